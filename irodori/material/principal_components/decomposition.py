"""Principal vectors of second moments, plain or weighted by lights and observers."""

from dataclasses import dataclass

import numpy as np

#: Share of equal weights for all wavelengths in the visual weighting, so that parts of a spectrum that are invisible
#: under all lights come last instead of being undetermined.
_SPECTRAL_SHARE = 1e-3
#: Singular values below this share of the first are rounding of single-precision pixels.
_RANK_SHARE = 1e-8


@dataclass(frozen=True)
class Decomposition:
    """Principal directions of a picture.

    Parameters
    ----------
    orthonormal : (61, r) float64
        Orthonormal basis of the space that the picture's spectra span.
    upper : (r, r) float64
        ``orthonormal @ upper`` is the basis of the picture's own coefficients.
    directions : (r, r) float64
        Principal directions as columns, by falling energy, in coordinates where the metric is the identity.
    energies : (r,) float64
        Square root of the energy (sum of squares over all pixels) along each direction.
    metric_root : (r, r) float64 or None
        Symmetric square root of the metric that weights spectral errors; None for the identity.
    """

    orthonormal: np.ndarray
    upper: np.ndarray
    directions: np.ndarray
    energies: np.ndarray
    metric_root: np.ndarray | None

    @property
    def rank(self) -> int:
        """Number of directions with energy above rounding error, at least 1."""
        return max(1, int((self.energies > _RANK_SHARE * self.energies[0]).sum()))

    def truncated(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the basis of the first ``count`` principal vectors and the matrix that computes coefficients on it.

        The vectors are orthonormal and sorted by falling energy, the sample of each with the largest magnitude is
        positive, and their coefficients are uncorrelated over the picture. With a metric, the coefficients are not
        projections on the vectors: they minimise the weighted error, and the vectors are the least-squares regression
        of the spectra on them.

        Returns
        -------
        basis : (61, count) float64
        encoder : (count, r) float64
            ``encoder @ pixel`` are the coefficients of a pixel.
        """
        chosen = self.directions[:, :count]
        if self.metric_root is None:
            return _signed(self.orthonormal @ chosen, chosen.T @ self.upper)
        decoder = np.linalg.solve(self.metric_root, chosen)
        spread = decoder * self.energies[:count] if self.energies[0] > 0 else decoder
        rotation = np.linalg.svd(spread, full_matrices=False)[0]
        return _signed(self.orthonormal @ rotation, rotation.T @ decoder @ chosen.T @ self.metric_root @ self.upper)


def _signed(basis: np.ndarray, encoder: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Flip signs so that each vector's sample of largest magnitude is positive: LAPACK's signs are arbitrary."""
    sign = np.where(basis[np.abs(basis).argmax(axis=0), np.arange(basis.shape[1])] < 0.0, -1.0, 1.0)
    return basis * sign, encoder * sign[:, None]


def decompose(root: np.ndarray, basis: np.ndarray | None, matrices=None) -> Decomposition:
    """Return the principal directions of a picture, without subtracting a mean.

    Parameters
    ----------
    root : (m, r) float64
        ``root.T @ root`` are the second moments of the pixels, see
        `irodori.material.principal_components.second_moments`.
    basis : (61, r) float or None
        Basis on which the pixels are coefficients; None if the pixels are spectra.
    matrices : list of (3, 61) float, optional
        Matrices from spectra to XYZ under each light, white at Y = 100, for the visual weighting. None: all wavelengths
        have equal weight.
    """
    if basis is None:
        orthonormal, upper = np.eye(root.shape[1]), np.eye(root.shape[1])
    else:
        orthonormal, upper = np.linalg.qr(np.asarray(basis, dtype=np.float64))
    own = root @ upper.T
    metric_root = None
    if matrices is not None:
        metric_root = _visual_root(orthonormal, matrices)
        own = own @ metric_root
    # The decomposition returns all directions only if there are at least as many rows as columns.
    padded = np.concatenate([own, np.zeros((max(own.shape[1] - len(own), 0), own.shape[1]))])
    _, energies, transposed = np.linalg.svd(padded, full_matrices=False)
    return Decomposition(orthonormal, upper, transposed.T, energies, metric_root)


def _visual_root(orthonormal: np.ndarray, matrices) -> np.ndarray:
    """Return the symmetric root of the metric of XYZ under the lights, scaled so that its mean eigenvalue is 1."""
    stacked = np.concatenate([np.asarray(matrix, dtype=np.float64) for matrix in matrices]) @ orthonormal
    metric = stacked.T @ stacked
    size = len(metric)
    metric = metric * (size / np.trace(metric)) + _SPECTRAL_SHARE * np.eye(size)
    values, vectors = np.linalg.eigh(metric)
    return (vectors * np.sqrt(values)) @ vectors.T
