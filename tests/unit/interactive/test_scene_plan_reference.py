"""The plan of the reference integrator: paths for a tolerance, predicted from pairs of pixels and checked."""

import numpy as np
import pytest
from made import made
from scenes import BALL, material, plate, sky, smooth_light

from irodori.config.models import Render, Scene, Size, View
from irodori.config.parts import Staging
from irodori.rendering.integrators import render_image
from irodori.rendering.planning.planned_check import ToleranceError
from irodori.rendering.planning.scene_plan import ScenePlan
from irodori.rendering.planning.stage import plan_of
from irodori.rendering.reference.converging_picture import make_scene, render
from irodori.rendering.reference.distance import traced_halves
from irodori.rendering.scene_arrays import make_objects, make_placements, make_view

OPTIONS = Render(pixel_side=1, min_throughput=1e-3)
SHAPES, MATERIALS = [plate(90.0), BALL], [material(0.6), material(0.3, beta=2.0, mu=0.2)]


def scene_of(tolerance: float, most=4096, **overrides) -> dict:
    places = [{"position_mm": [0.0, 0.0, z], "rotation_deg": [0.0, 0.0, 0.0], "scale": 1.0} for z in (0.0, 20.1)]
    return {
        "image": {"width": 24, "height": 18},
        "objects": [{"object": name, **place} for name, place in zip(("table", "jar"), places, strict=True)],
        "views": {"v": {"position_mm": [0.0, -200.0, 90.0], "target_mm": [0.0, 0.0, 12.0], "up": [0.0, 0.0, 1.0],
                        "field_of_view_deg": 22.0}},
        "integrator": {"kind": "reference", "samples": most, "seed": 0},
        "max_bounces": 4,
        "lights": [],
        "display": {"exposure": "auto", "device": {"kind": "standard", "name": "sRGB"}},
        "tolerance_ciede2000": tolerance,
        "plan": overrides,
    }  # fmt: skip


def light():
    return sky(lambda unit: smooth_light(unit)[..., None], 64, 32)


def plan(definition) -> dict:
    return plan_of("table-top", made(Scene, definition), SHAPES, MATERIALS, light(), made(Render, OPTIONS))


def test_half_the_tolerance_takes_about_four_times_the_paths_and_the_check_agrees():
    plans = [plan(scene_of(tolerance)) for tolerance in (4.0, 2.0)]
    samples = [p["decisions"]["samples"]["value"] for p in plans]
    assert samples[1] == 4 * samples[0] < 4096
    for tolerance, document in zip((4.0, 2.0), plans, strict=True):
        assert tolerance / 2 < document["predicted_delta_e"] <= tolerance
        _, figures = render_image(
            made(Scene, scene_of(tolerance)),
            "v",
            SHAPES,
            MATERIALS,
            light(),
            made(Render, OPTIONS),
            plan=ScenePlan.of(document),
        )
        assert figures["samples"] == document["decisions"]["samples"]["value"]
        # Sobol points err by less than the root law says, pilots by luck.
        assert 0.3 * document["predicted_delta_e"] < figures["delta_e_to_reference"]["p99"] <= tolerance


@pytest.mark.heavy
def test_views_without_noise_do_not_thin_out_the_one_that_has_it():
    definition = scene_of(4.0)
    alone = plan(definition)
    sky_alone = definition["views"]["v"] | {"target_mm": [0.0, -400.0, 300.0]}
    definition["views"]["sky"] = sky_alone
    assert plan(definition)["predicted_delta_e"] == alone["predicted_delta_e"] > 0


def test_too_few_paths_are_refused():
    definition = scene_of(0.5, samples=8)
    document = plan(definition)
    assert document["decisions"]["samples"]["by"] == "scene" and document["predicted_delta_e"] > 0.5
    with pytest.raises(ToleranceError, match=r"table-top.* or the samples of the integrator"):
        render_image(
            made(Scene, definition), "v", SHAPES, MATERIALS, light(), made(Render, OPTIONS), plan=ScenePlan.of(document)
        )


LENS = {"lens": {"diameter_mm": 30.0, "focus_mm": 150.0}}
PARALLEL = {"kind": "orthographic", "height_mm": 90.0}


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("kind", [{}, LENS, PARALLEL], ids=["pinhole", "lens", "parallel"])
def test_single_pixels_converge_to_those_of_the_picture(kind):
    definition = scene_of(1.0)
    definition["views"]["v"] |= kind
    if kind is PARALLEL:
        del definition["views"]["v"]["field_of_view_deg"]
    placements = make_placements(made(Scene | Staging, definition), SHAPES)
    objects, _ = make_objects(placements, MATERIALS)
    prepared, view = (
        make_scene(placements, objects, light()),
        make_view(made(View, definition["views"]["v"]), made(Size, definition["image"])),
    )
    pixels = np.array([[0, 0], [23, 17], [12, 9], [3, 14], [20, 2]])
    whole = render(prepared, view, 2048, seed=5, replicates=8)
    single = traced_halves(prepared, view, pixels, 2048, 7).mean(axis=0)
    error = whole.standard_error[pixels[:, 1], pixels[:, 0]]
    # Both have noise; seven standard errors of eight replicates are out of reach of luck.
    assert (np.abs(single - whole.radiance[pixels[:, 1], pixels[:, 0]]) <= 7 * np.sqrt(2) * error + 1e-3).all()
    # Another set of random numbers is another picture.
    one, other = (traced_halves(prepared, view, pixels[2:3], 8, seed) for seed in (7, 8))
    assert not np.array_equal(one, other) and not np.array_equal(*one)
