"""Shading of a packet: contribution of each hit or miss, and continuation of its paths [eq. 5, 8, 9]."""

import math
from typing import NamedTuple

import numpy as np

from irodori.geometry.shapes.mesh_nodes import lattice_place
from irodori.geometry.shapes.shape_rows import BEHIND, CENTRE, CURVATURE, MIRROR, SHAPE, THROUGH, TURN
from irodori.geometry.shapes.surface_nodes import warped_place
from irodori.jit.compilation import uncounted
from irodori.jit.vector_memory import (
    channel_count,
    compress,
    gather,
    lane,
    largest,
    load,
    load_like,
    mask_bits,
    store,
    zeros_like,
)
from irodori.reflection.fresnel import fresnel
from irodori.reflection.lobes import constants_of, features_of, strength, value_of
from irodori.rendering.interactive.cube_maps import MapPlace, bilinear, opposite
from irodori.rendering.interactive.look_ups import (
    decoded,
    find_sky,
    lobe_at,
    lobe_incidence,
    lobe_weight,
    sky_at,
    surroundings,
)
from irodori.rendering.interactive.packets import (
    BARYCENTRIC_B,
    BARYCENTRIC_C,
    CONE,
    COSINE,
    DIRECTION,
    NEXT,
    NORMAL,
    NORMAL_CELL,
    NORMAL_X,
    NORMAL_Y,
    OBJECT,
    ORIGIN,
    POINT,
    RAYS,
    REFLECTED,
    SPREAD,
    STRIDE,
    TEXEL,
    TEXEL_X,
    TEXEL_Y,
    TEXTURE_U,
    TEXTURE_V,
    THROUGHPUT,
    TRIANGLE,
    WIDTH,
    raised,
)
from irodori.rendering.interactive.representation_layout import (
    gloss_components,
    gloss_parts,
    has_sheets,
    is_coloured,
    light_black,
    light_lanes,
    seen_black,
    seen_lanes,
    surface_black,
    surface_lanes,
)
from irodori.rendering.interactive.round_lobes import ANGLES, ENTRY, POWER, ROUGHNESSES, TAPS

#: Numbers per texel for the gloss components from the second on.
FURTHER = 8
#: Numbers per object for the light map of an endless plane, see `irodori.rendering.map_layouts.Layout`.
GRID = 4


class Sums(NamedTuple):
    """Light accumulated in the pixels of a tile; the numbers of pixel ``slot`` begin at ``slot`` times the lanes."""

    colour: np.ndarray  # (PATHS * surface lanes,) float32
    light: np.ndarray  # (PATHS * light lanes,) float32, light in stored form; not used if paths are coloured
    throughput: np.ndarray  # (PATHS * surface lanes,) float32, used if paths are coloured
    texel: np.ndarray  # (surface lanes,) buffer
    gloss: np.ndarray  # (FURTHER,) buffer: power and roughness coordinate of the second component, the third, ...


class Hits(NamedTuple):
    """Buffers of a packet's hits and look-ups, see `packets` and `look_ups` in `irodori.rendering.interactive`."""

    f: np.ndarray
    i: np.ndarray
    entries: np.ndarray  # (components * parts * RAYS * ENTRY,)
    look: np.ndarray
    look_i: np.ndarray
    lit: np.ndarray  # (lamps * RAYS,) cosine of incidence of each lamp, 0 in shadow


@uncounted(forceinline=True)
def shade_sky(job, scratch, base, missed):
    """Add the environment's radiance to the pixels of the rays that missed all objects, given as bits."""
    world, layout, paths, hits, sums = job.world, job.layout, scratch.paths, scratch.hits, scratch.sums
    find_sky(world, job.frame, paths, base, hits)
    for ray in range(RAYS):
        if (missed >> ray) & 1:
            slot = np.int64(paths.slot[base + ray])
            light = sky_at(world, layout, hits, ray)
            if is_coloured(layout):
                _add_coloured(layout, sums, slot, decoded(world, layout, light))
            else:
                at = slot * light_lanes(layout)
                throughput = paths.f[THROUGHPUT * STRIDE + base + ray]
                store(sums.light, at, load_like(sums.light, at, light) + throughput * light)


@uncounted(forceinline=True)
def _add_coloured(layout, sums, slot, colour):
    """Add a colour times the path's coloured throughput to a pixel."""
    at = slot * surface_lanes(layout)
    passed = load_like(sums.throughput, at, colour) * colour
    store(sums.colour, at, load_like(sums.colour, at, colour) + passed)


@uncounted(forceinline=True)
def _add_colour(layout, scratch, path, colour):
    """Add a colour times the path's throughput to the path's pixel."""
    paths, sums = scratch.paths, scratch.sums
    slot = np.int64(paths.slot[path])
    if is_coloured(layout):
        _add_coloured(layout, sums, slot, colour)
    else:
        at = slot * surface_lanes(layout)
        throughput = paths.f[THROUGHPUT * STRIDE + path]
        store(sums.colour, at, load_like(sums.colour, at, colour) + throughput * colour)


@uncounted(forceinline=True)
def _component(layout, sums, component):
    """Return power and roughness coordinate of a gloss component of the current texel."""
    if component > 0:
        return sums.gloss[2 * component - 2], sums.gloss[2 * component - 1]
    width = surface_lanes(layout)
    return sums.texel[width - 2], sums.texel[width - 1]


@uncounted(forceinline=True)
def _lobe_entry(job, hits, ray, component, power, place):
    """Fill the table entries of a hit's lobe, interpolated over angle and roughness coordinate, and its power."""
    world, layout = job.world, job.layout
    cosine, parts = hits.f[COSINE * RAYS + ray], gloss_parts(layout)
    x, y = math.sqrt(cosine) * np.float32(ANGLES - 1), min(max(place, np.float32(0.0)), np.float32(ROUGHNESSES - 1))
    column, row = min(int(x), ANGLES - 2), min(int(y), ROUGHNESSES - 2)
    which = world.lobe[hits.i[OBJECT * RAYS + ray] * gloss_components(layout) + component]
    for part in range(parts):
        first, at = (which * parts + part) * (ROUGHNESSES * ANGLES * ENTRY), (component * parts + part) * RAYS + ray
        like = load(world.rows, 0, ENTRY)
        entry = bilinear(world.rows, first, ANGLES, MapPlace(row * ANGLES + column, x - column, y - row), like)
        store(hits.entries, at * ENTRY, entry)
        hits.entries[at * ENTRY + POWER] = power


@uncounted(forceinline=True)
def _baked_light(world, hits, ray, shape, like):
    """Return the baked light at a hit, interpolated in its object's light map."""
    columns, rows = world.baked_size[2 * shape], world.baked_size[2 * shape + 1]
    if rows == 0.0:
        return _light_of_nodes(world, hits, ray, shape, like)
    half, (u, v) = np.float32(0.5), _place_on_map(world, hits, ray, shape)
    x = min(max(u * columns + half, np.float32(0.0)), columns + half)
    y = min(max(v * rows + half, np.float32(0.0)), rows + half)
    column, row, stride = np.int64(x), np.int64(y), np.int64(columns) + 2
    place = MapPlace(row * stride + column, x - np.float32(column), y - np.float32(row))
    return bilinear(world.baked, world.baked_first[shape], stride, place, like)


@uncounted(forceinline=True)
def _place_on_map(world, hits, ray, shape):
    """Return the coordinates, 0..1, of a hit in the light map of its shape, which is not a mesh."""
    if world.baked_grid[GRID * shape + 2] > 0.0:
        return _place_on_plane(world, hits, ray, shape)
    return hits.f[TEXTURE_U * RAYS + ray], hits.f[TEXTURE_V * RAYS + ray]


@uncounted()
def _place_on_plane(world, hits, ray, shape):
    """Return the coordinates, 0..1, of a hit in the light map of an endless plane."""
    hit, row, at, grid = hits.f, world.shape, shape * SHAPE, GRID * shape
    x = hit[POINT * RAYS + ray] - row[at + CENTRE]
    y = hit[(POINT + 1) * RAYS + ray] - row[at + CENTRE + 1]
    z = hit[(POINT + 2) * RAYS + ray] - row[at + CENTRE + 2]
    across = x * row[at + TURN] + y * row[at + TURN + 3] + z * row[at + TURN + 6]
    along = x * row[at + TURN + 1] + y * row[at + TURN + 4] + z * row[at + TURN + 7]
    u = warped_place((across - world.baked_grid[grid]) / world.baked_grid[grid + 2])
    v = warped_place((along - world.baked_grid[grid + 1]) / world.baked_grid[grid + 3])
    return np.float32(0.5 + 0.5 * u), np.float32(0.5 + 0.5 * v)


@uncounted()
def _light_of_nodes(world, hits, ray, shape, like):
    """Return the baked light at a hit on a mesh, interpolated between nodes on its triangle."""
    triangle = world.first_face[shape] + hits.i[TRIANGLE * RAYS + ray]
    b, c = np.float64(hits.f[BARYCENTRIC_B * RAYS + ray]), np.float64(hits.f[BARYCENTRIC_C * RAYS + ray])
    places, weights = lattice_place(np.int64(world.baked_parts[triangle]), b, c)
    first, light, width = world.baked_corner[triangle], zeros_like(like), channel_count(like)
    for corner in range(3):
        at = world.baked_first[shape] + np.int64(world.baked_corners[first + places[corner]]) * width
        light = light + np.float32(weights[corner]) * load_like(world.baked, at, like)
    return light


@uncounted()
def _passed_light(job, hits, ray, shape, like):
    """Return the light that a hit's sheet lets through from its other side, as a colour."""
    world, frame, through = job.world, job.frame, job.world.shape[shape * SHAPE + THROUGH]
    light = zeros_like(like)
    if through < 0.0:
        return light
    if world.baked_maps > 0:
        light = _baked_light(world, hits, ray, np.int64(world.shape[shape * SHAPE + BEHIND]), like)
    elif world.irradiance_side > 0:
        x, y, side = hits.f[NORMAL_X * RAYS + ray], hits.f[NORMAL_Y * RAYS + ray], world.irradiance_side
        place = opposite(MapPlace(np.int64(hits.i[NORMAL_CELL * RAYS + ray]), x, y), side)
        light = bilinear(world.irradiance, 0, side + 2, place, like)
    for lamp in range(frame.lamps):
        cosine = hits.lit[lamp * RAYS + ray]
        if cosine < 0.0:
            at = lamp * channel_count(like)
            light = light - (frame.lamp_strength[lamp] * cosine) * load_like(world.lamp_light, at, like)
    x, y = hits.f[TEXEL_X * RAYS + ray], hits.f[TEXEL_Y * RAYS + ray]
    at, row = MapPlace(np.int64(hits.i[TEXEL * RAYS + ray]), x, y), np.int64(through)
    return light * bilinear(world.texels, world.texture_first[row], world.texture_stride[row], at, like)


@uncounted(forceinline=True)
def shade_surfaces(job, scratch, base, seen):
    """Add diffuse light and lamps' highlights of the hits given as bits; return the bits of glossy hits.

    The lowest sixteen bits of the result are those of the first gloss component, the next those of the second. The
    table entries of their lobes are filled.
    """
    world, frame, layout = job.world, job.frame, job.layout
    paths, hits, sums = scratch.paths, scratch.hits, scratch.sums
    glossy = 0
    width = surface_lanes(layout)
    for ray in range(RAYS):
        if not (seen >> ray) & 1:
            continue
        shape, black = hits.i[OBJECT * RAYS + ray], surface_black(layout)
        x, y = hits.f[TEXEL_X * RAYS + ray], hits.f[TEXEL_Y * RAYS + ray]
        at, stride = MapPlace(np.int64(hits.i[TEXEL * RAYS + ray]), x, y), world.texture_stride[shape]
        texel = bilinear(world.texels, world.texture_first[shape], stride, at, black)
        store(sums.texel, 0, texel)
        x, y = hits.f[NORMAL_X * RAYS + ray], hits.f[NORMAL_Y * RAYS + ray]
        normal = MapPlace(np.int64(hits.i[NORMAL_CELL * RAYS + ray]), x, y)
        light = zeros_like(texel)
        if world.baked_maps > 0:
            light = _baked_light(world, hits, ray, shape, texel)
        elif world.irradiance_side > 0:
            light = bilinear(world.irradiance, 0, world.irradiance_side + 2, normal, texel)
        if gloss_components(layout) > 1:
            like = load(world.further, 0, FURTHER)
            store(sums.gloss, 0, bilinear(world.further, world.further_first[shape], stride, at, like))
        for lamp in range(frame.lamps):
            cosine = hits.lit[lamp * RAYS + ray]
            if cosine > 0.0:
                light = light + (frame.lamp_strength[lamp] * cosine) * load_like(world.lamp_light, lamp * width, texel)
                for component in range(gloss_components(layout)):
                    if _component(layout, sums, component)[0] > 0.0:
                        _add_highlight(job, scratch, base, ray, lamp, component)
        _add_colour(layout, scratch, base + ray, texel * light)
        if has_sheets(layout):
            _add_colour(layout, scratch, base + ray, _passed_light(job, hits, ray, shape, texel))
        for component in range(gloss_components(layout)):
            power, place = _component(layout, sums, component)
            if power * paths.f[THROUGHPUT * STRIDE + base + ray] > job.limits.least_lobe:
                glossy |= 1 << (component * RAYS + ray)
                _lobe_entry(job, hits, ray, component, power, place)
    return glossy


@uncounted()
def _add_highlight(job, scratch, base, ray, lamp, component):
    """Add a lamp's highlight in one gloss component, β F D G / cosθ_r, to a pixel."""
    world, frame, layout = job.world, job.frame, job.layout
    paths, hits, sums = scratch.paths, scratch.hits, scratch.sums
    width = surface_lanes(layout)
    power, place = _component(layout, sums, component)
    which = np.int64(world.lobe[hits.i[OBJECT * RAYS + ray] * gloss_components(layout) + component])
    t = np.float64(place) * world.ladder[2 * which + 1] + world.ladder[2 * which]
    along = h2 = cos_nh = 0.0
    for axis in range(3):
        to_light = np.float64(frame.lamp_direction[3 * lamp + axis])
        to_eye = -np.float64(paths.f[(DIRECTION + axis) * STRIDE + base + ray])
        along += to_light * to_eye
        half = to_light + to_eye
        h2 += half * half
        cos_nh += half * hits.f[(NORMAL + axis) * RAYS + ray]
    if h2 < 1e-12:
        return
    cos_nh, cos_h = cos_nh / math.sqrt(h2), math.sqrt(max(0.5 * (1.0 + along), 0.0))
    cos_i, cos_r = np.float64(hits.lit[lamp * RAYS + ray]), np.float64(hits.f[COSINE * RAYS + ray])
    phi = math.acos(min(max(cos_nh, -1.0), 1.0))
    factor, f0, f1, f2 = features_of(world.lobes, which, cos_i, cos_r, cos_nh, cos_h, phi)
    value = factor * value_of(world.lobes, which, constants_of(world.lobes, which, t), f0, f1, f2)
    value *= 4.0 * power / strength(world.lobes, which, math.exp(t)) * frame.lamp_strength[lamp]
    index = hits.i[OBJECT * RAYS + ray] * 2 * width
    colour = load_like(world.lamp_colour, lamp * width, surface_black(layout))
    n, k = load_like(world.index, index, colour), load_like(world.index, index + width, colour)
    colour = value * colour * fresnel(zeros_like(colour) + cos_h, n, k)
    _add_colour(layout, scratch, base + ray, colour)


@uncounted(forceinline=True)
def shade_gloss(job, scratch, base, glossy):
    """Add the blurred light of the glossy hits' lobes; lobes with a weight below the limit are skipped."""
    world, layout, paths, hits, sums = job.world, job.layout, scratch.paths, scratch.hits, scratch.sums
    width = surface_lanes(layout)
    for ray in range(RAYS):
        if not (glossy >> ray) & 1:
            continue
        slot, throughput = np.int64(paths.slot[base + ray]), paths.f[THROUGHPUT * STRIDE + base + ray]
        light, colour = light_black(layout), surface_black(layout)
        shape, free, around = hits.i[OBJECT * RAYS + ray], np.float32(1.0), seen_black(layout)
        has_seen = world.seen_maps > 0 and world.seen_size[2 * shape] > 0.0
        if has_seen:
            around = surroundings(world, layout, hits, ray, _place_on_map(world, hits, ray, shape))
            free = lane(around, 0)
        whole, power = colour, np.float32(0.0)  # of the lobes
        for tap in range(TAPS):
            weight, passed = lobe_weight(hits.look, ray, tap), colour
            if is_coloured(layout):
                index = np.int64(hits.i[OBJECT * RAYS + ray]) * 2 * width
                n, k = load_like(world.index, index, colour), load_like(world.index, index + width, colour)
                passed = weight * fresnel(zeros_like(colour) + lobe_incidence(hits.look, ray, tap), n, k)
                weight = largest(passed)
                if has_seen:
                    whole = whole + passed
            power += weight
            if free * weight * throughput <= job.limits.least_lobe:
                continue
            found = lobe_at(world, layout, hits, ray, tap)
            if is_coloured(layout):
                colour = colour + passed * decoded(world, layout, found)
            else:
                light = light + weight * found
        if has_seen:
            others = surface_black(layout)
            for number in range(1, seen_lanes(layout)):
                others = others + lane(around, number) * load_like(world.seen_decode, (number - 1) * width, others)
            if is_coloured(layout):
                colour = free * colour + whole * others
            else:
                light = free * light
                _add_colour(layout, scratch, base + ray, power * others)
        if is_coloured(layout):
            _add_coloured(layout, sums, slot, colour)
        else:
            at = slot * light_lanes(layout)
            store(sums.light, at, load_like(sums.light, at, light) + throughput * light)


@uncounted(forceinline=True)
def reflect_packet(job, scratch, base, seen):
    """Compute the throughput of the hits' paths after the mirror reflection."""
    world, layout, paths, hits, sums = job.world, job.layout, scratch.paths, scratch.hits, scratch.sums
    width = surface_lanes(layout)
    shape = load(hits.i, OBJECT * RAYS, 16)
    mirror = gather(world.shape, shape * SHAPE + MIRROR)
    if not is_coloured(layout):
        n, k = gather(world.index, shape * (2 * width)), gather(world.index, shape * (2 * width) + width)
        factor = mirror * fresnel(load(hits.f, COSINE * RAYS, 16), n, k)
        store(hits.f, NEXT * RAYS, factor * load(paths.f, THROUGHPUT * STRIDE + base, 16))
        return
    for ray in range(RAYS):
        if (seen >> ray) & 1:
            index = np.int64(hits.i[OBJECT * RAYS + ray])
            at = np.int64(paths.slot[base + ray]) * width
            passed = load_like(sums.throughput, at, surface_black(layout))
            n = load_like(world.index, index * 2 * width, passed)
            k = load_like(world.index, index * 2 * width + width, passed)
            cosine = zeros_like(passed) + hits.f[COSINE * RAYS + ray]
            passed = passed * (world.shape[index * SHAPE + MIRROR] * fresnel(cosine, n, k))
            store(sums.throughput, at, passed)
            hits.f[NEXT * RAYS + ray] = largest(passed)
        else:
            hits.f[NEXT * RAYS + ray] = 0.0


@uncounted(forceinline=True)
def advance(job, scratch, base, seen, after):
    """Write the continuing paths contiguously from index ``after`` on; return the index after the last."""
    world, paths, hits = job.world, scratch.paths, scratch.hits
    throughput = load(hits.f, NEXT * RAYS, 16)
    going = seen & (throughput > job.limits.least_throughput)
    count = bits_set(mask_bits(going))
    if count == 0:
        return after
    shape = load(hits.i, OBJECT * RAYS, 16)
    x, y, z = raised(hits.f, 0, 1.0), raised(hits.f, 1, 1.0), raised(hits.f, 2, 1.0)
    width = load(hits.f, WIDTH * RAYS, 16)
    spread = load(paths.f, SPREAD * STRIDE + base, 16) + width * gather(world.shape, shape * SHAPE + CURVATURE)
    slot = load(paths.slot, base, 16)
    compress(paths.f, ORIGIN * STRIDE + after, going, x)
    compress(paths.f, (ORIGIN + 1) * STRIDE + after, going, y)
    compress(paths.f, (ORIGIN + 2) * STRIDE + after, going, z)
    for axis in range(3):
        compress(paths.f, (DIRECTION + axis) * STRIDE + after, going, load(hits.f, (REFLECTED + axis) * RAYS, 16))
    compress(paths.f, THROUGHPUT * STRIDE + after, going, throughput)
    compress(paths.f, CONE * STRIDE + after, going, width)
    compress(paths.f, SPREAD * STRIDE + after, going, spread)
    compress(paths.slot, after, going, slot)
    return after + count


@uncounted(forceinline=True)
def bits_set(mask):
    """Return the number of set bits in a mask of sixteen."""
    mask = mask - ((mask >> 1) & 0x5555)
    mask = (mask & 0x3333) + ((mask >> 2) & 0x3333)
    mask = (mask + (mask >> 4)) & 0x0F0F
    return (mask + (mask >> 8)) & 0x1F
