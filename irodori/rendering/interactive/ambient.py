"""Light from all sides where other objects stand in its way: contact shadows in closed form.

What a sphere or a flat shape hides of the cosine-weighted sky is known exactly, the horizon's cut included: the form
factor of a sphere (Snyder 1996), Lambert's sum over a polygon's edges, and its like for discs and planes
(`irodori.rendering.interactive.disc_occlusion`). Several objects hide as if they did so on their own,
and each sends the diffuse light that its mean colour reflects on the side that faces the point, so that a white object
on white leaves no shadow in a white furnace. What meshes hide, from themselves too, was found out by rays when the
scene was prepared (`irodori.rendering.interactive.mesh_shadows`).
"""

import math

import numpy as np

from irodori.geometry.shapes import DISC, MESH, PLANE, SPHERE
from irodori.jit.native import njit
from irodori.jit.ray_vectors import lane, load_like, repeated, zeros_like
from irodori.rendering.interactive.cube_maps import bilinear, cell_of, face_of
from irodori.rendering.interactive.disc_occlusion import hidden_by_disc, hidden_by_plane
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
    CENTRE,
    HIGH,
    KIND,
    NORMAL,
    OBJECT,
    POINT,
    RADIUS,
    RAYS,
    SHAPE,
    TURN,
    WIDE,
)
from irodori.rendering.interactive.representation_layout import surface_lanes
from irodori.rendering.interactive.shadow_look_up import mixed, nodes_about

_CORNERS = 4
#: Squared length of a mean of unit normals under which it points nowhere: they face each other.
_NO_SIDE = 1e-4


@njit(cache=True, error_model="numpy")
def hidden_by_sphere(cosine, distance, radius):
    """Return the share of the cosine-weighted hemisphere that a sphere hides.

    Parameters
    ----------
    cosine : float
        Of the angle between the normal and the way to the centre.
    distance : float
        To the centre, mm; a point inside is hidden by nothing.
    radius : float, mm
    """
    if distance <= radius:
        return 0.0
    ratio = distance / radius
    square = ratio * ratio
    if cosine * ratio >= 1.0:
        return cosine / square
    if cosine * ratio <= -1.0:
        return 0.0
    cut = 1.0 - square * cosine * cosine
    turn = math.acos(min(max(-cosine * math.sqrt((square - 1.0) / (1.0 - cosine * cosine)), -1.0), 1.0))
    part = (cosine * turn - math.sqrt(cut * (square - 1.0))) / square + math.atan(math.sqrt(cut / (square - 1.0)))
    return max(part / math.pi, 0.0)


@njit(cache=True, error_model="numpy")
def _edge(normal, a, b):
    """Return an edge's part of Lambert's sum: the angle that it spans times the cosine of its plane with the normal."""
    cx, cy, cz = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    sine = math.sqrt(cx * cx + cy * cy + cz * cz)
    if sine <= 0.0:
        return 0.0
    angle = math.atan2(sine, a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
    return angle * (normal[0] * cx + normal[1] * cy + normal[2] * cz) / sine


@njit(cache=True, error_model="numpy")
def hidden_by_corners(normal, corners):
    """Return the share of the cosine-weighted hemisphere that a flat polygon hides.

    Parameters
    ----------
    normal : tuple of 3 float
    corners : tuple of 4 tuples of 3 float
        From the point, in order about the polygon, mm; what lies under the horizon is cut off.
    """
    found = 0.0
    first = last = (0.0, 0.0, 0.0)
    begun = False
    for number in range(_CORNERS):
        a, b = corners[number], corners[(number + 1) % _CORNERS]
        ha = a[0] * normal[0] + a[1] * normal[1] + a[2] * normal[2]
        hb = b[0] * normal[0] + b[1] * normal[1] + b[2] * normal[2]
        if ha <= 0.0 and hb <= 0.0:
            continue
        if ha * hb < 0.0:
            part = ha / (ha - hb)
            middle = (a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1]), a[2] + part * (b[2] - a[2]))
            start, end = (a, middle) if ha > 0.0 else (middle, b)
        else:
            start, end = a, b
        if begun:
            # Along the horizon, where two edges were cut; of no length elsewhere.
            found += _edge(normal, last, start)
        else:
            first, begun = start, True
        found += _edge(normal, start, end)
        last = end
    if begun:
        found += _edge(normal, last, first)
    return abs(found) / (2.0 * math.pi)


@njit(cache=True)
def _plate_corner(table, at, x, y, z, sign_u, sign_v):
    u, v = sign_u * 0.5 / table[at + WIDE], sign_v * 0.5 / table[at + HIGH]
    return (
        x + u * table[at + TURN] + v * table[at + TURN + 1],
        y + u * table[at + TURN + 3] + v * table[at + TURN + 4],
        z + u * table[at + TURN + 6] + v * table[at + TURN + 7],
    )


@njit(cache=True)
def _axis(table, at, axis):
    """Return an axis of a shape's frame in the world."""
    return (
        np.float64(table[at + TURN + axis]),
        np.float64(table[at + TURN + 3 + axis]),
        np.float64(table[at + TURN + 6 + axis]),
    )


@njit(cache=True, error_model="numpy")
def _hidden(table, shape, point, normal):
    """Return the share that a shape hides, and the normal that faces the point, zeros for the back of a flat one."""
    at = shape * SHAPE
    x, y, z = table[at + CENTRE] - point[0], table[at + CENTRE + 1] - point[1], table[at + CENTRE + 2] - point[2]
    if table[at + KIND] == SPHERE:
        distance = math.sqrt(x * x + y * y + z * z)
        if distance <= 0.0:
            return 0.0, (0.0, 0.0, 0.0)
        cosine = (x * normal[0] + y * normal[1] + z * normal[2]) / distance
        share = hidden_by_sphere(cosine, distance, np.float64(table[at + RADIUS]))
        return share, (-x / distance, -y / distance, -z / distance)
    if table[at + KIND] == MESH:
        return 0.0, (0.0, 0.0, 0.0)
    axes = (_axis(table, at, 0), _axis(table, at, 1), _axis(table, at, 2))
    facing = axes[2]
    behind = x * facing[0] + y * facing[1] + z * facing[2] >= 0.0
    if table[at + KIND] == PLANE:
        cosine = normal[0] * facing[0] + normal[1] * facing[1] + normal[2] * facing[2]
        return hidden_by_plane(-cosine if behind else cosine), ((0.0, 0.0, 0.0) if behind else facing)
    if behind:
        facing = (0.0, 0.0, 0.0)
    if table[at + KIND] == DISC:
        return hidden_by_disc(normal, (x, y, z), axes, np.float64(table[at + RADIUS])), facing
    corners = (
        _plate_corner(table, at, x, y, z, -1.0, -1.0),
        _plate_corner(table, at, x, y, z, 1.0, -1.0),
        _plate_corner(table, at, x, y, z, 1.0, 1.0),
        _plate_corner(table, at, x, y, z, -1.0, 1.0),
    )
    return hidden_by_corners(normal, corners), facing


@njit(cache=True)
def _reflected(world, frame, layout, shape, facing, like):
    """Return the light that a shape's side reflects, in the channels that texels are multiplied with."""
    turn = frame.light_from_world
    x = turn[0] * facing[0] + turn[1] * facing[1] + turn[2] * facing[2]
    y = turn[3] * facing[0] + turn[4] * facing[1] + turn[5] * facing[2]
    z = turn[6] * facing[0] + turn[7] * facing[1] + turn[8] * facing[2]
    face, u, v = face_of(repeated(np.float32(x), 4), repeated(np.float32(y), 4), repeated(np.float32(z), 4))
    cell, fx, fy = cell_of(face, u, v, repeated(np.float32(world.irradiance_side), 4))
    at, stride = np.int64(lane(cell, 0)), world.irradiance_side + 2
    light = bilinear(world.irradiance, 0, at, stride, lane(fx, 0), lane(fy, 0), like)
    out, width = zeros_like(like), surface_lanes(layout)
    for channel in range(world.ambient_inputs):
        row = load_like(world.ambient, (shape * world.ambient_inputs + channel) * width, like)
        out = out + lane(light, channel) * row
    return out


@njit(cache=True)
def _reflected_by_meshes(world, frame, layout, own, about, normal, like):
    """Return the light that the meshes about a hit reflect to it, in the channels that texels are multiplied with."""
    shadows, out = world.shadows, zeros_like(like)
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
            out = out + np.float32(share) * _reflected(world, frame, layout, mesh, (x, y, z), like)
    return out


@njit(cache=True)
def ambient_light(world, frame, layout, hits, ray, light):
    """Return the light of a hit's normal, less what other objects hide, plus what they reflect."""
    hit, table = hits.f, world.shape
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
        share, facing = _hidden(table, shape, point, normal)
        if share <= 0.0:
            continue
        seen *= 1.0 - share
        hidden += share
        if facing[0] != 0.0 or facing[1] != 0.0 or facing[2] != 0.0:
            reflected = reflected + share * _reflected(world, frame, layout, shape, facing, light)
    if world.shadowed > 0 and world.shadows.numbers[own * SHAPE_NUMBERS + STRIDE] > 0:
        about = nodes_about(world, hits, ray, own, point)
        seen *= mixed(world.shadows, own, about, LEFT)
        uncovered = mixed(world.shadows, own, about, UNCOVERED)
        hidden = uncovered * hidden + mixed(world.shadows, own, about, HIDDEN)
        reflected = np.float32(uncovered) * reflected + _reflected_by_meshes(
            world, frame, layout, own, about, normal, light
        )
    if hidden > 0.0:
        light = seen * light + ((1.0 - seen) / hidden) * reflected
    return light
