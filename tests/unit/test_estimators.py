"""Estimators: exposure, units, types and hard charts, for each; their uncertainty and files."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up_camera import LIGHT, checked_fit, patches, system, training
from scipy.interpolate import PchipInterpolator

from irodori.calibration.conditioning import check_amplification, check_responses, noise_amplification
from irodori.calibration.estimators import ESTIMATORS, fit, monomials
from irodori.calibration.paper_estimator import calibrate
from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.recovery.mappings import LinearMapping, LocalMapping, PolynomialMapping
from irodori.calibration.recovery.posterior import RANK, Posterior
from irodori.calibration.recovery.posterior_loops import Errors
from irodori.calibration.response_model import fit_response_model, smooth_covariance, smooth_priors
from irodori.calibration.training import ResponseNoise, Training, mix_paints
from irodori.colour.colorimetry import delta_e_reflectance, spectral_rmse, xyz_from_reflectance
from irodori.core import store
from irodori.core.errors import InputError
from irodori.spectra.coordinates import write_wavelength
from irodori.spectra.grid import ERROR_NM, WAVELENGTH_NM

NAMES = list(ESTIMATORS)
PROBES = mix_paints(patches(), limit=60)[:50]


@pytest.fixture(scope="module")
def solved() -> dict[str, Calibration]:
    """Every estimator on the chart at 0.3 % noise, six bases."""
    return {name: fit(name, training(0.003), 6) for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
@given(exponent=st.floats(-6, 6))
@settings(deadline=None, max_examples=12)
def test_twice_the_light_gives_twice_the_reflectance(solved, name, exponent):
    gain, response = 10.0**exponent, PROBES @ system().T
    plain = solved[name].weights(response)
    assert np.allclose(solved[name].weights(gain * response), gain * plain, rtol=1e-9, atol=1e-12 * gain)
    variance = np.full(6, 1e-4)
    stated = solved[name].weights(response, variance)
    assert np.allclose(solved[name].weights(gain * response, gain**2 * variance), gain * stated, rtol=1e-7,
                       atol=1e-10 * gain)  # fmt: skip


@pytest.mark.default_cases(6)
@pytest.mark.stability(stage="calibrate", case="responses scaled by 1e-6..1e6")
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("gain", [1e-6, 1e6, "mixed"])
def test_units_of_the_responses_do_not_matter(solved, name, gain):
    gain = 10.0 ** np.array([-6.0, 6.0, 0.0, 3.0, -3.0, 1.0]) if gain == "mixed" else np.full(6, gain)
    chart = training(0.003)
    noise = ResponseNoise(chart.noise.patch * gain**2, chart.noise.pixel * gain**2)
    scaled = fit(name, Training(chart.response * gain, chart.spectra, LIGHT, noise), 6)
    response = PROBES @ system().T
    assert np.abs(scaled.spectra(response * gain) - solved[name].spectra(response)).max() <= 1e-6
    own, plain = Posterior(scaled).of(response * gain), Posterior(solved[name]).of(response)
    assert np.allclose(own.standard_deviation, plain.standard_deviation, rtol=1e-3, atol=1e-6)
    assert noise_amplification(scaled) == pytest.approx(noise_amplification(solved[name]), rel=1e-4)


@pytest.mark.stability(stage="calibrate", case="float32 input")
@pytest.mark.parametrize("name", NAMES)
def test_float32_in_is_float32_out_and_the_same(solved, name):
    response = (PROBES @ system().T).astype(np.float32)
    single = solved[name].weights(response.reshape(2, 25, 6))
    assert single.dtype == np.float32 and single.shape == (2, 25, 6)
    assert np.abs(single.reshape(50, 6) - solved[name].weights(response.astype(np.float64))).max() <= 3e-5
    chart = training(0.003)
    rounded = fit(name, replace(chart, response=chart.response.astype(np.float32).astype(np.float64)), 6)
    assert np.abs(rounded.spectra(response) - solved[name].spectra(response)).max() <= 1e-4


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("name", NAMES)
def test_large_pictures_are_recovered_as_small_ones(solved, name):
    response = np.resize(PROBES @ system().T, (70_050, 6))
    whole = solved[name].weights(response)
    assert np.allclose(whole[-50:], solved[name].weights(response[-50:]), rtol=1e-12, atol=1e-12)


@pytest.mark.stability(stage="calibrate", case="pixels without light or not finite")
@pytest.mark.parametrize("name", NAMES)
def test_pixels_without_light_are_black_and_missing_ones_stay_missing(solved, name):
    response = np.zeros((3, 6))
    response[1, 2] = np.nan
    weights = solved[name].weights(response)
    assert (weights[[0, 2]] == 0.0).all() and np.isnan(weights[1]).all()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("bases", [3, 8])
def test_unseen_mixtures_are_recovered_on_an_orthonormal_basis(name, bases):
    found = fit(name, training(), bases)
    assert np.abs(found.basis.T @ found.basis - np.eye(bases)).max() <= 1e-12
    best = spectral_rmse(PROBES, PROBES @ found.basis @ found.basis.T).mean()
    # What six bands do not see adds to what the basis cannot hold; a wrong order of bands gives over 0.1.
    assert best <= spectral_rmse(PROBES, found.spectra(PROBES @ system().T)).mean() <= best + 0.02


def test_without_noise_wiener_and_local_explain_the_response():
    response = PROBES @ system().T
    for name in ("wiener", "local"):
        again = fit(name, training(), 20).spectra(response) @ system().T
        assert np.abs(again - response).max() <= 0.003


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("name", ["ridge", "wiener", "local", "kernel", "broad"])
def test_knowing_the_noise_beats_the_pseudo_inverse(name):
    noise, rng = 0.01, np.random.default_rng(1)
    response = np.repeat(PROBES @ system().T, 20, axis=0)
    response += noise * rng.standard_normal(response.shape)
    truth = np.repeat(PROBES, 20, axis=0)
    found = {n: spectral_rmse(truth, fit(n, training(noise), 6).spectra(response)).mean() for n in ("pinv", name)}
    assert found[name] <= 0.7 * found["pinv"]


def test_a_stated_variance_shrinks_dark_pixels_towards_the_prior():
    noise, rng = 0.01, np.random.default_rng(2)
    truth = np.repeat(0.1 * PROBES, 20, axis=0)
    response = truth @ system().T + noise * rng.standard_normal((len(truth), 6))
    local = fit("local", training(noise), 6)
    plain, stated = (spectral_rmse(truth, local.spectra(response, v)).mean() for v in (None, np.full(6, noise**2)))
    assert stated <= 0.8 * plain


def test_an_unknown_estimator_is_refused_with_the_list():
    with pytest.raises(ValueError, match="'pin'; accepted: pinv, ridge, wiener, local, kernel"):
        fit("pin", training(), 6)


# ---- hard charts


def faulty(fault: str) -> Training:
    """Return a chart with one thing wrong."""
    chart = training()
    response, spectra = chart.response.copy(), chart.spectra
    if fault == "few patches":
        response, spectra = response[:5], spectra[:5]
    elif fault == "few different patches":
        response, spectra = np.tile(response[:5], (4, 1)), np.tile(spectra[:5], (4, 1))
    elif fault == "dead band":
        response[:, 4] = 0.0
    elif fault == "bands alike":
        response[:, 4] = 1e-3 * response[:, 1]
    elif fault == "rank of three":
        response[:, 3:] = response[:, :3] @ np.array([[0.9, 0.1, 0.0], [0.2, 0.7, 0.1], [0.0, 0.3, 0.7]])
    elif fault == "grey chart":
        response = np.linspace(0.1, 0.9, 24)[:, None] * np.ones(6)
    elif fault == "saturated":
        response[:, 1] = np.minimum(response[:, 1], 0.4)
    elif fault == "one saturated":
        response[:, 0] = np.minimum(response[:, 0], 0.75)
    elif fault == "negative":
        response[7, 2] = -0.1
    else:
        response[7, 2] = float(fault)
    return Training(response, spectra, LIGHT)


FAULTS = {
    "few patches": "5 patches for 6 bands; accepted: at least as many",
    "few different patches": "5 different patches among 20 for 6 bands; accepted",
    "dead band": "band 4 without any signal; accepted: bands that see the chart",
    "bands alike": "band 1 and band 4 are the most alike.*accepted: up to 1e.05.*a filter that changes",
    "rank of three": "condition number .* are the most alike.*accepted",
    "grey chart": "condition number .*accepted.*more saturated colours",
    "saturated": "same largest value in band 1: saturated; accepted: a chart exposed below saturation",
    "one saturated": "patch 18, the brightest in band 0, .*saturated; accepted: a chart exposed below",
    "negative": "patch 7 at -.* in band 2; accepted: responses that are not negative",
    "nan": "patch 7 not finite in band 2; accepted: finite responses",
    "inf": "patch 7 not finite in band 2; accepted: finite responses",
}


@pytest.mark.stability(
    stage="calibrate", case="rank-deficient responses", fault=("rank of three", "grey chart", "few different patches")
)
@pytest.mark.stability(stage="calibrate", case="fewer patches than bands", fault="few patches")
@pytest.mark.stability(stage="calibrate", case="dead band", fault="dead band")
@pytest.mark.stability(stage="calibrate", case="two bands alike", fault="bands alike")
@pytest.mark.stability(stage="calibrate", case="saturated patches", fault=("saturated", "one saturated"))
@pytest.mark.stability(stage="calibrate", case="negative patches", fault="negative")
@pytest.mark.stability(stage="calibrate", case="not finite patches", fault=("nan", "inf"))
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("fault", FAULTS)
def test_charts_that_determine_nothing_are_refused_with_the_reason(name, fault):
    chart = faulty(fault)
    with pytest.raises(ValueError, match=FAULTS[fault]):
        checked_fit(name, chart, min(6, len(chart.spectra)))


@pytest.mark.default_cases(2)
@pytest.mark.stability(stage="calibrate", case="duplicate patches")
@pytest.mark.parametrize("name", NAMES)
def test_patches_that_occur_twice_do_no_harm(name):
    chart = training()
    twice = Training(np.tile(chart.response, (2, 1)), np.tile(chart.spectra, (2, 1)), LIGHT)
    response = PROBES @ system().T
    found = {n: spectral_rmse(PROBES, fit(name, c, 6).spectra(response)).mean() for n, c in
             (("once", chart), ("twice", twice))}  # fmt: skip
    assert found["twice"] <= 1.1 * found["once"] + 1e-4


def test_bands_are_named_by_their_filters():
    chart = faulty("dead band")
    with pytest.raises(ValueError, match=r"band 4 \(green, filter in\) without any signal"):
        check_responses(chart.response, filters=("out", "in"))


@pytest.mark.stability(stage="calibrate", case="negative patches")
def test_noise_below_zero_is_not_a_fault_where_the_noise_is_known():
    chart = training()
    response = chart.response.copy()
    response[23] = -0.02
    check_responses(response, patch_variance=np.full(6, 0.01**2))
    with pytest.raises(ValueError, match="not negative"):
        check_responses(response, patch_variance=np.full(6, 0.001**2))


def test_too_much_amplification_is_refused_with_the_band():
    solved = fit("pinv", training(0.003), 6)
    amplification = noise_amplification(solved)
    check_amplification(amplification, amplification, solved)
    with pytest.raises(ValueError, match=r"pinv with 6 bases amplifies the noise of band \d .*accepted: up to 0.1"):
        check_amplification(amplification, 0.1, solved)


# ---- the parts


def test_the_response_model_is_that_of_the_camera_within_its_uncertainty():
    model = fit_response_model(patches() @ system().T, smooth_priors(patches(), LIGHT), np.zeros(6))
    error = model.mean - system()
    # Spectra beyond the chart: what the model says of their responses holds within its own standard deviation.
    probes = np.concatenate([PROBES, np.exp(-0.5 * ((np.arange(61) - np.arange(5, 60, 5)[:, None]) / 8.0) ** 2)])
    spread = np.sqrt(np.einsum("ni,bij,nj->nb", probes, model.covariance, probes))
    standard = (probes @ error.T) / (spread + 1e-9)
    assert np.sqrt(np.mean(standard**2)) <= 2.0
    assert np.abs(PROBES @ error.T).max() <= 0.005


def test_a_paint_that_stands_ten_times_on_a_chart_counts_once_where_paints_differ():
    chart = training(0.001)
    again = np.r_[:24, np.zeros(9, int)]
    many = replace(chart, response=chart.response[again], spectra=chart.spectra[again])
    (spectra, weight), (more, shared) = chart.different_paints, many.different_paints
    assert np.allclose(more[33:], spectra[24:]) and np.allclose(shared[33:], weight[24:])
    assert shared[0] + shared[24:33].sum() == pytest.approx(weight[0]) and np.allclose(shared[1:24], weight[1:24])
    # A chart without repeats has one population, and a repeat weighs more in the other.
    assert np.array_equal(chart.paints[1], weight) and many.paints[1][0] * 10 > 1.5 * weight[0]


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.003])
def test_smooth_reflectances_that_are_no_paint_are_recovered_better_by_the_broad_prior(noise):
    rng, chart = np.random.default_rng(0), training(noise)
    drawn = 0.5 + 0.1 * rng.multivariate_normal(np.zeros(61), smooth_covariance(80.0), 500, method="eigh")
    response = drawn @ system().T + noise * rng.standard_normal((500, 6))
    errors = {}
    for name in ("kernel", "broad"):
        # On all wavelengths: the principal vectors of the chart do not hold these spectra, whatever the estimator.
        found = np.empty((500, 61))
        ESTIMATORS[name](chart).weights(response, None, found)
        errors[name] = spectral_rmse(drawn, found).mean(), delta_e_reflectance(drawn, found, "D65").mean()
    assert errors["broad"][0] <= 0.97 * errors["kernel"][0] and errors["broad"][1] <= 0.95 * errors["kernel"][1]


def test_noise_that_is_not_stated_is_found():
    noise = 0.005
    found = [training(noise, seed, known=False, patch_share=1.0).model.noise for seed in range(20)]
    unit = np.abs(training().response).max(axis=0)
    assert noise / 2 <= np.sqrt(np.median(found, axis=0) * unit**2).min()
    assert np.sqrt(np.median(found, axis=0) * unit**2).max() <= 2 * noise


def test_paints_mix_to_between_their_parts():
    pair = np.stack([np.full(61, 0.2), np.full(61, 0.8)])
    mixed = mix_paints(pair)
    # Kubelka and Munk: K/S of 0.2 is 1.6, of 0.8 is 0.025.
    ratio = (1.6 + 0.025) / 2
    assert np.allclose(mixed, 1 + ratio - np.sqrt(ratio**2 + 2 * ratio))
    assert np.allclose(mix_paints(pair[[0, 0]]), 0.2)
    assert len(mix_paints(np.tile(patches(), (5, 1)))) <= 600


def test_anchors_of_one_matrix_are_that_matrix():
    rng = np.random.default_rng(3)
    matrix, anchors = rng.normal(size=(6, 4)), rng.normal(size=(7, 6))
    anchors /= np.linalg.norm(anchors, axis=1, keepdims=True)
    scale = rng.uniform(0.5, 2.0, 6)
    maps = np.broadcast_to(matrix, (3, 7, 6, 4)).copy()
    mapping = LocalMapping(scale, anchors, 0.2, np.array([-9.0, -2.0]), 5.0, maps)
    response = rng.normal(size=(50, 6))
    for variance in (None, rng.uniform(0, 1, (50, 6))):
        out = np.empty((50, 4))
        mapping.weights(response, variance, out)
        # Shares under 1e-7 are left out.
        assert np.allclose(out, (response / scale) @ matrix, atol=1e-5)


def test_monomials_and_their_slopes_are_those_of_the_compiled_loop():
    rng = np.random.default_rng(4)
    response = rng.uniform(-0.2, 1.0, (40, 6))
    values, slopes = monomials(response)
    assert values.shape == (40, 83)
    mapping, out = PolynomialMapping(np.ones(6), np.eye(83)), np.empty((40, 83))
    mapping.weights(response, None, out)
    assert np.allclose(out, values, atol=1e-12)
    for band in range(6):
        step = 1e-6 * np.eye(6)[band]
        difference = (monomials(response + step)[0] - monomials(response - step)[0]) / 2e-6
        assert np.abs(slopes[:, :, band] - difference).max() <= 1e-6
    # Euler: a function of degree one is its slopes times its argument.
    assert np.allclose(np.einsum("nfb,nb->nf", slopes, response), values, atol=1e-12)


# ---- uncertainty


@pytest.mark.parametrize("name", NAMES)
def test_noise_goes_into_the_covariance_as_repeated_photographs_scatter(solved, name):
    rng, response = np.random.default_rng(5), PROBES[::5] @ system().T
    variance = np.broadcast_to((0.002 * rng.uniform(0.5, 1.5, 6)) ** 2, response.shape)
    runs = response + np.sqrt(variance) * rng.standard_normal((4000, *response.shape))
    found = solved[name].spectra(runs).std(axis=0)[:, ::4]
    posterior = Posterior(solved[name])
    noisy, quiet = (posterior.of(response, v).standard_deviation for v in (variance, None))
    stated = np.sqrt(np.maximum(noisy.astype(float) ** 2 - quiet.astype(float) ** 2, 0.0))
    rms = [np.sqrt(np.mean(values**2, axis=1)) for values in (stated, found)]
    assert np.abs(rms[0] / rms[1] - 1.0).max() <= 0.1


def roots(posterior: Posterior, response: np.ndarray, variance: np.ndarray | None = None) -> np.ndarray:
    """Return square roots of the covariances of reflectances, (n, 16, r)."""
    count, wavelengths = len(response), len(ERROR_NM)
    sizes = (count, wavelengths), count, count, (count, wavelengths, RANK + response.shape[1])
    errors = Errors(*(np.empty(size, np.float32) for size in sizes))
    posterior.fill(response, variance, False, errors)
    return errors.root


@pytest.mark.parametrize("name", NAMES)
def test_twice_the_light_gives_twice_the_standard_deviation_and_a_covariance_that_is_its_factor(solved, name):
    response = PROBES @ system().T
    variance = np.full(response.shape, 1e-6)
    posterior = Posterior(solved[name])
    found, twice = posterior.of(response, variance), posterior.of(2.0 * response, 4.0 * variance)
    assert np.allclose(twice.standard_deviation, 2.0 * found.standard_deviation, rtol=1e-3)
    root = roots(posterior, response, variance).astype(float)
    assert np.allclose((root**2).sum(axis=2), found.standard_deviation.astype(float) ** 2, rtol=1e-4)


def whole(root: np.ndarray) -> np.ndarray:
    """Return factors of covariances (n, 16, r) at all wavelengths, (n, 61, r)."""
    return PchipInterpolator(ERROR_NM, root.astype(float), axis=1)(WAVELENGTH_NM)


def test_what_the_bands_see_is_not_in_the_covariance(solved):
    # Without noise the responses are explained up to what the chart leaves open of the camera; the spectra are not.
    root = roots(Posterior(solved["wiener"]), PROBES @ system().T)
    root = whole(root)
    seen = np.sqrt(np.mean(np.einsum("bw,nwr->nbr", system(), root) ** 2 * root.shape[2]))
    narrow = np.eye(61)[10:51:10]  # single wavelengths weigh as much as a band does
    assert seen <= 0.2 * np.sqrt(np.mean(np.einsum("bw,nwr->nbr", narrow, root) ** 2 * root.shape[2]))


def test_the_colour_error_is_the_quantile_of_draws_from_the_covariance(solved):
    response, rng = PROBES @ system().T, np.random.default_rng(3)
    variance = np.full(response.shape, 1e-6)
    posterior = Posterior(solved["wiener"])
    root = whole(roots(posterior, response, variance))
    spectra = solved["wiener"].spectra(response)
    drawn = spectra + np.einsum("nwr,dnr->dnw", root, rng.standard_normal((3000, len(root), root.shape[2])))
    within = (
        delta_e_reflectance(np.broadcast_to(spectra, drawn.shape), drawn) <= posterior.of(response, variance).delta_e
    )
    assert np.abs(within.mean(axis=0) - 0.683).max() <= 0.05


def test_a_posterior_leaves_the_matrix_to_xyz_that_others_use_as_it_is(solved):
    Posterior(solved["wiener"])
    assert abs(xyz_from_reflectance("D65")[1].sum() - 100.0) <= 1e-9  # Y of a perfect diffuser


def test_no_number_is_stated_where_there_is_none(solved):
    response, posterior = PROBES[:3] @ system().T, Posterior(solved["local"])
    variance = np.full(response.shape, 1e-6)
    response[1, 2], variance[2, 0] = np.nan, -1e-9
    found = posterior.of(response, variance, stated=True)
    assert np.isfinite(found.standard_deviation[0]).all() and np.isfinite(found.delta_e[0])
    assert np.isnan(found.standard_deviation[1:]).all() and np.isnan(found.delta_e[1:]).all()
    black = posterior.of(np.zeros((1, 6)), np.full((1, 6), 1e-6))
    assert np.isfinite(black.delta_e).all() and (black.standard_deviation > 0).all()
    with pytest.raises(ValueError, match="without a response model"):
        Posterior(replace(solved["local"], band_response=None))


def test_an_error_that_bands_share_goes_into_the_covariance_as_cameras_drawn_from_it_scatter(solved):
    """An error common to all bands scales the spectrum; one that is opposite in two bands tilts it."""
    rng, response = np.random.default_rng(8), PROBES[::8] @ system().T
    shape = np.exp(-0.5 * ((WAVELENGTH_NM - np.array([[450.0], [550.0], [640.0]])) / 40.0) ** 2)
    errors = rng.normal(0.0, 0.02, (3, 6, 1)) * shape[:, None] * system().max()
    calibration = replace(solved["pinv"], band_response_covariance=np.einsum("kbi,kcj->bicj", errors, errors))
    exact = replace(calibration, band_response_covariance=np.zeros((6, 61, 6, 61)))
    stated, without = (roots(Posterior(one), response).astype(float) for one in (calibration, exact))
    spectra = calibration.spectra(response)
    drawn = np.einsum("dk,kbw,nw->dnb", rng.standard_normal((4000, 3)), errors, spectra)
    recovered = (drawn @ calibration.weights_from_response @ calibration.basis.T)[..., ::4]
    found = np.einsum("dni,dnj->nij", recovered, recovered) / len(recovered)
    added = stated @ stated.swapaxes(1, 2) - without @ without.swapaxes(1, 2)
    scale = np.abs(found).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(added / scale, found / scale, atol=0.1)


# ---- files


@pytest.mark.parametrize("name", NAMES)
def test_a_calibration_survives_its_file(solved, name, tmp_path):
    calibration = replace(solved[name], filters=("out", "in"))
    with store.create(tmp_path / "c.h5", store.Provenance("test")) as out:
        calibration.write(out)
    loaded = Calibration.load(tmp_path / "c.h5")
    assert (loaded.estimator, loaded.filters) == (name, ("out", "in"))
    response = PROBES @ system().T
    variance = np.full(6, 1e-5)
    assert np.array_equal(loaded.weights(response, variance), calibration.weights(response, variance))
    own, written = (Posterior(one).of(response, variance).standard_deviation for one in (loaded, calibration))
    assert np.array_equal(own, written)
    assert (loaded.weights_from_response is None) == (name in ("local", "kernel", "broad"))


def test_a_file_of_an_earlier_version_that_knows_each_band_alone_is_refused(solved, tmp_path):
    each = np.einsum("blbm->blm", solved["pinv"].band_response_covariance)
    with store.create(tmp_path / "new.h5", store.Provenance("test")) as out:
        solved["pinv"].write(out)
    with (
        store.open_file(tmp_path / "new.h5") as file,
        store.create(tmp_path / "old.h5", store.Provenance("test")) as out,
    ):
        write_wavelength(out)
        for name in ("basis", "weights_from_response", "light", "band_response"):
            dims = file.dataset(name).attrs["dims"]
            out.write(name, file.read(name), units="1", dims=dims, quantity=name)
        dims = "band,wavelength,other_wavelength"
        out.write("band_response_covariance", each, units="1", dims=dims, quantity="covariance")
        out.attribute("filters", [])
    with pytest.raises(InputError, match="band_response_covariance: found 3 axes; accepted: 4"):
        Calibration.load(tmp_path / "old.h5")


def test_pinv_of_the_registry_is_the_printed_formula():
    chart = training(0.003)
    printed = calibrate(chart.response, chart.spectra, 6, LIGHT)
    assert np.array_equal(fit("pinv", chart, 6).weights_from_response, printed.weights_from_response)
    mapping = ESTIMATORS["pinv"](chart).on_basis(printed.basis)
    assert isinstance(mapping, LinearMapping)
    assert np.allclose(mapping.matrix, printed.weights_from_response, rtol=1e-8, atol=1e-9)
