"""Directional-hemispherical albedo of the lobes, by quadrature over half vectors."""

import math
from typing import NamedTuple

import numpy as np

from irodori.jit.compilation import njit
from irodori.reflection.lobes import Lobes, constants, features, value
from irodori.reflection.registry import lobe

_NODES = 128
_ROUGHNESSES, _COSINES, _ROUNDING = 25, 17, 1e-12


class AlbedoTable(NamedTuple):
    """Albedo of a lobe over roughness and cosine.

    ``albedo`` is ∫ D G / cosθ_r dω_i / π, what a view at cosθ_r has of even light for β F = 1. Lobes are reciprocal: it
    is also the share of light from that angle that is reflected to anywhere.
    """

    mu: np.ndarray  # (m,) in the unit of the lobe
    cosine: np.ndarray  # (c,) above 0
    albedo: np.ndarray  # (m, c)
    error: np.ndarray  # (m,) largest difference along the cosines from a quadrature of half as many nodes


@njit(cache=True, error_model="numpy")
def _integral(lobes, mu, cos_r, node, weight):
    """Return ∫ D G / cosθ_r dω_i / π with φ = μ sinh t; nodes and weights are those of 0..1."""
    constant = constants(lobes, math.log(mu))
    sin_r = math.sqrt(max(1.0 - cos_r * cos_r, 0.0))
    # Half vectors further out have light above the horizon nowhere.
    furthest = 0.25 * math.pi + 0.5 * math.acos(min(cos_r, 1.0))
    most, total = math.asinh(furthest / mu), 0.0
    for i in range(node.size):
        t = most * node[i]
        phi = mu * math.sinh(t)
        sine, cos_phi = math.sin(phi), math.cos(phi)
        # Light is above the horizon, cosθ_i > 0, up to an azimuth from the view; there the lobe has a corner.
        last, ring = _last_azimuth(cos_r, sin_r, cos_phi, sine), 0.0
        for j in range(node.size):
            cos_h = cos_phi * cos_r + sine * sin_r * math.cos(last * node[j])
            cos_i = 2.0 * cos_h * cos_phi - cos_r
            factor, f0, f1, f2 = features(lobes, cos_i, cos_r, cos_phi, cos_h, phi)
            ring += last * weight[j] * factor * value(lobes, constant, f0, f1, f2) * 4.0 * cos_h
        total += weight[i] * ring * sine * mu * math.cosh(t)
    return 2.0 * most * total / math.pi


@njit(cache=True, error_model="numpy")
def _last_azimuth(cos_r, sin_r, cos_phi, sine):
    """Return the azimuth from the view up to which a half vector mirrors the view above the horizon."""
    least = cos_r / (2.0 * cos_phi) - cos_phi * cos_r  # cosθ_H of light at the horizon, less its even part
    across = sine * sin_r
    if least <= -across:
        return math.pi
    return 0.0 if least >= across else math.acos(least / across)


@njit(cache=True)
def _fill(lobes, mu, cosine, node, weight, out):
    for i in range(mu.size):
        for j in range(cosine.size):
            out[i, j] = _integral(lobes, mu[i], cosine[j], node, weight)


def albedo_table(name: str, mu=None, cosine=None, nodes: int = _NODES) -> AlbedoTable:
    """Return the albedo of a lobe for β F = 1.

    Parameters
    ----------
    name : str
        Of a registered lobe.
    mu : (m,) float, optional
        Roughnesses; where absent 25 from one bound of the lobe to the other, evenly in their logarithm.
    cosine : (c,) float, optional
        Cosines of the view's angle, above 0; where absent 17 from 0.01 to 1, the angles evenly spread.
    nodes : int
        Of the quadrature, along the angle from the normal and around it.

    Raises
    ------
    ValueError
        If there is no lobe of that name.
    """
    bounds = lobe(name).roughness
    mu = np.geomspace(bounds.low, bounds.high, _ROUGHNESSES) if mu is None else np.atleast_1d(mu).astype(np.float64)
    if cosine is None:
        cosine = np.cos(np.linspace(0.0, math.acos(0.01), _COSINES))
    cosine = np.atleast_1d(cosine).astype(np.float64)
    fine, coarse = np.empty((2, len(mu), len(cosine)))
    for out, count in ((fine, nodes), (coarse, nodes // 2)):
        node, weight = np.polynomial.legendre.leggauss(count)
        _fill(Lobes.of(name), mu, cosine, 0.5 * (node + 1.0), 0.5 * weight, out)
    error = np.maximum(np.abs(fine - coarse), _ROUNDING * fine).max(axis=1)
    return AlbedoTable(mu, cosine, fine, error)
