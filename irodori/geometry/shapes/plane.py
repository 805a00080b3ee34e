"""Endless planes."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from irodori.geometry.embree import Primitive, oriented_disc
from irodori.geometry.mesh import Mesh
from irodori.geometry.shapes import flat
from irodori.geometry.shapes.flat import (
    FlatShape,
    flat_point,
    flat_texture,
    frame_axes,
    nodes_about_flat,
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

#: An endless plane is a disc of this radius: its edge is nearer to the horizon than single precision tells.
RADIUS_MM = 1e12
#: Half the side of the square that stands for the plane, over the reach of what stands about it.
_CUT = 100.0


@njit(cache=True, forceinline=True)
def _surface_at(surfaces, index, ray, point, normal, facet):
    onto_plane(surfaces, index, point, normal, facet)
    return 0.5, 0.5


@njit(cache=True)
def hidden_by_plane(cosine):
    """Return the share that an endless plane hides, by the cosine between the point's normal and its own."""
    return 0.5 * (1.0 - cosine)


@njit(cache=True)
def _hides(row, at, x, y, z, normal):
    facing = frame_axes(row, at)[2]
    cosine = normal[0] * facing[0] + normal[1] * facing[1] + normal[2] * facing[2]
    if x * facing[0] + y * facing[1] + z * facing[2] >= 0.0:
        return hidden_by_plane(-cosine), (0.0, 0.0, 0.0)
    return hidden_by_plane(cosine), facing


@njit(cache=True, forceinline=True)
def distance_to_plane(row, at, centre, direction):
    """Return distances along rays to a shape's plane, negative behind them; not a number in the plane."""
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
    """All of z = 0; everywhere it has the middle of its texture."""

    name = "plane"
    schema = SCHEMA
    is_endless = True
    kernels = Kernels(
        surface_at=_surface_at,
        hides=_hides,
        distance=_distance,
        may_be_met=None,
        point=flat_point,
        texture=flat_texture,
        nodes_about=nodes_about_flat,
    )

    @classmethod
    def from_block(cls, block: "PlaneShape") -> "Plane":
        """Return the plane; there is but one."""
        return cls()

    @property
    def size_mm(self) -> tuple[float, float]:
        """None."""
        return 0.0, 0.0

    @property
    def reach_mm(self) -> float:
        """None, see `irodori.geometry.shapes.placement.reaches`."""
        return 0.0

    def frame_origin(self, placement: Placement) -> np.ndarray:
        """Return the point that is nearest to the world's origin, from which all places are rounded least."""
        axis = placement.rotation[:, 2]
        return (placement.translation_mm @ axis) * axis

    def primitive(self, placement: Placement) -> Primitive:
        """Return a disc whose edge nobody sees."""
        return oriented_disc(self.frame_origin(placement), placement.rotation[:, 2], RADIUS_MM)

    def facetted(self, reach_mm: float) -> Mesh:
        """Return a square whose middle is the origin, a hundred times as far to its sides as what stands on it."""
        return rectangle(_CUT * reach_mm, _CUT * reach_mm)

    def samples(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the origin."""
        return np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])

    def texture_per_mm(self, scale: float) -> tuple[float, float]:
        """None: one place of the texture is everywhere."""
        return 0.0, 0.0

    def grid_ends(self, axis: int, scale: float, middle_mm: float, reach_mm: float) -> np.ndarray:
        """Return the ends of all places, but half a node."""
        return np.array([-1.0, 1.0]) * (1.0 - 1.0 / flat.FLAT_SIDE)
