"""Compiled loops of `irodori.ingest.registration.similarity_fit`: interpolated gradients and sums over them.

Pictures of the pyramid are (height, width, 4) float32: three bands and the share of valid pixels. Derivatives are those
of the picture convolved with a quintic B-spline, at any place. At every fraction of a pixel, the weights of the spline
sum to one and those of its derivatives to zero, so neither brightness nor noise biases a gradient depending on the
fraction (M. Unser, "Splines", IEEE Signal Processing Magazine 16(6), 1999). The frequency response is sinc⁶(f), 0.067
at the Nyquist frequency, which suppresses the aliasing of superpixels.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit

TAPS = 6
_SUMS = 4 + 16 + 5
_ROWS, _CELLS = 64, 256  # rows, or cells, that a thread takes at a time


@njit(cache=True, forceinline=True)
def _cubic(t):
    """Return the weights of the cubic B-spline for the taps -1..2 around a fraction t."""
    s = 1.0 - t
    c0, c3 = s * s * s / 6.0, t * t * t / 6.0
    c1 = (0.5 * t - 1.0) * t * t + 2.0 / 3.0
    return c0, c1, 1.0 - c0 - c1 - c3, c3


@njit(cache=True, forceinline=True)
def _quintic(t):
    """Return the weights of the quintic B-spline and of its derivative for the taps -2..3 around a fraction t."""
    c0, c1, c2, c3 = _cubic(t)
    # Degree by degree (de Boor); differences of the quartic are the derivative of the quintic.
    q0, q1 = 0.25 * (1.0 - t) * c0, 0.25 * ((t + 3.0) * c0 + (2.0 - t) * c1)
    q2, q3, q4 = 0.25 * ((t + 2.0) * c1 + (3.0 - t) * c2), 0.25 * ((t + 1.0) * c2 + (4.0 - t) * c3), 0.25 * t * c3
    w0, w1 = 0.2 * (1.0 - t) * q0, 0.2 * ((t + 4.0) * q0 + (2.0 - t) * q1)
    w2, w3 = 0.2 * ((t + 3.0) * q1 + (3.0 - t) * q2), 0.2 * ((t + 2.0) * q2 + (4.0 - t) * q3)
    w4, w5 = 0.2 * ((t + 1.0) * q3 + (5.0 - t) * q4), 0.2 * t * q4
    return (w0, w1, w2, w3, w4, w5), (-q0, q0 - q1, q1 - q2, q2 - q3, q3 - q4, q4)


@njit(cache=True, forceinline=True)
def _second(t):
    """Return the weights of the second derivative of the quintic B-spline: second differences of the cubic."""
    c0, c1, c2, c3 = _cubic(t)
    return c0, c1 - 2.0 * c0, c2 - 2.0 * c1 + c0, c3 - 2.0 * c2 + c1, c2 - 2.0 * c3, c3


def spline_power() -> tuple[float, float, float]:
    """Return the sums of the squared weights of the spline and of its first two derivatives, at a pixel's centre."""
    own, first, second = (float(np.square(weights).sum()) for weights in (*_quintic(0.0), _second(0.0)))
    return own, first, second


@njit(cache=True, forceinline=True, fastmath={"contract"})
def _row(values, p, w):
    """Return the weighted sum of six pixels of a row, in the band to which index ``p`` points."""
    four = np.uint64(4)
    a, b = w[0] * values[p], w[1] * values[p + four]
    p += four + four
    a += w[2] * values[p]
    b += w[3] * values[p + four]
    p += four + four
    return (a + w[4] * values[p]) + (b + w[5] * values[p + four])


@njit(cache=True, forceinline=True)
def _less(a, b):
    # Compiles to one instruction for eight numbers, unlike min() with its rules for NaN.
    return a if a < b else b


@njit(cache=True, nogil=True)
def _least_along_rows(level, along, first, last):
    """Fill the smallest share of valid pixels among the taps -2..3 along rows."""
    for y in range(first, last):
        share, out = level[y, :, 3].copy(), along[y]
        for i in range(share.size - 5):
            a, b = _less(share[i], share[i + 1]), _less(share[i + 2], share[i + 3])
            out[i + 2] = _less(_less(a, b), _less(share[i + 4], share[i + 5]))


@njit(cache=True)
def _least_of_six(along, y, out):
    """Fill the minimum of six rows, from two above ``y`` to three below it."""
    r0, r1, r2, r3, r4, r5 = along[y - 2], along[y - 1], along[y], along[y + 1], along[y + 2], along[y + 3]
    for i in range(out.size):
        out[i] = _less(_less(_less(r0[i], r1[i]), _less(r2[i], r3[i])), _less(r4[i], r5[i]))


@njit(cache=True, nogil=True)
def _least_of_rows(along, least, first, last):
    for y in range(max(first, 2), min(last, along.shape[0] - 3)):
        _least_of_six(along, y, least[y])


def least_share(level):
    """Return the smallest share of valid pixels in the 6 x 6 taps of the spline at each pixel, (h, w); 0 at borders."""
    along, out = np.zeros(level.shape[:2], dtype=np.float32), np.zeros(level.shape[:2], dtype=np.float32)
    run_chunks(_least_along_rows, len(along), _ROWS, level, along)
    run_chunks(_least_of_rows, len(along), _ROWS, along, out)
    return out


class Places(NamedTuple):
    """Places of the fixed picture at which gradients are compared, by cell."""

    xy: np.ndarray  # (cells, quota, 2) int32, x then y
    counts: np.ndarray  # (cells,) int64, number of places in each cell
    offsets: np.ndarray  # (3, 2) positions of the bands, pixels of the level
    #: (4,) superpixels per pixel of the level; centre x, y and RMS radius of the picture, superpixels.
    geometry: np.ndarray


class Fixed(NamedTuple):
    """Derivatives of the fixed picture at the places, float32."""

    gradient: np.ndarray  # (cells, quota, 3, 2) along x and y
    curvature: np.ndarray  # (cells, quota, 3, 3) second derivatives xx xy yy
    weight: np.ndarray  # (cells, quota) smallest share of valid pixels under the kernel, 0 outside


class Moving(NamedTuple):
    """Gradients of the moving picture at the transformed places, float32."""

    gradient: np.ndarray  # (cells, quota, 3, 2) along the fixed picture's axes
    valid: np.ndarray  # (cells, quota) the smaller share of valid pixels of the two pictures


class Residuals(NamedTuple):
    """Colour map, and expected statistics of the residuals of the gradients."""

    colour: np.ndarray  # (cells, 3, 3) map from fixed to moving gradients
    sigma: np.ndarray  # (3,) standard deviation in each band
    slope: float  # further standard deviation as a share of the gradient that the colour map predicts


@njit(cache=True, fastmath={"contract"})
def _template_cell(values, least, chosen, fixed, cell):
    places, count, offsets = chosen.xy[cell], chosen.counts[cell], chosen.offsets
    gradient, curvature, weight = fixed.gradient[cell], fixed.curvature[cell], fixed.weight[cell]
    height, width = least.shape
    line = np.uint64(4 * width)
    for n in range(count):
        weight[n] = 1.0
        for c in range(3):
            fx, fy = places[n, 0] + offsets[c, 0], places[n, 1] + offsets[c, 1]
            if not (2.0 <= fx < width - 3.0 and 2.0 <= fy < height - 3.0):
                weight[n] = 0.0
                break
            x, y = int(fx), int(fy)
            weight[n] = min(weight[n], least[y, x])
            wx, dx = _quintic(fx - x)
            wy, dy = _quintic(fy - y)
            ex, ey = _second(fx - x), _second(fy - y)
            gx = gy = gxx = gxy = gyy = 0.0
            p = np.uint64(((y - 2) * width + x - 2) * 4 + c)
            for j in range(TAPS):
                value, first, second = _row(values, p, wx), _row(values, p, dx), _row(values, p, ex)
                gx += wy[j] * first
                gy += dy[j] * value
                gxx += wy[j] * second
                gxy += dy[j] * first
                gyy += ey[j] * value
                p += line
            gradient[n, c, 0], gradient[n, c, 1] = gx, gy
            curvature[n, c, 0], curvature[n, c, 1], curvature[n, c, 2] = gxx, gxy, gyy


@njit(cache=True, nogil=True)
def _template_some(values, least, places, fixed, first, last):
    for cell in range(first, last):
        _template_cell(values, least, places, fixed, cell)


def template(level, least, places):
    """Compute the derivatives of the fixed picture at the places; return them as `Fixed`.

    Parameters
    ----------
    level : (h, w, 4) float32
    least : (h, w) float32
        From `least_share`.
    places : Places
    """
    cells, quota = places.xy.shape[:2]
    gradient = np.zeros((cells, quota, 3, 2), dtype=np.float32)
    curvature = np.zeros((cells, quota, 3, 3), dtype=np.float32)
    fixed = Fixed(gradient, curvature, np.zeros((cells, quota), dtype=np.float32))
    run_chunks(_template_some, cells, _CELLS, level.ravel(), least, places, fixed)
    return fixed


class _Picture(NamedTuple):
    """A level of the moving picture, and the transform."""

    values: np.ndarray  # (h * w * 4,)
    least: np.ndarray  # (h, w), see `least_share`
    affine: np.ndarray  # (2, 3) moving from fixed coordinates of the level


@njit(cache=True, fastmath={"contract"})
def _sample_cell(picture, chosen, fixed, moving, cell):
    (values, least, affine), places, count, offsets = picture, chosen.xy[cell], chosen.counts[cell], chosen.offsets
    fixed_weight, gradient, weight = fixed.weight[cell], moving.gradient[cell], moving.valid[cell]
    height, width = least.shape
    line = np.uint64(4 * width)
    for n in range(count):
        weight[n] = fixed_weight[n]
        if fixed_weight[n] <= 0.0:
            continue
        px, py = places[n, 0], places[n, 1]
        mx = affine[0, 0] * px + affine[0, 1] * py + affine[0, 2]
        my = affine[1, 0] * px + affine[1, 1] * py + affine[1, 2]
        for c in range(3):
            fx, fy = mx + offsets[c, 0], my + offsets[c, 1]
            if not (2.0 <= fx < width - 3.0 and 2.0 <= fy < height - 3.0):
                weight[n] = 0.0
                break
            x, y = int(fx), int(fy)
            weight[n] = min(weight[n], least[y, x])
            wx, dx = _quintic(fx - x)
            wy, dy = _quintic(fy - y)
            gx = gy = 0.0
            p = np.uint64(((y - 2) * width + x - 2) * 4 + c)
            for j in range(TAPS):
                gx += wy[j] * _row(values, p, dx)
                gy += dy[j] * _row(values, p, wx)
                p += line
            # Derivatives along the fixed picture's axes.
            gradient[n, c, 0] = affine[0, 0] * gx + affine[1, 0] * gy
            gradient[n, c, 1] = affine[0, 1] * gx + affine[1, 1] * gy


@njit(cache=True)
def _moments_cell(counts, at_fixed, at_moving, weight, sums, cell):
    fixed, moving, out = at_fixed.gradient[cell], at_moving.gradient[cell], sums[cell]
    for n in range(counts[cell]):
        w = weight[cell, n] * at_moving.valid[cell, n]
        if w == 0.0:
            continue
        for a in range(2):
            for i in range(3):
                for j in range(3):
                    out[0, i, j] += w * fixed[n, i, a] * fixed[n, j, a]
                    out[1, i, j] += w * moving[n, i, a] * fixed[n, j, a]


@njit(cache=True, nogil=True)
def _sample_some(picture, places, fixed, moving, first, last):
    for cell in range(first, last):
        _sample_cell(picture, places, fixed, moving, cell)


def sample(level, least, affine, places, fixed):
    """Compute the gradients of the moving picture at the transformed places; return them as `Moving`.

    Parameters
    ----------
    level : (h, w, 4) float32
    least : (h, w) float32
        From `least_share`.
    affine : (2, 3) float64
        Transform from fixed to moving coordinates of this level.
    places : Places
    fixed : Fixed
    """
    cells, quota = places.xy.shape[:2]
    picture = _Picture(level.ravel(), least, affine)
    gradient = np.zeros((cells, quota, 3, 2), dtype=np.float32)
    moving = Moving(gradient, np.zeros((cells, quota), dtype=np.float32))
    run_chunks(_sample_some, cells, _CELLS, picture, places, fixed, moving)
    return moving


@njit(cache=True, nogil=True)
def _moments_some(counts, pictures, weight, sums, first, last):
    fixed, moving = pictures
    for cell in range(first, last):
        _moments_cell(counts, fixed, moving, weight, sums, cell)


def gradient_moments(counts, fixed, moving, weight):
    """Return the sums of fixed·fixedᵀ and moving·fixedᵀ over the gradients of each cell, (cells, 2, 3, 3) float64.

    Places are weighted by ``weight``, (cells, quota) float32, times the share of valid pixels.
    """
    sums = np.zeros((counts.size, 2, 3, 3))
    run_chunks(_moments_some, counts.size, _CELLS, counts, (fixed, moving), weight, sums)
    return sums


@njit(cache=True, nogil=True)
def residuals(fixed, moving, colour, chosen):
    """Return the gradients that the colour map predicts at some places, and the residuals.

    Parameters
    ----------
    fixed, moving : (cells, quota, 3, 2) float32
    colour : (cells, 3, 3) float64
    chosen : (n,) int64
        Indices of the places in flattened order.

    Returns
    -------
    predicted, residual : (3, n, 2) float32
    """
    quota = fixed.shape[1]
    predicted, residual = np.empty((3, chosen.size, 2), np.float32), np.empty((3, chosen.size, 2), np.float32)
    for at in range(chosen.size):
        cell, n = chosen[at] // quota, chosen[at] % quota
        for i in range(3):
            for a in range(2):
                total = 0.0
                for j in range(3):
                    total += colour[cell, i, j] * fixed[cell, n, j, a]
                predicted[i, at, a], residual[i, at, a] = total, moving[cell, n, i, a] - total
    return predicted, residual


class Scores(NamedTuple):
    """Score (gradient of the log-likelihood) and Fisher information of each cell, in superpixels, and weights."""

    #: (cells, 25) float64: 0-3 score of t_x, t_y, a, b; 4-19 upper half of their information; 20-22 information xx, xy,
    #: yy of a translation; 23 Σw; 24 sum of weighted squared residuals.
    sums: np.ndarray
    weight: np.ndarray  # (cells, quota) float32


@njit(cache=True)
def _score_cell(chosen, at_fixed, at_moving, expected, scores, cell):
    """Sum score and information of one cell."""
    scale, cx, cy, reach = chosen.geometry
    places, count = chosen.xy[cell], chosen.counts[cell]
    fixed, curvature = at_fixed.gradient[cell], at_fixed.curvature[cell]
    moving, valid = at_moving.gradient[cell], at_moving.valid[cell]
    colour, sigma, slope = expected.colour[cell], expected.sigma, expected.slope
    weight, out = scores.weight[cell], scores.sums[cell]
    for n in range(count):
        weight[n] = 0.0
        if valid[n] <= 0.0:
            continue
        misfit, axx, axy, ayy, bx, by = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(3):
            hxx = hxy = hyy = gx = gy = 0.0
            for j in range(3):
                gx += colour[i, j] * fixed[n, j, 0]
                gy += colour[i, j] * fixed[n, j, 1]
                hxx += colour[i, j] * curvature[n, j, 0]
                hxy += colour[i, j] * curvature[n, j, 1]
                hyy += colour[i, j] * curvature[n, j, 2]
            rx, ry = moving[n, i, 0] - gx, moving[n, i, 1] - gy
            inverse = 1.0 / (sigma[i] * sigma[i] + slope * slope * (gx * gx + gy * gy))
            misfit += (rx * rx + ry * ry) * inverse
            axx += inverse * (hxx * hxx + hxy * hxy)
            axy += inverse * (hxx * hxy + hxy * hyy)
            ayy += inverse * (hxy * hxy + hyy * hyy)
            bx += inverse * (hxx * rx + hxy * ry)
            by += inverse * (hxy * rx + hyy * ry)
        length = math.sqrt(misfit / 6.0)
        # Huber's weight, squared: the influence of outliers decreases with their distance.
        w = 1.0 if length <= 1.5 else (1.5 / length) ** 2
        w *= valid[n] ** 4
        weight[n] = w
        u, v = ((places[n, 0] + 0.5) * scale - 0.5 - cx) / reach, ((places[n, 1] + 0.5) * scale - 0.5 - cy) / reach
        axx, axy, ayy = w * axx / scale**2, w * axy / scale**2, w * ayy / scale**2
        bx, by = w * bx / scale, w * by / scale
        out[20] += axx
        out[21] += axy
        out[22] += ayy
        out[23] += w
        out[24] += w * misfit
        # Displacement at the place: x = t_x + a u - b v, y = t_y + b u + a v.
        out[0] += bx
        out[1] += by
        out[2] += u * bx + v * by
        out[3] += u * by - v * bx
        out[4] += axx
        out[5] += axy
        out[6] += u * axx + v * axy
        out[7] += u * axy - v * axx
        out[9] += ayy
        out[10] += u * axy + v * ayy
        out[11] += u * ayy - v * axy
        out[14] += u * u * axx + 2.0 * u * v * axy + v * v * ayy
        out[15] += u * u * axy - u * v * axx + u * v * ayy - v * v * axy
        out[19] += u * u * ayy - 2.0 * u * v * axy + v * v * axx


@njit(cache=True, nogil=True)
def _score_some(places, pictures, expected, scores, first, last):
    fixed, moving = pictures
    for cell in range(first, last):
        _score_cell(places, fixed, moving, expected, scores, cell)


def score(places, fixed, moving, expected):
    """Compute the `Scores` of the cells.

    Parameters
    ----------
    places : Places
    fixed : Fixed
    moving : Moving
    expected : Residuals
    """
    scores = Scores(np.zeros((places.counts.size, _SUMS)), np.zeros(moving.valid.shape, dtype=np.float32))
    run_chunks(_score_some, places.counts.size, _CELLS, places, (fixed, moving), expected, scores)
    return scores
