"""The paper's estimator: a basis of principal vectors and the pseudo-inverse of the chart's responses [eq. 2 to 4]."""

import numpy as np

from irodori.calibration.conditioning import MAX_CONDITION, check_responses
from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.recovery.mappings import LinearMapping


def spectral_basis(spectra: np.ndarray, bases: int) -> np.ndarray:
    """Return the first principal vectors of measured spectra, without subtracting a mean [eq. 2].

    Parameters
    ----------
    spectra : (m, 61) float, Λ
    bases : int, 1..m

    Returns
    -------
    (61, bases) float64, orthonormal columns, the sum of each positive or zero
    """
    if not 1 <= bases <= min(spectra.shape):
        raise ValueError(f"{bases} bases; accepted: 1 to {min(spectra.shape)} for {len(spectra)} spectra")
    rows = np.linalg.svd(spectra, full_matrices=False)[2][:bases]
    return (rows * np.where(rows.sum(axis=1, keepdims=True) < 0, -1.0, 1.0)).T


def calibrate(
    response: np.ndarray,
    spectra: np.ndarray,
    bases: int,
    light: np.ndarray,
    max_condition: float = MAX_CONDITION,
) -> Calibration:
    """Return the calibration by equations (2) to (4) of the paper.

    Parameters
    ----------
    response : (m, bands) float, P
    spectra : (m, 61) float, Λ
    bases : int
    light : (61,) float
    max_condition : float
        Largest condition number of P with every band divided by its largest patch.

    Raises
    ------
    ValueError
        If P determines no calibration, see `irodori.calibration.conditioning.check_responses`.
    """
    response = np.asarray(response, dtype=np.float64)
    check_responses(response, max_condition)
    peak = np.abs(response).max(axis=0)
    basis = spectral_basis(spectra, bases)
    weights = np.linalg.pinv(basis) @ spectra.T
    # Bands are scaled to a common size first, so that the pseudo-inverse cuts none of them off for its unit.
    mapping = LinearMapping((np.linalg.pinv(response / peak) @ weights.T) / peak[:, None])
    return Calibration(basis, mapping, np.asarray(light, dtype=np.float64), training=response)
