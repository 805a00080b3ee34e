"""Cross filter that removes the noise of a path-traced picture, with an estimate of the remaining error.

A picture has two independent sets of samples. Each pixel of one set is replaced by the value of a linear function of
features of the first hits (albedo, normal, position, share of gloss), fitted to the pixels around it (first-order
regression: Moon et al. 2014, doi 10.1145/2641762; Bitterli et al. 2016, doi 10.1111/cgf.12954). The weights of the
neighbours come from the other set, by comparing patches in units of the noise (dual-buffer non-local means: Rousselle
et al. 2012, doi 10.1145/2366145.2366214), and are therefore independent of the noise that is filtered. All 61 bands
have the same weights, so that spectra are not distorted.

The filter is biased. The two sets show the whole error, noise and bias: it is the squared difference between one
filtered set and the other, unfiltered set, less the noise of the latter.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit
from irodori.jit.functions import exp, lower_of, select, upper_of
from irodori.jit.vector_memory import load, spread, store, total, zeros_like
from irodori.rendering.reference.world import ALBEDO, NORMAL, PLACE, SEEN, SHINE
from irodori.rendering.scene_lights import BANDS, PADDED

#: Pixels to each side that a pixel is filtered over, and pixels to each side of a patch that is compared.
RADIUS, PATCH = 5, 2
#: Rows around those wanted that `filtered_halves` reads.
MARGIN = RADIUS + PATCH
_ROWS = 8  # rows filtered together, because patches of neighbouring rows share their comparisons
_SIDE = 2 * RADIUS + 1
_WINDOW = _SIDE * _SIDE
_STRICT = 0.49  # square of the number of standard deviations by which patches may differ (k = 0.7, Rousselle et al.)
#: Regularisation of the regression's slopes, relative to the sum of the weights. That of the albedo is small, because
#: textures are to be kept and their features have little noise.
_RIDGE, _RIDGE_OF_ALBEDO = 1e-2, 1e-4
#: Mean square, over the window, of a feature's differences from the pixel, relative to the regularisation, below which
#: it has no part in the regression: a hundredth of its slope would be left.
_EVEN = 1e-2
_LEAST_WEIGHT = 1e-4
_COLUMNS, _LANES = SEEN + 1, 16  # of the regression, its constant last; numbers in a vector
_PLACES = -(-_WINDOW // _LANES) * _LANES  # of a window, filled up to whole vectors
_ROOM = _PLACES + _LANES  # of a feature's window in memory, for the end of the last row's vector
#: Differences of the normal, of the albedo's cube root and of the share of gloss that count as another surface.
_SAME_NORMAL, _SAME_ALBEDO, _SAME_SHINE = 0.3, 0.3, 0.2
_DARK = 1e-3  # share of the picture's mean below which differences are not visible
_NOISE_SIDE = 7  # side, in pixels, of the square over which the noise is averaged
_ERROR_SIDE = 31  # the same for squared errors, whose single values are inaccurate and may be negative
_TILE_PIXELS = 1 << 16  # filtered together, which takes 1 kB of memory each
#: Side, in pixels, of the blocks whose means are compared before and after filtering, because means have little noise.
BLOCK_PX = 16


class Halves(NamedTuple):
    """The two independent sets of samples of a picture, or of some of its rows."""

    mean: np.ndarray  # (height, width, 61) float32 radiance
    difference: np.ndarray  # (height, width, 61) float32 half the difference, first set less second
    seen: np.ndarray  # (height, width, SEEN) float32, see `irodori.rendering.reference.world.SEEN`


class Denoised(NamedTuple):
    """A filtered picture and its error."""

    radiance: np.ndarray  # (height, width, 61) float32
    error: np.ndarray  # (height, width) float32 root mean square over the bands and the neighbourhood, noise and bias


class Guides(NamedTuple):
    """Features of the pixels of `Halves` that determine the weights of the filter.

    All go on beyond the left and the right edge with the values of the edge: ``colour`` and ``noise`` by `MARGIN`
    pixels, ``seen`` by `RADIUS`, and to the right by as many more as a vector needs.
    """

    colour: np.ndarray  # (2 sets, 3 parts of the spectrum, height, width + 2 MARGIN + 16) float32, cube roots
    noise: np.ndarray  # (3, height, width + 2 MARGIN + 16) float32 variance of one set
    seen: np.ndarray  # (SEEN, height, width + 16) float32, scaled to about one over the window
    surface: np.ndarray  # (height, width) bool: whether any path hit a surface; other pixels have little noise


def _averaged(values: np.ndarray, side: int) -> np.ndarray:
    """Return means over a square of ``side`` pixels around each pixel of a picture (height, width)."""
    from scipy.ndimage import convolve1d  # slow to import

    # `uniform_filter` uses a running sum, whose rounding error next to a sun exceeds the values of dark pixels.
    even = np.full(side, 1.0 / side)
    return convolve1d(convolve1d(values.astype(np.float64), even, 0, mode="nearest"), even, 1, mode="nearest")


def _parts(spectra: np.ndarray) -> np.ndarray:
    """Return the means of spectra over three parts of the wavelength range, (3, ...) float32."""
    weights = np.zeros((spectra.shape[-1], 3), dtype=np.float32)
    for part, third in enumerate(np.array_split(np.arange(len(weights)), 3)):
        weights[third, part] = 1.0 / len(third)
    return np.moveaxis(spectra @ weights, -1, 0)


def _cube_roots(values: np.ndarray) -> np.ndarray:
    """Return the cube roots of positive numbers; `np.cbrt` takes four times as long."""
    return np.exp(np.log(values) / np.float32(3.0))


def _squared_length(vectors: np.ndarray) -> np.ndarray:
    return np.einsum("...c,...c->...", vectors, vectors)


def make_guides(halves: Halves) -> Guides:
    """Return the guides of a picture, or of some rows; those of rows differ slightly because of the mean brightness."""
    mean, half = _parts(halves.mean), _parts(halves.difference)
    # Cube roots approximate perceived lightness and make the noise similar in dark and bright regions.
    dark = np.float32(_DARK * float(mean.mean()) or 1.0)
    colour = _cube_roots(np.maximum(np.stack([mean + half, mean - half]), np.float32(0.0)) + dark)
    squares = 0.5 * np.square(colour[0] - colour[1])
    noise = np.stack([_averaged(part, _NOISE_SIDE) for part in squares]).astype(np.float32)
    seen = halves.seen.copy()
    surface = _squared_length(halves.seen[..., NORMAL:PLACE]) > 0.0
    seen[..., ALBEDO:NORMAL] = _cube_roots(np.maximum(seen[..., ALBEDO:NORMAL], 0.0) + np.float32(1e-3))
    both = surface[:, 1:] & surface[:, :-1]
    steps = np.sqrt(_squared_length(np.diff(seen[..., PLACE:SHINE], axis=1)))[both]
    seen[..., PLACE:SHINE] /= 2.0 * RADIUS * (float(np.median(steps)) if steps.size else 0.0) or 1.0
    beyond = [(0, 0), (0, 0), (MARGIN, MARGIN + _LANES)]
    colour, noise = np.pad(colour, [(0, 0), *beyond], mode="edge"), np.pad(noise, beyond, mode="edge")
    around = [(0, 0), (0, 0), (RADIUS, _LANES - RADIUS)]
    # Of a picture of one row, NumPy would keep another order.
    planes = np.ascontiguousarray(np.pad(np.moveaxis(seen, -1, 0), around, mode="edge"))
    return Guides(colour, noise, planes, surface)


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _compare(guides, which, shift, part, scratch, weights):
    """Fill the weights of the neighbours at one offset, (rows, width), from patches of a set; 0 outside the picture.

    ``part`` has first and last-plus-one row and column.
    """
    height, width = guides.surface.shape
    (down, right), (first, last, left, end), (patches, column) = shift, part, scratch
    count, step, beside = end - left, guides.noise.shape[2], patches.shape[1]
    start, strict, zero = MARGIN + left - PATCH, np.float32(_STRICT), np.float32(0.0)
    for row in range(first - PATCH, last + PATCH):
        own = min(max(row, 0), height - 1) * step + start
        other = min(max(row + down, 0), height - 1) * step + start + right
        for x in range(0, count + 2 * PATCH, _LANES):
            sums = spread(zero, _LANES)
            for third in range(3):
                colour, noise = (which * 3 + third) * height * step + x, third * height * step + x
                apart = load(guides.colour, colour + own, _LANES) - load(guides.colour, colour + other, _LANES)
                one, two = load(guides.noise, noise + own, _LANES), load(guides.noise, noise + other, _LANES)
                over = apart * apart - one - lower_of(one, two)
                sums = sums + over / (spread(np.float32(1e-12), _LANES) + strict * (one + two))
            store(patches, (row - first + PATCH) * beside + x, sums)
    share = np.float32(-1.0 / (3 * (2 * PATCH + 1) ** 2))
    for row in range(last - first):
        for x in range(0, count + 2 * PATCH, _LANES):
            sums = load(patches, row * beside + x, _LANES)
            for line in range(row + 1, row + 2 * PATCH + 1):
                sums = sums + load(patches, line * beside + x, _LANES)
            store(column, x, share * sums)
        inside = 0 <= first + row + down < height
        for x in range(0, count, _LANES):
            mean = load(column, x, _LANES)
            for place in range(1, 2 * PATCH + 1):
                mean = mean + load(column, x + place, _LANES)
            weight = exp(lower_of(mean, zero))
            weight = select(weight >= spread(np.float32(_LEAST_WEIGHT), _LANES), weight, spread(zero, _LANES))
            store(weights, row * weights.shape[1] + left + x, weight if inside else spread(zero, _LANES))
        for x in range(left, min(end, -right)):
            weights[row, x] = zero
        for x in range(max(left, width - right), end):
            weights[row, x] = zero


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _solve(matrix, count, out):
    """Fill ``out`` with the last column of the inverse of a positive definite matrix, which is overwritten.

    The matrix is in the first ``count`` rows and columns. Rows are eliminated as vectors; the right-hand side, the last
    unit vector, stays as it is meanwhile.
    """
    for k in range(count):
        inverse, own = 1.0 / max(matrix[k, k], 1e-12), load(matrix, k * _LANES, _LANES)
        out[k] = inverse
        for a in range(k + 1, count):
            factor = spread(matrix[a, k] * inverse, _LANES)
            store(matrix, a * _LANES, load(matrix, a * _LANES, _LANES) - factor * own)
    for a in range(count - 2, -1, -1):
        rest = 0.0
        for c in range(a + 1, count):
            rest -= matrix[a, c] * out[c]
        out[a] *= rest


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def _product(one, a, other, b):
    """Return the sum of the products of two windows, rows ``a`` and ``b`` of two arrays of windows."""
    sums = zeros_like(load(one, 0, _LANES))
    for place in range(0, _PLACES, _LANES):
        sums = sums + load(one, a * _ROOM + place, _LANES) * load(other, b * _ROOM + place, _LANES)
    return float(total(sums))


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def _regress(guides, row, x, weights, scratch):
    """Replace the weights of a pixel's window by those with which the regression combines the values.

    Each feature's differences from the pixel fill such a window, row after row: a row is stored as a vector, whose end
    the next row overwrites. The last feature is the constant, whose window has ones. Weights beyond the window are 0.
    """
    design, weighted, matrix, solved, (scale, ridge), used = scratch
    height, step = guides.surface.shape[0], guides.seen.shape[2]
    for line in range(_SIDE):
        other = min(max(row + line - RADIUS, 0), height - 1)
        unlike = zeros_like(load(design, 0, _LANES))
        for a in range(SEEN):
            plane = guides.seen[a]
            apart = load(plane, other * step + x, _LANES) - spread(plane[row, x + RADIUS], _LANES)
            store(design, a * _ROOM + line * _SIDE, apart)
            unlike = unlike + apart * apart * spread(scale[a], _LANES)
        store(weighted, SEEN * _ROOM + line * _SIDE, exp(zeros_like(unlike) - unlike))
    for place in range(0, _PLACES, _LANES):
        weight = load(weights, place, _LANES) * load(weighted, SEEN * _ROOM + place, _LANES)
        store(weighted, SEEN * _ROOM + place, weight)
        for a in range(SEEN):
            store(weighted, a * _ROOM + place, weight * load(design, a * _ROOM + place, _LANES))
    whole, count = _product(weighted, SEEN, design, SEEN), 0
    for a in range(_COLUMNS):
        square = _product(weighted, a, design, a)
        if square > _EVEN * ridge[a] * whole:
            used[count], matrix[count, count] = a, square + ridge[a] * whole
            count += 1
    for a in range(count):
        for b in range(a + 1, count):
            matrix[a, b] = matrix[b, a] = _product(weighted, used[b], design, used[a])
    _solve(matrix, count, solved)
    for line in range(0, _PLACES, _LANES):
        factor = zeros_like(load(design, 0, _LANES))
        for a in range(count):
            factor = factor + spread(np.float32(solved[a]), _LANES) * load(design, used[a] * _ROOM + line, _LANES)
        store(weights, line, factor * load(weighted, SEEN * _ROOM + line, _LANES))


@njit(cache=True, nogil=True)
def _new_scratch():
    """Return the buffers of `_regress`."""
    scale = np.zeros(SEEN, np.float32)
    scale[NORMAL : NORMAL + 3] = np.float32(1.0 / _SAME_NORMAL**2)
    scale[ALBEDO : ALBEDO + 3] = np.float32(1.0 / _SAME_ALBEDO**2)
    scale[SHINE] = np.float32(1.0 / _SAME_SHINE**2)
    design = np.ones((_COLUMNS, _ROOM), np.float32)
    solved, used = np.empty(_COLUMNS), np.empty(_COLUMNS, np.int64)
    ridge = np.full(_COLUMNS, _RIDGE)
    ridge[ALBEDO : ALBEDO + 3], ridge[SEEN] = _RIDGE_OF_ALBEDO, 0.0
    return design, np.zeros_like(design), np.zeros((_COLUMNS, _LANES)), solved, (scale, ridge), used


@njit(cache=True, nogil=True, fastmath={"contract"})
def _combine(sets, at, weights, out, to):
    """Store the weighted sum of a window's spectra, which are not negative, in ``out``; both by flat indices.

    ``at`` has the place of the pixel in ``sets`` and the step from one row to the next.
    """
    here, step = at
    zero = zeros_like(load(sets, here, _LANES))
    one, two, three, four = zero, zero, zero, zero
    for line in range(_SIDE):
        for beside in range(_SIDE):
            weight = weights[line * _SIDE + beside]
            if weight != np.float32(0.0):
                place, share = here + (line - RADIUS) * step + (beside - RADIUS) * PADDED, spread(weight, _LANES)
                one = one + share * load(sets, place, _LANES)
                two = two + share * load(sets, place + _LANES, _LANES)
                three = three + share * load(sets, place + 2 * _LANES, _LANES)
                four = four + share * load(sets, place + 3 * _LANES, _LANES)
    # The regression may give negative radiance.
    store(out, to, upper_of(one, np.float32(0.0)))
    store(out, to + _LANES, upper_of(two, np.float32(0.0)))
    store(out, to + 2 * _LANES, upper_of(three, np.float32(0.0)))
    store(out, to + 3 * _LANES, upper_of(four, np.float32(0.0)))


class _Results(NamedTuple):
    """Results of filtered rows; arrays without rows are not filled."""

    halves: np.ndarray  # (2 sets, rows, width, 61) float32, both sets
    radiance: np.ndarray  # (rows, width, 61) float32, their mean
    squares: np.ndarray  # (2, rows, width), see `_fill_squares`


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def _fill_squares(one, other, first, second, out):
    """Fill ``out``, (2,), with `squared_error` of a pixel and with the noise of the filtered sets alone.

    Both are mean squares over the bands. ``one`` and ``other`` are the unfiltered sets, (61 or more,), the other two
    the filtered ones.
    """
    crossed, own, between = 0.0, 0.0, 0.0
    for c in range(BANDS):
        a, b = np.float64(one[c]), np.float64(other[c])
        of_first, of_second = np.float64(first[c]), np.float64(second[c])
        crossed += (of_first - b) ** 2 + (of_second - a) ** 2
        own += (a - b) ** 2
        between += (of_first - of_second) ** 2
    out[1] = 0.25 * between / BANDS
    out[0] = 0.5 * (crossed - own) / BANDS - out[1]


@njit(cache=True, nogil=True)
def _filter_some_rows(sets, guides, starts, out, first, last):
    """Fill bands ``first`` to ``last`` of `_ROWS` rows of the results.

    ``starts`` has the first row of ``sets``, that of the results, and the one after the last of these.
    """
    read, start, stop = starts
    width = guides.surface.shape[1]
    compared = (
        np.empty((_ROWS + 2 * PATCH, width + 2 * _LANES), np.float32),
        np.empty(width + 2 * _LANES, np.float32),
    )
    weights, scratch = np.empty((_WINDOW, _ROWS, width + _LANES), np.float32), _new_scratch()
    own, filtered = np.zeros(_PLACES, np.float32), np.empty((2, _ROWS, width, PADDED), np.float32)
    for band in range(first, last):
        top, bottom = start + band * _ROWS, min(start + (band + 1) * _ROWS, stop)
        left, end = width, 0
        for row in range(top, bottom):
            for x in range(width):
                if guides.surface[row, x]:
                    left, end = min(left, x), max(end, x + 1)
        for which in range(2):
            for offset in range(_WINDOW if left < end else 0):
                shift = offset // _SIDE - RADIUS, offset % _SIDE - RADIUS
                _compare(guides, 1 - which, shift, (top, bottom, left, end), compared, weights[offset])
            for row in range(top, bottom):
                for x in range(width):
                    if not guides.surface[row, x]:
                        for c in range(PADDED):
                            filtered[which, row - top, x, c] = sets[which, row - read, x, c]
                        continue
                    for offset in range(_WINDOW):
                        own[offset] = weights[offset, row - top, x]
                    _regress(guides, row, x, own, scratch)
                    at = ((which * sets.shape[1] + row - read) * width + x) * PADDED
                    to = ((which * _ROWS + row - top) * width + x) * PADDED
                    _combine(sets, (at, width * PADDED), own, filtered, to)
        for row in range(top, bottom):
            for x in range(width):
                one, other, to = filtered[0, row - top, x], filtered[1, row - top, x], row - start
                if out.halves.shape[1] > 0:
                    for c in range(BANDS):
                        out.halves[0, to, x, c], out.halves[1, to, x, c] = one[c], other[c]
                if out.radiance.shape[0] > 0:
                    for c in range(BANDS):
                        out.radiance[to, x, c] = np.float32(0.5) * (one[c] + other[c])
                    first_set, second_set = sets[0, row - read, x], sets[1, row - read, x]
                    _fill_squares(first_set, second_set, one, other, out.squares[:, to, x])


def _filter_rows(halves: Halves, guides: Guides, rows: tuple[int, int], out: _Results) -> None:
    """Filter rows of both sets, on all threads of numba; ``rows`` are counted within ``halves``."""
    count, (height, _, bands) = rows[1] - rows[0], halves.mean.shape
    read = max(rows[0] - RADIUS, 0), min(rows[1] + RADIUS, height)
    mean, half = halves.mean[slice(*read)], halves.difference[slice(*read)]
    sets = np.zeros((2, *mean.shape[:2], PADDED), dtype=np.float32)
    np.add(mean, half, out=sets[0, ..., :bands])
    np.subtract(mean, half, out=sets[1, ..., :bands])
    run_chunks(_filter_some_rows, math.ceil(count / _ROWS), 1, sets, guides, (read[0], *rows), out)


def filtered_halves(halves: Halves, guides: Guides, rows: tuple[int, int]) -> np.ndarray:
    """Filter rows of both sets, on all threads of numba; returns (2, rows, width, 61) float32.

    Parameters
    ----------
    halves : Halves
        Picture with up to `MARGIN` rows around the filtered ones.
    guides : Guides
        Guides of the same rows, see `make_guides`.
    rows : (int, int)
        First and last-plus-one filtered row, counted within ``halves``.
    """
    filtered = np.empty((2, rows[1] - rows[0], *halves.mean.shape[1:]), dtype=np.float32)
    _filter_rows(halves, guides, rows, _Results(filtered, filtered[0, :0], np.empty((2, 0, 0))))
    return filtered


def squared_error(distance, first: np.ndarray, second: np.ndarray, filtered: np.ndarray) -> np.ndarray:
    """Return an unbiased estimate of a filtered picture's squared distance to the truth, per pixel; may be negative.

    The squared distance between a filtered set and the other, unfiltered set is the error of the filter plus the noise
    of the latter. The squared error of the mean of two filtered sets is smaller by the square of half their distance.

    Parameters
    ----------
    distance : callable
        Takes two pictures and returns their distance at every pixel.
    first, second : (..., 61) float
        Both sets, unfiltered.
    filtered : (2, ..., 61) float
        Both sets, filtered.
    """
    crossed = np.square(distance(filtered[0], second)) + np.square(distance(filtered[1], first))
    own = np.square(distance(first, second))
    return 0.5 * crossed - 0.5 * own - 0.25 * np.square(distance(*filtered))


def _band_distance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    apart = np.subtract(one, other, dtype=np.float64)
    return np.sqrt(np.einsum("...c,...c->...", apart, apart) / apart.shape[-1])


def denoise(halves: Halves) -> Denoised:
    """Filter a picture and estimate its error; the temporary memory is that of a few rows."""
    guides, (height, width, bands) = make_guides(halves), halves.mean.shape
    radiance, squares = np.empty_like(halves.mean), np.empty((2, height, width))
    none = np.empty((2, 0, width, bands), dtype=np.float32)
    count = max(_TILE_PIXELS // width // _ROWS, 1) * _ROWS
    for first in range(0, height, count):
        part = slice(first, min(first + count, height))
        own = _Results(none, radiance[part], np.empty((2, part.stop - first, width)))
        _filter_rows(halves, guides, (first, part.stop), own)
        squares[:, part] = own.squares
    # The remaining noise of the filtered sets is a lower limit, if the estimate is lost in the original noise.
    whole, least = (_averaged(one, _ERROR_SIDE) for one in squares)
    return Denoised(radiance, np.sqrt(np.maximum(whole, least)).astype(np.float32))


def distance_to_unbiased(halves: Halves, radiance: np.ndarray) -> dict[str, float]:
    """Return the differences between block means of a filtered picture and of the unfiltered one, which is unbiased.

    Blocks have sides of `BLOCK_PX` pixels; their means have little noise, but keep a bias of the filter.

    Returns
    -------
    dict
        ``mean``, ``p95`` and ``max`` over the blocks of the root mean square over bands, relative to the mean radiance;
        and ``noise``, the mean relative standard error of the unfiltered blocks. A difference of about the size of the
        noise does not indicate a bias.
    """
    height, width = (max(size // BLOCK_PX, 1) for size in radiance.shape[:2])

    def blocks(picture: np.ndarray) -> np.ndarray:
        rows = np.array_split(picture, height)
        means = [[block.mean(axis=(0, 1), dtype=np.float64) for block in np.array_split(row, width, 1)] for row in rows]
        return np.array(means)

    unbiased, half = blocks(halves.mean), blocks(halves.difference)
    level = np.maximum(unbiased.mean(axis=-1), np.finfo(np.float64).tiny)
    off, noise = _band_distance(blocks(radiance), unbiased) / level, _band_distance(half, 0.0 * half) / level
    return {
        "mean": float(off.mean()),
        "p95": float(np.percentile(off, 95)),
        "max": float(off.max()),
        "noise": float(noise.mean()),
    }
