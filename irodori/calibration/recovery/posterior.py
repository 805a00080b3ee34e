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
from irodori.calibration.recovery.posterior_loops import ErrorModel, Errors, Recovered, fill_errors
from irodori.calibration.response_model import smooth_covariance
from irodori.colour.colorimetry import delta_e_metric, lab_from_xyz, xyz_from_reflectance
from irodori.jit.chunks import run_chunks
from irodori.spectra.grid import ERROR_NM, ERROR_STRIDE, WAVELENGTH_NM

#: Correlation length of the part of a spectrum that the bands miss, nm.
_LENGTH_NM = 25.0
#: Relative size of an additional missed part at both ends of the range, and the lengths of its decay, nm.
_ENDS, _REACH_NM = 1.8, (15.0, 30.0)
#: Rank of the covariance, a multiple of 4; what is beyond has under 1e-3 of the variance.
RANK = 24
#: Coefficients of the missed part's variance: of the squared level, of the mean squared slope, and of the local one.
_LEVEL, _SLOPE, _NEARBY = 5e-4, 3e-3, 0.1
#: Factor of the missed part: the mean of those that fit six measured sets.
SIZE = 0.81
_SLOPE_NM, _NEAR_NM = 50.0, 30.0  # interval of a slope, and width of the local mean
_BATCH = 2048  # texels that a thread takes at a time


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
        basis = calibration.basis
        missed, xyz = size * _missed(), xyz_from_reflectance("D65")
        xyz = xyz / xyz.sum(axis=1, keepdims=True)  # in those of the white
        # The size of the missed part is linear between the wavelengths at which errors are stated.
        hat = np.stack([np.interp(WAVELENGTH_NM, ERROR_NM, row) for row in np.eye(len(ERROR_NM))])
        seen, coloured = (
            np.einsum("bw,ew,wr->bre", rows, hat, missed).reshape(-1, len(ERROR_NM)) for rows in (system, xyz)
        )
        self._ratio_basis = basis.T @ xyz.T
        near = smooth_covariance(_NEAR_NM)
        near = _NEARBY * (near / near.sum(axis=1, keepdims=True))[::ERROR_STRIDE]
        single = (basis[::ERROR_STRIDE].T, missed[::ERROR_STRIDE], seen, self._ratio_basis, coloured, hat.mean(axis=1))
        self._model = ErrorModel(
            np.ascontiguousarray(basis),
            np.ascontiguousarray(near),
            _LEVEL,
            _SLOPE,
            _SLOPE_NM / (WAVELENGTH_NM[1] - WAVELENGTH_NM[0]),
            _pairs_of(np.einsum("wk,bwcv,vl->bckl", basis, open_part, basis, optimize=True)),
            *(np.ascontiguousarray(one, np.float32) for one in single),
        )

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
        shape, count = response.shape[:-1], response.size // response.shape[-1]
        sizes = (count, len(ERROR_NM)), (count,), (count,), (0, 0, 0)
        errors = Errors(*(np.empty(size, np.float32) for size in sizes))
        self.fill(response, variance, stated, errors)
        return Uncertainty(errors.deviation.reshape(*shape, -1), *(one.reshape(shape) for one in errors[1:3]))

    def fill(self, response: np.ndarray, variance: np.ndarray | None, stated: bool, errors: Errors) -> None:
        """Fill the `Errors` of n recovered reflectances; other arguments as in `of`."""
        flat = response.reshape(-1, response.shape[-1])
        noise = np.broadcast_to(0.0 if variance is None else variance, response.shape).reshape(flat.shape)

        def fill(first: int, last: int) -> None:
            part = slice(first, last)
            told = np.where(noise[part] >= 0.0, noise[part], np.nan)
            used = told if stated else None
            weights = self.calibration.weights(flat[part], used)
            slopes = np.ascontiguousarray(self.calibration.mapping.slopes(flat[part], used), np.float32)
            ratio = weights @ self._ratio_basis
            metric = delta_e_metric(lab_from_xyz(ratio, np.ones(3)))
            here = Errors(*(one[part] for one in errors))
            fill_errors(self._model, Recovered(weights, slopes, told, ratio, metric), here)

        run_chunks(fill, len(flat), _BATCH)


def _pairs_of(covariance: np.ndarray) -> np.ndarray:
    """Return a covariance (bands, bands, k, k) for every pair of bands, and of weights, once; both are symmetric.

    Returns
    -------
    (bands (bands + 1) / 2, k (k + 1) / 2) float64
        Of different weights, the sum of both orders.
    """
    of_pairs = covariance[np.tril_indices(len(covariance))]
    k, other = np.tril_indices(of_pairs.shape[-1])
    return of_pairs[:, k, other] + np.where(k == other, 0.0, of_pairs[:, other, k])


def _missed() -> np.ndarray:
    """Return a square root (61, 24) of the covariance K of a missed part of unit size."""
    away = np.abs(WAVELENGTH_NM - WAVELENGTH_NM[[0, -1], None])
    ends = _ENDS * np.exp(-away / np.array(_REACH_NM)[:, None]).sum(axis=0)
    smooth = smooth_covariance(_LENGTH_NM)
    values, vectors = np.linalg.eigh(smooth + ends[:, None] * smooth * ends)
    return vectors[:, -RANK:] * np.sqrt(values[-RANK:])
