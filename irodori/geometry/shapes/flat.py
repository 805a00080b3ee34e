"""Common parts of flat shapes: they lie in z = 0 of their frame and face +z, with u along +x and v along -y.

So the texture has its usual orientation when seen from above.
"""

import numpy as np

from irodori.geometry.atlas import Texels
from irodori.geometry.mesh import Mesh, make_mesh
from irodori.geometry.shapes.shape import Shape, in_frame, texel_centres
from irodori.jit.compilation import njit

#: Height of a flat object's face above the table, mm.
THICKNESS_MM = 2.0


@njit(cache=True, error_model="numpy")
def uv_of_flat(size_x, size_y, x, y):
    """Return the texture coordinates of a point in the shape's frame, mm."""
    return x / size_x + 0.5, 0.5 - y / size_y


@njit(cache=True, forceinline=True)
def onto_plane(surfaces, index, point, normal, facet):
    """Move a point onto the plane of a flat shape, fill its normals, and return its x and y in the shape's frame."""
    ox, oy, oz = in_frame(surfaces, index, point)
    offset = oz * surfaces.scale[index]
    for a in range(3):
        normal[a] = surfaces.rotation[index, a, 2]
        point[a] -= offset * normal[a]
        facet[a] = normal[a]
    return ox, oy


@njit(cache=True, forceinline=True)
def surface_at_flat(surfaces, index, ray, point, normal, facet):
    """Move a hit onto its surface; see `irodori.geometry.surfaces.surface_at`."""
    ox, oy = onto_plane(surfaces, index, point, normal, facet)
    return uv_of_flat(surfaces.size_mm[index, 0], surfaces.size_mm[index, 1], ox, oy)


@njit(cache=True, forceinline=True)
def flat_point(offset, facing, radius):
    """Move points onto their planes; return them and the normals of the planes, in lanes."""
    x, y, z = offset
    height = x * facing[0] + y * facing[1] + z * facing[2]
    return (
        x - height * facing[0],
        y - height * facing[1],
        z - height * facing[2],
        facing[0],
        facing[1],
        facing[2],
    )


@njit(cache=True, forceinline=True)
def flat_texture(local, wide, high):
    """Return the texture coordinates of points in the shape's frame, in lanes."""
    return local[0] * wide + 0.5, 0.5 - local[1] * high


def rectangle(half_x: float, half_y: float) -> Mesh:
    """Return a rectangle of two triangles, centred on the origin, with the whole texture; half sides in mm."""
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    uv = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return make_mesh((corners * [half_x, half_y, 0.0])[faces], uv[faces])


class FlatShape(Shape):
    """Base class of shapes that lie in z = 0 of their frame."""

    is_flat = True
    is_convex = True
    is_curved = False
    has_inside = False
    wraps = False
    border = "black"

    @property
    def table_height_mm(self) -> float:
        """Height of the table's top: below the face, which is at z = 0, by the thickness of flat objects."""
        return -THICKNESS_MM

    def refined(self, origin, direction, distance, triangle) -> np.ndarray:
        """Return distances to the plane; for rays parallel to it the traced distance is kept."""
        with np.errstate(divide="ignore", invalid="ignore"):
            exact = -origin[:, 2] / direction[:, 2]
        return np.where(np.isfinite(exact), exact, distance)

    def atlas(self, width: int, height: int, rows: tuple[int, int] | None = None) -> Texels:
        """Return the texels of the bounding rectangle of the shape."""
        u, v = texel_centres(width, height, rows)
        position = np.stack([(u - 0.5) * self.size_mm[0], (0.5 - v) * self.size_mm[1], np.zeros_like(u)], axis=-1)
        normal = np.broadcast_to(np.array([0.0, 0.0, 1.0]), position.shape).copy()
        return Texels(position, normal, normal, np.ones(u.shape, dtype=bool))

    def facetted(self, reach_mm: float) -> Mesh:
        """Return a rectangle with the sides ``size_mm``."""
        return rectangle(0.5 * self.size_mm[0], 0.5 * self.size_mm[1])

    def curvature_per_mm(self, scale: float) -> float:
        """Return 0, because the shape is flat."""
        return 0.0

    def texture_per_mm(self, scale: float) -> tuple[float, float]:
        """Return the inverses of the sides in the world, 1/mm."""
        return 1.0 / (self.size_mm[0] * scale), 1.0 / (self.size_mm[1] * scale)
