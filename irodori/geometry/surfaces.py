"""Placed shapes as flat arrays for compiled loops: points, normals and texture coordinates of ray hits."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from irodori.geometry.shape_dispatch import chain
from irodori.geometry.shape_registry import number_of
from irodori.geometry.shapes.placement import Placement
from irodori.jit.compilation import njit


class Surfaces(NamedTuple):
    """Arrays of placed shapes, and of the triangles of all meshes among them."""

    kind: np.ndarray  # (shapes,), number of the shape in `irodori.geometry.shape_registry`
    rotation: np.ndarray  # (shapes, 3, 3) world_from_object
    translation_mm: np.ndarray  # (shapes, 3)
    scale: np.ndarray  # (shapes,)
    size_mm: np.ndarray  # (shapes, 2)
    first_face: np.ndarray  # (shapes,), index of the first triangle of each shape
    faces: np.ndarray  # (triangles, 3), indices into `vertices_mm`
    vertices_mm: np.ndarray  # (vertices, 3) object frame
    uv: np.ndarray  # (triangles, 3, 2)
    normals: np.ndarray  # (triangles, 3, 3) object frame


def make_surfaces(placements: Sequence[Placement]) -> Surfaces:
    """Collect placed shapes in flat arrays; shape i is placement i."""
    meshes = [p.shape.triangles for p in placements if p.shape.triangles is not None]
    sizes = np.array(
        [len(p.shape.triangles.faces) if p.shape.triangles is not None else 0 for p in placements], dtype=np.int64
    )
    before = np.cumsum([0] + [len(mesh.vertices_mm) for mesh in meshes])[:-1]
    return Surfaces(
        kind=np.array([number_of(p.shape) for p in placements]),
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
    """Concatenate arrays; a single array is not copied, because meshes are large."""
    if len(arrays) == 1:
        return np.ascontiguousarray(arrays[0])  # compiled loops exist for this memory order
    return np.concatenate(arrays) if arrays else np.zeros((0, *shape), dtype=dtype)


_surface_at = chain("surface_at", "surfaces, index, ray, point, normal, facet", __name__, inline="always")


@njit(cache=True, forceinline=True)
def surface_at(surfaces, index, ray, point, normal, facet):
    """Move a hit point onto its surface, fill its normals, and return its texture coordinates.

    Parameters
    ----------
    surfaces : Surfaces
    index : int
        Shape that was hit.
    ray : irodori.geometry.embree.Ray
        Ray that hit the shape; for a mesh it contains the triangle and the place in it.
    point : (3,) float64
        Traced point, mm; moved onto the surface.
    normal, facet : (3,) float64
        Filled with the outward unit shading normal and the outward unit geometric normal.

    Returns
    -------
    u, v : float
        Texture coordinates, 0..1.
    """
    return _surface_at(surfaces.kind[index], surfaces, index, ray, point, normal, facet)


@njit(cache=True, forceinline=True)
def face_viewer(normal, facet, direction):
    """Return the cosine between the shading normal and the direction to the viewer; not positive if seen from behind.

    At the outline of a coarse mesh, the shading normal may face away although the surface faces the viewer. It is then
    replaced by the geometric normal.
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
