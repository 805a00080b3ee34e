"""Probe rays through random pixels, whose light is kept term by term.

Every term is kept with the throughput that brings it to the eye, so that the picture without it, or with a coarser one,
is a sum over what is left. Nothing of the renderer that is being planned is run.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from irodori.geometry.embree import Tracer
from irodori.light.gloss.gloss_maps import GlossMaps
from irodori.rendering.interactive.channels import mean_spectra
from irodori.rendering.interactive.round_lobes import TAPS
from irodori.rendering.planning.probe_look_ups import (
    Ambient,
    Lit,
    Points,
    ambient,
    coarser,
    fresnel_rows,
    irradiance_of,
    lamps_at,
    lobes,
    meet,
    powers,
    raised,
    sky_of,
    texels_at,
    texture_of,
)
from irodori.rendering.scene_arrays import Light, Objects, View, coefficients_of, gloss_of
from irodori.rendering.single_pixels import pixel_view
from irodori.rendering.view_cameras import ORTHOGRAPHIC
from irodori.spectra.grid import SAMPLES

#: A path whose mirrors pass less than this is not followed: single precision.
_NOTHING = 1e-7
#: Levels by which the probes' sky is finer than their cones: the map of a coarser picture has its texels elsewhere.
_FINER = 2


class Scene(NamedTuple):
    """What probes travel in.

    ``gloss`` is the environment blurred, from a small picture of it: it weighs the lobes, and no more. ``ambient`` says
    whether objects hide light from all sides.
    """

    objects: Objects
    light: Light
    gloss: GlossMaps | None
    tracer: Tracer
    lamp_towards: np.ndarray  # (m, 3)
    lamp_spectra: np.ndarray  # (m, 61)
    ambient: bool


class Hits(NamedTuple):
    """Surfaces that the probes meet after as many mirrors as there are columns in ``passed``."""

    probe: np.ndarray  # (n,)
    throughput: np.ndarray  # (n, 61)
    passed: np.ndarray  # (n, mirrors) objects whose mirrors the path came by
    points: Points
    texel: np.ndarray  # (n, k + 2 c)
    irradiance: np.ndarray  # (n, k) coefficients
    ambient: Ambient | None
    lit: Lit | None
    gloss: list[tuple[np.ndarray, np.ndarray, np.ndarray]]  # by component: light of the lobes, weights, reflectance


class Misses(NamedTuple):
    """Probes that meet the environment."""

    probe: np.ndarray
    throughput: np.ndarray
    passed: np.ndarray
    direction: np.ndarray  # (n, 3)
    level: np.ndarray  # (n,) of the environment's ladder that is finer than the ray's cone


class Probes(NamedTuple):
    """Probes of a scene."""

    count: int
    views: int  # probe i is of view i modulo this
    scene: Scene
    hits: list[Hits]  # one for each number of mirrors
    misses: list[Misses]
    mean: list[np.ndarray]  # mean reflectance of each object, (61,)
    textures: dict[tuple[int, int], np.ndarray]  # those that were halved so far


@dataclass(frozen=True)
class Changes:
    """What a picture is computed without, or more coarsely; by default nothing.

    Parameters
    ----------
    max_bounces : int, optional
    least_throughput : float
    without_gloss, without_mirror : frozenset of int
        Objects.
    light_basis : (k, 61), optional
        That stands for the environment's basis: what is left of it on fewer vectors.
    sky_level : int
        Finest level of the environment's ladder.
    texture_level : dict
        Object -> level, halvings of its texture.
    reflected_basis : (m, 61), optional
        On which light is thrown from object to object.
    """

    max_bounces: int | None = None
    least_throughput: float = 0.0
    without_gloss: frozenset = frozenset()
    without_mirror: frozenset = frozenset()
    light_basis: np.ndarray | None = None
    sky_level: int = 0
    texture_level: dict = field(default_factory=dict)
    reflected_basis: np.ndarray | None = None


def trace_probes(scene: Scene, views: list[View], count: int, max_bounces: int, seed: int) -> Probes:
    """Send rays through random points of pictures and follow them from mirror to mirror.

    Parameters
    ----------
    scene : Scene
    views : list of View
        Which have equal shares of the rays.
    count : int
        Rays.
    max_bounces : int
        Mirrors that are followed.
    seed : int
    """
    rng = np.random.default_rng(seed)
    origin, direction = np.empty((2, count, 3))
    cone, spread = np.zeros((2, count))
    for probe in range(count):
        view = views[probe % len(views)]
        x, y = rng.random(2) * (view.width, view.height)
        seen = pixel_view(view, x, y)
        origin[probe], direction[probe] = seen.position_mm, seen.world_from_camera[:, 2]
        (cone if view.kind == ORTHOGRAPHIC else spread)[probe] = 1.0 / view.focal_px
    probe, throughput = np.arange(count), np.ones((count, SAMPLES))
    passed = np.zeros((count, 0), dtype=np.int64)
    hits, misses = [], []
    for bounce in range(max_bounces + 1):
        points = meet(scene.tracer, origin, direction)
        missed = points.shape == -1
        level = _level(scene.light, spread)
        misses.append(Misses(*(a[missed] for a in (probe, throughput, passed, direction, level))))
        met = points.shape >= 0
        points = Points(*(a[met] for a in points))
        probe, throughput, passed = probe[met], throughput[met], passed[met]
        origin, direction, cone, spread = origin[met], direction[met], cone[met], spread[met]
        hits.append(_shaded(scene, probe, throughput, passed, points, direction))
        if bounce == max_bounces or not probe.size:
            break
        cone = cone + points.distance * spread
        spread = spread + cone * _curvature(scene.tracer)[points.shape]
        reflectance = fresnel_rows(points.cosine, points.shape, scene.objects)
        throughput = throughput * scene.objects.mirror[points.shape, None] * reflectance
        going = throughput.max(axis=1) > _NOTHING
        passed = np.concatenate([passed, points.shape[:, None]], axis=1)[going]
        origin = raised(points)[going]
        direction = (direction + 2.0 * points.cosine[:, None] * points.normal)[going]
        probe, throughput, cone, spread = probe[going], throughput[going], cone[going], spread[going]
        if not probe.size:
            break
    return Probes(count, len(views), scene, hits, misses, mean_spectra(scene.objects), {})


def _level(light: Light, spread: np.ndarray) -> np.ndarray:
    """Return the level that is as wide as cones, less `_FINER`."""
    pitch = np.pi / light.size[0, 1]
    return np.clip(np.log2(np.maximum(spread / pitch, 1.0)).astype(int) - _FINER, 0, len(light.size) - 1)


def _curvature(tracer: Tracer) -> np.ndarray:
    return np.array([p.shape.curvature_per_mm(p.scale) for p in tracer.placements])


def _texture(objects: Objects, index: int, level: int, known: dict) -> np.ndarray:
    if level == 0:
        return texture_of(objects, index)
    if (index, level) not in known:
        known[index, level] = coarser(texture_of(objects, index), level)
    return known[index, level]


def _texels(objects: Objects, points: Points, texture_level: dict, known: dict) -> np.ndarray:
    out = np.zeros((len(points.shape), objects.texels.shape[1]))
    for index in map(int, np.unique(points.shape)):
        chosen = points.shape == index
        texture = _texture(objects, index, texture_level.get(index, 0), known)
        out[chosen] = texels_at(texture, points.uv[chosen], objects.wraps[index] == 1)
    return out


def _shaded(scene: Scene, probe, throughput, passed, points: Points, direction) -> Hits:
    """Look up what surfaces send back."""
    texel = _texels(scene.objects, points, {}, {})
    roughness = [np.where(mu > 0, mu, 1.0) for _, mu in gloss_of(scene.objects, texel)]
    hidden = ambient(scene.tracer, scene.light, points) if scene.ambient and points.shape.size else None
    irradiance = irradiance_of(scene.light, points.normal)
    if hidden is not None:
        irradiance = hidden.seen[:, None] * irradiance
    lit = None
    if len(scene.lamp_spectra):
        lamps = (scene.lamp_towards, scene.lamp_spectra)
        lit = lamps_at(scene.tracer, scene.objects, points, direction, roughness, *lamps)
    gloss = []
    if scene.gloss is not None and points.shape.size:
        for component, mu in enumerate(roughness):
            light, weight, cos_h = lobes(scene.gloss, scene.objects, points, direction, component, mu)
            gloss.append((light, weight, fresnel_rows(cos_h, points.shape, scene.objects)))
    return Hits(probe, throughput, passed, points, texel, irradiance, hidden, lit, gloss)


def radiance(probes: Probes, changes: Changes = Changes()) -> np.ndarray:
    """Return the radiance of every probe, (count, 61) float64, of the picture with changes."""
    out = np.zeros((probes.count, SAMPLES))
    for bounce, (hits, misses) in enumerate(zip(probes.hits, probes.misses, strict=True)):
        if changes.max_bounces is not None and bounce > changes.max_bounces:
            break
        basis = probes.scene.light.basis if changes.light_basis is None else changes.light_basis
        stays = _stays(misses, changes, bounce)
        if stays.any():
            level = np.maximum(misses.level[stays], changes.sky_level)
            sky = sky_of(probes.scene.light, misses.direction[stays], level) @ basis
            np.add.at(out, misses.probe[stays], misses.throughput[stays] * sky)
        if hits.probe.size:
            stays = _stays(hits, changes, bounce)
            found = _reflected(probes, hits, basis, changes)
            np.add.at(out, hits.probe[stays], hits.throughput[stays] * found[stays])
    return out


def _stays(events, changes: Changes, bounce: int) -> np.ndarray:
    stays = np.ones(len(events.probe), dtype=bool)
    if bounce and changes.least_throughput > 0.0:
        stays &= events.throughput.max(axis=1) > changes.least_throughput
    for index in changes.without_mirror:
        stays &= ~(events.passed == index).any(axis=1)
    return stays


def _reflected(probes: Probes, hits: Hits, basis: np.ndarray, changes: Changes) -> np.ndarray:
    """Return what surfaces send towards the eye without their mirrors, (n, 61)."""
    objects, shape = probes.scene.objects, hits.points.shape
    texel = (
        _texels(objects, hits.points, changes.texture_level, probes.textures) if changes.texture_level else hits.texel
    )
    surface = np.einsum("pk,pkl->pl", coefficients_of(objects, texel), objects.basis[shape])
    light = hits.irradiance @ basis / np.pi
    if hits.ambient is not None:
        for index, rows, coefficients in hits.ambient.reflected:
            thrown = (coefficients @ basis) * probes.mean[index] / np.pi
            if changes.reflected_basis is not None:
                thrown = thrown @ np.linalg.pinv(changes.reflected_basis) @ changes.reflected_basis
            light[rows] += thrown
    glossy = ~np.isin(shape, list(changes.without_gloss))
    power = [glossy * own for own in powers(objects, shape, gloss_of(objects, texel))]
    out = np.zeros_like(light)
    if hits.lit is not None:
        light = light + hits.lit.diffuse
        for own, gloss in zip(power, hits.lit.gloss, strict=True):
            out += own[:, None] * gloss
    for own, (lobe, weight, reflectance) in zip(power, hits.gloss, strict=False):
        strength = weight * own[:, None] * (hits.throughput * reflectance).max(axis=1, keepdims=True)
        weight = np.where(strength > changes.least_throughput / TAPS, weight, 0.0) * own[:, None]
        out += np.einsum("pt,ptk->pk", weight, lobe) @ basis * reflectance
    return out + surface * light
