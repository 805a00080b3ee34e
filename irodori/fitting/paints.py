"""Paints of an object: found from all its tiles, and shared with the texels of each.

Objects vary faster in colour than in gloss, and what is painted with one paint has one gloss. The paints are found
from the colours (`irodori.fitting.paint_colours`), each one's gloss from its texels together
(`irodori.fitting.paint_gloss`). A texel has the paint that explains its responses: the one under whose gloss its
diffuse responses have the paint's colour. So one observation is enough for a colour.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from irodori.fitting import gloss_sums
from irodori.fitting.band_fresnel import BandGloss
from irodori.fitting.gloss_sums import SearchedTexels
from irodori.fitting.paint_colours import NEAR, Colours
from irodori.fitting.paint_gloss import PaintGloss, TexelGloss, gloss_of_paint, share
from irodori.fitting.solvers import FitOptions, problem_of
from irodori.fitting.stage import GREEN, Observed, without_gloss
from irodori.material.material_file import Status

MOST_TEXELS = 600  # of one paint, from which its gloss comes
_LEAST_OF_TILE = 100  # texels of one paint that a tile gives at least, where it has them
_SEAM = 5  # texels across a seam, where a picture shows a mixture
_WORTH = 0.3  # relative standard error of α beyond which a colour is not stated,
_DARK = 0.01  # where its standard error is more than this
#: Statuses with a colour: what denies a model of gloss, such as two lobes that are fitted as one, has one as well.
BELIEVED = (Status.OK, Status.DIFFUSE_ONLY, Status.CONTRADICTED)


@dataclass(frozen=True)
class Paints:
    """The paints of an object.

    Parameters
    ----------
    colours : Colours
    gloss : list of PaintGloss or None
        Of each paint; None where it shows none or leaves it open.
    """

    colours: Colours
    gloss: list[PaintGloss | None]

    @property
    def known(self) -> list[int]:
        """Numbers of the paints whose gloss is known."""
        return [paint for paint, gloss in enumerate(self.gloss) if gloss is not None]


@dataclass(frozen=True)
class GlossModel:
    """Model by which an object's gloss is fitted: the options of its fit and its refractive index."""

    options: FitOptions
    fresnel: BandGloss


@dataclass(frozen=True)
class Tile:
    """Texels of a tile and the results of their own fit.

    Parameters
    ----------
    observed : Observed
    index : (texels,) float64
        Real refractive index.
    status : (texels,) int8
    response, variance : (texels, bands) float64
        Diffuse response by their own fit, and what the camera's noise gives it.
    """

    observed: Observed
    index: np.ndarray
    status: np.ndarray
    response: np.ndarray
    variance: np.ndarray

    def __getitem__(self, chosen) -> "Tile":
        """Return the texels chosen."""
        index, status, response = self.index[chosen], self.status[chosen], self.response[chosen]
        return Tile(self.observed[chosen], index, status, response, self.variance[chosen])

    def surface(self, optics: GlossModel) -> SearchedTexels:
        """Return the green observations, packed."""
        seen, k = self.observed, optics.fresnel.k
        problem = problem_of(
            seen.response[..., GREEN], seen.geometry, seen.weight, self.index, k, optics.options,
            noise=seen.noise[:, GREEN],
        )  # fmt: skip
        return gloss_sums.pack(*problem)

    def under(self, log_gloss: np.ndarray, optics: GlossModel) -> tuple[np.ndarray, np.ndarray]:
        """Return diffuse responses and their variance supposing a gloss, log β and log μ."""
        gloss = np.tile(np.exp(log_gloss), (len(self.status), 1))
        options = optics.options
        return without_gloss(
            self.observed, gloss, self.index, options.lobes, optics.fresnel, model_error=options.model_error
        )


def believed(tile: Tile) -> np.ndarray:
    """Return the texels whose own fit tells their colour, (texels,) bool."""
    return np.isin(tile.status, BELIEVED)


def seams(paint: np.ndarray) -> np.ndarray:
    """Return where two paints are near each other, (height, width) bool; ``paint`` is -1 where not known."""
    from scipy import ndimage  # slow to import

    size = {"size": _SEAM, "mode": "nearest"}
    lowest = ndimage.minimum_filter(np.where(paint < 0, np.iinfo(paint.dtype).max, paint), **size)
    return ndimage.maximum_filter(paint, **size) > lowest


def sample(tile: Tile, colours: Colours, width: int, tiles: int) -> Tile:
    """Return texels away from seams by which the gloss of the paints is told: so many of each paint, and of none.

    Parameters
    ----------
    tile : Tile
        Texels in rows of ``width``.
    tiles : int
        How many the object has.
    """
    paint = by_colour(tile, colours)
    free = ~seams(paint.reshape(-1, width)).ravel() & (tile.observed.weight > 0.0).any(axis=1)
    most, chosen = max(_LEAST_OF_TILE, MOST_TEXELS // tiles), []
    for number in range(-1, colours.count):
        here = np.flatnonzero(free & (paint == number))
        chosen.append(here[:: max(1, -(-len(here) // most))])
    return tile[np.sort(np.concatenate(chosen))]


def by_colour(tile: Tile, colours: Colours) -> np.ndarray:
    """Return the paint of each texel by the colour that its own fit gives, (texels,) int; -1 where none is near."""
    paint, apart = colours.nearest(tile.response, tile.variance)
    return np.where(apart <= 2.0 * NEAR, paint, -1)


def assign(tile: Tile, paint: np.ndarray, paints: Paints, optics: GlossModel, mixed: np.ndarray | bool = False):
    """Return the paint of each texel, (texels,) int, -1 where no paint explains it.

    Texels that their own fit tells the colour of, and that have that of a paint of known gloss, have that paint. The
    others have the paint under whose gloss their responses have its colour best.

    Parameters
    ----------
    paint : (texels,) int
        See `by_colour`.
    mixed : (texels,) bool
        Which texels lie at a seam, and have a mixture where their own fit tells them well.
    """
    paint, own = paint.copy(), believed(tile)
    done = own & (np.isin(paint, paints.known) | mixed)
    open_ = np.flatnonzero(~done & (tile.observed.weight > 0.0).any(axis=1))
    rest = tile[open_]
    best = np.full(len(open_), 2.0 * NEAR)
    for number in paints.known:
        gloss = paints.gloss[number]
        assert gloss is not None
        nearest, apart = paints.colours.nearest(*rest.under(gloss.log_gloss, optics))
        better = (nearest == number) & (apart <= best)
        paint[open_[better]], best[better] = number, apart[better]
    return paint


def find_paints(samples: list[Tile], colours: Colours, optics: GlossModel) -> Paints:
    """Return the paints of an object with their gloss.

    A wide lobe that a texel's own fit has not seen is in its colour. Gloss is therefore searched twice: in texels of
    one colour, then in those that a paint explains with the gloss found.

    Parameters
    ----------
    samples : list of Tile
        See `sample`.
    """
    first = [by_colour(tile, colours) for tile in samples]
    paints = _with_gloss(samples, first, Paints(colours, []), range(colours.count), optics)
    labels = [assign(tile, paint, paints, optics) for tile, paint in zip(samples, first, strict=True)]
    changed = [np.concatenate([old[old != new], new[old != new]]) for old, new in zip(first, labels, strict=True)]
    return _with_gloss(samples, labels, paints, sorted({*np.concatenate(changed).tolist()} - {-1}), optics)


def _with_gloss(
    samples: list[Tile], labels: list[np.ndarray], paints: Paints, numbers: Iterable[int], optics: GlossModel
) -> Paints:
    """Return the paints with the gloss of those numbers from the texels with their labels."""
    nodes = replace(optics.options, scan_per_octave=2).nodes()
    gloss = dict(enumerate(paints.gloss))
    for number in numbers:
        total = sum(int((label == number).sum()) for label in labels)
        step = max(1, -(-total // MOST_TEXELS))
        parts = [tile[np.flatnonzero(label == number)[::step]] for tile, label in zip(samples, labels, strict=True)]
        surfaces = [part.surface(optics) for part in parts if len(part.status)]
        blocks = np.concatenate([surface.blocks for surface in surfaces]) if surfaces else None
        gloss[number] = None if blocks is None else gloss_of_paint(surfaces[0]._replace(blocks=blocks), nodes)
    return Paints(paints.colours, [gloss[number] for number in range(paints.colours.count)])


@dataclass(frozen=True)
class Painted:
    """Parameters that a tile's texels take over from their paints.

    Parameters
    ----------
    paint : (texels,) int
        Number of the paint that a texel shares the gloss of, -1 where it has none.
    texel : (shared,) int
        The texels that have one.
    shared : TexelGloss
        Their parameters.
    """

    paint: np.ndarray
    texel: np.ndarray
    shared: TexelGloss


def share_by_paint(tile: Tile, paints: Paints, width: int, optics: GlossModel) -> Painted:
    """Return the parameters of a tile's texels in the light of the paints.

    Parameters
    ----------
    tile : Tile
        Texels in rows of ``width``.
    """
    from scipy import ndimage  # slow to import

    paint = by_colour(tile, paints.colours)
    mixed = seams(paint.reshape(-1, width)).ravel()
    found = assign(tile, paint, paints, optics, mixed).reshape(-1, width)
    if (found >= 0).any():
        # At a seam a texel has a mixture of colours, and the gloss of the paint beside it.
        far, place = ndimage.distance_transform_edt(found < 0, return_indices=True)
        mixed |= (found < 0).ravel()
        found = np.where(far <= 0.5 * _SEAM, found[tuple(place)], -1)
    paint, columns, texels = np.full(found.size, -1), [], []
    for number in paints.known:
        gloss, here = paints.gloss[number], np.flatnonzero(found.ravel() == number)
        assert gloss is not None
        one = share(tile[here].surface(optics), gloss)
        # What a mixture leaves unexplained is no gloss of its own.
        good = (one.agrees | mixed[here]) & (one.alpha_error <= np.maximum(_WORTH * one.alpha, _DARK))
        paint[here[good]] = number
        texels.append(here[good])
        columns.append(one[good])
    shared = TexelGloss.joined(columns)
    return Painted(paint, np.concatenate([*texels, np.empty(0, dtype=int)]), shared)
