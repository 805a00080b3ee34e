"""Surface points that store ambient occlusion, and the search for those around a hit.

Flat shapes have a grid whose middle lies where the scene's meshes stand: even as far as these are near, and from there
on ever coarser, so that an endless plane has a finite one. Spheres have a grid over their texture coordinates.
Triangles of a mesh are divided evenly into as many smaller ones as the nodes allow; those of a fine mesh are not, and
share nodes at their corners. A hit takes the values of the three or four nodes about it.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from irodori.geometry.mesh import Mesh
from irodori.geometry.shapes import PLANE, SPHERE, Placement

#: Nodes along each side of a flat shape's grid, and along a sphere's equator; a sphere has half as many rows.
FLAT_SIDE, EQUATOR = 128, 128
#: Nodes of a mesh, as far as its own corners are not more.
MESH_NODES = 1 << 14
#: Nodes rise this part of their coordinates, or of their shape's reach, above the surface, as hits do.
_RISE = 2.0**-18
#: Nodes at an edge or a crease keep this part of their distance from the middle of the triangle away from it.
_INSET = 0.05
#: Corners share a node where their normals agree in so many steps between -1 and 1.
_NORMAL_STEPS = 1022


@dataclass(frozen=True)
class Nodes:
    """Nodes of one shape, in the world.

    Parameters
    ----------
    origin : (n, 3) float64
        Where rays begin, mm.
    normal, facet : (n, 3) float64
        Unit shading normal, and the unit normal of the surface itself.
    probe : (n, 3) float64
        A point above the surface near each node that sees it, unless something is pushed through the surface between
        them; the node's own origin where there is none.
    cells : (c, 3 or 4) int
        Nodes that are interpolated between, a tuple of arrays where their number differs.
    grid : (GRID,) float64
        Of a flat shape or a sphere, see `Grid`; zeros of a mesh.
    parts : (triangles,) int32
        Of a mesh: into how many parts each edge of a triangle is divided.
    corners : (places,) int32
        Of a mesh: the nodes of its triangles' places, one triangle after the other, row by row from the first edge.
    """

    origin: np.ndarray
    normal: np.ndarray
    facet: np.ndarray
    probe: np.ndarray
    cells: np.ndarray
    grid: np.ndarray
    parts: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))
    corners: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))


#: Numbers of a grid: columns, rows; of a flat one, along both axes of its frame, the middle, the reach (mm) within
#: which it is even, the place of the first node, and nodes a unit of places, see `warped`.
COLUMNS, ROWS, MIDDLE, REACH, LOW, DENSITY, GRID = 0, 1, 2, 4, 6, 8, 10
#: Part of a mesh's height, from its lowest point on, by which it stands on something.
_FOOT = 0.1
#: Part of a grid's larger reach that the smaller one has at least.
_LEAST = 0.02


def warped(offset: np.ndarray) -> np.ndarray:
    """Return places, -1..1, of offsets in units of the reach: half of them within it, evenly."""
    away = np.maximum(np.abs(offset), 1.0)
    return np.where(np.abs(offset) <= 1.0, 0.5 * offset, np.sign(offset) * (1.0 - 0.5 / away))


def _unwarped(place: np.ndarray) -> np.ndarray:
    left = np.maximum(1.0 - np.abs(place), 1e-12)
    return np.where(np.abs(place) <= 0.5, 2.0 * place, np.sign(place) * 0.5 / left)


def frame_origin(placement: Placement) -> np.ndarray:
    """Return the origin of a flat shape's frame, (3,) mm: of a plane the point nearest to the world's origin."""
    if placement.shape.kind == PLANE:
        axis = placement.rotation[:, 2]
        return (placement.translation_mm @ axis) * axis
    return placement.translation_mm


def _raised(point: np.ndarray, facet: np.ndarray, reach_mm: float) -> np.ndarray:
    size = np.maximum(np.abs(point).max(axis=-1, keepdims=True), reach_mm)
    return point + _RISE * size * facet


def _quadrangles(number: np.ndarray) -> np.ndarray:
    """Return the cells of a grid of nodes, (c, 4)."""
    corners = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    return np.stack([corner.ravel() for corner in corners], axis=1)


def _middle_and_reach(points: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return middle and reach of a flat shape's grid along both axes, (2,) each, mm.

    The grid is even as far as meshes stand on the shape, as half of what they hang over, and as half of the height of
    the lowest where none stands on it: what is far above throws soft shadows.

    Parameters
    ----------
    points : list of (vertices, 3) float
        Of each mesh, in the shape's frame, mm.
    """
    above = [p for p in points if p[:, 2].max() > 0.0] or points
    above = [np.column_stack([p[:, :2], np.maximum(p[:, 2], 0.0)]) for p in above]
    feet = [p[p[:, 2] <= p[:, 2].min() + _FOOT * np.ptp(p[:, 2]), :2] for p in above]
    low, high = (np.array([end(foot, axis=0) for foot in feet]) for end in (np.min, np.max))
    low, high = low.min(axis=0), high.max(axis=0)
    everything = np.concatenate(above)
    middle = 0.5 * (low + high)
    away = np.abs(everything[:, :2] - middle).max(axis=0)
    least = max(0.5 * everything[:, 2].min(), _LEAST * away.max(), np.finfo(np.float32).tiny)
    return middle, np.maximum(np.maximum(0.5 * (high - low), 0.5 * away), least)


def flat_nodes(placement: Placement, reach_mm: float, points: list[np.ndarray]) -> Nodes:
    """Return the nodes of a plate, a disc or a plane.

    Parameters
    ----------
    placement : Placement
    reach_mm : float
        See `irodori.geometry.shapes.reaches`.
    points : list of (vertices, 3) float
        Of each of the scene's meshes, in the world, mm.
    """
    turn, origin = placement.rotation, frame_origin(placement)
    middle, reach = _middle_and_reach([(p - origin) @ turn for p in points])
    side, places = FLAT_SIDE, []
    for axis in range(2):
        if placement.shape.kind == PLANE:
            ends = np.array([-1.0, 1.0]) * (1.0 - 1.0 / side)
        else:
            half = 0.5 * placement.shape.size_mm[axis] * placement.scale
            ends = warped((np.array([-half, half]) - middle[axis]) / reach[axis])
        places.append(np.linspace(*ends, side))
    x, y = (middle[axis] + reach[axis] * _unwarped(places[axis]) for axis in range(2))
    x, y = (values.ravel() for values in np.meshgrid(x, y))
    facet = np.broadcast_to(turn[:, 2], (x.size, 3))
    point = _raised(origin + x[:, None] * turn[:, 0] + y[:, None] * turn[:, 1], facet, reach_mm)
    density = [(side - 1) / (p[-1] - p[0]) for p in places]
    grid = np.array([side, side, *middle, *reach, *(p[0] for p in places), *density])
    cells = _quadrangles(np.arange(side * side).reshape(side, side))
    return Nodes(point, facet, facet, point, cells, grid)


def sphere_nodes(placement: Placement) -> Nodes:
    """Return the nodes of a sphere: the middles of the texels that a texture of `EQUATOR` columns would have."""
    columns, rows = EQUATOR, EQUATOR // 2
    azimuth = (np.arange(columns) + 0.5) * 2.0 * np.pi / columns
    theta = (np.arange(rows) + 0.5) * np.pi / rows
    azimuth, theta = (values.ravel() for values in np.meshgrid(azimuth, theta))
    local = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=1)
    away = np.stack([np.cos(theta) * np.cos(azimuth), np.cos(theta) * np.sin(azimuth), -np.sin(theta)], axis=1)
    away *= np.where(theta < 0.5 * np.pi, 1.0, -1.0)[:, None]  # towards the equator
    normal, away = local @ placement.rotation.T, away @ placement.rotation.T
    radius = placement.shape.size_mm[0] * placement.scale
    origin = _raised(placement.translation_mm + radius * normal, normal, radius)
    probe = origin + 0.5 * radius * np.pi / rows * away
    number = np.arange(rows * columns).reshape(rows, columns)
    cells = _quadrangles(np.concatenate([number, number[:, :1]], axis=1))
    grid = np.array([columns, rows, *[0.0] * (GRID - 2)])
    return Nodes(origin, normal, normal, probe, cells, grid)


# --- meshes ----------------------------------------------------------------------------------------------------------


def lattice(parts: int) -> np.ndarray:
    """Return the weights of a triangle's corners at the places of a division, (places, 3), row by row."""
    rows = [(parts - i - j, i, j) for j in range(parts + 1) for i in range(parts + 1 - j)]
    return np.array(rows, dtype=np.float64) / parts


def _lattice_cells(parts: int) -> np.ndarray:
    """Return the small triangles of a division, (parts², 3) places."""
    start = [j * (parts + 1) - j * (j - 1) // 2 for j in range(parts + 2)]
    cells = []
    for j in range(parts):
        for i in range(parts - j):
            a, b = start[j] + i, start[j + 1] + i
            cells.append((a, a + 1, b))
            if i + j < parts - 1:
                cells.append((b + 1, b, a + 1))
    return np.array(cells)


def _divisions(longest: np.ndarray, corners: int) -> np.ndarray:
    """Return into how many parts to divide the edges of triangles by the length of their longest, (m,) int."""
    ones = np.ones(len(longest), dtype=np.int64)
    if corners >= MESH_NODES:
        return ones
    fine, coarse = longest.max() / MESH_NODES, longest.max()
    for _ in range(40):
        middle = math.sqrt(fine * coarse)
        parts = np.maximum(np.ceil(longest / middle), 1.0)
        if corners + np.where(parts > 1.0, 0.5 * (parts + 1.0) * (parts + 2.0), 0.0).sum() > MESH_NODES:
            fine = middle
        else:
            coarse = middle
    return np.maximum(np.ceil(longest / coarse), ones).astype(np.int64)


def _shared_corners(mesh: Mesh, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the node of each corner of chosen triangles, and each node's first corner and whether it has a whole ring.

    A node is a vertex and a normal. Its ring is whole where the triangles that share it lie all around the vertex:
    neither an edge of the surface nor a crease is there.
    """
    faces = mesh.faces[chosen].astype(np.int64)
    steps = np.round((mesh.normals[chosen] + 1.0) * (0.5 * _NORMAL_STEPS)).astype(np.int64)
    key = ((faces << 10 | steps[..., 0]) << 10 | steps[..., 1]) << 10 | steps[..., 2]
    _, first, node = np.unique(key.ravel(), return_index=True, return_inverse=True)
    node = node.reshape(-1)
    beside = np.stack([np.roll(faces, -1, axis=1), np.roll(faces, 1, axis=1)], axis=-1).reshape(-1, 2)
    pair, count = np.unique((node[:, None] * len(mesh.vertices_mm) + beside).ravel(), return_counts=True)
    whole = np.ones(len(first), dtype=bool)
    whole[pair[count != 2] // len(mesh.vertices_mm)] = False
    return node, first, whole


def mesh_nodes(placement: Placement) -> Nodes:
    """Return the nodes of a mesh."""
    mesh = placement.shape.mesh
    world = placement.points(mesh.vertices_mm)
    a, b, c = (world[mesh.faces[:, k]] for k in range(3))
    longest = np.sqrt(np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0))
    parts = _divisions(longest, len(world))
    sizes = (parts + 1) * (parts + 2) // 2
    first = np.cumsum(sizes) - sizes
    corners = np.empty(sizes.sum(), dtype=np.int32)
    found, cells, count = [], [], 0
    for number in np.unique(parts):
        chosen = np.flatnonzero(parts == number)
        if number == 1:
            local, node = _corner_nodes(mesh, chosen)
        else:
            local, node = _divided_nodes(mesh, chosen, int(number))
        found.append(local)
        corners[first[chosen][:, None] + np.arange(node.shape[1])] = count + node
        cells.append(count + node[:, _lattice_cells(int(number))].reshape(-1, 3))
        count += len(local[0])
    point, normal, facet, beside = (np.concatenate(part) for part in zip(*found, strict=True))
    reach = placement.shape.reach_mm * placement.scale
    normal, facet = normal @ placement.rotation.T, facet @ placement.rotation.T
    origin, probe = (_raised(placement.points(p), facet, reach) for p in (point, beside))
    return Nodes(origin, normal, facet, probe, np.concatenate(cells), np.zeros(GRID), parts.astype(np.int32), corners)


def _unit(vectors: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return vectors at unit length, others where they have none."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-6, vectors / np.maximum(length, 1e-6), other)


def _corner_nodes(mesh: Mesh, chosen: np.ndarray) -> tuple[tuple, np.ndarray]:
    """Return nodes at the corners of triangles (points, normals, facets, probes), and those of each triangle."""
    node, first, whole = _shared_corners(mesh, chosen)
    triangle, corner = chosen[first // 3], first % 3
    vertex = mesh.vertices_mm[mesh.faces[triangle, corner]]
    centre = mesh.vertices_mm[mesh.faces[triangle]].mean(axis=1)
    facet = mesh.facets[triangle]
    normal = _unit(mesh.normals[triangle, corner], facet)
    # All about a vertex the surface falls away or rises: its own normal is as good as that of any triangle. At an edge
    # the node lies in one triangle, clear of what the edge touches.
    inset = np.where(whole, 0.0, _INSET)[:, None]
    point = vertex + inset * (centre - vertex)
    facet = np.where(whole[:, None], normal, facet)
    return (point, normal, facet, centre), node.reshape(-1, 3)


def _divided_nodes(mesh: Mesh, chosen: np.ndarray, parts: int) -> tuple[tuple, np.ndarray]:
    """Do what `_corner_nodes` does for triangles that are divided and share no nodes."""
    weights, middle = lattice(parts), np.full(3, 1.0 / 3.0)
    inset = weights + _INSET / parts * (middle - weights)
    # As far away as the middle of a small triangle is from its corner.
    beside = weights + (middle - weights) / parts
    vertices = mesh.vertices_mm[mesh.faces[chosen]]
    point, probe = (np.einsum("pk,fkx->fpx", w, vertices).reshape(-1, 3) for w in (inset, beside))
    facet = np.repeat(mesh.facets[chosen], len(weights), axis=0)
    normal = np.einsum("pk,fkx->fpx", weights, mesh.normals[chosen]).reshape(-1, 3)
    node = np.arange(len(point)).reshape(len(chosen), -1)
    return (point, _unit(normal, facet), facet, probe), node


def make_nodes(placement: Placement, reach_mm: float, points: list[np.ndarray]) -> Nodes:
    """Return the nodes of any shape; parameters as of `flat_nodes`."""
    if placement.shape.mesh is not None:
        return mesh_nodes(placement)
    if placement.shape.kind == SPHERE:
        return sphere_nodes(placement)
    return flat_nodes(placement, reach_mm, points)
