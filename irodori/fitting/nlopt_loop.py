"""Compiled loop over texels that calls NLopt's C functions with a compiled objective.

The unknowns passed to NLopt are α and β, each divided by a scale, and log μ, so that one step size suits all three. The
start is the best point of the scan over μ. The data of a texel are its rows, preceded by four header words: the length
of a row, and the scales of α, of β, and of the objective.
"""

from functools import lru_cache
from typing import NamedTuple

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic

from irodori.fitting import judge
from irodori.fitting.observations import Evidence, Minimum, box_of, every_lane, expect_fitted, weigh
from irodori.fitting.shared_geometry import no_shared
from irodori.fitting.texel_rows import (
    COSINE,
    F0,
    F1,
    F2,
    GLOSS,
    LOBE,
    LOBE_SLOPE,
    RESPONSE,
    ROWS,
    WEIGHT,
    folded,
    get,
    padded,
    put,
    vectors_of,
)
from irodori.fitting.texels import (
    Room,
    Task,
    conclude,
    is_noisy,
    load_texel,
    new_sums,
    pack_texel,
    without_outliers,
    write,
    write_too_few,
)
from irodori.fitting.varpro import ESTIMATE, PLACE, find_intervals, pair_at, scan, value_nodes
from irodori.jit.c_functions import c_function
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import cfunc, njit, uncounted
from irodori.jit.vector_memory import spread
from irodori.reflection import lobes as lobe_kernels

HEADER = 4
PARAMETERS = 3
_CHUNK = 64  # texels that share one optimiser object
_PRECISION = 1e6  # factor on the relative objective: NLopt's L-BFGS stops at an absolute gradient of 1e-8

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
    """Convert an integer address to a pointer to float64."""
    signature = types.CPointer(types.float64)(types.uintp)

    def codegen(context, builder, signature, values):
        return builder.inttoptr(values[0], context.get_value_type(signature.return_type))

    return signature, codegen


@uncounted(error_model="numpy")
def objective(alpha, beta, log_mu, rows, lobes):
    """Return the weighted sum of squares of equation (7), and its derivatives with respect to α, β and log μ."""
    constant, zero = lobe_kernels.constants(lobes, log_mu), spread(0.0)
    total, ga, gb, gt = zero, zero, zero, zero
    for j in range(vectors_of(rows)):
        v, v1, _ = lobe_kernels.derivatives(lobes, constant, get(rows, F0, j), get(rows, F1, j), get(rows, F2, j))
        c, g, g1 = get(rows, COSINE, j), get(rows, GLOSS, j) * v, get(rows, GLOSS, j) * v1
        residual = alpha * c + beta * g - get(rows, RESPONSE, j)
        weighted = get(rows, WEIGHT, j) * residual
        total, ga, gb, gt = total + weighted * residual, ga + weighted * c, gb + weighted * g, gt + weighted * g1
    return (
        folded(total, log_mu), 2.0 * folded(ga, log_mu), 2.0 * folded(gb, log_mu), 2.0 * beta * folded(gt, log_mu)
    )  # fmt: skip


@uncounted(error_model="numpy")
def fill_lobe_and_slope(rows, lobes, log_mu):
    """Fill the rows with the gloss of every observation for β = 1, and its slope along log μ."""
    constant = lobe_kernels.constants(lobes, log_mu)
    for j in range(vectors_of(rows)):
        v, v1, _ = lobe_kernels.derivatives(lobes, constant, get(rows, F0, j), get(rows, F1, j), get(rows, F2, j))
        put(rows, LOBE, j, get(rows, GLOSS, j) * v)
        put(rows, LOBE_SLOPE, j, get(rows, GLOSS, j) * v1)


@lru_cache
def nlopt_objective(lobes):
    """Return the objective for one lobe with NLopt's C signature; it fills the gradient if the algorithm needs it."""

    @cfunc(types.float64(types.uint32, types.CPointer(types.float64), types.uintp, types.uintp), error_model="numpy")
    def called(count, x, gradient_address, data_address):
        header = numba.carray(_as_floats(data_address), (HEADER,))
        row, scale_a, scale_b, scale = int(header[0]), header[1], header[2], header[3]
        rows = numba.carray(_as_floats(data_address), (HEADER + ROWS * row,))[HEADER:].reshape((ROWS, row))
        value, ga, gb, gt = objective(x[0] * scale_a, x[1] * scale_b, x[2], rows, lobes)
        if gradient_address != 0:
            gradient = numba.carray(_as_floats(gradient_address), (3,))
            gradient[0], gradient[1], gradient[2] = scale * ga * scale_a, scale * gb * scale_b, scale * gt
        return scale * value

    return called


@njit(cache=True, error_model="numpy")
def set_scales(data, rows, power_sum, alpha, beta):
    """Store the scales of α, β and the objective in the header of a texel's data.

    α and β are scaled by their start values, but at least by those that would explain a hundredth of the largest
    response. The objective is divided by the weighted sum of squared responses, so that NLopt's stopping criterion does
    not depend on the unit of light.
    """
    peak, peak_gloss = 1e-300, 1e-300
    for j in range(rows.shape[1]):
        peak = max(peak, abs(rows[RESPONSE, j]))
        peak_gloss = max(peak_gloss, rows[GLOSS, j])
    data[3] = _PRECISION / max(power_sum, 1e-300)
    data[1] = max(alpha, 0.01 * peak)
    data[2] = max(beta, 0.01 * peak / peak_gloss)


class Nlopt(NamedTuple):
    """Addresses of NLopt's C functions, and the settings of the optimiser."""

    create: int
    destroy: int
    set_lower_bounds: int
    set_upper_bounds: int
    set_min_objective: int
    set_xtol_rel: int
    set_maxeval: int
    optimize: int
    get_numevals: int
    objective: int  # address of `nlopt_objective` for the lobe
    algorithm: int
    xtol_rel: float
    max_evaluations: int


@njit(cache=True)
def new_data(problem):
    """Allocate the data of a texel; return it, and a `Room` with views of its rows and the sums of the scan."""
    p = padded(problem.response.shape[1])
    data = np.zeros(HEADER + ROWS * p)
    data[0] = p
    rows = data[HEADER:].reshape((ROWS, p))
    return data, Room(rows, new_sums(problem))


@njit(cache=True)
def _new_optimiser(nlopt, data):
    optimiser = nlopt_create(nlopt.create, nlopt.algorithm, np.uint32(PARAMETERS))
    nlopt_set_objective(nlopt.set_min_objective, optimiser, nlopt.objective, np.uintp(data.ctypes.data))
    nlopt_set_number(nlopt.set_xtol_rel, optimiser, nlopt.xtol_rel)
    nlopt_set_count(nlopt.set_maxeval, optimiser, nlopt.max_evaluations)
    return optimiser


@njit(cache=True)
def _polish(nlopt, optimiser, data, start, rules, vectors):
    """Run NLopt from a start; return its code and the `Minimum` found, with the evaluations of the start included."""
    x, low, high, value = vectors
    low[0], high[0], x[0] = rules.low_alpha / data[1], rules.high_alpha / data[1], start.alpha / data[1]
    low[1], high[1], x[1] = rules.low_beta / data[2], rules.high_beta / data[2], start.beta / data[2]
    low[2], high[2], x[2] = rules.low_log_mu, rules.high_log_mu, start.log_mu
    for p in range(PARAMETERS):
        x[p] = min(max(x[p], low[p]), high[p])
    nlopt_set_pointer(nlopt.set_lower_bounds, optimiser, np.uintp(low.ctypes.data))
    nlopt_set_pointer(nlopt.set_upper_bounds, optimiser, np.uintp(high.ctypes.data))
    code = nlopt_optimize(nlopt.optimize, optimiser, np.uintp(x.ctypes.data), np.uintp(value.ctypes.data))
    evaluations = start.evaluations + nlopt_get_evaluations(nlopt.get_numevals, optimiser)
    return code, Minimum(x[0] * data[1], x[1] * data[2], x[2], evaluations)


@njit(cache=True, error_model="numpy")
def start_of(task, room, loaded):
    """Scan the roughness of a texel; return its `Evidence`, the best `Minimum` of the scan, and its sum of squares."""
    used, floor = loaded
    fixed, start, value = _scanned(task, room)
    evidence = Evidence(used, floor, fixed)
    if is_noisy(evidence, task.rules):
        expect_fitted(room.rows, task.problem, task.rules, start, every_lane())
        fixed, start, value = _scanned(task, room)
        evidence = Evidence(used, floor, fixed)
    return evidence, start, value


@njit(cache=True, error_model="numpy")
def _scanned(task, room):
    problem, (rows, sums), box = task.problem, room, box_of(task.rules)
    lobes, nodes = problem.lobes, problem.nodes
    fixed = weigh(rows, 0.0)
    scan(rows, problem, sums, 0.0)
    _, top = value_nodes(fixed, sums, nodes.size, box, 0.0)
    find_intervals(nodes, sums, int(top))
    log_mu = nodes[int(top)]
    a, b, value = pair_at(rows, lobes, fixed, box, log_mu)
    likely = 0
    for i in range(nodes.size - 1):
        if sums[ESTIMATE, i] < sums[ESTIMATE, likely]:
            likely = i
    if sums[ESTIMATE, likely] < np.inf:
        between = pair_at(rows, lobes, fixed, box, sums[PLACE, likely])
        if between[2] <= value:
            (a, b, value), log_mu = between, sums[PLACE, likely]
    return fixed, Minimum(a, b, log_mu, nodes.size), value


@njit(cache=True, error_model="numpy")
def finish(t, task, room, evidence, found, out):
    """Remove outliers, assess the `Minimum` that a solver found, and write the results of the texel."""
    evidence, found, sure = without_outliers(task, room, evidence, found)
    write(out, t, conclude(t, task, room, evidence, found, sure), evidence.fixed)


@njit(cache=True, error_model="numpy")
def load_own(t, problem, rules, rows):
    """Fill the rows of a texel; return its number of observations and the expected weighted square of a residual."""
    pack_texel(t, problem, rows)
    return load_texel(t, problem, rules, rows)


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_chunk(nlopt, problem, rules, out, first, last):
    task, (data, room) = Task(problem, rules, no_shared()), new_data(problem)
    rows = room.rows
    vectors = (np.empty(3), np.empty(3), np.empty(3), np.empty(1))
    optimiser = _new_optimiser(nlopt, data)
    for t in range(first, last):
        loaded = load_own(t, problem, rules, rows)
        if loaded[0] <= judge.PARAMETERS:
            write_too_few(t, loaded[0], problem, rows, out)
            continue
        evidence, start, squares = start_of(task, room, loaded)
        set_scales(data, rows, evidence.fixed[2], start.alpha, start.beta)
        out.result[t], found = _polish(nlopt, optimiser, data, start, rules, vectors)
        better = objective(found.alpha, found.beta, found.log_mu, rows, problem.lobes)[0] <= squares
        a, b, log_mu, _ = found if better else start
        finish(t, task, room, evidence, Minimum(a, b, log_mu, found.evaluations), out)
    nlopt_destroy(nlopt.destroy, optimiser)


def fit_nlopt(nlopt, problem, rules, out):
    """Fit every texel by a scan and then NLopt from the best point of the scan; the better of the two is kept."""
    run_chunks(_fit_chunk, len(problem.response), _CHUNK, nlopt, problem, rules, out)
