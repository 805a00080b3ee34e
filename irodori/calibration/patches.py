"""Statistics of a chart's patches that are robust against dirt, hot pixels and uneven light."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from irodori.core.errors import InputError

_NORMAL = NormalDist()
TRIM = 0.1  # share of a patch's pixels left out at each end
#: Variance of the middle 80 % of a normal distribution, relative to the whole: 1 - 2 z φ(z) / 0.8, z = 1.2816.
_KEPT_VARIANCE = 1.0 - 2.0 * _NORMAL.inv_cdf(1 - TRIM) * _NORMAL.pdf(_NORMAL.inv_cdf(1 - TRIM)) / (1.0 - 2.0 * TRIM)
#: Variance of the trimmed mean of n normal values, times n: the winsorised variance over (1 - 2 trim)².
_MEAN_VARIANCE = (_KEPT_VARIANCE * (1 - 2 * TRIM) + 2 * TRIM * _NORMAL.inv_cdf(1 - TRIM) ** 2) / (1 - 2 * TRIM) ** 2
_BLOCKS = 4  # per side: blocks from which slope and unevenness are computed
_BLOCK_TRIM = 0.25  # share of a block's pixels left out at each end: medians of whole numbers are too coarse
_BLOCK_VARIANCE = 1.2  # variance of that trimmed mean of n normal values, times n
_MIN_BLOCK_PX = 2
_DARK = 0.02  # of the chart's largest mean: smallest scale for differences in dark patches
_MAX_GRADIENT = 0.15
_MAX_UNEVENNESS = 0.03
_QUARTILES = 2.0 * _NORMAL.inv_cdf(0.75)  # distance of the quartiles, standard deviations
_ERRORS = 4.0  # standard errors that noise may explain
_LEAST_VALID = 0.5  # share of a patch


@dataclass(frozen=True)
class ChartReading:
    """Statistics of the camera's responses on a chart's patches, row by row.

    Parameters
    ----------
    centres_px : (patches, 2) float64
        x then y, superpixels.
    side_px : float
        Side of the squares that were averaged, superpixels.
    mean : (patches, bands) float64
        Trimmed mean response.
    pixel_variance : (patches, bands) float64
        Variance of one pixel about the plane fitted to the patch, estimated from the middle 80 % of the pixels for a
        normal distribution.
    mean_variance : (patches, bands) float64
        Variance of `mean`: that of independent pixels, or that of 4 x 4 blocks about the fitted plane, whichever is
        larger, so that dirt, texture and interpolated pixels are included.
    count : (patches,) int
        Valid pixels.
    invalid_share : (patches,) float64
        Share of the pixels that are clipped or hot.
    gradient : (patches,) float64
        Change of the response across the patch, less four standard errors, relative to the mean response (to 2 % of
        the brightest patch if that is larger); the largest of the bands. NaN if the patch is too small for blocks of
        2 x 2 pixels.
    unevenness : (patches,) float64
        Largest deviation of a block from the fitted plane, less four standard errors, on the same scale; NaN likewise.
    log_slope : (patches, 2, bands) float64
        Slope of the response along x and y, divided by the mean, per superpixel; NaN likewise, or if the mean is not
        positive.
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
    log_slope: np.ndarray

    @property
    def uneven(self) -> np.ndarray:
        """Mask of patches with dirt, an edge, a shadow or a gradient of the light over 15 %, (patches,) bool."""
        return (self.gradient > _MAX_GRADIENT) | (self.unevenness > _MAX_UNEVENNESS)

    def divided(self, field: np.ndarray) -> "ChartReading":
        """Return the reading under even light; `field`, (patches, bands), is the light relative to even light."""
        return replace(
            self,
            mean=self.mean / field,
            pixel_variance=self.pixel_variance / field**2,
            mean_variance=self.mean_variance / field**2,
        )


def read_squares(response, valid, centres, side: float, file) -> dict:
    """Return the statistics of square areas as keyword arguments of `ChartReading`, with slopes per sample.

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
    rows = [_statistics(*square) for square in _squares(response, valid, centres, side, file)]
    columns = [np.stack(column) for column in zip(*rows, strict=True)]
    names = ("mean", "pixel_variance", "mean_variance", "count", "invalid_share", "change", "deviation", "log_slope")
    read = dict(zip(names, columns, strict=True))
    scale = np.maximum(read["mean"], _DARK * read["mean"].max(axis=0))
    scale = np.where(scale > 0, scale, np.inf)
    read["gradient"] = (read.pop("change") / scale).max(axis=1)
    read["unevenness"] = (read.pop("deviation") / scale).max(axis=1)
    return read


def read_means(response, valid, centres, side: float, file) -> np.ndarray:
    """Return the trimmed mean responses of squares, (patches, bands); see `read_squares`."""
    squares = _squares(response, valid, centres, side, file)
    return np.stack([_trimmed_mean(square[good]) for square, good in squares])


def _squares(response, valid, centres, side: float, file) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the samples of each square and the mask of valid ones; raises as `read_squares`."""
    height, width = valid.shape
    side = max(1, round(side))
    for number, (x, y) in enumerate(centres):
        x0, y0 = round(x - side / 2.0), round(y - side / 2.0)
        x1, y1 = x0 + side, y0 + side
        if x0 < 0 or y0 < 0 or x1 > width or y1 > height:
            found = f"patch {number} at ({x:.0f}, {y:.0f})"
            raise InputError(file, "chart.centres_px", found, f"patches inside {width} x {height} samples")
        good = valid[y0:y1, x0:x1].astype(bool)
        if good.mean() < _LEAST_VALID:
            found = f"patch {number} saturated over {1 - good.mean():.0%}"
            raise InputError(file, "exposure_s", found, "a chart exposed below saturation")
        yield response[y0:y1, x0:x1], good


def _trimmed_mean(values: np.ndarray) -> np.ndarray:
    """Return the mean over the first axis without the lowest and highest tenth, float64."""
    cut = int(TRIM * len(values))
    return np.sort(values, axis=0)[cut : len(values) - cut].mean(axis=0, dtype=np.float64)


def _statistics(square: np.ndarray, good: np.ndarray) -> tuple:
    """Return a patch's mean, variances, count, invalid share, change along its plane, deviation from it, log slope."""
    values = square[good]
    mean = _trimmed_mean(values)
    slope, deviation, mean_variance, blocks = _slope(square, good)
    y, x = np.nonzero(good)
    centred = np.stack([x - (good.shape[1] - 1) / 2.0, y - (good.shape[0] - 1) / 2.0], axis=1)
    residual = np.sort(values - centred @ np.nan_to_num(slope), axis=0)
    cut = int(TRIM * len(residual))
    kept = residual[cut : len(residual) - cut]
    pixel = kept.var(axis=0) / (_KEPT_VARIANCE if cut else 1.0)
    # Noise is estimated from the middle half of the pixels: dirt on a sixth of the patch must not be taken for noise.
    quiet = (residual[(3 * len(residual)) // 4] - residual[len(residual) // 4]) / _QUARTILES
    error = np.sqrt(_BLOCK_VARIANCE * blocks / len(values)) * quiet
    beyond = np.maximum(deviation - _ERRORS * error, 0.0)
    mean_variance = np.maximum(mean_variance, _MEAN_VARIANCE * pixel / len(values))
    change = np.hypot(slope[0] * good.shape[1], slope[1] * good.shape[0])
    # The slope of n even-spaced values has the variance 12 / n of a value's, a side long.
    change = np.maximum(change - _ERRORS * np.sqrt(12.0 / len(values)) * quiet, 0.0)
    log_slope = slope / np.where(mean > 0, mean, np.nan)
    return mean, pixel, mean_variance, len(values), 1.0 - good.mean(), change, beyond, log_slope


def _slope(square: np.ndarray, good: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Return a patch's slope per sample (2, bands), and statistics of its blocks about the fitted plane.

    These are the largest deviation of a block (bands,), the variance of the patch's mean (bands,), and their number.
    """
    bands = square.shape[-1]
    side = min(_BLOCKS, min(good.shape) // _MIN_BLOCK_PX)
    nothing = np.full((2, bands), np.nan), np.full(bands, np.nan), np.zeros(bands), 1
    levels, places = [], []
    for ys in np.array_split(np.arange(good.shape[0]), max(1, side)):
        for xs in np.array_split(np.arange(good.shape[1]), max(1, side)):
            block = np.s_[ys[0] : ys[-1] + 1, xs[0] : xs[-1] + 1]
            if good[block].mean() >= _LEAST_VALID:
                ordered = np.sort(square[block][good[block]], axis=0)
                cut = int(_BLOCK_TRIM * len(ordered))
                levels.append(ordered[cut : len(ordered) - cut].mean(axis=0))
                places.append([1.0, xs.mean() - (good.shape[1] - 1) / 2.0, ys.mean() - (good.shape[0] - 1) / 2.0])
    if len(levels) < 4:
        return nothing
    place, level = np.array(places), np.array(levels)
    plane, _, rank, _ = np.linalg.lstsq(place, level)
    if rank < 3:
        return nothing
    residual = level - place @ plane
    variance = (residual**2).sum(axis=0) / (len(levels) - 3) / len(levels)
    return plane[1:], np.abs(residual).max(axis=0), variance, side**2
