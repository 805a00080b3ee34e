"""Compiled loops of `LocalMapping`: matrices of anchors, blended pixel by pixel.

A group of `LANES` pixels shares one product of weights and matrices for each level of noise that occurs in it. A matrix
that a pixel does not use has a weight of exactly zero, so that not a bit of its result depends on its neighbours.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.calibration.recovery.mapping_loops import BLOCK, FAST, LANES, Group, inverse_of, load, store
from irodori.jit.array_copies import copy_into
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit
from irodori.jit.functions import exp, log
from irodori.jit.table_sums import OUTPUTS, TILE, Place, any_above_zero, blend_tile

_LEAST_EXPONENT = -16.5  # of an anchor's share
_LEAST_SHARE = 1e-7  # of an anchor in a pixel's map; less would not show in float32
_LEAST_SIGNAL = 1e-3  # of the squared length of a response, where its noise is larger than itself
_LEAST_RATIO, _LARGEST_RATIO = 1e-300, 1e300  # of noise to signal, whose logarithm is taken


class Blending(NamedTuple):
    """A `LocalMapping` for compiled loops; anchors and maps are of the type of the responses."""

    scale: np.ndarray  # (bands,)
    anchors: np.ndarray  # `columns_of` the anchors' transpose, (bands, a)
    width: float
    levels: np.ndarray  # (l,)
    spread: float
    maps: np.ndarray  # `columns_of` (l + 1, a, k bands)


def columns_of(matrix: np.ndarray) -> np.ndarray:
    """Return matrices (..., rows, n) in the order in which `blend_tile` reads them.

    Returns
    -------
    (..., columns, rows, `OUTPUTS`), the last column filled up with zeros
    """
    *before, rows, count = matrix.shape
    columns = -(-count // OUTPUTS)
    whole = np.zeros((*before, rows, columns * OUTPUTS), matrix.dtype)
    whole[..., :count] = matrix
    return np.ascontiguousarray(whole.reshape(*before, rows, columns, OUTPUTS).swapaxes(-2, -3))


@njit(cache=True, nogil=True)
def _product(rows, members, count, table, sums):
    """Fill sums with the product of a transposed table (`columns_of`) and rows (count, LANES), for members alone."""
    flat, group = table.ravel(), members[:count]
    for column in range(table.shape[0]):
        for j in range(0, LANES, TILE):
            blend_tile(rows, group, Place(flat, column * table.shape[1] * OUTPUTS), sums, (column * OUTPUTS, j))


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _load_variance(variance, first, count, inverse_square, own):
    """Fill own (LANES,) with the variances of scaled responses, averaged over bands; a single row is for all pixels."""
    bands = variance.shape[1]
    for j in range(LANES):
        own[j] = 0.0
    for j in range(count):
        row = first + j if variance.shape[0] > 1 else 0
        total = 0.0
        for b in range(bands):
            total += variance[row, b] * inverse_square[b]
        own[j] = total / bands


@njit(cache=True, nogil=True, error_model="numpy")
def _place_levels(blending, own, length, position, inverse):
    """Fill the position of each pixel's relative variance among the levels, and the inverse of its squared width.

    A variance of zero, or below the lowest level, counts as the lowest level, an infinite one as the highest. Where the
    variance is negative or NaN, the length becomes NaN, and so does the pixel.
    """
    levels, spread, width, bands = blending.levels, blending.spread, blending.width, blending.scale.size
    last = levels.size - 1
    step = levels[1] - levels[0]
    least, largest = math.exp(levels[0]), math.exp(levels[last])
    for j in range(LANES):
        squared = length[j] * length[j]
        signal = max(squared - bands * own[j], _LEAST_SIGNAL * squared)
        ratio = own[j] / signal
        # The comparisons are written so that 0 / 0 and NaN yield the lowest level.
        ratio = ratio if ratio > _LEAST_RATIO else _LEAST_RATIO
        ratio = ratio if ratio < _LARGEST_RATIO else _LARGEST_RATIO
        length[j] = length[j] if own[j] >= 0.0 else np.nan
        place = (log(ratio) - levels[0]) / step
        place = place if place > 0.0 else 0.0
        position[j] = place if place < last else last
        ratio = ratio if ratio > least else least
        ratio = ratio if ratio < largest else largest
        inverse[j] = 1.0 / (width * width + spread * ratio)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _shares(count, inverse, share, largest, total):
    """Replace the cosines to the anchors, share (count.., LANES), by each pixel's weights of the anchors, with sum 1.

    Very small weights become zero.
    """
    least_exponent, least_share = share.dtype.type(_LEAST_EXPONENT), share.dtype.type(_LEAST_SHARE)
    zero, one = share.dtype.type(0.0), share.dtype.type(1.0)
    for j in range(LANES):
        largest[j] = share[0, j]
        total[j] = zero
    for a in range(1, count):
        for j in range(LANES):
            largest[j] = share[a, j] if share[a, j] > largest[j] else largest[j]
    for a in range(count):
        for j in range(LANES):
            exponent = (share[a, j] - largest[j]) * inverse[j]
            value = exp(exponent)
            share[a, j] = value if exponent > least_exponent else zero
        for j in range(LANES):
            total[j] += share[a, j]
    for j in range(LANES):
        total[j] = one / total[j]
    for a in range(count):
        for j in range(LANES):
            value = share[a, j] * total[j]
            share[a, j] = value if value > least_share else zero


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _pack(share, count, members):
    """Move rows of share with a value above zero to the front; fill members with their indices; return their number."""
    taken = 0
    for a in range(count):
        some = False
        for j in range(0, LANES, TILE):
            some |= any_above_zero(share, a, j)
        if some:
            if taken < a:
                for j in range(LANES):
                    share[taken, j] = share[a, j]
            members[taken] = a
            taken += 1
    return taken


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _apply(blend, x, values):
    """Add to values (k, LANES) the products of the pixels' matrices, blend (k * bands, LANES), and x (bands, LANES)."""
    bands = x.shape[0]
    for k in range(values.shape[0]):
        for b in range(bands):
            for j in range(LANES):
                values[k, j] += x[b, j] * blend[k * bands + b, j]


@njit(cache=True, nogil=True)
def _local_block(blending, response, variance, out, first, last):
    """Apply the blended matrices to the pixels from ``first`` to ``last``, see `LocalMapping`."""
    scale, anchors, width, levels, _, maps = blending
    bands, bases, count = scale.size, out.shape[1], maps.shape[2]
    kind = maps.dtype
    x, c, length = np.empty((bands, LANES)), np.empty((bands, LANES)), np.empty(LANES)
    own, position, inverse = np.empty(LANES), np.zeros(LANES), np.empty(LANES)
    inverse[:] = 1.0 / (width * width)
    # The arrays below have the type of the response.
    direction, faded = np.empty((bands, LANES), kind), np.empty((bands, LANES), kind)
    sharpness, largest, total = np.empty(LANES, kind), np.empty(LANES, kind), np.empty(LANES, kind)
    share, blend = np.empty((anchors.shape[0] * OUTPUTS, LANES), kind), np.empty((maps.shape[1] * OUTPUTS, LANES), kind)
    values, every, members = np.empty((bases, LANES), kind), np.empty(bands, np.int64), np.empty(count, np.int64)
    inverse_scale, inverse_square = inverse_of(scale), np.empty(bands)
    for b in range(bands):
        every[b], inverse_square[b] = b, inverse_scale[b] * inverse_scale[b]
    for start in range(first, last, LANES):
        pixels = min(LANES, last - start)
        load(response, start, pixels, inverse_scale, Group(x, c, length))
        lowest, highest = 0, 1
        if variance.size > 0:
            _load_variance(variance, start, pixels, inverse_square, own)
            _place_levels(blending, own, length, position, inverse)
            lowest, highest = levels.size, 0
            for j in range(LANES):
                lowest, highest = min(lowest, int(position[j]) + 1), max(highest, int(position[j]) + 2)
            highest = min(highest, levels.size) + 1
        copy_into(direction, c)
        for j in range(LANES):
            sharpness[j] = inverse[j]
        _product(direction, every, bands, anchors, share)
        _shares(count, sharpness, share, largest, total)
        taken = _pack(share, count, members)
        values[:] = 0.0
        copy_into(faded, x)
        for level in range(lowest, highest):
            if variance.size > 0:
                # Matrices are interpolated between levels: a level counts for pixels less than one level away.
                for b in range(bands):
                    for j in range(LANES):
                        faded[b, j] = x[b, j] * max(0.0, 1.0 - abs(position[j] - (level - 1)))
            _product(share, members, taken, maps[level], blend)
            _apply(blend, faded, values)
        store(values, length, start, pixels, out)


def local_weights(blending: Blending, response, variance, out) -> None:
    """Fill out (n, k) for responses (n, bands).

    Variances are (n, bands), (1, bands) for all, or (0, bands) where not known. All arrays are C-contiguous.
    """
    run_chunks(_local_block, len(response), BLOCK, blending, response, variance, out)
