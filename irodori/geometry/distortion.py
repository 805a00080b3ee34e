"""Lens distortion in OpenCV's model, and its inverse.

A point (x, y) of the plane at unit distance from the camera is imaged at

    x'' = x R + 2 p1 x y + p2 (r² + 2 x²)        R = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)
    y'' = y R + p1 (r² + 2 y²) + 2 p2 x y

Far from the axis the polynomial folds back, so that two points have the same image. The model is not valid there, and
both functions return NaN.
"""

import math
from typing import TYPE_CHECKING

import numba
import numpy as np

from irodori.jit.compilation import njit

if TYPE_CHECKING:
    from irodori.config.models import Distortion

COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_STEPS = 60
_TOLERANCE = 1e-13  # error of coordinates at unit distance, where a pixel is about 1e-4 wide


def coefficients_of(definition: "Distortion | None") -> np.ndarray:
    """Return the values of a configuration's ``distortion`` in the order of `COEFFICIENTS`, (8,); zeros for None."""
    return np.array([getattr(definition, name, 0.0) for name in COEFFICIENTS], dtype=np.float64)


def fold_radius(coefficients) -> float:
    """Return the distance from the axis, at unit depth, at which the radial distortion stops increasing, or infinity.

    Parameters
    ----------
    coefficients : (8,) float
        In the order of `COEFFICIENTS`.
    """
    k1, k2, _p1, _p2, k3, k4, k5, k6 = (float(c) for c in coefficients)
    above, below = np.poly1d([k3, k2, k1, 1.0]), np.poly1d([k6, k5, k4, 1.0])  # in s = r²
    # d(r R)/dr = (N D + 2 s (N' D - N D')) / D².
    slope = above * below + 2 * np.poly1d([1.0, 0.0]) * (above.deriv() * below - above * below.deriv())
    # Roots in 1/s: both polynomials are 1 at s = 0, so there is no division by a tiny leading coefficient.
    inverse = np.concatenate([np.roots(polynomial.coeffs[::-1]) for polynomial in (slope, below)])
    real = inverse.real[np.abs(inverse.imag) <= 1e-9 * np.abs(inverse)] if inverse.size else inverse.real
    nearest = real.max(initial=0.0)
    return 1.0 / math.sqrt(nearest) if nearest > 1e-12 else math.inf


@njit(cache=True, forceinline=True, error_model="numpy")
def _forward(c, x, y):
    """Return x'', y'' and the Jacobian xx, xy, yx, yy."""
    s = x * x + y * y
    above, below = 1.0 + s * (c[0] + s * (c[1] + s * c[4])), 1.0 + s * (c[5] + s * (c[6] + s * c[7]))
    radial = above / below
    slope = (c[0] + s * (2.0 * c[1] + 3.0 * s * c[4])) / below
    slope -= radial * (c[5] + s * (2.0 * c[6] + 3.0 * s * c[7])) / below  # dR / ds
    p1, p2 = c[2], c[3]
    mixed = 2.0 * (x * y * slope + p1 * x + p2 * y)
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
        y * radial + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y,
        radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
        mixed,
        mixed,
        radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
    )


@njit(cache=True, error_model="numpy")
def distort(coefficients, fold, x, y):
    """Return the distorted image of a point at unit distance; NaN where the map folds.

    Parameters
    ----------
    coefficients : (8,) float64
    fold : float
        `fold_radius` of the coefficients.
    x, y : float
        Coordinates of the point divided by its depth.
    """
    if not x * x + y * y < fold * fold:
        return math.nan, math.nan
    u, v, xx, xy, yx, yy = _forward(coefficients, x, y)
    if not (xx * yy - xy * yx > 0.0 and xx + yy > 0.0):
        return math.nan, math.nan
    return u, v


@njit(cache=True, error_model="numpy")
def undistort(coefficients, fold, u, v):
    """Return the point at unit distance with the distorted image u, v; NaN where the map folds.

    Newton's method, starting on the axis. Steps that do not reduce the error, or leave the region in which the map is
    one-to-one, are halved.
    """
    x, y = 0.0, 0.0
    fu, fv, xx, xy, yx, yy = _forward(coefficients, x, y)
    error = math.hypot(u - fu, v - fv)
    for _ in range(_STEPS):
        if error <= _TOLERANCE * max(1.0, math.hypot(u, v)):
            return x, y
        det = xx * yy - xy * yx
        dx, dy = (yy * (u - fu) - xy * (v - fv)) / det, (xx * (v - fv) - yx * (u - fu)) / det
        step, moved = 1.0, False
        for _halving in range(40):
            nx, ny = x + step * dx, y + step * dy
            if nx * nx + ny * ny < fold * fold:
                gu, gv, gxx, gxy, gyx, gyy = _forward(coefficients, nx, ny)
                closer = math.hypot(u - gu, v - gv)
                if closer < error and gxx * gyy - gxy * gyx > 0.0 and gxx + gyy > 0.0:
                    x, y, fu, fv, xx, xy, yx, yy, error = nx, ny, gu, gv, gxx, gxy, gyx, gyy, closer
                    moved = True
                    break
            step *= 0.5
        if not moved:
            break
    # Accept errors from rounding: 1e-10 at unit distance is a millionth of a pixel.
    if error <= 1e-12 * max(1.0, math.hypot(u, v)):
        return x, y
    return math.nan, math.nan


@njit(cache=True, parallel=True, nogil=True)
def distort_all(coefficients, fold, points, out):
    """Fill ``out``, (n, 2), with the results of `distort` for all points, (n, 2)."""
    for i in numba.prange(points.shape[0]):
        out[i, 0], out[i, 1] = distort(coefficients, fold, points[i, 0], points[i, 1])


@njit(cache=True, parallel=True, nogil=True)
def undistort_all(coefficients, fold, points, out):
    """Fill ``out``, (n, 2), with the results of `undistort` for all points, (n, 2)."""
    for i in numba.prange(points.shape[0]):
        out[i, 0], out[i, 1] = undistort(coefficients, fold, points[i, 0], points[i, 1])
