"""Search for single observations that contradict the model, such as one in an unmodelled shadow.

The sums of the scan without one observation follow from the sums with all by a subtraction. So the least sum of squares
without each observation is found over the whole range of μ, at the cost of about two more scans. It does not matter how
far the outlier has pulled the fit away.
"""

import numpy as np

from irodori.fitting.closed_form import best_pair
from irodori.fitting.texel_rows import (
    COSINE,
    F0,
    F1,
    F2,
    GLOSS,
    LOBE,
    RESPONSE,
    WEIGHT,
    get,
    put,
    vectors_of,
)
from irodori.fitting.varpro import CG, CG1, GG, GG1, RG, RG1, interval_minimum
from irodori.jit.compilation import uncounted
from irodori.jit.functions import lower_of, select
from irodori.jit.vector_memory import spread
from irodori.reflection import lobes as lobe_kernels


@uncounted(error_model="numpy")
def least_without(rows, problem, fixed, box, sums):
    """Fill the row `LOBE` with the least sum of squares without each observation; infinite if it has no weight.

    Parameters
    ----------
    rows : (ROWS, P) float64
        Rows of one texel.
    problem : irodori.fitting.texels.Problem
    fixed : tuple of four
        Σ w c², Σ w c ρ, Σ w ρ², Σ w.
    box : (4,) tuple
        Bounds of α, then of β.
    sums : (SUMS, nodes) float64
        Sums of the scan with all observations.
    """
    lobes, nodes = problem.lobes, problem.nodes
    for j in range(vectors_of(rows)):
        c, r, w, plain = get(rows, COSINE, j), get(rows, RESPONSE, j), get(rows, WEIGHT, j), get(rows, GLOSS, j)
        f0, f1, f2 = get(rows, F0, j), get(rows, F1, j), get(rows, F2, j)
        wc, wr = w * c, w * r
        rest = (fixed[0] - wc * c, fixed[1] - wc * r, fixed[2] - wr * r, fixed[3] - w)
        least = spread(0.0) + np.inf
        above, above_slope = least, spread(0.0)
        for i in range(nodes.size):
            value, slope, _ = lobe_kernels.derivatives(lobes, lobe_kernels.constants(lobes, nodes[i]), f0, f1, f2)
            g, g1 = plain * value, plain * slope
            cg, rg, gg = sums[CG, i] - wc * g, sums[RG, i] - wr * g, sums[GG, i] - w * g * g
            a, b, now = best_pair(rest, cg, rg, gg, box)
            cg1, rg1, gg1 = sums[CG1, i] - wc * g1, sums[RG1, i] - wr * g1, sums[GG1, i] - 2.0 * w * g * g1
            descent = b * (b * gg1 + 2.0 * (a * cg1 - rg1))
            if i > 0:
                between, _ = interval_minimum(nodes[i - 1] - nodes[i], now, above, descent, above_slope)
                least = lower_of(least, between)
            least = lower_of(least, now)
            above, above_slope = now, descent
        put(rows, LOBE, j, select(w > 0.0, least, np.inf))


@uncounted()
def two_least(rows):
    """Return the two observations without which the sum of squares is least; the second is -1 if there is only one."""
    first, second = 0, -1
    for j in range(1, rows.shape[1]):
        if rows[LOBE, j] < rows[LOBE, first]:
            first, second = j, first
        elif rows[LOBE, j] < np.inf and (second < 0 or rows[LOBE, j] < rows[LOBE, second]):
            second = j
    return first, second
