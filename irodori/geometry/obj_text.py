"""Text of an OBJ, prepared for the library that parses it: line ends, and polygons cut into triangles."""

import re
from pathlib import Path

import numpy as np

from irodori.core.errors import InputError

#: A face with an index of 0: an OBJ counts from 1, or from -1 backwards, and readers take 0 for any vertex.
_ZERO_INDEX = re.compile(rb"^[ \t]*f[ \t][^\n]*?(?<=[ \t/])0+(?![^ \t/\n])[^\n]*", re.MULTILINE)
_DECIMAL_COMMA = re.compile(rb"^[ \t]*v[tn]?[ \t][^\n#]*\d,\d[^\n]*", re.MULTILINE)
_POLYGON = re.compile(rb"^[ \t]*f((?:[ \t]+[-0-9/]+){4,})[ \t]*(?=$|#)", re.MULTILINE)
_VERTEX = re.compile(rb"^[ \t]*v[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", re.MULTILINE)


def obj_text(path) -> bytes:
    """Read an OBJ as text with the line ends of Unix, all of whose faces are triangles.

    Raises
    ------
    InputError
        If numbers have decimal commas, a face has an index of 0, or a polygon cannot be cut into triangles.
    """
    text = Path(path).read_bytes().replace(b"\r\n", b"\n").replace(b"\r", b"\n").replace(b"\\\n", b" ")
    if line := _DECIMAL_COMMA.search(text):
        raise InputError(
            path, "vertices", f"the line {_shown(line)}, with decimal commas", "numbers with decimal points"
        )
    if face := _ZERO_INDEX.search(text):
        found = f"the face {_shown(face)}, with an index of 0"
        raise InputError(path, "faces", found, "indices of vertices from 1, as an OBJ counts them")
    if not _POLYGON.search(text):
        return text
    vertices = np.array([found.groups() for found in _VERTEX.finditer(text)], dtype=np.float64).reshape(-1, 3)
    is_convex = iter(_convex_quads(text, vertices))

    def cut(polygon) -> bytes:
        corners = polygon.group(1).split()
        if len(corners) == 4 and next(is_convex):
            a, b, c, d = corners
            return b"f %b %b %b\nf %b %b %b" % (a, b, c, a, c, d)
        numbers = [int(corner.split(b"/")[0]) for corner in corners]
        try:
            triangles = _triangles([tuple(vertices[number - (number > 0)].tolist()) for number in numbers])
        except IndexError:
            found = f"the face {_shown(polygon)}, with a vertex that is none of the {len(vertices)} of the file"
            raise InputError(path, "faces", found, "triangles on vertices of the file") from None
        if triangles is None:
            found = f"the polygon {_shown(polygon)}, which cannot be cut into triangles"
            raise InputError(path, "faces", found, "polygons that do not cross themselves (triangulate on export)")
        return b"\n".join(b"f " + b" ".join(corners[i] for i in triangle) for triangle in triangles)

    return _POLYGON.sub(cut, text)


def _convex_quads(text: bytes, vertices: np.ndarray) -> list[bool]:
    """Return whether each face of four corners is convex, in their order: most polygons of large files are."""
    quads = [corners for face in _POLYGON.finditer(text) if len(corners := face.group(1).split()) == 4]
    number = np.array(
        [[int(corner.split(b"/")[0]) for corner in corners] for corners in quads], dtype=np.int64
    ).reshape(-1, 4)
    number -= number > 0
    known = np.all((number >= -len(vertices)) & (number < len(vertices)), axis=1)
    points = vertices[np.where(known[:, None], number, 0)]
    edge = np.roll(points, -1, axis=1) - points
    turn = np.cross(edge, np.roll(edge, -1, axis=1))
    return (known & (np.einsum("nci,ni->nc", turn, turn.sum(axis=1)) > 0.0).all(axis=1)).tolist()


def _shown(found: re.Match) -> str:
    return repr(found.group().strip().decode("ascii", "replace")[:80])


def _triangles(points: list) -> list[tuple[int, int, int]] | None:
    """Cut a polygon, of points (x, y, z), into triangles of its corners by clipping its ears.

    None if corners are left over without an ear, as in a polygon that crosses itself.
    """
    normal = [0.0, 0.0, 0.0]
    for p, q in zip(points, points[1:] + points[:1], strict=True):
        for axis in range(3):
            b, c = (axis + 1) % 3, (axis + 2) % 3
            normal[axis] += (p[b] - q[b]) * (p[c] + q[c])
    axis = max(range(3), key=lambda a: abs(normal[a]))
    sign, b, c = (1.0 if normal[axis] > 0.0 else -1.0), (axis + 1) % 3, (axis + 2) % 3

    def turn(i: int, j: int, k: int) -> float:
        """Return twice the area of a triangle, below 0 if it runs against the polygon."""
        p, q, r = points[i], points[j], points[k]
        return sign * ((q[b] - p[b]) * (r[c] - p[c]) - (q[c] - p[c]) * (r[b] - p[b]))

    ring, out = list(range(len(points))), []
    while len(ring) > 3:
        for place in range(len(ring)):
            # First the corner after the first: a convex polygon becomes a fan.
            i, j, k = ring[place], ring[(place + 1) % len(ring)], ring[(place + 2) % len(ring)]
            if turn(i, j, k) <= 0.0:
                continue
            others = (one for one in ring if points[one] not in (points[i], points[j], points[k]))
            if not any(turn(i, j, o) >= 0.0 and turn(j, k, o) >= 0.0 and turn(k, i, o) >= 0.0 for o in others):
                out.append((i, j, k))
                ring.remove(j)
                break
        else:
            return None
    return [*out, (ring[0], ring[1], ring[2])]
