"""Assessment of a fitted texel: residual, standard errors, choice of model, status.

Most functions work on one texel or on eight at once, see `irodori.fitting.texel_rows`.

The covariance of the parameters is that of least squares with arbitrary weights: A⁻¹ (Σ w² v J Jᵀ) A⁻¹ with A = Σ w J
Jᵀ. The variance v of an observation is the sum of the variances from noise, model error and pose error; on a steep
flank of the lobe the pose error dominates. If χ² exceeds the degrees of freedom, the covariance is multiplied by their
ratio. If χ² is larger than is usual by chance, the model may be wrong; then the covariance is also computed with
variances taken from the residuals, and the larger standard errors are used. Errors that all photographs share, such as
that of the light level, leave no residuals and are added to the errors of α and β in full.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.fitting.closed_form import best_pair
from irodori.fitting.observations import TINY
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
    item,
    put,
    vectors_of,
)
from irodori.fitting.texel_rows import VARIANCE as EXPECTED
from irodori.fitting.varpro import CG, GG, RG
from irodori.jit.compilation import njit, uncounted
from irodori.jit.functions import exp, log, lower_of, root, select, upper_of
from irodori.jit.vector_memory import spread
from irodori.material.material_file import Status
from irodori.reflection import lobes as lobe_kernels

#: Relative standard error beyond which a parameter counts as not determined.
MAX_RELATIVE_ERROR = {"beta": 0.3, "mu": 0.2}
_BETA, _MU = MAX_RELATIVE_ERROR["beta"], MAX_RELATIVE_ERROR["mu"]
PARAMETERS = 3
_FEW = PARAMETERS
NOTHING, DIFFUSE_ALONE, GLOSS_ALONE, BOTH = range(4)
#: Columns of the table of results; the last three are divided by the sum of the weights.
ALPHA, BETA, LOG_MU, ALPHA_ERROR, BETA_ERROR, LOG_MU_ERROR, SQUARES, POWER, VARIANCE = range(9)
COLUMNS = 9
_OK, _AT_BOUND, _DIFFUSE_ONLY = int(Status.OK), int(Status.AT_BOUND), int(Status.DIFFUSE_ONLY)
UNIDENTIFIABLE, _FEW_STATUS = int(Status.MU_UNIDENTIFIABLE), int(Status.TOO_FEW_OBSERVATIONS)
_NON_FINITE, _SATURATED, _DARK = int(Status.NON_FINITE), int(Status.SATURATED), int(Status.DARK)
_CONTRADICTED = int(Status.CONTRADICTED)
#: Statuses of texels with visible gloss whose β and μ are not known.
GLOSS_OPEN = UNIDENTIFIABLE, _SATURATED
#: Smallest share of the lobe's peak that must be observed; otherwise its height would be an extrapolation.
SEEN = math.exp(-2.0)
_WITHIN = math.exp(-1.0)  # share of the lobe's peak above which an observation lies within the highlight
#: Number of observations that must see the lobe above this share: a single one determines its height or its width only.
TWICE = 2.0
SINGULAR = 1e-10
_TOLD_APART = 1e-6
_NEAR = 2.0  # distance of log μ from a bound, in standard errors, within which the bound determines μ and not the data
#: Excess of χ² over the degrees of freedom, in standard deviations, that occurs by chance in 1 of 6, 50 and 400 fits.
_ONE_IN_6, _ONE_IN_50, _ONE_IN_400 = 1.0, 2.5, 4.0
LEAST_LEFT = 0.02  # lower limit of 1 - leverage


class Verdict(NamedTuple):
    """Assessment of a texel: status, model, parameters with standard errors, residual, number of evaluations."""

    status: int
    model: int
    alpha: float
    beta: float
    log_mu: float
    alpha_error: float
    beta_error: float
    log_mu_error: float
    squares: float
    variance: float  # of an observation with weight 1, from the residuals, but at least the expected variance
    evaluations: int


class Errors(NamedTuple):
    """Standard errors of α, β, log μ (infinite where undetermined), sum of squares, and two tests.

    ``seen`` is whether enough observations lie near the peak of the lobe, ``fits`` whether χ² is compatible with the
    model. The fields are numbers, or lanes and masks of eight texels.
    """

    alpha: float
    beta: float
    log_mu: float
    squares: float
    seen: bool
    fits: bool


class Normal(NamedTuple):
    """The normal matrix Σ w J Jᵀ of α, β, log μ, scaled to a unit diagonal; numbers or lanes.

    Parameters
    ----------
    scale : tuple of three
        Factors by which rows and columns were multiplied.
    correlation : tuple of three
        Off-diagonal elements: α with β, α with log μ, β with log μ.
    determinant : float or lanes
        Near zero if the parameters cannot be separated.
    """

    scale: tuple
    correlation: tuple
    determinant: float


@uncounted(error_model="numpy")
def sums_at_minimum(rows, lobes, found, rules, with_variances):
    """Compute the sums over the observations at the minimum, for one texel or for eight.

    Also fills the rows `LOBE` and `LOBE_SLOPE` with the gloss for β = 1, and its slope along log μ.

    Parameters
    ----------
    rows : (ROWS, P) float64
    lobes : Lobes
        One lobe.
    found : irodori.fitting.observations.Minimum
    rules : irodori.fitting.observations.Rules
    with_variances : bool
        Whether to compute χ² and Σ w² v J Jᵀ; otherwise they are 0.

    Returns
    -------
    squares, chi2 : float or lanes
    normal, middle : tuples of six
        Σ w J Jᵀ and Σ w² v J Jᵀ, where J is the gradient along α, β, log μ.
    seen : bool or mask
        Whether at least two observations with weight lie near the peak of the lobe.
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
            pose = rules.phi_variance * steepness * gloss * gloss + rules.incidence_variance * a * a * (1.0 - c * c)
            v = get(rows, EXPECTED, j) + pose
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
    """Return the quadratic form i M iᵀ of a symmetric 3 x 3 matrix M, given by six numbers."""
    return i0 * (i0 * m[0] + 2.0 * (i1 * m[1] + i2 * m[3])) + i1 * (i1 * m[2] + 2.0 * i2 * m[4]) + i2 * i2 * m[5]


@njit(cache=True, error_model="numpy", forceinline=True)
def students(degrees):
    """Return the factor on a variance estimated from residuals that makes its 68 % interval that of Student's t.

    An approximation, accurate to 0.3 % for any number of degrees of freedom.
    """
    wider = 1.0 + (0.5 + 0.25 / degrees + 0.087 / (degrees * degrees * degrees)) / degrees
    return wider * wider


@uncounted(error_model="numpy")
def excess_of(chi2, degrees):
    """Return the factor on variances: if χ² exceeds the degrees of freedom, their ratio times `students`, else 1."""
    return select(chi2 > degrees, chi2 / degrees * students(degrees), 1.0)


@njit(cache=True, error_model="numpy", forceinline=True)
def doubtful(chi2, degrees, rules):
    """Return whether χ² is larger than in 5 of 6 correct models, for numbers or lanes; False if noise is unknown."""
    return (chi2 > degrees + _ONE_IN_6 * root(2.0 * degrees)) & (chi2 >= (0.0 if rules.known else np.inf))


@njit(cache=True, error_model="numpy", forceinline=True)
def expected(chi2, degrees):
    """Return whether χ² is no larger than in 49 of 50 correct models."""
    return chi2 <= degrees + _ONE_IN_50 * root(2.0 * degrees)


@uncounted(error_model="numpy")
def allowed(chi2, degrees, rules):
    """Return whether χ² is no larger than in 399 of 400 correct models, for numbers or lanes.

    True if the camera's noise is unknown.
    """
    return (chi2 <= degrees + _ONE_IN_400 * root(2.0 * degrees)) | (chi2 < (0.0 if rules.known else np.inf))


@uncounted(error_model="numpy")
def _lone_alpha(normal, middle, excess, a, rules):
    """Return the standard error of α for a texel that does not determine β and μ.

    It follows from the component of α's column of the Jacobian that is orthogonal to those of β and μ. Observations
    that β and μ can explain exactly, such as the only one that sees the lobe, do not contribute; the error of α is the
    same for all β and μ that explain them equally well.
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
    """Return Σ w² v J Jᵀ with variances v estimated from the residuals, but no smaller than the expected ones.

    An observation pulls the fit towards itself by its leverage h, which makes its residual r too small; therefore v =
    r² / (1 - h)² (HC3; MacKinnon and White, J. Econometrics 29, 1985). Call it after `sums_at_minimum`, for one texel
    or for eight.
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
    """Return the `Errors` of a texel: of α, β and log μ, or only of β and log μ if ``with_alpha`` is false."""
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
    """Scale the normal matrix Σ w J Jᵀ, given by six numbers or lanes; return it as `Normal`."""
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
    """Return the standard error of α for a texel without gloss, the sum of squares, and whether χ² is `allowed`."""
    normal, middle, squares, chi2 = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for j in range(vectors_of(rows)):
        c, w = get(rows, COSINE, j), get(rows, WEIGHT, j)
        v = get(rows, EXPECTED, j) + rules.incidence_variance * a * a * (1.0 - c * c)
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
def missed_gloss(fixed, sums, most_beta, a, variance):
    """Return how much of the α of a texel without fitted gloss may be gloss that its observations do not tell from α.

    The largest over all μ, each with the best β and its standard error, but no more gloss than a surface can have, and
    no more than α. Observations far from the mirror direction, or all at the same angles, hardly tell it; those near
    the mirror direction and beside it leave next to nothing. Observations that clip show gloss, but not how much of it
    is in the others, so that this holds for saturated texels too.

    Parameters
    ----------
    fixed : tuple of four
        Sums of `irodori.fitting.observations.Evidence`.
    sums : (SUMS, nodes) float64
        Of the scan, see `irodori.fitting.varpro`.
    most_beta : (nodes,) float64
        See `irodori.fitting.texels.Problem`.
    a, variance : float
        α without gloss, and the variance of an observation with weight 1.
    """
    most = 0.0
    if fixed[0] > 0.0:
        for i in range(most_beta.size):
            cg, gg = sums[CG, i], sums[GG, i]
            alike, beta = cg / fixed[0], most_beta[i]
            apart = gg - cg * alike
            if apart > SINGULAR * gg:
                beta = min(beta, max(sums[RG, i] - a * cg, 0.0) / apart + math.sqrt(variance / apart))
            most = max(most, beta * alike)
    return min(most, a)


@uncounted(error_model="numpy")
def alpha_over_all_mu(evidence, sums, most_beta, found, errors, rules):
    """Return the standard error of α of a texel that does not determine its gloss, for numbers or lanes.

    Lobes of other widths may explain such observations as well, with another α, particularly if all angles are nearly
    the same: the sum of squares is no parabola, and its curvature at the minimum does not tell of them. The error is at
    least the root mean square distance to the best α at all μ, weighted by their likelihood; no more gloss than a
    surface can have is considered.

    Parameters
    ----------
    evidence : irodori.fitting.observations.Evidence
    sums : (SUMS, nodes) float64
        Of the scan, see `irodori.fitting.varpro`.
    most_beta : (nodes,) float64
        See `irodori.fitting.texels.Problem`.
    found : irodori.fitting.observations.Minimum
    errors : Errors
    rules : irodori.fitting.observations.Rules
    """
    (used, floor, fixed), a = evidence, found.alpha
    variance = upper_of(errors.squares / upper_of(used - float(PARAMETERS), 1.0), floor)
    least, total, square = a + np.inf, 0.0 * a, 0.0 * a
    for last in (False, True):
        for i in range(most_beta.size):
            cg, rg, gg = item(sums, CG, i, a), item(sums, RG, i, a), item(sums, GG, i, a)
            most = max(min(most_beta[i], rules.high_beta), rules.low_beta)
            other, _, value = best_pair(fixed, cg, rg, gg, (rules.low_alpha, rules.high_alpha, rules.low_beta, most))
            if not last:
                least = lower_of(value, least)
                continue
            alike, apart = cg / fixed[0], gg - cg * cg / fixed[0]
            gloss = lower_of(variance / upper_of(apart, SINGULAR * gg + TINY), most * most)
            weight = exp(0.5 * (least - value) / variance)
            off = (other - a) * (other - a) + variance / fixed[0] + gloss * alike * alike
            total, square = total + weight, square + weight * off
    common = rules.level_error * a
    return upper_of(errors.alpha, root(square / total + common * common))


@uncounted(error_model="numpy")
def without_gloss(evidence, rules):
    """Return the best α without gloss, and the information criteria of two models: diffuse reflection only, and none.

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
    """Return Schwarz's criterion (BIC) for an unknown variance that is at least the expected one.

    Parameters
    ----------
    squares : float or lanes
        Weighted sum of squares.
    used : float or lanes
        Number of observations.
    floor : float or lanes
        Expected weighted square of a residual.
    penalty : float or lanes
        log(used) for each unknown of the model.
    """
    floor = upper_of(floor, 1e-300)
    excess = squares / (used * floor)
    return used * select(excess > 1.0, log(upper_of(excess, 1.0)) + 1.0, excess) + penalty


@uncounted(error_model="numpy")
def highlight_clips(rows, lobes, clipped, log_mu, glossy):
    """Return whether at least half of the observations within the highlight of a texel are clipped.

    If no gloss was fitted (``glossy`` is false), the highlight is taken to extend as far as the clipped observations.
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
    """Return the status of a texel with too few usable observations: saturated, non-finite, or simply too few."""
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
    """Return the status of a texel without visible gloss; ``diffuse`` is α, and whether the diffuse model fits."""
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
    """Return whether α, plus two standard errors, explains less than a tenth of the squared responses."""
    high = a + 2.0 * error
    return high * high * fixed[0] < 0.1 * fixed[2]


@uncounted(error_model="numpy")
def gloss_status(rows, lobes, clipped, found, errors, rules):
    """Return the status of a texel with visible gloss."""
    if highlight_clips(rows, lobes, clipped, found.log_mu, True):
        return _SATURATED
    return int(gloss_status_of(found, errors, rules))


@uncounted(error_model="numpy")
def gloss_status_of(found, errors, rules):
    """Return the status of a texel with gloss that is not clipped, for numbers or lanes.

    If β and μ cannot be separated, the search may end at a bound by accident, so this does not count as at the bound.
    If they can, μ within two standard errors of a bound does, because values beyond the bound would fit as well.
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
    return select(edge, float(_AT_BOUND), select(known, stated, float(UNIDENTIFIABLE)))
