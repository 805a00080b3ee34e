"""The reflection model of equation (5): Fresnel reflectance, geometry, and the rough terms over arrays.

The forms of the rough gloss itself are the lobes of `irodori.reflection.registry`. Angles are in rad, directions are
unit vectors, refractive index is n + ik.
"""

import math

import numpy as np

from irodori.jit.compilation import njit
from irodori.reflection.fresnel import fresnel
from irodori.reflection.lobe_arrays import evaluate

MU_MIN_RAD = 0.005
MU_MAX_RAD = 1.2


@njit(cache=True, inline="always")
def facet_distribution(phi, mu):
    """Return D = exp(-(φ/μ)²) [eq. 5]; φ and μ in rad."""
    ratio = phi / mu
    return math.exp(-ratio * ratio)


@njit(cache=True, error_model="numpy", inline="always")
def attenuation_over_cosine(cos_i, cos_r, cos_phi, cos_h):
    """Return G / cosθ_r [eq. 5], bounded by 2 cosφ / cosθ_H however small cosθ_r becomes.

    Parameters
    ----------
    cos_i, cos_r, cos_phi, cos_h : float
        N·L, N·V, N·H and V·H. Zero is returned unless N·L, N·V and V·H are all positive.
    """
    if cos_i <= 0.0 or cos_r <= 0.0 or cos_h <= 0.0 or cos_phi <= 0.0:
        return 0.0
    facet = 2.0 * cos_phi / cos_h
    return min(min(1.0, facet * cos_i) / cos_r, facet)


@njit(cache=True, error_model="numpy", inline="always")
def gloss_factor(theta_i, theta_r, theta_h, phi, n, k):
    """Return F G / cosθ_r, the gloss term of equation (5) without β D; angles in rad."""
    cos_h = math.cos(theta_h)
    geometric = attenuation_over_cosine(math.cos(theta_i), math.cos(theta_r), math.cos(phi), cos_h)
    return fresnel(cos_h, n, k) * geometric


@njit(cache=True)
def gloss_factors(geometry, n, k):
    """Return F G / cosθ_r for arrays.

    Parameters
    ----------
    geometry : (..., 4) float
        θ_i, θ_r, θ_H, φ in rad.
    n, k : float

    Returns
    -------
    (...) float64
    """
    flat = geometry.reshape(-1, 4)
    out = np.empty(flat.shape[0])
    for j in range(flat.shape[0]):
        out[j] = gloss_factor(flat[j, 0], flat[j, 1], flat[j, 2], flat[j, 3], n, k)
    return out.reshape(geometry.shape[:-1])


def reflect(alpha, reflectance, beta, mu, geometry, n=1.5, k=0.0, *, lobe: str = "gaussian"):
    """Return π L_o / E_n of diffuse reflection and one component of rough gloss [eq. 5].

    Parameters
    ----------
    alpha, beta, mu : float or (...) float
        Weights, and roughness in the unit of the lobe.
    reflectance : float or (...) float
        S at one wavelength.
    geometry : (..., 4) float
        θ_i, θ_r, θ_H, φ in rad.
    n, k : float
    lobe : str
        Of `irodori.reflection.registry`.

    Returns
    -------
    (...) float64; zero where N·L <= 0 or N·V <= 0
    """
    geometry = np.asarray(geometry, dtype=np.float64)
    lit = (geometry[..., 0] < math.pi / 2) & (geometry[..., 1] < math.pi / 2)
    # With light and view at the normal of a facet that stands on it G / cosθ_r is 1, and F is left.
    facing = np.zeros_like(geometry)
    facing[..., 2] = geometry[..., 2]
    gloss = beta * gloss_factors(facing, float(n), float(k)) * evaluate(lobe, mu, geometry)
    return np.where(lit, alpha * reflectance * np.cos(geometry[..., 0]) + gloss, 0.0)


def angles_from_directions(normal, to_light, to_camera) -> np.ndarray:
    """Return θ_i, θ_r, θ_H, φ of unit directions.

    Parameters
    ----------
    normal, to_light, to_camera : (..., 3) float
        Unit vectors N, L, V; broadcast against each other.

    Returns
    -------
    (..., 4) float64, rad. Computed with atan2, so that small angles keep their digits.
    """
    normal, to_light, to_camera = np.broadcast_arrays(normal, to_light, to_camera)
    half = to_light + to_camera
    length = np.linalg.norm(half, axis=-1, keepdims=True)
    half = np.divide(half, length, out=np.array(normal, dtype=np.float64), where=length > 1e-12)

    def angle(a, b):
        return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))

    return np.stack(
        [angle(normal, to_light), angle(normal, to_camera), angle(half, to_light), angle(normal, half)], axis=-1
    )
