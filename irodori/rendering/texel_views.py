"""Views from the texels of light maps: rays from each of them into the cells of the sphere."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.geometry.embree import NO_HIT, Tracer, hit_distance, hit_shape, new_ray, trace
from irodori.geometry.shapes.placement import Placement, reaches
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit
from irodori.rendering.light_cells import CELLS, POOL, cell_directions, cell_vectors
from irodori.rendering.map_layouts import Points

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

#: Rays from a texel in each cell.
RAYS = 2
#: A texel is inside another object if this share of its rays meets surfaces from behind.
_ENCLOSED = 0.9
_TOGETHER, _CHUNK = 1024, 16  # texels that are traced at a time, in all and by a thread


class Links(NamedTuple):
    """Places of other surfaces that texels see."""

    texel: np.ndarray  # (n,) number of the texel
    shape: np.ndarray  # (n,) side of a shape that is seen
    place: np.ndarray  # (n, 3) mm
    way: np.ndarray  # (n, 3) mm from the texel to the place
    weight: np.ndarray  # (n,) float32 share of the light from there in that of the texel


class TexelView(NamedTuple):
    """Surroundings as some texels see them.

    ``hidden`` is the share of each cell that is hidden, times the weight of its light. The other arrays except
    ``is_open`` belong to its stored entries, of which an enclosed object has a thousand for each texel, so that they
    take few bytes each.
    """

    hidden: "csr_matrix"  # (texels, cells)
    shape: np.ndarray  # (entries,) int16 side of a shape that is seen in the cell, or `NO_HIT`
    distance: np.ndarray  # (entries,) float32 mm to it
    direction: np.ndarray  # (entries,) uint8 direction of the pool
    is_open: np.ndarray  # (texels,) bool whether they lie outside all other objects

    def links(self, points: Points) -> Links:
        """Return what the texels, which are at these points, see of other surfaces."""
        entry = np.flatnonzero(self.shape != NO_HIT)
        cell = self.hidden.indices[entry]
        texel = np.repeat(np.arange(len(self.is_open)), np.diff(self.hidden.indptr))[entry]
        way = self.distance[entry, None] * cell_directions()[cell, self.direction[entry]]
        cosine = np.maximum((points.normal[texel] * cell_vectors()[cell]).sum(axis=1), 0.0)
        weight = (self.hidden.data[entry] * cosine / np.pi).astype(np.float32)
        single = (points.point[texel] + way).astype(np.float32), way.astype(np.float32)
        return Links(texel, self.shape[entry], *single, weight)

    def weighted(self, normal: np.ndarray, weight: Callable[[np.ndarray], np.ndarray]) -> "TexelView":
        """Return the view with shares of cells times a weight of light by the cosine to the texels' normals, (n, 3)."""
        texel, vector = np.repeat(np.arange(len(self.is_open)), np.diff(self.hidden.indptr)), cell_vectors()
        unit = vector / np.linalg.norm(vector, axis=1, keepdims=True)
        cosine = (normal[texel] * unit[self.hidden.indices]).sum(axis=1)
        hidden = self.hidden.copy()
        hidden.data = (hidden.data * weight(np.clip(cosine, 0.0, 1.0))).astype(np.float32)
        return self._replace(hidden=hidden)


class _Bounds(NamedTuple):
    """Bounds of the shapes, so that most rays that meet nothing are not traced."""

    centre: np.ndarray  # (shapes, 3) mm
    radius: np.ndarray  # (shapes,) mm; infinite for endless shapes
    normal: np.ndarray  # (shapes, 3) of flat shapes, else zeros
    is_own: np.ndarray  # (shapes,) whether a texel of the shape may see the shape itself
    has_inside: np.ndarray  # (shapes,) whether a ray that meets a back comes from inside
    behind: np.ndarray  # (shapes,) the back of a sheet, or -1


class _Seen(NamedTuple):
    """Surfaces that texels see in each cell, filled by `_look_some`."""

    hidden: np.ndarray  # (n, cells) float32 share of a cell above the horizon that is hidden
    shape: np.ndarray  # (n, cells) int16 side of a shape that is seen, or `NO_HIT`
    distance: np.ndarray  # (n, cells) float32 mm
    place: np.ndarray  # (n, cells) uint8 direction of the pool
    is_open: np.ndarray  # (n,) bool whether a texel lies outside all other objects


class _Casting(NamedTuple):
    """Scene into which rays are traced from the texels of one shape."""

    intersect: int
    scene: int
    bounds: _Bounds
    shape: int
    direction: np.ndarray  # (cells, pool, 3)
    first: int  # number of the first texel


@njit(cache=True, error_model="numpy")
def _may_meet(bounds, own, origin, direction):
    """Return whether a ray may meet any shape, by the bounding spheres and the planes of flat shapes."""
    for shape in range(bounds.radius.size):
        if shape == own and not bounds.is_own[shape]:
            continue
        along = square = height = steep = 0.0
        for axis in range(3):
            away = bounds.centre[shape, axis] - origin[axis]
            along += away * direction[axis]
            square += away * away
            height += away * bounds.normal[shape, axis]
            steep += direction[axis] * bounds.normal[shape, axis]
        if height * steep < 0.0:
            continue  # away from the plane of a flat shape
        radius = bounds.radius[shape]
        if square <= radius * radius or (along > 0.0 and square - along * along <= 1.001 * radius * radius):
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _look_some(casting, points, seen, first, last):
    """Trace rays from the texels from ``first`` to before ``last`` of a shape and fill a `_Seen`."""
    ray, bounds, (point, normal, facet) = new_ray(), casting.bounds, points
    for texel in range(first, last):
        everywhere = behind = 0
        shift = (casting.first + texel) * RAYS
        for cell in range(CELLS):
            above = hidden = 0
            seen.shape[texel, cell] = NO_HIT
            for number in range(RAYS):
                place = (shift + number) % POOL
                direction = casting.direction[cell, place]
                rise = height = 0.0
                for axis in range(3):
                    rise += direction[axis] * normal[texel, axis]
                    height += direction[axis] * facet[texel, axis]
                if rise <= 0.0:
                    continue
                above += 1
                if height <= 0.0:
                    hidden += 1
                    continue
                if not _may_meet(bounds, casting.shape, point[texel], direction):
                    continue
                trace(casting.intersect, casting.scene, ray, point[texel], direction, np.inf)
                shape = hit_shape(ray)
                if shape == NO_HIT:
                    continue
                hidden += 1
                towards = 0.0
                for axis in range(3):
                    towards += ray.f[ray.at + 12 + axis] * direction[axis]
                if towards < 0.0 or bounds.behind[shape] >= 0:
                    seen.shape[texel, cell] = shape if towards < 0.0 else bounds.behind[shape]
                    seen.distance[texel, cell] = hit_distance(ray)
                    seen.place[texel, cell] = place
                elif bounds.has_inside[shape]:
                    behind += 1
            everywhere += above
            seen.hidden[texel, cell] = hidden / above if above > 0 else 0.0
        seen.is_open[texel] = behind < _ENCLOSED * everywhere


def _bounds(placements: Sequence[Placement], behind: np.ndarray) -> _Bounds:
    """Return the bounds of placed shapes."""
    radius = np.array([np.inf if p.shape.is_endless else reach * (1.0 + 1e-5)
                       for p, reach in zip(placements, reaches(placements), strict=True)])  # fmt: skip
    return _Bounds(
        np.stack([p.shape.frame_origin(p) for p in placements]).astype(np.float64),
        radius,
        np.stack([p.rotation[:, 2] if p.shape.is_flat else np.zeros(3) for p in placements]),
        np.array([not p.shape.is_convex for p in placements]),
        np.array([p.shape.has_inside or p.shape.triangles is not None for p in placements]),
        behind,
    )


def look_around(tracer: Tracer, points: Points, index: int, behind: np.ndarray, start: int = 0) -> list[TexelView]:
    """Trace rays from points of an object; return the views of some texels after the other.

    Parameters
    ----------
    tracer : Tracer
    points : Points
        Points raised above the surface, float64 and contiguous.
    index : int
        Number of the placed shape.
    behind : (shapes,) int
        The side that is the back of each shape, -1 if it is black from behind.
    start : int
        Selects other directions in the cells.
    """
    from scipy.sparse import csr_matrix

    bounds, pool, found = _bounds(tracer.placements, behind), cell_directions(), []
    for first in range(0, len(points.point), _TOGETHER):
        some = Points(*(values[first : first + _TOGETHER] for values in points))
        count = len(some.point)
        hides, shape, distance, place = (
            np.zeros((count, CELLS), kind) for kind in (np.float32, np.int16, np.float32, np.uint8)
        )
        seen = _Seen(hides, shape, distance, place, np.zeros(count, np.bool_))
        rays = tracer.intersect_address, tracer.scene
        casting = _Casting(*rays, bounds, index, pool, start + first)
        run_chunks(_look_some, count, _CHUNK, casting, some, seen)
        stored = hides != 0.0  # in the order of the entries
        found.append(TexelView(csr_matrix(hides), shape[stored], distance[stored], place[stored], seen.is_open))
    return found
