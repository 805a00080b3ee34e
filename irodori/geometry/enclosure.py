"""Test whether a point lies inside a placed shape: a ball or a closed mesh."""

import numpy as np

from irodori.geometry.shapes.placement import Placement

#: Largest deviation of a winding number from an integer for a closed mesh: a gap covers a larger share of the sphere.
_CLOSED = 1e-3


def encloses(thing: Placement, point_mm: np.ndarray) -> bool:
    """Return whether a point lies inside a ball or a closed mesh; False for other shapes, which have no inside.

    Parameters
    ----------
    thing : Placement
    point_mm : (3,) float
        Point in the world.
    """
    local = (np.asarray(point_mm, dtype=np.float64) - thing.translation_mm) @ thing.rotation / thing.scale
    shape = thing.shape
    if shape.ball_mm is not None:
        return bool(np.linalg.norm(local) < shape.ball_mm)
    if shape.triangles is None or np.linalg.norm(local) > shape.reach_mm:
        return False
    times = winding_number(shape.triangles.vertices_mm, shape.triangles.faces, local)
    return abs(times) > 0.5 and abs(times - round(times)) < _CLOSED


def winding_number(vertices_mm: np.ndarray, faces: np.ndarray, point_mm: np.ndarray) -> float:
    """Return the winding number of triangles about a point: their solid angles over 4π (Van Oosterom, Strackee 1983).

    Parameters
    ----------
    vertices_mm : (n, 3) float
    faces : (m, 3) int
        Counter-clockwise seen from outside.
    point_mm : (3,) float
        A point that does not lie on a triangle.
    """
    towards = vertices_mm - point_mm
    far = np.linalg.norm(towards, axis=1)
    (a, b, c), (la, lb, lc) = (towards[corner] for corner in faces.T), (far[corner] for corner in faces.T)
    over = np.einsum("ij,ij->i", a, np.cross(b, c))
    dots = (np.einsum("ij,ij->i", one, other) for one, other in ((a, b), (b, c), (c, a)))
    ab, bc, ca = dots
    return float(np.arctan2(over, la * lb * lc + ab * lc + bc * la + ca * lb).sum() / (2.0 * np.pi))
