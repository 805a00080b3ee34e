"""Mapping of texel centres in the UV atlas of a mesh to triangles and points of the surface.

Both triangles at an edge compute on which side of it a texel centre lies from the same numbers, and a centre exactly on
the edge belongs to the triangle that has it as a top or left edge. So each centre inside a chart belongs to exactly one
triangle.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.core.errors import InputError
from irodori.geometry.mesh import Mesh
from irodori.jit.compilation import njit

NO_FACE = -1
#: Distance from a common edge, in texels, within which two neighbours may both own a centre because of rounding.
_ROUNDING = 1e-6
_FLAT = 1e-6  # largest range of the components of the normals of a flat surface


class Texels(NamedTuple):
    """Points of the surface at the texel centres of some rows of a texture.

    ``normal`` is the shading normal and ``facet`` the geometric normal; they differ only on meshes.
    """

    position: np.ndarray  # (height, width, 3) float64, object frame, mm; NaN where there is no surface
    normal: np.ndarray  # (height, width, 3) float64, unit vectors; NaN likewise
    facet: np.ndarray  # (height, width, 3) float64, unit vectors; NaN likewise
    covered: np.ndarray  # (height, width) bool, whether the texel lies on the surface


def are_alike(normals: np.ndarray) -> bool:
    """Return whether unit normals, (n, 3), are those of a flat surface."""
    return bool(np.ptp(normals, axis=0).max() < _FLAT)


class _Triangles(NamedTuple):
    """Arrays of a mesh for compiled loops, see `irodori.geometry.mesh.Mesh`."""

    vertices: np.ndarray  # (v, 3) mm
    faces: np.ndarray  # (n, 3)
    normals: np.ndarray  # (n, 3, 3), shading normals at the corners
    facets: np.ndarray  # (n, 3), geometric normals


@njit(cache=True, forceinline=True, error_model="numpy")
def _edge(ax, ay, bx, by, x, y):
    """Return twice the signed area of the triangle a, b, (x, y); exchanging a and b changes exactly the sign."""
    if ax < bx or (ax == bx and ay < by):
        return (bx - ax) * (y - ay) - (by - ay) * (x - ax)
    return -((ax - bx) * (y - by) - (ay - by) * (x - bx))


@njit(cache=True, forceinline=True, error_model="numpy")
def _holds(xy, face, x, y):
    """Return whether a triangle owns a point, and the signed distance of the point inside its nearest edge, texels."""
    ax, ay, bx, by = xy[face, 0, 0], xy[face, 0, 1], xy[face, 1, 0], xy[face, 1, 1]
    cx, cy = xy[face, 2, 0], xy[face, 2, 1]
    turn = 1.0 if _edge(ax, ay, bx, by, cx, cy) > 0.0 else -1.0
    owned, depth = True, np.inf
    for side in range(3):
        px, py, qx, qy = ax, ay, bx, by
        if side == 1:
            px, py, qx, qy = bx, by, cx, cy
        elif side == 2:
            px, py, qx, qy = cx, cy, ax, ay
        area = turn * _edge(px, py, qx, qy, x, y)
        dx, dy = turn * (qx - px), turn * (qy - py)
        if area < 0.0 or (area == 0.0 and not (dy < 0.0 or (dy == 0.0 and dx > 0.0))):
            owned = False
        depth = min(depth, area / math.sqrt(dx * dx + dy * dy))
    return owned, depth


@njit(cache=True, error_model="numpy")
def _overlap(xy, face, other, depth, x, y):
    """Return whether two triangles that both own a point overlap there."""
    if depth > _ROUNDING or _holds(xy, other, x, y)[1] > _ROUNDING:
        return True
    # On an edge of both: a point moved towards the centre of one leaves a neighbour, but not an overlapping triangle.
    cx = (xy[face, 0, 0] + xy[face, 1, 0] + xy[face, 2, 0]) / 3.0
    cy = (xy[face, 0, 1] + xy[face, 1, 1] + xy[face, 2, 1]) / 3.0
    return _holds(xy, other, x + 1e-2 * (cx - x), y + 1e-2 * (cy - y))[1] > 0.0


@njit(cache=True, error_model="numpy")
def _rasterise(xy, face_of, overlaps):
    """Fill the triangle at each texel centre, and mark centres where two triangles overlap.

    ``xy`` has the corners of the triangles in texels, with integers at texel centres.
    """
    height, width = face_of.shape
    for face in range(xy.shape[0]):
        if _edge(xy[face, 0, 0], xy[face, 0, 1], xy[face, 1, 0], xy[face, 1, 1], xy[face, 2, 0], xy[face, 2, 1]) == 0.0:
            continue
        x0, x1 = (
            min(xy[face, 0, 0], xy[face, 1, 0], xy[face, 2, 0]),
            max(xy[face, 0, 0], xy[face, 1, 0], xy[face, 2, 0]),
        )
        y0, y1 = (
            min(xy[face, 0, 1], xy[face, 1, 1], xy[face, 2, 1]),
            max(xy[face, 0, 1], xy[face, 1, 1], xy[face, 2, 1]),
        )
        for row in range(max(math.ceil(y0), 0), min(math.floor(y1), height - 1) + 1):
            for column in range(max(math.ceil(x0), 0), min(math.floor(x1), width - 1) + 1):
                owned, depth = _holds(xy, face, float(column), float(row))
                if not owned:
                    continue
                other = face_of[row, column]
                if other == NO_FACE:
                    face_of[row, column] = face
                elif _overlap(xy, face, other, depth, float(column), float(row)):
                    overlaps[row, column] = 1


@njit(cache=True, error_model="numpy")
def _locate(xy, face_of, first_row, triangles, texels):
    vertices, faces, normals, facets = triangles
    position, normal, facet, _ = texels
    for row in range(face_of.shape[0]):
        for column in range(face_of.shape[1]):
            face = face_of[row, column]
            if face == NO_FACE:
                position[row, column], normal[row, column], facet[row, column] = np.nan, np.nan, np.nan
                continue
            x, y = float(column), float(row + first_row)
            ax, ay, bx, by = xy[face, 0, 0], xy[face, 0, 1], xy[face, 1, 0], xy[face, 1, 1]
            cx, cy = xy[face, 2, 0], xy[face, 2, 1]
            wa, wb, wc = _edge(bx, by, cx, cy, x, y), _edge(cx, cy, ax, ay, x, y), _edge(ax, ay, bx, by, x, y)
            total, length = wa + wb + wc, 0.0
            for i in range(3):
                a, b, c = vertices[faces[face, 0], i], vertices[faces[face, 1], i], vertices[faces[face, 2], i]
                position[row, column, i] = (wa * a + wb * b + wc * c) / total
                mixed = (wa * normals[face, 0, i] + wb * normals[face, 1, i] + wc * normals[face, 2, i]) / total
                normal[row, column, i], facet[row, column, i] = mixed, facets[face, i]
                length += mixed * mixed
            length = math.sqrt(length)
            for i in range(3):
                normal[row, column, i] = normal[row, column, i] / length if length > 1e-6 else facets[face, i]


def _in_texels(mesh: Mesh, width: int, height: int) -> np.ndarray:
    return np.ascontiguousarray(mesh.uv * [width, height] - 0.5)


def rasterise(mesh: Mesh, width: int, height: int, file="mesh") -> np.ndarray:
    """Return the index of the triangle at each texel centre, (height, width) int32; `NO_FACE` outside the charts.

    Raises
    ------
    InputError
        If charts overlap (the message states in how many texels), or no texel centre lies in a chart.
    """
    face_of = np.full((height, width), NO_FACE, dtype=np.int32)
    overlaps = np.zeros((height, width), dtype=np.uint8)
    _rasterise(_in_texels(mesh, width, height), face_of, overlaps)
    if overlaps.any():
        found = f"charts that overlap in {int(overlaps.sum())} of {width} x {height} texels"
        raise InputError(file, "UV", found, "an atlas in which each texel belongs to one place of the surface")
    if (face_of == NO_FACE).all():
        found = f"no triangle over any centre of {width} x {height} texels"
        raise InputError(file, "UV", found, "UV charts larger than a texel, or more texels")
    return face_of


def mesh_texels(mesh: Mesh, face_of: np.ndarray, rows: tuple[int, int] | None = None) -> Texels:
    """Compute positions and normals of the surface at the texel centres of some rows.

    Parameters
    ----------
    mesh : Mesh
    face_of : (height, width) int32
        From `rasterise`, all rows.
    rows : (int, int), optional
        First row, and one after the last; all rows by default.
    """
    height, width = face_of.shape
    first, last = rows or (0, height)
    wanted = face_of[first:last]
    position, normal, facet = np.empty((3, *wanted.shape, 3))
    texels = Texels(position, normal, facet, wanted != NO_FACE)
    triangles = _Triangles(mesh.vertices_mm, mesh.faces, mesh.normals, mesh.facets)
    _locate(_in_texels(mesh, width, height), wanted, first, triangles, texels)
    return texels
