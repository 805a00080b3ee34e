"""Gloss lobe of equation (5) as four round lobes, tabulated for look-up at every hit.

`irodori.light.gloss.lobe_table` has up to forty lobes to each entry of a table, of which a look-up mixes four entries.
Here the lobe D G / cosθ_r is a row of four Gaussians of the sphere in the plane of incidence, of one width and evenly
spaced: mean, spread along the plane and spread across it are those of the true lobe (where it is very long the row is
as long as four lobes may be without gaps), the weights are least squares of its shape and of its first and second
moments. All entries have the same form, so the parameters of one look-up are interpolated, not its results.
"""

import math
from functools import lru_cache

import numpy as np
from scipy.optimize import nnls

from irodori.light.blurred_light import WIDTHS_RAD
from irodori.light.gloss.make_lobe_table import lobe_samples
from irodori.reflection.equation5 import MU_MAX_RAD, MU_MIN_RAD
from irodori.reflection.fresnel import fresnel

TAPS = 4
#: Entries over ln μ and over the square root of cosθ_r.
ROUGHNESSES, ANGLES = 17, 17
#: Numbers an entry: level, then for each tap its weight, its place p and cosθ_H; padded to a vector.
ENTRY = 16
_LONGEST = 7.0  # variance of the row over that of a lobe in it
_NODES = (48, 32)
_ENERGY_WEIGHT = 3.0
_MOMENT_WEIGHTS = np.array([5.0, 5.0, 2.5, 2.5, 2.5])  # mean direction; then squares and product of its coordinates
_EVEN_WEIGHT = 0.02  # keeps the weights of lobes that nearly coincide from being any
_INDEX = 1.5  # for which the mean Fresnel reflectance of a lobe is kept
_COSINES = np.linspace(0.0, 1.0, 2001)


def roughness_place(mu_rad) -> np.ndarray:
    """Return the place in the table of roughnesses, 0..ROUGHNESSES - 1; held at the bounds of μ."""
    mu = np.clip(mu_rad, MU_MIN_RAD, MU_MAX_RAD)
    return np.log(mu / MU_MIN_RAD) * ((ROUGHNESSES - 1) / math.log(MU_MAX_RAD / MU_MIN_RAD))


def roughness_at(place):
    """Return μ, rad, at a place in the table."""
    return MU_MIN_RAD * np.exp(np.asarray(place) * (math.log(MU_MAX_RAD / MU_MIN_RAD) / (ROUGHNESSES - 1)))


@lru_cache(maxsize=1)
def _reflectance() -> np.ndarray:
    """Return the Fresnel reflectance of the index `_INDEX` at `_COSINES`, falling."""
    return np.array([fresnel(float(cosine), _INDEX, 0.0) for cosine in _COSINES])


def _moments(angle: np.ndarray, kappa: float) -> np.ndarray:
    """Return the means of x, z, x², z² and x z over lobes of concentration κ, (5, lobes)."""
    mean = 1.0 / math.tanh(kappa) - 1.0 / kappa
    even, along = mean / kappa, 1.0 - 3.0 * mean / kappa
    x, z = np.sin(angle), np.cos(angle)
    return np.stack([mean * x, mean * z, even + along * x * x, even + along * z * z, along * x * z])


def _moments_of(direction: np.ndarray, share: np.ndarray) -> np.ndarray:
    x, z = direction[:, 0], direction[:, 2]
    return share @ np.stack([x, z, x * x, z * z, x * z], axis=1)


def fit_row(mu: float, theta_r: float) -> tuple[float, np.ndarray, np.ndarray, np.ndarray, float, float]:
    """Fit the row of one lobe.

    Returns
    -------
    width : float, rad
    angle : (4,) of the axes from the normal, away from the view, rad
    weight : (4,) whose sum is 1
    cos_h : (4,) cosine of the incidence θ_H at which each one's light is reflected
    power : float, ∫ D G / cosθ_r dω
    distance : float, ∫ |row - lobe| dω / ∫ lobe dω
    """
    direction, value, cos_h, solid_angle = lobe_samples(mu, theta_r, _NODES)
    share = value * solid_angle
    power = float(share.sum())
    share = share / power
    middle = math.atan2(float(share @ direction[:, 0]), float(share @ direction[:, 2]))
    along = np.arcsin(np.clip(direction[:, 0] * math.cos(middle) - direction[:, 2] * math.sin(middle), -1.0, 1.0))
    across = np.arcsin(np.clip(direction[:, 1], -1.0, 1.0))
    long, short = float(share @ along**2), float(share @ across**2)
    variance = max(short, long / _LONGEST)
    spacing = math.sqrt(max(long - variance, 0.0) / ((TAPS**2 - 1) / 12.0))
    angle = np.minimum(middle + spacing * (np.arange(TAPS) - 0.5 * (TAPS - 1)), 0.5 * np.pi - 1e-3)
    kappa = 1.0 / variance
    cosine = direction[:, :1] * np.sin(angle) + direction[:, 2:] * np.cos(angle)
    shapes = kappa / (2 * np.pi * -np.expm1(-2 * kappa)) * np.exp(kappa * (cosine - 1.0))
    scale = np.sqrt(solid_angle) / math.sqrt(float(((value / power) ** 2 * solid_angle).sum()))
    moments, wanted = _moments(angle, kappa), _moments_of(direction, share)
    rows = [shapes * scale[:, None], np.full((1, TAPS), _ENERGY_WEIGHT), _EVEN_WEIGHT * np.eye(TAPS)]
    rows.append(moments * _MOMENT_WEIGHTS[:, None])
    targets = [value / power * scale, [_ENERGY_WEIGHT], np.zeros(TAPS), wanted * _MOMENT_WEIGHTS]
    weight = nnls(np.vstack(rows), np.concatenate(targets))[0]
    weight /= weight.sum()
    parts = shapes * weight
    found = parts.sum(axis=1)
    distance = float((np.abs(found - value / power) * solid_angle).sum())
    parts = parts / np.maximum(found, 1e-300)[:, None] * share[:, None]
    # The angle at which a lacquer reflects the mean over the part of the lobe that each one stands for, and all
    # together what the lobe does.
    lacquer = _reflectance()
    reflected = np.interp(cos_h, _COSINES, lacquer)
    mean = parts.T @ reflected / np.maximum(parts.sum(axis=0), 1e-300)
    mean = np.where(weight > 0.0, mean * float(share @ reflected) / float(weight @ mean), lacquer[-1])
    incidence = np.interp(mean, lacquer[::-1], _COSINES[::-1])
    return math.sqrt(variance), angle, weight, incidence, power, distance


@lru_cache(maxsize=1)
def lobe_table() -> tuple[np.ndarray, np.ndarray]:
    """Return the table for compiled loops, and the distances of its entries.

    Returns
    -------
    table : (ROUGHNESSES, ANGLES, ENTRY) float32
        Level of `irodori.light.blurred_light.WIDTHS_RAD`, fractional; then weight, place p and cosθ_H of each tap. A
        weight is the power over π μ². With R the mirror direction and N the normal the axis is p R + q N, its angle
        from N has the sine p sinθ_r.
    distance : (ROUGHNESSES, ANGLES) float64
    """
    table = np.zeros((ROUGHNESSES, ANGLES, ENTRY), dtype=np.float32)
    distance = np.empty((ROUGHNESSES, ANGLES))
    # At the ends of the ladder of angles the limit is taken from a little inside.
    cosine = np.clip(np.linspace(0.0, 1.0, ANGLES) ** 2, 2e-3, math.cos(1e-2))
    for i, mu in enumerate(roughness_at(np.arange(ROUGHNESSES))):
        for j, theta_r in enumerate(np.arccos(cosine)):
            width, angle, weight, cos_h, power, distance[i, j] = fit_row(float(mu), float(theta_r))
            table[i, j, 0] = 2.0 * math.log2(width / WIDTHS_RAD[0])
            table[i, j, 1 : 1 + 3 * TAPS : 3] = weight * power / (np.pi * mu**2)
            table[i, j, 2 : 1 + 3 * TAPS : 3] = np.sin(angle) / math.sin(theta_r)
            table[i, j, 3 : 1 + 3 * TAPS : 3] = cos_h
    return table, distance
