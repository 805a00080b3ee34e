"""Huber's loss: what one gross outlier may not do."""

import numpy as np
import pytest
from test_fitting import GEOMETRY, K, N, gloss_over_beta, materials, model
from test_fitting_hard import CAMERA, in_plane, stated

from irodori.fitting.solvers import FitOptions, fit


@pytest.mark.stability(stage="fit", case="one gross outlier in 20")
@pytest.mark.parametrize("factor", [0.0, 0.2, 3.0])
@pytest.mark.parametrize("weights", ["noise", "equal"])
def test_huber_withstands_one_gross_outlier_in_twenty(factor, weights):
    geometry = np.concatenate([GEOMETRY, in_plane([30, 50, 60], [25, 45, 60])])
    camera = np.tile(CAMERA[:1], (len(geometry), 1))
    alpha, beta, mu = materials(400, seed=26)
    rng = np.random.default_rng(260)
    clean = model(alpha, beta, mu, geometry)
    response = clean * (1 + 0.005 * rng.normal(size=clean.shape))
    response[np.arange(400), rng.integers(0, len(geometry), 400)] *= factor
    fits = [fit(response, geometry, np.ones(response.shape), N, K, FitOptions(huber=h, weights=weights), noise=camera)
            for h in (None, 2.0)]  # fmt: skip
    error = [np.where(stated(r), np.abs(r.mu / mu - 1), np.inf) for r in fits]
    assert np.median(error[1]) < 0.05 and np.median(error[1]) < 0.5 * np.median(error[0])
    robust = fits[1]
    known = stated(robust)
    off = np.abs(robust.mu - mu)[known] / robust.mu_error[known]
    assert known.mean() > 0.6 and (off < 3).mean() > 0.85


def huber_loss(response, geometry, weight, variance, parameters, limit):
    alpha, beta, mu = parameters
    deviation = np.abs(alpha * np.cos(geometry[:, 0]) + beta * gloss_over_beta(geometry, mu) - response)
    deviation /= np.sqrt(variance)
    far = limit * (2 * deviation - limit)
    return np.sum(weight * variance * np.where(deviation > limit, far, deviation**2), axis=1)


def test_no_dense_scan_finds_a_lower_huber_loss():
    rng = np.random.default_rng(261)
    alpha, beta, mu = materials(60, seed=262)
    response = model(alpha, beta, mu) * (1 + 0.01 * rng.normal(size=(60, len(GEOMETRY))))
    response[np.arange(60), rng.integers(0, len(GEOMETRY), 60)] *= 0.1
    variance = np.broadcast_to(CAMERA[:, 0], response.shape)
    noise = np.stack([CAMERA[:, 0], 0 * CAMERA[:, 1]], axis=1)
    result = fit(response, GEOMETRY, np.ones(response.shape), N, K, FitOptions(huber=2.0, model_error=0.0), noise=noise)
    arguments = (response, GEOMETRY, 1.0 / variance, variance)
    whole = (result.model == 3) & np.isfinite(result.alpha)
    found = huber_loss(*arguments, (result.alpha[:, None], *result.gloss.T[..., None]), 2.0)
    best = np.full(60, np.inf)
    for trial in np.geomspace(0.005, 1.2, 200):
        a, b = result.alpha[:, None], np.ones((60, 1))
        g, c = gloss_over_beta(GEOMETRY, trial), np.cos(GEOMETRY[:, 0])
        for _ in range(60):
            deviation = np.abs(a * c + b * g - response) / np.sqrt(variance)
            w = np.where(deviation > 2.0, 2.0 / np.maximum(deviation, 1e-30), 1.0) / variance
            cc, gg, cg = (w * c * c).sum(1), (w * g * g).sum(1), (w * c * g).sum(1)
            cr, rg = (w * c * response).sum(1), (w * g * response).sum(1)
            d = np.maximum(cc * gg - cg**2, 1e-30)
            a, b = np.maximum((cr * gg - rg * cg) / d, 0)[:, None], np.maximum((rg * cc - cr * cg) / d, 0)[:, None]
        best = np.minimum(best, huber_loss(*arguments, (a, b, trial), 2.0))
    assert whole.sum() > 40
    assert (found[whole] <= 1.01 * best[whole]).mean() >= 0.97
