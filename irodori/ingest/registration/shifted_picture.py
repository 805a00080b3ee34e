"""Resampling of a picture with invalid pixels under a similarity transform."""

from typing import NamedTuple

import numpy as np

from irodori.geometry.interpolation import keys_weights
from irodori.ingest.registration.band_layout import flatten
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit

_ROWS = 64  # rows that a thread takes at a time


@njit(cache=True)
def _reached_row(reached, valid, y):
    """Mark the pixels of a row for which all 4 x 4 neighbours, -1..2, are in the picture and valid."""
    width = valid.shape[1]
    column = np.empty(width, dtype=np.bool_)
    for x in range(width):
        column[x] = (valid[y - 1, x] != 0) & (valid[y, x] != 0) & (valid[y + 1, x] != 0) & (valid[y + 2, x] != 0)
    for x in range(1, width - 2):
        reached[y, x] = column[x - 1] & column[x] & column[x + 1] & column[x + 2]


@njit(cache=True, forceinline=True, fastmath={"contract"})
def _four(image, p, step, w):
    """Return the weighted sum of four pixels of a row in one band."""
    return (
        w[0] * image[p] + w[1] * image[p + step] + w[2] * image[p + step + step] + w[3] * image[p + step + step + step]
    )


@njit(cache=True, forceinline=True, fastmath={"contract"})
def _cubic(image, p, step, line, wx, wy):
    """Return the cubic interpolation from 4 x 4 pixels in one band; the first is at ``p``, rows are ``line`` apart."""
    top = wy[0] * _four(image, p, step, wx) + wy[1] * _four(image, p + line, step, wx)
    p += line + line
    return top + wy[2] * _four(image, p, step, wx) + wy[3] * _four(image, p + line, step, wx)


@njit(cache=True, forceinline=True)
def _linear(image, p, step, line, tx, ty):
    """Return the bilinear interpolation from 2 x 2 pixels in one band; the first is at ``p``."""
    top = (1.0 - tx) * image[p] + tx * image[p + step]
    bottom = (1.0 - tx) * image[p + line] + tx * image[p + line + step]
    return np.float32((1.0 - ty) * top + ty * bottom)


class _Picture(NamedTuple):
    """A picture of three bands as a flat array, and its mask."""

    samples: np.ndarray  # band b of pixel (y, x) is samples[(y * width + x) * step + b]
    step: int
    valid: np.ndarray  # (height, width) bool


@njit(cache=True, fastmath={"contract"})
def _resample_row(moved, picture, reached, affine, y):
    (out, out_step, out_valid), (image, step, valid) = moved, picture
    height, width = valid.shape
    line = width * step
    for x in range(width):
        fx = affine[0, 0] * x + affine[0, 1] * y + affine[0, 2]
        fy = affine[1, 0] * x + affine[1, 1] * y + affine[1, 2]
        r = g = b = np.float32(0.0)
        good = False
        if 0.0 <= fx <= width - 1.0 and 0.0 <= fy <= height - 1.0:
            ix, iy = min(int(fx), width - 2), min(int(fy), height - 2)
            tx, ty, at = fx - ix, fy - iy, iy * line + ix * step
            if reached[iy, ix]:
                wx, wy, good = keys_weights(tx), keys_weights(ty), True
                # Unsigned indices save numba the handling of negative ones.
                first, right, down, one = np.uint64(at - line - step), np.uint64(step), np.uint64(line), np.uint64(1)
                r = _cubic(image, first, right, down, wx, wy)
                g = _cubic(image, first + one, right, down, wx, wy)
                b = _cubic(image, first + one + one, right, down, wx, wy)
            elif valid[iy, ix] and valid[iy, ix + 1] and valid[iy + 1, ix] and valid[iy + 1, ix + 1]:
                good = True
                r = _linear(image, at, step, line, tx, ty)
                g = _linear(image, at + 1, step, line, tx, ty)
                b = _linear(image, at + 2, step, line, tx, ty)
        to = (y * width + x) * out_step
        out[to], out[to + 1], out[to + 2] = r, g, b
        out_valid[y, x] = good


@njit(cache=True, nogil=True)
def _reached_rows(reached, valid, first, last):
    for y in range(max(first, 1), min(last, valid.shape[0] - 2)):
        _reached_row(reached, valid, y)


@njit(cache=True, nogil=True)
def _resample_rows(moved, picture, reached, affine, first, last):
    for y in range(first, last):
        _resample_row(moved, picture, reached, affine, y)


def resample_affine(image, valid, affine, out=None) -> tuple[np.ndarray, np.ndarray]:
    """Resample a picture under an affine map.

    Parameters
    ----------
    image : (height, width, 3) float32
        At least 2 x 2 pixels; `irodori.ingest.registration.band_layout` states which layouts are read without a copy.
    valid : (height, width) bool
    affine : (2, 3) float64
        Map from destination to source coordinates, x then y.
    out : (height, width, 3) float32, optional
        Array for the result: neighbouring bands of a contiguous picture that does not overlap ``image``.

    Returns
    -------
    image : (height, width, 3) float32
        0 where invalid.
    valid : (height, width) bool

    Raises
    ------
    ValueError
        If ``out`` has another shape or layout, is read-only, or overlaps ``image``.
    """
    out = np.empty(image.shape, dtype=np.float32) if out is None else out
    flat_out, out_step = flatten(out)
    if not out.flags.writeable or np.shares_memory(out, image):
        raise ValueError("room that is read-only or holds the picture itself; accepted: room apart from the picture")
    if out.shape != image.shape or not np.may_share_memory(flat_out, out):
        raise ValueError(f"room for {out.shape}, strides {out.strides}; accepted: bands of a contiguous {image.shape}")
    out_valid = np.empty(valid.shape, dtype=np.bool_)
    moved, reached = _Picture(flat_out, out_step, out_valid), np.zeros(valid.shape, dtype=np.bool_)
    run_chunks(_reached_rows, len(valid), _ROWS, reached, valid)
    run_chunks(_resample_rows, len(valid), _ROWS, moved, _Picture(*flatten(image), valid), reached, affine)
    return out, out_valid


@njit(cache=True)
def _marked_row(out, mask, valid, affine, y):
    height, width = mask.shape
    for x in range(width):
        out[y, x] = False
        if valid[y, x]:
            continue
        fx = affine[0, 0] * x + affine[0, 1] * y + affine[0, 2]
        fy = affine[1, 0] * x + affine[1, 1] * y + affine[1, 2]
        if 0.0 <= fx <= width - 1.0 and 0.0 <= fy <= height - 1.0:
            ix, iy = int(fx + 0.5), int(fy + 0.5)
            out[y, x] = mask[max(iy - 2, 0) : iy + 3, max(ix - 2, 0) : ix + 3].any()


@njit(cache=True, nogil=True)
def _marked_rows(out, mask, valid, affine, first, last):
    for y in range(first, last):
        _marked_row(out, mask, valid, affine, y)


def marked_affine(mask, valid, affine):
    """Return the invalid pixels of a resampled picture with a marked source sample nearby, (height, width) bool.

    Nearby is within two samples of the nearest one. Parameters as in
    `irodori.ingest.registration.similarity.meets_marked`, with ``affine`` from destination to source coordinates.
    """
    out = np.empty(mask.shape, dtype=np.bool_)
    run_chunks(_marked_rows, len(mask), _ROWS, out, mask, valid, affine)
    return out
