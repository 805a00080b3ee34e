"""Minimum of Φ(log μ) for eight texels at once: scan, bracket, Newton's steps.

Every step is that of `irodori.fitting.varpro` for one texel.
"""

import math

import numpy as np

from irodori.fitting.closed_form import best_pair, slope_and_curvature
from irodori.fitting.shared_geometry import WIDTH
from irodori.fitting.texel_rows import LEAST_LOBE
from irodori.fitting.varpro import RIVAL, cubic_minimum
from irodori.fitting.vectorised_rows import (
    GROUP,
    L_GLOSS,
    L_LOBE,
    L_SQUARE,
    L_WEIGHT,
    L_WEIGHTED_COSINE,
    L_WEIGHTED_RESPONSE,
    row_place,
)
from irodori.jit.lanes import (
    COUNT,
    bits,
    exponential,
    lanes_times_tables,
    load,
    lower_of,
    magnitude,
    negated,
    select,
    spread,
    store,
    upper_of,
)
from irodori.jit.native import njit, uncounted

_CONVERGED = 3e-5  # last Newton step of log μ; nearer than alone, for the first step leaves the second just under that
_MAX_STEPS = 12  # of Newton; a texel that takes more is fitted alone
#: Sums at a node: Σ w c g, Σ w ρ g, Σ w g², then their slopes along log μ; then Φ and Φ'.
_CG, _RG, _GG, _CG1, _RG1, _GG1, _VALUE, _DESCENT = range(8)
_sum_nodes = lanes_times_tables(GROUP)


@uncounted()
def scan_tables(shared, rows, captures, nodes, sums, changed):
    """Fill the sums of all nodes from the tables of a shared geometry; those without the response if ``changed``."""
    blocks, height = shared.nodes.shape[1], shared.nodes.shape[2]
    table, padded = height * WIDTH, (nodes + GROUP - 1) // GROUP * GROUP
    for group in range(padded // GROUP):
        block, column = group * GROUP // WIDTH, group * GROUP % WIDTH
        kind, into, step = block * table + column, group * GROUP * COUNT, padded * COUNT
        flat, row = blocks * table, captures * COUNT
        _sum_nodes(rows, L_WEIGHTED_RESPONSE * row, captures, shared.nodes, kind, kind + flat, WIDTH,
                   sums, into + _RG * step, (_RG1 - _RG) * step)  # fmt: skip
        if changed:
            _sum_nodes(rows, L_WEIGHTED_COSINE * row, captures, shared.nodes, kind, kind + flat, WIDTH,
                       sums, into + _CG * step, (_CG1 - _CG) * step)  # fmt: skip
            _sum_nodes(rows, L_WEIGHT * row, captures, shared.nodes, kind + 2 * flat, kind + 3 * flat, WIDTH,
                       sums, into + _GG * step, (_GG1 - _GG) * step)  # fmt: skip


@uncounted(error_model="numpy")
def scan_squares(problem, rows, sums):
    """Fill the sums of all nodes for geometries of their own: from one node of a chain to the next D is squared."""
    captures, count = problem.response.shape[1], problem.nodes.size
    for chain in range(problem.chains + 1):
        first, step = (chain, problem.chains) if chain < problem.chains else (count - 1, count)
        factor = -math.exp(-2.0 * problem.nodes[first])
        for j in range(captures):
            store(
                rows, row_place(L_LOBE, j, captures), exponential(load(rows, row_place(L_SQUARE, j, captures)) * factor)
            )
        for i in range(first, count - 1 if chain < problem.chains else count, step):
            _sum_node(problem.steepness[i], rows, captures, sums, i, count)


@njit(cache=True, error_model="numpy", inline="always")
def _sum_node(steepness, rows, captures, sums, i, nodes):
    """Fill the sums of node i and square the lobe; ``steepness`` is 2 / μ²."""
    cg, rg, gg, cg1, rg1, gg1 = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for j in range(captures):
        lobe, x = load(rows, row_place(L_LOBE, j, captures)), load(rows, row_place(L_SQUARE, j, captures))
        g = load(rows, row_place(L_GLOSS, j, captures)) * lobe
        c = load(rows, row_place(L_WEIGHTED_COSINE, j, captures)) * g
        r = load(rows, row_place(L_WEIGHTED_RESPONSE, j, captures)) * g
        s = load(rows, row_place(L_WEIGHT, j, captures)) * g * g
        cg = cg + c
        rg = rg + r
        gg = gg + s
        cg1 = cg1 + c * x
        rg1 = rg1 + r * x
        gg1 = gg1 + s * x
        store(rows, row_place(L_LOBE, j, captures), lobe * lobe + LEAST_LOBE)
    padded = (nodes + GROUP - 1) // GROUP * GROUP
    store(sums, row_place(_CG, i, padded), cg)
    store(sums, row_place(_RG, i, padded), rg)
    store(sums, row_place(_GG, i, padded), gg)
    store(sums, row_place(_CG1, i, padded), steepness * cg1)
    store(sums, row_place(_RG1, i, padded), steepness * rg1)
    store(sums, row_place(_GG1, i, padded), 2.0 * steepness * gg1)


@uncounted(error_model="numpy")
def value_nodes(fixed, sums, nodes, box):
    """Fill Φ and Φ' of all nodes; return the least and its node."""
    padded = (nodes + GROUP - 1) // GROUP * GROUP
    least, top = spread(np.inf), spread(0.0)
    for i in range(nodes):
        cg, rg = load(sums, row_place(_CG, i, padded)), load(sums, row_place(_RG, i, padded))
        gg = load(sums, row_place(_GG, i, padded))
        a, b, value = best_pair(fixed, cg, rg, gg, box)
        cg1, rg1 = load(sums, row_place(_CG1, i, padded)), load(sums, row_place(_RG1, i, padded))
        gg1 = load(sums, row_place(_GG1, i, padded))
        store(sums, row_place(_VALUE, i, padded), value)
        store(sums, row_place(_DESCENT, i, padded), b * (b * gg1 + 2.0 * (a * cg1 - rg1)))
        top = select(value < least, i, top)
        least = lower_of(value, least)
    return least, top


@uncounted(error_model="numpy")
def best_interval(problem, sums, least, top):
    """Return where the lowest minimum is estimated, its bracket with Φ' at the ends, and which lanes have no other."""
    count = problem.nodes.size
    padded = (count + GROUP - 1) // GROUP * GROUP
    best, rival = spread(np.inf), spread(np.inf)
    place, low, high, ordinary = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    low_slope, high_slope = spread(0.0), spread(0.0)
    for i in range(count - 1):
        f0, f1 = load(sums, row_place(_VALUE, i + 1, padded)), load(sums, row_place(_VALUE, i, padded))
        d0, d1 = load(sums, row_place(_DESCENT, i + 1, padded)), load(sums, row_place(_DESCENT, i, padded))
        width = problem.nodes[i] - problem.nodes[i + 1]
        both, u = d0 * d1 * (width * width), (d0 + d1) * width - 3.0 * (f1 - f0)
        sure = (d0 <= 0.0) & (d1 >= 0.0) & (d0 < d1)
        holds = sure | ((both > 0.0) & (u * d0 > 0.0) & (u * u > both))
        if bits(holds) == 0:
            continue
        offset, found = cubic_minimum(width, f0, f1, d0, d1)
        ends = lower_of(f0, f1)
        estimate = select(holds & (sure | (found < ends)), lower_of(found, ends), np.inf)
        better = estimate < best
        rival = select(better, best, lower_of(estimate, rival))
        enclosed = (d0 < 0.0) & (d1 > 0.0) & ((top == i) | (top == i + 1.0))
        ordinary = select(better, select(enclosed, 1.0, 0.0), ordinary)
        place = select(better, problem.nodes[i + 1] + offset, place)
        low, high = select(better, problem.nodes[i + 1], low), select(better, problem.nodes[i], high)
        low_slope, high_slope = select(better, d0, low_slope), select(better, d1, high_slope)
        best = select(better, estimate, best)
    ordinary_lanes = (ordinary > 0.0) & (best <= RIVAL * least) & (rival > RIVAL * least)
    return place, (low, high, low_slope, high_slope), ordinary_lanes


@uncounted(error_model="numpy")
def _moments(rows, captures, log_mu):
    """Return what `irodori.fitting.varpro.moments` does."""
    factor = -exponential(-2.0 * log_mu)
    cg, cg1, cg2, rg, rg1 = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    rg2, gg, gg1, gg2 = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for j in range(captures):
        x = load(rows, row_place(L_SQUARE, j, captures)) * factor
        g = load(rows, row_place(L_GLOSS, j, captures)) * exponential(x)
        c = load(rows, row_place(L_WEIGHTED_COSINE, j, captures)) * g
        r = load(rows, row_place(L_WEIGHTED_RESPONSE, j, captures)) * g
        s = load(rows, row_place(L_WEIGHT, j, captures)) * g * g
        cg, rg, gg = cg + c, rg + r, gg + s
        c, r, s = c * x, r * x, s * x
        cg1, rg1, gg1 = cg1 + c, rg1 + r, gg1 + s
        cg2, rg2, gg2 = cg2 + c * x, rg2 + r * x, gg2 + s * x
    return (
        cg, -2.0 * cg1, 4.0 * (cg2 + cg1),
        rg, -2.0 * rg1, 4.0 * (rg2 + rg1),
        gg, -4.0 * gg1, 16.0 * gg2 + 8.0 * gg1,
    )  # fmt: skip


@njit(cache=True, error_model="numpy", inline="always")
def _through_ends(slope, curvature, low, high, low_slope, high_slope):
    """Return where the cubic through Φ' and Φ'' at 0 and through Φ' at both ends of the bracket is 0.

    What Newton's first step would leave to the second.
    """
    above = (high_slope - slope - curvature * high) / (high * high)
    below = (low_slope - slope - curvature * low) / (low * low)
    third = (above - below) / (high - low)
    second = above - third * high
    x = -slope / curvature
    for _ in range(2):
        x = x - (slope + x * (curvature + x * (second + x * third))) / (
            curvature + x * (2.0 * second + 3.0 * x * third)
        )
    return x


@uncounted(error_model="numpy")
def newton(rows, captures, fixed, box, place, bracket, wanted):
    """Return log μ, α, β and the steps, as `irodori.fitting.varpro.newton` does, and which lanes have converged."""
    t, a, b, steps = place, spread(0.0), spread(0.0), spread(0.0)
    low, high, low_slope, high_slope = bracket
    active = wanted
    for number in range(_MAX_STEPS):
        now_a, now_b, da, db, slope, curvature = slope_and_curvature(fixed, _moments(rows, captures, t), box)
        proposed = t - slope / curvature
        if number == 0:
            proposed = t + _through_ends(slope, curvature, low - t, high - t, low_slope, high_slope)
        above = slope > 0.0
        high, low = select(above, t, high), select(above, low, t)
        inside = (curvature > 0.0) & (proposed >= low) & (proposed <= high)
        following = select(inside, proposed, 0.5 * (low + high))
        change = following - t
        steps = steps + select(active, 1.0, 0.0)
        a = select(active, lower_of(upper_of(now_a + change * da, box[0]), box[1]), a)
        b = select(active, lower_of(upper_of(now_b + change * db, box[2]), box[3]), b)
        t = select(active, following, t)
        active = active & (magnitude(change) >= select(inside, _CONVERGED, 1e-9))
        if bits(active) == 0:
            break
    return t, a, b, steps, wanted & negated(active)
