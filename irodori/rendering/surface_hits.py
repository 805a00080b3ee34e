"""Surface data at a ray's hit: interpolated texel, normals and tangent frame."""

import math
from typing import NamedTuple

import numpy as np

from irodori.geometry.surfaces import surface_at
from irodori.jit.compilation import njit


class StackedPicture(NamedTuple):
    """One of several pictures stored after each other in an array."""

    pixels: np.ndarray  # (all pixels, k) float
    first: int  # index of the first pixel of this picture
    width: int
    height: int


@njit(cache=True, forceinline=True)
def frame(normal):
    """Return two unit vectors perpendicular to a normal (Duff et al. 2017, without a branch at the pole)."""
    sign = math.copysign(1.0, normal[2])
    a = -1.0 / (sign + normal[2])
    b = normal[0] * normal[1] * a
    tangent = 1.0 + sign * normal[0] ** 2 * a, sign * b, -sign * normal[0]
    return tangent, (b, sign + normal[1] ** 2 * a, -normal[1])


@njit(cache=True, forceinline=True)
def _interpolate(picture, u, v, out):
    """Interpolate a picture bilinearly at u, v in 0..1; columns wrap around, rows end."""
    pixels, first, width, height = picture
    x, y = u * width - 0.5, min(max(v * height - 0.5, 0.0), height - 1.0)
    x0, y0 = math.floor(x), int(y)
    fx, fy = x - x0, y - y0
    left, right = int(x0) % width, (int(x0) + 1) % width
    below = min(y0 + 1, height - 1)
    a, b = first + y0 * width + left, first + y0 * width + right
    c, d = first + below * width + left, first + below * width + right
    wa, wb, wc, wd = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    for i in range(out.size):
        out[i] = wa * pixels[a, i] + wb * pixels[b, i] + wc * pixels[c, i] + wd * pixels[d, i]


@njit(cache=True, forceinline=True)
def surface(world, index, ray, work):
    """Move a hit point onto its surface; fill its normals and its interpolated texel, and return which side is seen.

    If the back of a sheet faces the eye, that side is seen, and normals and texel are those of the back.

    Parameters
    ----------
    world : NamedTuple
        Has ``surfaces`` (`irodori.geometry.surfaces.Surfaces`) and ``objects``
        (`irodori.rendering.scene_arrays.Objects`) in the same order.
    index : int
        Number of the surface that was hit.
    ray : as in `irodori.geometry.embree.trace`
    work : irodori.rendering.reference.world.Work
        Its ``point`` is moved; ``normal`` (for shading), ``facet`` (of the surface itself) and ``texel`` are filled,
        for a sheet also ``through_texel``. It has the direction ``to_eye``.
    """
    u, v = surface_at(world.surfaces, index, ray, work.point, work.normal, work.facet)
    work.place[0], work.place[1] = u, v
    objects, side = world.objects, np.int64(index)
    if objects.behind[index] >= 0:
        facet, normal, eye = work.facet, work.normal, work.to_eye
        if facet[0] * eye[0] + facet[1] * eye[1] + facet[2] * eye[2] < 0.0:
            side = objects.behind[index]
            for axis in range(3):
                facet[axis], normal[axis] = -facet[axis], -normal[axis]
    width, height = objects.texture_size[side, 0], objects.texture_size[side, 1]
    if objects.wraps[side] == 0:
        # Columns that do not wrap: stay half a texel inside the texture's edges.
        u = min(max(u, 0.5 / width), 1.0 - 0.5 / width)
    _interpolate(StackedPicture(objects.texels, objects.first_texel[side], width, height), u, v, work.texel)
    sent = objects.through[side]
    if sent >= 0:
        _interpolate(StackedPicture(objects.texels, objects.first_texel[sent], width, height), u, v, work.through_texel)
    return side
