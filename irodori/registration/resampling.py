"""Resampling a picture under a similarity, with its invalid pixels."""

import math

import numba
import numpy as np


@numba.njit(cache=True, inline="always")
def _keys(t, w):
    """Fill the weights of Keys' cubic, a = -1/2, for the taps -1..2 around a fraction t."""
    w[0] = np.float32(((-0.5 * t + 1.0) * t - 0.5) * t)
    w[1] = np.float32((1.5 * t - 2.5) * t * t + 1.0)
    w[2] = np.float32(((-1.5 * t + 2.0) * t + 0.5) * t)
    w[3] = np.float32((0.5 * t - 0.5) * t * t)


@numba.njit(cache=True, inline="always")
def _whole(valid, x, y, taps):
    for j in range(taps):
        for i in range(taps):
            if valid[y + j, x + i] == 0:
                return False
    return True


@numba.njit(cache=True)
def _resample_row(out, out_valid, image, valid, affine, y):
    height, width = valid.shape
    wx, wy = np.empty(4, dtype=np.float32), np.empty(4, dtype=np.float32)
    for x in range(out.shape[1]):
        fx = affine[0, 0] * x + affine[0, 1] * y + affine[0, 2]
        fy = affine[1, 0] * x + affine[1, 1] * y + affine[1, 2]
        for c in range(3):
            out[y, x, c] = np.float32(0.0)
        out_valid[y, x] = False
        if not (0.0 <= fx <= width - 1.0 and 0.0 <= fy <= height - 1.0):
            continue
        ix, iy = min(int(fx), width - 2), min(int(fy), height - 2)
        tx, ty = fx - ix, fy - iy
        if 1 <= ix < width - 2 and 1 <= iy < height - 2 and _whole(valid, ix - 1, iy - 1, 4):
            _keys(tx, wx)
            _keys(ty, wy)
            r = g = b = np.float32(0.0)
            for j in range(4):
                row = image[iy - 1 + j]
                p0, p1, p2, p3 = row[ix - 1], row[ix], row[ix + 1], row[ix + 2]
                r += wy[j] * (wx[0] * p0[0] + wx[1] * p1[0] + wx[2] * p2[0] + wx[3] * p3[0])
                g += wy[j] * (wx[0] * p0[1] + wx[1] * p1[1] + wx[2] * p2[1] + wx[3] * p3[1])
                b += wy[j] * (wx[0] * p0[2] + wx[1] * p1[2] + wx[2] * p2[2] + wx[3] * p3[2])
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = r, g, b
            out_valid[y, x] = True
        elif _whole(valid, ix, iy, 2):
            for c in range(3):
                top = (1.0 - tx) * image[iy, ix, c] + tx * image[iy, ix + 1, c]
                bottom = (1.0 - tx) * image[iy + 1, ix, c] + tx * image[iy + 1, ix + 1, c]
                out[y, x, c] = np.float32((1.0 - ty) * top + ty * bottom)
            out_valid[y, x] = True


@numba.njit(cache=True, parallel=True, nogil=True)
def resample_affine(image, valid, affine):
    """Return a picture at the places that a map gives, and where it is valid.

    Parameters
    ----------
    image : (height, width, 3) float32
        At least 2 x 2.
    valid : (height, width) bool or uint8
    affine : (2, 3) float64
        Source from destination coordinates, x then y.

    Returns
    -------
    image : (height, width, 3) float32, 0 where invalid
    valid : (height, width) bool
    """
    out = np.empty(image.shape, dtype=np.float32)
    out_valid = np.empty(valid.shape, dtype=np.bool_)
    for y in numba.prange(image.shape[0]):
        _resample_row(out, out_valid, image, valid, affine, y)
    return out, out_valid


def frequency_response(frequency, fraction) -> np.ndarray:
    """Return |gain| of the cubic for a sine of a frequency, sampled at a fraction between two pixels.

    Parameters
    ----------
    frequency : float or array, cycles per pixel, 0..0.5
    fraction : float, 0..1
    """
    weights = np.empty(4, dtype=np.float32)
    _keys(float(fraction), weights)
    phase = np.exp(2j * math.pi * np.multiply.outer(np.asarray(frequency, dtype=np.float64), np.arange(-1, 3)))
    return np.abs(phase @ weights.astype(np.float64))
