"""Triangle meshes."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from irodori.geometry.atlas import Texels, mesh_texels, rasterise
from irodori.geometry.embree import Primitive, hit_barycentric, hit_primitive, triangles
from irodori.geometry.mesh import Mesh
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Kernels, Shape, ball_may_be_met
from irodori.jit.compilation import njit

if TYPE_CHECKING:
    from irodori.config.models import MeshShape

IS_FLAT = False
SCHEMA = {
    "object": {
        "title": "MeshShape",
        "type": "object",
        "additionalProperties": False,
        "required": ["kind", "file", "unit"],
        "properties": {
            "kind": {
                "const": "mesh",
                "description": "Triangles with UV coordinates, standing with their lowest point on the table.",
            },
            "file": {
                "type": "string",
                "minLength": 1,
                "description": "Path of an OBJ, PLY, GLB or glTF whose UV coordinates put every place of the surface "
                "into one texture.",
            },
            "unit": {"enum": ["mm", "cm", "m", "inch"], "description": "Unit of the file's coordinates."},
            "up": {
                "enum": ["z", "y"],
                "default": "z",
                "description": "Axis of the file that points up; glTF has y.",
            },
            "pivot_mm": {
                "$ref": "common.schema.yaml#/$defs/position_mm",
                "description": "The point that stands at the origin of the rig, x, y, z, in mm, after unit and up; the "
                "middle of the bounding box where absent.",
            },
            "crease_deg": {
                "type": "number",
                "minimum": 0,
                "maximum": 180,
                "default": 40.0,
                "description": "Where the file has no normals; facets that meet at a larger angle keep an edge, in "
                "degrees.",
            },
        },
    }
}

# All array elements are indexed individually: views would update a reference count shared by the threads, which is
# slow.


@njit(cache=True, error_model="numpy")
def _surface_at(surfaces, index, ray, point, normal, facet):
    """Fill point and normals of a hit on a mesh from its barycentric coordinates; return its texture coordinates."""
    face = surfaces.first_face[index] + hit_primitive(ray)
    b, c = hit_barycentric(ray)
    b, c = max(float(b), 0.0), max(float(c), 0.0)
    a = max(1.0 - b - c, 0.0)
    i, j, k = surfaces.faces[face, 0], surfaces.faces[face, 1], surfaces.faces[face, 2]
    p, q, r = (
        (surfaces.vertices_mm[i, 0], surfaces.vertices_mm[i, 1], surfaces.vertices_mm[i, 2]),
        (surfaces.vertices_mm[j, 0], surfaces.vertices_mm[j, 1], surfaces.vertices_mm[j, 2]),
        (surfaces.vertices_mm[k, 0], surfaces.vertices_mm[k, 1], surfaces.vertices_mm[k, 2]),
    )
    local = (a * p[0] + b * q[0] + c * r[0], a * p[1] + b * q[1] + c * r[1], a * p[2] + b * q[2] + c * r[2])
    e, f = (q[0] - p[0], q[1] - p[1], q[2] - p[2]), (r[0] - p[0], r[1] - p[1], r[2] - p[2])
    across = (e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0])
    n = surfaces.normals
    shading = (
        a * n[face, 0, 0] + b * n[face, 1, 0] + c * n[face, 2, 0],
        a * n[face, 0, 1] + b * n[face, 1, 1] + c * n[face, 2, 1],
        a * n[face, 0, 2] + b * n[face, 1, 2] + c * n[face, 2, 2],
    )
    flat = math.sqrt(across[0] ** 2 + across[1] ** 2 + across[2] ** 2)
    length = math.sqrt(shading[0] ** 2 + shading[1] ** 2 + shading[2] ** 2)
    if length < 1e-6:
        shading, length = across, flat
    for axis in range(3):
        turn = surfaces.rotation
        x, y, z = turn[index, axis, 0], turn[index, axis, 1], turn[index, axis, 2]
        point[axis] = surfaces.translation_mm[index, axis] + surfaces.scale[index] * (
            x * local[0] + y * local[1] + z * local[2]
        )
        facet[axis] = (x * across[0] + y * across[1] + z * across[2]) / flat
        normal[axis] = (x * shading[0] + y * shading[1] + z * shading[2]) / length
    uv = surfaces.uv
    u = a * uv[face, 0, 0] + b * uv[face, 1, 0] + c * uv[face, 2, 0]
    v = a * uv[face, 0, 1] + b * uv[face, 1, 1] + c * uv[face, 2, 1]
    return u, v


@dataclass(frozen=True)
class TriangleMesh(Shape):
    """A triangle mesh with the texture coordinates of its file.

    Parameters
    ----------
    mesh : Mesh
        The triangles, in the object's frame.
    file : str
        Source of the mesh, for error messages.
    """

    mesh: Mesh
    file: str = "mesh"

    name = "mesh"
    schema = SCHEMA
    is_flat = False
    is_convex = False
    is_endless = False
    is_curved = False
    has_inside = False
    wraps = False
    border = "unknown"
    kernels = Kernels(
        surface_at=_surface_at,
        distance=None,
        may_be_met=ball_may_be_met,
        point=None,
        texture=None,
    )

    @classmethod
    def from_block(cls, block: "MeshShape") -> "TriangleMesh":
        """Read the mesh from the file named in a configuration block."""
        from irodori.geometry.mesh_files import read_mesh

        mesh = read_mesh(block.file, unit=block.unit, up=block.up, pivot_mm=block.pivot_mm, crease_deg=block.crease_deg)
        return cls(mesh, block.file)

    @property
    def triangles(self) -> Mesh:
        """The mesh."""
        return self.mesh

    @property
    def size_mm(self) -> tuple[float, float]:
        """The reach, for both lengths."""
        return self.reach_mm, self.reach_mm

    @property
    def reach_mm(self) -> float:
        """Distance of the farthest vertex from the origin."""
        return self.mesh.reach_mm

    @property
    def table_height_mm(self) -> float:
        """Height z of the table's top: that of the lowest point of the mesh."""
        return self.mesh.bottom_mm

    def primitive(self, placement: Placement) -> Primitive:
        """Return the triangles for Embree."""
        return triangles(placement.points(self.mesh.vertices_mm), self.mesh.faces)

    def refined(self, origin, direction, distance, triangle) -> np.ndarray:
        """Return distances to the planes of the triangles that were hit."""
        mesh = self.mesh
        corner, facet = mesh.vertices_mm[mesh.faces[triangle, 0]], mesh.facets[triangle]
        steepness = np.sum(direction * facet, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            exact = np.sum((corner - origin) * facet, axis=1) / steepness
        # A ray nearly parallel to a triangle meets it at an edge, which the plane does not determine.
        steep = np.abs(steepness) > 1e-4 * np.linalg.norm(direction, axis=1)
        return np.where(steep & np.isfinite(exact), exact, distance)

    def atlas(self, width: int, height: int, rows: tuple[int, int] | None = None) -> Texels:
        """Return the texels in the charts of the mesh."""
        return mesh_texels(self.mesh, rasterise(self.mesh, width, height, self.file), rows)

    def is_covered(self, width: int, height: int) -> np.ndarray:
        """Return the texels that lie in a chart, (height, width) bool."""
        return rasterise(self.mesh, width, height, self.file) >= 0

    def facetted(self, reach_mm: float) -> Mesh:
        """Return the mesh."""
        return self.mesh

    def samples(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return ``count`` points spread evenly over the area."""
        return self.mesh.samples(count)

    def curvature_per_mm(self, scale: float) -> float:
        """Return 0, because triangles are flat."""
        return 0.0

    def texture_per_mm(self, scale: float) -> tuple[float, float]:
        """Return zeros, because texture coordinates depend on the triangle."""
        return 0.0, 0.0
