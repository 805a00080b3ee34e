"""Standard errors of a fit in which the refractive index is a fourth unknown.

The column of n is found by differences: what the gloss of an observation changes with n.
"""

import math

import numpy as np

from irodori.fitting import judge
from irodori.fitting.huber import fill_lobe, reweigh
from irodori.fitting.observations import expect, load
from irodori.fitting.texel_rows import (
    COSINE,
    GLOSS,
    RESPONSE,
    SQUARE,
    TRUST,
    VARIANCE,
    WEIGHT,
    exp_negative,
    pack_geometry,
)
from irodori.fitting.texels import new_block
from irodori.jit.native import njit, run_chunks

_STEP = 1e-3  # of n, relative
_TILT = 1e-3  # of an angle, rad
_CHUNK = 1024
UNKNOWNS = 4  # α, β, log μ, n


@njit(cache=True, error_model="numpy")
def _add(block, above, tilt, found, rules, normal, middle):
    """Add an observation's part to Σ w J Jᵀ and Σ w² v J Jᵀ; return χ²."""
    a, b, log_mu, width = found
    factor, chi2 = -math.exp(-2.0 * log_mu), 0.0
    row = np.empty(UNKNOWNS)
    for j in range(block.shape[1]):
        w, c, x = block[WEIGHT, j], block[COSINE, j], block[SQUARE, j] * factor
        if not w > 0.0:
            continue
        lobe = exp_negative(x)
        row[0], row[1], row[2] = c, block[GLOSS, j] * lobe, -2.0 * b * x * block[GLOSS, j] * lobe
        row[3] = b * lobe * (above[j] - block[GLOSS, j]) / width
        pose = 2.0 * block[SQUARE, j] * (b * factor * row[1]) ** 2 + a * a * (1.0 - c * c)
        v = block[VARIANCE, j] + rules.pose_variance * (pose + (b * lobe) ** 2 * tilt[j])
        off = w * (a * c + b * row[1] - block[RESPONSE, j]) / block[TRUST, j]
        chi2 += off * off / v
        for i in range(UNKNOWNS):
            for k in range(UNKNOWNS):
                normal[i, k] += w * row[i] * row[k]
                middle[i, k] += w * w * v * row[i] * row[k]
    return chi2


@njit(cache=True, error_model="numpy")
def _pack(geometry, index, k, angles, block, above, tilt):
    """Fill the block; ``above`` with the gloss at a larger n, ``tilt`` with its squared slope along θ_i and θ_r.

    n is told by grazing views, and there F G / cosθ_r is steep.
    """
    pack_geometry(geometry, index, k, angles, block)
    base = block[GLOSS].copy()
    tilt[:] = 0.0
    moved = geometry.copy()
    for side in range(2):
        for j in range(geometry.shape[0]):
            moved[j, 0], moved[j, 1], moved[j, 2] = geometry[j, 0], geometry[j, 1], geometry[j, 2] + 0.5 * _TILT
            moved[j, side] += _TILT
        pack_geometry(moved, index, k, angles, block)
        for j in range(tilt.size):
            tilt[j] += ((block[GLOSS, j] - base[j]) / _TILT) ** 2
    pack_geometry(geometry, index * (1.0 + _STEP), k, angles, block)
    for j in range(above.size):
        above[j] = block[GLOSS, j]
    pack_geometry(geometry, index, k, angles, block)


@njit(cache=True, nogil=True, error_model="numpy")
def _sums(problem, rules, index, found, normal, middle, excess, first, last):
    block, angles, _ = new_block(problem)
    above, tilt = np.empty(block.shape[1]), np.empty(block.shape[1])
    for t in range(first, last):
        a, b, log_mu = found[t, 0], found[t, 1], found[t, 2]
        geometry = problem.geometry[t if problem.geometry.shape[0] > 1 else 0]
        _pack(geometry, index[t], problem.k, angles, block, above, tilt)
        used, _, _ = load(problem.response[t], problem.weight[t], rules, block)
        if rules.weighted:
            expect(block, a, b, log_mu, rules)
        if rules.huber > 0.0:
            fill_lobe(block, log_mu)
            reweigh(block, a, b, rules.huber)
        chi2 = _add(block, above, tilt, (a, b, log_mu, _STEP * index[t]), rules, normal[t], middle[t])
        excess[t] = judge.excess_of(chi2, max(used - UNKNOWNS, 1))


def index_errors(problem, rules, index: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Return the standard errors of α, β, log μ and n; infinite where the data cannot tell the four apart.

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
    run_chunks(_sums, count, _CHUNK, problem, rules, index, np.ascontiguousarray(found), normal, middle, excess)
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
    common = (rules.model_error * found[:, :2]) ** 2
    variance[:, :2] += np.where(np.isfinite(common), common, 0.0)
    return np.sqrt(np.where(regular[:, None], variance, np.inf))
