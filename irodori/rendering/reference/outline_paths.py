"""Pixels at outlines, which get more paths than others.

Where the paths of a pixel meet different things, their mean depends on how evenly the pixel is covered, and no
neighbour shows the same mixture: a filter cannot help. Whether a pixel is at an outline is decided by what its four
corners show, directly or in mirrors, not by its own paths: their mean would otherwise depend on their number.
"""

from typing import NamedTuple

import numpy as np

from irodori.geometry.embree import NO_HIT, hit_distance, hit_shape, new_ray, trace
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit
from irodori.reflection.fresnel import fresnel
from irodori.rendering.reference.world import World
from irodori.rendering.scene_arrays import View
from irodori.rendering.view_cameras import aim

#: Paths of a pixel at an outline, as a multiple of those of other pixels.
MORE = 4
_MIRRORS = 3  # that are looked into one after another
_CLEAR = 0.1  # reflectance from which on a mirror is looked into
_GREEN = 30  # band of that reflectance
_SAME = 0.8  # least cosine between the normals of one surface
_STEP = 0.25  # largest squared sine of the angle between a surface and the line that joins two of its points
_ABOVE = 1e-5  # height at which rays leave a mirror, relative to their length
_CHUNK = 1024


class _Eye(NamedTuple):
    """Camera and scene, for compiled loops."""

    camera: View
    intersect: int
    scene: int
    mirror: np.ndarray  # (objects,)
    n: np.ndarray  # (objects,) refractive index n, k in one band
    k: np.ndarray


class _Sights(NamedTuple):
    """Shapes and mirrors that points of a picture show."""

    place: np.ndarray  # (points, 2) px
    number: np.ndarray  # (points,) int64 of the surfaces, one after another
    normal: np.ndarray  # (points, 3) of the last, unit, zeros without one
    hit: np.ndarray  # (points, 3) mm, on the last


@njit(cache=True, nogil=True)
def _look_at_some(eye, sights, first, last):
    """Fill what the points from ``first`` to before ``last`` show; corners are seen through the middle of a lens."""
    ray, origin, direction, normal = new_ray(), np.empty(3), np.empty(3), np.empty(3)
    count = eye.mirror.size
    for point in range(first, last):
        aim(eye.camera, (sights.place[point, 0], sights.place[point, 1]), (0.0, 0.0), origin, direction)
        number = np.int64(0)
        for _ in range(_MIRRORS + 1):
            trace(eye.intersect, eye.scene, ray, origin, direction, np.inf)
            shape = np.int64(hit_shape(ray))
            number = number * 65_536 + shape + 1
            for axis in range(3):
                sights.normal[point, axis] = 0.0
            if shape == NO_HIT or shape >= count:
                break
            square, cosine, distance = 0.0, 0.0, np.float64(hit_distance(ray))
            for axis in range(3):
                normal[axis] = ray.f[ray.at + 12 + axis]
                square += normal[axis] * normal[axis]
            for axis in range(3):
                normal[axis] /= np.sqrt(square)
                cosine -= normal[axis] * direction[axis]
                origin[axis] += distance * direction[axis]
                sights.normal[point, axis], sights.hit[point, axis] = normal[axis], origin[axis]
            if eye.mirror[shape] < _CLEAR or cosine <= 0.0:
                break
            if eye.mirror[shape] * fresnel(cosine, eye.n[shape], eye.k[shape]) < _CLEAR:
                break
            for axis in range(3):
                direction[axis] += 2.0 * cosine * normal[axis]
                origin[axis] += _ABOVE * distance * normal[axis]
        sights.number[point] = number


@njit(cache=True, nogil=True)
def _differ(sights, one, other):
    """Return whether two corners show different things, or parts of one surface that are not beside each other."""
    if sights.number[one] != sights.number[other]:
        return True
    cosine, along, apart, whole = 0.0, 0.0, 0.0, 0.0
    for axis in range(3):
        a, b = sights.normal[one, axis], sights.normal[other, axis]
        step = sights.hit[other, axis] - sights.hit[one, axis]
        cosine += a * b
        along += step * (a + b)
        apart += step * step
        whole += (a + b) * (a + b)
    return whole > 0.0 and (cosine < _SAME or along * along > _STEP * apart * whole)


@njit(cache=True, nogil=True)
def _mark_some(sights, corners, out, first, last):
    """Mark the pixels from ``first`` to before ``last`` whose corners, given by number, show different things."""
    for pixel in range(first, last):
        for one in range(4):
            for other in range(one):
                if not out[pixel] and _differ(sights, corners[pixel, one], corners[pixel, other]):
                    out[pixel] = True


def at_outlines(world: World, view: View, places: np.ndarray) -> np.ndarray:
    """Return which pixels have corners that show different things, (rows, width) bool.

    Parameters
    ----------
    world : World
    view : View
    places : (rows, width, 2) int64
        Columns and rows of the pixels; corners that pixels share are looked at once.
    """
    top, step = int(places[..., 1].min()), view.width + 1
    corners = (places[..., 1:] - top + (0, 0, 1, 1)) * step + places[..., :1] + (0, 1, 0, 1)
    number = np.zeros(corners.max() + 1, np.int64)
    number[corners] = 1
    points = np.flatnonzero(number)
    number[points] = np.arange(len(points))
    sights = _Sights(
        np.stack([points % step, top + points // step], axis=1).astype(np.float64),
        np.zeros(len(points), np.int64),
        *np.zeros((2, len(points), 3)),
    )
    objects = world.objects
    n, k = (np.ascontiguousarray(one[:, _GREEN]) for one in (objects.n, objects.k))
    eye = _Eye(view, world.intersect, world.scene, objects.mirror[: world.placed], n, k)
    run_chunks(_look_at_some, len(points), _CHUNK, eye, sights)
    out = np.zeros(places.shape[0] * places.shape[1], dtype=np.bool_)
    run_chunks(_mark_some, len(out), 4 * _CHUNK, sights, number[corners].reshape(-1, 4), out)
    return out.reshape(places.shape[:2])
