"""Look-up of ambient occlusion at a hit from the nodes around it."""

import numpy as np

from irodori.geometry.shape_dispatch import chain
from irodori.geometry.shapes.shadow_nodes import NodeHit
from irodori.geometry.shapes.shape_rows import KIND, SHAPE
from irodori.jit.compilation import uncounted
from irodori.rendering.interactive.mesh_shadows import FIRST, SHAPE_NUMBERS, STRIDE
from irodori.rendering.interactive.packets import (
    BARYCENTRIC_B,
    BARYCENTRIC_C,
    RAYS,
    TEXTURE_U,
    TEXTURE_V,
    TRIANGLE,
)

_nodes_about = chain("nodes_about", "shadows, own, row, hit", __name__)


@uncounted()
def nodes_about(world, hits, ray, own, point):
    """Return the nodes around a hit on a shape, (4,) int, and their interpolation weights, (4,) float, with sum 1."""
    f, at = hits.f, own * SHAPE
    hit = NodeHit(
        f[TEXTURE_U * RAYS + ray],
        f[TEXTURE_V * RAYS + ray],
        world.surfaces.first_face[own] + hits.i[TRIANGLE * RAYS + ray],
        np.float64(f[BARYCENTRIC_B * RAYS + ray]),
        np.float64(f[BARYCENTRIC_C * RAYS + ray]),
        point,
        at,
    )
    return _nodes_about(world.shape[at + KIND], world.shadows, own, world.shape, hit)


@uncounted()
def mixed(shadows, own, about, number):
    """Return one of the nodes' values, interpolated at a hit from the nodes and weights in ``about``."""
    nodes, weights = about
    stride, first = shadows.numbers[own * SHAPE_NUMBERS + STRIDE], shadows.numbers[own * SHAPE_NUMBERS + FIRST]
    found = 0.0
    for corner in range(4):
        found += weights[corner] * shadows.values[first + nodes[corner] * stride + number]
    return found
