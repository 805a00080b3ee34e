"""Placed shapes as flat arrays for compiled loops: points, normals and texture coordinates of ray hits."""

import math
from typing import NamedTuple

import numpy as np

from irodori.geometry.embree import hit_barycentric, hit_primitive
from irodori.geometry.shapes import MESH, SPHERE, Placement, uv_from_point
from irodori.jit.native import njit


class Surfaces(NamedTuple):
    """Placed shapes; the first axis of the first block counts them, that of the second all triangles of all meshes."""

    kind: np.ndarray  # (shapes,)
    rotation: np.ndarray  # (shapes, 3, 3) world_from_object
    translation_mm: np.ndarray  # (shapes, 3)
    scale: np.ndarray  # (shapes,)
    size_mm: np.ndarray  # (shapes, 2)
    first_face: np.ndarray  # (shapes,)

    faces: np.ndarray  # (triangles, 3) into `vertices_mm`
    vertices_mm: np.ndarray  # (vertices, 3) object frame
    uv: np.ndarray  # (triangles, 3, 2)
    normals: np.ndarray  # (triangles, 3, 3) object frame


def make_surfaces(placements: list[Placement]) -> Surfaces:
    """Return placed shapes in flat arrays; shape i is placement i."""
    meshes = [p.shape.mesh for p in placements if p.shape.mesh is not None]
    sizes = np.array([len(p.shape.mesh.faces) if p.shape.mesh is not None else 0 for p in placements], dtype=np.int64)
    before = np.cumsum([0] + [len(mesh.vertices_mm) for mesh in meshes])[:-1]
    return Surfaces(
        kind=np.array([p.shape.kind for p in placements]),
        rotation=np.stack([p.rotation for p in placements]).astype(np.float64),
        translation_mm=np.stack([p.translation_mm for p in placements]).astype(np.float64),
        scale=np.array([p.scale for p in placements], dtype=np.float64),
        size_mm=np.array([p.shape.size_mm for p in placements], dtype=np.float64),
        first_face=np.cumsum(sizes) - sizes,
        faces=_joined(
            [m.faces + np.int32(n) if n else m.faces for m, n in zip(meshes, before, strict=True)], 3, dtype=np.int32
        ),
        vertices_mm=_joined([mesh.vertices_mm for mesh in meshes], 3),
        uv=_joined([mesh.uv for mesh in meshes], 3, 2),
        normals=_joined([mesh.normals for mesh in meshes], 3, 3),
    )


def _joined(arrays: list[np.ndarray], *shape: int, dtype=np.float64) -> np.ndarray:
    """Return arrays one after the other; the array itself where there is one, for meshes are large."""
    if len(arrays) == 1:
        return arrays[0]
    return np.concatenate(arrays) if arrays else np.zeros((0, *shape), dtype=dtype)


# Fields are indexed in full: a view of an array counts its owners, and two threads would fight over the count.


@njit(cache=True, error_model="numpy")
def _on_mesh(surfaces, index, ray, point, normal, facet):
    """Fill point and normals of a hit on a mesh from its barycentric coordinates; return u, v."""
    face = surfaces.first_face[index] + hit_primitive(ray)
    b, c = hit_barycentric(ray)
    b, c = max(float(b), 0.0), max(float(c), 0.0)
    a = max(1.0 - b - c, 0.0)
    i, j, k = surfaces.faces[face, 0], surfaces.faces[face, 1], surfaces.faces[face, 2]
    local, shading, across = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
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


@njit(cache=True, inline="always")
def surface_at(surfaces, index, ray, point, normal, facet):
    """Move a hit point onto its surface, fill its normals, and return its texture coordinates.

    Parameters
    ----------
    surfaces : Surfaces
    index : int
        Shape that was hit.
    ray : irodori.geometry.embree.Ray
        That met it; of a mesh the triangle and the place in it are read from here.
    point : (3,) float64
        Traced point, mm; moved onto the surface.
    normal, facet : (3,) float64
        Filled with the unit shading normal and the unit normal of the surface itself, outward.

    Returns
    -------
    u, v : float, 0..1
    """
    kind = surfaces.kind[index]
    if kind == MESH:
        return _on_mesh(surfaces, index, ray, point, normal, facet)
    x = point[0] - surfaces.translation_mm[index, 0]
    y = point[1] - surfaces.translation_mm[index, 1]
    z = point[2] - surfaces.translation_mm[index, 2]
    inverse = 1.0 / surfaces.scale[index]
    ox, oy, oz = 0.0, 0.0, 0.0
    for a, value in enumerate((x, y, z)):
        ox += surfaces.rotation[index, a, 0] * value * inverse
        oy += surfaces.rotation[index, a, 1] * value * inverse
        oz += surfaces.rotation[index, a, 2] * value * inverse
    if kind == SPHERE:
        length = math.sqrt(x * x + y * y + z * z)
        radius = surfaces.size_mm[index, 0] * surfaces.scale[index]
        for a in range(3):
            normal[a] = (point[a] - surfaces.translation_mm[index, a]) / length
            point[a] = surfaces.translation_mm[index, a] + radius * normal[a]
            facet[a] = normal[a]
    else:
        offset = oz * surfaces.scale[index]
        for a in range(3):
            normal[a] = surfaces.rotation[index, a, 2]
            point[a] -= offset * normal[a]
            facet[a] = normal[a]
    return uv_from_point(kind, surfaces.size_mm[index, 0], surfaces.size_mm[index, 1], ox, oy, oz)


@njit(cache=True, inline="always")
def face_viewer(normal, facet, direction):
    """Return the cosine between the shading normal and the way back to the viewer; not positive seen from behind.

    Where the surface is seen from its front and the shading normal alone looks away, as it may at the outline of
    a coarse mesh, the surface's own normal takes its place.
    """
    front = -(facet[0] * direction[0] + facet[1] * direction[1] + facet[2] * direction[2])
    if front <= 0.0:
        return front
    cosine = -(normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2])
    if cosine <= 0.0:
        for a in range(3):
            normal[a] = facet[a]
        return front
    return cosine
