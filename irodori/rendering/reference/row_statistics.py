"""Rendering of a row's pixels: means over their paths, and variances between independent sets of samples."""

import math
from typing import NamedTuple

import numpy as np

from irodori.geometry.embree import new_ray
from irodori.jit.compilation import njit, uncounted
from irodori.rendering.reference.band_loops import BANDS, PADDED
from irodori.rendering.reference.glints import AIMED, Glints, fill_glint_shares, weight_in_pixel
from irodori.rendering.reference.paths import MIRRORED, follow
from irodori.rendering.reference.random_numbers import LENS, PIXEL, Numbers, draw, pixel_key, stream_of
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
    image: np.ndarray  # (rows, width, 61) float32 mean radiance
    error: np.ndarray  # (rows, width, 61) float32 standard error of that mean by the spread of the replicates
    difference: np.ndarray  # (rows, width, 61) float32 half the difference of the means, first set less last set
    seen: np.ndarray  # (rows, width, SEEN) float32 mean features of the paths' first hits
    cut: np.ndarray  # (rows,) int64 paths that were cut at `LONGEST` surfaces


class _Sums(NamedTuple):
    """Sums of a pixel, (61,) float64 each."""

    replicate: np.ndarray  # over the samples of one
    mean: np.ndarray  # over the means of the replicates
    square: np.ndarray  # over their squares
    difference: np.ndarray  # half the first's mean less half the last's


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
def _render_pixel(sampling, ray, work, x, y, sums):
    """Trace all paths of a pixel, add replicate means and their squares to sums, return the number of cut paths."""
    (world, camera, numbers, glints), whole, cut = sampling, sums.replicate, 0
    has_glints = has_images(world.images) and fill_glint_shares(world.images, glints, x, y, work.glint)
    mirrored = numbers.samples / ((numbers.samples + MIRRORED - 1) // MIRRORED)
    for replicate in range(numbers.replicates):
        key = pixel_key(x, y, replicate, numbers.seed)
        whole[:] = 0.0
        for first in range(0, numbers.samples, _TOGETHER):
            for band in range(PADDED):
                work.total[band] = np.float32(0.0)
            for sample in range(first, min(first + _TOGETHER, numbers.samples)):
                stream = stream_of(numbers, key, replicate, sample)
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
            for band in range(BANDS):
                whole[band] += work.total[band]
        for band in range(BANDS):
            value = whole[band] / numbers.samples
            sums.mean[band] += value
            sums.square[band] += value * value
            if replicate == 0:
                sums.difference[band] += 0.5 * value
            if replicate == numbers.replicates - 1:
                sums.difference[band] -= 0.5 * value
    return cut


@njit(cache=True, nogil=True)
def render_some_rows(sampling, rows, first, last):
    """Render the rows from ``first`` to before ``last`` of `Rows`."""
    ray, work = new_ray(), new_work(sampling.world)
    sums, count = _Sums(np.empty(BANDS), np.empty(BANDS), np.empty(BANDS), np.empty(BANDS)), sampling.numbers.replicates
    for row in range(first, last):
        for x in range(rows.places.shape[1]):
            sums.mean[:] = 0.0
            sums.square[:] = 0.0
            sums.difference[:] = 0.0
            work.seen[:] = 0.0
            column, line = rows.places[row, x, 0], rows.places[row, x, 1]
            rows.cut[row] += _render_pixel(sampling, ray, work, column, line, sums)
            for part in range(SEEN):
                rows.seen[row, x, part] = work.seen[part] / (count * sampling.numbers.samples)
            for band in range(BANDS):
                value = sums.mean[band] / count
                rows.difference[row, x, band] = sums.difference[band]
                rows.image[row, x, band] = value
                spread = max(sums.square[band] / count - value * value, 0.0)
                rows.error[row, x, band] = math.sqrt(spread / (count - 1))
