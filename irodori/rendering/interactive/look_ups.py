"""Light look-ups of a packet of rays: sky radiance, and blurred light for the four lobes of each hit."""

import numpy as np

from irodori.jit.compilation import uncounted
from irodori.jit.functions import as_float, bits_as_float, bits_as_int, lower_of, root, select, truncated, upper_of
from irodori.jit.vector_memory import (
    gather,
    lane,
    load,
    load_like,
    mask_bits,
    numbered,
    pair_mixed,
    spread,
    store,
    zeros_like,
)
from irodori.reflection.fresnel import fresnel
from irodori.rendering.interactive.cube_maps import (
    Corners,
    at_corners,
    cell_of,
    corners_apart,
    face_of,
    keep_corners,
    prefetch_corners,
)
from irodori.rendering.interactive.packets import (
    COSINE,
    DIRECTION,
    LIT_MIRROR,
    LIT_NORMAL,
    MAP_U,
    NORMAL,
    OBJECT,
    RAYS,
    REFLECTED,
    SPREAD,
    STRIDE,
    THROUGHPUT,
    nodes_around,
    of_shapes,
    texel_of,
    turned,
)
from irodori.rendering.interactive.representation_layout import (
    is_coloured,
    light_black,
    light_lanes,
    pair_black,
    seen_cells_black,
    seen_lanes,
    surface_black,
    surface_lanes,
)
from irodori.rendering.interactive.round_lobes import ANGLES, ENTRY, POWER, ROUGHNESSES, TAPS

# Fields of a look-up, each sixteen wide, and whole numbers; see `Corners` for the first of both.
_WEIGHT, _COS_H, _FIELDS = 4, 5, 6
_NUMBERS = 2
#: Cube maps of surroundings that are mixed at each node of a mesh.
LINKS = 3
# After those of the taps: how far the level is from the next, and a hit's look-up in the surroundings of its object:
# weights of the four texels around it, and fractions of the way to the next cell of their cubes.
_MIX, _SEEN, _SEEN_X, _SEEN_Y = TAPS * _FIELDS, TAPS * _FIELDS + 1, TAPS * _FIELDS + 5, TAPS * _FIELDS + 6
_SEEN_CELL = TAPS * _NUMBERS
LOOK_FIELDS, LOOK_NUMBERS = TAPS * _FIELDS + 7, TAPS * _NUMBERS + 2
# Fields of a packet's look-ups of the sky, each sixteen wide: weights of four texels in each of two levels; and whole
# numbers: two texels in each level, then the pixels of the tile.
SKY_FIELDS, SKY_NUMBERS = 2 * 4, 2 * _NUMBERS + 1
_SKY_SLOT = 2 * _NUMBERS
#: Share of the next level below which it is left out.
_LEAST_MIX = 0.01


@uncounted(forceinline=True)
def _corners(hits, tap):
    """Return where the texels of a lobe are kept."""
    return Corners(hits.look, tap * _FIELDS * RAYS, hits.look_i, tap * _NUMBERS * RAYS)


@uncounted(forceinline=True)
def _sky_corners(sky, step):
    """Return where the texels of one of the sky's two levels are kept."""
    return Corners(sky.f, step * 4 * RAYS, sky.i, step * _NUMBERS * RAYS)


@uncounted(forceinline=True)
def _seen_corners(hits):
    return Corners(hits.look, _SEEN * RAYS, hits.look_i, _SEEN_CELL * RAYS)


@uncounted(forceinline=True)
def cells_of(world):
    """Return the number of cells of a cube map of surroundings."""
    return 6 * (world.seen_side + 2) * (world.seen_side + 2)


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
def find_sky(job, paths, base, sky, missed):
    """Compute where sixteen paths from ``base`` on look up the sky, in the two levels nearest to their cones' width.

    The texels are asked for, and kept with the paths' pixels until `sky_at` reads them. Returns whether any of them
    looks the second level up. Weights include the throughput unless paths are coloured.
    """
    dx, dy, dz = (
        load(paths.f, DIRECTION * STRIDE + base, 16),
        load(paths.f, (DIRECTION + 1) * STRIDE + base, 16),
        load(paths.f, (DIRECTION + 2) * STRIDE + base, 16),
    )
    world, layout, turn = job.world, job.layout, job.frame.light_from_world
    face, u, v = face_of(turned(turn, 0, dx, dy, dz), turned(turn, 1, dx, dy, dz), turned(turn, 2, dx, dy, dz))
    width = load(paths.f, SPREAD * STRIDE + base, 16)
    last = float(world.environment_levels - 1)
    level = logarithm(upper_of(width * world.texels_per_rad, 1.0))
    level = lower_of(upper_of(level, 0.0), last)
    lower = truncated(level)
    mix = level - as_float(lower)
    mix = select(mix > _LEAST_MIX, mix, 0.0)
    weight = spread(np.float32(1.0), 16)
    if not is_coloured(layout):
        weight = load(paths.f, THROUGHPUT * STRIDE + base, 16)
    blends = mask_bits(mix > 0.0) != 0
    for step in range(2):
        if step == 0 or blends:
            chosen = truncated(lower_of(as_float(lower + step), last))
            side = gather(world.environment_side, chosen)
            cell, x, y = cell_of(face, u, v, as_float(side))
            cell = cell + gather(world.environment_first, chosen)
            keep_corners(_sky_corners(sky, step), cell, side + 2, (x, y), weight * (mix if step else 1.0 - mix))
            for ray in range(RAYS):
                if (missed >> ray) & 1:
                    prefetch_corners(world.environment, _sky_corners(sky, step), ray, light_lanes(layout))
    store(sky.i, _SKY_SLOT * RAYS, load(paths.slot, base, 16))
    return blends


@uncounted(forceinline=True)
def sky_at(world, layout, sky, ray, blends):
    """Return a ray's pixel and the sky's light, in stored form, times the weight of `find_sky`."""
    found = at_corners(world.environment, _sky_corners(sky, 0), ray, light_black(layout))
    if blends:
        found = found + at_corners(world.environment, _sky_corners(sky, 1), ray, found)
    return np.int64(sky.i[_SKY_SLOT * RAYS + ray]), found


@uncounted(forceinline=True)
def find_lobes(world, layout, hits, entries, placed):
    """Compute where the four lobes of a row are looked up for a packet's hits, from their table entries.

    ``placed`` is the result of `irodori.rendering.interactive.packets.place_hits`.
    """
    hit, look = hits.f, hits.look
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
    side, first_texel = gather(world.gloss_side, lower), gather(world.gloss_first, lower)
    store(look, _MIX * RAYS, level - as_float(lower))
    sine2 = 1.0 - cosine * cosine
    power = gather(entries, at + POWER)
    width = surface_lanes(layout)
    n, k = of_shapes(world.index, 2 * width, 0, placed), of_shapes(world.index, 2 * width, width, placed)
    along_mirror, along_normal = 0.0 * cosine, 0.0 * cosine  # of the sum of the lobes' directions
    for tap in range(TAPS):
        weight, p = gather(entries, at + (1 + 3 * tap)), gather(entries, at + (2 + 3 * tap))
        cos_h = gather(entries, at + (3 + 3 * tap))
        q = root(upper_of(1.0 - p * p * sine2, 0.0)) - p * cosine
        ax, ay, az = p * rx + q * nx, p * ry + q * ny, p * rz + q * nz
        along_mirror, along_normal = along_mirror + weight * p, along_normal + weight * q
        face, u, v = face_of(ax, ay, az)
        cell, x, y = cell_of(face, u, v, as_float(side))
        weight = weight * power
        if not is_coloured(layout):
            weight = weight * fresnel(cos_h, n, k)
        keep_corners(_corners(hits, tap), cell + first_texel, side + 2, (x, y), weight)
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
        columns, rows = of_shapes(world.seen_size, 2, 0, placed), of_shapes(world.seen_size, 2, 1, placed)
        texel, stride, place = texel_of(hit, MAP_U, columns, rows)
        store(look, _SEEN_X * RAYS, x)
        store(look, _SEEN_Y * RAYS, y)
        cell = cell + (texel + of_shapes(world.seen_first, 1, 0, placed)) * cells_of(world)
        keep_corners(_seen_corners(hits), cell, stride * cells_of(world), place, spread(np.float32(1.0), 16))


@uncounted(forceinline=True)
def sees_objects(world, hits, ray):
    """Return whether a hit's lobes may see other objects in their mean direction; else that is free."""
    return world.seen_maps > 0 and world.seen_free[hits.look_i[_SEEN_CELL * RAYS + ray]] == 0


@uncounted(forceinline=True)
def surroundings(world, layout, hits, ray):
    """Return what a hit's lobes see in their mean direction: the share of free directions, then others' light."""
    # A cell, the one below it, and the two to the right of them are read at once.
    like, width = seen_cells_black(layout), 2 * seen_lanes(layout)
    if world.baked_size[2 * hits.i[OBJECT * RAYS + ray] + 1] == 0.0:
        found = _around_nodes(world, hits, ray, width, like)
    else:
        found = corners_apart(world.seen, _seen_corners(hits), ray, (width, cells_of(world) * width), like)
    return pair_mixed(pair_mixed(found, hits.look[_SEEN_X * RAYS + ray]), hits.look[_SEEN_Y * RAYS + ray])


@uncounted()
def _around_nodes(world, hits, ray, width, like):
    """Add up the four cells that a hit on a mesh looks up, of the cube maps next to the nodes around it."""
    shape, found = hits.i[OBJECT * RAYS + ray], zeros_like(like)
    first, places, weights = nodes_around(world, hits, ray, shape)
    # Maps of meshes have no columns, so that this is the cell of the object's first map.
    cell = np.int64(hits.look_i[_SEEN_CELL * RAYS + ray])
    for corner in range(3):
        node = (np.int64(world.seen_nodes[shape]) + world.baked_corners[first + places[corner]]) * LINKS
        for number in range(node, node + LINKS):
            weight = np.float32(weights[corner]) * world.seen_shares[number]
            at = (cell + np.int64(world.seen_links[number]) * cells_of(world)) * width
            found = found + weight * load_like(world.seen, at, found)
    return found


@uncounted(forceinline=True)
def lobe_at(world, layout, hits, ray, tap):
    """Return the blurred light of two levels for one lobe of one hit, in stored form, times the lobe's weight."""
    return at_corners(world.gloss, _corners(hits, tap), ray, pair_black(layout))


@uncounted(forceinline=True)
def of_level(hits, ray, pair):
    """Return blurred light between the two levels of a hit's look-ups."""
    return pair_mixed(pair, hits.look[_MIX * RAYS + ray])


@uncounted(forceinline=True)
def lobe_weight(look, ray, tap):
    """Return the weight of one lobe of one hit, with its Fresnel reflectance unless paths are coloured."""
    return look[(tap * _FIELDS + _WEIGHT) * RAYS + ray]


@uncounted(forceinline=True)
def lobe_incidence(look, ray, tap):
    """Return cosθ_H of one lobe of one hit."""
    return look[(tap * _FIELDS + _COS_H) * RAYS + ray]


@uncounted(forceinline=True)
def find_entries(hits, places):
    """Compute where sixteen hits are looked up in the table of lobes, from their roughness coordinates."""
    x = root(load(hits.f, COSINE * RAYS, 16)) * (ANGLES - 1)
    y = lower_of(upper_of(places, 0.0), ROUGHNESSES - 1)
    column, row = truncated(lower_of(x, ANGLES - 2)), truncated(lower_of(y, ROUGHNESSES - 2))
    place, one = (x - as_float(column), y - as_float(row)), spread(np.float32(1.0), 16)
    keep_corners(_corners(hits, 0), row * ANGLES + column, spread(ANGLES, 16), place, one)


@uncounted(forceinline=True)
def entry_at(world, hits, ray, first):
    """Return the entry of one hit in the table of lobes whose first number has the index ``first``."""
    return at_corners(world.rows[first:], _corners(hits, 0), ray, load(world.rows, 0, ENTRY))
