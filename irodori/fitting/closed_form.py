"""Closed-form α and β for a given roughness μ, which reduces the fit to a function of t = log μ [eq. 7].

Φ(t) is the sum of squares with the best bounded pair (α, β). By the envelope theorem, its slope is the partial
derivative along t at this pair. Its curvature is the Schur complement of the full Hessian over the variables that are
not at a bound (variable projection: Golub and Pereyra 1973).

The sums over observations are passed as ``fixed`` = (Σ w c², Σ w c ρ, Σ w ρ², Σ w), with c = cosθ_i, and as
``moments``: value, slope and curvature along t of Σ w c g, of Σ w ρ g and of Σ w g², with g = F G D / cosθ_r. Arguments
and results may be numbers, or lanes: vectors with one number for each of eight texels.
"""

from irodori.jit.compilation import njit
from irodori.jit.functions import lower_of, negated, select, upper_of

_PARALLEL = 1e-13  # smallest sin² of the angle between the columns of α and β for which the two can be separated
_TINY = 1e-300


@njit(cache=True, error_model="numpy", forceinline=True)
def clamp(x, low, high):
    """Clamp a number, or lanes, to bounds."""
    return lower_of(upper_of(x, low), high)


@njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy", forceinline=True)
def best_pair(fixed, cg, rg, gg, box):
    """Return the bounded α and β that minimise the sum of squares, and the minimum; computed without branches.

    If the unbounded minimum lies outside the box, the bounded minimum lies on an edge whose bound the unbounded one
    violates. It is the better of two candidates, each optimal on its edge.

    Parameters
    ----------
    fixed : tuple of four
        Σ w c², Σ w c ρ, Σ w ρ², Σ w.
    cg, rg, gg : float
        Σ w c g, Σ w ρ g, Σ w g².
    box : (4,) tuple
        Lower and upper bound of α, then of β.
    """
    cc, cr, rr, _ = fixed
    determinant = cc * gg - cg * cg
    regular = determinant > _PARALLEL * cc * gg
    scale = 1.0 / select(regular, determinant, 1.0)
    free_a = select(regular, (cr * gg - rg * cg) * scale, box[0])
    free_b = select(regular, (rg * cc - cr * cg) * scale, box[2])
    b1 = clamp(free_b, box[2], box[3])
    a1 = clamp((cr - b1 * cg) / (cc + _TINY), box[0], box[1])
    a2 = clamp(free_a, box[0], box[1])
    b2 = clamp((rg - a2 * cg) / (gg + _TINY), box[2], box[3])
    v1 = rr + a1 * (a1 * cc - 2.0 * cr) + b1 * (b1 * gg + 2.0 * (a1 * cg - rg))
    v2 = rr + a2 * (a2 * cc - 2.0 * cr) + b2 * (b2 * gg + 2.0 * (a2 * cg - rg))
    first = v1 <= v2
    return select(first, a1, a2), select(first, b1, b2), upper_of(select(first, v1, v2), 0.0)


@njit(cache=True, error_model="numpy")
def slope_and_curvature(fixed, moments, box):
    """Return the best α and β at one t, their slopes along t, and the derivatives Φ' and Φ''."""
    cc = fixed[0]
    cg, cg1, cg2, rg, rg1, rg2, gg, gg1, gg2 = moments
    a, b, _ = best_pair(fixed, cg, rg, gg, box)
    cross = a * cg1 - rg1
    slope = b * (b * gg1 + 2.0 * cross)
    curvature = b * (b * gg2 + 2.0 * (a * cg2 - rg2))
    at, bt = 2.0 * b * cg1, 2.0 * (b * gg1 + cross)
    free_a, free_b = (a > box[0]) & (a < box[1]), (b > box[2]) & (b < box[3])
    both, determinant = free_a & free_b, cc * gg - cg * cg
    regular = determinant > _PARALLEL * cc * gg
    scale = 0.5 / select(regular, determinant, 1.0)
    da = select(both, (cg * bt - gg * at) * scale, select(free_a, -0.5 * at / (cc + _TINY), 0.0))
    db = select(both, (cg * at - cc * bt) * scale, select(free_b, -0.5 * bt / (gg + _TINY), 0.0))
    da, db = select(both & negated(regular), 0.0, da), select(both & negated(regular), 0.0, db)
    return a, b, da, db, slope, curvature + at * da + bt * db
