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
from irodori.jit.functions import exp, upper_of
from irodori.jit.vector_memory import load, spread, store, total, zeros_like
from irodori.rendering.reference.world import ALBEDO, NORMAL, PLACE, SEEN, SHINE
from irodori.rendering.scene_lights import PADDED

#: Pixels to each side that a pixel is filtered over, and pixels to each side of a patch that is compared.
RADIUS, PATCH = 5, 2
#: Rows around those wanted that `filtered_halves` reads.
MARGIN = RADIUS + PATCH
_ROWS = 8  # rows filtered together, because patches of neighbouring rows share their comparisons
_SIDE = 2 * RADIUS + 1
_WINDOW = _SIDE * _SIDE
_STRICT = 0.49  # square of the number of standard deviations by which patches may differ (k = 0.7, Rousselle et al.)
_RIDGE = 1e-4  # regularisation of the regression's slopes, relative to the sum of the weights
_LEAST_WEIGHT = 1e-4
_COLUMNS, _LANES = SEEN + 1, 16  # of the regression, its constant last; the same filled up to a vector
_ONE, _SCALE = _LANES, 2 * _LANES  # places of vectors, see `_new_scratch`
#: Differences of the normal, of the albedo's cube root and of the share of gloss that count as another surface.
_SAME_NORMAL, _SAME_ALBEDO, _SAME_SHINE = 0.3, 0.3, 0.2
_DARK = 1e-3  # share of the picture's mean below which differences are not visible
_NOISE_SIDE = 7  # side, in pixels, of the square over which the noise is averaged
_ERROR_SIDE = 31  # the same for squared errors, whose single values are inaccurate and may be negative
_TILE_ROWS = 64
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

    ``colour`` and ``noise`` go on by `RADIUS` pixels beyond the left and the right edge, with the values of the edge.
    """

    colour: np.ndarray  # (2 sets, 3 parts of the spectrum, height, width + 2 RADIUS) float32, cube roots
    noise: np.ndarray  # (3, height, width + 2 RADIUS) float32 variance of one set
    seen: np.ndarray  # (height, width, 16) float32, scaled to about one over the window; SEEN features, then 1, then 0
    surface: np.ndarray  # (height, width) bool: whether any path hit a surface; other pixels have little noise


def _averaged(values: np.ndarray, side: int) -> np.ndarray:
    """Return means over a square of ``side`` pixels around each pixel of a picture (height, width)."""
    from scipy.ndimage import convolve1d  # slow to import

    # `uniform_filter` uses a running sum, whose rounding error next to a sun exceeds the values of dark pixels.
    even = np.full(side, 1.0 / side)
    return convolve1d(convolve1d(values.astype(np.float64), even, 0, mode="nearest"), even, 1, mode="nearest")


def _parts(spectra: np.ndarray) -> np.ndarray:
    """Return the means of spectra over three parts of the wavelength range, (3, ...) float32."""
    thirds = np.array_split(np.arange(spectra.shape[-1]), 3)
    return np.stack([spectra[..., third].mean(axis=-1, dtype=np.float32) for third in thirds])


def make_guides(halves: Halves) -> Guides:
    """Return the guides of a picture, or of some rows; those of rows differ slightly because of the mean brightness."""
    mean, half = _parts(halves.mean), _parts(halves.difference)
    # Cube roots approximate perceived lightness and make the noise similar in dark and bright regions.
    dark = _DARK * float(mean.mean()) or 1.0
    colour = np.stack([np.cbrt(np.maximum(mean + sign * half, 0.0) + dark) for sign in (1.0, -1.0)]).astype(np.float32)
    squares = 0.5 * np.square(colour[0] - colour[1])
    noise = np.stack([_averaged(part, _NOISE_SIDE) for part in squares]).astype(np.float32)
    seen = np.zeros((*halves.seen.shape[:2], _LANES), dtype=np.float32)
    seen[..., :SEEN], seen[..., SEEN] = halves.seen, 1.0
    surface = np.square(halves.seen[..., NORMAL:PLACE]).sum(axis=-1) > 0.0
    seen[..., ALBEDO:NORMAL] = np.cbrt(np.maximum(seen[..., ALBEDO:NORMAL], 0.0) + 1e-3)
    both = surface[:, 1:] & surface[:, :-1]
    steps = np.linalg.norm(np.diff(seen[..., PLACE:SHINE], axis=1), axis=-1)[both]
    seen[..., PLACE:SHINE] /= 2.0 * RADIUS * (float(np.median(steps)) if steps.size else 0.0) or 1.0
    beyond = [(0, 0), (0, 0), (RADIUS, RADIUS)]
    return Guides(np.pad(colour, [(0, 0), *beyond], mode="edge"), np.pad(noise, beyond, mode="edge"), seen, surface)


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _compare(guides, which, shift, rows, scratch, weights):
    """Fill the weights (rows, width) of the neighbours at one offset from patches of a set; 0 outside the picture."""
    height, width = guides.surface.shape
    (down, right), (first, last), (patches, column) = shift, rows, scratch
    for row in range(first - PATCH, last + PATCH):
        own = min(max(row, 0), height - 1)
        other = min(max(row + down, 0), height - 1)
        line = patches[row - first + PATCH]
        line[:] = np.float32(0.0)
        for part in range(3):
            here, there = guides.colour[which, part, own], guides.colour[which, part, other]
            noise_here, noise_there = guides.noise[part, own], guides.noise[part, other]
            for x in range(width):
                step = here[RADIUS + x] - there[RADIUS + right + x]
                one, two = noise_here[RADIUS + x], noise_there[RADIUS + right + x]
                over = step * step - (one + min(one, two))
                line[x] += over / (np.float32(1e-12) + np.float32(_STRICT) * (one + two))
    share, zero = np.float32(-1.0 / (3 * (2 * PATCH + 1) ** 2)), np.float32(0.0)
    for row in range(first, last):
        out = weights[row - first]
        if not 0 <= row + down < height:
            out[:] = zero
            continue
        column[:] = zero
        for line in range(row - first, row - first + 2 * PATCH + 1):
            for x in range(width):
                column[PATCH + x] += patches[line, x]
        for x in range(PATCH):
            column[x], column[PATCH + width + x] = column[PATCH], column[PATCH + width - 1]
        for x in range(width):
            mean = zero
            for beside in range(2 * PATCH + 1):
                mean += share * column[x + beside]
            out[x] = exp(min(mean, zero))
        for x in range(-right):
            out[x] = zero
        for x in range(width - right, width):
            out[x] = zero


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _solve(matrix, out):
    """Fill ``out`` with the last column of the inverse of a positive definite matrix, which is overwritten.

    Rows are eliminated as vectors; the right-hand side, the last unit vector, stays as it is meanwhile.
    """
    for k in range(_COLUMNS):
        inverse, own = 1.0 / max(matrix[k, k], 1e-12), load(matrix, k * _LANES, _LANES)
        out[k] = inverse
        for a in range(k + 1, _COLUMNS):
            factor = spread(matrix[a, k] * inverse, _LANES)
            store(matrix, a * _LANES, load(matrix, a * _LANES, _LANES) - factor * own)
    for a in range(_COLUMNS - 2, -1, -1):
        rest = 0.0
        for c in range(a + 1, _COLUMNS):
            rest -= matrix[a, c] * out[c]
        out[a] *= rest


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def _weigh(count, unlike, weights):
    """Multiply the weights of neighbours by those of their similarity to the pixel."""
    for place in range(count):
        weights[place] *= exp(-unlike[place])


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def _regress(guides, row, x, near, scratch):
    """Replace the weights of a pixel's neighbours by those with which the regression combines their values.

    ``near`` has the number of neighbours, their places relative to the pixel in the picture, and their weights.
    """
    count, away, weights = near
    design, unlike, sums, matrix, solved, lanes = scratch
    here = row * guides.surface.shape[1] + x
    own, one, scale = load(guides.seen, here * _LANES, _LANES), load(lanes, _ONE, _LANES), load(lanes, _SCALE, _LANES)
    for place in range(count):
        apart = load(guides.seen, (here + away[place]) * _LANES, _LANES) - own
        unlike[place] = total(apart * apart * scale)
        store(design, place * _LANES, apart + one)
    _weigh(count, unlike, weights)
    for a in range(_COLUMNS):
        store(sums, a * _LANES, zeros_like(own))
    whole = np.float32(0.0)
    for place in range(count):
        whole += weights[place]
        scaled = load(design, place * _LANES, _LANES) * spread(weights[place], _LANES)
        for a in range(_COLUMNS):
            share = spread(design[place, a], _LANES)
            store(sums, a * _LANES, load(sums, a * _LANES, _LANES) + share * scaled)
    for a in range(_COLUMNS):
        for lane in range(_LANES):
            matrix[a, lane] = sums[a, lane]
    for a in range(_COLUMNS - 1):
        matrix[a, a] += _RIDGE * whole
    _solve(matrix, solved)
    for lane in range(_COLUMNS):
        lanes[lane] = solved[lane]
    factors = load(lanes, 0, _LANES)
    for place in range(count):
        weights[place] *= total(factors * load(design, place * _LANES, _LANES))


@njit(cache=True, nogil=True)
def _new_scratch():
    """Return the buffers of `_regress`."""
    lanes = np.zeros(3 * _LANES, np.float32)  # the regression's result, the unit of the constant, and 1 / scale²
    lanes[_ONE + SEEN] = 1.0
    for axis in range(3):
        lanes[_SCALE + NORMAL + axis] = 1.0 / _SAME_NORMAL**2
        lanes[_SCALE + ALBEDO + axis] = 1.0 / _SAME_ALBEDO**2
    lanes[_SCALE + SHINE] = 1.0 / _SAME_SHINE**2
    return (
        np.zeros((_WINDOW, _LANES), np.float32),
        np.zeros(_WINDOW, np.float32),
        np.zeros((_COLUMNS, _LANES), np.float32),
        np.empty((_COLUMNS, _LANES)),
        np.empty(_COLUMNS),
        lanes,
    )


@njit(cache=True, nogil=True, fastmath={"contract"})
def _combine(sets, at, near, out, to):
    """Store the weighted sum of neighbours' spectra, which are not negative, in ``out``; both by flat indices."""
    count, away, weights = near
    for band in range(0, PADDED, _LANES):
        sums = zeros_like(load(sets, at, _LANES))
        for place in range(count):
            value = load(sets, at + away[place] * PADDED + band, _LANES)
            sums = sums + spread(weights[place], _LANES) * value
        # The regression may give negative radiance.
        store(out, to + band, upper_of(sums, np.float32(0.0)))


@njit(cache=True, nogil=True)
def _filter_some_rows(sets, guides, starts, filtered, first, last):
    """Fill bands ``first`` to ``last`` of `_ROWS` rows in ``filtered`` (2 sets, rows, width, 64).

    ``starts`` has the first row of ``sets``, and that of ``filtered``.
    """
    read, start = starts
    width, count = guides.surface.shape[1], filtered.shape[1]
    compared = np.empty((_ROWS + 2 * PATCH, width), np.float32), np.empty(width + 2 * PATCH, np.float32)
    weights = np.empty((_WINDOW, _ROWS, width), np.float32)
    away, own, scratch = np.empty(_WINDOW, np.int64), np.empty(_WINDOW, np.float32), _new_scratch()
    for band in range(first, last):
        top, bottom = start + band * _ROWS, min(start + (band + 1) * _ROWS, start + count)
        for which in range(2):
            for offset in range(_WINDOW):
                shift = offset // _SIDE - RADIUS, offset % _SIDE - RADIUS
                _compare(guides, 1 - which, shift, (top, bottom), compared, weights[offset])
            for row in range(top, bottom):
                for x in range(width):
                    if not guides.surface[row, x]:
                        for c in range(PADDED):
                            filtered[which, row - start, x, c] = sets[which, row - read, x, c]
                        continue
                    near = 0
                    for offset in range(_WINDOW):
                        weight = weights[offset, row - top, x]
                        if weight >= _LEAST_WEIGHT:
                            away[near] = (offset // _SIDE - RADIUS) * width + offset % _SIDE - RADIUS
                            own[near] = weight
                            near += 1
                    _regress(guides, row, x, (near, away, own), scratch)
                    at = ((which * sets.shape[1] + row - read) * width + x) * PADDED
                    to = ((which * count + row - start) * width + x) * PADDED
                    _combine(sets, at, (near, away, own), filtered, to)


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
    count, (height, width, bands) = rows[1] - rows[0], halves.mean.shape
    read = max(rows[0] - RADIUS, 0), min(rows[1] + RADIUS, height)
    mean, half = halves.mean[slice(*read)], halves.difference[slice(*read)]
    sets = np.zeros((2, *mean.shape[:2], PADDED), dtype=np.float32)
    np.add(mean, half, out=sets[0, ..., :bands])
    np.subtract(mean, half, out=sets[1, ..., :bands])
    filtered = np.empty((2, count, width, PADDED), dtype=np.float32)
    run_chunks(_filter_some_rows, math.ceil(count / _ROWS), 1, sets, guides, (read[0], rows[0]), filtered)
    return filtered[..., :bands]


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


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def _square_some_rows(halves, filtered, start, out, first, last):
    """Fill rows of ``out``, (2, rows, width), with `squared_error` and with the noise of the filtered sets alone.

    Both are mean squares over the bands. ``start`` is the row of ``halves`` with which ``filtered`` and ``out`` begin.
    """
    bands = halves.mean.shape[2]
    for row in range(first, last):
        for x in range(halves.mean.shape[1]):
            crossed, own, between = 0.0, 0.0, 0.0
            for c in range(bands):
                mean = np.float64(halves.mean[start + row, x, c])
                half = np.float64(halves.difference[start + row, x, c])
                one, two = np.float64(filtered[0, row, x, c]), np.float64(filtered[1, row, x, c])
                crossed += (one - mean + half) ** 2 + (two - mean - half) ** 2
                own += half * half
                between += (one - two) ** 2
            out[1, row, x] = 0.25 * between / bands
            out[0, row, x] = (0.5 * crossed - 2.0 * own) / bands - out[1, row, x]


def _band_distance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    apart = np.subtract(one, other, dtype=np.float64)
    return np.sqrt(np.einsum("...c,...c->...", apart, apart) / apart.shape[-1])


def denoise(halves: Halves) -> Denoised:
    """Filter a picture and estimate its error; the temporary memory is that of a few rows."""
    guides, (height, width, _) = make_guides(halves), halves.mean.shape
    radiance, squares, least = np.empty_like(halves.mean), np.empty((height, width)), np.empty((height, width))
    for first in range(0, height, _TILE_ROWS):
        rows = (first, min(first + _TILE_ROWS, height))
        filtered = filtered_halves(halves, guides, rows)
        part = slice(*rows)
        radiance[part] = 0.5 * (filtered[0] + filtered[1])
        own = np.empty((2, *filtered.shape[1:3]))
        run_chunks(_square_some_rows, filtered.shape[1], _ROWS, halves, filtered, first, own)
        squares[part], least[part] = own
    # The remaining noise of the filtered sets is a lower limit, if the estimate is lost in the original noise.
    squares = np.maximum(_averaged(squares, _ERROR_SIDE), _averaged(least, _ERROR_SIDE))
    return Denoised(radiance, np.sqrt(squares).astype(np.float32))


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
