"""Common parts of flat shapes: they lie in z = 0 of their frame and face +z, with u along +x and v along -y.

So the texture has its usual orientation when seen from above.
"""

import numpy as np

from irodori.geometry.atlas import Texels
from irodori.geometry.mesh import Mesh, make_mesh
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shadow_nodes import (
    DENSITY,
    GRID,
    LOW,
    MIDDLE,
    REACH,
    Nodes,
    grid_place,
    grid_size,
    middle_and_reach,
    quadrangles,
    raised,
    unwarped,
    warped,
    warped_place,
)
from irodori.geometry.shapes.shape import Shape, in_frame, texel_centres
from irodori.geometry.shapes.shape_rows import CENTRE, TURN
from irodori.jit.compilation import njit

#: Nodes along each side of a grid.
FLAT_SIDE = 128
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


@njit(cache=True)
def frame_axes(row, at):
    """Return the three axes of a shape's frame as vectors in the world."""
    return (
        (np.float64(row[at + TURN]), np.float64(row[at + TURN + 3]), np.float64(row[at + TURN + 6])),
        (np.float64(row[at + TURN + 1]), np.float64(row[at + TURN + 4]), np.float64(row[at + TURN + 7])),
        (np.float64(row[at + TURN + 2]), np.float64(row[at + TURN + 5]), np.float64(row[at + TURN + 8])),
    )


@njit(cache=True)
def nodes_about_flat(shadows, own, row, hit):
    """Return the four nodes around a hit, and their weights, from its place on the grid of `FlatShape.nodes`."""
    grid, at, point = shadows.grid, own * GRID, hit.point
    columns, rows = grid_size(grid, own)
    x, y, z = point[0] - row[hit.at + CENTRE], point[1] - row[hit.at + CENTRE + 1], point[2] - row[hit.at + CENTRE + 2]
    across = x * row[hit.at + TURN] + y * row[hit.at + TURN + 3] + z * row[hit.at + TURN + 6]
    along = x * row[hit.at + TURN + 1] + y * row[hit.at + TURN + 4] + z * row[hit.at + TURN + 7]
    column = (warped_place((across - grid[at + MIDDLE]) / grid[at + REACH]) - grid[at + LOW]) * grid[at + DENSITY]
    line = (warped_place((along - grid[at + MIDDLE + 1]) / grid[at + REACH + 1]) - grid[at + LOW + 1]) * grid[
        at + DENSITY + 1
    ]
    return grid_place(column, line, columns, rows, False)


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
    hides_by_rays = False
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

    def grid_ends(self, axis: int, scale: float, middle_mm: float, reach_mm: float) -> np.ndarray:
        """Return the first and last place of the grid of nodes along an axis, as defined by `shadow_nodes.warped`."""
        half = 0.5 * self.size_mm[axis] * scale
        return warped((np.array([-half, half]) - middle_mm) / reach_mm)

    def nodes(self, placement: Placement, reach_mm: float, points: list[np.ndarray]) -> Nodes:
        """Return a grid of nodes that is regular near the shapes that cast shadows by rays, and coarser farther away.

        So the grid is finite also on an endless plane.
        """
        turn, origin = placement.rotation, self.frame_origin(placement)
        middle, reach = middle_and_reach([(p - origin) @ turn for p in points])
        side = FLAT_SIDE
        ends = [self.grid_ends(axis, placement.scale, middle[axis], reach[axis]) for axis in range(2)]
        places = [np.linspace(first, last, side) for first, last in ends]
        x, y = (middle[axis] + reach[axis] * unwarped(places[axis]) for axis in range(2))
        x, y = (values.ravel() for values in np.meshgrid(x, y))
        facet = np.broadcast_to(turn[:, 2], (x.size, 3))
        point = raised(origin + x[:, None] * turn[:, 0] + y[:, None] * turn[:, 1], facet, reach_mm)
        density = [(side - 1) / (p[-1] - p[0]) for p in places]
        grid = np.array([side, side, *middle, *reach, *(p[0] for p in places), *density])
        cells = quadrangles(np.arange(side * side).reshape(side, side))
        return Nodes(point, facet, facet, point, cells, grid)
