"""Importance sampling of directions in proportion to the light's power.

The density of a direction is constant within a pixel and in 1/sr: the pixel's probability over its exact solid angle.
Within a pixel directions are even in solid angle, so that a polar row is sampled as it should be.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.jit.native import njit
from irodori.light.environment_file import Environment
from irodori.light.equirectangular import TWO_PI


class LightSampler(NamedTuple):
    """Cumulative probabilities of an equirectangular picture, for compiled loops."""

    rows: np.ndarray  # (height + 1,) from 0 to 1
    columns: np.ndarray  # (height, width + 1), each row from 0 to 1
    edge_cosine: np.ndarray  # (height + 1,) cosine of the rows' edges, from 1 to -1
    solid_angle: np.ndarray  # (height,) sr, of a pixel


def light_sampler(power: np.ndarray) -> LightSampler:
    """Return the sampler of a picture of scalar radiance.

    Parameters
    ----------
    power : (height, width) float
        Radiance, not negative. Where it is nothing at all, directions are even over the sphere: no light, and no reason
        to stop a renderer.

    Raises
    ------
    ValueError
        If a value is negative or not finite.
    """
    power = np.asarray(power, dtype=np.float64)
    if not (np.isfinite(power) & (power >= 0.0)).all():
        raise ValueError("a radiance that is negative or not finite; accepted: from 0")
    height, width = power.shape
    theta = np.pi * np.arange(height + 1) / height
    edge_cosine = np.cos(theta)
    # The difference of cosines without its cancellation at the poles.
    middle = 0.5 * (theta[1:] + theta[:-1])
    solid_angle = 2.0 * np.sin(middle) * np.sin(0.5 * np.pi / height) * (TWO_PI / width)
    largest = power.max()
    scaled = power / largest if largest > 0.0 else np.ones_like(power)
    columns = np.concatenate([np.zeros((height, 1)), np.cumsum(scaled, axis=1)], axis=1)
    of_row = columns[:, -1] * solid_angle
    # A black row is never entered; its own probabilities are even so that nothing is divided by 0.
    black = columns[:, -1] <= 0.0
    columns[black] = np.arange(width + 1)
    columns /= columns[:, -1:]
    rows = np.concatenate([[0.0], np.cumsum(of_row)])
    return LightSampler(rows / rows[-1], columns, edge_cosine, solid_angle)


def sampler_of(environment: Environment) -> LightSampler:
    """Return the sampler of an environment by its radiance summed over the wavelengths, what is negative being dark."""
    return light_sampler(np.maximum(environment.coefficients @ environment.basis.sum(axis=0), 0.0))


@njit(cache=True, inline="always")
def _entry(cumulative, u):
    """Return the entry whose share of 0..1 holds u, never one without a share."""
    low, high = 0, cumulative.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if cumulative[middle] <= u:
            low = middle
        else:
            high = middle
    return low


@njit(cache=True, inline="always")
def _density(sampler, row, column):
    of_row = sampler.rows[row + 1] - sampler.rows[row]
    of_column = sampler.columns[row, column + 1] - sampler.columns[row, column]
    return of_row * of_column / sampler.solid_angle[row]


@njit(cache=True)
def sample_light(sampler, u, v, direction):
    """Fill a unit direction (3,) drawn from the light; return its density in 1/sr.

    Parameters
    ----------
    sampler : LightSampler
    u, v : float
        Even in [0, 1).
    direction : (3,) float
    """
    row = _entry(sampler.rows, v)
    start = sampler.rows[row]
    v = (v - start) / (sampler.rows[row + 1] - start)
    cumulative = sampler.columns[row]
    column = _entry(cumulative, u)
    u = (u - cumulative[column]) / (cumulative[column + 1] - cumulative[column])
    z = sampler.edge_cosine[row] + v * (sampler.edge_cosine[row + 1] - sampler.edge_cosine[row])
    azimuth = TWO_PI * (column + u) / (cumulative.size - 1)
    sine = math.sqrt(max(1.0 - z * z, 0.0))
    direction[0], direction[1], direction[2] = sine * math.cos(azimuth), sine * math.sin(azimuth), z
    return _density(sampler, row, column)


@njit(cache=True)
def light_density(sampler, direction):
    """Return the density in 1/sr with which `sample_light` draws a unit direction."""
    height, width = sampler.columns.shape[0], sampler.columns.shape[1] - 1
    z = min(max(direction[2], -1.0), 1.0)
    row = min(int(math.acos(z) / math.pi * height), height - 1)
    azimuth = math.atan2(direction[1], direction[0])
    azimuth = azimuth if azimuth >= 0.0 else azimuth + TWO_PI
    return _density(sampler, row, min(int(azimuth / TWO_PI * width), width - 1))


@njit(cache=True)
def sample_lights(sampler, uv, directions, densities):
    """Fill directions (n, 3) and densities (n,) for points (n, 2) of the unit square."""
    for i in range(uv.shape[0]):
        densities[i] = sample_light(sampler, uv[i, 0], uv[i, 1], directions[i])


@njit(cache=True)
def light_densities(sampler, directions, densities):
    """Fill densities (n,) of unit directions (n, 3)."""
    for i in range(directions.shape[0]):
        densities[i] = light_density(sampler, directions[i])
