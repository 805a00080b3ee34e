"""The reflection model of equation (5): its angles, and its diffuse and gloss terms over arrays.

The shapes of the gloss term are the lobes of `irodori.reflection.registry`. Angles are in rad, directions are unit
vectors, the refractive index is n + ik.
"""

import math

import numpy as np

from irodori.reflection.fresnel import fresnel_array
from irodori.reflection.lobe_arrays import evaluate


def reflect(alpha, reflectance, beta, mu, geometry, *, n=1.5, k=0.0, lobe: str = "gaussian"):
    """Return π L_o / E_n, reflected radiance over irradiance, of diffuse reflection and one gloss component [eq. 5].

    Parameters
    ----------
    alpha, beta, mu : float or (...) float
        Weights, and roughness in the unit of the lobe.
    reflectance : float or (...) float
        S at one wavelength.
    geometry : (..., 4) float
        θ_i, θ_r, θ_H, φ in rad.
    n, k : float
        Complex refractive index.
    lobe : str
        Name of a lobe in `irodori.reflection.registry`.

    Returns
    -------
    (...) float64; zero where N·L <= 0 or N·V <= 0
    """
    geometry = np.asarray(geometry, dtype=np.float64)
    lit = (geometry[..., 0] < math.pi / 2) & (geometry[..., 1] < math.pi / 2)
    gloss = beta * fresnel_array(np.cos(geometry[..., 2]), n, k) * evaluate(lobe, mu, geometry)
    return np.where(lit, alpha * reflectance * np.cos(geometry[..., 0]) + gloss, 0.0)


def angles_from_directions(normal, to_light, to_camera) -> np.ndarray:
    """Return the angles θ_i, θ_r, θ_H, φ of the reflection model from unit directions.

    Parameters
    ----------
    normal, to_light, to_camera : (..., 3) float
        Unit vectors N, L, V; broadcast against each other.

    Returns
    -------
    (..., 4) float64, rad. Computed with atan2, so that small angles keep full relative precision.
    """
    normal, to_light, to_camera = np.broadcast_arrays(normal, to_light, to_camera)
    half = to_light + to_camera
    length = np.linalg.norm(half, axis=-1, keepdims=True)
    half = np.divide(half, length, out=np.array(normal, dtype=np.float64), where=length > 1e-12)
    out = np.empty((*half.shape[:-1], 4))
    pairs = (normal, to_light), (normal, to_camera), (half, to_light), (normal, half)
    for i, (first, second) in enumerate(pairs):
        (ax, ay, az), (bx, by, bz) = np.moveaxis(first, -1, 0), np.moveaxis(second, -1, 0)
        # NumPy's cross product and norm take three times as long.
        cross = np.sqrt((ay * bz - az * by) ** 2 + (az * bx - ax * bz) ** 2 + (ax * by - ay * bx) ** 2)
        out[..., i] = np.arctan2(cross, ax * bx + ay * by + az * bz)
    return out
