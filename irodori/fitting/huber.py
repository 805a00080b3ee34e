"""Huber's loss: quadratic for small residuals, linear for outliers.

For one μ the loss is convex in α and β, and repeated weighted least squares finds its minimum; the scan compares these
minima over the whole range of μ, because least squares may have been led to another valley by the outlier itself.
"""

import numpy as np

from irodori.fitting.closed_form import best_pair
from irodori.fitting.observations import Minimum, box_of, every_lane, expect_fitted, weigh
from irodori.fitting.texel_rows import (
    COSINE,
    LOBE,
    RESPONSE,
    SHARE,
    TRUST,
    VARIANCE,
    WEIGHT,
    fill_lobe,
    folded,
    get,
    put,
    vectors_of,
)
from irodori.fitting.varpro import NODE_STEP, Bracket, newton
from irodori.jit.compilation import uncounted
from irodori.jit.functions import magnitude, root, select
from irodori.jit.vector_memory import spread

_AT_NODE = 8  # weighted least squares at a node of the scan
_SETTLING = 100  # at most, from the best node on
_MAX_STEPS = 24  # of Newton
_SETTLED = 1e-6  # change of log μ, and of α and β relative to themselves


@uncounted()
def copy_row(rows, source, target):
    """Copy a row to another."""
    for j in range(vectors_of(rows)):
        put(rows, target, j, get(rows, source, j))


@uncounted(error_model="numpy")
def reweigh(rows, a, b, huber):
    """Give observations beyond ``huber`` deviations the weight that makes their loss linear; return the loss."""
    loss = spread(0.0)
    for j in range(vectors_of(rows)):
        v, trust = get(rows, VARIANCE, j), get(rows, TRUST, j)
        deviation = magnitude(a * get(rows, COSINE, j) + b * get(rows, LOBE, j) - get(rows, RESPONSE, j)) / root(v)
        far = deviation > huber
        share = select(far, huber / deviation, 1.0)
        put(rows, SHARE, j, share)
        put(rows, WEIGHT, j, trust * share)
        loss = loss + trust * v * select(far, huber * (2.0 * deviation - huber), deviation * deviation)
    return folded(loss, 0.0)


@uncounted(error_model="numpy")
def _pair(rows, box):
    """Return the best α and β for the lobe and the weights at hand."""
    zero = spread(0.0)
    cc, cr, rr, cg, rg, gg = zero, zero, zero, zero, zero, zero
    for j in range(vectors_of(rows)):
        w, c, r, g = get(rows, WEIGHT, j), get(rows, COSINE, j), get(rows, RESPONSE, j), get(rows, LOBE, j)
        wc, wr = w * c, w * r
        cc, cr, rr = cc + wc * c, cr + wc * r, rr + wr * r
        cg, rg, gg = cg + wc * g, rg + wr * g, gg + w * g * g
    fixed = (folded(cc, 0.0), folded(cr, 0.0), folded(rr, 0.0), 0.0)
    a, b, _ = best_pair(fixed, folded(cg, 0.0), folded(rg, 0.0), folded(gg, 0.0), box)
    return a, b


@uncounted(error_model="numpy")
def _least_loss(rows, lobes, nodes, box, rules):
    """Return the `Minimum` of Huber's loss over the nodes."""
    best, log_mu, a, b = np.inf, nodes[0], 0.0, 0.0
    for i in range(nodes.size):
        fill_lobe(rows, lobes, nodes[i])
        copy_row(rows, TRUST, WEIGHT)
        x, y, loss = 0.0, 0.0, np.inf
        for _ in range(_AT_NODE):
            x, y = _pair(rows, box)
            loss = reweigh(rows, x, y, rules.huber)
        if loss < best:
            best, log_mu, a, b = loss, nodes[i], x, y
    return Minimum(a, b, log_mu, nodes.size * _AT_NODE)


@uncounted(error_model="numpy")
def robust(rows, problem, rules):
    """Return the sums without lobe, the `Minimum` of Huber's loss, and whether it settled.

    The rows are left with the weights that make the loss linear for outliers.
    """
    box, lobes, nodes = box_of(rules), problem.lobes, problem.nodes
    copy_row(rows, WEIGHT, TRUST)
    found = _least_loss(rows, lobes, nodes, box, rules)
    if rules.weighted:
        # The variance of a reading that lost its light would be small, and its pull large.
        copy_row(rows, TRUST, WEIGHT)
        expect_fitted(rows, problem, rules, found, every_lane())
        copy_row(rows, WEIGHT, TRUST)
        found = _least_loss(rows, lobes, nodes, box, rules)
    a, b, log_mu, evaluations = found
    settled, fixed = False, weigh(rows, 0.0)
    for _ in range(_SETTLING):
        fill_lobe(rows, lobes, log_mu)
        reweigh(rows, a, b, rules.huber)
        fixed = weigh(rows, 0.0)
        low, high = max(log_mu - NODE_STEP, rules.low_log_mu), min(log_mu + NODE_STEP, rules.high_log_mu)
        bracket = Bracket(log_mu, low, high, np.nan, np.nan, False, True)
        (x, y, t, count), _ = newton(rows, lobes, fixed, box, bracket, _MAX_STEPS)
        evaluations += int(count)
        settled = abs(t - log_mu) + abs(x - a) / (abs(x) + 1e-30) + abs(y - b) / (abs(y) + 1e-30) < _SETTLED
        log_mu, a, b = t, x, y
        if settled:
            break
    return fixed, Minimum(a, b, log_mu, evaluations), settled
