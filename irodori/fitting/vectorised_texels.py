"""Variable projection of eight texels at once, for the ordinary case.

A texel is ordinary if one interval of the scan certainly contains the lowest minimum, no other is nearly as low, and
the data need, and are compatible with, both diffuse reflection and gloss. The formulas are those for one texel
(`irodori.fitting.texels`). Texels that turn out not to be ordinary are left to be fitted singly.
"""

from typing import NamedTuple

import numpy as np

from irodori.fitting import judge
from irodori.fitting.observations import (
    ENOUGH,
    Evidence,
    Minimum,
    box_of,
    distinct_geometries,
    expect_fitted,
    load_eight,
    weigh,
    weights_changed,
)
from irodori.fitting.shared_geometry import GROUP, scan_shared_eight
from irodori.fitting.texel_rows import any_of, item, new_rows_of_eight, pack_eight
from irodori.fitting.varpro import DESCENT, RIVAL, SUMS, VALUE, Bracket, interval_minimum, newton, scan, value_nodes
from irodori.jit.compilation import njit, uncounted
from irodori.jit.functions import log, lower_of, negated, select, upper_of
from irodori.jit.vector_memory import aligned, mask_bits, spread, store
from irodori.jit.vectors import LANES

NOISY = 0.01  # relative variance times number of observations above which weights come from the fitted response
SURE = 4.0  # α in standard errors above which a model without diffuse reflection is not tried
_MAX_STEPS = 12  # Newton steps after which a texel is left to be fitted singly


class Eight(NamedTuple):
    """Buffers of one thread for eight texels."""

    rows: np.ndarray  # (ROWS, J * LANES)
    sums: np.ndarray  # (SUMS, nodes * LANES), nodes padded to a multiple of GROUP
    results: np.ndarray  # (judge.COLUMNS + 2, LANES): the columns, status, evaluations


@njit(cache=True)
def new_eight(captures, nodes):
    """Allocate the buffers for a number of photographs and of nodes of the scan."""
    width = (nodes + GROUP - 1) // GROUP * GROUP * LANES
    sums = aligned(SUMS * width).reshape((SUMS, width))
    return Eight(new_rows_of_eight(captures), sums, np.zeros((judge.COLUMNS + 2, LANES)))


@uncounted(error_model="numpy")
def _best_interval(problem, sums, least, top, wanted):
    """Return the `Bracket` of the lowest minimum; only lanes without a second candidate are wanted."""
    zero = spread(0.0)
    best, rival = zero + np.inf, zero + np.inf
    place, low, high, ordinary, low_slope, high_slope = zero, zero, zero, zero, zero, zero
    for i in range(problem.nodes.size - 1):
        d0, d1 = item(sums, DESCENT, i + 1, zero), item(sums, DESCENT, i, zero)
        f0, f1 = item(sums, VALUE, i + 1, zero), item(sums, VALUE, i, zero)
        estimate, offset = interval_minimum(problem.nodes[i] - problem.nodes[i + 1], f0, f1, d0, d1)
        if mask_bits(estimate < np.inf) == 0:
            continue
        better = estimate < best
        rival = select(better, best, lower_of(estimate, rival))
        enclosed = (d0 < 0.0) & (d1 > 0.0) & ((top == float(i)) | (top == i + 1.0))
        ordinary = select(better, select(enclosed, 1.0, 0.0), ordinary)
        place = select(better, problem.nodes[i + 1] + offset, place)
        low, high = select(better, problem.nodes[i + 1], low), select(better, problem.nodes[i], high)
        low_slope, high_slope = select(better, d0, low_slope), select(better, d1, high_slope)
        best = select(better, estimate, best)
    ordinary_lanes = (ordinary > 0.0) & (best <= RIVAL * least) & (rival > RIVAL * least)
    return Bracket(place, low, high, low_slope, high_slope, zero > 0.0, wanted & ordinary_lanes)


@uncounted(error_model="numpy")
def _minimise(problem, shared, rules, rows, sums, ordinary):
    """Return the sums without lobe, the `Minimum`, and the mask of lanes that are still ordinary."""
    box, zero = box_of(rules), spread(0.0)
    fixed = weigh(rows, zero)
    if shared.nodes.shape[1] == 0:
        scan(rows, problem, sums, zero)
    else:
        scan_shared_eight(rows, shared, sums, weights_changed(rows))
    least, top = value_nodes(fixed, sums, problem.nodes.size, box, zero)
    bracket = _best_interval(problem, sums, least, top, ordinary)
    found, converged = newton(rows, problem.lobes, fixed, box, bracket, _MAX_STEPS)
    return fixed, found, converged


@uncounted(error_model="numpy")
def _judge(problem, rules, evidence, found, eight):
    """Fill the results of all lanes; return the mask of lanes that need, and are compatible with, both terms."""
    (used, floor, fixed), (a, b, log_mu, steps), rows, lobes = evidence, found, eight.rows, problem.lobes
    squares, chi2, sums, middle, seen = judge.sums_at_minimum(rows, lobes, found, rules, rules.known)
    normal = judge.correlations(sums)
    plain = (sums[0] > 0.0) & (sums[2] > 0.0) & (sums[5] > 0.0) & (normal.determinant > judge.SINGULAR) & (b > 0.0)
    excess = judge.excess_of(chi2, upper_of(used - 3.0, 1.0))
    if not rules.known:
        middle = judge.scatter(rows, a, b, normal)
        excess = spread(1.0)
    alpha, beta, along = judge.parameter_errors(middle, normal, excess, found, rules)
    doubtful = judge.doubtful(chi2, upper_of(used - 3.0, 1.0), rules)
    if any_of(doubtful):
        wider = judge.students(upper_of(used - 3.0, 1.0))
        own = judge.parameter_errors(judge.scatter(rows, a, b, normal), normal, wider, found, rules)
        alpha = select(doubtful, upper_of(alpha, own[0]), alpha)
        beta, along = select(doubtful, upper_of(beta, own[1]), beta), select(doubtful, upper_of(along, own[2]), along)
    _, simpler, nothing = judge.without_gloss(evidence, rules)
    if rules.low_alpha == 0.0:
        simpler = lower_of(simpler, nothing)
        plain = plain & ((a > SURE * alpha) | negated(judge.shown_dark(a, alpha, fixed)))
    if not rules.low_beta > 0.0:
        unknown = log(upper_of(used, 1.0))
        plain = plain & (judge.information_criterion(squares, used, floor, 3.0 * unknown) < simpler)
    fits = judge.allowed(chi2, upper_of(used - 3.0, 1.0), rules)
    plain = plain & fits
    errors = judge.Errors(alpha, beta, along, squares, seen, fits)
    status = judge.gloss_status_of(found, errors, rules)
    hidden = status == float(judge.UNIDENTIFIABLE)
    if any_of(hidden & plain):
        wide = judge.alpha_over_all_mu(evidence, eight.sums, problem.most_beta, found, errors, rules)
        alpha = select(hidden, wide, alpha)
    variance = upper_of(squares / (used - judge.PARAMETERS), floor)
    for column, value in (
        (judge.ALPHA, a), (judge.BETA, b), (judge.LOG_MU, log_mu), (judge.ALPHA_ERROR, alpha),
        (judge.BETA_ERROR, beta), (judge.LOG_MU_ERROR, along), (judge.SQUARES, squares / fixed[3]),
        (judge.POWER, fixed[2] / fixed[3]), (judge.VARIANCE, variance / fixed[3]), (judge.COLUMNS, status),
        (judge.COLUMNS + 1, steps),
    ):  # fmt: skip
        store(eight.results, column * LANES, value)
    return plain


@uncounted(error_model="numpy")
def fit_eight(problem, shared, rules, first, last, eight):
    """Fit the eight texels from ``first`` on, as far as they are before ``last``.

    Parameters
    ----------
    problem, shared, rules
        As in `irodori.fitting.texels`; the rows of a shared geometry must be filled already.
    eight : Eight
        Buffers; the results are filled.

    Returns
    -------
    int
        A bit for each texel, set if it is done.
    """
    captures, rows, sums = problem.response.shape[1], eight.rows, eight.sums
    if shared.nodes.shape[1] == 0:
        pack_eight(problem, first, last, rows)
    used, floor, ordinary = load_eight(problem, rules, first, last, rows)
    ordinary = ordinary & (distinct_geometries(rows, captures, spread(0.0)) >= float(ENOUGH))
    fixed, found, ordinary = _minimise(problem, shared, rules, rows, sums, ordinary)
    steps = found.evaluations
    if rules.known:
        noisy = ordinary & (used * used * floor > NOISY * fixed[2])
        if mask_bits(noisy) != 0:
            expect_fitted(rows, problem, rules, found, noisy)
            fixed, found, ordinary = _minimise(problem, shared, rules, rows, sums, ordinary)
            steps = select(noisy, steps + found.evaluations, found.evaluations)
    if mask_bits(ordinary) == 0:
        return 0
    found = Minimum(found.alpha, found.beta, found.log_mu, steps + float(problem.nodes.size))
    ordinary = ordinary & _judge(problem, rules, Evidence(used, floor, fixed), found, eight)
    return int(mask_bits(ordinary)) & _unclipped(problem, first, last)


@uncounted()
def _unclipped(problem, first, last):
    """Return a bit for each texel, set if none of its observations is clipped."""
    found = (1 << min(LANES, last - first)) - 1
    for i in range(min(LANES, last - first)):
        t = first + i if problem.clipped.shape[0] > 1 else 0
        for j in range(problem.clipped.shape[1]):
            if problem.clipped[t, j] != 0:
                found &= ~(1 << i)
    return found


@uncounted()
def write_eight(results, done, first, out):
    """Store the results of lanes with their bit in ``done`` set in the output, for the texels from ``first`` on."""
    for i in range(LANES):
        if done >> i & 1:
            for column in range(judge.COLUMNS):
                out.table[first + i, column] = results[column, i]
            out.status[first + i], out.model[first + i] = int(results[judge.COLUMNS, i]), judge.BOTH
            out.evaluations[first + i] = int(results[judge.COLUMNS + 1, i])
