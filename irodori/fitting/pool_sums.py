"""Normal-equation sums over texels that share β and μ, each with its own α [eq. 7].

With a texel's own α eliminated (variable projection), its sum of squares at one μ is a parabola in β,
A - 2 B β + C β²; the parabolas of several texels add, so a joint fit is one-dimensional in log μ like that of one
texel. A texel is packed as rows cosθ_i, gloss,
features, response, and weight, the inverse of a variance.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.fitting import judge
from irodori.fitting.texel_rows import (
    COSINE,
    F0,
    F1,
    F2,
    GLOSS,
    LOBE,
    RESPONSE,
    VARIANCE,
    WEIGHT,
    fill_lobe,
    folded,
    get,
    new_rows,
    vectors_of,
)
from irodori.fitting.texels import load_texel, pack_texel
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit, uncounted
from irodori.jit.vector_memory import spread
from irodori.reflection import lobes as lobe_kernels

PACKED = 7
_C, _G, _F0, _F1, _F2, _R, _W = range(PACKED)
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
_CHUNK = 1024  # texels that a thread takes at a time


class Packed(NamedTuple):
    """Texels that may take part in a pool.

    Parameters
    ----------
    blocks : (texels, PACKED, P) float64
        Their observations.
    used : (texels,) int32
        Observations with weight, 0 where a texel takes no part.
    sums : (texels, 4, nodes) float64
        Least sum of squares, B, C at the nodes; then A, the least of all sums, and its log μ.
    nodes : (nodes,) float64
        log μ, falling.
    """

    blocks: np.ndarray
    used: np.ndarray
    sums: np.ndarray
    nodes: np.ndarray


@njit(cache=True, error_model="numpy")
def _weights(rows, lobes, own, loaded, rules, out):
    """Fill inverse variances: the weights over what the texel's own residual says of them, outliers by Huber's loss."""
    (beta, mu), (used, floor) = own, loaded
    fill_lobe(rows, lobes, math.log(mu))
    squares, cc, cr, huber = 0.0, 0.0, 0.0, rules.huber
    for j in range(rows.shape[1]):
        wc = rows[WEIGHT, j] * rows[COSINE, j]
        cc += wc * rows[COSINE, j]
        cr += wc * (rows[RESPONSE, j] - beta * rows[LOBE, j])
    alpha = min(max(cr / cc if cc > 0.0 else 0.0, rules.low_alpha), rules.high_alpha)
    for j in range(rows.shape[1]):
        r = alpha * rows[COSINE, j] + beta * rows[LOBE, j] - rows[RESPONSE, j]
        w = rows[WEIGHT, j]
        if huber > 0.0:
            deviation = abs(r) / math.sqrt(rows[VARIANCE, j])
            w *= huber / deviation if deviation > huber else 1.0
        out[_W, j] = w
        squares += w * r * r
    scatter = max(squares / max(used - 3, 1), floor)
    for j in range(rows.shape[1]):
        out[_C, j], out[_G, j], out[_R, j] = rows[COSINE, j], rows[GLOSS, j], rows[RESPONSE, j]
        out[_F0, j], out[_F1, j], out[_F2, j] = rows[F0, j], rows[F1, j], rows[F2, j]
        out[_W, j] = out[_W, j] / scatter if scatter > 0.0 else 0.0


@uncounted(error_model="numpy")
def evaluate(block, lobes, log_mu):
    """Return A, B, C of one packed texel at one log μ."""
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


@njit(cache=True, error_model="numpy")
def lowest(a, b, c, low, high):
    """Return the least value of A - 2 B β + C β² within bounds of β, and its β."""
    beta = b / c if c > 0.0 else low
    beta = min(max(beta, low), high)
    return a + beta * (beta * c - 2.0 * b), beta


@njit(cache=True, error_model="numpy")
def together(blocks, lobes, log_mu, high):
    """Return the least sum of squares of several texels with one β and this μ, and the β."""
    a, b, c = 0.0, 0.0, 0.0
    for m in range(blocks.shape[0]):
        one = evaluate(blocks[m], lobes, log_mu)
        a += one[0]
        b += one[1]
        c += one[2]
    return lowest(a, b, c, 0.0, high)


@njit(cache=True, error_model="numpy")
def polish(blocks, lobes, left, right, high, steps):
    """Return log μ, β and the sum of squares of the minimum in a bracket: golden section, then a parabola."""
    x1, x2 = right - _GOLDEN * (right - left), left + _GOLDEN * (right - left)
    (f1, _), (f2, _) = together(blocks, lobes, x1, high), together(blocks, lobes, x2, high)
    for _ in range(steps):
        if f1 <= f2:
            right, x2, f2 = x2, x1, f1
            x1 = right - _GOLDEN * (right - left)
            f1, _b = together(blocks, lobes, x1, high)
        else:
            left, x1, f1 = x1, x2, f2
            x2 = left + _GOLDEN * (right - left)
            f2, _b = together(blocks, lobes, x2, high)
    fl, _ = together(blocks, lobes, left, high)
    slope, other = (f1 - fl) / (x1 - left), (f2 - f1) / (x2 - x1)
    bend = (other - slope) / (x2 - left)
    t = x1 if f1 <= f2 else x2
    if bend > 0.0:
        vertex = 0.5 * (left + x1 - slope / bend)
        if left < vertex < right and together(blocks, lobes, vertex, high)[0] <= min(f1, f2):
            t = vertex
    value, beta = together(blocks, lobes, t, high)
    return t, beta, value


@njit(cache=True, nogil=True, error_model="numpy")
def _pack_chunk(problem, rules, own, packed, first, last):
    rows, lobes = new_rows(problem.response.shape[1]), problem.lobes
    used, sums, nodes = packed.used, packed.sums, packed.nodes
    for t in range(first, last):
        pack_texel(t, problem, rows)
        loaded = load_texel(t, problem, rules, rows)
        used[t] = (rows[WEIGHT] > 0.0).sum()
        if loaded[0] <= judge.PARAMETERS or not math.isfinite(own[t, 0]):
            used[t] = 0
            continue
        _weights(rows, lobes, (own[t, 0], own[t, 1]), loaded, rules, packed.blocks[t])
        best = 0
        for i in range(nodes.size):
            a, sums[t, 1, i], sums[t, 2, i] = evaluate(packed.blocks[t], lobes, nodes[i])
            sums[t, 0, i] = lowest(a, sums[t, 1, i], sums[t, 2, i], 0.0, rules.high_beta)[0]
            sums[t, 3, 0] = a
            if sums[t, 0, i] < sums[t, 0, best]:
                best = i
        left, right = nodes[min(best + 1, nodes.size - 1)], nodes[max(best - 1, 0)]
        sums[t, 3, 2], _b, sums[t, 3, 1] = polish(packed.blocks[t : t + 1], lobes, left, right, rules.high_beta, 10)


def pack(problem, rules, own, packed: Packed) -> None:
    """Pack all texels and fill their sums at the nodes.

    Parameters
    ----------
    problem : Problem
    rules : Rules
    own : (texels, 2) float64
        β and μ of each texel's own best fit; NaN where it takes no part.
    packed : Packed
        Filled, but for the nodes.
    """
    run_chunks(_pack_chunk, len(problem.response), _CHUNK, problem, rules, own, packed)


@njit(cache=True, error_model="numpy", forceinline=True)
def _gloss_of(block, lobes, constant, j):
    """Return the gloss of an observation for β = 1, its slope along log μ, and along φ, squared and over its square."""
    f0, f1, f2 = block[_F0, j], block[_F1, j], block[_F2, j]
    value, slope, _ = lobe_kernels.derivatives(lobes, constant, f0, f1, f2)
    return block[_G, j] * value, block[_G, j] * slope, lobe_kernels.flank(lobes, constant, f0, f1, f2)[1]


@njit(cache=True, error_model="numpy")
def own_alpha(block, lobes, beta, log_mu, low, high):
    """Return a texel's α for given gloss and, along β and log μ, its slopes; then Σ w c²."""
    constant = lobe_kernels.constants(lobes, log_mu)
    cc, cr, cg, cs = 0.0, 0.0, 0.0, 0.0
    for j in range(block.shape[1]):
        wc = block[_W, j] * block[_C, j]
        g, slope, _ = _gloss_of(block, lobes, constant, j)
        cc += wc * block[_C, j]
        cr += wc * block[_R, j]
        cg += wc * g
        cs += wc * beta * slope
    return min(max((cr - beta * cg) / cc, low), high), -cg / cc, -cs / cc, cc


@njit(cache=True, error_model="numpy")
def spread_by_pose(blocks, lobes, beta, log_mu, rules):
    """Lower the weights by the variance that an error of the pose gives an observation of this gloss."""
    constant = lobe_kernels.constants(lobes, log_mu)
    for m in range(blocks.shape[0]):
        block = blocks[m]
        alpha = own_alpha(block, lobes, beta, log_mu, rules.low_alpha, rules.high_alpha)[0]
        for j in range(block.shape[1]):
            g, _, steepness = _gloss_of(block, lobes, constant, j)
            # As in `irodori.fitting.judge`: θ_i is off by one error, φ by 1/√2 of it.
            pose = 0.5 * steepness * (beta * g) ** 2 + alpha * alpha * (1.0 - block[_C, j] ** 2)
            block[_W, j] /= 1.0 + block[_W, j] * rules.pose_variance * pose


@njit(cache=True, error_model="numpy")
def _add(matrix, x, y, weight):
    matrix[0] += weight * x * x
    matrix[1] += weight * x * y
    matrix[2] += weight * y * y


@njit(cache=True, error_model="numpy")
def covariance(blocks, lobes, beta, log_mu, rules, excess):
    """Return the covariance of (β, log μ) as three numbers; infinite where they are not determined.

    Noise is independent from observation to observation. Drift of the light and errors of the pose are those of a
    photograph: all texels share them, and averaging over texels does not lower them.
    """
    constant = lobe_kernels.constants(lobes, log_mu)
    normal, middle = np.zeros(3), np.zeros(3)
    common = np.zeros((blocks.shape[2], 3, 2))
    for m in range(blocks.shape[0]):
        block = blocks[m]
        alpha, by_beta, by_mu, _ = own_alpha(block, lobes, beta, log_mu, rules.low_alpha, rules.high_alpha)
        for j in range(block.shape[1]):
            c, w = block[_C, j], block[_W, j]
            g, slope, steepness = _gloss_of(block, lobes, constant, j)
            jb, jt = g + c * by_beta, beta * slope + c * by_mu
            _add(normal, jb, jt, w)
            light = rules.model_error * (alpha * c + beta * g)
            # Below the peak a lobe falls with φ: the same error of a photograph moves all texels one way.
            flank = -math.sqrt(0.5 * rules.pose_variance * steepness) * beta * g
            tilt = math.sqrt(rules.pose_variance * max(1.0 - c * c, 0.0)) * alpha
            for i, size in enumerate((light, flank, tilt)):
                common[j, i, 0] += w * size * jb
                common[j, i, 1] += w * size * jt
    for i in range(3):
        middle[i] = excess * normal[i]
    for j in range(common.shape[0]):
        for i in range(3):
            _add(middle, common[j, i, 0], common[j, i, 1], 1.0)
    determinant = normal[0] * normal[2] - normal[1] ** 2
    if not determinant > 1e-10 * normal[0] * normal[2]:
        return np.inf, 0.0, np.inf
    i0, i1, i2 = normal[2] / determinant, -normal[1] / determinant, normal[0] / determinant
    bb = i0 * i0 * middle[0] + 2.0 * i0 * i1 * middle[1] + i1 * i1 * middle[2]
    bt = i0 * i1 * middle[0] + (i0 * i2 + i1 * i1) * middle[1] + i1 * i2 * middle[2]
    tt = i1 * i1 * middle[0] + 2.0 * i1 * i2 * middle[1] + i2 * i2 * middle[2]
    return bb + (rules.model_error * beta) ** 2, bt, tt


@njit(cache=True, error_model="numpy")
def residual(block, lobes, alpha, beta, log_mu):
    """Return Σ w r², Σ w ρ² and Σ w of a texel."""
    constant = lobe_kernels.constants(lobes, log_mu)
    squares, power, total = 0.0, 0.0, 0.0
    for j in range(block.shape[1]):
        w, r = block[_W, j], block[_R, j]
        off = alpha * block[_C, j] + beta * _gloss_of(block, lobes, constant, j)[0] - r
        squares += w * off * off
        power += w * r * r
        total += w
    return squares, power, total


@njit(cache=True, error_model="numpy")
def top_is_seen(blocks, lobes, log_mu):
    """Return whether an observation with weight lies where the lobe is high."""
    constant = lobe_kernels.constants(lobes, log_mu)
    for m in range(blocks.shape[0]):
        block = blocks[m]
        for j in range(block.shape[1]):
            share = lobe_kernels.flank(lobes, constant, block[_F0, j], block[_F1, j], block[_F2, j])[0]
            if block[_W, j] > 0.0 and block[_G, j] > 0.0 and share >= judge.SEEN:
                return True
    return False
