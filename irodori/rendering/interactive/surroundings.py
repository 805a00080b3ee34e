"""Surroundings of a scene's objects as their gloss sees them: which directions other objects hide, and their light.

For some points of each object, a cube map of coarse directions holds the share of directions that lead to the
environment, and the radiance of the objects in the others. A rough lobe reflects the blurred environment by that share,
and the objects' light in place of the rest.
"""

from collections.abc import Sequence

import numpy as np

from irodori.geometry.shapes.placement import Placement, reaches
from irodori.geometry.shapes.surface_nodes import raised
from irodori.rendering.interactive.cube_maps import FACES, face_directions, fill_borders
from irodori.rendering.interactive.look_ups import LINKS
from irodori.rendering.map_layouts import Points, make_layout

#: Texels of an object, texels along the side of a cube's face, and rays along each side of such a texel.
TEXELS, SIDE, _ALONG = 1 << 8, 4, 4
#: Numbers of a direction, see `irodori.rendering.interactive.representation_layout.Layout.seen`.
SEEN = 8
_TURNED = 0.25  # distance, in sizes of a mesh, that counts like a difference of normals by 1
_LIFT = 0.02  # height above the horizon to which directions below it are lifted, for the look-ups next to it


def coarse_texels(
    placements: Sequence[Placement], shape: np.ndarray, most: Sequence[int]
) -> tuple[list[Points], list[tuple[int, int]]]:
    """Return the texels of each side from which gloss sees, raised above the surface, and their rows and columns.

    Those of a mesh, in one row, are some of the texels of its light map. ``shape`` has the placed shape of each side,
    first those of the fronts, and ``most`` the largest number of texels of each side's light map.
    """
    places, sizes, found = [], [], reaches(placements)
    for side, index in enumerate(shape):
        layout, reach = make_layout(placements, index, 1.0 if side < len(placements) else -1.0), found[index]
        points, size = layout.points(TEXELS), layout.size(TEXELS)
        if placements[index].shape.triangles is not None:
            nodes = layout.points(most[side])
            chosen = _spread_out(nodes)
            points, size = Points(*(values[chosen] for values in nodes)), (1, len(chosen))
        places.append(points._replace(point=raised(points.point, points.facet, reach)))
        sizes.append(size)
    return places, sizes


def _features(nodes: Points) -> np.ndarray:
    """Return coordinates of a mesh's nodes, (n, 6), whose distance counts differences of places and of normals."""
    scale = _TURNED * np.ptp(nodes.point, axis=0).max()
    return np.concatenate([nodes.point, scale * nodes.normal], axis=1)


def _spread_out(nodes: Points) -> np.ndarray:
    """Return at most `TEXELS` of a mesh's nodes, each the one farthest from those before it."""
    place, chosen = _features(nodes), [0]
    away = np.full(len(place), np.inf)
    while len(chosen) < min(TEXELS, len(place)):
        away = np.minimum(away, np.square(place - place[chosen[-1]]).sum(axis=1))
        if away.max() == 0.0:  # the other nodes are at the same places
            break
        chosen.append(int(away.argmax()))
    return np.array(chosen)


def node_links(nodes: Points) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers and weights, (n, LINKS), of the texels of `coarse_texels` next to each node of a mesh.

    A weight falls to zero at the distance of the next texel after these, so that it is continuous on the surface.
    """
    from scipy.spatial import cKDTree

    place = _features(nodes)
    chosen = place[_spread_out(nodes)]
    away, near = cKDTree(chosen).query(place, k=LINKS + 1)
    # Where there are fewer texels, the distance is infinite.
    weight = 1.0 / np.maximum(away, 1e-6 * np.ptp(place, axis=0).max())
    weight = np.maximum(weight[:, :LINKS] - weight[:, LINKS:], 1e-9 * weight[:, :1])
    near = np.minimum(near[:, :LINKS], len(chosen) - 1)
    return near.astype(np.int32), (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32)


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
