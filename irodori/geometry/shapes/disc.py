"""Discs."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from irodori.geometry.embree import Primitive, oriented_disc
from irodori.geometry.mesh import Mesh, make_mesh
from irodori.geometry.shapes.flat import (
    FlatShape,
    flat_point,
    flat_texture,
    surface_at_flat,
)
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.plane import distance_to_plane
from irodori.geometry.shapes.shape import Kernels
from irodori.geometry.shapes.shape_rows import RADIUS
from irodori.jit.compilation import njit
from irodori.jit.functions import select

if TYPE_CHECKING:
    from irodori.config.models import DiscShape

IS_FLAT = True
SCHEMA = {
    "scene": {
        "title": "DiscShape",
        "type": "object",
        "additionalProperties": False,
        "required": ["kind", "radius_mm"],
        "properties": {
            "kind": {
                "const": "disc",
                "description": "A flat disc that faces +z before it is turned; black behind unless a sheet.",
            },
            "radius_mm": {
                "type": "number",
                "exclusiveMinimum": 0,
                "maximum": 1.0e6,
                "description": "Radius, in mm.",
            },
        },
    }
}

#: Number of sides of the polygon that approximates a disc.
_SIDES = 128


@njit(cache=True, forceinline=True)
def _distance(row, at, centre, direction, along):
    distance, radius = distance_to_plane(row, at, centre, direction), row[at + RADIUS]
    x, y, z = (
        distance * direction[0] - centre[0],
        distance * direction[1] - centre[1],
        distance * direction[2] - centre[2],
    )
    return select((distance >= 0.0) & (x * x + y * y + z * z < radius * radius), distance, np.inf)


@dataclass(frozen=True)
class Disc(FlatShape):
    """A disc centred on the origin; its texture covers the square around it.

    Parameters
    ----------
    radius_mm : float
    """

    radius_mm: float

    name = "disc"
    schema = SCHEMA
    is_endless = False
    kernels = Kernels(
        surface_at=surface_at_flat,
        distance=_distance,
        may_be_met=None,
        point=flat_point,
        texture=flat_texture,
    )

    @classmethod
    def from_block(cls, block: "DiscShape") -> "Disc":
        """Return the disc with the radius given in a configuration block."""
        return cls(float(block.radius_mm))

    @property
    def size_mm(self) -> tuple[float, float]:
        """The diameter, for both sides."""
        return 2.0 * self.radius_mm, 2.0 * self.radius_mm

    @property
    def reach_mm(self) -> float:
        """The radius."""
        return self.radius_mm

    def primitive(self, placement: Placement) -> Primitive:
        """Return Embree's disc, which is exact."""
        return oriented_disc(placement.translation_mm, placement.rotation[:, 2], self.radius_mm * placement.scale)

    def facetted(self, reach_mm: float) -> Mesh:
        """Return a polygon with 128 sides; its edges are at most 0.03 % of the radius inside the rim."""
        angle = 2.0 * np.pi * np.arange(_SIDES + 1) / _SIDES
        rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        rim[-1] = rim[0]
        flat = np.stack([np.zeros_like(rim[1:]), rim[:-1], rim[1:]], axis=1)
        corners = self.radius_mm * np.concatenate([flat, np.zeros((_SIDES, 3, 1))], axis=2)
        return make_mesh(corners, 0.5 + flat * [0.5, -0.5])

    def samples(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the centre and four points of the rim, where the angles of the camera differ most."""
        position = self.radius_mm * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], dtype=float)
        return position, np.tile([0.0, 0.0, 1.0], (len(position), 1))
