"""Standard errors of a fit in which the refractive index n is a fourth unknown.

The column of the Jacobian for n is computed by finite differences of the gloss.
"""

from typing import NamedTuple

import numpy as np

from irodori.fitting import judge
from irodori.fitting.observations import Minimum, every_lane, expect_fitted, load_one
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
    new_rows,
    pack_geometry,
)
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit
from irodori.reflection import lobes as lobe_kernels

_STEP = 1e-3  # relative step of n for finite differences
_TILT = 1e-3  # step of an angle for finite differences, rad
_CHUNK = 1024
UNKNOWNS = 4  # α, β, log μ, n


class ErrorSums(NamedTuple):
    """Sums over the observations of each texel for the covariance of the unknowns.

    Parameters
    ----------
    normal, middle : (texels, UNKNOWNS, UNKNOWNS) float64
        Σ w J Jᵀ and Σ w² v J Jᵀ, with weights w, variances v and the gradient J of the model.
    excess : (texels,) float64
        Factor on the variances.
    """

    normal: np.ndarray
    middle: np.ndarray
    excess: np.ndarray


class Moved(NamedTuple):
    """Gloss of the observations of a texel after changes of n and of the angles.

    Parameters
    ----------
    above : (P,) float64
        Gloss without the lobe at n (1 + `_STEP`).
    tilt : (P,) float64
        Sum of the squared slopes of the gloss along θ_i and θ_r. Views near grazing angles determine n, and there F G /
        cosθ_r is steep.
    """

    above: np.ndarray
    tilt: np.ndarray


@njit(cache=True, error_model="numpy")
def _add(rows, moved, lobes, found, rules, into):
    """Add the observations of a texel to Σ w J Jᵀ and Σ w² v J Jᵀ; return χ²."""
    (a, b, log_mu, index), (normal, middle) = found, into
    width = _STEP * index
    constant, chi2 = lobe_kernels.constants(lobes, log_mu), 0.0
    row = np.empty(UNKNOWNS)
    for j in range(rows.shape[1]):
        w, c, gloss = rows[WEIGHT, j], rows[COSINE, j], rows[GLOSS, j]
        if not w > 0.0:
            continue
        value, slope, _ = lobe_kernels.derivatives(lobes, constant, rows[F0, j], rows[F1, j], rows[F2, j])
        steepness = lobe_kernels.flank(lobes, constant, rows[F0, j], rows[F1, j], rows[F2, j])[1]
        row[0], row[1], row[2] = c, gloss * value, b * slope * gloss
        row[3] = b * value * (moved.above[j] - gloss) / width
        pose = rules.phi_variance * steepness * (b * row[1]) ** 2
        v = rows[VARIANCE, j] + pose + rules.incidence_variance * (a * a * (1.0 - c * c) + b * b * moved.tilt[j])
        off = a * c + b * row[1] - rows[RESPONSE, j]
        chi2 += off * off / v
        for i in range(UNKNOWNS):
            for k in range(UNKNOWNS):
                normal[i, k] += w * row[i] * row[k]
                middle[i, k] += w * w * v * row[i] * row[k]
    return chi2


@njit(cache=True, error_model="numpy")
def _pack(geometry, problem, index, log_mu, rows, moved):
    """Fill the rows of a texel, and the arrays of `Moved`."""
    lobes, k, coupled, tilt = problem.lobes, problem.k, problem.coupled, moved.tilt
    pack_geometry(geometry, lobes, index, k, coupled, rows)
    fill_lobe(rows, lobes, log_mu)
    base = rows[LOBE].copy()
    tilt[:] = 0.0
    other = geometry.copy()
    for side in range(2):
        for j in range(geometry.shape[0]):
            other[j, 0], other[j, 1], other[j, 2] = geometry[j, 0], geometry[j, 1], geometry[j, 2] + 0.5 * _TILT
            other[j, side] += _TILT
        pack_geometry(other, lobes, index, k, coupled, rows)
        fill_lobe(rows, lobes, log_mu)
        for j in range(tilt.size):
            tilt[j] += ((rows[LOBE, j] - base[j]) / _TILT) ** 2
    pack_geometry(geometry, lobes, index * (1.0 + _STEP), k, coupled, rows)
    for j in range(rows.shape[1]):
        moved.above[j] = rows[GLOSS, j]
    pack_geometry(geometry, lobes, index, k, coupled, rows)


@njit(cache=True, nogil=True, error_model="numpy")
def _sums(problem, rules, found, sums, first, last):
    rows, lobes = new_rows(problem.response.shape[1]), problem.lobes
    moved = Moved(np.empty(rows.shape[1]), np.empty(rows.shape[1]))
    for t in range(first, last):
        a, b, log_mu, index = found[t, 0], found[t, 1], found[t, 2], found[t, 3]
        geometry = problem.geometry[t if problem.geometry.shape[0] > 1 else 0]
        _pack(geometry, problem, index, log_mu, rows, moved)
        used, _ = load_one(problem.response[t], problem.weight[t], problem.noise, rules, rows)
        if rules.weighted:
            expect_fitted(rows, problem, rules, Minimum(a, b, log_mu, 0), every_lane())
        into = sums.normal[t], sums.middle[t]
        chi2 = _add(rows, moved, lobes, (a, b, log_mu, index), rules, into)
        sums.excess[t] = judge.excess_of(chi2, float(max(used - UNKNOWNS, 1)))


def index_errors(problem, rules, index: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Return the standard errors of α, β, log μ and n; infinite where the data do not determine all four.

    Parameters
    ----------
    problem : irodori.fitting.texels.Problem
    rules : irodori.fitting.observations.Rules
    index : (texels,) float64
        n of every texel.
    found : (texels, 3) float64
        α, β, log μ of every texel.

    Returns
    -------
    (texels, 4) float64
    """
    count = len(index)
    normal, middle = np.zeros((2, count, UNKNOWNS, UNKNOWNS))
    excess = np.ones(count)
    sums = ErrorSums(normal, middle, excess)
    run_chunks(_sums, count, _CHUNK, problem, rules, np.column_stack([found, index]), sums)
    diagonal = np.sqrt(np.einsum("tii->ti", normal))
    scale = np.where(diagonal > 0.0, 1.0 / np.where(diagonal > 0.0, diagonal, 1.0), 0.0)
    scaled = normal * scale[:, :, None] * scale[:, None, :]
    regular = np.isfinite(scaled).all(axis=(1, 2)) & (diagonal > 0.0).all(axis=1)
    scaled[~regular] = np.eye(UNKNOWNS)
    regular &= np.linalg.eigvalsh(scaled)[:, 0] > 1e-9
    scaled[~regular] = np.eye(UNKNOWNS)
    inverse = np.linalg.inv(scaled) * scale[:, :, None] * scale[:, None, :]
    covariance = np.einsum("tij,tjk,tlk->til", inverse, middle, inverse) * excess[:, None, None]
    variance = np.einsum("tii->ti", covariance)
    common = (rules.level_error * found[:, :2]) ** 2
    variance[:, :2] += np.where(np.isfinite(common), common, 0.0)
    return np.sqrt(np.where(regular[:, None], variance, np.inf))
