"""Shading of a packet: contribution of each hit or miss, and continuation of its paths [eq. 5, 8, 9]."""

import math
from typing import NamedTuple

import numpy as np

from irodori.geometry.shapes.shape_rows import BEHIND, CURVATURE, MIRROR, SHAPE, THROUGH
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
    numbered,
    store,
    zeros_like,
)
from irodori.reflection import coat
from irodori.reflection.fresnel import fresnel
from irodori.reflection.lobes import constants_of, features_of, strength, value_of
from irodori.rendering.interactive.cube_maps import (
    at_corners,
    mix_corners,
    opposite_texel,
    prefetch_corners,
    texels_kept,
)
from irodori.rendering.interactive.look_ups import (
    decoded,
    entry_at,
    find_entries,
    lobe_at,
    lobe_incidence,
    lobe_weight,
    of_level,
    sees_objects,
    sky_at,
    surroundings,
)
from irodori.rendering.interactive.packets import (
    CONE,
    COSINE,
    DIRECTION,
    NEXT,
    NORMAL,
    OBJECT,
    ORIGIN,
    RAYS,
    REFLECTED,
    SPREAD,
    STRIDE,
    THROUGHPUT,
    WIDTH,
    light_corners,
    nodes_around,
    of_shapes,
    raised,
    texture_corners,
)
from irodori.rendering.interactive.representation_layout import (
    gloss_components,
    gloss_parts,
    has_coats,
    has_sheets,
    is_coloured,
    light_lanes,
    pair_black,
    seen_lanes,
    surface_black,
    surface_lanes,
)
from irodori.rendering.interactive.round_lobes import ANGLES, ENTRY, POWER, ROUGHNESSES, TAPS

#: Numbers per texel for the gloss components from the second on.
FURTHER = 8
#: Place of a hit's roughness coordinate in the entry of its lobe's first row, until that is filled.
_PLACE = POWER + 1


class Sums(NamedTuple):
    """Light accumulated in the pixels of a tile; the numbers of pixel ``slot`` begin at ``slot`` times the lanes."""

    colour: np.ndarray  # (PATHS * surface lanes,) float32
    light: np.ndarray  # (PATHS * light lanes,) float32, light in stored form; not used if paths are coloured
    throughput: np.ndarray  # (PATHS * surface lanes,) float32, used if paths are coloured
    texel: np.ndarray  # (surface lanes,) buffer
    gloss: np.ndarray  # (FURTHER,) buffer: power and roughness coordinate of the second component, the third, ...


class Sky(NamedTuple):
    """Buffers of a packet's look-ups of the sky, see `irodori.rendering.interactive.look_ups`."""

    f: np.ndarray
    i: np.ndarray


class Hits(NamedTuple):
    """Buffers of a packet's hits and look-ups, see `packets` and `look_ups` in `irodori.rendering.interactive`."""

    f: np.ndarray
    i: np.ndarray
    entries: np.ndarray  # (components * parts * RAYS * ENTRY,)
    look: np.ndarray
    look_i: np.ndarray
    lit: np.ndarray  # (lamps * RAYS,) cosine of incidence of each lamp, 0 in shadow


@uncounted(forceinline=True)
def shade_sky(job, scratch, missed, blends):
    """Add the environment's radiance to the pixels of the rays that missed all objects, given as bits.

    ``blends`` is the result of `irodori.rendering.interactive.look_ups.find_sky`.
    """
    world, layout, sums = job.world, job.layout, scratch.sums
    for ray in range(RAYS):
        if (missed >> ray) & 1:
            slot, light = sky_at(world, layout, scratch.sky, ray, blends)
            if is_coloured(layout):
                _add_coloured(layout, sums, slot, decoded(world, layout, light))
            else:
                at = slot * light_lanes(layout)
                store(sums.light, at, load_like(sums.light, at, light) + light)


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
def _fill_entries(job, scratch, base, seen):
    """Fill the table entries of the lobes of the hits given as bits, and their powers; return the bits of glossy hits.

    The entries are interpolated over angle and roughness coordinate. The bits are those of `shade_surfaces`.
    """
    world, layout, hits, parts, glossy = job.world, job.layout, scratch.hits, gloss_parts(job.layout), 0
    for component in range(gloss_components(layout)):
        first = component * parts * RAYS
        entries = hits.entries[first * ENTRY :]
        power, place = gather(entries, numbered(16) * ENTRY + POWER), gather(entries, numbered(16) * ENTRY + _PLACE)
        throughput = load(scratch.paths.f, THROUGHPUT * STRIDE + base, 16)
        bits = mask_bits(power * throughput > job.limits.least_lobe) & seen
        if not bits:
            continue
        glossy |= bits << (component * RAYS)
        find_entries(hits, place)
        for ray in range(RAYS):
            if not (bits >> ray) & 1:
                continue
            which = world.lobe[hits.i[OBJECT * RAYS + ray] * gloss_components(layout) + component]
            own = entries[ray * ENTRY + POWER]
            for part in range(parts):
                at = (part * RAYS + ray) * ENTRY
                number = (which * parts + part) * (ROUGHNESSES * ANGLES * ENTRY)
                store(entries, at, entry_at(world, hits, ray, number))
                entries[at + POWER] = own
    return glossy


@uncounted(forceinline=True)
def _baked_light(world, hits, ray, shape, like):
    """Return the baked light at a hit, interpolated in its object's light map."""
    if world.baked_size[2 * shape + 1] == 0.0:
        return _light_of_nodes(world, hits, ray, shape, like)
    return at_corners(world.baked, light_corners(hits), ray, like)


@uncounted()
def _light_of_nodes(world, hits, ray, shape, like):
    """Return the baked light at a hit on a mesh, interpolated between nodes on its triangle."""
    first, places, weights = nodes_around(world, hits, ray, shape)
    light, width = zeros_like(like), channel_count(like)
    for corner in range(3):
        at = (np.int64(world.baked_first[shape]) + world.baked_corners[first + places[corner]]) * width
        light = light + np.float32(weights[corner]) * load_like(world.baked, at, like)
    return light


@uncounted()
def _passed_light(job, hits, ray, shape, like):
    """Return the light that a hit's sheet lets through from its other side, as a colour."""
    world, frame, through = job.world, job.frame, job.world.shape[shape * SHAPE + THROUGH]
    light = zeros_like(like)
    if through < 0.0:
        return light
    width, corners = channel_count(like), light_corners(hits)
    upper, lower, weights = texels_kept(corners, ray)
    if world.baked_maps > 0:
        behind = np.int64(world.shape[shape * SHAPE + BEHIND])
        if world.baked_size[2 * shape + 1] == 0.0:
            light = _light_of_nodes(world, hits, ray, behind, like)
        else:
            further = np.int64(world.baked_first[behind]) - world.baked_first[shape]
            places = (upper + further) * width, (lower + further) * width, width
            light = mix_corners(world.baked, places, weights, like)
    elif world.irradiance_side > 0:
        upper, lower = (
            opposite_texel(upper, world.irradiance_side) * width,
            opposite_texel(lower, world.irradiance_side) * width,
        )
        light = mix_corners(world.irradiance, (upper, lower, -width), weights, like)
    for lamp in range(frame.lamps):
        cosine = hits.lit[lamp * RAYS + ray]
        if cosine < 0.0:
            at = lamp * channel_count(like)
            light = light - (frame.lamp_strength[lamp] * cosine) * load_like(world.lamp_light, at, like)
    upper, lower, weights = texels_kept(texture_corners(hits), ray)
    further = np.int64(world.texture_first[np.int64(through)]) - world.texture_first[shape]
    places = (upper + further) * width, (lower + further) * width, width
    return light * mix_corners(world.texels, places, weights, like)


@uncounted(forceinline=True)
def _through_coat(job, hits, ray, cosine):
    """Return the share of light that passes the coat of a hit's object at an angle; 1 without a coat."""
    shape = hits.i[OBJECT * RAYS + ray]
    n = job.world.coat[2 * shape]
    return np.float32(coat.passed(cosine, n, job.world.coat[2 * shape + 1])) if n > 0.0 else np.float32(1.0)


@uncounted(forceinline=True)
def shade_surfaces(job, scratch, base, seen):
    """Add diffuse light and lamps' highlights of the hits given as bits; return the bits of glossy hits.

    The lowest sixteen bits of the result are those of the first gloss component, the next those of the second. The
    table entries of their lobes are filled.
    """
    world, frame, layout = job.world, job.frame, job.layout
    hits, sums = scratch.hits, scratch.sums
    width, corners = surface_lanes(layout), texture_corners(hits)
    for ray in range(RAYS):
        if (seen >> ray) & 1:
            prefetch_corners(world.texels, corners, ray, width)
            if world.baked_maps > 0:
                prefetch_corners(world.baked, light_corners(hits), ray, width)
            elif world.irradiance_side > 0:
                prefetch_corners(world.irradiance, light_corners(hits), ray, width)
    for ray in range(RAYS):
        if not (seen >> ray) & 1:
            continue
        texel = at_corners(world.texels, corners, ray, surface_black(layout))
        store(sums.texel, 0, texel)
        light = zeros_like(texel)
        if world.baked_maps > 0:
            light = _baked_light(world, hits, ray, hits.i[OBJECT * RAYS + ray], texel)
        elif world.irradiance_side > 0:
            light = at_corners(world.irradiance, light_corners(hits), ray, texel)
        if gloss_components(layout) > 1:
            like = load(world.further, 0, FURTHER)
            store(sums.gloss, 0, at_corners(world.further, corners, ray, like))
        for lamp in range(frame.lamps):
            cosine = hits.lit[lamp * RAYS + ray]
            if cosine > 0.0:
                level = frame.lamp_strength[lamp] * cosine
                if has_coats(layout):
                    level = level * _through_coat(job, hits, ray, cosine)
                light = light + level * load_like(world.lamp_light, lamp * width, texel)
                for component in range(gloss_components(layout)):
                    if _component(layout, sums, component)[0] > 0.0:
                        _add_highlight(job, scratch, base, ray, lamp, component)
        if has_coats(layout):
            light = _through_coat(job, hits, ray, hits.f[COSINE * RAYS + ray]) * light
        _add_colour(layout, scratch, base + ray, texel * light)
        if has_sheets(layout):
            _add_colour(layout, scratch, base + ray, _passed_light(job, hits, ray, hits.i[OBJECT * RAYS + ray], texel))
        for component in range(gloss_components(layout)):
            at = (component * gloss_parts(layout) * RAYS + ray) * ENTRY
            hits.entries[at + POWER], hits.entries[at + _PLACE] = _component(layout, sums, component)
    return _fill_entries(job, scratch, base, seen)


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
def _others(world, layout, around, like):
    """Return the light of other objects, from what `surroundings` found, as a colour or as stored light."""
    width, others = channel_count(like), zeros_like(like)
    for number in range(1, seen_lanes(layout)):
        others = others + lane(around, number) * load_like(world.seen_decode, (number - 1) * width, others)
    return others


@uncounted(forceinline=True)
def shade_gloss(job, scratch, base, glossy):
    """Add the blurred light of the glossy hits' lobes."""
    world, layout, paths, hits, sums = job.world, job.layout, scratch.paths, scratch.hits, scratch.sums
    width = surface_lanes(layout)
    for ray in range(RAYS):
        if not (glossy >> ray) & 1:
            continue
        colour, whole, pair = surface_black(layout), surface_black(layout), pair_black(layout)
        power = np.float32(0.0)  # of the lobes
        for tap in range(TAPS):
            found = lobe_at(world, layout, hits, ray, tap)
            if is_coloured(layout):
                index = np.int64(hits.i[OBJECT * RAYS + ray]) * 2 * width
                n, k = load_like(world.index, index, colour), load_like(world.index, index + width, colour)
                passed = fresnel(zeros_like(colour) + lobe_incidence(hits.look, ray, tap), n, k)
                colour = colour + passed * decoded(world, layout, of_level(hits, ray, found))
                whole = whole + lobe_weight(hits.look, ray, tap) * passed
            else:
                pair = pair + found
                power += lobe_weight(hits.look, ray, tap)
        light = of_level(hits, ray, pair)
        slot, throughput = np.int64(paths.slot[base + ray]), paths.f[THROUGHPUT * STRIDE + base + ray]
        if sees_objects(world, hits, ray):
            around = surroundings(world, layout, hits, ray)
            free = lane(around, 0)
            if is_coloured(layout):
                colour = free * colour + whole * _others(world, layout, around, colour)
            else:
                light = free * light + power * _others(world, layout, around, light)
        if is_coloured(layout):
            _add_coloured(layout, sums, slot, colour)
        else:
            at = slot * light_lanes(layout)
            store(sums.light, at, load_like(sums.light, at, light) + throughput * light)


@uncounted(forceinline=True)
def reflect_packet(job, scratch, base, seen, placed):
    """Compute the throughput of the hits' paths after the mirror reflection."""
    world, layout, paths, hits, sums = job.world, job.layout, scratch.paths, scratch.hits, scratch.sums
    width = surface_lanes(layout)
    mirror = of_shapes(world.shape, SHAPE, MIRROR, placed)
    if not is_coloured(layout):
        n, k = of_shapes(world.index, 2 * width, 0, placed), of_shapes(world.index, 2 * width, width, placed)
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
def advance(job, scratch, base, seen, after, placed):
    """Write the continuing paths contiguously from index ``after`` on; return the index after the last."""
    world, paths, hits = job.world, scratch.paths, scratch.hits
    throughput = load(hits.f, NEXT * RAYS, 16)
    going = seen & (throughput > job.limits.least_throughput)
    count = bits_set(mask_bits(going))
    if count == 0:
        return after
    x, y, z = raised(hits.f, 0, 1.0), raised(hits.f, 1, 1.0), raised(hits.f, 2, 1.0)
    width = load(hits.f, WIDTH * RAYS, 16)
    spread = load(paths.f, SPREAD * STRIDE + base, 16) + width * of_shapes(world.shape, SHAPE, CURVATURE, placed)
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
