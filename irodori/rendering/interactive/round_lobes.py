"""Gloss lobes as rows of four round lobes, tabulated for look-up at every hit.

The lobe D G / cosθ_r of any registered kind is approximated by one to three rows of four spherical Gaussians in the
plane of incidence; those of a row have the same width and equal spacing. A lobe with a nearly Gaussian distribution of
facets needs one row; a lobe with long tails is split by φ into nearly Gaussian parts, each with its own row (`split`).
Mean direction, spread along the plane and spread across it of each row equal those of its part of the true lobe; if
that part is very long, the row is as long as four lobes without gaps can be. The weights are a least-squares fit of the
lobe's shape and of its first and second moments. All entries have the same form, so that parameters are interpolated
before a look-up, instead of the results of several look-ups.
"""

import hashlib
import math
import os
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irodori.core.provenance import code_hash
from irodori.jit.compilation import njit
from irodori.jit.kernel_cache import cache_folder
from irodori.light.blurred_light import WIDTHS_RAD
from irodori.reflection.fresnel import fresnel
from irodori.reflection.lobes import Lobes, constants, features, strength, value
from irodori.reflection.registry import lobe

TAPS = 4
#: Entries over ln μ and over the square root of cosθ_r.
ROUGHNESSES, ANGLES = 17, 17
#: Numbers of an entry: level, then weight, coordinate p and cosθ_H of each tap (each of the four lobes), then a place
#: for the hit's power; padded to a vector.
ENTRY, POWER = 16, 13
#: Largest number of rows of a lobe, and the largest distance to the true lobe, if that is short, with fewer rows.
MOST_PARTS, _NEAR = 3, 0.12
_PLACES, _ANGLES_RAD = (4, 7, 10), (0.01, 0.5, 0.9)  # roughnesses, as table rows, and angles at which that is tested
_LONGEST = 7.0  # variance of the row over that of a lobe in it
_NODES, _NODES_OF_PARTS = (48, 32), (72, 48)
_STEPS = 60  # iterations of the search for the parts
_STARTS = {2: (0.7, 2.5), 3: (0.6, 1.6, 5.0)}  # initial widths of the parts, relative to a Gaussian of equal strength
_ENERGY_WEIGHT = 3.0
_MOMENT_WEIGHTS = np.array([5.0, 5.0, 2.5, 2.5, 2.5])  # mean direction; then squares and product of its coordinates
_EVEN_WEIGHT = 0.02  # regularisation, because weights of lobes that nearly coincide are otherwise undetermined
_INDEX = 1.5  # for which the mean Fresnel reflectance of a lobe is kept
_COSINES = np.linspace(0.0, 1.0, 2001)


class LobeRows(NamedTuple):
    """Table of rows for one kind of lobe, over roughness and angle.

    ``entries`` are (parts, ROUGHNESSES, ANGLES, ENTRY) float32: the fractional level in
    `irodori.light.blurred_light.WIDTHS_RAD`; then weight, coordinate p and cosθ_H of each tap, that is each of the four
    lobes. A weight is the integral of the lobe divided by π / 4 times the strength (π μ² for the Gaussian). With mirror
    direction R and normal N, the axis of a tap is p R + q N; its angle from N has the sine p sinθ_r. ``distance`` is
    ∫ |rows - lobe| dω / ∫ lobe dω.
    """

    entries: np.ndarray
    distance: np.ndarray  # (ROUGHNESSES, ANGLES) float64


class Samples(NamedTuple):
    """Samples of a lobe over half the sphere of light directions; the other half is its mirror image.

    The normal is +z, the view lies in the x-z plane at x < 0; ``solid_angle``, sr, counts both halves.
    """

    direction: np.ndarray  # (n, 3)
    value: np.ndarray  # (n,) D G / cosθ_r
    cos_h: np.ndarray
    phi: np.ndarray
    solid_angle: np.ndarray


class Row(NamedTuple):
    """Rows fitted to one lobe at one roughness and angle, see `fit_row`."""

    width: np.ndarray  # (parts,) rad
    angle: np.ndarray  # (parts, 4) of the axes from the normal, away from the view, rad
    weight: np.ndarray  # (parts, 4) whose sum is 1
    cos_h: np.ndarray  # (parts, 4) cosine of the angle θ_H at which the light of each lobe is reflected
    power: float  # ∫ D G / cosθ_r dω
    distance: float


def _step(name: str) -> tuple[float, float]:
    """Return ln μ of the first roughness in a lobe's table, and the step of ln μ."""
    bounds = lobe(name).roughness
    return math.log(bounds.low), math.log(bounds.high / bounds.low) / (ROUGHNESSES - 1)


def roughness_place(mu, name: str = "gaussian") -> np.ndarray:
    """Return the coordinate of μ in a lobe's table, 0..ROUGHNESSES - 1; μ is clipped to the lobe's bounds."""
    bounds = lobe(name).roughness
    place = np.log(np.clip(mu, bounds.low, bounds.high) / bounds.low)
    return place * ((ROUGHNESSES - 1) / math.log(bounds.high / bounds.low))


def roughness_at(place, name: str = "gaussian"):
    """Return μ at a coordinate in a lobe's table, the inverse of `roughness_place`."""
    first, step = _step(name)
    return math.exp(first) * np.exp(np.asarray(place) * step)


def ladder(lobes: Lobes) -> np.ndarray:
    """Return first ln μ and step of ln μ in each lobe's table, (lobes, 2)."""
    return np.array([_step(name) for name in lobes.names])


@njit(cache=True, error_model="numpy")
def _strengths(lobes, mu, out):
    for i in range(mu.size):
        out[i] = strength(lobes, 0, mu[i])


def gloss_power(beta: np.ndarray, mu: np.ndarray, name: str = "gaussian") -> np.ndarray:
    """Return β times a quarter of the lobe's strength, (...) float64, 0 where μ is 0; for the Gaussian β μ²."""
    flat = np.where(mu > 0, mu, 1.0).astype(np.float64).ravel()
    out = np.empty_like(flat)
    _strengths(Lobes((name,)), flat, out)
    return np.where(mu > 0, beta * (0.25 * out.reshape(np.shape(mu))), 0.0)


@njit(cache=True, error_model="numpy")
def _fill_values(lobes, t, cos_r, angles, out):
    """Fill ``out`` with D G / cosθ_r for light directions; ``angles`` are cosθ_i, cosφ, cosθ_H and φ, (n,) each."""
    constant, (cos_i, cos_phi, cos_h, phi) = constants(lobes, t), angles
    for i in range(out.size):
        if cos_i[i] > 0.0 and cos_phi[i] > 0.0 and cos_h[i] > 1e-9:
            factor, f0, f1, f2 = features(lobes, cos_i[i], cos_r, cos_phi[i], cos_h[i], phi[i])
            out[i] = factor * value(lobes, constant, f0, f1, f2)


def unit(along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return unit vectors, (..., 3), at angles ``along`` from +z to +x and ``across`` out of the x-z plane (rad)."""
    return np.stack([np.cos(across) * np.sin(along), np.sin(across), np.cos(across) * np.cos(along)], axis=-1)


def grid_cells(scale: float, low: float, high: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return centres and widths of ``count`` cells between ``low`` and ``high`` that are narrowest around 0."""
    edges = scale * np.sinh(np.linspace(math.asinh(low / scale), math.asinh(high / scale), count + 1))
    return 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)


def samples_about_mirror(name: str, mu: float, theta_r: float, grid: tuple[int, int] = _NODES) -> Samples:
    """Return samples of a lobe on a grid that is finest around the mirror direction; angles in rad."""
    law = lobe(name)
    width = math.sqrt(0.5 * law.strength(mu))
    reach = min(2.8 * law.reach(mu), 2.0 * math.pi) + 0.02
    low, high = max(-reach, -0.5 * math.pi - 0.3 - theta_r), min(reach, 0.5 * math.pi + min(reach, 1.5) - theta_r)
    along, along_step = grid_cells(0.5 * width, low, high, grid[0])
    across, across_step = grid_cells(0.5 * width * math.cos(theta_r), 0.0, min(reach, 0.5 * math.pi), grid[1])
    direction = unit(*np.meshgrid(theta_r + along, across, indexing="ij")).reshape(-1, 3)
    solid_angle = np.outer(along_step, 2.0 * across_step * np.cos(across)).ravel()
    view = unit(np.array(-theta_r), np.array(0.0))
    half = direction + view
    length = np.linalg.norm(half, axis=1)
    half = np.divide(half, length[:, None], out=np.zeros_like(half), where=length[:, None] > 1e-9)
    cos_h, phi = half @ view, np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2])
    values = np.zeros(len(phi))
    angles = tuple(np.ascontiguousarray(c) for c in (direction[:, 2], half[:, 2], cos_h, phi))
    _fill_values(Lobes((name,)), math.log(mu), math.cos(theta_r), angles, values)
    return Samples(direction, values, cos_h, phi, solid_angle)


@lru_cache(maxsize=1)
def _reflectance() -> np.ndarray:
    """Return the Fresnel reflectance for the refractive index `_INDEX` at `_COSINES`, which decreases."""
    return np.array([fresnel(float(cosine), _INDEX, 0.0) for cosine in _COSINES])


def _moments(angle: np.ndarray, kappa: float) -> np.ndarray:
    """Return the means of x, z, x², z² and x z over spherical Gaussians of concentration κ, (5, lobes)."""
    mean = 1.0 / math.tanh(kappa) - 1.0 / kappa
    even, along = mean / kappa, 1.0 - 3.0 * mean / kappa
    x, z = np.sin(angle), np.cos(angle)
    return np.stack([mean * x, mean * z, even + along * x * x, even + along * z * z, along * x * z])


def _moments_of(direction: np.ndarray, share: np.ndarray) -> np.ndarray:
    x, z = direction[:, 0], direction[:, 2]
    return share @ np.stack([x, z, x * x, z * z, x * z], axis=1)


def split(name: str, mu: float, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Return shares and squared widths, rad², of a mixture of Gaussians of φ that approximates a lobe, each (parts,).

    The mixture is fitted for a view near the normal by expectation maximisation. The initial widths depend only on the
    lobe's strength, so that the parts change continuously with roughness.
    """
    if parts == 1:
        return np.ones(1), np.ones(1)
    seen = samples_about_mirror(name, mu, 1e-2, _NODES_OF_PARTS)
    mass = seen.value * seen.solid_angle / float(seen.value @ seen.solid_angle)
    share, square = np.full(parts, 1.0 / parts), 0.25 * lobe(name).strength(mu) * np.square(_STARTS[parts])
    for _ in range(_STEPS):
        belongs = _belongs(seen.phi, share, square)
        share = np.maximum(mass @ belongs, 1e-12)
        square = (mass * seen.phi**2) @ belongs / share
    return share, square


def _belongs(phi: np.ndarray, share: np.ndarray, square: np.ndarray) -> np.ndarray:
    """Return the share of each part of the mixture in the lobe at angles φ, (n, parts)."""
    if len(share) == 1:
        return np.ones((len(phi), 1))
    exponent = np.log(share / square) - phi[:, None] ** 2 / square
    weight = np.exp(exponent - exponent.max(axis=1, keepdims=True))
    return weight / weight.sum(axis=1, keepdims=True)


def _placed(direction: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the axes of a row's lobes, (4,) rad from the normal, and their variance; ``share`` weights the samples."""
    middle = math.atan2(float(share @ direction[:, 0]), float(share @ direction[:, 2]))
    along = np.arcsin(np.clip(direction[:, 0] * math.cos(middle) - direction[:, 2] * math.sin(middle), -1.0, 1.0))
    across = np.arcsin(np.clip(direction[:, 1], -1.0, 1.0))
    long, short = float(share @ along**2), float(share @ across**2)
    variance = max(short, long / _LONGEST)
    spacing = math.sqrt(max(long - variance, 0.0) / ((TAPS**2 - 1) / 12.0))
    return np.minimum(middle + spacing * (np.arange(TAPS) - 0.5 * (TAPS - 1)), 0.5 * np.pi - 1e-3), variance


def fit_row(name: str, mu: float, theta_r: float, mixture: tuple[np.ndarray, np.ndarray]) -> Row:
    """Fit the rows to one lobe; ``mixture`` is the result of `split`."""
    from scipy.optimize import nnls  # slow to import

    parts = len(mixture[0])
    seen = samples_about_mirror(name, mu, theta_r, _NODES if parts == 1 else _NODES_OF_PARTS)
    direction, solid_angle, cos_h = seen.direction, seen.solid_angle, seen.cos_h
    share = seen.value * solid_angle
    power = float(share.sum())
    share, density = share / power, seen.value / power
    belongs = _belongs(seen.phi, *mixture)
    width, angles, shapes, moments = np.empty(parts), np.empty((parts, TAPS)), [], []
    for part in range(parts):
        mass = float(share @ belongs[:, part])
        own = share * belongs[:, part] / mass if mass > 1e-12 else share
        angles[part], variance = _placed(direction, own)
        kappa, width[part] = 1.0 / variance, math.sqrt(variance)
        cosine = direction[:, :1] * np.sin(angles[part]) + direction[:, 2:] * np.cos(angles[part])
        shapes.append(kappa / (2 * np.pi * -np.expm1(-2 * kappa)) * np.exp(kappa * (cosine - 1.0)))
        moments.append(_moments(angles[part], kappa))
    shape, moment, count = np.hstack(shapes), np.hstack(moments), parts * TAPS
    scale = np.sqrt(solid_angle) / math.sqrt(float((density**2 * solid_angle).sum()))
    rows = [shape * scale[:, None], np.full((1, count), _ENERGY_WEIGHT), _EVEN_WEIGHT * np.eye(count)]
    rows.append(moment * _MOMENT_WEIGHTS[:, None])
    wanted = _moments_of(direction, share)
    targets = [density * scale, [_ENERGY_WEIGHT], np.zeros(count), wanted * _MOMENT_WEIGHTS]
    weight = nnls(np.vstack(rows), np.concatenate(targets))[0]
    weight /= weight.sum()
    pieces = shape * weight
    found = pieces.sum(axis=1)
    distance = float((np.abs(found - density) * solid_angle).sum())
    pieces = pieces / np.maximum(found, 1e-300)[:, None] * share[:, None]
    # θ_H of each lobe is chosen so that a lacquer reflects there the mean over the part that the lobe represents, and
    # all lobes together as much as the true lobe.
    lacquer = _reflectance()
    reflected = np.interp(cos_h, _COSINES, lacquer)
    mean = pieces.T @ reflected / np.maximum(pieces.sum(axis=0), 1e-300)
    mean = mean * float(share @ reflected) / float(weight @ mean)
    incidence = np.interp(mean, lacquer[::-1], _COSINES[::-1])
    # A lobe without weight has weight in the next entry of the table: it reflects as facets towards its axis do.
    incidence = np.where(weight > 0.0, incidence, np.cos(0.5 * (angles.ravel() + theta_r)))
    return Row(width, angles, weight.reshape(parts, TAPS), incidence.reshape(parts, TAPS), power, distance)


def parts_of(name: str) -> int:
    """Return the fewest rows within `_NEAR` of a lobe, tested at low and middle roughness and non-grazing angles."""
    for parts in range(1, MOST_PARTS):
        rough = [float(mu) for mu in roughness_at(np.array(_PLACES), name)]
        mixtures = {mu: split(name, mu, parts) for mu in rough}
        rows = (fit_row(name, mu, theta, mixtures[mu]) for mu in rough for theta in _ANGLES_RAD)
        if max(row.distance for row in rows) <= _NEAR:
            return parts
    return MOST_PARTS


def _make_table(name: str) -> LobeRows:
    parts = parts_of(name)
    entries = np.zeros((parts, ROUGHNESSES, ANGLES, ENTRY), dtype=np.float32)
    distance = np.empty((ROUGHNESSES, ANGLES))
    # At both ends of the range of angles, the row is fitted slightly inside the range.
    cosine = np.clip(np.linspace(0.0, 1.0, ANGLES) ** 2, 2e-3, math.cos(1e-2))
    for i, mu in enumerate(map(float, roughness_at(np.arange(ROUGHNESSES), name))):
        mixture, unit_power = split(name, mu, parts), np.pi * 0.25 * lobe(name).strength(mu)
        for j, theta_r in enumerate(map(float, np.arccos(cosine))):
            row = fit_row(name, mu, theta_r, mixture)
            distance[i, j] = row.distance
            entry = entries[:, i, j]
            entry[:, 0] = 2.0 * np.log2(row.width / WIDTHS_RAD[0])
            entry[:, 1 : 1 + 3 * TAPS : 3] = row.weight * row.power / unit_power
            entry[:, 2 : 1 + 3 * TAPS : 3] = np.sin(row.angle) / math.sin(theta_r)
            entry[:, 3 : 1 + 3 * TAPS : 3] = row.cos_h
    return LobeRows(entries, distance)


def _table_file(name: str) -> Path | None:
    """Return the file of a lobe's table in the kernel cache, named by a hash of the lobe's and this module's source."""
    folder = cache_folder()
    if folder is None:
        return None
    key = hashlib.blake2b(f"{code_hash(__name__)} {lobe(name).digest}".encode(), digest_size=8).hexdigest()
    return Path(folder) / f"{__name__}.{name}-{key}.npz"


@lru_cache(maxsize=16)
def _table(name: str, digest: str) -> LobeRows:
    path = _table_file(name)
    if path is not None and path.is_file():
        with np.load(path) as kept:
            return LobeRows(kept["entries"], kept["distance"])
    table = _make_table(name)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Several processes may write the table at once: the last one stays.
        temporary = path.with_name(f".{path.stem}.{os.getpid()}.npz")
        np.savez(temporary, entries=table.entries, distance=table.distance)
        os.replace(temporary, path)
    return table


def lobe_table(name: str = "gaussian") -> LobeRows:
    """Return the table of a lobe, read from the kernel cache or computed, which takes some time, and stored there."""
    return _table(name, lobe(name).digest)


def joined_tables(lobes: Lobes) -> np.ndarray:
    """Return the tables of lobes, (lobes, parts, ROUGHNESSES, ANGLES, ENTRY) float32, padded with rows of weight 0."""
    tables = [lobe_table(name).entries for name in lobes.names]
    most = max(len(table) for table in tables)
    return np.stack([np.pad(table, ((0, most - len(table)), (0, 0), (0, 0), (0, 0))) for table in tables])
