"""Construction of the table of a gloss lobe: ``python -m irodori.light.gloss.make_lobe_table LOBE``, some minutes.

For each roughness and view angle the lobe D G / cosθ_r is sampled on a grid over the sphere of light, what lies under
the horizon included, where it is nothing. Of a few thousand lobes of `irodori.light.blurred_light` the one that
explains most of what is left is taken in turn, and the weights of all that were taken are solved for again, none
negative (orthogonal matching pursuit), until there are so many or the rest is small.
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

_LOOKUPS = 40  # of blurred light an entry may ask for; a pair asks for two
_REST = 0.01  # root of the squared distance over that of the lobe at which an entry is good enough
_GRID = (110, 45)  # samples within the plane of incidence and out of it
_REACH = 2.4  # widths of the lobe, or parts of that of the Gaussian, up to which the half vector of an axis lies
_SPACING = 0.6  # of the candidates' axes, in their widths
_FINEST, _FINEST_ACROSS, _NARROWEST = 0.25, 0.6, 0.1  # widths of candidates, over that of the lobe
_FINEST_RAD = 0.2  # what the horizon's cut through a rough lobe asks for
_SINGLE_RAD = 0.12  # smoother surfaces have a lobe without curvature: axes in the plane of incidence suffice
_LOST = 2.2e-8  # share of the facets beyond which nothing is sampled; at 4.2 roughnesses of a Gaussian
_ENERGY_WEIGHT = 3.0


class FittedEntry(NamedTuple):
    """One entry of the table, strongest lobe first, and its ``rest``: root mean square difference over the lobe's."""

    width: np.ndarray
    offset: np.ndarray
    across: np.ndarray
    weight: np.ndarray
    incidence: np.ndarray
    rest: float


def unit(along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return directions (..., 3) at an angle from +z towards +x and one out of that plane, rad."""
    return np.stack([np.cos(across) * np.sin(along), np.sin(across), np.cos(across) * np.cos(along)], axis=-1)


def grid_cells(scale: float, low: float, high: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return middles and widths of cells that are narrowest about 0."""
    edges = scale * np.sinh(np.linspace(math.asinh(low / scale), math.asinh(high / scale), count + 1))
    return 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)


class Extent(NamedTuple):
    """Spread of a lobe's facets about the normal, rad; for the Gaussian lobe both are its roughness."""

    core: float  # φ at which D has fallen to 1/e
    tail: float  # the roughness of the Gaussian that has lost as much at the end of the samples


def _facets(name: str, mu: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return φ from 0 to π/2, D, and the share of the facets' area that leans by less."""
    phi = np.sinh(np.linspace(0.0, math.asinh(0.5 * math.pi / mu), 20_001)) * mu
    facing = np.zeros((len(phi), 4))
    facing[:, 3] = phi  # light and view at the normal of the facet: D alone is left
    d = np.where(phi < 0.5 * math.pi, evaluate(name, mu, facing), 0.0)
    power = d * np.sin(phi) * np.cos(phi)
    gathered = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(phi))])
    return phi, d, gathered / gathered[-1]


@lru_cache(maxsize=256)
def farthest(name: str, mu: float, lost: float) -> float:
    """Return the angle from the normal beyond which no more than a share of a lobe's facets lean, rad."""
    phi, _, share = _facets(name, mu)
    return float(np.interp(1.0 - lost, share, phi))


@lru_cache(maxsize=256)
def extent(name: str, mu: float) -> Extent:
    """Return the extent of a lobe at a roughness."""
    phi, d, _ = _facets(name, mu)
    core = float(np.interp(math.exp(-1.0), d[::-1], phi[::-1]))
    return Extent(core, max(core, farthest(name, mu, _LOST) / math.sqrt(-math.log(_LOST))))


def lobe_samples(mu: float, theta_r: float, grid: tuple[int, int] = _GRID, name: str = "gaussian"):
    """Return samples of the true lobe over half the sphere of light; the other half is its mirror image.

    Returns
    -------
    direction : (n, 3) float64
        Of the light; the normal is +z, the view in the x-z plane at x < 0.
    value : (n,) float64, D G / cosθ_r
    cos_h : (n,) float64
    solid_angle : (n,) float64, sr; both halves together
    """
    core, tail = extent(name, mu)
    width = math.sqrt(2.0) * core
    reach = min(8.4 * tail, 2.0 * math.pi) + 0.02
    # A long tail has cells of its own.
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
    """Return lobes of unit power, or the mean of a pair on both sides of the x-z plane, at samples: (n, lobes)."""
    kappa = 1.0 / width_rad**2
    scale = kappa / (2.0 * np.pi * -np.expm1(-2.0 * kappa))
    both = (axis, axis * [1.0, -1.0, 1.0])
    with np.errstate(under="ignore"):
        return sum(0.5 * scale * np.exp(np.maximum(kappa * (direction @ side.T - 1.0), -700.0)) for side in both)


def _candidates(name: str, mu: float, theta_r: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the number of the width, and the axis' angles along and across, of lobes that may serve."""
    core, tail = extent(name, mu)
    width, view = math.sqrt(2.0) * core, unit(np.array(-theta_r), np.array(0.0))
    finest = min(width * max(_NARROWEST, min(_FINEST, _FINEST_ACROSS * math.cos(theta_r))), _FINEST_RAD)
    first, last = np.searchsorted(WIDTHS_RAD, [finest, 1.02 * math.sqrt(2.0) * tail])
    found = []
    for number in range(first, max(last, first + 1)):
        own = WIDTHS_RAD[number]
        step, reach = _SPACING * own, max(7.0 * core, 4.8 * own)
        low, high = max(theta_r - reach, -0.5 * math.pi), min(theta_r + reach, 0.5 * math.pi + 0.5 * step)
        # The mirror direction is one of them.
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
    """Return which columns make up a target, and their weights, by non-negative orthogonal matching pursuit."""
    from scipy.optimize import nnls  # slow to import

    length = np.linalg.norm(rows, axis=0)
    chosen, weights, rest = np.empty(0, dtype=int), np.empty(0), target
    for _ in range(4 * _LOOKUPS):
        gain = rest @ rows / length
        gain[chosen] = -1.0
        gain[cost > _LOOKUPS - cost[chosen].sum()] = -1.0
        best = int(np.argmax(gain))
        if gain[best] < 1e-4:
            break
        chosen = np.append(chosen, best)
        # The least squares of many samples are those of the triangle of their columns.
        q, triangle = np.linalg.qr(rows[:, chosen])
        weights = nnls(triangle, q.T @ target)[0]
        chosen, weights = chosen[weights > 0.0], weights[weights > 0.0]
        rest = target - rows[:, chosen] @ weights
        if np.linalg.norm(rest) < _REST:
            break
    return chosen, weights


def fit_lobe(mu: float, theta_r: float, name: str = "gaussian") -> FittedEntry:
    """Return the Gaussians of the sphere that make up one true lobe; rad."""
    direction, value, cos_h, solid_angle = lobe_samples(mu, theta_r, name=name)
    power = float((value * solid_angle).sum())
    scale = np.sqrt(solid_angle) / math.sqrt(float((value**2 * solid_angle).sum()))
    number, along, across = _candidates(name, mu, theta_r)
    shapes = gaussians(direction, unit(along, across), WIDTHS_RAD[number])
    # The last row keeps the power: constant light is reflected as it is.
    rows = np.vstack([shapes * (scale[:, None] * power), np.full((1, len(number)), _ENERGY_WEIGHT)])
    chosen, weight = _pursue(rows, np.append(value * scale, _ENERGY_WEIGHT), np.where(across > 0.0, 2, 1))
    order = np.argsort(weight)[::-1]
    chosen, weight = chosen[order], weight[order] * power
    parts = shapes[:, chosen] * weight
    total = parts.sum(axis=1)
    share = parts / np.maximum(total, 1e-300)[:, None] * (value * solid_angle)[:, None]
    # Fresnel's rise towards grazing is about (1 - cosθ_H)^5: its mean, not that of the angle, is kept.
    mean = (share * ((1.0 - cos_h) ** 5)[:, None]).sum(axis=0) / np.maximum(share.sum(axis=0), 1e-300)
    incidence = np.arccos(np.clip(1.0 - mean**0.2, 0.0, 1.0)) - theta_r
    rest = float(np.linalg.norm((total - value) * scale))
    return FittedEntry(number[chosen], along[chosen] - theta_r, across[chosen], weight, incidence, rest)


def write_table(path, name: str) -> None:
    """Fit every entry of the ladder and write the table of a lobe."""
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
