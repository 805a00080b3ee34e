"""Shapes with a texture parametrisation: plate, sphere, triangle mesh, disc and plane, and where they stand.

A texture has `height` rows and `width` columns; texel (row, column) has u = (column + 0.5) / width and
v = (row + 0.5) / height. Object frame, mm: a plate lies in z = 0 with its face up, u along +x and v along -y (so that
the texture reads as seen from above); a sphere is centred at the origin, v runs from the pole +z to -z and u is the
azimuth from +x towards +y over 2π; a mesh has the texture coordinates of its file. A disc lies as the plate about it,
and has that one's texture; a plane is all of z = 0, and everywhere the middle of its texture.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from irodori.config.models import BodyShape, ObjectShape
from irodori.geometry.atlas import Texels, mesh_texels, rasterise
from irodori.geometry.mesh import Mesh
from irodori.jit.native import njit

PLATE, SPHERE, MESH, DISC, PLANE = 0, 1, 2, 3, 4
#: Kinds that lie in z = 0 of their frame and face +z.
FLAT = (PLATE, DISC, PLANE)
#: An endless plane is a disc of this radius: its edge is nearer to the horizon than single precision tells.
PLANE_RADIUS_MM = 1e12
PLATE_THICKNESS_MM = 2.0
#: Rays leave a surface this part of the shape's reach above it: some hundred steps of single precision.
_RAY_OFFSET = 3e-5


@dataclass(frozen=True)
class Shape:
    """A plate, a sphere, a mesh, a disc or a plane.

    Parameters
    ----------
    kind : int
        `PLATE`, `SPHERE`, `MESH`, `DISC` or `PLANE`.
    size_mm : (2,) tuple
        Width and height of a plate; radius twice of a sphere; reach from the origin twice of a mesh; diameter twice of
        a disc; zeros of a plane.
    mesh : Mesh, optional
        The triangles of a mesh, in the object's frame.
    file : str
        Where a mesh came from, for error messages.
    """

    kind: int
    size_mm: tuple[float, float]
    mesh: Mesh | None = None
    file: str = "mesh"

    @classmethod
    def from_definition(cls, shape: ObjectShape | BodyShape) -> "Shape":
        """Return the shape of a configuration's `shape` block; a mesh is read from its file.

        Raises
        ------
        ValueError
            If the kind is unknown.
        InputError
            If a mesh is refused, see `irodori.geometry.mesh_files.read_mesh`.
        """
        if shape.kind == "plate":
            return cls(PLATE, (float(shape.width_mm), float(shape.height_mm)))
        if shape.kind == "sphere":
            return cls(SPHERE, (float(shape.radius_mm), float(shape.radius_mm)))
        if shape.kind == "mesh":
            from irodori.geometry.mesh_files import read_mesh

            mesh = read_mesh(
                shape.file, unit=shape.unit, up=shape.up, pivot_mm=shape.pivot_mm, crease_deg=shape.crease_deg
            )
            return cls.from_mesh(mesh, shape.file)
        if shape.kind == "disc":
            return cls(DISC, (2.0 * shape.radius_mm,) * 2)
        if shape.kind == "plane":
            return cls(PLANE, (0.0, 0.0))
        raise ValueError(f"unknown shape {shape.kind!r}; accepted: plate, sphere, mesh, disc, plane")

    @classmethod
    def from_mesh(cls, mesh: Mesh, file: str = "mesh") -> "Shape":
        """Return the shape of triangles."""
        return cls(MESH, (mesh.reach_mm, mesh.reach_mm), mesh, str(file))

    @property
    def table_height_mm(self) -> float:
        """Height of the table's top under the shape.

        A sphere's centre and a plate's face are at the origin; a mesh stands on its lowest point.
        """
        if self.mesh is not None:
            return self.mesh.bottom_mm
        return -self.size_mm[0] if self.kind == SPHERE else -PLATE_THICKNESS_MM

    @property
    def reach_mm(self) -> float:
        """Largest distance of a point of the shape from the origin of its frame, mm; 0 of a plane, see `reaches`."""
        if self.kind == PLATE:
            return math.hypot(*self.size_mm) / 2.0
        return self.size_mm[0] / 2.0 if self.kind == DISC else self.size_mm[0]

    @property
    def ray_offset_mm(self) -> float:
        """Height above the surface at which rays leave it, mm: out of reach of the tracer's single precision."""
        return _RAY_OFFSET * self.reach_mm

    def texels(self, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (height, width, 3) in mm and unit normals (height, width, 3) of the texel centres."""
        found = self.atlas(width, height)
        return found.position, found.normal

    def atlas(self, width: int, height: int, rows: tuple[int, int] | None = None) -> Texels:
        """Return what lies under the texel centres of some rows, of all where ``rows`` is absent.

        Raises
        ------
        InputError
            If the charts of a mesh overlap, or hold no texel, see `irodori.geometry.atlas.rasterise`.
        """
        if self.mesh is not None:
            return mesh_texels(self.mesh, rasterise(self.mesh, width, height, self.file), rows)
        first, last = rows or (0, height)
        u = (np.arange(width) + 0.5) / width
        v = (np.arange(first, last) + 0.5) / height
        u, v = np.meshgrid(u, v)
        covered = np.ones(u.shape, dtype=bool)
        if self.kind in FLAT:
            position = np.stack([(u - 0.5) * self.size_mm[0], (0.5 - v) * self.size_mm[1], np.zeros_like(u)], axis=-1)
            normal = np.broadcast_to(np.array([0.0, 0.0, 1.0]), position.shape).copy()
            return Texels(position, normal, normal, covered)
        theta, azimuth = np.pi * v, 2 * np.pi * u
        normal = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)
        return Texels(self.size_mm[0] * normal, normal, normal, covered)

    def is_covered(self, width: int, height: int) -> np.ndarray:
        """Return which texels lie on the surface, (height, width) bool: all but those outside a mesh's charts."""
        if self.mesh is None:
            return np.ones((height, width), dtype=bool)
        return rasterise(self.mesh, width, height, self.file) >= 0


@njit(cache=True, error_model="numpy")
def uv_from_point(kind, size_x, size_y, x, y, z):
    """Return texture coordinates u, v in 0..1 of a point on the surface, object frame, mm."""
    if kind == PLANE:
        return 0.5, 0.5
    if kind in (PLATE, DISC):
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


def reaches(placements: list[Placement]) -> np.ndarray:
    """Return the reach of each placed shape about its own origin, (n,) mm: what lengths at its surface compare to.

    That of a plane is the largest of the others, 1 mm where there is none.
    """
    found = np.array([p.shape.reach_mm * p.scale for p in placements])
    planes = np.array([p.shape.kind == PLANE for p in placements])
    others = found[~planes]
    return np.where(planes, others.max() if others.size else 1.0, found)


def on_table(shape: Shape, rotation: np.ndarray, table_radius_mm: float) -> list[Placement]:
    """Return an object (shape 0) on the rig's table (shape 1, a square; absent for radius 0) in the rig's frame."""
    placements = [Placement(shape, rotation)]
    if table_radius_mm > 0:
        top = Shape(PLATE, (2 * table_radius_mm, 2 * table_radius_mm))
        placements.append(Placement(top, rotation, rotation @ np.array([0.0, 0.0, shape.table_height_mm])))
    return placements
