"""Compiled loop over texels that calls NLopt's C functions with a compiled objective.

NLopt sees the unknowns (α / scale, β / scale, log μ), so that one step fits all three, and starts from the best
place of the scan. A texel's data is its block behind four header words: length of a row, scales of α, of β, and of the
objective.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic

from irodori.fitting import judge
from irodori.fitting.huber import robust
from irodori.fitting.observations import expect, load, telling, weigh
from irodori.fitting.shared_geometry import padded_nodes
from irodori.fitting.texel_rows import (
    CONSTANT,
    COSINE,
    FAST,
    GLOSS,
    RESPONSE,
    ROWS,
    SLOPE,
    SQUARE,
    WEIGHT,
    exp_negative,
    pack_geometry,
    padded,
)
from irodori.fitting.texels import clipped_of, conclude, doubt, give_up, is_noisy, write
from irodori.fitting.varpro import SUMS, find_intervals, pair_at, scan_own, value_nodes
from irodori.jit.native import c_function, cfunc, njit

HEADER = 4
PARAMETERS = 3
_CHUNK = 64  # texels that share one optimiser object
_PRECISION = 1e6  # of the scaled objective: NLopt's L-BFGS stops at an absolute gradient of 1e-8

_P, _F, _I = types.uintp, types.float64, types.intc
nlopt_create = c_function(_P, _I, types.uint32)
nlopt_destroy = c_function(types.void, _P)
nlopt_set_pointer = c_function(_I, _P, _P)  # lower bounds, upper bounds
nlopt_set_objective = c_function(_I, _P, _P, _P)
nlopt_set_number = c_function(_I, _P, _F)  # relative tolerance
nlopt_set_count = c_function(_I, _P, _I)  # evaluations
nlopt_optimize = c_function(_I, _P, _P, _P)
nlopt_get_evaluations = c_function(_I, _P)


@intrinsic
def _as_floats(typingctx, address):
    """Return an integer address as a pointer to float64."""
    signature = types.CPointer(types.float64)(types.uintp)

    def codegen(context, builder, signature, values):
        return builder.inttoptr(values[0], context.get_value_type(signature.return_type))

    return signature, codegen


@njit(cache=True, fastmath=FAST, error_model="numpy")
def objective(alpha, beta, log_mu, block):
    """Return the weighted sum of squares of equation (7) and its derivatives by α, β, log μ."""
    factor = -math.exp(-2.0 * log_mu)
    total, ga, gb, gt = 0.0, 0.0, 0.0, 0.0
    for j in range(block.shape[1]):
        x = block[SQUARE, j] * factor
        g = block[GLOSS, j] * exp_negative(x)
        residual = alpha * block[COSINE, j] + beta * g - block[RESPONSE, j]
        weighted = block[WEIGHT, j] * residual
        total += weighted * residual
        ga += weighted * block[COSINE, j]
        gb += weighted * g
        gt += weighted * g * x
    return total, 2.0 * ga, 2.0 * gb, -4.0 * beta * gt


@cfunc(
    types.float64(types.uint32, types.CPointer(types.float64), types.uintp, types.uintp),
    cache=True,
    error_model="numpy",
)
def nlopt_objective(count, x, gradient_address, data_address):
    """Objective in NLopt's C signature, with its gradient where NLopt asks for one."""
    header = numba.carray(_as_floats(data_address), (HEADER,))
    row, scale_a, scale_b, scale = int(header[0]), header[1], header[2], header[3]
    block = numba.carray(_as_floats(data_address), (HEADER + ROWS * row,))[HEADER:].reshape((ROWS, row))
    value, ga, gb, gt = objective(x[0] * scale_a, x[1] * scale_b, x[2], block)
    if gradient_address != 0:
        gradient = numba.carray(_as_floats(gradient_address), (3,))
        gradient[0], gradient[1], gradient[2] = scale * ga * scale_a, scale * gb * scale_b, scale * gt
    return scale * value


@njit(cache=True, error_model="numpy")
def set_scales(data, block, power_sum, alpha, beta):
    """Store scales: of α and β, their start or a hundredth of the largest response; of the objective.

    The objective is relative to the power of the responses, so that NLopt stops at the same place whatever the unit
    of light.
    """
    peak, peak_gloss = 1e-300, 1e-300
    for j in range(block.shape[1]):
        peak = max(peak, abs(block[RESPONSE, j]))
        peak_gloss = max(peak_gloss, block[GLOSS, j])
    data[3] = _PRECISION / max(power_sum, 1e-300)
    data[1] = max(alpha, 0.01 * peak)
    data[2] = max(beta, 0.01 * peak / peak_gloss)


class Nlopt(NamedTuple):
    """Addresses of NLopt's C functions, and how to run them."""

    create: int
    destroy: int
    set_lower_bounds: int
    set_upper_bounds: int
    set_min_objective: int
    set_xtol_rel: int
    set_maxeval: int
    optimize: int
    get_numevals: int
    objective: int  # address of `nlopt_objective`
    algorithm: int
    xtol_rel: float
    max_evaluations: int


@njit(cache=True)
def new_data(problem):
    """Return the data of a texel, its block within, scratch for angles, and for the sums of the scan."""
    p = padded(problem.response.shape[1])
    data = np.zeros(HEADER + ROWS * p)
    data[0] = p
    block = data[HEADER:].reshape((ROWS, p))
    block[CONSTANT], block[SLOPE] = problem.noise[0], problem.noise[1]
    return data, block, np.zeros((4, p)), np.zeros((SUMS, padded_nodes(problem.nodes.size)))


@njit(cache=True)
def _new_optimiser(nlopt, data):
    optimiser = nlopt_create(nlopt.create, nlopt.algorithm, np.uint32(PARAMETERS))
    nlopt_set_objective(nlopt.set_min_objective, optimiser, nlopt.objective, np.uintp(data.ctypes.data))
    nlopt_set_number(nlopt.set_xtol_rel, optimiser, nlopt.xtol_rel)
    nlopt_set_count(nlopt.set_maxeval, optimiser, nlopt.max_evaluations)
    return optimiser


@njit(cache=True)
def _polish(nlopt, optimiser, data, start, rules, vectors):
    """Run NLopt from a start; return its code, its evaluations and the α, β, log μ that it found."""
    x, low, high, value = vectors
    low[0], high[0], x[0] = rules.low_alpha / data[1], rules.high_alpha / data[1], start[0] / data[1]
    low[1], high[1], x[1] = rules.low_beta / data[2], rules.high_beta / data[2], start[1] / data[2]
    low[2], high[2], x[2] = rules.low_log_mu, rules.high_log_mu, start[2]
    for p in range(PARAMETERS):
        x[p] = min(max(x[p], low[p]), high[p])
    nlopt_set_pointer(nlopt.set_lower_bounds, optimiser, np.uintp(low.ctypes.data))
    nlopt_set_pointer(nlopt.set_upper_bounds, optimiser, np.uintp(high.ctypes.data))
    code = nlopt_optimize(nlopt.optimize, optimiser, np.uintp(x.ctypes.data), np.uintp(value.ctypes.data))
    evaluations = nlopt_get_evaluations(nlopt.get_numevals, optimiser)
    return code, evaluations, x[0] * data[1], x[1] * data[2], x[2]


@njit(cache=True, error_model="numpy")
def start_of(block, problem, rules, used, floor, sums):
    """Return the sums without lobe, and the best α, β, log μ that the scan knows with their sum of squares."""
    start = _scanned(block, problem, rules, sums)
    if is_noisy(used, floor, start[0], rules):
        expect(block, start[1], start[2], start[3], rules)
        start = _scanned(block, problem, rules, sums)
    return start


@njit(cache=True, error_model="numpy")
def _scanned(block, problem, rules, sums):
    box = (rules.low_alpha, rules.high_alpha, rules.low_beta, rules.high_beta)
    fixed = weigh(block)
    scan_own(block, problem.nodes, problem.steepness, problem.chains, sums)
    value_nodes(fixed, sums, box)
    log_mu = problem.nodes[find_intervals(problem.nodes, sums)]
    a, b, value = pair_at(block, fixed, box, log_mu)
    likely = 0
    for i in range(problem.nodes.size - 1):
        if sums[8, i] < sums[8, likely]:
            likely = i
    if sums[8, likely] < np.inf:
        between = pair_at(block, fixed, box, sums[9, likely])
        if between[2] <= value:
            return fixed, between[0], between[1], sums[9, likely], between[2]
    return fixed, a, b, log_mu, value


@njit(cache=True, error_model="numpy")
def load_own(t, problem, rules, block, angles):
    """Fill a texel's block."""
    n = problem.n[t if problem.n.size > 1 else 0]
    pack_geometry(problem.geometry[t if problem.geometry.shape[0] > 1 else 0], n, problem.k, angles, block)
    used, lost, floor = load(problem.response[t], problem.weight[t], rules, block)
    return telling(block, used), lost, floor


@njit(cache=True, error_model="numpy")
def finish(t, block, fixed, found, used, floor, evaluations, problem, rules, sums, out):
    """Judge α, β, log μ that a solver found, after reweighting if that is asked for, and write the texel."""
    a, b, log_mu = found
    settled = True
    if rules.huber > 0.0:
        fixed, a, b, log_mu, count, settled = robust(block, problem.nodes, rules)
        scan_own(block, problem.nodes, problem.steepness, problem.chains, sums)
        evaluations += count + problem.nodes.size
    clipped = clipped_of(t, problem)
    verdict = conclude(block, fixed, a, b, log_mu, used, floor, clipped, problem.nodes, sums, rules)
    write(out, t, verdict, fixed, evaluations)
    if not settled:
        doubt(out, t)


@njit(cache=True, error_model="numpy")
def _fit_chunk(nlopt, problem, rules, out, first, last):
    data, block, angles, sums = new_data(problem)
    vectors = (np.empty(3), np.empty(3), np.empty(3), np.empty(1))
    optimiser = _new_optimiser(nlopt, data)
    for t in range(first, last):
        used, lost, floor = load_own(t, problem, rules, block, angles)
        if used <= judge.PARAMETERS:
            give_up(t, used, lost, problem, out)
            continue
        fixed, a, b, log_mu, squares = start_of(block, problem, rules, used, floor, sums)
        set_scales(data, block, fixed[2], a, b)
        code, count, pa, pb, pt = _polish(nlopt, optimiser, data, (a, b, log_mu), rules, vectors)
        if objective(pa, pb, pt, block)[0] <= squares:
            a, b, log_mu = pa, pb, pt
        out.result[t] = code
        evaluations = count + problem.nodes.size
        finish(t, block, fixed, (a, b, log_mu), used, floor, evaluations, problem, rules, sums, out)
    nlopt_destroy(nlopt.destroy, optimiser)


@njit(cache=True, parallel=True, nogil=True)
def fit_nlopt(nlopt, problem, rules, out):
    """Fit every texel: scan, then NLopt from the best of the scan; the better of the two is kept."""
    texels = problem.response.shape[0]
    for c in numba.prange((texels + _CHUNK - 1) // _CHUNK):
        _fit_chunk(nlopt, problem, rules, out, c * _CHUNK, min(texels, (c + 1) * _CHUNK))
