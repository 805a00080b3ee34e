"""Compiled loops of the fit: the scan over μ, the objective for NLopt, and the loop over texels.

One texel's data is a float64 block: five header words (observations, scale of α, scale of β, and two spare), then
five words an observation: cosθ_i, F G / cosθ_r, φ, response, weight. The unknowns that NLopt sees are
(α / scale, β / scale, log μ), so that a trust region fits all three.
"""

import math

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic

from irodori.brdf import gloss_factor
from irodori.native import c_function

HEADER, WORDS = 5, 5
PARAMETERS = 3

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
        return objective(alpha, beta, mu, data)
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
    gradient[0], gradient[1], gradient[2] = ga * scale_a, gb * scale_b, gm
    return total


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
    """Store the scales of α and β in the block: their start, or a hundredth of the largest response."""
    peak = 1e-300
    peak_gloss = 1e-300
    for j in range(int(data[0])):
        at = HEADER + WORDS * j
        peak = max(peak, abs(data[at + 3]))
        peak_gloss = max(peak_gloss, data[at + 1])
    data[1] = max(alpha, 0.01 * peak)
    data[2] = max(beta, 0.01 * peak / peak_gloss)


@numba.njit(cache=True, parallel=True, nogil=True)
def fit_texels(
    functions,
    callback,
    algorithm,
    response,
    geometry,
    weight,
    n,
    k,
    mu_grid,
    lower,
    upper,
    xtol_rel,
    max_evaluations,
    parameters,
    sum_squares,
    diffuse,
    used,
    evaluations,
    result,
):
    """Fit every texel: scan, then NLopt from the best of the scan; the better of the two is kept.

    ``functions`` are the addresses of nlopt_create, destroy, set_lower_bounds, set_upper_bounds, set_initial_step,
    set_min_objective, set_xtol_rel, set_maxeval, optimize and get_numevals. ``diffuse`` gets α and the sum of
    squares of the model without gloss.
    """
    texels, captures = response.shape
    chunk = 64
    for c in numba.prange((texels + chunk - 1) // chunk):
        data = np.zeros(HEADER + WORDS * captures)
        x, lo, hi, step = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
        value = np.empty(1)
        optimiser = nlopt_create(functions[0], algorithm, np.uint32(PARAMETERS))
        nlopt_set_objective(functions[5], optimiser, callback, np.uintp(data.ctypes.data))
        nlopt_set_number(functions[6], optimiser, xtol_rel)
        nlopt_set_count(functions[7], optimiser, max_evaluations)
        for t in range(c * chunk, min(texels, (c + 1) * chunk)):
            used[t] = pack(response[t], geometry[t], weight[t], n, k, data)
            evaluations[t], result[t] = 0, 0
            parameters[t, :] = np.nan
            if used[t] == 0:
                continue
            diffuse[t, 0], _, diffuse[t, 1] = linear_solution(1e-6, data, lower, np.array([upper[0], lower[1]]))
            if used[t] <= PARAMETERS:
                continue
            a, b, m, best = scan(data, mu_grid, lower, upper)
            set_scales(data, a, b)
            lo[0], lo[1], lo[2] = lower[0] / data[1], lower[1] / data[2], math.log(lower[2])
            hi[0], hi[1], hi[2] = upper[0] / data[1], upper[1] / data[2], math.log(upper[2])
            x[0], x[1], x[2] = a / data[1], b / data[2], math.log(m)
            step[0], step[1], step[2] = 0.1, 0.1, 0.1
            nlopt_set_pointer(functions[2], optimiser, np.uintp(lo.ctypes.data))
            nlopt_set_pointer(functions[3], optimiser, np.uintp(hi.ctypes.data))
            nlopt_set_pointer(functions[4], optimiser, np.uintp(step.ctypes.data))
            x[:] = np.minimum(np.maximum(x, lo), hi)
            result[t] = nlopt_optimize(functions[8], optimiser, np.uintp(x.ctypes.data), np.uintp(value.ctypes.data))
            evaluations[t] = nlopt_get_evaluations(functions[9], optimiser) + mu_grid.size
            parameters[t, 0], parameters[t, 1], parameters[t, 2] = a, b, m
            sum_squares[t] = best
            polished = objective(x[0] * data[1], x[1] * data[2], math.exp(x[2]), data)
            if polished <= best:
                parameters[t, 0], parameters[t, 1], parameters[t, 2] = x[0] * data[1], x[1] * data[2], math.exp(x[2])
                sum_squares[t] = polished
        nlopt_destroy(functions[1], optimiser)


@numba.njit(cache=True, parallel=True, nogil=True)
def standard_errors(response, geometry, weight, n, k, parameters, sum_squares, used, model_noise, out):
    """Fill ``out`` (texel, 3) with Gauss-Newton standard errors of α, β, μ; infinite where undetermined.

    The variance is that of the residuals, but at least that of ``model_noise`` times the root mean square response:
    four observations can be met exactly by three parameters and know nothing.
    """
    texels, captures = response.shape
    for t in numba.prange(texels):
        out[t, :] = np.inf
        if used[t] <= PARAMETERS or not math.isfinite(parameters[t, 2]):
            continue
        data = np.zeros(HEADER + WORDS * captures)
        pack(response[t], geometry[t], weight[t], n, k, data)
        normal = np.zeros((3, 3))
        row = np.empty(3)
        power = 0.0
        for j in range(used[t]):
            at = HEADER + WORDS * j
            power += data[at + 4] * data[at + 3] * data[at + 3]
            ratio2 = (data[at + 2] / parameters[t, 2]) ** 2
            lobe = data[at + 1] * math.exp(-ratio2)
            row[0], row[1] = data[at], lobe
            row[2] = parameters[t, 1] * lobe * 2.0 * ratio2 / parameters[t, 2]
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
        variance = max(sum_squares[t] / (used[t] - PARAMETERS), model_noise * model_noise * power / used[t])
        for p in range(3):
            out[t, p] = math.sqrt(max(variance * inverse[p, p], 0.0)) / size[p]
