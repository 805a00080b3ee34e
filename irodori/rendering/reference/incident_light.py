"""Irradiance at given points of surfaces by path tracing, against which light maps are checked [eq. 8].

From each point, one direction is sampled from the environment and one by the cosine, and paths continue from there as
those of a picture do. The result is the radiance of a perfect diffuser at the point, irradiance / π. On a surface with
a coupled coat, light counts by the share that passes the coat at its angle.
"""

from typing import NamedTuple

import numpy as np

from irodori.core.progress import LOGGER
from irodori.geometry.embree import new_ray
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit, uncounted
from irodori.jit.references import address_of, at_address
from irodori.rendering.compiled_calls import resolved
from irodori.rendering.reference.band_loops import BANDS, PADDED
from irodori.rendering.reference.converging_picture import TracedScene
from irodori.rendering.reference.paths import gather
from irodori.rendering.reference.random_numbers import (
    DIMENSIONS,
    Numbers,
    fill_shifts,
    make_numbers,
    pixel_key,
    stream_of,
)
from irodori.rendering.reference.world import new_work

_REPLICATES = 2
_CHUNK = 64  # places that a thread takes at a time


class Places(NamedTuple):
    """Points on surfaces, raised to the height at which rays start, with buffers for the results."""

    point: np.ndarray  # (n, 3) mm
    normal: np.ndarray  # (n, 3) unit, of shading
    facet: np.ndarray  # (n, 3) unit, of the surface itself
    surface: np.ndarray  # (n,) int64 side of a shape on which each point lies
    key: np.ndarray  # (n,) int64, not negative, selects the random numbers
    halves: np.ndarray  # (2, n, 61) float32 irradiance / π from each half of the paths
    cut: np.ndarray  # (n,) int64 paths that were cut
    lamps: bool  # whether direct light of the scene's lights other than the environment is added


@uncounted()
def _gather_each(world_at, work_at, task, buffers, first, last):
    world, work, (ray, whole, shifts) = at_address(world_at), at_address(work_at), buffers
    numbers, places = task
    size = numbers.points.shape[1]
    for place in range(first, last):
        for replicate in range(_REPLICATES):
            key = pixel_key(places.key[place], 0, replicate, numbers.seed)
            for band in range(BANDS):
                whole[band] = 0.0
            for sample in range(numbers.samples):
                if sample % size == 0:
                    own = (places.key[place], 0, numbers.samples)
                    fill_shifts(numbers, own, replicate, sample // size, shifts)
                for axis in range(3):
                    work.point[axis] = places.point[place, axis]
                    work.normal[axis] = places.normal[place, axis]
                    work.facet[axis] = places.facet[place, axis]
                for band in range(PADDED):
                    work.total[band] = np.float32(0.0)
                stream, start = (
                    stream_of(numbers, key, replicate, sample, shifts),
                    (places.surface[place], places.lamps),
                )
                places.cut[place] += gather(world, ray, work, numbers, stream, start)
                for band in range(BANDS):
                    whole[band] += work.total[band]
            for band in range(BANDS):
                places.halves[replicate, place, band] = whole[band] / numbers.samples


@uncounted()
def _gather_range(world, work, task, buffers, first, last):
    _gather_each(address_of(world), address_of(work), task, buffers, first, last)


@njit(cache=True, nogil=True)
def _gather_at_some(world, numbers, places, first, last):
    """Trace the paths of the points from ``first`` to before ``last`` and fill their ``halves``."""
    buffers = new_ray(), np.empty(BANDS), np.empty(DIMENSIONS, np.uint32)
    _gather_range(world, new_work(world), (numbers, places), buffers, first, last)


def incident_light(
    scene: TracedScene,
    surface: int | np.ndarray,
    point: np.ndarray,
    normal: np.ndarray,
    facet: np.ndarray,
    *,
    samples: int,
    seed: int = 0,
) -> np.ndarray:
    """Return the light on points of surfaces, as the radiance of a perfect diffuser there, in two halves of paths.

    Of the scene's own lights, only what other surfaces reflect is included.

    Parameters
    ----------
    scene : TracedScene
    surface : int or (n,) int
        Side of a shape on which the points lie, see `irodori.rendering.scene_arrays.Objects`.
    point, normal, facet : (n, 3) float
        Points in mm, unit shading normals and unit normals of the surface itself.
    samples : int
        Paths per point, a multiple of 2.
    seed : int, from 0

    Returns
    -------
    (2, n, 61) float32, irradiance / π from two independent halves of the paths
    """
    places = make_places(scene, surface, point, normal, facet)
    return light_at(scene, places, make_numbers(samples, seed, _REPLICATES))


def make_places(scene: TracedScene, surface, point: np.ndarray, normal: np.ndarray, facet: np.ndarray) -> Places:
    """Return the places of `incident_light`, without direct light of the scene's own lights."""
    reach = np.abs(point).sum(axis=1, keepdims=True)
    count = len(point)
    own = np.broadcast_to(surface, count)
    offset = scene.world.offset_mm[scene.world.objects.shape[own], None]
    raised = point + (offset + scene.world.steps * reach) * facet
    return Places(
        np.ascontiguousarray(raised, dtype=np.float64),
        np.ascontiguousarray(normal, dtype=np.float64),
        np.ascontiguousarray(facet, dtype=np.float64),
        np.array(own, dtype=np.int64),
        # Places of other surfaces have other numbers.
        own * (1 << 24) + np.arange(count),
        np.zeros((_REPLICATES, count, BANDS), dtype=np.float32),
        np.zeros(count, dtype=np.int64),
        False,
    )


def gathering_loop(scene: TracedScene, places: Places, numbers: Numbers):
    """Return the compiled loop of `light_at`, whose argument types take a millisecond to determine."""
    return resolved(_gather_at_some, scene.world, numbers, places, 0, 0)


def light_at(scene: TracedScene, places: Places, numbers: Numbers, loop=None) -> np.ndarray:
    """Trace the paths from places, each with the samples of ``numbers``; return the result of `incident_light`.

    ``loop`` is that of `gathering_loop`, if there is one already for a scene with arrays of the same types.
    """
    count = len(places.point)
    places = places._replace(halves=np.zeros_like(places.halves), cut=np.zeros(count, dtype=np.int64))
    run_chunks(loop or gathering_loop(scene, places, numbers), count, _CHUNK, scene.world, numbers, places)
    if places.cut.any():
        LOGGER.warning("%d paths were cut: the light is too dark by what they would have brought", places.cut.sum())
    return places.halves
