"""Directional-hemispherical albedo of the lobes, by quadrature over half vectors."""

import math
from functools import lru_cache

import numpy as np

from irodori.jit.compilation import njit
from irodori.reflection.fresnel import fresnel
from irodori.reflection.lobes import Lobes, constants, features, value
from irodori.reflection.registry import lobe

_NODES = 48  # of the quadrature, along the angle from the normal and around it


@njit(cache=True, error_model="numpy")
def _integrate(lobes, mu, cos_r, rule, index, out):
    """Fill ``out`` with ∫ F D G / cosθ_r dω_i / π for each refractive index.

    ``rule`` has the nodes and weights of a quadrature over 0..1, ``index`` arrays of n and k. The angle of the half
    vector is substituted by φ = μ sinh t.
    """
    (node, weight), (n, k) = rule, index
    constant = constants(lobes, math.log(mu))
    sin_r = math.sqrt(max(1.0 - cos_r * cos_r, 0.0))
    # For larger φ, no direction of light lies above the horizon.
    furthest = 0.25 * math.pi + 0.5 * math.acos(min(cos_r, 1.0))
    most = math.asinh(furthest / mu)
    out[:] = 0.0
    for i in range(node.size):
        t = most * node[i]
        phi = mu * math.sinh(t)
        sine, cos_phi = math.sin(phi), math.cos(phi)
        # The light is above the horizon, cosθ_i > 0, up to this azimuth from the view, where the integrand has a kink.
        last = _last_azimuth(cos_r, sin_r, cos_phi, sine)
        ring = 2.0 * most / math.pi * weight[i] * sine * mu * math.cosh(t) * last
        for j in range(node.size):
            cos_h = cos_phi * cos_r + sine * sin_r * math.cos(last * node[j])
            cos_i = 2.0 * cos_h * cos_phi - cos_r
            factor, f0, f1, f2 = features(lobes, cos_i, cos_r, cos_phi, cos_h, phi)
            part = ring * weight[j] * factor * value(lobes, constant, f0, f1, f2) * 4.0 * cos_h
            for which in range(n.size):
                out[which] += part * fresnel(cos_h, n[which], k[which])


@njit(cache=True, error_model="numpy")
def _last_azimuth(cos_r, sin_r, cos_phi, sine):
    """Return the azimuth from the view up to which a half vector reflects the view direction above the horizon."""
    least = cos_r / (2.0 * cos_phi) - cos_phi * cos_r  # cosθ_H of light at the horizon, less its part without azimuth
    across = sine * sin_r
    if least <= -across:
        return math.pi
    return 0.0 if least >= across else math.acos(least / across)


@njit(cache=True)
def _fill(lobes, mu, cosine, rule, index, out):
    for i in range(mu.size):
        for j in range(cosine.size):
            _integrate(lobes, mu[i], cosine[j], rule, index, out[i, j])


@lru_cache(maxsize=16)  # objects of a scene share lobes and refractive indices
def _kept_integrals(name: str, digest: str, *given: bytes) -> np.ndarray:
    """Return the integrals of `_integrate`, (m, c, indices)."""
    mu, cosine, n, k = (np.frombuffer(values).copy() for values in given)
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    out = np.empty((len(mu), len(cosine), len(n)))
    _fill(Lobes.of(name), mu, cosine, (0.5 * (node + 1.0), 0.5 * weight), (n, k), out)
    out.flags.writeable = False
    return out


def gloss_albedo(name: str, mu, cosine, n, k) -> np.ndarray:
    """Return the albedo of a lobe with its Fresnel reflectance, for β = 1: ∫ F D G / cosθ_r dω_i / π.

    It is the radiance towards an angle θ_r under uniform light of radiance 1. Lobes are reciprocal, so it is also the
    share of light from that angle that is reflected in all directions.

    Parameters
    ----------
    name : str
        Name of a registered lobe.
    mu : (m,) float
        Roughnesses.
    cosine : (c,) float
        Cosines of the viewing angle, above 0.
    n, k : (i,) float
        Complex refractive indices.

    Returns
    -------
    (m, c, i) float64

    Raises
    ------
    ValueError
        If there is no lobe of that name.
    """
    given = (np.atleast_1d(np.asarray(x, dtype=np.float64)).tobytes() for x in (mu, cosine, n, k))
    return _kept_integrals(name, lobe(name).digest, *given)
