"""Sums for the joint fit of texels that share β and μ but have separate α [eq. 7].

With the α of a texel eliminated (variable projection), its sum of squares at one μ is a parabola in β, A - 2 B β + C
β². The parabolas of several texels add, so the joint fit of any number of texels is one-dimensional in log μ, and its
cost is linear in the number of texels.

A texel is packed as `PACKED` rows over its observations: cosθ_i, gloss without the lobe, three features of the lobe,
response, weight (an inverse variance), and the side of the highlight: the derivative of φ with respect to a rotation of
the half vector in the plane of light and camera, -1 to 1.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.fitting.observations import Rules, load_one
from irodori.fitting.texel_rows import (
    COSINE,
    F0,
    GLOSS,
    RESPONSE,
    VARIANCE,
    WEIGHT,
    folded,
    get,
    highest,
    new_rows,
    put,
    vectors_of,
)
from irodori.fitting.texels import Problem, pack_texel
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit, uncounted
from irodori.jit.functions import select, upper_of
from irodori.jit.vector_memory import spread
from irodori.reflection import lobes as lobe_kernels
from irodori.reflection.lobes import Lobes

PACKED = 8
_C, _G, _F0, _F1, _F2, _R, _W, _SIDE = range(PACKED)
#: Columns of a texel's contribution to a fit of log β and log μ: the negative gradient of half its sum of squares; the
#: matrix of the normal equations; the sum of squares; α, its slopes along log β and log μ, and its inverse variance;
#: the largest share of the lobe's peak in the observations; Σ w ρ², Σ w, and the number of observations with weight.
(
    DOWN_BETA, DOWN_MU, BETA_BETA, BETA_MU, MU_MU, SQUARES, ALPHA, ALPHA_BY_BETA, ALPHA_BY_MU, ALPHA_WEIGHT, SEEN,
    POWER, TOTAL, USED,
) = range(14)  # fmt: skip
PARTS = 14
#: Errors that all texels of a photograph share.
LEVEL, HALF, INCIDENCE, VEIL = range(4)
SHARED = 4
_GLOSS, _SLOPE, _STEEP, _SHARE, _KNOWN = range(5)
_ROOM = 5
_TOP = 1e-9  # 2 sinφ sinθ_H below which a texel counts as at the centre of the highlight
_ALONE = 1e-9  # remaining share of a texel's weight below which it has no other observation
_OPEN = 1e-3  # relative determinant below which β and μ cannot be separated
_LEAST_EXCESS = 1e-3
_CHUNK = 2048  # texels that a thread takes at a time


class SearchedTexels(NamedTuple):
    """Packed texels, for the search for their common gloss.

    Parameters
    ----------
    blocks : (texels, PACKED, P) float64
        Packed observations of each texel.
    lobes : Lobes
        One lobe.
    rules : Rules
    """

    blocks: np.ndarray
    lobes: Lobes
    rules: Rules


@njit(cache=True, nogil=True, error_model="numpy")
def _pack_chunk(problem, rules, blocks, sides, first, last):
    rows = new_rows(problem.response.shape[1])
    for t in range(first, last):
        pack_texel(t, problem, rows)
        load_one(problem.response[t], problem.weight[t], problem.noise, rules, rows)
        for j in range(rows.shape[1]):
            blocks[t, _C, j], blocks[t, _G, j], blocks[t, _R, j] = rows[COSINE, j], rows[GLOSS, j], rows[RESPONSE, j]
            for i in range(3):
                blocks[t, _F0 + i, j] = rows[F0 + i, j]
            w = rows[WEIGHT, j]
            blocks[t, _W, j] = w if rules.known or not w > 0.0 else w / rows[VARIANCE, j]
        for j in range(problem.response.shape[1] if sides else 0):
            angles = problem.geometry[t, j]
            apart = 2.0 * math.sin(angles[2]) * math.sin(angles[3])
            # (V - L)·N = 2 sinθ_H times the component of N along the motion of the half vector.
            side = (math.cos(angles[1]) - math.cos(angles[0])) / apart if apart > _TOP else 0.0
            blocks[t, _SIDE, j] = min(max(side, -1.0), 1.0)


def pack(problem: Problem, rules: Rules, *, sides: bool) -> SearchedTexels:
    """Pack the texels of a problem, with inverse variances as weights.

    Parameters
    ----------
    problem : Problem
    rules : Rules
    sides : bool
        Whether to fill the side of the highlight, which only a fit of photographs' errors reads; otherwise it is 0.
    """
    blocks = np.zeros((len(problem.response), PACKED, problem.noise.shape[1]))
    run_chunks(_pack_chunk, len(blocks), _CHUNK, problem, rules, blocks, sides)
    return SearchedTexels(blocks, problem.lobes, rules)


@uncounted(error_model="numpy")
def _parabola(block, lobes, log_mu):
    """Return the coefficients A, B, C of the parabola of one packed texel at one log μ."""
    constant, zero = lobe_kernels.constants(lobes, log_mu), spread(0.0)
    cc, cr, rr, cg, rg, gg = zero, zero, zero, zero, zero, zero
    for j in range(vectors_of(block)):
        c, r, w = get(block, _C, j), get(block, _R, j), get(block, _W, j)
        value = lobe_kernels.value(lobes, constant, get(block, _F0, j), get(block, _F1, j), get(block, _F2, j))
        g = get(block, _G, j) * value
        wc, wr = w * c, w * r
        cc, cr, rr = cc + wc * c, cr + wc * r, rr + wr * r
        cg, rg, gg = cg + wc * g, rg + wr * g, gg + w * g * g
    c2, cr1, cg1 = folded(cc, 0.0), folded(cr, 0.0), folded(cg, 0.0)
    if not c2 > 0.0:
        return 0.0, 0.0, 0.0
    a, b, c = folded(rr, 0.0) - cr1 * cr1 / c2, folded(rg, 0.0) - cr1 * cg1 / c2, folded(gg, 0.0) - cg1 * cg1 / c2
    return max(a, 0.0), b, max(c, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_chunk(surface, nodes, out, first, last):
    for t in range(first, last):
        for i in range(nodes.size):
            a, b, c = _parabola(surface.blocks[t], surface.lobes, nodes[i])
            out[t, i, 0], out[t, i, 1], out[t, i, 2] = a, b, c


def parabolas(surface: SearchedTexels, nodes: np.ndarray) -> np.ndarray:
    """Return the coefficients A, B, C of every texel's parabola at each log μ in ``nodes``, (texels, nodes, 3)."""
    out = np.empty((len(surface.blocks), nodes.size, 3))
    run_chunks(_sum_chunk, len(out), _CHUNK, surface, nodes, out)
    return out


@uncounted(error_model="numpy")
def _take_part(block, lobes, rules, gloss, room, out):
    """Compute the contribution of a texel to a fit of log β and log μ, with pose errors in the weights.

    Fills ``out``, (PARTS,), and the rows of ``room`` with, for each observation, the gloss, its slope along log μ, the
    squared slope of its logarithm along φ, the share of the lobe's peak, and the weight.
    """
    constant, beta, zero = lobe_kernels.constants(lobes, gloss[1]), math.exp(gloss[0]), spread(0.0)
    for i in range(PARTS):
        out[i] = 0.0
    cc, cr = zero, zero
    for j in range(vectors_of(block)):
        f0, f1, f2, bare = get(block, _F0, j), get(block, _F1, j), get(block, _F2, j), get(block, _G, j)
        value, slope, _ = lobe_kernels.derivatives(lobes, constant, f0, f1, f2)
        share, steep = lobe_kernels.flank(lobes, constant, f0, f1, f2)
        g, c, w = beta * bare * value, get(block, _C, j), get(block, _W, j)
        put(room, _GLOSS, j, g)
        put(room, _SLOPE, j, beta * bare * slope)
        put(room, _STEEP, j, zero + steep)
        put(room, _SHARE, j, select((w > 0.0) & (bare > 0.0), share, 0.0))
        cc, cr = cc + w * c * c, cr + w * c * (get(block, _R, j) - g)
    power = folded(cc, 0.0)
    if not power > 0.0:
        out[ALPHA] = np.nan
        return
    alpha = min(max(folded(cr, 0.0) / power, rules.low_alpha), rules.high_alpha)
    cc, cr, cg, cs = zero, zero, zero, zero
    for j in range(vectors_of(block)):
        c, g, w = get(block, _C, j), get(room, _GLOSS, j), get(block, _W, j)
        pose = rules.phi_variance * get(room, _STEEP, j) * g * g
        w = w / (1.0 + w * (pose + rules.incidence_variance * alpha * alpha * (1.0 - c * c)))
        put(room, _KNOWN, j, w)
        wc = w * c
        cc, cr, cg, cs = cc + wc * c, cr + wc * get(block, _R, j), cg + wc * g, cs + wc * get(room, _SLOPE, j)
    power, of_gloss, of_slope = folded(cc, 0.0), folded(cg, 0.0), folded(cs, 0.0)
    alpha = min(max((folded(cr, 0.0) - of_gloss) / power, rules.low_alpha), rules.high_alpha)
    out[ALPHA], out[ALPHA_BY_BETA], out[ALPHA_BY_MU] = alpha, -of_gloss / power, -of_slope / power
    out[ALPHA_WEIGHT] = power
    down_beta, down_mu, beta_beta, beta_mu, mu_mu = zero, zero, zero, zero, zero
    squares, responses, weights, used, seen = zero, zero, zero, zero, zero
    for j in range(vectors_of(block)):
        c, g, w, r = get(block, _C, j), get(room, _GLOSS, j), get(room, _KNOWN, j), get(block, _R, j)
        left = r - alpha * c - g
        along_beta, along_mu = g - c * (of_gloss / power), get(room, _SLOPE, j) - c * (of_slope / power)
        wb, wm = w * along_beta, w * along_mu
        down_beta, down_mu, squares = down_beta + wb * left, down_mu + wm * left, squares + w * left * left
        beta_beta, beta_mu, mu_mu = beta_beta + wb * along_beta, beta_mu + wb * along_mu, mu_mu + wm * along_mu
        responses, weights, used = responses + w * r * r, weights + w, used + select(w > 0.0, 1.0, 0.0)
        seen = upper_of(seen, get(room, _SHARE, j))
    out[DOWN_BETA], out[DOWN_MU] = folded(down_beta, 0.0), folded(down_mu, 0.0)
    out[BETA_BETA], out[BETA_MU], out[MU_MU] = folded(beta_beta, 0.0), folded(beta_mu, 0.0), folded(mu_mu, 0.0)
    out[SQUARES], out[SEEN], out[POWER] = folded(squares, 0.0), highest(seen, 0.0), folded(responses, 0.0)
    out[TOTAL], out[USED] = folded(weights, 0.0), folded(used, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _part_chunk(surface, gloss, out, first, last):
    room = np.empty((_ROOM, surface.blocks.shape[2]))
    for t in range(first, last):
        _take_part(surface.blocks[t], surface.lobes, surface.rules, gloss[t], room, out[t])


def parts(surface: SearchedTexels, gloss: np.ndarray) -> np.ndarray:
    """Compute the contributions of all texels to a fit, each at its own log β and log μ.

    A texel without lit observations contributes nothing, and its α is NaN.

    Parameters
    ----------
    surface : SearchedTexels
    gloss : (texels, 2) float64
        log β and log μ of each texel.

    Returns
    -------
    (texels, PARTS) float64
        In the columns `DOWN_BETA` to `USED` of this module.
    """
    out, gloss = np.empty((len(surface.blocks), PARTS)), np.ascontiguousarray(gloss, dtype=np.float64)
    run_chunks(_part_chunk, len(out), _CHUNK, surface, gloss, out)
    return out


@njit(cache=True, error_model="numpy")
def _fill_changes(block, alpha, rules, veil, room, out):
    """Fill ``out``, (SHARED, P), with the change of each response by one expected size of the errors of its photograph.

    These are the lamp's level, the angle to the half vector, the angle of incidence, and veiling glare.
    """
    for j in range(block.shape[1]):
        c, g = block[_C, j], room[_GLOSS, j]
        out[LEVEL, j] = rules.model_error * (alpha * c + g)
        # A pose error moves the highlight of a photograph towards the texels on one side, away from the others.
        out[HALF, j] = block[_SIDE, j] * math.sqrt(rules.phi_variance * room[_STEEP, j]) * g
        out[INCIDENCE, j] = math.sqrt(rules.incidence_variance * max(1.0 - c * c, 0.0)) * alpha
        out[VEIL, j] = veil


@uncounted(error_model="numpy")
def _unknown_part(n00, n01, n11, varying):
    """Return V (1 + N V)⁻¹: the covariance of a texel's own log β and log μ, from the normal matrix N and prior V."""
    v00, v01, v11 = varying[0, 0], varying[0, 1], varying[1, 1]
    a00, a01 = 1.0 + n00 * v00 + n01 * v01, n00 * v01 + n01 * v11
    a10, a11 = n01 * v00 + n11 * v01, 1.0 + n01 * v01 + n11 * v11
    determinant = a00 * a11 - a01 * a10
    return (
        (v00 * a11 - v01 * a10) / determinant,
        (v01 * a00 - v00 * a01) / determinant,
        (v11 * a00 - v01 * a01) / determinant,
    )


@njit(cache=True, error_model="numpy")
def areas(surface, gloss):
    """Return the number of the photograph in which each texel shines most, (texels,) int64: neighbours share theirs."""
    blocks = surface.blocks
    out = np.zeros(blocks.shape[0], dtype=np.int64)
    part, room = np.empty(PARTS), np.empty((_ROOM, blocks.shape[2]))
    for t in range(blocks.shape[0]):
        _take_part(blocks[t], surface.lobes, surface.rules, gloss, room, part)
        out[t] = room[_SHARE].argmax()
    return out


class Differences(NamedTuple):
    """Normally distributed differences of the texels' log β and log μ from those of their paint.

    Parameters
    ----------
    own : (2, 2) float64
        Covariance of what each texel has to itself.
    common : (2, 2) float64
        Covariance of what the texels of an area have in common.
    area : (texels,) int64
        Area of each texel, from `areas`.
    """

    own: np.ndarray
    common: np.ndarray
    area: np.ndarray

    @property
    def of_mean(self) -> float:
        """Standard deviation of the mean difference of all texels in log β."""
        return float(np.sqrt(self.own[0, 0] / self.area.size + self.common[0, 0] / np.unique(self.area).size))

    def over(self, excess: float) -> "Differences":
        """Return the covariances in units of a variance of observations that is larger by a factor."""
        return self._replace(own=self.own / excess, common=self.common / excess)


class PhotographErrors(NamedTuple):
    """Errors that all texels of a photograph share.

    Parameters
    ----------
    sizes : (P, SHARED) float64
        Each in its expected size.
    veil : float
        Expected size of veiling glare, in the unit of responses.
    """

    sizes: np.ndarray
    veil: float


@njit(cache=True, error_model="numpy")
def _eliminate(rows, pull, columns, varying, normal, down):
    """Eliminate a difference of log β and log μ that some texels share from normal equations.

    Parameters
    ----------
    rows : (2, unknowns) float64
        Rows of the difference in the equations of its texels; those of log β and log μ themselves are the same. In
        place: what remains of the latter.
    pull : (2,) float64
        Negative gradient along the difference; in place as ``rows``.
    columns : (used,) int64
        Ascending numbers of the unknowns on which the texels depend.
    varying : (2, 2) float64
        Covariance of the difference.
    normal, down
        Output: the equations of all other unknowns, as in `add_equations`.
    """
    n00, n01, n11 = rows[0, 0], rows[0, 1], rows[1, 1]
    w00, w01, w11 = _unknown_part(n00, n01, n11, varying)
    if w00 == 0.0 and w11 == 0.0:
        return
    for n in range(columns.size):
        a = columns[n]
        first, second = w00 * rows[0, a] + w01 * rows[1, a], w01 * rows[0, a] + w11 * rows[1, a]
        down[a] -= first * pull[0] + second * pull[1]
        for b in columns[n:]:
            normal[a, b] -= first * rows[0, b] + second * rows[1, b]
    k00, k01 = 1.0 - n00 * w00 - n01 * w01, -n00 * w01 - n01 * w11
    k10, k11 = -n01 * w00 - n11 * w01, 1.0 - n01 * w01 - n11 * w11
    for a in columns:
        rows[0, a], rows[1, a] = k00 * rows[0, a] + k01 * rows[1, a], k10 * rows[0, a] + k11 * rows[1, a]
    pull[0], pull[1] = k00 * pull[0] + k01 * pull[1], k10 * pull[0] + k11 * pull[1]


@njit(cache=True, error_model="numpy")
def add_equations(surface, gloss, differences, photographs, normal, down):
    """Add a paint's normal equations of its log β and log μ and of the errors of photographs.

    The α of every texel and the differences of texels from their paint are eliminated.

    Parameters
    ----------
    surface : SearchedTexels
        Texels of one paint.
    gloss : (2,) float64
        log β and log μ.
    differences : Differences
        Their covariances may be zero.
    photographs : PhotographErrors
        Present errors of the photographs.
    normal : (2 + P SHARED, 2 + P SHARED) float64
        Output: the upper triangle is added to.
    down : (2 + P SHARED,) float64
        Output: the negative gradient of half the sum of squares is added to.
    """
    blocks, count, errors, area = surface.blocks, surface.blocks.shape[2], photographs.sizes, differences.area
    part, room, changes = np.empty(PARTS), np.empty((_ROOM, count)), np.empty((SHARED, count))
    # Products of the columns with cosθ_i, and with the slopes along log β and log μ: of a texel and of an area.
    along, own, pull = np.zeros(down.size), np.zeros((2, down.size)), np.empty(2)
    common, common_pull = np.zeros((2, down.size)), np.zeros(2)
    every, columns, used = np.arange(down.size), np.arange(down.size), np.empty(count, dtype=np.int64)
    order = np.argsort(area, kind="mergesort")
    for place in range(order.size):
        t = order[place]
        if place > 0 and area[t] != area[order[place - 1]]:
            _eliminate(common, common_pull, every, differences.common, normal, down)
            common[:], common_pull[:] = 0.0, 0.0
        _take_part(blocks[t], surface.lobes, surface.rules, gloss, room, part)
        if not part[ALPHA_WEIGHT] > 0.0:
            continue
        _fill_changes(blocks[t], part[ALPHA], surface.rules, photographs.veil, room, changes)
        many, cc, cr, along[:2], own[:, :2], pull[:] = 0, part[ALPHA_WEIGHT], 0.0, 0.0, 0.0, 0.0
        for j in range(count):
            w = room[_KNOWN, j]
            if not w > 0.0:
                continue
            used[many] = j
            c, left = w * blocks[t, _C, j], blocks[t, _R, j] - room[_GLOSS, j]
            for i in range(SHARED):
                column = 2 + j * SHARED + i
                columns[2 + many * SHARED + i] = column
                left -= errors[j, i] * changes[i, j]
                along[column] = c * changes[i, j]
            many += 1
            cr += c * left
            along[0] += c * room[_GLOSS, j]
            along[1] += c * room[_SLOPE, j]
        for n in range(many):
            j = used[n]
            first, w, g, s = 2 + j * SHARED, room[_KNOWN, j], room[_GLOSS, j], room[_SLOPE, j]
            left = blocks[t, _R, j] - g - cr / cc * blocks[t, _C, j]
            for i in range(SHARED):
                left -= errors[j, i] * changes[i, j]
            pull[0] += w * g * left
            pull[1] += w * s * left
            own[0, 0] += w * g * g
            own[0, 1] += w * g * s
            own[1, 1] += w * s * s
            for i in range(SHARED):
                change = w * changes[i, j]
                down[first + i] += change * left
                own[0, first + i] = change * g
                own[1, first + i] = change * s
                for k in range(i, SHARED):
                    normal[first + i, first + k] += change * changes[k, j]
        own[1, 0] = own[0, 1]
        present = columns[: 2 + many * SHARED]
        # With α eliminated, the unknowns of all photographs that see the texel depend on each other.
        for n in range(present.size):
            a = present[n]
            share = along[a] / cc
            own[0, a] -= share * along[0]
            own[1, a] -= share * along[1]
            if n >= 2:
                for b in present[n:]:
                    normal[a, b] -= share * along[b]
        for k in range(2):
            down[k] += pull[k]
            for b in present[k:]:
                normal[k, b] += own[k, b]
        _eliminate(own, pull, present, differences.own, normal, down)
        for a in present:
            common[0, a] += own[0, a]
            common[1, a] += own[1, a]
        common_pull += pull
    _eliminate(common, common_pull, every, differences.common, normal, down)


@njit(cache=True, error_model="numpy")
def without_errors(surface, gloss, photographs):
    """Return packed texels without the errors of their photographs, (texels, PACKED, P); see `add_equations`."""
    blocks, count, errors = surface.blocks.copy(), surface.blocks.shape[2], photographs.sizes
    part, room, changes = np.empty(PARTS), np.empty((_ROOM, count)), np.empty((SHARED, count))
    for t in range(blocks.shape[0]):
        _take_part(blocks[t], surface.lobes, surface.rules, gloss, room, part)
        if not part[ALPHA_WEIGHT] > 0.0:
            continue
        _fill_changes(blocks[t], part[ALPHA], surface.rules, photographs.veil, room, changes)
        for j in range(count):
            if blocks[t, _W, j] > 0.0:
                for i in range(SHARED):
                    blocks[t, _R, j] -= errors[j, i] * changes[i, j]
    return blocks


@njit(cache=True, error_model="numpy")
def _described(surface, gloss):
    """Return the responses that a common gloss and each texel's own α describe, (texels, P); 0 without an α."""
    blocks = surface.blocks
    out = np.zeros((blocks.shape[0], blocks.shape[2]))
    part, room = np.empty(PARTS), np.empty((_ROOM, blocks.shape[2]))
    for t in range(blocks.shape[0]):
        _take_part(blocks[t], surface.lobes, surface.rules, gloss, room, part)
        if part[ALPHA_WEIGHT] > 0.0:
            for j in range(blocks.shape[2]):
                out[t, j] = part[ALPHA] * blocks[t, _C, j] + room[_GLOSS, j]
    return out


def without_brightest(surface: SearchedTexels, gloss: np.ndarray, share: float) -> SearchedTexels:
    """Return packed texels without a share of their readings: those that a common gloss describes as the brightest."""
    level, blocks = _described(surface, np.ascontiguousarray(gloss)), surface.blocks.copy()
    told = blocks[:, _W] > 0.0
    blocks[:, _W][level > np.quantile(level[told], 1.0 - share)] = 0.0
    return surface._replace(blocks=blocks)


def without_photographs(surface: SearchedTexels, photographs: int | np.ndarray) -> SearchedTexels:
    """Return packed texels without the readings of photographs, given by a number from 0 or by a mask (P,)."""
    blocks = surface.blocks.copy()
    blocks[:, _W, photographs] = 0.0
    return surface._replace(blocks=blocks)


def left_out_gain(surface: SearchedTexels, kept: SearchedTexels, gloss: np.ndarray) -> tuple[float, float]:
    """Return by how much the readings that were left out are brighter than the kept ones and a gloss describe them.

    Parameters
    ----------
    surface, kept : SearchedTexels
        Packed texels with all readings, and the same without some.
    gloss : (2,) float64
        log β and log μ fitted to the kept readings.

    Returns
    -------
    gain, error : float
        Relative, below 0 if they are darker, and its standard error by the noise; 0 and infinity without any.
    """
    level = _described(kept, np.ascontiguousarray(gloss))
    weight = np.where(kept.blocks[:, _W] > 0.0, 0.0, surface.blocks[:, _W])
    power = float(np.sum(weight * level**2))
    if not power > 0.0:
        return 0.0, math.inf
    return float(np.sum(weight * level * surface.blocks[:, _R])) / power - 1.0, power**-0.5


@njit(cache=True, error_model="numpy")
def _without_each(surface, gloss):
    """Return gradient and normal matrix of log β and log μ without each photograph, (P, 5), with each α re-fitted."""
    blocks, rules = surface.blocks, surface.rules
    out, part, room = np.zeros((blocks.shape[2], 5)), np.empty(PARTS), np.empty((_ROOM, blocks.shape[2]))
    own, total = np.empty(9), np.empty(9)
    for t in range(blocks.shape[0]):
        _take_part(blocks[t], surface.lobes, rules, gloss, room, part)
        if not part[ALPHA_WEIGHT] > 0.0:
            continue
        total[:] = 0.0
        for j in range(blocks.shape[2]):
            _outer(blocks[t], part[ALPHA], room, j, own)
            total += own
        for j in range(blocks.shape[2]):
            _outer(blocks[t], part[ALPHA], room, j, own)
            cc, cb, cm, cr, br, mr, bb, bm, mm = total - own
            if cc > _ALONE * total[0]:  # otherwise the texel has no other observation
                out[j, 0] += br - cr * cb / cc
                out[j, 1] += mr - cr * cm / cc
                out[j, 2] += bb - cb * cb / cc
                out[j, 3] += bm - cb * cm / cc
                out[j, 4] += mm - cm * cm / cc
    return out


@njit(cache=True, error_model="numpy")
def _outer(block, alpha, room, j, out):
    """Fill the weighted products of cosθ_i, the slopes along log β and log μ, and the residual of one observation."""
    c, g, s, w = block[_C, j], room[_GLOSS, j], room[_SLOPE, j], room[_KNOWN, j]
    r = block[_R, j] - alpha * c - g
    out[0], out[1], out[2], out[3] = w * c * c, w * c * g, w * c * s, w * c * r
    out[4], out[5], out[6], out[7], out[8] = w * g * r, w * s * r, w * g * g, w * g * s, w * s * s


def without_each(surface: SearchedTexels, gloss: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Estimate the change of log β and log μ if each photograph in turn is left out (jackknife).

    The change is that of one Gauss-Newton step from the common gloss.

    Parameters
    ----------
    surface : SearchedTexels
    gloss : (2,) float
        log β and log μ fitted to all photographs.

    Returns
    -------
    moved : (P, 2) float64
        Change of log β and log μ; 0 where it is not determined.
    told : (P,) bool
        Whether the remaining photographs determine β and μ.
    """
    sums = _without_each(surface, np.ascontiguousarray(gloss, dtype=np.float64))
    down0, down1, n00, n01, n11 = sums.T
    determinant = n00 * n11 - n01 * n01
    told = determinant > _OPEN * np.maximum(n00 * n11, np.finfo(float).tiny)
    told &= determinant > _OPEN * determinant.max(initial=0.0)
    regular = np.where(told, determinant, 1.0)
    moved = np.column_stack([(n11 * down0 - n01 * down1) / regular, (n00 * down1 - n01 * down0) / regular])
    return np.where(told[:, None], moved, 0.0), told


@njit(cache=True, error_model="numpy")
def own_shares(part, precision, excess, each):
    """Sum the residual squares of texels that have their own gloss, with a normal prior about the common gloss.

    Parameters
    ----------
    part : (texels, PARTS) float64
        Contributions of the texels at the common gloss, from `parts`.
    precision : (2, 2) float64
        Inverse covariance of the texels' log β and log μ about the common ones.
    excess : float
        Factor on the variances of the observations.
    each : (texels, 2) float64
        Output: sum of squares and effective degrees of freedom of each texel.

    Returns
    -------
    squares, free : float
        Sums of ``each``.
    second : (2, 2) float64
        Mean second moment of the texels' log β and log μ about the common ones.
    """
    p00, p01, p11 = precision[0, 0], precision[0, 1], precision[1, 1]
    second, squares, free = np.zeros((2, 2)), 0.0, 0.0
    for t in range(part.shape[0]):
        n00, n01, n11 = part[t, BETA_BETA], part[t, BETA_MU], part[t, MU_MU]
        g0, g1 = part[t, DOWN_BETA], part[t, DOWN_MU]
        a00, a01, a11 = n00 / excess + p00, n01 / excess + p01, n11 / excess + p11
        determinant = a00 * a11 - a01 * a01
        a00, a01, a11 = a11 / determinant, -a01 / determinant, a00 / determinant
        m0, m1 = (a00 * g0 + a01 * g1) / excess, (a01 * g0 + a11 * g1) / excess
        gained = 2.0 * (g0 * m0 + g1 * m1) - (n00 * m0 * m0 + 2.0 * n01 * m0 * m1 + n11 * m1 * m1)
        each[t, 0] = part[t, SQUARES] - gained
        each[t, 1] = part[t, USED] - 1.0 - (a00 * n00 + 2.0 * a01 * n01 + a11 * n11) / excess
        squares += each[t, 0]
        free += each[t, 1]
        second[0, 0] += a00 + m0 * m0
        second[0, 1] += a01 + m0 * m1
        second[1, 1] += a11 + m1 * m1
    second[1, 0] = second[0, 1]
    return squares, free, second / part.shape[0]


@njit(cache=True, error_model="numpy")
def varying(part, start, least, rounds):
    """Estimate, by maximum likelihood, the covariance of the texels' log β and log μ, and the excess variance.

    If the gloss of a texel differs by δ from the common one, its gradient is normally distributed with mean N δ and
    covariance N times the excess, where N is its normal matrix. The method is expectation maximisation.

    Parameters
    ----------
    part : (texels, PARTS) float64
        Contributions of the texels at the common gloss, from `parts`.
    start : float
        Initial variance of log β and of log μ.
    least : float
        Variance that is added in every round to keep the covariance regular.
    rounds : int
        Largest number of rounds.

    Returns
    -------
    covariance : (2, 2) float64
    excess : float
        Factor on the variances of the observations. It is below 1 where the expected errors of photographs are larger
        than the actual ones.
    """
    covariance, precision, each = np.zeros((2, 2)), np.zeros((2, 2)), np.empty((part.shape[0], 2))
    covariance[0, 0], covariance[1, 1], excess = start, start, 1.0
    for _ in range(rounds):
        determinant = covariance[0, 0] * covariance[1, 1] - covariance[0, 1] ** 2
        precision[0, 0], precision[1, 1] = covariance[1, 1] / determinant, covariance[0, 0] / determinant
        precision[0, 1] = precision[1, 0] = -covariance[0, 1] / determinant
        squares, free, new = own_shares(part, precision, excess, each)
        excess = max(squares / max(free - 2.0, 1.0), _LEAST_EXCESS)
        new[0, 0] += least
        new[1, 1] += least
        change, largest = 0.0, 0.0
        for i in range(2):
            for j in range(2):
                change, largest = max(change, abs(new[i, j] - covariance[i, j])), max(largest, abs(new[i, j]))
                covariance[i, j] = new[i, j]
        if change < 1e-3 * largest:
            break
    return covariance, excess
