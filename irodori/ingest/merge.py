"""Merging of a bracket of exposures into responses, in one pass over the digital numbers.

Exposures are merged with inverse variances as weights. The weight of a sample must not depend on its own noise, because
that would bias the mean:

* weights are computed from the common signal of a block of 8 x 8 samples of one colour;
* whether a longer exposure is near clipping is predicted from the mean of the block in the shorter ones, and its weight
  fades out between 60 % and 85 % of the range. If the block varies by more than its noise, because of texture or a
  highlight, the weighted mean of the pixel's exposures replaces the prediction; the fade is slow compared with the
  noise of this mean;
* in addition, samples at or above the clip level are never used.

With a single exposure there is no prediction, and only the clip level counts.
"""

from typing import NamedTuple

import numpy as np

from irodori.ingest import flat_field as flat_field
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit

_BLOCK = 8  # samples along the side of a block
_CHUNKS = 32  # number of groups of rows of blocks, which the threads process
_FADE_FROM, _FADE_TO = 0.6, 0.85  # shares of the range from black to the clip level
FADED = 0.5 * (_FADE_FROM + _FADE_TO)  # that at which a longer exposure has half of its weight
#: Placeholder for a missing dark frame; strided like a view of one, so that the loops are compiled only once.
ABSENT = np.zeros((4, 4), dtype=np.int16)[::2, ::2]
_TEXTURE = 2.0  # variance of a block, relative to its noise, that indicates texture; noise alone scatters it by 18 %


class ExposureBracket(NamedTuple):
    """The K exposures of one filter state in ascending order; each field is (K,) float64.

    If the noise of an exposure is unknown (NaN), samples are weighted by exposure, which is the inverse variance if
    shot noise dominates.
    """

    #: Digital numbers above black for a response rate of 1: relative exposure in s times full scale; ascending.
    exposure_dn: np.ndarray
    dark_s: np.ndarray  # exposure time, s, times the amplification relative to the dark frames
    electrons_per_dn: np.ndarray
    read_dn2: np.ndarray


class PatternPlanes(NamedTuple):
    """Samples at each place of the mosaic pattern, or of each band after demosaicing."""

    samples: tuple  # one array (K, height, width) uint16 for each place; may be strided views
    bands: np.ndarray  # (places,) int64
    black: np.ndarray  # (places, K) float64, DN without light, including a constant dark signal
    clip: np.ndarray  # (places, K) float64, DN at and above which a sample is clipped
    offset: tuple  # one array (height, width) int16 of the dark frame for each place; ABSENT if there is none
    rate: tuple  # likewise
    steps: tuple[float, float]  # DN of one step of offset, and DN/s of one step of rate; 0 without a dark frame


class _Place(NamedTuple):
    """Samples of one place; the fields are those of `PatternPlanes`."""

    samples: np.ndarray  # (K, height, width)
    black: np.ndarray  # (K,)
    clip: np.ndarray  # (K,)
    offset: np.ndarray  # (height, width)
    rate: np.ndarray  # (height, width)
    steps: tuple[float, float]


class _Flat(NamedTuple):
    """Polynomials of the flat field."""

    surface: np.ndarray  # (3, power of x, power of y) coefficients; empty if there is no flat field
    axes: tuple[float, float, float, float]  # coordinate of the first sample, and step, along y and along x


class _Merged(NamedTuple):
    """Arrays that a merge fills."""

    out: np.ndarray  # (height, width, 3) float32 responses, 0 where clipped
    clipped: np.ndarray  # (height, width) bool
    counts: np.ndarray  # (blocks, 3, K), samples contributed by each exposure, with fractions for those near clipping


class _Rows(NamedTuple):
    """Sums for one band over a row of blocks."""

    first: int  # first row in the picture
    total: np.ndarray  # (rows, width) float32, sum of the merged samples
    excess: np.ndarray  # (rows, width) float32, common to all bands; 0 or more where a band is clipped
    counts: np.ndarray  # (K,)


class _Weighing(NamedTuple):
    """Weights and predicted levels of the exposures in each block of a row, (blocks, K)."""

    weights: np.ndarray
    predicted: np.ndarray  # level, DN above black and dark signal; NaN if it cannot be predicted


class _Sums(NamedTuple):
    """Dark signal and weighted sums for one row of one place, (width,) each."""

    dark: np.ndarray  # DN
    top: np.ndarray  # sum of weighted rates
    bottom: np.ndarray  # sum of weights


class _Levels(NamedTuple):
    """Levels and steps of a single exposure, float32."""

    offset_step: np.float32  # DN
    rate_step: np.float32  # DN
    black: np.float32
    clip: np.float32
    scale: np.float32  # response per DN


@njit(cache=True, nogil=True, fastmath=True)
def _add_single(samples, offset, rate, levels, total, excess):
    """Add the scaled samples of a single exposure at one place to a row; update the excess over the clip level."""
    black, clip, scale = levels.black, levels.clip, levels.scale
    for x in range(samples.size):
        total[x] += (np.float32(samples[x]) - black) * scale
        excess[x] = max(excess[x], np.float32(samples[x]) - clip)
    if levels.rate_step != 0.0:
        step = levels.rate_step * scale
        for x in range(samples.size):
            total[x] -= step * np.float32(rate[x])
    if levels.offset_step != 0.0:
        step = levels.offset_step * scale
        for x in range(samples.size):
            total[x] -= step * np.float32(offset[x])


@njit(cache=True, nogil=True)
def _block_moments(values, first, last, left, right):
    """Return the mean and variance of a block."""
    origin, total, square = float(values[first, left]), 0.0, 0.0
    for y in range(first, last):
        for x in range(left, right):
            step = values[y, x] - origin
            total += step
            square += step * step
    count = (last - first) * (right - left)
    mean = total / count
    return origin + mean, square / count - mean * mean


@njit(cache=True, nogil=True)
def _weigh_block(means, variances, bracket, room, weights, predicted):
    """Compute the weight of each exposure (the inverse variance of its rate) and its predicted level for one block.

    ``means`` are mean levels above black and dark signal, DN, with clipped samples at their clipped values. The
    prediction is NaN if the next shorter exposure varies by more than its noise because of texture.
    """
    exposure, gain, read = bracket.exposure_dn, bracket.electrons_per_dn, bracket.read_dn2
    signal, seconds = means[0], exposure[0]
    for k in range(1, exposure.size):
        if means[k] < _FADE_TO * room[k]:
            signal += means[k]
            seconds += exposure[k]
    common = max(signal / seconds, 0.0)
    top, bottom, even = 0.0, 0.0, False
    for k in range(exposure.size):
        known = gain[k] > 0.0 and read[k] > 0.0
        variance = read[k] + common * exposure[k] / gain[k]
        weights[k] = exposure[k] ** 2 / variance if known else exposure[k]
        predicted[k] = top / bottom * exposure[k] if k > 0 and even else np.nan
        even = known and variances[k] < _TEXTURE * variance
        if k == 0 or means[k] < _FADE_TO * room[k]:
            top += weights[k] * means[k] / exposure[k]
            bottom += weights[k]


@njit(cache=True, nogil=True)
def _weigh_row(first, last, place, bracket, weighing):
    """Fill the weights and predicted levels of a row of blocks."""
    samples, black, clip, offset, rate, steps = place
    count, dark_s = bracket.exposure_dn.size, bracket.dark_s
    means, variances, room = np.empty(count), np.empty(count), clip - black
    for block in range(weighing.weights.shape[0]):
        left, right = block * _BLOCK, min((block + 1) * _BLOCK, samples.shape[2])
        fixed = steps[0] * _block_moments(offset, first, last, left, right)[0] if steps[0] != 0.0 else 0.0
        slope = steps[1] * _block_moments(rate, first, last, left, right)[0] if steps[1] != 0.0 else 0.0
        for k in range(count):
            level, variances[k] = _block_moments(samples[k], first, last, left, right)
            means[k] = level - black[k] - fixed - slope * dark_s[k]
        _weigh_block(means, variances, bracket, room, weighing.weights[block], weighing.predicted[block])


@njit(cache=True, nogil=True)
def _dark_row(offset, rate, step, slope, dark):
    """Compute the dark signal of a row, DN."""
    dark[:] = 0.0
    if step != 0.0:
        for x in range(dark.size):
            dark[x] += step * offset[x]
    if slope != 0.0:
        for x in range(dark.size):
            dark[x] += slope * rate[x]


@njit(cache=True, nogil=True)
def _add_exposure(place, seconds, k, y, weighing, sums):
    """Add exposure k of a row to the sums; return the number of samples used, in fractions for those near clipping."""
    samples, black, clip, used = place.samples[k, y], place.black[k], place.clip[k], 0.0
    (dark, top, bottom), room = sums, clip - black
    for block in range(weighing.weights.shape[0]):
        weight, expected = weighing.weights[block, k], weighing.predicted[block, k]
        for x in range(block * _BLOCK, min((block + 1) * _BLOCK, samples.size)):
            value = float(samples[x])
            if value >= clip:
                continue
            rate, fade = (value - black - dark[x]) / seconds, 1.0
            if bottom[x] > 0.0:
                level = expected
                if level != level:
                    level = (top[x] + weight * rate) / (bottom[x] + weight) * seconds
                fade = 1.0 - min(max((level / room - _FADE_FROM) / (_FADE_TO - _FADE_FROM), 0.0), 1.0)
            if fade > 0.0:
                used += fade
                top[x] += weight * fade * rate
                bottom[x] += weight * fade
    return used


@njit(cache=True, nogil=True)
def _merge_place(place, bracket, scale, rows):
    """Merge the exposures at one place in a row of blocks, and add them, scaled, to the total of the band."""
    first, total, excess, counts = rows
    last, steps, (count, _, width) = first + total.shape[0], place.steps, place.samples.shape
    blocks = (width + _BLOCK - 1) // _BLOCK
    weighing = _Weighing(np.empty((blocks, count)), np.empty((blocks, count)))
    _weigh_row(first, last, place, bracket, weighing)
    dark, top, bottom = np.empty(width), np.empty(width), np.empty(width)
    sums = _Sums(dark, top, bottom)
    for y in range(first, last):
        top[:] = 0.0
        bottom[:] = 0.0
        for k in range(count):
            _dark_row(_row(place.offset, y), _row(place.rate, y), steps[0], steps[1] * bracket.dark_s[k], dark)
            counts[k] += _add_exposure(place, bracket.exposure_dn[k], k, y, weighing, sums)
        for x in range(width):
            if bottom[x] > 0.0:
                total[y - first, x] += np.float32(top[x] / bottom[x] * scale)
            else:
                excess[y - first, x] = 0.0


@njit(cache=True, nogil=True)
def _row(values, y):
    """Return a row of a dark frame; for `ABSENT`, which has few rows and a step of 0, any row."""
    return values[min(y, values.shape[0] - 1)]


@njit(cache=True, nogil=True, fastmath=True)
def _flat_row(surface, y, x_start, x_step, row):
    """Divide a row of one band by the flat field's polynomial, ``surface`` (power of x, power of y)."""
    a = np.zeros(surface.shape[0])
    for i in range(a.size):
        for j in range(surface.shape[1] - 1, -1, -1):
            a[i] = a[i] * y + surface[i, j]
    a0, a1, a2, a3, a4 = np.float32(a[0]), np.float32(a[1]), np.float32(a[2]), np.float32(a[3]), np.float32(a[4])
    start, step = np.float32(x_start), np.float32(x_step)
    for column in range(row.size):
        x = start + np.float32(column) * step
        row[column] /= a0 + x * (a1 + x * (a2 + x * (a3 + x * a4)))


@njit(cache=True, nogil=True)
def _store_row(total, excess, out, clipped):
    """Write one row of three bands, with 0 for clipped pixels."""
    for x in range(excess.size):
        if excess[x] >= 0.0:
            clipped[x] = True
            out[x, 0], out[x, 1], out[x, 2] = 0.0, 0.0, 0.0
        else:
            out[x, 0], out[x, 1], out[x, 2] = total[0, x], total[1, x], total[2, x]


@njit(cache=True, nogil=True)
def _add_singles(place, bracket, scale, rows):
    """Add the samples of a single exposure at one place in a row of blocks, scaled, to the total of the band."""
    levels = _Levels(
        np.float32(place.steps[0]),
        np.float32(place.steps[1] * bracket.dark_s[0]),
        np.float32(place.black[0]),
        np.float32(place.clip[0]),
        np.float32(scale / bracket.exposure_dn[0]),
    )
    for row in range(rows.total.shape[0]):
        y = rows.first + row
        offset, rate = _row(place.offset, y), _row(place.rate, y)
        _add_single(place.samples[0, y], offset, rate, levels, rows.total[row], rows.excess[row])


@njit(cache=True, nogil=True)
def _block_row(planes, bracket, flat, merged, block):
    """Compute the three bands of one row of blocks."""
    first, last = block * _BLOCK, min((block + 1) * _BLOCK, merged.out.shape[0])
    bands, surface, axes = planes.bands, flat.surface, flat.axes
    places, height, width = len(planes.samples), last - first, merged.out.shape[1]
    total = np.zeros((3, height, width), dtype=np.float32)
    excess = np.full((height, width), np.float32(-1.0))
    for p in range(places):
        shared = 0
        for q in range(places):
            shared += bands[q] == bands[p]
        scale = 1.0 / shared
        place = _Place(
            planes.samples[p], planes.black[p], planes.clip[p], planes.offset[p], planes.rate[p], planes.steps
        )
        rows = _Rows(first, total[bands[p]], excess, merged.counts[block, bands[p]])
        if bracket.exposure_dn.size > 1:
            _merge_place(place, bracket, scale, rows)
        else:
            _add_singles(place, bracket, scale, rows)
    for y in range(first, last):
        if surface.size > 0:
            for b in range(3):
                _flat_row(surface[b], axes[0] + y * axes[1], axes[2], axes[3], total[b, y - first])
        _store_row(total[:, y - first], excess[y - first], merged.out[y], merged.clipped[y])


@njit(cache=True, nogil=True)
def _merge_some(planes, bracket, flat, merged, first, last):
    for block in range(first, last):
        _block_row(planes, bracket, flat, merged, block)


def merge(
    planes: PatternPlanes, bracket: ExposureBracket, white, sample_px: int, out: np.ndarray, clipped: np.ndarray
) -> np.ndarray:
    """Merge the exposures of one filter state into responses.

    Parameters
    ----------
    planes : PatternPlanes
    bracket : ExposureBracket
    white : (3, 15) float64 or None
        Coefficients of the flat field, see `irodori.ingest.flat_field`; or (3,), a constant for the whole picture.
    sample_px : int
        Side of a sample in mosaic pixels: 2 for superpixels, 1 after demosaicing.
    out : (height, width, 3) float32
        Filled with the responses, 0 where clipped; may be a strided view.
    clipped : (height, width) bool
        Set where a band has no sample below its clip level in any exposure.

    Returns
    -------
    (3, K) float64
        Share of each band's samples contributed by each exposure, with fractions for samples near clipping.
    """
    if white is None:
        surface = np.zeros((0, 0, 0))
    elif np.ndim(white) == 1:
        surface = np.zeros((3, flat_field.DEGREE + 1, flat_field.DEGREE + 1))
        surface[:, 0, 0] = white
    else:
        surface = flat_field.grid(white)
    height, width = out.shape[:2]
    counts = np.zeros((-(-height // _BLOCK), 3, bracket.exposure_dn.size))
    flat = _Flat(surface, (*_axis(height, sample_px), *_axis(width, sample_px)))
    chunk = -(-len(counts) // _CHUNKS)
    run_chunks(_merge_some, len(counts), chunk, planes, bracket, flat, _Merged(out, clipped, counts))
    if bracket.exposure_dn.size == 1:
        return np.ones((3, 1))
    places = np.bincount(planes.bands, minlength=3)[:, None]
    return counts.sum(axis=0) / (height * width * places)


def _axis(size: int, sample_px: int) -> tuple[float, float]:
    """Return the coordinate of the first sample in the flat field, and the step between samples."""
    superpixels = size * sample_px // 2
    if superpixels < 2:
        return 0.0, 0.0
    step = 2.0 / (superpixels - 1)
    # The centre of sample i lies at (i + 1/2) sample_px / 2 - 1/2 superpixels.
    return -1.0 + step * (sample_px / 4 - 0.5), step * sample_px / 2
