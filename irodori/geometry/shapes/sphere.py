"""Spheres."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from irodori.geometry.atlas import Texels
from irodori.geometry.embree import Primitive, sphere_point
from irodori.geometry.mesh import Mesh, make_mesh
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Kernels, Shape, in_frame, texel_centres
from irodori.geometry.shapes.shape_rows import RADIUS
from irodori.geometry.shapes.surface_nodes import quadrangles
from irodori.jit.compilation import njit
from irodori.jit.functions import lower_of, magnitude, root, select, upper_of, with_sign

if TYPE_CHECKING:
    from irodori.config.models import SphereShape

IS_FLAT = False
SCHEMA = {
    "object": {
        "title": "SphereShape",
        "type": "object",
        "additionalProperties": False,
        "required": ["kind", "radius_mm"],
        "properties": {
            "kind": {"const": "sphere", "description": "A sphere, its centre at the origin of the rig."},
            "radius_mm": {
                "type": "number",
                "exclusiveMinimum": 0,
                "maximum": 10000,
                "description": "Radius, in mm.",
            },
        },
    },
    "scene": {
        "title": "SphereShape",
        "type": "object",
        "additionalProperties": False,
        "required": ["kind", "radius_mm"],
        "properties": {
            "kind": {"const": "sphere", "description": "A sphere."},
            "radius_mm": {
                "type": "number",
                "exclusiveMinimum": 0,
                "maximum": 1.0e6,
                "description": "Radius, in mm.",
            },
        },
    },
}

#: Number of columns of the triangles that approximate a sphere.
_MERIDIANS = 128


@njit(cache=True, error_model="numpy")
def uv_of_sphere(x, y, z):
    """Return the texture coordinates of a point in the shape's frame, mm."""
    u = math.atan2(y, x) / (2.0 * math.pi)
    v = math.atan2(math.sqrt(x * x + y * y), z) / math.pi
    return (u if u >= 0.0 else u + 1.0), v


@njit(cache=True, forceinline=True)
def _surface_at(surfaces, index, ray, point, normal, facet):
    ox, oy, oz = in_frame(surfaces, index, point)
    x = point[0] - surfaces.translation_mm[index, 0]
    y = point[1] - surfaces.translation_mm[index, 1]
    z = point[2] - surfaces.translation_mm[index, 2]
    length = math.sqrt(x * x + y * y + z * z)
    radius = surfaces.size_mm[index, 0] * surfaces.scale[index]
    for a in range(3):
        normal[a] = (point[a] - surfaces.translation_mm[index, a]) / length
        point[a] = surfaces.translation_mm[index, a] + radius * normal[a]
        facet[a] = normal[a]
    return uv_of_sphere(ox, oy, oz)


@njit(cache=True, forceinline=True)
def _distance(row, at, centre, direction, along):
    x, y, z = centre
    dx, dy, dz = direction
    # Uses the distance of the ray from the centre: the usual discriminant loses precision for small, distant spheres.
    px, py, pz = x - along * dx, y - along * dy, z - along * dz
    square = row[at + RADIUS] * row[at + RADIUS] - (px * px + py * py + pz * pz)
    half = root(upper_of(square, 0.0))
    near, far = along - half, along + half
    first = select(near >= 0.0, near, far)
    return select((square >= 0.0) & (first >= 0.0), first, np.inf)


@njit(cache=True, forceinline=True)
def _point(offset, facing, radius):
    x, y, z = offset
    inverse = 1.0 / upper_of(root(x * x + y * y + z * z), 1e-30)
    nx, ny, nz = x * inverse, y * inverse, z * inverse
    return radius * nx, radius * ny, radius * nz, nx, ny, nz


@njit(cache=True, forceinline=True)
def arc_tangent(y, x):
    """Return atan2 of lanes with an error below 1e-5 rad."""
    ax, ay = magnitude(x), magnitude(y)
    ratio = lower_of(ax, ay) / upper_of(upper_of(ax, ay), 1e-30)
    s = ratio * ratio
    angle = ratio * (
        0.99997726 + s * (-0.33262347 + s * (0.19354346 + s * (-0.11643287 + s * (0.05265332 + s * -0.01172120))))
    )
    angle = select(ay > ax, 0.5 * np.pi - angle, angle)
    angle = select(x < 0.0, np.pi - angle, angle)
    return with_sign(angle, y)


@njit(cache=True, forceinline=True)
def _texture(local, wide, high):
    x, y, z = local
    turn = arc_tangent(y, x) * (0.5 / np.pi)
    return select(turn < 0.0, turn + 1.0, turn), arc_tangent(root(x * x + y * y), z) * (1.0 / np.pi)


@dataclass(frozen=True)
class Sphere(Shape):
    """A sphere centred on the origin; v runs from the pole +z to -z, u is the azimuth from +x towards +y over 2π.

    Parameters
    ----------
    radius_mm : float
    """

    radius_mm: float

    name = "sphere"
    schema = SCHEMA
    is_flat = False
    is_convex = True
    is_endless = False
    is_curved = True
    has_inside = True
    wraps = True
    border = "joined"
    kernels = Kernels(
        surface_at=_surface_at,
        distance=_distance,
        may_be_met=None,
        point=_point,
        texture=_texture,
    )

    @classmethod
    def from_block(cls, block: "SphereShape") -> "Sphere":
        """Return the sphere with the radius given in a configuration block."""
        return cls(float(block.radius_mm))

    @property
    def size_mm(self) -> tuple[float, float]:
        """The radius, for both lengths."""
        return self.radius_mm, self.radius_mm

    @property
    def ball_mm(self) -> float:
        """The radius."""
        return self.radius_mm

    @property
    def reach_mm(self) -> float:
        """The radius."""
        return self.radius_mm

    @property
    def table_height_mm(self) -> float:
        """Height z of the table's top: one radius below the centre."""
        return -self.radius_mm

    def primitive(self, placement: Placement) -> Primitive:
        """Return Embree's sphere, which is exact."""
        return sphere_point(placement.translation_mm, self.radius_mm * placement.scale)

    def refined(self, origin, direction, distance, triangle) -> np.ndarray:
        """Return the solution of the sphere's equation that is nearer to the traced distance."""
        a = np.sum(direction**2, axis=1)
        b = np.sum(origin * direction, axis=1)
        # The discriminant from the distance of the ray from the centre loses no precision for distant rays.
        perpendicular = origin - direction * (b / a)[:, None]
        root = np.sqrt(np.maximum(self.radius_mm**2 - np.sum(perpendicular**2, axis=1), 0.0) / a)
        near, far = -b / a - root, -b / a + root
        return np.where(np.abs(near - distance) <= np.abs(far - distance), near, far)

    def atlas(self, width: int, height: int, rows: tuple[int, int] | None = None) -> Texels:
        """Return the texels of the texture, with columns along longitude and rows along latitude."""
        u, v = texel_centres(width, height, rows)
        theta, azimuth = np.pi * v, 2 * np.pi * u
        normal = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)
        return Texels(self.radius_mm * normal, normal, normal, np.ones(u.shape, dtype=bool))

    def facetted(self, reach_mm: float) -> Mesh:
        """Return triangles on a grid of longitude and latitude, at most 0.03 % of the radius inside the sphere."""
        u, v = np.meshgrid(np.arange(_MERIDIANS + 1) / _MERIDIANS, np.arange(_MERIDIANS // 2 + 1) * 2.0 / _MERIDIANS)
        azimuth = 2.0 * np.pi * (u % 1.0)  # the last column is identical to the first
        ring = np.where((v > 0.0) & (v < 1.0), np.sin(np.pi * v), 0.0)
        normal = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), np.cos(np.pi * v)], axis=-1)
        cells = quadrangles(np.arange(u.size).reshape(u.shape))
        # The corners of a cell are listed row by row, and v runs down.
        faces = np.concatenate([cells[:, [0, 2, 3]], cells[:, [0, 3, 1]]])
        normals = normal.reshape(-1, 3)[faces]
        return make_mesh(self.radius_mm * normals, np.stack([u.ravel(), v.ravel()], axis=1)[faces], normals)

    def samples(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return points spread evenly, on a spiral from pole to pole."""
        index = np.arange(count) + 0.5
        z, azimuth = 1.0 - 2.0 * index / count, np.pi * (1.0 + math.sqrt(5.0)) * index
        radius = np.sqrt(1.0 - z**2)
        normal = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1)
        return self.radius_mm * normal, normal

    def curvature_per_mm(self, scale: float) -> float:
        """Return twice the curvature of a great circle, 1/mm."""
        return 2.0 / (self.radius_mm * scale)

    def texture_per_mm(self, scale: float) -> tuple[float, float]:
        """Return zeros, because the texture follows angles."""
        return 0.0, 0.0
