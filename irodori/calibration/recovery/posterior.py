"""Posterior covariance of recovered reflectances: what the chart, the bands and the noise leave open in a spectrum.

A camera of six bands does not see most of a spectrum. What it misses is taken as a smooth Gaussian process K whose size
follows the spectrum that was recovered: one that varies much varies more than the bands show, above all where it is
steep, and at the ends of the range, which cameras hardly see. An estimator of the derivative J, with the camera's
response H per unit reflectance, is then off by

    Σ = (1 - J H) K (1 - J H)ᵀ + J (V + U) Jᵀ

where V is the variance of the response and U what the chart leaves open of H. This holds for every estimator, since all
are homogeneous of degree 1. The constants of K were taken from measured reflectances of several sets;
`docs/method/calibration.md` says how the statements hold on a set that had no part in that.
"""

from dataclasses import dataclass

import numpy as np

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.response_model import smooth_covariance
from irodori.colour.colorimetry import delta_e, lab_from_xyz, xyz_from_reflectance
from irodori.spectra.grid import SAMPLES, WAVELENGTH_NM

#: Correlation length of what the bands miss, nm.
_LENGTH_NM = 25.0
#: At the ends of the range what is missed is so many times larger, and over so many nm.
_ENDS, _REACH_NM = 1.8, (15.0, 30.0)
_RANK = 24  # of the covariance; what is beyond has under 1e-3 of the variance
#: Shares of the variance of what the bands miss in the squared level, in the mean squared slope, and in that nearby.
_LEVEL, _SLOPE, _NEARBY = 5e-4, 3e-3, 0.1
#: What the bands miss is multiplied with this, the size that six measured sets ask for on average.
SIZE = 0.81
_SLOPE_NM, _NEAR_NM = 50.0, 30.0  # what a slope is over, and how far nearby reaches
_BATCH = 2048  # responses whose factors of (61, 30) numbers are held at a time
_STEP = 1e-2  # of CIELAB, in which CIEDE2000 is taken as a quadratic form
#: 0.6827 of the normal distribution lie below so many of its standard deviations.
_WITHIN_ONE = 0.4752


@dataclass(frozen=True)
class Uncertainty:
    """What is unknown of recovered reflectances.

    Parameters
    ----------
    standard_deviation : (..., 61) float32
        Of the reflectance factor at each wavelength; NaN where the response or its variance is none.
    delta_e : (...) float32
        CIEDE2000 to the true colour under D65 that is not exceeded with a probability of 0.68.
    """

    standard_deviation: np.ndarray
    delta_e: np.ndarray


class Posterior:
    """Posterior covariance of what a calibration recovers.

    Parameters
    ----------
    calibration : Calibration
    size : float
        Of what the bands miss.

    Raises
    ------
    ValueError
        If the calibration carries no response model.
    """

    def __init__(self, calibration: Calibration, size: float = SIZE) -> None:
        if calibration.band_response is None or calibration.band_response_covariance is None:
            raise ValueError("a calibration without a response model; accepted: one that an estimator was fitted for")
        self.calibration = calibration
        self._basis = calibration.basis.astype(np.float32)
        self._system = calibration.band_response.astype(np.float32)
        self._missed = (size * _missed()).astype(np.float32)
        near = smooth_covariance(_NEAR_NM)
        self._near = (near / near.sum(axis=1, keepdims=True)).T
        basis, open_part = calibration.basis, calibration.band_response_covariance
        self._open = np.einsum("wk,bwv,vl->bkl", basis, open_part, basis)
        self._xyz = xyz_from_reflectance("D65")

    def factor(self, response: np.ndarray, variance: np.ndarray | None = None, stated: bool = False) -> np.ndarray:
        """Return matrices Z whose Z Zᵀ are the covariances Σ of recovered reflectances.

        Parameters
        ----------
        response : (n, bands) float
        variance : (n, bands) float, optional
            Of the response; where absent, there is no noise.
        stated : bool
            Whether the calibration is told the variance as it recovers spectra.

        Returns
        -------
        (n, 61, 24 + bands) float32; NaN where the response is not finite or its variance not 0 or more
        """
        response = np.asarray(response, dtype=np.float64)
        variance = np.zeros_like(response) if variance is None else np.asarray(variance, dtype=np.float64)
        variance = np.where(variance >= 0.0, variance, np.nan)
        told = variance if stated else None
        weights = self.calibration.weights(response, told)
        slopes = self.calibration.mapping.slopes(response, told).astype(np.float32)
        spectrum = weights @ self.calibration.basis.T
        squared = np.mean(spectrum**2, axis=1, keepdims=True)
        slope = (np.gradient(spectrum, WAVELENGTH_NM, axis=1) * _SLOPE_NM) ** 2
        size = np.sqrt(_LEVEL * squared + _SLOPE * slope.mean(axis=1, keepdims=True) + _NEARBY * slope @ self._near)
        missed = size[:, :, None].astype(np.float32) * self._missed
        unsure = np.stack([np.einsum("nk,kl,nl->n", weights, own, weights) for own in self._open], axis=1)
        spread = np.sqrt(variance + np.maximum(unsure, 0.0))
        back = np.swapaxes(slopes, 1, 2)
        seen = self._basis @ (back @ (self._system @ missed))
        noise = self._basis @ (back * spread[:, None, :].astype(np.float32))
        return np.concatenate([missed - seen, noise], axis=2)

    def of(self, response: np.ndarray, variance: np.ndarray | None = None, stated: bool = False) -> Uncertainty:
        """Return what is unknown of the reflectances of responses (..., bands); see `factor`."""
        response = np.asarray(response, dtype=np.float64)
        flat = response.reshape(-1, response.shape[-1])
        noise = None if variance is None else np.broadcast_to(variance, response.shape).reshape(flat.shape)
        deviation, colour = np.empty((len(flat), SAMPLES), np.float32), np.empty(len(flat), np.float32)
        for first in range(0, len(flat), _BATCH):
            part = slice(first, first + _BATCH)
            own = None if noise is None else noise[part]
            root = self.factor(flat[part], own, stated)
            deviation[part] = np.sqrt(np.vecdot(root, root))
            spectrum = self.calibration.spectra(flat[part], own if stated else None)
            colour[part] = _delta_e(spectrum @ self._xyz.T, self._xyz.astype(np.float32) @ root, self._xyz.sum(axis=1))
        return Uncertainty(deviation.reshape(*response.shape[:-1], SAMPLES), colour.reshape(response.shape[:-1]))


def _missed() -> np.ndarray:
    """Return a matrix (61, 24) whose product with its transpose is K for a spectrum of unit size."""
    away = np.abs(WAVELENGTH_NM - WAVELENGTH_NM[[0, -1], None])
    ends = _ENDS * np.exp(-away / np.array(_REACH_NM)[:, None]).sum(axis=0)
    smooth = smooth_covariance(_LENGTH_NM)
    values, vectors = np.linalg.eigh(smooth + ends[:, None] * smooth * ends)
    return vectors[:, -_RANK:] * np.sqrt(values[-_RANK:])


def _delta_e(xyz: np.ndarray, root: np.ndarray, white: np.ndarray) -> np.ndarray:
    """Return the CIEDE2000 that normal errors of XYZ do not exceed with a probability of 0.68, (n,).

    About a colour the square of CIEDE2000 is a quadratic form of the errors. Its quantile is that of the multiple of a
    χ² variable of the same mean and variance (Satterthwaite 1946), by the cube root (Wilson and Hilferty 1931).

    Parameters
    ----------
    xyz : (n, 3) float
    root : (n, 3, r) float
        Matrices whose products with their transposes are the covariances of XYZ.
    white : (3,) float
    """
    lab = lab_from_xyz(xyz, white)
    form = np.empty((len(lab), 3, 3))
    steps = _STEP * np.eye(3)
    for i in range(3):
        form[:, i, i] = (delta_e(lab, lab + steps[i]) / _STEP) ** 2
    for i, j in ((0, 1), (0, 2), (1, 2)):
        both = (delta_e(lab, lab + steps[i] + steps[j]) / _STEP) ** 2
        form[:, i, j] = form[:, j, i] = 0.5 * (both - form[:, i, i] - form[:, j, j])
    moved = _lab_slopes(xyz / white) @ (root / white[:, None])
    product = form @ moved @ np.swapaxes(moved, 1, 2)
    mean = np.trace(product, axis1=1, axis2=2)
    square = np.trace(product @ product, axis1=1, axis2=2)
    relative = np.divide(2.0 * square, 9.0 * mean**2, out=np.zeros_like(mean), where=mean > 0.0)
    return np.sqrt(mean * (1.0 - relative + _WITHIN_ONE * np.sqrt(relative)) ** 3)


def _lab_slopes(ratio: np.ndarray) -> np.ndarray:
    """Return the derivatives of CIELAB by XYZ over the white, (n, 3, 3), at such ratios (n, 3)."""
    linear = ratio <= (6 / 29) ** 3
    x, y, z = np.where(linear, (29 / 6) ** 2 / 3, np.where(linear, 1.0, ratio) ** (-2.0 / 3.0) / 3.0).T
    none = np.zeros_like(x)
    rows = [[none, 116.0 * y, none], [500.0 * x, -500.0 * y, none], [none, 200.0 * y, -200.0 * z]]
    return np.moveaxis(np.array(rows), -1, 0)
