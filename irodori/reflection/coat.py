"""Light that a coat lets through to the diffuse ground beneath it, and back.

Equation (5) adds the gloss to the diffuse term, which is not reduced by what the surface reflects: a *sum*. With a
*coupled* coat, the diffuse term α S cosθ_i is multiplied by T(θ_i) T(θ_r) / T(0)². T = 1 - F is the share of light that
passes the surface, with Fresnel's reflectance F. α keeps its meaning for light and camera straight above the surface,
and the term stays reciprocal.
"""

import math

import numpy as np

from irodori.jit.compilation import njit
from irodori.reflection.fresnel import fresnel, fresnel_array

#: Coats of an object: none beside the sum of equation (5), or a coupled one.
SUM, COUPLED = "sum", "coupled"
COATS = (SUM, COUPLED)
_NODES = 64


@njit(cache=True, error_model="numpy", forceinline=True, fastmath={"contract"})
def passed(cosine, n, k):
    """Return T(θ) / T(0), the light that passes a surface n + ik relative to normal incidence; a number or lanes.

    Parameters
    ----------
    cosine : float
        Cosine of the angle θ to the normal outside, 0 to 1.
    n, k : float
        Complex refractive index.

    Returns
    -------
    float
        1 at normal incidence, 0 at grazing incidence.
    """
    return (1.0 - fresnel(cosine, n, k)) / (1.0 - fresnel(0.0 * cosine + 1.0, n, k))


def passed_array(cosine, n: float, k: float) -> np.ndarray:
    """Return `passed` over an array of cosines, (...) float64.

    Examples
    --------
    Glass lets 95 % of the light through at 60°, relative to normal incidence, and none at grazing incidence:

    >>> passed_array([1.0, 0.5, 0.0], 1.5, 0.0).round(2).tolist()
    [1.0, 0.95, 0.0]
    """
    return (1.0 - fresnel_array(cosine, n, k)) / (1.0 - fresnel_array(1.0, n, k))


def diffuse_cosine(geometry, n: float, k: float, coupled: bool) -> np.ndarray:
    """Return the diffuse term for α = 1 of directions θ_i, θ_r, θ_H, φ in rad, (...) of (..., 4).

    It is cosθ_i, reduced by the coat if that is ``coupled``, and 0 where light or camera is below the horizon.
    """
    geometry = np.asarray(geometry, dtype=np.float64)
    lit = (geometry[..., :2] < 0.5 * math.pi).all(axis=-1)
    cosine = np.where(lit, np.cos(geometry[..., 0]), 0.0)
    if coupled:
        cosine = cosine * passed_array(np.cos(geometry[..., 0]), n, k) * passed_array(np.cos(geometry[..., 1]), n, k)
    return cosine


def diffuse_albedo(cosine, n: float, k: float) -> np.ndarray:
    """Return the albedo of the diffuse term of a coupled coat for α S = 1, over the cosine of incidence, (...)."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    out = 0.5 * (node + 1.0)  # cosines of the light that leaves
    mean = float(np.sum(weight * out * passed_array(out, n, k)))
    return mean * passed_array(cosine, n, k)
