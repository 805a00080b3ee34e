"""Compiled loops of the non-linear mappings, each homogeneous of degree 1 in the response.

Pixels are taken `LANES` at a time, each quantity a row with one number a pixel, so that the compiler turns the loop
over a row into vector instructions. No sum runs over pixels: a pixel's bits do not depend on its neighbours.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.jit.array_copies import copy_into
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit

LANES = 64
BLOCK = 64 * LANES  # pixels that a thread takes at a time
_ROWS = 8  # that are summed at a time
FAST = {"contract", "reassoc", "nsz", "arcp"}  # infinities and NaN keep their meaning


@njit(cache=True)
def _rows(count):
    """Return the count of rows rounded up to a multiple of 8, as `_combine` requires."""
    return (count + _ROWS - 1) // _ROWS * _ROWS


@njit(cache=True)
def inverse_of(scale):
    """Return the inverses of numbers, (bands,): a loop compiles faster than an expression of arrays."""
    inverse = np.empty(scale.size)
    for b in range(scale.size):
        inverse[b] = 1.0 / scale[b]
    return inverse


class Group(NamedTuple):
    """Scaled responses of a group of `LANES` pixels."""

    x: np.ndarray  # (bands, LANES)
    direction: np.ndarray  # (bands, LANES) x divided by its length
    length: np.ndarray  # (LANES,)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def load(response, first, count, inverse_scale, group):
    """Fill a `Group` with ``count`` responses from the index ``first``; its further pixels are 1 in every band."""
    x, c, length = group
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
    inverse = np.empty(LANES)
    for j in range(LANES):
        inverse[j] = 1.0 / length[j] if length[j] > 0.0 else 0.0
    for b in range(bands):
        for j in range(LANES):
            c[b, j] = x[b, j] * inverse[j]


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
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


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def store(values, length, first, count, out):
    """Write rows (k, LANES) into out, NaN where the length is not finite."""
    for k in range(out.shape[1]):
        for j in range(count):
            out[first + j, k] = values[k, j] if math.isfinite(length[j]) else np.nan


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
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


@njit(cache=True, nogil=True)
def _polynomial_block(response, scale, coefficients, out, first, last):
    """Sum homogeneous monomials of degree one to three; coefficients are (k, monomials)."""
    bands, (bases, count) = scale.size, coefficients.shape
    padded = _rows(count)
    x, c, values = np.empty((bands, LANES)), np.empty((bands, LANES)), np.empty((bases, LANES))
    terms, weight, length = np.zeros((padded, LANES)), np.zeros((bases, padded)), np.empty(LANES)
    copy_into(weight, coefficients)
    inverse_scale = inverse_of(scale)
    for start in range(first, last, LANES):
        pixels = min(LANES, last - start)
        load(response, start, pixels, inverse_scale, Group(x, c, length))
        _monomials(x, c, terms)
        for k in range(bases):
            _combine(terms, padded, weight[k], values[k])
        store(values, length, start, pixels, out)


def polynomial_weights(response, scale, coefficients, out):
    """Fill out (n, k) for responses (n, bands); coefficients are (k, monomials), C-contiguous."""
    run_chunks(_polynomial_block, len(response), BLOCK, response, scale, coefficients, out)
