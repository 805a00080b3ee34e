"""Fit of two gloss components: α, β_1, β_2 in closed form, the two roughnesses by a scan over pairs and Newton steps.

Φ(log μ_1, log μ_2) is the weighted sum of squares with the best α, β_1, β_2 within their bounds. At all pairs of nodes
of the scan it follows from sums of products of lobes. The lowest local minima on this grid are refined with exact
derivatives (variable projection: Golub and Pereyra 1973). A texel gets two components if Schwarz's criterion prefers
them to the model with one (`irodori.fitting.texels`); standard errors are computed as there.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.fitting import judge
from irodori.fitting.closed_form import best_pair
from irodori.fitting.observations import Evidence, Minimum, Rules, box_of, every_lane, expect_fitted, weigh
from irodori.fitting.texel_rows import (
    BEFORE,
    COSINE,
    F0,
    F1,
    F2,
    GLOSS,
    LOBE,
    LOBE_SLOPE,
    RESPONSE,
    VARIANCE,
    WEIGHT,
    fill_lobe,
    folded,
    get,
    new_rows,
    pack_geometry,
    put,
    vectors_of,
)
from irodori.fitting.texels import Output, Problem, clipped_of, is_noisy, load_texel
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit, uncounted
from irodori.jit.vector_memory import aligned, spread
from irodori.material.material_file import Status
from irodori.reflection import lobes as lobe_kernels
from irodori.reflection.lobes import Lobes

PARAMETERS = 5  # α, β_1, log μ_1, β_2, log μ_2
#: Columns of the table of results; the errors have the order of `PARAMETERS`.
ALPHA, BETA, LOG_MU, BETA_2, LOG_MU_2, ERRORS, SQUARES, POWER = 0, 1, 2, 3, 4, 5, 10, 11
COLUMNS = 12
_CURVATURE = BEFORE  # row of the second derivative of a lobe; the scan over one roughness no longer needs it
_REGULAR = 1e-12  # smallest determinant of three normalised columns for which they can be separated
_SINGULAR = 1e-10
_DIPS = 6  # number of local minima on the grid that are refined
_MAX_STEPS = 60
_MAX_TRIALS = 14
_CONVERGED = 1e-7
_LONGEST = 0.7  # longest step of log μ
_BETA_ERROR, _MU_ERROR = judge.MAX_RELATIVE_ERROR["beta"], judge.MAX_RELATIVE_ERROR["mu"]
_CHUNK = 1024
_OK, _AT_BOUND = int(Status.OK), int(Status.AT_BOUND)
_UNIDENTIFIABLE, _SATURATED = int(Status.MU_UNIDENTIFIABLE), int(Status.SATURATED)
_CONTRADICTED = int(Status.CONTRADICTED)


class TwoTask(NamedTuple):
    """Input of a fit of two components.

    Parameters
    ----------
    problem : Problem
        Observations, with the first lobe.
    second : Lobes
        The second lobe.
    same : bool
        Whether both components have the same lobe.
    rules : Rules
    one, two : Output
        Fits of one component, with the first lobe and with the second.
    """

    problem: Problem
    second: Lobes
    same: bool
    rules: Rules
    one: Output
    two: Output


class ScanTable(NamedTuple):
    """Values of a lobe at the nodes of the scan, and sums over the observations."""

    values: np.ndarray  # (nodes, P)
    sums: np.ndarray  # (3, nodes): Σ w c g, Σ w ρ g, Σ w g²


class Covariance(NamedTuple):
    """Buffers for the standard errors; parameters in the order α, β_1, log μ_1, β_2, log μ_2."""

    normal: np.ndarray  # (PARAMETERS, PARAMETERS), Σ w J Jᵀ
    middle: np.ndarray  # (PARAMETERS, PARAMETERS), Σ w² v J Jᵀ
    inverse: np.ndarray  # (PARAMETERS, PARAMETERS), inverse of ``normal``
    column: np.ndarray  # (PARAMETERS,), J of an observation
    scale: np.ndarray  # (PARAMETERS,), factors that give ``normal`` a unit diagonal
    product: np.ndarray  # (PARAMETERS,)


class TwoRoom(NamedTuple):
    """Buffers of one thread for one texel."""

    rows: np.ndarray  # (ROWS, P), with the first lobe
    other: np.ndarray  # (ROWS, P), with the second lobe
    first: ScanTable
    second: ScanTable  # its values are multiplied by the weights
    grid: np.ndarray  # (nodes, nodes), Φ at pairs of nodes
    taken: np.ndarray  # (nodes, nodes) uint8, local minima that were refined
    covariance: Covariance


class TwoOutput(NamedTuple):
    """Results of a fit of two components.

    Parameters
    ----------
    table : (texels, COLUMNS) float64
        Valid where ``both`` is set.
    both : (texels,) uint8
        Whether the texel has two components.
    second : (texels,) uint8
        Whether a single component has the second lobe.
    status, model : (texels,) int8
        Valid where ``both`` is set.
    evaluations : (texels,) int32
    """

    table: np.ndarray
    both: np.ndarray
    second: np.ndarray
    status: np.ndarray
    model: np.ndarray
    evaluations: np.ndarray


@njit(cache=True, error_model="numpy", forceinline=True)
def _value(g, a, b1, b2):
    cc, cr, rr, c1, r1, g11, c2, r2, g22, g12 = g
    value = rr + a * (a * cc - 2.0 * cr) + b1 * (b1 * g11 + 2.0 * (a * c1 - r1))
    return max(value + b2 * (b2 * g22 + 2.0 * (a * c2 + b1 * g12 - r2)), 0.0)


@uncounted(error_model="numpy")
def best_triple(g, box):
    """Return α, β_1, β_2 within bounds that minimise the sum of squares, and the minimum.

    If the unbounded minimum lies outside the bounds, the bounded one lies on a face of the box whose bound the
    unbounded one violates. On a face, two variables are left (`best_pair`).

    Parameters
    ----------
    g : tuple of ten
        Σ w c², Σ w c ρ, Σ w ρ², Σ w c g_1, Σ w ρ g_1, Σ w g_1², Σ w c g_2, Σ w ρ g_2, Σ w g_2², Σ w g_1 g_2.
    box : tuple of four
        Lower and upper bound of α, then of β.
    """
    cc, cr, rr, c1, r1, g11, c2, r2, g22, g12 = g
    low_a, high_a, low_b, high_b = box
    m00, m01, m02 = g11 * g22 - g12 * g12, c2 * g12 - c1 * g22, c1 * g12 - c2 * g11
    determinant = cc * m00 + c1 * m01 + c2 * m02
    regular = determinant > _REGULAR * cc * g11 * g22
    a, b1, b2 = low_a, low_b, low_b
    if regular:
        m11, m12, m22 = cc * g22 - c2 * c2, c1 * c2 - cc * g12, cc * g11 - c1 * c1
        a = (m00 * cr + m01 * r1 + m02 * r2) / determinant
        b1 = (m01 * cr + m11 * r1 + m12 * r2) / determinant
        b2 = (m02 * cr + m12 * r1 + m22 * r2) / determinant
        if low_a <= a <= high_a and low_b <= b1 <= high_b and low_b <= b2 <= high_b:
            return a, b1, b2, _value(g, a, b1, b2)
    best = (low_a, low_b, low_b, np.inf)
    if a <= low_a or a > high_a:
        at = high_a if a > high_a else low_a
        fixed = (g11, r1 - at * c1, rr + at * (at * cc - 2.0 * cr), 0.0)
        x, y, value = best_pair(fixed, g12, r2 - at * c2, g22, (low_b, high_b, low_b, high_b))
        if value < best[3]:
            best = (at, x, y, value)
    if b1 <= low_b or b1 > high_b:
        at = high_b if b1 > high_b else low_b
        fixed = (cc, cr - at * c1, rr + at * (at * g11 - 2.0 * r1), 0.0)
        x, y, value = best_pair(fixed, c2, r2 - at * g12, g22, box)
        if value < best[3]:
            best = (x, at, y, value)
    if b2 <= low_b or b2 > high_b:
        at = high_b if b2 > high_b else low_b
        fixed = (cc, cr - at * c2, rr + at * (at * g22 - 2.0 * r2), 0.0)
        x, y, value = best_pair(fixed, c1, r1 - at * g12, g11, box)
        if value < best[3]:
            best = (x, y, at, value)
    return best


@uncounted(error_model="numpy")
def _fill_derivatives(rows, lobes, log_mu):
    """Fill the rows with the gloss of every observation for β = 1, and its first two derivatives along log μ."""
    constant = lobe_kernels.constants(lobes, log_mu)
    for j in range(vectors_of(rows)):
        v, v1, v2 = lobe_kernels.derivatives(lobes, constant, get(rows, F0, j), get(rows, F1, j), get(rows, F2, j))
        plain = get(rows, GLOSS, j)
        put(rows, LOBE, j, plain * v)
        put(rows, LOBE_SLOPE, j, plain * v1)
        put(rows, _CURVATURE, j, plain * v2)


@uncounted(error_model="numpy")
def _lobe_sums(rows, other):
    """Return Σ w c g, Σ w ρ g, Σ w g² for the lobe in ``other``, with cosines, responses and weights from ``rows``."""
    zero = spread(0.0)
    cg, rg, gg = zero, zero, zero
    for j in range(vectors_of(rows)):
        wg = get(rows, WEIGHT, j) * get(other, LOBE, j)
        cg, rg = cg + wg * get(rows, COSINE, j), rg + wg * get(rows, RESPONSE, j)
        gg = gg + wg * get(other, LOBE, j)
    return folded(cg, 0.0), folded(rg, 0.0), folded(gg, 0.0)


@uncounted(error_model="numpy")
def _product(one, i, other, j):
    """Return the scalar product of two rows."""
    total = spread(0.0)
    for v in range(vectors_of(one)):
        total = total + get(one, i, v) * get(other, j, v)
    return folded(total, 0.0)


@uncounted(error_model="numpy")
def tabulate(rows, other, lobes, nodes, table, weighted):
    """Fill a table with the lobe at every node, and its sums Σ w c g, Σ w ρ g, Σ w g².

    If ``weighted``, the tabulated values are multiplied by the weights.
    """
    for i in range(nodes.size):
        fill_lobe(other, lobes, nodes[i])
        table.sums[0, i], table.sums[1, i], table.sums[2, i] = _lobe_sums(rows, other)
        for j in range(vectors_of(rows)):
            g = get(other, LOBE, j)
            put(table.values, i, j, g * get(rows, WEIGHT, j) if weighted else g)


@uncounted(error_model="numpy")
def _fill_grid(fixed, room, given):
    """Fill Φ at all pairs of nodes; if both components have the same lobe, only pairs with the broader one first."""
    one, two, grid, box = room.first.sums, room.second.sums, room.grid, box_of(given.rules)
    for i in range(grid.shape[0]):
        for j in range(grid.shape[1]):
            grid[i, j] = np.inf
            if j > i or not given.same:
                g = (fixed[0], fixed[1], fixed[2], one[0, i], one[1, i], one[2, i], two[0, j], two[1, j], two[2, j],
                     _product(room.first.values, i, room.second.values, j))  # fmt: skip
                grid[i, j] = best_triple(g, box)[3]


@uncounted(error_model="numpy")
def _next_dip(grid, taken):
    """Return the pair of nodes of the lowest local minimum that is not marked yet, and mark it; -1 if there is none."""
    rows, columns = grid.shape
    best, at, to = np.inf, -1, -1
    for i in range(rows):
        for j in range(columns):
            value = grid[i, j]
            if taken[i, j] == 0 and value < best:
                dip = True
                for y in range(max(i - 1, 0), min(i + 2, rows)):
                    for x in range(max(j - 1, 0), min(j + 2, columns)):
                        dip &= not grid[y, x] < value
                if dip:
                    best, at, to = value, i, j
    if at >= 0:
        taken[at, to] = 1
    return at, to


@uncounted(error_model="numpy")
def _gram(rows, other, fixed):
    """Return the ten sums for `best_triple` from the current lobes."""
    c1, r1, g11 = _lobe_sums(rows, rows)
    c2, r2, g22 = _lobe_sums(rows, other)
    total = spread(0.0)
    for j in range(vectors_of(rows)):
        total = total + get(rows, WEIGHT, j) * get(rows, LOBE, j) * get(other, LOBE, j)
    return fixed[0], fixed[1], fixed[2], c1, r1, g11, c2, r2, g22, folded(total, 0.0)


@uncounted(error_model="numpy")
def evaluate(room, given, fixed, t1, t2):
    """Fill both lobes and their derivatives at log μ_1 = t1 and log μ_2 = t2.

    Returns
    -------
    g : tuple of ten
        Sums for `best_triple`.
    found : tuple of four
        Best α, β_1, β_2, and Φ.
    """
    _fill_derivatives(room.rows, given.problem.lobes, t1)
    _fill_derivatives(room.other, given.second, t2)
    g = _gram(room.rows, room.other, fixed)
    return g, best_triple(g, box_of(given.rules))


@uncounted(error_model="numpy")
def slopes(rows, other, g, found, box):
    """Return half the gradient (2 numbers) and half the Hessian (3 numbers) of Φ; call it after `evaluate`."""
    a, b1, b2 = found[0], found[1], found[2]
    zero = spread(0.0)
    e1, e2, d1, d2, a11, a12, a22 = zero, zero, zero, zero, zero, zero, zero
    p1, p2, q11, q12, q21, q22 = zero, zero, zero, zero, zero, zero
    for j in range(vectors_of(rows)):
        w, c, g1, g2 = get(rows, WEIGHT, j), get(rows, COSINE, j), get(rows, LOBE, j), get(other, LOBE, j)
        s1, s2 = get(rows, LOBE_SLOPE, j), get(other, LOBE_SLOPE, j)
        off = w * (a * c + b1 * g1 + b2 * g2 - get(rows, RESPONSE, j))
        e1, e2 = e1 + off * s1, e2 + off * s2
        d1, d2 = d1 + off * get(rows, _CURVATURE, j), d2 + off * get(other, _CURVATURE, j)
        w1, w2 = w * s1, w * s2
        a11, a12, a22 = a11 + w1 * s1, a12 + w1 * s2, a22 + w2 * s2
        p1, q11, q12 = p1 + w1 * c, q11 + w1 * g1, q12 + w1 * g2
        p2, q21, q22 = p2 + w2 * c, q21 + w2 * g1, q22 + w2 * g2
    r1, r2 = folded(e1, 0.0), folded(e2, 0.0)
    # Mixed derivatives of log μ with α, β_1, β_2; 0 for those at a bound.
    x, y, z = a > box[0] and a < box[1], b1 > box[2] and b1 < box[3], b2 > box[2] and b2 < box[3]
    v = (b1 * folded(p1, 0.0) if x else 0.0, b1 * folded(q11, 0.0) + r1 if y else 0.0,
         b1 * folded(q12, 0.0) if z else 0.0)  # fmt: skip
    u = (b2 * folded(p2, 0.0) if x else 0.0, b2 * folded(q21, 0.0) if y else 0.0,
         b2 * folded(q22, 0.0) + r2 if z else 0.0)  # fmt: skip
    cc, c1, g11, c2, g22, g12 = g[0], g[3], g[5], g[6], g[8], g[9]
    m = (cc if x else 1.0, c1 if x and y else 0.0, c2 if x and z else 0.0, g11 if y else 1.0,
         g12 if y and z else 0.0, g22 if z else 1.0)  # fmt: skip
    vv, vu, uu = _forms(m, v, u)
    h11 = b1 * (b1 * folded(a11, 0.0) + folded(d1, 0.0)) - vv
    h22 = b2 * (b2 * folded(a22, 0.0) + folded(d2, 0.0)) - uu
    return (b1 * r1, b2 * r2), (h11, b1 * b2 * folded(a12, 0.0) - vu, h22)


@uncounted(error_model="numpy")
def _forms(m, v, u):
    """Return v M⁻¹ v, v M⁻¹ u and u M⁻¹ u for a symmetric 3 x 3 matrix M, given by six numbers; 0 if M is singular."""
    a, b, c, d, e, f = m
    i00, i01, i02 = d * f - e * e, c * e - b * f, b * e - c * d
    i11, i12, i22 = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * i00 + b * i01 + c * i02
    if not determinant > _REGULAR * a * d * f:
        return 0.0, 0.0, 0.0
    vi = (v[0] * i00 + v[1] * i01 + v[2] * i02, v[0] * i01 + v[1] * i11 + v[2] * i12,
          v[0] * i02 + v[1] * i12 + v[2] * i22)  # fmt: skip
    ui = (u[0] * i00 + u[1] * i01 + u[2] * i02, u[0] * i01 + u[1] * i11 + u[2] * i12,
          u[0] * i02 + u[1] * i12 + u[2] * i22)  # fmt: skip
    return (
        (vi[0] * v[0] + vi[1] * v[1] + vi[2] * v[2]) / determinant,
        (vi[0] * u[0] + vi[1] * u[1] + vi[2] * u[2]) / determinant,
        (ui[0] * u[0] + ui[1] * u[1] + ui[2] * u[2]) / determinant,
    )


@uncounted(error_model="numpy")
def _step(gradient, hessian, damping, held1, held2):
    """Return Newton's step with ``damping`` added to the diagonal of the Hessian; 0 for variables held at a bound."""
    h11, h12, h22 = hessian[0] + damping, hessian[1], hessian[2] + damping
    if held1 and held2:
        return 0.0, 0.0
    if held1:
        return 0.0, -gradient[1] / h22 if h22 > 0.0 else math.copysign(_LONGEST, -gradient[1])
    if held2:
        return -gradient[0] / h11 if h11 > 0.0 else math.copysign(_LONGEST, -gradient[0]), 0.0
    determinant = h11 * h22 - h12 * h12
    if not (h11 > 0.0 and determinant > 1e-14 * h11 * h22):
        return np.nan, np.nan
    return (h12 * gradient[1] - h22 * gradient[0]) / determinant, (h12 * gradient[0] - h11 * gradient[1]) / determinant


@uncounted(error_model="numpy")
def polish(room, given, fixed, t1, t2):
    """Find the minimum of Φ near a start (t1, t2).

    Returns
    -------
    t1, t2 : float
        log μ_1 and log μ_2 at the minimum.
    found : tuple of four
        α, β_1, β_2 and Φ.
    count : int
        Evaluations of Φ.
    """
    low, high, box = given.rules.low_log_mu, given.rules.high_log_mu, box_of(given.rules)
    g, found = evaluate(room, given, fixed, t1, t2)
    damping, count = 0.0, 1
    for _ in range(_MAX_STEPS):
        gradient, hessian = slopes(room.rows, room.other, g, found, box)
        held1 = (t1 <= low and gradient[0] > 0.0) or (t1 >= high and gradient[0] < 0.0) or found[1] == 0.0
        held2 = (t2 <= low and gradient[1] > 0.0) or (t2 >= high and gradient[1] < 0.0) or found[2] == 0.0
        scale = abs(hessian[0]) + abs(hessian[2])
        moved, change = False, 0.0
        for _trial in range(_MAX_TRIALS):
            d1, d2 = _step(gradient, hessian, damping, held1, held2)
            if math.isfinite(d1 + d2):
                longest = max(abs(d1), abs(d2))
                shorter = _LONGEST / longest if longest > _LONGEST else 1.0
                n1, n2 = min(max(t1 + d1 * shorter, low), high), min(max(t2 + d2 * shorter, low), high)
                trial_g, trial = evaluate(room, given, fixed, n1, n2)
                count += 1
                if trial[3] <= found[3]:
                    change = max(abs(n1 - t1), abs(n2 - t2))
                    t1, t2, g, found, moved = n1, n2, trial_g, trial, True
                    damping = 0.1 * damping if damping > 1e-6 * scale else 0.0
                    break
            damping = max(10.0 * damping, 1e-4 * scale)
        if not moved or change < _CONVERGED:
            break
    # Fill the rows at the returned minimum: they may hold a rejected trial.
    _, found = evaluate(room, given, fixed, t1, t2)
    return t1, t2, found, count


@uncounted()
def _clear(matrix):
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            matrix[i, j] = 0


@uncounted(error_model="numpy")
def _invert(m, inverse):
    """Invert a symmetric matrix with a unit diagonal, overwriting it; return whether it is regular."""
    size = m.shape[0]
    for i in range(size):
        for j in range(size):
            inverse[i, j] = 1.0 if i == j else 0.0
    for i in range(size):
        pivot = m[i, i]
        if not pivot > _SINGULAR:
            return False
        for j in range(size):
            m[i, j] /= pivot
            inverse[i, j] /= pivot
        for k in range(size):
            factor = m[k, i]
            if k != i and factor != 0.0:
                for j in range(size):
                    m[k, j] -= factor * m[i, j]
                    inverse[k, j] -= factor * inverse[i, j]
    return True


@uncounted(error_model="numpy")
def _column(rows, other, j, b1, b2, out):
    """Fill the derivatives of an observation with respect to α, β_1, log μ_1, β_2, log μ_2."""
    out[0] = rows[COSINE, j]
    out[1], out[2] = rows[LOBE, j], b1 * rows[LOBE_SLOPE, j]
    out[3], out[4] = other[LOBE, j], b2 * other[LOBE_SLOPE, j]


@uncounted(error_model="numpy")
def _spread_of(room, given, constants, found, j):
    """Return the variance of observation j from noise, light, and pose error."""
    rows, other = room.rows, room.other
    one = lobe_kernels.flank(given.problem.lobes, constants[0], rows[F0, j], rows[F1, j], rows[F2, j])[1]
    two = lobe_kernels.flank(given.second, constants[1], other[F0, j], other[F1, j], other[F2, j])[1]
    # Both components decrease with φ, so their changes add.
    fall = found[1] * rows[LOBE, j] * math.sqrt(one) + found[2] * other[LOBE, j] * math.sqrt(two)
    rules, sine2 = given.rules, 1.0 - rows[COSINE, j] * rows[COSINE, j]
    return rows[VARIANCE, j] + rules.phi_variance * fall * fall + rules.incidence_variance * found[0] * found[0] * sine2


@uncounted(error_model="numpy")
def errors_of(room, given, at, found, used, out):
    """Fill the standard errors of the five parameters; infinite if they cannot be separated.

    The covariance is computed as in `irodori.fitting.judge`. The rows must hold the lobes at the minimum.

    Returns
    -------
    bool
        Whether χ² is compatible with the model.
    """
    normal, middle, inverse, column, scale, _ = room.covariance
    rows, other, rules, (a, b1, b2, _) = room.rows, room.other, given.rules, found
    constants = lobe_kernels.constants(given.problem.lobes, at[0]), lobe_kernels.constants(given.second, at[1])
    _clear(normal)
    _clear(middle)
    chi2 = 0.0
    for j in range(rows.shape[1]):
        w = rows[WEIGHT, j]
        if not w > 0.0:
            continue
        _column(rows, other, j, b1, b2, column)
        v = _spread_of(room, given, constants, found, j)
        off = a * column[0] + b1 * column[1] + b2 * column[3] - rows[RESPONSE, j]
        chi2 += off * off / v
        for i in range(PARAMETERS):
            for k in range(PARAMETERS):
                normal[i, k] += w * column[i] * column[k]
                middle[i, k] += w * w * v * column[i] * column[k]
    for i in range(PARAMETERS):
        out[i] = np.inf
        scale[i] = 1.0 / math.sqrt(normal[i, i]) if normal[i, i] > 0.0 else 0.0
    for i in range(PARAMETERS):
        for k in range(PARAMETERS):
            normal[i, k] *= scale[i] * scale[k]
    # α at its lower bound is not counted as an unknown.
    dark = a <= rules.low_alpha
    if dark:
        for i in range(PARAMETERS):
            normal[0, i], normal[i, 0] = 0.0, 0.0
        normal[0, 0] = 1.0
    degrees = float(max(used - PARAMETERS + dark, 1))
    if not _invert(normal, inverse):
        return judge.allowed(chi2, degrees, rules)
    excess = judge.excess_of(chi2, degrees) if rules.known else 0.0
    for i in range(PARAMETERS):
        out[i] = _variance(room, i, excess)
    if not (rules.known and judge.expected(chi2, degrees)):
        _scatter(room, found)
        for i in range(PARAMETERS):
            out[i] = max(out[i], _variance(room, i, judge.students(degrees) if rules.known else 1.0))
    for i in range(PARAMETERS):
        common = 0.0
        if i in (0, 1, 3):
            common = rules.level_error * (a if i == 0 else b1 if i == 1 else b2)
        out[i] = math.sqrt(out[i] + common * common)
    return judge.allowed(chi2, degrees, rules)


@uncounted(error_model="numpy")
def _variance(room, i, excess):
    """Return the variance of parameter i, with the variances of observations multiplied by ``excess``."""
    _, middle, inverse, _, scale, product = room.covariance
    for k in range(PARAMETERS):
        product[k] = 0.0
        for m in range(PARAMETERS):
            product[k] += inverse[i, m] * scale[m] * middle[m, k]
    total = 0.0
    for k in range(PARAMETERS):
        total += product[k] * scale[k] * inverse[k, i]
    return max(total * excess * scale[i] * scale[i], 0.0)


@uncounted(error_model="numpy")
def _scatter(room, found):
    """Fill Σ w² v J Jᵀ with variances v from the residuals, see `judge.scatter`."""
    rows, other, (_, middle, inverse, column, scale, _) = room.rows, room.other, room.covariance
    _clear(middle)
    for j in range(rows.shape[1]):
        w = rows[WEIGHT, j]
        if not w > 0.0:
            continue
        _column(rows, other, j, found[1], found[2], column)
        leverage = 0.0
        for i in range(PARAMETERS):
            for k in range(PARAMETERS):
                leverage += w * column[i] * scale[i] * inverse[i, k] * scale[k] * column[k]
        off = found[0] * column[0] + found[1] * column[1] + found[2] * column[3] - rows[RESPONSE, j]
        off /= max(1.0 - leverage, judge.LEAST_LEFT)
        u = w * w * max(off * off, rows[VARIANCE, j])
        for i in range(PARAMETERS):
            for k in range(PARAMETERS):
                middle[i, k] += u * column[i] * column[k]


@uncounted(error_model="numpy")
def _is_seen(rows, weights, lobes, log_mu):
    """Return whether at least two observations with weight lie near the peak of a lobe."""
    constant, seen = lobe_kernels.constants(lobes, log_mu), 0
    for j in range(rows.shape[1]):
        share = lobe_kernels.flank(lobes, constant, rows[F0, j], rows[F1, j], rows[F2, j])[0]
        seen += weights[WEIGHT, j] > 0.0 and rows[GLOSS, j] > 0.0 and share >= judge.SEEN
    return seen >= judge.TWICE


@uncounted(error_model="numpy")
def is_determined(b, error, log_mu_error, seen):
    """Return whether the data determine a component: small errors of β and log μ, and a lobe that is seen."""
    return error < _BETA_ERROR * b and log_mu_error < _MU_ERROR and seen


@uncounted(error_model="numpy")
def _status(t, room, given, row, fits):
    """Return the status of a texel with two components; set the errors of undetermined components to infinity."""
    rows, other, problem, second, rules = room.rows, room.other, given.problem, given.second, given.rules
    clipped = clipped_of(t, problem)
    if judge.highlight_clips(rows, problem.lobes, clipped, row[LOG_MU], True):
        return _SATURATED
    if judge.highlight_clips(other, second, clipped, row[LOG_MU_2], True):
        return _SATURATED
    one = is_determined(
        row[BETA], row[ERRORS + BETA], row[ERRORS + LOG_MU], _is_seen(rows, rows, problem.lobes, row[LOG_MU])
    )
    two = is_determined(
        row[BETA_2], row[ERRORS + BETA_2], row[ERRORS + LOG_MU_2], _is_seen(other, rows, second, row[LOG_MU_2])
    )
    if not one:
        row[ERRORS + BETA], row[ERRORS + LOG_MU] = np.inf, np.inf
    if not two:
        row[ERRORS + BETA_2], row[ERRORS + LOG_MU_2] = np.inf, np.inf
    edge = row[ALPHA] >= rules.high_alpha * (1.0 - 1e-6)
    for i in (BETA, BETA_2):
        edge |= row[i] >= rules.high_beta * (1.0 - 1e-6)
    for i in (LOG_MU, LOG_MU_2):
        edge |= row[i] >= rules.high_log_mu - 1e-4 or row[i] <= rules.low_log_mu + 1e-4
    if edge:
        return _AT_BOUND
    if not (one and two):
        return _UNIDENTIFIABLE
    return _OK if fits else _CONTRADICTED


@uncounted(error_model="numpy")
def _criterion(t, rows, other, lobes, known, evidence):
    """Return Schwarz's criterion of a fit of one component, evaluated with the current weights."""
    a, b, log_mu = known.table[t, judge.ALPHA], known.table[t, judge.BETA], known.table[t, judge.LOG_MU]
    if known.model[t] == judge.DIFFUSE_ALONE or known.model[t] == judge.NOTHING:
        b, log_mu = 0.0, 0.0
    a = 0.0 if known.model[t] == judge.NOTHING or known.model[t] == judge.GLOSS_ALONE else a
    fill_lobe(other, lobes, log_mu)
    squares = spread(0.0)
    for j in range(vectors_of(rows)):
        off = a * get(rows, COSINE, j) + b * get(other, LOBE, j) - get(rows, RESPONSE, j)
        squares = squares + get(rows, WEIGHT, j) * off * off
    unknowns = known.model[t]  # the code of the model is its number of unknowns
    used = evidence.used
    return judge.information_criterion(folded(squares, 0.0), used, evidence.floor, unknowns * math.log(used))


@uncounted(error_model="numpy")
def _search(room, given, fixed):
    """Return log μ_1, log μ_2, (α, β_1, β_2, Φ) at the lowest minimum of Φ, and the number of evaluations."""
    nodes = given.problem.nodes
    tabulate(room.rows, room.rows, given.problem.lobes, nodes, room.first, False)
    tabulate(room.rows, room.other, given.second, nodes, room.second, True)
    _fill_grid(fixed, room, given)
    _clear(room.taken)
    best_1, best_2, best, evaluations = nodes[0], nodes[0], (0.0, 0.0, 0.0, np.inf), nodes.size * nodes.size
    for _ in range(_DIPS):
        i, j = _next_dip(room.grid, room.taken)
        if i < 0:
            break
        t1, t2, found, count = polish(room, given, fixed, nodes[i], nodes[j])
        evaluations += count
        if found[3] < best[3]:
            best_1, best_2, best = t1, t2, found
    return best_1, best_2, best, evaluations


@uncounted(error_model="numpy")
def _fit_texel(t, given, room, out):
    """Fit two components to a texel, and choose between two and one."""
    rows, other, problem, rules, one = room.rows, room.other, given.problem, given.rules, given.one
    geometry = problem.geometry[t if problem.geometry.shape[0] > 1 else 0]
    pack_geometry(geometry, problem.lobes, problem.n, problem.k, problem.coupled, rows)
    pack_geometry(geometry, given.second, problem.n, problem.k, problem.coupled, other)
    used, floor = load_texel(t, problem, rules, rows)
    evidence = Evidence(used, floor, weigh(rows, 0.0))
    if is_noisy(evidence, rules):
        alone = Minimum(one.table[t, judge.ALPHA], one.table[t, judge.BETA], one.table[t, judge.LOG_MU], 0)
        expect_fitted(rows, problem, rules, alone, every_lane())
        evidence = Evidence(used, floor, weigh(rows, 0.0))
    fixed, best = evidence.fixed, _criterion(t, rows, rows, problem.lobes, one, evidence)
    if not given.same:
        of_second = _criterion(t, rows, other, given.second, given.two, evidence)
        if of_second < best:
            out.second[t], best = 1, of_second
    t1, t2, found, count = _search(room, given, fixed)
    out.evaluations[t] = count
    dark = found[0] <= 0.0
    criterion = judge.information_criterion(found[3], used, floor, (PARAMETERS - dark) * math.log(used))
    if not (used > PARAMETERS and found[1] > 0.0 and found[2] > 0.0 and criterion < best):
        return
    evaluate(room, given, fixed, t1, t2)
    row = out.table[t]
    fits = errors_of(room, given, (t1, t2), found, used, row[ERRORS : ERRORS + PARAMETERS])
    row[ALPHA], row[BETA], row[LOG_MU], row[BETA_2], row[LOG_MU_2] = found[0], found[1], t1, found[2], t2
    row[SQUARES], row[POWER] = found[3] / fixed[3], fixed[2] / fixed[3]
    for j in range(rows.shape[1]):
        other[WEIGHT, j] = rows[WEIGHT, j]
    out.status[t] = _status(t, room, given, row, fits)
    if given.same and t2 > t1:
        for i in (BETA, LOG_MU, ERRORS + BETA, ERRORS + LOG_MU):
            row[i], row[i + 2] = row[i + 2], row[i]
    out.both[t], out.model[t] = 1, judge.GLOSS_ALONE if dark else judge.BOTH


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_chunk(given, out, first, last):
    _fit_range(given, _new_room(given.problem), out, first, last)


@njit(cache=True)
def _new_table(nodes, width):
    return ScanTable(aligned(nodes * width).reshape((nodes, width)), np.zeros((3, nodes)))


@njit(cache=True)
def _new_room(problem):
    observations, nodes = problem.response.shape[1], problem.nodes.size
    rows, square = new_rows(observations), (PARAMETERS, PARAMETERS)
    covariance = Covariance(
        np.zeros(square), np.zeros(square), np.zeros(square),
        np.zeros(PARAMETERS), np.zeros(PARAMETERS), np.zeros(PARAMETERS),
    )  # fmt: skip
    return TwoRoom(
        rows, new_rows(observations), _new_table(nodes, rows.shape[1]), _new_table(nodes, rows.shape[1]),
        np.zeros((nodes, nodes)), np.zeros((nodes, nodes), dtype=np.uint8), covariance,
    )  # fmt: skip


@uncounted(error_model="numpy")
def _fit_range(given, room, out, first, last):
    for t in range(first, last):
        if given.one.model[t] > 0:  # enough observations, and visible reflection
            _fit_texel(t, given, room, out)


def fit_two(problem: Problem, second, rules: Rules, one: Output, two: Output) -> TwoOutput:
    """Fit two components to every texel; parameters as in `TwoTask`."""
    count = len(problem.response)
    out = TwoOutput(
        table=np.full((count, COLUMNS), np.nan),
        both=np.zeros(count, dtype=np.uint8),
        second=np.zeros(count, dtype=np.uint8),
        status=np.zeros(count, dtype=np.int8),
        model=np.zeros(count, dtype=np.int8),
        evaluations=np.zeros(count, dtype=np.int32),
    )

    def fit_some(first, last):
        texels = slice(first, last)
        singles = [Output(*(array[texels] for array in single)) for single in (one, two)]
        task = TwoTask(problem.in_float64(texels), second, problem.lobes == second, rules, *singles)
        _fit_chunk(task, TwoOutput(*(array[texels] for array in out)), 0, last - first)

    run_chunks(fit_some, count, _CHUNK)
    return out
