"""Surroundings of a scene's objects as their gloss sees them: which directions other objects hide, and their light.

For some texels of each object, a cube map of coarse directions holds the share of directions that lead to the
environment, and the radiance of the objects in the others. A rough lobe reflects the blurred environment by that share,
and the objects' light in place of the rest.
"""

from collections.abc import Sequence

import numpy as np

from irodori.geometry.shapes.placement import Placement, reaches
from irodori.geometry.shapes.surface_nodes import raised
from irodori.rendering.interactive.cube_maps import FACES, face_directions, fill_borders
from irodori.rendering.map_layouts import Points, make_layout

#: Texels of an object, texels along the side of a cube's face, and rays along each side of such a texel.
TEXELS, SIDE, _ALONG = 1 << 8, 4, 4
#: Numbers of a direction, see `irodori.rendering.interactive.representation_layout.Layout.seen`.
SEEN = 8
_LIFT = 0.02  # height above the horizon to which directions below it are lifted, for the look-ups next to it


def coarse_texels(placements: Sequence[Placement], shape: np.ndarray) -> tuple[list[Points], list[tuple[int, int]]]:
    """Return the texels of each side from which gloss sees, raised above the surface, and their rows and columns.

    Meshes have none. ``shape`` has the placed shape of each side, first those of the fronts.
    """
    places, sizes, found = [], [], reaches(placements)
    for side, index in enumerate(shape):
        layout, reach = make_layout(placements, index, 1.0 if side < len(placements) else -1.0), found[index]
        is_mesh = placements[index].shape.triangles is not None
        points = Points(*np.zeros((3, 0, 3))) if is_mesh else layout.points(TEXELS)
        places.append(points._replace(point=raised(points.point, points.facet, reach)))
        sizes.append((0, 0) if is_mesh else layout.size(TEXELS))
    return places, sizes


def ways_out(facet: np.ndarray) -> np.ndarray:
    """Return the directions of the rays from texels with normals (n, 3), by cell of their cube maps, (n, cells, r, 3).

    Directions below the horizon are lifted above it.
    """
    fine = np.stack([face_directions(face, SIDE * _ALONG) for face in range(FACES)])
    parts = fine.reshape(FACES, SIDE, _ALONG, SIDE, _ALONG, 3).swapaxes(2, 3).reshape(FACES * SIDE**2, -1, 3)
    facet = facet[:, None, None]
    direction = parts + np.maximum(_LIFT - (parts * facet).sum(axis=-1, keepdims=True), 0.0) * facet
    return direction / np.linalg.norm(direction, axis=-1, keepdims=True)


def stored_cubes(found: np.ndarray) -> np.ndarray:
    """Return the cells of cube maps, (n, cells, k), with borders, (n, 6, SIDE + 2, SIDE + 2, k) float32."""
    stored = np.zeros((FACES, SIDE + 2, SIDE + 2, len(found), found.shape[2]), np.float32)
    if len(found):
        stored[:, 1:-1, 1:-1] = np.moveaxis(found.reshape(-1, FACES, SIDE, SIDE, found.shape[2]), 0, -2)
        fill_borders(stored.reshape(FACES, SIDE + 2, SIDE + 2, -1))
    return np.moveaxis(stored, 3, 0)
