"""Compiled loops of `Posterior`: errors of recovered spectra, `TEXELS` texels at a time.

Each quantity is a row of numbers, one a texel, and a row is one vector: a texel's bits do not depend on its neighbours.
Square roots of the covariances are in single precision; what is subtracted to find them is in double.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.calibration.recovery.mapping_loops import FAST
from irodori.jit.compilation import njit
from irodori.jit.functions import root as square_root
from irodori.jit.vector_memory import load, spread, store

TEXELS = 16  # of a vector, in single precision
#: 0.6827 of the normal distribution lie below so many of its standard deviations.
_WITHIN_ONE = 0.4752


class ErrorModel(NamedTuple):
    """Constants of a calibration's posterior, with e errors stated for a spectrum and a missed part of rank r.

    Single precision where not said otherwise.
    """

    spectrum: np.ndarray  # (61, k) float64, basis
    near: np.ndarray  # (e, 61) float64, coefficients of the squared slopes in it
    level: float  # coefficient of the squared level in the missed part's variance
    slope: float  # that of the mean squared slope
    step: float  # interval of a slope, in steps of the grid
    open: np.ndarray  # (bands (bands + 1) / 2, k (k + 1) / 2) float64, what products of weights add to a covariance
    basis: np.ndarray  # (k, e), at the wavelengths of the stated errors
    missed: np.ndarray  # (e, r), missed part of unit size; r is a multiple of 4
    seen: np.ndarray  # (bands r, e), responses to the missed part
    ratio_basis: np.ndarray  # (k, 3), XYZ of the basis, in those of the white
    coloured: np.ndarray  # (3 r, e), XYZ of the missed part, in those of the white
    share: np.ndarray  # (e,), share of the wavelengths that an error stands for


class Recovered(NamedTuple):
    """Recovered spectra of n texels and what determines their errors."""

    weights: np.ndarray  # (n, k) float64
    slopes: np.ndarray  # (n, bands, k) float32, derivatives of the weights with respect to the response
    variance: np.ndarray  # (n, bands) float64
    ratio: np.ndarray  # (n, 3) float64, XYZ in those of the white
    metric: np.ndarray  # (n, 3, 3) float64, of CIEDE2000 about the colour


class Errors(NamedTuple):
    """Errors of n texels, to be filled; see `Uncertainty`."""

    deviation: np.ndarray  # (n, e) float32
    rms: np.ndarray  # (n,) float32
    delta_e: np.ndarray  # (n,) float32
    root: np.ndarray  # (n, e, r + bands) float32, square roots of the covariances; (0, e, r + bands) if not wanted


class _Rows(NamedTuple):
    """Numbers of a group of texels, in rows of `TEXELS`; single precision where not said otherwise."""

    weights: np.ndarray  # (k, TEXELS) float64
    spectrum: np.ndarray  # (61, TEXELS) float64
    steep: np.ndarray  # (61, TEXELS) float64, squared slopes of the spectrum
    products: np.ndarray  # (k (k + 1) / 2, TEXELS) float64, of the weights
    factor: np.ndarray  # (bands, bands, TEXELS) float64, Cholesky factor of the covariance of the response
    lower: np.ndarray  # the same
    size: np.ndarray  # (e, TEXELS), of the missed part
    seen: np.ndarray  # (bands, r, TEXELS), response to the missed part
    slopes: np.ndarray  # (bands, k, TEXELS)
    derivative: np.ndarray  # (bands, e, TEXELS), of the spectrum with respect to the response
    colour: np.ndarray  # (bands, 3, TEXELS), of XYZ
    moved: np.ndarray  # (3, r + bands, TEXELS), square root of the covariance of XYZ
    squares: np.ndarray  # (3, 3, TEXELS), that covariance


@njit(cache=True)
def _rows_for(model, bands):
    """Return rows for a group of texels."""
    samples, bases = model.spectrum.shape
    stated, rank = model.missed.shape
    single, pairs = np.float32, bases * (bases + 1) // 2
    return _Rows(
        np.zeros((bases, TEXELS)),
        np.empty((samples, TEXELS)),
        np.empty((samples, TEXELS)),
        np.empty((pairs, TEXELS)),
        np.empty((bands, bands, TEXELS)),
        np.empty((bands, bands, TEXELS), single),
        np.empty((stated, TEXELS), single),
        np.empty((bands, rank, TEXELS), single),
        np.zeros((bands, bases, TEXELS), single),
        np.empty((bands, stated, TEXELS), single),
        np.empty((bands, 3, TEXELS), single),
        np.empty((3, rank + bands, TEXELS), single),
        np.empty((3, 3, TEXELS), single),
    )


@njit(cache=True, nogil=True)
def _load(recovered, first, count, rows):
    """Fill the weights, their slopes and the variances of ``count`` texels; the latter are the factor's diagonal."""
    bands, bases = rows.slopes.shape[:2]
    for j in range(count):
        for k in range(bases):
            rows.weights[k, j] = recovered.weights[first + j, k]
        for b in range(bands):
            for k in range(bases):
                rows.slopes[b, k, j] = recovered.slopes[first + j, b, k]
            rows.factor[b, b, j] = recovered.variance[first + j, b]


@njit(cache=True, nogil=True)
def _weighted_sum(rows, table, row):
    """Return the sum of rows of double precision, weighted by a row of a table."""
    found = load(rows, 0, TEXELS) * table[row, 0]
    for k in range(1, table.shape[1]):
        found = found + load(rows, k * TEXELS, TEXELS) * table[row, k]
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _find_sizes(model, rows):
    """Fill the sizes of the missed parts of texels."""
    samples, stated = model.spectrum.shape[0], model.near.shape[0]
    squared, steep = spread(0.0, TEXELS), spread(0.0, TEXELS)
    for w in range(samples):
        value = _weighted_sum(rows.weights, model.spectrum, w)
        store(rows.spectrum, w * TEXELS, value)
        squared = squared + value * value
    for w in range(samples):
        lower, upper = max(w - 1, 0), min(w + 1, samples - 1)
        slope = load(rows.spectrum, upper * TEXELS, TEXELS) - load(rows.spectrum, lower * TEXELS, TEXELS)
        slope = slope * (model.step / (upper - lower))
        store(rows.steep, w * TEXELS, slope * slope)
        steep = steep + slope * slope
    common = (squared * model.level + steep * model.slope) * (1.0 / samples)
    for e in range(stated):
        size = square_root(common + _weighted_sum(rows.steep, model.near, e))
        store(rows.spectrum, 0, size)
        for j in range(TEXELS):
            rows.size[e, j] = rows.spectrum[0, j]


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _factorise(model, rows):
    """Fill the Cholesky factors of the covariances of responses; a pivot that rounding has made negative is zero."""
    bases, factor = rows.weights.shape[0], rows.factor
    bands = factor.shape[0]
    pair = 0
    for k in range(bases):
        for other in range(k + 1):
            for j in range(TEXELS):
                rows.products[pair, j] = rows.weights[k, j] * rows.weights[other, j]
            pair += 1
    pair = 0
    for b in range(bands):
        for c in range(b + 1):
            rest = _weighted_sum(rows.products, model.open, pair)
            pair += 1
            if b == c:
                rest = rest + load(factor, (b * bands + b) * TEXELS, TEXELS)
            for d in range(c):
                rest = rest - load(factor, (b * bands + d) * TEXELS, TEXELS) * load(
                    factor, (c * bands + d) * TEXELS, TEXELS
                )
            store(factor, (b * bands + c) * TEXELS, rest)
            for j in range(TEXELS):
                if b == c:
                    value = factor[b, b, j]
                    factor[b, b, j] = 0.0 if value < 0.0 else math.sqrt(value)
                else:
                    pivot = factor[c, c, j]
                    factor[b, c, j] = factor[b, c, j] / pivot if pivot != 0.0 else 0.0
                rows.lower[b, c, j] = factor[b, c, j]


@njit(cache=True, nogil=True)
def _times_sizes(table, row, size):
    """Return four sums over the sizes of the missed part, weighted by rows of a table from ``row`` on."""
    here = load(size, 0, TEXELS)
    one, two, three, four = (
        here * table[row, 0],
        here * table[row + 1, 0],
        here * table[row + 2, 0],
        here * table[row + 3, 0],
    )
    for e in range(1, table.shape[1]):
        here = load(size, e * TEXELS, TEXELS)
        one, two = one + here * table[row, e], two + here * table[row + 1, e]
        three, four = three + here * table[row + 2, e], four + here * table[row + 3, e]
    return one, two, three, four


@njit(cache=True, nogil=True)
def _less_explained(moved, derivative, at, seen, r):
    """Return four numbers of the missed part less what the response to it explains.

    Parameters
    ----------
    moved : tuple of four vectors
        Missed part.
    derivative : (bands, n, TEXELS) float32
    at : int
        Row of the derivative for each band, below n.
    seen : (bands, rank, TEXELS) float32
    r : int
        First of the four, below the rank.
    """
    one, two, three, four = moved
    step, rank = derivative.shape[1], seen.shape[1]
    for b in range(derivative.shape[0]):
        factor = load(derivative, (at + b * step) * TEXELS, TEXELS)
        place = (b * rank + r) * TEXELS
        one, two = one - factor * load(seen, place, TEXELS), two - factor * load(seen, place + TEXELS, TEXELS)
        place += 2 * TEXELS
        three, four = three - factor * load(seen, place, TEXELS), four - factor * load(seen, place + TEXELS, TEXELS)
    return one, two, three, four


@njit(cache=True, nogil=True)
def _by_response(derivative, at, lower, band):
    """Return the part of a root that comes from one of the factors of the response's covariance."""
    bands, step = derivative.shape[:2]
    found = load(derivative, (at + band * step) * TEXELS, TEXELS) * load(lower, (band * bands + band) * TEXELS, TEXELS)
    for b in range(band + 1, bands):
        factor = load(lower, (b * bands + band) * TEXELS, TEXELS)
        found = found + load(derivative, (at + b * step) * TEXELS, TEXELS) * factor
    return found


@njit(cache=True, nogil=True)
def _fill_products(slopes, basis, out):
    """Fill derivatives (bands, n, TEXELS) of what is the product of weights and a basis (k, n)."""
    bands, bases = slopes.shape[:2]
    count = basis.shape[1]
    for b in range(bands):
        for e in range(count):
            found = load(slopes, b * bases * TEXELS, TEXELS) * basis[0, e]
            for k in range(1, bases):
                found = found + load(slopes, (b * bases + k) * TEXELS, TEXELS) * basis[k, e]
            store(out, (b * count + e) * TEXELS, found)


@njit(cache=True, nogil=True)
def _fill_deviations(model, rows, first, count, errors):
    """Fill the standard deviations of ``count`` spectra, and the square roots of covariances where wanted."""
    (bands, rank), stated = rows.seen.shape[:2], rows.size.shape[0]
    wanted, single = errors.root.shape[0] > 0, np.float32(0.0)
    mean = spread(single, TEXELS)
    row = np.empty((4, TEXELS), np.float32)
    for e in range(stated):
        size, squares = load(rows.size, e * TEXELS, TEXELS), spread(single, TEXELS)
        for r in range(0, rank, 4):
            missed = (
                size * model.missed[e, r],
                size * model.missed[e, r + 1],
                size * model.missed[e, r + 2],
                size * model.missed[e, r + 3],
            )
            one, two, three, four = _less_explained(missed, rows.derivative, e, rows.seen, r)
            squares = squares + ((one * one + two * two) + (three * three + four * four))
            if wanted:
                store(row, 0, one)
                store(row, TEXELS, two)
                store(row, 2 * TEXELS, three)
                store(row, 3 * TEXELS, four)
                errors.root[first : first + count, e, r : r + 4] = row[:, :count].T
        for b in range(bands):
            noise = _by_response(rows.derivative, e, rows.lower, b)
            squares = squares + noise * noise
            if wanted:
                store(row, 0, noise)
                errors.root[first : first + count, e, rank + b] = row[0, :count]
        store(row, 0, square_root(squares))
        mean = mean + squares * model.share[e]
        for j in range(count):
            errors.deviation[first + j, e] = row[0, j]
    store(row, 0, square_root(mean))
    for j in range(count):
        errors.rms[first + j] = row[0, j]


@njit(cache=True, nogil=True)
def _fill_colours(model, rows):
    """Fill the covariances of XYZ."""
    bands, rank = rows.seen.shape[:2]
    for x in range(3):
        for r in range(0, rank, 4):
            missed = _times_sizes(model.coloured, x * rank + r, rows.size)
            place = (x * (rank + bands) + r) * TEXELS
            one, two, three, four = _less_explained(missed, rows.colour, x, rows.seen, r)
            store(rows.moved, place, one)
            store(rows.moved, place + TEXELS, two)
            store(rows.moved, place + 2 * TEXELS, three)
            store(rows.moved, place + 3 * TEXELS, four)
        for b in range(bands):
            noise = _by_response(rows.colour, x, rows.lower, b)
            store(rows.moved, (x * (rank + bands) + rank + b) * TEXELS, noise)
    for x in range(3):
        for y in range(x + 1):
            place, other = x * (rank + bands) * TEXELS, y * (rank + bands) * TEXELS
            found = load(rows.moved, place, TEXELS) * load(rows.moved, other, TEXELS)
            for r in range(1, rank + bands):
                right = load(rows.moved, other + r * TEXELS, TEXELS)
                found = found + load(rows.moved, place + r * TEXELS, TEXELS) * right
            store(rows.squares, (3 * x + y) * TEXELS, found)
            store(rows.squares, (3 * y + x) * TEXELS, found)


@njit(cache=True, nogil=True, error_model="numpy")
def _slope_of_lightness(ratio):
    """Return the derivative of the cube root of CIELAB at an XYZ in those of the white."""
    return ratio ** (-2.0 / 3.0) / 3.0 if ratio > (6.0 / 29.0) ** 3 else (29.0 / 6.0) ** 2 / 3.0


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_delta_e(recovered, rows, first, count, errors):
    """Fill the CIEDE2000 that normal errors do not exceed with a probability of 0.68.

    Near a colour the square of CIEDE2000 is a quadratic form of the errors. It is approximated by a scaled χ² variable
    with the same mean and variance (Satterthwaite 1946); the quantile follows by the cube root (Wilson and Hilferty
    1931).
    """
    lab, product = np.zeros((3, 3)), np.empty((3, 3))
    for j in range(count):
        x, y, z = (
            _slope_of_lightness(recovered.ratio[first + j, 0]),
            _slope_of_lightness(recovered.ratio[first + j, 1]),
            _slope_of_lightness(recovered.ratio[first + j, 2]),
        )
        lab[0, 1], lab[1, 0], lab[1, 1], lab[2, 1], lab[2, 2] = 116.0 * y, 500.0 * x, -500.0 * y, 200.0 * y, -200.0 * z
        mean, square = 0.0, 0.0
        # The covariance of CIELAB times the metric.
        for i in range(3):
            for k in range(3):
                total = 0.0
                for a in range(3):
                    along = 0.0
                    for b in range(3):
                        inner = 0.0
                        for c in range(3):
                            inner += lab[b, c] * rows.squares[a, c, j]
                        along += inner * recovered.metric[first + j, b, k]
                    total += lab[i, a] * along
                product[i, k] = total
        for i in range(3):
            mean += product[i, i]
            for k in range(3):
                square += product[i, k] * product[k, i]
        relative = 2.0 * square / (9.0 * mean * mean) if mean > 0.0 else 0.0
        errors.delta_e[first + j] = math.sqrt(mean * (1.0 - relative + _WITHIN_ONE * math.sqrt(relative)) ** 3)


@njit(cache=True, nogil=True)
def fill_errors(model, recovered, errors):
    """Fill the `Errors` of `Recovered` spectra."""
    rows = _rows_for(model, recovered.variance.shape[1])
    for first in range(0, len(recovered.weights), TEXELS):
        count = min(TEXELS, len(recovered.weights) - first)
        _load(recovered, first, count, rows)
        _find_sizes(model, rows)
        _factorise(model, rows)
        bands, rank = rows.seen.shape[:2]
        for row in range(0, bands * rank, 4):
            one, two, three, four = _times_sizes(model.seen, row, rows.size)
            store(rows.seen, row * TEXELS, one)
            store(rows.seen, (row + 1) * TEXELS, two)
            store(rows.seen, (row + 2) * TEXELS, three)
            store(rows.seen, (row + 3) * TEXELS, four)
        _fill_products(rows.slopes, model.basis, rows.derivative)
        _fill_products(rows.slopes, model.ratio_basis, rows.colour)
        _fill_deviations(model, rows, first, count, errors)
        _fill_colours(model, rows)
        _fill_delta_e(recovered, rows, first, count, errors)
