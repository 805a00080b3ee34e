"""The published error of a picture: its distance to path tracing, with the paths' noise taken out."""

import numpy as np
import pytest
from made import made
from scenes import BALL, constant_light, material, plate, sky, smooth_light

from irodori.colour.colorimetry import delta_e, lab_from_xyz, xyz_from_radiance
from irodori.config.models import Render, Scene
from irodori.core.errors import InputError
from irodori.geometry.shapes.placement import Placement
from irodori.rendering.integrators import render_image
from irodori.rendering.planning.stage import plan_of
from irodori.rendering.reference.converging_picture import make_scene
from irodori.rendering.reference.distance import distance_to_halves, distance_to_reference, object_pixels, traced_halves
from irodori.rendering.scene_arrays import View, make_objects

WHITE_XYZ = np.array([95.047, 100.0, 108.883])
FIGURES = ("mean", "p95", "p99", "rms")


def halves_of(rng, truth, noise):
    """Two pictures with independent noise, a part of each pixel's luminance that all channels share, mostly."""
    together = rng.normal(size=(2, len(truth), 1)) + 0.2 * rng.normal(size=(2, len(truth), 3))
    return truth * (1.0 + noise * together)


def exact_figures(truth, shown):
    off = delta_e(lab_from_xyz(truth, WHITE_XYZ), lab_from_xyz(shown, WHITE_XYZ))
    return {"mean": off.mean(), "p95": np.percentile(off, 95), "p99": np.percentile(off, 99),
            "rms": np.sqrt(np.mean(off**2))}  # fmt: skip


def made_up(rng, count):
    truth = WHITE_XYZ * rng.uniform(0.1, 0.7, (count, 1)) * rng.uniform(0.8, 1.0, (count, 3))
    return truth, truth * (1.0 + 0.06 * rng.normal(size=(count, 1)) + 0.02 * rng.normal(size=(count, 3)))


@pytest.mark.heavy
def test_known_errors_are_found_under_noise_of_their_size():
    rng = np.random.default_rng(5)
    truth, shown = made_up(rng, 40_000)
    halves = halves_of(rng, truth, 0.06)
    found, exact = distance_to_halves(shown, halves, WHITE_XYZ, 8), exact_figures(truth, shown)
    assert found.noise == pytest.approx(exact_figures(truth, halves.mean(axis=0))["rms"], rel=0.03)
    noisy = exact_figures(halves.mean(axis=0), shown)
    assert found.rms == pytest.approx(exact["rms"], rel=0.02)
    for name in FIGURES:
        assert noisy[name] > 1.09 * exact[name]  # as it would be with the noise
        assert getattr(found, name) == pytest.approx(exact[name], rel=0.04), name


def test_a_perfect_picture_has_a_small_part_of_the_noise_left():
    rng = np.random.default_rng(6)
    truth, _ = made_up(rng, 20_000)
    found = distance_to_halves(truth, halves_of(rng, truth, 0.03), WHITE_XYZ, 8)
    assert found.noise > 0.5 and found.rms < 0.15 * found.noise and found.mean < 0.15 * found.noise


@pytest.mark.heavy
def test_stated_standard_errors_cover_the_truth():
    """The truth is the figure of endless pixels; a picture's are a sample of them."""
    rng = np.random.default_rng(7)
    exact, off = exact_figures(*made_up(rng, 400_000)), {name: [] for name in FIGURES}
    for _ in range(120):
        truth, shown = made_up(rng, 600)
        found = distance_to_halves(shown, halves_of(rng, truth, 0.02), WHITE_XYZ, 8)
        for name in FIGURES:
            off[name].append((getattr(found, name) - exact[name]) / getattr(found, f"standard_error_of_{name}"))
    for name in FIGURES:
        within = np.abs(off[name])
        assert 0.55 < np.mean(within < 1.0) < 0.82 and np.mean(within < 2.0) > 0.88, name


VIEW = View(np.array([0.0, 0.0, 200.0]), np.diag([1.0, -1.0, -1.0]), 90.0, 60, 40)


def traced(reflectance, light):
    placements = [Placement(BALL, np.eye(3), np.zeros(3))]
    return make_scene(placements, make_objects(placements, [material(reflectance)])[0], light)


def test_a_diffuse_ball_under_constant_light_is_as_far_as_its_closed_form_says():
    light, reflectance = constant_light(), 0.4
    scene, white = traced(reflectance, light), light.upward_white()
    matrix = xyz_from_radiance(white)
    pixels = object_pixels(scene.tracer, VIEW, 1)
    # Far from the outline, where pixels show the ball and the sky.
    pixels = pixels[np.hypot(pixels[:, 0] - 29.5, pixels[:, 1] - 19.5) < 6.0]
    assert len(pixels) > 80
    exact = matrix @ (reflectance * white)  # of a convex body under radiance from all sides
    shown = np.broadcast_to(1.1 * exact, (len(pixels), 3))
    found = distance_to_reference(scene, VIEW, pixels, shown, matrix, matrix @ white)
    expected = exact_figures(
        exact[None] / (matrix @ white) * WHITE_XYZ, 1.1 * exact[None] / (matrix @ white) * WHITE_XYZ
    )
    assert found.rms == pytest.approx(expected["rms"], abs=3 * found.standard_error_of_rms + 0.01)
    assert found.brightness == pytest.approx(0.1, abs=1e-3) and found.standard_error_of_brightness < 1e-3
    right = distance_to_reference(scene, VIEW, pixels, np.broadcast_to(exact, shown.shape), matrix, matrix @ white)
    assert right.rms < 0.05


def test_pixels_of_objects_are_chosen_and_no_others_and_each_once():
    scene = traced(0.4, constant_light())
    pixels = object_pixels(scene.tracer, VIEW, 1)
    assert len(np.unique(pixels, axis=0)) == len(pixels) < VIEW.width * VIEW.height
    # The outline of a sphere seen from a point: tan of its half angle times the focal length.
    radius = 90.0 * np.tan(np.arcsin(20.0 / 200.0))
    assert np.hypot(*(pixels + 0.5 - (30.0, 20.0)).T).max() <= radius + 1e-6
    assert abs(len(pixels) - np.pi * radius**2) < 4 * radius
    assert len(object_pixels(scene.tracer, VIEW, 1, count=7)) == 7
    assert not len(object_pixels(scene.tracer, VIEW, 0))  # what is met is a light
    empty = distance_to_reference(scene, VIEW, pixels[:0], np.zeros((0, 3)), np.ones((3, 61)), WHITE_XYZ)
    assert empty.count == empty.p99 == 0


def scene_of(integrator, tolerance=None):
    places = [{"position_mm": [0.0, 0.0, z], "rotation_deg": [0.0, 0.0, 0.0], "scale": 1.0} for z in (0.0, 20.1)]
    return made(Scene, {
        "image": {"width": 48, "height": 36},
        "objects": [{"object": name, **place} for name, place in zip(("table", "jar"), places, strict=True)],
        "views": {"v": {"position_mm": [0.0, -200.0, 90.0], "target_mm": [0.0, 0.0, 12.0], "up": [0.0, 0.0, 1.0],
                        "field_of_view_deg": 22.0}},
        "integrator": integrator,
        "max_bounces": 4,
        "lights": [],
        "display": {"exposure": "auto", "device": {"kind": "standard", "name": "sRGB"}},
        "tolerance_ciede2000": tolerance,
    })  # fmt: skip


STUDIO = ([plate(90.0), BALL], [material(0.8), material(0.6)], sky(lambda unit: smooth_light(unit)[..., None], 64, 32))
OPTIONS = made(Render, Render(pixel_side=2, min_throughput=1e-3))


@pytest.mark.heavy
def test_a_picture_states_what_it_leaves_out_of_the_transport():
    far = {}
    for name, integrator in {
        "plain": {"kind": "interactive", "light_maps": False},
        "maps": {"kind": "interactive", "light_maps": True},
        "reference": {"kind": "reference", "samples": 512, "seed": 0},
    }.items():
        _, figures = render_image(scene_of(integrator), "v", *STUDIO, OPTIONS, distance=True)
        far[name] = figures["delta_e_to_reference"]
    # A ball on a plate hides half of its light: more than anybody overlooks.
    assert far["plain"]["mean"] > 1.5 and far["plain"]["mean"] > 1.5 * far["maps"]["mean"]
    assert far["maps"]["rms"] < 1.0 and far["reference"]["rms"] < 0.5


@pytest.mark.heavy
def test_a_tolerance_that_the_integrator_cannot_keep_is_refused_with_what_would():
    def plan(tolerance):
        scene = scene_of({"kind": "interactive", "light_maps": False}, tolerance)
        return plan_of("table-top", scene, *STUDIO, OPTIONS, to_reference=True)

    with pytest.raises(
        InputError, match=r"tolerance_ciede2000: found 1, but .* path tracing .*`light_maps: true`, or .* ref"
    ):
        plan(1.0)
    document = plan(60.0)
    far = document["full_model_delta_e_to_reference"]["p99"]
    assert document["tolerance_ciede2000"] == 60.0 and 1.0 < far < 60.0
    assert document["predicted_delta_e"] <= 60.0 - far


def test_halves_share_no_random_numbers_and_pixels_have_their_own():
    scene = traced(0.4, STUDIO[2])
    pixels = np.array([[28, 19], [31, 21]])
    first, second = traced_halves(scene, VIEW, pixels, 8, 3)
    off = second - first
    assert off.all() and not np.allclose(off[0] / first[0], off[1] / first[1])
