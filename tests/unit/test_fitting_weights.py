"""Weights, variances and bounds of the fit: what they may change, and what is refused."""

import numpy as np
import pytest
from test_fitting import GEOMETRY, K, N, materials, model, run
from test_fitting_hard import CAMERA, stated

from irodori.fitting.solvers import FitOptions, fit
from irodori.material.material_file import Status


def test_weights_of_noisy_readings_do_not_pull_alpha():
    rng = np.random.default_rng(30)
    camera = np.tile([1e-8, 4e-4], (len(GEOMETRY), 1))
    truth = np.broadcast_to(model(0.01, 0.0, 0.1), (4000, len(GEOMETRY)))
    electrons = rng.poisson(truth / 4e-4)
    result = fit(electrons * 4e-4, GEOMETRY, np.ones(truth.shape), N, K, noise=camera)
    matt = np.isfinite(result.alpha) & (result.status == Status.DIFFUSE_ONLY)
    assert matt.mean() > 0.8
    assert result.alpha[matt].mean() == pytest.approx(0.01, rel=0.02)


@pytest.mark.parametrize("common", [1e-200, 1e-20, 1e20, 1e200])
def test_a_common_weight_of_any_size_changes_nothing(common):
    alpha, beta, mu = materials(40, seed=31)
    response = model(alpha, beta, mu) * (1 + 0.01 * np.random.default_rng(31).normal(size=(40, len(GEOMETRY))))
    one, many = run(response), run(response, weight=common)
    assert np.array_equal(one.status, many.status)
    for name in ("alpha", "mu", "mu_error", "alpha_error"):
        np.testing.assert_allclose(getattr(many, name), getattr(one, name), rtol=1e-6, equal_nan=True)


def test_what_lies_at_a_bound_is_said_to():
    bounds = {"alpha": (0.1, 2.0)}
    rng = np.random.default_rng(32)
    dark = run(model(0.02, 3.0, 0.15)[None] * (1 + 0.01 * rng.normal(size=(20, len(GEOMETRY)))), bounds=bounds)
    bright = run(model(3.0, 0.0, 0.15)[None] * (1 + 0.01 * rng.normal(size=(20, len(GEOMETRY)))))
    for result in (dark, bright):
        assert (result.status == Status.AT_BOUND).all() and np.isnan(result.alpha_error).all()


@pytest.mark.parametrize("bounds", [{"mu_rad": (0.1, 0.1)}, {"mu_rad": (0.2, 0.1)}, {"alpha": (1.0, 0.0)}])
def test_bounds_that_leave_no_range_are_refused(bounds):
    with pytest.raises(ValueError, match="lower bound first"):
        FitOptions(bounds=bounds)


def test_a_negative_variance_is_refused():
    with pytest.raises(ValueError, match="0 or more"):
        fit(np.ones((1, len(GEOMETRY))), GEOMETRY, np.ones((1, len(GEOMETRY))), N, K, noise=-CAMERA)


def test_standard_errors_hold_where_the_noise_is_not_known_and_grows_with_the_light():
    alpha, beta, mu = materials(3000, seed=33)
    rng = np.random.default_rng(33)
    response = model(alpha, beta, mu) * (1 + 0.05 * rng.normal(size=(3000, len(GEOMETRY))))
    result = run(response)
    known = stated(result)
    assert known.mean() > 0.8
    for name, truth in (("alpha", alpha), ("beta", beta), ("mu", mu)):
        off = np.abs(getattr(result, name) - truth)[known] / getattr(result, f"{name}_error")[known]
        assert 0.6 < (off < 1).mean() < 0.9 and (off < 2).mean() > 0.88, name
