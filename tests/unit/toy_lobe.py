"""A lobe that no module of the package knows: Blinn-Phong facets, D = cos^p φ with p = 2 / μ², between grooves."""

import math

from irodori.jit.compilation import njit
from irodori.jit.functions import exp, log, lower_of, select, upper_of
from irodori.reflection.lobe import Parameter

NAME = "toy"
TITLE = "Blinn-Phong facets"
ROUGHNESS = Parameter("mu", "μ", "1", "roughness: the exponent is 2 / μ²", 0.02, 0.8)
SQUARES_AT_HALF_OCTAVE = True

_TINY = 1e-300


@njit(cache=True, forceinline=True, error_model="numpy")
def features(cos_i, cos_r, cos_phi, cos_h, phi):
    """Return G / cosθ_r of V-shaped grooves, -ln cosφ and tan²φ; φ near 0 gives the digits that cosφ has lost."""
    facet = 2.0 * cos_phi / (cos_h + _TINY)
    bounded = lower_of(lower_of(facet * cos_i, 1.0) / (cos_r + _TINY), facet)
    lit = (cos_i > 0.0) & (cos_r > 0.0) & (cos_h > 0.0) & (cos_phi > 0.0)
    nothing = 0.0 * bounded
    cosine, near, p2 = upper_of(cos_phi, 3e-8), phi < 0.05, phi * phi
    fall = p2 * (1 / 2 + p2 * (1 / 12 + p2 * (1 / 45 + p2 * (17 / 2520 + p2 * (31 / 14175)))))
    slope = p2 * (1.0 + p2 * (2 / 3 + p2 * (17 / 45 + p2 * (62 / 315 + p2 * (1382 / 14175)))))
    fall, slope = select(near, fall, -log(cosine)), select(near, slope, 1.0 / (cosine * cosine) - 1.0)
    return select(lit, bounded, nothing), fall, slope, nothing


@njit(cache=True, forceinline=True)
def constants(t):
    """Return -p."""
    return -2.0 * exp(-2.0 * t), 0.0


@njit(cache=True, forceinline=True)
def value(constant, f0, f1, f2):
    """Return D."""
    return exp(constant[0] * f0)


@njit(cache=True, forceinline=True)
def derivatives(constant, f0, f1, f2):
    """Return D and its derivatives by ln μ."""
    x = constant[0] * f0
    d = exp(x)
    return d, -2.0 * x * d, 4.0 * x * (x + 1.0) * d


@njit(cache=True, forceinline=True, error_model="numpy")
def flank(constant, f0, f1, f2):
    """Return D and (p tanφ)²."""
    return exp(constant[0] * f0), constant[0] * constant[0] * f1


@njit(cache=True, forceinline=True, error_model="numpy")
def draw(mu, v0, v1, v2, u0, u1):
    """Draw a half vector with the density (p + 1) / 2π cos^p φ."""
    cosine = math.exp(math.log1p(-u0) / (2.0 / (mu * mu) + 1.0))
    sine, azimuth = math.sqrt(max(1.0 - cosine * cosine, 0.0)), 2.0 * math.pi * u1
    return sine * math.cos(azimuth), sine * math.sin(azimuth), cosine


@njit(cache=True, forceinline=True, error_model="numpy")
def density(mu, cos_r, cos_phi, cos_h, phi):
    """Return a quarter of the half vector's density over V·H."""
    p = 2.0 / (mu * mu)
    return (p + 1.0) / (2.0 * math.pi) * max(cos_phi, 1e-300) ** p / (4.0 * cos_h)


@njit(cache=True, forceinline=True)
def strength(mu):
    """Return ∫ 4 D dω_H / π."""
    return 8.0 / (2.0 / (mu * mu) + 1.0)


@njit(cache=True, forceinline=True)
def reach(mu):
    """Return the angle at which D has fallen to 1e-4."""
    return math.acos(math.exp(math.log(1e-4) * mu * mu / 2.0))
