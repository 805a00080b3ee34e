"""The refractive index as one more unknown: found where the angles tell it, with errors that hold."""

import numpy as np
from test_fitting import GEOMETRY, K, N, model, run
from test_fitting_hard import in_plane, stated

from irodori.fitting.solvers import FitOptions, fit
from irodori.material.material_file import Status


def test_a_fitted_index_is_that_of_the_material():
    geometry = in_plane(*np.meshgrid([20, 35, 50, 65, 75], [15, 25, 35, 50, 60, 70, 78])).reshape(-1, 4)
    rng = np.random.default_rng(8)
    truth = rng.uniform(1.35, 2.0, 40)
    mu, beta = rng.uniform(0.15, 0.3, 40), rng.uniform(4, 8, 40)
    response = np.stack([model(0.2, b, m, geometry, n=n) for b, m, n in zip(beta, mu, truth, strict=True)])
    exact = run(response, geometry, refractive_index="fitted", model_error=1e-4, level_error=1e-4, pose_error_deg=0.0)
    known = np.isfinite(exact.index)
    assert known.mean() > 0.9
    np.testing.assert_allclose(exact.index[known], truth[known], atol=2e-3)
    np.testing.assert_allclose(exact.beta[known], beta[known], rtol=1e-2)
    noisy = run(response + 0.003 * rng.normal(size=response.shape), geometry, refractive_index="fitted",
                weights="equal", model_error=1e-3, level_error=1e-3, pose_error_deg=0.0)  # fmt: skip
    known = np.isfinite(noisy.index)
    assert known.any() and (np.abs(noisy.index - truth)[known] <= 4 * noisy.index_error[known]).all()


def test_errors_of_a_fitted_index_and_of_what_hangs_on_it_hold():
    geometry = in_plane(*np.meshgrid([20, 35, 50, 65, 75], [15, 25, 35, 50, 60, 70, 78])).reshape(-1, 4)
    rng = np.random.default_rng(80)
    mu, beta = rng.uniform(0.15, 0.3, 400), rng.uniform(4, 8, 400)
    off = np.degrees(geometry[:, :2]) + 0.05 * rng.normal(size=(400, len(geometry), 2))
    response = model(0.2, beta, mu, in_plane(off[..., 0], off[..., 1]))
    noise = np.tile([4e-6, 8e-5], (len(geometry), 1))
    response = response + np.sqrt(noise[:, 0] + noise[:, 1] * response) * rng.normal(size=response.shape)
    for weights in ("noise", "equal"):
        options = FitOptions(
            refractive_index="fitted", weights=weights, model_error=1e-4, level_error=1e-4, pose_error_deg=0.05
        )
        result = fit(response, geometry, np.ones(response.shape), N, K, options, noise=noise)
        known = np.isfinite(result.index) & stated(result)
        assert known.mean() > 0.5
        truths = (("index", np.full(400, N)), ("alpha", np.full(400, 0.2)), ("beta", beta), ("mu", mu))
        for name, truth in truths:
            deviation = (np.abs(getattr(result, name) - truth) / getattr(result, f"{name}_error"))[known]
            assert (deviation < 2).mean() > 0.88, (name, weights)
            assert (deviation < 1).mean() < 0.9, (name, weights)


def test_an_index_of_texels_without_gloss_is_not_stated():
    rng = np.random.default_rng(81)
    matt = model(0.4, 0.0, 0.1)[None] * (1 + 0.01 * rng.normal(size=(20, len(GEOMETRY))))
    result = run(np.concatenate([matt, np.zeros((2, len(GEOMETRY)))]), refractive_index="fitted")
    assert np.isnan(result.index).all()
    assert np.isin(result.status, (Status.DIFFUSE_ONLY, Status.DARK)).mean() > 0.9


def test_an_index_that_the_angles_do_not_tell_is_not_stated():
    rng = np.random.default_rng(9)
    geometry = in_plane(np.linspace(3, 12, 12), np.linspace(2, 25, 12))  # all near normal incidence
    response = model(0.3, 5.0, 0.12, geometry) * (1 + 0.01 * rng.normal(size=(30, 12)))
    result, given = run(response, geometry, refractive_index="fitted"), run(response, geometry)
    assert np.isnan(result.index).all()
    np.testing.assert_array_equal(result.mu, given.mu)
