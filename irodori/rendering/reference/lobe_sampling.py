"""Angles of half vectors, and sampling of directions from a surface's gloss and diffuse terms with exact densities."""

import math
from typing import NamedTuple

from irodori.jit.compilation import uncounted
from irodori.jit.functions import circle_point
from irodori.reflection.lobes import Lobes, draw
from irodori.rendering.surface_hits import frame


class Gloss(NamedTuple):
    """A gloss component of a texel."""

    lobes: Lobes
    which: int  # of these
    mu: float  # roughness, in the unit of the lobe


@uncounted(forceinline=True, error_model="numpy")
def half_angles(normal, view, light, cos_i, cos_r):
    """Return cosφ, cosθ_H and φ (rad) for two unit directions with N·L and N·V above 0; φ is accurate near 0."""
    x, y, z = view[0] + light[0], view[1] + light[1], view[2] + light[2]
    length = math.sqrt(x * x + y * y + z * z)
    cos_phi = min((cos_i + cos_r) / length, 1.0)
    # |N x (V + L)| keeps the digits of small angles, which 1 - cosφ loses.
    cx = normal[1] * z - normal[2] * y
    cy = normal[2] * x - normal[0] * z
    cz = normal[0] * y - normal[1] * x
    sin_phi = math.sqrt(cx * cx + cy * cy + cz * cz) / length
    return cos_phi, 0.5 * length, math.atan2(sin_phi, cos_phi)


@uncounted(forceinline=True, error_model="numpy")
def draw_gloss(gloss, normal, view, u, v, out):
    """Sample a light direction by reflecting the view in a half vector from a lobe; return whether it is valid.

    Its probability density is `irodori.reflection.lobes.density`.
    """
    tangent, bitangent = frame(normal)
    v0, v1, v2 = 0.0, 0.0, 0.0
    for axis in range(3):
        v0 += view[axis] * tangent[axis]
        v1 += view[axis] * bitangent[axis]
        v2 += view[axis] * normal[axis]
    a, b, c = draw(gloss.lobes, gloss.which, gloss.mu, v0, v1, v2, u, v)
    cos_h = 0.0
    for axis in range(3):
        out[axis] = a * tangent[axis] + b * bitangent[axis] + c * normal[axis]
        cos_h += out[axis] * view[axis]
    if cos_h <= 0.0:
        return False
    for axis in range(3):
        out[axis] = 2.0 * cos_h * out[axis] - view[axis]
    return True


@uncounted(forceinline=True)
def draw_cosine(normal, u, v, out):
    """Sample a direction around a normal with the probability density cosθ / π."""
    tangent, bitangent = frame(normal)
    radius, (cosine, sine) = math.sqrt(u), circle_point(v)
    a, b, c = radius * cosine, radius * sine, math.sqrt(1.0 - u)
    for axis in range(3):
        out[axis] = a * tangent[axis] + b * bitangent[axis] + c * normal[axis]
