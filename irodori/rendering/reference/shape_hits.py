"""What a ray meets: by the formulas of a few simple shapes, else by Embree.

For spheres, plates and discs, a loop over their formulas in double precision takes less time than a call of Embree, if
there are few. Scenes with a mesh, or with many shapes, are left to Embree as a whole.
"""

from collections.abc import Sequence

import numpy as np

from irodori.geometry.embree import NO_HIT, is_blocked, trace
from irodori.geometry.shape_dispatch import chain
from irodori.geometry.shape_registry import number_of
from irodori.geometry.shapes.placement import Placement, reaches
from irodori.geometry.shapes.shape_rows import CENTRE, SHAPE, shape_row
from irodori.jit.compilation import uncounted

#: Largest number of shapes whose formulas are tried one after the other.
_MOST = 12

_distance = chain("distance", "row, at, centre, direction, along", __name__, forceinline=True)


def shape_rows(placements: Sequence[Placement]) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of the shapes' kinds, (n,) int64, and their rows, (n * SHAPE,); empty if Embree traces."""
    simple = all(placement.shape.kernels.distance is not None for placement in placements)
    if not simple or len(placements) > _MOST:
        return np.zeros(0, np.int64), np.zeros(0)
    kinds = np.array([number_of(placement.shape) for placement in placements], dtype=np.int64)
    own = zip(placements, reaches(placements), kinds, strict=True)
    return kinds, np.concatenate([shape_row(*one, dtype=np.float64) for one in own])


@uncounted(forceinline=True, error_model="numpy")
def _distance_of(world, shape, origin, direction):
    """Return the distance along a ray to one shape, mm; infinite or NaN if it is not met."""
    rows, at = world.shape_rows, shape * SHAPE
    x, y, z = rows[at + CENTRE] - origin[0], rows[at + CENTRE + 1] - origin[1], rows[at + CENTRE + 2] - origin[2]
    d = direction[0], direction[1], direction[2]
    return _distance(world.shape_kinds[shape], rows, at, (x, y, z), d, x * d[0] + y * d[1] + z * d[2])


@uncounted(forceinline=True)
def meet(world, ray, origin, direction):
    """Find the nearest hit of a ray; `irodori.geometry.embree.hit_shape` and ``hit_distance`` read it."""
    count = world.shape_kinds.size
    if count == 0:
        trace(world.intersect, world.scene, ray, origin, direction, np.inf)
        return
    nearest = np.inf
    ray.i[ray.at + 18] = NO_HIT
    for shape in range(count):
        distance = _distance_of(world, shape, origin, direction)
        if distance < nearest:
            nearest = distance
            ray.i[ray.at + 18] = shape
    ray.f[ray.at + 8] = nearest


@uncounted(forceinline=True)
def is_hidden(world, ray, origin, direction):
    """Return whether a ray meets anything."""
    count = world.shape_kinds.size
    if count == 0:
        trace(world.occluded, world.scene, ray, origin, direction, np.inf)
        return is_blocked(ray)
    for shape in range(count):  # noqa: SIM110  `any` is not compiled
        if _distance_of(world, shape, origin, direction) < np.inf:
            return True
    return False
