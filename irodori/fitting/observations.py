"""Observations of one texel as the solvers take them: responses, expected variances, weights."""

import math
from typing import NamedTuple

import numpy as np

from irodori.fitting.texel_rows import (
    CONSTANT,
    COSINE,
    FAST,
    GLOSS,
    RESPONSE,
    SLOPE,
    SPOILED,
    SQUARE,
    TRUST,
    VARIANCE,
    WEIGHT,
    WEIGHTED_COSINE,
    WEIGHTED_RESPONSE,
    exp_negative,
    padded,
)
from irodori.jit.lanes import magnitude
from irodori.jit.native import njit

LEAST_VARIANCE = 1e-8  # of the mean square response: no observation counts ten thousand times another
TINY = 1e-60
LARGE = 1e30  # a common weight beyond this, or below its inverse, is taken out
_SAME = 1e-6  # of cosine, φ² and gloss: what single precision makes of one angle
ENOUGH = 4  # geometries that determine three unknowns and can object to them


class Rules(NamedTuple):
    """What is allowed, and what is known about the scatter of an observation; numbers only.

    Parameters
    ----------
    low_alpha, high_alpha, low_beta, high_beta, low_log_mu, high_log_mu : float
    known : bool
        Whether the camera's noise was measured.
    weighted : bool
        Whether observations count by inverse variance; needs ``known``.
    model_error : float
        Relative error of an observation apart from noise.
    pose_variance : float
        Of one angle of the rig, rad².
    huber : float
        Residual in standard deviations beyond which an observation counts for less; 0 for none.
    """

    low_alpha: float
    high_alpha: float
    low_beta: float
    high_beta: float
    low_log_mu: float
    high_log_mu: float
    known: bool
    weighted: bool
    model_error: float
    pose_variance: float
    huber: float

    @property
    def box(self):
        """Bounds of α, then of β."""
        return self.low_alpha, self.high_alpha, self.low_beta, self.high_beta


def camera_noise(model, captures: int) -> tuple[np.ndarray, bool]:
    """Return c0 and c1 of every capture in padded rows, (2, P), and whether they are known: given and finite.

    Raises
    ------
    ValueError
        If one is negative: a variance is not.
    """
    out = np.zeros((2, padded(captures)))
    if model is not None and (np.asarray(model) < 0.0).any():
        raise ValueError(f"noise model with a coefficient of {np.nanmin(model):.3g}; accepted: 0 or more")
    known = model is not None and bool(np.isfinite(model).all())
    if known:
        out[:, :captures] = np.asarray(model, dtype=np.float64).T
    return out, known


@njit(cache=True, error_model="numpy")
def _rescale(block, largest):
    """Divide weights whose squares would leave the range of numbers by the largest; return Σ w and Σ w ρ²."""
    total, power = 0.0, 0.0
    for j in range(block.shape[1]):
        t = block[TRUST, j] / largest if largest > 0.0 else 0.0
        block[TRUST, j] = t
        total += t
        power += t * block[RESPONSE, j] * block[RESPONSE, j]
    return total, power


@njit(cache=True, fastmath=FAST, error_model="numpy")
def load(response, weight, rules, block):
    """Fill responses, variances and weights of a texel.

    Returns
    -------
    used : int
        Observations with weight.
    lost : int
        Observations that would have weight, were they finite.
    floor : float
        Expected weighted square of a residual.
    """
    used, offered, total, power, largest = 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(response.size):
        given, trust = np.float64(response[j]), np.float64(weight[j])
        fine = abs(given + block[SPOILED, j]) < np.inf and trust > 0.0 and trust < np.inf
        r = given if fine else 0.0
        t = trust if fine else 0.0
        block[RESPONSE, j], block[TRUST, j] = r, t
        used += 1.0 if fine else 0.0
        offered += 0.0 if trust <= 0.0 else 1.0
        largest = t if t > largest else largest
        total += t
        power += t * r * r
    if largest > LARGE or total < used / LARGE:
        total, power = _rescale(block, largest)
    power /= total if total > 0.0 else 1.0
    relative = rules.model_error * rules.model_error
    common = TINY + (LEAST_VARIANCE if rules.known else relative) * power
    relative = relative if rules.known else 0.0
    floor = 0.0
    for j in range(block.shape[1]):
        r = block[RESPONSE, j]
        v = common + block[CONSTANT, j] + block[SLOPE, j] * (r if r > 0.0 else 0.0) + relative * r * r
        block[VARIANCE, j] = v
        w = block[TRUST, j] / (v if rules.weighted else 1.0)
        block[TRUST, j] = w
        block[WEIGHT, j] = w
        floor += w * v
    return int(used), int(offered - used), floor / max(used, 1.0)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def expect(block, a, b, log_mu, rules):
    """Weigh observations by the variance that the fitted response calls for, not the one with its noise.

    A reading that is too low by chance has too small a variance, and counts for too much.
    """
    factor = -math.exp(-2.0 * log_mu)
    relative = rules.model_error * rules.model_error
    for j in range(block.shape[1]):
        r, v = block[RESPONSE, j], block[VARIANCE, j]
        fitted = a * block[COSINE, j] + b * block[GLOSS, j] * exp_negative(block[SQUARE, j] * factor)
        given = r if r > 0.0 else 0.0
        u = v + block[SLOPE, j] * (fitted - given) + relative * (fitted * fitted - r * r)
        least = LEAST_VARIANCE * v
        u = u if u > least else least
        block[VARIANCE, j] = u
        block[TRUST, j] *= v / u
        block[WEIGHT, j] = block[TRUST, j]


@njit(cache=True, error_model="numpy")
def telling(block, used):
    """Return the number of observations with weight, or of their geometries where these are fewer than `ENOUGH`.

    A repeated geometry adds certainty to what it tells, and nothing else; one that carries no light tells nothing.
    """
    count, first, second, third = 0, 0, 0, 0
    for j in range(block.shape[1]):
        if not (block[WEIGHT, j] > 0.0 and (block[COSINE, j] > 0.0 or block[GLOSS, j] > 0.0)):
            continue
        if count > 0 and _same(block, j, first):
            continue
        if count > 1 and _same(block, j, second):
            continue
        if count > 2 and _same(block, j, third):
            continue
        count += 1
        if count == ENOUGH:
            return used
        if count == 1:
            first = j
        elif count == 2:
            second = j
        else:
            third = j
    return count


@njit(cache=True, error_model="numpy", inline="always")
def is_same(one, other):
    """Return whether two geometries, each cosθ_i, φ², F G / cosθ_r, are one; numbers or lanes."""
    near = (magnitude(one[0] - other[0]) <= _SAME) & (magnitude(one[1] - other[1]) <= _SAME)
    return near & (magnitude(one[2] - other[2]) <= _SAME * (1.0 + one[2]))


@njit(cache=True, error_model="numpy", inline="always")
def _same(block, i, j):
    return is_same(
        (block[COSINE, i], block[SQUARE, i], block[GLOSS, i]), (block[COSINE, j], block[SQUARE, j], block[GLOSS, j])
    )


@njit(cache=True, fastmath=FAST, error_model="numpy")
def weigh(block):
    """Fill the weighted rows and return Σ w c², Σ w c ρ, Σ w ρ², Σ w."""
    cc, cr, rr, total = 0.0, 0.0, 0.0, 0.0
    for j in range(block.shape[1]):
        w, c, r = block[WEIGHT, j], block[COSINE, j], block[RESPONSE, j]
        block[WEIGHTED_COSINE, j] = w * c
        block[WEIGHTED_RESPONSE, j] = w * r
        cc += w * c * c
        cr += w * c * r
        rr += w * r * r
        total += w
    return cc, cr, rr, total


def pose_variance(pose_error_deg: float) -> float:
    """Return the variance of one angle of the rig, rad²."""
    return math.radians(pose_error_deg) ** 2
