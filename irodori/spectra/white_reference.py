"""Reflectance factor of a white reference in each camera band."""

import numpy as np

from irodori.core.errors import InputError
from irodori.spectra.grid import TRAPEZOID_NM
from irodori.spectra.published import spectrum
from irodori.spectra.spectral_files import REFLECTANCE


def white_reflectance(definition: float | str, weights: np.ndarray | None = None) -> tuple[np.ndarray, float]:
    """Return the reflectance factor of a white reference in each camera band, and its relative uncertainty.

    Parameters
    ----------
    definition : float or str
        The reflectance factor itself, or a measured spectrum of it: ``TCS<n>`` or the path of a file.
    weights : (bands, 61) float, optional
        Sensitivity times light times wavelength step of each band, in any scale. They are known on the virtual rig, and
        on a real one if the camera's sensitivities were measured.

    Returns
    -------
    factor : (bands,) float64, or () without `weights`
        With weights, the exact mean of the spectrum as weighted by each band [eq. 1]. Without them, the position of a
        band in the spectrum is unknown, and the factor is the mean over 400..700 nm, the same for all bands.
    relative_uncertainty : float
        Standard deviation of the spectrum over 400..700 nm, relative to its mean. It is the standard uncertainty of the
        factor for a narrow band at an unknown wavelength, an upper estimate for the broad bands of a camera. 0 with
        weights or for a single number.

    Raises
    ------
    InputError
        For a spectrum that cannot be read, or with values that no white has: 0 and below, or over 1.2.
    """
    if not isinstance(definition, str):
        count = () if weights is None else np.shape(weights)[0]
        return np.full(count, float(definition)), 0.0
    reflectance = spectrum(definition)
    if reflectance.min() <= 0.0 or reflectance.max() > REFLECTANCE[1]:
        found = f"values from {reflectance.min():g} to {reflectance.max():g}"
        raise InputError(definition, "", found, f"reflectance factors above 0, up to {REFLECTANCE[1]:g}, not percent")
    if weights is not None:
        weights = np.asarray(weights, dtype=np.float64)
        return weights @ reflectance / weights.sum(axis=1), 0.0
    share = TRAPEZOID_NM / TRAPEZOID_NM.sum()
    mean = share @ reflectance
    return np.asarray(mean), float(np.sqrt(share @ (reflectance - mean) ** 2) / mean)
