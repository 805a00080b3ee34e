"""Plates: flat rectangles."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from irodori.geometry.embree import Primitive, triangles
from irodori.geometry.shapes.flat import (
    FlatShape,
    flat_point,
    flat_texture,
    surface_at_flat,
)
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.plane import distance_to_plane
from irodori.geometry.shapes.shape import Kernels
from irodori.geometry.shapes.shape_rows import TURN, WIDE
from irodori.jit.compilation import njit
from irodori.jit.functions import magnitude, select

if TYPE_CHECKING:
    from irodori.config.models import PlateShape

IS_FLAT = True
SCHEMA = {
    "object": {
        "title": "PlateShape",
        "type": "object",
        "additionalProperties": False,
        "required": ["kind", "width_mm", "height_mm"],
        "properties": {
            "kind": {
                "const": "plate",
                "description": "A flat rectangle on the table, its centre at the origin of the rig.",
            },
            "width_mm": {
                "type": "number",
                "exclusiveMinimum": 0,
                "maximum": 10000,
                "description": "Size along x, in mm.",
            },
            "height_mm": {
                "type": "number",
                "exclusiveMinimum": 0,
                "maximum": 10000,
                "description": "Size along y, in mm.",
            },
        },
    },
    "scene": {
        "title": "PlateShape",
        "type": "object",
        "additionalProperties": False,
        "required": ["kind", "width_mm", "height_mm"],
        "properties": {
            "kind": {
                "const": "plate",
                "description": "A flat rectangle that faces +z before it is turned; black behind unless a sheet.",
            },
            "width_mm": {
                "type": "number",
                "exclusiveMinimum": 0,
                "maximum": 1.0e6,
                "description": "Size along x, in mm.",
            },
            "height_mm": {
                "type": "number",
                "exclusiveMinimum": 0,
                "maximum": 1.0e6,
                "description": "Size along y, in mm.",
            },
        },
    },
}


@njit(cache=True, forceinline=True)
def _distance(row, at, centre, direction, along):
    x, y, z = centre
    dx, dy, dz = direction
    distance = distance_to_plane(row, at, centre, direction)
    within = distance >= 0.0
    for axis in range(2):
        a, b, c = row[at + TURN + axis], row[at + TURN + axis + 3], row[at + TURN + axis + 6]
        across = (distance * dx - x) * a + (distance * dy - y) * b + (distance * dz - z) * c
        within = within & (magnitude(across) * row[at + WIDE + axis] <= 0.5)
    return select(within, distance, np.inf)


@dataclass(frozen=True)
class Plate(FlatShape):
    """A rectangle centred on the origin.

    Parameters
    ----------
    width_mm, height_mm : float
        Sides along x and y.
    """

    width_mm: float
    height_mm: float

    name = "plate"
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
    def from_block(cls, block: "PlateShape") -> "Plate":
        """Return the plate with the sides given in a configuration block."""
        return cls(float(block.width_mm), float(block.height_mm))

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height."""
        return self.width_mm, self.height_mm

    @property
    def reach_mm(self) -> float:
        """Half the diagonal."""
        return math.hypot(self.width_mm, self.height_mm) / 2.0

    def primitive(self, placement: Placement) -> Primitive:
        """Return two triangles for Embree."""
        return triangles(placement.corners(), np.array([[0, 1, 2], [0, 2, 3]]))

    def samples(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the centre and the corners.

        A plate has one normal, but the camera is near: the viewing angles of its corners differ by some degrees, so a
        pose that suits the centre may exceed the largest angle at a corner.
        """
        signs = np.array([[0, 0, 0], [-1, -1, 0], [-1, 1, 0], [1, -1, 0], [1, 1, 0]])
        position = signs * [self.width_mm / 2, self.height_mm / 2, 0.0]
        return position, np.tile([0.0, 0.0, 1.0], (len(position), 1))
