"""Packets of sixteen rays: tracing by formulas and Embree, then points, normals and texture coordinates of hits."""

from typing import NamedTuple

import numpy as np
from numba import types

from irodori.geometry.embree import NO_HIT, Ray
from irodori.geometry.shape_dispatch import chain, lane_chain, lanes_are
from irodori.geometry.shapes.shape_rows import BEHIND, COLUMNS, HIGH, KIND, RADIUS, ROWS, SHAPE, TURN, WIDE
from irodori.geometry.surfaces import surface_at
from irodori.jit.c_functions import c_function
from irodori.jit.compilation import uncounted
from irodori.jit.functions import as_float, bits_as_float, bits_as_int, lower_of, magnitude, select, truncated, upper_of
from irodori.jit.vector_memory import gather, load, mask_bits, numbered, spread, store
from irodori.rendering.interactive.cube_maps import cell_of, face_of
from irodori.rendering.interactive.representation_layout import has_sheets

RAYS = 16
TILE = 16  # pixels along a side
PATHS = TILE * TILE
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


class TilePaths(NamedTuple):
    """Active paths of a tile; field f of path j is at ``f * STRIDE + j``."""

    f: np.ndarray
    slot: np.ndarray  # (STRIDE,) int32, pixel of the tile


STRIDE = PATHS + RAYS
#: Fields of a path: origin, direction, throughput, width of its cone (mm) and growth of the width with the distance.
ORIGIN, DIRECTION, THROUGHPUT, CONE, SPREAD, PATH_FIELDS = 0, 3, 6, 7, 8, 9

# Fields of a packet's hits, each sixteen wide.
POINT, NORMAL, FACET, TEXTURE_U, TEXTURE_V = 0, 3, 6, 9, 10
COSINE, REFLECTED, TEXEL_X, TEXEL_Y, NORMAL_X, NORMAL_Y = 11, 12, 15, 16, 17, 18
LIT_NORMAL, LIT_MIRROR, NEXT, WIDTH = 20, 23, 26, 27
SIZE = 29
# The weights of a triangle's second and third corner.
BARYCENTRIC_B, BARYCENTRIC_C, HIT_FIELDS = 28, 30, 31
# Integer fields of a packet's hits.
OBJECT, TEXEL, NORMAL_CELL, TRIANGLE, HIT_NUMBERS = 0, 1, 2, 3, 4


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
def _onto_shapes(world, hit, shape, point):
    """Move hit points exactly onto their shapes; fill points, normals and texture coordinates."""
    table, at, (px, py, pz) = world.shape, shape * SHAPE, point
    cx, cy, cz = gather(table, at), gather(table, at + 1), gather(table, at + 2)
    radius, kind = gather(table, at + RADIUS), gather(table, at + KIND)
    r00, r01, r02 = gather(table, at + TURN), gather(table, at + (TURN + 1)), gather(table, at + (TURN + 2))
    r10, r11, r12 = gather(table, at + (TURN + 3)), gather(table, at + (TURN + 4)), gather(table, at + (TURN + 5))
    r20, r21, r22 = gather(table, at + (TURN + 6)), gather(table, at + (TURN + 7)), gather(table, at + (TURN + 8))
    x, y, z, nx, ny, nz = _point(kind, (px - cx, py - cy, pz - cz), (r02, r12, r22), radius)
    store(hit, POINT * RAYS, cx + x)
    store(hit, (POINT + 1) * RAYS, cy + y)
    store(hit, (POINT + 2) * RAYS, cz + z)
    for field in range(2):
        store(hit, (NORMAL + 3 * field) * RAYS, nx)
        store(hit, (NORMAL + 3 * field + 1) * RAYS, ny)
        store(hit, (NORMAL + 3 * field + 2) * RAYS, nz)
    local = x * r00 + y * r10 + z * r20, x * r01 + y * r11 + z * r21, x * r02 + y * r12 + z * r22
    u, v = _texture(kind, local, gather(table, at + WIDE), gather(table, at + HIGH))
    store(hit, TEXTURE_U * RAYS, u)
    store(hit, TEXTURE_V * RAYS, v)
    return kind


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
    """Fill points, normals and texture coordinates of the hits that the mask ``met`` selects.

    Returns
    -------
    shape, kind : vectors of int
    distance : vector of float, mm
    """
    packet, paths, hits = scratch.packet, scratch.paths, scratch.hits
    distance = select(met, distances(packet), 0.0)
    shape = select(met, shapes_met(packet), 0)
    px = load(paths.f, ORIGIN * STRIDE + base, 16) + distance * load(paths.f, DIRECTION * STRIDE + base, 16)
    py = load(paths.f, (ORIGIN + 1) * STRIDE + base, 16) + distance * load(paths.f, (DIRECTION + 1) * STRIDE + base, 16)
    pz = load(paths.f, (ORIGIN + 2) * STRIDE + base, 16) + distance * load(paths.f, (DIRECTION + 2) * STRIDE + base, 16)
    store(hits.i, OBJECT * RAYS, shape)
    store(hits.f, SIZE * RAYS, gather(world.shape, shape * SHAPE + RADIUS))
    kind = _onto_shapes(world, hits.f, shape, (px, py, pz))
    if world.brought_singly > 0:
        single = mask_bits(_are_brought_singly(kind) & met)
        for lane in range(RAYS):
            if (single >> lane) & 1:
                _onto_shape(world, packet, hits, lane, hits.i[OBJECT * RAYS + lane])
    return shape, kind, distance


@uncounted(forceinline=True)
def turned(rotation, row, x, y, z):
    """Return coordinate ``row`` of vectors rotated by a flat (9,) matrix."""
    return rotation[3 * row] * x + rotation[3 * row + 1] * y + rotation[3 * row + 2] * z


@uncounted(forceinline=True)
def prepare_hits(job, scratch, base, met, placed):
    """Fill reflection directions, texels and look-up points of hits; return the mask of those not black from behind.

    Where the back of a sheet is seen, `OBJECT` becomes that side, and the normals its own. ``placed`` is the result of
    `place_hits`.
    """
    world, paths, hit, number = job.world, scratch.paths, scratch.hits.f, scratch.hits.i
    shape, kind, distance = placed
    table, at = world.shape, shape * SHAPE
    dx, dy, dz = (
        load(paths.f, DIRECTION * STRIDE + base, 16),
        load(paths.f, (DIRECTION + 1) * STRIDE + base, 16),
        load(paths.f, (DIRECTION + 2) * STRIDE + base, 16),
    )
    fx, fy, fz = load(hit, FACET * RAYS, 16), load(hit, (FACET + 1) * RAYS, 16), load(hit, (FACET + 2) * RAYS, 16)
    front = -(fx * dx + fy * dy + fz * dz)
    nx, ny, nz = load(hit, NORMAL * RAYS, 16), load(hit, (NORMAL + 1) * RAYS, 16), load(hit, (NORMAL + 2) * RAYS, 16)
    if has_sheets(job.layout):
        behind = gather(table, at + BEHIND)
        over = met & (front < 0.0) & (behind >= 0.0)
        shape, sign = select(over, truncated(behind), shape), select(over, spread(np.float32(-1.0), 16), 1.0)
        at, front = shape * SHAPE, front * sign
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
    columns, rows = gather(table, at + COLUMNS), gather(table, at + ROWS)
    u, v = load(hit, TEXTURE_U * RAYS, 16), load(hit, TEXTURE_V * RAYS, 16)
    x, y = (
        lower_of(upper_of(u * columns + 0.5, 0.0), columns + 0.5),
        lower_of(upper_of(v * rows + 0.5, 0.0), rows + 0.5),
    )
    column, row = truncated(x), truncated(y)
    store(hit, TEXEL_X * RAYS, x - as_float(column))
    store(hit, TEXEL_Y * RAYS, y - as_float(row))
    store(number, TEXEL * RAYS, row * (truncated(columns) + 2) + column)
    # The light may be rotated: directions are rotated back before they are looked up.
    turn = job.frame.light_from_world
    lx, ly, lz = turned(turn, 0, nx, ny, nz), turned(turn, 1, nx, ny, nz), turned(turn, 2, nx, ny, nz)
    store(hit, LIT_NORMAL * RAYS, lx)
    store(hit, (LIT_NORMAL + 1) * RAYS, ly)
    store(hit, (LIT_NORMAL + 2) * RAYS, lz)
    store(hit, LIT_MIRROR * RAYS, turned(turn, 0, rx, ry, rz))
    store(hit, (LIT_MIRROR + 1) * RAYS, turned(turn, 1, rx, ry, rz))
    store(hit, (LIT_MIRROR + 2) * RAYS, turned(turn, 2, rx, ry, rz))
    face, a, b = face_of(lx, ly, lz)
    cell, sx, sy = cell_of(face, a, b, spread(np.float32(world.irradiance_side), 16))
    store(number, NORMAL_CELL * RAYS, cell)
    store(hit, NORMAL_X * RAYS, sx)
    store(hit, NORMAL_Y * RAYS, sy)
    return seen


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
