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
    frame_axes,
    nodes_about_flat,
    surface_at_flat,
)
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.plane import distance_to_plane
from irodori.geometry.shapes.shape import Kernels
from irodori.geometry.shapes.shape_rows import HIGH, TURN, WIDE
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
                "description": "A flat rectangle that faces +z before it is turned, and is black behind.",
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

_CORNERS = 4


@njit(cache=True, error_model="numpy")
def _edge(normal, a, b):
    """Return the term of an edge in Lambert's formula.

    It is the angle that the edge spans as seen from the point, times the cosine between the surface normal and the
    normal of the plane through edge and point.
    """
    cx, cy, cz = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    sine = math.sqrt(cx * cx + cy * cy + cz * cz)
    if sine <= 0.0:
        return 0.0
    angle = math.atan2(sine, a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
    return angle * (normal[0] * cx + normal[1] * cy + normal[2] * cz) / sine


@njit(cache=True, error_model="numpy")
def hidden_by_corners(normal, corners):
    """Return the share of the cosine-weighted hemisphere that a flat quadrilateral hides.

    Parameters
    ----------
    normal : tuple of 3 float
        Unit normal at the point.
    corners : tuple of 4 tuples of 3 float
        Corners relative to the point, in order around the polygon, mm. The part below the horizon is cut off.
    """
    found = 0.0
    first = last = (0.0, 0.0, 0.0)
    begun = False
    for number in range(_CORNERS):
        a, b = corners[number], corners[(number + 1) % _CORNERS]
        ha = a[0] * normal[0] + a[1] * normal[1] + a[2] * normal[2]
        hb = b[0] * normal[0] + b[1] * normal[1] + b[2] * normal[2]
        if ha <= 0.0 and hb <= 0.0:
            continue
        if ha * hb < 0.0:
            part = ha / (ha - hb)
            middle = (a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1]), a[2] + part * (b[2] - a[2]))
            start, end = (a, middle) if ha > 0.0 else (middle, b)
        else:
            start, end = a, b
        if begun:
            # Along the horizon between two edges that were cut; of zero length otherwise.
            found += _edge(normal, last, start)
        else:
            first, begun = start, True
        found += _edge(normal, start, end)
        last = end
    if begun:
        found += _edge(normal, last, first)
    return abs(found) / (2.0 * math.pi)


@njit(cache=True)
def _plate_corner(row, at, centre, sign_u, sign_v):
    x, y, z = centre
    u, v = sign_u * 0.5 / row[at + WIDE], sign_v * 0.5 / row[at + HIGH]
    return (
        x + u * row[at + TURN] + v * row[at + TURN + 1],
        y + u * row[at + TURN + 3] + v * row[at + TURN + 4],
        z + u * row[at + TURN + 6] + v * row[at + TURN + 7],
    )


@njit(cache=True, error_model="numpy")
def _hides(row, at, x, y, z, normal):
    facing = frame_axes(row, at)[2]
    if x * facing[0] + y * facing[1] + z * facing[2] >= 0.0:
        facing = (0.0, 0.0, 0.0)
    corners = (
        _plate_corner(row, at, (x, y, z), -1.0, -1.0),
        _plate_corner(row, at, (x, y, z), 1.0, -1.0),
        _plate_corner(row, at, (x, y, z), 1.0, 1.0),
        _plate_corner(row, at, (x, y, z), -1.0, 1.0),
    )
    return hidden_by_corners(normal, corners), facing


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
        hides=_hides,
        distance=_distance,
        may_be_met=None,
        point=flat_point,
        texture=flat_texture,
        nodes_about=nodes_about_flat,
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
