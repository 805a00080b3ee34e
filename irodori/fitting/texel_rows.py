"""Geometry factors of one texel's observations, in loops that vectorise.

numba calls the C library for `math.cos`, one number at a time. The polynomial here is exact to a few units in the last
place, and a loop over observations that calls it is vectorised; `irodori.jit.exponential` does the same for `math.exp`.

Rows of a texel's observations are padded to a multiple of `LANES` with observations of weight 0, so that no loop has
a remainder; each step of the geometry is a loop of its own, because the compiler vectorises short ones.
"""

import math

from irodori.jit.exponential import exp_negative as exp_negative
from irodori.jit.lanes import lower_of, select, upper_of
from irodori.jit.native import njit
from irodori.reflection.fresnel import fresnel

LANES = 8
#: Rows of a texel's block: cosθ_i, F G / cosθ_r, φ², response, weight, weight times cosine and times response, expected
#: variance, weight before outliers lose theirs, D, c0 and c1 of the camera's variance, and what is not a number.
(
    COSINE, GLOSS, SQUARE, RESPONSE, WEIGHT, WEIGHTED_COSINE, WEIGHTED_RESPONSE, VARIANCE, TRUST, LOBE, CONSTANT, SLOPE,
    SPOILED,
) = range(13)  # fmt: skip
ROWS = 13
_TINY = 1e-300

#: Sums may be reordered and products fused; NaN and infinity keep their meaning.
FAST = {"reassoc", "contract", "nsz", "arcp"}

LEAST_LOBE = 1e-74
_HALF_PI_HIGH, _HALF_PI_LOW = 1.5707963267948966, 6.123233995736766e-17


@njit(cache=True, fastmath={"contract"}, inline="always")
def cosine_of(angle):
    """Return cos of an angle in rad, clipped to 0..π, to 1e-16; a number or lanes."""
    x = lower_of(upper_of(angle, 0.0), math.pi)  # NaN becomes 0
    y = (_HALF_PI_HIGH - x) + _HALF_PI_LOW
    s = y * y
    p = 1.0 / 51090942171709440000.0
    p = p * s - 1.0 / 121645100408832000.0
    p = p * s + 1.0 / 355687428096000.0
    p = p * s - 1.0 / 1307674368000.0
    p = p * s + 1.0 / 6227020800.0
    p = p * s - 1.0 / 39916800.0
    p = p * s + 1.0 / 362880.0
    p = p * s - 1.0 / 5040.0
    p = p * s + 1.0 / 120.0
    p = p * s - 1.0 / 6.0
    return y + y * s * p


@njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def attenuation(cos_i, cos_r, cos_h, cos_phi):
    """Return `equation5.attenuation_over_cosine` without branches: zero unless all four cosines are positive."""
    facet = 2.0 * cos_phi / (cos_h + _TINY)
    bounded = lower_of(lower_of(facet * cos_i, 1.0) / (cos_r + _TINY), facet)
    bounded = select(cos_i > 0.0, bounded, 0.0)
    bounded = select(cos_r > 0.0, bounded, 0.0)
    bounded = select(cos_h > 0.0, bounded, 0.0)
    return select(cos_phi > 0.0, bounded, 0.0)


@njit(cache=True, error_model="numpy")
def _gather(geometry, angles, block):
    for j in range(geometry.shape[0]):
        block[SPOILED, j] = 0.0 * (geometry[j, 0] + geometry[j, 1] + (geometry[j, 2] + geometry[j, 3]))
    for i in range(4):
        for j in range(geometry.shape[0]):
            angles[i, j] = geometry[j, i]


@njit(cache=True, fastmath=FAST, error_model="numpy")
def pack_geometry(geometry, n, k, angles, block):
    """Fill cosθ_i, F G / cosθ_r, φ² of a texel's block, and NaN where an observation's angles are not all finite.

    Parameters
    ----------
    geometry : (J, 4) float
        θ_i, θ_r, θ_H, φ in rad; where one is not finite, what is filled is of no use, but finite.
    n, k : float
    angles : (4, P) float64
        Scratch; P is J padded to a multiple of `LANES`.
    block : (ROWS, P) float64
    """
    _gather(geometry, angles, block)
    for j in range(block.shape[1]):
        phi = angles[3, j] if abs(angles[3, j]) < math.pi else math.pi
        block[SQUARE, j] = phi * phi
    flat = angles.reshape(angles.size)
    for j in range(flat.size):
        flat[j] = cosine_of(flat[j])
    for j in range(block.shape[1]):
        cos_i, cos_r, cos_h, cos_phi = angles[0, j], angles[1, j], angles[2, j], angles[3, j]
        block[LOBE, j] = cos_r
        angles[1, j] = attenuation(cos_i, cos_r, cos_h, cos_phi)
    for j in range(block.shape[1]):
        # Light and eye are on the outer side, or no light is carried.
        block[COSINE, j] = angles[0, j] if angles[0, j] > 0.0 and block[LOBE, j] > 0.0 else 0.0
        block[GLOSS, j] = fresnel(angles[2, j], n, k) * angles[1, j]


@njit(cache=True)
def padded(observations: int) -> int:
    """Return a row's length: observations, rounded up to a multiple of `LANES`."""
    return (observations + LANES - 1) // LANES * LANES
