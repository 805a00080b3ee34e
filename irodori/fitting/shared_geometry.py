"""Precomputed lobes at the nodes of the scan, for texels with one common geometry.

At the nodes the lobes of all observations are a matrix, and a texel's sums are products of a vector with it.
"""

from typing import NamedTuple

import numpy as np

from irodori.fitting.texel_rows import GLOSS, LEAST_LOBE, SQUARE, WEIGHT, WEIGHTED_COSINE, WEIGHTED_RESPONSE
from irodori.jit.native import aligned, njit, vector_times_table

WIDTH = 24  # nodes that are summed together
_times_nodes = vector_times_table(WIDTH, 2)


class Shared(NamedTuple):
    """What one geometry gives for all texels; empty where texels have geometries of their own.

    Parameters
    ----------
    nodes : (4, blocks, P, WIDTH) float64
        g, dg/dt, g² and d(g²)/dt at the nodes, t = log μ, in blocks of `WIDTH` nodes, the last padded with zeros.
    """

    nodes: np.ndarray


@njit(cache=True)
def no_shared():
    """Return what texels with geometries of their own share: nothing."""
    return Shared(np.zeros((4, 0, 0, WIDTH)))


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
    return Shared(_table(at_nodes))


@njit(cache=True)
def padded_nodes(nodes):
    """Return the length of a row of sums: the number of nodes, rounded up to a multiple of `WIDTH`."""
    return (nodes + WIDTH - 1) // WIDTH * WIDTH


@njit(cache=True)
def _node_sums(shared, kind, block, row, sums, into):
    blocks, size = shared.nodes.shape[1], shared.nodes.shape[2] * WIDTH
    for b in range(blocks):
        _times_nodes(block, row, shared.nodes, (kind * blocks + b) * size, sums, into * sums.shape[1] + b * WIDTH)


@njit(cache=True, error_model="numpy")
def scan_shared(block, shared, sums, changed):
    """Fill the sums of all nodes; those without the response stay as they are unless ``changed``."""
    _node_sums(shared, 0, block, WEIGHTED_RESPONSE, sums, 1)
    _node_sums(shared, 1, block, WEIGHTED_RESPONSE, sums, 4)
    if changed:
        _node_sums(shared, 0, block, WEIGHTED_COSINE, sums, 0)
        _node_sums(shared, 1, block, WEIGHTED_COSINE, sums, 3)
        _node_sums(shared, 2, block, WEIGHT, sums, 2)
        _node_sums(shared, 3, block, WEIGHT, sums, 5)
