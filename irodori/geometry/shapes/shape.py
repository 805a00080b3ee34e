"""The interface of a shape: everything that the package asks of one.

A shape declares all of it: `irodori.geometry.shape_registry.register` refuses one that leaves something out. Where it
has no answer it says so with a value that is meant for that, such as `hides_nothing`, `no_nodes` or lanes that are
None.
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
    from irodori.geometry.shapes.shadow_nodes import Nodes

#: Rays leave a surface this part of the shape's reach above it: some hundred steps of single precision.
_RAY_OFFSET = 3e-5


class Kernels(NamedTuple):
    """Compiled functions of a shape. Loops choose among those of all shapes, see `irodori.geometry.shape_dispatch`.

    ``row`` and ``at`` are a table and the place in it at which the shape's numbers begin, see
    `irodori.geometry.shapes.shape_rows`. Lanes are vectors of `irodori.jit.vectors`, one ray each.

    Parameters
    ----------
    surface_at : (surfaces, index, ray, point, normal, facet) -> u, v
        See `irodori.geometry.surfaces.surface_at`.
    hides : (row, at, x, y, z, normal) -> share, facing
        Share of the cosine-weighted hemisphere about a unit normal that the shape hides, its centre being at x, y, z
        (mm) from the point; and the unit normal of its side that faces the point, zeros where that reflects nothing.
        `hides_nothing` of a shape whose shadow of the ambient light is found by rays, or is left out.
    distance : (row, at, centre, direction, along) -> distances, or None
        How far along rays the shape is first met from either side, mm, in lanes: its centre from their origins (mm),
        their unit directions, and how far along them the centre lies. Infinite where the shape is not met. None of a
        shape that has no such formula: Embree meets it.
    may_be_met : (row, at, centre, direction, along) -> mask, or None
        Whether rays may meet a shape without a formula, true where in doubt; None of the others.
    point : (offset, facing, radius) -> (x, y, z, nx, ny, nz), or None
        Points and normals of lanes from traced points, all from the shape's centre in the world; ``facing`` is the z
        axis of the shape's frame. None where rays are brought to the shape one by one by ``surface_at``.
    texture : (local, wide, high) -> (u, v), or None
        Texture coordinates of points in the shape's frame, in world units, with the row's ``WIDE`` and ``HIGH``.
    nodes_about : (shadows, own, row, hit) -> nodes, weights
        See `irodori.rendering.interactive.shadow_look_up.nodes_about`.
    """

    surface_at: Callable
    hides: Callable
    distance: Callable | None
    may_be_met: Callable | None
    point: Callable | None
    texture: Callable | None
    nodes_about: Callable


class Shape(ABC):
    """A surface in its own frame, mm, with a texture on it."""

    #: What `irodori.geometry.shape_registry.register` asks for besides the methods.
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
            "hides_by_rays",
            "wraps",
            "border",
        ]
    )
    name: ClassVar[str]  # in configuration
    schema: ClassVar[dict[str, dict]]  # variants of the key ``shape`` in the schemas ``object`` and ``scene``
    kernels: ClassVar[Kernels]
    is_flat: ClassVar[bool]  # lies in z = 0 of its frame and faces +z
    is_convex: ClassVar[bool]  # shades none of its own points that face the light
    is_endless: ClassVar[bool]  # has no size of its own
    is_curved: ClassVar[bool]  # rounding may turn a point of its outline away from who sees it
    has_inside: ClassVar[bool]  # what meets its back is inside it
    hides_by_rays: ClassVar[bool]  # what it hides of the ambient light is found by rays when a scene is prepared
    wraps: ClassVar[bool]  # the texture's left and right sides are joined
    border: ClassVar[str]  # beyond the texture's sides: "joined" (columns alone), "black", or "unknown"

    @classmethod
    @abstractmethod
    def from_block(cls, block: Any) -> "Shape":
        """Return the shape of a validated block of configuration, whose keys are attributes."""

    @property
    @abstractmethod
    def size_mm(self) -> tuple[float, float]:
        """Two lengths that ``surface_at`` reads from the surfaces' ``size_mm``."""

    @property
    @abstractmethod
    def reach_mm(self) -> float:
        """Largest distance of a point of the shape from the origin of its frame; 0 of an endless one."""

    @property
    @abstractmethod
    def table_height_mm(self) -> float:
        """Height of the table's top under the shape."""

    @abstractmethod
    def primitive(self, placement: "Placement") -> Primitive:
        """Return what Embree traces for the placed shape."""

    @abstractmethod
    def refined(self, origin, direction, distance, triangle) -> np.ndarray:
        """Return hit distances recomputed in double precision on the shape's own equation, (n,).

        The root nearest to the traced distance is kept, so that a ray that starts inside keeps its exit.

        Parameters
        ----------
        origin, direction : (n, 3) float64
            In the shape's frame; a direction is as long as the distance counts, in mm of the shape.
        distance : (n,) float
            As traced.
        triangle : (n,) int, or None
            Which triangle of the primitive was met.
        """

    @abstractmethod
    def atlas(self, width: int, height: int, rows: tuple[int, int] | None = None) -> Texels:
        """Return what lies under the texel centres of some rows, of all where ``rows`` is absent.

        Raises
        ------
        InputError
            If the charts of a mesh overlap, or hold no texel, see `irodori.geometry.atlas.rasterise`.
        """

    @abstractmethod
    def samples(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return points that stand for the whole, positions (n, 3) in mm and unit normals (n, 3), about ``count``."""

    @abstractmethod
    def curvature_per_mm(self, scale: float) -> float:
        """Return the sum of the principal curvatures when enlarged, 1/mm: by it a cone of mirrored rays opens."""

    @abstractmethod
    def texture_per_mm(self, scale: float) -> tuple[float, float]:
        """Return what u and -v rise by a mm along x and y when enlarged; zeros where they are none of x and y."""

    @abstractmethod
    def nodes(self, placement: "Placement", reach_mm: float, points: list[np.ndarray]) -> "Nodes | None":
        """Return the points at which what others hide by rays is worked out; None where nothing hides anything.

        Parameters
        ----------
        placement : Placement
        reach_mm : float
            See `irodori.geometry.shapes.placement.reaches`.
        points : list of (vertices, 3) float
            Of each of the scene's shapes that hide by rays, in the world, mm.
        """

    @abstractmethod
    def facetted(self, reach_mm: float) -> Mesh:
        """Return triangles that stand for the shape where nothing else is known, in its frame, mm.

        Parameters
        ----------
        reach_mm : float
            Size of what stands about it, in its own mm: where an endless shape is cut.
        """

    # --- what follows from these, or has one answer for most ------------------------------------------------------

    @classmethod
    def from_definition(cls, shape: "ObjectShape | BodyShape") -> "Shape":
        """Return the shape of a configuration's `shape` block; a mesh is read from its file.

        Raises
        ------
        ValueError
            If the kind is unknown.
        InputError
            If a mesh is refused, see `irodori.geometry.mesh_files.read_mesh`.
        """
        known = {one.name: one for one in shapes()}
        if shape.kind not in known:
            raise ValueError(f"unknown shape {shape.kind!r}; accepted: {', '.join(known)}")
        return known[shape.kind].from_block(shape)

    @classmethod
    def from_mesh(cls, mesh: Mesh, file: str = "mesh") -> "Shape":
        """Return the shape of triangles."""
        from irodori.geometry.shapes.triangle_mesh import TriangleMesh

        return TriangleMesh(mesh, str(file))

    @property
    def triangles(self) -> Mesh | None:
        """Triangles that ``surface_at`` reads, None where it needs none."""
        return None

    @property
    def ball_mm(self) -> float | None:
        """Radius of the ball that the shape is, its texture by azimuth and angle from +z; None of other shapes.

        So programs that have balls of their own need no triangles.
        """
        return None

    @property
    def hull_mm(self) -> np.ndarray:
        """Points whose hull holds the shape, (n, 3); asked of what hides by rays."""
        raise NotImplementedError(f"a {self.name} hides by rays and has no hull")

    @property
    def ray_offset_mm(self) -> float:
        """Height above the surface at which rays leave it, mm: out of reach of the tracer's single precision."""
        return _RAY_OFFSET * self.reach_mm

    def frame_origin(self, placement: "Placement") -> np.ndarray:
        """Return the point about which compiled loops reckon the placed shape, (3,) mm."""
        return placement.translation_mm

    def texels(self, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (height, width, 3) in mm and unit normals (height, width, 3) of the texel centres."""
        found = self.atlas(width, height)
        return found.position, found.normal

    def is_covered(self, width: int, height: int) -> np.ndarray:
        """Return which texels lie on the surface, (height, width) bool."""
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
    """Return a point in the frame of a placed shape, mm of the shape."""
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


# --- answers for shapes that have none of their own ------------------------------------------------------------------


@njit(cache=True)
def hides_nothing(row, at, x, y, z, normal):
    """Return that a shape hides nothing: its contact shadow is left out, or found by rays."""
    return 0.0, (0.0, 0.0, 0.0)


@njit(cache=True)
def no_nodes(shadows, own, row, hit):
    """Return no node: of a shape from which nothing is hidden by rays this is never asked."""
    return (0, 0, 0, 0), (0.0, 0.0, 0.0, 0.0)


#: Bounds of shapes are wider by this part of their size and of the distance.
_SLACK = 1e-4


@njit(cache=True, forceinline=True)
def ball_may_be_met(row, at, centre, direction, along):
    """Return whether rays may meet the ball of the shape's reach about its centre; one that they leave bounds none."""
    x, y, z = centre
    dx, dy, dz = direction
    radius = row[at + RADIUS]
    px, py, pz = x - along * dx, y - along * dy, z - along * dz
    bound = radius + (radius + magnitude(along)) * _SLACK
    inside = x * x + y * y + z * z < radius * radius * (1.0 + 2e-6)
    return (px * px + py * py + pz * pz <= bound * bound) & ((along > 0.0) | inside)
