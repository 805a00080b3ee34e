"""Compiled loops of the non-linear mappings; every one is positively homogeneous of degree 1 in the response.

Pixels are taken `LANES` at a time, each quantity a row with one number a pixel, so that the compiler turns the loop
over a row into vector instructions. No sum runs over pixels: a pixel's bits do not depend on its neighbours.
"""

import math

import numba
import numpy as np

from irodori.exponential import exp_negative

LANES = 64
_BLOCK = 16 * LANES  # pixels that a thread takes at a time
_SERIAL = 4 * _BLOCK  # pixels that are not worth waking threads for
_ROWS = 8  # that are summed at a time
_FAST = {"contract", "reassoc", "nsz", "arcp"}  # infinities and NaN keep their meaning
_LEAST_EXPONENT = -16.5  # of an anchor's share
_LEAST_SHARE = 1e-7  # of an anchor in a pixel's map; less would not show in float32
_LEAST_SIGNAL = 1e-3  # of the squared length of a response, where its noise is larger than itself


@numba.njit(cache=True)
def _rows(count):
    """Return a number of rows that can be summed: the count, rounded up to a multiple of 8."""
    return (count + _ROWS - 1) // _ROWS * _ROWS


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _load(response, first, count, inverse_scale, x, c, length):
    """Fill x (bands, LANES) with scaled responses, the first rows of c with their directions, and length (LANES,).

    Pixels beyond `count` are 1 in every band.
    """
    bands = x.shape[0]
    for b in range(bands):
        for j in range(LANES):
            x[b, j] = 1.0
        for j in range(count):
            x[b, j] = response[first + j, b] * inverse_scale[b]
    for j in range(LANES):
        length[j] = 0.0
    for b in range(bands):
        for j in range(LANES):
            length[j] += x[b, j] * x[b, j]
    for j in range(LANES):
        length[j] = math.sqrt(length[j])
    for b in range(bands):
        for j in range(LANES):
            c[b, j] = x[b, j] / length[j] if length[j] > 0.0 else 0.0


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _combine(rows, count, weight, total):
    """Fill total (LANES,) with the weighted sum of the first rows; `count` is a multiple of 8."""
    for j in range(LANES):
        total[j] = 0.0
    for r in range(0, count, _ROWS):
        w0, w1, w2, w3 = weight[r], weight[r + 1], weight[r + 2], weight[r + 3]
        w4, w5, w6, w7 = weight[r + 4], weight[r + 5], weight[r + 6], weight[r + 7]
        for j in range(LANES):
            total[j] += (
                w0 * rows[r, j] + w1 * rows[r + 1, j] + w2 * rows[r + 2, j] + w3 * rows[r + 3, j]
                + w4 * rows[r + 4, j] + w5 * rows[r + 5, j] + w6 * rows[r + 6, j] + w7 * rows[r + 7, j]
            )  # fmt: skip


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _combine_two(rows, count, first_weight, second_weight, first, second):
    """Fill two sums as `_combine` does one; each row is loaded once for both."""
    for j in range(LANES):
        first[j] = 0.0
        second[j] = 0.0
    for r in range(0, count, 4):
        w0, w1, w2, w3 = first_weight[r], first_weight[r + 1], first_weight[r + 2], first_weight[r + 3]
        v0, v1, v2, v3 = second_weight[r], second_weight[r + 1], second_weight[r + 2], second_weight[r + 3]
        for j in range(LANES):
            r0, r1, r2, r3 = rows[r, j], rows[r + 1, j], rows[r + 2, j], rows[r + 3, j]
            first[j] += w0 * r0 + w1 * r1 + w2 * r2 + w3 * r3
            second[j] += v0 * r0 + v1 * r1 + v2 * r2 + v3 * r3


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _store(values, length, first, count, out):
    """Write rows (k, LANES) into out, NaN where the length is not finite."""
    for k in range(out.shape[1]):
        for j in range(count):
            out[first + j, k] = values[k, j] if math.isfinite(length[j]) else np.nan


@numba.njit(cache=True, nogil=True)
def _place_levels(variance, first, count, bands, levels, spread, width, length, position, inverse):
    """Fill where each pixel's relative variance lies among the levels, and one over its squared width.

    A variance of zero, or below the lowest level, counts as the lowest level, an infinite one as the highest. Where the
    variance is negative or NaN, the length becomes NaN, and so does the pixel.
    """
    last = float(levels.size - 1)
    step = levels[1] - levels[0]
    for j in range(LANES):
        position[j] = 0.0
    for j in range(count):
        own = variance[first + j]
        if not own >= 0.0:
            length[j] = np.nan
            continue
        squared = length[j] * length[j]
        signal = max(squared - bands * own, _LEAST_SIGNAL * squared)
        if signal > 0.0 and own > 0.0:
            position[j] = min(max((math.log(own / signal) - levels[0]) / step, 0.0), last)
    widest = spread * math.exp(levels[0] + last * step)
    for j in range(LANES):
        inverse[j] = 1.0 / (width * width + widest * exp_negative((position[j] - last) * step))


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _shares(anchors, c, inverse, share, largest, total):
    """Fill share (anchors, LANES): how much of each anchor's matrices a pixel takes, sum one; least shares are zero."""
    for j in range(LANES):
        largest[j] = -2.0
        total[j] = 0.0
    for a in range(anchors.shape[0]):
        _combine(c, c.shape[0], anchors[a], share[a])
        for j in range(LANES):
            largest[j] = share[a, j] if share[a, j] > largest[j] else largest[j]
    for a in range(anchors.shape[0]):
        for j in range(LANES):
            exponent = (share[a, j] - largest[j]) * inverse[j]
            value = exp_negative(exponent)
            share[a, j] = value if exponent > _LEAST_EXPONENT else 0.0
        for j in range(LANES):
            total[j] += share[a, j]
    for j in range(LANES):
        total[j] = 1.0 / total[j]
    for a in range(anchors.shape[0]):
        for j in range(LANES):
            value = share[a, j] * total[j]
            share[a, j] = value if value > _LEAST_SHARE else 0.0


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _pack(share, fade, packed, members):
    """Copy the rows of share that are not zero throughout, times `fade`; return their number, padded to 8 rows."""
    count = 0
    for a in range(share.shape[0]):
        total = 0.0
        for j in range(LANES):
            packed[count, j] = share[a, j] * fade[j]
        for j in range(LANES):
            total += share[a, j] * fade[j]
        if total > 0.0:
            members[count] = a
            count += 1
    padded = _rows(count)
    for r in range(count, padded):
        members[r] = -1
        for j in range(LANES):
            packed[r, j] = 0.0
    return padded


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _add_maps(maps, packed, members, padded, x, weight, blend, values):
    """Add to values (k, LANES) what the matrices of one level, blended, make of x."""
    bases = values.shape[0]
    for b in range(x.shape[0]):
        for k in range(0, bases, 2):
            other = min(k + 1, bases - 1)
            for r in range(padded):
                weight[0, r] = maps[members[r], b, k] if members[r] >= 0 else 0.0
                weight[1, r] = maps[members[r], b, other] if members[r] >= 0 else 0.0
            _combine_two(packed, padded, weight[0], weight[1], blend[0], blend[1])
            for row in range(k, other + 1):
                for j in range(LANES):
                    values[row, j] += x[b, j] * blend[row - k, j]


@numba.njit(cache=True, nogil=True)
def _local_block(first, last, response, variance, scale, anchors, width, levels, spread, maps, out):
    """Blend the matrices of the anchors, see `LocalMapping`."""
    bands, count, bases = scale.size, anchors.shape[0], out.shape[1]
    x, c = np.empty((bands, LANES)), np.zeros((_rows(bands), LANES))
    padded_anchors = np.zeros((count, _rows(bands)))
    padded_anchors[:, :bands] = anchors
    share, members = np.empty((count, LANES)), np.empty(count + _ROWS, np.int64)
    # Shares are found in float64; matrices are blended in the type of the response.
    values, blend = np.empty((bases, LANES), response.dtype), np.empty((2, LANES), response.dtype)
    packed, weight = np.empty((count + _ROWS, LANES), response.dtype), np.empty((2, count + _ROWS), response.dtype)
    scaled = np.empty((bands, LANES), response.dtype)
    length, position, inverse, fade = np.empty(LANES), np.empty(LANES), np.empty(LANES), np.empty(LANES)
    largest, total = np.empty(LANES), np.empty(LANES)
    inverse_scale = 1.0 / scale
    fade[:] = 1.0
    inverse[:] = 1.0 / (width * width)
    for start in range(first, last, LANES):
        pixels = min(LANES, last - start)
        _load(response, start, pixels, inverse_scale, x, c, length)
        if variance.size > 0:
            _place_levels(variance, start, pixels, bands, levels, spread, width, length, position, inverse)
        _shares(padded_anchors, c, inverse, share, largest, total)
        scaled[:] = x
        values[:] = 0.0
        if variance.size == 0:
            padded = _pack(share, fade, packed, members)
            _add_maps(maps[0], packed, members, padded, scaled, weight, blend, values)
        else:
            # Matrices are interpolated between levels: each level of the group counts where it is less than one away.
            for level in range(int(position.min()), min(int(position.max()) + 2, levels.size)):
                for j in range(LANES):
                    fade[j] = max(0.0, 1.0 - abs(position[j] - level))
                padded = _pack(share, fade, packed, members)
                _add_maps(maps[level + 1], packed, members, padded, scaled, weight, blend, values)
        _store(values, length, start, pixels, out)


def local_weights(response, variance, scale, anchors, width, levels, spread, maps, out):
    """Fill out (n, k) for responses (n, bands); variance is (n,) or empty."""
    if len(response) <= _SERIAL:
        _local_block(0, len(response), response, variance, scale, anchors, width, levels, spread, maps, out)
    else:
        _local_parallel(response, variance, scale, anchors, width, levels, spread, maps, out)


@numba.njit(cache=True, parallel=True, nogil=True)
def _local_parallel(response, variance, scale, anchors, width, levels, spread, maps, out):
    blocks = (response.shape[0] + _BLOCK - 1) // _BLOCK
    for block in numba.prange(blocks):
        _local_block(
            block * _BLOCK, min((block + 1) * _BLOCK, response.shape[0]),
            response, variance, scale, anchors, width, levels, spread, maps, out,
        )  # fmt: skip


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _monomials(x, c, terms):
    """Fill terms (monomials, LANES): x_i, x_i c_j and x_i c_j c_k with i ≤ j ≤ k."""
    bands = x.shape[0]
    row = bands
    for i in range(bands):
        for n in range(LANES):
            terms[i, n] = x[i, n]
        for j in range(i, bands):
            for n in range(LANES):
                terms[row, n] = x[i, n] * c[j, n]
            row += 1
    product = bands
    for i in range(bands):
        for j in range(i, bands):
            for k in range(j, bands):
                for n in range(LANES):
                    terms[row, n] = terms[product, n] * c[k, n]
                row += 1
            product += 1


@numba.njit(cache=True, nogil=True)
def _polynomial_block(first, last, response, scale, coefficients, out):
    """Sum homogeneous monomials of degree one to three; coefficients are (k, monomials)."""
    bands, (bases, count) = scale.size, coefficients.shape
    padded = _rows(count)
    x, c, values = np.empty((bands, LANES)), np.empty((bands, LANES)), np.empty((bases, LANES))
    terms, weight, length = np.zeros((padded, LANES)), np.zeros((bases, padded)), np.empty(LANES)
    weight[:, :count] = coefficients
    inverse_scale = 1.0 / scale
    for start in range(first, last, LANES):
        pixels = min(LANES, last - start)
        _load(response, start, pixels, inverse_scale, x, c, length)
        _monomials(x, c, terms)
        for k in range(bases):
            _combine(terms, padded, weight[k], values[k])
        _store(values, length, start, pixels, out)


def polynomial_weights(response, scale, coefficients, out):
    """Fill out (n, k) for responses (n, bands); coefficients are (k, monomials), each row in one piece."""
    if len(response) <= _SERIAL:
        _polynomial_block(0, len(response), response, scale, coefficients, out)
    else:
        _polynomial_parallel(response, scale, coefficients, out)


@numba.njit(cache=True, parallel=True, nogil=True)
def _polynomial_parallel(response, scale, coefficients, out):
    blocks = (response.shape[0] + _BLOCK - 1) // _BLOCK
    for block in numba.prange(blocks):
        _polynomial_block(
            block * _BLOCK, min((block + 1) * _BLOCK, response.shape[0]), response, scale, coefficients, out
        )
