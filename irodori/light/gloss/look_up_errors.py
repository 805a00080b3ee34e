"""Error of gloss look-ups against the exact integral of the lobe over the light."""

import math
from typing import NamedTuple

import numpy as np

from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit
from irodori.light.gloss.gloss_maps import GlossMaps, gloss_radiance
from irodori.light.gloss.make_lobe_table import farthest
from irodori.light.gloss.point_sources import Seen, place_of
from irodori.light.irradiance import Integrator
from irodori.reflection.fresnel import fresnel
from irodori.reflection.lobes import Lobes, constants, features, value

#: Roughnesses (in the unit of the lobe) and view angles (degrees) at which errors are measured.
MU = (0.01, 0.02, 0.05, 0.1, 0.2, 0.36, 0.8, 1.2)
THETA_R_DEG = (0.0, 30.0, 60.0, 75.0, 80.0, 85.0)
_PLACES = 3
_CELLS_PER_WIDTH = 10.0  # smallest ratio of the lobe's width to the cells over which light is summed
_LOST = 1.9e-5  # share of a lobe's facets that may be left out of the sum; 3.3 roughnesses of a Gaussian
_PARTS_PER_WIDTH, _MOST_PARTS = 4.0, 8
_INDEX = (1.5, 0.0)


class _Surface(NamedTuple):
    """Reflection parameters of a surface, for compiled loops."""

    lobes: Lobes  # the lobe
    mu: float
    reach: float  # angle from the mirror direction, rad, beyond which the lobe is negligible
    n: float
    k: float


@njit(cache=True, forceinline=True, error_model="numpy")
def _reflected(surface, constant, seen, direction):
    """Return F D G / cosθ_r for light from a unit direction, at one place."""
    (normal, view), (x, y, z) = seen, direction
    cos_i = normal[0] * x + normal[1] * y + normal[2] * z
    hx, hy, hz = x + view[0], y + view[1], z + view[2]
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    if cos_i <= 0.0 or length < 1e-9:
        return 0.0
    cos_phi = (normal[0] * hx + normal[1] * hy + normal[2] * hz) / length
    cos_h = (view[0] * hx + view[1] * hy + view[2] * hz) / length
    cos_r = normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2]
    phi = math.acos(min(max(cos_phi, -1.0), 1.0))
    factor, f0, f1, f2 = features(surface.lobes, cos_i, cos_r, cos_phi, cos_h, phi)
    return fresnel(cos_h, surface.n, surface.k) * factor * value(surface.lobes, constant, f0, f1, f2)


@njit(cache=True)
def _mirrored(seen):
    """Return the mirror direction of a view."""
    normal, view = seen
    cos_r = normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2]
    mirror = np.empty(3)
    for axis in range(3):
        mirror[axis] = 2.0 * cos_r * normal[axis] - view[axis]
    return mirror


@njit(cache=True)
def _mean_lobe(pixels, pixel, parts, surface, constant, seen):
    """Return the mean of the lobe over a pixel (row, column), from ``parts`` points along each side."""
    (row, column), (height, width) = pixel, pixels.values.shape[:2]
    total = 0.0
    for a in range(parts):
        theta = math.pi * (row + (a + 0.5) / parts) / height
        s, z = math.sin(theta), math.cos(theta)
        for b in range(parts):
            azimuth = 2.0 * math.pi * (column + (b + 0.5) / parts) / width
            x, y = s * math.cos(azimuth), s * math.sin(azimuth)
            total += _reflected(surface, constant, seen, (x, y, z))
    return total / parts**2


@njit(cache=True)
def _add_from_pixels(pixels, parts, surface, seen, i, out):
    """Add the radiance at place ``i``, (k,), summed over pixels with ``parts`` x ``parts`` points each."""
    place = place_of(seen, i)
    mirror, reach, constant = _mirrored(place), surface.reach, constants(surface.lobes, math.log(surface.mu))
    height, width, bases = pixels.values.shape
    margin = math.pi / height + math.pi / width
    least, middle = math.cos(min(reach + margin, math.pi)), math.acos(min(max(mirror[2], -1.0), 1.0))
    first = max(int((middle - reach) / math.pi * height) - 1, 0)
    last = min(int((middle + reach) / math.pi * height) + 2, height)
    for row in range(first, last):
        s, z, weight = pixels.sin_theta[row], pixels.cos_theta[row], pixels.solid_angle[row]
        for column in range(width):
            x, y = s * pixels.cos_azimuth[column], s * pixels.sin_azimuth[column]
            if mirror[0] * x + mirror[1] * y + mirror[2] * z < least:
                continue
            shown = weight * _mean_lobe(pixels, (row, column), parts, surface, constant, place)
            for b in range(bases):
                out[b] += shown * pixels.values[row, column, b]


@njit(cache=True)
def _add_from_cells(cells, level, surface, seen, i, out):
    """Add the radiance at place ``i``, (k,), summed over the cells of a level of the quadtree."""
    first, place = cells.first[level], place_of(seen, i)
    mirror, reach, constant = _mirrored(place), surface.reach, constants(surface.lobes, math.log(surface.mu))
    for j in range(first, first + cells.rows[level] * cells.columns[level]):
        c = cells.centre[j]
        away = mirror[0] * c[0] + mirror[1] * c[1] + mirror[2] * c[2]
        if reach + cells.radius[j] < math.pi and away < math.cos(reach + cells.radius[j]):
            continue
        m = cells.power_moment[j]
        length = math.sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2])
        if length <= 0.0:
            continue
        x, y, z = m[0] / length, m[1] / length, m[2] / length
        shown = _reflected(surface, constant, place, (x, y, z))
        # Σ L dΩ of a small cell is the length of Σ L ω dΩ.
        for b in range(out.size):
            out[b] += shown * (x * cells.moment[j, b, 0] + y * cells.moment[j, b, 1] + z * cells.moment[j, b, 2])


@njit(cache=True, nogil=True)
def _sum_cells(light, surface, seen, out, first, last):
    cells, level = light
    for i in range(first, last):
        _add_from_cells(cells, level, surface, seen, i, out[i])


@njit(cache=True, nogil=True)
def _sum_pixels(light, surface, seen, out, first, last):
    pixels, parts = light
    for i in range(first, last):
        _add_from_pixels(pixels, parts, surface, seen, i, out[i])


def true_gloss(
    integrator: Integrator, normal: np.ndarray, view: np.ndarray, mu: float, index=_INDEX, lobe: str = "gaussian"
) -> np.ndarray:
    """Compute the gloss radiance β/π ∫ L F D G / cosθ_r dω for β = 1 by summation over the light, (n, bases) float64.

    The light is summed over cells of at most a tenth of the roughness, each at its centre of power, or else over
    pixels. A pixel has uniform radiance and is sampled at up to 8 x 8 points, so that a narrow lobe is not missed.
    """
    cells, pixels = integrator.cells, integrator.pixels
    height, width = pixels.values.shape[:2]
    pixel = max(np.pi / height, 2 * np.pi / width)
    fine = np.flatnonzero(pixel * 8.0 * 2.0 ** np.arange(len(cells.first)) <= mu / _CELLS_PER_WIDTH)
    narrow = mu * float((normal * view).sum(axis=-1).min())
    parts = int(np.clip(np.ceil(_PARTS_PER_WIDTH * pixel / narrow), 1, _MOST_PARTS))
    out = np.zeros((len(normal), pixels.values.shape[2]))
    seen = Seen(np.ascontiguousarray(normal), np.ascontiguousarray(view))
    # A facet tilted by φ deflects light by 2 φ.
    surface = _Surface(Lobes.of(lobe), float(mu), min(2.0 * farthest(lobe, mu, _LOST), math.pi), *map(float, index))
    if fine.size:
        run_chunks(_sum_cells, len(out), 1, (cells, int(fine[-1])), surface, seen, out)
    else:
        run_chunks(_sum_pixels, len(out), 1, (pixels, parts), surface, seen, out)
    return out / np.pi


def places(theta_r: float, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Draw random normals, and view directions at the angle θ_r (rad) from them, (count, 3) each."""
    rng = np.random.default_rng(seed)
    normal, other = rng.normal(size=(2, count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    across = np.cross(normal, other)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return normal, np.cos(theta_r) * normal + np.sin(theta_r) * across


def lit_places(cells, mu: float, theta_r: float, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Draw normals and view directions, (count, 3) each, with mirror directions near bright parts of the light.

    Mirror directions are drawn in proportion to the power of the light, with a scatter of about a roughness (rad).
    """
    rng = np.random.default_rng(seed)
    blocks = cells.rows[0] * cells.columns[0]
    power = cells.power[:blocks]
    if not power.any():
        return places(theta_r, count, seed)
    chosen = rng.choice(blocks, count, p=power / power.sum())
    mirror = cells.power_moment[:blocks][chosen]
    mirror = mirror / np.linalg.norm(mirror, axis=1, keepdims=True) + mu * rng.normal(size=(count, 3))
    mirror /= np.linalg.norm(mirror, axis=1, keepdims=True)
    across = np.cross(mirror, rng.normal(size=(count, 3)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    normal = np.cos(theta_r) * mirror + np.sin(theta_r) * across
    return normal, 2.0 * np.cos(theta_r) * normal - mirror


def gloss_errors(integrator: Integrator, maps: GlossMaps, lobe: str = "gaussian") -> list[dict]:
    """Measure the errors of the look-up of a lobe for each roughness and view angle, for n = 1.5.

    Returns
    -------
    list of dict
        ``lobe``; ``mu``, in the unit of the lobe; ``theta_r_deg``; ``rms``: RMS error divided by RMS radiance, over 3
        random places and 3 that mirror bright parts of the light; ``max``: largest error divided by largest radiance.
    """
    tables, rows = maps.tables(lobe), []
    for mu in MU:
        for theta_r in THETA_R_DEG:
            angle = math.radians(theta_r)
            pairs = places(angle, _PLACES), lit_places(integrator.cells, mu, angle, _PLACES)
            normal, view = (np.concatenate(both) for both in zip(*pairs, strict=True))
            truth = true_gloss(integrator, normal, view, mu, lobe=lobe)
            error = np.linalg.norm(gloss_radiance(tables, normal, view, 1.0, mu, _INDEX) - truth, axis=1)
            size = np.linalg.norm(truth, axis=1)
            rms, largest = math.sqrt(float((size**2).mean())), float(size.max())
            rows.append(
                {
                    "lobe": lobe,
                    "mu": mu,
                    "theta_r_deg": theta_r,
                    "rms": math.sqrt(float((error**2).mean())) / (rms or 1.0),
                    "max": float(error.max()) / (largest or 1.0),
                }
            )
    return rows
