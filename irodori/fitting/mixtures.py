"""Texels at a seam between paints, which may show a mixture of both, and what their paints tell of their gloss.

A picture blurs a seam over a few texels. The colour of such a texel lies between those of its neighbours' paints. It
may be the colour of none, or by chance that of a third paint. It does not tell the gloss, which may be that of either
of the two or anything between.
"""

from collections.abc import Sequence
from dataclasses import fields
from typing import NamedTuple

import numpy as np

from irodori.fitting.diffuse_response import GREEN
from irodori.fitting.gloss_search import PairGloss
from irodori.fitting.paint_colours import NEAR, Colours
from irodori.fitting.paint_gloss import LEAST_VARYING, PaintGloss

SEAM = 5  # width of a seam in texels, within which a picture shows a mixture
#: Smallest share of a paint for which one taken at random in the mixture lies within two standard deviations of the
#: mean, √((1 - s) / s) = 2. A texel with surely less of a second paint shows the first one.
LEAST_SHARE = 0.2
_SURE = 2.0  # standard deviations


class Mixtures(NamedTuple):
    """Texels that may show a mixture of two paints.

    Parameters
    ----------
    texel : (n,) int
        Their indices.
    one, other : (n,) int
        Numbers of the paints.
    share : (n,) float64
        Share of the ``other`` paint, 0 to 1.
    apart : (n,) float64
        Diffuse response in green of the ``other`` paint less that of the first.
    """

    texel: np.ndarray
    one: np.ndarray
    other: np.ndarray
    share: np.ndarray
    apart: np.ndarray

    @property
    def variance(self) -> np.ndarray:
        """Variance of what a point in the texel has of the ``other`` paint, 0 or 1, (n,).

        It is so large that two standard deviations from the mean contain either paint.
        """
        least = (np.maximum(self.share, 1.0 - self.share) / _SURE) ** 2
        return np.maximum(self.share * (1.0 - self.share), least)

    @property
    def alpha_error(self) -> np.ndarray:
        """Standard error of α as that of a point in the texel, which has the α of either paint, (n,)."""
        return np.sqrt(self.variance) * np.abs(self.apart)


def seams(paint: np.ndarray) -> np.ndarray:
    """Return the texels near a border between two paints, (height, width) bool; ``paint`` is -1 where unknown."""
    from scipy import ndimage  # slow to import

    size = {"size": SEAM, "mode": "nearest"}
    lowest = ndimage.minimum_filter(np.where(paint < 0, np.iinfo(paint.dtype).max, paint), **size)
    return ndimage.maximum_filter(paint, **size) > lowest


def _supported(paint: np.ndarray) -> np.ndarray:
    """Return the paint of texels that lie in, or beside, three by three texels of this paint, -1 elsewhere.

    A narrower strip of a paint may be a mixture of its neighbours that happens to have its colour.
    """
    from scipy import ndimage  # slow to import

    none, size = np.iinfo(paint.dtype).max, {"size": 3, "mode": "nearest"}
    lowest, highest = ndimage.minimum_filter(paint, **size), ndimage.maximum_filter(paint, **size)
    alike = (lowest == highest) & (paint >= 0)
    lowest = ndimage.minimum_filter(np.where(alike, paint, none), **size)
    highest = ndimage.maximum_filter(np.where(alike, paint, -1), **size)
    return np.where((paint >= 0) & ((paint == lowest) | (paint == highest)), paint, -1)


def _around(paint: np.ndarray, texel: np.ndarray) -> np.ndarray:
    """Return the paints within a seam's width of texels, (texels, SEAM²); ``paint`` is (height, width)."""
    reach = SEAM // 2
    wide = np.pad(paint, reach, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(wide, (SEAM, SEAM))
    return windows[np.unravel_index(texel, paint.shape)].reshape(len(texel), SEAM * SEAM)


def find_mixtures(
    texel: np.ndarray, found: np.ndarray, filled: np.ndarray, response, variance, colours: Colours
) -> tuple[np.ndarray, Mixtures]:
    """Find the texels that may show a mixture of two paints near them.

    A texel does if, within two standard errors, its colour allows `LEAST_SHARE` of either. Of more than two paints,
    those are taken between whose colours it lies best. If its own paint is only in a narrow strip, it shows this paint
    unless its colour lies between those of two others.

    Parameters
    ----------
    texel : (n,) int
        Indices of the texels at seams of ``filled``.
    found : (height, width) int
        Paints by colour, -1 for none.
    filled : (height, width) int
        The same, with the nearest paint at texels near one.
    response, variance : (n, bands) float
        Diffuse responses of the texels at seams, and their variances.

    Returns
    -------
    paint : (height, width) int
        Paints without the mixtures; a texel that had none has the one of which it surely shows most.
    mixtures : Mixtures
    """
    found = found.astype(np.int16)  # faster, and there are never as many paints
    kept = (filled.ravel()[texel] >= 0) & np.isfinite(response).all(axis=1)
    texel, response, variance = texel[kept], response[kept], variance[kept]
    own, solid = found.ravel()[texel], _supported(found)
    loose, thin, near = own < 0, (own >= 0) & (solid.ravel()[texel] < 0), _around(solid, texel)
    near[loose] = _around(found, texel[loose])  # it may be a mixture of a narrow strip, too
    first = np.where(thin & (near >= 0).any(axis=1), near.max(axis=1), filled.ravel()[texel]).astype(np.int16)
    second, share, mixed = np.full(len(texel), -1), np.zeros(len(texel)), np.zeros(len(texel), dtype=bool)
    best, left = np.full(len(texel), np.inf), np.where(near == first[:, None], -1, near)
    while (left >= 0).any():
        other = left.max(axis=1)
        here = np.flatnonzero(other >= 0)
        part, error, apart = colours.between(response[here], variance[here], first[here], other[here])
        possible = (part + _SURE * error >= LEAST_SHARE) & (part - _SURE * error <= 1.0 - LEAST_SHARE)
        better = (possible & ~mixed[here]) | ((possible == mixed[here]) & (apart < best[here]))
        better &= ~thin[here] | (possible & (apart <= 2.0 * NEAR))
        chosen = here[better]
        best[chosen], second[chosen], share[chosen] = apart[better], other[chosen], part[better]
        mixed[chosen] = possible[better]
        left = np.where(left == other[:, None], -1, left)
    paint = filled.copy()
    paint.flat[texel[mixed]] = -1
    sure = loose & ~mixed & (share > 0.5)
    paint.flat[texel[sure]] = second[sure]
    one, other = (colours.nearest_of(response[mixed], number[mixed])[:, GREEN] for number in (first, second))
    return paint, Mixtures(texel[mixed], first[mixed], second[mixed], share[mixed], other - one)


def gloss_between(gloss: Sequence[PaintGloss | PairGloss | None], mixtures: Mixtures) -> PaintGloss | PairGloss:
    """Return the gloss of mixtures, with a first axis of texels in every field.

    It is the mean of both paints'. Its variance is that of the gloss of a point in the texel, see `Mixtures`. A mixture
    shows two lobes, with shares that differ between photographs. One lobe fitted to its own observations is therefore
    worse than the mean, which they do not change.

    Parameters
    ----------
    gloss : sequence
        Gloss of each paint of the object; known for those of the mixtures.
    """
    known = [one for one in gloss if one is not None]
    place = np.cumsum([one is not None for one in gloss]) - 1
    one, other, share = place[mixtures.one], place[mixtures.other], mixtures.share

    def mean(name: str) -> np.ndarray:
        each = np.stack([np.asarray(getattr(paint, name), dtype=np.float64) for paint in known])
        part = share.reshape(-1, *[1] * (each.ndim - 1))
        return (1.0 - part) * each[one] + part * each[other]

    values: dict = {field.name: mean(field.name) for field in fields(known[0])}
    log_gloss = np.stack([paint.log_gloss for paint in known])
    apart = log_gloss[other] - log_gloss[one]
    spread = np.einsum("t,ti,tj->tij", mixtures.variance, apart, apart)
    values["error"] = values["error"] + values["varying"] + spread
    values["varying"] = np.broadcast_to(LEAST_VARYING * np.eye(apart.shape[1]), spread.shape)
    return type(known[0])(**values)
