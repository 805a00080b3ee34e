"""Fisher information of poses: derivatives, noise, additivity, and what a fit really reaches."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import made
from plans import PLATE_OBJECT, POSES, RIG, SPHERE_OBJECT, flat_angles, texel
from shortcuts import information

from irodori.capture.shot_planner.fisher_information import (
    Materials,
    ObservationNoise,
    observe,
    standard_errors,
)
from irodori.capture.shot_planner.planner import subject_of
from irodori.config.capture_table import Pose
from irodori.config.models import Object, Rig, SensorOptions
from irodori.config.parts import PlannedObject
from irodori.fitting.solvers import FitOptions, fit
from irodori.material.material_file import Status
from irodori.reflection.equation5 import reflect
from irodori.reflection.gaussian import ROUGHNESS
from irodori.reflection.registry import names

SHOT = ObservationNoise(read_variance=6e-8, shot_variance=4e-5, relative=0.0, pose_rms_deg=0.0)


def one(alpha, beta, mu, n=1.5, k=0.0, lobe="gaussian") -> Materials:
    return Materials(np.array([alpha]), np.array([beta]), np.array([mu]), n, k, (lobe,))


def plain(parameters) -> tuple:
    """Return α, S, β, μ of a white material."""
    alpha, beta, mu = parameters
    return alpha, 1.0, beta, mu


materials = st.builds(
    one,
    st.floats(0.01, 1.5),
    st.floats(0.01, 50.0),
    st.floats(ROUGHNESS.low, ROUGHNESS.high),
    st.sampled_from([1.3, 1.5, 0.2]),
    st.sampled_from([0.0, 3.2]),
    st.sampled_from(names()),
)
poses = st.builds(Pose, st.floats(0.0, 75.0), st.floats(0.0, 75.0))


@settings(max_examples=60, deadline=None)
@given(materials, poses)
def test_the_jacobian_is_the_derivative_of_the_response_by_the_logarithms(material, pose):
    geometry, step = flat_angles([pose]), 1e-5
    seen = observe(texel(), [pose], material, SHOT)
    truth = material.parameters()[0]
    for index in range(3):
        factor = np.where(np.arange(3) == index, np.exp(step), 1.0)
        high, low = truth * factor, truth / factor
        kind = {"n": material.n, "k": material.k, "lobe": material.lobes[0]}
        numeric = [reflect(*plain(p), geometry, **kind)[0] for p in (high, low)]
        slope = (numeric[0] - numeric[1]) / (2 * step)
        # The third derivative is at most some (2 φ²/μ²)³ of the lobe, the rounding 1e-16 / step of the response.
        ratio = 1.0 + 2.0 * (geometry[0, 3] / truth[2]) ** 2
        lobe = abs(seen.jacobian[0, 0, 1])
        tolerance = step**2 * ratio**3 * lobe + 1e-10 * seen.response[0, 0] + 1e-15
        assert abs(seen.jacobian[0, 0, index] - slope) <= tolerance


def test_materials_of_two_lobes_are_seen_as_each_alone():
    poses = [Pose(45.0, 35.0), Pose(45.0, 50.0), Pose(30.0, 10.0)]
    both = Materials(np.array([0.2, 0.4]), np.array([3.0, 2.0]), np.array([0.1, 0.2]), lobes=("gaussian", "ggx"))
    found = observe(texel(), poses, both, ObservationNoise())
    for case, name in enumerate(both.lobes):
        alone = one(both.alpha[case], both.beta[case], both.mu[case], lobe=name)
        seen = observe(texel(), poses, alone, ObservationNoise())
        np.testing.assert_array_equal(found.jacobian[:, case], seen.jacobian[:, 0])
        np.testing.assert_array_equal(found.variance[:, case], seen.variance[:, 0])
        expected = reflect(alone.alpha, 1.0, alone.beta, alone.mu, flat_angles(poses), lobe=name)
        np.testing.assert_allclose(seen.response[:, 0], expected, rtol=1e-12)


def test_a_pose_error_adds_the_squared_slope_times_its_variance():
    material, pose, rms = one(0.4, 3.0, 0.15), Pose(45.0, 35.0), 0.05
    noise = replace(SHOT, pose_rms_deg=rms)
    extra = observe(texel(), [pose], material, noise).variance - observe(texel(), [pose], material, SHOT).variance

    def rho(light, camera):
        return reflect(0.4, 1.0, 3.0, 0.15, flat_angles([Pose(light, camera)]))[0]

    slopes = [rho(45.01, 35.0) - rho(44.99, 35.0), rho(45.0, 35.01) - rho(45.0, 34.99)]
    expected = sum((slope / 0.02 * rms) ** 2 for slope in slopes)
    assert extra[0, 0] == pytest.approx(expected, rel=1e-3)


def test_the_top_of_a_narrow_lobe_is_less_certain_than_its_slope_says():
    material, noise = one(0.3, 3.0, 0.005), replace(SHOT, pose_rms_deg=0.05)
    top, still = (observe(texel(), [Pose(45.0, 45.0)], material, n).variance[0, 0] for n in (noise, SHOT))
    assert top > 1.05 * still


def test_the_steeper_the_flank_the_more_a_pose_error_takes_away():
    kept = []
    for mu in (0.3, 0.15, 0.08, 0.04):
        flank = Pose(45.0, 45.0 - 2 * np.degrees(mu))  # φ = μ
        sure, unsure = (
            information(observe(texel(), [flank], one(0.4, 3.0, mu), replace(SHOT, pose_rms_deg=rms)))[0, 2, 2]
            for rms in (0.0, 0.2)
        )
        kept.append(unsure / sure)
    assert (np.diff(kept) < 0).all() and kept[0] > 0.5 and kept[-1] < 0.2


def test_information_adds_and_never_falls():
    subject = subject_of(made(Object | PlannedObject, PLATE_OBJECT), made(Rig, RIG))
    few, many = POSES[:6], POSES
    material = Materials(np.array([0.1, 0.7]), np.array([1.0, 6.0]), np.array([0.08, 0.25]))
    whole = information(observe(subject, many, material, ObservationNoise()))
    parts = [information(observe(subject, group, material, ObservationNoise())) for group in (few, many[6:])]
    np.testing.assert_allclose(whole, parts[0] + parts[1], rtol=1e-12)
    assert (np.linalg.eigvalsh(whole - parts[0]) >= -1e-9 * np.abs(whole).max()).all()


@settings(max_examples=30, deadline=None)
@given(st.floats(1e-3, 1e3))
def test_another_unit_of_light_leaves_the_information_as_it_is(unit):
    noise = ObservationNoise()
    scaled = replace(noise, read_variance=noise.read_variance * unit**2, shot_variance=noise.shot_variance * unit)
    first = information(observe(texel(), POSES, one(0.4, 3.0, 0.15), noise))
    second = information(observe(texel(), POSES, one(0.4 * unit, 3.0 * unit, 0.15), scaled))
    np.testing.assert_allclose(first, second, rtol=1e-9)


@pytest.mark.parametrize("material", [one(0.4, 3.0, 0.12), one(0.05, 1.5, 0.25), one(0.7, 5.0, 0.09)])
def test_expected_errors_are_the_scatter_of_fits_under_shot_and_read_noise(material):
    repeats = 4000
    rng = np.random.default_rng(7)
    geometry = flat_angles(POSES)
    alpha, beta, mu = material.parameters()[0]
    mean = reflect(alpha, 1.0, beta, mu, geometry)
    response = rng.poisson(mean / SHOT.shot_variance, size=(repeats, len(POSES))) * SHOT.shot_variance
    response = (response + rng.normal(scale=np.sqrt(SHOT.read_variance), size=response.shape)).astype(np.float32)
    camera = np.tile([SHOT.read_variance, SHOT.shot_variance], (len(POSES), 1))
    result = fit(response, geometry, np.ones_like(response), noise=camera)
    assert (result.status == Status.OK).all()
    scatter = [result.alpha.std() / alpha, result.beta.std() / beta, result.mu.std() / mu]
    seen = observe(texel(), POSES, material, SHOT, model_error=FitOptions().model_error)
    # The standard deviation of 4000 values is itself known to 1.1 %.
    np.testing.assert_allclose(standard_errors(seen)[0], scatter, rtol=0.05)


@pytest.mark.parametrize("material", [one(0.4, 3.0, 0.12), one(0.05, 1.5, 0.25), one(0.7, 5.0, 0.09)])
def test_expected_errors_are_those_that_the_fit_states(material):
    options, noise = (
        FitOptions(model_error=0.02, pose_error_deg=0.08),
        ObservationNoise(3e-6, 8e-5, 0.02, 0.08),
    )
    geometry, truth = flat_angles(POSES), material.parameters()[0]
    response = reflect(truth[0], 1.0, truth[1], truth[2], geometry)[None].astype(np.float32)
    camera = np.tile([noise.read_variance, noise.shot_variance], (len(POSES), 1))
    result = fit(response, geometry, np.ones_like(response), options=options, noise=camera)
    stated = np.array([result.alpha_error, result.beta_error, result.mu_error])[:, 0] / truth
    stated[:2] = np.sqrt(stated[:2] ** 2 - options.level_error**2)  # what all photographs share
    seen = observe(texel(), POSES, material, noise, model_error=options.model_error)
    # The fit knows a pose error by the slope along φ alone; F and G, and the curvature at the top, are left.
    np.testing.assert_allclose(standard_errors(seen)[0], stated, rtol=0.05)


@pytest.mark.parametrize("model_error", [0.0, 0.01, 1.0])
def test_no_weights_reach_more_than_the_information_allows(model_error):
    subject = subject_of(made(Object | PlannedObject, PLATE_OBJECT), made(Rig, RIG))
    material = Materials(np.array([0.1, 0.7]), np.array([1.0, 6.0]), np.array([0.08, 0.25]))
    seen = observe(subject, POSES, material, ObservationNoise(), model_error=model_error)
    bound = np.sqrt(np.einsum("cii->ci", np.linalg.inv(information(seen))))
    assert (standard_errors(seen) >= bound * (1 - 1e-9)).all()


def test_weights_of_the_fit_reach_the_information_where_they_are_the_inverse_variances():
    subject, noise = (
        subject_of(made(Object | PlannedObject, PLATE_OBJECT), made(Rig, RIG)),
        replace(ObservationNoise(), pose_rms_deg=0.0),
    )
    material = Materials(np.array([0.1, 0.7]), np.array([1.0, 6.0]), np.array([0.08, 0.25]))
    seen = observe(subject, POSES, material, noise, model_error=noise.relative)
    bound = np.sqrt(np.einsum("cii->ci", np.linalg.inv(information(seen))))
    np.testing.assert_allclose(standard_errors(seen), bound, rtol=1e-9)


@pytest.mark.parametrize("mu", [ROUGHNESS.low, ROUGHNESS.high])
@pytest.mark.parametrize(("alpha", "beta"), [(0.4, 0.0), (0.0, 3.0), (0.0, 0.0), (0.4, 3.0)])
def test_what_a_material_lacks_is_undetermined_and_nothing_overflows(alpha, beta, mu):
    seen = observe(texel(), POSES, one(alpha, beta, mu), ObservationNoise())
    assert np.isfinite(seen.jacobian).all() and np.isfinite(seen.scaled()).all()
    assert (information(seen)[0, 1:] == 0.0).all() == (beta == 0.0)
    errors = standard_errors(seen)
    assert not np.isnan(errors).any()
    if alpha == 0.0 or beta == 0.0:
        assert np.isinf(errors).all()


def test_three_observations_determine_nothing():
    assert np.isinf(standard_errors(observe(texel(), POSES[2:5], one(0.4, 3.0, 0.12), ObservationNoise()))).all()
    assert np.isfinite(standard_errors(observe(texel(), POSES[1:5], one(0.4, 3.0, 0.12), ObservationNoise()))).all()


def test_beyond_the_largest_angle_and_from_saturation_on_nothing_is_told():
    grazing = [Pose(45.0, 81.0), Pose(85.0, 20.0), Pose(100.0, 20.0), Pose(45.0, 120.0)]
    seen = observe(texel(), [*grazing, Pose(45.0, 79.0)], one(0.4, 3.0, 0.12), ObservationNoise(), max_angle_deg=80.0)
    assert np.isinf(seen.variance[:4]).all() and (seen.jacobian[:4] == 0.0).all()
    assert np.isfinite(seen.variance[4]).all()
    bright = observe(texel(), [Pose(45.0, 45.0)], one(0.4, 3.0, 0.12), ObservationNoise())
    limit = float(bright.response[0, 0])
    for saturation, told in ((limit * 0.99, False), (limit * 1.01, True)):
        seen = observe(
            texel(), [Pose(45.0, 45.0)], one(0.4, 3.0, 0.12), ObservationNoise(saturation_response=saturation)
        )
        assert np.isfinite(seen.variance).all() == told


def test_the_table_hides_a_spheres_underside_and_a_turn_shows_its_other_side():
    subject = subject_of(made(Object | PlannedObject, SPHERE_OBJECT), made(Rig, RIG))
    seen = np.isfinite(
        observe(
            subject, [Pose(45.0, 10.0), Pose(45.0, 10.0, 0.0, 180.0)], one(0.4, 3.0, 0.1), ObservationNoise()
        ).variance
    )
    up = subject.normal[:, 2]
    assert not seen[:, up < -0.5].any() and seen[:, up > 0.95].all()
    # A half turn moves x to -x: what the one pose shows on one side, the other shows on the other.
    assert (subject.normal[seen[0], 0].mean() > 0.1) and (subject.normal[seen[1], 0].mean() < -0.1)


def test_the_noise_of_a_sensor_is_that_of_its_electrons():
    sensor = {"full_well_e": 40000.0, "read_noise_e": 6.0, "response_at_full_well": 1.6, "base_exposure_s": 0.02}
    noise = ObservationNoise.of_sensor(made(SensorOptions, sensor), relative=0.0)
    # 25 000 electrons at a response of 1.
    assert noise.shot_variance == pytest.approx(1 / 25000) and noise.read_variance == pytest.approx((6 / 25000) ** 2)
    assert noise.saturation_response == pytest.approx(1.6) and noise.relative == 0.0
    bracket = ObservationNoise.of_sensor(made(SensorOptions, sensor), [0.002, 0.02, 0.04])
    assert bracket.shot_variance == pytest.approx(1 / 50000) and bracket.saturation_response == pytest.approx(16.0)
