"""Compiled loops of the fit: the scan over μ, the objective for NLopt, and the loop over texels.

One texel's data is a float64 block: five header words (observations, scale of α, of β, of the objective, and one
spare), then five words an observation: cosθ_i, F G / cosθ_r, φ, response, weight. The unknowns that NLopt sees are
(α / scale, β / scale, log μ), so that a trust region fits all three.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic

from irodori.brdf import gloss_factor
from irodori.native import c_function

HEADER, WORDS = 5, 5
PARAMETERS = 3
_CHUNK = 64  # texels that share one optimiser object
_PRECISION = 1e6  # of the scaled objective: NLopt's L-BFGS stops at an absolute gradient of 1e-8
_FIRST_STEP = 0.1  # of the scaled unknowns, for algorithms without gradient

_P, _F, _I = types.uintp, types.float64, types.intc
nlopt_create = c_function(_P, _I, types.uint32)
nlopt_destroy = c_function(types.void, _P)
nlopt_set_pointer = c_function(_I, _P, _P)  # lower bounds, upper bounds, initial step
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


@numba.njit(cache=True, error_model="numpy")
def objective(alpha, beta, mu, data):
    """Return the weighted sum of squares of equation (7)."""
    total = 0.0
    for j in range(int(data[0])):
        at = HEADER + WORDS * j
        ratio = data[at + 2] / mu
        model = alpha * data[at] + beta * data[at + 1] * math.exp(-ratio * ratio)
        residual = model - data[at + 3]
        total += data[at + 4] * residual * residual
    return total


@numba.cfunc(
    types.float64(types.uint32, types.CPointer(types.float64), types.uintp, types.uintp),
    cache=True,
    error_model="numpy",
)
def nlopt_objective(count, x, gradient_address, data_address):
    """Objective in NLopt's C signature, with its gradient where the algorithm asks for one."""
    data = numba.carray(_as_floats(data_address), (HEADER + WORDS * 100_000,))
    scale_a, scale_b = data[1], data[2]
    alpha, beta, mu = x[0] * scale_a, x[1] * scale_b, math.exp(x[2])
    if gradient_address == 0:
        return data[3] * objective(alpha, beta, mu, data)
    total, ga, gb, gm = 0.0, 0.0, 0.0, 0.0
    for j in range(int(data[0])):
        at = HEADER + WORDS * j
        ratio2 = (data[at + 2] / mu) ** 2
        lobe = data[at + 1] * math.exp(-ratio2)
        residual = alpha * data[at] + beta * lobe - data[at + 3]
        weighted = 2.0 * data[at + 4] * residual
        total += data[at + 4] * residual * residual
        ga += weighted * data[at]
        gb += weighted * lobe
        gm += weighted * beta * lobe * 2.0 * ratio2
    gradient = numba.carray(_as_floats(gradient_address), (3,))
    gradient[0], gradient[1], gradient[2] = data[3] * ga * scale_a, data[3] * gb * scale_b, data[3] * gm
    return data[3] * total


@numba.njit(cache=True, error_model="numpy")
def linear_solution(mu, data, lower, upper):
    """Return α, β and the sum of squares that are best for one μ, within their bounds.

    The problem is a convex quadratic in two bounded variables: the minimum is inside, or on one of four edges.
    """
    cc, cg, gg, cr, gr, rr = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(int(data[0])):
        at = HEADER + WORDS * j
        ratio = data[at + 2] / mu
        c, w, r = data[at], data[at + 4], data[at + 3]
        g = data[at + 1] * math.exp(-ratio * ratio)
        cc += w * c * c
        cg += w * c * g
        gg += w * g * g
        cr += w * c * r
        gr += w * g * r
        rr += w * r * r
    best = np.inf
    best_a, best_b = lower[0], lower[1]
    determinant = cc * gg - cg * cg
    for case in range(5):
        if case == 0:
            if not determinant > 1e-14 * cc * gg:
                continue
            a, b = (cr * gg - gr * cg) / determinant, (gr * cc - cr * cg) / determinant
            if a < lower[0] or a > upper[0] or b < lower[1] or b > upper[1]:
                continue
        elif case <= 2:
            b = lower[1] if case == 1 else upper[1]
            a = min(max((cr - b * cg) / cc if cc > 0.0 else 0.0, lower[0]), upper[0])
        else:
            a = lower[0] if case == 3 else upper[0]
            b = min(max((gr - a * cg) / gg if gg > 0.0 else 0.0, lower[1]), upper[1])
        value = rr + a * a * cc + b * b * gg + 2.0 * (a * b * cg - a * cr - b * gr)
        if value < best:
            best, best_a, best_b = value, a, b
    return best_a, best_b, max(best, 0.0)


@numba.njit(cache=True, error_model="numpy")
def pack(response, geometry, weight, n, k, data):
    """Fill a texel's data block and return the number of observations with weight."""
    used = 0
    for j in range(response.shape[0]):
        if not weight[j] > 0.0 or not math.isfinite(response[j]):
            continue
        at = HEADER + WORDS * used
        data[at] = math.cos(geometry[j, 0])
        data[at + 1] = gloss_factor(geometry[j, 0], geometry[j, 1], geometry[j, 2], geometry[j, 3], n, k)
        data[at + 2] = geometry[j, 3]
        data[at + 3] = response[j]
        data[at + 4] = weight[j]
        used += 1
    data[0] = used
    return used


@numba.njit(cache=True)
def scan(data, mu_grid, lower, upper):
    """Return the best α, β, μ of a grid of μ with its sum of squares."""
    best_a, best_b, best_m, best = 0.0, 0.0, mu_grid[0], np.inf
    for i in range(mu_grid.size):
        a, b, value = linear_solution(mu_grid[i], data, lower, upper)
        if value < best:
            best_a, best_b, best_m, best = a, b, mu_grid[i], value
    return best_a, best_b, best_m, best


@numba.njit(cache=True)
def set_scales(data, alpha, beta):
    """Store scales in the block: of α and β, their start or a hundredth of the largest response; of the objective.

    The objective is relative to the power of the responses, so that NLopt stops at the same place whatever the unit
    of light.
    """
    peak = 1e-300
    peak_gloss = 1e-300
    power = 1e-300
    for j in range(int(data[0])):
        at = HEADER + WORDS * j
        power += data[at + 4] * data[at + 3] * data[at + 3]
        peak = max(peak, abs(data[at + 3]))
        peak_gloss = max(peak_gloss, data[at + 1])
    data[3] = _PRECISION / power
    data[1] = max(alpha, 0.01 * peak)
    data[2] = max(beta, 0.01 * peak / peak_gloss)


class Nlopt(NamedTuple):
    """Addresses of NLopt's C functions, and how to run them."""

    create: int
    destroy: int
    set_lower_bounds: int
    set_upper_bounds: int
    set_initial_step: int
    set_min_objective: int
    set_xtol_rel: int
    set_maxeval: int
    optimize: int
    get_numevals: int
    objective: int  # address of `nlopt_objective`
    algorithm: int
    xtol_rel: float
    max_evaluations: int


class Output(NamedTuple):
    """What the loop over texels fills."""

    parameters: np.ndarray  # (texels, 3) α, β, μ
    sum_squares: np.ndarray  # (texels,)
    diffuse: np.ndarray  # (texels, 2) α and sum of squares of the model without gloss
    used: np.ndarray  # (texels,) observations with weight
    evaluations: np.ndarray  # (texels,)
    result: np.ndarray  # (texels,) NLopt's return code


@numba.njit(cache=True)
def _new_optimiser(nlopt, data):
    optimiser = nlopt_create(nlopt.create, nlopt.algorithm, np.uint32(PARAMETERS))
    nlopt_set_objective(nlopt.set_min_objective, optimiser, nlopt.objective, np.uintp(data.ctypes.data))
    nlopt_set_number(nlopt.set_xtol_rel, optimiser, nlopt.xtol_rel)
    nlopt_set_count(nlopt.set_maxeval, optimiser, nlopt.max_evaluations)
    return optimiser


@numba.njit(cache=True)
def _polish(nlopt, optimiser, data, start, lower, upper, vectors):
    """Run NLopt from a start; return its code, its evaluations and the α, β, μ and sum of squares it found."""
    x, low, high, step, value = vectors
    scale = (data[1], data[2])
    for p in range(2):
        low[p], high[p], x[p] = lower[p] / scale[p], upper[p] / scale[p], start[p] / scale[p]
    low[2], high[2], x[2] = math.log(lower[2]), math.log(upper[2]), math.log(start[2])
    for p in range(PARAMETERS):
        x[p] = min(max(x[p], low[p]), high[p])
        step[p] = _FIRST_STEP
    nlopt_set_pointer(nlopt.set_lower_bounds, optimiser, np.uintp(low.ctypes.data))
    nlopt_set_pointer(nlopt.set_upper_bounds, optimiser, np.uintp(high.ctypes.data))
    nlopt_set_pointer(nlopt.set_initial_step, optimiser, np.uintp(step.ctypes.data))
    code = nlopt_optimize(nlopt.optimize, optimiser, np.uintp(x.ctypes.data), np.uintp(value.ctypes.data))
    evaluations = nlopt_get_evaluations(nlopt.get_numevals, optimiser)
    a, b, m = x[0] * scale[0], x[1] * scale[1], math.exp(x[2])
    return code, evaluations, a, b, m, objective(a, b, m, data)


@numba.njit(cache=True)
def _fit_chunk(nlopt, response, geometry, weight, n, k, mu_grid, lower, upper, out, first, last):
    data = np.zeros(HEADER + WORDS * response.shape[1])
    vectors = (np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(1))
    without_gloss = np.array([upper[0], lower[1]])
    optimiser = _new_optimiser(nlopt, data)
    for t in range(first, last):
        out.used[t] = pack(response[t], geometry[t], weight[t], n, k, data)
        if out.used[t] == 0:
            continue
        out.diffuse[t, 0], _, out.diffuse[t, 1] = linear_solution(1e-6, data, lower, without_gloss)
        if out.used[t] <= PARAMETERS:
            continue
        a, b, m, squares = scan(data, mu_grid, lower, upper)
        set_scales(data, a, b)
        code, count, pa, pb, pm, polished = _polish(nlopt, optimiser, data, (a, b, m), lower, upper, vectors)
        if polished <= squares:
            a, b, m, squares = pa, pb, pm, polished
        out.parameters[t, 0], out.parameters[t, 1], out.parameters[t, 2] = a, b, m
        out.sum_squares[t], out.result[t] = squares, code
        out.evaluations[t] = count + mu_grid.size
    nlopt_destroy(nlopt.destroy, optimiser)


@numba.njit(cache=True, parallel=True, nogil=True)
def fit_texels(nlopt, response, geometry, weight, n, k, mu_grid, lower, upper, out):
    """Fit every texel: scan, then NLopt from the best of the scan; the better of the two is kept."""
    texels = response.shape[0]
    for c in numba.prange((texels + _CHUNK - 1) // _CHUNK):
        first, last = c * _CHUNK, min(texels, (c + 1) * _CHUNK)
        _fit_chunk(nlopt, response, geometry, weight, n, k, mu_grid, lower, upper, out, first, last)


@numba.njit(cache=True, parallel=True, nogil=True)
def standard_errors(response, geometry, weight, n, k, fitted, model_noise, out):
    """Fill ``out`` (texel, 3) with Gauss-Newton standard errors of α, β, μ; infinite where undetermined.

    The variance is that of the residuals, but at least that of ``model_noise`` times the root mean square response:
    four observations can be met exactly by three parameters and know nothing.
    """
    texels, captures = response.shape
    for t in numba.prange(texels):
        out[t, :] = np.inf
        if fitted.used[t] <= PARAMETERS or not math.isfinite(fitted.parameters[t, 2]):
            continue
        data = np.zeros(HEADER + WORDS * captures)
        pack(response[t], geometry[t], weight[t], n, k, data)
        normal = np.zeros((3, 3))
        row = np.empty(3)
        power = 0.0
        for j in range(fitted.used[t]):
            at = HEADER + WORDS * j
            power += data[at + 4] * data[at + 3] * data[at + 3]
            ratio2 = (data[at + 2] / fitted.parameters[t, 2]) ** 2
            lobe = data[at + 1] * math.exp(-ratio2)
            row[0], row[1] = data[at], lobe
            row[2] = fitted.parameters[t, 1] * lobe * 2.0 * ratio2 / fitted.parameters[t, 2]
            for p in range(3):
                for q in range(3):
                    normal[p, q] += data[at + 4] * row[p] * row[q]
        size = np.sqrt(np.diag(normal))
        if not (size[0] > 0.0 and size[1] > 0.0 and size[2] > 0.0):
            continue
        for p in range(3):
            for q in range(3):
                normal[p, q] /= size[p] * size[q]
        # Scaled to a unit diagonal, a determinant near zero means that two parameters cannot be told apart.
        if abs(np.linalg.det(normal)) < 1e-10:
            continue
        inverse = np.linalg.inv(normal)
        variance = max(
            fitted.sum_squares[t] / (fitted.used[t] - PARAMETERS), model_noise * model_noise * power / fitted.used[t]
        )
        for p in range(3):
            out[t, p] = math.sqrt(max(variance * inverse[p, p], 0.0)) / size[p]
