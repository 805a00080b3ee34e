"""Points of a surface at which what others hide by rays is worked out, and how a hit finds those about it.

Every shape lays out its own (`irodori.geometry.shapes.shape.Shape.nodes`): flat ones and spheres on a grid, meshes on
their triangles. A hit takes the values of the three or four nodes about it.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from irodori.jit.compilation import njit

#: Nodes rise this part of their coordinates, or of their shape's reach, above the surface, as hits do.
_RISE = 2.0**-18


@dataclass(frozen=True)
class Nodes:
    """Nodes of one shape, in the world.

    Parameters
    ----------
    origin : (n, 3) float64
        Where rays begin, mm.
    normal, facet : (n, 3) float64
        Unit shading normal, and the unit normal of the surface itself.
    probe : (n, 3) float64
        A point above the surface near each node that sees it, unless something is pushed through the surface between
        them; the node's own origin where there is none.
    cells : (c, 3 or 4) int
        Nodes that are interpolated between, a tuple of arrays where their number differs.
    grid : (GRID,) float64
        Of a flat shape or a sphere, see `Grid`; zeros of a mesh.
    parts : (triangles,) int32
        Of a mesh: into how many parts each edge of a triangle is divided.
    corners : (places,) int32
        Of a mesh: the nodes of its triangles' places, one triangle after the other, row by row from the first edge.
    """

    origin: np.ndarray
    normal: np.ndarray
    facet: np.ndarray
    probe: np.ndarray
    cells: np.ndarray
    grid: np.ndarray
    parts: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))
    corners: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))


#: Numbers of a grid: columns, rows; of a flat one, along both axes of its frame, the middle, the reach (mm) within
#: which it is even, the place of the first node, and nodes a unit of places, see `warped`.
COLUMNS, ROWS, MIDDLE, REACH, LOW, DENSITY, GRID = 0, 1, 2, 4, 6, 8, 10
#: Part of a mesh's height, from its lowest point on, by which it stands on something.
_FOOT = 0.1
#: Part of a grid's larger reach that the smaller one has at least.
_LEAST = 0.02


def warped(offset: np.ndarray) -> np.ndarray:
    """Return places, -1..1, of offsets in units of the reach: half of them within it, evenly."""
    away = np.maximum(np.abs(offset), 1.0)
    return np.where(np.abs(offset) <= 1.0, 0.5 * offset, np.sign(offset) * (1.0 - 0.5 / away))


def unwarped(place: np.ndarray) -> np.ndarray:
    """Return the offsets of places, see `warped`."""
    left = np.maximum(1.0 - np.abs(place), 1e-12)
    return np.where(np.abs(place) <= 0.5, 2.0 * place, np.sign(place) * 0.5 / left)


def raised(point: np.ndarray, facet: np.ndarray, reach_mm: float) -> np.ndarray:
    """Return points, (n, 3) mm, lifted along their facets by what single precision needs."""
    size = np.maximum(np.abs(point).max(axis=-1, keepdims=True), reach_mm)
    return point + _RISE * size * facet


def quadrangles(number: np.ndarray) -> np.ndarray:
    """Return the cells of a grid of nodes, (c, 4)."""
    corners = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    return np.stack([corner.ravel() for corner in corners], axis=1)


def middle_and_reach(points: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return middle and reach of a flat shape's grid along both axes, (2,) each, mm.

    The grid is even as far as meshes stand on the shape, as half of what they hang over, and as half of the height of
    the lowest where none stands on it: what is far above throws soft shadows.

    Parameters
    ----------
    points : list of (vertices, 3) float
        Of each mesh, in the shape's frame, mm.
    """
    above = [p for p in points if p[:, 2].max() > 0.0] or points
    above = [np.column_stack([p[:, :2], np.maximum(p[:, 2], 0.0)]) for p in above]
    feet = [p[p[:, 2] <= p[:, 2].min() + _FOOT * np.ptp(p[:, 2]), :2] for p in above]
    low, high = (np.array([end(foot, axis=0) for foot in feet]) for end in (np.min, np.max))
    low, high = low.min(axis=0), high.max(axis=0)
    everything = np.concatenate(above)
    middle = 0.5 * (low + high)
    away = np.abs(everything[:, :2] - middle).max(axis=0)
    least = max(0.5 * everything[:, 2].min(), _LEAST * away.max(), np.finfo(np.float32).tiny)
    return middle, np.maximum(np.maximum(0.5 * (high - low), 0.5 * away), least)


class NodeHit(NamedTuple):
    """A hit for which the nodes about it are wanted."""

    u: float
    v: float
    triangle: int  # among those of all surfaces
    b: float
    c: float
    point: tuple[float, float, float]  # mm
    at: int  # where the numbers of the shape begin


@njit(cache=True, error_model="numpy")
def warped_place(offset):
    """Return the place of an offset in units of a grid's reach, see `warped`."""
    away = abs(offset)
    if away <= 1.0:
        return 0.5 * offset
    return 1.0 - 0.5 / away if offset > 0.0 else 0.5 / away - 1.0


@njit(cache=True)
def grid_place(column, row, columns, rows, wraps):
    """Return the four nodes about a place of a grid, and their weights."""
    y = min(max(row, 0.0), rows - 1.0)
    j = min(int(y), rows - 2)
    x = column if wraps else min(max(column, 0.0), columns - 1.0)
    i = int(np.floor(x)) if wraps else min(int(x), columns - 2)
    fx, fy = x - i, y - j
    left, right = i % columns, (i + 1) % columns
    at, below = j * columns, (j + 1) * columns
    weights = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    return (at + left, at + right, below + left, below + right), weights


@njit(cache=True)
def grid_size(grid, own):
    """Return the columns and rows of a shape's grid."""
    return np.int64(grid[own * GRID + COLUMNS]), np.int64(grid[own * GRID + ROWS])
