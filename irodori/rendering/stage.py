"""The stage: materials, light and a scene in; spectral EXR, PNG and figures out."""

import json
import os
from pathlib import Path

import numpy as np

from irodori.colour import xyz_from_radiance
from irodori.display import encode_srgb, rgb_from_xyz
from irodori.geometry.shapes import Shape
from irodori.light import Environment
from irodori.material import Material
from irodori.pictures import write_png, write_spectral_exr, write_xyz_exr
from irodori.progress import LOGGER
from irodori.rendering.integrators import render_image


def display_white(environment: Environment, lights: list[dict], exposure) -> tuple[np.ndarray, float]:
    """Return the radiance that the display shows as white, and the exposure used.

    Parameters
    ----------
    environment : Environment
    lights : list of dict
        Of the scene, which that diffuser sees from the scene's origin.
    exposure : float or ``auto``
        Factor on the radiance of a perfect diffuser that faces up; ``auto`` is 1, that diffuser is then white.

    Returns
    -------
    white : (61,) float64
    exposure : float
    """
    factor = 1.0 if exposure == "auto" else float(exposure)
    white = environment.upward_white()
    if lights:
        from irodori.rendering.lights import make_lights, upward_radiance

        white = white + upward_radiance(make_lights(lights, 0)[0])
    return white / factor, factor


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
    plan_file=None,
    check: bool = True,
) -> None:
    """Render a view from files into an EXR, a PNG and a JSON of figures.

    The EXR holds spectra, or XYZ where a plan does not carry them. Nothing is written of a picture whose check against
    its plan's tolerance fails.
    """
    plan = None
    if plan_file:
        from irodori.rendering.scene_plan.plan_file import read_plan  # loads the interactive integrator

        plan = read_plan(plan_file)
    materials = [Material.load(path) for path in material_files]
    environment = Environment.load(environment_file)
    radiance, figures = render_image(
        scene,
        view_name,
        [Shape.from_definition(s) for s in shapes],
        materials,
        environment,
        options,
        tile_rows,
        Path(exr).with_suffix(".tiles"),
        plan,
        check,
    )
    white, exposure = display_white(environment, scene.get("lights", []), scene["display"]["exposure"])
    matrix = xyz_from_radiance(white)
    white_xyz = matrix @ white
    spectral = radiance.shape[-1] != 3
    to_xyz = matrix if spectral else np.eye(3)
    rgb = radiance @ (rgb_from_xyz(white_xyz) @ to_xyz).T.astype(np.float32)
    pixels, outside = encode_srgb(rgb)
    attributes = {"irodori:chromaticAdaptation": "CAT16", "irodori:whiteXYZ": " ".join(f"{v:.6g}" for v in white_xyz)}
    if spectral:
        write_spectral_exr(exr, radiance, rgb, attributes)
    else:
        # XYZ are of the scene: only the display's picture is adapted.
        write_xyz_exr(exr, radiance, {"irodori:whiteXYZ": attributes["irodori:whiteXYZ"]})
    write_png(png, pixels)
    figures |= {"out_of_gamut_fraction": outside, "exposure": exposure}
    temporary = Path(figures_file).with_suffix(".part")
    temporary.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    os.replace(temporary, figures_file)
    LOGGER.info(
        "%.2f s, %.0f pixels/s; %.1f %% of pixels outside the display's gamut",
        figures["seconds"],
        figures["pixels_per_second"],
        100 * outside,
    )
