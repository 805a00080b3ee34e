"""Check whether the integrator `interactive` can keep a scene's tolerance at all, with advice if it cannot."""

import numpy as np

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.config.models import InteractiveIntegrator, Scene
from irodori.core.errors import InputError
from irodori.geometry.shapes.placement import Placement
from irodori.rendering.interactive.frame_renderer import CollimatedLamp, render_frame
from irodori.rendering.planning.modelled_scene import SceneParts, full_model, prepare
from irodori.rendering.reference.converging_picture import TracedScene, make_scene
from irodori.rendering.reference.distance import Distance, distance_to_reference, object_pixels
from irodori.rendering.scene_arrays import View, make_view


def refuse_unattainable(
    scene_name: str, scene: Scene, parts: SceneParts, placements: list[Placement], side: int
) -> Distance:
    """Return the full model's distance to path tracing in the worst view; raise an error if it exceeds the tolerance.

    The worst view is the one with the largest 99th percentile.

    Parameters
    ----------
    scene_name : str
    scene : Scene
        Scene with ``tolerance_ciede2000``.
    parts : SceneParts
        Parts of the scene.
    placements : list of Placement
        Placements of its objects and bodies.
    side : int
        Number of rays along each side of a pixel.

    Raises
    ------
    InputError
        If the distance exceeds the tolerance; the message names measured settings that would keep it.
    """
    traced = make_scene(placements, parts.objects, parts.environment, scene.lights)
    views = [make_view(view, scene.image) for view in scene.views.values()]
    tolerance = scene.tolerance_ciede2000
    assert tolerance is not None  # of a scene that is planned
    found = _of_full_model(scene, parts, traced, views, side)
    if found.p99 < tolerance:
        return found
    mends = [f"a tolerance above {found.p99:.3g}", "the integrator reference"]
    if parts.maps is None:
        mends.insert(1, "the integrator's `light_maps: true`")
    raise InputError(
        f"scene {scene_name}",
        "tolerance_ciede2000",
        f"{tolerance:g}, but 99 of 100 pixels of objects that the integrator interactive renders with all that it has "
        f"are within {found.p99:.3g} ± {found.standard_error_of_p99:.2g} ΔE2000 of path tracing "
        f"(mean {found.mean:.3g})",
        ", or ".join(mends),
    )


def _of_full_model(scene: Scene, parts: SceneParts, traced: TracedScene, views: list[View], side: int) -> Distance:
    """Return the full model's distance in the view with the largest 99th percentile."""
    matrix = xyz_from_radiance(parts.white)
    lamps = tuple(CollimatedLamp(towards) for towards in parts.lamp_towards)
    assert isinstance(scene.integrator, InteractiveIntegrator)  # another has no full model
    full, found = full_model(parts, scene.max_bounces), []
    prepared = prepare(parts, full, matrix, smooth_outlines=scene.integrator.smooth_outlines)
    for number, view in enumerate(views):
        pixels = object_pixels(traced.tracer, view, len(parts.objects.mirror), number)
        picture = render_frame(prepared, view.finer(side), lamps=lamps)
        picture = picture.reshape(view.height, side, view.width, side, 3).mean(axis=(1, 3))
        shown = picture[pixels[:, 1], pixels[:, 0]].astype(np.float64)
        found.append(distance_to_reference(traced, view, pixels, shown, matrix, matrix @ parts.white))
    return max(found, key=lambda one: one.p99)
