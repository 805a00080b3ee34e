"""Paints of an object: found from samples of all its tiles, then assigned to the texels of each tile.

Objects vary more in colour than in gloss, and areas of the same paint have the same gloss. The paints are found from
the colours (`irodori.fitting.paint_colours`), and the gloss of each is fitted to its texels together
(`irodori.fitting.paint_gloss`). A texel is assigned the paint that explains its responses: with the gloss of this paint
subtracted, its diffuse responses have the colour of the paint. Therefore a single observation suffices to find the
colour of a texel.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from irodori.fitting import gloss_sums
from irodori.fitting.band_fresnel import BandGloss
from irodori.fitting.diffuse_response import GREEN, Observed, without_gloss
from irodori.fitting.gloss_search import GlossSearch, PairGloss, share_pair
from irodori.fitting.gloss_sums import SearchedTexels
from irodori.fitting.joint_gloss import Contradiction, gloss_of_paints
from irodori.fitting.mixtures import SEAM, Mixtures, find_mixtures, gloss_between, seams
from irodori.fitting.paint_colours import NEAR, Colours
from irodori.fitting.paint_gloss import PaintGloss, TexelGloss, share
from irodori.fitting.solvers import FitOptions, problem_of
from irodori.fitting.texel_sample import Readings
from irodori.jit.chunks import Result, parallel_map
from irodori.material.material_file import Status

_PIECE = 16384  # texels that a thread takes at a time
MOST_TEXELS = 600  # largest number of texels from which the gloss of a paint is fitted
_LEAST_OF_TILE = 100  # texels of one paint that are taken from a tile, if it has as many
_LOOKED_AT = 400_000  # texels of an object, in whole rows, from which they are taken: all others need not be read
_WORTH = 0.3  # a colour is not stated if the relative standard error of α exceeds this
_DARK = 0.01  # and its standard error exceeds this
#: Statuses with a reliable colour. A contradicted fit, such as of two lobes as one, has a wrong gloss but a usable
#: colour.
BELIEVED = (Status.OK, Status.DIFFUSE_ONLY, Status.CONTRADICTED)


@dataclass(frozen=True)
class Paints:
    """The paints of an object.

    Parameters
    ----------
    colours : Colours
    gloss : list of PaintGloss or PairGloss or None
        Gloss of each paint; None if it shows none or does not determine it. A `PairGloss` under two lobes.
    contradiction : Contradiction or None
        Photographs that contradict the gloss of the paints.
    """

    colours: Colours
    gloss: Sequence[PaintGloss | PairGloss | None]
    contradiction: Contradiction | None

    @property
    def known(self) -> list[int]:
        """Numbers of the paints with a known gloss."""
        return [paint for paint, gloss in enumerate(self.gloss) if gloss is not None]


@dataclass(frozen=True)
class GlossModel:
    """Options and refractive index with which the gloss of an object is fitted."""

    options: FitOptions
    fresnel: BandGloss


@dataclass(frozen=True)
class Tile:
    """Texels of a tile, with the results of their separate fits.

    Parameters
    ----------
    observed : Observed
    status : (texels,) int8
    response, variance : (texels, bands) float64
        Diffuse responses from the separate fits, and their variance by the camera's noise.
    """

    observed: Observed
    status: np.ndarray
    response: np.ndarray
    variance: np.ndarray

    def __getitem__(self, chosen) -> "Tile":
        """Return a tile with selected texels; ``chosen`` is any NumPy index."""
        return Tile(self.observed[chosen], self.status[chosen], self.response[chosen], self.variance[chosen])

    def surface(self, optics: GlossModel, chosen=slice(None), *, sides: bool = True) -> SearchedTexels:
        """Pack the observations of the green band for a fit of gloss; ``chosen`` is any NumPy index.

        ``sides`` as in `irodori.fitting.gloss_sums.pack`.
        """
        seen = self.observed
        problem = problem_of(
            seen.response[chosen, :, GREEN], seen.geometry[chosen], seen.weight[chosen], optics.fresnel.n,
            optics.fresnel.k, optics.options, noise=seen.noise[:, GREEN],
        )  # fmt: skip
        return gloss_sums.pack(*problem, sides=sides)

    def readings(self, optics: GlossModel, chosen=slice(None)) -> Readings:
        """Return the observations of the green band; ``chosen`` is any NumPy index."""
        fresnel, coupled = optics.fresnel, optics.options.is_coupled
        return Readings.of_band(self.observed[chosen], GREEN, fresnel.n, fresnel.k, coupled)

    def under(self, log_gloss: np.ndarray, optics: GlossModel) -> tuple[np.ndarray, np.ndarray]:
        """Return diffuse responses and their variances, (texels, bands) each, assuming a gloss.

        ``log_gloss`` is log β and log μ of each component.
        """
        gloss = np.tile(np.exp(log_gloss), (len(self.status), 1))
        options = optics.options
        return without_gloss(
            self.observed,
            gloss,
            options.lobes,
            optics.fresnel,
            model_error=options.model_error,
            coupled=options.is_coupled,
        )


def in_pieces(work: Callable[[np.ndarray], Result], texels: np.ndarray) -> list[Result]:
    """Return what a function makes of each piece of some texels' indices, on the threads of numba.

    A piece is small, because packed observations take four times the space of a tile's.
    """
    return list(parallel_map(work, [texels[first : first + _PIECE] for first in range(0, max(len(texels), 1), _PIECE)]))


def believed(tile: Tile) -> np.ndarray:
    """Return the texels with a reliable colour from their separate fits, (texels,) bool."""
    return np.isin(tile.status, BELIEVED)


def looked_at(texels: int, width: int, tiles: int) -> np.ndarray:
    """Return the texels from which the sample of a tile is drawn, (n,) int, sorted: whole rows at equal distances.

    ``tiles`` is the number of such tiles of the object; of a small object, all texels are looked at. Every tile has at
    least one such row.
    """
    step, rows_of_tile = max(1, texels * tiles // _LOOKED_AT), texels // width
    rows = np.arange(min(step, rows_of_tile) // 2, rows_of_tile, step)
    return (rows[:, None] * width + np.arange(width)).ravel()


def sample_of(paint: np.ndarray, seen: np.ndarray, colours: Colours, width: int, tiles: int) -> np.ndarray:
    """Draw a sample of texels away from seams for the fit of gloss, of limited size for each paint and for no paint.

    Parameters
    ----------
    paint : (texels,) int
        Paints from `by_colour`, of texels in rows of ``width``.
    seen : (texels,) bool
        Whether a texel is among `looked_at` and has an observation.
    tiles : int
        Number of tiles of the object.

    Returns
    -------
    (sampled,) int
        Indices of the texels, sorted.
    """
    free = ~seams(paint.reshape(-1, width)).ravel() & seen
    most, chosen = max(_LEAST_OF_TILE, MOST_TEXELS // tiles), []
    for number in range(-1, colours.count):
        here = np.flatnonzero(free & (paint == number))
        chosen.append(here[:: max(1, -(-len(here) // most))])
    return np.sort(np.concatenate(chosen))


def by_colour(response: np.ndarray, variance: np.ndarray, colours: Colours) -> np.ndarray:
    """Return the paint nearest in colour to each texel's diffuse response, (texels,) int; -1 if none is near."""
    paint, apart = colours.nearest(response, variance)
    return np.where(apart <= 2.0 * NEAR, paint, -1)


def assign(tile: Tile, paint: np.ndarray, paints: Paints, optics: GlossModel, mixed: np.ndarray | bool = False):
    """Assign a paint to each texel, (texels,) int; -1 if no paint explains it.

    A texel with a reliable colour near that of a paint with known gloss gets this paint. Each other texel gets the
    paint for which its diffuse responses, after subtraction of the paint's gloss, are nearest to the paint's colour.

    Parameters
    ----------
    paint : (texels,) int
        Paints from `by_colour`.
    mixed : (texels,) bool
        Texels at a seam: those with a reliable colour show a mixture and keep their paint from `by_colour`.
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
    """Fit the gloss of the paints of an object.

    Where the separate fit of a texel has missed a wide lobe, the lobe has changed the texel's colour. Gloss is
    therefore fitted twice: to texels with the colour of a paint, then to those that `assign` gives to a paint with the
    gloss found first.

    Parameters
    ----------
    samples : list of Tile
        Texels from `sample_of`, for each tile.
    """
    first = [by_colour(tile.response, tile.variance, colours) for tile in samples]
    paints = _with_gloss(samples, first, colours, optics)
    labels = [assign(tile, paint, paints, optics) for tile, paint in zip(samples, first, strict=True)]
    if all(np.array_equal(old, new) for old, new in zip(first, labels, strict=True)):
        return paints
    return _with_gloss(samples, labels, colours, optics)


def _with_gloss(samples: list[Tile], labels: list[np.ndarray], colours: Colours, optics: GlossModel) -> Paints:
    """Return the paints with the gloss of the texels that are labelled with them."""
    paints = []
    for number in range(colours.count):
        total = sum(int((label == number).sum()) for label in labels)
        step = max(1, -(-total // MOST_TEXELS))
        parts = [tile[np.flatnonzero(label == number)[::step]] for tile, label in zip(samples, labels, strict=True)]
        paints.append([part for part in parts if len(part.status)])
    if len(optics.options.lobes) > 1:
        return Paints(colours, list(parallel_map(functools.partial(_pair_of, optics=optics), paints)), None)
    surfaces = []
    for parts in paints:
        packed = [part.surface(optics) for part in parts]
        blocks = np.concatenate([surface.blocks for surface in packed]) if packed else None
        surfaces.append(None if blocks is None else packed[0]._replace(blocks=blocks))
    gloss, contradiction = gloss_of_paints(surfaces, optics.options.nodes())
    return Paints(colours, gloss, contradiction)


def _pair_of(parts: list[Tile], optics: GlossModel) -> PairGloss | None:
    """Return the gloss of one paint under two lobes from its texels in all tiles."""
    if not parts:
        return None
    readings = Readings.joined([part.readings(optics) for part in parts])
    return GlossSearch(readings, optics.options).found


@dataclass(frozen=True)
class Painted:
    """Parameters of the texels of a tile that were fitted with the gloss of a paint, or of two.

    Parameters
    ----------
    paint : (texels,) int
        Number of the paint of each texel, -1 for none or a mixture.
    texel : (shared,) int
        Indices of the texels that have a paint or are a mixture of two.
    shared : TexelGloss
        Parameters of these texels.
    """

    paint: np.ndarray
    texel: np.ndarray
    shared: TexelGloss

    @property
    def is_mixture(self) -> np.ndarray:
        """Whether a texel of ``shared`` is a mixture of two paints, (shared,) bool."""
        return self.paint[self.texel] < 0


def _share_piece(tile: Tile, gloss: PaintGloss | PairGloss, optics: GlossModel, texels: np.ndarray) -> TexelGloss:
    if isinstance(gloss, PairGloss):
        return share_pair(tile.readings(optics, texels), gloss, optics.options)
    return share(tile.surface(optics, texels, sides=False), gloss)


def _share_mixtures(tile: Tile, paints: Paints, optics: GlossModel, mixtures: Mixtures, some: np.ndarray) -> TexelGloss:
    """Fit mixtures, of which ``some`` are chosen."""
    chosen = Mixtures(*(each[some] for each in mixtures))
    return _share_piece(tile, gloss_between(paints.gloss, chosen), optics, chosen.texel)


def _colours_at(edge: Tile, paint: np.ndarray, paints: Paints, optics: GlossModel) -> tuple[np.ndarray, np.ndarray]:
    """Return diffuse responses and variances; the gloss of the given paints is subtracted where they are unreliable."""
    response, variance, own = edge.response.copy(), edge.variance.copy(), believed(edge)
    for number in paints.known:
        gloss, here = paints.gloss[number], np.flatnonzero((paint == number) & ~own)
        assert gloss is not None
        response[here], variance[here] = edge[here].under(gloss.log_gloss, optics)
    return response, variance


def share_by_paint(tile: Tile, paints: Paints, width: int, optics: GlossModel) -> Painted:
    """Fit the texels of a tile with the gloss of their paints as prior, and mixtures with that of both paints.

    A texel that no paint explains gets the gloss of the only paint near it, unless a surface of unknown paint is near
    as well.

    Parameters
    ----------
    tile : Tile
        Texels in rows of ``width``.
    """
    from scipy import ndimage  # slow to import

    paint = by_colour(tile.response, tile.variance, paints.colours)
    at_seam = seams(paint.reshape(-1, width))
    found = assign(tile, paint, paints, optics, at_seam.ravel()).reshape(-1, width)
    at_seam, filled, mixtures = (at_seam | (found < 0)).ravel(), found, None
    if (found >= 0).any():
        far, place = ndimage.distance_transform_edt(found < 0, return_indices=True)
        filled = np.where(far <= 0.5 * SEAM, found[tuple(place)], -1)
        edge = np.flatnonzero(seams(filled))
        response, variance = _colours_at(tile[edge], filled.ravel()[edge], paints, optics)
        seen = (tile.observed.weight > 0.0).any(axis=1).reshape(-1, width)
        unknown = ndimage.maximum_filter(seen & (filled < 0), size=SEAM, mode="nearest")
        filled, mixtures = find_mixtures(edge, found, filled, response, variance, paints.colours)
        filled = np.where((found < 0) & unknown, -1, filled)
    paint, columns, texels = np.full(found.size, -1), [], []

    def keep(here: np.ndarray, pieces: list[TexelGloss], *, contradicted: np.ndarray | bool, mixed=0.0) -> np.ndarray:
        one = TexelGloss.joined(pieces, len(optics.options.lobes))
        good = (one.agrees | contradicted) & (one.alpha_error <= np.maximum(_WORTH * one.alpha, _DARK))
        texels.append(here[good])
        columns.append(replace(one, alpha_error=np.hypot(one.alpha_error, mixed))[good])
        return here[good]

    for number in paints.known:
        gloss, here = paints.gloss[number], np.flatnonzero(filled.ravel() == number)
        assert gloss is not None
        pieces = in_pieces(functools.partial(_share_piece, tile, gloss, optics), here)
        # At a seam, a texel may fit badly without having a gloss of its own.
        paint[keep(here, pieces, contradicted=at_seam[here])] = number
    if mixtures is not None:
        known = np.isin(mixtures.one, paints.known) & np.isin(mixtures.other, paints.known)
        both = np.flatnonzero(known)
        if len(both):
            pieces = in_pieces(functools.partial(_share_mixtures, tile, paints, optics, mixtures), both)
            keep(mixtures.texel[both], pieces, contradicted=True, mixed=mixtures.alpha_error[both])
    shared = TexelGloss.joined(columns, len(optics.options.lobes))
    return Painted(paint, np.concatenate([*texels, np.empty(0, dtype=int)]), shared)
