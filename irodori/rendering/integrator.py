"""The paper's ray tracer: irradiance map, sampled gloss, and mirror reflection traced to a limit [eq. 9]."""

import math

import numba
import numpy as np

from irodori.brdf import fresnel
from irodori.geometry.embree import Tracer, new_ray, trace
from irodori.rendering.scene import Light, Objects, View
from irodori.rendering.shading import (
    BANDS,
    add_ambient,
    add_gloss,
    add_light,
    frame,  # noqa: F401  numba's cache needs the callee importable
    hashed,
    map_irradiance,
    reflected_irradiance,
    surface,
)

#: Rays start this fraction of the scene's size above the surface they leave.
OFFSET = 1e-5


@numba.njit(cache=True)
def _shade(
    objects, light, tracing, buffers, index, point, normal, texel, view, counts, pixel, offset, irradiance, local
):
    """Fill the radiance that a point sends towards the viewer without its mirror term."""
    ambient_samples, gloss_samples = counts
    x, y, sample = pixel
    local[:] = 0.0
    map_irradiance(light, normal, irradiance)
    if ambient_samples > 0:
        add_ambient(
            objects,
            light,
            tracing,
            buffers,
            point,
            normal,
            ambient_samples,
            hashed(x, y, sample, 0),
            hashed(x, y, sample, 1),
            offset,
            irradiance,
        )
    reflected_irradiance(objects, light, index, normal, texel, irradiance, 1.0, True, local)
    bases = objects.texels.shape[1] - 2
    add_gloss(
        objects,
        light,
        tracing,
        buffers,
        index,
        point,
        normal,
        view,
        texel[bases],
        texel[bases + 1],
        gloss_samples,
        hashed(x, y, sample, 2),
        hashed(x, y, sample, 3),
        offset,
        local,
    )


@numba.njit(cache=True)
def _follow(objects, light, tracing, buffers, origin, d, counts, max_bounces, min_throughput, pixel, offset, work, out):
    """Add the radiance along one ray from the eye, mirror after mirror; return the number of surfaces met."""
    intersect, scene, address, at, f, i = tracing
    throughput, irradiance, local, texel, point, normal, view = work
    throughput[:] = 1.0
    for bounce in range(max_bounces + 1):
        trace(
            intersect,
            scene,
            address,
            at,
            f,
            i,
            origin[0],
            origin[1],
            origin[2],
            d[0],
            d[1],
            d[2],
            0.0,
            np.float32(np.inf),
        )
        index = i[at + 18]
        if index < 0:
            coefficients = np.zeros(light.basis.shape[1])
            add_light(light, 0, d[0], d[1], d[2], 1.0, coefficients)
            for band in range(BANDS):
                value = 0.0
                for b in range(coefficients.size):
                    value += light.basis[band, b] * coefficients[b]
                out[band] += throughput[band] * max(value, 0.0)
            return bounce
        for axis in range(3):
            point[axis] = origin[axis] + f[at + 8] * d[axis]
            view[axis] = -d[axis]
        surface(objects, index, point, normal, texel)
        cosine = normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2]
        if cosine <= 0.0:
            return bounce
        _shade(
            objects,
            light,
            tracing,
            buffers,
            index,
            point,
            normal,
            texel,
            view,
            counts,
            (pixel[0], pixel[1], pixel[2] * 32 + bounce),
            offset,
            irradiance,
            local,
        )
        largest = 0.0
        for band in range(BANDS):
            out[band] += throughput[band] * local[band]
            throughput[band] *= objects.mirror[index] * fresnel(cosine, objects.n[index, band], objects.k[index, band])
            largest = max(largest, throughput[band])
        if largest < min_throughput:
            return bounce + 1
        for axis in range(3):
            d[axis] = 2.0 * cosine * normal[axis] - view[axis]
            origin[axis] = point[axis] + offset * normal[axis]
    return max_bounces + 1


@numba.njit(cache=True, parallel=True, nogil=True)
def _render(
    objects,
    light,
    view,
    intersect,
    scene,
    first_row,
    counts,
    pixel_side,
    max_bounces,
    min_throughput,
    offset,
    image,
    met,
):
    for row in numba.prange(image.shape[0]):
        f = np.empty(64, np.float32)
        i = f.view(np.int32)
        address, at = new_ray(f, i)
        tracing = (intersect, scene, address, at, f, i)
        texel_size = objects.texels.shape[1]
        buffers = (
            np.empty(3),
            np.empty(3),
            np.empty(3),
            np.empty(3),
            np.empty(3),
            np.empty(texel_size),
            np.empty(BANDS),
        )
        work = (
            np.empty(BANDS),
            np.empty(BANDS),
            np.empty(BANDS),
            np.empty(texel_size),
            np.empty(3),
            np.empty(3),
            np.empty(3),
        )
        origin, d, total = np.empty(3), np.empty(3), np.empty(BANDS)
        y = first_row + row
        for x in range(view.width):
            total[:] = 0.0
            for s in range(pixel_side * pixel_side):
                px = (x + (s % pixel_side + 0.5) / pixel_side - 0.5 * view.width) / view.focal_px
                py = (y + (s // pixel_side + 0.5) / pixel_side - 0.5 * view.height) / view.focal_px
                scale = 1.0 / math.sqrt(px * px + py * py + 1.0)
                rotation = view.world_from_camera
                for a in range(3):
                    d[a] = (rotation[a, 0] * px + rotation[a, 1] * py + rotation[a, 2]) * scale
                    origin[a] = view.position_mm[a]
                met[row] += _follow(
                    objects,
                    light,
                    tracing,
                    buffers,
                    origin,
                    d,
                    counts,
                    max_bounces,
                    min_throughput,
                    (x, y, s),
                    offset,
                    work,
                    total,
                )
            for band in range(BANDS):
                image[row, x, band] = total[band] / (pixel_side * pixel_side)


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
        ``pixel_side`` (samples along each side of a pixel), ``ambient_samples``, ``gloss_samples``,
        ``max_bounces``, ``min_throughput``.

    Returns
    -------
    radiance : (rows, width, 61) float32
    met : int
        Surfaces shaded, for the count of rays: each costs 1 + ambient_samples + gloss_samples rays.
    """
    image = np.zeros((rows[1] - rows[0], view.width, BANDS), dtype=np.float32)
    met = np.zeros(len(image), dtype=np.int64)
    extent = np.abs(objects.translation_mm).max() + (objects.size_mm.max(axis=1) * objects.scale).max()
    size = float(extent + np.linalg.norm(view.position_mm))
    _render(
        objects,
        light,
        view,
        tracer.intersect_address,
        tracer.scene,
        rows[0],
        (options["ambient_samples"], options["gloss_samples"]),
        options["pixel_side"],
        options["max_bounces"],
        options["min_throughput"],
        OFFSET * size,
        image,
        met,
    )
    return image, int(met.sum())
