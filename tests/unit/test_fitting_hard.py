"""The fit on hard cases: each with the outcome that is expected of it."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from test_fitting import GEOMETRY, K, N, gloss_over_beta, materials, model, run

from irodori.fitting import solvers
from irodori.fitting.judge import BOTH, DIFFUSE_ALONE, GLOSS_ALONE
from irodori.fitting.solvers import FitOptions, fit
from irodori.material.material_file import Status

CAMERA = np.tile([4e-6, 8e-5], (len(GEOMETRY), 1))  # c0 and c1 of a camera of moderate noise
FREE = {"alpha": (0.0, 2.0), "beta": (0.0, 1e4), "mu_rad": (0.005, 1.2)}


def in_plane(incidence_deg, view_deg) -> np.ndarray:
    """Angles of poses in one plane, light and camera on opposite sides of the normal, (J, 4) rad."""
    i, v = np.broadcast_arrays(np.radians(incidence_deg), np.radians(view_deg))
    return np.stack([np.abs(i), np.abs(v), np.abs(i + v) / 2, np.abs(i - v) / 2], axis=-1)


def brute_force(response, geometry, weight, mus) -> np.ndarray:
    """Least weighted sum of squares over α, β >= 0 on a dense grid of μ, (texels,)."""
    c, root = np.cos(geometry[:, 0]), np.sqrt(weight)
    out = np.full(len(response), np.inf)
    for mu in mus:
        g = gloss_over_beta(geometry, mu)
        a = root[:, None] * np.stack([c, g], axis=1)
        for columns in ([0, 1], [0], [1]):
            solution, *_ = np.linalg.lstsq(a[:, columns], root[:, None] * response.T, rcond=None)
            squares = np.sum((a[:, columns] @ solution - root[:, None] * response.T) ** 2, axis=0)
            out = np.where((solution >= 0).all(axis=0), np.minimum(out, squares), out)
    return out


def stated(result) -> np.ndarray:
    return result.status == Status.OK


def assert_sound(result, bounds=FREE, stating=(Status.OK, Status.DIFFUSE_ONLY, Status.DARK, Status.AT_BOUND)):
    """Finite or flagged, and within bounds; of some statuses α is always stated."""
    for name, (low, high) in zip(("alpha", "beta", "mu"), bounds.values(), strict=True):
        values = getattr(result, name)
        known = np.isfinite(values)
        assert ((values[known] >= low * (1 - 1e-12)) & (values[known] <= high * (1 + 1e-12))).all()
    for name in ("beta", "mu", "beta_error", "mu_error"):
        denied = (result.status == Status.CONTRADICTED) & (result.model >= GLOSS_ALONE)
        assert np.array_equal(np.isfinite(getattr(result, name)), stated(result) | denied)
    assert np.isfinite(result.alpha[np.isin(result.status, stating)]).all()
    # What is open says so in full.
    assert not np.isfinite(result.alpha_error[np.isnan(result.alpha)]).any()
    assert not np.isinf(np.concatenate([result.alpha, result.alpha_error, result.residual_rms])).any()


@pytest.mark.default_cases(2)
@pytest.mark.stability(stage="fit", case="1 % noise", noise=0.01)
@pytest.mark.stability(stage="fit", case="5 % noise", noise=0.05)
@pytest.mark.parametrize("noise", [0.01, 0.05])
@pytest.mark.parametrize("glossy", [True, False])
def test_no_dense_scan_beats_variable_projection(noise, glossy):
    rng = np.random.default_rng(1)
    if glossy:
        alpha, beta, mu = materials(400, seed=21)
    else:
        alpha, beta, mu = rng.uniform(0, 1, 400), 10 ** rng.uniform(-2, 2, 400), 10 ** rng.uniform(-2.3, 0.08, 400)
    truth = model(alpha, beta, mu)
    response = truth * (1 + noise * rng.normal(size=truth.shape)) + 0.1 * noise * rng.normal(size=truth.shape)
    result = run(response)
    both = (result.model == 3) & (result.gloss[:, 0] < 9e3)
    fitted = model(result.alpha, *result.gloss.T)
    squares = np.sum((fitted - response) ** 2, axis=1)
    best = brute_force(response, GEOMETRY, np.ones(len(GEOMETRY)), np.geomspace(0.005, 1.2, 1500))
    assert both.sum() > 200
    assert (squares[both] <= best[both] * 1.001).mean() >= 0.999


def test_one_geometry_for_all_gives_what_a_geometry_each_gives():
    alpha, beta, mu = materials(300, seed=22)
    rng = np.random.default_rng(220)
    response = model(alpha, beta, mu) * (1 + 0.01 * rng.normal(size=(300, len(GEOMETRY))))
    weight = (rng.random(response.shape) < 0.8).astype(float)
    weight[::3] = 1.0
    for noise in (None, CAMERA):
        shared = fit(response, GEOMETRY, weight, N, K, noise=noise)
        own = fit(response, np.tile(GEOMETRY, (300, 1, 1)), weight, N, K, noise=noise)
        assert np.array_equal(shared.status, own.status)
        for name in ("alpha", "beta", "mu", "beta_error", "residual_rms"):
            np.testing.assert_allclose(getattr(shared, name), getattr(own, name), rtol=1e-4, equal_nan=True)


@pytest.mark.stability(stage="fit", case="grazing views")
def test_grazing_views_are_fitted():
    geometry = in_plane([45, 60, 70, 75, 78, 80, 79, 60, 40, 20], [79, 75, 78, 79, 79.9, 79.9, 70, 60, 30, 0])
    alpha, beta, mu = np.array([0.2, 0.5]), np.array([1.0, 0.5]), np.array([0.15, 0.3])
    result = run(model(alpha, beta, mu, geometry), geometry)
    assert stated(result).all()
    np.testing.assert_allclose(result.mu, mu, rtol=1e-4)
    np.testing.assert_allclose(result.beta, beta, rtol=1e-4)


@pytest.mark.stability(stage="fit", case="back-lit observations")
def test_back_lit_observations_count_as_dark_and_do_no_harm():
    back = in_plane([95, 110, 125], [10, 20, 30])
    alpha, beta, mu = materials(50, seed=23)
    response = np.concatenate([model(alpha, beta, mu), np.zeros((50, 3))], axis=1)
    geometry = np.concatenate([GEOMETRY, back])
    weight = np.concatenate([np.ones(len(GEOMETRY)), np.zeros(3)])
    result = run(response, geometry, weight)
    assert stated(result).all()
    np.testing.assert_allclose(result.mu, mu, rtol=1e-4)
    assert_sound(run(response, geometry))  # even with weight


@pytest.mark.parametrize("n", [1.0, 1.5])
def test_light_and_eye_below_the_surface_at_an_index_of_one_tell_nothing(n):
    """Angles of 1.6 rad, all alike: index 1 and a facet that turns away once made infinity times nothing."""
    result = run(np.zeros((9, len(GEOMETRY))), np.full((9, len(GEOMETRY), 4), 1.6), n=n)
    assert (result.status == Status.TOO_FEW_OBSERVATIONS).all()
    assert np.isnan(result.alpha).all() and np.isnan(result.beta).all()


@pytest.mark.stability(stage="fit", case="back-lit observations")
@pytest.mark.parametrize("lit", [0, 3])
def test_geometries_that_carry_no_light_are_none_to_fit_by(lit):
    """However many they are: three that are lit, besides, stay three."""
    geometry = in_plane(np.linspace(95.0, 120.0, len(GEOMETRY)), np.linspace(30.0, 60.0, len(GEOMETRY)))
    geometry[:lit] = in_plane(np.linspace(10.0, 40.0, lit), 20.0)
    response = np.where(np.arange(len(GEOMETRY)) < lit, 0.3, 0.0)
    for own in (geometry, np.tile(geometry, (9, 1, 1))):
        result = run(np.tile(response, (9, 1)), own)
        assert (result.status == Status.TOO_FEW_OBSERVATIONS).all() and np.isnan(result.alpha).all()


@pytest.mark.stability(stage="fit", case="μ from 0.005 to 1.2")
def test_roughness_over_its_whole_range_is_recovered_or_flagged():
    off = np.geomspace(0.05, 20, 16)
    camera = np.concatenate([np.linspace(0, 75, 16), 40 + off, 40 - off])
    geometry = in_plane(40.0, camera)
    mu = np.geomspace(0.0055, 1.15, 40)
    result = run(model(0.3, 3.0, mu, geometry), geometry)
    assert_sound(result)
    known = stated(result)
    assert known[(mu > 0.006) & (mu < 0.5)].all()
    np.testing.assert_allclose(result.mu[known], mu[known], rtol=1e-4)


@pytest.mark.stability(stage="fit", case="α = 0")
def test_no_diffuse_light_is_gloss_alone():
    _, beta, mu = materials(60, seed=24)
    rng = np.random.default_rng(240)
    truth = model(0.0, beta, mu)
    result = run(truth + 0.002 * truth.max(axis=1, keepdims=True) * rng.normal(size=truth.shape))
    assert (result.model == 2).mean() > 0.9 and stated(result).mean() > 0.9
    assert (result.alpha[result.model == 2] == 0).all()
    known = stated(result)
    assert np.median(np.abs(result.mu / mu - 1)[known]) < 0.01


@pytest.mark.stability(stage="fit", case="all observations at one geometry")
@pytest.mark.stability(stage="fit", case="48 observations at one geometry", distinct=1, times=48)
@pytest.mark.parametrize(("distinct", "times"), [(1, 4), (1, 48), (2, 4), (3, 4)])
def test_a_repeated_geometry_determines_no_more_than_once(distinct, times):
    geometry = np.tile(in_plane([45.0, 30.0, 60.0], [40.0, 20.0, 58.0])[:distinct], (times, 1))
    rng = np.random.default_rng(2)
    result = run(model(0.3, 4.0, 0.1, geometry) * (1 + 0.01 * rng.normal(size=(20, len(geometry)))), geometry)
    assert (result.status == Status.TOO_FEW_OBSERVATIONS).all()
    assert np.isnan([result.alpha, result.beta, result.mu]).all()


def test_gloss_alone_is_not_chosen_where_the_data_cannot_tell_it_from_diffuse_light():
    rng = np.random.default_rng(20)
    alpha, beta, mu = materials(2000, seed=200)
    geometry = in_plane([20.0, 35.0, 50.0, 65.0], [10.0, 40.0, 45.0, 70.0])
    result = run(model(alpha, beta, mu, geometry) * (1 + 0.01 * rng.normal(size=(2000, 4))), geometry)
    wrong = stated(result) & (result.alpha == 0)
    assert wrong.mean() < 0.001


@pytest.mark.stability(stage="fit", case="zeros", value=0.0)
@pytest.mark.stability(stage="fit", case="negative after dark subtraction", value=-0.003)
@pytest.mark.parametrize("value", [0.0, -0.003])
def test_no_light_is_dark(value):
    result = run(np.full((3, len(GEOMETRY)), value))
    assert (result.status == Status.DARK).all() and (result.alpha == 0).all()


def test_noise_around_nothing_is_dark_and_never_gloss():
    rng = np.random.default_rng(3)
    result = fit(1e-3 * rng.normal(size=(500, len(GEOMETRY))), GEOMETRY, np.ones((500, len(GEOMETRY))), N, K,
                 noise=np.tile([1e-6, 0.0], (len(GEOMETRY), 1)))  # fmt: skip
    assert (result.status == Status.DARK).mean() > 0.85
    assert stated(result).mean() < 0.01
    assert_sound(result)


@pytest.mark.stability(stage="fit", case="negative after dark subtraction")
def test_negative_values_after_dark_subtraction_bias_nothing():
    rng = np.random.default_rng(4)
    truth = np.broadcast_to(model(0.004, 0.0, 0.1), (2000, len(GEOMETRY)))
    result = run(truth + 0.004 * rng.normal(size=truth.shape))
    assert_sound(result)
    assert result.alpha.mean() == pytest.approx(0.004, rel=0.05)


def clip(alpha, beta, mu, level):
    """Responses and what of them clips."""
    response = model(alpha, beta, mu)
    return np.minimum(response, level), response > level


@pytest.mark.stability(stage="fit", case="saturated peaks")
def test_a_highlight_that_clips_is_saturated():
    response, clipped = clip(0.3, np.array([20.0, 30.0]), 0.08, 0.5)
    assert clipped.any(axis=1).all()
    result = fit(response, GEOMETRY, (~clipped).astype(float), N, K, clipped=clipped)
    assert (result.status == Status.SATURATED).all()
    assert np.isnan(result.mu).all() and np.abs(result.alpha - 0.3).max() < 0.02
    assert_sound(result)


def beside_a_clipped_highlight(count, seed, solver):
    """True α and the fit of five photographs 25 degrees beside the mirror direction, and three in it, which clip."""
    rng = np.random.default_rng(seed)
    light, view = np.radians([[45.0] * 8, [20.0] * 5 + [45.0] * 3])[:, None] + np.radians(
        rng.uniform(-1.0, 1.0, (2, count, 8))
    )
    geometry = np.stack([light, view, (light + view) / 2, np.abs(light - view) / 2], axis=-1)
    alpha, mu = np.exp(rng.uniform(np.log([[0.03], [0.05]]), np.log([[0.8], [0.4]]), (2, count)))
    truth = model(alpha, rng.uniform(0.05, 0.5, count) / (4.0 * mu**2), mu, geometry)
    response = truth * (1.0 + 0.01 * rng.normal(size=truth.shape))
    clipped = response > 1.3 * alpha[:, None]
    noise = np.tile([1e-7, 2e-5], (8, 1))
    options = FitOptions(solver=solver, level_error=0.0)
    return alpha, fit(response, geometry, (~clipped).astype(float), N, K, options, noise=noise, clipped=clipped)


@pytest.mark.stability(stage="fit", case="saturated peaks")
@pytest.mark.parametrize("solver", ["varpro", "nlopt"])
def test_gloss_beside_a_highlight_that_clips_is_in_the_error_of_alpha(solver):
    alpha, result = beside_a_clipped_highlight(300, 6, solver)
    hidden = (result.status == Status.SATURATED) & (result.model == DIFFUSE_ALONE)
    off = np.abs(result.alpha - alpha)[hidden]
    assert hidden.sum() > 50 and (off <= 2.0 * result.alpha_error[hidden]).mean() > 0.95
    assert np.quantile(off / alpha[hidden], 0.9) > 0.1  # so that the error has something to contain


@pytest.mark.stability(stage="fit", case="saturated peaks")
@pytest.mark.parametrize("solver", ["varpro", "nlopt"])
@pytest.mark.parametrize("status", [Status.SATURATED, Status.MU_UNIDENTIFIABLE])
def test_lobes_of_other_widths_are_in_the_error_of_alpha(solver, status):
    """Gloss fitted to readings that lie within one degree of one another: many lobes explain them."""
    alpha, result = beside_a_clipped_highlight(2400, 60, solver)
    open_ = (result.status == status) & (result.model == BOTH)
    off = np.abs(result.alpha - alpha)[open_]
    assert open_.sum() > 200 and (off <= 2.0 * result.alpha_error[open_]).mean() > 0.95
    # What is stated tells something: no more than α itself.
    assert np.median(result.alpha_error[open_] / alpha[open_]) < 1.0


@pytest.mark.stability(stage="fit", case="saturated peaks")
def test_one_clipped_observation_among_many_in_the_highlight_is_not_missed():
    response, clipped = clip(0.3, 4.0, 0.2, np.sort(model(0.3, 4.0, 0.2))[-2] * 1.0001)
    assert clipped.sum() == 1
    result = fit(response[None], GEOMETRY, (~clipped).astype(float)[None], N, K, clipped=clipped[None])
    assert stated(result).all() and result.mu == pytest.approx(0.2, rel=1e-4)


@pytest.mark.stability(stage="fit", case="saturated peaks")
def test_a_texel_that_clips_in_almost_every_picture_is_saturated():
    clipped = np.ones((1, len(GEOMETRY)), dtype=bool)
    clipped[0, :2] = False
    result = fit(np.ones(clipped.shape), GEOMETRY, (~clipped).astype(float), N, K, clipped=clipped)
    assert result.status == Status.SATURATED and np.isnan(result.alpha).all()


@pytest.mark.stability(stage="fit", case="amplitude × 1e-6 and × 1e6")
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("noise", [CAMERA, None], ids=["noise known", "equal weights"])
def test_amplitude_changes_no_decision(scale, noise, monkeypatch):
    alpha, beta, mu = materials(60, seed=25)
    beta[::4] = 0.0
    rng = np.random.default_rng(250)
    response = model(alpha, beta, mu) * (1 + 0.01 * rng.normal(size=(60, len(GEOMETRY))))
    bounds = {"alpha": (0.0, 2.0 * scale), "beta": (0.0, 1e4 * scale)}
    one = fit(response, GEOMETRY, np.ones(response.shape), N, K, noise=noise)
    camera = None if noise is None else noise * [scale**2, scale]
    # The most gloss that a matt texel may hide is what a smooth surface reflects, here in the same unit.
    most = solvers._most_beta
    monkeypatch.setattr(solvers, "_most_beta", lambda *surface: scale * most(*surface))
    many = fit(scale * response, GEOMETRY, np.ones(response.shape), N, K,
               FitOptions(bounds=bounds), noise=camera)  # fmt: skip
    assert np.array_equal(one.status, many.status)
    np.testing.assert_allclose(many.mu, one.mu, rtol=1e-6, equal_nan=True)
    np.testing.assert_allclose(many.alpha_error, scale * one.alpha_error, rtol=1e-5, equal_nan=True)
    assert (one.status == Status.DIFFUSE_ONLY).any()


@pytest.mark.parametrize("observations", [5, 8])
def test_two_lobes_with_a_valley_between_two_nodes_are_searched(observations):
    rng = np.random.default_rng(observations)
    light = rng.uniform(20.0, 60.0, observations)
    geometry = in_plane(light, light - rng.uniform(-20.0, 20.0, observations))
    first, second = materials(800, seed=28), materials(800, seed=29)
    response = model(*first, geometry) + 0.3 * model(*second, geometry)
    result = run(response, geometry)
    whole = (result.model == 3) & (result.gloss[:, 0] < 9e3) & np.isfinite(result.alpha)
    squares = np.sum((model(result.alpha, *result.gloss.T, geometry) - response) ** 2, axis=1)
    best = brute_force(response, geometry, np.ones(observations), np.geomspace(0.005, 1.2, 1500))
    assert whole.sum() > 100
    floor = 1e-12 * np.sum(response**2, axis=1)
    assert (squares <= 1.001 * best + floor)[whole].mean() >= 0.999


@pytest.mark.stability(stage="fit", case="1 % noise", noise=0.01)
@pytest.mark.stability(stage="fit", case="5 % noise", noise=0.05)
@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_prediction_at_held_out_angles_is_as_good_as_the_noise(noise):
    held = in_plane([35, 50, 55, 65, 45, 30], [20, 40, 58, 60, 60, 45])
    many = np.concatenate([GEOMETRY, in_plane(np.linspace(30, 70, 31), np.linspace(60, 35, 31))])
    alpha, beta, mu = materials(500, seed=27)
    rng = np.random.default_rng(270)
    clean = model(alpha, beta, mu, many)
    result = run(clean * (1 + noise * rng.normal(size=clean.shape)), many)
    predicted = model(result.alpha, *result.gloss.T, held)
    truth = model(alpha, beta, mu, held)
    measured = truth * (1 + noise * rng.normal(size=truth.shape))
    assert np.std(predicted - measured) <= 1.1 * np.std(truth - measured)


def photographed(count, rng, common=0.7):
    """Materials and their responses under pose errors of 0.05° and a light that drifts by 1 %."""
    alpha, mu = rng.uniform(0.05, 0.9, count), np.exp(rng.uniform(np.log(0.04), np.log(0.25), count))
    beta = 10 ** rng.uniform(-0.2, 0.9, count)
    shape = (count, len(GEOMETRY))
    off = np.degrees(GEOMETRY[:, :2]) + 0.05 * rng.normal(size=(*shape, 2))
    y = model(alpha, beta, mu, in_plane(off[..., 0], off[..., 1]))
    drift = common * rng.normal(size=(count, 1)) + np.sqrt(1 - common**2) * rng.normal(size=shape)
    y = y * (1 + 0.01 * drift)
    return alpha, beta, mu, y + np.sqrt(CAMERA[:, 0] + CAMERA[:, 1] * y) * rng.normal(size=shape)


@pytest.mark.parametrize("noise", [CAMERA, None], ids=["noise known", "equal weights"])
def test_two_standard_errors_hold_for_nine_texels_in_ten(noise):
    alpha, beta, mu, response = photographed(3000, np.random.default_rng(5))
    result = fit(response, GEOMETRY, np.ones(response.shape), N, K, noise=noise)
    known = stated(result)
    assert known.mean() > 0.95
    for name, truth in (("alpha", alpha), ("beta", beta), ("mu", mu)):
        deviation = np.abs(getattr(result, name) - truth)[known] / getattr(result, f"{name}_error")[known]
        assert (deviation < 2).mean() >= 0.9
        assert np.median(deviation) > 0.1  # not simply huge


def test_inverse_variance_is_better_than_equal_weights():
    _alpha, _beta, mu, response = photographed(3000, np.random.default_rng(6))
    weight = np.ones(response.shape)
    fits = [fit(response, GEOMETRY, weight, N, K, noise=noise) for noise in (CAMERA, None)]
    error = [np.nanmedian(np.abs(f.mu / mu - 1)) for f in fits]
    assert error[0] < error[1]


@pytest.mark.stability(stage="fit", case="F D never sampled near its peak")
def test_a_lobe_seen_only_far_from_its_peak_is_not_stated():
    geometry = in_plane([10, 20, 30, 40, 10, 20, 30, 50], [45, 55, 70, 75, 50, 60, 65, 10])
    rng = np.random.default_rng(7)
    response = model(0.3, 2000.0, 0.1, geometry)[None] * (1 + 0.002 * rng.normal(size=(50, len(geometry))))
    result = run(response, geometry)
    assert (np.abs(geometry[:, 3]) > 0.2).all()
    assert not stated(result).any()
    assert_sound(result)


VALUES = st.floats(-1e6, 1e6, width=32) | st.sampled_from([np.nan, np.inf])


@pytest.mark.stability(stage="fit", case="random data")
@given(
    response=npst.arrays(np.float32, (5, 11), elements=VALUES),
    angles=npst.arrays(np.float32, (5, 11, 4), elements=st.floats(0.0, 2.25, width=32) | st.just(np.nan)),
    weight=npst.arrays(np.float32, (5, 11), elements=st.sampled_from([0.0, 1.0])),
    clipped=npst.arrays(np.uint8, (5, 11), elements=st.integers(0, 1)),
    known=st.booleans(),
    scale=st.sampled_from([1e-6, 1.0]),
)  # fmt: skip
@settings(deadline=None, max_examples=150)
def test_whatever_the_data_the_fit_ends_finite_or_flagged(response, angles, weight, clipped, known, scale):
    noise = np.tile([1e-6, 1e-5], (11, 1)) if known else None
    with np.errstate(invalid="ignore", over="ignore"):
        result = fit(response * np.float32(scale), angles, weight, N, K, noise=noise, clipped=clipped)
    assert_sound(result)


@pytest.mark.stability(stage="fit", case="random data")
@pytest.mark.parametrize("solver", ["nlopt", "nlopt-reference"])
@given(
    response=npst.arrays(np.float64, (3, 9), elements=VALUES),
    angles=npst.arrays(np.float64, (3, 9, 4), elements=st.floats(0.0, 2.25) | st.just(np.nan)),
    weight=npst.arrays(np.float64, (3, 9), elements=st.sampled_from([0.0, 1.0])),
    scale=st.sampled_from([1e-6, 1.0]),
)
@settings(deadline=None, max_examples=40)
def test_whatever_the_data_nlopt_ends_finite_or_flagged(solver, response, angles, weight, scale):
    with np.errstate(invalid="ignore", over="ignore"):
        result = fit(response * scale, angles, weight, N, K, FitOptions(solver=solver))
    assert_sound(result)


@pytest.mark.parametrize("solver", ["nlopt", "nlopt-reference"])
def test_nlopt_says_of_hard_texels_what_variable_projection_says(solver):
    rng = np.random.default_rng(11)
    noise = 1 + 0.01 * rng.normal(size=len(GEOMETRY))
    hard = {
        "no gloss": model(0.4, 0.0, 0.1) * noise,
        "no diffuse light": model(0.0, 4.0, 0.12) * noise,
        "no light": np.zeros(len(GEOMETRY)),
        "negative": np.full(len(GEOMETRY), -0.003),
        "dim": 1e-6 * model(0.4, 4.0, 0.1) * noise,
        "smooth": model(0.4, 4.0, 0.02) * noise,
        "rough": model(0.4, 4.0, 0.6) * noise,
        "not a number": np.where(np.arange(len(GEOMETRY)) > 2, np.nan, 1.0),
    }
    response = np.stack(list(hard.values()))
    one, other = run(response), run(response, solver=solver)
    assert dict(zip(hard, one.status, strict=True)) == dict(zip(hard, other.status, strict=True))
    np.testing.assert_allclose(other.mu, one.mu, rtol=1e-2, equal_nan=True)
    assert_sound(other)


def test_results_do_not_depend_on_the_neighbours():
    _alpha, _beta, _mu, response = photographed(400, np.random.default_rng(10))
    weight = np.ones(response.shape)
    whole = fit(response, GEOMETRY, weight, N, K, noise=CAMERA)
    parts = [fit(response[i : i + 7], GEOMETRY, weight[i : i + 7], N, K, noise=CAMERA) for i in (0, 133, 250)]
    for part, i in zip(parts, (0, 133, 250), strict=True):
        names = [field.name for field in dataclasses.fields(part) if isinstance(getattr(part, field.name), np.ndarray)]
        assert len(names) >= 13
        for name in names:
            np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[i : i + 7])
