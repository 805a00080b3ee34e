"""Mappings from responses to basis weights: a matrix, a blend of matrices, a polynomial.

All are positively homogeneous of degree 1: twice the light yields twice the weights. Each maps (n, bands) to (n, k) in
the type of the response, float32 or float64; the fields of its dataclass are stored in ``calibration.h5``.
"""

from dataclasses import dataclass, replace
from math import comb
from typing import Any, ClassVar, Protocol

import numpy as np

from irodori.calibration.recovery.local_loops import Blending, columns_of, local_weights
from irodori.calibration.recovery.mapping_loops import polynomial_weights

_TILE = 1 << 16  # responses at a time: the tile and its result stay in the cache
_STEP = 1e-4  # of the length of a response, for differences


class Mapping(Protocol):
    """Function from responses to weights on a basis, as an estimator returns it: a dataclass of its parameters."""

    kind: ClassVar[str]
    __dataclass_fields__: ClassVar[dict[str, Any]]

    def weights(self, response: np.ndarray, variance: np.ndarray | None, out: np.ndarray) -> None:
        """Fill out (n, k) from responses (n, bands) and, where known, their variances (n, bands)."""

    def slopes(self, response: np.ndarray, variance: np.ndarray | None) -> np.ndarray:
        """Return the derivatives ∂w_k/∂ρ_b at responses (n, bands), (n, bands, k) float64."""

    def on_basis(self, basis: np.ndarray) -> "Mapping":
        """Return the mapping with its outputs, spectra (61), projected on an orthonormal basis (61, k)."""

    def multiply_adds(self) -> int:
        """Return the number of multiply-add operations for a pixel, with an exponential counted as 10."""


@dataclass(frozen=True)
class LinearMapping:
    """Mapping by one matrix.

    Parameters
    ----------
    matrix : (bands, k) float64, M [eq. 4]
    """

    matrix: np.ndarray
    kind: ClassVar[str] = "linear"

    def weights(self, response, variance, out) -> None:
        """See `Mapping`; the variance is ignored."""
        matrix = self.matrix.astype(response.dtype)
        for first in range(0, len(response), _TILE):
            np.matmul(response[first : first + _TILE], matrix, out=out[first : first + _TILE])

    def slopes(self, response, variance) -> np.ndarray:
        """See `Mapping`."""
        return np.broadcast_to(self.matrix, (len(response), *self.matrix.shape))

    def on_basis(self, basis):
        """See `Mapping`."""
        return LinearMapping(self.matrix @ basis)

    def multiply_adds(self) -> int:
        """See `Mapping`."""
        return self.matrix.size


class _Differences(Mapping, Protocol):
    """Non-linear mapping with derivatives by central differences."""

    scale: np.ndarray

    @property
    def bases(self) -> int:
        """Number of outputs."""

    def slopes(self, response, variance) -> np.ndarray:
        """See `Mapping`."""
        response = np.asarray(response, dtype=np.float64)
        length = np.linalg.norm(response / self.scale, axis=1)
        slopes = np.empty((*response.shape, self.bases))
        upper, lower = (np.empty((len(response), self.bases)) for _ in range(2))
        for band, scale in enumerate(self.scale):
            step = np.where(length > 0, _STEP * length, _STEP) * scale
            for sign, out in ((1.0, upper), (-1.0, lower)):
                moved = response.copy()
                moved[:, band] += sign * step
                self.weights(moved, variance, out)
            slopes[:, band] = (upper - lower) / (2.0 * step[:, None])
        return slopes


@dataclass(frozen=True)
class LocalMapping(_Differences):
    """Blend of matrices that belong to anchors, weighted by the closeness of a response's direction to each anchor.

    A response is divided by ``scale``. The weights of the anchors z are proportional to exp((c·z - 1) / width²) for its
    direction c, with the sum 1. If the variance of a response is given, the matrices are those of its relative noise,
    interpolated between levels, and the width grows with it; otherwise they are those of ``maps[0]``. A variance of
    zero counts as the lowest level, an infinite one as the highest; if it is NaN or negative, the results are NaN.
    float32 responses are blended in float32.

    Parameters
    ----------
    scale : (bands,) float64
    anchors : (a, bands) float64, unit length
    width : float
    levels : (l,) float64
        Natural logarithms of relative noise variance, equally spaced, increasing; two or more.
    spread : float
        Factor with which the relative variance is added to the squared width.
    maps : (l + 1, a, bands, k) float64
    """

    scale: np.ndarray
    anchors: np.ndarray
    width: float
    levels: np.ndarray
    spread: float
    maps: np.ndarray
    kind: ClassVar[str] = "local"

    @property
    def bases(self) -> int:
        """Number of outputs."""
        return self.maps.shape[-1]

    def weights(self, response, variance, out) -> None:
        """See `Mapping`."""
        response = np.ascontiguousarray(response)
        if variance is None:
            variance = np.empty((0, self.scale.size), response.dtype)
        elif variance.strides[0] == 0 or len(variance) == 1:
            variance = variance[:1].copy()  # a read-only array would compile the loop once more
        maps = self.maps.astype(response.dtype).swapaxes(-1, -2)
        blending = Blending(
            scale=self.scale,
            anchors=columns_of(self.anchors.T.astype(response.dtype)),
            width=self.width,
            levels=self.levels,
            spread=self.spread,
            maps=columns_of(maps.reshape(*maps.shape[:2], -1)),
        )
        # The loop is compiled anew for arrays that cannot be written.
        local_weights(blending, response, np.require(variance, requirements=["C", "W"]), out)

    def on_basis(self, basis):
        """See `Mapping`."""
        return replace(self, maps=self.maps @ basis)

    def multiply_adds(self) -> int:
        """See `Mapping`."""
        anchors, bands, bases = self.maps.shape[1:]
        return anchors * (bands + 10 + bands * bases)


@dataclass(frozen=True)
class PolynomialMapping(_Differences):
    """Monomials of degree 1 to 3 in the response, each divided by a power of its length that leaves degree 1.

    Parameters
    ----------
    scale : (bands,) float64
    coefficients : (f, k) float64
        Coefficients of x_i, x_i c_j (i ≤ j) and x_i c_j c_l (i ≤ j ≤ l); x is the scaled response, c its direction.
    """

    scale: np.ndarray
    coefficients: np.ndarray
    kind: ClassVar[str] = "polynomial"

    @property
    def bases(self) -> int:
        """Number of outputs."""
        return self.coefficients.shape[1]

    def weights(self, response, variance, out) -> None:
        """See `Mapping`; the variance is ignored."""
        coefficients = np.ascontiguousarray(self.coefficients.T)
        polynomial_weights(np.ascontiguousarray(response), self.scale, coefficients, out)

    def on_basis(self, basis):
        """See `Mapping`."""
        return replace(self, coefficients=self.coefficients @ basis)

    def multiply_adds(self) -> int:
        """See `Mapping`."""
        return self.coefficients.size + len(self.coefficients)


def polynomial_count(bands: int) -> int:
    """Return the number of monomials of degree 1 to 3."""
    return sum(comb(bands + degree - 1, degree) for degree in (1, 2, 3))


KINDS: dict[str, type[Mapping]] = {kind.kind: kind for kind in (LinearMapping, LocalMapping, PolynomialMapping)}
