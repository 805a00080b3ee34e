"""Posterior covariance of recovered reflectances: the uncertainty that chart, bands and noise leave in a spectrum.

Six bands do not determine a spectrum. The part that they miss is modelled as a smooth Gaussian process with the
covariance K. Its size depends on the recovered spectrum: it is larger for a spectrum that varies much, above all where
it is steep, and at the ends of the range, where cameras are hardly sensitive. For an estimator with the derivative J
and a camera with the response H per unit reflectance, the covariance of the error is

    Σ = (1 - J H) K (1 - J H)ᵀ + J (V + U) Jᵀ

where V is the variance of the response and U the variance of the response due to the uncertainty of H. This holds for
every estimator, since all are homogeneous of degree 1. The constants of K were taken from several sets of measured
reflectances; `docs/method/calibration.md` compares predicted and actual errors on a set that was not used for this.
"""

from dataclasses import dataclass

import numpy as np

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.response_model import smooth_covariance
from irodori.colour.colorimetry import delta_e_metric, lab_from_xyz, xyz_from_reflectance
from irodori.jit.chunks import run_chunks
from irodori.spectra.grid import SAMPLES, WAVELENGTH_NM

#: Correlation length of the part of a spectrum that the bands miss, nm.
_LENGTH_NM = 25.0
#: Relative size of an additional missed part at both ends of the range, and the lengths of its decay, nm.
_ENDS, _REACH_NM = 1.8, (15.0, 30.0)
_RANK = 24  # of the covariance; what is beyond has under 1e-3 of the variance
#: Coefficients of the missed part's variance: of the squared level, of the mean squared slope, and of the local one.
_LEVEL, _SLOPE, _NEARBY = 5e-4, 3e-3, 0.1
#: Factor of the missed part: the mean of those that fit six measured sets.
SIZE = 0.81
_SLOPE_NM, _NEAR_NM = 50.0, 30.0  # interval of a slope, and width of the local mean
_STRIDE = 4  # of the grid, between wavelengths at which errors are stated, closer than their correlation length
#: Wavelengths, nm, at which errors are stated.
ERROR_NM = WAVELENGTH_NM[::_STRIDE]
_BATCH = 2048  # responses whose factors of (16, 30) numbers are held at a time
#: 0.6827 of the normal distribution lie below so many of its standard deviations.
_WITHIN_ONE = 0.4752


@dataclass(frozen=True)
class Uncertainty:
    """Errors of recovered reflectances.

    Parameters
    ----------
    standard_deviation : (..., 16) float32
        Standard deviation of the reflectance factor at each of `ERROR_NM`; NaN for an invalid response or variance.
    rms : (...) float32
        Root mean square of the standard deviation over the wavelengths.
    delta_e : (...) float32
        CIEDE2000 to the true colour under D65 that is not exceeded with a probability of 0.68.
    """

    standard_deviation: np.ndarray
    rms: np.ndarray
    delta_e: np.ndarray


class Posterior:
    """Posterior covariance of the reflectances that a calibration recovers.

    Parameters
    ----------
    calibration : Calibration
    size : float
        Factor of the part of a spectrum that the bands miss.

    Raises
    ------
    ValueError
        If the calibration carries no response model.
    """

    def __init__(self, calibration: Calibration, size: float = SIZE) -> None:
        system, open_part = calibration.band_response, calibration.band_response_covariance
        if system is None or open_part is None:
            raise ValueError("a calibration without a response model; accepted: one that an estimator was fitted for")
        self.calibration = calibration
        self._basis = calibration.basis[::_STRIDE].astype(np.float32)
        missed, xyz = size * _missed(), xyz_from_reflectance("D65")
        # The size of the missed part is linear between the wavelengths at which errors are stated.
        self._hat = np.stack([np.interp(WAVELENGTH_NM, ERROR_NM, row) for row in np.eye(len(ERROR_NM))])
        self._missed = missed[::_STRIDE].astype(np.float32)
        self._seen, self._coloured = (
            np.einsum("bw,ew,wr->ebr", rows, self._hat, missed).astype(np.float32) for rows in (system, xyz)
        )
        self._xyz_basis = (xyz @ calibration.basis).astype(np.float32)
        self._white = xyz.sum(axis=1)
        near = smooth_covariance(_NEAR_NM)
        self._near = (near / near.sum(axis=1, keepdims=True))[::_STRIDE].T
        # Of every pair of bands once, since it is symmetric.
        of_pairs = np.einsum("wk,bwcv,vl->bckl", calibration.basis, open_part, calibration.basis, optimize=True)
        self._pairs = np.tril_indices(len(system))
        self._open = of_pairs[self._pairs].reshape(len(self._pairs[0]), -1).T

    def of(self, response: np.ndarray, variance: np.ndarray | None = None, stated: bool = False) -> Uncertainty:
        """Return the uncertainty of recovered reflectances.

        Parameters
        ----------
        response : (..., bands) float
        variance : (..., bands) float, optional
            Variance of the response; zero if absent.
        stated : bool
            Whether the calibration uses the variance when it recovers spectra.
        """
        response = np.asarray(response, dtype=np.float64)
        flat, shape = response.reshape(-1, response.shape[-1]), response.shape[:-1]
        noise = None if variance is None else np.broadcast_to(variance, response.shape).reshape(flat.shape)
        deviation, colour = np.empty((len(flat), len(ERROR_NM)), np.float32), np.empty(len(flat), np.float32)

        def fill(first: int, last: int) -> None:
            part = slice(first, last)
            weights, root, xyz_root = self._roots(flat[part], None if noise is None else noise[part], stated)
            deviation[part] = np.sqrt(np.vecdot(root, root))
            colour[part] = _delta_e(weights @ self._xyz_basis.T, xyz_root, self._white)

        run_chunks(fill, len(flat), _BATCH)
        rms = np.sqrt(deviation**2 @ (self._hat.sum(axis=1) / SAMPLES).astype(np.float32))
        return Uncertainty(deviation.reshape(*shape, -1), rms.reshape(shape), colour.reshape(shape))

    def _roots(self, response: np.ndarray, variance, stated: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the weights (n, k) of responses, and square roots of the covariances of reflectance and of XYZ.

        Each covariance Σ = Z Zᵀ; Z is (n, 16, 24 + bands), at `ERROR_NM`, and (n, 3, 24 + bands).
        """
        variance = np.zeros_like(response) if variance is None else np.asarray(variance, dtype=np.float64)
        variance = np.where(variance >= 0.0, variance, np.nan)
        told = variance if stated else None
        weights = self.calibration.weights(response, told)
        back = np.swapaxes(self.calibration.mapping.slopes(response, told), 1, 2).astype(np.float32)
        spectrum = weights @ self.calibration.basis.T
        squared = np.mean(spectrum**2, axis=1, keepdims=True)
        slope = (np.gradient(spectrum, WAVELENGTH_NM, axis=1) * _SLOPE_NM) ** 2
        size = np.sqrt(_LEVEL * squared + _SLOPE * slope.mean(axis=1, keepdims=True) + _NEARBY * slope @ self._near)
        size = size.astype(np.float32)
        spread = self._response_roots(weights, variance)
        seen, coloured = (np.tensordot(size, each, axes=1) for each in (self._seen, self._coloured))
        roots = []
        for basis, missed in ((self._basis, size[:, :, None] * self._missed), (self._xyz_basis, coloured)):
            derivative = basis @ back
            roots.append(np.concatenate([missed - derivative @ seen, derivative @ spread], axis=2))
        return weights, roots[0], roots[1]

    def _response_roots(self, weights: np.ndarray, variance: np.ndarray) -> np.ndarray:
        """Return Cholesky factors (n, bands, bands) of V + U: covariances of responses to spectra with weights (n, k).

        A pivot that rounding has made negative counts as zero.
        """
        products = (weights[:, :, None] * weights[:, None, :]).reshape(len(weights), -1) @ self._open
        bands = variance.shape[1]
        root = np.zeros((bands, bands, len(weights)))
        root[self._pairs] = products.T
        root[np.arange(bands), np.arange(bands)] += variance.T
        for band in range(bands):
            rest = root[band:, band] - np.einsum("ikn,kn->in", root[band:, :band], root[band, :band])
            pivot = np.sqrt(np.maximum(rest[0], 0.0))
            root[band:, band] = rest / np.where(pivot == 0.0, np.inf, pivot)
        return np.moveaxis(root, -1, 0).astype(np.float32)


def _missed() -> np.ndarray:
    """Return a square root (61, 24) of the covariance K of a missed part of unit size."""
    away = np.abs(WAVELENGTH_NM - WAVELENGTH_NM[[0, -1], None])
    ends = _ENDS * np.exp(-away / np.array(_REACH_NM)[:, None]).sum(axis=0)
    smooth = smooth_covariance(_LENGTH_NM)
    values, vectors = np.linalg.eigh(smooth + ends[:, None] * smooth * ends)
    return vectors[:, -_RANK:] * np.sqrt(values[-_RANK:])


def _delta_e(xyz: np.ndarray, root: np.ndarray, white: np.ndarray) -> np.ndarray:
    """Return the CIEDE2000 that normal errors of XYZ do not exceed with a probability of 0.68, (n,).

    Near a colour the square of CIEDE2000 is a quadratic form of the errors. It is approximated by a scaled χ² variable
    with the same mean and variance (Satterthwaite 1946); the quantile follows by the cube root (Wilson and Hilferty
    1931).

    Parameters
    ----------
    xyz : (n, 3) float
    root : (n, 3, r) float
        Square roots of the covariances of XYZ: each is the product of a matrix with its transpose.
    white : (3,) float
    """
    form = delta_e_metric(lab_from_xyz(xyz, white))
    moved = _lab_slopes(xyz / white) @ (root / white[:, None])
    product = form @ moved @ np.swapaxes(moved, 1, 2)
    mean = np.trace(product, axis1=1, axis2=2)
    square = np.trace(product @ product, axis1=1, axis2=2)
    relative = np.divide(2.0 * square, 9.0 * mean**2, out=np.zeros_like(mean), where=mean > 0.0)
    return np.sqrt(mean * (1.0 - relative + _WITHIN_ONE * np.sqrt(relative)) ** 3)


def _lab_slopes(ratio: np.ndarray) -> np.ndarray:
    """Return the derivatives of CIELAB with respect to XYZ divided by the white, (n, 3, 3), at such ratios (n, 3)."""
    linear = ratio <= (6 / 29) ** 3
    x, y, z = np.where(linear, (29 / 6) ** 2 / 3, np.where(linear, 1.0, ratio) ** (-2.0 / 3.0) / 3.0).T
    none = np.zeros_like(x)
    rows = [[none, 116.0 * y, none], [500.0 * x, -500.0 * y, none], [none, 200.0 * y, -200.0 * z]]
    return np.moveaxis(np.array(rows), -1, 0)
