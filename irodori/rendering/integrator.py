"""The paper's ray tracer: irradiance map, sampled gloss, and mirror reflection traced to a limit [eq. 9]."""

from typing import NamedTuple

import numba
import numpy as np

from irodori.brdf import fresnel
from irodori.geometry.embree import Tracer, hit_distance, hit_shape, new_ray, trace
from irodori.geometry.surfaces import Surfaces, face_viewer, make_surfaces
from irodori.native import run_chunks, uncounted
from irodori.rendering.cameras import aim
from irodori.rendering.scene import Light, Objects, View
from irodori.rendering.shading import (
    BANDS,
    World,
    add_diffuse,
    add_gloss,
    add_light,
    add_spectrum,
    fill_irradiance,
    hashed,
    hide_and_reflect,
    new_scratch,
    stratum,
    surface,
)

#: Rays start this fraction of the scene's size above the surface they leave.
OFFSET = 1e-5
_STREAMS = 32  # more than the bounces that a scene may ask for
_LENS = -1  # the stream of places on a lens, which no sample of a pixel has


class Sampling(NamedTuple):
    """How finely to render.

    ``pixel_side`` rays along each side of a pixel; rays a shading point for hidden light and for gloss; mirror
    reflections to follow; and the throughput under which a path ends.
    """

    pixel_side: int
    ambient_samples: int
    gloss_samples: int
    max_bounces: int
    min_throughput: float


class Path(NamedTuple):
    """Buffers of one thread for the path from the eye."""

    origin: np.ndarray  # (3,)
    direction: np.ndarray  # (3,)
    point: np.ndarray  # (3,)
    normal: np.ndarray  # (3,)
    facet: np.ndarray  # (3,)
    to_eye: np.ndarray  # (3,)
    texel: np.ndarray  # (k + 2,)
    throughput: np.ndarray  # (61,)
    irradiance: np.ndarray  # (61,)
    radiance: np.ndarray  # (61,)


@numba.njit(cache=True)
def _new_path(world):
    return Path(
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(world.objects.texels.shape[1]),
        np.empty(BANDS),
        np.empty(BANDS),
        np.empty(BANDS),
    )


@numba.njit(cache=True)
def _shade(world, ray, scratch, path, index, sampling, pixel):
    """Fill ``path.radiance`` with what the path's point sends towards the viewer without its mirror term."""
    x, y, stream = pixel
    path.radiance[:] = 0.0
    fill_irradiance(world.light, path.normal, scratch.light, scratch.decoded, path.irradiance)
    if sampling.ambient_samples > 0:
        shift = (hashed(x, y, stream, 0), hashed(x, y, stream, 1))
        at = (path.point, path.normal, path.facet)
        hide_and_reflect(world, ray, scratch, at[0], at[1], at[2], sampling.ambient_samples, shift, path.irradiance)
    add_diffuse(world.objects, index, path.texel, path.irradiance, 1.0, scratch.decoded, path.radiance)
    shift = (hashed(x, y, stream, 2), hashed(x, y, stream, 3))
    gloss = (path.texel[path.texel.size - 2], path.texel[path.texel.size - 1])
    at = (path.point, path.normal, path.facet)
    samples = sampling.gloss_samples
    add_gloss(world, ray, scratch, index, at[0], at[1], at[2], path.to_eye, gloss, samples, shift, path.radiance)


@numba.njit(cache=True)
def _follow(world, ray, scratch, path, sampling, pixel, out):
    """Add the radiance along one ray from the eye, mirror after mirror; return the number of surfaces shaded."""
    objects, d = world.objects, path.direction
    path.throughput[:] = 1.0
    for bounce in range(sampling.max_bounces + 1):
        trace(world.intersect, world.scene, ray, path.origin, d, np.inf)
        index = hit_shape(ray)
        if index < 0:
            scratch.light[:] = 0.0
            path.radiance[:] = 0.0
            add_light(world.light, 0, d[0], d[1], d[2], 1.0, scratch.light)
            add_spectrum(world.light.basis, scratch.light, scratch.decoded, path.radiance)
            for band in range(BANDS):
                out[band] += path.throughput[band] * path.radiance[band]
            return bounce
        for axis in range(3):
            path.point[axis] = path.origin[axis] + hit_distance(ray) * d[axis]
            path.to_eye[axis] = -d[axis]
        surface(world, index, ray, path.point, path.normal, path.facet, path.texel)
        cosine = face_viewer(path.normal, path.facet, d)
        if cosine <= 0.0:
            return bounce
        _shade(world, ray, scratch, path, index, sampling, (pixel[0], pixel[1], pixel[2] * _STREAMS + bounce))
        largest = 0.0
        for band in range(BANDS):
            out[band] += path.throughput[band] * path.radiance[band]
            mirror = objects.mirror[index] * fresnel(cosine, objects.n[index, band], objects.k[index, band])
            path.throughput[band] *= mirror
            largest = max(largest, path.throughput[band])
        if largest < sampling.min_throughput:
            return bounce + 1
        for axis in range(3):
            d[axis] = 2.0 * cosine * path.normal[axis] - path.to_eye[axis]
            path.origin[axis] = path.point[axis] + world.offset_mm * path.facet[axis]
    return sampling.max_bounces + 1


@uncounted()
def _render_row(world, ray, scratch, path, total, view, sampling, y, row):
    """Fill a row of the picture; return the number of points shaded."""
    side = sampling.pixel_side
    samples = side * side
    shaded = 0
    for x in range(view.width):
        total[:] = 0.0
        shift = (hashed(x, y, _LENS, 0), hashed(x, y, _LENS, 1))
        for s in range(samples):
            u, v = stratum(s, samples, shift)
            px, py = x + (s % side + 0.5) / side, y + (s // side + 0.5) / side
            aim(view, px, py, u, v, path.origin, path.direction)
            shaded += _follow(world, ray, scratch, path, sampling, (x, y, s), total)
        for band in range(BANDS):
            row[x, band] = total[band] / samples
    return shaded


@numba.njit(cache=True, nogil=True)
def _render(world, view, sampling, first_row, image, shaded, first, last):
    ray, scratch, path, total = new_ray(), new_scratch(world), _new_path(world), np.empty(BANDS)
    for row in range(first, last):
        shaded[row] = _render_row(world, ray, scratch, path, total, view, sampling, first_row + row, image[row])


def render_rows(
    objects: Objects, light: Light, view: View, tracer: Tracer, rows: tuple[int, int], options: dict
) -> tuple[np.ndarray, int]:
    """Render a band of rows of a view.

    Parameters
    ----------
    objects, light, view : the flat scene, see `irodori.rendering.scene`
    tracer : Tracer
        Shape i is object i.
    rows : (int, int)
        First and last-plus-one row.
    options : dict
        The fields of `Sampling`; others are ignored.

    Returns
    -------
    radiance : (rows, width, 61) float32
    shaded : int
        Points shaded, for the count of rays: each costs 1 + ambient_samples + gloss_samples rays.
    """
    image = np.zeros((rows[1] - rows[0], view.width, BANDS), dtype=np.float32)
    shaded = np.zeros(len(image), dtype=np.int64)
    surfaces: Surfaces = make_surfaces(tracer.placements)
    extent = np.abs(surfaces.translation_mm).max() + (surfaces.size_mm.max(axis=1) * surfaces.scale).max()
    size = float(extent + np.linalg.norm(view.position_mm))
    world = World(surfaces, objects, light, tracer.intersect_address, tracer.scene, OFFSET * size)
    sampling = Sampling(**{name: options[name] for name in Sampling._fields})
    # Rows differ much in cost: handed out one by one, no thread waits for the half with the objects.
    run_chunks(_render, len(image), 1, world, view, sampling, rows[0], image, shaded)
    return image, int(shaded.sum())
