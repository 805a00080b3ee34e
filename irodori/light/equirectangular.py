"""Bilinear look-up in equirectangular pictures, continuous across the seam and the poles."""

import math
from typing import NamedTuple

import numba
import numpy as np

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


class StackedPicture(NamedTuple):
    """One of several pictures stored after each other in an array."""

    pixels: np.ndarray  # (all pixels, k) float
    first: int  # index of the first pixel of this picture
    width: int
    height: int


@njit(cache=True)
def add_interpolated(picture, direction, scale, out):
    """Add ``scale`` times the bilinear value of an equirectangular picture in a direction.

    Parameters
    ----------
    picture : StackedPicture
        Rows start at the zenith; with an even width the picture is continuous over the poles.
    direction : tuple of 3 float
        Unit vector.
    scale : float
    out : (k,) float
        Array to which the value is added.
    """
    pixels, first, width, height = picture
    u, v = direction_uv(direction[0], direction[1], direction[2])
    column, row = u * width - 0.5, v * height - 0.5
    c0, r0 = math.floor(column), math.floor(row)
    fx, fy = column - c0, row - r0
    upper, upper_shift = _row_and_shift(r0, height, width)
    lower, lower_shift = _row_and_shift(r0 + 1, height, width)
    a = first + upper * width + (c0 + upper_shift) % width
    b = first + upper * width + (c0 + 1 + upper_shift) % width
    c = first + lower * width + (c0 + lower_shift) % width
    d = first + lower * width + (c0 + 1 + lower_shift) % width
    wa, wb = scale * (1.0 - fx) * (1.0 - fy), scale * fx * (1.0 - fy)
    wc, wd = scale * (1.0 - fx) * fy, scale * fx * fy
    for i in range(out.size):
        out[i] += wa * pixels[a, i] + wb * pixels[b, i] + wc * pixels[c, i] + wd * pixels[d, i]


@njit(cache=True, parallel=True, nogil=True)
def look_up(picture, directions, out):
    """Fill ``out``, (n, k), with the values of an equirectangular picture, (height, width, k), in directions (n, 3)."""
    height, width, bases = picture.shape
    pixels = picture.reshape(height * width, bases)
    for i in numba.prange(directions.shape[0]):
        out[i] = 0.0
        direction = directions[i, 0], directions[i, 1], directions[i, 2]
        add_interpolated(StackedPicture(pixels, 0, width, height), direction, 1.0, out[i])
