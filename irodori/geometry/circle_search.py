"""Search for the outline of a ball in photographs of one fixed camera: the circle on which most edges lie (Hough).

The gradient at an edge points towards or away from the centre of the circle on which the edge lies. Every edge votes
for the points along its gradient. The point with most votes becomes the centre, and the distance at which most edges
lie becomes the radius. The circle is then fitted to the edges near it. Edges of a stand, of the terminator (the border
of light and shadow) or of reflections in the ball lie on other circles.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.core.errors import InputError

#: Share of pixels, those with the steepest gradients, that may be edges; range of radii, as shares of the shorter side.
_EDGES, _RADII = 0.15, (0.08, 0.52)
#: Cells along the shorter side in which votes are counted.
_CELLS = 120
#: Largest distance of an edge from the circle in each round of the fit, as a share of the radius; largest deviation of
#: its gradient from the radial direction, as a cosine.
_NEAR, _TURN = (0.08, 0.04, 0.02, 0.012, 0.012), math.cos(math.radians(20.0))
#: Least share of the circle along which edges have to be found.
LEAST_SEEN = 0.4
#: Largest distance of an edge from a circle that is not fitted yet, as a share of the radius.
_RING = 0.02
_SECTORS, _ROUNDS = 72, 8


class Circle(NamedTuple):
    """A circle in a picture, pixels; the centre of the first pixel is (0, 0), y runs down."""

    x: float
    y: float
    radius: float

    def normals(self, shape) -> np.ndarray:
        """Return the unit normals of a sphere with this outline, far from the camera: x right, y up, z to the camera.

        Parameters
        ----------
        shape : (int, int)
            Rows and columns.

        Returns
        -------
        (rows, columns, 3) float64, NaN outside the circle
        """
        rows, columns = np.indices(shape)
        a, b = (columns - self.x) / self.radius, (self.y - rows) / self.radius
        square = a * a + b * b
        with np.errstate(invalid="ignore"):
            return np.where((square < 1.0)[..., None], np.stack([a, b, np.sqrt(1.0 - square)], axis=-1), np.nan)


def find_circle(picture, path) -> Circle:
    """Return the circular outline of the only ball in a picture.

    Parameters
    ----------
    picture : (rows, columns) float
        Brightness, for example the mean of several photographs.
    path : path
        For the error message.

    Raises
    ------
    InputError
        If there is no circle with edges along at least two fifths of it.
    """
    place, towards = _edges_of(picture)
    accepted = "one ball, whole, against a background of another brightness; or its circle, or its mask"
    if len(place) < _SECTORS:
        raise InputError(path, "", "a picture without edges", accepted)
    circle = _outermost(place, towards, _voted(place, towards, picture.shape), picture.shape)
    for near in _NEAR:
        fitted = _fitted(place, towards, circle, near)
        if fitted is None:
            raise InputError(path, "", "no ball's outline", accepted)
        circle = fitted
    seen = _seen(place, towards, circle, _NEAR[-1])
    if seen < LEAST_SEEN:
        raise InputError(path, "", f"a ball's outline of which edges show {seen:.0%}", accepted)
    return circle


def seen_along(picture, circle: Circle) -> float:
    """Return the share of a circle along which a picture, (rows, columns), has edges, 0 to 1."""
    return _seen(*_edges_of(picture), circle, _RING)


def _edges_of(picture) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges of a picture, see `_edges`."""
    from scipy import ndimage  # slow to import

    # Square roots of brightness give dim and bright parts of an outline about the same weight.
    picture = ndimage.gaussian_filter(np.sqrt(np.maximum(picture, 0.0)), 1.0)
    return _edges(np.stack([ndimage.sobel(picture, axis=1), ndimage.sobel(picture, axis=0)], axis=-1))


def _edges(slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 2), x then y, where the brightness gradient is largest along its direction, and directions."""
    from scipy import ndimage

    strength = np.hypot(slope[..., 0], slope[..., 1])
    least = max(float(np.quantile(strength, 1.0 - _EDGES)), 1e-9)
    rows, columns = np.nonzero(strength > least)
    here = strength[rows, columns]
    towards = slope[rows, columns] / here[:, None]
    place = np.stack([columns, rows], axis=-1).astype(float)

    def at(where: np.ndarray) -> np.ndarray:
        return ndimage.map_coordinates(strength, where.T[::-1], order=1, mode="nearest")

    beside = at(place - towards), at(place + towards)
    bend = 2.0 * here - beside[0] - beside[1]
    steepest = (here >= beside[0]) & (here > beside[1]) & (bend > 0.0)
    shift = 0.5 * (beside[1] - beside[0])[steepest] / bend[steepest]
    return place[steepest] + shift[:, None] * towards[steepest], towards[steepest]


def _voted(place: np.ndarray, towards: np.ndarray, shape) -> Circle:
    """Return the circle with most votes of edges, accurate to about one cell of the grid of votes."""
    from scipy import ndimage

    cell = min(shape) / _CELLS
    size = [int(side / cell) + 1 for side in shape]
    radii = np.arange(_RADII[0] * min(shape), _RADII[1] * min(shape), cell)
    votes = np.zeros(size)
    for sign in (-1.0, 1.0):
        for radius in radii:
            at = (place + sign * radius * towards) / cell
            inside = ((at >= 0.0) & (at < [size[1], size[0]])).all(axis=1)
            column, row = at[inside].astype(int).T
            # Long circles collect more edges by chance: a vote counts by the share of the circle that it covers.
            np.add.at(votes, (row, column), 1.0 / radius)
    votes = ndimage.gaussian_filter(votes, 1.0)
    best: tuple[float, Circle] | None = None
    for at in np.argsort(votes, axis=None)[-40:]:
        row, column = np.unravel_index(at, votes.shape)
        centre = (np.array([column, row]) + 0.5) * cell
        away = place - centre
        distance = np.hypot(*away.T)
        facing = np.abs(np.sum(away * towards, axis=1)) > _TURN * distance
        shares = np.array([(facing & (np.abs(distance - r) < cell)).sum() / r for r in radii])
        found = Circle(float(centre[0]), float(centre[1]), float(radii[shares.argmax()]))
        if best is None or shares.max() > best[0]:
            best = float(shares.max()), found
    assert best is not None
    return best[1]


def _outermost(place: np.ndarray, towards: np.ndarray, circle: Circle, shape) -> Circle:
    """Return the largest concentric circle with edges along two fifths of it, because a ball may have painted rings."""
    larger = np.arange(circle.radius, _RADII[1] * min(shape), min(shape) / _CELLS)
    rings = [circle._replace(radius=float(radius)) for radius in larger]
    return next((ring for ring in rings[::-1] if _seen(place, towards, ring, _RING) >= LEAST_SEEN), circle)


def _facing(place: np.ndarray, towards: np.ndarray, circle: Circle, near: float) -> np.ndarray:
    """Return a mask of the edges that lie near a circle and run along it, (n,) bool."""
    away = place - [circle.x, circle.y]
    distance = np.maximum(np.hypot(*away.T), 1e-9)
    along = np.abs(np.sum(away * towards, axis=1)) > _TURN * distance
    return along & (np.abs(distance - circle.radius) < near * circle.radius)


def _fitted(place: np.ndarray, towards: np.ndarray, circle: Circle, near: float) -> Circle | None:
    """Return the least-squares circle through the edges near a circle, all sectors with equal weight; None if too few.

    Cauchy weights reduce the influence of outliers, such as edges of reflections near the rim of a mirror ball.
    """
    used = place[_facing(place, towards, circle, near)]
    if len(used) < _SECTORS:
        return None
    away = used - [circle.x, circle.y]
    sector = _sector(away)
    share = np.reciprocal(np.bincount(sector)[sector].astype(float))
    matrix = np.column_stack([2.0 * away, np.ones(len(away))])
    x, y, radius, weight = 0.0, 0.0, circle.radius, share
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)
        x, y, rest = np.linalg.lstsq(root[:, None] * matrix, root * np.sum(away**2, axis=1), rcond=None)[0]
        radius = math.sqrt(max(rest + x * x + y * y, 1e-9))
        off = np.hypot(*(away - [x, y]).T) - radius
        weight = share / (1.0 + (off / max(1.5 * float(np.median(np.abs(off))), 0.3)) ** 2)
    return Circle(float(circle.x + x), float(circle.y + y), radius)


def _sector(away: np.ndarray) -> np.ndarray:
    return np.floor(np.arctan2(away[:, 1], away[:, 0]) / (2.0 * math.pi) * _SECTORS).astype(int) % _SECTORS


def _seen(place: np.ndarray, towards: np.ndarray, circle: Circle, near: float) -> float:
    used = place[_facing(place, towards, circle, near)]
    return len(np.unique(_sector(used - [circle.x, circle.y]))) / _SECTORS


def circle_of_mask(mask, path) -> Circle:
    """Return the circle with the centroid and the area of a mask's largest bright region, which shows the ball.

    Raises
    ------
    InputError
        If the bright region is no disc.
    """
    from scipy import ndimage

    part = mask > 0.5 * float(mask.max(initial=0.0))
    numbers, _ = ndimage.label(part)
    largest = int(np.argmax(np.bincount(numbers.ravel())[1:])) + 1 if numbers.any() else 0
    rows, columns = np.nonzero(numbers == largest)
    circle = Circle(float(columns.mean()), float(rows.mean()), math.sqrt(len(rows) / math.pi))
    # No pixel of a disc lies outside the circle of the same area, apart from pixels at the edge.
    outside = np.hypot(columns - circle.x, rows - circle.y) > circle.radius + 2.0
    if largest == 0 or outside.mean() > 0.01:
        raise InputError(path, "", "a mask that is no disc", "a picture that is bright on the ball and black elsewhere")
    return circle
