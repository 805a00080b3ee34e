"""Validated triangle meshes with texture coordinates.

Coordinates are in the object's frame, mm. In the texture, u runs to the right and v down, as in
`irodori.geometry.shapes`; files have v from the bottom.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from irodori.core.errors import InputError, counted
from irodori.core.progress import LOGGER
from irodori.geometry.normals import corner_normals, least_cosines
from irodori.jit.compilation import njit

#: Twice the area of a triangle, relative to the squared extent of the mesh, below which it has no normal.
_NO_AREA = 1e-15
#: Texture coordinates may exceed 0..1 by this much because of rounding.
_UV_ROUNDING = 1e-6
#: Gap between two positions on the border of a surface, relative to its extent, below which they count as one.
_ONE_PLACE = 1e-6
#: Share of the area below which a fault of single triangles is not mentioned.
_HARDLY_ANY = 1e-3
#: Share of the area with wrong normals at which a mesh is refused, or questioned.
_MUCH = 0.1
#: Angle, degrees, by which a normal may lean beyond the facets around it; and from its own facet before that is said.
_UNEXPLAINED_DEG, _STEEP_DEG = 5.0, 15.0
#: Odd factors by which the bits of three coordinates make a hash.
_HASH = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xC2B2AE3D27D4EB4F), np.uint64(0x165667B19E3779F9))
WITHOUT_NORMALS = "they are then computed, with edges where triangles meet at more than `shape.crease_deg`"
ACCEPTED_UV = "one UV atlas over the whole surface (unwrap it in the program that made it, and export with UV)"


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangle mesh with texture coordinates and shading normals.

    Parameters
    ----------
    vertices_mm : (n, 3) float64
        Each position once, even if it has several texture coordinates or normals.
    faces : (m, 3) int32
        Indices of the corners, counter-clockwise seen from outside.
    uv : (m, 3, 2) float64
        Texture coordinates of each triangle's corners, 0..1, v from the top.
    normals : (m, 3, 3) float64
        Unit shading normals of the corners.
    """

    vertices_mm: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    normals: np.ndarray

    @cached_property
    def facets(self) -> np.ndarray:
        """Unit geometric normals of the triangles, (m, 3)."""
        across = _across(self.vertices_mm, self.faces)
        return across / np.linalg.norm(across, axis=1, keepdims=True)

    @property
    def reach_mm(self) -> float:
        """Largest distance of a vertex from the origin, mm."""
        return float(np.linalg.norm(self.vertices_mm, axis=1).max())

    @property
    def bottom_mm(self) -> float:
        """Smallest z of a vertex, mm."""
        return float(self.vertices_mm[:, 2].min())

    def samples(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return positions, (count, 3) mm, and unit normals, (count, 3), of points spread evenly over the area."""
        area = np.cumsum(np.linalg.norm(_across(self.vertices_mm, self.faces), axis=1))
        chosen = np.searchsorted(area, (np.arange(count) + 0.5) / count * area[-1])
        normal = self.normals[chosen].mean(axis=1)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = np.where(length > 1e-6, normal / np.maximum(length, 1e-6), self.facets[chosen])
        return self.vertices_mm[self.faces[chosen]].mean(axis=1), normal


def _across(vertices, faces) -> np.ndarray:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)


def make_mesh(corners_mm, uv, normals=None, crease_deg: float = 40.0, file="mesh") -> Mesh:
    """Make a mesh of triangles after checking it for errors that would spoil its maps or pictures.

    Triangles without area are left out, because no ray meets them and they have no texels.

    Parameters
    ----------
    corners_mm : (m, 3, 3) float
        Positions of each triangle's corners, counter-clockwise seen from outside.
    uv : (m, 3, 2) float or None
        Texture coordinates of the corners, v from the top.
    normals : (m, 3, 3) float, optional
        Shading normals of the corners, of any length; computed by `irodori.geometry.normals.corner_normals` if absent.
    crease_deg : float
        Angle between neighbouring triangles, degrees, above which computed normals show an edge.
    file : path
        Source of the mesh, for error messages.

    Raises
    ------
    InputError
        If texture coordinates are missing or outside 0..1, a number is not finite, no triangle has an area,
        neighbouring triangles have opposite orientations, a closed surface is inside out, or normals point inward or
        lean further than the triangles around their corners.
    """
    corners = np.asarray(corners_mm, dtype=np.float64).reshape(-1, 3, 3)
    if uv is None:
        raise InputError(file, "UV", "no texture coordinates", ACCEPTED_UV)
    uv = np.asarray(uv, dtype=np.float64).reshape(-1, 3, 2)
    for field, values in (("vertices", corners), ("UV", uv), ("normals", normals)):
        if values is not None and not np.isfinite(values).all():
            bad = int((~np.isfinite(values)).any(axis=(1, 2)).sum())
            raise InputError(file, field, f"{bad} of {len(corners)} triangles with NaN or infinity", "finite numbers")
    outside = ((uv < -_UV_ROUNDING) | (uv > 1.0 + _UV_ROUNDING)).any(axis=(1, 2))
    if outside.any():
        found = f"{int(outside.sum())} of {len(uv)} triangles outside 0..1"
        raise InputError(file, "UV", found, "coordinates within 0..1: a texture that is not repeated")
    vertices, faces = _weld(corners)
    across = np.linalg.norm(_across(vertices, faces), axis=1)
    extent = np.ptp(vertices, axis=0).max() if len(vertices) else 0.0
    solid = across > _NO_AREA * extent**2
    if not solid.any():
        raise InputError(file, "faces", f"{len(faces)} triangles, none with an area", "a surface of triangles")
    if not solid.all():
        LOGGER.info("%s: %d of %d triangles have no area and are left out", file, (~solid).sum(), len(solid))
    faces, uv = faces[solid], np.clip(uv[solid], 0.0, 1.0)
    _check_winding(vertices, _closed_gaps(vertices, faces), file)
    _warn_of_collapsed(uv, across[solid], file)
    if normals is None:
        return Mesh(vertices, faces, uv, corner_normals(vertices, faces, crease_deg))
    normals = _unit(np.asarray(normals, dtype=np.float64)[solid], vertices, faces)
    _check_normals(normals, vertices, faces, file)
    return Mesh(vertices, faces, uv, normals)


def _weld(corners) -> tuple[np.ndarray, np.ndarray]:
    """Merge equal positions; return vertices, (n, 3), and triangles, (m, 3).

    So a seam of the texture is not a boundary of the surface.
    """
    points = corners.reshape(-1, 3) + 0.0  # -0.0 becomes 0.0
    slots = np.full(1 << max(len(points), 1).bit_length() + 1, -1, dtype=np.int32)
    number = np.empty(len(points), dtype=np.int32)
    places = points[_number_places(points, points.view(np.uint64), slots, number)]
    order = np.lexsort(places.T)
    rank = np.empty(len(order), dtype=np.int32)
    rank[order] = np.arange(len(order))
    return places[order], rank[number].reshape(-1, 3)


@njit(cache=True)
def _number_places(points, bits, slots, number):
    """Fill ``number`` with the number of each point's position, and return the first point of each position.

    ``slots``, a power of two of entries of -1, becomes a table of these points by a hash of the bits of their
    coordinates.
    """
    first, count = np.empty(points.shape[0], dtype=np.int32), 0
    last = np.uint64(slots.size - 1)
    for i in range(points.shape[0]):
        key = bits[i, 0] * _HASH[0] + bits[i, 1] * _HASH[1] + bits[i, 2] * _HASH[2]
        key = (key ^ (key >> np.uint64(32))) * _HASH[0]  # round coordinates have few bits that are not 0
        slot = (key ^ (key >> np.uint64(29))) & last
        while True:
            known = slots[slot]
            if known < 0:
                slots[slot] = i
                first[count], number[i] = i, count
                count += 1
                break
            if (
                points[known, 0] == points[i, 0]
                and points[known, 1] == points[i, 1]
                and points[known, 2] == points[i, 2]
            ):
                number[i] = number[known]
                break
            slot = (slot + np.uint64(1)) & last
    return first[:count].copy()


def _edges(faces, count: int) -> np.ndarray:
    """Return numbers of the edges of triangles on ``count`` vertices, (3 m,) int64, the same from both sides."""
    start, end = faces.astype(np.int64).ravel(), np.roll(faces, -1, axis=1).astype(np.int64).ravel()
    return np.minimum(start, end) * count + np.maximum(start, end)


def _closed_gaps(vertices, faces) -> np.ndarray:
    """Return triangles, (m, 3), with one vertex for all those on the border that lie in one place but for rounding."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    edge, count = np.unique(_edges(faces, len(vertices)), return_counts=True)
    border = np.unique(np.concatenate(np.divmod(edge[count == 1], len(vertices))))
    if not len(border):
        return faces
    pairs = cKDTree(vertices[border]).query_pairs(_ONE_PLACE * np.ptp(vertices, axis=0).max(), output_type="ndarray")
    if not len(pairs):
        return faces
    _, group = connected_components(coo_array((np.ones(len(pairs)), pairs.T), shape=(len(border),) * 2), directed=False)
    one = np.arange(len(vertices), dtype=faces.dtype)
    one[border] = border[np.unique(group, return_index=True)[1]][group]
    joined = one[faces]
    return joined[(joined != np.roll(joined, 1, axis=1)).all(axis=1)]


def _warn_of_collapsed(uv, area, file) -> None:
    """Warn if triangles, with ``area`` (m,) in any unit, have a chart without area: no texel shows them."""
    one, two = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    share = area[np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) < _NO_AREA].sum() / area.sum()
    if share > _HARDLY_ANY:
        LOGGER.warning(
            "%s: UV: %.1f %% of the area has texture coordinates on one point or line, hence no texels and no "
            "measurement; accepted: %s",
            file, 100.0 * share, ACCEPTED_UV,
        )  # fmt: skip


def _check_winding(vertices, faces, file) -> None:
    """Raise `InputError` if neighbouring triangles have opposite orientations, or a closed surface is inside out.

    Edges with three or more triangles are not checked: such surfaces are traced and shaded like others.
    """
    start, end = faces.astype(np.int64).ravel(), np.roll(faces, -1, axis=1).astype(np.int64).ravel()
    edge = _edges(faces, len(vertices))
    order = np.argsort(edge, kind="stable")
    first = np.flatnonzero(np.diff(edge[order], prepend=-1))
    count = np.diff(np.append(first, len(order)))
    forward = np.add.reduceat((start < end)[order].astype(np.int64), first)
    against = int(((count == 2) & (forward != 1)).sum())
    if against:
        accepted = "triangles counter-clockwise seen from outside (recalculate the outside of the mesh)"
        raise InputError(
            file, "faces", f"{counted(against, 'edge')} whose two triangles look to opposite sides", accepted
        )
    if (count == 2).all() and _volume(vertices, faces, vertices.mean(axis=0)) < 0.0:
        accepted = "triangles counter-clockwise seen from outside (flip the faces)"
        raise InputError(file, "faces", "a closed surface that looks inward", accepted)


@njit(cache=True)
def _volume(vertices, faces, centre):
    """Return six times the volume within a closed surface; below 0 if it looks inward."""
    total = 0.0
    for face in range(faces.shape[0]):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        ax, ay, az = vertices[a, 0] - centre[0], vertices[a, 1] - centre[1], vertices[a, 2] - centre[2]
        bx, by, bz = vertices[b, 0] - centre[0], vertices[b, 1] - centre[1], vertices[b, 2] - centre[2]
        cx, cy, cz = vertices[c, 0] - centre[0], vertices[c, 1] - centre[1], vertices[c, 2] - centre[2]
        total += ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    return total


def _unit(normals, vertices, faces) -> np.ndarray:
    """Normalise the normals of a file, (m, 3, 3); corners without a normal get that of their triangle."""
    facet = _across(vertices, faces)
    facet = np.repeat((facet / np.linalg.norm(facet, axis=1, keepdims=True))[:, None], 3, axis=1)
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    return np.where(length > 1e-12, normals / np.maximum(length, 1e-12), facet)


def _check_normals(normals, vertices, faces, file) -> None:
    """Raise `InputError` if normals of a file look inward or lean further than facets bend; warn if they lean far.

    A smooth normal is a mean over the facets at a vertex, so that it leans from none of them by more than that facet is
    from the farthest other one. On a fine mesh of a round object that is little. On a box with smoothed normals it is
    the angle at its edges, and its flat sides would be measured as round ones: of this the user is told.
    """
    facet = _across(vertices, faces)
    area = np.linalg.norm(facet, axis=1)
    facet, area = facet / area[:, None], area / area.sum()
    inward = area[np.sum(normals.sum(axis=1) * facet, axis=1) < 0.0].sum()
    accepted = f"normals that fit the triangles, or a file without them ({WITHOUT_NORMALS})"
    if inward > _MUCH:
        raise InputError(file, "normals", f"{inward:.0%} of the area with normals against its winding", accepted)
    lean = np.degrees(np.arccos(np.clip(np.sum(normals * facet[:, None], axis=2), -1.0, 1.0)))
    share = np.repeat(area[:, None] / 3.0, 3, axis=1)
    steep = lean > _STEEP_DEG
    if not (lean > _UNEXPLAINED_DEG).any():
        return
    excess = lean - np.degrees(np.arccos(least_cosines(vertices, faces)))
    loose = excess > _UNEXPLAINED_DEG
    if share[loose].sum() > _MUCH:
        found = (
            f"{share[loose].sum():.0%} of the area with normals that lean from its triangles, by up to "
            f"{lean[loose].max():.0f} degrees, further than these bend"
        )
        raise InputError(file, "normals", found, accepted)
    if share[steep].sum() > _MUCH:
        LOGGER.warning(
            "%s: normals: on %.0f %% of the area they lean from the triangles by more than %.0f degrees, up to %.0f; "
            "right for a coarse mesh of a round object, wrong for flat sides with edges; accepted: %s",
            file, 100.0 * share[steep].sum(), _STEEP_DEG, lean.max(), accepted,
        )  # fmt: skip
