"""Variable projection: scan Φ(log μ), then safeguarded Newton in each interval that brackets a minimum.

From one roughness of the scan to the next, smaller by √2, the lobe D = exp(-(φ/μ)²) is squared: a scan costs one
exponential an observation. Value and slope at every node tell which intervals hold a minimum, and a cubic through them
where; the best is polished, and any other that may come as low. Texels that share one geometry share tables of lobes
(`irodori.fitting.shared_geometry`), and where their weights agree too, the scan's sums but those with the response.
"""

import math

import numpy as np

from irodori.fitting.closed_form import best_pair, slope_and_curvature
from irodori.fitting.texel_rows import (
    FAST,
    GLOSS,
    LEAST_LOBE,
    LOBE,
    SQUARE,
    WEIGHT,
    WEIGHTED_COSINE,
    WEIGHTED_RESPONSE,
    exp_negative,
)
from irodori.jit.lanes import lower_of, root, select, upper_of
from irodori.jit.native import njit

NODE_STEP = 0.5 * math.log(2.0)  # of log μ
RIVAL = 1.05  # an interval whose estimate is below this multiple of the best is polished too
_CONVERGED = 1e-4  # last Newton step of log μ; what is left is of the order of its square
_MAX_STEPS = 24
#: Rows of sums of the scan: Σ w c g, Σ w ρ g, Σ w g², their slopes along log μ, Φ, Φ', and of the interval below the
#: node the estimated minimum and its place.
SUMS = 10


@njit(cache=True, fastmath=FAST, error_model="numpy")
def moments(block, log_mu):
    """Return value, slope and curvature along log μ of Σ w c g, Σ w ρ g and Σ w g²."""
    factor = -math.exp(-2.0 * log_mu)
    cg, cg1, cg2, rg, rg1, rg2, gg, gg1, gg2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(block.shape[1]):
        x = block[SQUARE, j] * factor
        g = block[GLOSS, j] * exp_negative(x)
        c = block[WEIGHTED_COSINE, j] * g
        r = block[WEIGHTED_RESPONSE, j] * g
        s = block[WEIGHT, j] * g * g
        cg += c
        rg += r
        gg += s
        c *= x
        r *= x
        s *= x
        cg1 += c
        rg1 += r
        gg1 += s
        cg2 += c * x
        rg2 += r * x
        gg2 += s * x
    # x = -(φ/μ)²: dg/dt = -2 x g, d²g/dt² = (4 x² + 4 x) g; g² has twice the exponent.
    return (
        cg, -2.0 * cg1, 4.0 * (cg2 + cg1),
        rg, -2.0 * rg1, 4.0 * (rg2 + rg1),
        gg, -4.0 * gg1, 16.0 * gg2 + 8.0 * gg1,
    )  # fmt: skip


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _first_lobe(block, log_mu):
    factor = -math.exp(-2.0 * log_mu)
    for j in range(block.shape[1]):
        block[LOBE, j] = exp_negative(block[SQUARE, j] * factor)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _node(block, factor, sums, i):
    """Fill the sums of node i and square the lobe; ``factor`` is 2 / μ²."""
    cg, rg, gg, cg1, rg1, gg1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(block.shape[1]):
        g = block[GLOSS, j] * block[LOBE, j]
        x = block[SQUARE, j]
        c = block[WEIGHTED_COSINE, j] * g
        r = block[WEIGHTED_RESPONSE, j] * g
        s = block[WEIGHT, j] * g * g
        cg += c
        rg += r
        gg += s
        cg1 += c * x
        rg1 += r * x
        gg1 += s * x
    sums[0, i], sums[1, i], sums[2, i] = cg, rg, gg
    sums[3, i], sums[4, i], sums[5, i] = factor * cg1, factor * rg1, 2.0 * factor * gg1
    # A loop of its own: a store among the sums would keep the compiler from vectorising them.
    for j in range(block.shape[1]):
        block[LOBE, j] = block[LOBE, j] * block[LOBE, j] + LEAST_LOBE


@njit(cache=True, error_model="numpy")
def scan_own(block, nodes, steepness, chains, sums):
    """Fill the sums of all nodes.

    Parameters
    ----------
    block : (ROWS, P) float64
    nodes : (nodes,) float64
        log μ, falling by `NODE_STEP` / ``chains``, but for the last, the smallest.
    steepness : (nodes,) float64
        2 / μ².
    chains : int
    sums : (SUMS, nodes) float64
    """
    count = nodes.size
    for chain in range(chains):
        _first_lobe(block, nodes[chain])
        for i in range(chain, count - 1, chains):
            _node(block, steepness[i], sums, i)
    _first_lobe(block, nodes[count - 1])
    _node(block, steepness[count - 1], sums, count - 1)


@njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")
def value_nodes(fixed, sums, box):
    """Fill Φ and Φ' of all nodes."""
    for i in range(sums.shape[1]):
        a, b, value = best_pair(fixed, sums[0, i], sums[1, i], sums[2, i], box)
        sums[6, i] = value
        sums[7, i] = b * (b * sums[5, i] + 2.0 * (a * sums[3, i] - sums[4, i]))


@njit(cache=True, error_model="numpy")
def cubic_minimum(width, f0, f1, d0, d1):
    """Return where in an interval, from 0 to its width, the cubic through values and slopes is least, and its value.

    Numbers or lanes.
    """
    u = d0 + d1 - 3.0 * (f1 - f0) / width
    half = root(upper_of(u * u - d0 * d1, 0.0))
    bottom = d1 - d0 + 2.0 * half
    s = select(bottom > 0.0, 1.0 - (d1 + half - u) / select(bottom > 0.0, bottom, 1.0), 0.5)
    s = lower_of(upper_of(s, 0.02), 0.98)
    h00, h01 = (1.0 + 2.0 * s) * (1.0 - s) * (1.0 - s), s * s * (3.0 - 2.0 * s)
    h10, h11 = s * (1.0 - s) * (1.0 - s), s * s * (s - 1.0)
    return s * width, h00 * f0 + h01 * f1 + width * (h10 * d0 + h11 * d1)


@njit(cache=True, error_model="numpy")
def _dips(width, f0, f1, d0, d1):
    """Return whether the cubic through values and slopes of one sign has a minimum inside all the same."""
    # All times the width, for a division in every interval would cost as much as the rest.
    both = d0 * d1 * width * width
    u = (d0 + d1) * width - 3.0 * (f1 - f0)
    return both > 0.0 and u * d0 > 0.0 and u * u > both


@njit(cache=True, error_model="numpy")
def find_intervals(nodes, sums):
    """Fill the estimated minimum of every interval, infinite where it holds none; return the best node."""
    value, slope, estimate, place = sums[6], sums[7], sums[8], sums[9]
    best = 0
    for i in range(nodes.size):
        if value[i] < value[best]:
            best = i
    for i in range(nodes.size - 1):
        estimate[i] = np.inf
        width = nodes[i] - nodes[i + 1]
        # Node i + 1 has the smaller μ. A slope of 0 is where the best β is at its bound.
        sure = slope[i + 1] <= 0.0 <= slope[i] and slope[i + 1] < slope[i]
        if sure or _dips(width, value[i + 1], value[i], slope[i + 1], slope[i]):
            offset, least = cubic_minimum(width, value[i + 1], value[i], slope[i + 1], slope[i])
            ends = min(value[i], value[i + 1])
            if sure or least < ends:
                estimate[i] = min(least, ends)
                place[i] = nodes[i + 1] + offset
    _mark_beside(nodes, value, slope, estimate, place, best)
    return best


@njit(cache=True, error_model="numpy")
def _mark_beside(nodes, value, slope, estimate, place, best):
    """Mark the interval to which Φ falls from the best node: its far end is higher, so it holds a minimum."""
    if slope[best] > 0.0 and best + 1 < nodes.size and estimate[best] == np.inf:
        estimate[best] = value[best]
        place[best] = 0.8 * nodes[best] + 0.2 * nodes[best + 1]
    elif slope[best] < 0.0 and best > 0 and estimate[best - 1] == np.inf:
        estimate[best - 1] = value[best]
        place[best - 1] = 0.8 * nodes[best] + 0.2 * nodes[best - 1]


@njit(cache=True, error_model="numpy")
def newton(block, fixed, box, log_mu, low, high, flat_above):
    """Return log μ, α and β of the minimum in a bracket, and the evaluations it took.

    Parameters
    ----------
    log_mu, low, high : float
        Start and bracket.
    flat_above : bool
        Where β is at its bound, Φ is flat: says on which side of the minimum.
    """
    t, steps = log_mu, 0
    while steps < _MAX_STEPS:
        steps += 1
        a, b, da, db, slope, curvature = slope_and_curvature(fixed, moments(block, t), box)
        if slope > 0.0 or (slope == 0.0 and flat_above):
            high = t
        else:
            low = t
        following = t - slope / curvature if curvature > 0.0 and slope != 0.0 else low - 1.0
        inside = low <= following <= high
        if not inside:
            following = 0.5 * (low + high)
        change = following - t
        t = following
        if abs(change) < (_CONVERGED if inside else 1e-9):
            break
    return t, min(max(a + change * da, box[0]), box[1]), min(max(b + change * db, box[2]), box[3]), steps


@njit(cache=True, error_model="numpy")
def pair_at(block, fixed, box, log_mu):
    """Return the best α and β at one log μ, and the sum of squares."""
    m = moments(block, log_mu)
    return best_pair(fixed, m[0], m[3], m[6], box)


@njit(cache=True, error_model="numpy")
def minimise(block, fixed, box, nodes, sums):
    """Return log μ, α and β of the lowest minimum of Φ, and the evaluations; the nodes' sums are filled already."""
    value_nodes(fixed, sums, box)
    top = find_intervals(nodes, sums)
    best_t, best = nodes[top], sums[6, top]
    evaluations = nodes.size
    for attempt in range(nodes.size):
        i, rival = 0, np.inf
        for other in range(1, nodes.size - 1):
            if sums[8, other] < sums[8, i]:
                rival, i = sums[8, i], other
            else:
                rival = min(rival, sums[8, other])
        if not sums[8, i] <= RIVAL * best:
            break
        above = sums[7, i] == 0.0
        t, a, b, count = newton(block, fixed, box, sums[9, i], nodes[i + 1], nodes[i], above)
        sums[8, i] = np.inf
        evaluations += count
        # Where slopes of both signs enclose it the minimum is lower than both nodes; any other has to be compared.
        sure = sums[7, i + 1] <= 0.0 <= sums[7, i] and (i == top or i + 1 == top)
        if attempt == 0 and sure and not rival <= RIVAL * best:
            return t, a, b, evaluations
        _, _, value = pair_at(block, fixed, box, t)
        evaluations += 1
        if value <= best:
            best_t, best = t, value
    a, b, _ = pair_at(block, fixed, box, best_t)
    return best_t, a, b, evaluations + 1
