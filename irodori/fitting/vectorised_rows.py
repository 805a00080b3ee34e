"""Observations of eight texels at once: geometry, responses, variances, weights.

Every step is that of `irodori.fitting.texel_rows` and `irodori.fitting.observations` for one texel.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.fitting import judge
from irodori.fitting.observations import ENOUGH, LARGE, LEAST_VARIANCE, TINY, is_same
from irodori.fitting.texel_rows import COSINE, GLOSS, SPOILED, SQUARE, attenuation, cosine_of
from irodori.jit.lanes import COUNT, bits, exponential, load, magnitude, negated, select, spread, store, upper_of
from irodori.jit.native import aligned, njit, uncounted
from irodori.reflection.fresnel import fresnel

#: Rows of lanes: cosθ_i, F G / cosθ_r, φ², what is not a number, response, weight, variance, weight times cosine and
#: times response, lobe, and the weights of the texels before.
(
    L_COSINE, L_GLOSS, L_SQUARE, L_SPOILED, L_RESPONSE, L_WEIGHT, L_VARIANCE, L_WEIGHTED_COSINE, L_WEIGHTED_RESPONSE,
    L_LOBE, L_BEFORE,
) = range(11)  # fmt: skip
L_ROWS = 11
GROUP = 6  # nodes that are summed together
L_SUMS = 8  # at a node, see `irodori.fitting.vectorised_scan`


class Abreast(NamedTuple):
    """Buffers of one thread for eight texels."""

    rows: np.ndarray  # (L_ROWS * J * COUNT,)
    sums: np.ndarray  # (L_SUMS * nodes * COUNT,), nodes padded to a multiple of GROUP
    results: np.ndarray  # (judge.COLUMNS + 2, COUNT): the columns, status, evaluations


@njit(cache=True)
def new_abreast(captures, nodes):
    """Return buffers for so many photographs and nodes of the scan."""
    groups = (nodes + GROUP - 1) // GROUP
    rows = aligned(L_ROWS * captures * COUNT)
    for j in range(captures * COUNT):
        rows[L_BEFORE * captures * COUNT + j] = np.nan
    return Abreast(rows, aligned(L_SUMS * groups * GROUP * COUNT), np.zeros((judge.COLUMNS + 2, COUNT)))


@njit(cache=True, inline="always")
def row_place(row, j, count):
    """Return the flat place of item j of a row of so many items of `COUNT` lanes."""
    return (row * count + j) * COUNT


@uncounted()
def spread_geometry(common, rows, captures):
    """Fill the rows of the geometry that all texels share."""
    for j in range(captures):
        store(rows, row_place(L_COSINE, j, captures), spread(common[COSINE, j]))
        store(rows, row_place(L_GLOSS, j, captures), spread(common[GLOSS, j]))
        store(rows, row_place(L_SQUARE, j, captures), spread(common[SQUARE, j]))
        store(rows, row_place(L_SPOILED, j, captures), spread(common[SPOILED, j]))


@uncounted(error_model="numpy")
def pack_own(problem, first, last, rows):
    """Fill the rows of the geometries of eight texels; the last stands for those beyond the end."""
    captures, many = problem.geometry.shape[1], problem.n.size > 1
    for i in range(COUNT):
        t = min(first + i, last - 1)
        for j in range(captures):
            for angle in range(4):
                rows[row_place(L_RESPONSE + angle, j, captures) + i] = problem.geometry[t, j, angle]
        rows[row_place(L_LOBE, 0, captures) + i] = problem.n[t if many else 0]
    n = load(rows, row_place(L_LOBE, 0, captures))
    for j in range(captures):
        theta_i, theta_r = (
            load(rows, row_place(L_RESPONSE, j, captures)),
            load(rows, row_place(L_RESPONSE + 1, j, captures)),
        )
        theta_h, phi = (
            load(rows, row_place(L_RESPONSE + 2, j, captures)),
            load(rows, row_place(L_RESPONSE + 3, j, captures)),
        )
        store(rows, row_place(L_SPOILED, j, captures), 0.0 * (theta_i + theta_r + (theta_h + phi)))
        bounded = select(magnitude(phi) < math.pi, phi, math.pi)
        store(rows, row_place(L_SQUARE, j, captures), bounded * bounded)
        cos_i, cos_r, cos_h = cosine_of(theta_i), cosine_of(theta_r), cosine_of(theta_h)
        carried = attenuation(cos_i, cos_r, cos_h, cosine_of(phi))
        store(rows, row_place(L_GLOSS, j, captures), fresnel(cos_h, n, problem.k) * carried)
        store(rows, row_place(L_COSINE, j, captures), select((cos_i > 0.0) & (cos_r > 0.0), cos_i, 0.0))


@uncounted(error_model="numpy")
def load_rows(problem, rules, first, last, rows):
    """Fill responses, variances and weights; return the observations used, the floor, and which lanes are ordinary."""
    captures = problem.response.shape[1]
    if first + COUNT <= last:
        for j in range(captures):
            for i in range(COUNT):
                rows[row_place(L_RESPONSE, j, captures) + i] = problem.response[first + i, j]
            for i in range(COUNT):
                rows[row_place(L_WEIGHT, j, captures) + i] = problem.weight[first + i, j]
    else:  # the last texel stands for those beyond the end
        for i in range(COUNT):
            t = min(first + i, last - 1)
            for j in range(captures):
                rows[row_place(L_RESPONSE, j, captures) + i] = problem.response[t, j]
                rows[row_place(L_WEIGHT, j, captures) + i] = problem.weight[t, j]
    used, total, power, largest = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for j in range(captures):
        given, trust = load(rows, row_place(L_RESPONSE, j, captures)), load(rows, row_place(L_WEIGHT, j, captures))
        fine = (
            (magnitude(given + load(rows, row_place(L_SPOILED, j, captures))) < np.inf)
            & (trust > 0.0)
            & (trust < np.inf)
        )
        r, t = select(fine, given, 0.0), select(fine, trust, 0.0)
        store(rows, row_place(L_RESPONSE, j, captures), r)
        store(rows, row_place(L_WEIGHT, j, captures), t)
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
        r, w = load(rows, row_place(L_RESPONSE, j, captures)), load(rows, row_place(L_WEIGHT, j, captures))
        v = common + problem.noise[0, j] + problem.noise[1, j] * upper_of(r, 0.0) + relative * r * r
        store(rows, row_place(L_VARIANCE, j, captures), v)
        if rules.weighted:
            w = w / v
            store(rows, row_place(L_WEIGHT, j, captures), w)
        floor = floor + w * v
    return used, floor / upper_of(used, 1.0), ordinary


@uncounted(error_model="numpy")
def tell(rows, captures):
    """Return which lanes have `ENOUGH` geometries that differ and carry light."""
    nothing, count = spread(np.nan), spread(0.0)
    first, second, third = (nothing, nothing, nothing), (nothing, nothing, nothing), (nothing, nothing, nothing)
    for j in range(captures):
        now = (
            load(rows, row_place(L_COSINE, j, captures)),
            load(rows, row_place(L_SQUARE, j, captures)),
            load(rows, row_place(L_GLOSS, j, captures)),
        )
        known = is_same(now, first) | is_same(now, second) | is_same(now, third)
        lit = (now[0] > 0.0) | (now[2] > 0.0)
        new = (load(rows, row_place(L_WEIGHT, j, captures)) > 0.0) & lit & negated(known)
        third = _replaced(new & (count == 2.0), now, third)
        second = _replaced(new & (count == 1.0), now, second)
        first = _replaced(new & (count == 0.0), now, first)
        count = select(new, count + 1.0, count)
        if bits(count >= float(ENOUGH)) == 255:
            break
    return count >= float(ENOUGH)


@njit(cache=True, inline="always")
def _replaced(mask, now, before):
    return select(mask, now[0], before[0]), select(mask, now[1], before[1]), select(mask, now[2], before[2])


@uncounted(error_model="numpy")
def expect(problem, rules, rows, a, b, log_mu, noisy):
    """Weigh the observations of noisy lanes as `irodori.fitting.observations.expect` does."""
    captures = problem.response.shape[1]
    factor, relative = -exponential(-2.0 * log_mu), rules.model_error * rules.model_error
    for j in range(captures):
        r, v = load(rows, row_place(L_RESPONSE, j, captures)), load(rows, row_place(L_VARIANCE, j, captures))
        lobe = load(rows, row_place(L_GLOSS, j, captures)) * exponential(
            load(rows, row_place(L_SQUARE, j, captures)) * factor
        )
        fitted = a * load(rows, row_place(L_COSINE, j, captures)) + b * lobe
        u = v + problem.noise[1, j] * (fitted - upper_of(r, 0.0)) + relative * (fitted * fitted - r * r)
        u = select(noisy, upper_of(u, LEAST_VARIANCE * v), v)
        store(rows, row_place(L_VARIANCE, j, captures), u)
        w = load(rows, row_place(L_WEIGHT, j, captures))
        store(rows, row_place(L_WEIGHT, j, captures), select(noisy, w * v / u, w))


@uncounted(error_model="numpy")
def weigh_rows(rows, captures):
    """Fill the weighted rows; return Σ w c², Σ w c ρ, Σ w ρ², Σ w, and whether weights differ from those before."""
    cc, cr, rr, total = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    same = total == total
    for j in range(captures):
        w, c = load(rows, row_place(L_WEIGHT, j, captures)), load(rows, row_place(L_COSINE, j, captures))
        r, before = load(rows, row_place(L_RESPONSE, j, captures)), load(rows, row_place(L_BEFORE, j, captures))
        same = same & (w == before)
        store(rows, row_place(L_BEFORE, j, captures), w)
        wc, wr = w * c, w * r
        store(rows, row_place(L_WEIGHTED_COSINE, j, captures), wc)
        store(rows, row_place(L_WEIGHTED_RESPONSE, j, captures), wr)
        cc = cc + wc * c
        cr = cr + wc * r
        rr = rr + wr * r
        total = total + w
    return (cc, cr, rr, total), bits(same) != 255
