"""Importance sampling of equation (5)'s rough terms, with exact densities."""

import math

from irodori.jit.native import njit
from irodori.reflection.equation5 import attenuation_over_cosine


@njit(cache=True, _nrt=False, forceinline=True)
def inside(mu):
    """Return 1 - exp(-(π/2μ)²), the share of the facets' law that lies within a quarter turn."""
    return -math.expm1(-((0.5 * math.pi / mu) ** 2))


@njit(cache=True, _nrt=False, forceinline=True)
def gloss_share(beta, mu, fresnel_towards_viewer):
    """Return about the light that the gloss term reflects: β F ∫ D G / (π cosθ_r) dω for a smooth surface seen steeply.

    What terms are chosen by, never 0 where there is gloss. 4 μ² is ∫ 4 D dω_H / π of small μ.
    """
    return 4.0 * beta * mu * mu * fresnel_towards_viewer


@njit(cache=True, _nrt=False, forceinline=True, error_model="numpy")
def gloss_at(normal, view, light, cos_i, cos_r, beta, mu):
    """Return the gloss term without its Fresnel reflectance, the density of its own drawing, and V·H.

    Parameters
    ----------
    normal, view, light : (3,) float
        Unit vectors.
    cos_i, cos_r : float
        N·L and N·V, both above 0.
    beta, mu : float
        Gloss weight and roughness in rad.

    Returns
    -------
    factor : float, 1/sr
        β D G / (π cosθ_r): times F and radiance, integrated over the directions of light, it is radiance.
    density : float, 1/sr
        With which `draw_gloss` draws this direction of light, for one drawn without being refused.
    cos_h : float
    """
    x, y, z = view[0] + light[0], view[1] + light[1], view[2] + light[2]
    length = math.sqrt(x * x + y * y + z * z)
    cos_h = 0.5 * length
    cos_phi = min((cos_i + cos_r) / length, 1.0)
    # |N x (V + L)| keeps the digits of small angles, which 1 - cosφ loses.
    cx = normal[1] * z - normal[2] * y
    cy = normal[2] * x - normal[0] * z
    cz = normal[0] * y - normal[1] * x
    sin_phi = math.sqrt(cx * cx + cy * cy + cz * cz) / length
    phi = math.atan2(sin_phi, cos_phi)
    ratio = phi / mu
    distribution = math.exp(-ratio * ratio)
    factor = beta / math.pi * distribution * attenuation_over_cosine(cos_i, cos_r, cos_phi, cos_h)
    spread = phi / sin_phi if sin_phi > 1e-9 else 1.0
    density = distribution * spread / (math.pi * mu * mu * inside(mu) * 4.0 * cos_h)
    return factor, density, cos_h


@njit(cache=True, _nrt=False, forceinline=True, error_model="numpy")
def draw_gloss(normal, tangent, bitangent, view, mu, u, v, out):
    """Fill the direction of light that mirrors the view in a drawn half vector; return whether it is of any use.

    φ of the half vector has the density 2φ/μ² exp(-(φ/μ)²) / inside, cut at π/2: D(φ) dω but for a factor sinφ/φ. The
    reflected direction has a quarter of the half vector's density over V·H.
    """
    phi = mu * math.sqrt(-math.log1p(-u * inside(mu)))
    angle, sine, cosine = 2.0 * math.pi * v, math.sin(phi), math.cos(phi)
    a, b = sine * math.cos(angle), sine * math.sin(angle)
    cos_h = 0.0
    for axis in range(3):
        out[axis] = a * tangent[axis] + b * bitangent[axis] + cosine * normal[axis]
        cos_h += out[axis] * view[axis]
    if cos_h <= 0.0:
        return False
    for axis in range(3):
        out[axis] = 2.0 * cos_h * out[axis] - view[axis]
    return True


@njit(cache=True, _nrt=False, forceinline=True)
def draw_cosine(normal, tangent, bitangent, u, v, out):
    """Fill a direction with the density cosθ / π about a normal."""
    radius, angle = math.sqrt(u), 2.0 * math.pi * v
    a, b, c = radius * math.cos(angle), radius * math.sin(angle), math.sqrt(1.0 - u)
    for axis in range(3):
        out[axis] = a * tangent[axis] + b * bitangent[axis] + c * normal[axis]
