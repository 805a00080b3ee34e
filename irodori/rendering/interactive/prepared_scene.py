"""Arrays of a scene and of a frame for the kernel of the interactive integrator."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from irodori.geometry.embree import Tracer
from irodori.geometry.shape_registry import number_of
from irodori.geometry.shapes.placement import Placement, reaches
from irodori.geometry.shapes.shape_rows import BEHIND, COLUMNS, MIRROR, ROWS, THROUGH, shape_row
from irodori.geometry.surfaces import Surfaces, make_surfaces
from irodori.light.blurred_light import WIDTHS_RAD
from irodori.light.environment_file import Environment
from irodori.light.gloss_maps import GlossMaps
from irodori.reflection.lobes import Lobes
from irodori.rendering.interactive.channels import Channels
from irodori.rendering.interactive.cube_maps import (
    FACES,
    CubePyramid,
    environment_pyramid,
    from_equirectangular,
    give_back,
    on_cache_lines,
)
from irodori.rendering.interactive.look_ups import LINKS
from irodori.rendering.interactive.packets import GRID
from irodori.rendering.interactive.round_lobes import (
    ROUGHNESSES,
    gloss_power,
    joined_tables,
    ladder,
    lobe_table,
    roughness_place,
)
from irodori.rendering.interactive.shading import FURTHER
from irodori.rendering.interactive.surroundings import node_links
from irodori.rendering.light_maps import LightMaps
from irodori.rendering.map_layouts import make_layout
from irodori.rendering.scene_arrays import Light, Objects, coats_of, gloss_of, sides_placed, textures
from irodori.spectra.grid import SAMPLES

#: Largest number of objects for which formulas and bounds are tested one by one before Embree.
_MOST_BOUNDED = 12


class PreparedWorld(NamedTuple):
    """Scene as the kernel reads it; arrays are flat float32 unless stated otherwise."""

    shape: np.ndarray  # (sides * SHAPE,)
    objects: int
    surfaces: Surfaces
    first_face: np.ndarray  # (sides,) int64, index of the first triangle of each side's shape
    brought_singly: int  # number of objects onto which hit points are moved one by one, without vector functions
    scatters: int  # 1 if any surface has a diffuse or a gloss term
    bounded: int  # number of objects whose formulas and bounds are tested before Embree: all, or none if too many
    texels: np.ndarray
    texture_first: np.ndarray  # (objects,) int32 first texel of each object
    index: np.ndarray  # type: ignore[assignment]  # n, then k, of each object; hides the method of tuples
    environment: np.ndarray
    environment_first: np.ndarray  # (levels,) int32 first texel of each level
    environment_side: np.ndarray  # (levels,) int32
    environment_levels: int  # 0 if nothing is looked up in it; likewise for irradiance_side and gloss_levels
    texels_per_rad: float
    irradiance: np.ndarray  # without a coat, then under each of the scene's coats
    irradiance_side: int
    coat: np.ndarray  # (sides * 2,) n and k of each side's coupled coat, zeros without one
    coat_first: np.ndarray  # (sides,) int32 first texel of the irradiance under each side's coat
    baked: np.ndarray  # the light maps, each with a border of one texel, except those of meshes
    baked_first: np.ndarray  # (objects,) int32 first texel of each map
    baked_size: np.ndarray  # (objects * 2,) columns and rows; 0 rows for a mesh
    baked_grid: np.ndarray  # (objects * GRID,) float64 middle and reach of a plane's map, mm; zeros for other shapes
    baked_planes: int  # number of objects that are endless planes
    baked_parts: np.ndarray  # (triangles,) int32, see `irodori.geometry.shapes.surface_nodes.Nodes`
    baked_corner: np.ndarray  # (triangles,) int64, index of a triangle's first corner
    baked_corners: np.ndarray  # int32, nodes at the points of the triangles' grids
    baked_maps: int  # 1 if there are light maps, of all objects
    seen: np.ndarray  # what gloss sees, each cell with the one below, in half precision; maps but meshes' have a border
    seen_first: np.ndarray  # (objects,) int32 first texel of each map, of `cells_of` cells each
    seen_size: np.ndarray  # (objects * 2,) columns and rows; 0 for an object without such a map
    seen_side: int  # texels along the side of a face of their cube maps
    seen_decode: np.ndarray  # from the light of other objects to the channels of texels, or to stored light
    seen_maps: int  # 1 if objects have such maps, then all have
    seen_free: np.ndarray  # (texels * cells,) uint8, 1 where no look-up beginning there sees another object
    seen_nodes: np.ndarray  # (objects,) int32 first node of each mesh
    seen_links: np.ndarray  # (nodes * LINKS,) int32 texels of these maps at each node
    seen_shares: np.ndarray  # (nodes * LINKS,) their weights
    gloss: np.ndarray  # like the environment; each texel of a level has the light of this level and of the next
    gloss_first: np.ndarray  # (levels,) int32 first texel of each level
    gloss_side: np.ndarray  # (levels,) int32
    gloss_levels: int
    gloss_level: float  # index of the finest level in `irodori.light.blurred_light.WIDTHS_RAD`
    lobes: Lobes
    lobe: np.ndarray  # (objects * components,) int64 index of each gloss component's lobe
    rows: np.ndarray  # see `irodori.rendering.interactive.round_lobes.joined_tables`
    ladder: np.ndarray  # (lobes * 2,) float64 ln μ of the first roughness, and the step
    further: np.ndarray  # (texels * FURTHER,) of the gloss components from the second on
    decode: np.ndarray
    lamp_light: np.ndarray
    lamp_colour: np.ndarray
    xyz_from_colour: np.ndarray  # by channel, then X, Y, Z and 0
    xyz_from_light: np.ndarray
    intersect: int
    occluded: int
    scene: int
    query: int  # address of RTCIntersectArguments


class FrameView(NamedTuple):
    """View, rotation of the light and lamps of one frame, for the kernel."""

    position_mm: np.ndarray  # (3,)
    world_from_camera: np.ndarray  # (9,)
    pixel: float  # size of a pixel in the image plane at distance 1; in mm if rays are parallel
    parallel: int  # 1 if rays are parallel and start in the image plane, 0 if they start at the eye
    width: int
    height: int
    light_from_world: np.ndarray  # (9,)
    lamps: int
    lamp_direction: np.ndarray  # (lamps * 3,) towards the lamp
    lamp_strength: np.ndarray  # (lamps,)
    rays: np.ndarray  # (rays * LISTED,) list instead of a picture, see `irodori.rendering.interactive.tile_loop`
    listed: int  # number of listed rays, which fill a picture of TILE columns; 0 without a list
    parts: np.ndarray  # where the rays of a pixel at an outline pass, from its upper left corner: columns, then rows


_TEXELS_AT_ONCE = 1 << 18  # texels that are converted together


def padded(rows: np.ndarray, width: int) -> np.ndarray:
    """Pad rows, (..., n), with zeros to a width and return them as a flat float32 array."""
    room = width - rows.shape[-1]
    return np.pad(rows, [(0, 0)] * (rows.ndim - 1) + [(0, room)]).astype(np.float32).ravel()


def indices(first: np.ndarray) -> np.ndarray:
    """Return indices of texels as the kernel reads them.

    Raises
    ------
    ValueError
        If there are too many texels.
    """
    if max(first, default=0) >= 1 << 30:
        raise ValueError(f"{max(first)} texels of a kind in a scene; accepted: fewer than {1 << 30}")
    return np.asarray(first, dtype=np.int32)


def joined(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Return flat float32 arrays one after the other, the first at the beginning of a line of the processor's cache."""
    out = on_cache_lines(sum(part.size for part in parts))
    np.concatenate(parts, out=out)
    return out


def make_shapes(tracer: Tracer, objects: Objects) -> np.ndarray:
    """Return the table of the sides' parameters, (sides * SHAPE,) float32; the first rows are those of the shapes."""
    placed = zip(tracer.placements, reaches(tracer.placements), strict=True)
    fronts = np.stack([shape_row(placement, reach, number_of(placement.shape)) for placement, reach in placed])
    table = fronts[objects.shape]
    for side, row in enumerate(table):
        row[MIRROR] = objects.mirror[side]
        row[COLUMNS], row[ROWS] = objects.texture_size[side]
        row[BEHIND], row[THROUGH] = objects.behind[side], objects.through[side]
    return table.ravel()


def bordered_size(rows: int, columns: int) -> int:
    """Return the number of texels of a texture with its border of one texel."""
    return (int(rows) + 2) * (int(columns) + 2)


def stored_texels(
    objects: Objects, index: int, texels: np.ndarray, channels: Channels
) -> tuple[np.ndarray, np.ndarray]:
    """Convert an object's texture, (rows, columns, k + 2 c), to the kernel's form, with a border of one texel.

    If the left and right sides of a texture are joined, the border repeats the opposite side; other edges repeat
    themselves.

    Returns
    -------
    texels : (texels * surface lanes,) float32
    further : (texels * FURTHER,) float32
        Gloss components from the second on; empty if the scene's objects have one component.
    """
    size = texels.shape[0] + 2, texels.shape[1] + 2
    stored = np.zeros((*size, channels.surface), dtype=np.float32)
    further = np.zeros((*size, FURTHER) if _has_further(objects) else 0, dtype=np.float32)
    _fill_texture(objects, index, texels, channels, (stored, further))
    return stored.ravel(), further.ravel()


def _fill_texture(
    objects: Objects, index: int, texels: np.ndarray, channels: Channels, out: tuple[np.ndarray, np.ndarray]
) -> None:
    """Fill the arrays of `stored_texels`, (rows + 2, columns + 2, numbers) each, some rows at a time."""
    stored, further = out
    step = max(1, _TEXELS_AT_ONCE // texels.shape[1])
    for first in range(0, len(texels), step):
        some = texels[first : first + step]
        inside = np.s_[1 + first : 1 + first + len(some), 1:-1]
        weights = some[..., : objects.bases[index]].astype(np.float64)
        stored[inside][..., : channels.count] = weights @ channels.texel_from_weights[index].T
        for component, (beta, mu) in enumerate(gloss_of(objects, some)):
            name = objects.lobes.names[objects.lobe[index, component]]
            # β times a quarter of the lobe's strength, its power: one number less to compute at a hit.
            place = 2 * component - 2
            pair = stored[inside][..., -2:] if component == 0 else further[inside][..., place : place + 2]
            pair[..., 0] = gloss_power(beta, mu, name)
            pair[..., 1] = roughness_place(np.where(mu > 0, mu, 1.0), name)
    for values in out:
        if values.size:
            _repeat_border(values, objects.wraps[index] == 1)


def _has_further(objects: Objects) -> bool:
    return objects.lobe.shape[1] > 1


def make_textures(objects: Objects, channels: Channels, spare: int = 0) -> dict:
    """Return the fields of a `PreparedWorld` that hold the texels, with memory for ``spare`` unused texels."""
    sizes = [bordered_size(rows, columns) for columns, rows in objects.texture_size]
    first = np.cumsum([0, *sizes]).astype(np.int64)
    widths = channels.surface, FURTHER if _has_further(objects) else 0
    room = [on_cache_lines((int(first[-1]) + spare) * width) for width in widths]
    for i, texels in enumerate(textures(objects)):
        size = texels.shape[0] + 2, texels.shape[1] + 2
        # In place: of a texture of ten megapixels, a copy takes hundreds of megabytes.
        stored, further = (
            flat[first[i] * width : first[i + 1] * width].reshape(*size, width)
            for flat, width in zip(room, widths, strict=True)
        )
        _fill_texture(objects, i, texels, channels, (stored, further))
    return {
        "texels": room[0],
        "texture_first": indices(first[:-1]),
        "further": room[1],
    }


def _bordered(texels: np.ndarray, wraps: bool) -> np.ndarray:
    """Return a texture, (rows, columns, numbers), with a border of one texel added, as a flat array."""
    stored = np.zeros((texels.shape[0] + 2, texels.shape[1] + 2, texels.shape[2]), dtype=np.float32)
    stored[1:-1, 1:-1] = texels
    _repeat_border(stored, wraps)
    return stored.ravel()


def _repeat_border(stored: np.ndarray, wraps: bool) -> None:
    """Fill the border of one texel of a texture, (rows + 2, columns + 2, numbers)."""
    stored[:, 0], stored[:, -1] = (stored[:, -2], stored[:, 1]) if wraps else (stored[:, 1], stored[:, -2])
    stored[0], stored[-1] = stored[1], stored[-2]


def make_irradiance(light: Light, channels: Channels) -> tuple[np.ndarray, int]:
    """Return the irradiance maps in the channels of texels, flat, and their side, 0 if the light has no irradiance."""
    width, height = light.irradiance_size
    if height == 0:
        return np.zeros(0, dtype=np.float32), 0
    side, found = int(height), []
    for one in (light.irradiance, *light.under_coats):
        faces = from_equirectangular(one.reshape(height, width, -1), side)
        stored = np.stack([face @ channels.irradiance_from_light.T for face in faces])
        found.append(padded(stored, channels.surface))
    return joined(found), side


def make_coats(objects: Objects, light: Light, side: int) -> dict:
    """Return the fields of a `PreparedWorld` with the sides' coats, for irradiance maps of a side, 0 for none.

    Raises
    ------
    ValueError
        If the light lacks the irradiance under the coats.
    """
    coats = coats_of(objects)
    if side and len(light.under_coats) != len(coats.n_k):
        raise ValueError(f"irradiance under {len(light.under_coats)} coats; accepted: under {len(coats.n_k)}")
    index = np.concatenate([np.zeros((1, 2)), coats.n_k])[coats.of_side]
    first = coats.of_side * (FACES * (side + 2) ** 2 if side else 0)
    return {"coat": index.astype(np.float32).ravel(), "coat_first": indices(first)}


def stored_maps(maps: LightMaps, placements: Sequence[Placement], channels: Channels) -> list[np.ndarray]:
    """Return the light maps as flat arrays in the channels of texels, with a border of one texel except for meshes."""
    stored_from_map = (channels.baked_from_radiance @ maps.basis).T.astype(np.float32)
    flat = []
    for stored, placement in zip(maps.maps, placements, strict=True):
        room = np.zeros((*stored.shape[:2], channels.surface), dtype=np.float32)
        room[..., : channels.count] = stored @ stored_from_map
        flat.append(room.ravel() if placement.shape.triangles is not None else _bordered(room, placement.shape.wraps))
    return flat


def make_baked(maps: LightMaps | None, placements: Sequence[Placement], shape: np.ndarray, channels: Channels) -> dict:
    """Return the fields of a `PreparedWorld` that hold the light maps, in the channels of texels.

    ``shape`` has the placed shape of each side.

    Raises
    ------
    ValueError
        If the maps do not fit the shapes.
    """
    count = len(shape)
    flat, size, grid = [np.zeros(0, np.float32)], np.zeros((count, 2), np.float32), np.zeros((count, GRID))
    parts, corners = [np.zeros(0, np.int32)], [np.zeros(0, np.int32)]
    nodes, links, shares = np.zeros(count, np.int32), [np.zeros(0, np.int32)], [np.zeros(0, np.float32)]
    for index, placed in enumerate(shape if maps is not None else ()):
        assert maps is not None  # the loop is empty without maps
        stored, most, layout = maps.maps[index], maps.bakes[index].most, make_layout(placements, placed)
        if stored.shape[:2] != layout.size(most):
            raise ValueError(f"a light map of {stored.shape[:2]} texels; accepted: {layout.size(most)}, of this shape")
        rows = 0 if placements[placed].shape.triangles is not None else stored.shape[0]
        size[index], grid[index] = (stored.shape[1], rows), layout.grid
        if index >= len(placements):
            nodes[index] = nodes[placed]
            continue  # the back of a sheet has the triangles of its front
        for found, own in zip((parts, corners), layout.triangles(most), strict=True):
            found.append(own)
        nodes[index] = sum(one.size for one in links) // LINKS
        if not rows:
            linked, weights = node_links(layout.points(most))
            links.append(linked.ravel())
            shares.append(weights.ravel())
    flat += [] if maps is None else stored_maps(maps, [placements[index] for index in shape], channels)
    sides = np.concatenate(parts)
    sizes = (sides.astype(np.int64) + 1) * (sides + 2) // 2
    first = np.cumsum([one.size for one in flat], dtype=np.int64)
    return {
        "baked": joined(flat),
        "baked_first": indices(first[:-1] // channels.surface) if maps is not None else np.zeros(count, np.int32),
        "baked_size": size.ravel(),
        "baked_grid": grid.ravel(),
        "baked_planes": int((grid[:, 2] > 0.0).sum()),
        "baked_parts": sides,
        "baked_corner": np.cumsum(sizes) - sizes,
        "baked_corners": np.concatenate(corners),
        "baked_maps": int(maps is not None),
        "seen_nodes": nodes,
        "seen_links": np.concatenate(links),
        "seen_shares": np.concatenate(shares),
    }


def make_seen(maps: LightMaps | None, placements: Sequence[Placement], channels: Channels) -> dict:
    """Return the fields of a `PreparedWorld` that hold what the gloss of objects sees around them.

    Where light is only added to pixels, that of other objects is kept as XYZ, which need fewer numbers.
    """
    seen, basis = (maps.seen, maps.seen_basis) if maps is not None else ((), np.zeros((SAMPLES, 0)))
    decode = channels.colour_from_radiance @ basis
    stored_from_seen = np.eye(basis.shape[1])
    if not channels.coloured:
        stored_from_seen, decode = channels.xyz_from_colour @ decode, stored_from_xyz(channels)[1]
    # The largest number is brought to between 16384 and 32768, by a power of two.
    largest = max((float(np.abs(one[..., 1:] @ stored_from_seen.T).max()) for one in seen), default=0.0)
    scale = np.exp2(np.ceil(np.log2(largest)) - 15.0) if largest > 0.0 else 1.0
    flat, first = [np.zeros(0, np.float32)], np.zeros(len(placements) + 1, np.int64)
    size, free = np.zeros((len(placements), 2), dtype=np.float32), [np.zeros(0, bool)]
    for index, found in enumerate(seen):
        others = found[..., 1:] @ (stored_from_seen.T / scale).astype(np.float32)
        texels = np.concatenate([found[..., :1], others], axis=-1)
        texels = np.concatenate([texels, np.roll(texels, -1, axis=3)], axis=-1)
        shape, (rows, columns), cells = placements[index].shape, found.shape[:2], texels.shape[2:]
        count, sees_none = rows * columns, np.zeros((rows, columns, *cells[:3]), bool)
        if shape.triangles is None:
            size[index], count = (columns, rows), bordered_size(rows, columns)
            texels = _bordered(texels.reshape(rows, columns, -1), shape.wraps)
            sees_none = _sees_none(texels.reshape(rows + 2, columns + 2, *cells)[..., : cells[-1] // 2])
        flat.append(texels.ravel())
        free.append(sees_none.ravel())
        first[index + 1] = first[index] + count
    stored = on_cache_lines(sum(one.size for one in flat), np.float16)
    np.concatenate(flat, out=stored, casting="unsafe")
    return {
        "seen": stored.view(np.uint16),
        "seen_first": indices(first[:-1]),
        "seen_size": size.ravel(),
        "seen_side": max((found.shape[3] - 2 for found in seen), default=1),
        "seen_decode": padded(scale * decode.T, channels.surface if channels.coloured else channels.light),
        "seen_maps": int(len(seen) > 0),
        "seen_free": np.concatenate(free).view(np.uint8),
    }


def _sees_none(cells: np.ndarray) -> np.ndarray:
    """Return whether look-ups between texels and cells see no object: (rows, columns, faces, side, side) bool.

    A look-up begins at the upper left texel, of the four around a hit, and at the upper left cell of its cube map.

    Parameters
    ----------
    cells : (rows, columns, faces, side, side, n) float
        Share of free directions, then the light of other objects.
    """
    free = (cells[..., 0].astype(np.float16) == 1.0) & (cells[..., 1:] == 0.0).all(axis=-1)
    for axis in (0, 1, 3, 4):  # no look-up begins at the last of them
        free = free & np.roll(free, -1, axis=axis)
    return free


def needed_gloss(gloss: GlossMaps, objects: Objects) -> GlossMaps:
    """Return the blurred maps without the finest, which are narrower than any lobe of the scene's materials."""
    spare = min(max(_finest_level(objects) - gloss.first, 0), len(gloss.levels) - 1)
    return replace(gloss, first=gloss.first + spare, levels=gloss.levels[spare:])


def gloss_for(environment: Environment, objects: Objects) -> GlossMaps:
    """Return the blurred maps of an environment that a scene's materials need, read from its file or computed.

    The finest maps take most of a file and are narrower than most lobes; they are read only if needed.
    """
    levels = _finest_level(objects), len(WIDTHS_RAD)
    return GlossMaps.stored(environment, levels) or GlossMaps.of(environment.coefficients)


def _finest_level(objects: Objects) -> int:
    """Return the level of the finest blurred map that a scene uses; the coarsest if nothing has gloss."""
    finest = min((level for level, _ in levels_by_lobe(objects, whole=True)), default=math.inf)
    return int(min(max(math.floor(finest) if finest < math.inf else len(WIDTHS_RAD), 0), len(WIDTHS_RAD) - 1))


def levels_by_lobe(objects: Objects, traced: tuple[bool, ...] | None = None, whole: bool = False) -> list:
    """Return the finest and coarsest level, fractional, at which each gloss component of the scene is looked up.

    All entries of the lobe's table between the least and the largest roughness of the texels are considered, at every
    angle; with ``whole``, all from the least roughness on. Because texels are interpolated, ``whole`` also counts the
    roughness of texels without gloss.
    """
    found = []
    for i, texels in enumerate(textures(objects)):
        for component, (beta, mu) in enumerate(gloss_of(objects, texels)):
            if not beta.any() or (traced is not None and not traced[i]):
                continue
            name = objects.lobes.names[objects.lobe[i, component]]
            rough = mu[mu > 0] if whole else mu[beta > 0]
            first, last = np.clip(roughness_place([rough.min(), rough.max()], name), 0, ROUGHNESSES - 1)
            end = ROUGHNESSES if whole else int(np.ceil(last)) + 1
            entries = lobe_table(name).entries[:, int(first) : end, :, 0]
            found.append((float(entries.min()), float(entries.max())))
    return found


def make_gloss(gloss: GlossMaps, channels: Channels) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the blurred light as a flat array, the index at which each level begins, and the side of each level."""
    # Texels in the centre of a face are as wide as a row of the equirectangular maps is high.
    sides = [int(np.ceil(level.shape[0] * 2.0 / np.pi)) for level in gloss.levels]
    first = np.cumsum([0] + [FACES * (side + 2) ** 2 * 2 * channels.light for side in sides])
    flat, stored = on_cache_lines(first[-1]), len(channels.stored_from_light)
    for number, side in enumerate(sides):
        there = flat[first[number] : first[number + 1]].reshape(FACES, side + 2, side + 2, 2, channels.light)
        for place, level in enumerate((number, min(number + 1, len(sides) - 1))):
            for face, found in enumerate(from_equirectangular(gloss.levels[level], side)):
                there[face, :, :, place, :stored] = found @ channels.stored_from_light.T
            give_back(gloss.levels[level])
    return flat, indices(first[:-1] // (2 * channels.light)), np.array(sides, dtype=np.int32)


def make_query(flags: int) -> np.ndarray:
    """Return Embree's RTCIntersectArguments with flags, all features, no callbacks; the caller must keep the array."""
    query = np.zeros(16, dtype=np.uint32)
    query[0], query[1] = flags, 0xFFFFFFFF
    return query


def environment_fields(pyramid: CubePyramid, channels: Channels) -> dict:
    """Return the fields of a `PreparedWorld` that hold the environment."""
    return {
        "environment": pyramid.texels,
        "environment_first": indices(pyramid.first // channels.light),
        "environment_side": pyramid.side.astype(np.int32),
        "environment_levels": len(pyramid.side),
        "texels_per_rad": float(pyramid.side.max(initial=0) * np.sqrt(FACES / (4.0 * np.pi))),
    }


def _light_fields(light: Light, gloss: GlossMaps, pyramid: CubePyramid, channels: Channels) -> dict:
    """Return the fields of a `PreparedWorld` that hold environment, irradiance and blurred light."""
    irradiance, irradiance_side = make_irradiance(light, channels)
    blurred, gloss_first, gloss_side = make_gloss(gloss, channels)
    return environment_fields(pyramid, channels) | {
        "irradiance": irradiance,
        "irradiance_side": irradiance_side,
        "gloss": blurred,
        "gloss_first": gloss_first,
        "gloss_side": gloss_side,
        "gloss_levels": len(gloss_side),
        "gloss_level": float(gloss.first),
    }


def _surface_fields(objects: Objects, tracer: Tracer, channels: Channels, spare: int) -> dict:
    """Return the fields of a `PreparedWorld` that hold shapes and materials."""
    fields, surfaces = make_textures(objects, channels, spare), make_surfaces(tracer.placements)
    index = np.concatenate(
        [channels.index, np.repeat(channels.index[..., -1:], channels.surface - channels.count, axis=2)], axis=2
    )
    texels = sum(bordered_size(rows, columns) for columns, rows in objects.texture_size)
    scatters = fields["texels"].reshape(-1, channels.surface)[:texels, :-1].any()
    return fields | {
        "shape": make_shapes(tracer, objects),
        "objects": len(tracer.placements),
        "surfaces": surfaces,
        "first_face": surfaces.first_face[objects.shape],
        "brought_singly": sum(p.shape.kernels.point is None for p in tracer.placements),
        "scatters": int(scatters or fields["further"][: texels * FURTHER : 2].any()),
        "lobes": objects.lobes,
        "lobe": objects.lobe.ravel(),
        "rows": joined([joined_tables(objects.lobes).ravel()]),
        "ladder": ladder(objects.lobes).ravel(),
        "bounded": len(tracer.placements) if len(tracer.placements) <= _MOST_BOUNDED else 0,
        "index": index.astype(np.float32).ravel(),
        "scene": tracer.scene,
    }


def stored_from_xyz(channels: Channels) -> tuple[np.ndarray, np.ndarray]:
    """Return matrices from all lanes of stored light to XYZ, (3, lanes), and back, (lanes, 3).

    Lanes that hold no light of the environment are given those parts of XYZ that the others lack.
    """
    xyz, used = np.zeros((3, channels.light)), channels.xyz_from_light.shape[1]
    left, values, _ = np.linalg.svd(channels.xyz_from_light)
    spare = min(channels.light - used, 3)
    xyz[:, :used], xyz[:, used : used + spare] = channels.xyz_from_light, values.max() * left[:, 3 - spare :]
    return xyz, np.linalg.pinv(xyz)


def _by_lane(xyz: np.ndarray, lanes: int) -> np.ndarray:
    """Return X, Y, Z and 0 for each lane, flat, of a matrix to XYZ, (3, n)."""
    room = np.zeros((lanes, 4), np.float32)
    room[: xyz.shape[1], :3] = xyz.T
    return room.ravel()


def colour_fields(channels: Channels) -> dict:
    """Return the fields of a `PreparedWorld` with the matrices between stored light, channels and XYZ."""
    decode = padded(channels.colour_from_light, channels.light).reshape(channels.count, channels.light)
    return {
        "decode": padded(decode.T, channels.surface),
        "lamp_light": padded(channels.lamp_light, channels.surface),
        "lamp_colour": padded(channels.lamp_colour, channels.surface),
        "xyz_from_colour": _by_lane(channels.xyz_from_colour, channels.surface),
        "xyz_from_light": _by_lane(stored_from_xyz(channels)[0], channels.light),
    }


def make_world(
    objects: Objects,
    light: Light,
    gloss: GlossMaps,
    tracer: Tracer,
    channels: Channels,
    functions: tuple[int, int, int],
    *,
    spare: int,
    maps: LightMaps | None,
) -> PreparedWorld:
    """Return the scene as flat arrays for one representation of colour.

    Parameters
    ----------
    objects, light, gloss, tracer
        Parts of the scene; shape i of the tracer is object i.
    channels : Channels
    functions : (int, int, int)
        Addresses of rtcIntersect16, rtcOccluded16 and of their arguments.
    spare : int
        Number of additional texels to allocate.
    maps : LightMaps, optional
        Baked light on the objects.
    """
    columns, rows = light.size[0]
    picture = light.pixels[: columns * rows].reshape(rows, columns, light.pixels.shape[1])
    pyramid = environment_pyramid(picture, channels.stored_from_light, channels.light)
    fields = _light_fields(light, needed_gloss(gloss, objects), pyramid, channels)
    fields |= _surface_fields(objects, tracer, channels, spare) | colour_fields(channels)
    fields |= make_coats(objects, light, fields["irradiance_side"] if maps is None else 0)
    fields |= make_baked(maps, tracer.placements, objects.shape, channels)
    fields |= make_seen(maps, sides_placed(objects, tracer.placements), channels)
    fields |= {
        "intersect": functions[0],
        "occluded": functions[1],
        "query": functions[2],
    }
    return PreparedWorld(**fields)
