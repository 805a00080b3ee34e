"""Coarse look at whole photographs for an object of another size, at another place or in another pose than was typed.

Registration searches outlines near their expected places. If size, distance or focal length are far from what was
typed, if the object lies elsewhere, or if two lines of a table are exchanged, it finds nothing, or the borders of
paints. Here the expected outline is enlarged, moved and exchanged with those of other poses. Brightness changes most
across it where the object really ends.
"""

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.rectification.reduced_pictures import DARK, GREEN, Picture

if TYPE_CHECKING:
    from irodori.rectification.registration_problem import Problem

_MOST_PICTURES, _MOST_POINTS = 6, 60  # photographs, and points of each outline, that are looked at
#: Multiples of the size and shifts that are tried: ratio of neighbours and their number to either side; step and range
#: in half widths of the object.
_RATIO, _RATIOS, _STEP, _FARTHEST = 1.08, 36, 0.08, 2.0
#: Distance of the readings from the outline: half widths of the object, and samples at least.
_ACROSS, _ACROSS_LEAST = 0.06, 1.5
_FEWEST = 12  # points of an outline that tell anything
#: Ratio of the contrast across another outline to that across the expected one from which the other one is believed;
#: change of the size and shift, half widths of the object, from which there is another outline.
CLEARER, _OTHER_SIZE, _OTHER_PLACE = 1.5, 0.12, 0.15
LEAST = 0.5  # contrast, as a logarithm, of an outline that is believed


class Look(NamedTuple):
    """Outline that photographs show most clearly, of those larger or smaller than the expected one or beside it.

    Parameters
    ----------
    multiple : float
        Its size relative to the expected one.
    shift_mm : float
        Its distance from the expected place, mm.
    contrast, expected : float
        Mean contrast across it, and across the expected one: changes of the logarithm of brightness.
    """

    multiple: float = 1.0
    shift_mm: float = 0.0
    contrast: float = 0.0
    expected: float = 0.0

    @property
    def is_elsewhere(self) -> bool:
        """Whether its size or place is another."""
        return self.multiple != 1.0 or self.shift_mm > 0.0


class _Outline(NamedTuple):
    """Expected outline in a photograph: points (n, 2), unit normals (n, 2), middle (2,) and half width, superpixels."""

    xy: np.ndarray
    outward: np.ndarray
    middle: np.ndarray
    half: float

    @classmethod
    def of(cls, problem: "Problem", number: int) -> "_Outline | None":
        """Return the outline that is expected in a photograph by its pose; None if too few points of it are lit."""
        rim, outward = problem.views[number].rim, problem.views[number].outward
        chosen = np.unique(np.linspace(0, len(rim) - 1, min(len(rim), _MOST_POINTS)).round().astype(int))
        if len(chosen) < _FEWEST:
            return None
        xy = problem.seen(number, rim[chosen], problem.unknowns)
        if not np.isfinite(xy).all():
            return None
        places = problem.seen(number, problem.texels.position, problem.unknowns)
        extent = np.nanmax(places, axis=0) - np.nanmin(places, axis=0)
        middle = problem.seen(number, np.zeros((1, 3)), problem.unknowns)[0]
        return cls(xy, outward[chosen], middle, 0.5 * float(extent.min()))

    def contrast(self, picture: Picture, multiple: float | np.ndarray = 1.0, shift=((0.0, 0.0),)) -> np.ndarray:
        """Return mean changes of the logarithm of brightness across enlarged or moved outlines, (m,).

        Parameters
        ----------
        picture : Picture
        multiple : (m,) float
            Sizes of the outlines relative to the expected one.
        shift : (m, 2) float
            Their shifts, superpixels.
        """
        size = np.atleast_1d(np.asarray(multiple, float))[:, None, None]
        on = self.middle + size * (self.xy - self.middle) + np.asarray(shift, float)[:, None]
        across = np.maximum(_ACROSS * self.half * size, _ACROSS_LEAST / picture.scale) * self.outward
        return contrast(picture, on, across)


def contrast(picture: Picture, on: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return mean changes of the logarithm of brightness across outlines, (m,); 0 for those mostly beyond the picture.

    Parameters
    ----------
    picture : Picture
    on : (m, n, 2) float
        Points of m outlines, superpixels.
    across : (m, n, 2) float
        Ways from these points to those outside where brightness is read; inside it is read as far away.
    """
    level = picture.level(0.0)
    inside, outside = (
        np.log(np.maximum(level.sampled(level.bands[[GREEN]], picture.place(at.reshape(-1, 2)))[:, 0], 0.0) + DARK)
        for at in (on - across, on + across)
    )
    change = np.abs(inside - outside).reshape(on.shape[:2])
    known = np.isfinite(change)
    return np.where(
        known.mean(axis=1) >= 0.5, np.nan_to_num(change).sum(axis=1) / np.maximum(known.sum(axis=1), 1), 0.0
    )


def _outlines(problem: "Problem", linear: Sequence) -> Iterator[tuple[_Outline, Picture]]:
    """Yield the expected outline in some of the photographs, and the photograph, where enough of it is lit."""
    some = np.unique(np.linspace(0, len(linear) - 1, min(len(linear), _MOST_PICTURES)).round().astype(int))
    for number in some:
        outline = _Outline.of(problem, number)
        if outline is not None:
            yield outline, Picture.load(linear[number])


def expected_contrast(problem: "Problem", linear: Sequence) -> float:
    """Return how clearly some of the photographs show the outline where it is expected; arguments as `look_elsewhere`.

    The mean change of the logarithm of brightness across it; 0 if no photograph shows enough of it.
    """
    found = [float(outline.contrast(picture)[0]) for outline, picture in _outlines(problem, linear)]
    return float(np.mean(found)) if found else 0.0


def look_elsewhere(problem: "Problem", linear: Sequence) -> Look:
    """Return the outline that some of the photographs show most clearly.

    Parameters
    ----------
    problem : Problem
        Its unknowns say where outlines are expected.
    linear : sequence of path
        Files of linear responses.
    """
    multiples = _RATIO ** np.arange(-_RATIOS, _RATIOS + 1)
    steps = np.arange(-_FARTHEST, _FARTHEST + 0.5 * _STEP, _STEP)
    shifts = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    expected, by_size, by_shift, ways = [], [], [], []
    for outline, picture in _outlines(problem, linear):
        expected.append(float(outline.contrast(picture)[0]))
        by_size.append(outline.contrast(picture, multiples, np.zeros((len(multiples), 2))))
        # A photograph shows an outline elsewhere in another direction if the table is turned.
        moved = outline.contrast(picture, np.ones(len(shifts)), outline.half * shifts)
        by_shift.append(float(moved.max()))
        ways.append([np.hypot(*shifts[np.argmax(moved)]), outline.half])
    if not expected:
        return Look()
    sizes, typed, moved_contrast = np.mean(by_size, axis=0), float(np.mean(expected)), float(np.mean(by_shift))
    at, (way, half) = int(np.argmax(sizes)), np.median(ways, axis=0)
    if sizes[at] >= moved_contrast and abs(math.log(multiples[at])) > _OTHER_SIZE:
        return Look(float(multiples[at]), 0.0, float(sizes[at]), typed)
    if moved_contrast > sizes[at] and way > _OTHER_PLACE:
        return Look(1.0, float(way * half) * problem.mm_per_px, moved_contrast, typed)
    return Look(contrast=typed, expected=typed)


class Exchanged(NamedTuple):
    """Photographs that show a flat object in the pose of another one, and not in their own.

    Parameters
    ----------
    pairs : list of (int, int)
        Index of each such photograph, and of the one whose pose it shows.
    contrast : float
        Mean contrast of all photographs across the outline of the pose that they show.
    """

    pairs: list[tuple[int, int]]
    contrast: float


def look_for_other_poses(problem: "Problem") -> Exchanged:
    """Return the photographs that show the object in the pose of another one; none of round objects, which look alike.

    Parameters
    ----------
    problem : Problem
        Its unknowns say where outlines are expected.
    """
    views = range(len(problem.views)) if problem.tells_texture else range(0)
    outlines = [_Outline.of(problem, number) for number in views]
    pairs, shown = [], []
    for number, own in enumerate(outlines):
        if own is None:
            continue
        picture = problem.views[number].picture
        seen = [0.0 if one is None else float(one.contrast(picture)[0]) for one in outlines]
        best = int(np.argmax(seen))
        shown.append(seen[best])
        if seen[best] > max(LEAST, CLEARER * seen[number]):
            pairs.append((number, best))
    return Exchanged(pairs, float(np.mean(shown)) if shown else 0.0)
