"""Number of paths per pixel for a tolerance, from pairs of pictures of a few pixels."""

import math
from dataclasses import asdict

import numpy as np

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.config.models import ReferenceIntegrator, Scene
from irodori.core.progress import LOGGER
from irodori.light.environment_file import Environment
from irodori.rendering.planning.planned_check import chosen_pixels, measure, refuse_above
from irodori.rendering.planning.tolerance import SHARE, bound_of_share, differences
from irodori.rendering.reference.converging_picture import REPLICATES, TracedScene, make_scene, render_rows
from irodori.rendering.reference.random_numbers import make_numbers
from irodori.rendering.scene_arrays import Objects, View, make_view
from irodori.rendering.scene_white import scene_white
from irodori.rendering.single_pixels import sheared_view

#: Pixels of each view rendered twice for the plan, and the paths of each time.
PILOTS, PILOT_PATHS = 400, 64
#: Pixels of the check, and how many times the plan's paths they get.
PIXELS, MORE = 600, 4
#: Paths of a pixel, the fewest of a plan.
_LEAST = 8
_PILOT_SEEDS, _CHECK_SEED = (101, 102), 103


def render_pixels(prepared: TracedScene, view: View, pixels: np.ndarray, samples: int, seed: int) -> np.ndarray:
    """Return chosen pixels of a view by paths, (n, 61) float64; each has random numbers of its own.

    Parameters
    ----------
    prepared : irodori.rendering.reference.converging_picture.TracedScene
    view : View
    pixels : (n, 2) int
        Column and row.
    samples : int
        Paths a pixel, an even number.
    seed : int
    """
    numbers = make_numbers(samples, seed, REPLICATES)
    found = []
    for number, (x, y) in enumerate(pixels):
        seen = sheared_view(view, x + 0.5, y + 0.5)
        own = numbers._replace(seed=seed * 1_000_003 + number)
        found.append(render_rows(prepared, seen, own, (0, 1)).radiance[0, 0])
    return np.array(found, dtype=np.float64).reshape(len(pixels), -1)


def plan_reference(
    scene_name: str,
    scene: Scene,
    placements,
    objects: Objects,
    environment: Environment,
    *,
    views: list[View],
) -> dict:
    """Return the plan of a scene of the reference integrator: the paths of a pixel.

    The noise of a pixel falls with the root of the number of paths at least; it is taken from the difference of two
    renderings of random pixels. The integrator's ``samples`` are the most that the plan takes.

    Parameters
    ----------
    scene_name : str
    scene : Scene
    placements, objects, environment
        As of `irodori.rendering.reference.converging_picture.make_scene`.
    views : list of View
    """
    white, _ = scene_white(scene, environment)
    matrix = xyz_from_radiance(white)
    prepared = make_scene(placements, objects, environment, scene.lights)
    found, bounds = 0, []
    for number, view in enumerate(views):
        pixels = chosen_pixels(view, PILOTS, number)
        one, other = (render_pixels(prepared, view, pixels, PILOT_PATHS, seed) @ matrix.T for seed in _PILOT_SEEDS)
        bounds.append(bound_of_share(differences(one, other, matrix @ white)))
        found += len(pixels)
    # Each picture is checked alone. Two differ by √2 times what one errs, and the check's own noise is seen too.
    noise = max(bounds) / math.sqrt(2.0) * math.sqrt(1.0 + 1.0 / MORE)
    assert isinstance(scene.integrator, ReferenceIntegrator)  # whose plan this is
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
    """Return the least power of two of paths whose noise keeps a tolerance, at most ``most``."""
    samples = _LEAST
    while samples < most and noise * math.sqrt(PILOT_PATHS / samples) > tolerance:
        samples *= 2
    return min(samples, most)


def check_reference(
    scene: Scene,
    view_name: str,
    placements,
    objects: Objects,
    environment: Environment,
    *,
    radiance: np.ndarray,
    plan: dict,
) -> dict:
    """Return what random pixels with `MORE` times the paths say of a picture, (height, width, 61).

    Raises
    ------
    irodori.rendering.planning.planned_check.ToleranceError
        If it is more than the plan's tolerance.
    """
    white, _ = scene_white(scene, environment)
    matrix = xyz_from_radiance(white)
    prepared = make_scene(placements, objects, environment, scene.lights)
    view = make_view(scene.views[view_name], scene.image)
    pixels = chosen_pixels(view, PIXELS)
    samples = MORE * plan["decisions"]["samples"]["value"]
    truth = render_pixels(prepared, view, pixels, samples, _CHECK_SEED) @ matrix.T
    found = radiance[pixels[:, 1], pixels[:, 0]].astype(np.float64) @ matrix.T
    measured = measure(found, truth, matrix @ white)
    LOGGER.info("plan: predicted %.3g, measured %.3g ΔE2000", plan["predicted_delta_e"], measured.p99)
    refuse_above(measured, plan, view_name, "the samples of the integrator and of `plan`")
    return {
        "tolerance_ciede2000": plan["tolerance_ciede2000"],
        "predicted_delta_e": plan["predicted_delta_e"],
        "measured_delta_e": asdict(measured),
    }
