"""Loop over the tiles of a picture: trace packets of rays through mirrors, shade hits and accumulate light."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.jit.c_functions import cycles
from irodori.jit.compilation import njit, uncounted
from irodori.jit.functions import as_float, root
from irodori.jit.vector_memory import (
    compress,
    lane,
    load,
    mask_bits,
    numbered,
    spread,
    store,
)
from irodori.rendering.interactive.hard_shadows import light_hits
from irodori.rendering.interactive.look_ups import LOOK_FIELDS, LOOK_NUMBERS, find_lobes
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
    is_profiled,
    light_black,
    light_lanes,
    surface_black,
    surface_lanes,
)
from irodori.rendering.interactive.round_lobes import ENTRY
from irodori.rendering.interactive.shading import (
    FURTHER,
    Hits,
    Sums,
    advance,
    bits_set,
    reflect_packet,
    shade_gloss,
    shade_sky,
    shade_surfaces,
)

if TYPE_CHECKING:  # keeps their other imports out of the kernel's import closure
    from irodori.rendering.interactive.prepared_scene import FrameView, PreparedWorld

#: Values of `PathLimits.visibility`: trace all rays, trace and store hits, recall the stored hits of an earlier frame.
TRACED, STORED, RECALLED = 0, 1, 2
#: Stages whose processor cycles are counted; then the number of rays, hits, hits with gloss, and misses.
STAGES = ("tracing", "geometry", "surfaces", "gloss", "sky", "mirror", "colour", "rays", "hits", "glossy", "misses")
_TRACE, _PLACE, _SURFACE, _GLOSS, _SKY, _MIRROR, _COLOUR, _RAYS, _HITS, _GLOSSY, _MISSES = range(11)
FIGURES = len(STAGES)


#: Numbers of a listed ray: origin, mm; direction; width of its cone, mm, and growth of the width per distance.
LISTED = 8


class PathLimits(NamedTuple):
    """Limits at which paths end, and the treatment of hits between frames."""

    max_bounces: int
    least_throughput: float  # least throughput of a path that continues
    least_lobe: float  # least weight times throughput of a lobe that is looked up
    visibility: int  # see `TRACED`
    kept_bounces: int  # number of bounces whose hits are kept, including the rays from the eye


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
    sums: Sums
    figures: np.ndarray  # (FIGURES,) int64, counters of the thread


@uncounted()
def _singles(layout, lamps):
    """Return the number of float32 in a thread's buffers."""
    entries = gloss_components(layout) * gloss_parts(layout) * ENTRY
    fixed = PACKET_SINGLES + (PATH_FIELDS + 1) * STRIDE + (HIT_FIELDS + HIT_NUMBERS + entries + LOOK_FIELDS) * RAYS
    lanes = (2 * PATHS + 1) * surface_lanes(layout) + PATHS * light_lanes(layout)
    return fixed + (LOOK_NUMBERS + max(lamps, 1)) * RAYS + lanes + FURTHER


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
    colour, light = PATHS * surface_lanes(layout), PATHS * light_lanes(layout)
    texel = at[2 * colour + light :]
    sums = Sums(at, at[colour:], at[colour + light :], texel, texel[surface_lanes(layout) :])
    return Scratch(packet, paths, hits, sums, figures)


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
        store(paths.f, CONE * STRIDE + count, spread(np.float32(frame.pixel * frame.parallel), 16))
        store(paths.f, SPREAD * STRIDE + count, spread(np.float32(frame.pixel * (1 - frame.parallel)), 16))
        compress(paths.slot, count, inside, number + block * RAYS)
        bits = mask_bits(inside)
        while bits:
            bits &= bits - 1
            count += 1
    return count


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
def _count(layout, figures, stage, since):
    """Add the processor cycles since the count ``since`` to a stage and return the present count."""
    if is_profiled(layout):
        now = cycles()
        figures[stage] += now - since
        return now
    return since


@uncounted()
def _meet(job, scratch, base, count, bounce, kept):
    """Trace a packet or recall its hits from ``kept``; return the bits of rays that hit and of those that missed."""
    world, limits, active = job.world, job.limits, active_lanes(count, base)
    if limits.visibility == RECALLED and bounce < limits.kept_bounces:
        recall_packet(scratch.packet, kept)
    else:
        left = active
        if world.bounded > 0:
            left = meet_by_formula(world, scratch.packet, scratch.paths, base, active)
        if mask_bits(left):
            trace_packet(world, scratch.packet, scratch.paths, base, left)
        if limits.visibility == STORED and bounce < limits.kept_bounces:
            keep_packet(scratch.packet, kept)
    met = active & (shapes_met(scratch.packet) >= 0)
    return mask_bits(met), mask_bits(active & ~met)


@uncounted()
def _shade_packet(job, scratch, base, count, bounce, after):
    """Shade a packet's hits and write the continuing paths from index ``after`` on; return the index after the last."""
    world, frame, layout = job.world, job.frame, job.layout
    packet, hits, figures = scratch.packet, scratch.hits, scratch.figures
    since = cycles() if is_profiled(layout) else 0
    met = active_lanes(count, base) & (shapes_met(packet) >= 0)
    placed = place_hits(world, scratch, base, met)
    seen, placed = prepare_hits(job, scratch, base, met, placed)
    since = _count(layout, figures, _PLACE, since)
    bits = mask_bits(seen)
    if frame.lamps > 0:
        light_hits(job, packet, hits, seen)
        since = _count(layout, figures, _TRACE, since)
    glossy = 0
    if world.scatters > 0:
        glossy = shade_surfaces(job, scratch, base, bits)
    figures[_HITS] += bits_set(bits)
    of_any = glossy
    for component in range(1, gloss_components(layout)):
        of_any |= glossy >> (component * RAYS)
    figures[_GLOSSY] += bits_set(of_any & 0xFFFF)
    since = _count(layout, figures, _SURFACE, since)
    if glossy and world.gloss_levels > 0:
        for row in range(gloss_components(layout) * gloss_parts(layout)):
            bits_of_row = (glossy >> (row // gloss_parts(layout) * RAYS)) & 0xFFFF
            if bits_of_row:
                entries = hits.entries[row * RAYS * ENTRY :]
                find_lobes(world, layout, hits, entries, placed)
                shade_gloss(job, scratch, base, bits_of_row)
        since = _count(layout, figures, _GLOSS, since)
    if bounce < job.limits.max_bounces:
        reflect_packet(job, scratch, base, bits, placed)
        after = advance(job, scratch, base, seen, after, placed)
        since = _count(layout, figures, _MIRROR, since)
    return after


@uncounted()
def _follow(job, scratch, count, kept):
    """Follow the paths of a tile through mirrors until none is left or the limit of bounces is reached."""
    layout, figures, packets = job.layout, scratch.figures, 0
    for bounce in range(job.limits.max_bounces + 1):
        after = np.int64(0)  # for a literal 0, `_shade_packet` would be compiled a second time
        for base in range(0, count, RAYS):
            since = cycles() if is_profiled(layout) else 0
            met, missed = _meet(job, scratch, base, count, bounce, kept[packets * KEPT :])
            packets += 1
            figures[_MISSES] += bits_set(missed)
            since = _count(layout, figures, _TRACE, since)
            if missed and job.world.environment_levels > 0:
                shade_sky(job, scratch, base, missed)
                since = _count(layout, figures, _SKY, since)
            if met:
                after = _shade_packet(job, scratch, base, count, bounce, after)
        figures[_RAYS] += count
        count = after
        if count == 0:
            break


@uncounted()
def _finish_tile(job, sums, left, top, target):
    """Convert the light accumulated in a tile's pixels to the channels of the picture, and clear the sums."""
    world, frame, layout, image, channels = job.world, job.frame, job.layout, target.image, target.channels
    surface, light = surface_lanes(layout), light_lanes(layout)
    for block in range(PATHS // RAYS):
        for place in range(RAYS):
            slot = block * RAYS + place
            x, y = left + (block & 3) * 4 + (place & 3), top + (block >> 2) * 4 + (place >> 2)
            if x >= frame.width or y >= frame.height:
                continue
            at = (y * frame.width + x) * channels
            if channels != 3:
                for channel in range(channels):
                    image[at + channel] = sums.colour[slot * surface + channel]
                store(sums.colour, slot * surface, surface_black(layout))
                continue
            # No matrix has a column for the last two numbers, which are not channels.
            first = slot * surface
            xyz = sums.colour[first] * load(world.xyz_from_colour, 0, 4)
            odd = sums.colour[first + 1] * load(world.xyz_from_colour, 4, 4)
            for number in range(2, surface - 2, 2):  # in two sums, which need not wait for each other
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
def _render_tile(job, scratch, tile, target):
    frame, layout, limits = job.frame, job.layout, job.limits
    columns = (frame.width + TILE - 1) // TILE
    left, top = (tile % columns) * TILE, (tile // columns) * TILE
    listed = frame.listed > 0
    count = start_rays(frame, tile, scratch.paths) if listed else start_tile(frame, left, top, scratch.paths)
    if is_coloured(layout):
        for number in range(PATHS * surface_lanes(layout)):
            scratch.sums.throughput[number] = 1.0
    numbers = limits.kept_bounces * (PATHS // RAYS) * KEPT if limits.visibility != TRACED else 0
    _follow(job, scratch, count, target.kept[tile * numbers :])
    since = cycles() if is_profiled(layout) else 0
    _finish_tile(job, scratch.sums, left, top, target)
    _count(layout, scratch.figures, _COLOUR, since)


@uncounted()
def _render_tiles(job, target, singles, doubles, first, last):
    scratch = scratch_in(job, singles, doubles, target.figures[first * FIGURES :])
    for tile in range(first, last):
        _render_tile(job, scratch, tile, target)


@njit(cache=True, nogil=True)
def render_tiles(job, target, first, last):
    """Render the tiles from ``first`` to before ``last`` of a `Job`, numbered row by row, into a `FrameBuffers`."""
    room, doubles = np.zeros(_singles(job.layout, job.frame.lamps) + RAYS, np.float32), np.zeros(PACKET_DOUBLES)
    skip = (64 - room.ctypes.data % 64) % 64 // 4
    _render_tiles(job, target, room[skip:], doubles, first, last)
