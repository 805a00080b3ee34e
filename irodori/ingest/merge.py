"""Merging of a bracket of exposures into responses, in one pass over the digital numbers.

Brackets are merged by inverse variance. What decides about a sample must not depend on its own noise, or the mean
leans:

* weights come from a signal that a block of 8 x 8 samples of one colour shares;
* whether a longer exposure is near clipping is predicted from the block's mean in the shorter ones, and its weight
  fades out between 60 % and 85 % of the range. Where the block varies by more than its noise, by texture or a
  highlight, the weighted mean of the pixel's own exposures takes the place of the prediction: the fade is slow against
  its noise;
* in addition, no sample at or above the clip level is ever used.

With one exposure nothing predicts, and the clip level alone decides.
"""

from dataclasses import dataclass

import numba
import numpy as np

from irodori.ingest import flat_field as flat_field
from irodori.jit.compilation import njit

_BLOCK = 8  # samples along the side of a block
_FADE_FROM, _FADE_TO = 0.6, 0.85  # of the range from black to clip level
#: Stands for a dark frame that is not there; strided like a view of one, so that the loops are compiled once.
ABSENT = np.zeros((4, 4), dtype=np.int16)[::2, ::2]
_TEXTURE = 2.0  # variance of a block over that of its noise; noise alone scatters it by 18 %


@dataclass(frozen=True)
class Bracket:
    """Exposures of one filter state, in ascending order, as the merge takes them.

    Parameters
    ----------
    exposure_dn : (K,) float64
        Digital numbers above black that a response rate of 1 leaves: relative exposure in s times full scale; each
        above the one before.
    dark_s : (K,) float64
        Exposure times for the dark signal's rate, s, times the amplification relative to the dark frames.
    electrons_per_dn, read_dn2 : (K,) float64
        Noise of each exposure; NaN where unknown: samples then weigh by exposure, which is inverse variance where shot
        noise rules.
    """

    exposure_dn: np.ndarray
    dark_s: np.ndarray
    electrons_per_dn: np.ndarray
    read_dn2: np.ndarray


@dataclass(frozen=True)
class Planes:
    """Samples of each place of the mosaic's pattern, or of each band after demosaicing.

    Parameters
    ----------
    samples : tuple of (K, height, width) uint16
        One array a place; may be strided views.
    bands : (places,) int64
    black, clip : (places, K) float64
        Digital numbers of no light, dark signal included where there is no dark frame, and from which a sample clips.
    offset, rate : tuple of (height, width) int16
        Dark frame, one array a place; ABSENT where there is none, with a step of 0.
    steps : (float, float)
        Digital numbers of one step of offset, DN/s of one step of rate.
    """

    samples: tuple
    bands: np.ndarray
    black: np.ndarray
    clip: np.ndarray
    offset: tuple
    rate: tuple
    steps: tuple[float, float]


@njit(cache=True, nogil=True, fastmath=True)
def _single_row(samples, offset, rate, steps, black, clip, scale, total, excess):
    """Add the scaled samples of one exposure of one place to a row; note by how much the largest passes its clip."""
    for x in range(samples.size):
        total[x] += (np.float32(samples[x]) - black) * scale
        excess[x] = max(excess[x], np.float32(samples[x]) - clip)
    if steps[1] != 0.0:
        step = steps[1] * scale
        for x in range(samples.size):
            total[x] -= step * np.float32(rate[x])
    if steps[0] != 0.0:
        step = steps[0] * scale
        for x in range(samples.size):
            total[x] -= step * np.float32(offset[x])


@njit(cache=True, nogil=True)
def _block_moments(values, first, last, left, right):
    """Return mean and variance of a block."""
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
def _weigh_block(means, variances, exposure, gain, read, room, weights, predicted):
    """Set each exposure's inverse variance of the rate from the block's common signal, and the level predicted for it.

    ``means`` are levels above black and dark, DN; clipped samples counted with their clipped value. There is no
    prediction, NaN, where the next shorter exposure varies by more than its noise: by texture.
    """
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
def _weigh_row(first, last, samples, offset, rate, steps, black, clip, exposures, weights, predicted):
    """Fill weights and predictions of a row of blocks, (blocks, K)."""
    exposure, dark_s, gain, read = exposures
    means, variances, room = np.empty(exposure.size), np.empty(exposure.size), clip - black
    for block in range(weights.shape[0]):
        left, right = block * _BLOCK, min((block + 1) * _BLOCK, samples.shape[2])
        fixed = steps[0] * _block_moments(offset, first, last, left, right)[0] if steps[0] != 0.0 else 0.0
        slope = steps[1] * _block_moments(rate, first, last, left, right)[0] if steps[1] != 0.0 else 0.0
        for k in range(exposure.size):
            level, variances[k] = _block_moments(samples[k], first, last, left, right)
            means[k] = level - black[k] - fixed - slope * dark_s[k]
        _weigh_block(means, variances, exposure, gain, read, room, weights[block], predicted[block])


@njit(cache=True, nogil=True)
def _dark_row(offset, rate, step, slope, dark):
    """Set the dark signal of a row, DN."""
    dark[:] = 0.0
    if step != 0.0:
        for x in range(dark.size):
            dark[x] += step * offset[x]
    if slope != 0.0:
        for x in range(dark.size):
            dark[x] += slope * rate[x]


@njit(cache=True, nogil=True)
def _add_exposure(k, samples, dark, black, clip, exposure, weights, predicted, top, bottom):
    """Add exposure k of a row to the sums of weighted rates and of weights; return the sum of its fades."""
    used = 0.0
    seconds, room = exposure[k], clip - black
    for block in range(weights.shape[0]):
        weight, expected = weights[block, k], predicted[block, k]
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
def _merge_place(first, last, samples, offset, rate, steps, black, clip, exposures, scale, total, excess, counts):
    """Merge one place's samples in the rows of one row of blocks and add them, scaled, to the band's total."""
    exposure, dark_s, _, _ = exposures
    count, _, width = samples.shape
    blocks = (width + _BLOCK - 1) // _BLOCK
    weights, predicted = np.empty((blocks, count)), np.empty((blocks, count))
    _weigh_row(first, last, samples, offset, rate, steps, black, clip, exposures, weights, predicted)
    dark, top, bottom = np.empty(width), np.empty(width), np.empty(width)
    for y in range(first, last):
        top[:] = 0.0
        bottom[:] = 0.0
        for k in range(count):
            _dark_row(_row(offset, y), _row(rate, y), steps[0], steps[1] * dark_s[k], dark)
            counts[k] += _add_exposure(
                k, samples[k, y], dark, black[k], clip[k], exposure, weights, predicted, top, bottom
            )
        for x in range(width):
            if bottom[x] > 0.0:
                total[y - first, x] += np.float32(top[x] / bottom[x] * scale)
            else:
                excess[y - first, x] = 0.0


@njit(cache=True, nogil=True)
def _row(values, y):
    """Return a row of a dark frame; one that is absent has few rows, and a step of 0."""
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
    """Write one row of three bands; what clipped is 0."""
    for x in range(excess.size):
        if excess[x] >= 0.0:
            clipped[x] = True
            out[x, 0], out[x, 1], out[x, 2] = 0.0, 0.0, 0.0
        else:
            out[x, 0], out[x, 1], out[x, 2] = total[0, x], total[1, x], total[2, x]


@njit(cache=True, nogil=True)
def _block_row(first, last, samples, offset, rate, steps, levels, exposures, surface, axes, out, clipped, counts):
    """Compute the three bands of one row of blocks."""
    bands, black, clip = levels
    exposure, dark_s, _, _ = exposures
    places, height, width = len(samples), last - first, out.shape[1]
    total = np.zeros((3, height, width), dtype=np.float32)
    excess = np.full((height, width), np.float32(-1.0))
    for p in range(places):
        shared = 0
        for q in range(places):
            shared += bands[q] == bands[p]
        scale = 1.0 / shared
        if exposure.size > 1:
            _merge_place(
                first, last, samples[p], offset[p], rate[p], steps, black[p], clip[p], exposures, scale,
                total[bands[p]], excess, counts[bands[p]],
            )  # fmt: skip
            continue
        at = (np.float32(steps[0]), np.float32(steps[1] * dark_s[0]))
        floor, top = np.float32(black[p, 0]), np.float32(clip[p, 0])
        for y in range(first, last):
            _single_row(
                samples[p][0, y], _row(offset[p], y), _row(rate[p], y), at, floor, top,
                np.float32(scale / exposure[0]), total[bands[p], y - first], excess[y - first],
            )  # fmt: skip
    for y in range(first, last):
        if surface.size > 0:
            for b in range(3):
                _flat_row(surface[b], axes[0] + y * axes[1], axes[2], axes[3], total[b, y - first])
        _store_row(total[:, y - first], excess[y - first], out[y], clipped[y])


@njit(cache=True, parallel=True, nogil=True)
def _merge(samples, offset, rate, steps, levels, exposures, surface, axes, out, clipped, counts):
    height = out.shape[0]
    for block in numba.prange((height + _BLOCK - 1) // _BLOCK):
        first, last = block * _BLOCK, min((block + 1) * _BLOCK, height)
        _block_row(
            first, last, samples, offset, rate, steps, levels, exposures, surface, axes, out, clipped, counts[block]
        )


def merge(planes: Planes, bracket: Bracket, white, sample_px: int, out: np.ndarray, clipped: np.ndarray) -> np.ndarray:
    """Merge the exposures of one filter state into responses.

    Parameters
    ----------
    planes : Planes
    bracket : Bracket
    white : (3, 15) float64 or None
        Coefficients of the flat field, see `irodori.ingest.flat_field`; or (3,) the level that applies to the whole
        picture.
    sample_px : int
        Mosaic pixels a sample: 2 for superpixels, 1 after demosaicing.
    out : (height, width, 3) float32
        Receives the responses, 0 where clipped; may be a strided view.
    clipped : (height, width) bool
        Is set where a band has no sample below its clip level in any exposure.

    Returns
    -------
    (3, K) float64
        Share of each band's samples that each exposure gave, those near clipping in part.
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
    _merge(
        planes.samples, planes.offset, planes.rate, planes.steps, (planes.bands, planes.black, planes.clip),
        (bracket.exposure_dn, bracket.dark_s, bracket.electrons_per_dn, bracket.read_dn2),
        surface, (*_axis(height, sample_px), *_axis(width, sample_px)), out, clipped, counts,
    )  # fmt: skip
    if bracket.exposure_dn.size == 1:
        return np.ones((3, 1))
    places = np.bincount(planes.bands, minlength=3)[:, None]
    return counts.sum(axis=0) / (height * width * places)


def _axis(size: int, sample_px: int) -> tuple[float, float]:
    """Return where the flat field's coordinate of the first sample lies, and its step."""
    superpixels = size * sample_px // 2
    if superpixels < 2:
        return 0.0, 0.0
    step = 2.0 / (superpixels - 1)
    # The centre of sample i lies at (i + 1/2) sample_px / 2 - 1/2 superpixels.
    return -1.0 + step * (sample_px / 4 - 0.5), step * sample_px / 2
