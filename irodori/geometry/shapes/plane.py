"""Endless planes."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from irodori.geometry.embree import Primitive, oriented_disc
from irodori.geometry.mesh import Mesh
from irodori.geometry.shapes.flat import (
    FlatShape,
    flat_point,
    flat_texture,
    onto_plane,
    rectangle,
)
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Kernels
from irodori.geometry.shapes.shape_rows import TURN
from irodori.jit.compilation import njit
from irodori.jit.functions import select

if TYPE_CHECKING:
    from irodori.config.models import PlaneShape

IS_FLAT = True
SCHEMA = {
    "scene": {
        "title": "PlaneShape",
        "type": "object",
        "additionalProperties": False,
        "required": ["kind"],
        "properties": {
            "kind": {
                "const": "plane",
                "description": "An endless plane, a floor unless it is turned; it faces +z before, and is black "
                "behind.",
            }
        },
    }
}

#: Radius of the disc that represents an endless plane: in single precision, its edge coincides with the horizon.
RADIUS_MM = 1e12
#: Half the side of the square that approximates the plane, relative to the reach of the shapes on it.
_CUT = 100.0


@njit(cache=True, forceinline=True)
def _surface_at(surfaces, index, ray, point, normal, facet):
    onto_plane(surfaces, index, point, normal, facet)
    return 0.5, 0.5


@njit(cache=True, forceinline=True)
def distance_to_plane(row, at, centre, direction):
    """Return distances along rays to the plane of a shape; negative behind the origin, NaN for rays in the plane."""
    x, y, z = centre
    dx, dy, dz = direction
    nx, ny, nz = row[at + TURN + 2], row[at + TURN + 5], row[at + TURN + 8]
    return (x * nx + y * ny + z * nz) / (dx * nx + dy * ny + dz * nz)


@njit(cache=True, forceinline=True)
def _distance(row, at, centre, direction, along):
    distance = distance_to_plane(row, at, centre, direction)
    return select((distance >= 0.0) & (distance < RADIUS_MM), distance, np.inf)


@dataclass(frozen=True)
class Plane(FlatShape):
    """The endless plane z = 0; the centre of its texture applies everywhere."""

    name = "plane"
    schema = SCHEMA
    is_endless = True
    kernels = Kernels(
        surface_at=_surface_at,
        distance=_distance,
        may_be_met=None,
        point=flat_point,
        texture=flat_texture,
    )

    @classmethod
    def from_block(cls, block: "PlaneShape") -> "Plane":
        """Return the plane; it has no parameters."""
        return cls()

    @property
    def size_mm(self) -> tuple[float, float]:
        """Zeros, because the plane has no size."""
        return 0.0, 0.0

    @property
    def reach_mm(self) -> float:
        """Zero; `irodori.geometry.shapes.placement.reaches` replaces it by the reach of other shapes."""
        return 0.0

    def frame_origin(self, placement: Placement) -> np.ndarray:
        """Return the point of the plane nearest to the world's origin, which minimises rounding errors."""
        axis = placement.rotation[:, 2]
        return (placement.translation_mm @ axis) * axis

    def primitive(self, placement: Placement) -> Primitive:
        """Return a disc so large that its edge is never visible."""
        return oriented_disc(self.frame_origin(placement), placement.rotation[:, 2], RADIUS_MM)

    def facetted(self, reach_mm: float) -> Mesh:
        """Return a square centred on the origin, with half a side of 100 times the reach of the shapes on it."""
        return rectangle(_CUT * reach_mm, _CUT * reach_mm)

    def samples(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the origin, with the normal +z."""
        return np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])

    def texture_per_mm(self, scale: float) -> tuple[float, float]:
        """Return zeros, because the whole plane has the same texture coordinates."""
        return 0.0, 0.0
