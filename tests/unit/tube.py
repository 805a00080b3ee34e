"""A shape that the package does not know: the outer side of an upright tube, for the tests of the registry."""

import math
from dataclasses import dataclass

import numpy as np

from irodori.geometry.atlas import Texels
from irodori.geometry.embree import Primitive, triangles
from irodori.geometry.mesh import make_mesh
from irodori.geometry.shapes.shape import (
    Kernels,
    Shape,
    ball_may_be_met,
    in_frame,
    texel_centres,
)
from irodori.jit.compilation import njit

SIDES = 512


# Not cached: in the loops that use it it is compiled anew, whatever in the package changed beneath it.
@njit(inline="always")
def _surface_at(surfaces, index, ray, point, normal, facet):
    ox, oy, oz = in_frame(surfaces, index, point)
    length = math.sqrt(ox * ox + oy * oy)
    nx, ny, radius = ox / length, oy / length, surfaces.size_mm[index, 0]
    turn = surfaces.rotation
    for a in range(3):
        normal[a] = turn[index, a, 0] * nx + turn[index, a, 1] * ny
        facet[a] = normal[a]
        point[a] = surfaces.translation_mm[index, a] + surfaces.scale[index] * (
            radius * normal[a] + turn[index, a, 2] * oz
        )
    u = math.atan2(oy, ox) / (2.0 * math.pi)
    return (u if u >= 0.0 else u + 1.0), 0.5 - oz / surfaces.size_mm[index, 1]


@dataclass(frozen=True)
class Tube(Shape):
    radius_mm: float
    height_mm: float

    name = "tube"
    schema = {  # noqa: RUF012
        of: {
            "title": "TubeShape",
            "type": "object",
            "additionalProperties": False,
            "required": ["kind", "radius_mm", "height_mm"],
            "properties": {
                "kind": {"const": "tube", "description": "The side of an upright cylinder about the origin."},
                "radius_mm": {"type": "number", "exclusiveMinimum": 0, "description": "Radius, in mm."},
                "height_mm": {"type": "number", "exclusiveMinimum": 0, "description": "Height, in mm."},
            },
        }
        for of in ("object", "scene")
    }
    is_flat = False
    is_convex = True
    is_endless = False
    is_curved = True
    has_inside = True
    wraps = True
    border = "joined"
    # In `interactive` it leaves no contact shadow, and none falls on it.
    kernels = Kernels(
        surface_at=_surface_at,
        distance=None,
        may_be_met=ball_may_be_met,
        point=None,
        texture=None,
    )

    @classmethod
    def from_block(cls, block):
        return cls(float(block.radius_mm), float(block.height_mm))

    @property
    def size_mm(self):
        return self.radius_mm, self.height_mm

    @property
    def reach_mm(self):
        return math.hypot(self.radius_mm, 0.5 * self.height_mm)

    @property
    def table_height_mm(self):
        return -0.5 * self.height_mm

    def primitive(self, placement) -> Primitive:
        angle = np.arange(SIDES) * 2.0 * np.pi / SIDES
        ring = np.stack([np.cos(angle), np.sin(angle)], axis=1) * self.radius_mm
        ends = [np.column_stack([ring, np.full(SIDES, z)]) for z in (-0.5 * self.height_mm, 0.5 * self.height_mm)]
        here, there = np.arange(SIDES), np.roll(np.arange(SIDES), -1)
        faces = [[here, there, there + SIDES], [here, there + SIDES, here + SIDES]]
        return triangles(placement.points(np.concatenate(ends)), np.concatenate([np.stack(f, axis=1) for f in faces]))

    def refined(self, origin, direction, distance, triangle):
        a = np.sum(direction[:, :2] ** 2, axis=1)
        b = np.sum(origin[:, :2] * direction[:, :2], axis=1)
        c = np.sum(origin[:, :2] ** 2, axis=1) - self.radius_mm**2
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        near, far = (-b - root) / a, (-b + root) / a
        return np.where(np.abs(near - distance) <= np.abs(far - distance), near, far)

    def atlas(self, width, height, rows=None) -> Texels:
        u, v = texel_centres(width, height, rows)
        normal = np.stack([np.cos(2 * np.pi * u), np.sin(2 * np.pi * u), np.zeros_like(u)], axis=-1)
        position = self.radius_mm * normal + np.stack([0 * u, 0 * u, (0.5 - v) * self.height_mm], axis=-1)
        return Texels(position, normal, normal, np.ones(u.shape, dtype=bool))

    def facetted(self, reach_mm):
        angle = np.arange(SIDES + 1) * 2.0 * np.pi / SIDES
        angle[-1] = 0.0
        normal = np.stack([np.cos(angle), np.sin(angle), np.zeros(SIDES + 1)], axis=1)
        below, above = (self.radius_mm * normal + [0.0, 0.0, z] for z in self.height_mm * np.array([-0.5, 0.5]))
        u = np.arange(SIDES + 1) / SIDES
        low, high = np.stack([u, np.ones_like(u)], axis=1), np.stack([u, np.zeros_like(u)], axis=1)

        def around(at, over):
            first = np.stack([at[:-1], at[1:], over[1:]], axis=1)
            return np.concatenate([first, np.stack([at[:-1], over[1:], over[:-1]], axis=1)])

        return make_mesh(around(below, above), around(low, high), around(normal, normal))

    def samples(self, count):
        found = self.atlas(count, 1)
        return found.position[0], found.normal[0]

    def curvature_per_mm(self, scale):
        return 1.0 / (self.radius_mm * scale)

    def texture_per_mm(self, scale):
        return 0.0, 0.0
