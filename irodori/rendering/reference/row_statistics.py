"""Rendering of a row's pixels: means over their paths, and variances between independent sets of samples."""

import math
from typing import NamedTuple

import numpy as np

from irodori.geometry.embree import new_ray
from irodori.jit.compilation import njit, uncounted
from irodori.jit.references import address_of, at_address
from irodori.rendering.reference.band_loops import BANDS, PADDED
from irodori.rendering.reference.glints import AIMED, Glints, fill_glint_shares, weight_in_pixel
from irodori.rendering.reference.paths import MIRRORED, follow
from irodori.rendering.reference.random_numbers import (
    DIMENSIONS,
    LENS,
    PIXEL,
    Numbers,
    draw,
    fill_shifts,
    pixel_key,
    stream_of,
)
from irodori.rendering.reference.sun_images import draw_image, has_images, pick_chain
from irodori.rendering.reference.world import SEEN, World, new_work
from irodori.rendering.scene_arrays import View
from irodori.rendering.view_cameras import aim

#: Paths summed in single precision; in larger sums, the rounding errors of single paths would accumulate.
_TOGETHER = 256


class Sampling(NamedTuple):
    """Scene, view and random numbers for path tracing."""

    world: World
    camera: View
    numbers: Numbers
    glints: Glints


class Rows(NamedTuple):
    """Pixels to render, a band of a picture's rows or a column of single pixels, and arrays for their results."""

    places: np.ndarray  # (rows, width, 2) int64 column and row in the picture
    more: np.ndarray  # (rows, width) bool: whether the pixel has the most samples
    image: np.ndarray  # (rows, width, 61) float32 mean radiance
    #: (rows, width, 61) float32 standard error of that mean by the spread of the replicates, or (rows, width, 1) its
    #: root mean square over the bands.
    error: np.ndarray
    difference: np.ndarray  # (rows, width, 61) float32 half the difference of the means, first set less last set
    seen: np.ndarray  # (rows, width, SEEN) float32 mean features of the paths' first hits
    cut: np.ndarray  # (rows,) int64 paths that were cut at `LONGEST` surfaces
    paths: np.ndarray  # (rows,) int64 paths that were followed


class _Sums(NamedTuple):
    """Buffers of a pixel; spectra are padded to 64 bands, float64."""

    replicate: np.ndarray  # (replicates, 64) mean of the samples of each
    mean: np.ndarray  # (64,) mean of the replicates
    spread: np.ndarray  # (64,) squared standard error of that mean by their differences
    shifts: np.ndarray  # (DIMENSIONS,) uint32 of the points of random numbers


@uncounted(forceinline=True, fastmath={"contract", "reassoc", "nsz"})
def _summarise(sums):
    """Fill the mean of the replicates and its squared standard error."""
    count = sums.replicate.shape[0]
    share, mean, spread = 1.0 / count, sums.mean, sums.spread
    for band in range(PADDED):
        mean[band] = spread[band] = 0.0
    for number in range(count):
        values = sums.replicate[number]
        for band in range(PADDED):
            mean[band] += share * values[band]
    share /= count - 1
    for number in range(count):
        values = sums.replicate[number]
        for band in range(PADDED):
            spread[band] += share * (values[band] - mean[band]) ** 2


@uncounted(forceinline=True)
def _aim_near_glint(sampling, work, pixel, place, on_lens):
    """Aim a path of a pixel with glints at one of them or anywhere; return the path's weight.

    ``pixel`` has column and row, ``place`` two random numbers in [0, 1), of which both ways use even parts.
    """
    world, camera, (x, y), (u, v) = sampling.world, sampling.camera, pixel, place
    if u < AIMED:
        aim(camera, (x + 0.5, y + 0.5), on_lens, work.origin, work.direction)
        chain, u = pick_chain(work.glint, u / AIMED)
        if not draw_image(world.images, world.sky, chain, (u, v), work, work.direction):
            return 0.0
    else:
        aim(camera, (x + (u - AIMED) / (1.0 - AIMED), y + v), on_lens, work.origin, work.direction)
    return weight_in_pixel(world.images, camera, sampling.glints, pixel, work)


@uncounted(forceinline=True)
def _render_pixel(sampling, ray, work, pixel, samples, sums):
    """Trace all paths of a pixel, fill the replicates' means, and return the number of cut paths.

    ``pixel`` has column and row; ``samples`` is the number of paths of a replicate.
    """
    world, camera, numbers, glints = sampling.world, sampling.camera, sampling.numbers, sampling.glints
    (x, y), cut = pixel, 0
    has_glints = has_images(world.images) and fill_glint_shares(world.images, glints, x, y, work.glint)
    size, share = numbers.points.shape[1], 1.0 / samples
    mirrored = samples / ((samples + MIRRORED - 1) // MIRRORED)
    for replicate in range(numbers.replicates):
        key, whole = pixel_key(x, y, replicate, numbers.seed), sums.replicate[replicate]
        for band in range(PADDED):
            whole[band] = 0.0
        for first in range(0, samples, _TOGETHER):
            for band in range(PADDED):
                work.total[band] = np.float32(0.0)
            for sample in range(first, min(first + _TOGETHER, samples)):
                if sample % size == 0:
                    fill_shifts(numbers, (x, y, samples), replicate, sample // size, sums.shifts)
                stream = stream_of(numbers, key, replicate, sample, sums.shifts)
                u, v = draw(numbers, stream, PIXEL), draw(numbers, stream, PIXEL + 1)
                on_lens = (0.0, 0.0)
                if camera.lens_mm > 0.0:
                    on_lens = (draw(numbers, stream, LENS), draw(numbers, stream, LENS + 1))
                weight = 1.0
                if has_glints:
                    weight = _aim_near_glint(sampling, work, (x, y), (u, v), on_lens)
                else:
                    aim(camera, (x + u, y + v), on_lens, work.origin, work.direction)
                if weight > 0.0:
                    seldom = mirrored if sample % MIRRORED == 0 else 0.0
                    cut += follow(world, ray, work, (numbers, stream), seldom, weight)
            for band in range(PADDED):
                whole[band] += share * work.total[band]
    return cut


@uncounted(fastmath={"contract", "reassoc", "nsz"})
def _render_each(sampling_at, work_at, rows, buffers, first, last):
    sampling, work, by_band = at_address(sampling_at), at_address(work_at), rows.error.shape[2] == BANDS
    (ray, sums), count = buffers, sampling.numbers.replicates
    for row in range(first, last):
        for x in range(rows.places.shape[1]):
            for part in range(SEEN):
                work.seen[part] = 0.0
            column, line = rows.places[row, x, 0], rows.places[row, x, 1]
            samples = sampling.numbers.most if rows.more[row, x] else sampling.numbers.samples
            rows.cut[row] += _render_pixel(sampling, ray, work, (column, line), samples, sums)
            rows.paths[row] += count * samples
            share = 1.0 / (count * samples)
            for part in range(SEEN):
                rows.seen[row, x, part] = work.seen[part] * share
            _summarise(sums)
            image, difference = rows.image[row, x], rows.difference[row, x]
            one, other = sums.replicate[0], sums.replicate[count - 1]
            for band in range(BANDS):
                image[band] = sums.mean[band]
            for band in range(BANDS):
                difference[band] = 0.5 * (one[band] - other[band])
            if by_band:
                error = rows.error[row, x]
                for band in range(BANDS):
                    error[band] = math.sqrt(sums.spread[band])
            else:
                whole = 0.0
                for band in range(BANDS):
                    whole += sums.spread[band]
                rows.error[row, x, 0] = math.sqrt(whole / BANDS)


@uncounted()
def _render_rows(sampling, work, rows, buffers, first, last):
    _render_each(address_of(sampling), address_of(work), rows, buffers, first, last)


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def render_some_rows(sampling, rows, first, last):
    """Render the rows from ``first`` to before ``last`` of `Rows`."""
    count = sampling.numbers.replicates
    sums = _Sums(np.empty((count, PADDED)), np.empty(PADDED), np.empty(PADDED), np.empty(DIMENSIONS, np.uint32))
    _render_rows(sampling, new_work(sampling.world), rows, (new_ray(), sums), first, last)
