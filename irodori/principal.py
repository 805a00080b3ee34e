"""Principal components of one spectral image that already lies in a small basis [section 7 of the paper].

An image recovered from a few bands has their number as its rank, so its decomposition is a problem of that size:
the 61 bands are never built.
"""

from dataclasses import dataclass

import numpy as np

from irodori.colour import delta_e, lab_from_xyz, summary

_COLOUR_SAMPLES = 20_000


@dataclass(frozen=True)
class Compressed:
    """An image on its own principal basis.

    Parameters
    ----------
    coefficients : (n, k) float32
    basis : (61, k) float64, orthonormal columns
    errors : dict
        CIEDE2000 against the image before compression: light -> mean, p95, p99, max and count of the pixels compared.
    negative_fraction : float
        Share of compared samples (pixel and wavelength) that are below zero.
    """

    coefficients: np.ndarray
    basis: np.ndarray
    errors: dict
    negative_fraction: float


def principal_basis(weights: np.ndarray, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the principal vectors of the spectra ``weights @ basis.T``, without subtracting a mean.

    Parameters
    ----------
    weights : (n, r) float
    basis : (61, r) float

    Returns
    -------
    vectors : (61, r) float64, orthonormal, by falling share of the image's energy
    coefficients_from_weights : (r, r) float64
    """
    orthonormal, upper = np.linalg.qr(basis)
    weights = np.asarray(weights, dtype=np.float64)
    moment = upper @ (weights.T @ weights) @ upper.T
    rotation = np.linalg.eigh(moment)[1][:, ::-1]
    return orthonormal @ rotation, rotation.T @ upper


def compress(weights: np.ndarray, basis: np.ndarray, observers: dict, target_mean: float, align: int) -> Compressed:
    """Compress an image to the fewest bases whose mean CIEDE2000 stays under a target.

    Parameters
    ----------
    weights : (n, r) float, finite
        The image on its recovery basis.
    basis : (61, r) float
    observers : dict
        light -> ((3, 61) matrix to XYZ, (3,) XYZ of white). Brighter than white is scaled down to it before the
        comparison, because CIELAB is for surfaces.
    target_mean : float, CIEDE2000
    align : int
        The count is rounded up to a multiple of this, but never beyond the rank.

    Returns
    -------
    Compressed
    """
    vectors, transform = principal_basis(weights, basis)
    rank = basis.shape[1]
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(weights), min(len(weights), _COLOUR_SAMPLES), replace=False)
    full = np.asarray(weights, dtype=np.float64)[chosen] @ transform.T
    counts = sorted({min(rank, -(-k // align) * align) for k in range(1, rank + 1)})
    for count in counts:
        errors = {
            light: summary(_colour_error(full, count, vectors, *observer)) for light, observer in observers.items()
        }
        if max(e["mean"] for e in errors.values()) <= target_mean:
            break
    decoded = full[:, :count] @ vectors[:, :count].T
    coefficients = (np.asarray(weights) @ transform[:count].T).astype(np.float32)
    return Compressed(coefficients, vectors[:, :count], errors, float((decoded < 0).mean()))


def _colour_error(full, count: int, vectors, matrix, white) -> np.ndarray:
    before, after = full @ (matrix @ vectors).T, full[:, :count] @ (matrix @ vectors[:, :count]).T
    scale = np.maximum(before[:, 1:2] / white[1], 1.0)
    return delta_e(lab_from_xyz(before / scale, white), lab_from_xyz(after / scale, white))
