"""Packets of sixteen rays: tracing by formulas and Embree, then points, normals and texture coordinates of hits."""

from typing import NamedTuple

import numpy as np
from numba import types

from irodori.geometry.embree import NO_HIT, Ray
from irodori.geometry.shape_dispatch import chain, lane_chain, lanes_are
from irodori.geometry.shapes.mesh_nodes import lattice_place
from irodori.geometry.shapes.shape_rows import BEHIND, CENTRE, COLUMNS, HIGH, KIND, RADIUS, ROWS, SHAPE, TURN, WIDE
from irodori.geometry.shapes.surface_nodes import warped_place
from irodori.geometry.surfaces import surface_at
from irodori.jit.c_functions import c_function
from irodori.jit.compilation import uncounted
from irodori.jit.functions import as_float, bits_as_float, bits_as_int, lower_of, magnitude, select, truncated, upper_of
from irodori.jit.vector_memory import gather, largest, load, mask_bits, numbered, spread, store
from irodori.rendering.interactive.cube_maps import Corners, cell_of, face_of, keep_corners
from irodori.rendering.interactive.representation_layout import has_coats, has_sheets

RAYS = 16
TILE = 16  # pixels along a side
PATHS = TILE * TILE
#: Numbers per object for the light map of an endless plane, see `irodori.rendering.map_layouts.Layout`.
GRID = 4
#: Height, relative to the coordinates, by which points of hits are raised above the surface: 32 float32 steps.
_RISE = 2.0**-18
#: Least cosine of a curved shape at a hit: rounding at the outline may make it slightly negative.
_OUTLINE = -1e-3
# RTCRayHit16 as 32-bit words, each field sixteen wide.
_ORIGIN, _NEAR, _DIRECTION, _TIME, _FAR, _MASK, _FLAGS, _U, _V, _PRIMITIVE, _GEOMETRY, _WORDS = (
    0, 48, 64, 112, 128, 144, 176, 240, 256, 272, 288, 352)  # fmt: skip
#: Words of a packet's hit that are kept: distance, u, v, triangle, shape.
KEPT = 5 * RAYS

_LANES = "row, at, centre, direction, along"
_distance = chain("distance", _LANES, __name__, forceinline=True)
_may_be_met = chain("may_be_met", _LANES, __name__, forceinline=True)
_has_formula = lanes_are(lambda shape: shape.kernels.distance is not None, "has_formula", __name__)
_point = lane_chain("point", "offset, facing, radius", 6, __name__)
_texture = lane_chain("texture", "local, wide, high", 2, __name__)
_are_brought_singly = lanes_are(lambda shape: shape.kernels.point is None, "are_brought_singly", __name__)
_are_curved = lanes_are(lambda shape: shape.is_curved, "are_curved", __name__)

_trace = c_function(types.void, types.uintp, types.uintp, types.uintp, types.uintp)


class Packet(NamedTuple):
    """A packet of rays in Embree's layout, preceded by sixteen masks, and a single ray for `surface_at`."""

    f: np.ndarray
    i: np.ndarray
    rays: np.uintp  # address of the rays
    valid: np.uintp  # address of the masks
    ray: Ray
    point: np.ndarray  # (3,) float64
    normal: np.ndarray  # (3,) float64
    facet: np.ndarray  # (3,) float64


class Placed(NamedTuple):
    """Shapes of a packet's hits, and distances."""

    shape: np.ndarray  # vector of int32; rays without a hit have that of another one
    kind: np.ndarray  # vector of float32
    distance: np.ndarray  # vector of float32, mm
    first: int | np.integer  # the only shape, if all rays hit the same
    alike: bool  # whether they do


class TilePaths(NamedTuple):
    """Active paths of a tile; field f of path j is at ``f * STRIDE + j``."""

    f: np.ndarray
    slot: np.ndarray  # (STRIDE,) int32, pixel of the tile


STRIDE = PATHS + RAYS
#: Fields of a path: origin, direction, throughput, width of its cone (mm) and growth of the width with the distance.
ORIGIN, DIRECTION, THROUGHPUT, CONE, SPREAD, PATH_FIELDS = 0, 3, 6, 7, 8, 9

# Fields of a packet's hits, each sixteen wide.
POINT, NORMAL, FACET, TEXTURE_U, TEXTURE_V = 0, 3, 6, 9, 10
COSINE, REFLECTED, NEXT, WIDTH, SIZE = 11, 12, 15, 16, 17
LIT_NORMAL, LIT_MIRROR = 18, 21
# The weights of a triangle's second and third corner.
BARYCENTRIC_B, BARYCENTRIC_C = 24, 25
# The place of a hit in its object's light map; the weights of the four texels around it in the texture, and in the
# light map or the irradiance.
MAP_U, MAP_V, _TEXEL_WEIGHTS, _LIGHT_WEIGHTS, HIT_FIELDS = 26, 27, 28, 32, 36
# Integer fields of a packet's hits.
OBJECT, TRIANGLE, _TEXEL, _LIGHT_TEXEL, HIT_NUMBERS = 0, 1, 2, 4, 6


#: Number of float32 and of float64 in a packet.
PACKET_SINGLES, PACKET_DOUBLES = _WORDS + RAYS + 32, 9


@uncounted()
def packet_in(singles, doubles):
    """Return a packet in zeroed memory, aligned to a cache line, with its constant words set."""
    i = singles.view(np.int32)
    for lane in range(RAYS):
        i[lane + RAYS + _MASK] = -1
        i[lane + RAYS + _GEOMETRY + RAYS] = -1
        i[lane + RAYS + _GEOMETRY + 2 * RAYS] = -1
    single = singles[RAYS + _WORDS :]
    address = np.uintp(singles.ctypes.data)
    ray = Ray(single, single.view(np.int32), np.uintp(0), 0)
    rays = address + np.uintp(4 * RAYS)
    return Packet(singles, i, rays, address, ray, doubles, doubles[3:], doubles[6:])


@uncounted(forceinline=True)
def trace_packet(world, packet, paths, base, active):
    """Trace with Embree those of the sixteen rays from path ``base`` on that the mask ``active`` selects."""
    f, i = packet.f, packet.i
    for axis in range(3):
        store(f, RAYS + _ORIGIN + axis * RAYS, load(paths.f, (ORIGIN + axis) * STRIDE + base, 16))
        store(f, RAYS + _DIRECTION + axis * RAYS, load(paths.f, (DIRECTION + axis) * STRIDE + base, 16))
    store(f, RAYS + _FAR, select(active, np.inf, load(f, RAYS + _FAR, 16)))
    store(i, RAYS + _GEOMETRY, select(active, -1, load(i, RAYS + _GEOMETRY, 16)))
    store(i, 0, select(active, spread(-1, 16), 0))
    _trace(world.intersect, packet.valid, world.scene, packet.rays, world.query)


@uncounted(forceinline=True)
def nearest_shapes(world, origin, direction):
    """Intersect rays with the shapes that have formulas, and mark the rays that Embree has to trace.

    Returns
    -------
    distance : vector of float, mm; infinite without a hit
    shape : vector of int, `NO_HIT` without a hit
    doubtful : mask of the rays that may hit a shape without a formula
    """
    ox, oy, oz = origin
    dx, dy, dz = direction
    # Directions have length 1 except for rounding, which matters if a centre is far away.
    scale = 1.0 / (dx * dx + dy * dy + dz * dz)
    nearest, met = spread(np.float32(np.inf), 16), spread(NO_HIT, 16)
    doubtful = scale < 0.0
    table = world.shape
    for shape in range(world.bounded):
        at = shape * SHAPE
        kind = table[at + KIND]
        x, y, z = table[at] - ox, table[at + 1] - oy, table[at + 2] - oz
        along = (x * dx + y * dy + z * dz) * scale
        if _has_formula(kind):
            distance = _distance(kind, table, at, (x, y, z), direction, along)
            closer = distance < nearest
            nearest, met = select(closer, distance, nearest), select(closer, spread(shape, 16), met)
        else:
            doubtful = doubtful | _may_be_met(kind, table, at, (x, y, z), direction, along)
    return nearest, met, doubtful


@uncounted(forceinline=True)
def meet_by_formula(world, packet, paths, base, active):
    """Intersect the rays from path ``base`` on by formulas; fill hits, return the mask of those left to Embree."""
    origin = (
        load(paths.f, ORIGIN * STRIDE + base, 16),
        load(paths.f, (ORIGIN + 1) * STRIDE + base, 16),
        load(paths.f, (ORIGIN + 2) * STRIDE + base, 16),
    )
    direction = (
        load(paths.f, DIRECTION * STRIDE + base, 16),
        load(paths.f, (DIRECTION + 1) * STRIDE + base, 16),
        load(paths.f, (DIRECTION + 2) * STRIDE + base, 16),
    )
    distance, shape, doubtful = nearest_shapes(world, origin, direction)
    store(packet.f, RAYS + _FAR, distance)
    store(packet.i, RAYS + _GEOMETRY, shape)
    return active & doubtful


@uncounted(forceinline=True)
def keep_packet(packet, kept):
    """Write the hits of a packet to the first `KEPT` numbers of ``kept``."""
    store(kept, 0, load(packet.f, RAYS + _FAR, 16))
    store(kept, 16, load(packet.f, RAYS + _U, 16))
    store(kept, 32, load(packet.f, RAYS + _V, 16))
    store(kept, 48, bits_as_float(load(packet.i, RAYS + _PRIMITIVE, 16)))
    store(kept, 64, bits_as_float(load(packet.i, RAYS + _GEOMETRY, 16)))


@uncounted(forceinline=True)
def recall_packet(packet, kept):
    """Read the hits of a packet that `keep_packet` wrote."""
    store(packet.f, RAYS + _FAR, load(kept, 0, 16))
    store(packet.f, RAYS + _U, load(kept, 16, 16))
    store(packet.f, RAYS + _V, load(kept, 32, 16))
    store(packet.i, RAYS + _PRIMITIVE, bits_as_int(load(kept, 48, 16)))
    store(packet.i, RAYS + _GEOMETRY, bits_as_int(load(kept, 64, 16)))


@uncounted(forceinline=True)
def shapes_met(packet):
    """Return the numbers of the shapes that the rays hit, `NO_HIT` for none."""
    return load(packet.i, RAYS + _GEOMETRY, 16)


@uncounted(forceinline=True)
def distances(packet):
    """Return the distances of the hits, mm."""
    return load(packet.f, RAYS + _FAR, 16)


@uncounted(forceinline=True)
def are_meshes(world, shape):
    """Return the mask of the rays that hit shapes without formulas, from their numbers."""
    hit = shape >= 0
    return hit & _are_brought_singly(gather(world.shape, select(hit, shape, 0) * SHAPE + KIND))


@uncounted(forceinline=True)
def of_shapes(table, size, field, placed):
    """Return one of the ``size`` numbers that a table has for each shape, for the shapes of a packet's hits."""
    if placed.alike:  # as most packets are
        return spread(table[placed.first * size + field], 16)
    return gather(table, placed.shape * size + field)


@uncounted(forceinline=True)
def texture_corners(hits):
    """Return where the texels around the hits in the textures are kept."""
    return Corners(hits.f, _TEXEL_WEIGHTS * RAYS, hits.i, _TEXEL * RAYS)


@uncounted(forceinline=True)
def light_corners(hits):
    """Return where the texels around the hits in light maps, or around their normals in the irradiance, are kept."""
    return Corners(hits.f, _LIGHT_WEIGHTS * RAYS, hits.i, _LIGHT_TEXEL * RAYS)


@uncounted(forceinline=True)
def texel_of(hit, field, columns, rows):
    """Return the upper left of the four texels around hits in bordered maps, texels a row, and fractions to the next.

    ``field`` is that of the hits' first texture coordinate; the second follows.
    """
    u, v = load(hit, field * RAYS, 16), load(hit, (field + 1) * RAYS, 16)
    x = lower_of(upper_of(u * columns + 0.5, 0.0), columns + 0.5)
    y = lower_of(upper_of(v * rows + 0.5, 0.0), rows + 0.5)
    column, row, stride = truncated(x), truncated(y), truncated(columns) + 2
    return row * stride + column, stride, (x - as_float(column), y - as_float(row))


@uncounted(forceinline=True)
def _onto_shapes(world, hit, placed, point):
    """Move hit points exactly onto their shapes; fill points, normals and texture coordinates."""
    table, (px, py, pz) = world.shape, point
    cx, cy, cz = (
        of_shapes(table, SHAPE, 0, placed),
        of_shapes(table, SHAPE, 1, placed),
        of_shapes(table, SHAPE, 2, placed),
    )
    radius, kind = of_shapes(table, SHAPE, RADIUS, placed), placed.kind
    r00, r01, r02 = (
        of_shapes(table, SHAPE, TURN, placed),
        of_shapes(table, SHAPE, TURN + 1, placed),
        of_shapes(table, SHAPE, TURN + 2, placed),
    )
    r10, r11, r12 = (
        of_shapes(table, SHAPE, TURN + 3, placed),
        of_shapes(table, SHAPE, TURN + 4, placed),
        of_shapes(table, SHAPE, TURN + 5, placed),
    )
    r20, r21, r22 = (
        of_shapes(table, SHAPE, TURN + 6, placed),
        of_shapes(table, SHAPE, TURN + 7, placed),
        of_shapes(table, SHAPE, TURN + 8, placed),
    )
    store(hit, SIZE * RAYS, radius)
    x, y, z, nx, ny, nz = _point(kind, (px - cx, py - cy, pz - cz), (r02, r12, r22), radius)
    store(hit, POINT * RAYS, cx + x)
    store(hit, (POINT + 1) * RAYS, cy + y)
    store(hit, (POINT + 2) * RAYS, cz + z)
    for field in range(2):
        store(hit, (NORMAL + 3 * field) * RAYS, nx)
        store(hit, (NORMAL + 3 * field + 1) * RAYS, ny)
        store(hit, (NORMAL + 3 * field + 2) * RAYS, nz)
    local = x * r00 + y * r10 + z * r20, x * r01 + y * r11 + z * r21, x * r02 + y * r12 + z * r22
    u, v = _texture(kind, local, of_shapes(table, SHAPE, WIDE, placed), of_shapes(table, SHAPE, HIGH, placed))
    store(hit, TEXTURE_U * RAYS, u)
    store(hit, TEXTURE_V * RAYS, v)


@uncounted()
def _onto_shape(world, packet, hits, lane, shape):
    """Move the hit point of one ray onto a shape without vector functions, as `_onto_shapes` does for the others."""
    hit, number = hits.f, hits.i
    ray, at = packet.ray, packet.ray.at
    ray.i[at + 17], ray.i[at + 18] = packet.i[RAYS + _PRIMITIVE + lane], shape
    ray.f[at + 15], ray.f[at + 16] = packet.f[RAYS + _U + lane], packet.f[RAYS + _V + lane]
    for axis in range(3):
        packet.point[axis] = hit[(POINT + axis) * RAYS + lane]
    u, v = surface_at(world.surfaces, shape, ray, packet.point, packet.normal, packet.facet)
    for axis in range(3):
        hit[(POINT + axis) * RAYS + lane] = packet.point[axis]
        hit[(NORMAL + axis) * RAYS + lane] = packet.normal[axis]
        hit[(FACET + axis) * RAYS + lane] = packet.facet[axis]
    hit[TEXTURE_U * RAYS + lane], hit[TEXTURE_V * RAYS + lane] = u, v
    number[TRIANGLE * RAYS + lane] = packet.i[RAYS + _PRIMITIVE + lane]
    hit[BARYCENTRIC_B * RAYS + lane], hit[BARYCENTRIC_C * RAYS + lane] = (
        packet.f[RAYS + _U + lane],
        packet.f[RAYS + _V + lane],
    )


@uncounted(forceinline=True)
def place_hits(world, scratch, base, met):
    """Fill points, normals and texture coordinates of the hits that the mask ``met`` selects; return a `Placed`."""
    packet, paths, hits = scratch.packet, scratch.paths, scratch.hits
    distance = select(met, distances(packet), 0.0)
    shape = shapes_met(packet)
    first = np.int64(largest(as_float(select(met, shape, 0))))
    shape = select(met, shape, spread(first, 16))
    alike = mask_bits(shape == first) == 0xFFFF
    placed = Placed(
        shape,
        of_shapes(world.shape, SHAPE, KIND, Placed(shape, distance, distance, first, alike)),
        distance,
        first,
        alike,
    )
    px = load(paths.f, ORIGIN * STRIDE + base, 16) + distance * load(paths.f, DIRECTION * STRIDE + base, 16)
    py = load(paths.f, (ORIGIN + 1) * STRIDE + base, 16) + distance * load(paths.f, (DIRECTION + 1) * STRIDE + base, 16)
    pz = load(paths.f, (ORIGIN + 2) * STRIDE + base, 16) + distance * load(paths.f, (DIRECTION + 2) * STRIDE + base, 16)
    store(hits.i, OBJECT * RAYS, shape)
    _onto_shapes(world, hits.f, placed, (px, py, pz))
    if world.brought_singly > 0:
        single = mask_bits(_are_brought_singly(placed.kind) & met)
        for lane in range(RAYS):
            if (single >> lane) & 1:
                _onto_shape(world, packet, hits, lane, hits.i[OBJECT * RAYS + lane])
    return placed


@uncounted()
def place_on_planes(world, hit, number, bits):
    """Replace the places in light maps of those hits, given as bits, that are on endless planes."""
    for ray in range(RAYS):
        shape = number[OBJECT * RAYS + ray]
        if not (bits >> ray) & 1 or world.baked_grid[GRID * shape + 2] == 0.0:
            continue
        row, at, grid = world.shape, shape * SHAPE, GRID * shape
        x = hit[POINT * RAYS + ray] - row[at + CENTRE]
        y = hit[(POINT + 1) * RAYS + ray] - row[at + CENTRE + 1]
        z = hit[(POINT + 2) * RAYS + ray] - row[at + CENTRE + 2]
        across = x * row[at + TURN] + y * row[at + TURN + 3] + z * row[at + TURN + 6]
        along = x * row[at + TURN + 1] + y * row[at + TURN + 4] + z * row[at + TURN + 7]
        u = warped_place((across - world.baked_grid[grid]) / world.baked_grid[grid + 2])
        v = warped_place((along - world.baked_grid[grid + 1]) / world.baked_grid[grid + 3])
        hit[MAP_U * RAYS + ray], hit[MAP_V * RAYS + ray] = 0.5 + 0.5 * u, 0.5 + 0.5 * v


@uncounted(forceinline=True)
def nodes_around(world, hits, ray, shape):
    """Return the first corner of the triangle that a ray hit, and corners around the hit with weights.

    See `irodori.geometry.shapes.mesh_nodes.lattice_place`.
    """
    triangle = world.first_face[shape] + hits.i[TRIANGLE * RAYS + ray]
    b, c = np.float64(hits.f[BARYCENTRIC_B * RAYS + ray]), np.float64(hits.f[BARYCENTRIC_C * RAYS + ray])
    places, weights = lattice_place(np.int64(world.baked_parts[triangle]), b, c)
    return world.baked_corner[triangle], places, weights


@uncounted(forceinline=True)
def turned(rotation, row, x, y, z):
    """Return coordinate ``row`` of vectors rotated by a flat (9,) matrix."""
    return rotation[3 * row] * x + rotation[3 * row + 1] * y + rotation[3 * row + 2] * z


@uncounted(forceinline=True)
def prepare_hits(job, scratch, base, met, placed):
    """Fill reflection directions, texels and look-up points of hits.

    Where the back of a sheet is seen, `OBJECT` becomes that side, and the normals its own. ``placed`` is the result of
    `place_hits`.

    Returns
    -------
    mask of the hits that are not black from behind
    Placed
        With those sides as shapes.
    """
    world, paths, hit, number = job.world, scratch.paths, scratch.hits.f, scratch.hits.i
    kind, distance = placed.kind, placed.distance
    dx, dy, dz = (
        load(paths.f, DIRECTION * STRIDE + base, 16),
        load(paths.f, (DIRECTION + 1) * STRIDE + base, 16),
        load(paths.f, (DIRECTION + 2) * STRIDE + base, 16),
    )
    fx, fy, fz = load(hit, FACET * RAYS, 16), load(hit, (FACET + 1) * RAYS, 16), load(hit, (FACET + 2) * RAYS, 16)
    front = -(fx * dx + fy * dy + fz * dz)
    nx, ny, nz = load(hit, NORMAL * RAYS, 16), load(hit, (NORMAL + 1) * RAYS, 16), load(hit, (NORMAL + 2) * RAYS, 16)
    if has_sheets(job.layout):
        behind = of_shapes(world.shape, SHAPE, BEHIND, placed)
        over = met & (front < 0.0) & (behind >= 0.0)
        shape, sign = select(over, truncated(behind), placed.shape), select(over, spread(np.float32(-1.0), 16), 1.0)
        front = front * sign
        placed = Placed(shape, kind, distance, placed.first, placed.alike and mask_bits(over) == 0)
        nx, ny, nz, fx, fy, fz = nx * sign, ny * sign, nz * sign, fx * sign, fy * sign, fz * sign
        store(number, OBJECT * RAYS, shape)
        store(hit, FACET * RAYS, fx)
        store(hit, (FACET + 1) * RAYS, fy)
        store(hit, (FACET + 2) * RAYS, fz)
    seen = met & ((front > 0.0) | (_are_curved(kind) & (front > _OUTLINE)))
    cosine = -(nx * dx + ny * dy + nz * dz)
    away = cosine <= 0.0
    nx, ny, nz = select(away, fx, nx), select(away, fy, ny), select(away, fz, nz)
    cosine = lower_of(upper_of(select(away, front, cosine), 0.0), 1.0)
    rx, ry, rz = dx + 2.0 * cosine * nx, dy + 2.0 * cosine * ny, dz + 2.0 * cosine * nz
    store(hit, COSINE * RAYS, cosine)
    store(hit, NORMAL * RAYS, nx)
    store(hit, (NORMAL + 1) * RAYS, ny)
    store(hit, (NORMAL + 2) * RAYS, nz)
    store(hit, REFLECTED * RAYS, rx)
    store(hit, (REFLECTED + 1) * RAYS, ry)
    store(hit, (REFLECTED + 2) * RAYS, rz)
    width = load(paths.f, CONE * STRIDE + base, 16) + distance * load(paths.f, SPREAD * STRIDE + base, 16)
    store(hit, WIDTH * RAYS, width)
    # The texture has a border, which its sides or its edges fill.
    one = spread(np.float32(1.0), 16)
    columns, rows = (
        of_shapes(world.shape, SHAPE, COLUMNS, placed),
        of_shapes(world.shape, SHAPE, ROWS, placed),
    )
    texel, stride, place = texel_of(hit, TEXTURE_U, columns, rows)
    texel = texel + of_shapes(world.texture_first, 1, 0, placed)
    keep_corners(texture_corners(scratch.hits), texel, stride, place, one)
    # The light may be rotated: directions are rotated back before they are looked up.
    turn = job.frame.light_from_world
    lx, ly, lz = turned(turn, 0, nx, ny, nz), turned(turn, 1, nx, ny, nz), turned(turn, 2, nx, ny, nz)
    store(hit, LIT_NORMAL * RAYS, lx)
    store(hit, (LIT_NORMAL + 1) * RAYS, ly)
    store(hit, (LIT_NORMAL + 2) * RAYS, lz)
    store(hit, LIT_MIRROR * RAYS, turned(turn, 0, rx, ry, rz))
    store(hit, (LIT_MIRROR + 1) * RAYS, turned(turn, 1, rx, ry, rz))
    store(hit, (LIT_MIRROR + 2) * RAYS, turned(turn, 2, rx, ry, rz))
    if world.baked_maps > 0:
        store(hit, MAP_U * RAYS, load(hit, TEXTURE_U * RAYS, 16))
        store(hit, MAP_V * RAYS, load(hit, TEXTURE_V * RAYS, 16))
        if world.baked_planes > 0:
            place_on_planes(world, hit, number, mask_bits(seen))
        columns, rows = of_shapes(world.baked_size, 2, 0, placed), of_shapes(world.baked_size, 2, 1, placed)
        texel, stride, place = texel_of(hit, MAP_U, columns, rows)
        texel = texel + of_shapes(world.baked_first, 1, 0, placed)
        keep_corners(light_corners(scratch.hits), texel, stride, place, one)
    elif world.irradiance_side > 0:
        face, a, b = face_of(lx, ly, lz)
        cell, x, y = cell_of(face, a, b, spread(np.float32(world.irradiance_side), 16))
        if has_coats(job.layout):
            cell = cell + of_shapes(world.coat_first, 1, 0, placed)
        stride = spread(world.irradiance_side + 2, 16)
        keep_corners(light_corners(scratch.hits), cell, stride, (x, y), one)
    return seen, placed


@uncounted(forceinline=True)
def raised(hit, axis, side):
    """Return one coordinate of the hits' points, raised by the error of single precision; lowered if ``side`` is -1."""
    facet = load(hit, (FACET + axis) * RAYS, 16)
    x, y, z = load(hit, POINT * RAYS, 16), load(hit, (POINT + 1) * RAYS, 16), load(hit, (POINT + 2) * RAYS, 16)
    reach = upper_of(upper_of(magnitude(x), magnitude(y)), upper_of(magnitude(z), load(hit, SIZE * RAYS, 16)))
    return load(hit, (POINT + axis) * RAYS, 16) + reach * _RISE * (facet * side)


@uncounted(forceinline=True)
def active_lanes(count, base):
    """Return the mask of the lanes that hold a path: sixteen from ``base`` on, fewer at the end of ``count``."""
    return numbered(16) + base < count
