"""Plausibility of a whole set of photographs: what a session asks shot by shot, asked of a table that is there already.

Beyond that it asks what only a whole set can tell: whether the photographs with the filter show the poses that those
without it show, and whether lenses agree with the definition. A photograph with a reason in the column ``accepted`` of
its table is not doubted, and is no measure for others.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from irodori.config.capture_table import Shot
from irodori.core.errors import InputError
from irodori.ingest.mosaic import Mosaic
from irodori.ingest.plausibility import Doubt, Look, Series, look_at

#: The two photographs of a pose are of different ones where each has another pose's that is this many times as like it,
_LIKER = 2.0
#: and they are unlike each other by more than this, 1 less the correlation of the pictures.
_UNLIKE = 0.02
#: Part of its files' focal length by which a definition may differ: makers round, and a lens in focus is another.
_FOCAL = 0.15
_FEWEST_BLOCKS, _NAMED = 64, 3
#: Doubts about photographs that tell no pose: nothing is to be seen in them, or they are said by a plainer mistake.
_TELLS_NO_POSE = ("identical", "size", "black", "blown", "filter")
#: Captures before and behind, in the order of the table, with which each is compared.
_NEIGHBOURS = 16


@dataclass(frozen=True)
class Doubted:
    """A photograph of a set that cannot be what its table says.

    Parameters
    ----------
    path : path
        Its file.
    doubt : Doubt
    """

    path: Path
    doubt: Doubt


@dataclass(frozen=True)
class FocalRange:
    """Focal lengths that files may state for a lens.

    Parameters
    ----------
    stated_mm : float
        What the definition says: the distance from lens to sensor, as a calibration finds it, mm.
    least_mm, most_mm : float
        Smallest and largest focal length of the lens at infinity that is compatible, mm.
    """

    stated_mm: float
    least_mm: float
    most_mm: float

    @classmethod
    def of(cls, focal_length_mm: float, distance_mm: float) -> "FocalRange":
        """Return the range for a definition's focal length, mm, before a subject at a distance, mm.

        In focus a lens stands up to 1 + m of its focal length before the sensor, with m the magnification.
        """
        closer = 1.0 + focal_length_mm / max(distance_mm - focal_length_mm, focal_length_mm)
        return cls(focal_length_mm, focal_length_mm * (1.0 - _FOCAL) / closer, focal_length_mm * (1.0 + _FOCAL))

    def doubt(self, found_mm: float) -> Doubt | None:
        """Return the doubt about a file that states a focal length, None where it agrees or states none (0)."""
        if not found_mm or self.least_mm <= found_mm <= self.most_mm:
            return None
        found = f"taken at {found_mm:g} mm, the camera's optics.focal_length_mm is {self.stated_mm:g}"
        return Doubt("focal length", f"{found}: is it the right lens, or was its zoom turned?")


class SetLook:
    """Looks at the photographs of a set, capture by capture.

    Parameters
    ----------
    shots : iterable of Shot
        The whole set.
    focal : FocalRange, optional
        Of its camera's lens.
    whites : iterable of (Shot, Look)
        Photographs of the camera's white reference that were found sound, where they stand in another set.
    """

    def __init__(
        self, shots: Iterable[Shot], focal: FocalRange | None = None, whites: Iterable[tuple[Shot, Look]] = ()
    ) -> None:
        self.shots = in_captures(shots)
        self._focal, self._series = focal, Series(self.shots)
        for shot, look in whites:
            self._series.add(shot, look)
        #: Photographs of the white reference that were found sound.
        self.whites: list[tuple[Shot, Look]] = []
        self._found: list[Doubted] = []
        self._pairs: dict[str, dict[str, tuple[Path, Look]]] = {}

    def see(self, shot: Shot, path: Path, mosaic: Mosaic) -> None:
        """Take the next photograph, in the order of `shots`, with its ISO and f-number where its file knows them.

        What is doubted is no measure for the next ones.
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
        if shot.role == "object" and not any(doubt.kind in _TELLS_NO_POSE for doubt in doubts):
            # Of a bracket that in which least clips, and of those the brightest, shows most.
            states = self._pairs.setdefault(shot.capture, {})
            best = states.get(shot.filter)
            if best is None or (look.clipped, -look.level) < (best[1].clipped, -best[1].level):
                states[shot.filter] = path, look

    def doubted(self) -> list[Doubted]:
        """Return what was found, photographs that show other poses than their names say first."""
        elsewhere = _of_other_poses(list(self._pairs.values()))
        # Light and place that differ from the pair's other photograph follow from that.
        explained = {one.path for one in elsewhere}
        return [*elsewhere, *(one for one in self._found if one.path not in explained)]

    def refuse(self, table) -> list[Doubted]:
        """Refuse what cannot be, and return what is merely unlikely.

        Raises
        ------
        InputError
            For the first photograph that cannot be what its table says, with how many others there are.
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


def in_captures(shots: Iterable[Shot]) -> list[Shot]:
    """Return shots with those of a capture side by side, captures in the order of their first photographs."""
    groups: dict[str, list[Shot]] = {}
    for shot in shots:
        groups.setdefault(shot.capture, []).append(shot)
    return [shot for group in groups.values() for shot in group]


def _of_other_poses(captures: list[dict[str, tuple[Path, Look]]]) -> list[Doubted]:
    """Return the photographs with the filter that, as their partners, are far liker to one of another pose.

    One of the two alone may be: under grazing light noise, or gloss that clips, makes some pictures unlike all others.
    """
    pairs = [states for states in captures if len(states) == 2]
    if len({look.picture.shape for states in pairs for _, look in states.values()}) != 1:
        return []
    out, through = ([states[state] for states in pairs] for state in ("out", "in"))
    found = []
    for own, (path, look) in enumerate(through):
        near = range(max(0, own - _NEIGHBOURS), min(len(pairs), own + _NEIGHBOURS + 1))
        by_out = {other: _unlikeness(out[other][1], look) for other in near}
        nearest = min(by_out, key=by_out.__getitem__)
        if by_out[own] <= max(_UNLIKE, _LIKER * by_out[nearest]):
            continue
        if by_out[own] > _LIKER * min(_unlikeness(out[own][1], through[other][1]) for other in near):
            words = f"it shows what {out[nearest][0].name} shows, and not what {out[own][0].name} does"
            asked = "are the names of one filter state shifted by a pose, or exchanged?"
            found.append(Doubted(path, Doubt("order", f"{words}: {asked}")))
    return found


def _unlikeness(first: Look, second: Look) -> float:
    """Return 1 less the correlation of two green pictures where neither clips, 1 where too little is left."""
    common = first.whole & second.whole
    if common.sum() < _FEWEST_BLOCKS:
        return 1.0
    a, b = (look.picture[..., 1][common].astype(np.float64) for look in (first, second))
    a, b = a - a.mean(), b - b.mean()
    size = np.sqrt((a @ a) * (b @ b))
    return float(1.0 - (a @ b) / size) if size > 0.0 else 1.0
