"""Filling of the light cache of a scene, see `irodori.rendering.reference.light_cache`."""

from typing import NamedTuple

import numpy as np

from irodori.geometry.embree import NO_HIT, hit_shape, new_ray, trace
from irodori.geometry.shapes.placement import Placement
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit
from irodori.rendering.map_layouts import Layout, Points, make_layout
from irodori.rendering.reference.band_loops import padded
from irodori.rendering.reference.converging_picture import TracedScene
from irodori.rendering.reference.incident_light import gathering_loop, light_at, make_places
from irodori.rendering.reference.light_cache import Cache
from irodori.rendering.reference.random_numbers import make_numbers

#: Paths from each texel in each pass, and the seed of the first.
_PASSES, _SEED = (4, 8, 8), 401
#: Share of a picture's paths that the cache may cost; its cost in paths, to prepare it and for each texel.
_SHARE, _TO_PREPARE, _EACH = 0.2, 5_000, 24
#: Texels of a surface, at least and at most.
_FEWEST, _MOST = 16, 4096
#: Triangles of a mesh for each texel that it may have, beyond which it has none: laying them out would take long.
_FACES = 64
#: Area in which a path may have arrived, in squares of a texel's side, from which on the texel is used.
_LEAST_TEXELS = 4.0
#: Directions from a texel in which surfaces that are met from behind tell that it lies inside another object.
_LOOKS, _ENCLOSED, _CHUNK = 8, 7, 256


class _Texels(NamedTuple):
    """Texels of one surface."""

    layout: Layout
    most: int
    points: Points
    numbers: np.ndarray | None  # (nodes of the layout,) texel that stands for each node of a mesh; None for pictures
    side_mm: np.ndarray  # (texels,) length of their sides


class _Looks(NamedTuple):
    """Rays from texels, for compiled loops."""

    intersect: int
    scene: int
    has_inside: np.ndarray  # (surfaces,) bool
    point: np.ndarray  # (n, 3) mm
    direction: np.ndarray  # (n, looks, 3) unit


@njit(cache=True, nogil=True)
def _look_some(looks, behind, first, last):
    """Count the rays of the texels from ``first`` to before ``last`` that meet a surface from behind."""
    ray = new_ray()
    for texel in range(first, last):
        for number in range(looks.direction.shape[1]):
            direction = looks.direction[texel, number]
            trace(looks.intersect, looks.scene, ray, looks.point[texel], direction, np.inf)
            shape = hit_shape(ray)
            if shape == NO_HIT or not looks.has_inside[shape]:
                continue
            towards = 0.0
            for axis in range(3):
                towards += ray.f[ray.at + 12 + axis] * direction[axis]
            behind[texel] += int(towards > 0.0)


def _enclosed(scene: TracedScene, point: np.ndarray, facet: np.ndarray) -> np.ndarray:
    """Return whether points, raised above their surfaces, lie inside other objects, (n,) bool."""
    number = np.arange(_LOOKS) + 0.5
    z, azimuth = 1.0 - 2.0 * number / _LOOKS, np.pi * (1.0 + np.sqrt(5.0)) * number
    sphere = np.stack([np.sqrt(1.0 - z * z) * np.cos(azimuth), np.sqrt(1.0 - z * z) * np.sin(azimuth), z], axis=1)
    way = facet[:, None] + 0.99 * sphere
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    shapes = [placement.shape for placement in scene.tracer.placements]
    inside = np.array([shape.has_inside or shape.triangles is not None for shape in shapes])
    behind = np.zeros(len(point), dtype=np.int64)
    rays = scene.world.intersect, scene.world.scene, inside, np.ascontiguousarray(point), np.ascontiguousarray(way)
    run_chunks(_look_some, len(point), _CHUNK, _Looks(*rays), behind)
    return behind >= _ENCLOSED


def _sides(layout: Layout, most: int, point: np.ndarray) -> np.ndarray:
    """Return the sides of the texels of a picture, mm: the larger distance to a neighbour in its row and column."""
    rows, columns = layout.size(most)
    grid = point.reshape(rows, columns, 3)
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1) for axis in (0, 1)]
    side = np.zeros((rows, columns))
    for axis, step in enumerate(steps):
        for part in (slice(1, None), slice(None, -1)):
            place = (part, slice(None)) if axis == 0 else (slice(None), part)
            side[place] = np.maximum(side[place], step)
    return side.ravel()


def _texels(placements: list[Placement], index: int, most: int) -> _Texels | None:
    """Return the texels of a surface; None for a mesh whose vertices are too many to be looked through."""
    layout, mesh = make_layout(placements, index), placements[index].shape.triangles
    if mesh is not None and len(mesh.faces) > _FACES * most:
        return None
    points = layout.points(most)
    if mesh is None:
        return _Texels(layout, most, points, None, _sides(layout, most, points.point))
    count, numbers = len(points.point), np.arange(len(points.point))
    if count > 2 * most:
        from scipy.spatial import cKDTree

        chosen = np.random.default_rng(_SEED).permutation(count)[:most]
        reach = placements[index].shape.reach_mm * placements[index].scale
        place = np.concatenate([points.point, 0.1 * reach * points.normal], axis=1)
        numbers = cKDTree(place[chosen]).query(place)[1]
        points = Points(*(values[chosen] for values in points))
    world = placements[index].points(mesh.vertices_mm)[mesh.faces]
    area = 0.5 * np.linalg.norm(np.cross(world[:, 1] - world[:, 0], world[:, 2] - world[:, 0]), axis=1).sum()
    side = np.full(len(points.point), np.sqrt(area / len(points.point)))
    return _Texels(layout, most, points, numbers, side)


def with_cache(scene: TracedScene, paths: int) -> TracedScene:
    """Return a scene with a filled cache for a picture of a number of paths, if it is worth the time.

    The number of paths determines that of the texels. If too few of them fit into the share of the time that the cache
    may take, the scene is returned as it is.
    """
    placements = list(scene.tracer.placements)[: scene.world.placed]
    share = (_SHARE * paths - _TO_PREPARE) / (_EACH * max(len(placements), 1))
    if share < _FEWEST:
        return scene
    most = int(min(share, _MOST))
    is_sheet = scene.world.objects.behind[: len(placements)] >= 0
    found = [None if is_sheet[index] else _texels(placements, index, most) for index in range(len(placements))]
    if not any(found):
        return scene
    cache, points, surface = _laid_out(scene, found)
    places, numbers = make_places(scene, surface, *points)._replace(lamps=True), make_numbers(max(_PASSES), _SEED, 2)
    world, loop = scene.world, gathering_loop(scene, places, numbers)
    for number, samples in enumerate(_PASSES):
        own = numbers._replace(samples=samples // 2, seed=_SEED + number)
        light = light_at(scene._replace(world=world), places, own, loop)
        world = scene.world._replace(cache=cache._replace(light=padded(light)))
    return scene._replace(world=world)


def _laid_out(scene: TracedScene, found: list[_Texels | None]) -> tuple[Cache, Points, np.ndarray]:
    """Return a cache without light, the places of its texels, and the surface of each."""
    placements, count = scene.tracer.placements, len(found)
    numbers = np.array([len(one.side_mm) if one else 0 for one in found])
    first = np.cumsum(numbers) - numbers
    size, wraps, grid = np.zeros((count, 2), np.int64), np.zeros(count, np.int64), np.zeros((count, 4))
    parts, corners = [np.zeros(0, np.int32)], [np.zeros(0, np.int32)]
    for index, one in enumerate(found):
        if one is None:
            mesh = placements[index].shape.triangles
            parts.append(np.zeros(0 if mesh is None else len(mesh.faces), np.int32))
            continue
        if one.numbers is not None:
            own_parts, own_corners = one.layout.triangles(one.most)
            parts.append(own_parts)
            corners.append(one.numbers[own_corners].astype(np.int32))
            continue
        size[index], wraps[index] = one.layout.size(one.most), int(placements[index].shape.wraps)
        grid[index] = one.layout.grid
        away = placements[index].translation_mm - placements[index].shape.frame_origin(placements[index])
        grid[index, :2] -= (away @ placements[index].rotation)[:2] if grid[index, 2] > 0.0 else 0.0
    points = Points(*(np.concatenate([getattr(one.points, name) for one in found if one]) for name in Points._fields))
    surface = np.repeat(np.arange(count), numbers)
    least = _LEAST_TEXELS * np.concatenate([one.side_mm for one in found if one]) ** 2
    offset = scene.world.offset_mm[surface, None] + scene.world.steps * np.abs(points.point).sum(axis=1, keepdims=True)
    least[_enclosed(scene, points.point + offset * points.facet, points.facet)] = np.inf
    sides = np.concatenate(parts)
    sizes = (sides.astype(np.int64) + 1) * (sides + 2) // 2
    cache = Cache(
        np.zeros((2, 0, 64), np.float32),
        least.astype(np.float32),
        np.where(numbers > 0, first, -1),
        size,
        wraps,
        grid,
        sides,
        np.cumsum(sizes) - sizes,
        np.concatenate(corners),
    )
    return cache, points, surface
