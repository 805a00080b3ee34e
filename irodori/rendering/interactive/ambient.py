"""Ambient occlusion by neighbouring objects in closed form: contact shadows.

The share of the cosine-weighted hemisphere that a sphere or a flat shape hides has an exact formula, also if the shape
is cut by the horizon: the form factor of a sphere (Snyder 1996), Lambert's sum over a polygon's edges, and similar ones
for discs and planes. Each shape has its own (``hides`` in `irodori.geometry.shapes.shape.Kernels`). Several objects are
treated as if they hid light independently of each other. Each object sends back the diffuse light that its mean colour
reflects on the side that faces the point, so that a white object on a white surface leaves no shadow under uniform
light. The occlusion by meshes, also of themselves, is found by rays when the scene is prepared
(`irodori.rendering.interactive.mesh_shadows`).
"""

import numpy as np

from irodori.geometry.shape_dispatch import chain
from irodori.geometry.shapes.shape_rows import CENTRE, KIND, SHAPE
from irodori.jit.compilation import uncounted
from irodori.jit.vector_memory import lane, load_like, spread, zeros_like
from irodori.rendering.interactive.cube_maps import MapPlace, bilinear, cell_of, face_of
from irodori.rendering.interactive.mesh_shadows import (
    COUNT,
    HIDDEN,
    LAYER,
    LAYERS,
    LEFT,
    SEEN,
    SHAPE_NUMBERS,
    STRIDE,
    UNCOVERED,
)
from irodori.rendering.interactive.packets import (
    NORMAL,
    OBJECT,
    POINT,
    RAYS,
)
from irodori.rendering.interactive.representation_layout import surface_lanes
from irodori.rendering.interactive.shadow_look_up import mixed, nodes_about

#: Squared length of a mean of unit normals below which they cancel and the mean has no direction.
_NO_SIDE = 1e-4


_hidden = chain("hides", "row, at, x, y, z, normal", __name__)


@uncounted()
def _reflected(job, shape, facing, like):
    """Return the diffuse light that the side of a shape facing a direction reflects, in the channels of texels."""
    world, turn = job.world, job.frame.light_from_world
    x = turn[0] * facing[0] + turn[1] * facing[1] + turn[2] * facing[2]
    y = turn[3] * facing[0] + turn[4] * facing[1] + turn[5] * facing[2]
    z = turn[6] * facing[0] + turn[7] * facing[1] + turn[8] * facing[2]
    face, u, v = face_of(spread(np.float32(x), 4), spread(np.float32(y), 4), spread(np.float32(z), 4))
    cell, fx, fy = cell_of(face, u, v, spread(np.float32(world.irradiance_side), 4))
    place = MapPlace(np.int64(lane(cell, 0)), lane(fx, 0), lane(fy, 0))
    light = bilinear(world.irradiance, 0, world.irradiance_side + 2, place, like)
    out, width = zeros_like(like), surface_lanes(job.layout)
    for channel in range(world.ambient_inputs):
        row = load_like(world.ambient, (shape * world.ambient_inputs + channel) * width, like)
        out = out + lane(light, channel) * row
    return out


@uncounted()
def _reflected_by_meshes(job, own, about, normal, like):
    """Return the light that the meshes around a hit reflect towards it, in the channels of texels."""
    shadows, out = job.world.shadows, zeros_like(like)
    for layer in range(shadows.numbers[own * SHAPE_NUMBERS + COUNT]):
        at = LAYERS + LAYER * layer
        share = mixed(shadows, own, about, at)
        if share > 0.0:
            x = mixed(shadows, own, about, at + 1)
            y = mixed(shadows, own, about, at + 2)
            z = mixed(shadows, own, about, at + 3)
            if x * x + y * y + z * z < _NO_SIDE * share * share:
                x, y, z = -normal[0], -normal[1], -normal[2]
            mesh = shadows.numbers[own * SHAPE_NUMBERS + SEEN + layer]
            out = out + np.float32(share) * _reflected(job, mesh, (x, y, z), like)
    return out


@uncounted()
def ambient_light(job, hits, ray, light):
    """Return the ambient light at a hit: the environment's reduced by occlusion, plus light from other objects."""
    world, hit, table = job.world, hits.f, job.world.shape
    own = hits.i[OBJECT * RAYS + ray]
    point = (hit[POINT * RAYS + ray], hit[(POINT + 1) * RAYS + ray], hit[(POINT + 2) * RAYS + ray])
    normal = (
        np.float64(hit[NORMAL * RAYS + ray]),
        np.float64(hit[(NORMAL + 1) * RAYS + ray]),
        np.float64(hit[(NORMAL + 2) * RAYS + ray]),
    )
    seen, hidden, reflected = 1.0, 0.0, zeros_like(light)
    for shape in range(world.objects):
        if shape == own:
            continue
        at = shape * SHAPE
        x, y, z = table[at + CENTRE] - point[0], table[at + CENTRE + 1] - point[1], table[at + CENTRE + 2] - point[2]
        # The normal that faces the point is zero for the back of a flat shape, which is black.
        share, facing = _hidden(table[at + KIND], table, at, x, y, z, normal)
        if share <= 0.0:
            continue
        seen *= 1.0 - share
        hidden += share
        if facing[0] != 0.0 or facing[1] != 0.0 or facing[2] != 0.0:
            reflected = reflected + share * _reflected(job, shape, facing, light)
    if world.shadowed > 0 and world.shadows.numbers[own * SHAPE_NUMBERS + STRIDE] > 0:
        about = nodes_about(world, hits, ray, own, point)
        seen *= mixed(world.shadows, own, about, LEFT)
        uncovered = mixed(world.shadows, own, about, UNCOVERED)
        hidden = uncovered * hidden + mixed(world.shadows, own, about, HIDDEN)
        by_meshes = _reflected_by_meshes(job, own, about, normal, light)
        reflected = np.float32(uncovered) * reflected + by_meshes
    if hidden > 0.0:
        light = seen * light + ((1.0 - seen) / hidden) * reflected
    return light
