"""Statistics of a chart's patches that dirt, hot pixels and uneven light do not rule."""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from irodori.errors import InputError

TRIM = 0.1  # share of a patch's pixels left out at each end
#: Variance of the middle 80 % of a normal distribution, relative to the whole: 1 - 2 z φ(z) / 0.8, z = 1.2816.
_KEPT_VARIANCE = 1.0 - 2.0 * stats.norm.ppf(1 - TRIM) * stats.norm.pdf(stats.norm.ppf(1 - TRIM)) / (1.0 - 2.0 * TRIM)
#: Variance of the trimmed mean of n normal values, times n: the winsorised variance over (1 - 2 trim)².
_MEAN_VARIANCE = (_KEPT_VARIANCE * (1 - 2 * TRIM) + 2 * TRIM * stats.norm.ppf(1 - TRIM) ** 2) / (1 - 2 * TRIM) ** 2
_BLOCKS = 4  # a side: blocks whose medians tell unevenness
_MIN_BLOCK_PX = 2
_DARK = 0.02  # of the chart's largest mean: differences of dark patches are judged against no less
_MAX_GRADIENT = 0.15
_MAX_UNEVENNESS = 0.05
_LEAST_VALID = 0.5  # share of a patch


@dataclass(frozen=True)
class ChartReading:
    """What a camera answered on the patches of a chart, patch by patch, row by row.

    Parameters
    ----------
    centres_px : (patches, 2) float64
        x then y, superpixels.
    side_px : float
        Side of the squares that were averaged, superpixels.
    mean : (patches, bands) float64
        Trimmed mean response.
    pixel_variance : (patches, bands) float64
        Variance of one pixel about the patch's slope, from its middle 80 %, as for a normal distribution.
    mean_variance : (patches, bands) float64
        Variance of `mean`: that of independent pixels, or that which 4 x 4 blocks show about the slope, whichever is
        larger; so dirt, texture and interpolated neighbours count.
    count : (patches,) int
        Valid pixels.
    invalid_share : (patches,) float64
        Share of the pixels that are clipped or hot.
    gradient : (patches,) float64
        Change of the response from side to side over its mean (over 2 % of the chart's brightest patch where the mean
        is less), the largest of the bands; NaN where the patch has no blocks of 2 pixels.
    unevenness : (patches,) float64
        Largest deviation of a block from the slope beyond three standard errors, on the same scale; NaN likewise.
    """

    centres_px: np.ndarray
    side_px: float
    mean: np.ndarray
    pixel_variance: np.ndarray
    mean_variance: np.ndarray
    count: np.ndarray
    invalid_share: np.ndarray
    gradient: np.ndarray
    unevenness: np.ndarray

    @property
    def uneven(self) -> np.ndarray:
        """Patches with dirt, an edge, a shadow or light that falls off by over 15 %, (patches,) bool."""
        return (self.gradient > _MAX_GRADIENT) | (self.unevenness > _MAX_UNEVENNESS)

    def divided(self, field: np.ndarray) -> "ChartReading":
        """Return the reading under even light; `field` (patches, bands) or (patches, 1) is the light's share, 1 = even."""
        parts = {name: getattr(self, name) for name in self.__dataclass_fields__}
        parts["mean"] = self.mean / field
        parts["pixel_variance"], parts["mean_variance"] = self.pixel_variance / field**2, self.mean_variance / field**2
        return ChartReading(**parts)


def read_squares(response, valid, centres, side: float, file) -> dict:
    """Return the statistics of squares as keywords of `ChartReading`.

    Parameters
    ----------
    response : (height, width, bands) float
    valid : (height, width) bool
    centres : (patches, 2) float, samples
    side : float, samples
    file : path, for error messages

    Raises
    ------
    InputError
        If a square lies outside the picture or most of it is not valid.
    """
    height, width = valid.shape
    half = side / 2.0
    rows = []
    for number, (x, y) in enumerate(centres):
        x0, x1, y0, y1 = round(x - half), round(x + half), round(y - half), round(y + half)
        if x0 < 0 or y0 < 0 or x1 > width or y1 > height:
            found = f"patch {number} at ({x:.0f}, {y:.0f})"
            raise InputError(file, "chart.centres_px", found, f"patches inside {width} x {height} samples")
        good = valid[y0:y1, x0:x1].astype(bool)
        if good.mean() < _LEAST_VALID:
            found = f"patch {number} saturated over {1 - good.mean():.0%}"
            raise InputError(file, "exposure_s", found, "a chart exposed below saturation")
        rows.append(_statistics(response[y0:y1, x0:x1], good))
    columns = [np.stack(column) for column in zip(*rows, strict=True)]
    names = ("mean", "pixel_variance", "mean_variance", "count", "invalid_share", "change", "deviation")
    read = dict(zip(names, columns, strict=True))
    scale = np.maximum(read["mean"], _DARK * read["mean"].max(axis=0))
    scale = np.where(scale > 0, scale, np.inf)
    read["gradient"] = (read.pop("change") / scale).max(axis=1)
    read["unevenness"] = (read.pop("deviation") / scale).max(axis=1)
    return read


def _statistics(square: np.ndarray, good: np.ndarray) -> tuple:
    """Return mean, variances, count, share invalid, change along the slope and deviation from it of one patch."""
    values = square[good]
    mean = stats.trim_mean(values, TRIM, axis=0)
    slope, deviation, of_blocks = _slope(square, good, mean)
    y, x = np.nonzero(good)
    centred = np.stack([x - (good.shape[1] - 1) / 2.0, y - (good.shape[0] - 1) / 2.0], axis=1)
    residual = np.sort(values - centred @ np.nan_to_num(slope), axis=0)
    cut = int(TRIM * len(residual))
    kept = residual[cut : len(residual) - cut]
    pixel = kept.var(axis=0, ddof=1 if len(kept) > 1 else 0) / (_KEPT_VARIANCE if cut else 1.0)
    # As many values of a variance as blocks have bands: a block is taken for more only where it says much more.
    error = np.sqrt(pixel / max(1.0, len(values) / max(1, of_blocks[1])) * np.pi / 2.0)
    beyond = np.maximum(deviation - 3.0 * error, 0.0)
    independent = _MEAN_VARIANCE * pixel / len(values)
    change = np.hypot(slope[0] * good.shape[1], slope[1] * good.shape[0])
    return mean, pixel, np.fmax(independent, of_blocks[0]), len(values), 1.0 - good.mean(), change, beyond


def _slope(square: np.ndarray, good: np.ndarray, mean: np.ndarray) -> tuple:
    """Return slope per sample (2, bands), largest block deviation (bands), variance that blocks give the mean, blocks."""
    bands = square.shape[-1]
    blocks = min(_BLOCKS, min(good.shape) // _MIN_BLOCK_PX)
    nothing = np.full((2, bands), np.nan), np.full(bands, np.nan), (np.zeros(bands), 1)
    if blocks < 2:
        return nothing
    medians, places = [], []
    for ys in np.array_split(np.arange(good.shape[0]), blocks):
        for xs in np.array_split(np.arange(good.shape[1]), blocks):
            inside = good[ys[0] : ys[-1] + 1, xs[0] : xs[-1] + 1]
            if inside.mean() >= _LEAST_VALID:
                medians.append(np.median(square[ys[0] : ys[-1] + 1, xs[0] : xs[-1] + 1][inside], axis=0))
                places.append([1.0, xs.mean() - (good.shape[1] - 1) / 2.0, ys.mean() - (good.shape[0] - 1) / 2.0])
    if len(medians) < 4:
        return nothing
    places, medians = np.array(places), np.array(medians)
    plane, _, rank, _ = np.linalg.lstsq(places, medians)
    if rank < 3:
        return nothing
    residual = medians - places @ plane
    spread = (residual**2).sum(axis=0) / max(1, len(medians) - 3) / len(medians)
    return plane[1:], np.abs(residual).max(axis=0), (spread, blocks**2)
