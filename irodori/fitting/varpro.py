"""Variable projection: a scan of Φ(log μ), then safeguarded Newton steps in intervals that bracket a minimum.

If a lobe is an exponential with an exponent proportional to 1 / μ², its value at the next roughness of the scan,
smaller by √2, is its square; a scan then takes one exponential for each observation. From value and slope at the nodes
follows which intervals contain a minimum, and a cubic through them estimates its place. The best minimum is refined,
and every other that may be as low. Texels with the same geometry share tables of lobes
(`irodori.fitting.shared_geometry`), and if their weights agree too, all sums of the scan except those with the
response.

All functions except `find_intervals` and `minimise` work on one texel or on eight, see `irodori.fitting.texel_rows`.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.fitting.closed_form import best_pair, clamp, slope_and_curvature
from irodori.fitting.observations import Minimum
from irodori.fitting.texel_rows import (
    F0,
    F1,
    F2,
    GLOSS,
    LOBE,
    WEIGHT,
    WEIGHTED_COSINE,
    WEIGHTED_RESPONSE,
    any_of,
    folded,
    get,
    item,
    put,
    put_item,
    vectors_of,
)
from irodori.jit.compilation import njit, uncounted
from irodori.jit.functions import lower_of, magnitude, negated, root, select, upper_of
from irodori.jit.vector_memory import spread
from irodori.reflection import lobes as lobe_kernels

NODE_STEP = 0.5 * math.log(2.0)  # step of log μ for a factor √2
RIVAL = 1.05  # intervals with an estimate below this multiple of the best are refined too
LEAST_LOBE = 1e-74  # keeps squares of squares from becoming denormal numbers, which are slow
_CONVERGED = 3e-5  # Newton step of log μ at which the iteration ends; the remaining error is of the order of its square
_MAX_STEPS = 24
#: Rows of sums at the nodes of the scan: Σ w c g, Σ w ρ g, Σ w g², their slopes along log μ, Φ, Φ', and, for one texel
#: only, the estimated minimum in the interval below the node, and its place.
CG, RG, GG, CG1, RG1, GG1, VALUE, DESCENT, ESTIMATE, PLACE = range(10)
SUMS = 10


class Bracket(NamedTuple):
    """Interval of log μ in which Newton's method searches for a minimum, for one texel or for eight.

    Parameters
    ----------
    start : float or lanes
    low, high : float or lanes
        Ends of the interval.
    low_slope, high_slope : float or lanes
        Φ' at the ends; NaN if unknown.
    flat_above : bool or mask
        Whether a place with Φ' = 0 because β is at its bound lies above the minimum.
    wanted : bool or mask
        Texels to search.
    """

    start: float
    low: float
    high: float
    low_slope: float
    high_slope: float
    flat_above: bool
    wanted: bool


@uncounted(error_model="numpy")
def moments(rows, lobes, log_mu):
    """Return value, slope and curvature along log μ of Σ w c g, Σ w ρ g and Σ w g²."""
    if lobe_kernels.squares_at_half_octave(lobes):
        return _exponential_moments(rows, lobes, log_mu)
    return _moments(rows, lobes, log_mu)


@uncounted(error_model="numpy")
def _exponential_moments(rows, lobes, log_mu):
    """Return the moments of a lobe exp(x), x ∝ 1 / μ²; faster, because its derivatives are multiples of it."""
    constant = lobe_kernels.constants(lobes, log_mu)
    cg, cg1, cg2, rg, rg1 = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    rg2, gg, gg1, gg2 = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for j in range(vectors_of(rows)):
        f0 = get(rows, F0, j)
        x = f0 * constant[0]
        g = get(rows, GLOSS, j) * lobe_kernels.value(lobes, constant, f0, get(rows, F1, j), get(rows, F2, j))
        c = get(rows, WEIGHTED_COSINE, j) * g
        r = get(rows, WEIGHTED_RESPONSE, j) * g
        s = get(rows, WEIGHT, j) * g * g
        cg, rg, gg = cg + c, rg + r, gg + s
        c, r, s = c * x, r * x, s * x
        cg1, rg1, gg1 = cg1 + c, rg1 + r, gg1 + s
        cg2, rg2, gg2 = cg2 + c * x, rg2 + r * x, gg2 + s * x
    # dg/dt = -2 x g, d²g/dt² = (4 x² + 4 x) g; g² has twice the exponent.
    cg1, rg1, gg1 = folded(cg1, log_mu), folded(rg1, log_mu), folded(gg1, log_mu)
    return (
        folded(cg, log_mu), -2.0 * cg1, 4.0 * (folded(cg2, log_mu) + cg1),
        folded(rg, log_mu), -2.0 * rg1, 4.0 * (folded(rg2, log_mu) + rg1),
        folded(gg, log_mu), -4.0 * gg1, 16.0 * folded(gg2, log_mu) + 8.0 * gg1,
    )  # fmt: skip


@uncounted(error_model="numpy")
def _moments(rows, lobes, log_mu):
    """Return the moments of any lobe."""
    constant = lobe_kernels.constants(lobes, log_mu)
    cg, cg1, cg2, rg, rg1 = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    rg2, gg, gg1, gg2 = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for j in range(vectors_of(rows)):
        plain = get(rows, GLOSS, j)
        v, v1, v2 = lobe_kernels.derivatives(lobes, constant, get(rows, F0, j), get(rows, F1, j), get(rows, F2, j))
        g, g1, g2 = plain * v, plain * v1, plain * v2
        wc, wr, w = get(rows, WEIGHTED_COSINE, j), get(rows, WEIGHTED_RESPONSE, j), get(rows, WEIGHT, j)
        cg, cg1, cg2 = cg + wc * g, cg1 + wc * g1, cg2 + wc * g2
        rg, rg1, rg2 = rg + wr * g, rg1 + wr * g1, rg2 + wr * g2
        wg = w * g
        gg, gg1, gg2 = gg + wg * g, gg1 + wg * g1, gg2 + (w * g1 * g1 + wg * g2)
    return (
        folded(cg, log_mu), folded(cg1, log_mu), folded(cg2, log_mu),
        folded(rg, log_mu), folded(rg1, log_mu), folded(rg2, log_mu),
        folded(gg, log_mu), 2.0 * folded(gg1, log_mu), 2.0 * folded(gg2, log_mu),
    )  # fmt: skip


@uncounted(error_model="numpy")
def _fill_value(rows, lobes, constant):
    for j in range(vectors_of(rows)):
        put(rows, LOBE, j, lobe_kernels.value(lobes, constant, get(rows, F0, j), get(rows, F1, j), get(rows, F2, j)))


@njit(cache=True, forceinline=True)
def _put_node(sums, i, found, zero):
    cg, rg, gg, cg1, rg1, gg1 = found
    put_item(sums, CG, i, folded(cg, zero), zero)
    put_item(sums, RG, i, folded(rg, zero), zero)
    put_item(sums, GG, i, folded(gg, zero), zero)
    put_item(sums, CG1, i, folded(cg1, zero), zero)
    put_item(sums, RG1, i, folded(rg1, zero), zero)
    put_item(sums, GG1, i, folded(gg1, zero), zero)


@uncounted(error_model="numpy")
def _sum_squared_node(steepness, rows, sums, i, zero):
    """Fill the sums of node i, and square the lobe; its logarithm has the slope ``steepness`` f0 along log μ."""
    cg, rg, gg, cg1, rg1, gg1 = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for j in range(vectors_of(rows)):
        lobe = get(rows, LOBE, j)
        g = get(rows, GLOSS, j) * lobe
        put(rows, LOBE, j, lobe * lobe + LEAST_LOBE)
        s = get(rows, WEIGHT, j) * g * g
        r = get(rows, WEIGHTED_RESPONSE, j) * g
        c = get(rows, WEIGHTED_COSINE, j) * g
        x = get(rows, F0, j)
        gg, rg, cg = gg + s, rg + r, cg + c
        gg1, rg1, cg1 = gg1 + s * x, rg1 + r * x, cg1 + c * x
    _put_node(sums, i, (cg, rg, gg, steepness * cg1, steepness * rg1, 2.0 * steepness * gg1), zero)


@uncounted(error_model="numpy")
def _sum_node(lobes, log_mu, rows, sums, i, zero):
    """Fill the sums of node i for any lobe."""
    constant = lobe_kernels.constants(lobes, log_mu)
    cg, rg, gg, cg1, rg1, gg1 = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for j in range(vectors_of(rows)):
        v, v1, _ = lobe_kernels.derivatives(lobes, constant, get(rows, F0, j), get(rows, F1, j), get(rows, F2, j))
        plain = get(rows, GLOSS, j)
        g, g1 = plain * v, plain * v1
        wc, wr, wg = get(rows, WEIGHTED_COSINE, j), get(rows, WEIGHTED_RESPONSE, j), get(rows, WEIGHT, j) * g
        cg, rg, gg = cg + wc * g, rg + wr * g, gg + wg * g
        cg1, rg1, gg1 = cg1 + wc * g1, rg1 + wr * g1, gg1 + wg * g1
    _put_node(sums, i, (cg, rg, gg, cg1, rg1, 2.0 * gg1), zero)


@uncounted(error_model="numpy")
def scan(rows, problem, sums, zero):
    """Fill the sums at all nodes of the scan.

    Parameters
    ----------
    rows : (ROWS, P) float64
    problem : irodori.fitting.texels.Problem
        Its nodes, log μ, decrease in steps of `NODE_STEP`; the last step may be smaller.
    sums : (SUMS, nodes) float64, or for eight texels (SUMS, 8 nodes)
    zero : float or lanes
        0 of the type that selects one texel or eight.
    """
    lobes, count = problem.lobes, problem.nodes.size
    if lobe_kernels.squares_at_half_octave(lobes):
        for first, end in ((0, count - 1), (count - 1, count)):
            constant = lobe_kernels.constants(lobes, problem.nodes[first])
            _fill_value(rows, lobes, constant)
            steepness = -2.0 * constant[0]
            for i in range(first, end):
                _sum_squared_node(steepness, rows, sums, i, zero)
                steepness *= 2.0
    else:
        for i in range(count):
            _sum_node(lobes, problem.nodes[i], rows, sums, i, zero)


@uncounted(error_model="numpy")
def value_nodes(fixed, sums, nodes, box, zero):
    """Fill Φ and Φ' at all nodes; return the smallest Φ and the index of its node."""
    least, top = zero + np.inf, zero
    for i in range(nodes):
        cg, rg, gg = item(sums, CG, i, zero), item(sums, RG, i, zero), item(sums, GG, i, zero)
        a, b, value = best_pair(fixed, cg, rg, gg, box)
        cg1, rg1, gg1 = item(sums, CG1, i, zero), item(sums, RG1, i, zero), item(sums, GG1, i, zero)
        put_item(sums, VALUE, i, value, zero)
        put_item(sums, DESCENT, i, b * (b * gg1 + 2.0 * (a * cg1 - rg1)), zero)
        top = select(value < least, float(i), top)
        least = lower_of(value, least)
    return least, top


@njit(cache=True, error_model="numpy", forceinline=True)
def _cubic_minimum(width, f0, f1, d0, d1):
    """Return place (0 to ``width``) and value of the minimum of the cubic with given values and slopes at the ends."""
    u = d0 + d1 - 3.0 * (f1 - f0) / width
    half = root(upper_of(u * u - d0 * d1, 0.0))
    bottom = d1 - d0 + 2.0 * half
    s = select(bottom > 0.0, 1.0 - (d1 + half - u) / select(bottom > 0.0, bottom, 1.0), 0.5)
    s = clamp(s, 0.02, 0.98)
    h00, h01 = (1.0 + 2.0 * s) * (1.0 - s) * (1.0 - s), s * s * (3.0 - 2.0 * s)
    h10, h11 = s * (1.0 - s) * (1.0 - s), s * s * (s - 1.0)
    return s * width, h00 * f0 + h01 * f1 + width * (h10 * d0 + h11 * d1)


@njit(cache=True, error_model="numpy", forceinline=True)
def interval_minimum(width, f0, f1, d0, d1):
    """Estimate the minimum of Φ within an interval.

    Parameters
    ----------
    width : float
        Width of the interval in log μ.
    f0, f1, d0, d1 : float or lanes
        Φ at the ends, the smaller μ first, and Φ' there.

    Returns
    -------
    value : float or lanes
        Estimated minimum; infinite if there is none.
    offset : float or lanes
        Its distance from the lower end.
    """
    # The slope is 0 where the best β is at its bound.
    sure = (d0 <= 0.0) & (d1 >= 0.0) & (d0 < d1)
    # An interval with slopes of one sign may contain a minimum, too. Multiplied by the width to avoid slow divisions.
    both, u = d0 * d1 * (width * width), (d0 + d1) * width - 3.0 * (f1 - f0)
    holds = sure | ((both > 0.0) & (u * d0 > 0.0) & (u * u > both))
    if not any_of(holds):
        return select(holds, f0, np.inf), 0.0 * f0
    offset, found = _cubic_minimum(width, f0, f1, d0, d1)
    ends = lower_of(f0, f1)
    return select(holds & (sure | (found < ends)), lower_of(found, ends), np.inf), offset


@uncounted(error_model="numpy")
def find_intervals(nodes, sums, best):
    """Fill the estimated minimum of every interval of one texel, and its place; infinite if there is none."""
    value, slope, estimate, place = sums[VALUE], sums[DESCENT], sums[ESTIMATE], sums[PLACE]
    for i in range(nodes.size - 1):
        width = nodes[i] - nodes[i + 1]  # node i + 1 has the smaller μ
        estimate[i], offset = interval_minimum(width, value[i + 1], value[i], slope[i + 1], slope[i])
        place[i] = nodes[i + 1] + offset
    # Φ decreases from the best node into this interval and is higher at its other end, so it contains a minimum.
    if slope[best] > 0.0 and best + 1 < nodes.size and estimate[best] == np.inf:
        estimate[best] = value[best]
        place[best] = 0.8 * nodes[best] + 0.2 * nodes[best + 1]
    elif slope[best] < 0.0 and best > 0 and estimate[best - 1] == np.inf:
        estimate[best - 1] = value[best]
        place[best - 1] = 0.8 * nodes[best] + 0.2 * nodes[best - 1]


@njit(cache=True, error_model="numpy", forceinline=True)
def _through_ends(slope, curvature, low, high, slopes):
    """Return the zero of the cubic with the values Φ' and Φ'' at 0, and Φ' at both ends of the bracket.

    It is more accurate than Newton's first step, and saves the second.
    """
    above = (slopes[1] - slope - curvature * high) / (high * high)
    below = (slopes[0] - slope - curvature * low) / (low * low)
    third = (above - below) / (high - low)
    second = above - third * high
    x = -slope / curvature
    for _ in range(2):
        x = x - (slope + x * (curvature + x * (second + x * third))) / (
            curvature + x * (2.0 * second + 3.0 * x * third)
        )
    return x


@uncounted(error_model="numpy")
def newton(rows, lobes, fixed, box, bracket, most):
    """Find the minimum of Φ in a bracket by safeguarded Newton steps.

    Parameters
    ----------
    rows, lobes, fixed, box
        Rows of observations, lobe, sums without lobe, and bounds, see `irodori.fitting.closed_form`.
    bracket : Bracket
    most : int
        Largest number of evaluations.

    Returns
    -------
    found : Minimum
        With evaluations as float or lanes.
    converged : bool or mask
    """
    zero, low, high = 0.0 * bracket.start, bracket.low, bracket.high
    t, a, b, steps, active = bracket.start, zero, zero, zero, bracket.wanted
    for number in range(most):
        now_a, now_b, da, db, slope, curvature = slope_and_curvature(fixed, moments(rows, lobes, t), box)
        proposed = t - slope / curvature
        if number == 0:
            slopes = bracket.low_slope, bracket.high_slope
            better = t + _through_ends(slope, curvature, low - t, high - t, slopes)
            proposed = select(better == better, better, proposed)
        above = (slope > 0.0) | ((slope == 0.0) & bracket.flat_above)
        high, low = select(above, t, high), select(above, low, t)
        inside = (curvature > 0.0) & (proposed >= low) & (proposed <= high)
        following = select(inside, proposed, 0.5 * (low + high))
        change = following - t
        steps = steps + select(active, 1.0, 0.0)
        a = select(active, clamp(now_a + change * da, box[0], box[1]), a)
        b = select(active, clamp(now_b + change * db, box[2], box[3]), b)
        t = select(active, following, t)
        active = active & (magnitude(change) >= select(inside, _CONVERGED, 1e-9))
        if not any_of(active):
            break
    return Minimum(a, b, t, steps), bracket.wanted & negated(active)


@uncounted(error_model="numpy")
def pair_at(rows, lobes, fixed, box, log_mu):
    """Return the best α and β at one log μ, and their sum of squares."""
    m = moments(rows, lobes, log_mu)
    return best_pair(fixed, m[0], m[3], m[6], box)


@uncounted(error_model="numpy")
def minimise(rows, lobes, fixed, box, nodes, sums):
    """Return the lowest `Minimum` of one texel from the sums of a finished scan."""
    best, found = value_nodes(fixed, sums, nodes.size, box, 0.0)
    top = int(found)
    find_intervals(nodes, sums, top)
    best_t, evaluations = nodes[top], nodes.size
    for attempt in range(nodes.size):
        i, rival = 0, np.inf
        for other in range(1, nodes.size - 1):
            if sums[ESTIMATE, other] < sums[ESTIMATE, i]:
                rival, i = sums[ESTIMATE, i], other
            else:
                rival = min(rival, sums[ESTIMATE, other])
        if not sums[ESTIMATE, i] <= RIVAL * best:
            break
        low_slope, high_slope = sums[DESCENT, i + 1], sums[DESCENT, i]
        # If the slopes at the ends have opposite signs, the minimum is below both nodes; otherwise compare.
        sure = low_slope <= 0.0 <= high_slope and (i == top or i + 1 == top)
        enclosed = low_slope < 0.0 < high_slope
        slopes = (low_slope, high_slope) if enclosed else (np.nan, np.nan)
        bracket = Bracket(sums[PLACE, i], nodes[i + 1], nodes[i], slopes[0], slopes[1], high_slope == 0.0, True)
        found, _ = newton(rows, lobes, fixed, box, bracket, _MAX_STEPS)
        sums[ESTIMATE, i] = np.inf
        evaluations += int(found.evaluations)
        if attempt == 0 and sure and not rival <= RIVAL * best:
            return Minimum(found.alpha, found.beta, found.log_mu, evaluations)
        _, _, value = pair_at(rows, lobes, fixed, box, found.log_mu)
        evaluations += 1
        if value <= best:
            best_t, best = found.log_mu, value
    a, b, _ = pair_at(rows, lobes, fixed, box, best_t)
    return Minimum(a, b, best_t, evaluations + 1)
