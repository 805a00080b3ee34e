"""Bilinear look-up in equirectangular pictures, continuous across the seam and the poles."""

import math

import numba

from irodori.jit.compilation import njit

TWO_PI = 2.0 * math.pi


@njit(cache=True, forceinline=True)
def direction_uv(x, y, z):
    """Return the equirectangular coordinates u, v of a unit vector, both 0..1."""
    u = math.atan2(y, x) / TWO_PI
    return (u if u >= 0.0 else u + 1.0), math.acos(min(max(z, -1.0), 1.0)) / math.pi


@njit(cache=True, forceinline=True)
def _row_and_shift(row, height, width):
    """Return the valid row for a row index, and a shift of columns: beyond a pole is the opposite meridian."""
    if row < 0:
        return 0, width // 2
    if row >= height:
        return height - 1, width // 2
    return row, 0


@njit(cache=True)
def _interpolate(picture, direction, out):
    """Fill ``out``, (k,), with the bilinear value of an equirectangular picture in a direction, a unit vector.

    Rows start at the zenith; with an even width the picture is continuous over the poles.
    """
    height, width, _ = picture.shape
    u, v = direction_uv(direction[0], direction[1], direction[2])
    column, row = u * width - 0.5, v * height - 0.5
    c0, r0 = math.floor(column), math.floor(row)
    fx, fy = column - c0, row - r0
    upper, upper_shift = _row_and_shift(r0, height, width)
    lower, lower_shift = _row_and_shift(r0 + 1, height, width)
    a, b = (c0 + upper_shift) % width, (c0 + 1 + upper_shift) % width
    c, d = (c0 + lower_shift) % width, (c0 + 1 + lower_shift) % width
    wa, wb, wc, wd = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    for i in range(out.size):
        above = wa * picture[upper, a, i] + wb * picture[upper, b, i]
        out[i] = above + wc * picture[lower, c, i] + wd * picture[lower, d, i]


@njit(cache=True, parallel=True, nogil=True)
def look_up(picture, directions, out):
    """Fill ``out``, (n, k), with the values of an equirectangular picture, (height, width, k), in directions (n, 3)."""
    for i in numba.prange(directions.shape[0]):
        _interpolate(picture, (directions[i, 0], directions[i, 1], directions[i, 2]), out[i])
