"""Compiled loops of the non-linear mappings; every one is positively homogeneous of degree 1 in the response."""

import math

import numba
import numpy as np

_BLOCK = 1024  # pixels that a thread takes at a time
_SERIAL = 4 * _BLOCK  # pixels that are not worth waking threads for
_LEAST_SHARE = 1e-7  # of an anchor in a pixel's map; less would not show in float32


@numba.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"})
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


@numba.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"})
def _add_map(x, weight, matrix, y):
    for b in range(x.size):
        part = weight * x[b]
        for k in range(y.size):
            y[k] += part * matrix[b, k]


@numba.njit(cache=True, nogil=True)
def _local_block(first, last, response, variance, scale, anchors, width, levels, spread, maps, out):
    """Blend the maps of the anchors, see `LocalMapping`."""
    bands, count, bases = scale.size, anchors.shape[0], out.shape[1]
    x, c, y = np.empty(bands), np.empty(bands), np.empty(bases)
    share = np.empty(count)
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
            cosine = 0.0
            for b in range(bands):
                cosine += anchors[a, b] * c[b]
            share[a] = cosine
            largest = max(largest, cosine)
        total = 0.0
        for a in range(count):
            exponent = (share[a] - largest) / squared_width
            share[a] = math.exp(exponent) if exponent > -20.0 else 0.0
            total += share[a]
        y[:] = 0.0
        for a in range(count):
            weight = share[a] / total
            if weight > _LEAST_SHARE:
                _add_map(x, weight * (1.0 - fraction), maps[lower, a], y)
                if fraction > 0.0:
                    _add_map(x, weight * fraction, maps[lower + 1, a], y)
        for k in range(bases):
            out[n, k] = y[k]


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


@numba.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"})
def _add_row(value, row, y):
    for k in range(y.size):
        y[k] += value * row[k]


@numba.njit(cache=True, nogil=True)
def _polynomial_block(first, last, response, scale, coefficients, out):
    """Sum homogeneous monomials of degree one to three, see `PolynomialMapping`."""
    bands = scale.size
    x, c, y = np.empty(bands), np.empty(bands), np.empty(out.shape[1])
    for n in range(first, last):
        if not math.isfinite(_direction(response[n], scale, x, c)):
            out[n] = np.nan
            continue
        y[:] = 0.0
        for i in range(bands):
            _add_row(x[i], coefficients[i], y)
        row = bands
        for i in range(bands):
            for j in range(i, bands):
                _add_row(x[i] * c[j], coefficients[row], y)
                row += 1
        for i in range(bands):
            for j in range(i, bands):
                product = x[i] * c[j]
                for k in range(j, bands):
                    _add_row(product * c[k], coefficients[row], y)
                    row += 1
        for k in range(out.shape[1]):
            out[n, k] = y[k]


def polynomial_weights(response, scale, coefficients, out):
    """Fill out (n, k) for responses (n, bands)."""
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
