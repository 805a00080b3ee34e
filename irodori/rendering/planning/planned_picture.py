"""Rendering of a view by a plan, with a check against the full model, for `irodori.rendering.integrators`."""

import time
from dataclasses import asdict

import numpy as np

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.config.models import InteractiveIntegrator, Render, Scene
from irodori.config.placed_names import object_names
from irodori.core.progress import LOGGER
from irodori.rendering.integrators import InteractiveRenderer, has_light_maps
from irodori.rendering.interactive.frame_renderer import CollimatedLamp, render_frame
from irodori.rendering.interactive.pixel_rays import render_pixels
from irodori.rendering.planning.modelled_scene import SceneParts, full_model, prepare
from irodori.rendering.planning.plan_file import model_of
from irodori.rendering.planning.planned_check import chosen_pixels, measure, refuse_above
from irodori.rendering.planning.scene_plan import ScenePlan
from irodori.rendering.scene_arrays import make_view, row_names
from irodori.rendering.scene_lights import BANDS, make_lights
from irodori.rendering.scene_white import scene_white


def parts_of(renderer: InteractiveRenderer) -> SceneParts:
    """Return the parts of a renderer's scene in the planner's form."""
    scene, environment = renderer.scene, renderer.environment
    lights, _ = make_lights(scene.lights, 0)
    towards, spectra = lights.rotation[:, :, 2].copy(), lights.spectrum[:, :BANDS].astype(np.float64)
    white, _ = scene_white(scene, environment)
    maps = renderer.baked if has_light_maps(scene) else None
    return SceneParts(renderer.objects, environment, renderer.tracer, towards, spectra, white, maps)


def render_planned(
    scene: Scene, view_name: str, parts: SceneParts, options: Render, plan: ScenePlan, check: bool = True
) -> tuple[np.ndarray, dict]:
    """Render a view by a plan and check it.

    Parameters
    ----------
    scene : Scene
    view_name : str
    parts : SceneParts
    options : Render
    plan : ScenePlan
    check : bool
        Whether to compare random pixels with the full model, both without additional rays at outlines.

    Returns
    -------
    picture : (height, width, 61) radiance if the plan computes all bands, else (height, width, 3) XYZ; float32
    figures : dict

    Raises
    ------
    irodori.rendering.planning.planned_check.ToleranceError
        If the check finds an error above the plan's tolerance.
    """
    side, matrix = options.pixel_side, xyz_from_radiance(parts.white)
    full = full_model(parts, scene.max_bounces)
    model = model_of(plan, full, row_names(object_names(scene), parts.objects))
    bands = model.representation == "spectral"
    start = time.perf_counter()
    assert isinstance(scene.integrator, InteractiveIntegrator)  # the plan of another has no model
    prepared = prepare(parts, model, matrix, smooth_outlines=scene.integrator.smooth_outlines)
    prepared_s = time.perf_counter() - start
    lamps = tuple(CollimatedLamp(towards) for towards in parts.lamp_towards)
    view = make_view(scene.views[view_name], scene.image)
    fine = view.finer(side)
    render_frame(prepared, fine._replace(width=side, height=side), lamps=lamps, bands=bands)  # compile
    counted: dict[str, int] = {}
    start = time.perf_counter()
    picture = render_frame(prepared, fine, lamps=lamps, bands=bands, figures=counted)
    picture = picture.reshape(view.height, side, view.width, side, -1).mean(axis=(1, 3))
    seconds = time.perf_counter() - start
    of_plan = plan.figures
    figures = {
        "seconds": seconds,
        "seconds_to_prepare": prepared_s,
        "rays": counted["rays"],
        "rays_per_second": counted["rays"] / seconds,
        "plan": of_plan,
    }
    if check:
        start = time.perf_counter()
        pixels = chosen_pixels(view)
        found = render_pixels(prepared, view, pixels, side, lamps)
        del prepared
        truth = render_pixels(prepare(parts, full, matrix), view, pixels, side, lamps)
        measured = measure(found, truth, matrix @ parts.white)
        of_plan |= {"delta_e_to_full_model": asdict(measured), "seconds_to_check": time.perf_counter() - start}
        LOGGER.info("plan: predicted %.3g, measured %.3g ΔE2000", plan.predicted_delta_e, measured.p99)
        refuse_above(measured, plan, view_name)
    return picture, figures
