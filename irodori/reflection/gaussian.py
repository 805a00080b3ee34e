"""The lobe of the paper: Gaussian distribution of facets with the attenuation of V-shaped grooves [eq. 5].

D = exp(-(φ/μ)²) and G = min(1, 2 cosφ cosθ_r / cosθ_H, 2 cosφ cosθ_i / cosθ_H).
"""

import math

from irodori.jit.compilation import njit
from irodori.jit.functions import exp, lower_of, select
from irodori.reflection.lobe import Parameter

NAME = "gaussian"
TITLE = "Gaussian facets"
ROUGHNESS = Parameter("mu", "μ", "rad", "roughness", 0.005, 1.2)
SQUARES_AT_HALF_OCTAVE = True

_TINY = 1e-300
_REACH = 3.0  # exp(-9) is 1.2e-4


@njit(cache=True, forceinline=True, error_model="numpy")
def features(cos_i, cos_r, cos_phi, cos_h, phi):
    """Return G / cosθ_r, which is at most 2 cosφ / cosθ_H for any cosθ_r, and φ²; the other two features are 0."""
    facet = 2.0 * cos_phi / (cos_h + _TINY)
    bounded = lower_of(lower_of(facet * cos_i, 1.0) / (cos_r + _TINY), facet)
    lit = (cos_i > 0.0) & (cos_r > 0.0) & (cos_h > 0.0) & (cos_phi > 0.0)
    nothing = 0.0 * bounded
    return select(lit, bounded, nothing), phi * phi, nothing, nothing


@njit(cache=True, forceinline=True, error_model="numpy")
def constants(t):
    """Return -1 / μ² and 0."""
    return -exp(-2.0 * t), 0.0


@njit(cache=True, forceinline=True, error_model="numpy")
def value(constant, f0, f1, f2):
    """Return D = exp(-(φ/μ)²)."""
    return exp(constant[0] * f0)


@njit(cache=True, forceinline=True, error_model="numpy")
def derivatives(constant, f0, f1, f2):
    """Return D and its first two derivatives by ln μ."""
    x = constant[0] * f0
    d = exp(x)
    return d, -2.0 * x * d, 4.0 * x * (x + 1.0) * d


@njit(cache=True, forceinline=True, error_model="numpy")
def flank(constant, f0, f1, f2):
    """Return D and (2 φ / μ²)²."""
    return exp(constant[0] * f0), 4.0 * constant[0] * constant[0] * f0


@njit(cache=True, forceinline=True)
def _inside(mu):
    """Return 1 - exp(-(π/2μ)²), the probability of φ < π/2 for the density 2φ/μ² exp(-(φ/μ)²)."""
    return -math.expm1(-((0.5 * math.pi / mu) ** 2))


@njit(cache=True, forceinline=True, error_model="numpy")
def draw(mu, v0, v1, v2, u0, u1):
    """Sample a half vector; φ has the density 2φ/μ² exp(-(φ/μ)²) below π/2, which is D(φ) dω but for sinφ/φ."""
    phi = mu * math.sqrt(-math.log1p(-u0 * _inside(mu)))
    azimuth, sine = 2.0 * math.pi * u1, math.sin(phi)
    return sine * math.cos(azimuth), sine * math.sin(azimuth), math.cos(phi)


@njit(cache=True, forceinline=True, error_model="numpy")
def density(mu, cos_r, cos_phi, cos_h, phi):
    """Return the density of the light direction, 1/sr: that of the half vector over 4 V·H."""
    ratio = phi / mu
    sine = math.sin(phi)
    spread = phi / sine if sine > 1e-9 else 1.0
    return math.exp(-ratio * ratio) * spread / (math.pi * mu * mu * _inside(mu) * 4.0 * cos_h)


@njit(cache=True, forceinline=True)
def strength(mu):
    """Return 4 μ², which equals ∫ 4 D dω_H / π for small μ."""
    return 4.0 * mu * mu


@njit(cache=True, forceinline=True)
def reach(mu):
    """Return 3 μ, at most π/2."""
    return min(_REACH * mu, 0.5 * math.pi)
