"""Interface of a shape: everything that the package needs from it.

A shape must define all of it; `irodori.geometry.shape_registry.register` refuses an incomplete one. A function that
does not apply to a shape is given as None.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from irodori.geometry.atlas import Texels
from irodori.geometry.embree import Primitive
from irodori.geometry.mesh import Mesh
from irodori.geometry.shape_registry import shapes
from irodori.geometry.shapes.shape_rows import RADIUS
from irodori.jit.compilation import njit
from irodori.jit.functions import magnitude

if TYPE_CHECKING:
    from irodori.config.models import BodyShape, ObjectShape
    from irodori.geometry.shapes.placement import Placement

#: Height above a surface at which rays start, relative to the shape's reach: some hundred steps of single precision.
_RAY_OFFSET = 3e-5


class Kernels(NamedTuple):
    """Compiled functions of a shape. `irodori.geometry.shape_dispatch` selects among those of all shapes.

    ``row`` and ``at`` are a table, and the index at which the numbers of the shape begin, see
    `irodori.geometry.shapes.shape_rows`. Lanes are vectors of `irodori.jit.vectors` with one number for each ray.

    Parameters
    ----------
    surface_at : (surfaces, index, ray, point, normal, facet) -> u, v
        See `irodori.geometry.surfaces.surface_at`.
    distance : (row, at, centre, direction, along) -> distances, or None
        Distance, mm, at which rays first meet the shape from either side, in lanes; infinite where they miss it.
        Arguments: its centre relative to the origins of the rays (mm), their unit directions, and the distance along
        them to the point nearest to the centre. None for a shape without such a formula, which Embree traces.
    may_be_met : (row, at, centre, direction, along) -> mask, or None
        For a shape without ``distance``: whether rays may meet it, true if in doubt. None for other shapes.
    point : (offset, facing, radius) -> (x, y, z, nx, ny, nz), or None
        Points moved onto the surface, and normals, in lanes; ``offset`` and the result are relative to the shape's
        centre in the world, and ``facing`` is the z axis of the shape's frame. None if each hit is moved by
        ``surface_at`` instead.
    texture : (local, wide, high) -> (u, v), or None
        Texture coordinates of points in the axes of the shape's frame, in world units; ``wide`` and ``high`` are the
        row's ``WIDE`` and ``HIGH``.
    """

    surface_at: Callable
    distance: Callable | None
    may_be_met: Callable | None
    point: Callable | None
    texture: Callable | None


class Shape(ABC):
    """A textured surface in its own coordinate frame, mm."""

    #: Class attributes that `irodori.geometry.shape_registry.register` requires besides the methods.
    DECLARED: ClassVar[frozenset[str]] = frozenset(
        [
            "name",
            "schema",
            "kernels",
            "is_flat",
            "is_convex",
            "is_endless",
            "is_curved",
            "has_inside",
            "wraps",
            "border",
        ]
    )
    name: ClassVar[str]  # name in configuration files
    schema: ClassVar[dict[str, dict]]  # variants of the key ``shape`` in the schemas ``object`` and ``scene``
    kernels: ClassVar[Kernels]
    is_flat: ClassVar[bool]  # lies in z = 0 of its frame and faces +z
    is_convex: ClassVar[bool]  # casts no shadow on its own points that face the light
    is_endless: ClassVar[bool]  # has no finite size
    is_curved: ClassVar[bool]  # by rounding, a visible point at its outline may seem to face away
    has_inside: ClassVar[bool]  # a ray that meets its back comes from inside
    wraps: ClassVar[bool]  # the left and right side of the texture are joined
    border: ClassVar[str]  # surroundings of the texture: "joined" (columns only), "black", or "unknown"

    @classmethod
    @abstractmethod
    def from_block(cls, block: Any) -> "Shape":
        """Return the shape defined by a validated configuration block, which has its keys as attributes."""

    @property
    @abstractmethod
    def size_mm(self) -> tuple[float, float]:
        """Two lengths that ``surface_at`` finds in ``Surfaces.size_mm``."""

    @property
    @abstractmethod
    def reach_mm(self) -> float:
        """Largest distance of a point of the shape from the origin of its frame; 0 for an endless shape."""

    @property
    @abstractmethod
    def table_height_mm(self) -> float:
        """Height z, in the shape's frame, of the table's top on which the shape stands."""

    @abstractmethod
    def primitive(self, placement: "Placement") -> Primitive:
        """Return the geometry that Embree traces for the placed shape."""

    @abstractmethod
    def refined(self, origin, direction, distance, triangle) -> np.ndarray:
        """Recompute hit distances in double precision from the equation of the shape, (n,).

        Of several solutions, the one nearest to the traced distance is returned, also for a ray that starts inside.

        Parameters
        ----------
        origin, direction : (n, 3) float64
            In the shape's frame. Distances are in units of the length of ``direction``.
        distance : (n,) float
            Traced distances.
        triangle : (n,) int, or None
            Index of the triangle that was hit, for meshes.
        """

    @abstractmethod
    def atlas(self, width: int, height: int, rows: tuple[int, int] | None = None) -> Texels:
        """Return the surface points at the texel centres of some rows, by default of all.

        Raises
        ------
        InputError
            If the charts of a mesh overlap, or contain no texel centre, see `irodori.geometry.atlas.rasterise`.
        """

    @abstractmethod
    def samples(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return about ``count`` points that represent the shape: positions, (n, 3) mm, and unit normals, (n, 3)."""

    @abstractmethod
    def curvature_per_mm(self, scale: float) -> float:
        """Return the sum of the principal curvatures of the scaled shape, 1/mm; it widens a cone of mirrored rays."""

    @abstractmethod
    def texture_per_mm(self, scale: float) -> tuple[float, float]:
        """Return the slopes of u along x and of -v along y of the scaled shape, 1/mm.

        Zeros if u and v are not linear in x and y.
        """

    @abstractmethod
    def facetted(self, reach_mm: float) -> Mesh:
        """Return an approximation by triangles, in the shape's frame, for programs that support no other shapes.

        Parameters
        ----------
        reach_mm : float
            Size of the surrounding scene in units of the shape's frame, which limits endless shapes.
        """

    # --- derived from the above, or the same for most shapes ------------------------------------------------------

    @classmethod
    def from_definition(cls, shape: "ObjectShape | BodyShape") -> "Shape":
        """Return the shape defined by the block ``shape`` of a configuration; a mesh is read from its file.

        Raises
        ------
        ValueError
            If the kind is unknown.
        InputError
            If a mesh cannot be used, see `irodori.geometry.mesh_files.read_mesh`.
        """
        known = {one.name: one for one in shapes()}
        if shape.kind not in known:
            raise ValueError(f"unknown shape {shape.kind!r}; accepted: {', '.join(known)}")
        return known[shape.kind].from_block(shape)

    @property
    def triangles(self) -> Mesh | None:
        """Triangles that ``surface_at`` reads; None if it needs none."""
        return None

    @property
    def ball_mm(self) -> float | None:
        """Radius if the shape is a ball with a texture by azimuth and polar angle; None for other shapes.

        Exports use it for programs that have exact balls.
        """
        return None

    @property
    def ray_offset_mm(self) -> float:
        """Height above the surface at which rays start, mm, so that rounding errors do not make them hit it again."""
        return _RAY_OFFSET * self.reach_mm

    def frame_origin(self, placement: "Placement") -> np.ndarray:
        """Return the origin of the placed shape's frame for compiled loops, (3,) mm in the world."""
        return placement.translation_mm

    def texels(self, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (height, width, 3) in mm and unit normals (height, width, 3) of the texel centres."""
        found = self.atlas(width, height)
        return found.position, found.normal

    def is_covered(self, width: int, height: int) -> np.ndarray:
        """Return the texels that lie on the surface, (height, width) bool."""
        return np.ones((height, width), dtype=bool)


def texel_centres(width: int, height: int, rows: tuple[int, int] | None) -> tuple[np.ndarray, np.ndarray]:
    """Return u and v of the texel centres of some rows, (rows, width) each."""
    first, last = rows or (0, height)
    u = (np.arange(width) + 0.5) / width
    v = (np.arange(first, last) + 0.5) / height
    u, v = np.meshgrid(u, v)
    return u, v


@njit(cache=True, inline="always")
def in_frame(surfaces, index, point):
    """Convert a point from the world to the frame of a placed shape, in mm of that frame."""
    x = point[0] - surfaces.translation_mm[index, 0]
    y = point[1] - surfaces.translation_mm[index, 1]
    z = point[2] - surfaces.translation_mm[index, 2]
    inverse = 1.0 / surfaces.scale[index]
    ox, oy, oz = 0.0, 0.0, 0.0
    for a, value in enumerate((x, y, z)):
        ox += surfaces.rotation[index, a, 0] * value * inverse
        oy += surfaces.rotation[index, a, 1] * value * inverse
        oz += surfaces.rotation[index, a, 2] * value * inverse
    return ox, oy, oz


# --- placeholders for shapes to which a function does not apply ------------------------------------------------------


#: Relative enlargement of bounding balls, by their size and by the distance, against rounding errors.
_SLACK = 1e-4


@njit(cache=True, forceinline=True)
def ball_may_be_met(row, at, centre, direction, along):
    """Return whether rays may meet the bounding ball of a shape, in lanes.

    Rays that start outside and move away from it do not.
    """
    x, y, z = centre
    dx, dy, dz = direction
    radius = row[at + RADIUS]
    px, py, pz = x - along * dx, y - along * dy, z - along * dz
    bound = radius + (radius + magnitude(along)) * _SLACK
    inside = x * x + y * y + z * z < radius * radius * (1.0 + 2e-6)
    return (px * px + py * py + pz * pz <= bound * bound) & ((along > 0.0) | inside)
