"""Compiled loop for recovery of light: posterior means under a mixture prior for all pixels.

Pixels are processed `_LANES` at a time. Each quantity is a row with one number per pixel, so that the compiler
vectorises loops over rows. There are no sums over pixels: the exact result for a pixel does not depend on its
neighbours.
"""

import math

import numpy as np

from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit

_LANES = 64
_ROWS = 8  # rows that are summed at a time
_BLOCK = 16 * _LANES  # pixels that a thread takes at a time
_FAST = {"contract", "reassoc", "nsz", "arcp"}  # infinity and NaN are still treated correctly
_LEAST = np.float32(1e-30)  # added to squared lengths, so that shares are defined for black pixels


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _combine(rows, weight, total):
    """Fill ``total``, (_LANES,), with the weighted sum of rows; their number is a multiple of 8."""
    for j in range(_LANES):
        total[j] = 0.0
    for r in range(0, rows.shape[0], _ROWS):
        w0, w1, w2, w3 = weight[r], weight[r + 1], weight[r + 2], weight[r + 3]
        w4, w5, w6, w7 = weight[r + 4], weight[r + 5], weight[r + 6], weight[r + 7]
        for j in range(_LANES):
            total[j] += (
                w0 * rows[r, j] + w1 * rows[r + 1, j] + w2 * rows[r + 2, j] + w3 * rows[r + 3, j]
                + w4 * rows[r + 4, j] + w5 * rows[r + 5, j] + w6 * rows[r + 6, j] + w7 * rows[r + 7, j]
            )  # fmt: skip


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _shares(square, share, bands):
    """Replace squares, (families, _LANES), by posterior shares: share square^(-bands / 2), normalised to sum one."""
    least, total = square[0].copy(), np.zeros(_LANES, np.float32)
    for c in range(1, square.shape[0]):
        for j in range(_LANES):
            least[j] = min(least[j], square[c, j])
    for c in range(square.shape[0]):
        for j in range(_LANES):
            ratio = least[j] / square[c, j]
            power = share[c]
            for _ in range(bands // 2):
                power *= ratio
            square[c, j] = power * math.sqrt(ratio) if bands % 2 else power
            total[j] += square[c, j]
    for c in range(square.shape[0]):
        for j in range(_LANES):
            square[c, j] /= total[j]


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _fill_means(response, constants, out, first, last):
    share, factor, maps = constants
    families, bands = factor.shape[:2]
    x = np.zeros((factor.shape[2], _LANES), np.float32)
    parts = np.zeros((maps.shape[1], _LANES), np.float32)
    square, total = np.empty((families, _LANES), np.float32), np.empty(_LANES, np.float32)
    for start in range(first, last, _LANES):
        count = min(_LANES, last - start)
        for b in range(bands):
            for j in range(_LANES):
                x[b, j] = response[start + j, b] if j < count else np.float32(1.0)
        for c in range(families):
            square[c] = _LEAST
            for i in range(bands):
                _combine(x, factor[c, i], total)
                for j in range(_LANES):
                    square[c, j] += total[j] * total[j]
        _shares(square, share, bands)
        for c in range(families):
            for b in range(bands):
                for j in range(_LANES):
                    parts[c * bands + b, j] = square[c, j] * x[b, j]
        for k in range(maps.shape[0]):
            _combine(parts, maps[k], total)
            for j in range(count):
                out[start + j, k] = total[j]


def _padded(matrix: np.ndarray) -> np.ndarray:
    """Convert a matrix to single precision and append zeros to its rows, up to a length that is a multiple of 8."""
    spare = -matrix.shape[-1] % _ROWS
    wide = np.pad(matrix, [(0, 0)] * (matrix.ndim - 1) + [(0, spare)])
    return np.ascontiguousarray(wide, dtype=np.float32)


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
    flat = maps.swapaxes(0, 1).reshape(maps.shape[1], -1)
    constants = share.astype(np.float32), _padded(factor), _padded(flat)
    run_chunks(_fill_means, len(response), _BLOCK, response, constants, out)
