"""Compiled loops of the non-linear mappings; every one is positively homogeneous of degree 1 in the response."""

import math

import numba
import numpy as np

_BLOCK = 1024  # pixels that a thread takes at a time
_SERIAL = 4 * _BLOCK  # pixels that are not worth waking threads for
_FAST = {"contract", "reassoc", "nsz", "arcp"}  # infinities and NaN keep their meaning
_LEAST_SHARE = 1e-7  # of an anchor in a pixel's map; less would not show in float32


@numba.njit(cache=True, nogil=True, fastmath=_FAST)
def _direction(response, scale, x, c):
    """Fill x with the scaled response and c with its direction; return its length."""
    length = 0.0
    for b in range(x.size):
        x[b] = response[b] / scale[b]
        length += x[b] * x[b]
    length = math.sqrt(length)
    for b in range(x.size):
        c[b] = x[b] / length if length > 0.0 else 0.0
    return length


@numba.njit(cache=True, nogil=True)
def _level(relative_variance, levels):
    """Return the position of a relative noise variance in the levels, 0..levels.size - 1."""
    last = levels.size - 1
    if not relative_variance > 0.0:
        return 0.0
    position = (math.log(relative_variance) - levels[0]) / (levels[1] - levels[0])
    return min(max(position, 0.0), float(last))


@numba.njit(cache=True, nogil=True, fastmath=_FAST)
def _add_map(weight, matrix, total):
    for i in range(total.size):
        total[i] += weight * matrix[i]


@numba.njit(cache=True, nogil=True, fastmath=_FAST)
def _dot(a, b):
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@numba.njit(cache=True, nogil=True)
def _local_block(first, last, response, variance, scale, anchors, width, levels, spread, maps, out):
    """Blend the maps of the anchors, see `LocalMapping`."""
    bands, count, bases = scale.size, anchors.shape[0], out.shape[1]
    x, c = np.empty(bands), np.empty(bands)
    share, blend = np.empty(count), np.empty(bands * bases)
    flat = maps.reshape(maps.shape[0], count, bands * bases)
    for n in range(first, last):
        length = _direction(response[n], scale, x, c)
        if not math.isfinite(length):
            out[n] = np.nan
            continue
        lower, fraction, squared_width = 0, 0.0, width * width
        if variance.size > 0 and length > 0.0:
            signal = max(length * length - bands * variance[n], 1e-3 * length * length)
            position = _level(variance[n] / signal, levels)
            lower = min(int(position), levels.size - 2)
            fraction = position - lower
            lower += 1  # map 0 is that of no stated variance
            squared_width += spread * math.exp(levels[0] + position * (levels[1] - levels[0]))
        largest = -np.inf
        for a in range(count):
            share[a] = _dot(anchors[a], c)
            largest = max(largest, share[a])
        total = 0.0
        for a in range(count):
            exponent = (share[a] - largest) / squared_width
            share[a] = math.exp(exponent) if exponent > -16.5 else 0.0
            total += share[a]
        blend[:] = 0.0
        for a in range(count):
            weight = share[a] / total
            if weight > _LEAST_SHARE:
                _add_map(weight * (1.0 - fraction), flat[lower, a], blend)
                if fraction > 0.0:
                    _add_map(weight * fraction, flat[lower + 1, a], blend)
        for k in range(bases):
            value = 0.0
            for b in range(bands):
                value += x[b] * blend[b * bases + k]
            out[n, k] = value


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


@numba.njit(cache=True, nogil=True)
def _polynomial_block(first, last, response, scale, coefficients, out):
    """Sum homogeneous monomials of degree one to three; coefficients are (k, monomials)."""
    bands = scale.size
    x, c, terms = np.empty(bands), np.empty(bands), np.empty(coefficients.shape[1])
    for n in range(first, last):
        if not math.isfinite(_direction(response[n], scale, x, c)):
            out[n] = np.nan
            continue
        terms[:bands] = x
        row = bands
        for i in range(bands):
            for j in range(i, bands):
                terms[row] = x[i] * c[j]
                row += 1
        for i in range(bands):
            for j in range(i, bands):
                product = x[i] * c[j]
                for k in range(j, bands):
                    terms[row] = product * c[k]
                    row += 1
        for k in range(out.shape[1]):
            out[n, k] = _dot(coefficients[k], terms)


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
