"""Irradiance map I_d(N) = Σ cosθ L(ω) dΩ of equation (8), computed on the coefficients.

The picture is stored as a quadtree of cells of constant angular size, each with Σ L ω dΩ. For a normal N, a cell
entirely above the horizon contributes exactly N · Σ L ω dΩ, and one entirely below contributes nothing. A cell that the
horizon cuts is divided, down to the pixels, until its possible error is a small share of the irradiance.

A weight of the light by its angle, such as that of a coat, multiplies the cosine. Then cells in which the product is
not linear enough are divided too.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from irodori.core.progress import LOGGER
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit
from irodori.light.environment_file import directions, row_solid_angles
from irodori.light.equirectangular import look_up

_BLOCK = 8  # pixels along each side of the smallest cell that is stored
_TOP_CELLS = 32
_COARSE_CELLS = 1024  # cells from which a lower bound of the irradiance, and so the tolerance, is computed
_TOLERANCE = 2e-4  # largest power times angular radius of an undivided cut cell, relative to the irradiance
_SPREAD = 0.55  # half the range of heights above the horizon within a cell, relative to its angular radius
_DARKEST = 1e-7  # ratio of irradiance to power below which the tolerance is not reduced further
_STACK = 1024
_NORMALS = 256  # normals that a thread takes at a time
_SMALLEST_HEIGHT = 32
#: Steps of cosine at which a weight is tabulated; largest error of weighted light by its curvature within cells, all
#: together, relative to the irradiance.
_COSINES, _CURVED = 2048, 5e-4
_MIDPOINTS = 1 << 15


class Cells(NamedTuple):
    """Quadtree of a picture, with the cells of all levels in sequence, the finest level first.

    ``power`` of a cell is Σ |L| dΩ, where |L| is the norm of a pixel's coefficients.
    """

    first: np.ndarray  # (levels,)
    rows: np.ndarray  # (levels,)
    columns: np.ndarray  # (levels,)
    centre: np.ndarray  # (cells, 3)
    sine: np.ndarray  # (cells,) sine of the angular radius that contains the cell's pixels; 2 for 90 degrees or more
    radius: np.ndarray  # (cells,) rad
    power: np.ndarray  # (cells,)
    power_moment: np.ndarray  # (cells, 3)
    moment: np.ndarray  # (cells, k, 3)


class Pixels(NamedTuple):
    """A picture, with directions and solid angles for its rows and columns."""

    values: np.ndarray  # (height, width, k)
    sin_theta: np.ndarray  # (height,)
    cos_theta: np.ndarray  # (height,)
    cos_azimuth: np.ndarray  # (width,)
    sin_azimuth: np.ndarray  # (width,)
    solid_angle: np.ndarray  # (height,)


def make_pixels(coefficients: np.ndarray) -> Pixels:
    """Make the tables of a picture, (height, width, k); directions are those of pixel centres."""
    height, width = coefficients.shape[:2]
    theta = np.pi * (np.arange(height) + 0.5) / height
    azimuth = 2 * np.pi * (np.arange(width) + 0.5) / width
    return Pixels(
        np.ascontiguousarray(coefficients, dtype=np.float32),
        np.sin(theta),
        np.cos(theta),
        np.cos(azimuth),
        np.sin(azimuth),
        row_solid_angles(width, height),
    )


@njit(cache=True)
def _fill_block(pixels, i, j, moment, power_moment):
    values = pixels.values
    height, width, bases = values.shape
    power = 0.0
    for row in range(i * _BLOCK, min(height, (i + 1) * _BLOCK)):
        s, z, weight = pixels.sin_theta[row], pixels.cos_theta[row], pixels.solid_angle[row]
        for column in range(j * _BLOCK, min(width, (j + 1) * _BLOCK)):
            x, y = s * pixels.cos_azimuth[column], s * pixels.sin_azimuth[column]
            square = 0.0
            for b in range(bases):
                value = values[row, column, b] * weight
                square += value * value
                moment[b, 0] += value * x
                moment[b, 1] += value * y
                moment[b, 2] += value * z
            length = math.sqrt(square)
            power += length
            power_moment[0] += length * x
            power_moment[1] += length * y
            power_moment[2] += length * z
    return power


@njit(cache=True, nogil=True)
def _fill_blocks(pixels, power, power_moment, moment, first, last):
    columns = -(-pixels.values.shape[1] // _BLOCK)
    for block in range(first, last):
        power[block] = _fill_block(pixels, block // columns, block % columns, moment[block], power_moment[block])


def _halved(values: np.ndarray) -> np.ndarray:
    rows, columns = ((n + 1) // 2 for n in values.shape[:2])
    sums = np.add.reduceat(values, 2 * np.arange(rows), axis=0)
    return np.add.reduceat(sums, 2 * np.arange(columns), axis=1)


def _geometry(rows: int, columns: int, side: int, height: int, width: int):
    """Return centres (cells, 3) and angular radii (cells,) of the cells of a level, ``side`` pixels square."""
    top, left = np.arange(rows) * side, np.arange(columns) * side
    theta = np.stack([top, np.minimum(top + side, height)]) * (np.pi / height)
    azimuth = np.stack([left, np.minimum(left + side, width)]) * (2 * np.pi / width)
    middle, turn = theta.mean(axis=0), azimuth.mean(axis=0)
    centre = np.empty((rows, columns, 3))
    centre[..., 0], centre[..., 1] = np.outer(np.sin(middle), np.cos(turn)), np.outer(np.sin(middle), np.sin(turn))
    centre[..., 2] = np.cos(middle)[:, None]
    widest = np.where((theta[0] < np.pi / 2) & (theta[1] > np.pi / 2), 1.0, np.sin(theta).max(axis=0))
    # An upper bound: from the centre along the meridian, then along the parallel.
    radius = 0.5 * np.ptp(theta, axis=0)[:, None] + widest[:, None] * (0.5 * np.ptp(azimuth, axis=0))[None]
    return centre.reshape(-1, 3), radius.ravel()


def make_cells(pixels: Pixels) -> Cells:
    """Make the quadtree of a picture."""
    height, width, bases = pixels.values.shape
    rows, columns = -(-height // _BLOCK), -(-width // _BLOCK)
    power, power_moment = np.zeros(rows * columns), np.zeros((rows * columns, 3))
    moment = np.zeros((rows * columns, bases, 3))
    run_chunks(_fill_blocks, power.size, columns, pixels, power, power_moment, moment)
    finest = (
        power.reshape(rows, columns),
        power_moment.reshape(rows, columns, 3),
        moment.reshape(rows, columns, bases, 3),
    )
    levels: list[tuple[np.ndarray, ...]] = [finest]
    while levels[-1][0].size > _TOP_CELLS:
        levels.append(tuple(_halved(values) for values in levels[-1]))
    sizes = np.array([level[0].shape for level in levels])
    shapes = [_geometry(r, c, _BLOCK << i, height, width) for i, (r, c) in enumerate(sizes)]
    radius = np.concatenate([shape[1] for shape in shapes])
    return Cells(
        first=np.concatenate([[0], np.cumsum(sizes.prod(axis=1))[:-1]]),
        rows=sizes[:, 0].copy(),
        columns=sizes[:, 1].copy(),
        centre=np.concatenate([shape[0] for shape in shapes]),
        sine=np.where(radius < np.pi / 2, np.sin(radius), 2.0),
        radius=radius,
        power=np.concatenate([level[0].ravel() for level in levels]),
        power_moment=np.concatenate([level[1].reshape(-1, 3) for level in levels]),
        moment=np.concatenate([level[2].reshape(-1, bases, 3) for level in levels]),
    )


@njit(cache=True)
def _lower_bound(cells, level, normal):
    """Return the irradiance of |L| from the cells of a level that are entirely above the horizon, and Σ |L| dΩ."""
    first, (nx, ny, nz) = cells.first[level], normal
    found, total = 0.0, 0.0
    for j in range(first, first + cells.rows[level] * cells.columns[level]):
        total += cells.power[j]
        height = nx * cells.centre[j, 0] + ny * cells.centre[j, 1] + nz * cells.centre[j, 2]
        if height >= cells.sine[j]:
            m = cells.power_moment[j]
            found += nx * m[0] + ny * m[1] + nz * m[2]
    return found, total


@njit(cache=True)
def _weighted(weight, cosine):
    """Return a cosine times the weight of light at that angle, tabulated at even steps."""
    place = min(max(cosine, 0.0), 1.0) * (weight.size - 1)
    low = min(int(place), weight.size - 2)
    return cosine * (weight[low] + (place - low) * (weight[low + 1] - weight[low]))


@njit(cache=True)
def _is_curved(weight, height, spread, most):
    """Return whether the mean of a weighted cosine over a cell differs by more than ``most`` from that in its middle.

    The heights above the horizon in the cell are within ``spread`` of ``height``. The mean over a uniform range differs
    by a sixth of the second difference.
    """
    low, high = max(height - spread, 0.0), min(height + spread, 1.0)
    middle = _weighted(weight, 0.5 * (low + high))
    return abs(_weighted(weight, low) + _weighted(weight, high) - 2.0 * middle) > 6.0 * most


@njit(cache=True)
def _add_pixels(pixels, i, j, normal, weight, out):
    """Add the irradiance from the pixels of a block one by one."""
    values, (nx, ny, nz) = pixels.values, normal
    height, width, bases = values.shape
    for row in range(i * _BLOCK, min(height, (i + 1) * _BLOCK)):
        s, solid_angle = pixels.sin_theta[row], pixels.solid_angle[row]
        z = nz * pixels.cos_theta[row]
        for column in range(j * _BLOCK, min(width, (j + 1) * _BLOCK)):
            cosine = s * (nx * pixels.cos_azimuth[column] + ny * pixels.sin_azimuth[column]) + z
            if cosine > 0.0:
                factor = cosine * solid_angle if weight is None else _weighted(weight, cosine) * solid_angle
                for b in range(bases):
                    out[b] += factor * values[row, column, b]


@njit(cache=True)
def _add_irradiance(light, normal, weight, stack, out):
    """Add the irradiance for a normal; ``stack`` is memory for the levels and indices of cells to process."""
    (cells, pixels, coarse), (nx, ny, nz), (levels, places) = light, normal, stack
    bound, total = _lower_bound(cells, coarse, normal)
    limit = _TOLERANCE * max(bound, _DARKEST * total)
    most = _CURVED * max(bound, _DARKEST * total) / max(total, 1e-300)
    top = cells.first.size - 1
    waiting = cells.rows[top] * cells.columns[top]
    for place in range(waiting):
        levels[place], places[place] = top, place
    while waiting > 0:
        waiting -= 1
        level, place = levels[waiting], places[waiting]
        j = cells.first[level] + place
        height = nx * cells.centre[j, 0] + ny * cells.centre[j, 1] + nz * cells.centre[j, 2]
        if height <= -cells.sine[j] or cells.power[j] == 0.0:
            continue
        divides = height < cells.sine[j] and cells.power[j] * cells.radius[j] > limit
        if weight is not None:
            divides = divides or _is_curved(weight, height, _SPREAD * cells.radius[j], most)
        if divides:
            columns = cells.columns[level]
            i, k = place // columns, place % columns
            if level == 0:
                _add_pixels(pixels, i, k, normal, weight, out)
                continue
            below_rows, below_columns = cells.rows[level - 1], cells.columns[level - 1]
            for row in range(2 * i, min(2 * i + 2, below_rows)):
                for column in range(2 * k, min(2 * k + 2, below_columns)):
                    levels[waiting], places[waiting] = level - 1, row * below_columns + column
                    waiting += 1
            continue
        m, c = cells.moment[j], cells.centre[j]
        spread = _SPREAD * cells.radius[j]
        if abs(height) < spread:
            # Assume that the light is uniform over the heights within ``spread`` of the centre.
            mean = (height + spread) ** 2 / (4.0 * spread)
            if weight is not None:
                mean = _weighted(weight, mean)
            for b in range(out.size):
                out[b] += mean * (c[0] * m[b, 0] + c[1] * m[b, 1] + c[2] * m[b, 2])
        elif height > 0.0:
            share = 1.0
            if weight is not None:
                p = cells.power_moment[j]
                mean = max((nx * p[0] + ny * p[1] + nz * p[2]) / cells.power[j], 1e-30)
                share = _weighted(weight, mean) / mean
            for b in range(out.size):
                out[b] += share * (nx * m[b, 0] + ny * m[b, 1] + nz * m[b, 2])


@njit(cache=True, nogil=True)
def _add_irradiances(light, weight, normals, out, first, last):
    stack = np.empty(_STACK, dtype=np.int64), np.empty(_STACK, dtype=np.int64)
    for i in range(first, last):
        _add_irradiance(light, (normals[i, 0], normals[i, 1], normals[i, 2]), weight, stack, out[i])


class Integrator:
    """Irradiance for any normal under one environment.

    Parameters
    ----------
    coefficients : (height, width, k) float
        Radiance, equirectangular.
    """

    def __init__(self, coefficients: np.ndarray) -> None:
        self.pixels = make_pixels(coefficients)
        self.cells = make_cells(self.pixels)
        counts = self.cells.rows * self.cells.columns
        self._coarse = int(np.argmax(counts <= max(_COARSE_CELLS, counts[-1])))

    def __call__(self, normals: np.ndarray, weight: Callable[[np.ndarray], np.ndarray] | None = None) -> np.ndarray:
        """Compute the irradiance, (..., k) float64 in radiance unit times sr, for unit normals, (..., 3).

        With a ``weight``, each light counts by its value at the cosine to the normal, a function of (n,) to (n,) whose
        values are tabulated.
        """
        flat = np.ascontiguousarray(np.reshape(normals, (-1, 3)), dtype=np.float64)
        out = np.zeros((len(flat), self.pixels.values.shape[2]))
        light = self.cells, self.pixels, self._coarse
        table = None if weight is None else np.asarray(weight(np.linspace(0.0, 1.0, _COSINES)), dtype=np.float64)
        run_chunks(_add_irradiances, len(flat), _NORMALS, light, table, flat, out)
        return out.reshape(*np.shape(normals)[:-1], out.shape[1])


def irradiance_at(irradiance: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Look up an irradiance map, (h, w, k), at unit normals, (..., 3); return (..., k) float64."""
    flat = np.ascontiguousarray(np.reshape(normals, (-1, 3)), dtype=np.float64)
    out = np.empty((len(flat), irradiance.shape[2]))
    look_up(np.ascontiguousarray(irradiance), flat, out)
    return out.reshape(*np.shape(normals)[:-1], out.shape[1])


def midpoints(height: int) -> np.ndarray:
    """Return the normals half-way between those of a map with ``height`` rows, and the poles, (n, 3).

    If there are more than 32768, an even selection is returned.
    """
    theta = np.pi * np.arange(1, height) / height
    azimuth = np.pi * np.arange(2 * height) / height
    theta, azimuth = (grid.ravel() for grid in np.meshgrid(theta, azimuth, indexing="ij"))
    if theta.size > _MIDPOINTS:
        # Multiples of the golden ratio, which favour no row or column.
        chosen = np.unique((np.arange(_MIDPOINTS) * 0.6180339887498949 % 1.0 * theta.size).astype(int))
        theta, azimuth = theta[chosen], azimuth[chosen]
    unit = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)
    return np.concatenate([[[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], unit])


def fitted_irradiance_map(
    coefficients: np.ndarray, max_error: float, max_height: int, integrate: Integrator | None = None
) -> tuple[np.ndarray, dict]:
    """Compute the smallest irradiance map with a sufficiently small interpolation error.

    Parameters
    ----------
    coefficients : (H, W, k) float
        Radiance, equirectangular.
    max_error : float
        Largest error of the look-up at the midpoints between the map's normals, relative to the largest irradiance.
    max_height : int
        Largest number of rows; there are twice as many columns. Heights tried are 32, 64, 128...
    integrate : Integrator, optional
        Integrator of the same picture, if there is one already.

    Returns
    -------
    map : (height, 2 * height, k) float32
        In radiance unit times sr.
    errors : dict
        ``height`` of the map, ``max_error`` and ``mean_error`` at the midpoints, relative to the largest irradiance.
    """
    integrate = Integrator(coefficients) if integrate is None else integrate
    height = min(_SMALLEST_HEIGHT, max_height)
    while True:
        found = integrate(directions(2 * height, height)[0]).astype(np.float32)
        between = midpoints(height)
        exact = integrate(between)
        largest = np.linalg.norm(exact, axis=-1).max()
        difference = np.linalg.norm(irradiance_at(found, between) - exact, axis=-1) / (largest or 1.0)
        error = float(difference.max())
        if error <= max_error or height >= max_height:
            break
        height = min(2 * height, max_height)
    if error > max_error:
        LOGGER.info("the irradiance map of %d rows errs by %.2g between its normals, more than asked", height, error)
    LOGGER.info("irradiance map %d x %d, error between its normals up to %.2g", 2 * height, height, error)
    return found, {"height": height, "max_error": error, "mean_error": float(difference.mean())}
