"""Nodes: points of a surface at which the light of a light map is found, and between which it is interpolated."""

from dataclasses import dataclass

import numpy as np

from irodori.jit.compilation import njit

#: Height of nodes above the surface, relative to their coordinates or their shape's reach; hits have the same.
_RISE = 2.0**-18


@dataclass(frozen=True)
class Nodes:
    """Nodes of a mesh, in the world.

    Parameters
    ----------
    origin : (n, 3) float64
        Origins of rays, mm.
    normal, facet : (n, 3) float64
        Unit shading normals, and unit geometric normals.
    cells : (c, 3) int
        Groups of nodes between which values are interpolated.
    parts : (triangles,) int32
        Number of parts into which each edge of a triangle is divided.
    corners : (places,) int32
        Nodes at the points of each divided triangle in turn, row by row from the first edge.
    """

    origin: np.ndarray
    normal: np.ndarray
    facet: np.ndarray
    cells: np.ndarray
    parts: np.ndarray
    corners: np.ndarray


#: Share of a mesh's height, from its lowest point, that counts as its foot.
_FOOT = 0.1
#: Smallest reach of a grid along an axis, relative to the largest distance of the shapes above it.
_LEAST = 0.02


def unwarped(place: np.ndarray) -> np.ndarray:
    """Map places -1..1 to offsets in units of the reach; the inverse of `warped_place`."""
    left = np.maximum(1.0 - np.abs(place), 1e-12)
    return np.where(np.abs(place) <= 0.5, 2.0 * place, np.sign(place) * 0.5 / left)


def raised(point: np.ndarray, facet: np.ndarray, reach_mm: float) -> np.ndarray:
    """Lift points, (n, 3) mm, along their geometric normals by more than the rounding errors of single precision."""
    size = np.maximum(np.abs(point).max(axis=-1, keepdims=True), reach_mm)
    return point + _RISE * size * facet


def quadrangles(number: np.ndarray) -> np.ndarray:
    """Return the cells of a grid of nodes, (c, 4); ``number`` has the node at each row and column."""
    corners = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    return np.stack([corner.ravel() for corner in corners], axis=1)


def middle_and_reach(points: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return middle and reach of the grid of a flat shape along both axes, (2,) each, mm.

    Within the reach, the grid is regular. The reach covers the feet of the meshes on the shape, and half the extent of
    the meshes. It is at least half the height of the lowest mesh, because shapes far above cast soft shadows.

    Parameters
    ----------
    points : list of (vertices, 3) float
        Vertices of each mesh, in the frame of the flat shape, mm.
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


def extend_to_closed(values: np.ndarray, is_open: np.ndarray, cells: np.ndarray) -> None:
    """Replace the values of nodes that are not in the open by the mean of open nodes in the same cells, if any.

    Parameters
    ----------
    values : (n, k) float
    is_open : (n,) bool
        Whether a node lies in the open, not inside or behind another surface.
    cells : (c, 3 or 4) int
        Groups of nodes between which values are interpolated.
    """
    opens = is_open[cells]
    mixed = opens.any(axis=1) & ~opens.all(axis=1)
    cells, opens = cells[mixed], opens[mixed]
    total, count = np.zeros(values.shape), np.zeros(len(values))
    mean = np.einsum("ck,ckj->cj", opens.astype(np.float64), values[cells]) / opens.sum(axis=1, keepdims=True)
    for corner in range(cells.shape[1]):
        shut = ~opens[:, corner]
        np.add.at(total, cells[shut, corner], mean[shut])
        np.add.at(count, cells[shut, corner], 1.0)
    filled = count > 0.0
    values[filled] = total[filled] / count[filled, None]


@njit(cache=True, error_model="numpy")
def warped_place(offset):
    """Map an offset, in units of the reach, to -1..1: linear to -0.5..0.5 within the reach, compressed outside."""
    away = abs(offset)
    if away <= 1.0:
        return 0.5 * offset
    return 1.0 - 0.5 / away if offset > 0.0 else 0.5 / away - 1.0
