"""Compiled loops of `irodori.registration.fit`: gradients at fractional places and sums over them.

Pictures of the pyramid are (height, width, 4) float32: three bands and the share of valid pixels. Derivatives are
those of the picture convolved with a quintic B-spline, taken at any place: the spline's weights sum to one and its
derivatives' to zero at every fraction of a pixel, so neither brightness nor noise leaks into a gradient with the
fraction (M. Unser, "Splines", IEEE Signal Processing Magazine 16(6), 1999). Its response is sinc⁶(f): 0.067 at
Nyquist, which keeps what superpixels alias down.
"""

import math

import numba
import numpy as np

TAPS = 6
_SUMS = 4 + 16 + 5


@numba.njit(cache=True, inline="always")
def _spline(t, w, d, e):
    """Fill the weights of the quintic B-spline and of its two derivatives for the taps -2..3 around a fraction t."""
    w[0] = 1.0
    for degree in range(1, TAPS):
        if degree == TAPS - 2:
            # Second differences of the cubic are the second derivative of the quintic.
            for j in range(TAPS):
                low2 = w[j - 2] if j >= 2 else 0.0
                low1 = w[j - 1] if 1 <= j <= degree else 0.0
                low0 = w[j] if j < degree else 0.0
                e[j] = low2 - 2.0 * low1 + low0
        if degree == TAPS - 1:
            for j in range(TAPS):
                d[j] = (w[j - 1] if j >= 1 else 0.0) - (w[j] if j < degree else 0.0)
        previous = 0.0
        for j in range(degree + 1):
            here = w[j] if j < degree else 0.0
            w[j] = ((t + degree - j) * previous + (1.0 + j - t) * here) / degree
            previous = here


def spline_power() -> tuple[float, float, float]:
    """Return the sums of the squared weights of the spline and of its two derivatives, at a pixel."""
    kernels = np.zeros((3, TAPS))
    _spline(0.0, *kernels)
    value, first, second = (kernels**2).sum(axis=1)
    return float(value), float(first), float(second)


@numba.njit(cache=True, inline="always")
def _least_weight(level, x, y):
    least = np.float32(1.0)
    for j in range(TAPS):
        for i in range(TAPS):
            least = min(least, level[y + j, x + i, 3])
    return least


@numba.njit(cache=True)
def _template_cell(level, places, count, offsets, gradient, curvature, weight):
    wx, dx, ex = np.empty(TAPS), np.empty(TAPS), np.empty(TAPS)
    wy, dy, ey = np.empty(TAPS), np.empty(TAPS), np.empty(TAPS)
    for n in range(count):
        weight[n] = 1.0
        for c in range(3):
            fx, fy = places[n, 0] + offsets[c, 0], places[n, 1] + offsets[c, 1]
            x, y = math.floor(fx), math.floor(fy)
            _spline(fx - x, wx, dx, ex)
            _spline(fy - y, wy, dy, ey)
            x, y = int(x) - 2, int(y) - 2
            if x < 0 or y < 0 or x + TAPS > level.shape[1] or y + TAPS > level.shape[0]:
                weight[n] = 0.0
                break
            weight[n] = min(weight[n], _least_weight(level, x, y))
            gx = gy = gxx = gxy = gyy = 0.0
            for j in range(TAPS):
                value = first = second = 0.0
                for i in range(TAPS):
                    v = level[y + j, x + i, c]
                    value += wx[i] * v
                    first += dx[i] * v
                    second += ex[i] * v
                gx += wy[j] * first
                gy += dy[j] * value
                gxx += wy[j] * second
                gxy += dy[j] * first
                gyy += ey[j] * value
            gradient[n, c, 0], gradient[n, c, 1] = gx, gy
            curvature[n, c, 0], curvature[n, c, 1], curvature[n, c, 2] = gxx, gxy, gyy


@numba.njit(cache=True, parallel=True, nogil=True)
def template(level, places, counts, offsets):
    """Return gradients and second derivatives of the fixed picture at chosen places.

    Returns
    -------
    gradient : (cells, quota, 3, 2) float32, along x and y
    curvature : (cells, quota, 3, 3) float32, xx xy yy
    weight : (cells, quota) float32, least share of valid pixels under the kernel, 0 outside
    """
    cells, quota = places.shape[:2]
    gradient = np.zeros((cells, quota, 3, 2), dtype=np.float32)
    curvature = np.zeros((cells, quota, 3, 3), dtype=np.float32)
    weight = np.zeros((cells, quota), dtype=np.float32)
    for cell in numba.prange(cells):
        _template_cell(level, places[cell], counts[cell], offsets, gradient[cell], curvature[cell], weight[cell])
    return gradient, curvature, weight


@numba.njit(cache=True)
def _sample_cell(level, places, count, offsets, affine, fixed_weight, gradient, weight):
    wx, dx, ex = np.empty(TAPS), np.empty(TAPS), np.empty(TAPS)
    wy, dy, ey = np.empty(TAPS), np.empty(TAPS), np.empty(TAPS)
    for n in range(count):
        weight[n] = fixed_weight[n]
        if fixed_weight[n] <= 0.0:
            continue
        px, py = places[n, 0], places[n, 1]
        for c in range(3):
            if c == 0 or offsets[c, 0] != offsets[c - 1, 0] or offsets[c, 1] != offsets[c - 1, 1]:
                fx = affine[0, 0] * px + affine[0, 1] * py + affine[0, 2] + offsets[c, 0]
                fy = affine[1, 0] * px + affine[1, 1] * py + affine[1, 2] + offsets[c, 1]
                if not (2.0 <= fx < level.shape[1] - 3.0 and 2.0 <= fy < level.shape[0] - 3.0):
                    weight[n] = 0.0
                    break
                x, y = int(fx), int(fy)
                _spline(fx - x, wx, dx, ex)
                _spline(fy - y, wy, dy, ey)
                x, y = x - 2, y - 2
                weight[n] = min(weight[n], _least_weight(level, x, y))
            gx = gy = 0.0
            for j in range(TAPS):
                value = first = 0.0
                for i in range(TAPS):
                    v = level[y + j, x + i, c]
                    value += wx[i] * v
                    first += dx[i] * v
                gx += wy[j] * first
                gy += dy[j] * value
            # Derivatives along the fixed picture's axes.
            gradient[n, c, 0] = affine[0, 0] * gx + affine[1, 0] * gy
            gradient[n, c, 1] = affine[0, 1] * gx + affine[1, 1] * gy


@numba.njit(cache=True, parallel=True, nogil=True)
def sample(level, places, counts, offsets, affine, fixed_weight):
    """Return gradients of the moving picture, along the fixed picture's axes, at the images of chosen places.

    Parameters
    ----------
    affine : (2, 3) float64
        Moving from fixed coordinates of this level.
    fixed_weight : (cells, quota) float32
        Weights of the places in the fixed picture.

    Returns
    -------
    gradient : (cells, quota, 3, 2) float32
    weight : (cells, quota) float32, the smaller of the two pictures'
    """
    cells, quota = places.shape[:2]
    gradient = np.zeros((cells, quota, 3, 2), dtype=np.float32)
    weight = np.zeros((cells, quota), dtype=np.float32)
    for cell in numba.prange(cells):
        _sample_cell(
            level, places[cell], counts[cell], offsets, affine, fixed_weight[cell], gradient[cell], weight[cell]
        )
    return gradient, weight


@numba.njit(cache=True)
def _moments_cell(fixed, moving, weight, count, out):
    for n in range(count):
        w = weight[n]
        if w == 0.0:
            continue
        for a in range(2):
            for i in range(3):
                for j in range(3):
                    out[0, i, j] += w * fixed[n, i, a] * fixed[n, j, a]
                    out[1, i, j] += w * moving[n, i, a] * fixed[n, j, a]


@numba.njit(cache=True, parallel=True, nogil=True)
def moments(fixed, moving, weight, counts):
    """Return weighted sums (cells, 2, 3, 3): fixed·fixedᵀ and moving·fixedᵀ."""
    out = np.zeros((counts.size, 2, 3, 3))
    for cell in numba.prange(counts.size):
        _moments_cell(fixed[cell], moving[cell], weight[cell], counts[cell], out[cell])
    return out


@numba.njit(cache=True)
def _residual_cell(fixed, moving, colour, count, residual):
    for n in range(count):
        for i in range(3):
            for a in range(2):
                total = moving[n, i, a]
                for j in range(3):
                    total -= colour[i, j] * fixed[n, j, a]
                residual[n, i, a] = total


@numba.njit(cache=True, parallel=True, nogil=True)
def residuals(fixed, moving, colour, counts):
    """Return moving minus colour times fixed gradients, (cells, quota, 3, 2) float32."""
    out = np.zeros_like(moving)
    for cell in numba.prange(counts.size):
        _residual_cell(fixed[cell], moving[cell], colour[cell], counts[cell], out[cell])
    return out


@numba.njit(cache=True)
def _score_cell(places, residual, predicted_from, curvature, colour, valid, count, sigma, slope, geometry, weight, out):
    """Sum score and information of one cell; ``weight`` receives the weights of its places."""
    scale, cx, cy, reach = geometry
    for n in range(count):
        weight[n] = 0.0
        if valid[n] <= 0.0:
            continue
        misfit, axx, axy, ayy, bx, by = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(3):
            hxx = hxy = hyy = expected = 0.0
            for a in range(2):
                total = 0.0
                for j in range(3):
                    total += colour[i, j] * predicted_from[n, j, a]
                expected += total * total
            for j in range(3):
                hxx += colour[i, j] * curvature[n, j, 0]
                hxy += colour[i, j] * curvature[n, j, 1]
                hyy += colour[i, j] * curvature[n, j, 2]
            rx, ry = residual[n, i, 0], residual[n, i, 1]
            inverse = 1.0 / (sigma[i] * sigma[i] + slope * slope * expected)
            misfit += (rx * rx + ry * ry) * inverse
            axx += inverse * (hxx * hxx + hxy * hxy)
            axy += inverse * (hxx * hxy + hxy * hyy)
            ayy += inverse * (hxy * hxy + hyy * hyy)
            bx += inverse * (hxx * rx + hxy * ry)
            by += inverse * (hxy * rx + hyy * ry)
        length = math.sqrt(misfit / 6.0)
        # Huber's weight, squared beyond: what lies far off pulls less and less.
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


@numba.njit(cache=True, parallel=True, nogil=True)
def scores(places, residual, fixed, curvature, colour, valid, counts, sigma, slope, geometry):
    """Return sums of score and information of each cell, in superpixels, and the weights of the places.

    Parameters
    ----------
    sigma : (3,) float64
        Standard deviation of a residual in each band.
    slope : float
        Further standard deviation of a residual as a share of the gradient that the colour map predicts.
    geometry : (4,) float64
        Superpixels in a pixel of this level; centre x, y and rms radius of the picture, superpixels.

    Returns
    -------
    sums : (cells, 25) float64
        0-3 score of t_x, t_y, a, b; 4-19 upper half of their information; 20-22 information xx, xy, yy of a
        translation; 23 Σw; 24 Σ of weighted squared residuals.
    weight : (cells, quota) float32
    """
    sums = np.zeros((counts.size, _SUMS))
    weight = np.zeros(valid.shape, dtype=np.float32)
    for c in numba.prange(counts.size):
        _score_cell(
            places[c], residual[c], fixed[c], curvature[c], colour[c], valid[c], counts[c], sigma, slope, geometry,
            weight[c], sums[c],
        )  # fmt: skip
    return sums, weight
