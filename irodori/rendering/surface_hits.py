"""Surface data at a ray's hit: interpolated texel, normals and tangent frame."""

import math

from irodori.geometry.surfaces import surface_at
from irodori.jit.compilation import njit
from irodori.light.equirectangular import StackedPicture


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
    """Move a hit point onto its surface; fill its normals and its interpolated texel.

    Parameters
    ----------
    world : NamedTuple
        Has ``surfaces`` (`irodori.geometry.surfaces.Surfaces`) and ``objects``
        (`irodori.rendering.scene_arrays.Objects`) in the same order.
    index : int
        Number of the surface that was hit.
    ray : as in `irodori.geometry.embree.trace`
    work : irodori.rendering.reference.world.Work
        Its ``point`` is moved; ``normal`` (for shading), ``facet`` (of the surface itself) and ``texel`` are filled.
    """
    u, v = surface_at(world.surfaces, index, ray, work.point, work.normal, work.facet)
    objects = world.objects
    width, height = objects.texture_size[index, 0], objects.texture_size[index, 1]
    if objects.wraps[index] == 0:
        # Columns that do not wrap: stay half a texel inside the texture's edges.
        u = min(max(u, 0.5 / width), 1.0 - 0.5 / width)
    _interpolate(StackedPicture(objects.texels, objects.first_texel[index], width, height), u, v, work.texel)
