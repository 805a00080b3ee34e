"""The planner: the best choice among few, and poses that a rig can take."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import made
from plans import PLATE_OBJECT, POSES, RIG, SIDEWAYS, SPHERE_OBJECT, texel
from scipy.stats import qmc
from shortcuts import information

from irodori.capture.shot_planner.exchange import Selection, TooFewPoses, choose
from irodori.capture.shot_planner.fisher_information import (
    Materials,
    ObservationNoise,
    Observations,
    RigSubject,
    observe,
    shared_errors,
    standard_errors,
)
from irodori.capture.shot_planner.planner import (
    KNOWN_RELATIVE_ERROR,
    MaterialRange,
    Planner,
    axis_angles,
    candidate_poses,
    default_noise,
    open_poses,
    plan_best,
    subject_of,
)
from irodori.config.capture_table import Pose, expand_poses
from irodori.config.definitions import load_definitions, read_yaml
from irodori.config.models import AxisLimit, Fit, Object, Rig, RigLimits
from irodori.config.parts import PlannedObject
from irodori.fitting import judge
from irodori.geometry.rig_frame import to_camera, to_light
from irodori.geometry.shapes.plate import Plate
from irodori.geometry.shapes.shape import Shape

ROOT = Path(__file__).resolve().parents[2]
PRIOR = 1.0
#: Criteria of a single texel: its own information, and the same as a patch that shares its gloss.
PATCHES = (None, [0])


def random_poses(count: int, seed: int) -> list[Pose]:
    rng = np.random.default_rng(seed)
    lights = rng.choice([35.0, 45.0, 60.0, 75.0], size=count)
    cameras = rng.choice(np.arange(0.0, 78.0), size=count, replace=False)
    return [Pose(float(a), float(b)) for a, b in zip(lights, cameras, strict=True)]


def manual_settings(plan) -> int:
    """Number of different settings of light and tilt, which a person sets."""
    return len({(pose.light_deg, pose.light_azimuth_deg, pose.tilt_deg) for pose in plan.poses})


def some_observations(seed: int, count: int = 10):
    return observe(texel(), random_poses(count, seed), MaterialRange().spread(6), ObservationNoise())


def test_materials_fill_their_range_as_a_halton_sequence_does():
    unit = qmc.Halton(3, scramble=False).random(201)[1:]
    found, expected = MaterialRange().spread(200), MaterialRange().at(unit)
    np.testing.assert_allclose(found.parameters(), expected.parameters(), rtol=1e-14)


@pytest.mark.parametrize("patch", PATCHES)
@pytest.mark.parametrize("seed", range(4))
def test_the_choice_is_the_best_of_all_choices(patch, seed):
    seen = some_observations(seed)
    setting = np.zeros(10, dtype=int)
    selection = Selection(seen, PRIOR, setting, 1, patch)
    best = max(selection.value(list(design)) for design in itertools.combinations(range(10), 4))
    chosen = choose(seen, PRIOR, setting, 4, 1, patch)
    assert selection.value(chosen) == pytest.approx(best, abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_the_choice_within_two_settings_is_the_best_of_all_such(seed):
    poses = random_poses(10, seed)
    seen = observe(texel(), poses, MaterialRange().spread(6), ObservationNoise())
    setting = np.unique([pose.light_deg for pose in poses], return_inverse=True)[1]
    selection = Selection(seen, PRIOR, setting, 2)
    designs = [list(d) for d in itertools.combinations(range(10), 4) if len(set(setting[list(d)])) <= 2]
    chosen = choose(seen, PRIOR, setting, 4, 2)
    assert len(set(setting[chosen])) <= 2
    assert selection.value(chosen) == pytest.approx(max(map(selection.value, designs)), abs=1e-9)


def test_the_criterion_is_the_sum_of_the_relative_variances():
    seen = observe(texel(), POSES, MaterialRange().spread(8), ObservationNoise())
    chosen = [0, 3, 5, 9, 12, 16]
    fisher = information(seen.of(chosen)) + PRIOR * np.eye(3)
    value = -np.trace(np.linalg.inv(fisher), axis1=1, axis2=2).mean()
    for patch in PATCHES:  # of a single texel: nothing is shared
        selection = Selection(seen, PRIOR, np.zeros(len(POSES), dtype=int), 1, patch)
        assert selection.value(chosen) == pytest.approx(value, rel=1e-8)


def test_places_of_one_paint_share_their_gloss_and_each_has_its_own_colour():
    """Of four texels side by side the second pair is another paint, whose second texel is seen three times only."""
    seen, materials = observe(texel(), POSES, MaterialRange().spread(8), ObservationNoise()), 8
    variance = np.full((len(POSES), 4, materials), np.inf)
    for number, photographs in enumerate(([0, 3, 5, 9, 12], [2, 4, 8, 11, 14], range(0, 15, 2), [3, 5, 9])):
        variance[photographs, number] = seen.variance[list(photographs)]
    parts = Observations(*(np.concatenate([one] * 4, axis=1) for one in seen))
    parts = parts._replace(variance=variance.reshape(len(POSES), -1))
    patch, design, setting = np.array([0, 0, 1, 1]), list(range(len(POSES))), np.zeros(len(POSES), dtype=int)
    errors = shared_errors(parts, patch)
    known = parts._replace(weight=np.where(np.isfinite(parts.variance), 1.0 / parts.variance, 0.0))
    apart = standard_errors(known._replace(jacobian=np.where(known.weight[..., None] > 0.0, known.jacobian, 0.0)))
    by_texel, own = errors.reshape(4, materials, 3), apart.reshape(4, materials, 3)
    np.testing.assert_array_equal(by_texel[[0, 2], :, 1:], by_texel[[1, 3], :, 1:])
    assert (by_texel[:2, :, 1] < own[:2, :, 1].max(axis=0)).all()
    # Half of this patch tells nothing, which counts as half as much information.
    np.testing.assert_allclose(by_texel[2, :, 1:], math.sqrt(2.0) * own[2, :, 1:], rtol=1e-6)
    assert np.isinf(own[3]).all() and np.isfinite(by_texel[3]).all()
    selection = Selection(parts, 1e-9, setting, 1, patch)
    assert -selection.value(design) == pytest.approx((errors**2).sum(axis=1).mean(), rel=1e-4)


def test_materials_without_gloss_do_not_stop_the_choice():
    none = Materials(np.array([0.4, 0.4]), np.array([0.0, 3.0]), np.array([0.1, 0.1]))
    seen = observe(texel(), POSES, none, ObservationNoise())
    for patch in PATCHES:
        chosen = choose(seen, PRIOR, np.zeros(len(POSES), dtype=int), 5, 1, patch)
        assert len(set(chosen)) == 5
        assert math.isfinite(Selection(seen, PRIOR, np.zeros(len(POSES)), 1, patch).value(chosen))


limit = st.builds(
    lambda low, parts, step: {"min": low, "max": low + parts * step * 0.999, "step": step},
    st.floats(0.0, 40.0).map(lambda v: round(v, 1)),
    st.integers(0, 12),
    st.sampled_from([0.1, 0.5, 2.0, 4.5]),
)


@settings(max_examples=20, deadline=None)
@given(
    light=limit, camera=limit, tilt=limit, count=st.integers(4, 9), manual=st.integers(1, 3), clearance=st.floats(0, 30)
)
def test_a_plan_holds_only_poses_that_the_rig_can_take(light, camera, tilt, count, manual, clearance):
    limits = {
        "light_deg": light,
        "camera_deg": camera,
        "tilt_deg": tilt,
        "turn_deg": {"min": 0.0, "max": 0.0, "step": 1.0},
    }
    rig = RIG | {"limits": limits, "clearance_deg": clearance}
    coarse = {"light_deg": 10.0, "camera_deg": 5.0, "tilt_deg": 15.0, "turn_deg": 45.0}
    materials = MaterialRange(mu_rad=(0.1, 0.3))
    try:
        plan = plan_best(
            made(Object | PlannedObject, PLATE_OBJECT),
            made(Rig, rig),
            count,
            manual,
            coarse_deg=coarse,
            materials=materials,
        )
    except TooFewPoses:
        poses = candidate_poses(made(RigLimits, limits), coarse, clearance)
        if poses:
            told = observe(
                subject_of(made(Object | PlannedObject, PLATE_OBJECT), made(Rig, rig)),
                poses,
                materials.spread(40),
                ObservationNoise(),
            )
            useful = [
                (p.light_deg, p.tilt_deg) for p, v in zip(poses, told.variance, strict=True) if np.isfinite(v).any()
            ]
            sizes = sorted(useful.count(setting) for setting in set(useful))
            # Greedy settings may be smaller ones; with every setting too small no choice is left at all.
            assert len(sizes) == 0 or sizes[0] * manual < count or len(useful) < count
        return
    assert len(plan.poses) == count == len({pose.name for pose in plan.poses})
    assert manual_settings(plan) <= manual
    for pose in plan.poses:
        for axis, span in limits.items():
            angle = getattr(pose, axis)
            steps = (angle - span["min"]) / span["step"]
            assert span["min"] - 1e-6 <= angle <= span["max"] + 1e-6 and abs(steps - round(steps)) < 1e-5
        between = math.degrees(math.acos(min(1.0, to_light(pose) @ to_camera(pose))))
        assert between >= clearance - 1e-4
        # A corner of the plate is seen at up to 4 degrees less than its centre.
        assert pose.light_deg - pose.tilt_deg <= 80 + 1e-6 and pose.camera_deg + pose.tilt_deg <= 84


def test_a_camera_in_the_lights_way_is_no_candidate():
    limits = {
        "light_deg": {"min": 0.0, "max": 10.0, "step": 1.0},
        "camera_deg": {"min": -10.0, "max": 10.0, "step": 1.0},
        "tilt_deg": {"min": 0.0, "max": 0.0, "step": 1.0},
        "turn_deg": {"min": 0.0, "max": 0.0, "step": 1.0},
    }
    coarse = {"light_deg": 1.0, "camera_deg": 1.0, "tilt_deg": 1.0, "turn_deg": 1.0}
    poses = candidate_poses(made(RigLimits, limits), coarse, clearance_deg=5.0)
    # The camera stands on the other side, at minus its angle: they coincide where the angles sum to nothing.
    assert {(p.light_deg, p.camera_deg) for p in poses} == {
        (a, c) for a in range(11) for c in range(-10, 11) if abs(a + c) >= 5
    }


def test_a_lamp_beside_the_plane_stands_at_each_place_once_and_never_where_the_camera_is():
    coarse = {"light_deg": 35.0, "light_azimuth_deg": 90.0, "camera_deg": 35.0, "tilt_deg": 45.0, "turn_deg": 180.0}
    poses = candidate_poses(made(Rig, SIDEWAYS).limits, coarse, clearance_deg=5.0)
    assert len({pose.name for pose in poses}) == len(poses)
    assert {pose.light_azimuth_deg for pose in poses} == {-90.0, 0.0, 90.0, 180.0}
    # Opposite the lamp's plane stands the camera: where both have the same angle, it is in the way.
    assert not any(pose.light_azimuth_deg == 180.0 and pose.light_deg == pose.camera_deg for pose in poses)
    assert any(pose.light_azimuth_deg == 90.0 and pose.light_deg == pose.camera_deg for pose in poses)
    # A flat object is lit in the camera's plane, by a rig that can do so.
    plate = Plate(90.0, 90.0)
    assert {pose.light_azimuth_deg for pose in open_poses(plate, made(Rig, SIDEWAYS).limits)} == {0.0}
    aside = SIDEWAYS["limits"] | {"light_azimuth_deg": {"min": 90.0, "max": 135.0, "step": 0.5}}
    assert {pose.light_azimuth_deg for pose in open_poses(plate, made(RigLimits, aside))} == {90.0, 135.0}


def test_a_lamp_beside_the_plane_shows_the_lower_half_of_a_sphere():
    coarse = {"light_deg": 30.0, "light_azimuth_deg": 90.0, "camera_deg": 60.0, "tilt_deg": 45.0, "turn_deg": 90.0}
    seen = []
    for rig in (RIG, SIDEWAYS):
        own = {axis: step for axis, step in coarse.items() if axis in rig["limits"]}
        planner = Planner(made(Object | PlannedObject, SPHERE_OBJECT), made(Rig, rig), coarse_deg=own)
        plan = planner.best(12, max_manual=4)
        assert manual_settings(plan) <= 4 and len({pose.turn_deg for pose in plan.poses}) > 2
        assert plan.determined_fraction > 0.0
        seen.append(np.isfinite(observe(planner.subject, plan.poses, planner.sample, planner.noise).variance))
    in_plane, sideways = (found.any(axis=0).mean() for found in seen)
    # In one plane, opposite each other and with a table in between, lamp and camera never reach below the equator.
    assert in_plane < 0.55 and sideways > 0.75


def test_the_default_spheres_are_photographed_all_around_and_each_paint_at_its_highlight():
    loaded = load_definitions(read_yaml(ROOT / "config/config.yaml"), ROOT)
    rig, spheres = loaded.rigs["virtual"], [name for name in loaded.objects if name.endswith("-sphere")]
    assert len(spheres) == 3
    for name in spheres:
        definition = loaded.objects[name]
        shape, poses = Shape.from_definition(definition.shape), expand_poses(definition.poses)
        position, normal = shape.samples(600)
        subject = RigSubject(shape, position, normal, rig.camera_distance_mm, rig.table_radius_mm)
        angles = subject.geometry(poses)
        seen = (np.degrees(angles[..., :2]) <= 80.0).all(axis=-1) & subject.unobstructed(poses)
        assert len(poses) == 16 and seen.any(axis=0).mean() > 0.95
        # Six bands from pole to pole have the two paints in turn, each with its gloss.
        band = np.minimum(np.arccos(normal[:, 2]) * 6.0 / np.pi, 5.0).astype(int)
        first, second = definition.virtual.materials
        assert first.beta != second.beta and first.mu_rad != second.mu_rad
        for number, material in enumerate((first, second)):
            off = angles[..., 3][seen & (band % 2 == number)] / material.mu_rad
            assert (off < 0.7).sum() >= 3 and ((off > 0.7) & (off < 2.0)).sum() >= 10


def test_angles_of_an_axis_stay_on_its_steps_and_reach_no_further_than_asked():
    np.testing.assert_array_equal(
        axis_angles(made(AxisLimit, {"min": 35.0, "max": 41.0, "step": 0.5}), 2.0), [35, 37, 39, 41]
    )
    np.testing.assert_array_equal(
        axis_angles(made(AxisLimit, {"min": 0.0, "max": 0.3, "step": 0.1}), 0.1), [0, 0.1, 0.2, 0.3]
    )
    np.testing.assert_array_equal(
        axis_angles(made(AxisLimit, {"min": 0.0, "max": 20.0, "step": 7.5}), 2.0), [0, 7.5, 15]
    )
    np.testing.assert_array_equal(axis_angles(made(AxisLimit, {"min": 5.0, "max": 5.0, "step": 1.0}), 2.0), [5])


def test_more_poses_and_more_manual_settings_promise_no_worse_design():
    planner = Planner(made(Object | PlannedObject, PLATE_OBJECT), made(Rig, RIG))
    errors = {k: planner.best(k).expected for k in (6, 12, 24)}
    for name in ("alpha", "beta", "mu"):
        assert errors[24][name][0] < errors[12][name][0] < errors[6][name][0]
    one, three = (planner.best(8, max_manual=m) for m in (1, 3))
    assert manual_settings(one) == 1 and manual_settings(three) <= 3
    assert sum(v[0] ** 2 for v in three.expected.values()) <= sum(v[0] ** 2 for v in one.expected.values())


def test_an_object_of_two_lobes_is_planned_with_materials_of_either_and_wants_six_poses():
    definition = PLATE_OBJECT | {"lobes": ["ggx", "gaussian"]}
    planner = Planner(made(Object, definition), made(Rig, RIG))
    (first, of_first), (second, of_second) = planner.sample.of_lobes()
    assert (first, second) == ("ggx", "gaussian") and len(of_first) == len(of_second)
    # Either half of the materials fills the range.
    for part in (of_first, of_second):
        assert np.median(planner.sample.alpha[part]) == pytest.approx(0.46, abs=0.08)
    with pytest.raises(ValueError, match="accepted: 6 or more, for 5 parameters"):
        planner.best(5)


def test_the_materials_of_a_range_fill_it():
    chosen = MaterialRange(alpha=(0.1, 0.5), beta=(1.0, 4.0), mu_rad=(0.1, 0.2), n=1.4).spread(200)
    assert chosen.n == 1.4
    for values, low, high in ((chosen.alpha, 0.1, 0.5), (chosen.beta, 1, 4), (chosen.mu, 0.1, 0.2)):
        assert low <= values.min() < low * 1.1 and high * 0.9 < values.max() <= high
    assert np.median(chosen.beta) == pytest.approx(2.0, rel=0.03)


@pytest.mark.parametrize("span", [(0.0, 1.0), (2.0, 1.0), (-1.0, 1.0)])
def test_a_range_the_wrong_way_round_or_with_nothing_in_it_is_refused(span):
    with pytest.raises(ValueError, match=r"plan\.beta .*accepted: two numbers above 0"):
        MaterialRange(beta=span)


def test_impossible_counts_are_refused():
    planner = Planner(made(Object | PlannedObject, PLATE_OBJECT), made(Rig, RIG))
    with pytest.raises(ValueError, match="3 poses; accepted: 4 or more"):
        planner.best(3)
    with pytest.raises(ValueError, match="0 manual settings; accepted: 1 or more"):
        planner.best(6, max_manual=0)
    with pytest.raises(TooFewPoses, match="accepted: at most"):
        planner.best(100_000)
    with pytest.raises(ValueError, match="accepted: light_deg, camera_deg, tilt_deg, turn_deg"):
        Planner(made(Object | PlannedObject, PLATE_OBJECT), made(Rig, RIG), coarse_deg={"light_deg": 5.0})


def test_the_planner_reckons_with_the_weights_that_the_fit_has():
    plans = [
        Planner(made(Object | PlannedObject, PLATE_OBJECT), made(Rig, RIG), model_error=error).best(8)
        for error in (0.01, 1.0)
    ]
    # Weights for the error that there is promise more of the same poses.
    for name in ("beta", "mu"):
        assert plans[0].expected[name][0] < plans[1].expected[name][0]


@pytest.mark.parametrize("saturation", [1.5, 3.0])
def test_a_plan_of_few_poses_leaves_no_material_of_a_plate_with_three_unclipped_photographs(saturation):
    noise = ObservationNoise(saturation_response=saturation)
    plan = Planner(made(Object | PlannedObject, PLATE_OBJECT), made(Rig, RIG), noise=noise).best(4, max_manual=4)
    # By the information alone 73 and 88 % would be determined: three photographs promise more than none.
    assert plan.determined_fraction == 1.0


def test_what_counts_as_known_is_what_the_fit_states():
    assert KNOWN_RELATIVE_ERROR == judge.MAX_RELATIVE_ERROR


def test_the_noise_of_a_virtual_rig_has_its_imperfections_and_their_switches():
    faults = {
        "light_drift": {"enabled": False, "relative_rms": 0.02},
        "pose_error": {"enabled": True, "rms_deg": 0.2},
    }
    noise = default_noise(made(Rig, RIG | {"virtual": {"imperfections": faults}}))
    assert (noise.relative, noise.pose_rms_deg) == (0.0, 0.2)
    assert default_noise(made(Rig, RIG)) == ObservationNoise()
    assert default_noise(made(Rig, RIG), fit=Fit(model_error=0.03, pose_error_deg=0.1)) == ObservationNoise(
        relative=0.03, pose_rms_deg=0.1
    )


def test_a_plan_in_words_names_every_pose_and_expectation():
    plan = plan_best(made(Object | PlannedObject, PLATE_OBJECT), made(Rig, RIG), 6)
    text = "\n".join(plan.lines())
    assert all(f"{pose.camera_deg:g}" in text for pose in plan.poses)
    assert text.count("expected standard error") == 3 and text.count("light ") == manual_settings(plan)
