"""The stage: materials, light and a scene in; spectral EXR, PNG and figures out."""

import json
import os
import time
from pathlib import Path

import numpy as np

from irodori.colour import xyz_from_radiance
from irodori.display import encode_srgb, rgb_from_xyz
from irodori.geometry.shapes import Shape
from irodori.light import Environment
from irodori.material import Material
from irodori.pictures import write_png, write_spectral_exr
from irodori.progress import LOGGER, track
from irodori.rendering.integrator import render_rows
from irodori.rendering.scene import make_light, make_objects, make_placements, make_tracer, make_view


def display_white(environment: Environment, exposure) -> tuple[np.ndarray, float]:
    """Return the radiance that the display shows as white, and the exposure used.

    Parameters
    ----------
    environment : Environment
    exposure : float or ``auto``
        Factor on the radiance of a perfect diffuser that faces up; ``auto`` is 1, that diffuser is then white.

    Returns
    -------
    white : (61,) float64
    exposure : float
    """
    factor = 1.0 if exposure == "auto" else float(exposure)
    return environment.upward_white() / factor, factor


def render_image(
    scene: dict,
    view_name: str,
    shapes: list[Shape],
    materials: list[Material],
    environment: Environment,
    options: dict,
    tile_rows: int = 60,
) -> tuple[np.ndarray, dict]:
    """Render a view of a scene.

    Parameters
    ----------
    scene : dict
        Validated definition of the scene.
    view_name : str
    shapes, materials : one an object of the scene
    environment : Environment
    options : dict
        See `irodori.rendering.integrator.render_rows`.
    tile_rows : int
        Rows rendered between two reports of progress.

    Returns
    -------
    radiance : (height, width, 61) float32
    figures : dict
        Seconds, pixels and rays per second, share of filled texels by object.
    """
    placements = make_placements(scene, shapes)
    tracer = make_tracer(placements)
    objects, filled = make_objects(placements, materials)
    light = make_light(environment)
    view = make_view(scene["views"][view_name], scene["image"])
    render_rows(objects, light, view, tracer, (view.height // 2, view.height // 2 + 1), options)  # compile
    start, met = time.perf_counter(), 0
    radiance = np.empty((view.height, view.width, 61), dtype=np.float32)
    for first in track(range(0, view.height, tile_rows), f"render {view_name}"):
        last = min(first + tile_rows, view.height)
        radiance[first:last], shaded = render_rows(objects, light, view, tracer, (first, last), options)
        met += shaded
    seconds = time.perf_counter() - start
    primary = view.width * view.height * options["pixel_side"] ** 2
    rays = primary + met * (1 + options["ambient_samples"] + options["gloss_samples"])
    figures = {
        "seconds": seconds,
        "pixels_per_second": view.width * view.height / seconds,
        "rays": rays,
        "rays_per_second": rays / seconds,
        "surfaces_shaded": met,
        "filled_fraction": {o["object"]: f for o, f in zip(scene["objects"], filled, strict=True)},
    }
    return radiance, figures


def render_view(
    scene: dict,
    view_name: str,
    shapes: list[dict],
    material_files: list,
    environment_file,
    exr,
    png,
    figures_file,
    options: dict,
    tile_rows: int,
) -> None:
    """Render a view from files into a spectral EXR, a PNG and a JSON of figures."""
    materials = [Material.load(path) for path in material_files]
    environment = Environment.load(environment_file)
    radiance, figures = render_image(
        scene, view_name, [Shape.from_definition(s) for s in shapes], materials, environment, options, tile_rows
    )
    white, exposure = display_white(environment, scene["display"]["exposure"])
    matrix = xyz_from_radiance(white)
    white_xyz = matrix @ white
    rgb = radiance @ (rgb_from_xyz(white_xyz) @ matrix).T.astype(np.float32)
    pixels, outside = encode_srgb(rgb)
    attributes = {"irodori:chromaticAdaptation": "CAT16", "irodori:whiteXYZ": " ".join(f"{v:.6g}" for v in white_xyz)}
    write_spectral_exr(exr, radiance, rgb, attributes)
    write_png(png, pixels)
    figures |= {"out_of_gamut_fraction": outside, "exposure": exposure}
    temporary = Path(figures_file).with_suffix(".part")
    temporary.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    os.replace(temporary, figures_file)
    LOGGER.info(
        "%.2f s, %.0f pixels/s, %.2f million rays/s; %.1f %% of pixels outside the display's gamut",
        figures["seconds"],
        figures["pixels_per_second"],
        figures["rays_per_second"] / 1e6,
        100 * outside,
    )
