"""Accuracy of cameras' response models from a chart, with and without a table of the filter or of the sensitivities.

``python -m benchmarks.calibrate --response-models`` prints the errors of the bands and how often they lie within the
stated errors, for cameras and filters in ``../shared/data`` on which no constant was chosen. Every filter's table has
the errors of a data sheet: shifted by about 1.5 nm, blurred, with a level error of 7 % and smooth waves of 1 %. Given
sensitivities have a smooth error of 10 %.
"""

import itertools
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from irodori.calibration.best_response import BestResponse, CameraSensitivities, Given, best_response
from irodori.calibration.filter_table import FilterTable
from irodori.calibration.response_model import fit_response_model, smooth_covariance, smooth_priors
from irodori.calibration.sensitivity_prior import of_independent_bands
from irodori.calibration.simulated_responses import band_weights
from irodori.spectra.published import camera_sensitivities, chart_spectra, spectrum
from irodori.spectra.resampling import resample
from irodori.spectra.tables import wide_table

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
#: The D5100 is not among them: colour-science publishes the same measurement, which constants were chosen with.
CAMERAS = ("canon_eos_40d", "canon_eos_5d_mark_ii", "nikon_d700", "sony_ilce-7rm2")
FILTERS = ("Schott_BG36", "MIDOPT_TB475_550_850", "MIDOPT_TB550_660_850", "MIDOPT_NF550")
NOISES = (0.0, 0.001, 0.01)
CHART, LIGHT = "BabelColor Average", "A"
_SENSITIVITY_ERROR = 0.1


@dataclass(frozen=True)
class Wrong:
    """Errors of a table of a filter; ``of`` draws random errors as in a data sheet.

    Parameters
    ----------
    shift_nm, blur_nm2, level, wave : float
        Shift of the filter towards longer wavelengths relative to its table; variance of the table's blur; relative
        level of the table; relative standard deviation of its smooth waves over 25 nm.
    """

    shift_nm: float = 0.0
    blur_nm2: float = 0.0
    level: float = 1.0
    wave: float = 0.01

    @classmethod
    def of(cls, seed: int) -> "Wrong":
        """Return random errors of the size that is typical of a data sheet."""
        shift, blur, level = np.random.default_rng(seed).standard_normal(3)
        return cls(1.5 * shift, 2.0 * abs(blur), float(np.exp(0.07 * level)))

    def table(self, wavelength_nm: np.ndarray, transmittance: np.ndarray, seed: int = 0) -> FilterTable:
        """Return the table, with these errors, of a filter with the given true transmittance."""
        # Beyond its measured range, the filter's transmittance is taken to be constant.
        curve = [np.interp(wavelength_nm + self.shift_nm + s, wavelength_nm, transmittance) for s in (-2.0, 0.0, 2.0)]
        blurred = curve[1] + self.blur_nm2 * (curve[0] + curve[2] - 2.0 * curve[1]) / 8.0
        distance = (wavelength_nm[:, None] - wavelength_nm) / 25.0
        draw = np.random.default_rng(seed).multivariate_normal
        wave = draw(np.zeros(len(distance)), np.exp(-0.5 * distance**2), method="eigh")
        return FilterTable(wavelength_nm, np.clip(self.level * blurred * (1.0 + self.wave * wave), 0.0, 1.0))


@cache
def published_filter(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return wavelengths, nm, and transmittances of a measured filter."""
    names, wavelengths, values = wide_table(DATA / "filters/filters.csv")
    return np.array(wavelengths), np.clip(np.array(values[names.index(name)]), 0.0, 1.0)


@cache
def sensitivities(camera: str) -> np.ndarray:
    """Return the sensitivities of a camera in the measured data or in colour-science, (3, 61)."""
    file = DATA / f"cameras/{camera}.csv"
    return camera_sensitivities(str(file) if file.exists() else camera)


@dataclass(frozen=True)
class Trial:
    """A simulated camera with a filter, which photographs a chart with noise.

    Parameters
    ----------
    sensitivities : (3, 61) float64
    transmittance : (61,) float64
        Transmittance of the filter.
    noise : float
        Standard deviation of a patch's mean, relative to the root mean square over the patches.
    """

    sensitivities: np.ndarray
    transmittance: np.ndarray
    noise: float
    seed: int = 0
    light: np.ndarray = field(default_factory=lambda: spectrum(LIGHT))

    def chart(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return responses (24, 6), reflectances, variances (6,) and the true response model (6, 61), each band scaled.

        Every band is divided by its largest patch, as training does.
        """
        spectra = chart_spectra(CHART)[1]
        true = band_weights(self.sensitivities, self.light, self.transmittance)
        response = spectra @ true.T
        spread = self.noise * np.sqrt(np.mean(response**2, axis=0))
        response = response + spread * np.random.default_rng(self.seed).standard_normal(response.shape)
        scale = np.abs(response).max(axis=0)
        return response / scale, spectra, (spread / scale) ** 2, true / scale[:, None]

    def found(self, given: Given) -> tuple[BestResponse, np.ndarray]:
        """Return the response model estimated from the chart and given tables, and the true one."""
        response, spectra, variance, true = self.chart()
        return best_response(response, spectra, self.light, variance, given), true


def trial(camera: str, name: str, noise: float, seed: int = 0) -> Trial:
    """Return the trial of a camera with a filter in the measured data.

    A photograph integrates over wavelengths: the finely sampled transmittance is averaged around each of the 61.
    """
    return Trial(sensitivities(camera), resample(*published_filter(name), name, method="average"), noise, seed)


def judged_trial(camera: str, name: str, noise: float = 0.001, seed: int = 0) -> tuple[Trial, FilterTable]:
    """Return the trial of a camera with a filter, and a table of this filter with the errors of a data sheet."""
    return trial(camera, name, noise, seed), Wrong.of(seed).table(*published_filter(name), seed)


def given_sensitivities(true: np.ndarray, error: float = _SENSITIVITY_ERROR, seed: int = 0) -> CameraSensitivities:
    """Return sensitivities with a smooth relative error with a correlation length of 30 nm."""
    draw = np.random.default_rng(seed).multivariate_normal
    off = draw(np.zeros(true.shape[1]), smooth_covariance(30.0), size=len(true), method="eigh")
    return CameraSensitivities(np.maximum(true * (1.0 + error * off), 0.0), error)


def errors(mean: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return the relative root-mean-square error of each band, (bands,)."""
    return np.linalg.norm(mean - true, axis=1) / np.linalg.norm(true, axis=1)


def shares(mean: np.ndarray, covariance: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Return the shares of errors, over wavelengths and bands, within one and two stated standard deviations."""
    ratio = np.abs(mean - true) / np.sqrt(np.maximum(np.einsum("blbl->bl", covariance), 1e-300))
    return float(np.mean(ratio <= 1.0)), float(np.mean(ratio <= 2.0))


WAYS = ("smooth", "chart", "sensitivities", "filter", "filter and sensitivities")


def judged(way: str, noise: float, cameras=CAMERAS, filters=FILTERS) -> tuple[float, float, float, float]:
    """Return mean errors of the bands without and with the filter, and mean shares of errors within one and two σ.

    ``way`` names the given tables; ``smooth`` is the response model with which the estimators are trained.
    """
    rows = []
    for seed, (camera, name) in enumerate(itertools.product(cameras, filters)):
        own, sheet = judged_trial(camera, name, noise, seed)
        if way == "smooth":
            response, spectra, variance, true = own.chart()
            smooth = fit_response_model(response, smooth_priors(spectra, own.light), variance)
            mean, covariance = smooth.mean, of_independent_bands(smooth.covariance)
        else:
            table = sheet if "filter" in way else None
            known = given_sensitivities(own.sensitivities, seed=seed) if "sensitivities" in way else None
            best, true = own.found(Given(table, known))
            mean, covariance = best.mean, best.covariance
        off = errors(mean, true)
        rows.append((off[:3].mean(), off[3:].mean(), *shares(mean, covariance, true)))
    return tuple(np.mean(rows, axis=0).tolist())


def print_response_models(cameras=CAMERAS, filters=FILTERS) -> None:
    """Print errors and shares for all combinations of given tables and noise levels."""
    print(f"{'given':26}{'noise':>7}{'without':>9}{'with':>7}{'1 σ':>6}{'2 σ':>6}")
    for way, noise in itertools.product(WAYS, NOISES):
        plain, filtered, one, two = judged(way, noise, cameras, filters)
        print(f"{way:26}{noise:7.1%}{plain:9.1%}{filtered:7.1%}{one:6.2f}{two:6.2f}", flush=True)
