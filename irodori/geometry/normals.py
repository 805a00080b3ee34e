"""Computation of shading normals for a mesh without normals: angle-weighted means over the triangles at a vertex.

Source: Thürmer and Wüthrich, *Computing vertex normals from polygonal facets*, Journal of Graphics Tools 3(1), 1998.
"""

import math

import numpy as np

from irodori.jit.compilation import njit


@njit(cache=True, forceinline=True)
def _edge(vertices, start, end):
    """Return the vector from one vertex to another."""
    return (
        vertices[end, 0] - vertices[start, 0],
        vertices[end, 1] - vertices[start, 1],
        vertices[end, 2] - vertices[start, 2],
    )


@njit(cache=True, forceinline=True)
def _corner_angle(vertices, faces, face, corner):
    """Return the angle of a triangle at one of its corners, rad."""
    a, b, c = faces[face, corner], faces[face, (corner + 1) % 3], faces[face, (corner + 2) % 3]
    (ux, uy, uz), (vx, vy, vz) = _edge(vertices, a, b), _edge(vertices, a, c)
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return math.atan2(math.sqrt(x**2 + y**2 + z**2), ux * vx + uy * vy + uz * vz)


@njit(cache=True)
def _angles(vertices, faces, out):
    for face in range(faces.shape[0]):
        for corner in range(3):
            out[face, corner] = _corner_angle(vertices, faces, face, corner)


@njit(cache=True)
def _gather(first, members, facets, angle, cosine, out):
    """Fill the normals of all corners; ``members`` lists the corners at vertex i from the index ``first[i]`` on."""
    total = np.empty(3)
    for vertex in range(first.size - 1):
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
    corners = vertices[faces]
    facets = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facets /= np.linalg.norm(facets, axis=1, keepdims=True)
    angle = np.empty(faces.shape)
    _angles(vertices, faces, angle)
    members = np.argsort(faces.ravel(), kind="stable")
    first = np.searchsorted(faces.ravel()[members], np.arange(len(vertices) + 1))
    out = np.empty((*faces.shape, 3))
    # With rounding, the scalar product of two equal normals may be below the cosine of 0 degrees.
    _gather(first, members, facets, angle, math.cos(math.radians(crease_deg)) - 1e-9, out)
    return out
