"""Light look-ups of a packet of rays: sky radiance, and blurred light for the four lobes of each hit."""

import numpy as np

from irodori.jit.compilation import uncounted
from irodori.jit.functions import as_float, bits_as_float, bits_as_int, lower_of, root, truncated, upper_of
from irodori.jit.vector_memory import gather, lane, load, load_like, numbered, pair_mixed, spread, store
from irodori.reflection.fresnel import fresnel
from irodori.rendering.interactive.cube_maps import MapPlace, bilinear, cell_of, face_of
from irodori.rendering.interactive.packets import (
    COSINE,
    DIRECTION,
    LIT_MIRROR,
    LIT_NORMAL,
    NORMAL,
    OBJECT,
    RAYS,
    REFLECTED,
    SPREAD,
    STRIDE,
    turned,
)
from irodori.rendering.interactive.representation_layout import (
    is_coloured,
    light_black,
    light_lanes,
    pair_black,
    seen_black,
    seen_lanes,
    surface_black,
    surface_lanes,
)
from irodori.rendering.interactive.round_lobes import ENTRY, POWER, TAPS

# Fields of a look-up, each sixteen wide, and whole numbers.
_X, _Y, _MIX, _WEIGHT, _COS_H, _FIELDS = 0, 1, 2, 3, 4, 5
_CELL, _LEVEL, _NUMBERS = 0, 1, 2
# After those of the taps: a hit's look-up in the surroundings of its object, see `surroundings`.
_SEEN_X, _SEEN_Y, _SEEN_CELL = TAPS * _FIELDS, TAPS * _FIELDS + 1, TAPS * _NUMBERS
LOOK_FIELDS, LOOK_NUMBERS = TAPS * _FIELDS + 2, TAPS * _NUMBERS + 1


@uncounted(forceinline=True)
def decoded(world, layout, light):
    """Return stored light as a colour, in the channels of a texel."""
    out = surface_black(layout)
    row = surface_lanes(layout)
    for channel in range(light_lanes(layout)):
        out = out + lane(light, channel) * load_like(world.decode, channel * row, out)
    return out


@uncounted(forceinline=True)
def logarithm(x):
    """Return the binary logarithm of positive numbers in a lane vector, accurate to 0.01."""
    bits = bits_as_int(x)
    exponent = as_float((bits >> 23) - 127)
    mantissa = bits_as_float((bits & 0x007FFFFF) | 0x3F800000)
    return exponent + (mantissa * (2.0 - mantissa * (1.0 / 3.0)) - 5.0 / 3.0)


@uncounted(forceinline=True)
def find_sky(world, frame, paths, base, hits):
    """Compute where sixteen paths from ``base`` on look up the sky, in the two levels nearest to their cones' width."""
    dx, dy, dz = (
        load(paths.f, DIRECTION * STRIDE + base, 16),
        load(paths.f, (DIRECTION + 1) * STRIDE + base, 16),
        load(paths.f, (DIRECTION + 2) * STRIDE + base, 16),
    )
    look, number, turn = hits.look, hits.look_i, frame.light_from_world
    face, u, v = face_of(turned(turn, 0, dx, dy, dz), turned(turn, 1, dx, dy, dz), turned(turn, 2, dx, dy, dz))
    width = load(paths.f, SPREAD * STRIDE + base, 16)
    last = float(world.environment_levels - 1)
    level = logarithm(upper_of(width * world.texels_per_rad, 1.0))
    level = lower_of(upper_of(level, 0.0), last)
    lower = truncated(level)
    store(look, _MIX * RAYS, level - as_float(lower))
    for step in range(2):
        chosen = truncated(lower_of(as_float(lower + step), last))
        side = as_float(gather(world.environment_side, chosen))
        cell, x, y = cell_of(face, u, v, side)
        store(number, (step * _NUMBERS + _CELL) * RAYS, cell)
        store(number, (step * _NUMBERS + _LEVEL) * RAYS, chosen)
        store(look, (step * _FIELDS + _X) * RAYS, x)
        store(look, (step * _FIELDS + _Y) * RAYS, y)


@uncounted(forceinline=True)
def _place(hits, ray, number):
    """Return the map point of one ray's look-up ``number``: the number of a lobe, or of one of the sky's two levels."""
    cell = np.int64(hits.look_i[(number * _NUMBERS + _CELL) * RAYS + ray])
    look, at = hits.look, number * _FIELDS
    return MapPlace(cell, look[(at + _X) * RAYS + ray], look[(at + _Y) * RAYS + ray])


@uncounted(forceinline=True)
def sky_at(world, layout, hits, ray):
    """Return the sky's light, in stored form, for one ray of the packet."""
    like = light_black(layout)
    level = hits.look_i[_LEVEL * RAYS + ray]
    first, stride = world.environment_first[level], world.environment_side[level] + 2
    found = bilinear(world.environment, first, stride, _place(hits, ray, 0), like)
    mix = hits.look[_MIX * RAYS + ray]
    if mix > 0.01:
        level = hits.look_i[(_NUMBERS + _LEVEL) * RAYS + ray]
        first, stride = world.environment_first[level], world.environment_side[level] + 2
        found = (1.0 - mix) * found + mix * bilinear(world.environment, first, stride, _place(hits, ray, 1), like)
    return found


@uncounted(forceinline=True)
def find_lobes(world, layout, hits, entries):
    """Compute where the four lobes of a row are looked up for a packet's hits, from their table entries."""
    hit, look, number = hits.f, hits.look, hits.look_i
    cosine = load(hit, COSINE * RAYS, 16)
    nx, ny, nz = (
        load(hit, LIT_NORMAL * RAYS, 16),
        load(hit, (LIT_NORMAL + 1) * RAYS, 16),
        load(hit, (LIT_NORMAL + 2) * RAYS, 16),
    )
    rx, ry, rz = (
        load(hit, LIT_MIRROR * RAYS, 16),
        load(hit, (LIT_MIRROR + 1) * RAYS, 16),
        load(hit, (LIT_MIRROR + 2) * RAYS, 16),
    )
    at = numbered(16) * ENTRY
    last = float(world.gloss_levels - 1)
    level = lower_of(upper_of(gather(entries, at) - world.gloss_level, 0.0), last)
    lower = truncated(level)
    side = as_float(gather(world.gloss_side, lower))
    store(look, _MIX * RAYS, level - as_float(lower))
    store(number, _LEVEL * RAYS, lower)
    sine2 = 1.0 - cosine * cosine
    power = gather(entries, at + POWER)
    object_ = load(hits.i, OBJECT * RAYS, 16)
    width = surface_lanes(layout)
    n, k = gather(world.index, object_ * (2 * width)), gather(world.index, object_ * (2 * width) + width)
    along_mirror, along_normal = 0.0 * cosine, 0.0 * cosine  # of the sum of the lobes' directions
    for tap in range(TAPS):
        weight, p = gather(entries, at + (1 + 3 * tap)), gather(entries, at + (2 + 3 * tap))
        cos_h = gather(entries, at + (3 + 3 * tap))
        q = root(upper_of(1.0 - p * p * sine2, 0.0)) - p * cosine
        ax, ay, az = p * rx + q * nx, p * ry + q * ny, p * rz + q * nz
        along_mirror, along_normal = along_mirror + weight * p, along_normal + weight * q
        face, u, v = face_of(ax, ay, az)
        cell, x, y = cell_of(face, u, v, side)
        store(number, (tap * _NUMBERS + _CELL) * RAYS, cell)
        store(look, (tap * _FIELDS + _X) * RAYS, x)
        store(look, (tap * _FIELDS + _Y) * RAYS, y)
        weight = weight * power
        if not is_coloured(layout):
            weight = weight * fresnel(cos_h, n, k)
        store(look, (tap * _FIELDS + _WEIGHT) * RAYS, weight)
        store(look, (tap * _FIELDS + _COS_H) * RAYS, cos_h)
    if world.seen_maps > 0:
        # Objects do not turn with the light.
        face, u, v = face_of(
            along_mirror * load(hit, REFLECTED * RAYS, 16) + along_normal * load(hit, NORMAL * RAYS, 16),
            along_mirror * load(hit, (REFLECTED + 1) * RAYS, 16) + along_normal * load(hit, (NORMAL + 1) * RAYS, 16),
            along_mirror * load(hit, (REFLECTED + 2) * RAYS, 16) + along_normal * load(hit, (NORMAL + 2) * RAYS, 16),
        )
        cell, x, y = cell_of(face, u, v, spread(np.float32(world.seen_side), 16))
        store(number, _SEEN_CELL * RAYS, cell)
        store(look, _SEEN_X * RAYS, x)
        store(look, _SEEN_Y * RAYS, y)


@uncounted(forceinline=True)
def surroundings(world, layout, hits, ray, place):
    """Return what the mean direction of a hit's lobes sees: the share of free directions, then light of other objects.

    ``place`` is the place of the hit on its object, u and v.
    """
    shape, (u, v) = hits.i[OBJECT * RAYS + ray], place
    columns, rows, half = world.seen_size[2 * shape], world.seen_size[2 * shape + 1], np.float32(0.5)
    x = min(max(u * columns + half, np.float32(0.0)), columns + half)
    y = min(max(v * rows + half, np.float32(0.0)), rows + half)
    column, row = np.int64(x), np.int64(y)
    fx, fy = x - np.float32(column), y - np.float32(row)
    cell = np.int64(hits.look_i[_SEEN_CELL * RAYS + ray])
    towards = MapPlace(cell, hits.look[_SEEN_X * RAYS + ray], hits.look[_SEEN_Y * RAYS + ray])
    side, like, left, upper = np.int64(world.seen_side) + 2, seen_black(layout), half + half - fx, half + half - fy
    size = 6 * side * side * seen_lanes(layout)
    at = world.seen_first[shape] + (row * (np.int64(columns) + 2) + column) * size
    below = at + (np.int64(columns) + 2) * size
    top = left * bilinear(world.seen, at, side, towards, like)
    top = top + fx * bilinear(world.seen, at + size, side, towards, like)
    bottom = left * bilinear(world.seen, below, side, towards, like)
    bottom = bottom + fx * bilinear(world.seen, below + size, side, towards, like)
    return upper * top + fy * bottom


@uncounted(forceinline=True)
def lobe_at(world, layout, hits, ray, tap):
    """Return the blurred light for one lobe of one hit, in stored form, without the lobe's weight."""
    level = hits.look_i[_LEVEL * RAYS + ray]
    first, stride = world.gloss_first[level], world.gloss_side[level] + 2
    found = bilinear(world.gloss, first, stride, _place(hits, ray, tap), pair_black(layout))
    return pair_mixed(found, hits.look[_MIX * RAYS + ray])


@uncounted(forceinline=True)
def lobe_weight(look, ray, tap):
    """Return the weight of one lobe of one hit, with its Fresnel reflectance unless paths are coloured."""
    return look[(tap * _FIELDS + _WEIGHT) * RAYS + ray]


@uncounted(forceinline=True)
def lobe_incidence(look, ray, tap):
    """Return cosθ_H of one lobe of one hit."""
    return look[(tap * _FIELDS + _COS_H) * RAYS + ray]
