"""Tables for texels that share one geometry: what a scan and its polish need of the lobe, known once for all of them.

At the nodes of the scan the lobes of all observations are a matrix. Around any other μ the lobe is a polynomial in
(μ_k / μ)², k the nearest of a row of centres, so that its sums over observations are polynomials too: a texel's sums
are products of a vector and a small matrix, and Newton's steps cost no exponential an observation.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from irodori.fitting.lobe import FAST, GLOSS, LEAST_LOBE, SQUARE, WEIGHT, WEIGHTED_COSINE, WEIGHTED_RESPONSE
from irodori.native import aligned, vector_times_table

#: Of the polynomials: exp(-(φ/μ)²) and its square to 3e-9 of their largest value.
DEGREE = 7
TERMS = DEGREE + 1
_STEP = 0.25 * math.log(2.0)  # of log μ between centres
_REACH = 0.6 * _STEP  # to both sides of a centre
# (μ_k / μ)² = _MIDDLE + _HALF τ, τ in -1..1.
_MIDDLE, _HALF = math.cosh(2.0 * _REACH), math.sinh(2.0 * _REACH)
_POINTS = 16  # Chebyshev points that the polynomials are fitted to
WIDTH = 24  # nodes that are summed together
_times_nodes, _times_shapes = vector_times_table(WIDTH, 2), vector_times_table(TERMS, 4)


class Shared(NamedTuple):
    """What one geometry gives for all texels; empty where texels have geometries of their own.

    Parameters
    ----------
    nodes : (4, blocks, P, WIDTH) float64
        g, dg/dt, g² and d(g²)/dt at the nodes, t = log μ, in blocks of `WIDTH` nodes, the last padded with zeros.
    shapes : (centres, 2, P, TERMS) float64
        Coefficients of g and g² in powers of τ.
    lowest : float
        log μ of the first centre.
    """

    nodes: np.ndarray
    shapes: np.ndarray
    lowest: float


@numba.njit(cache=True)
def no_shared():
    """Return what texels with geometries of their own share: nothing."""
    return Shared(np.zeros((4, 0, 0, WIDTH)), np.zeros((0, 2, 0, TERMS)), 0.0)


def _terms_from_samples() -> tuple[np.ndarray, np.ndarray]:
    """Return the places τ of the samples, and the matrix from samples to coefficients of the powers of τ."""
    tau = np.cos(np.pi * (np.arange(_POINTS) + 0.5) / _POINTS)
    chebyshev = np.polynomial.chebyshev.chebvander(tau, DEGREE) * (2.0 / _POINTS)
    chebyshev[:, 0] *= 0.5
    powers = np.zeros((TERMS, TERMS))
    for m in range(TERMS):
        powers[m, : m + 1] = np.polynomial.chebyshev.cheb2poly(np.eye(TERMS)[m])[: m + 1]
    return tau, chebyshev @ powers


def _table(values: np.ndarray) -> np.ndarray:
    """Return an aligned copy without the tails of the lobe: denormal numbers are a hundred times slower."""
    out = aligned(values.size).reshape(values.shape)
    out[...] = np.where(np.abs(values) > LEAST_LOBE, values, 0.0)
    return out


def tabulate(block: np.ndarray, nodes: np.ndarray) -> Shared:
    """Return the tables of one geometry.

    Parameters
    ----------
    block : (ROWS, P) float64
        Of which F G / cosθ_r and φ² are read.
    nodes : (nodes,) float64
        log μ, falling.
    """
    gloss, square = block[GLOSS], block[SQUARE]
    x = square[:, None] * np.exp(-2.0 * nodes)
    g = gloss[:, None] * np.exp(-x)
    width = padded_nodes(nodes.size)
    at_nodes = np.zeros((4, square.size, width))
    at_nodes[..., : nodes.size] = g, 2.0 * x * g, g * g, 4.0 * x * g * g
    at_nodes = at_nodes.reshape(4, square.size, width // WIDTH, WIDTH).transpose(0, 2, 1, 3)
    centres = np.arange(nodes[-1], nodes[0] + _STEP, _STEP)
    tau, terms = _terms_from_samples()
    ratio = np.exp(-2.0 * centres)[:, None] * (_MIDDLE + _HALF * tau)
    lobe = gloss[:, None] * np.exp(-square[:, None] * ratio[:, None, :])  # (centres, P, points)
    shapes = np.stack([lobe @ terms, lobe**2 @ terms], axis=1)
    return Shared(_table(at_nodes), _table(shapes), float(centres[0]))


@numba.njit(cache=True)
def padded_nodes(nodes):
    """Return the length of a row of sums: the number of nodes, rounded up to a multiple of `WIDTH`."""
    return (nodes + WIDTH - 1) // WIDTH * WIDTH


@numba.njit(cache=True)
def _node_sums(shared, kind, block, row, sums, into):
    blocks, size = shared.nodes.shape[1], shared.nodes.shape[2] * WIDTH
    for b in range(blocks):
        _times_nodes(block, row, shared.nodes, (kind * blocks + b) * size, sums, into * sums.shape[1] + b * WIDTH)


@numba.njit(cache=True, error_model="numpy")
def scan_shared(block, shared, sums, changed):
    """Fill the sums of all nodes; those without the response stay as they are unless ``changed``."""
    _node_sums(shared, 0, block, WEIGHTED_RESPONSE, sums, 1)
    _node_sums(shared, 1, block, WEIGHTED_RESPONSE, sums, 4)
    if changed:
        _node_sums(shared, 0, block, WEIGHTED_COSINE, sums, 0)
        _node_sums(shared, 1, block, WEIGHTED_COSINE, sums, 3)
        _node_sums(shared, 2, block, WEIGHT, sums, 2)
        _node_sums(shared, 3, block, WEIGHT, sums, 5)


@numba.njit(cache=True, error_model="numpy")
def nearest_centre(shared, log_mu, held):
    """Return the centre whose polynomials hold at log μ: the one at hand if they do, else the nearest."""
    if held >= 0 and abs(log_mu - shared.lowest - held * _STEP) <= _REACH:
        return held
    return math.floor((log_mu - shared.lowest) / _STEP + 0.5)


@numba.njit(cache=True, error_model="numpy")
def project(block, shared, centre, sums, row):
    """Fill the polynomials of Σ w c g, Σ w ρ g and Σ w g² around a centre into a row of the sums, `TERMS` each."""
    size, place = shared.shapes.shape[2] * TERMS, row * sums.shape[1]
    _times_shapes(block, WEIGHTED_COSINE, shared.shapes, 2 * centre * size, sums, place)
    _times_shapes(block, WEIGHTED_RESPONSE, shared.shapes, 2 * centre * size, sums, place + TERMS)
    _times_shapes(block, WEIGHT, shared.shapes, (2 * centre + 1) * size, sums, place + 2 * TERMS)


@numba.njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def _polynomial(sums, row, first_term, tau, slope, bend):
    """Return value, slope and curvature along t of a polynomial in τ; ``slope`` and ``bend`` are those of τ."""
    value, first, second = sums[row, first_term + DEGREE], 0.0, 0.0
    for m in range(DEGREE - 1, -1, -1):
        second = second * tau + first
        first = first * tau + value
        value = value * tau + sums[row, first_term + m]
    return value, first * slope, 2.0 * second * slope * slope + first * bend


@numba.njit(cache=True, error_model="numpy")
def local_moments(sums, row, offset):
    """Return value, slope and curvature along log μ of the three sums, ``offset`` beyond a centre."""
    ratio = math.exp(-2.0 * offset)
    tau = (ratio - _MIDDLE) / _HALF
    slope = -2.0 * ratio / _HALF
    bend = -2.0 * slope
    cg, cg1, cg2 = _polynomial(sums, row, 0, tau, slope, bend)
    rg, rg1, rg2 = _polynomial(sums, row, TERMS, tau, slope, bend)
    gg, gg1, gg2 = _polynomial(sums, row, 2 * TERMS, tau, slope, bend)
    return cg, cg1, cg2, rg, rg1, rg2, gg, gg1, gg2


@numba.njit(cache=True)
def log_mu_of_centre(shared, centre):
    """Return log μ of a centre."""
    return shared.lowest + centre * _STEP
