"""Precomputed lobes at the nodes of the scan, for texels that all have the same geometry.

The lobes of all observations at all nodes form a matrix; the sums of a texel are products of a vector with this matrix.
"""

from typing import NamedTuple

import numpy as np

from irodori.fitting.texel_rows import F0, F1, F2, GLOSS, WEIGHT, WEIGHTED_COSINE, WEIGHTED_RESPONSE, item
from irodori.fitting.varpro import CG, CG1, GG, GG1, LEAST_LOBE, RG, RG1
from irodori.jit.compilation import njit, uncounted
from irodori.jit.table_sums import Place, Tables, lanes_times_tables, vector_times_table
from irodori.jit.vector_memory import aligned
from irodori.jit.vectors import LANES
from irodori.reflection import lobes as lobe_kernels

WIDTH = 24  # nodes that are summed together
GROUP = 6  # nodes that are summed together for eight texels
_times_nodes = vector_times_table(WIDTH, 2)
_eight_times_nodes = lanes_times_tables(GROUP)


class Shared(NamedTuple):
    """Tables for the geometry that all texels share; empty if texels have separate geometries.

    Parameters
    ----------
    rows : (ROWS, P) float64
        Rows of a texel with this geometry.
    nodes : (4, blocks, P, WIDTH) float64
        g, dg/dt, g² and d(g²)/dt at the nodes, t = log μ, in blocks of `WIDTH` nodes, the last padded with zeros.
    """

    rows: np.ndarray
    nodes: np.ndarray


@njit(cache=True)
def no_shared():
    """Return the empty `Shared` for texels with separate geometries."""
    return Shared(np.zeros((0, 0)), np.zeros((4, 0, 0, WIDTH)))


def _table(values: np.ndarray) -> np.ndarray:
    """Return an aligned copy with tiny values set to 0, because denormal numbers are a hundred times slower."""
    out = aligned(values.size).reshape(values.shape)
    out[...] = np.where(np.abs(values) > LEAST_LOBE, values, 0.0)
    return out


@njit(cache=True, error_model="numpy")
def _at_nodes(rows, lobes, nodes, out):
    for i in range(nodes.size):
        constant = lobe_kernels.constants(lobes, nodes[i])
        for j in range(rows.shape[1]):
            f0, f1, f2 = item(rows, F0, j, 0.0), item(rows, F1, j, 0.0), item(rows, F2, j, 0.0)
            value, slope, _ = lobe_kernels.derivatives(lobes, constant, f0, f1, f2)
            g, g1 = rows[GLOSS, j] * value, rows[GLOSS, j] * slope
            out[0, j, i], out[1, j, i], out[2, j, i], out[3, j, i] = g, g1, g * g, 2.0 * g * g1


def tabulate(rows: np.ndarray, lobes, nodes: np.ndarray) -> Shared:
    """Compute the tables for one geometry.

    Parameters
    ----------
    rows : (ROWS, P) float64
        Rows of a texel; gloss and features are read.
    lobes : Lobes
        One lobe.
    nodes : (nodes,) float64
        log μ of the scan, in decreasing order.
    """
    width = padded_nodes(nodes.size)
    at_nodes = np.zeros((4, rows.shape[1], width))
    _at_nodes(rows, lobes, nodes, at_nodes)
    at_nodes = at_nodes.reshape(4, rows.shape[1], width // WIDTH, WIDTH).transpose(0, 2, 1, 3)
    return Shared(rows, _table(at_nodes))


@njit(cache=True)
def padded_nodes(nodes):
    """Return the length of a row of sums: the number of nodes, rounded up to a multiple of `WIDTH`."""
    return (nodes + WIDTH - 1) // WIDTH * WIDTH


@uncounted()
def _node_sums(shared, kind, rows, row, sums, into):
    blocks, size = shared.nodes.shape[1], shared.nodes.shape[2] * WIDTH
    for b in range(blocks):
        table = Place(shared.nodes, (kind * blocks + b) * size)
        _times_nodes(rows, row, table, Place(sums, into * sums.shape[1] + b * WIDTH))


@uncounted(error_model="numpy")
def scan_shared(rows, shared, sums, changed):
    """Fill the sums of one texel at all nodes; sums without the response only if ``changed`` (the weights)."""
    _node_sums(shared, 0, rows, WEIGHTED_RESPONSE, sums, RG)
    _node_sums(shared, 1, rows, WEIGHTED_RESPONSE, sums, RG1)
    if changed:
        _node_sums(shared, 0, rows, WEIGHTED_COSINE, sums, CG)
        _node_sums(shared, 1, rows, WEIGHTED_COSINE, sums, CG1)
        _node_sums(shared, 2, rows, WEIGHT, sums, GG)
        _node_sums(shared, 3, rows, WEIGHT, sums, GG1)


@uncounted()
def scan_shared_eight(rows, shared, sums, changed):
    """Fill the sums of eight texels at all nodes; sums without the response only if ``changed`` (the weights)."""
    blocks, height, captures = shared.nodes.shape[1], shared.nodes.shape[2], rows.shape[1] // LANES
    table, row, step = height * WIDTH, rows.shape[1], sums.shape[1]
    flat = blocks * table
    for group in range(step // (GROUP * LANES)):
        into = group * GROUP * LANES
        kind = group * GROUP // WIDTH * table + group * GROUP % WIDTH
        lobe, square = Tables(shared.nodes, kind, flat, WIDTH), Tables(shared.nodes, kind + 2 * flat, flat, WIDTH)
        _eight_times_nodes(
            Place(rows, WEIGHTED_RESPONSE * row), captures, lobe, Place(sums, into + RG * step), (RG1 - RG) * step
        )
        if changed:
            _eight_times_nodes(
                Place(rows, WEIGHTED_COSINE * row), captures, lobe, Place(sums, into + CG * step), (CG1 - CG) * step
            )
            _eight_times_nodes(
                Place(rows, WEIGHT * row), captures, square, Place(sums, into + GG * step), (GG1 - GG) * step
            )
