"""After the fit: the diffuse response of every texel, and the variance that the camera's noise gives it."""

import dataclasses

import made_up_camera
import numpy as np
import pytest
from made import made
from test_fitting import GEOMETRY, K, N, gloss_over_beta, materials, run
from test_paints import CREAM, DEFAULT, TWO_MU, VERMILION, fitted, halves, photographed, sphere

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.solution import solve
from irodori.config.models import CalibrationOptions
from irodori.core import store
from irodori.core.errors import InputError
from irodori.fitting.band_fresnel import band_gloss, uniform
from irodori.fitting.diffuse_response import diffuse_response
from irodori.fitting.solvers import fit
from irodori.fitting.stage import _of_near_light, fresnel_of
from irodori.material.material_file import Status
from irodori.spectra.grid import WAVELENGTH_NM

FRESNEL = uniform(N, K, 6)
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
    assert np.abs(diffuse_response(response, geometry, weight, known, FRESNEL, NOISE)[0] - bands).max() <= 1e-9
    assert np.abs(diffuse_response(response, geometry, weight, fitted, FRESNEL, NOISE)[0] - bands).max() <= 1e-4


def test_diffuse_response_averages_noise_down():
    texels, noise = 4000, 0.01
    rng = np.random.default_rng(14)
    bands = np.tile(rng.uniform(0.1, 0.9, 6), (texels, 1))
    zero = np.zeros(texels)
    response = six_bands(bands[:, 1], zero, zero + 0.1, bands)
    # Every other capture has a hundred times the variance: an even mean would be ten times as uncertain.
    camera = np.zeros(NOISE.shape)
    camera[::2, :, 0], camera[1::2, :, 0] = noise**2, 100 * noise**2
    response += np.sqrt(camera[..., 0]) * rng.normal(size=response.shape)
    geometry, weight = np.tile(GEOMETRY, (texels, 1, 1)), np.ones(response.shape[:2])
    matt = dataclasses.replace(run(response[..., 1]), gloss=np.tile([0.0, 1.0], (texels, 1)))
    found, variance = diffuse_response(response, geometry, weight, matt, FRESNEL, camera, model_error=0.0)
    scatter = (found - bands).std(axis=0)
    # Gauss: the best estimate of a slope along cosθ_i has this standard error.
    best = 1.0 / np.sqrt(np.sum(np.cos(GEOMETRY[:, 0]) ** 2 / camera[:, 0, 0]))
    np.testing.assert_allclose(np.sqrt(variance), best, rtol=1e-6)
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
    found, variance = diffuse_response(response, geometry, weight, known, FRESNEL, noise)
    for half in (slice(0, None, 2), slice(1, None, 2)):
        assert variance[half].mean(axis=0) == pytest.approx((found - bands)[half].var(axis=0), rel=0.1)
    unknown = diffuse_response(response, geometry, weight, known, FRESNEL, np.full(noise.shape, np.nan))
    assert np.isnan(unknown[1]).all()
    assert (np.abs(unknown[0] - bands).mean(axis=0) > np.abs(found - bands).mean(axis=0)).all()


def test_diffuse_response_is_nan_without_observations():
    response = six_bands(*(np.array([v]) for v in (0.3, 5.0, 0.1)), np.full((1, 6), 0.3))
    weight = np.zeros((1, len(GEOMETRY)))
    result = fit(response[..., 1], GEOMETRY[None], weight, N, K)
    assert np.isnan(diffuse_response(response, GEOMETRY[None], weight, result, FRESNEL, NOISE)).all()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_diffuse_response_leaves_out_what_the_fit_leaves_out(value):
    alpha, beta, mu = materials(5, seed=15)
    response = six_bands(alpha, beta, mu, np.tile(alpha[:, None], (1, 6)))
    response[:, 4] = value
    geometry, weight = np.tile(GEOMETRY, (5, 1, 1)), np.ones(response.shape[:2])
    fitted = fit(response[..., 1], geometry, weight, N, K)
    assert (fitted.status == Status.OK).all()
    assert (
        np.abs(diffuse_response(response, geometry, weight, fitted, FRESNEL, NOISE)[0] - alpha[:, None]).max() <= 1e-4
    )


@pytest.mark.parametrize(("clipped", "worse"), [(2, 1.8), (1, 5.0)])
def test_a_few_readings_that_clip_in_one_band_unflagged_hardly_change_a_colour(clipped, worse):
    """Highlights clip at 60 % of a texel's peak, diffuse light does not; if green clips, the fitted gloss is wrong."""
    paint = np.random.default_rng(2101).permutation(halves())
    colour, geometry = np.array([VERMILION, CREAM])[paint], sphere()
    seen = photographed(colour, np.array([5.0, 2.0])[paint], TWO_MU[paint], geometry, seed=2102)
    plain = fitted(seen, DEFAULT)[0].response / colour - 1.0
    band, lit = seen.response[..., clipped], np.cos(geometry[..., 0]).max(axis=1)
    limit = np.maximum(0.6 * band.max(axis=1), 1.03 * lit * colour[:, clipped])[:, None]
    cut = (band > limit).sum(axis=1)
    seen.response[..., clipped] = np.minimum(band, limit)
    tile, own = fitted(seen, DEFAULT)
    off, error = tile.response / colour - 1.0, own.alpha_error / own.alpha
    told = (cut > 0) & (cut <= 5) & np.isfinite(error)
    assert told.sum() > 500
    assert (np.abs(off) < 2.0 * error[:, None])[told].mean(axis=0).min() > 0.9
    assert np.sqrt((off[told] ** 2).mean(axis=0))[2] < worse * np.sqrt((plain[told] ** 2).mean(axis=0))[2]


def test_one_reading_without_light_does_not_change_a_colour():
    rng, texels, geometry = np.random.default_rng(2103), 400, GEOMETRY[:16]
    bands, beta, mu = rng.uniform(0.05, 0.8, (texels, 6)), rng.uniform(0.5, 8.0, texels), rng.uniform(0.08, 0.3, texels)
    gloss = beta[:, None] * gloss_over_beta(geometry, mu[:, None])
    response = bands[:, None, :] * np.cos(geometry[:, 0])[:, None] + gloss[..., None]
    response *= 1.0 + 0.01 * rng.normal(size=(texels, 16, 1))
    geometry, weight, noise = np.tile(geometry, (texels, 1, 1)), np.ones(response.shape[:2]), NOISE[:16]
    off = []
    for level in (1.0, 0.0):
        response[np.arange(texels), rng.integers(0, 16, texels)] *= level
        own = fit(response[..., 1], geometry, weight, N, K, noise=noise[:, 1])
        off.append(np.abs(diffuse_response(response, geometry, weight, own, FRESNEL, noise)[0] / bands - 1.0))
    assert np.quantile(off[1], 0.95) < 1.2 * np.quantile(off[0], 0.95)


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


#: n and k of gold at 400, 450, .. 700 nm, to two digits (Johnson and Christy 1972).
GOLD = np.stack([np.interp(WAVELENGTH_NM, np.arange(400, 701, 50), v) for v in (
    [1.47, 1.50, 0.97, 0.43, 0.25, 0.17, 0.16], [1.95, 1.88, 1.87, 2.46, 2.99, 3.14, 3.80])])  # fmt: skip


def fresnel_exact(geometry, n, k) -> np.ndarray:
    """F from the amplitudes, (J,)."""
    index, outside = n + 1j * k, np.cos(geometry[:, 2])
    inside = np.sqrt(1.0 - (np.sin(geometry[:, 2]) / index) ** 2 + 0j)
    s = (outside - index * inside) / (outside + index * inside)
    p = (index * outside - inside) / (index * outside + inside)
    return 0.5 * (abs(s) ** 2 + abs(p) ** 2)


@pytest.mark.parametrize("known", ["camera", "chart"])
def test_the_coloured_gloss_of_gold_is_subtracted_in_its_own_colour(known):
    """Responses integrated over the spectrum; ``chart``: the bands are known from the calibration's chart alone."""
    rng = np.random.default_rng(18)
    count, true = 40, made_up_camera.system()
    bands = rng.uniform(0.05, 0.3, (count, 6))
    mu, beta = rng.uniform(0.1, 0.3, count), rng.uniform(0.5, 2.0, count)
    factor = np.stack([fresnel_exact(GEOMETRY, *index) for index in GOLD.T])  # (61, J)
    plain = gloss_over_beta(GEOMETRY, mu[:, None]) / fresnel_exact(GEOMETRY, N, K)
    gloss = (beta[:, None] * plain)[..., None] * (true @ factor).T[None]
    response = bands[:, None, :] * np.cos(GEOMETRY[:, 0])[:, None] + gloss
    seen = (
        true
        if known == "camera"
        else solve(
            made_up_camera.training(),
            made(CalibrationOptions, {"estimator": "pinv", "bases": 6}),
            ("out", "in"),
            ("D65",),
            False,
        ).calibration.band_response
    )
    fresnel = band_gloss(*GOLD, seen, 1)
    geometry, weight = np.tile(GEOMETRY, (count, 1, 1)), np.ones(response.shape[:2])
    fitted = fit(response[..., 1], geometry, weight, fresnel.n, fresnel.k)
    found = diffuse_response(response, geometry, weight, fitted, fresnel, NOISE)[0]
    n, k = (float(v[WAVELENGTH_NM == 550.0][0]) for v in GOLD)
    alone = fit(response[..., 1], geometry, weight, n, k)
    plain = diffuse_response(response, geometry, weight, alone, uniform(n, k, 6), NOISE)[0]
    # The fit has one n + ik for a mean over the band, which is not quite the F of any.
    assert np.abs(fitted.beta / beta - 1).max() < 0.005 < np.abs(alone.beta / beta - 1).min()
    assert np.abs(found - bands).max() < 0.001 * gloss.max()
    assert np.abs(plain - bands).max() > 0.1


def test_bands_do_not_matter_where_the_index_has_no_colour():
    flat = band_gloss(np.full(61, 1.5), np.full(61, 0.2), made_up_camera.system(), 1)
    assert (flat.n, flat.k) == (pytest.approx(1.5, abs=1e-6), pytest.approx(0.2, abs=1e-6))
    np.testing.assert_allclose(flat.ratio, 1.0, atol=1e-7)


def test_the_bands_are_read_from_the_calibration_and_missed_where_they_are_needed(tmp_path):
    provenance = store.Provenance("test", "", "")
    calibration = solve(
        made_up_camera.training(),
        made(CalibrationOptions, {"estimator": "pinv", "bases": 6}),
        ("out", "in"),
        ("D65",),
        False,
    ).calibration
    for name, content in (("whole", calibration), ("old", dataclasses.replace(calibration, band_response=None))):
        with store.create(tmp_path / f"{name}.h5", provenance) as out:
            content.write(out)
    np.testing.assert_array_equal(Calibration.load(tmp_path / "whole.h5").band_response, calibration.band_response)
    found, expected = fresnel_of(*GOLD, tmp_path / "whole.h5", 6), band_gloss(*GOLD, calibration.band_response, 1)
    assert (found.n, found.k) == (expected.n, expected.k)
    with pytest.raises(InputError, match="band_response"):
        fresnel_of(*GOLD, tmp_path / "old.h5", 6)
    with pytest.raises(ValueError, match="accepted: one with a calibration"):
        fresnel_of(*GOLD, None, 6)
    assert fresnel_of(np.full(61, 1.5), np.zeros(61), None, 6).n == fresnel_of(1.5, 0.0, None, 6).n == 1.5
