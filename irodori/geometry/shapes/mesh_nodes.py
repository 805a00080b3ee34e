"""Nodes of a triangle mesh, at which light is found (`irodori.geometry.shapes.surface_nodes`).

Triangles are divided evenly into as many smaller ones as the number of nodes allows. Those of a fine mesh are not
divided, and share nodes at their corners.
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from irodori.geometry.mesh import Mesh
from irodori.geometry.shapes.surface_nodes import Nodes, raised
from irodori.jit.compilation import njit

if TYPE_CHECKING:
    from irodori.geometry.shapes.placement import Placement

#: Nodes at an edge or a crease are moved by this share of their distance towards the centre of the triangle.
_INSET = 0.05
#: Number of steps between -1 and 1 to which components of normals are rounded when they are compared for equality.
_NORMAL_STEPS = 1022


def lattice(parts: int) -> np.ndarray:
    """Return barycentric weights of the points of a divided triangle, (points, 3), row by row.

    Each edge is divided into ``parts``.
    """
    rows = [(parts - i - j, i, j) for j in range(parts + 1) for i in range(parts + 1 - j)]
    return np.array(rows, dtype=np.float64) / parts


def _lattice_cells(parts: int) -> np.ndarray:
    """Return the small triangles of a divided triangle, (parts², 3), as indices of the points of `lattice`."""
    start = [j * (parts + 1) - j * (j - 1) // 2 for j in range(parts + 2)]
    cells = []
    for j in range(parts):
        for i in range(parts - j):
            a, b = start[j] + i, start[j + 1] + i
            cells.append((a, a + 1, b))
            if i + j < parts - 1:
                cells.append((b + 1, b, a + 1))
    return np.array(cells)


def _divisions(longest: np.ndarray, corners: int, most: int) -> np.ndarray:
    """Return the number of parts into which to divide the edges of each triangle, (m,) int.

    Parameters
    ----------
    longest : (m,) float
        Length of the longest edge of each triangle.
    corners : int
        Number of vertices of the mesh.
    most : int
        Largest number of nodes, unless the mesh has more vertices.
    """
    ones = np.ones(len(longest), dtype=np.int64)
    if corners >= most:
        return ones
    fine, coarse = longest.max() / most, longest.max()
    for _ in range(40):
        middle = math.sqrt(fine * coarse)
        parts = np.maximum(np.ceil(longest / middle), 1.0)
        if corners + np.where(parts > 1.0, 0.5 * (parts + 1.0) * (parts + 2.0), 0.0).sum() > most:
            fine = middle
        else:
            coarse = middle
    return np.maximum(np.ceil(longest / coarse), ones).astype(np.int64)


def _shared_corners(mesh: Mesh, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the nodes shared by corners of selected triangles; corners share a node if vertex and normal are equal.

    Returns
    -------
    node : (corners,) int
        Node of each corner.
    first : (nodes,) int
        First corner with each node.
    whole : (nodes,) bool
        Whether the triangles with the node lie all around the vertex, so that it is not on an edge of the surface or on
        a crease.
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


def mesh_nodes(mesh: Mesh, placement: "Placement", most: int) -> Nodes:
    """Lay out the nodes of a placed mesh: at most ``most``, unless it has more vertices."""
    world = placement.points(mesh.vertices_mm)
    a, b, c = (world[mesh.faces[:, k]] for k in range(3))
    longest = np.sqrt(np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0))
    parts = _divisions(longest, len(world), most)
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
    point, normal, facet = (np.concatenate(part) for part in zip(*found, strict=True))
    reach = placement.shape.reach_mm * placement.scale
    normal, facet = normal @ placement.rotation.T, facet @ placement.rotation.T
    origin = raised(placement.points(point), facet, reach)
    return Nodes(origin, normal, facet, np.concatenate(cells), parts.astype(np.int32), corners)


def _unit(vectors: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Normalise vectors, (..., 3); those without length are replaced by ``other``."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-6, vectors / np.maximum(length, 1e-6), other)


def _corner_nodes(mesh: Mesh, chosen: np.ndarray) -> tuple[tuple, np.ndarray]:
    """Lay out nodes at the corners of selected triangles.

    Returns
    -------
    tuple
        Points, normals and facet normals of the nodes, (nodes, 3) each, in the object frame.
    (triangles, 3) int
        Nodes of each triangle.
    """
    node, first, whole = _shared_corners(mesh, chosen)
    triangle, corner = chosen[first // 3], first % 3
    vertex = mesh.vertices_mm[mesh.faces[triangle, corner]]
    centre = mesh.vertices_mm[mesh.faces[triangle]].mean(axis=1)
    facet = mesh.facets[triangle]
    normal = _unit(mesh.normals[triangle, corner], facet)
    # A vertex surrounded by triangles uses its own normal, which is as good as that of any triangle. At an edge or a
    # crease, the node is moved into one triangle, away from whatever the edge touches.
    inset = np.where(whole, 0.0, _INSET)[:, None]
    point = vertex + inset * (centre - vertex)
    facet = np.where(whole[:, None], normal, facet)
    return (point, normal, facet), node.reshape(-1, 3)


def _divided_nodes(mesh: Mesh, chosen: np.ndarray, parts: int) -> tuple[tuple, np.ndarray]:
    """Lay out nodes as `_corner_nodes` does, for triangles that are divided and share no nodes."""
    weights, middle = lattice(parts), np.full(3, 1.0 / 3.0)
    inset = weights + _INSET / parts * (middle - weights)
    vertices = mesh.vertices_mm[mesh.faces[chosen]]
    point = np.einsum("pk,fkx->fpx", inset, vertices).reshape(-1, 3)
    facet = np.repeat(mesh.facets[chosen], len(weights), axis=0)
    normal = np.einsum("pk,fkx->fpx", weights, mesh.normals[chosen]).reshape(-1, 3)
    node = np.arange(len(point)).reshape(len(chosen), -1)
    return (point, _unit(normal, facet), facet), node


@njit(cache=True)
def lattice_place(parts, b, c):
    """Return the three points of a divided triangle around a place, the last of them twice, and their weights.

    ``b`` and ``c`` are the barycentric weights of the second and third corner.
    """
    x, y = min(max(b, 0.0), 1.0) * parts, min(max(c, 0.0), 1.0) * parts
    j = min(int(y), parts - 1)
    i = min(int(x), parts - 1 - j)
    fx, fy = min(x - i, 1.0), min(y - j, 1.0)
    here = j * (parts + 1) - j * (j - 1) // 2 + i
    above = here + parts + 1 - j
    if i + j == parts - 1 and fx + fy > 1.0:
        # Beyond the third edge of the triangle by rounding.
        fx = fx / (fx + fy)
        fy = 1.0 - fx
    if i + j == parts - 1 or fx + fy <= 1.0:
        return (here, here + 1, above, above), (1.0 - fx - fy, fx, fy, 0.0)
    return (above + 1, above, here + 1, here + 1), (fx + fy - 1.0, 1.0 - fx, 1.0 - fy, 0.0)
