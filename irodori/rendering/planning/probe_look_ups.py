"""Look-ups of a probe at the points that it meets: surfaces, textures, blurred light, lamps, occlusion.

Arrays of points in NumPy, in double precision and 61 bands: the terms of the interactive integrator, one by one, so
that each can be left out.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.geometry.embree import Tracer, hit_distance, hit_shape, new_ray, trace
from irodori.geometry.shape_dispatch import chain
from irodori.geometry.shape_registry import number_of
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape_rows import CENTRE, KIND, shape_row
from irodori.geometry.surfaces import face_viewer, make_surfaces, surface_at
from irodori.jit.compilation import njit
from irodori.light.gloss.gloss_maps import GlossMaps
from irodori.light.irradiance import irradiance_at
from irodori.reflection.equation5 import angles_from_directions
from irodori.reflection.fresnel import fresnel
from irodori.reflection.lobes import Lobes, constants, features, value
from irodori.rendering.interactive.round_lobes import (
    ANGLES,
    ROUGHNESSES,
    TAPS,
    gloss_power,
    lobe_table,
    roughness_place,
)
from irodori.rendering.scene_arrays import Light, Objects
from irodori.spectra.grid import SAMPLES

#: Rays start this part of the coordinates' size above the surface they leave: single precision.
_RISE = 1e-5


class Points(NamedTuple):
    """Where rays meet surfaces; of rays that meet nothing, or a back, ``shape`` is -1, or -2."""

    shape: np.ndarray  # (n,)
    distance: np.ndarray  # (n,) mm
    point: np.ndarray  # (n, 3) mm
    normal: np.ndarray  # (n, 3)
    facet: np.ndarray  # (n, 3)
    uv: np.ndarray  # (n, 2)
    cosine: np.ndarray  # (n,) with the way back


@njit(cache=True)
def _meet(surfaces, intersect, scene, origin, direction, shape, distance, point, normal, facet, uv, cosine):
    ray = new_ray()
    for r in range(shape.size):
        trace(intersect, scene, ray, origin[r], direction[r], np.inf)
        shape[r] = hit_shape(ray)
        if shape[r] < 0:
            continue
        distance[r] = hit_distance(ray)
        for axis in range(3):
            point[r, axis] = origin[r, axis] + distance[r] * direction[r, axis]
        uv[r, 0], uv[r, 1] = surface_at(surfaces, shape[r], ray, point[r], normal[r], facet[r])
        cosine[r] = face_viewer(normal[r], facet[r], direction[r])
        if cosine[r] <= 0.0:
            shape[r] = -2


def meet(tracer: Tracer, origin: np.ndarray, direction: np.ndarray) -> Points:
    """Return what rays meet first, (n, 3) mm and unit vectors."""
    count = len(origin)
    found = Points(
        np.empty(count, dtype=np.int64),
        np.zeros(count),
        *(np.zeros((count, 3)) for _ in range(3)),
        np.zeros((count, 2)),
        np.zeros(count),
    )
    surfaces = make_surfaces(list(tracer.placements))
    _meet(surfaces, tracer.intersect_address, tracer.scene, origin, direction, *found)
    return found


def raised(points: Points) -> np.ndarray:
    """Return where rays leave surfaces, (n, 3) mm."""
    reach = np.abs(points.point).max(axis=1, keepdims=True) + points.distance[:, None]
    return points.point + _RISE * reach * points.facet


@njit(cache=True)
def _fresnel_rows(cosine, which, n, k, out):
    for r in range(cosine.size):
        for band in range(n.shape[1]):
            out[r, band] = fresnel(cosine[r], n[which[r], band], k[which[r], band])


def fresnel_rows(cosine: np.ndarray, shape: np.ndarray, objects: Objects) -> np.ndarray:
    """Return the Fresnel reflectance of objects at cosines of incidence, (n, 61)."""
    out = np.empty((len(cosine), SAMPLES))
    _fresnel_rows(np.ascontiguousarray(cosine, dtype=np.float64), shape, objects.n, objects.k, out)
    return out


def texture_of(objects: Objects, index: int) -> np.ndarray:
    """Return an object's texels, (rows, columns, k + 2 c)."""
    columns, rows = objects.texture_size[index]
    first = objects.first_texel[index]
    return objects.texels[first : first + rows * columns].reshape(rows, columns, -1)


def coarser(texture: np.ndarray, level: int) -> np.ndarray:
    """Return a texture whose texels are the means of squares of 2**level texels, fewer at the ends."""
    side = 2**level
    if level == 0:
        return texture
    rows, columns = (np.arange(0, size, side) for size in texture.shape[:2])
    sums = np.add.reduceat(np.add.reduceat(texture, rows, axis=0, dtype=np.float64), columns, axis=1)
    counts = np.outer(
        np.diff(np.append(rows, texture.shape[0])),
        np.diff(np.append(columns, texture.shape[1])),
    )
    return (sums / counts[..., None]).astype(np.float32)


def texels_at(texture: np.ndarray, uv: np.ndarray, wraps: bool) -> np.ndarray:
    """Return a texture between its texels' centres, (n, k + 2 c) float64; edges hold, joined sides join."""
    rows, columns = texture.shape[:2]
    x, y = uv[:, 0] * columns - 0.5, np.clip(uv[:, 1] * rows - 0.5, 0.0, rows - 1.0)
    if not wraps:
        x = np.clip(x, 0.0, columns - 1.0)
    left, upper = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - left)[:, None], (y - upper)[:, None]
    a, b, lower = left % columns, (left + 1) % columns, np.minimum(upper + 1, rows - 1)
    if not wraps:
        b = np.minimum(left + 1, columns - 1)
    texture = texture.astype(np.float64, copy=False) if texture.size < uv.size else texture
    top = texture[upper, a] * (1 - fx) + texture[upper, b] * fx
    return top * (1 - fy) + (texture[lower, a] * (1 - fx) + texture[lower, b] * fx) * fy


def rows_by_lobe(objects: Objects, shape: np.ndarray, component: int) -> list[tuple[str, np.ndarray]]:
    """Return, for each lobe that a gloss component of some hits has, its name and which hits, (n,) bool."""
    which = objects.lobe[shape, component]
    return [(objects.lobes.names[number], which == number) for number in np.unique(which)]


def powers(objects: Objects, shape: np.ndarray, pairs: list[tuple[np.ndarray, np.ndarray]]) -> list[np.ndarray]:
    """Return the power of each gloss component at hits, (n,), from its β and μ; see `round_lobes.gloss_power`."""
    found = []
    for component, (beta, mu) in enumerate(pairs):
        power = np.zeros(len(shape))
        for name, chosen in rows_by_lobe(objects, shape, component):
            power[chosen] = gloss_power(beta[chosen], mu[chosen], name)
        found.append(power)
    return found


def lobe_entries(name: str, mu: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """Return the entries of lobes in the table of `irodori.rendering.interactive.round_lobes`, (parts, n, ENTRY)."""
    table = lobe_table(name).entries.astype(np.float64)
    x, y = np.sqrt(cosine) * (ANGLES - 1), np.clip(roughness_place(mu, name), 0, ROUGHNESSES - 1)
    column, row = np.minimum(x.astype(int), ANGLES - 2), np.minimum(y.astype(int), ROUGHNESSES - 2)
    fx, fy = (x - column)[:, None], (y - row)[:, None]
    top = table[:, row, column] * (1 - fx) + table[:, row, column + 1] * fx
    return top * (1 - fy) + (table[:, row + 1, column] * (1 - fx) + table[:, row + 1, column + 1] * fx) * fy


def lobes(
    maps: GlossMaps, objects: Objects, points: Points, direction: np.ndarray, component: int, mu: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the round lobes of a gloss component of hits in the blurred light.

    Returns
    -------
    light : (n, lobes, k) float64, coefficients
    weight : (n, lobes) float64
        For a power of 1, without the Fresnel reflectance.
    cos_h : (n,) float64
        Mean cosine of the incidence at which the lobes are reflected.
    """
    named = rows_by_lobe(objects, points.shape, component)
    most = TAPS * max(len(lobe_table(name).entries) for name, _ in named)
    light, weight = np.zeros((len(mu), most, maps.levels[0].shape[2])), np.zeros((len(mu), most))
    cos_h = np.zeros(len(mu))
    for name, chosen in named:
        own = Points(*(field[chosen] for field in points))
        found, weights, cosines = _lobes(maps, own, direction[chosen], lobe_entries(name, mu[chosen], own.cosine))
        light[chosen, : found.shape[1]], weight[chosen, : found.shape[1]] = found, weights
        cos_h[chosen] = np.sum(weights * cosines, axis=1) / np.maximum(weights.sum(axis=1), 1e-300)
    return light, weight, np.clip(cos_h, 0.0, 1.0)


def _lobes(maps: GlossMaps, points: Points, direction: np.ndarray, entries: np.ndarray):
    """Return light (n, lobes, k), weights (n, lobes) and cosθ_H (n, lobes) of the rows of entries of one lobe."""
    mirrored = direction + 2.0 * points.cosine[:, None] * points.normal
    sine2, light, last = 1.0 - points.cosine**2, [], len(maps.levels) - 1
    for row in entries:
        level = np.clip(row[:, 0] - maps.first, 0, last)
        lower = np.minimum(level.astype(int), last)
        upper, mix = np.minimum(lower + 1, last), (level - lower)[:, None]
        for tap in range(TAPS):
            p = row[:, 2 + 3 * tap]
            q = np.sqrt(np.maximum(1.0 - p * p * sine2, 0.0)) - p * points.cosine
            axis = p[:, None] * mirrored + q[:, None] * points.normal
            found = np.zeros((len(p), maps.levels[0].shape[2]))
            for at, share in ((lower, 1.0 - mix), (upper, mix)):
                for number in np.unique(at):
                    chosen = at == number
                    found[chosen] += share[chosen] * irradiance_at(maps.levels[number], axis[chosen])
            light.append(found)
    weight, cosines = (
        np.concatenate([row[:, first : 1 + 3 * TAPS : 3] for row in entries], axis=1) for first in (1, 3)
    )
    return np.stack(light, axis=1), weight, cosines


_hides = chain("hides", "row, at, x, y, z, normal", __name__)


@njit(cache=True)
def _hide(row, point, normal, share, facing):
    for r in range(share.size):
        x, y, z = row[CENTRE] - point[r, 0], row[CENTRE + 1] - point[r, 1], row[CENTRE + 2] - point[r, 2]
        about = (normal[r, 0], normal[r, 1], normal[r, 2])
        share[r], side = _hides(row[KIND], row, 0, x, y, z, about)
        facing[r, 0], facing[r, 1], facing[r, 2] = side[0], side[1], side[2]


def _hidden(placement: Placement, points: Points) -> tuple[np.ndarray, np.ndarray]:
    """Return the share that a shape hides, (n,), and the normal of its side that faces each point, or zeros, (n, 3)."""
    share, facing = np.zeros(len(points.shape)), np.zeros((len(points.shape), 3))
    reach = placement.shape.reach_mm * placement.scale
    row = shape_row(placement, reach, number_of(placement.shape), np.float64)
    _hide(row, points.point, points.normal, share, facing)
    return share, facing


class Ambient(NamedTuple):
    """Light from all sides where objects hide it; the rows of ``reflected`` are those of points that see an object."""

    seen: np.ndarray  # (n,) share of the irradiance map's light
    reflected: list[tuple[int, np.ndarray, np.ndarray]]  # object, rows, coefficients of the irradiance of its side


def ambient(tracer: Tracer, light: Light, points: Points) -> Ambient:
    """Return what objects in closed form hide of the light from all sides at points, and what they reflect instead."""
    count = len(points.shape)
    seen, hidden, found = np.ones(count), np.zeros(count), []
    for shape, placement in enumerate(tracer.placements):
        share, facing = _hidden(placement, points)
        share[(points.shape == shape) | (share <= 0.0)] = 0.0
        seen *= 1.0 - share
        hidden += share
        rows = np.flatnonzero((share > 0.0) & facing.any(axis=1))
        if rows.size:
            found.append((shape, rows, share[rows, None] * irradiance_of(light, facing[rows])))
    scale = np.divide(1.0 - seen, hidden, out=np.zeros(count), where=hidden > 0.0)
    return Ambient(seen, [(shape, rows, scale[rows, None] * values) for shape, rows, values in found])


def irradiance_of(light: Light, normals: np.ndarray) -> np.ndarray:
    """Return coefficients of the irradiance of normals, (n, k)."""
    columns, rows = light.irradiance_size
    return irradiance_at(light.irradiance.reshape(rows, columns, -1), normals)


def sky_of(light: Light, direction: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Return coefficients of the environment's radiance from directions at levels of its ladder, (n, k)."""
    out = np.zeros((len(direction), light.pixels.shape[1]))
    for number in np.unique(level):
        columns, rows = light.size[number]
        first = light.first_pixel[number]
        picture = light.pixels[first : first + rows * columns].reshape(rows, columns, -1)
        chosen = level == number
        out[chosen] = irradiance_at(picture, direction[chosen])
    return out


@njit(cache=True, error_model="numpy")
def _highlights(lobes, angles, mu, free, which, n, k, out):
    for r in range(mu.size):
        if not free[r]:
            continue
        cosines = math.cos(angles[r, 0]), math.cos(angles[r, 1]), math.cos(angles[r, 3]), math.cos(angles[r, 2])
        factor, f0, f1, f2 = features(lobes, cosines[0], cosines[1], cosines[2], cosines[3], angles[r, 3])
        found = factor * value(lobes, constants(lobes, math.log(mu[r])), f0, f1, f2)
        for band in range(n.shape[1]):
            out[r, band] = found * fresnel(cosines[3], n[which[r], band], k[which[r], band])


class Lit(NamedTuple):
    """What collimated lamps give at points: the diffuse term's light over π; by component, gloss for a power of 1."""

    diffuse: np.ndarray  # (n, 61)
    gloss: list[np.ndarray]  # of (n, 61)


def lamps_at(
    tracer: Tracer,
    objects: Objects,
    points: Points,
    direction: np.ndarray,
    roughness: list[np.ndarray],
    towards: np.ndarray,
    spectra: np.ndarray,
) -> Lit:
    """Return what lamps, (m, 3) directions and (m, 61) irradiances, give at points with hard shadows."""
    count = len(points.shape)
    found = Lit(np.zeros((count, SAMPLES)), [np.zeros((count, SAMPLES)) for _ in roughness])
    start = raised(points)
    for axis, spectrum in zip(towards, spectra, strict=True):
        cosine = points.normal @ axis
        free = (cosine > 0.0) & (points.facet @ axis > 0.0)
        free[free] = ~tracer.occluded(start[free], np.repeat(axis[None], free.sum(), axis=0))
        found.diffuse[...] += np.where(free, cosine, 0.0)[:, None] * spectrum / np.pi
        angles = angles_from_directions(points.normal, axis, -direction)
        for component, (mu, gloss) in enumerate(zip(roughness, found.gloss, strict=True)):
            for name, chosen in rows_by_lobe(objects, points.shape, component):
                values = np.zeros((count, SAMPLES))
                _highlights(Lobes((name,)), angles, mu, free & chosen, points.shape, objects.n, objects.k, values)
                power = gloss_power(np.ones(count), mu, name)
                gloss[chosen] += (values * spectrum / np.pi / power[:, None])[chosen]
    return found
