"""Level of an object's photographs through the comb filter beside those without it, told by its colours.

White reference and chart fix how bright a surface of each colour is in both states of the filter. Photographs of an
object through the filter with another aperture, lamp or exposure time than their files say give spectra that no surface
has, and six responses alone do not contradict it. Responses through the filter are predicted from those without it by
the linear map of the chart; what all paints of an object have more or less than predicted is a level.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from irodori.config.capture_table import FILTERS

#: Relative difference that is said, at least, and the number of standard errors beyond which it is.
_TOLERATED, _ERRORS = 0.1, 4.0
_DARKEST = 0.01  # mean response of a paint that tells something
_COLOURS = 3  # bands in each state of the filter


class FilterLevel(NamedTuple):
    """Ratio of responses through the filter to those expected, its relative standard error, and number of paints."""

    ratio: float
    error: float
    paints: int

    @property
    def is_other(self) -> bool:
        """Whether the photographs through the filter had another level."""
        return self.paints > 0 and abs(np.log(self.ratio)) > max(_TOLERATED, _ERRORS * self.error)


def filter_level(chart: np.ndarray, paints: np.ndarray) -> FilterLevel:
    """Compare the responses of an object's paints in both states of the filter with those of a chart.

    Parameters
    ----------
    chart : (patches, 6) float
        Responses of the chart, without the filter first.
    paints : (n, 6) float
        Mean diffuse response of each paint.

    Returns
    -------
    FilterLevel
        Its error is the scatter of the chart's patches, each predicted from the others, over the root of the paints.
    """
    paints = paints[np.isfinite(paints).all(axis=1)]
    paints = paints[(paints.mean(axis=1) > _DARKEST) & (paints > 0.0).all(axis=1)]
    # Relative errors count, not those of the brightest patches.
    relative = chart / chart[:, :_COLOURS].sum(axis=1, keepdims=True)
    out, through = relative[:, :_COLOURS], relative[:, _COLOURS:]
    inverse = np.linalg.pinv(out)
    leverage = np.einsum("pc,cp->p", out, inverse)
    # The prediction of a patch from all others.
    left_out = through - (through - out @ (inverse @ through)) / (1.0 - leverage)[:, None]
    error = float(np.std(_log_ratio(through, left_out)))
    if not len(paints):
        return FilterLevel(1.0, error, 0)
    level = float(np.median(_log_ratio(paints[:, _COLOURS:], paints[:, :_COLOURS] @ (inverse @ through))))
    return FilterLevel(float(np.exp(level)), error / len(paints) ** 0.5, len(paints))


def _log_ratio(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Return the logarithm of the ratio of two responses summed over the colours, (n,)."""
    return np.log(np.maximum(found.sum(axis=1), 1e-12) / np.maximum(expected.sum(axis=1), 1e-12))


def level_of_object(
    filters: tuple[str, ...], chart: np.ndarray | None, tiles: Iterable[tuple[slice, dict[str, np.ndarray]]]
) -> FilterLevel | None:
    """Return the `filter_level` of an object's fitted tiles; None if it was not photographed in both states.

    Parameters
    ----------
    filters : tuple of str
        States of the filter, in the order of the bands.
    chart : (patches, bands) float, optional
    tiles : iterable of (rows, maps)
        With the maps ``diffuse_response`` and ``paint``; texels of no paint count as one paint together.
    """
    if filters != FILTERS or chart is None or chart.shape[1] != 2 * _COLOURS:
        return None
    sums: dict[int, np.ndarray] = {}
    for _, maps in tiles:
        response, paint = maps["diffuse_response"], maps["paint"]
        known = np.isfinite(response).all(axis=-1)
        for number in np.unique(paint[known]):
            own = response[known & (paint == number)].astype(np.float64)
            sums[int(number)] = sums.get(int(number), 0.0) + np.append(own.sum(axis=0), len(own))
    found = np.array([total[:-1] / total[-1] for total in sums.values()]).reshape(-1, chart.shape[1])
    return filter_level(chart, found)
