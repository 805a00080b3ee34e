"""After the fit: the diffuse response of every texel, and the variance that the camera's noise gives it."""

import dataclasses

import numpy as np
import pytest
from test_fitting import GEOMETRY, K, N, gloss_over_beta, materials, run

from irodori.fitting import Status, fit
from irodori.fitting.stage import _of_near_light, diffuse_response

NOISE = np.tile([1e-6, 2e-5], (len(GEOMETRY), 6, 1))  # c0 and c1 of each capture and band


def six_bands(alpha, beta, mu, bands):
    """Responses of six bands, (texels, J, 6): the gloss has no colour, the diffuse light has that of ``bands``."""
    gloss = beta[:, None] * gloss_over_beta(GEOMETRY, mu[:, None])
    return bands[:, None, :] * np.cos(GEOMETRY[:, 0])[:, None] + gloss[..., None]


def test_diffuse_response_is_the_truth_where_the_gloss_is_known():
    alpha, beta, mu = materials(60, seed=13)
    rng = np.random.default_rng(130)
    bands = rng.uniform(0.0, 1.0, (60, 6))
    bands[:, 1] = alpha
    response = six_bands(alpha, beta, mu, bands)
    geometry, weight = np.tile(GEOMETRY, (60, 1, 1)), np.ones(response.shape[:2])
    fitted = fit(response[..., 1], geometry, weight, N, K)
    known = dataclasses.replace(fitted, gloss=np.stack([beta, mu], axis=1))
    assert np.abs(diffuse_response(response, geometry, weight, known, N, K, NOISE)[0] - bands).max() <= 1e-9
    assert np.abs(diffuse_response(response, geometry, weight, fitted, N, K, NOISE)[0] - bands).max() <= 1e-4


def test_diffuse_response_averages_noise_down():
    texels, noise = 4000, 0.01
    rng = np.random.default_rng(14)
    bands = np.tile(rng.uniform(0.1, 0.9, 6), (texels, 1))
    zero = np.zeros(texels)
    response = six_bands(bands[:, 1], zero, zero + 0.1, bands)
    response += noise * rng.normal(size=response.shape)
    geometry, weight = np.tile(GEOMETRY, (texels, 1, 1)), np.ones(response.shape[:2])
    matt = dataclasses.replace(run(response[..., 1]), gloss=np.tile([0.0, 1.0], (texels, 1)))
    scatter = (diffuse_response(response, geometry, weight, matt, N, K, NOISE)[0] - bands).std(axis=0)
    # Gauss: the best estimate of a slope along cosθ_i has this standard error.
    best = noise / np.sqrt(np.sum(np.cos(GEOMETRY[:, 0]) ** 2))
    assert scatter == pytest.approx(np.full(6, best), rel=0.05)


def test_variance_of_the_diffuse_response_is_the_scatter_that_the_cameras_noise_gives():
    texels = 4000
    rng = np.random.default_rng(15)
    bands = np.tile(rng.uniform(0.1, 0.9, 6), (texels, 1))
    gloss = np.tile([0.4, 0.2], (texels, 1))
    clean = six_bands(bands[:, 1], *gloss.T, bands)
    # Bands and captures of different noise, the first capture seen by half of the texels only.
    noise = rng.uniform(0.5, 2.0, NOISE.shape) * np.array([1e-5, 4e-4])
    response = clean + np.sqrt(noise[..., 0] + noise[..., 1] * clean) * rng.normal(size=clean.shape)
    geometry, weight = np.tile(GEOMETRY, (texels, 1, 1)), np.ones(response.shape[:2])
    weight[::2, 0] = 0.0
    known = dataclasses.replace(run(clean[..., 1]), gloss=gloss)
    found, variance = diffuse_response(response, geometry, weight, known, N, K, noise)
    for half in (slice(0, None, 2), slice(1, None, 2)):
        assert variance[half].mean(axis=0) == pytest.approx((found - bands)[half].var(axis=0), rel=0.1)
    unknown = diffuse_response(response, geometry, weight, known, N, K, np.full(noise.shape, np.nan))
    assert np.array_equal(unknown[0], found) and np.isnan(unknown[1]).all()


def test_diffuse_response_is_nan_without_observations():
    response = six_bands(*(np.array([v]) for v in (0.3, 5.0, 0.1)), np.full((1, 6), 0.3))
    weight = np.zeros((1, len(GEOMETRY)))
    result = fit(response[..., 1], GEOMETRY[None], weight, N, K)
    assert np.isnan(diffuse_response(response, GEOMETRY[None], weight, result, N, K, NOISE)).all()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_diffuse_response_leaves_out_what_the_fit_leaves_out(value):
    alpha, beta, mu = materials(5, seed=15)
    response = six_bands(alpha, beta, mu, np.tile(alpha[:, None], (1, 6)))
    response[:, 4] = value
    geometry, weight = np.tile(GEOMETRY, (5, 1, 1)), np.ones(response.shape[:2])
    fitted = fit(response[..., 1], geometry, weight, N, K)
    assert (fitted.status == Status.OK).all()
    assert np.abs(diffuse_response(response, geometry, weight, fitted, N, K, NOISE)[0] - alpha[:, None]).max() <= 1e-4


def test_noise_under_a_near_light_is_that_of_the_response_that_its_gain_scaled():
    rng = np.random.default_rng(17)
    gain, weight = rng.uniform(0.7, 1.4, (4000, 3)), np.ones((4000, 3))
    weight[::2, 1] = 0.0
    gain[::2, 1] = 0.0  # what is not seen has no gain
    noise = rng.uniform(0.5, 2.0, (3, 6, 2)) * [1e-4, 1e-3]
    found = _of_near_light(noise, gain, weight)
    for j in range(3):
        seen = gain[weight[:, j] > 0, j, None]
        scaled = 0.4  # the response after its gain, which the camera saw as scaled / gain
        exact = seen**2 * (noise[j, :, 0] + noise[j, :, 1] * scaled / seen)
        assert found[j, :, 0] + found[j, :, 1] * scaled == pytest.approx(exact.mean(axis=0), rel=1e-9)
