"""Meshes of quadrangles, each with a square of the texture to itself."""

import numpy as np

from irodori.geometry.mesh import Mesh, make_mesh
from irodori.geometry.shapes.shape import Shape
from irodori.geometry.shapes.triangle_mesh import TriangleMesh


def squares(*corners) -> Shape:
    """A mesh of quadrangles of four corners each, every one with a square of the texture to itself."""
    corners, count = np.array(corners, dtype=np.float64), len(corners)
    side = int(np.ceil(np.sqrt(count)))
    where = np.array([(i % side, i // side) for i in range(count)])
    unit = np.array([[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9]])
    uv = (where[:, None] + unit) / side
    turn = np.array([[0, 1, 2], [0, 2, 3]])
    return TriangleMesh(make_mesh(corners[:, turn].reshape(-1, 3, 3), uv[:, turn].reshape(-1, 3, 2)))


def box(half: float, outward: bool) -> Shape:
    """A cube about the origin of twelve triangles, seen from outside or, as a room, from inside."""
    faces = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            a, b = np.roll([0.0, 1.0, 0.0], axis), np.roll([0.0, 0.0, 1.0], axis)
            centre = sign * np.roll([1.0, 0.0, 0.0], axis)
            a, b = (a, b) if sign > 0 else (b, a)
            faces.append([half * (centre + p * a + q * b) for p, q in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    found = squares(*faces)
    if outward:
        return found
    # `make_mesh` refuses closed surfaces that look inward.
    mesh = found.mesh
    turned = Mesh(mesh.vertices_mm, mesh.faces[:, ::-1].copy(), mesh.uv[:, ::-1].copy(), -mesh.normals[:, ::-1])
    return TriangleMesh(turned)
