"""Places of the texels of light maps on the surfaces of a scene.

The map of a sphere, disc or plate lies on the object's own texture. That of an endless plane is a picture that is
regular near the other objects and ever coarser away from them. A mesh has texels at nodes on its triangles, between
which light is interpolated: charts of its texture have edges at arbitrary places, and the large texels of a map would
spread light across them.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from irodori.geometry.mesh import Mesh
from irodori.geometry.shapes.mesh_nodes import lattice_place, mesh_nodes
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.surface_nodes import Nodes, middle_and_reach, quadrangles, raised, unwarped
from irodori.rendering.light_maps import look_up

#: Points by which each of the other objects is represented when the picture of an endless plane is laid out.
_SAMPLES = 256
#: Texels of the pictures on which the points between a map's texels lie, relative to those of the map, along each side.
_FINER = 1.37


class Points(NamedTuple):
    """Points on a surface in the world."""

    point: np.ndarray  # (n, 3) mm
    normal: np.ndarray  # (n, 3) unit, of shading
    facet: np.ndarray  # (n, 3) unit, of the surface itself


class Layout(ABC):
    """Texels of one object's light map; their number follows from the largest number ``most`` that is asked for."""

    #: Middle and reach of an endless plane's picture along x and y of its frame, mm; zeros for other shapes.
    grid = np.zeros(4)

    @abstractmethod
    def size(self, most: int) -> tuple[int, int]:
        """Return rows and columns of the map; one row for a mesh."""

    @abstractmethod
    def points(self, most: int) -> Points:
        """Return the places of the texels, row by row."""

    @abstractmethod
    def cells(self, most: int) -> np.ndarray:
        """Return the groups of texels between which light is interpolated, (c, 3 or 4) int."""

    @abstractmethod
    def between(self, picture: np.ndarray, most: int, count: int, seed: int) -> tuple[Points, np.ndarray]:
        """Return random points between the texels, and a map (rows, columns, k) interpolated at them, (n, k)."""

    def triangles(self, most: int) -> tuple[np.ndarray, np.ndarray]:
        """Return parts and corners of the triangles of a mesh, see `irodori.geometry.shapes.surface_nodes.Nodes`."""
        return np.zeros(0, np.int32), np.zeros(0, np.int32)


class _Picture(Layout):
    """Texels in rows and columns over the texture coordinates u and v."""

    wraps = False

    @abstractmethod
    def at(self, size: tuple[int, int]) -> Points:
        """Return the points at the texel centres of a picture of (rows, columns) texels."""

    def points(self, most: int) -> Points:
        return self.at(self.size(most))

    def cells(self, most: int) -> np.ndarray:
        rows, columns = self.size(most)
        number = np.arange(rows * columns).reshape(rows, columns)
        return quadrangles(np.concatenate([number, number[:, :1]], axis=1) if self.wraps else number)

    def between(self, picture: np.ndarray, most: int, count: int, seed: int) -> tuple[Points, np.ndarray]:
        rows, columns = (round(_FINER * side) for side in picture.shape[:2])
        chosen = np.random.default_rng(seed).permutation(rows * columns)[:count]
        u, v = (chosen % columns + 0.5) / columns, (chosen // columns + 0.5) / rows
        return Points(*(values[chosen] for values in self.at((rows, columns)))), look_up(picture, u, v, self.wraps)


class _OnTexture(_Picture):
    """Texels of the object's own texture."""

    def __init__(self, placement: Placement, sign: float) -> None:
        self.placement, self.wraps, self.sign = placement, placement.shape.wraps, sign

    def size(self, most: int) -> tuple[int, int]:
        """Return rows and columns of texels that are nearly square on the shape."""
        width, height = (2.0, 1.0) if self.wraps else self.placement.shape.size_mm
        columns = max(round(float(np.sqrt(most * width / height))), 4)
        return max(round(most / columns), 4), columns

    def at(self, size: tuple[int, int]) -> Points:
        atlas = self.placement.shape.atlas(size[1], size[0])
        turn = self.sign * self.placement.rotation.T
        normal, facet = (side.reshape(-1, 3) @ turn for side in (atlas.normal, atlas.facet))
        return Points(self.placement.points(atlas.position).reshape(-1, 3), normal, facet)


class _OnPlane(_Picture):
    """Texels of an endless plane, regular within a reach and ever larger outside."""

    def __init__(self, placement: Placement, others: list[np.ndarray]) -> None:
        self.turn, self.origin = placement.rotation, placement.shape.frame_origin(placement)
        self.grid = np.array([0.0, 0.0, 1.0, 1.0])
        if others:
            self.grid = np.concatenate(middle_and_reach([(p - self.origin) @ self.turn for p in others]))

    def size(self, most: int) -> tuple[int, int]:
        side = round(most**0.5)
        return side, side

    def at(self, size: tuple[int, int]) -> Points:
        middle, reach = self.grid[:2], self.grid[2:]
        v, u = ((np.arange(count) + 0.5) / count for count in size)
        x, y = (values.ravel() for values in np.meshgrid(*(
            middle[axis] + reach[axis] * unwarped(2.0 * place - 1.0) for axis, place in enumerate((u, v))
        )))  # fmt: skip
        facet = np.broadcast_to(self.turn[:, 2], (x.size, 3))
        return Points(self.origin + x[:, None] * self.turn[:, 0] + y[:, None] * self.turn[:, 1], facet, facet)


class _OnMesh(Layout):
    """Texels at nodes on the triangles of a mesh."""

    def __init__(self, placement: Placement, mesh: Mesh, sign: float) -> None:
        self.placement, self.mesh, self.sign = placement, mesh, sign
        self._nodes = lru_cache(maxsize=1)(self._lay_out)

    def _lay_out(self, most: int) -> Nodes:
        return mesh_nodes(self.mesh, self.placement, most)

    def size(self, most: int) -> tuple[int, int]:
        return 1, len(self._nodes(most).origin)

    def points(self, most: int) -> Points:
        nodes = self._nodes(most)
        origin, facet = nodes.origin, self.sign * nodes.facet
        for _ in range(2 if self.sign < 0.0 else 0):  # nodes are above the front
            origin = raised(origin, facet, self.placement.shape.reach_mm * self.placement.scale)
        return Points(origin, self.sign * nodes.normal, facet)

    def cells(self, most: int) -> np.ndarray:
        return self._nodes(most).cells

    def triangles(self, most: int) -> tuple[np.ndarray, np.ndarray]:
        return self._nodes(most).parts, self._nodes(most).corners

    def between(self, picture: np.ndarray, most: int, count: int, seed: int) -> tuple[Points, np.ndarray]:
        """Return points that are spread evenly over the area, and the map there."""
        rng, corner = np.random.default_rng(seed), self.mesh.vertices_mm[self.mesh.faces]
        area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
        chosen = rng.choice(len(area), count, p=area / area.sum())
        root, along = np.sqrt(rng.random(count)), rng.random(count)
        weight = np.stack([1.0 - root, root * (1.0 - along), root * along], axis=1)[:, :, None]
        facet = self.mesh.facets[chosen]
        normal = (weight * self.mesh.normals[chosen]).sum(axis=1)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = np.where(length > 1e-6, normal / np.maximum(length, 1e-6), facet)
        turn, local = self.sign * self.placement.rotation.T, (weight * corner[chosen]).sum(axis=1)
        shown = np.stack([self._at(picture[0], most, t, *w[1:, 0]) for t, w in zip(chosen, weight, strict=True)])
        return Points(self.placement.points(local), normal @ turn, facet @ turn), shown

    def _at(self, values: np.ndarray, most: int, triangle: int, b: float, c: float) -> np.ndarray:
        """Return the map at the barycentric weights of the second and third corner of a triangle, (k,)."""
        parts, corners = self.triangles(most)
        sides = parts[:triangle].astype(np.int64)
        places, weights = lattice_place(np.int64(parts[triangle]), b, c)
        first = int(((sides + 1) * (sides + 2) // 2).sum())
        return np.array(weights) @ values[corners[first + np.array(places)]]


def make_layout(placements: Sequence[Placement], index: int, sign: float = 1.0) -> Layout:
    """Return the layout of the light map of a placed shape, which for an endless plane depends on the other shapes.

    With ``sign`` -1, it is that of the back of a sheet: the places are the same, and the normals opposite.
    """
    own = placements[index]
    if own.shape.triangles is not None:
        return _OnMesh(own, own.shape.triangles, sign)
    if not own.shape.is_endless:
        return _OnTexture(own, sign)
    others = [p for number, p in enumerate(placements) if number != index and not p.shape.is_endless]
    return _OnPlane(own, [p.points(p.shape.samples(_SAMPLES)[0]) for p in others])
