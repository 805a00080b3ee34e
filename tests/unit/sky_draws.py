"""Many directions from the light at once, and what their density sums up to."""

import numpy as np

from irodori.jit.compilation import njit
from irodori.light.environment_file import Environment, directions
from irodori.rendering.reference.sky_sampling import Sky, look_at_sky, sample_sky


@njit(cache=True)
def _sample(sky, uv, towards, density):
    coefficients = np.empty(sky.pixels.shape[1])
    for i in range(len(uv)):
        density[i] = sample_sky(sky, uv[i, 0], uv[i, 1], towards[i], coefficients)


@njit(cache=True)
def _look(sky, towards, density):
    coefficients = np.empty(sky.pixels.shape[1])
    for i in range(len(towards)):
        density[i] = look_at_sky(sky, towards[i], coefficients)


def drawn(sky: Sky, uv) -> tuple[np.ndarray, np.ndarray]:
    """Return directions (n, 3) and their densities (n,) for points (n, 2) of the unit square."""
    towards, density = np.empty((len(uv), 3)), np.empty(len(uv))
    _sample(sky, uv, towards, density)
    return towards, density


def densities(sky: Sky, unit: np.ndarray) -> np.ndarray:
    """Return the densities, (...), with which unit directions (..., 3) are drawn."""
    out = np.empty(unit[..., 0].size)
    _look(sky, np.ascontiguousarray(unit, dtype=np.float64).reshape(-1, 3), out)
    return out.reshape(unit.shape[:-1])


def shares(sky: Sky) -> np.ndarray:
    """Return the integral of the density over each pixel, (height, width).

    The density times the sine of the zenith angle is bilinear within a quarter of a pixel: its middle tells all.
    """
    unit = directions(2 * sky.width, 2 * sky.height)[0]
    parts = densities(sky, unit) * np.hypot(unit[..., 0], unit[..., 1]) * np.pi**2 / (2 * sky.width * sky.height)
    return parts.reshape(sky.height, 2, sky.width, 2).sum(axis=(1, 3))


def light_of(power: np.ndarray) -> Environment:
    """Return an environment whose radiance, summed over the wavelengths, is a picture (height, width)."""
    return Environment(power[..., None].astype(np.float32), np.full((61, 1), 1 / 61), np.ones((2, 4, 1), np.float32))
