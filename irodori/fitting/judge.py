"""Assessment of a fitted texel: residual, standard errors, choice of model, status.

Most is for one texel and for eight, see `irodori.fitting.texel_rows`. The covariance is that of least squares with
weights that need not be the inverse variances, A⁻¹ (Σ w² v J Jᵀ) A⁻¹ with A = Σ w J Jᵀ. The variance v of an
observation is that of noise and model error, and what an error of the pose does to it: on a steep flank of the lobe,
far more than to the response. It is multiplied by χ² over degrees of freedom where that exceeds 1. Where χ² is larger
than mostly by chance, the model may be off, and where is shown by the residuals: no error is less than the one with
variances from them. An error that all photographs share, such as the level of the light, leaves no residual: it is
added to α and β in full.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.fitting.texel_rows import (
    COSINE,
    F0,
    F1,
    F2,
    GLOSS,
    LOBE,
    LOBE_SLOPE,
    RESPONSE,
    SPOILED,
    WEIGHT,
    folded,
    get,
    put,
    vectors_of,
)
from irodori.fitting.texel_rows import VARIANCE as EXPECTED
from irodori.jit.compilation import njit, uncounted
from irodori.jit.functions import log, lower_of, root, select, upper_of
from irodori.jit.vector_memory import spread
from irodori.material.material_file import Status
from irodori.reflection import lobes as lobe_kernels

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
_CONTRADICTED = int(Status.CONTRADICTED)
#: Share of its peak at which a lobe must be seen at least, or its height is an extrapolation.
SEEN = math.exp(-2.0)
_WITHIN = math.exp(-1.0)  # share of its peak down to which a lobe is a highlight
#: Observations that must see a lobe so high: one tells its height or its width.
TWICE = 2.0
SINGULAR = 1e-10
_TOLD_APART = 1e-6
_NEAR = 2.0  # standard errors of log μ from a bound, within which the bound decides and not the data
#: Standard deviations of χ² by which it exceeds the degrees of freedom of one right model in 6, in 50, in 400.
_ONE_IN_6, _ONE_IN_50, _ONE_IN_400 = 1.0, 2.5, 4.0
LEAST_LEFT = 0.02  # of an observation's error that its residual is taken to show at least


class Verdict(NamedTuple):
    """Assessment of a texel; see the columns."""

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
    """Standard errors of α, β, log μ (infinite where undetermined), sum of squares, and two findings.

    ``seen`` is whether the lobe is, ``fits`` whether the observations allow the model. Numbers, or lanes and masks.
    """

    alpha: float
    beta: float
    log_mu: float
    squares: float
    seen: bool
    fits: bool


class Normal(NamedTuple):
    """Σ w J Jᵀ scaled to a unit diagonal, J along α, β, log μ; numbers or lanes.

    Parameters
    ----------
    scale : tuple of three
        By which a row and a column were multiplied.
    correlation : tuple of three
        α with β, α with log μ, β with log μ.
    determinant : float or lanes
        Near zero where two parameters cannot be told apart.
    """

    scale: tuple
    correlation: tuple
    determinant: float


@uncounted(error_model="numpy")
def sums_at_minimum(rows, lobes, found, rules, with_variances):
    """Return what is summed over the observations of one texel, or of each of eight, at the minimum.

    Leaves the gloss of every observation for β = 1, and its slope along log μ.

    Parameters
    ----------
    rows : (ROWS, P) float64
    lobes : Lobes
        One lobe.
    found : irodori.fitting.observations.Minimum
    rules : irodori.fitting.observations.Rules
    with_variances : bool
        Whether χ² and the sums with v are asked for; else they are 0.

    Returns
    -------
    squares, chi2 : float or lanes
    normal, middle : tuples of six
        Σ w J Jᵀ and Σ w² v J Jᵀ, J along α, β, log μ.
    seen : bool or mask
        Whether observations enough with weight lie where the lobe is high.
    """
    a, b, log_mu, _ = found
    constant, zero = lobe_kernels.constants(lobes, log_mu), spread(0.0)
    n0, n1, n2, n3, n4, n5, squares = zero, zero, zero, zero, zero, zero, zero
    m0, m1, m2, m3, m4, m5, chi2 = zero, zero, zero, zero, zero, zero, zero
    seen = zero
    for j in range(vectors_of(rows)):
        f0, f1, f2 = get(rows, F0, j), get(rows, F1, j), get(rows, F2, j)
        c, w, plain = get(rows, COSINE, j), get(rows, WEIGHT, j), get(rows, GLOSS, j)
        value, slope, _ = lobe_kernels.derivatives(lobes, constant, f0, f1, f2)
        share, steepness = lobe_kernels.flank(lobes, constant, f0, f1, f2)
        g, g1 = plain * value, plain * slope
        put(rows, LOBE, j, g)
        put(rows, LOBE_SLOPE, j, g1)
        s, gloss = b * g1, b * g
        r = a * c + gloss - get(rows, RESPONSE, j)
        squares = squares + w * r * r
        seen = seen + select((w > 0.0) & (plain > 0.0) & (share >= SEEN), 1.0, 0.0)
        wc, wg, ws = w * c, w * g, w * s
        n0, n1, n2 = n0 + wc * c, n1 + wc * g, n2 + wg * g
        n3, n4, n5 = n3 + wc * s, n4 + wg * s, n5 + ws * s
        if with_variances:
            # Both angles of the rig are off: θ_i by one, φ = |θ_i - θ_r| / 2 by 1/√2 of it.
            pose = 0.5 * steepness * gloss * gloss + a * a * (1.0 - c * c)
            v = get(rows, EXPECTED, j) + rules.pose_variance * pose
            chi2 = chi2 + select(w > 0.0, r * r / v, 0.0)
            wv = w * v
            m0, m1, m2 = m0 + wc * c * wv, m1 + wc * g * wv, m2 + wg * g * wv
            m3, m4, m5 = m3 + wc * s * wv, m4 + wg * s * wv, m5 + ws * s * wv
    return (
        folded(squares, log_mu), folded(chi2, log_mu), _folded_six((n0, n1, n2, n3, n4, n5), log_mu),
        _folded_six((m0, m1, m2, m3, m4, m5), log_mu), folded(seen, log_mu) >= TWICE,
    )  # fmt: skip


@njit(cache=True, forceinline=True)
def _folded_six(m, zero):
    return (
        folded(m[0], zero), folded(m[1], zero), folded(m[2], zero),
        folded(m[3], zero), folded(m[4], zero), folded(m[5], zero),
    )  # fmt: skip


@njit(cache=True, error_model="numpy", forceinline=True)
def _sandwich(m, i0, i1, i2):
    """Return i M iᵀ for a symmetric M in six numbers."""
    return i0 * (i0 * m[0] + 2.0 * (i1 * m[1] + i2 * m[3])) + i1 * (i1 * m[2] + 2.0 * i2 * m[4]) + i2 * i2 * m[5]


@njit(cache=True, error_model="numpy", forceinline=True)
def students(degrees):
    """Return by what Student's distribution widens a variance that the residuals tell.

    The interval which holds 68 % of a normal variable, to 0.3 % for any degrees of freedom.
    """
    wider = 1.0 + (0.5 + 0.25 / degrees + 0.087 / (degrees * degrees * degrees)) / degrees
    return wider * wider


@uncounted(error_model="numpy")
def excess_of(chi2, degrees):
    """Return the factor of variances: χ² over degrees of freedom where that exceeds 1, with Student's factor."""
    return select(chi2 > degrees, chi2 / degrees * students(degrees), 1.0)


@njit(cache=True, error_model="numpy", forceinline=True)
def doubtful(chi2, degrees, rules):
    """Return whether χ² is one that few right models have: numbers or lanes; never where noise is not known."""
    return (chi2 > degrees + _ONE_IN_6 * root(2.0 * degrees)) & (chi2 >= (0.0 if rules.known else np.inf))


@njit(cache=True, error_model="numpy", forceinline=True)
def expected(chi2, degrees):
    """Return whether χ² is one that nearly all right models have."""
    return chi2 <= degrees + _ONE_IN_50 * root(2.0 * degrees)


@uncounted(error_model="numpy")
def allowed(chi2, degrees, rules):
    """Return whether observations allow a model: numbers or lanes; always where the camera's noise is not known."""
    return (chi2 <= degrees + _ONE_IN_400 * root(2.0 * degrees)) | (chi2 < (0.0 if rules.known else np.inf))


@uncounted(error_model="numpy")
def _lone_alpha(normal, middle, excess, a, rules):
    """Return the standard error of α where β and μ are open: of the part of its column that is not theirs.

    What β and μ take up entirely, such as the one observation that sees the lobe, says nothing of α, however uncertain:
    along the valley of β and μ that explain it alike the error of α is the same.
    """
    if not normal[0] > 0.0:
        return np.inf
    on_gloss, on_slope, told = 0.0, 0.0, 0.0
    if normal[2] > 0.0:
        on_gloss = normal[1] / normal[2]
        apart = 1.0 - normal[4] / normal[2] * (normal[4] / normal[5]) if normal[5] > 0.0 else 0.0
        if apart > SINGULAR:
            on_gloss, on_slope = (
                (on_gloss - normal[4] / normal[2] * (normal[3] / normal[5])) / apart,
                (normal[3] - on_gloss * normal[4]) / normal[5] / apart,
            )
        told = (on_gloss * normal[1] + on_slope * normal[3]) / normal[0]
    if not 1.0 - told > _TOLD_APART:
        return np.inf
    own, common = normal[0] * (1.0 - told), rules.level_error * a
    return math.sqrt(excess * max(_sandwich(middle, 1.0, -on_gloss, -on_slope), 0.0) / (own * own) + common * common)


@uncounted(error_model="numpy")
def scatter(rows, a, b, normal):
    """Return Σ w² v J Jᵀ with the variances v of the residuals, at least the expected ones.

    A residual is smaller than the error by what the observation decides itself, its leverage h: v = r² / (1 - h)²
    (HC3; MacKinnon and White, J. Econometrics 29, 1985). After `sums_at_minimum`, for one texel or for eight.
    """
    scale, (p, q, r), determinant = normal
    i0, i1, i2 = 1.0 - r * r, 1.0 - q * q, 1.0 - p * p
    i01, i02, i12 = q * r - p, p * r - q, p * q - r
    inverse, zero = 1.0 / determinant, spread(0.0)
    m0, m1, m2, m3, m4, m5 = zero, zero, zero, zero, zero, zero
    for j in range(vectors_of(rows)):
        w, c, g, s = get(rows, WEIGHT, j), get(rows, COSINE, j), get(rows, LOBE, j), b * get(rows, LOBE_SLOPE, j)
        u0, u1, u2 = c * scale[0], g * scale[1], s * scale[2]
        form = u0 * (i0 * u0 + 2.0 * (i01 * u1 + i02 * u2)) + u1 * (i1 * u1 + 2.0 * i12 * u2) + i2 * u2 * u2
        left = upper_of(1.0 - w * form * inverse, LEAST_LEFT)
        off = (a * c + b * g - get(rows, RESPONSE, j)) / left
        u = w * w * upper_of(off * off, get(rows, EXPECTED, j))
        uc, ug = u * c, u * g
        m0, m1, m2 = m0 + uc * c, m1 + uc * g, m2 + ug * g
        m3, m4, m5 = m3 + uc * s, m4 + ug * s, m5 + u * s * s
    return _folded_six((m0, m1, m2, m3, m4, m5), b)


@uncounted(error_model="numpy")
def full_errors(rows, lobes, found, used, rules, with_alpha):
    """Return the standard errors of α, β, log μ of a texel, or of β and log μ alone."""
    squares, chi2, sums, middle, seen = sums_at_minimum(rows, lobes, found, rules, True)
    degrees = float(max(used - (3 if with_alpha else 2), 1))
    excess, fits = excess_of(chi2, degrees), allowed(chi2, degrees, rules)
    if not (sums[0] > 0.0 and sums[2] > 0.0 and sums[5] > 0.0):
        lone = _lone_alpha(sums, middle, excess, found.alpha, rules) if with_alpha else np.inf
        return Errors(lone, np.inf, np.inf, squares, seen, fits)
    normal = correlations(sums)
    if not with_alpha:
        r = normal.correlation[2]
        normal = Normal(normal.scale, (0.0, 0.0, r), 1.0 - r * r)
    if not normal.determinant > SINGULAR:
        lone = _lone_alpha(sums, middle, excess, found.alpha, rules) if with_alpha else np.inf
        return Errors(lone, np.inf, np.inf, squares, seen, fits)
    if not rules.known:
        middle = scatter(rows, found.alpha, found.beta, normal)
        excess = 1.0
    alpha, beta, along = parameter_errors(middle, normal, excess, found, rules)
    if doubtful(chi2, degrees, rules):
        own = parameter_errors(scatter(rows, found.alpha, found.beta, normal), normal, students(degrees), found, rules)
        alpha, beta, along = max(alpha, own[0]), max(beta, own[1]), max(along, own[2])
    return Errors(alpha if with_alpha else np.inf, beta, along, squares, seen, fits)


@uncounted(error_model="numpy")
def correlations(sums):
    """Return the `Normal` of Σ w J Jᵀ in six numbers or lanes."""
    s0, s1, s2 = 1.0 / root(sums[0]), 1.0 / root(sums[2]), 1.0 / root(sums[5])
    p, q, r = sums[1] * s0 * s1, sums[3] * s0 * s2, sums[4] * s1 * s2
    return Normal((s0, s1, s2), (p, q, r), 1.0 + 2.0 * p * q * r - p * p - q * q - r * r)


@uncounted(error_model="numpy")
def parameter_errors(middle, normal, excess, found, rules):
    """Return the standard errors of α, β, log μ from Σ w² v J Jᵀ and the `Normal`; numbers or lanes."""
    (s0, s1, s2), (p, q, r), determinant = normal
    scaled = (
        middle[0] * s0 * s0, middle[1] * s0 * s1, middle[2] * s1 * s1,
        middle[3] * s0 * s2, middle[4] * s1 * s2, middle[5] * s2 * s2,
    )  # fmt: skip
    factor = excess / (determinant * determinant)
    va = _sandwich(scaled, 1.0 - r * r, q * r - p, p * r - q)
    vb = _sandwich(scaled, q * r - p, 1.0 - q * q, p * q - r)
    vt = _sandwich(scaled, p * r - q, p * q - r, 1.0 - p * p)
    common = rules.level_error * rules.level_error
    return (
        root(upper_of(va * factor, 0.0) * s0 * s0 + common * found.alpha * found.alpha),
        root(upper_of(vb * factor, 0.0) * s1 * s1 + common * found.beta * found.beta),
        root(upper_of(vt * factor, 0.0)) * s2,
    )


@uncounted(error_model="numpy")
def diffuse_errors(rows, a, used, rules):
    """Return the standard error of α where there is no gloss, the sum of squares, and whether that is `allowed`."""
    normal, middle, squares, chi2 = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for j in range(vectors_of(rows)):
        c, w = get(rows, COSINE, j), get(rows, WEIGHT, j)
        v = get(rows, EXPECTED, j) + rules.pose_variance * a * a * (1.0 - c * c)
        r = a * c - get(rows, RESPONSE, j)
        squares = squares + w * r * r
        chi2 = chi2 + select(w > 0.0, r * r / v, 0.0)
        normal = normal + w * c * c
        middle = middle + w * w * v * c * c
    information = folded(normal, a)
    degrees = float(max(used - 1, 1))
    excess, fits = excess_of(folded(chi2, a), degrees), allowed(folded(chi2, a), degrees, rules)
    variance = excess * folded(middle, a) / (information * information) if information > 0.0 else np.inf
    return math.sqrt(variance + (rules.level_error * a) ** 2), folded(squares, a), fits


@uncounted(error_model="numpy")
def without_gloss(evidence, rules):
    """Return the best α without gloss, and the criteria of the models of diffuse light alone and of nothing.

    For one texel or for eight.
    """
    used, floor, fixed = evidence
    diffuse = select(fixed[0] > 0.0, fixed[1] / fixed[0], 0.0)
    diffuse = lower_of(upper_of(diffuse, rules.low_alpha), rules.high_alpha)
    squares = upper_of(fixed[2] + diffuse * (diffuse * fixed[0] - 2.0 * fixed[1]), 0.0)
    alone = information_criterion(squares, used, floor, log(upper_of(used, 1.0)))
    return diffuse, alone, information_criterion(fixed[2], used, floor, 0.0)


@njit(cache=True, error_model="numpy", forceinline=True)
def information_criterion(squares, used, floor, penalty):
    """Return Schwarz's BIC where the variance is unknown but at least the expected one; log(used) an unknown."""
    floor = upper_of(floor, 1e-300)
    excess = squares / (used * floor)
    return used * select(excess > 1.0, log(upper_of(excess, 1.0)) + 1.0, excess) + penalty


@uncounted(error_model="numpy")
def highlight_clips(rows, lobes, clipped, log_mu, glossy):
    """Return whether most of a texel's observations within the highlight clip; without a fitted one, whether any does.

    Without one the highlight reaches as far as what clips.
    """
    constant, furthest = lobe_kernels.constants(lobes, log_mu), -1.0
    if not glossy:
        for j in range(clipped.size):
            if clipped[j] and rows[GLOSS, j] > 0.0:
                furthest = max(furthest, rows[F0, j])
    clips, good = 0, 0
    for j in range(clipped.size):
        within = rows[F0, j] <= furthest
        if glossy:
            within = lobe_kernels.flank(lobes, constant, rows[F0, j], rows[F1, j], rows[F2, j])[0] >= _WITHIN
        if within and rows[GLOSS, j] > 0.0:
            clips += clipped[j] != 0
            good += rows[WEIGHT, j] > 0.0
    return clips > 0 and clips >= good


@uncounted()
def status_of_too_few(used, response, weight, rows, clipped):
    """Return the status of a texel with too few observations, by what became of the others."""
    clips, lost = 0, 0
    for j in range(clipped.size):
        clips += clipped[j] != 0
    for j in range(response.size):
        offered = weight[j] > 0.0 or math.isnan(weight[j])
        fine = math.isfinite(response[j] + rows[SPOILED, j]) and weight[j] < np.inf
        lost += offered and not fine
    if used + clips > _FEW:
        return _SATURATED
    return _NON_FINITE if used + lost > _FEW else _FEW_STATUS


@uncounted(error_model="numpy")
def diffuse_status(rows, lobes, clipped, model, diffuse, rules):
    """Return the status of a texel whose data shows no gloss; ``diffuse`` is α and whether the model fits."""
    alpha, fits = diffuse
    if highlight_clips(rows, lobes, clipped, 0.0, False):
        return _SATURATED
    if model == NOTHING:
        return _DARK
    pinned = alpha >= rules.high_alpha * (1.0 - 1e-6) or 0.0 < alpha <= rules.low_alpha * (1.0 + 1e-6)
    if pinned:
        return _AT_BOUND
    return _DIFFUSE_ONLY if fits else _CONTRADICTED


@uncounted(error_model="numpy")
def shown_dark(a, error, fixed):
    """Return whether α is known to be small: its share of the power, two standard errors up, is under a tenth."""
    high = a + 2.0 * error
    return high * high * fixed[0] < 0.1 * fixed[2]


@uncounted(error_model="numpy")
def gloss_status(rows, lobes, clipped, found, errors, rules):
    """Return the status of a texel whose data shows gloss."""
    if highlight_clips(rows, lobes, clipped, found.log_mu, True):
        return _SATURATED
    return int(gloss_status_of(found, errors, rules))


@uncounted(error_model="numpy")
def gloss_status_of(found, errors, rules):
    """Return the status of gloss that does not clip; numbers or lanes.

    Where β and μ cannot be told apart, a bound that one of them meets is where the search along their valley ended, and
    no finding. A bound of μ within two standard errors is one: a rougher surface than any allowed would look alike.
    """
    a, b, log_mu, _ = found
    edge = (b >= rules.high_beta * (1.0 - 1e-6)) | (log_mu >= rules.high_log_mu - 1e-4)
    edge = edge | (log_mu <= rules.low_log_mu + 1e-4)
    if rules.low_beta > 0.0:
        edge = edge | (b <= rules.low_beta * (1.0 + 1e-6))
    edge = (edge & (errors.beta < np.inf)) | (a >= rules.high_alpha * (1.0 - 1e-6))
    if rules.low_alpha > 0.0:
        edge = edge | (a <= rules.low_alpha * (1.0 + 1e-6))
    known = (errors.beta < _BETA * b) & (errors.log_mu < _MU) & errors.seen
    reach = _NEAR * errors.log_mu
    edge = edge | (known & ((log_mu + reach >= rules.high_log_mu) | (log_mu - reach <= rules.low_log_mu)))
    stated = select(errors.fits, float(_OK), float(_CONTRADICTED))
    return select(edge, float(_AT_BOUND), select(known, stated, float(_UNIDENTIFIABLE)))
