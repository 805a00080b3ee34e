"""Compiled loop for recovery of light: posterior means under a mixture prior for all pixels.

Pixels are processed `_LANES` at a time. Each quantity is a row with one number per pixel, so that the compiler
vectorises loops over rows. There are no sums over pixels: the exact result for a pixel does not depend on its
neighbours.
"""

import math

import numpy as np

from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit

_LANES = 256
_WIDE = 6  # bands that are multiplied at a time
_BLOCK = 4 * _LANES  # pixels that a thread takes at a time
_FAST = {"contract", "reassoc", "nsz", "arcp"}  # infinity and NaN are still treated correctly
_LEAST = np.float32(1e-30)  # added to squared lengths, so that shares are defined for black pixels


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _add_product(matrix, i, k, x, total, row):
    """Add to a row of ``total`` the product of row ``i`` of a matrix with six rows of ``x`` from the row ``k`` on."""
    m0, m1, m2 = matrix[i, k], matrix[i, k + 1], matrix[i, k + 2]
    m3, m4, m5 = matrix[i, k + 3], matrix[i, k + 4], matrix[i, k + 5]
    for j in range(_LANES):
        total[row, j] += (m0 * x[k, j] + m1 * x[k + 1, j] + m2 * x[k + 2, j]
                          + m3 * x[k + 3, j] + m4 * x[k + 4, j] + m5 * x[k + 5, j])  # fmt: skip


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _add_squares(factor, c, i, x, before, square):
    """Add to a row of ``square`` the squares of ``before`` plus a triangle of a factor times six rows of ``x``."""
    f = factor
    for j in range(_LANES):
        x0, x1, x2, x3, x4, x5 = x[i, j], x[i + 1, j], x[i + 2, j], x[i + 3, j], x[i + 4, j], x[i + 5, j]
        y0 = before[0, j] + f[c, i, i] * x0
        y1 = before[1, j] + f[c, i + 1, i] * x0 + f[c, i + 1, i + 1] * x1
        y2 = before[2, j] + f[c, i + 2, i] * x0 + f[c, i + 2, i + 1] * x1 + f[c, i + 2, i + 2] * x2
        y3 = (before[3, j] + f[c, i + 3, i] * x0 + f[c, i + 3, i + 1] * x1 + f[c, i + 3, i + 2] * x2
              + f[c, i + 3, i + 3] * x3)  # fmt: skip
        y4 = (before[4, j] + f[c, i + 4, i] * x0 + f[c, i + 4, i + 1] * x1 + f[c, i + 4, i + 2] * x2
              + f[c, i + 4, i + 3] * x3 + f[c, i + 4, i + 4] * x4)  # fmt: skip
        y5 = (before[5, j] + f[c, i + 5, i] * x0 + f[c, i + 5, i + 1] * x1 + f[c, i + 5, i + 2] * x2
              + f[c, i + 5, i + 3] * x3 + f[c, i + 5, i + 4] * x4 + f[c, i + 5, i + 5] * x5)  # fmt: skip
        square[c, j] += (y0 * y0 + y1 * y1) + (y2 * y2 + y3 * y3) + (y4 * y4 + y5 * y5)


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _shares(square, share, bands):
    """Replace squares, (families, _LANES), by posterior shares: share square^(-bands / 2), normalised to sum one."""
    least, ratio, total = square[0].copy(), np.empty(_LANES, np.float32), np.zeros(_LANES, np.float32)
    for c in range(1, square.shape[0]):
        for j in range(_LANES):
            least[j] = min(least[j], square[c, j])
    for c in range(square.shape[0]):
        for j in range(_LANES):
            ratio[j] = least[j] / square[c, j]
            square[c, j] = share[c]
        for _ in range(bands // 2):
            for j in range(_LANES):
                square[c, j] *= ratio[j]
        if bands % 2:
            for j in range(_LANES):
                square[c, j] *= math.sqrt(ratio[j])
        for j in range(_LANES):
            total[j] += square[c, j]
    for j in range(_LANES):
        total[j] = np.float32(1.0) / total[j]
    for c in range(square.shape[0]):
        for j in range(_LANES):
            square[c, j] *= total[j]


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _fill_means(response, constants, out, first, last):
    share, factor, maps = constants
    families, wide = factor.shape[:2]
    bands, bases = response.shape[1], out.shape[1]
    x, parts = np.zeros((wide, _LANES), np.float32), np.zeros((wide, _LANES), np.float32)
    square, before = np.empty((families, _LANES), np.float32), np.empty((_WIDE, _LANES), np.float32)
    total = np.empty((bases, _LANES), np.float32)
    for start in range(first, last, _LANES):
        count = min(_LANES, last - start)
        for b in range(bands):
            for j in range(_LANES):
                x[b, j] = response[start + j, b] if j < count else np.float32(1.0)
        for c in range(families):
            for j in range(_LANES):
                square[c, j] = _LEAST
            for i in range(0, wide, _WIDE):
                before[:] = np.float32(0.0)
                for k in range(0, i, _WIDE):
                    for row in range(_WIDE):
                        _add_product(factor[c], i + row, k, x, before, row)
                _add_squares(factor, c, i, x, before, square)
        _shares(square, share, bands)
        total[:] = np.float32(0.0)
        for c in range(families):
            own = maps[c]
            for b in range(bands):
                for j in range(_LANES):
                    parts[b, j] = square[c, j] * x[b, j]
            for i in range(0, wide, _WIDE):
                for k in range(bases):
                    _add_product(own, k, i, parts, total, k)
        for k in range(bases):
            for j in range(count):
                out[start + j, k] = total[k, j]


def _padded(matrix: np.ndarray, rows: int = 0) -> np.ndarray:
    """Convert matrices to single precision, and append zeros to their columns, and to the rows up to a given number.

    The number of columns becomes a multiple of 6.
    """
    spare = max(rows - matrix.shape[1], 0), -matrix.shape[2] % _WIDE
    return np.pad(matrix, [(0, 0), (0, spare[0]), (0, spare[1])]).astype(np.float32)


def mixture_weights(response, share, factor, maps, out) -> None:
    """Fill ``out`` with the posterior means of pixels.

    Parameters
    ----------
    response : (n, bands) float32
    share : (families,) float64
        Prior share of each family, divided by the square root of the determinant of its covariance.
    factor : (families, bands, bands) float64
        Inverse of the Cholesky factor of the covariance of the responses of each family.
    maps : (families, bases, bands) float64
        Matrix of each family that maps responses to the posterior mean.
    out : (n, bases) float32
        NaN where a response is not finite.
    """
    wide = factor.shape[1] + -factor.shape[1] % _WIDE
    constants = share.astype(np.float32), _padded(factor, wide), _padded(maps)
    run_chunks(_fill_means, len(response), _BLOCK, response, constants, out)
