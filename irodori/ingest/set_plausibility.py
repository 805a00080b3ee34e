"""Plausibility of a whole set of photographs: the checks of a capture session, applied to an existing table.

Additional checks need the whole set: whether the photographs with the filter show the same poses as those without it,
whether those of the white reference show an even surface, and whether the focal lengths agree with the definition. A
photograph with a reason in the column ``accepted`` of its table is not checked, and others are not compared with it.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from irodori.config.capture_table import Shot
from irodori.core.errors import InputError
from irodori.ingest.mosaic import Mosaic
from irodori.ingest.plausibility import PLATE_SHIFT, Doubt, Look, Series, look_at

#: The photographs of a capture show different poses if each is this many times more similar to one of another capture,
_LIKER = 2.0
#: and their dissimilarity (1 minus the correlation of the pictures) exceeds this.
_UNLIKE = 0.02
#: The same for smoothed pictures, from which most of the noise is gone.
_UNLIKE_SMOOTH = 0.005
#: Largest relative difference between the focal length in a file and that expected: makers round the values.
_FOCAL = 0.15
_FEWEST_BLOCKS, _NAMED = 64, 3
#: Standard deviation of the smoothing before a shift of less than a block is measured, blocks.
_SMOOTHED_PX = 1
#: Doubts with which a photograph is not compared for its pose: it shows nothing, or the mistake explains a mismatch.
_TELLS_NO_POSE = ("identical", "size", "black", "blown", "filter")
#: Doubts with which a photograph does not tell whether it shows an even surface.
_TELLS_NO_SURFACE = ("identical", "black", "blown")
#: Number of captures before and after, in the order of the table, with which each is compared.
_NEIGHBOURS = 16


@dataclass(frozen=True)
class Doubted:
    """A doubt about a photograph of a set.

    Parameters
    ----------
    path : path
        File of the photograph.
    doubt : Doubt
    """

    path: Path
    doubt: Doubt


@dataclass(frozen=True)
class FocalRange:
    """Range of the focal lengths that files may state for a lens.

    Parameters
    ----------
    stated_mm : float
        Focal length in the definition: the distance from lens to sensor, as found by a calibration, mm.
    least_mm, most_mm : float
        Smallest and largest compatible focal length of the lens at infinity, mm.
    """

    stated_mm: float
    least_mm: float
    most_mm: float

    @classmethod
    def of(cls, focal_length_mm: float, distance_mm: float) -> "FocalRange":
        """Compute the range from the focal length in a definition, mm, and the distance of the subject, mm.

        A focused lens is up to 1 + m times its focal length away from the sensor, where m is the magnification.
        """
        closer = 1.0 + focal_length_mm / max(distance_mm - focal_length_mm, focal_length_mm)
        return cls(focal_length_mm, focal_length_mm * (1.0 - _FOCAL) / closer, focal_length_mm * (1.0 + _FOCAL))

    def doubt(self, found_mm: float) -> Doubt | None:
        """Return the doubt about a focal length stated in a file; None if it agrees, or the file states none (0)."""
        if not found_mm or self.least_mm <= found_mm <= self.most_mm:
            return None
        found = f"taken at {found_mm:g} mm, the camera's optics.focal_length_mm is {self.stated_mm:g}"
        return Doubt("focal length", f"{found}: is it the right lens, or was its zoom turned?")


class SetLook:
    """Checks of the photographs of a set, capture by capture.

    Parameters
    ----------
    shots : iterable of Shot
        The whole set.
    focal : FocalRange, optional
        Range for the lens of the camera.
    whites : iterable of (Shot, Look)
        Accepted photographs of the camera's white reference from another set.
    """

    def __init__(
        self, shots: Iterable[Shot], focal: FocalRange | None = None, whites: Iterable[tuple[Shot, Look]] = ()
    ) -> None:
        self.shots = in_captures(shots)
        self._focal, self._series = focal, Series(self.shots)
        for shot, look in whites:
            self._series.add(shot, look)
        #: Accepted photographs of the white reference.
        self.whites: list[tuple[Shot, Look]] = []
        self._found: list[Doubted] = []
        self._surfaces: list[tuple[Shot, Path, str]] = []
        self._pairs: dict[str, dict[str, tuple[Path, Look]]] = {}

    def see(self, shot: Shot, path: Path, mosaic: Mosaic) -> None:
        """Check the next photograph, in the order of `shots`, with ISO and f-number completed from its file.

        Later photographs are not compared with doubtful ones.
        """
        if shot.taken.accepted:
            return
        look = look_at(path, mosaic, thumbnail=True)
        doubts = self._series.doubts(shot, look)
        if self._focal is not None and (doubt := self._focal.doubt(look.focal_mm)) is not None:
            doubts.insert(0, doubt)
        self._found += [Doubted(path, doubt) for doubt in doubts]
        if not doubts:
            self._series.add(shot, look)
            if shot.role == "white":
                self.whites.append((shot, look))
        if shot.role in ("white", "chart") and not any(doubt.kind in _TELLS_NO_SURFACE for doubt in doubts):
            self._surfaces.append((shot, path, _unevenness(look)))
        if shot.role == "object" and not any(doubt.kind in _TELLS_NO_POSE for doubt in doubts):
            # From a bracket take the least clipped photograph, and among equals the brightest.
            states = self._pairs.setdefault(shot.capture, {})
            best = states.get(shot.filter)
            if best is None or (look.clipped, -look.level) < (best[1].clipped, -best[1].level):
                states[shot.filter] = path, look

    def doubted(self) -> list[Doubted]:
        """Return all doubts, first those about photographs that show another pose than their table states."""
        elsewhere = _of_other_poses(list(self._pairs.values()))
        # A wrong pose explains other differences from the other photograph of the pair.
        explained = {one.path for one in elsewhere}
        return [*elsewhere, *(one for one in self._found if one.path not in explained), *self._uneven_whites()]

    def _uneven_whites(self) -> Iterator[Doubted]:
        """Yield the doubts about photographs of the white reference that do not show an even surface."""
        for shot, path, unevenness in self._surfaces:
            if shot.role != "white" or not unevenness:
                continue
            asked = "does the white reference fill the picture, evenly lit?"
            for other, file, fault in self._surfaces:
                if other.role == "chart" and other.filter == shot.filter and not fault:
                    asked = f"are white reference and chart exchanged? {file.name} shows an even surface"
            yield Doubted(path, Doubt("white", f"{unevenness}: {asked}"))

    def refuse(self, table) -> list[Doubted]:
        """Raise an error if any doubt is certain; otherwise return all doubts.

        Raises
        ------
        InputError
            For the first photograph that cannot be what its table states; the message gives the number of others.
        """
        found = self.doubted()
        certain = [one for one in found if one.doubt.is_certain]
        if certain:
            first, *others = certain
            names = list(dict.fromkeys(one.path.name for one in others if one.path != first.path))
            more = f"; {len(names)} more are doubted ({', '.join(names[:_NAMED])}{', ...' if names[_NAMED:] else ''})"
            accepted = f"a photograph as {table} says, or there, in its column accepted, why it is right"
            raise InputError(first.path, first.doubt.kind, first.doubt.words + (more if names else ""), accepted)
        return found


def _unevenness(look: Look) -> str:
    """Return what keeps a photograph from showing an even surface, as `fit_flat` says it; empty if it shows one."""
    from irodori.ingest.flat_field import fit_flat  # compiled loops, slow to import

    try:
        fit_flat(look.picture, look.whole)
    except ValueError as error:
        return str(error)
    return ""


def in_captures(shots: Iterable[Shot]) -> list[Shot]:
    """Sort shots by capture, with captures in the order of their first photographs."""
    groups: dict[str, list[Shot]] = {}
    for shot in shots:
        groups.setdefault(shot.capture, []).append(shot)
    return [shot for group in groups.values() for shot in group]


def _of_other_poses(captures: list[dict[str, tuple[Path, Look]]]) -> list[Doubted]:
    """Return doubts about filtered photographs that seem to show another pose than their unfiltered partners.

    Both photographs of the pair must be far more similar to one of another pose. A single one may differ from all
    others, because of noise under grazing light or clipped gloss. If the plate of the filter shifts a picture further
    than its lit edge is wide, the view of another pose may cover more of it than that of its own pose. What seems to
    show another pose is therefore compared once more, after the shift that all pairs have in common.
    """
    pairs = [states for states in captures if len(states) == 2]
    if len({look.picture.shape for states in pairs for _, look in states.values()}) != 1:
        return []
    out, through = ([states[state] for states in pairs] for state in ("out", "in"))

    def elsewhere(own: int, unlikeness: Callable[[Look, Look], float], limit: float) -> int | None:
        """Return the pose that a filtered photograph shows; None if it shows its own."""
        look = through[own][1]
        near = range(max(0, own - _NEIGHBOURS), min(len(pairs), own + _NEIGHBOURS + 1))
        by_out = {other: unlikeness(out[other][1], look) for other in near}
        nearest = min(by_out, key=by_out.__getitem__)
        if by_out[own] <= max(limit, _LIKER * by_out[nearest]):
            return None
        least = min(unlikeness(out[own][1], through[other][1]) for other in near)
        return nearest if by_out[own] > _LIKER * least else None

    found, suspects = [], [own for own in range(len(pairs)) if elsewhere(own, _unlikeness, _UNLIKE) is not None]
    if not suspects:
        return []
    shift = np.median([_shift(out[own][1], through[own][1]) for own in range(len(pairs))], axis=0)
    for own in suspects:
        if (shown := elsewhere(own, lambda a, b: _unlikeness(a, b, shift), _UNLIKE_SMOOTH)) is None:
            continue
        words = f"it shows what {out[shown][0].name} shows, and not what {out[own][0].name} does"
        asked = "are the names of one filter state shifted by a pose, or exchanged?"
        found.append(Doubted(through[own][0], Doubt("order", f"{words}: {asked}")))
    return found


def _unlikeness(first: Look, second: Look, shift: np.ndarray | None = None) -> float:
    """Return 1 minus the correlation of two green pictures over unclipped blocks; 1 if there are too few.

    With a shift of the second against the first, (row, column) in blocks, both are smoothed.
    """
    common = first.whole & second.whole
    if shift is None:
        a, b = (look.picture[..., 1][common].astype(np.float64) for look in (first, second))
    else:
        picture, slopes, b = _smoothed(first, second, common)
        a = picture - shift @ slopes
    if a.size < _FEWEST_BLOCKS:
        return 1.0
    a, b = a - a.mean(), b - b.mean()
    size = np.sqrt((a @ a) * (b @ b))
    return float(1.0 - (a @ b) / size) if size > 0.0 else 1.0


def _shift(first: Look, second: Look) -> np.ndarray:
    """Return the shift of the second picture against the first, (row, column) in blocks; at most that by a plate.

    It is that of a linear regression of the second picture on the first and its derivatives. 0 if nothing is in common.
    """
    picture, slopes, b = _smoothed(first, second, first.whole & second.whole)
    known = np.stack([picture, *slopes, np.ones(picture.size)], axis=1)
    level, *by = np.linalg.lstsq(known, b)[0][:3]
    shift = -np.array(by) / level if level > 0.0 else np.zeros(2)
    return shift * min(1.0, PLATE_SHIFT * first.picture.shape[1] / max(float(np.hypot(*shift)), 1e-9))


def _smoothed(first: Look, second: Look, whole: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return smoothed green where nothing near is clipped: of the first (n,), its derivatives (2, n), of the second."""
    from scipy.ndimage import binary_erosion, gaussian_filter  # slow to import

    common = binary_erosion(whole, iterations=2 * _SMOOTHED_PX, border_value=1)
    a, b = (gaussian_filter(look.picture[..., 1].astype(np.float64), _SMOOTHED_PX) for look in (first, second))
    return a[common], np.stack([slope[common] for slope in np.gradient(a)]), b[common]
