"""Shapes with a texture parametrisation: plate and sphere, and where they stand.

A texture has `height` rows and `width` columns; texel (row, column) has u = (column + 0.5) / width and
v = (row + 0.5) / height. Object frame, mm: a plate lies in z = 0 with its face up, u along +x and v along -y (so that
the texture reads as seen from above); a sphere is centred at the origin, v runs from the pole +z to -z and u is the
azimuth from +x towards +y over 2π.
"""

import math
from dataclasses import dataclass, field

import numba
import numpy as np

PLATE, SPHERE = 0, 1
PLATE_THICKNESS_MM = 2.0


@dataclass(frozen=True)
class Shape:
    """A plate or a sphere.

    Parameters
    ----------
    kind : int
        `PLATE` or `SPHERE`.
    size_mm : (2,) tuple
        Width and height of a plate; radius twice of a sphere.
    """

    kind: int
    size_mm: tuple[float, float]

    @classmethod
    def from_definition(cls, shape: dict) -> "Shape":
        """Return the shape of a configuration's `shape` block."""
        if shape["kind"] == "plate":
            return cls(PLATE, (float(shape["width_mm"]), float(shape["height_mm"])))
        if shape["kind"] == "sphere":
            return cls(SPHERE, (float(shape["radius_mm"]), float(shape["radius_mm"])))
        raise ValueError(f"unknown shape {shape['kind']!r}; accepted: plate, sphere")

    @property
    def table_height_mm(self) -> float:
        """Height of the table's top under the shape when its centre (sphere) or face (plate) is at the origin."""
        return -self.size_mm[0] if self.kind == SPHERE else -PLATE_THICKNESS_MM

    @property
    def reach_mm(self) -> float:
        """Largest distance of a point of the shape from its centre, mm."""
        return self.size_mm[0] if self.kind == SPHERE else math.hypot(*self.size_mm) / 2.0

    def texels(self, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (height, width, 3) in mm and unit normals (height, width, 3) of the texel centres."""
        u = (np.arange(width) + 0.5) / width
        v = (np.arange(height) + 0.5) / height
        u, v = np.meshgrid(u, v)
        if self.kind == PLATE:
            position = np.stack([(u - 0.5) * self.size_mm[0], (0.5 - v) * self.size_mm[1], np.zeros_like(u)], axis=-1)
            return position, np.broadcast_to(np.array([0.0, 0.0, 1.0]), position.shape).copy()
        theta, azimuth = np.pi * v, 2 * np.pi * u
        normal = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)
        return self.size_mm[0] * normal, normal


@numba.njit(cache=True, error_model="numpy")
def uv_from_point(kind, size_x, size_y, x, y, z):
    """Return texture coordinates u, v in 0..1 of a point on the surface, object frame, mm."""
    if kind == PLATE:
        return x / size_x + 0.5, 0.5 - y / size_y
    u = math.atan2(y, x) / (2.0 * math.pi)
    v = math.atan2(math.sqrt(x * x + y * y), z) / math.pi
    return (u if u >= 0.0 else u + 1.0), v


@dataclass(frozen=True)
class Placement:
    """A shape standing in a world: ``world = scale * rotation @ object + translation``.

    Parameters
    ----------
    shape : Shape
    rotation : (3, 3) float, world_from_object
    translation_mm : (3,) float
    scale : float
    """

    shape: Shape
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    translation_mm: np.ndarray = field(default_factory=lambda: np.zeros(3))
    scale: float = 1.0

    def points(self, position: np.ndarray) -> np.ndarray:
        """Return world positions of object-frame positions, (..., 3) mm."""
        return self.scale * (position @ self.rotation.T) + self.translation_mm

    def corners(self) -> np.ndarray:
        """Return the four corners (4, 3) of a plate in the world, counter-clockwise seen from its face."""
        half_x, half_y = self.shape.size_mm[0] / 2, self.shape.size_mm[1] / 2
        signs = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
        return self.points(signs * [half_x, half_y, 0.0])


def on_table(shape: Shape, rotation: np.ndarray, table_radius_mm: float) -> list[Placement]:
    """Return an object (shape 0) on the rig's table (shape 1, a square; absent for radius 0) in the rig's frame."""
    placements = [Placement(shape, rotation)]
    if table_radius_mm > 0:
        top = Shape(PLATE, (2 * table_radius_mm, 2 * table_radius_mm))
        placements.append(Placement(top, rotation, rotation @ np.array([0.0, 0.0, shape.table_height_mm])))
    return placements
