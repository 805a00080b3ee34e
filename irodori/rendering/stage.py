"""Rendering stage: reads materials, light and a scene; writes a spectral EXR, a PNG and figures."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.colour.display import Display, make_display, srgb
from irodori.config.models import ObjectShape, Render, Scene
from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError, counted
from irodori.core.progress import LOGGER
from irodori.core.store import Provenance
from irodori.export.loss import LOSS, display_loss, stored_loss
from irodori.export.pictures import read_xyz, write_display_picture, write_spectral_exr, write_xyz_exr
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment
from irodori.rendering.energy_gain import load_materials
from irodori.rendering.eyes import refuse_enclosed_eye, tell_black_backs
from irodori.rendering.integrators import (
    InteractiveRenderer,
    Renderer,
    body_material,
    make_renderer,
    render_prepared,
    with_planned_samples,
)
from irodori.rendering.planning.scene_plan import read_plan
from irodori.rendering.scene_white import scene_white, shown_white


def render_view(
    scene: Scene,
    view_name: str,
    shapes: Sequence[ObjectShape],
    material_files: list,
    environment_file,
    *,
    exr,
    png,
    figures_file,
    options: Render,
    plan_file=None,
    maps_file=None,
    check: bool = True,
) -> None:
    """Render a view from files into an EXR, a PNG and a JSON of figures.

    The EXR holds spectra, or XYZ if a plan does not compute spectra. With ``check``, the figures include the picture's
    distance to the path-traced one, and nothing is written if that exceeds the plan's tolerance.

    Raises
    ------
    InputError
        If the view's eye is inside an object, a material reflects more light than falls on it, there is no light, or
        a pixel of the rendered picture is not finite; no file is written then.
    """
    plan = read_plan(plan_file) if plan_file else None
    display = make_display(scene.display.device)
    placed = [Shape.from_definition(shape) for shape in shapes]
    refuse_enclosed_eye(scene, view_name, placed)
    environment = Environment.load(environment_file)
    white, exposure = shown_white(scene, environment, environment_file)

    def prepared() -> Renderer:
        materials = load_materials(scene, placed, material_files)
        two_sided = [material.is_sheet for material in materials]
        tell_black_backs(scene, view_name, placed, two_sided + [body_material(body).is_sheet for body in scene.bodies])
        return make_renderer(
            with_planned_samples(scene, plan), placed, materials, environment, options, maps_file=maps_file
        )

    radiance, figures = render_prepared(
        prepared(), view_name, tiles_folder=Path(exr).with_suffix(".tiles"), plan=plan, check=check, distance=check
    )
    require_finite(radiance, exr)
    matrix = xyz_from_radiance(white)
    white_xyz = matrix @ white
    if radiance.shape[-1] == 3:
        xyz = radiance  # of a plan that does not carry all bands
        write_xyz_exr(exr, xyz, _xyz_attributes(xyz, white_xyz))
    else:
        xyz = radiance @ matrix.T.astype(np.float32)
        rgb, attributes = srgb().linear_rgb(xyz, white_xyz), srgb().attributes(white_xyz)
        write_spectral_exr(exr, radiance, rgb, attributes, storage=options.storage, white=white)
    figures |= write_picture(png, xyz, white_xyz, display) | {"display": display.name, "exposure": exposure}
    with written_whole(figures_file) as temporary:
        temporary.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    LOGGER.info("%.2f s, %.0f pixels/s", figures["seconds"], figures["pixels_per_second"])


def bake_light(
    scene: Scene,
    shapes: Sequence[ObjectShape],
    material_files: list,
    environment_file,
    *,
    options: Render,
    output,
    provenance: Provenance,
) -> None:
    """Bake the light maps of a scene, which are the same for all its views, into a file; see `render_view`."""
    placed = [Shape.from_definition(shape) for shape in shapes]
    materials = load_materials(scene, placed, material_files)
    renderer = make_renderer(scene, placed, materials, Environment.load(environment_file), options)
    assert isinstance(renderer, InteractiveRenderer)  # the workflow asks for maps of these scenes alone
    renderer.baked.save(output, provenance)


def require_finite(picture: np.ndarray, path) -> None:
    """Refuse a picture, (height, width, n), with a number that is not finite; the message names the first pixel.

    Raises
    ------
    InputError
    """
    bad = np.argwhere(~np.isfinite(picture).all(axis=-1))
    if len(bad):
        found = (
            f"{counted(len(bad), 'pixel')} without a finite colour, the first in row {bad[0, 0]}, column {bad[0, 1]}"
        )
        raise InputError(path, "", found, "finite light in every pixel; please report this fault of the renderer")


def write_picture(
    path, xyz: np.ndarray, white_xyz: np.ndarray, display: Display, bits: int = 8, judged_step: int = 1
) -> dict[str, float]:
    """Write XYZ (height, width, 3) as a picture for a display; return and log the share of out-of-gamut colours.

    The file states its loss by rounding to code values and by colours outside the display's gamut. It is measured on
    every ``judged_step``-th pixel of every ``judged_step``-th row.

    Raises
    ------
    InputError
        If a pixel is not finite.
    """
    require_finite(xyz, path)
    linear = display.linear_rgb(xyz, white_xyz)
    pixels, gamut = display.encode(linear, bits)
    judged = np.s_[::judged_step, ::judged_step]
    attributes = {LOSS: display_loss(display, linear[judged], pixels[judged]).text} | display.attributes(white_xyz)
    write_display_picture(path, pixels, display.profile, attributes)
    figures = gamut.figures()
    text = "%s: %.2f %% of pixels outside the gamut of %s, set to its edge (%.2f %% under 0, %.2f %% over 1)"
    shares = [100 * figures[f"out_of_gamut_{side}fraction"] for side in ("", "below_", "above_")]
    LOGGER.info(text, path, shares[0], display.name, *shares[1:])
    return figures


def write_xyz(scene: Scene, exr, environment_file, output) -> None:
    """Write the XYZ of a rendered view without chromatic adaptation; Y = 100 is the scene's white.

    Parameters
    ----------
    scene : Scene
    exr : path
        Spectral EXR of the view.
    environment_file : path
    output : path
    """
    xyz, white_xyz = _view_xyz(scene, exr, environment_file)
    write_xyz_exr(output, xyz, _xyz_attributes(xyz, white_xyz))


def _xyz_attributes(xyz: np.ndarray, white_xyz: np.ndarray) -> dict[str, str]:
    loss = stored_loss(
        np.eye(3), white_xyz, xyz.__getitem__, lambda part: xyz[part].astype(np.float32, copy=False), len(xyz)
    )
    listed = " ".join(f"{value:.6g}" for value in white_xyz)
    observer = {"irodori:observer": "CIE 1931 2 degrees", "irodori:chromaticAdaptation": "none"}
    return observer | {"irodori:whiteXYZ": listed, LOSS: loss.text}


def write_tiff(scene: Scene, exr, environment_file, output) -> None:
    """Write a rendered view for its display with 16 bits per channel; parameters as in `write_xyz`."""
    display = make_display(scene.display.device)
    write_picture(output, *_view_xyz(scene, exr, environment_file), display, bits=16)


def _view_xyz(scene: Scene, exr, environment_file) -> tuple[np.ndarray, np.ndarray]:
    """Return the XYZ of a view's EXR, (height, width, 3), and the XYZ of its white, (3,)."""
    white, _ = scene_white(scene, Environment.load(environment_file))
    matrix = xyz_from_radiance(white)
    return read_xyz(exr, matrix), matrix @ white
