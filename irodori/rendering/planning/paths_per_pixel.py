"""Number of paths per pixel for a tolerance, estimated from two independent renderings of a few pixels."""

import math

from irodori.colour.colorimetry import delta_e_xyz, xyz_from_radiance
from irodori.config.models import ReferenceIntegrator, Scene
from irodori.light.environment_file import Environment
from irodori.rendering.planning.planned_check import chosen_pixels
from irodori.rendering.planning.tolerance import SHARE, bound_of_share
from irodori.rendering.reference.converging_picture import make_scene
from irodori.rendering.reference.distance import traced_halves
from irodori.rendering.scene_arrays import Objects, View
from irodori.rendering.scene_white import scene_white

#: Number of pixels of each view that are rendered twice for the plan, and paths per pixel of each rendering.
PILOTS, PILOT_PATHS = 400, 64
#: Least number of paths per pixel of a plan.
_LEAST = 8
_PILOT_SEED = 101


def plan_reference(
    scene_name: str,
    scene: Scene,
    placements,
    objects: Objects,
    environment: Environment,
    *,
    views: list[View],
) -> dict:
    """Return the plan of a scene of the integrator `reference`: its number of paths per pixel.

    The noise is estimated from the difference of two renderings of random pixels. It falls at least with the square
    root of the number of paths. The integrator's ``samples`` are the maximum.

    Parameters
    ----------
    scene_name : str
    scene : Scene
    placements, objects, environment
        As in `irodori.rendering.reference.converging_picture.make_scene`.
    views : list of View
    """
    white, _ = scene_white(scene, environment)
    matrix = xyz_from_radiance(white)
    prepared = make_scene(placements, objects, environment, scene.lights)
    found, bounds = 0, []
    for number, view in enumerate(views):
        pixels = chosen_pixels(view, PILOTS, number)
        # At outlines, where points cover a pixel evenly, the noise falls faster than with the root, and so it rises
        # faster if there are fewer paths than here: pilots have no more paths there, the picture has.
        one, other = traced_halves(prepared, view, pixels, 2 * PILOT_PATHS, _PILOT_SEED, more=1) @ matrix.T
        bounds.append(bound_of_share(delta_e_xyz(one, other, matrix @ white)))
        found += len(pixels)
    # The noisiest view counts. The difference of two renderings is √2 times the error of one.
    noise = max(bounds) / math.sqrt(2.0)
    assert isinstance(scene.integrator, ReferenceIntegrator)  # checked by the caller
    assert scene.tolerance_ciede2000 is not None
    most = scene.integrator.samples
    samples = scene.plan.samples or _samples_for(noise, scene.tolerance_ciede2000, most)
    predicted = float(f"{noise * math.sqrt(PILOT_PATHS / samples):.4g}")
    decision = {
        "value": samples,
        "full": most,
        "predicted_delta_e": predicted,
        "paths_per_pixel": samples,
        "by": "plan" if scene.plan.samples is None else "scene",
        "why": f"{found} pixels of {PILOT_PATHS} paths, twice",
    }
    return {
        "scene": scene_name,
        "integrator": "reference",
        "tolerance_ciede2000": scene.tolerance_ciede2000,
        "pixels_within": SHARE,
        "predicted_delta_e": predicted,
        "cost": {"paths_per_pixel": samples},
        "cost_of_full_model": {"paths_per_pixel": most},
        "decisions": {"samples": decision},
    }


def _samples_for(noise: float, tolerance: float, most: int) -> int:
    """Return the least power of two of paths per pixel whose noise is within a tolerance, at most ``most``."""
    samples = _LEAST
    while samples < most and noise * math.sqrt(PILOT_PATHS / samples) > tolerance:
        samples *= 2
    return min(samples, most)
