"""Evaluation of a lobe over arrays, for callers in Python."""

import math

import numpy as np

from irodori.jit.compilation import njit
from irodori.reflection.lobes import Lobes, constants, derivatives, features


@njit(cache=True, error_model="numpy")
def _fill(lobes, mu, geometry, out):
    for j in range(geometry.shape[0]):
        theta_i, theta_r, theta_h, phi = geometry[j, 0], geometry[j, 1], geometry[j, 2], geometry[j, 3]
        if not (theta_i < 0.5 * math.pi and theta_r < 0.5 * math.pi):
            continue
        factor, f0, f1, f2 = features(
            lobes, math.cos(theta_i), math.cos(theta_r), math.cos(phi), math.cos(theta_h), phi
        )
        value, first, second = derivatives(lobes, constants(lobes, math.log(mu[j])), f0, f1, f2)
        out[0, j], out[1, j], out[2, j] = factor * value, factor * first, factor * second


def evaluate_with_derivatives(name: str, mu, geometry) -> np.ndarray:
    """Return D G / cosθ_r of a lobe and its first two derivatives by ln μ.

    Parameters
    ----------
    name : str
        Name of a registered lobe.
    mu : float or (...) float
        Roughness, in the unit of the lobe.
    geometry : (..., 4) float
        θ_i, θ_r, θ_H, φ in rad.

    Returns
    -------
    (3, ...) float64; zero where N·L <= 0 or N·V <= 0

    Raises
    ------
    ValueError
        If there is no lobe of that name.
    """
    geometry = np.asarray(geometry, dtype=np.float64)
    shape = np.broadcast_shapes(np.shape(mu), geometry.shape[:-1])
    mu = np.ascontiguousarray(np.broadcast_to(np.asarray(mu, dtype=np.float64), shape)).reshape(-1)
    flat = np.ascontiguousarray(np.broadcast_to(geometry, (*shape, 4))).reshape(-1, 4)
    out = np.zeros((3, mu.size))
    _fill(Lobes.of(name), mu, flat, out)
    return out.reshape(3, *shape)


def evaluate(name: str, mu, geometry) -> np.ndarray:
    """Return D G / cosθ_r of a lobe, (...) float64; parameters and errors as in `evaluate_with_derivatives`.

    Examples
    --------
    The Gaussian lobe of roughness 0.1 rad, for light and camera at the normal, and for facets tilted by 0.1 rad:

    >>> evaluate("gaussian", 0.1, [[0.0, 0.0, 0.0, 0.0], [0.1, 0.1, 0.0, 0.1]]).round(3).tolist()
    [1.0, 0.37]
    """
    return evaluate_with_derivatives(name, mu, geometry)[0]
