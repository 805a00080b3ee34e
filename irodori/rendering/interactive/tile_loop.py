"""Loop over the tiles of a picture: trace packets of rays through mirrors, shade hits and accumulate light."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.jit.compilation import njit, uncounted
from irodori.jit.functions import as_float, root, select
from irodori.jit.references import address_of, at_address
from irodori.jit.vector_memory import (
    compress,
    lane,
    load,
    load_like,
    mask_bits,
    numbered,
    spread,
    store,
)
from irodori.rendering.interactive.hard_shadows import light_hits
from irodori.rendering.interactive.look_ups import (
    LOOK_FIELDS,
    LOOK_NUMBERS,
    SKY_FIELDS,
    SKY_NUMBERS,
    find_lobes,
    find_sky,
)
from irodori.rendering.interactive.packets import (
    CONE,
    DIRECTION,
    HIT_FIELDS,
    HIT_NUMBERS,
    KEPT,
    ORIGIN,
    PACKET_DOUBLES,
    PACKET_SINGLES,
    PATH_FIELDS,
    PATHS,
    RAYS,
    SPREAD,
    STRIDE,
    THROUGHPUT,
    TILE,
    Packet,
    TilePaths,
    active_lanes,
    are_meshes,
    distances,
    keep_packet,
    meet_by_formula,
    packet_in,
    place_hits,
    prepare_hits,
    recall_packet,
    shapes_met,
    trace_packet,
)
from irodori.rendering.interactive.representation_layout import (
    Layout,
    gloss_components,
    gloss_parts,
    is_coloured,
    light_black,
    light_lanes,
    surface_black,
    surface_lanes,
)
from irodori.rendering.interactive.round_lobes import ENTRY
from irodori.rendering.interactive.shading import (
    FURTHER,
    Hits,
    Sky,
    Sums,
    advance,
    bits_set,
    reflect_packet,
    shade_gloss,
    shade_sky,
    shade_surfaces,
)
from irodori.rendering.interactive.smooth_outlines import (
    MET,
    SIDE,
    Met,
    note_block,
    note_pixel,
    note_row,
    outline_bits,
    shaded_rays,
)

if TYPE_CHECKING:  # keeps their other imports out of the kernel's import closure
    from irodori.rendering.interactive.prepared_scene import FrameView, PreparedWorld

#: Values of `PathLimits.visibility`: trace all rays, trace and store hits, recall the stored hits of an earlier frame.
TRACED, STORED, RECALLED = 0, 1, 2
#: Numbers that are counted: rays, hits, hits with gloss, and misses.
COUNTED = ("rays", "hits", "glossy", "misses")
_RAYS, _HITS, _GLOSSY, _MISSES = range(4)
FIGURES = len(COUNTED)


#: Numbers of a listed ray: origin, mm; direction; width of its cone, mm, and growth of the width per distance.
LISTED = 8


class PathLimits(NamedTuple):
    """Limits at which paths end, and the treatment of hits between frames."""

    max_bounces: int
    least_throughput: float  # least throughput of a path that continues
    least_lobe: float  # least weight times throughput of a lobe that is looked up
    visibility: int  # see `TRACED`
    kept_bounces: int  # number of bounces whose hits are kept, including the rays from the eye
    outlines: int  # 1 if pixels at outlines have more rays, see `irodori.rendering.interactive.smooth_outlines`; else 0


class Job(NamedTuple):
    """Input of the kernel for one frame: scene, view, layout and limits."""

    world: "PreparedWorld"
    frame: "FrameView"
    layout: Layout
    limits: PathLimits


class FrameBuffers(NamedTuple):
    """Flat arrays that the kernel fills for one frame."""

    image: np.ndarray  # (height * width * channels,) float32
    channels: int
    kept: np.ndarray  # (tiles * packets * KEPT,) float32 hits, empty if none are kept
    figures: np.ndarray  # (tiles * FIGURES,) int64 counters; counts of several tiles may all be added at the first one


class Scratch(NamedTuple):
    """Buffers of one thread."""

    packet: Packet
    paths: TilePaths
    hits: Hits
    sky: Sky
    sums: Sums
    figures: np.ndarray  # (FIGURES,) int64, counters of the thread
    met: Met
    outlines: np.ndarray  # (PATHS,) int32, pixels of the tile that are at outlines, see `_list_outlines`
    pixels: np.ndarray  # (PATHS,) int32, column and row, in the tile, of the pixel of each additional path
    shares: np.ndarray  # (PATHS + RAYS,) for how much of its pixel each additional path counts


@uncounted()
def _singles(layout, lamps):
    """Return the number of float32 in a thread's buffers."""
    entries = gloss_components(layout) * gloss_parts(layout) * ENTRY
    fixed = PACKET_SINGLES + (PATH_FIELDS + 1) * STRIDE + (HIT_FIELDS + HIT_NUMBERS + entries + LOOK_FIELDS) * RAYS
    lanes = (2 * PATHS + 1) * surface_lanes(layout) + PATHS * light_lanes(layout)
    looks = (LOOK_NUMBERS + SKY_FIELDS + SKY_NUMBERS + max(lamps, 1)) * RAYS
    return fixed + looks + lanes + FURTHER + 2 * MET + 3 * PATHS + RAYS


@uncounted()
def scratch_in(job, singles, doubles, figures):
    """Return one thread's buffers in zeroed memory, aligned to a cache line."""
    layout, lamps, packet = job.layout, job.frame.lamps, packet_in(singles, doubles)
    at = singles[PACKET_SINGLES:]
    paths = TilePaths(at, at[PATH_FIELDS * STRIDE :].view(np.int32))
    at = at[(PATH_FIELDS + 1) * STRIDE :]
    look = at[(HIT_FIELDS + HIT_NUMBERS + gloss_components(layout) * gloss_parts(layout) * ENTRY) * RAYS :]
    hits = Hits(
        at,
        at[HIT_FIELDS * RAYS :].view(np.int32),
        at[(HIT_FIELDS + HIT_NUMBERS) * RAYS :],
        look,
        look[LOOK_FIELDS * RAYS :].view(np.int32),
        look[(LOOK_FIELDS + LOOK_NUMBERS) * RAYS :],
    )
    at = look[(LOOK_FIELDS + LOOK_NUMBERS + max(lamps, 1)) * RAYS :]
    sky = Sky(at, at[SKY_FIELDS * RAYS :].view(np.int32))
    at = at[(SKY_FIELDS + SKY_NUMBERS) * RAYS :]
    colour, light = PATHS * surface_lanes(layout), PATHS * light_lanes(layout)
    texel = at[2 * colour + light :]
    gloss = texel[surface_lanes(layout) :]
    sums = Sums(at, at[colour:], at[colour + light :], texel, gloss)
    at = gloss[FURTHER:]
    met = Met(at.view(np.int32), at[MET:])
    at = at[2 * MET :]
    outlines, pixels = at.view(np.int32), at[PATHS:].view(np.int32)
    return Scratch(packet, paths, hits, sky, sums, figures, met, outlines, pixels, at[2 * PATHS :])


@uncounted(forceinline=True)
def _start_packet(frame, paths, count, inside, place, part):
    """Start paths through points of the picture, given in pixels from its middle, for the rays of the mask ``inside``.

    They are written from index ``count`` on, with the cone of a part of a pixel.
    """
    px, py = place
    # One of the two is 0: either the directions or the origins differ between pixels.
    a, b = float(1 - frame.parallel), float(frame.parallel)
    scale = 1.0 / root(a * (px * px + py * py) + 1.0)
    turn = frame.world_from_camera
    for axis in range(3):
        across = turn[3 * axis] * px + turn[3 * axis + 1] * py
        along = (a * across + turn[3 * axis + 2]) * scale
        compress(paths.f, (DIRECTION + axis) * STRIDE + count, inside, along)
        compress(paths.f, (ORIGIN + axis) * STRIDE + count, inside, b * across + frame.position_mm[axis])
    store(paths.f, THROUGHPUT * STRIDE + count, spread(np.float32(1.0), 16))
    store(paths.f, CONE * STRIDE + count, spread(np.float32(part * frame.pixel * frame.parallel), 16))
    store(paths.f, SPREAD * STRIDE + count, spread(np.float32(part * frame.pixel * (1 - frame.parallel)), 16))


@uncounted()
def start_tile(frame, left, top, paths):
    """Start a path for each pixel of a tile that lies in the picture; return their number."""
    count = 0
    for block in range(PATHS // RAYS):
        number = numbered(16)
        x, y = (number & 3) + (left + (block & 3) * 4), (number >> 2) + (top + (block >> 2) * 4)
        inside = (x < frame.width) & (y < frame.height)
        px = (as_float(x) + (0.5 - 0.5 * frame.width)) * frame.pixel
        py = (as_float(y) + (0.5 - 0.5 * frame.height)) * frame.pixel
        _start_packet(frame, paths, count, inside, (px, py), 1.0)
        compress(paths.slot, count, inside, number + block * RAYS)
        count += bits_set(mask_bits(inside))
    return count


@uncounted()
def _start_parts(frame, paths, count, rays, corner, pixel):
    """Start those of the rays of a pixel at an outline that are given as bits, from path ``count`` on."""
    column, row = pixel
    px = load(frame.parts, 0, 16) + (corner[0] + column - 0.5 * frame.width)
    py = load(frame.parts, 16, 16) + (corner[1] + row - 0.5 * frame.height)
    inside = ((spread(rays, 16) >> numbered(16)) & 1) == 1
    _start_packet(frame, paths, count, inside, (px * frame.pixel, py * frame.pixel), 1.0 / SIDE)
    return inside


@uncounted()
def start_rays(frame, tile, paths):
    """Start a path for each listed ray that falls to a tile, in rows of TILE pixels; return their number."""
    first = tile * PATHS
    count = min(frame.listed - first, PATHS)
    for number in range(count):
        at = (first + number) * LISTED
        for field in range(3):
            paths.f[(ORIGIN + field) * STRIDE + number] = frame.rays[at + field]
            paths.f[(DIRECTION + field) * STRIDE + number] = frame.rays[at + 3 + field]
        paths.f[CONE * STRIDE + number], paths.f[SPREAD * STRIDE + number] = frame.rays[at + 6], frame.rays[at + 7]
        paths.f[THROUGHPUT * STRIDE + number] = 1.0
        # A tile's pixels are numbered block by block, and the picture row by row.
        x, y = number % TILE, number // TILE
        paths.slot[number] = ((y // 4) * 4 + x // 4) * RAYS + (y % 4) * 4 + x % 4
    return count


@uncounted(forceinline=True)
def _trace(world, scratch, base, active):
    """Trace those of the sixteen rays from path ``base`` on that the mask ``active`` selects."""
    left = active
    if world.bounded > 0:
        left = meet_by_formula(world, scratch.packet, scratch.paths, base, active)
    if mask_bits(left):
        trace_packet(world, scratch.packet, scratch.paths, base, left)


@uncounted()
def _trace_apart(world, scratch, base, active):
    """Do as `_trace`, in one copy for all callers that trace few rays."""
    _trace(world, scratch, base, active)


@uncounted()
def _meet(job, scratch, base, count, bounce, memory):
    """Trace a packet or recall its hits; return the bits of rays that hit and of those that missed.

    ``memory`` tells whether hits are kept or recalled, and where.
    """
    visibility, kept = memory
    world, limits, active = job.world, job.limits, active_lanes(count, base)
    if visibility == RECALLED and bounce < limits.kept_bounces:
        recall_packet(scratch.packet, kept)
    else:
        _trace(world, scratch, base, active)
        if visibility == STORED and bounce < limits.kept_bounces:
            keep_packet(scratch.packet, kept)
    met = active & (shapes_met(scratch.packet) >= 0)
    return mask_bits(met), mask_bits(active & ~met)


@uncounted()
def _shade_packet(job, scratch, base, count, bounce, after):
    """Shade a packet's hits and write the continuing paths from index ``after`` on; return the index after the last."""
    world, frame, layout = job.world, job.frame, job.layout
    packet, hits, figures = scratch.packet, scratch.hits, scratch.figures
    met = active_lanes(count, base) & (shapes_met(packet) >= 0)
    placed = place_hits(world, scratch, base, met)
    seen, placed = prepare_hits(job, scratch, base, met, placed)
    bits = mask_bits(seen)
    if frame.lamps > 0:
        light_hits(job, packet, hits, seen)
    glossy = 0
    if world.scatters > 0:
        glossy = shade_surfaces(job, scratch, base, bits)
    figures[_HITS] += bits_set(bits)
    of_any = glossy
    for component in range(1, gloss_components(layout)):
        of_any |= glossy >> (component * RAYS)
    figures[_GLOSSY] += bits_set(of_any & 0xFFFF)
    if glossy and world.gloss_levels > 0:
        for row in range(gloss_components(layout) * gloss_parts(layout)):
            bits_of_row = (glossy >> (row // gloss_parts(layout) * RAYS)) & 0xFFFF
            if bits_of_row:
                entries = hits.entries[row * RAYS * ENTRY :]
                find_lobes(world, layout, hits, entries, placed)
                shade_gloss(job, scratch, base, bits_of_row)
    if bounce < job.limits.max_bounces:
        reflect_packet(job, scratch, base, bits, placed)
        after = advance(job, scratch, base, seen, after, placed)
    return after


@uncounted(forceinline=True)
def _place_of(slot):
    """Return column and row of a pixel in its tile; pixels are numbered block by block."""
    block, place = slot // RAYS, slot % RAYS
    return (block & 3) * 4 + (place & 3), (block >> 2) * 4 + (place >> 2)


@uncounted(forceinline=True)
def _met_by(world, packet):
    """Return the shapes that a packet's rays meet, and the inverse of the distance to those that are meshes."""
    shape = shapes_met(packet)
    inverse = 0.0 * as_float(shape)
    if world.brought_singly > 0:
        inverse = select(are_meshes(world, shape), 1.0 / distances(packet), 0.0)
    return shape, inverse


@uncounted()
def _note(world, scratch, base, count):
    """Note what a packet of rays through the middles of a tile's pixels meets."""
    number, inverse = _met_by(world, scratch.packet)
    if count == PATHS:
        column, row = _place_of(base)
        note_block(scratch.met, column, row, number, inverse)
        return
    for ray in range(min(RAYS, count - base)):
        column, row = _place_of(np.int64(scratch.paths.slot[base + ray]))
        note_pixel(scratch.met, column, row, lane(number, ray), lane(inverse, ray))


@uncounted()
def _note_around(job, scratch, left, top):
    """Trace and note the pixels beside a tile, or beside its part in the picture."""
    frame, place = job.frame, numbered(16)
    for side in range(4):
        # The rows above and below, then the columns to the left and to the right.
        wide, high = min(TILE, frame.width - left), min(TILE, frame.height - top)
        at = (-1, high, -1, wide)[side]
        column, row = (place, spread(at, 16)) if side < 2 else (spread(at, 16), place)
        px = (as_float(column + left) + (0.5 - 0.5 * frame.width)) * frame.pixel
        py = (as_float(row + top) + (0.5 - 0.5 * frame.height)) * frame.pixel
        _start_packet(frame, scratch.paths, 0, place >= 0, (px, py), 1.0)
        _trace_apart(job.world, scratch, 0, place >= 0)
        number, inverse = _met_by(job.world, scratch.packet)
        scratch.figures[_RAYS] += RAYS
        if side < 2:
            note_row(scratch.met, at, number, inverse)
        else:
            for ray in range(RAYS):
                note_pixel(scratch.met, at, ray, lane(number, ray), lane(inverse, ray))


@uncounted()
def _follow(job, scratch, count, visibility, kept, notes):
    """Follow the paths of a tile through mirrors until none is left or the limit of bounces is reached.

    With ``notes``, what the first rays meet is noted in ``scratch.met``. Returns, as bits, the packets of first rays of
    which any meets an object.
    """
    figures, packets, lit = scratch.figures, 0, np.int64(0)
    for bounce in range(job.limits.max_bounces + 1):
        after = np.int64(0)  # for a literal 0, `_shade_packet` would be compiled a second time
        # Rays of the packet before whose light is looked up in the sky, and has had time to come from memory.
        waiting, blends = np.int64(0), False
        for base in range(0, count + RAYS, RAYS):
            met, missed = np.int64(0), np.int64(0)
            if base < count:
                met, missed = _meet(job, scratch, base, count, bounce, (visibility, kept[packets * KEPT :]))
                packets += 1
                if notes and bounce == 0:
                    _note(job.world, scratch, base, count)
                figures[_MISSES] += bits_set(missed)
            if waiting:
                shade_sky(job, scratch, waiting, blends)
            waiting = missed if job.world.environment_levels > 0 else np.int64(0)
            if waiting:
                blends = find_sky(job, scratch.paths, base, scratch.sky, waiting)
            if met:
                lit |= np.int64(bounce == 0) << (base // RAYS)
                after = _shade_packet(job, scratch, base, count, bounce, after)
        figures[_RAYS] += count
        count = after
        if count == 0:
            break
    return lit


@uncounted(forceinline=True)
def _write_pixel(job, sums, slot, at, lit, target):
    """Convert the light accumulated at a slot to the channels of the picture, written at ``at``, and clear it.

    Unless ``lit``, the sum of its colours is black.
    """
    world, layout, image, channels = job.world, job.layout, target.image, target.channels
    surface, light = surface_lanes(layout), light_lanes(layout)
    if channels != 3:
        for channel in range(channels):
            image[at + channel] = sums.colour[slot * surface + channel]
        store(sums.colour, slot * surface, surface_black(layout))
        return
    # No matrix has a column for the last two numbers, which are not channels.
    first = slot * surface
    xyz = odd = spread(np.float32(0.0), 4)
    if lit:
        for number in range(0, surface - 2, 2):  # in two sums, which need not wait for each other
            xyz = xyz + sums.colour[first + number] * load(world.xyz_from_colour, 4 * number, 4)
            odd = odd + sums.colour[first + number + 1] * load(world.xyz_from_colour, 4 * number + 4, 4)
        xyz = xyz + odd
        store(sums.colour, slot * surface, surface_black(layout))
    if not is_coloured(layout):
        direct = sums.light[slot * light] * load(world.xyz_from_light, 0, 4)
        for number in range(1, light):
            direct = direct + sums.light[slot * light + number] * load(world.xyz_from_light, 4 * number, 4)
        xyz = xyz + direct
        store(sums.light, slot * light, light_black(layout))
    for channel in range(3):
        image[at + channel] = lane(xyz, channel)


@uncounted()
def _finish_tile(job, sums, corner, lit, target):
    """Write the pixels of a tile to the picture, and clear their sums.

    ``lit`` has the bits of the blocks that show objects; the colours of others are black.
    """
    frame, (left, top) = job.frame, corner
    for block in range(PATHS // RAYS):
        shown = (lit >> block) & 1
        for place in range(RAYS):
            x, y = left + (block & 3) * 4 + (place & 3), top + (block >> 2) * 4 + (place >> 2)
            if x < frame.width and y < frame.height:
                _write_pixel(job, sums, block * RAYS + place, (y * frame.width + x) * target.channels, shown, target)


@uncounted()
def _finish_parts(job, scratch, count, corner, target):
    """Write the pixels of ``count`` additional paths, those of a pixel one after the other, and clear their sums."""
    frame, layout, sums, first = job.frame, job.layout, scratch.sums, 0
    surface, light = surface_lanes(layout), light_lanes(layout)
    while first < count:
        pixel, path, colour, direct = scratch.pixels[first], first, surface_black(layout), light_black(layout)
        while path < count and scratch.pixels[path] == pixel:
            share = scratch.shares[path]
            colour = colour + share * load_like(sums.colour, path * surface, colour)
            store(sums.colour, path * surface, surface_black(layout))
            if not is_coloured(layout):
                direct = direct + share * load_like(sums.light, path * light, direct)
                store(sums.light, path * light, light_black(layout))
            path += 1
        store(sums.colour, first * surface, colour)
        if not is_coloured(layout):
            store(sums.light, first * light, direct)
        x, y = corner[0] + pixel % TILE, corner[1] + pixel // TILE
        _write_pixel(job, sums, first, (y * frame.width + x) * target.channels, np.int64(1), target)
        first = path


@uncounted()
def _clear_throughput(layout, sums):
    if is_coloured(layout):
        for number in range(PATHS * surface_lanes(layout)):
            sums.throughput[number] = 1.0


@uncounted()
def _render_tile(job, scratch, tile, target):
    """Render a tile, then those of its pixels again that are at outlines, in batches."""
    frame, layout, limits = job.frame, job.layout, job.limits
    columns = (frame.width + TILE - 1) // TILE
    left, top = (tile % columns) * TILE, (tile // columns) * TILE
    listed, refines = frame.listed > 0, limits.outlines > 0
    count = start_rays(frame, tile, scratch.paths) if listed else start_tile(frame, left, top, scratch.paths)
    numbers = limits.kept_bounces * (PATHS // RAYS) * KEPT if limits.visibility != TRACED else 0
    visibility, again, done, found = limits.visibility, False, np.int64(0), np.int64(0)
    while count > 0:
        _clear_throughput(layout, scratch.sums)
        # The only call, so that it is compiled once.
        lit = _follow(job, scratch, count, visibility, target.kept[tile * numbers :], refines and not again)
        if again:
            _finish_parts(job, scratch, count, (left, top), target)
        else:
            # Only a whole tile's packets are its blocks, and coloured paths add the sky's light to colours.
            whole = count == PATHS and not listed and not is_coloured(layout)
            _finish_tile(job, scratch.sums, (left, top), lit if whole else np.int64(-1), target)
        if refines and not again:
            visibility, again, found = TRACED, True, _list_outlines(job, scratch, left, top)
        count = np.int64(0)
        while done < found and count <= PATHS - RAYS:
            count = _add_parts(job, scratch, count, (left, top), scratch.outlines[done])
            done += 1


@uncounted()
def _list_outlines(job, scratch, left, top):
    """List the pixels of a tile that are at outlines, plus `PATHS` where a mesh bends; return their number."""
    frame, count = job.frame, 0
    _note_around(job, scratch, left, top)
    inside = (1 << min(TILE, frame.width - left)) - 1
    for row in range(min(TILE, frame.height - top)):
        beside, bent = outline_bits(frame, scratch.met, row)
        left_over, column = (beside | bent) & inside, 0
        while left_over:
            if left_over & 1:
                scratch.outlines[count] = row * TILE + column + ((bent >> column) & 1) * PATHS
                count += 1
            left_over, column = left_over >> 1, column + 1
    return count


@uncounted()
def _add_parts(job, scratch, count, corner, listed):
    """Start the paths of a listed pixel at an outline from index ``count`` on; return the index after the last."""
    pixel = listed % TILE, listed % PATHS // TILE
    inside = _start_parts(job.frame, scratch.paths, count, np.int64(0xFFFF), corner, pixel)
    _trace_apart(job.world, scratch, count, inside)
    scratch.figures[_RAYS] += RAYS
    shape, inverse = _met_by(job.world, scratch.packet)
    if listed < PATHS and mask_bits(shape == lane(shape, 0)) == 0xFFFF:
        return count
    chosen, share = shaded_rays(job.frame, shape, inverse)
    inside = _start_parts(job.frame, scratch.paths, count, chosen, corner, pixel)
    compress(scratch.shares, count, inside, share)
    for path in range(count, count + bits_set(chosen)):
        scratch.pixels[path], scratch.paths.slot[path] = listed % PATHS, path
    return count + bits_set(chosen)


@uncounted()
def _render_each(job_at, scratch_at, target_at, first, last):
    job, scratch, target = at_address(job_at), at_address(scratch_at), at_address(target_at)
    for tile in range(first, last):
        _render_tile(job, scratch, tile, target)


@uncounted()
def _render_tiles(job, target, singles, doubles, first, last):
    scratch = scratch_in(job, singles, doubles, target.figures[first * FIGURES :])
    _render_each(address_of(job), address_of(scratch), address_of(target), first, last)


@njit(cache=True, nogil=True)
def render_tiles(job, target, first, last):
    """Render the tiles from ``first`` to before ``last`` of a `Job`, numbered row by row, into a `FrameBuffers`."""
    room, doubles = np.zeros(_singles(job.layout, job.frame.lamps) + RAYS, np.float32), np.zeros(PACKET_DOUBLES)
    skip = (64 - room.ctypes.data % 64) % 64 // 4
    _render_tiles(job, target, room[skip:], doubles, first, last)
