"""Assessment of eight fitted texels at once, for the ordinary case of diffuse light and gloss.

Every step is that of `irodori.fitting.judge` for one texel.
"""

from irodori.fitting import judge
from irodori.fitting.vectorised_rows import (
    L_COSINE,
    L_GLOSS,
    L_LOBE,
    L_RESPONSE,
    L_SQUARE,
    L_VARIANCE,
    L_WEIGHT,
    row_place,
)
from irodori.jit.lanes import COUNT, exponential, load, log, lower_of, negated, select, spread, store, upper_of
from irodori.jit.native import uncounted

SURE = 4.0  # standard errors of α from zero, from which on a model without diffuse light is not tried
_SINGULAR = 1e-10


@uncounted(error_model="numpy")
def _normal(rows, captures, a, b, log_mu, rules):
    """Return what `irodori.fitting.judge` sums at the minimum, and which lobes are seen where they are high.

    Leaves the gloss of every observation for β = 1.
    """
    factor, zero = -exponential(-2.0 * log_mu), spread(0.0)
    slope_factor = 2.0 * b * b * factor * factor
    n0, n1, n2, n3, n4, n5, squares = zero, zero, zero, zero, zero, zero, zero
    m0, m1, m2, m3, m4, m5, chi2 = zero, zero, zero, zero, zero, zero, zero
    seen = zero > 0.0
    for j in range(captures):
        q, c, w = (load(rows, row_place(L_SQUARE, j, captures)), load(rows, row_place(L_COSINE, j, captures)),
                   load(rows, row_place(L_WEIGHT, j, captures)))  # fmt: skip
        x, plain = q * factor, load(rows, row_place(L_GLOSS, j, captures))
        g = plain * exponential(x)
        store(rows, row_place(L_LOBE, j, captures), g)
        s = -2.0 * b * x * g
        pose = slope_factor * q * g * g + a * a * (1.0 - c * c)
        v = load(rows, row_place(L_VARIANCE, j, captures)) + rules.pose_variance * pose
        r = a * c + b * g - load(rows, row_place(L_RESPONSE, j, captures))
        squares = squares + w * r * r
        chi2 = chi2 + select(w > 0.0, r * r / v, 0.0)
        seen = seen | ((w > 0.0) & (plain > 0.0) & (x >= judge.LOG_LEAST_LOBE))
        wc, wg, ws = w * c, w * g, w * s
        n0, n1, n2 = n0 + wc * c, n1 + wc * g, n2 + wg * g
        n3, n4, n5 = n3 + wc * s, n4 + wg * s, n5 + ws * s
        wv = w * v
        m0, m1, m2 = m0 + wc * c * wv, m1 + wc * g * wv, m2 + wg * g * wv
        m3, m4, m5 = m3 + wc * s * wv, m4 + wg * s * wv, m5 + ws * s * wv
    return squares, chi2, (n0, n1, n2, n3, n4, n5), (m0, m1, m2, m3, m4, m5), seen


@uncounted(error_model="numpy")
def _scatter(rows, captures, a, b, log_mu, correlation, scale, determinant):
    """Return what `irodori.fitting.judge` does where the variances are not known; after `_normal`."""
    p, q, r = correlation
    i0, i1, i2 = 1.0 - r * r, 1.0 - q * q, 1.0 - p * p
    i01, i02, i12 = q * r - p, p * r - q, p * q - r
    factor, inverse, zero = -exponential(-2.0 * log_mu), 1.0 / determinant, spread(0.0)
    m0, m1, m2, m3, m4, m5 = zero, zero, zero, zero, zero, zero
    for j in range(captures):
        x, w = load(rows, row_place(L_SQUARE, j, captures)) * factor, load(rows, row_place(L_WEIGHT, j, captures))
        c, g = load(rows, row_place(L_COSINE, j, captures)), load(rows, row_place(L_LOBE, j, captures))
        s = -2.0 * b * x * g
        u0, u1, u2 = c * scale[0], g * scale[1], s * scale[2]
        form = u0 * (i0 * u0 + 2.0 * (i01 * u1 + i02 * u2)) + u1 * (i1 * u1 + 2.0 * i12 * u2) + i2 * u2 * u2
        left = upper_of(1.0 - w * form * inverse, judge.LEAST_LEFT)
        off = (a * c + b * g - load(rows, row_place(L_RESPONSE, j, captures))) / left
        u = w * w * upper_of(off * off, load(rows, row_place(L_VARIANCE, j, captures)))
        uc, ug = u * c, u * g
        m0, m1, m2 = m0 + uc * c, m1 + uc * g, m2 + ug * g
        m3, m4, m5 = m3 + uc * s, m4 + ug * s, m5 + u * s * s
    return m0, m1, m2, m3, m4, m5


@uncounted(error_model="numpy")
def judge_lanes(rows, captures, fixed, found, used, floor, rules, results):
    """Fill the results of lanes that call for diffuse light and gloss; return which they are."""
    a, b, log_mu = found
    squares, chi2, normal, middle, seen = _normal(rows, captures, a, b, log_mu, rules)
    scale, correlation, determinant = judge.correlations(normal)
    plain = (normal[0] > 0.0) & (normal[2] > 0.0) & (normal[5] > 0.0) & (determinant > _SINGULAR) & (b > 0.0)
    excess = judge.excess_of(chi2, upper_of(used - 3.0, 1.0))
    if not rules.known:
        middle = _scatter(rows, captures, a, b, log_mu, correlation, scale, determinant)
        excess = spread(1.0)
    errors = judge.parameter_errors(middle, scale, correlation, determinant, excess, a, b, rules)
    unknown = log(upper_of(used, 1.0))
    diffuse = lower_of(upper_of(fixed[1] / fixed[0], rules.low_alpha), rules.high_alpha)
    alone = upper_of(fixed[2] + diffuse * (diffuse * fixed[0] - 2.0 * fixed[1]), 0.0)
    simpler = judge.information_criterion(alone, used, floor, unknown)
    if rules.low_alpha == 0.0:
        simpler = lower_of(simpler, judge.information_criterion(fixed[2], used, floor, spread(0.0)))
        high = a + 2.0 * errors[0]
        plain = plain & ((a > SURE * errors[0]) | negated(high * high * fixed[0] < 0.1 * fixed[2]))
    if not rules.low_beta > 0.0:
        plain = plain & (judge.information_criterion(squares, used, floor, 3.0 * unknown) < simpler)
    status = judge.gloss_status_of(a, b, log_mu, errors, seen, rules)
    variance = upper_of(squares / (used - judge.PARAMETERS), floor)
    for column, value in (
        (judge.ALPHA, a), (judge.BETA, b), (judge.LOG_MU, log_mu), (judge.ALPHA_ERROR, errors[0]),
        (judge.BETA_ERROR, errors[1]), (judge.LOG_MU_ERROR, errors[2]), (judge.SQUARES, squares / fixed[3]),
        (judge.POWER, fixed[2] / fixed[3]), (judge.VARIANCE, variance / fixed[3]), (judge.COLUMNS, status),
    ):  # fmt: skip
        store(results, column * COUNT, value)
    return plain
