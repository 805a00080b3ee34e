"""Rough reflection of the environment by look-up: blurred light and the table of lobes [eq. 5, 9]."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from irodori import store
from irodori.brdf import fresnel
from irodori.errors import InputError
from irodori.gloss_lobes import Lobes, fitted_lobes
from irodori.prefilter import WIDTHS_RAD, prefiltered
from irodori.sphere import add_interpolated


class GlossTables(NamedTuple):
    """Gloss maps as compiled loops want them."""

    pixels: np.ndarray  # (all pixels, k) float32
    first_pixel: np.ndarray  # (levels,)
    size: np.ndarray  # (levels, 2) width, height
    first_level: int  # the finest of the ladder that is there
    mu: np.ndarray
    theta_r: np.ndarray
    level: np.ndarray
    offset: np.ndarray
    weight: np.ndarray
    incidence: np.ndarray


@dataclass(frozen=True)
class GlossMaps:
    """Blurred light of an environment, on its basis.

    Parameters
    ----------
    first : int
        Level of `irodori.prefilter.WIDTHS_RAD` that the finest map has.
    levels : tuple of (h, 2 h, k) float32
        Mean radiance under lobes of growing width.
    """

    first: int
    levels: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, coefficients: np.ndarray) -> "GlossMaps":
        """Return the maps of an equirectangular picture, (height, width, k)."""
        first, levels = prefiltered(coefficients)
        return cls(first, tuple(levels))

    def write(self, out) -> None:
        """Write ``/gloss`` into an open file of `irodori.store`."""
        widths = WIDTHS_RAD[self.first :]
        out.write("gloss/width", widths, units="rad", dims="level", quantity="width 1/√κ of the blurring lobe")
        for number, level in enumerate(self.levels, start=self.first):
            out.write(
                f"gloss/level-{number:02d}",
                level,
                units="1",
                dims="row,column,basis",
                quantity="coefficients of the radiance blurred by a von Mises-Fisher lobe",
                compression="fast",
            )

    @classmethod
    def load(cls, path) -> "GlossMaps":
        """Read ``/gloss`` of an environment's file.

        Raises
        ------
        InputError
            If the file has none, or has the ladder of another version.
        """
        with store.open_file(path) as file:
            widths = file.read("gloss/width")
            first = len(WIDTHS_RAD) - len(widths)
            if first < 0 or not np.allclose(widths, WIDTHS_RAD[first:]):
                accepted = f"{WIDTHS_RAD[0]:.4g} rad and every factor of √2 to {WIDTHS_RAD[-1]:.4g}"
                raise InputError(path, "gloss/width", "other widths", accepted)
            return cls(first, tuple(file.read(f"gloss/level-{n:02d}") for n in range(first, len(WIDTHS_RAD))))

    def tables(self) -> GlossTables:
        """Return the maps and the table of lobes flat, for `add_gloss_radiance`."""
        lobes: Lobes = fitted_lobes()[0]
        sizes = np.array([level.shape[1::-1] for level in self.levels])
        counts = sizes.prod(axis=1)
        pixels = np.concatenate([level.reshape(-1, level.shape[2]) for level in self.levels])
        return GlossTables(pixels, np.concatenate([[0], np.cumsum(counts)[:-1]]), sizes, self.first, *lobes)


@numba.njit(cache=True, inline="always")
def _between(ladder, value):
    """Return the entry of a growing ladder below a value and the part of the way to the next; ends are held."""
    last = ladder.size - 2
    i = min(max(np.searchsorted(ladder, value) - 1, 0), last)
    part = (value - ladder[i]) / (ladder[i + 1] - ladder[i])
    return i, min(max(part, 0.0), 1.0)


@numba.njit(cache=True, error_model="numpy")
def add_gloss_radiance(maps, normal, view, beta, mu, n, k, out):
    """Add the coefficients of the gloss radiance β/π ∫ L F D G / cosθ_r dω [eq. 5, 9].

    Parameters
    ----------
    maps : GlossTables
    normal, view : (3,) float, unit
    beta, mu : float
        Weight and roughness (rad); NaN or 0 gives nothing.
    n, k : float
        Refractive index at one wavelength; where it varies call once for each.
    out : (bases,) float

    Notes
    -----
    Under the smallest roughness of the ladder, 0.01 rad, the light is as blurred as there, its power exact.
    """
    cos_r = normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2]
    if not (beta > 0.0 and mu > 0.0 and cos_r > 0.0):
        return
    tx, ty, tz = cos_r * normal[0] - view[0], cos_r * normal[1] - view[1], cos_r * normal[2] - view[2]
    sin_r = math.sqrt(tx * tx + ty * ty + tz * tz)
    theta_r = math.atan2(sin_r, cos_r)
    if sin_r > 1e-9:
        tx, ty, tz = tx / sin_r, ty / sin_r, tz / sin_r
    else:  # any direction across the normal
        sign = math.copysign(1.0, normal[2])
        a = -1.0 / (sign + normal[2])
        tx, ty, tz = 1.0 + sign * normal[0] ** 2 * a, sign * normal[0] * normal[1] * a, -sign * normal[0]
    i, part_i = _between(maps.mu, mu)
    if 0.0 < part_i < 1.0:
        part_i = math.log(mu / maps.mu[i]) / math.log(maps.mu[i + 1] / maps.mu[i])
    j, part_j = _between(maps.theta_r, theta_r)
    for corner in range(4):
        a, b = i + corner // 2, j + corner % 2
        share = (part_i if corner // 2 else 1.0 - part_i) * (part_j if corner % 2 else 1.0 - part_j)
        if share <= 0.0:
            continue
        share *= beta * mu * mu  # β / π times π μ²
        for tap in range(maps.weight.shape[2]):
            weight = maps.weight[a, b, tap]
            if weight <= 0.0:
                break
            angle = theta_r + maps.offset[a, b, tap]
            c, s = math.cos(angle), math.sin(angle)
            level = max(maps.level[a, b, tap] - maps.first_level, 0)
            add_interpolated(
                maps.pixels,
                maps.first_pixel[level],
                maps.size[level, 0],
                maps.size[level, 1],
                c * normal[0] + s * tx,
                c * normal[1] + s * ty,
                c * normal[2] + s * tz,
                share
                * weight
                * fresnel(math.cos(min(max(theta_r + maps.incidence[a, b, tap], 0.0), 0.5 * math.pi)), n, k),
                out,
            )


@numba.njit(cache=True, parallel=True, nogil=True)
def _gloss_radiance(maps, normal, view, beta, mu, n, k, out):
    for i in numba.prange(normal.shape[0]):
        add_gloss_radiance(maps, normal[i], view[i], beta[i], mu[i], n, k, out[i])


def gloss_radiance(maps: GlossTables, normal, view, beta, mu, n: float, k: float) -> np.ndarray:
    """Return coefficients of the gloss radiance, see `add_gloss_radiance`.

    Parameters
    ----------
    maps : GlossTables
    normal, view : (..., 3) float, unit; broadcast against each other
    beta, mu : (...) float
    n, k : float

    Returns
    -------
    (..., bases) float64
    """
    normal, view = np.broadcast_arrays(np.asarray(normal, dtype=np.float64), np.asarray(view, dtype=np.float64))
    shape = normal.shape[:-1]
    beta, mu = (np.ascontiguousarray(np.broadcast_to(v, shape), dtype=np.float64).ravel() for v in (beta, mu))
    out = np.zeros((beta.size, maps.pixels.shape[1]))
    normal, view = (np.ascontiguousarray(v).reshape(-1, 3) for v in (normal, view))
    _gloss_radiance(maps, normal, view, beta, mu, float(n), float(k), out)
    return out.reshape(*shape, -1)
