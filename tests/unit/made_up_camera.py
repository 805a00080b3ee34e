"""A chart through a made-up camera of six bands, for the tests of the estimators."""

from functools import lru_cache

import numpy as np

from irodori.calibration.conditioning import check_brightest, check_responses
from irodori.calibration.estimators import fit
from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.training import ResponseNoise, Training
from irodori.spectra.grid import TRAPEZOID_NM, WAVELENGTH_NM
from irodori.spectra.published import chart_spectra, spectrum

LIGHT = spectrum("A")


@lru_cache(maxsize=1)
def patches() -> np.ndarray:
    """Return the spectra of a published chart, (24, 61)."""
    return chart_spectra("BabelColor Average")[1]


@lru_cache(maxsize=1)
def system() -> np.ndarray:
    """Return responses per unit reflectance, (6, 61): three bells, and the same behind a plate with a notch."""
    bells = np.stack([np.exp(-0.5 * ((WAVELENGTH_NM - centre) / width) ** 2) for centre, width in
                      ((605.0, 35.0), (540.0, 38.0), (455.0, 26.0))])  # fmt: skip
    notch = 1.0 - 0.95 * np.exp(-0.5 * ((WAVELENGTH_NM - 560.0) / 28.0) ** 2)
    whole = np.concatenate([bells, bells * notch]) * LIGHT * TRAPEZOID_NM
    return whole / whole.sum(axis=1, keepdims=True)


def training(noise: float = 0.0, seed: int = 0, known: bool = True, patch_share: float = 0.1) -> Training:
    """Return the chart as seen with noise, a share of it on the patch means."""
    rng = np.random.default_rng(seed)
    response = patches() @ system().T
    response = response + patch_share * noise * rng.standard_normal(response.shape)
    variance = np.full(6, noise**2)
    return Training(
        response, patches(), LIGHT, ResponseNoise(patch_share**2 * variance, variance) if known else ResponseNoise()
    )


def checked_fit(name: str, chart: Training, bases: int) -> Calibration:
    """Return a calibration by an estimator, or refuse the chart, as the stage does."""
    check_responses(chart.response, patch_variance=chart.noise.patch)
    check_brightest(chart)
    return fit(name, chart, bases)
