"""Means and variances of a row's pixels over sets of samples."""

import math

import numpy as np

from irodori.geometry.embree import new_ray
from irodori.jit.compilation import njit, uncounted
from irodori.rendering.reference.band_loops import BANDS, PADDED
from irodori.rendering.reference.paths import MIRRORED, follow
from irodori.rendering.reference.random_numbers import LENS, PIXEL, draw, pixel_key, stream_of
from irodori.rendering.reference.world import new_work
from irodori.rendering.view_cameras import aim

#: Paths summed in single precision: a sum of more grows until each further path is rounded the same way.
_TOGETHER = 256


@uncounted(forceinline=True)
def _render_pixel(world, ray, work, view, numbers, x, y, whole, mean, spread):
    """Add the means of a pixel's replicates, and their squares; return the number of paths that were cut.

    ``whole`` is a buffer, (61,) float64.
    """
    cut = 0
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
                if view.lens_mm > 0.0:
                    on_lens = (draw(numbers, stream, LENS), draw(numbers, stream, LENS + 1))
                aim(view, x + u, y + v, on_lens[0], on_lens[1], work.origin, work.direction)
                cut += follow(world, ray, work, numbers, stream, mirrored if sample % MIRRORED == 0 else 0.0)
            for band in range(BANDS):
                whole[band] += work.total[band]
        for band in range(BANDS):
            value = whole[band] / numbers.samples
            mean[band] += value
            spread[band] += value * value
    return cut


@njit(cache=True, nogil=True)
def render_some_rows(world, view, numbers, first_row, image, error, cut, first, last):
    """Fill rows ``first`` to ``last`` of a band of the picture that begins at ``first_row``.

    Parameters
    ----------
    world : World
    view : irodori.rendering.scene_arrays.View
    numbers : irodori.rendering.reference.random_numbers.Numbers
    first_row : int
    image, error : (rows, width, 61) float32
        Mean radiance, and the standard error of that mean by the spread of the replicates.
    cut : (rows,) int64
        Paths that were cut at `LONGEST` surfaces.
    """
    ray, work = new_ray(), new_work(world)
    whole, mean, spread = np.empty(BANDS), np.empty(BANDS), np.empty(BANDS)
    count = numbers.replicates
    for row in range(first, last):
        for x in range(view.width):
            mean[:] = 0.0
            spread[:] = 0.0
            cut[row] += _render_pixel(world, ray, work, view, numbers, x, first_row + row, whole, mean, spread)
            for band in range(BANDS):
                value = mean[band] / count
                image[row, x, band] = value
                error[row, x, band] = math.sqrt(max(spread[band] / count - value * value, 0.0) / (count - 1))
