"""Construction of the table of a gloss lobe: ``python -m irodori.light.gloss.make_lobe_table LOBE`` (some minutes).

For each roughness and view angle, the lobe D G / cosθ_r is sampled on a grid over the whole sphere of light directions,
including those below the horizon, where it is zero. It is approximated by lobes of `irodori.light.blurred_light` by
non-negative orthogonal matching pursuit: of a few thousand candidates, the one that explains most of the residual is
added, and the weights of all chosen lobes are solved for again, until their number reaches a limit or the residual is
small.
"""

import argparse
import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from irodori.core import store
from irodori.core.progress import track
from irodori.light.blurred_light import WIDTHS_RAD
from irodori.light.gloss.lobe_table import COLUMNS, MU, TABLE, THETA_R_RAD, path_of
from irodori.reflection.equation5 import angles_from_directions
from irodori.reflection.lobe_arrays import evaluate
from irodori.reflection.registry import lobe, names

_LOOKUPS = 40  # largest number of look-ups in blurred light for an entry; a pair takes two
_REST = 0.01  # relative root-mean-square residual with which an entry is accepted
_GRID = (110, 45)  # number of samples within the plane of incidence and out of it
_REACH = 2.4  # largest tilt of a candidate's half vector, relative to the width of the lobe or of the candidate
_SPACING = 0.6  # spacing of the candidates' axes, in their widths
_FINEST, _FINEST_ACROSS, _NARROWEST = 0.25, 0.6, 0.1  # smallest widths of candidates, relative to that of the lobe
_FINEST_RAD = 0.2  # width needed to represent the cut of the horizon through a rough lobe
_SINGLE_RAD = 0.12  # smoother surfaces have straight lobes: axes in the plane of incidence suffice
_LOST = 2.2e-8  # share of facets that are not sampled; beyond 4.2 roughnesses of a Gaussian
_ENERGY_WEIGHT = 3.0


class FittedEntry(NamedTuple):
    """One entry of the table, strongest lobe first; ``rest`` is the relative RMS difference to the true lobe."""

    width: np.ndarray
    offset: np.ndarray
    across: np.ndarray
    weight: np.ndarray
    incidence: np.ndarray
    rest: float


def unit(along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return unit vectors, (..., 3), at angles ``along`` from +z to +x and ``across`` out of the x-z plane (rad)."""
    return np.stack([np.cos(across) * np.sin(along), np.sin(across), np.cos(across) * np.cos(along)], axis=-1)


def grid_cells(scale: float, low: float, high: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return centres and widths of ``count`` cells between ``low`` and ``high`` that are narrowest around 0."""
    edges = scale * np.sinh(np.linspace(math.asinh(low / scale), math.asinh(high / scale), count + 1))
    return 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)


class Extent(NamedTuple):
    """Spread of a lobe's facet normals about the normal, rad; for the Gaussian lobe both are its roughness."""

    core: float  # φ at which D has fallen to 1/e
    tail: float  # roughness of a Gaussian with the same share of facets beyond the sampled range


def _facets(name: str, mu: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return φ from 0 to π/2, D, and the cumulative share of the facets' projected area up to φ."""
    phi = np.sinh(np.linspace(0.0, math.asinh(0.5 * math.pi / mu), 20_001)) * mu
    facing = np.zeros((len(phi), 4))
    facing[:, 3] = phi  # light and view along the facet's normal: only D is left
    d = np.where(phi < 0.5 * math.pi, evaluate(name, mu, facing), 0.0)
    power = d * np.sin(phi) * np.cos(phi)
    gathered = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(phi))])
    return phi, d, gathered / gathered[-1]


@lru_cache(maxsize=256)
def farthest(name: str, mu: float, lost: float) -> float:
    """Return the angle from the normal beyond which only the share ``lost`` of a lobe's facets are tilted, rad."""
    phi, _, share = _facets(name, mu)
    return float(np.interp(1.0 - lost, share, phi))


@lru_cache(maxsize=256)
def extent(name: str, mu: float) -> Extent:
    """Return the extent of a lobe at a roughness."""
    phi, d, _ = _facets(name, mu)
    core = float(np.interp(math.exp(-1.0), d[::-1], phi[::-1]))
    return Extent(core, max(core, farthest(name, mu, _LOST) / math.sqrt(-math.log(_LOST))))


def lobe_samples(mu: float, theta_r: float, grid: tuple[int, int] = _GRID, name: str = "gaussian"):
    """Return samples of the true lobe over half of the sphere of light directions; the other half is symmetric.

    Returns
    -------
    direction : (n, 3) float64
        Directions to the light; the normal is +z, the view is in the x-z plane with x < 0.
    value : (n,) float64
        D G / cosθ_r.
    cos_h : (n,) float64
    solid_angle : (n,) float64
        In sr, for both halves together.
    """
    core, tail = extent(name, mu)
    width = math.sqrt(2.0) * core
    reach = min(8.4 * tail, 2.0 * math.pi) + 0.02
    # A long tail gets additional cells.
    more = math.asinh(2.0 * reach / width) / math.asinh(2.0 * min(8.4 * core + 0.02, reach) / width)
    along_cells, across_cells = (round(more * count) for count in grid)
    low, high = max(-reach, -0.5 * math.pi - 0.3 - theta_r), min(reach, 0.5 * math.pi + min(reach, 1.5) - theta_r)
    along, along_step = grid_cells(0.5 * width, low, high, along_cells)
    across, across_step = grid_cells(0.5 * width * math.cos(theta_r), 0.0, min(reach, 0.5 * math.pi), across_cells)
    direction = unit(*np.meshgrid(theta_r + along, across, indexing="ij")).reshape(-1, 3)
    solid_angle = np.outer(along_step, 2.0 * across_step * np.cos(across)).ravel()
    geometry = angles_from_directions(np.array([0.0, 0.0, 1.0]), direction, unit(np.array(-theta_r), np.array(0.0)))
    return direction, evaluate(name, mu, geometry), np.cos(geometry[:, 2]), solid_angle


def gaussians(direction: np.ndarray, axis: np.ndarray, width_rad: np.ndarray) -> np.ndarray:
    """Evaluate lobes of unit power, averaged over both sides of the x-z plane, at directions: (n, lobes)."""
    kappa = 1.0 / width_rad**2
    scale = kappa / (2.0 * np.pi * -np.expm1(-2.0 * kappa))
    both = (axis, axis * [1.0, -1.0, 1.0])
    with np.errstate(under="ignore"):
        return sum(0.5 * scale * np.exp(np.maximum(kappa * (direction @ side.T - 1.0), -700.0)) for side in both)


def _candidates(name: str, mu: float, theta_r: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return index of the width, and angles of the axis along and across the plane of incidence, of all candidates."""
    core, tail = extent(name, mu)
    width, view = math.sqrt(2.0) * core, unit(np.array(-theta_r), np.array(0.0))
    finest = min(width * max(_NARROWEST, min(_FINEST, _FINEST_ACROSS * math.cos(theta_r))), _FINEST_RAD)
    first, last = np.searchsorted(WIDTHS_RAD, [finest, 1.02 * math.sqrt(2.0) * tail])
    found = []
    for number in range(first, max(last, first + 1)):
        own = WIDTHS_RAD[number]
        step, reach = _SPACING * own, max(7.0 * core, 4.8 * own)
        low, high = max(theta_r - reach, -0.5 * math.pi), min(theta_r + reach, 0.5 * math.pi + 0.5 * step)
        # The mirror direction is one of the axes.
        along = theta_r + step * np.arange(math.ceil((low - theta_r) / step), math.floor((high - theta_r) / step) + 1)
        beside = min(max(3.0 * width, 2.9 * own), 1.4)
        across = np.arange(0.0, beside, step) if max(core, own / 1.5) > _SINGLE_RAD else np.zeros(1)
        along, across = (one.ravel() for one in np.meshgrid(along, across, indexing="ij"))
        half = unit(along, across) + view
        far = _REACH * max(core, 0.69 * own)
        near = half[:, 2] > math.cos(min(far, 1.5)) * np.linalg.norm(half, axis=1)
        found.append((np.full(near.sum(), number), along[near], across[near]))
    numbers, along, across = (np.concatenate(column) for column in zip(*found, strict=True))
    return numbers, along, across


def _pursue(rows: np.ndarray, target: np.ndarray, cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Approximate a target by columns with non-negative weights, by orthogonal matching pursuit.

    Parameters
    ----------
    rows : (samples, candidates) float
    target : (samples,) float
    cost : (candidates,) int
        Look-ups that each candidate takes.

    Returns
    -------
    chosen : (n,) int
        Indices of the chosen columns.
    weights : (n,) float
    """
    from scipy.optimize import nnls  # slow to import

    length = np.linalg.norm(rows, axis=0)
    chosen, weights, rest = np.empty(0, dtype=int), np.empty(0), target
    for _ in range(4 * _LOOKUPS):
        gain = rest @ rows / length
        gain[chosen] = -np.inf
        gain[cost > _LOOKUPS - cost[chosen].sum()] = -np.inf
        best = int(np.argmax(gain))
        if gain[best] < 1e-4:
            break
        chosen = np.append(chosen, best)
        # A QR decomposition reduces the least-squares problem to the triangular factor.
        q, triangle = np.linalg.qr(rows[:, chosen])
        weights = nnls(triangle, q.T @ target)[0]
        chosen, weights = chosen[weights > 0.0], weights[weights > 0.0]
        rest = target - rows[:, chosen] @ weights
        if np.linalg.norm(rest) < _REST:
            break
    return chosen, weights


def fit_lobe(mu: float, theta_r: float, name: str = "gaussian") -> FittedEntry:
    """Approximate one true lobe by spherical Gaussians; angles in rad."""
    direction, value, cos_h, solid_angle = lobe_samples(mu, theta_r, name=name)
    power = float((value * solid_angle).sum())
    scale = np.sqrt(solid_angle) / math.sqrt(float((value**2 * solid_angle).sum()))
    number, along, across = _candidates(name, mu, theta_r)
    shapes = gaussians(direction, unit(along, across), WIDTHS_RAD[number])
    # The last row preserves the power of the lobe under constant light.
    rows = np.vstack([shapes * (scale[:, None] * power), np.full((1, len(number)), _ENERGY_WEIGHT)])
    chosen, weight = _pursue(rows, np.append(value * scale, _ENERGY_WEIGHT), np.where(across > 0.0, 2, 1))
    order = np.argsort(weight)[::-1]
    chosen, weight = chosen[order], weight[order] * power
    parts = shapes[:, chosen] * weight
    total = parts.sum(axis=1)
    share = parts / np.maximum(total, 1e-300)[:, None] * (value * solid_angle)[:, None]
    # The Fresnel reflectance rises as (1 - cosθ_H)^5 towards grazing: the mean of this is preserved, not of the angle.
    mean = (share * ((1.0 - cos_h) ** 5)[:, None]).sum(axis=0) / np.maximum(share.sum(axis=0), 1e-300)
    incidence = np.arccos(np.clip(1.0 - mean**0.2, 0.0, 1.0)) - theta_r
    rest = float(np.linalg.norm((total - value) * scale))
    return FittedEntry(number[chosen], along[chosen] - theta_r, across[chosen], weight, incidence, rest)


def write_table(path, name: str) -> None:
    """Fit a lobe at every roughness and view angle, and write its table."""
    fits = [[fit_lobe(mu, theta_r, name) for theta_r in THETA_R_RAD] for mu in track(MU, "lobes")]
    most = max(len(fit.weight) for row in fits for fit in row)
    roughness = lobe(name).roughness
    with store.create(path, store.Provenance("gloss_fit")) as out:
        out.attribute("table", TABLE)
        out.attribute("lobe", name)
        out.coordinate("mu", MU, units=roughness.unit, quantity=roughness.quantity)
        out.coordinate("theta_r", THETA_R_RAD, units="rad", quantity="view angle")
        for column_name, (units, quantity) in COLUMNS.items():
            kind = np.uint8 if column_name == "width" else np.float32
            column = np.zeros((len(MU), len(THETA_R_RAD), most), dtype=kind)
            for i, row in enumerate(fits):
                for j, fit in enumerate(row):
                    column[i, j, : len(fit.weight)] = getattr(fit, column_name)
            out.write(column_name, column, units=units, dims="mu,theta_r,lobe", quantity=quantity)
        rest = [[fit.rest for fit in row] for row in fits]
        quantity = "root mean square difference from the true lobe over its root mean square"
        out.write("rest", rest, units="1", dims="mu,theta_r", quantity=quantity)


def main(arguments: list[str] | None = None) -> None:
    """Make the stored table of a lobe."""
    parser = argparse.ArgumentParser(prog="python -m irodori.light.gloss.make_lobe_table", description=main.__doc__)
    parser.add_argument("lobe", choices=names(), help="name of a lobe")
    name = parser.parse_args(arguments).lobe
    write_table(path_of(name), name)


if __name__ == "__main__":
    main()
