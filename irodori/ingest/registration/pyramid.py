"""Image pyramids with invalid pixels, and selection of places with strong gradients.

A level is (height, width, 4) float32: three bands and the share of valid pixels. A pixel of the next level is the mean
of the valid pixels of a block of 2 x 2.
"""

import math

import numpy as np

from irodori.ingest.registration.band_layout import flatten
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit

_LEAST_NOISE = 1e-9
_ROWS, _CELLS = 64, 256  # rows, or cells, that a thread takes at a time


@njit(cache=True)
def _halve_row(out, source, y):
    for x in range(out.shape[1]):
        total, r, g, b = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for s in range(4):
            p = source[2 * y + s // 2, 2 * x + s % 2]
            total += p[3]
            r += p[3] * p[0]
            g += p[3] * p[1]
            b += p[3] * p[2]
        share = np.float32(1.0) / total if total > 0.0 else np.float32(0.0)
        out[y, x, 0], out[y, x, 1], out[y, x, 2] = r * share, g * share, b * share
        out[y, x, 3] = np.float32(0.25) * total


@njit(cache=True, nogil=True)
def _halve_rows(out, source, first, last):
    for y in range(first, last):
        _halve_row(out, source, y)


def halve(source):
    """Average the valid pixels of each block of 2 x 2: (h, w, 4) to (h // 2, w // 2, 4)."""
    out = np.empty((source.shape[0] // 2, source.shape[1] // 2, 4), dtype=np.float32)
    run_chunks(_halve_rows, len(out), _ROWS, out, source)
    return out


@njit(cache=True, forceinline=True)
def _weight(image, at, valid):
    """Return 1 for a valid and finite pixel, else 0."""
    one = np.uint64(1)
    r, g, b = image[at], image[at + one], image[at + one + one]
    good = valid and math.isfinite(r) and math.isfinite(g) and math.isfinite(b)
    return np.float32(1.0) if good else np.float32(0.0)


@njit(cache=True)
def _pack_row(out, image, step, valid, y):
    zero = np.float32(0.0)
    for x in range(out.shape[1]):
        at = np.uint64((y * out.shape[1] + x) * step)
        weight = _weight(image, at, valid[y, x])
        for c in range(3):
            out[y, x, c] = image[at + np.uint64(c)] if weight > zero else zero
        out[y, x, 3] = weight


@njit(cache=True, nogil=True)
def _pack_rows(out, image, step, valid, first, last):
    for y in range(first, last):
        _pack_row(out, image, step, valid, y)


def pack(image, valid):
    """Make level 0, (h, w, 4), in which invalid and non-finite pixels are zero and have no weight."""
    out = np.empty((*valid.shape, 4), dtype=np.float32)
    run_chunks(_pack_rows, len(out), _ROWS, out, *flatten(image), valid)
    return out


@njit(cache=True)
def _pack_halve_row(out, image, step, valid, y):
    width = valid.shape[1]
    quarter, zero = np.float32(0.25), np.float32(0.0)
    for x in range(out.shape[1]):
        total = r = g = b = zero
        for s in range(4):
            row, column = 2 * y + s // 2, 2 * x + s % 2
            at = np.uint64((row * width + column) * step)
            weight = _weight(image, at, valid[row, column])
            if weight > zero:
                total += weight
                r += image[at]
                g += image[at + np.uint64(1)]
                b += image[at + np.uint64(2)]
        share = np.float32(1.0) / total if total > zero else zero
        out[y, x, 0], out[y, x, 1], out[y, x, 2], out[y, x, 3] = r * share, g * share, b * share, quarter * total


@njit(cache=True, nogil=True)
def _pack_halve_rows(out, image, step, valid, first, last):
    for y in range(first, last):
        _pack_halve_row(out, image, step, valid, y)


def pack_halve(image, valid):
    """Make level 1 directly, without level 0."""
    out = np.empty((valid.shape[0] // 2, valid.shape[1] // 2, 4), dtype=np.float32)
    run_chunks(_pack_halve_rows, len(out), _ROWS, out, *flatten(image), valid)
    return out


@njit(cache=True, forceinline=True)
def _energy(level, noise, y, x):
    """Return the sum over the bands of squared central differences divided by noise variance.

    ``noise`` has the inverse variances. The result is 0 beside an invalid pixel.
    """
    left, right, up, down = level[y, x - 1], level[y, x + 1], level[y - 1, x], level[y + 1, x]
    total = np.float32(0.0)
    for c in range(3):
        gx, gy = right[c] - left[c], down[c] - up[c]
        total += (gx * gx + gy * gy) * noise[c]
    weight = min(min(left[3], right[3]), min(up[3], down[3]))
    return total * weight * weight


@njit(cache=True, nogil=True)
def _energies(level, inverse, out, first, last):
    for y in range(max(first, 1), min(last, level.shape[0] - 1)):
        for x in range(1, level.shape[1] - 1):
            out[y, x] = _energy(level, inverse, y, x)


def noise_of(level) -> np.ndarray:
    """Estimate the standard deviation of the noise of a pixel in each band, (3,) float64, including fine texture.

    It is computed from the lower quartile of the differences between pixels two apart, which edges hardly affect.
    """
    rows, step = level[:: max(1, level.shape[0] // 64)], max(1, level.shape[1] // 256)
    right, left = rows[:, 2::step], rows[:, :-2:step]
    differences = np.abs(right[..., :3] - left[..., :3])[np.minimum(right[..., 3], left[..., 3]) > 0.5]
    if len(differences) == 0:
        return np.full(3, _LEAST_NOISE)
    floor = 1e-3 * np.sqrt(np.square(differences, dtype=np.float64).mean())
    # 0.3186: lower quartile of |x| of a standard normal variable; the difference of two has twice the variance.
    return np.maximum(np.quantile(differences, 0.25, axis=0) / (0.3186 * math.sqrt(2.0)), max(floor, _LEAST_NOISE))


def gradient_energy(level, noise) -> np.ndarray:
    """Return squared gradients in units of the noise, summed over the bands, (h, w) float32; 0 at the border."""
    out = np.zeros(level.shape[:2], dtype=np.float32)
    run_chunks(_energies, len(out), _ROWS, level, (noise**-2.0).astype(np.float32), out)
    return out


@njit(cache=True)
def _select(values, count, place):
    """Return the element with index ``place`` of the first ``count`` values in ascending order; reorders them.

    Hoare's quickselect. `numpy.partition` does the same, but takes twenty seconds to compile.
    """
    first, last = 0, count - 1
    while first < last:
        pivot, i, j = values[(first + last) // 2], first, last
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if place <= j:
            last = j
        elif place >= i:
            first = i
        else:
            break
    return values[place]


@njit(cache=True)
def _choose(energy, places, counts, cell, grid, gate):
    """Fill the places with the largest energies in one cell.

    ``grid`` has the number of columns of cells, and height and width of a cell.
    """
    (columns, height, width), quota = grid, places.shape[1]
    y0, x0 = (cell // columns) * height, (cell % columns) * width
    bottom, right = min(y0 + height, energy.shape[0]), min(x0 + width, energy.shape[1])
    limit, passed, values = np.float32(gate), 0, np.empty(height * width, dtype=np.float32)
    for y in range(y0, bottom):
        for x in range(x0, right):
            if energy[y, x] > 0.0 and energy[y, x] >= limit:
                values[passed] = energy[y, x]
                passed += 1
    if passed > quota:
        limit = _select(values, passed, passed - quota)
    n = 0
    for y in range(y0, bottom):
        for x in range(x0, right):
            if energy[y, x] > 0.0 and energy[y, x] >= limit and n < quota:
                places[cell, n, 0], places[cell, n, 1] = x, y
                n += 1
    counts[cell] = n


@njit(cache=True, nogil=True)
def _choose_some(energy, chosen, grid, gate, first, last):
    places, counts = chosen
    for cell in range(first, last):
        _choose(energy, places, counts, cell, grid, gate)


def choose(energy, height, width, quota, gate):
    """Choose in each cell the places with the largest gradient energies, all at least ``gate``.

    Returns
    -------
    places : (cells, quota, 2) int32, x then y
    counts : (cells,) int64
        Number of places in each cell. Cells are numbered along the rows, and each row has an even number of them.
    """
    columns = 2 * max(1, energy.shape[1] // (2 * width))
    rows = max(1, energy.shape[0] // height)
    places = np.zeros((rows * columns, quota, 2), dtype=np.int32)
    counts = np.zeros(rows * columns, dtype=np.int64)
    grid = (columns, height, width)
    run_chunks(_choose_some, len(counts), _CELLS, energy, (places, counts), grid, float(gate))
    return places, counts


class Pyramid:
    """Image pyramid with levels that are computed on first access."""

    def __init__(self, image, valid) -> None:
        self._image, self._valid = np.asarray(image, dtype=np.float32), np.ascontiguousarray(valid, dtype=bool)
        self._levels: dict[int, np.ndarray] = {}

    def __getitem__(self, n: int) -> np.ndarray:
        if n not in self._levels:
            if n > 1:
                self._levels[n] = halve(self[n - 1])
            else:
                self._levels[n] = (pack if n == 0 else pack_halve)(self._image, self._valid)
        return self._levels[n]
