"""Huber's loss: quadratic for small residuals, linear for outliers.

For one μ the loss is convex in α and β, and repeated weighted least squares finds its minimum; the scan compares these
minima over the whole range of μ, because least squares may have been led to another valley by the outlier itself.
"""

import math

import numpy as np

from irodori.fitting.closed_form import best_pair
from irodori.fitting.observations import expect, weigh
from irodori.fitting.texel_rows import (
    COSINE,
    FAST,
    GLOSS,
    LOBE,
    RESPONSE,
    SQUARE,
    TRUST,
    VARIANCE,
    WEIGHT,
    exp_negative,
)
from irodori.fitting.varpro import NODE_STEP, newton
from irodori.jit.native import njit

_AT_NODE = 8  # weighted least squares at a node of the scan
_SETTLING = 100  # at most, from the best node on
_SETTLED = 1e-6  # change of log μ, and of α and β relative to themselves


@njit(cache=True, fastmath=FAST, error_model="numpy")
def fill_lobe(block, log_mu):
    """Fill the gloss of every observation for β = 1."""
    factor = -math.exp(-2.0 * log_mu)
    for j in range(block.shape[1]):
        block[LOBE, j] = block[GLOSS, j] * exp_negative(block[SQUARE, j] * factor)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def reweigh(block, a, b, huber):
    """Give observations beyond ``huber`` deviations the weight that makes their loss linear; return the loss."""
    loss = 0.0
    for j in range(block.shape[1]):
        v = block[VARIANCE, j]
        deviation = abs(a * block[COSINE, j] + b * block[LOBE, j] - block[RESPONSE, j]) / math.sqrt(v)
        far = deviation > huber
        block[WEIGHT, j] = block[TRUST, j] * (huber / deviation if far else 1.0)
        loss += block[TRUST, j] * v * (huber * (2.0 * deviation - huber) if far else deviation * deviation)
    return loss


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _pair(block, box):
    """Return the best α and β for the lobe and the weights at hand."""
    cc, cr, rr, cg, rg, gg = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(block.shape[1]):
        w, c, r, g = block[WEIGHT, j], block[COSINE, j], block[RESPONSE, j], block[LOBE, j]
        cc += w * c * c
        cr += w * c * r
        rr += w * r * r
        cg += w * c * g
        rg += w * r * g
        gg += w * g * g
    a, b, _ = best_pair((cc, cr, rr, 0.0), cg, rg, gg, box)
    return a, b


@njit(cache=True, error_model="numpy")
def _least_loss(block, nodes, box, rules):
    """Return log μ of the node with the least Huber loss, and α and β there."""
    best, log_mu, a, b = np.inf, nodes[0], 0.0, 0.0
    for i in range(nodes.size):
        fill_lobe(block, nodes[i])
        for j in range(block.shape[1]):
            block[WEIGHT, j] = block[TRUST, j]
        x, y, loss = 0.0, 0.0, np.inf
        for _ in range(_AT_NODE):
            x, y = _pair(block, box)
            loss = reweigh(block, x, y, rules.huber)
        if loss < best:
            best, log_mu, a, b = loss, nodes[i], x, y
    return log_mu, a, b


@njit(cache=True, error_model="numpy")
def robust(block, nodes, rules):
    """Return the sums without lobe, α, β, log μ of the least Huber loss, the evaluations, and whether it settled.

    The block is left with the weights that make the loss linear for outliers.
    """
    box = (rules.low_alpha, rules.high_alpha, rules.low_beta, rules.high_beta)
    log_mu, a, b = _least_loss(block, nodes, box, rules)
    if rules.weighted:
        # The variance of a reading that lost its light would be small, and its pull large.
        expect(block, a, b, log_mu, rules)
        log_mu, a, b = _least_loss(block, nodes, box, rules)
    settled, evaluations = False, nodes.size * _AT_NODE
    fixed = weigh(block)
    for _ in range(_SETTLING):
        fill_lobe(block, log_mu)
        reweigh(block, a, b, rules.huber)
        fixed = weigh(block)
        low, high = max(log_mu - NODE_STEP, rules.low_log_mu), min(log_mu + NODE_STEP, rules.high_log_mu)
        t, x, y, count = newton(block, fixed, box, log_mu, low, high, False)
        evaluations += count
        settled = abs(t - log_mu) + abs(x - a) / (abs(x) + 1e-30) + abs(y - b) / (abs(y) + 1e-30) < _SETTLED
        log_mu, a, b = t, x, y
        if settled:
            break
    return fixed, a, b, log_mu, evaluations, settled
