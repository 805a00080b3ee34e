"""The gloss lobe of equation (5) as few Gaussians of the sphere, so that a look-up in blurred light integrates it.

D G / cosθ_r is fitted, for a ladder of roughnesses and view angles, by a sum with non-negative weights of the lobes of
`irodori.prefilter` with their axes in the plane of incidence. At grazing view the true lobe is long in that plane and
narrow across, so several narrow lobes stand in a row there. Each keeps the angle θ_H at which its light is reflected,
and the Fresnel reflectance F(n, k, θ_H) multiplies it at look-up: one table serves every refractive index.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numba
import numpy as np
from scipy.optimize import nnls

from irodori.brdf import MU_MAX_RAD, attenuation_over_cosine, facet_distribution
from irodori.prefilter import WIDTHS_RAD

#: Roughnesses of the ladder, rad, a factor √2 apart: at normal view the lobe is as wide as a level of blurred light.
MU_RAD = np.minimum(WIDTHS_RAD / math.sqrt(2.0), MU_MAX_RAD)
#: View angles of the ladder, rad.
THETA_R_RAD = np.radians([0.0, 20.0, 40.0, 50.0, 60.0, 67.5, 75.0, 80.0, 84.0, 87.0, 89.0])
_TAPS = 12
_NODES = (28, 28)  # of the quadrature over φ and over the azimuth of the half vector
_REACH = 3.5  # roughnesses over which the lobe is fitted
_FINER, _COARSER = 5, 1  # levels about the lobe's own from which it is made
_ENERGY_WEIGHT = 3.0


class Lobes(NamedTuple):
    """The fitted table, over roughnesses and view angles; a weight of 0 is no lobe.

    ``weight`` is ∫ D G / cosθ_r dω of the part divided by π μ². ``offset`` (rad) is the axis' angle from the normal,
    away from the view, less θ_r; ``incidence`` (rad) is the angle θ_H at which its light is reflected, less θ_r.
    """

    mu: np.ndarray  # (m,) rad
    theta_r: np.ndarray  # (t,) rad
    level: np.ndarray  # (m, t, taps) of `WIDTHS_RAD`
    offset: np.ndarray  # (m, t, taps) rad
    weight: np.ndarray  # (m, t, taps)
    incidence: np.ndarray  # (m, t, taps) rad


@numba.njit(cache=True)
def true_lobe(mu, view, half, out):
    """Fill rows of ``out`` with the reflected direction (3), D G / cosθ_r, V·H, for half vectors (n, 3); N is +z."""
    for i in range(half.shape[0]):
        cos_h = half[i, 0] * view[0] + half[i, 1] * view[1] + half[i, 2] * view[2]
        for axis in range(3):
            out[i, axis] = 2.0 * cos_h * half[i, axis] - view[axis]
        cos_phi = half[i, 2]
        phi = math.atan2(math.hypot(half[i, 0], half[i, 1]), cos_phi)
        geometric = attenuation_over_cosine(out[i, 2], view[2], cos_phi, cos_h)
        out[i, 3] = facet_distribution(phi, mu) * geometric
        out[i, 4] = cos_h


def lobe_samples(mu: float, theta_r: float, nodes: tuple[int, int] = _NODES):
    """Return samples of the true lobe over half the sphere of light; the other half is its mirror image.

    Returns
    -------
    direction : (n, 3) float64
        Of the light; the normal is +z, the view in the x-z plane at x < 0.
    value : (n,) float64, D G / cosθ_r
    cos_h : (n,) float64
    solid_angle : (n,) float64, sr; both halves together
    """
    reach = min(_REACH * mu, 0.5 * np.pi)
    x, wx = np.polynomial.legendre.leggauss(nodes[0])
    y, wy = np.polynomial.legendre.leggauss(nodes[1])
    phi, azimuth = 0.5 * reach * (x + 1), 0.5 * np.pi * (y + 1)
    weight = np.outer(0.5 * reach * wx * np.sin(phi), 0.5 * np.pi * wy)
    half = np.stack(
        [np.outer(np.sin(phi), np.cos(azimuth)), np.outer(np.sin(phi), np.sin(azimuth)),
         np.repeat(np.cos(phi)[:, None], len(azimuth), axis=1)], axis=-1).reshape(-1, 3)  # fmt: skip
    out = np.empty((len(half), 5))
    true_lobe(mu, np.array([-math.sin(theta_r), 0.0, math.cos(theta_r)]), half, out)
    front = out[:, 4] > 1e-9
    out, weight = out[front], weight.ravel()[front]
    return out[:, :3], out[:, 3], out[:, 4], 2.0 * 4.0 * out[:, 4] * weight


def _gaussians(direction: np.ndarray, level: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return lobes of unit power at samples, (n, lobes), axes at angles from +z towards +x."""
    kappa = 1.0 / WIDTHS_RAD[level] ** 2
    cosine = direction[:, :1] * np.sin(angle) + direction[:, 2:] * np.cos(angle)
    return kappa / (2 * np.pi * -np.expm1(-2 * kappa)) * np.exp(kappa * (cosine - 1.0))


def _candidates(index: int, mu: float, theta_r: float) -> tuple[np.ndarray, np.ndarray]:
    level = np.arange(max(index - _FINER, 0), min(index + _COARSER, len(WIDTHS_RAD) - 1) + 1)
    angle = np.clip(theta_r + mu * np.linspace(-5.0, 5.0, 31), -0.5 * np.pi, 0.55 * np.pi)
    level, angle = np.meshgrid(level, np.unique(angle), indexing="ij")
    return level.ravel(), angle.ravel()


def fit_lobe(mu: float, theta_r: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """Return levels, offsets, powers and θ_H - θ_r of the lobes that make up one true lobe, strongest first; rad.

    The last value is ∫ |sum - true| dω / ∫ true dω.
    """
    index = int(np.argmin(np.abs(np.log(MU_RAD / mu))))
    direction, value, cos_h, solid_angle = lobe_samples(mu, theta_r)
    power = float((value * solid_angle).sum())
    scale = np.sqrt(solid_angle) / math.sqrt(float((value**2 * solid_angle).sum()))
    level, angle = _candidates(index, mu, theta_r)

    def solve(level, angle):
        shapes = _gaussians(direction, level, angle)
        # The last row keeps the power: constant light is reflected as it is.
        rows = np.vstack([shapes * scale[:, None], np.full((1, len(level)), _ENERGY_WEIGHT / power)])
        return shapes, nnls(rows, np.append(value * scale, _ENERGY_WEIGHT))[0]

    _, found = solve(level, angle)
    chosen = np.argsort(found)[::-1][:_TAPS]
    chosen = chosen[found[chosen] > 0.0]
    level, angle = level[chosen], angle[chosen]
    shapes, found = solve(level, angle)
    parts = shapes * found
    total = parts.sum(axis=1)
    distance = float((np.abs(total - value) * solid_angle).sum() / power)
    share = parts / np.maximum(total, 1e-300)[:, None] * (value * solid_angle)[:, None]
    # Fresnel's rise towards grazing is about (1 - cosθ_H)^5: its mean, not that of the angle, is kept.
    mean = (share * ((1.0 - cos_h) ** 5)[:, None]).sum(axis=0) / np.maximum(share.sum(axis=0), 1e-300)
    keep = found > 0.0
    incidence = np.arccos(np.clip(1.0 - mean**0.2, 0.0, 1.0)) - theta_r
    return level[keep], (angle - theta_r)[keep], found[keep], incidence[keep], distance


@lru_cache(maxsize=1)
def fitted_lobes() -> tuple[Lobes, np.ndarray]:
    """Return the table, and ∫ |sum - true| dω / ∫ true dω of its entries (m, t)."""
    shape = (len(MU_RAD), len(THETA_R_RAD))
    lobes = Lobes(
        MU_RAD, THETA_R_RAD, np.zeros((*shape, _TAPS), dtype=np.int64), *(np.zeros((*shape, _TAPS)) for _ in range(3))
    )
    distance = np.empty(shape)
    for i, mu in enumerate(MU_RAD):
        for j, theta_r in enumerate(THETA_R_RAD):
            level, offset, power, incidence, distance[i, j] = fit_lobe(mu, theta_r)
            count = len(level)
            lobes.level[i, j, :count], lobes.offset[i, j, :count] = level, offset
            lobes.weight[i, j, :count], lobes.incidence[i, j, :count] = power / (np.pi * mu**2), incidence
    return lobes, distance
