"""The GGX lobe with Smith's height-correlated masking and shadowing.

Walter et al., *Microfacet models for refraction through rough surfaces*, EGSR 2007; Heitz, *Understanding the
masking-shadowing function in microfacet-based BRDFs*, JCGT 3(2), 2014; visible normals are sampled as in Heitz,
*Sampling the GGX distribution of visible normals*, JCGT 7(4), 2018.

D is scaled to 1 at φ = 0, so that the gloss term is β F D G₂ / cosθ_r. A surface with the usual normalisation of D, in
which the projected area of the facets equals that of the surface, has β = 1 / (4 μ²).
"""

import math

from irodori.jit.compilation import njit
from irodori.jit.functions import exp, root, select
from irodori.reflection.lobe import Parameter

NAME = "ggx"
TITLE = "GGX facets"
ROUGHNESS = Parameter("mu", "μ", "1", "roughness: tan of the angle at which D has fallen to a quarter", 0.005, 1.2)
SQUARES_AT_HALF_OCTAVE = False


@njit(cache=True, forceinline=True, error_model="numpy")
def features(cos_i, cos_r, cos_phi, cos_h, phi):
    """Return 2 cosθ_i, then sin²φ, cosθ_i and cosθ_r; near 0, sin²φ is computed from φ, because 1 - cos²φ cancels."""
    lit = (cos_i > 0.0) & (cos_r > 0.0) & (cos_h > 0.0) & (cos_phi > 0.0)
    square = 1.0 - cos_phi * cos_phi
    p2 = phi * phi
    small = p2 * (1.0 - p2 * (1.0 / 3.0 - p2 * (2.0 / 45.0 - p2 * (1.0 / 315.0))))
    square = select(phi < 0.05, small, square)
    one = 0.0 * cos_i + 1.0
    return select(lit, 2.0 * cos_i, 0.0 * cos_i), square, select(lit, cos_i, one), select(lit, cos_r, one)


@njit(cache=True, forceinline=True, error_model="numpy")
def constants(t):
    """Return μ² and 0."""
    return exp(2.0 * t), 0.0


@njit(cache=True, forceinline=True, error_model="numpy")
def value(constant, f0, f1, f2):
    """Return D over the denominator of Smith's G₂, a sum of two square roots."""
    m2 = constant[0]
    ratio = m2 / (m2 * (1.0 - f0) + f0)
    q_i, q_r = f1 * f1 + m2 * (1.0 - f1 * f1), f2 * f2 + m2 * (1.0 - f2 * f2)
    return ratio * ratio / (f2 * root(q_i) + f1 * root(q_r))


@njit(cache=True, forceinline=True, error_model="numpy")
def derivatives(constant, f0, f1, f2):
    """Return the value and its first two derivatives by ln μ, from the derivatives of its logarithm."""
    m2 = constant[0]
    facing = m2 * (1.0 - f0)
    base = facing + f0
    ratio = m2 / base
    e_i, e_r = m2 * (1.0 - f1 * f1), m2 * (1.0 - f2 * f2)
    q_i, q_r = f1 * f1 + e_i, f2 * f2 + e_r
    root_i, root_r = root(q_i), root(q_r)
    total = f2 * root_i + f1 * root_r
    slope_i, slope_r = f2 * e_i / root_i, f1 * e_r / root_r
    slope = (slope_i + slope_r) / total
    bend = (slope_i * (2.0 - e_i / q_i) + slope_r * (2.0 - e_r / q_r)) / total
    first = 4.0 * f0 / base - slope
    second = slope * slope - bend - 8.0 * f0 * facing / (base * base)
    v = ratio * ratio / total
    return v, v * first, v * (second + first * first)


@njit(cache=True, forceinline=True, error_model="numpy")
def flank(constant, f0, f1, f2):
    """Return D scaled to 1 at φ = 0, and the squared derivative of its logarithm by φ."""
    m2 = constant[0]
    base = m2 * (1.0 - f0) + f0
    ratio, slope = m2 / base, (1.0 - m2) / base
    return ratio * ratio, 16.0 * f0 * (1.0 - f0) * slope * slope


@njit(cache=True, forceinline=True, error_model="numpy")
def draw(mu, v0, v1, v2, u0, u1):
    """Sample a facet normal with the distribution of normals that are visible to the viewer."""
    s0, s1, s2 = mu * v0, mu * v1, max(v2, 1e-7)
    length = math.sqrt(s0 * s0 + s1 * s1 + s2 * s2)
    s0, s1, s2 = s0 / length, s1 / length, s2 / length
    across = s0 * s0 + s1 * s1
    if across > 1e-24:
        scale = 1.0 / math.sqrt(across)
        a0, a1 = -s1 * scale, s0 * scale
    else:
        a0, a1 = 1.0, 0.0
    # b = s x a, a has no third component.
    b0, b1, b2 = -s2 * a1, s2 * a0, s0 * a1 - s1 * a0
    radius, azimuth = math.sqrt(u0), 2.0 * math.pi * u1
    p, q = radius * math.cos(azimuth), radius * math.sin(azimuth)
    mix = 0.5 * (1.0 + s2)
    q = (1.0 - mix) * math.sqrt(max(1.0 - p * p, 0.0)) + mix * q
    up = math.sqrt(max(1.0 - p * p - q * q, 0.0))
    h0 = mu * (p * a0 + q * b0 + up * s0)
    h1 = mu * (p * a1 + q * b1 + up * s1)
    h2 = max(q * b2 + up * s2, 1e-9)
    length = math.sqrt(h0 * h0 + h1 * h1 + h2 * h2)
    return h0 / length, h1 / length, h2 / length


@njit(cache=True, forceinline=True, error_model="numpy")
def density(mu, cos_r, cos_phi, cos_h, phi):
    """Return D G₁ / (4 cosθ_r) with normalised D, the density of the light direction, 1/sr."""
    m2 = mu * mu
    sine = math.sin(phi)
    s2 = sine * sine
    ratio = m2 / (m2 * (1.0 - s2) + s2)
    return ratio * ratio / (math.pi * m2) * 0.5 / (cos_r + math.sqrt(cos_r * cos_r + m2 * (1.0 - cos_r * cos_r)))


@njit(cache=True, forceinline=True)
def strength(mu):
    """Return 4 μ², because a surface with β = 1 / (4 μ²) and F = 1 has an albedo near 1 for a view near the normal."""
    return 4.0 * mu * mu


@njit(cache=True, forceinline=True)
def reach(mu):
    """Return arctan(10 μ), the angle at which D has fallen to about 1e-4."""
    return math.atan(10.0 * mu)
