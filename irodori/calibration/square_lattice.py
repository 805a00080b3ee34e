"""Grouping of detected squares into rows and columns of a lattice.

Squares that the detector missed leave holes; squares that are not patches remain without neighbours.
"""

from dataclasses import dataclass

import numpy as np

from irodori.calibration.chart_grid import homography, project

_REACH = (1.0, 1.75)  # of a square's side: distance from its centre to its neighbour's
_SIDEWAYS = 0.3  # of a square's side
_SIZES = 1.7  # largest ratio of the areas of neighbours
_MAX_RESIDUAL = 0.15  # of the pitch, about the perspective map
_MIN_SQUARES = 10
_TURNS = ((1, 0), (0, 1), (-1, 0), (0, -1))


@dataclass(frozen=True)
class Lattice:
    """Squares in rows and columns.

    Parameters
    ----------
    places : (n, 2) int
        Column and row of each square, the least of each 0; columns are at least as many as rows, and the frame is
        right-handed in the picture (x to the right, y down).
    centres : (n, 2) float
        x and y of the squares.
    """

    places: np.ndarray
    centres: np.ndarray

    @property
    def columns(self) -> int:
        """Number of columns, from the first to the last one with a square."""
        return int(self.places[:, 0].max()) + 1

    @property
    def rows(self) -> int:
        """Number of rows, from the first to the last one with a square."""
        return int(self.places[:, 1].max()) + 1

    @property
    def image_from_grid(self) -> np.ndarray:
        """Homography from columns and rows to x and y of the squares' centres, (3, 3)."""
        return homography(self.places, self.centres)


def lattices(squares: np.ndarray) -> list[Lattice]:
    """Return the lattices of ten squares or more, the largest first.

    Parameters
    ----------
    squares : (n, 4, 2) float
        Corners of each square in order around it.
    """
    squares = np.asarray(squares, dtype=np.float64).reshape(-1, 4, 2)
    centres = squares.mean(axis=1)
    frames = np.stack([_frame(square) for square in squares]) if len(squares) else np.zeros((0, 2, 2))
    left, found = set(range(len(squares))), []
    while left:
        members = _grow(min(left), centres, frames, left)
        left -= set(members)
        if len(members) >= _MIN_SQUARES:
            lattice = _settle(np.array(list(members.values())), centres[list(members)])
            if lattice is not None:
                found.append(lattice)
    return sorted(found, key=lambda lattice: -len(lattice.places))


def _frame(square: np.ndarray) -> np.ndarray:
    """Return two adjacent sides of a square as row vectors, (2, 2), right-handed with y down."""
    first, second = square[1] - square[0], square[2] - square[1]
    return np.array([first, second if first[0] * second[1] > first[1] * second[0] else -second])


def _grow(seed: int, centres, frames, left: set) -> dict[int, tuple[int, int]]:
    """Return {square: (column, row)} of the squares connected to a seed, counted from the seed."""
    places, taken, queue = {seed: (0, 0)}, {(0, 0)}, [seed]
    frame_of = {seed: frames[seed]}
    while queue:
        here = queue.pop(0)
        for turn in _TURNS:
            place = places[here][0] + turn[0], places[here][1] + turn[1]
            if place in taken:
                continue
            near = _neighbour(here, frame_of[here], turn, centres, frames, left - places.keys())
            if near is None:
                continue
            places[near], frame_of[near] = place, _aligned(frames[near], frame_of[here])
            taken.add(place)
            queue.append(near)
    return places


def _neighbour(here: int, frame, turn, centres, frames, candidates: set) -> int | None:
    """Return the nearest square one step away in a direction of the frame; None if there is none."""
    best, nearest = None, np.inf
    area = abs(np.linalg.det(frame))
    for other in candidates:
        ratio = abs(np.linalg.det(frames[other])) / area
        if not 1.0 / _SIZES < ratio < _SIZES:
            continue
        step = np.linalg.solve(frame.T, centres[other] - centres[here])
        along = step @ np.array(turn)
        sideways = abs(step @ np.array([turn[1], turn[0]]))
        if _REACH[0] < along < _REACH[1] and sideways < _SIDEWAYS and along < nearest:
            best, nearest = other, along
    return best


def _aligned(frame: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Return a frame turned by the multiple of 90° that brings it nearest to another frame."""
    turned = [frame, np.array([frame[1], -frame[0]]), -frame, np.array([-frame[1], frame[0]])]
    return max(turned, key=lambda f: np.sum(f * like))


def _settle(places: np.ndarray, centres: np.ndarray) -> Lattice | None:
    """Return the lattice of the squares that agree with one homography; None if too few do."""
    for _ in range(3):
        if min(np.ptp(places, axis=0)) < 2:
            return None
        image_from_grid = homography(places, centres)
        pitch = np.median(np.linalg.norm(project(image_from_grid, places + np.array([1, 0])) - centres, axis=1))
        good = np.linalg.norm(project(image_from_grid, places) - centres, axis=1) < _MAX_RESIDUAL * pitch
        if good.all():
            break
        places, centres = places[good], centres[good]
        if len(places) < _MIN_SQUARES:
            return None
    places = places - places.min(axis=0)
    if places[:, 1].max() > places[:, 0].max():
        places = np.stack([places[:, 1], places[:, 0].max() - places[:, 0]], axis=1)
    return Lattice(places, centres)
