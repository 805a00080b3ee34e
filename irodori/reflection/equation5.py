"""The reflection model of equation (5): its angles, and its diffuse and gloss terms over arrays.

The shapes of the gloss term are the lobes of `irodori.reflection.registry`. Angles are in rad, directions are unit
vectors, the refractive index is n + ik.
"""

import math

import numpy as np

from irodori.jit.compilation import njit
from irodori.reflection.coat import diffuse_cosine
from irodori.reflection.fresnel import fresnel_array
from irodori.reflection.lobe_arrays import evaluate


@njit(cache=True, error_model="numpy")
def _angle(ax, ay, az, bx, by, bz):
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return math.atan2(math.sqrt(x * x + y * y + z * z), ax * bx + ay * by + az * bz)


@njit(cache=True, error_model="numpy")
def _fill_angles(normal, to_light, to_camera, out):
    for j in range(out.shape[0]):
        nx, ny, nz = normal[j, 0], normal[j, 1], normal[j, 2]
        lx, ly, lz = to_light[j, 0], to_light[j, 1], to_light[j, 2]
        vx, vy, vz = to_camera[j, 0], to_camera[j, 1], to_camera[j, 2]
        hx, hy, hz = lx + vx, ly + vy, lz + vz
        length = math.sqrt(hx * hx + hy * hy + hz * hz)
        # Between opposite directions, the normal stands for the half vector.
        hx, hy, hz = (hx / length, hy / length, hz / length) if length > 1e-12 else (nx, ny, nz)
        out[j, 0] = _angle(nx, ny, nz, lx, ly, lz)
        out[j, 1] = _angle(nx, ny, nz, vx, vy, vz)
        out[j, 2] = _angle(hx, hy, hz, lx, ly, lz)
        out[j, 3] = _angle(nx, ny, nz, hx, hy, hz)


def reflect(alpha, reflectance, beta, mu, geometry, *, n=1.5, k=0.0, lobe: str = "gaussian", coupled: bool = False):
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
    coupled : bool
        Whether the coat reduces the diffuse term, see `irodori.reflection.coat`.

    Returns
    -------
    (...) float64; zero where N·L <= 0 or N·V <= 0
    """
    geometry = np.asarray(geometry, dtype=np.float64)
    lit = (geometry[..., 0] < math.pi / 2) & (geometry[..., 1] < math.pi / 2)
    gloss = beta * fresnel_array(np.cos(geometry[..., 2]), n, k) * evaluate(lobe, mu, geometry)
    return np.where(lit, alpha * reflectance * diffuse_cosine(geometry, n, k, coupled) + gloss, 0.0)


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
    directions = np.broadcast_arrays(normal, to_light, to_camera)
    out = np.empty((*directions[0].shape[:-1], 4))
    rows = (np.ascontiguousarray(one, dtype=np.float64).reshape(-1, 3) for one in directions)
    _fill_angles(*rows, out.reshape(-1, 4))
    return out
