"""Normal-equation sums over texels that share β and μ, each with its own α [eq. 7].

With a texel's own α eliminated (variable projection), its sum of squares at one μ is a parabola in β,
A - 2 B β + C β²; the parabolas of several texels add, so a joint fit is one-dimensional in log μ like that of one
texel. A texel is packed as rows cosθ_i, F G / cosθ_r, φ², response, and weight, the inverse of a variance.
"""

import math

import numba
import numpy as np

from irodori.fitting.observations import load, telling
from irodori.fitting.texel_rows import (
    COSINE,
    FAST,
    GLOSS,
    LOBE,
    RESPONSE,
    SQUARE,
    VARIANCE,
    WEIGHT,
    exp_negative,
    pack_geometry,
)
from irodori.fitting.texels import new_block
from irodori.jit.native import njit

PACKED = 5
_C, _G, _Q, _R, _W = range(PACKED)
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
_CHUNK = 128


@njit(cache=True, error_model="numpy")
def _weights(block, beta, mu, used, floor, rules, out):
    """Fill inverse variances: the weights over what the texel's own residual says of them, outliers by Huber's loss."""
    squares, cc, cr, huber = 0.0, 0.0, 0.0, rules.huber
    for j in range(block.shape[1]):
        block[LOBE, j] = block[GLOSS, j] * exp_negative(-block[SQUARE, j] / (mu * mu))
        wc = block[WEIGHT, j] * block[COSINE, j]
        cc += wc * block[COSINE, j]
        cr += wc * (block[RESPONSE, j] - beta * block[LOBE, j])
    alpha = min(max(cr / cc if cc > 0.0 else 0.0, rules.low_alpha), rules.high_alpha)
    for j in range(block.shape[1]):
        lobe = block[LOBE, j]
        r = alpha * block[COSINE, j] + beta * lobe - block[RESPONSE, j]
        w = block[WEIGHT, j]
        if huber > 0.0:
            deviation = abs(r) / math.sqrt(block[VARIANCE, j])
            w *= huber / deviation if deviation > huber else 1.0
        out[_W, j] = w
        squares += w * r * r
    scatter = max(squares / max(used - 3, 1), floor)
    for j in range(block.shape[1]):
        out[_C, j], out[_G, j], out[_Q, j], out[_R, j] = (
            block[COSINE, j], block[GLOSS, j], block[SQUARE, j], block[RESPONSE, j]
        )  # fmt: skip
        out[_W, j] = out[_W, j] / scatter if scatter > 0.0 else 0.0


@njit(cache=True, fastmath=FAST, error_model="numpy")
def evaluate(block, log_mu):
    """Return A, B, C of one packed texel at one log μ."""
    factor = -math.exp(-2.0 * log_mu)
    cc, cr, rr, cg, rg, gg = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(block.shape[1]):
        c, r, w = block[_C, j], block[_R, j], block[_W, j]
        g = block[_G, j] * exp_negative(block[_Q, j] * factor)
        cc += w * c * c
        cr += w * c * r
        rr += w * r * r
        cg += w * c * g
        rg += w * r * g
        gg += w * g * g
    if not cc > 0.0:
        return 0.0, 0.0, 0.0
    return max(rr - cr * cr / cc, 0.0), rg - cr * cg / cc, max(gg - cg * cg / cc, 0.0)


@njit(cache=True, error_model="numpy")
def lowest(a, b, c, low, high):
    """Return the least value of A - 2 B β + C β² within bounds of β, and its β."""
    beta = b / c if c > 0.0 else low
    beta = min(max(beta, low), high)
    return a + beta * (beta * c - 2.0 * b), beta


@njit(cache=True, error_model="numpy")
def together(blocks, log_mu, high):
    """Return the least sum of squares of several texels with one β and this μ, and the β."""
    a, b, c = 0.0, 0.0, 0.0
    for m in range(blocks.shape[0]):
        one = evaluate(blocks[m], log_mu)
        a += one[0]
        b += one[1]
        c += one[2]
    return lowest(a, b, c, 0.0, high)


@njit(cache=True, error_model="numpy")
def polish(blocks, left, right, high, steps):
    """Return log μ, β and the sum of squares of the minimum in a bracket: golden section, then a parabola."""
    x1, x2 = right - _GOLDEN * (right - left), left + _GOLDEN * (right - left)
    (f1, _), (f2, _) = together(blocks, x1, high), together(blocks, x2, high)
    for _ in range(steps):
        if f1 <= f2:
            right, x2, f2 = x2, x1, f1
            x1 = right - _GOLDEN * (right - left)
            f1, _b = together(blocks, x1, high)
        else:
            left, x1, f1 = x1, x2, f2
            x2 = left + _GOLDEN * (right - left)
            f2, _b = together(blocks, x2, high)
    fl, _ = together(blocks, left, high)
    slope, other = (f1 - fl) / (x1 - left), (f2 - f1) / (x2 - x1)
    bend = (other - slope) / (x2 - left)
    t = x1 if f1 <= f2 else x2
    if bend > 0.0:
        vertex = 0.5 * (left + x1 - slope / bend)
        if left < vertex < right and together(blocks, vertex, high)[0] <= min(f1, f2):
            t = vertex
    value, beta = together(blocks, t, high)
    return t, beta, value


@njit(cache=True, error_model="numpy")
def _pack_chunk(problem, rules, own, nodes, packed, used, sums, first, last):
    block, angles, _ = new_block(problem)
    for t in range(first, last):
        n = problem.n[t if problem.n.size > 1 else 0]
        pack_geometry(problem.geometry[t if problem.geometry.shape[0] > 1 else 0], n, problem.k, angles, block)
        count, _lost, floor = load(problem.response[t], problem.weight[t], rules, block)
        used[t] = count
        count = telling(block, count)
        if count <= 3 or not math.isfinite(own[t, 0]):
            used[t] = 0
            continue
        _weights(block, own[t, 0], own[t, 1], count, floor, rules, packed[t])
        best = 0
        for i in range(nodes.size):
            a, sums[t, 1, i], sums[t, 2, i] = evaluate(packed[t], nodes[i])
            sums[t, 0, i] = lowest(a, sums[t, 1, i], sums[t, 2, i], 0.0, rules.high_beta)[0]
            sums[t, 3, 0] = a
            if sums[t, 0, i] < sums[t, 0, best]:
                best = i
        left, right = nodes[min(best + 1, nodes.size - 1)], nodes[max(best - 1, 0)]
        sums[t, 3, 2], _b, sums[t, 3, 1] = polish(packed[t : t + 1], left, right, rules.high_beta, 10)


@njit(cache=True, parallel=True, nogil=True)
def pack(problem, rules, own, nodes, packed, used, sums):
    """Pack all texels and fill their sums at the nodes.

    Parameters
    ----------
    problem : Problem
    rules : Rules
    own : (texels, 2) float64
        β and μ of each texel's own best fit; NaN where it takes no part.
    nodes : (nodes,) float64
        log μ, falling.
    packed : (texels, PACKED, P) float64
        Filled.
    used : (texels,) int32
        Filled: observations with weight, 0 where a texel takes no part.
    sums : (texels, 4, nodes) float64
        Filled: least sum of squares, B, C; then A, the least of all sums, and its log μ.
    """
    texels = problem.response.shape[0]
    for chunk in numba.prange((texels + _CHUNK - 1) // _CHUNK):
        _pack_chunk(problem, rules, own, nodes, packed, used, sums, chunk * _CHUNK, min(texels, (chunk + 1) * _CHUNK))


@njit(cache=True, error_model="numpy")
def own_alpha(block, beta, log_mu, low, high):
    """Return a texel's α for given gloss and, along β and log μ, its slopes; then Σ w c²."""
    factor = -math.exp(-2.0 * log_mu)
    cc, cr, cg, cs = 0.0, 0.0, 0.0, 0.0
    for j in range(block.shape[1]):
        x = block[_Q, j] * factor
        wc = block[_W, j] * block[_C, j]
        g = block[_G, j] * exp_negative(x)
        cc += wc * block[_C, j]
        cr += wc * block[_R, j]
        cg += wc * g
        cs += wc * (-2.0 * beta * x * g)
    return min(max((cr - beta * cg) / cc, low), high), -cg / cc, -cs / cc, cc


@njit(cache=True, error_model="numpy")
def spread_by_pose(blocks, beta, log_mu, rules):
    """Lower the weights by the variance that an error of the pose gives an observation of this gloss."""
    factor = -math.exp(-2.0 * log_mu)
    for m in range(blocks.shape[0]):
        block = blocks[m]
        alpha = own_alpha(block, beta, log_mu, rules.low_alpha, rules.high_alpha)[0]
        for j in range(block.shape[1]):
            g = beta * factor * block[_G, j] * exp_negative(block[_Q, j] * factor)
            # As in `irodori.fitting.judge`: θ_i is off by one error, φ by 1/√2 of it.
            pose = 2.0 * block[_Q, j] * g * g + alpha * alpha * (1.0 - block[_C, j] ** 2)
            block[_W, j] /= 1.0 + block[_W, j] * rules.pose_variance * pose


@njit(cache=True, error_model="numpy")
def _add(matrix, x, y, weight):
    matrix[0] += weight * x * x
    matrix[1] += weight * x * y
    matrix[2] += weight * y * y


@njit(cache=True, error_model="numpy")
def covariance(blocks, beta, log_mu, rules, excess):
    """Return the covariance of (β, log μ) as three numbers; infinite where they are not determined.

    Noise is independent from observation to observation. Drift of the light and errors of the pose are those of a
    photograph: all texels share them, and averaging over texels does not lower them.
    """
    factor = -math.exp(-2.0 * log_mu)
    normal, middle = np.zeros(3), np.zeros(3)
    common = np.zeros((blocks.shape[2], 3, 2))
    for m in range(blocks.shape[0]):
        block = blocks[m]
        alpha, by_beta, by_mu, _ = own_alpha(block, beta, log_mu, rules.low_alpha, rules.high_alpha)
        for j in range(block.shape[1]):
            c, w, x = block[_C, j], block[_W, j], block[_Q, j] * factor
            g = block[_G, j] * exp_negative(x)
            jb, jt = g + c * by_beta, -2.0 * beta * x * g + c * by_mu
            _add(normal, jb, jt, w)
            light = rules.model_error * (alpha * c + beta * g)
            flank = math.sqrt(2.0 * rules.pose_variance * block[_Q, j]) * beta * factor * g
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
def residual(block, alpha, beta, log_mu):
    """Return Σ w r², Σ w ρ² and Σ w of a texel."""
    factor = -math.exp(-2.0 * log_mu)
    squares, power, total = 0.0, 0.0, 0.0
    for j in range(block.shape[1]):
        w, r = block[_W, j], block[_R, j]
        off = alpha * block[_C, j] + beta * block[_G, j] * exp_negative(block[_Q, j] * factor) - r
        squares += w * off * off
        power += w * r * r
        total += w
    return squares, power, total


@njit(cache=True, error_model="numpy")
def top_is_seen(blocks, log_mu):
    """Return whether an observation with weight lies where the lobe is above exp(-2) of its peak."""
    limit = 2.0 * math.exp(2.0 * log_mu)
    for m in range(blocks.shape[0]):
        for j in range(blocks.shape[2]):
            if blocks[m, _W, j] > 0.0 and blocks[m, _G, j] > 0.0 and blocks[m, _Q, j] <= limit:
                return True
    return False
