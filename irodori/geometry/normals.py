"""Computation of shading normals for a mesh without normals: angle-weighted means over the triangles at a vertex.

Source: Thürmer and Wüthrich, *Computing vertex normals from polygonal facets*, Journal of Graphics Tools 3(1), 1998.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit

_CHUNK = 16384  # vertices that a thread takes at a time


class _Corners(NamedTuple):
    """Corners of triangles by vertex, and what their triangles contribute."""

    first: np.ndarray  # (vertices + 1,) index in ``members`` of the first corner at each vertex
    members: np.ndarray  # (corners,) three times the triangle, plus the corner
    facets: np.ndarray  # (triangles, 3) unit normals
    angle: np.ndarray  # (triangles, 3) rad


@njit(cache=True, forceinline=True)
def _edge(vertices, start, end):
    """Return the vector from one vertex to another."""
    return (
        vertices[end, 0] - vertices[start, 0],
        vertices[end, 1] - vertices[start, 1],
        vertices[end, 2] - vertices[start, 2],
    )


@njit(cache=True)
def _measure(vertices, faces, facets, angle):
    """Fill the unit normals of triangles and the angles at their corners, rad."""
    for face in range(faces.shape[0]):
        for corner in range(3):
            a, b, c = faces[face, corner], faces[face, (corner + 1) % 3], faces[face, (corner + 2) % 3]
            (ux, uy, uz), (vx, vy, vz) = _edge(vertices, a, b), _edge(vertices, a, c)
            x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            across = math.sqrt(x**2 + y**2 + z**2)
            angle[face, corner] = math.atan2(across, ux * vx + uy * vy + uz * vz)
            if corner == 0:
                facets[face, 0], facets[face, 1], facets[face, 2] = x / across, y / across, z / across


@njit(cache=True)
def _list_members(faces, first, members):
    """List the corners at every vertex; ``first`` has those of vertex i counted at i + 1, and becomes the sums."""
    for vertex in range(first.size - 1):
        first[vertex + 1] += first[vertex]
    filled = first[:-1].copy()
    for face in range(faces.shape[0]):
        for corner in range(3):
            vertex = faces[face, corner]
            members[filled[vertex]] = 3 * face + corner
            filled[vertex] += 1


def _corners(vertices, faces) -> _Corners:
    """Sort the corners of triangles by vertex, and measure the triangles."""
    facets, angle = np.empty((len(faces), 3)), np.empty(faces.shape)
    _measure(vertices, faces, facets, angle)
    first, members = np.zeros(len(vertices) + 1, np.int64), np.empty(faces.size, np.int64)
    first[1:] = np.bincount(faces.ravel(), minlength=len(vertices))
    _list_members(faces, first, members)
    return _Corners(first, members, facets, angle)


@njit(cache=True, nogil=True)
def _gather(corners, cosine, out, start, end):
    """Fill the normals of the corners at the vertices from ``start`` to before ``end``, see `_Corners`."""
    first, members, facets, angle = corners
    total = np.empty(3)
    for vertex in range(start, end):
        for i in range(first[vertex], first[vertex + 1]):
            mine = members[i] // 3
            total[:] = 0.0
            for j in range(first[vertex], first[vertex + 1]):
                other = members[j] // 3
                along = 0.0
                for a in range(3):
                    along += facets[mine, a] * facets[other, a]
                if along >= cosine or other == mine:
                    for a in range(3):
                        total[a] += angle[other, members[j] % 3] * facets[other, a]
            length = math.sqrt(total[0] ** 2 + total[1] ** 2 + total[2] ** 2)
            for a in range(3):
                out[mine, members[i] % 3, a] = total[a] / length if length > 1e-12 else facets[mine, a]


@njit(cache=True, nogil=True)
def _compare(corners, cosine, out, start, end):
    """Fill the least cosines of the corners at the vertices from ``start`` to before ``end``, see `least_cosines`."""
    first, members, facets, _ = corners
    for vertex in range(start, end):
        for i in range(first[vertex], first[vertex + 1]):
            mine = members[i] // 3
            least = cosine
            for j in range(first[vertex], first[vertex + 1]):
                other = members[j] // 3
                along = 0.0
                for a in range(3):
                    along += facets[mine, a] * facets[other, a]
                least = min(least, along)
            out[mine, members[i] % 3] = max(least, -1.0)


def least_cosines(vertices, faces) -> np.ndarray:
    """Return the cosine of each triangle's normal with the farthest of those at each of its corners, (m, 3).

    Parameters are those of `corner_normals`.
    """
    out = np.empty(faces.shape)
    run_chunks(_compare, len(vertices), _CHUNK, _corners(vertices, faces), 1.0, out)
    return out


def corner_normals(vertices, faces, crease_deg: float) -> np.ndarray:
    """Compute unit shading normals at the corners of every triangle, (m, 3, 3) float64.

    Parameters
    ----------
    vertices : (n, 3) float
        Vertices, each position once.
    faces : (m, 3) int
        Triangles, all with an area.
    crease_deg : float
        Largest angle, degrees, between the normals of two triangles at a vertex that enter a common mean.
    """
    out = np.empty((*faces.shape, 3))
    # With rounding, the scalar product of two equal normals may be below the cosine of 0 degrees.
    cosine = math.cos(math.radians(crease_deg)) - 1e-9
    run_chunks(_gather, len(vertices), _CHUNK, _corners(vertices, faces), cosine, out)
    return out
