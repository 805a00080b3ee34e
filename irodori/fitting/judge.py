"""Assessment of a fitted texel: residual, standard errors, choice of model, status.

The covariance is that of least squares with weights that need not be the inverse variances,
A⁻¹ (Σ w² v J Jᵀ) A⁻¹ with A = Σ w J Jᵀ. The variance v of an observation is that of noise and model error, and what an
error of the pose does to it: on a steep flank of the lobe, far more than to the response. It is multiplied by χ² over
degrees of freedom where that exceeds 1. An error that all photographs share, such as the level of the light, leaves no
residual: it is added to α and β in full.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.fitting.texel_rows import COSINE, FAST, GLOSS, RESPONSE, SQUARE, TRUST, WEIGHT, exp_negative
from irodori.fitting.texel_rows import VARIANCE as EXPECTED
from irodori.jit.lanes import log, root, select, upper_of
from irodori.jit.native import njit
from irodori.material.material_file import Status

#: Relative standard error beyond which a parameter is not stated.
MAX_RELATIVE_ERROR = {"beta": 0.3, "mu": 0.2}
_BETA, _MU = MAX_RELATIVE_ERROR["beta"], MAX_RELATIVE_ERROR["mu"]
PARAMETERS = 3
_FEW = PARAMETERS
NOTHING, DIFFUSE_ALONE, GLOSS_ALONE, BOTH = range(4)
#: Columns of the table of results; the last three are means over the weights.
ALPHA, BETA, LOG_MU, ALPHA_ERROR, BETA_ERROR, LOG_MU_ERROR, SQUARES, POWER, VARIANCE = range(9)
COLUMNS = 9
_OK, _AT_BOUND, _DIFFUSE_ONLY = int(Status.OK), int(Status.AT_BOUND), int(Status.DIFFUSE_ONLY)
_UNIDENTIFIABLE, _FEW_STATUS = int(Status.MU_UNIDENTIFIABLE), int(Status.TOO_FEW_OBSERVATIONS)
_NON_FINITE, _SATURATED, _DARK = int(Status.NON_FINITE), int(Status.SATURATED), int(Status.DARK)
#: The lobe must be seen where D is at least this, or its height is an extrapolation.
LOG_LEAST_LOBE = -2.0
_SINGULAR = 1e-10
_TOLD_APART = 1e-6
LEAST_LEFT = 0.05  # of an observation's error that its residual is taken to show at least


class Verdict(NamedTuple):
    """What is said about a texel; see the columns."""

    status: int
    model: int
    alpha: float
    beta: float
    log_mu: float
    alpha_error: float
    beta_error: float
    log_mu_error: float
    squares: float
    variance: float  # of an observation of weight 1, from the residual, at least the expected one
    evaluations: int


class Errors(NamedTuple):
    """Standard errors of α, β, log μ (infinite where undetermined), sum of squares, χ² over degrees of freedom."""

    alpha: float
    beta: float
    log_mu: float
    squares: float
    excess: float


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _normal(block, a, b, log_mu, pose_variance):
    """Return the sum of squares and χ², Σ w J Jᵀ, and Σ w² v J Jᵀ, J along α, β, log μ; six numbers a matrix."""
    factor = -math.exp(-2.0 * log_mu)
    slope_factor = 2.0 * b * b * factor * factor
    n0, n1, n2, n3, n4, n5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    m0, m1, m2, m3, m4, m5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    squares, chi2 = 0.0, 0.0
    for j in range(block.shape[1]):
        x = block[SQUARE, j] * factor
        c, w = block[COSINE, j], block[WEIGHT, j]
        g = block[GLOSS, j] * exp_negative(x)
        s = -2.0 * b * x * g
        # Both angles of the rig are off: θ_i by one, φ = |θ_i - θ_r| / 2 by 1/√2 of it.
        pose = slope_factor * block[SQUARE, j] * g * g + a * a * (1.0 - c * c)
        v = block[EXPECTED, j] + pose_variance * pose
        r = a * c + b * g - block[RESPONSE, j]
        squares += w * r * r
        trust = block[TRUST, j]
        kept = w * r / (trust if trust > 0.0 else 1.0)  # an outlier counts as far as the loss lets it
        chi2 += kept * kept / v
        u = w * w * v
        n0 += w * c * c
        n1 += w * c * g
        n2 += w * g * g
        n3 += w * c * s
        n4 += w * g * s
        n5 += w * s * s
        m0 += u * c * c
        m1 += u * c * g
        m2 += u * g * g
        m3 += u * c * s
        m4 += u * g * s
        m5 += u * s * s
    return squares, chi2, (n0, n1, n2, n3, n4, n5), (m0, m1, m2, m3, m4, m5)


@njit(cache=True, error_model="numpy", inline="always")
def _sandwich(m, i0, i1, i2):
    """Return i M iᵀ for a symmetric M in six numbers."""
    return i0 * (i0 * m[0] + 2.0 * (i1 * m[1] + i2 * m[3])) + i1 * (i1 * m[2] + 2.0 * i2 * m[4]) + i2 * i2 * m[5]


@njit(cache=True, error_model="numpy")
def excess_of(chi2, degrees):
    """Return by what variances are multiplied: χ² over degrees of freedom where that exceeds 1, with Student's factor.

    The factor is that of the interval which holds 68 % of a normal variable, to 0.3 % for any degrees of freedom.
    """
    student = 1.0 + (0.5 + 0.25 / degrees + 0.087 / (degrees * degrees * degrees)) / degrees
    return select(chi2 > degrees, chi2 / degrees * student * student, 1.0)


@njit(cache=True, error_model="numpy")
def _lone_alpha(normal, middle, told, excess, a, rules):
    """Return the standard error of α where β and μ are open; ``told`` is the part of its column that is theirs."""
    if not (normal > 0.0 and 1.0 - told > _TOLD_APART):
        return np.inf
    common = rules.model_error * a
    return math.sqrt(excess * middle / (normal * normal * (1.0 - told)) + common * common)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _scatter(block, a, b, log_mu, correlation, scale, determinant):
    """Return Σ w² v J Jᵀ where the variances v are not known: those of the residuals, at least the expected ones.

    A residual is smaller than the error by what the observation decides itself, its leverage h: v = r² / (1 - h)²
    (HC3; MacKinnon and White, J. Econometrics 29, 1985).
    """
    p, q, r = correlation
    i0, i1, i2 = 1.0 - r * r, 1.0 - q * q, 1.0 - p * p
    i01, i02, i12 = q * r - p, p * r - q, p * q - r
    factor, inverse = -math.exp(-2.0 * log_mu), 1.0 / determinant
    m0, m1, m2, m3, m4, m5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(block.shape[1]):
        x, w = block[SQUARE, j] * factor, block[WEIGHT, j]
        c, g = block[COSINE, j], block[GLOSS, j] * exp_negative(x)
        s = -2.0 * b * x * g
        u0, u1, u2 = c * scale[0], g * scale[1], s * scale[2]
        form = u0 * (i0 * u0 + 2.0 * (i01 * u1 + i02 * u2)) + u1 * (i1 * u1 + 2.0 * i12 * u2) + i2 * u2 * u2
        left = 1.0 - w * form * inverse
        left = left if left > LEAST_LEFT else LEAST_LEFT
        off = (a * c + b * g - block[RESPONSE, j]) / left
        v, expected = off * off, block[EXPECTED, j]
        u = w * w * (v if v > expected else expected)
        m0 += u * c * c
        m1 += u * c * g
        m2 += u * g * g
        m3 += u * c * s
        m4 += u * g * s
        m5 += u * s * s
    return m0, m1, m2, m3, m4, m5


@njit(cache=True, error_model="numpy")
def full_errors(block, a, b, log_mu, used, rules, with_alpha):
    """Return the standard errors of α, β, log μ, or of β and log μ alone."""
    squares, chi2, normal, middle = _normal(block, a, b, log_mu, rules.pose_variance)
    excess = excess_of(chi2, max(used - (3 if with_alpha else 2), 1))
    if not (normal[0] > 0.0 and normal[2] > 0.0 and normal[5] > 0.0):
        lone = _lone_alpha(normal[0], middle[0], 0.0, excess, a, rules) if with_alpha else np.inf
        return Errors(lone, np.inf, np.inf, squares, excess)
    scale, correlation, determinant = correlations(normal)
    s0, s1, s2 = scale
    p, q, r = correlation
    if not with_alpha:
        p, q, determinant = 0.0, 0.0, 1.0 - r * r
    if not determinant > _SINGULAR:
        apart = 1.0 - r * r
        told = (p * p + q * q - 2.0 * p * q * r) / apart if apart > _SINGULAR else p * p
        lone = _lone_alpha(normal[0], middle[0], told, excess, a, rules) if with_alpha else np.inf
        return Errors(lone, np.inf, np.inf, squares, excess)
    if not rules.known:
        middle = _scatter(block, a, b, log_mu, (p, q, r), (s0, s1, s2), determinant)
        excess = 1.0
    alpha, beta, along = parameter_errors(middle, (s0, s1, s2), (p, q, r), determinant, excess, a, b, rules)
    return Errors(alpha if with_alpha else np.inf, beta, along, squares, excess)


@njit(cache=True, error_model="numpy")
def correlations(normal):
    """Return what scales Σ w J Jᵀ to a unit diagonal, its three numbers beside it then, and its determinant.

    A determinant near zero means that two parameters cannot be told apart. Numbers or lanes.
    """
    s0, s1, s2 = 1.0 / root(normal[0]), 1.0 / root(normal[2]), 1.0 / root(normal[5])
    p, q, r = normal[1] * s0 * s1, normal[3] * s0 * s2, normal[4] * s1 * s2
    return (s0, s1, s2), (p, q, r), 1.0 + 2.0 * p * q * r - p * p - q * q - r * r


@njit(cache=True, error_model="numpy")
def parameter_errors(middle, scale, correlation, determinant, excess, a, b, rules):
    """Return the standard errors of α, β, log μ from Σ w² v J Jᵀ and what `correlations` says; numbers or lanes."""
    s0, s1, s2 = scale
    p, q, r = correlation
    scaled = (
        middle[0] * s0 * s0, middle[1] * s0 * s1, middle[2] * s1 * s1,
        middle[3] * s0 * s2, middle[4] * s1 * s2, middle[5] * s2 * s2,
    )  # fmt: skip
    factor = excess / (determinant * determinant)
    va = _sandwich(scaled, 1.0 - r * r, q * r - p, p * r - q)
    vb = _sandwich(scaled, q * r - p, 1.0 - q * q, p * q - r)
    vt = _sandwich(scaled, p * r - q, p * q - r, 1.0 - p * p)
    common = rules.model_error * rules.model_error
    return (
        root(upper_of(va * factor, 0.0) * s0 * s0 + common * a * a),
        root(upper_of(vb * factor, 0.0) * s1 * s1 + common * b * b),
        root(upper_of(vt * factor, 0.0)) * s2,
    )


@njit(cache=True, fastmath=FAST, error_model="numpy")
def diffuse_errors(block, a, used, rules):
    """Return the standard error of α where there is no gloss, and the sum of squares."""
    normal, middle, squares, chi2 = 0.0, 0.0, 0.0, 0.0
    for j in range(block.shape[1]):
        c, w = block[COSINE, j], block[WEIGHT, j]
        v = block[EXPECTED, j] + rules.pose_variance * a * a * (1.0 - c * c)
        r = a * c - block[RESPONSE, j]
        squares += w * r * r
        trust = block[TRUST, j]
        kept = w * r / (trust if trust > 0.0 else 1.0)  # an outlier counts as far as the loss lets it
        chi2 += kept * kept / v
        normal += w * c * c
        middle += w * w * v * c * c
    excess = excess_of(chi2, max(used - 1, 1))
    variance = excess * middle / (normal * normal) if normal > 0.0 else np.inf
    return math.sqrt(variance + (rules.model_error * a) ** 2), squares


@njit(cache=True, error_model="numpy")
def information_criterion(squares, used, floor, penalty):
    """Return Schwarz's BIC where the variance is unknown but at least the expected one; log(used) an unknown."""
    floor = upper_of(floor, 1e-300)
    excess = squares / (used * floor)
    return used * select(excess > 1.0, log(upper_of(excess, 1.0)) + 1.0, excess) + penalty


@njit(cache=True, error_model="numpy")
def lobe_is_seen(block, log_mu):
    """Return whether an observation with weight lies where the lobe is high."""
    limit = -LOG_LEAST_LOBE * math.exp(2.0 * log_mu)
    for j in range(block.shape[1]):
        if block[WEIGHT, j] > 0.0 and block[GLOSS, j] > 0.0 and block[SQUARE, j] <= limit:
            return True
    return False


@njit(cache=True, error_model="numpy")
def highlight_clips(block, clipped, log_mu, glossy):
    """Return whether most of the observations within the highlight clip; without a fitted one, whether any does."""
    if glossy:
        limit = math.exp(2.0 * log_mu)
    else:
        limit = -1.0
        for j in range(clipped.size):
            if clipped[j] and block[GLOSS, j] > 0.0:
                limit = max(limit, block[SQUARE, j])
    clips, good = 0, 0
    for j in range(clipped.size):
        if block[SQUARE, j] <= limit and block[GLOSS, j] > 0.0:
            clips += clipped[j] != 0
            good += block[WEIGHT, j] > 0.0
    return clips > 0 and clips >= good


@njit(cache=True)
def hopeless(used, lost, clipped):
    """Return the status of a texel with too few observations, by what became of the others."""
    clips = 0
    for j in range(clipped.size):
        clips += clipped[j] != 0
    if used + clips > _FEW:
        return _SATURATED
    return _NON_FINITE if used + lost > _FEW else _FEW_STATUS


@njit(cache=True, error_model="numpy")
def diffuse_status(block, clipped, model, diffuse, rules):
    """Return the status of a texel whose data shows no gloss."""
    if highlight_clips(block, clipped, 0.0, False):
        return _SATURATED
    if model == NOTHING:
        return _DARK
    pinned = diffuse >= rules.high_alpha * (1.0 - 1e-6) or 0.0 < diffuse <= rules.low_alpha * (1.0 + 1e-6)
    return _AT_BOUND if pinned else _DIFFUSE_ONLY


@njit(cache=True, error_model="numpy")
def shown_dark(a, error, fixed):
    """Return whether α is known to be small: its share of the power, two standard errors up, is under a tenth."""
    high = a + 2.0 * error
    return high * high * fixed[0] < 0.1 * fixed[2]


@njit(cache=True, error_model="numpy")
def gloss_status(block, clipped, a, b, log_mu, errors, rules):
    """Return the status of a texel whose data shows gloss."""
    if highlight_clips(block, clipped, log_mu, True):
        return _SATURATED
    seen = lobe_is_seen(block, log_mu)
    return int(gloss_status_of(a, b, log_mu, (errors.alpha, errors.beta, errors.log_mu), seen, rules))


@njit(cache=True, error_model="numpy")
def gloss_status_of(a, b, log_mu, errors, seen, rules):
    """Return the status of gloss that does not clip; numbers or lanes, ``seen`` says whether the lobe is."""
    edge = (a >= rules.high_alpha * (1.0 - 1e-6)) | (b >= rules.high_beta * (1.0 - 1e-6))
    edge = edge | (log_mu >= rules.high_log_mu - 1e-4) | (log_mu <= rules.low_log_mu + 1e-4)
    if rules.low_alpha > 0.0:
        edge = edge | (a <= rules.low_alpha * (1.0 + 1e-6))
    if rules.low_beta > 0.0:
        edge = edge | (b <= rules.low_beta * (1.0 + 1e-6))
    known = (errors[1] < _BETA * b) & (errors[2] < _MU) & seen
    return select(edge, float(_AT_BOUND), select(known, float(_OK), float(_UNIDENTIFIABLE)))
