"""Eight texels at once: the ordinary case of variable projection and of what is said about its outcome, in lanes.

A texel takes this way where one interval of the scan certainly holds the lowest minimum, no other comes near, and the
data calls for both diffuse light and gloss. Every step is that of `irodori.fitting.texels`, and where a lane meets
anything else it is handed back, to be fitted alone. Scan, Newton's steps and errors read the rows of observations from
one array whose last axis are the lanes.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from irodori.fitting import judge
from irodori.fitting.linear import best_pair, slope_and_curvature
from irodori.fitting.lobe import COSINE, GLOSS, LEAST_LOBE, SPOILED, SQUARE, attenuation, cosine_of, fresnel_of
from irodori.fitting.observations import ENOUGH, LARGE, LEAST_VARIANCE, TINY, is_same
from irodori.fitting.shared import WIDTH
from irodori.fitting.varpro import RIVAL, cubic_minimum
from irodori.lanes import (
    COUNT,
    bits,
    exponential,
    lanes_times_tables,
    load,
    log,
    lower_of,
    magnitude,
    negated,
    select,
    spread,
    store,
    upper_of,
)
from irodori.native import aligned

NOISY = 0.01  # relative variance of an observation times their number, from which on weights are of the fitted response
SURE = 4.0  # standard errors of α from zero, from which on a model without diffuse light is not tried
_CONVERGED = 3e-5  # last Newton step of log μ; nearer than alone, for the first step leaves the second just under that
_MAX_STEPS = 12  # of Newton; a texel that takes more is fitted alone
_SINGULAR = 1e-10
#: Rows of lanes: cosθ_i, F G / cosθ_r, φ², what is not a number, response, weight, variance, weight times cosine and
#: times response, lobe, and the weights of the texels before.
_C, _G, _Q, _S, _R, _W, _V, _WC, _WR, _D, _BEFORE = range(11)
_ROWS = 11
#: Sums at a node: Σ w c g, Σ w ρ g, Σ w g², then their slopes along log μ; then Φ and Φ'.
_CG, _RG, _GG, _CG1, _RG1, _GG1, _VALUE, _DESCENT = range(8)
_SUMS = 8
_GROUP = 6  # nodes that are summed together
_sum_nodes = lanes_times_tables(_GROUP)


class Abreast(NamedTuple):
    """Buffers of one thread for eight texels."""

    rows: np.ndarray  # (_ROWS * J * COUNT,)
    sums: np.ndarray  # (_SUMS * nodes * COUNT,), nodes padded to a multiple of _GROUP
    results: np.ndarray  # (judge.COLUMNS + 2, COUNT): the columns, status, evaluations


@numba.njit(cache=True)
def new_abreast(captures, nodes):
    """Return buffers for so many photographs and nodes of the scan."""
    groups = (nodes + _GROUP - 1) // _GROUP
    rows = aligned(_ROWS * captures * COUNT)
    for j in range(captures * COUNT):
        rows[_BEFORE * captures * COUNT + j] = np.nan
    return Abreast(rows, aligned(_SUMS * groups * _GROUP * COUNT), np.zeros((judge.COLUMNS + 2, COUNT)))


@numba.njit(cache=True, inline="always")
def _place(row, j, count):
    return (row * count + j) * COUNT


@numba.njit(cache=True)
def spread_geometry(common, rows, captures):
    """Fill the rows of the geometry that all texels share."""
    for j in range(captures):
        store(rows, _place(_C, j, captures), spread(common[COSINE, j]))
        store(rows, _place(_G, j, captures), spread(common[GLOSS, j]))
        store(rows, _place(_Q, j, captures), spread(common[SQUARE, j]))
        store(rows, _place(_S, j, captures), spread(common[SPOILED, j]))


@numba.njit(cache=True, error_model="numpy")
def _pack_own(problem, first, last, rows):
    """Fill the rows of the geometries of eight texels; the last stands for those beyond the end."""
    captures, many = problem.geometry.shape[1], problem.n.size > 1
    for i in range(COUNT):
        t = min(first + i, last - 1)
        for j in range(captures):
            for angle in range(4):
                rows[_place(_R + angle, j, captures) + i] = problem.geometry[t, j, angle]
        rows[_place(_D, 0, captures) + i] = problem.n[t if many else 0]
    n = load(rows, _place(_D, 0, captures))
    for j in range(captures):
        theta_i, theta_r = load(rows, _place(_R, j, captures)), load(rows, _place(_R + 1, j, captures))
        theta_h, phi = load(rows, _place(_R + 2, j, captures)), load(rows, _place(_R + 3, j, captures))
        store(rows, _place(_S, j, captures), 0.0 * (theta_i + theta_r + (theta_h + phi)))
        bounded = select(magnitude(phi) < math.pi, phi, math.pi)
        store(rows, _place(_Q, j, captures), bounded * bounded)
        cos_i, cos_r, cos_h = cosine_of(theta_i), cosine_of(theta_r), cosine_of(theta_h)
        carried = attenuation(cos_i, cos_r, cos_h, cosine_of(phi))
        store(rows, _place(_G, j, captures), fresnel_of(cos_h, n, problem.k) * carried)
        store(rows, _place(_C, j, captures), select((cos_i > 0.0) & (cos_r > 0.0), cos_i, 0.0))


@numba.njit(cache=True, error_model="numpy")
def _load(problem, rules, first, last, rows):
    """Fill responses, variances and weights; return the observations used, the floor, and which lanes are ordinary."""
    captures = problem.response.shape[1]
    if first + COUNT <= last:
        for j in range(captures):
            for i in range(COUNT):
                rows[_place(_R, j, captures) + i] = problem.response[first + i, j]
            for i in range(COUNT):
                rows[_place(_W, j, captures) + i] = problem.weight[first + i, j]
    else:  # the last texel stands for those beyond the end
        for i in range(COUNT):
            t = min(first + i, last - 1)
            for j in range(captures):
                rows[_place(_R, j, captures) + i] = problem.response[t, j]
                rows[_place(_W, j, captures) + i] = problem.weight[t, j]
    used, total, power, largest = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for j in range(captures):
        given, trust = load(rows, _place(_R, j, captures)), load(rows, _place(_W, j, captures))
        fine = (magnitude(given + load(rows, _place(_S, j, captures))) < np.inf) & (trust > 0.0) & (trust < np.inf)
        r, t = select(fine, given, 0.0), select(fine, trust, 0.0)
        store(rows, _place(_R, j, captures), r)
        store(rows, _place(_W, j, captures), t)
        used = used + select(fine, 1.0, 0.0)
        largest = upper_of(largest, t)
        total = total + t
        power = power + t * r * r
    ordinary = (largest <= LARGE) & (total * LARGE >= used) & (total > 0.0)
    power = power / select(ordinary, total, 1.0)
    relative = rules.model_error * rules.model_error
    common = TINY + (LEAST_VARIANCE if rules.known else relative) * power
    relative = relative if rules.known else 0.0
    floor = spread(0.0)
    for j in range(captures):
        r, w = load(rows, _place(_R, j, captures)), load(rows, _place(_W, j, captures))
        v = common + problem.noise[0, j] + problem.noise[1, j] * upper_of(r, 0.0) + relative * r * r
        store(rows, _place(_V, j, captures), v)
        if rules.weighted:
            w = w / v
            store(rows, _place(_W, j, captures), w)
        floor = floor + w * v
    return used, floor / upper_of(used, 1.0), ordinary


@numba.njit(cache=True, error_model="numpy")
def _tell(rows, captures):
    """Return which lanes have `ENOUGH` geometries that differ."""
    nothing, count = spread(np.nan), spread(0.0)
    first, second, third = (nothing, nothing, nothing), (nothing, nothing, nothing), (nothing, nothing, nothing)
    for j in range(captures):
        now = (
            load(rows, _place(_C, j, captures)),
            load(rows, _place(_Q, j, captures)),
            load(rows, _place(_G, j, captures)),
        )
        known = is_same(now, first) | is_same(now, second) | is_same(now, third)
        new = (load(rows, _place(_W, j, captures)) > 0.0) & negated(known)
        third = _replaced(new & (count == 2.0), now, third)
        second = _replaced(new & (count == 1.0), now, second)
        first = _replaced(new & (count == 0.0), now, first)
        count = select(new, count + 1.0, count)
        if bits(count >= float(ENOUGH)) == 255:
            break
    return count >= float(ENOUGH)


@numba.njit(cache=True, inline="always")
def _replaced(mask, now, before):
    return select(mask, now[0], before[0]), select(mask, now[1], before[1]), select(mask, now[2], before[2])


@numba.njit(cache=True, error_model="numpy")
def _expect(problem, rules, rows, a, b, log_mu, noisy):
    """Weigh the observations of noisy lanes as `irodori.fitting.observations.expect` does."""
    captures = problem.response.shape[1]
    factor, relative = -exponential(-2.0 * log_mu), rules.model_error * rules.model_error
    for j in range(captures):
        r, v = load(rows, _place(_R, j, captures)), load(rows, _place(_V, j, captures))
        lobe = load(rows, _place(_G, j, captures)) * exponential(load(rows, _place(_Q, j, captures)) * factor)
        fitted = a * load(rows, _place(_C, j, captures)) + b * lobe
        u = v + problem.noise[1, j] * (fitted - upper_of(r, 0.0)) + relative * (fitted * fitted - r * r)
        u = select(noisy, upper_of(u, LEAST_VARIANCE * v), v)
        store(rows, _place(_V, j, captures), u)
        w = load(rows, _place(_W, j, captures))
        store(rows, _place(_W, j, captures), select(noisy, w * v / u, w))


@numba.njit(cache=True, error_model="numpy")
def _weigh(rows, captures):
    """Fill the weighted rows; return Σ w c², Σ w c ρ, Σ w ρ², Σ w, and whether weights differ from those before."""
    cc, cr, rr, total = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    same = total == total
    for j in range(captures):
        w, c = load(rows, _place(_W, j, captures)), load(rows, _place(_C, j, captures))
        r, before = load(rows, _place(_R, j, captures)), load(rows, _place(_BEFORE, j, captures))
        same = same & (w == before)
        store(rows, _place(_BEFORE, j, captures), w)
        wc, wr = w * c, w * r
        store(rows, _place(_WC, j, captures), wc)
        store(rows, _place(_WR, j, captures), wr)
        cc = cc + wc * c
        cr = cr + wc * r
        rr = rr + wr * r
        total = total + w
    return (cc, cr, rr, total), bits(same) != 255


@numba.njit(cache=True)
def _scan_tables(shared, rows, captures, nodes, sums, changed):
    """Fill the sums of all nodes from the tables of a shared geometry; those without the response if ``changed``."""
    blocks, height = shared.nodes.shape[1], shared.nodes.shape[2]
    table, padded = height * WIDTH, (nodes + _GROUP - 1) // _GROUP * _GROUP
    for group in range(padded // _GROUP):
        block, column = group * _GROUP // WIDTH, group * _GROUP % WIDTH
        kind, into, step = block * table + column, group * _GROUP * COUNT, padded * COUNT
        flat, row = blocks * table, captures * COUNT
        _sum_nodes(rows, _WR * row, captures, shared.nodes, kind, kind + flat, WIDTH,
                   sums, into + _RG * step, (_RG1 - _RG) * step)  # fmt: skip
        if changed:
            _sum_nodes(rows, _WC * row, captures, shared.nodes, kind, kind + flat, WIDTH,
                       sums, into + _CG * step, (_CG1 - _CG) * step)  # fmt: skip
            _sum_nodes(rows, _W * row, captures, shared.nodes, kind + 2 * flat, kind + 3 * flat, WIDTH,
                       sums, into + _GG * step, (_GG1 - _GG) * step)  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def _scan_squares(problem, rows, sums):
    """Fill the sums of all nodes for geometries of their own: from one node of a chain to the next D is squared."""
    captures, count = problem.response.shape[1], problem.nodes.size
    for chain in range(problem.chains + 1):
        first, step = (chain, problem.chains) if chain < problem.chains else (count - 1, count)
        factor = -math.exp(-2.0 * problem.nodes[first])
        for j in range(captures):
            store(rows, _place(_D, j, captures), exponential(load(rows, _place(_Q, j, captures)) * factor))
        for i in range(first, count - 1 if chain < problem.chains else count, step):
            _sum_node(problem.steepness[i], rows, captures, sums, i, count)


@numba.njit(cache=True, error_model="numpy", inline="always")
def _sum_node(steepness, rows, captures, sums, i, nodes):
    """Fill the sums of node i and square the lobe; ``steepness`` is 2 / μ²."""
    cg, rg, gg, cg1, rg1, gg1 = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for j in range(captures):
        lobe, x = load(rows, _place(_D, j, captures)), load(rows, _place(_Q, j, captures))
        g = load(rows, _place(_G, j, captures)) * lobe
        c = load(rows, _place(_WC, j, captures)) * g
        r = load(rows, _place(_WR, j, captures)) * g
        s = load(rows, _place(_W, j, captures)) * g * g
        cg = cg + c
        rg = rg + r
        gg = gg + s
        cg1 = cg1 + c * x
        rg1 = rg1 + r * x
        gg1 = gg1 + s * x
        store(rows, _place(_D, j, captures), lobe * lobe + LEAST_LOBE)
    padded = (nodes + _GROUP - 1) // _GROUP * _GROUP
    store(sums, _place(_CG, i, padded), cg)
    store(sums, _place(_RG, i, padded), rg)
    store(sums, _place(_GG, i, padded), gg)
    store(sums, _place(_CG1, i, padded), steepness * cg1)
    store(sums, _place(_RG1, i, padded), steepness * rg1)
    store(sums, _place(_GG1, i, padded), 2.0 * steepness * gg1)


@numba.njit(cache=True, error_model="numpy")
def _value_nodes(fixed, sums, nodes, box):
    """Fill Φ and Φ' of all nodes; return the least and its node."""
    padded = (nodes + _GROUP - 1) // _GROUP * _GROUP
    least, top = spread(np.inf), spread(0.0)
    for i in range(nodes):
        cg, rg = load(sums, _place(_CG, i, padded)), load(sums, _place(_RG, i, padded))
        gg = load(sums, _place(_GG, i, padded))
        a, b, value = best_pair(fixed, cg, rg, gg, box)
        cg1, rg1 = load(sums, _place(_CG1, i, padded)), load(sums, _place(_RG1, i, padded))
        gg1 = load(sums, _place(_GG1, i, padded))
        store(sums, _place(_VALUE, i, padded), value)
        store(sums, _place(_DESCENT, i, padded), b * (b * gg1 + 2.0 * (a * cg1 - rg1)))
        top = select(value < least, i, top)
        least = lower_of(value, least)
    return least, top


@numba.njit(cache=True, error_model="numpy")
def _best_interval(problem, sums, least, top):
    """Return where the lowest minimum is estimated, its bracket with Φ' at the ends, and which lanes have no other."""
    count = problem.nodes.size
    padded = (count + _GROUP - 1) // _GROUP * _GROUP
    best, rival = spread(np.inf), spread(np.inf)
    place, low, high, ordinary = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    low_slope, high_slope = spread(0.0), spread(0.0)
    for i in range(count - 1):
        f0, f1 = load(sums, _place(_VALUE, i + 1, padded)), load(sums, _place(_VALUE, i, padded))
        d0, d1 = load(sums, _place(_DESCENT, i + 1, padded)), load(sums, _place(_DESCENT, i, padded))
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


@numba.njit(cache=True, error_model="numpy")
def _moments(rows, captures, log_mu):
    """Return what `irodori.fitting.varpro.moments` does."""
    factor = -exponential(-2.0 * log_mu)
    cg, cg1, cg2, rg, rg1 = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    rg2, gg, gg1, gg2 = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for j in range(captures):
        x = load(rows, _place(_Q, j, captures)) * factor
        g = load(rows, _place(_G, j, captures)) * exponential(x)
        c = load(rows, _place(_WC, j, captures)) * g
        r = load(rows, _place(_WR, j, captures)) * g
        s = load(rows, _place(_W, j, captures)) * g * g
        cg, rg, gg = cg + c, rg + r, gg + s
        c, r, s = c * x, r * x, s * x
        cg1, rg1, gg1 = cg1 + c, rg1 + r, gg1 + s
        cg2, rg2, gg2 = cg2 + c * x, rg2 + r * x, gg2 + s * x
    return (
        cg, -2.0 * cg1, 4.0 * (cg2 + cg1),
        rg, -2.0 * rg1, 4.0 * (rg2 + rg1),
        gg, -4.0 * gg1, 16.0 * gg2 + 8.0 * gg1,
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy", inline="always")
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


@numba.njit(cache=True, error_model="numpy")
def _newton(rows, captures, fixed, box, place, bracket, wanted):
    """Return log μ, α, β and the steps, as `irodori.fitting.varpro.newton` does, and which lanes have converged."""
    t, a, b, steps = place, spread(0.0), spread(0.0), spread(0.0)
    low, high, low_slope, high_slope = bracket
    active = wanted
    for number in range(_MAX_STEPS):
        now_a, now_b, da, db, slope, curvature = slope_and_curvature(fixed, _moments(rows, captures, t), box)
        newton = t - slope / curvature
        if number == 0:
            newton = t + _through_ends(slope, curvature, low - t, high - t, low_slope, high_slope)
        above = slope > 0.0
        high, low = select(above, t, high), select(above, low, t)
        inside = (curvature > 0.0) & (newton >= low) & (newton <= high)
        following = select(inside, newton, 0.5 * (low + high))
        change = following - t
        steps = steps + select(active, 1.0, 0.0)
        a = select(active, lower_of(upper_of(now_a + change * da, box[0]), box[1]), a)
        b = select(active, lower_of(upper_of(now_b + change * db, box[2]), box[3]), b)
        t = select(active, following, t)
        active = active & (magnitude(change) >= select(inside, _CONVERGED, 1e-9))
        if bits(active) == 0:
            break
    return t, a, b, steps, wanted & negated(active)


@numba.njit(cache=True, error_model="numpy")
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
        q, c, w = (load(rows, _place(_Q, j, captures)), load(rows, _place(_C, j, captures)),
                   load(rows, _place(_W, j, captures)))  # fmt: skip
        x, plain = q * factor, load(rows, _place(_G, j, captures))
        g = plain * exponential(x)
        store(rows, _place(_D, j, captures), g)
        s = -2.0 * b * x * g
        pose = slope_factor * q * g * g + a * a * (1.0 - c * c)
        v = load(rows, _place(_V, j, captures)) + rules.pose_variance * pose
        r = a * c + b * g - load(rows, _place(_R, j, captures))
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


@numba.njit(cache=True, error_model="numpy")
def _scatter(rows, captures, a, b, log_mu, correlation, scale, determinant):
    """Return what `irodori.fitting.judge` does where the variances are not known; after `_normal`."""
    p, q, r = correlation
    i0, i1, i2 = 1.0 - r * r, 1.0 - q * q, 1.0 - p * p
    i01, i02, i12 = q * r - p, p * r - q, p * q - r
    factor, inverse, zero = -exponential(-2.0 * log_mu), 1.0 / determinant, spread(0.0)
    m0, m1, m2, m3, m4, m5 = zero, zero, zero, zero, zero, zero
    for j in range(captures):
        x, w = load(rows, _place(_Q, j, captures)) * factor, load(rows, _place(_W, j, captures))
        c, g = load(rows, _place(_C, j, captures)), load(rows, _place(_D, j, captures))
        s = -2.0 * b * x * g
        u0, u1, u2 = c * scale[0], g * scale[1], s * scale[2]
        form = u0 * (i0 * u0 + 2.0 * (i01 * u1 + i02 * u2)) + u1 * (i1 * u1 + 2.0 * i12 * u2) + i2 * u2 * u2
        left = upper_of(1.0 - w * form * inverse, judge.LEAST_LEFT)
        off = (a * c + b * g - load(rows, _place(_R, j, captures))) / left
        u = w * w * upper_of(off * off, load(rows, _place(_V, j, captures)))
        uc, ug = u * c, u * g
        m0, m1, m2 = m0 + uc * c, m1 + uc * g, m2 + ug * g
        m3, m4, m5 = m3 + uc * s, m4 + ug * s, m5 + u * s * s
    return m0, m1, m2, m3, m4, m5


@numba.njit(cache=True, error_model="numpy")
def _judge(rows, captures, fixed, found, used, floor, rules, results):
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


@numba.njit(cache=True, error_model="numpy")
def _minimise(problem, shared, rules, rows, sums, ordinary):
    """Return the fixed sums, log μ, α, β, the steps, and which lanes stayed ordinary."""
    captures, nodes = problem.response.shape[1], problem.nodes.size
    box = (rules.low_alpha, rules.high_alpha, rules.low_beta, rules.high_beta)
    fixed, changed = _weigh(rows, captures)
    if shared.nodes.shape[1] == 0:
        _scan_squares(problem, rows, sums)
    else:
        _scan_tables(shared, rows, captures, nodes, sums, changed)
    least, top = _value_nodes(fixed, sums, nodes, box)
    place, bracket, single = _best_interval(problem, sums, least, top)
    t, a, b, steps, converged = _newton(rows, captures, fixed, box, place, bracket, ordinary & single)
    return fixed, t, a, b, steps, converged


@numba.njit(cache=True, error_model="numpy")
def fit_abreast(problem, shared, rules, first, last, buffers):
    """Fit texels ``first`` .. ``first + 7``, those before ``last``; return a bit for each that is done.

    Parameters
    ----------
    problem, shared, rules
        As in `irodori.fitting.texels`; the rows of a shared geometry are filled already.
    buffers : Abreast
        Its results are filled.
    """
    captures, rows, sums = problem.response.shape[1], buffers.rows, buffers.sums
    if shared.nodes.shape[1] == 0:
        _pack_own(problem, first, last, rows)
    used, floor, ordinary = _load(problem, rules, first, last, rows)
    ordinary = ordinary & _tell(rows, captures)
    fixed, t, a, b, steps, ordinary = _minimise(problem, shared, rules, rows, sums, ordinary)
    if rules.weighted:
        noisy = ordinary & (used * used * floor > NOISY * fixed[2])
        if bits(noisy) != 0:
            _expect(problem, rules, rows, a, b, t, noisy)
            before = steps
            fixed, t, a, b, steps, ordinary = _minimise(problem, shared, rules, rows, sums, ordinary)
            steps = select(noisy, steps + before, steps)
    if bits(ordinary) == 0:
        return 0
    ordinary = ordinary & _judge(rows, captures, fixed, (a, b, t), used, floor, rules, buffers.results)
    store(buffers.results, (judge.COLUMNS + 1) * COUNT, steps + problem.nodes.size)
    return int(bits(ordinary)) & _unclipped(problem, first, last)


@numba.njit(cache=True)
def _unclipped(problem, first, last):
    """Return a bit for each texel of which no observation clips."""
    found = (1 << min(COUNT, last - first)) - 1
    for i in range(min(COUNT, last - first)):
        t = first + i if problem.clipped.shape[0] > 1 else 0
        for j in range(problem.clipped.shape[1]):
            if problem.clipped[t, j] != 0:
                found &= ~(1 << i)
    return found


@numba.njit(cache=True)
def write_abreast(results, done, first, out):
    """Store the results of the lanes that are ``done`` as those of the texels from ``first`` on."""
    for i in range(COUNT):
        if done >> i & 1:
            for column in range(judge.COLUMNS):
                out.table[first + i, column] = results[column, i]
            out.status[first + i], out.model[first + i] = int(results[judge.COLUMNS, i]), judge.BOTH
            out.evaluations[first + i] = int(results[judge.COLUMNS + 1, i])
