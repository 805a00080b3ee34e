"""Responses, expected variances and weights of one texel or of eight, in the rows that the solvers read.

The rows are described in `irodori.fitting.texel_rows`. *Lanes* are vectors with one number for each of eight texels.
"""

from typing import NamedTuple

import numpy as np

from irodori.fitting.texel_rows import (
    ASSUMED,
    BEFORE,
    COSINE,
    F0,
    F1,
    F2,
    GLOSS,
    RESPONSE,
    SPOILED,
    VARIANCE,
    WEIGHT,
    WEIGHTED_COSINE,
    WEIGHTED_RESPONSE,
    all_of,
    folded,
    get,
    highest,
    item,
    noise_at,
    padded,
    put,
    vectors_of,
)
from irodori.jit.compilation import njit, uncounted
from irodori.jit.functions import lower_of, magnitude, negated, select, upper_of
from irodori.jit.vector_memory import mask_bits, spread
from irodori.jit.vectors import LANES
from irodori.reflection import lobes as lobe_kernels

LEAST_VARIANCE = 1e-8  # smallest variance relative to the mean square response, which limits the ratio of weights
TINY = 1e-60
LARGE = 1e30  # weights larger than this, or smaller than its inverse on average, are divided by the largest
_SAME = 1e-6  # tolerance for equal geometries: rounding errors of cosine, features and gloss in single precision
_ROUNDS = 4  # iterations for the diffuse level
ENOUGH = 4  # different geometries that determine three unknowns and leave one to test the model


class Rules(NamedTuple):
    """Bounds of the parameters, and expected errors of the observations.

    Parameters
    ----------
    low_alpha, high_alpha, low_beta, high_beta, low_log_mu, high_log_mu : float
    known : bool
        Whether the camera's noise was measured; if it was, observations are weighted by inverse variance.
    model_error : float
        Relative error of an observation apart from noise.
    incidence_variance, phi_variance : float
        Variances of θ_i and φ due to errors of the geometry, rad².
    level_error : float
        Relative error common to all observations: that of the white reference's reflectance, and the change of the
        lamp's level between the photographs of white reference and object.
    """

    low_alpha: float
    high_alpha: float
    low_beta: float
    high_beta: float
    low_log_mu: float
    high_log_mu: float
    known: bool
    model_error: float
    incidence_variance: float
    phi_variance: float
    level_error: float


class Screened(NamedTuple):
    """Sums over the valid observations of one texel or of eight; float or lanes.

    Parameters
    ----------
    used : float or lanes
        Number of valid observations.
    total, power : float or lanes
        Σ w and Σ w ρ².
    largest : float or lanes
        Largest weight.
    """

    used: float
    total: float
    power: float
    largest: float


class Evidence(NamedTuple):
    """Weighted sums over the observations of one texel, or of each of eight, that do not depend on the lobe.

    Parameters
    ----------
    used : int or lanes
        Number of observations with weight; if they have fewer than `ENOUGH` different geometries, the number of these.
    floor : float or lanes
        Expected weighted square of a residual.
    fixed : tuple of four
        Σ w c², Σ w c ρ, Σ w ρ², Σ w.
    """

    used: int
    floor: float
    fixed: tuple


class Minimum(NamedTuple):
    """Parameters at a minimum of the sum of squares, and the evaluations of the objective; numbers or lanes."""

    alpha: float
    beta: float
    log_mu: float
    evaluations: int


@njit(cache=True, forceinline=True)
def box_of(rules):
    """Return lower and upper bound of α, then of β."""
    return rules.low_alpha, rules.high_alpha, rules.low_beta, rules.high_beta


def camera_noise(model, captures: int) -> tuple[np.ndarray, bool]:
    """Return c0 and c1 of every capture in padded rows, (2, P), and whether they are known: given and finite.

    Raises
    ------
    ValueError
        If a coefficient is negative.
    """
    out = np.zeros((2, padded(captures)))
    if model is not None and (np.asarray(model) < 0.0).any():
        raise ValueError(f"noise model with a coefficient of {np.nanmin(model):.3g}; accepted: 0 or more")
    known = model is not None and bool(np.isfinite(model).all())
    if known:
        out[:, :captures] = np.asarray(model, dtype=np.float64).T
    return out, known


@uncounted(error_model="numpy")
def screen(rows, zero):
    """Set responses and weights of invalid observations to 0, and return the `Screened` sums of the others.

    Observations are invalid if a value is not finite or the weight is not positive.
    """
    used, total, power, largest = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for j in range(vectors_of(rows)):
        given, trust = get(rows, RESPONSE, j), get(rows, WEIGHT, j)
        fine = (magnitude(given + get(rows, SPOILED, j)) < np.inf) & (trust > 0.0) & (trust < np.inf)
        r, t = select(fine, given, 0.0), select(fine, trust, 0.0)
        put(rows, RESPONSE, j, r)
        put(rows, WEIGHT, j, t)
        used = used + select(fine, 1.0, 0.0)
        largest = upper_of(largest, t)
        total = total + t
        power = power + t * r * r
    return Screened(folded(used, zero), folded(total, zero), folded(power, zero), highest(largest, zero))


@njit(cache=True, error_model="numpy", forceinline=True)
def in_range(screened):
    """Return whether the squares of the weights stay within the range of floating-point numbers."""
    return (screened.largest <= LARGE) & (screened.total * LARGE >= screened.used)


@uncounted(error_model="numpy")
def _diffuse_level(rows, zero):
    """Estimate α roughly by a weighted mean in which each response is limited to twice the diffuse level.

    A single response near 0 hardly lowers it, and a highlight hardly raises it.
    """
    level = zero + LARGE
    for _ in range(_ROUNDS):
        top, bottom = spread(0.0), spread(TINY)
        for j in range(vectors_of(rows)):
            c, w = get(rows, COSINE, j), get(rows, WEIGHT, j)
            top = top + w * c * lower_of(get(rows, RESPONSE, j), 2.0 * level * c)
            bottom = bottom + w * c * c
        level = folded(top, zero) / folded(bottom, zero)
    return upper_of(level, 0.0)


@uncounted(error_model="numpy")
def expect_noise(rows, noise, rules, screened, zero):
    """Fill the expected variances of the responses and the weights; return the expected weighted square of a residual.

    Variances are computed for at least half of the diffuse level: otherwise the variance of a response that is low by
    mistake, such as one in shadow, would be so small that it dominated the fit.
    """
    power = screened.power / select(screened.total > 0.0, screened.total, 1.0)
    relative = rules.model_error * rules.model_error
    common = TINY + (LEAST_VARIANCE if rules.known else relative) * power
    relative = relative if rules.known else 0.0
    least = 0.5 * _diffuse_level(rows, zero)
    floor = spread(0.0)
    for j in range(vectors_of(rows)):
        w = get(rows, WEIGHT, j)
        r = upper_of(get(rows, RESPONSE, j), least * get(rows, COSINE, j))
        put(rows, ASSUMED, j, r)
        v = common + noise_at(noise, 0, j, zero) + noise_at(noise, 1, j, zero) * upper_of(r, 0.0) + relative * r * r
        put(rows, VARIANCE, j, v)
        if rules.known:
            w = w / v
            put(rows, WEIGHT, j, w)
        floor = floor + w * v
    return folded(floor, zero) / upper_of(screened.used, 1.0)


@uncounted(error_model="numpy")
def _rescale(rows, screened):
    """Divide the weights by the largest, so that their squares stay in range; return the new `Screened` sums."""
    total, power, largest = 0.0, 0.0, screened.largest
    for j in range(rows.shape[1]):
        w = rows[WEIGHT, j] / largest if largest > 0.0 else 0.0
        rows[WEIGHT, j] = w
        total += w
        power += w * rows[RESPONSE, j] * rows[RESPONSE, j]
    return Screened(screened.used, total, power, largest)


@uncounted(error_model="numpy")
def load_one(response, weight, noise, rules, rows):
    """Fill responses, variances and weights of one texel.

    Returns
    -------
    used : int
        Number of observations with weight.
    floor : float
        Expected weighted square of a residual.
    """
    for j in range(response.size):
        rows[RESPONSE, j], rows[WEIGHT, j] = response[j], weight[j]
    for j in range(response.size, rows.shape[1]):
        rows[RESPONSE, j], rows[WEIGHT, j] = 0.0, 0.0
    screened = screen(rows, 0.0)
    if not in_range(screened):
        screened = _rescale(rows, screened)
    return int(screened.used), expect_noise(rows, noise, rules, screened, 0.0)


@uncounted(error_model="numpy")
def load_eight(problem, rules, first, last, rows):
    """Fill responses, variances and weights of eight texels; beyond the end, the last texel is repeated.

    Returns
    -------
    used, floor : lanes
        As from `load_one`.
    ordinary : mask
        Texels with weights that need no rescaling.
    """
    for j in range(problem.response.shape[1]):
        if first + LANES <= last:
            for i in range(LANES):
                rows[RESPONSE, j * LANES + i] = problem.response[first + i, j]
            for i in range(LANES):
                rows[WEIGHT, j * LANES + i] = problem.weight[first + i, j]
        else:
            for i in range(LANES):
                t = min(first + i, last - 1)
                rows[RESPONSE, j * LANES + i], rows[WEIGHT, j * LANES + i] = (
                    problem.response[t, j],
                    problem.weight[t, j],
                )
    zero = spread(0.0)
    screened = screen(rows, zero)
    floor = expect_noise(rows, problem.noise, rules, screened, zero)
    return screened.used, floor, in_range(screened) & (screened.total > 0.0)


@uncounted(error_model="numpy")
def expect_fitted(rows, problem, rules, found, which):
    """Recompute variances and weights of observations from the fitted responses instead of the noisy ones.

    Otherwise a response that is too low by chance gets too small a variance, and too large a weight.

    Parameters
    ----------
    rows : (ROWS, P) float64
    problem : irodori.fitting.texels.Problem
    rules : Rules
    found : Minimum
    which : mask
        Lanes to change.
    """
    lobes, log_mu = problem.lobes, found.log_mu
    constant, relative = lobe_kernels.constants(lobes, log_mu), rules.model_error * rules.model_error
    for j in range(vectors_of(rows)):
        r, v, w = get(rows, ASSUMED, j), get(rows, VARIANCE, j), get(rows, WEIGHT, j)
        value = lobe_kernels.value(lobes, constant, get(rows, F0, j), get(rows, F1, j), get(rows, F2, j))
        fitted = found.alpha * get(rows, COSINE, j) + found.beta * get(rows, GLOSS, j) * value
        slope = noise_at(problem.noise, 1, j, log_mu)
        u = v + slope * (fitted - upper_of(r, 0.0)) + relative * (fitted * fitted - r * r)
        u = select(which, upper_of(u, LEAST_VARIANCE * v), v)
        put(rows, ASSUMED, j, select(which, fitted, r))
        put(rows, VARIANCE, j, u)
        put(rows, WEIGHT, j, select(which, w * v / u, w))


@njit(cache=True, forceinline=True)
def every_lane():
    """Return a mask with all lanes set."""
    return spread(0.0) == 0.0


@njit(cache=True, error_model="numpy", forceinline=True)
def _is_same(one, other):
    """Return whether two geometries, each cosθ_i, three features and gloss, are equal; numbers or lanes."""
    near = (magnitude(one[0] - other[0]) <= _SAME) & (magnitude(one[1] - other[1]) <= _SAME)
    near = near & (magnitude(one[2] - other[2]) <= _SAME) & (magnitude(one[3] - other[3]) <= _SAME)
    return near & (magnitude(one[4] - other[4]) <= _SAME * (1.0 + one[4]))


@njit(cache=True, forceinline=True)
def _replaced(mask, now, before):
    return (
        select(mask, now[0], before[0]), select(mask, now[1], before[1]), select(mask, now[2], before[2]),
        select(mask, now[3], before[3]), select(mask, now[4], before[4]),
    )  # fmt: skip


@uncounted(error_model="numpy")
def distinct_geometries(rows, observations, zero):
    """Count the different lit geometries of observations with weight, up to `ENOUGH`.

    A repeated geometry reduces noise but adds no further equation; an unlit one gives no information.
    """
    none, count = zero + np.nan, zero
    first = (none, none, none, none, none)
    second, third = first, first
    for j in range(observations):
        now = (
            item(rows, COSINE, j, zero), item(rows, F0, j, zero), item(rows, F1, j, zero), item(rows, F2, j, zero),
            item(rows, GLOSS, j, zero),
        )  # fmt: skip
        known = _is_same(now, first) | _is_same(now, second) | _is_same(now, third)
        lit = (now[0] > 0.0) | (now[4] > 0.0)
        new = (item(rows, WEIGHT, j, zero) > 0.0) & lit & negated(known)
        third = _replaced(new & (count == 2.0), now, third)
        second = _replaced(new & (count == 1.0), now, second)
        first = _replaced(new & (count == 0.0), now, first)
        count = select(new, count + 1.0, count)
        if all_of(count >= float(ENOUGH)):
            break
    return count


@uncounted(error_model="numpy")
def telling(rows, observations, used):
    """Return the number of a texel's observations with weight, or of their geometries if fewer than `ENOUGH` differ."""
    count = distinct_geometries(rows, observations, 0.0)
    return used if count >= ENOUGH else int(count)


@uncounted(error_model="numpy")
def weigh(rows, zero):
    """Fill the rows of weighted cosines and responses; return Σ w c², Σ w c ρ, Σ w ρ², Σ w."""
    cc, cr, rr, total = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for j in range(vectors_of(rows)):
        w, c, r = get(rows, WEIGHT, j), get(rows, COSINE, j), get(rows, RESPONSE, j)
        wc, wr = w * c, w * r
        put(rows, WEIGHTED_COSINE, j, wc)
        put(rows, WEIGHTED_RESPONSE, j, wr)
        cc = cc + wc * c
        cr = cr + wc * r
        rr = rr + wr * r
        total = total + w
    return folded(cc, zero), folded(cr, zero), folded(rr, zero), folded(total, zero)


@uncounted()
def weights_changed(rows):
    """Return whether weights differ from those at the last call."""
    same = every_lane()
    for j in range(vectors_of(rows)):
        w = get(rows, WEIGHT, j)
        same = same & (w == get(rows, BEFORE, j))
        put(rows, BEFORE, j, w)
    return mask_bits(same) != 255
