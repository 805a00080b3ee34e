"""Fit of a similarity transform at one level of a pyramid."""

import math
from typing import NamedTuple

import numpy as np

from irodori.ingest.registration import gradient_sums
from irodori.ingest.registration.gradient_sums import Fixed, Places
from irodori.ingest.registration.pyramid import choose, gradient_energy, noise_of

_REACH_PX = 12.0  # of the search, superpixels
_CANDIDATES = 3
_PRIOR = (8.0, math.radians(0.5), 0.01)  # shift in superpixels, rotation in rad, scale
_SLOPE = 0.1  # spread of a residual as a share of its gradient
_PULL = 0.1  # of the picture's colour map on a cell's, as a share of a cell's mean gradient energy
_GATE = 12.0  # gradient energy of a place over the 5 % quantile; noise alone passes it with 2 in a thousand
_LEAST_PLACES = 16
_MEDIAN_PLACES = 4096  # at most twice as many tell the spread of residuals; 8192 values tell it within 2 %


def affine_of_level(turn: complex, shift: complex, centre: complex, scale: float) -> np.ndarray:
    """Return the (2, 3) map in the pixels of a level, each ``scale`` superpixels wide."""
    half = 0.5 + 0.5j
    offset = (centre + shift + half + turn * (scale * half - half - centre)) / scale - half
    return np.array([[turn.real, -turn.imag, offset.real], [turn.imag, turn.real, offset.imag]])


class Level(NamedTuple):
    """A level of the two pyramids with the places of the fixed picture that are compared there."""

    scale: float  # superpixels in one of its pixels
    moving: np.ndarray  # (h, w, 4)
    least: np.ndarray  # (h, w) share of valid pixels of the moving picture, see `least_share`
    places: Places
    columns: int  # of cells
    mixed: bool  # whether the colour map mixes bands
    local: bool  # whether it varies from cell to cell
    fixed: Fixed
    first_weight: np.ndarray  # (cells, quota) in the first colour map
    noise: np.ndarray  # (3,) variance that noise gives a gradient of the fixed picture


class SimilarityFit(NamedTuple):
    """A similarity p -> c + turn (p - c) + shift, places as complex numbers, with the sums at it."""

    turn: complex
    shift: complex
    sums: np.ndarray  # (cells, 25)
    weight: np.ndarray  # (cells, quota)
    coherence: float  # of predicted and found gradients, -1..1
    places: int  # that lie in both pictures
    noise_share: float  # of the variance of residuals that is the fixed picture's noise, at most 1/2, over the bands


def make_level(fixed, moving, scale: float, *, shape, count: int, offsets_px, local: bool) -> Level:
    """Choose the places of one level and take the fixed picture's derivatives there; ``shape`` is that of level 0."""
    cell = int(min(32, max(8, min(fixed.shape[:2]) // 6)))
    noise = noise_of(fixed)
    energy = gradient_energy(fixed, noise)
    some = energy[1 :: max(1, energy.shape[0] // 64)]
    some = some[some > 0.0]  # which the border is not
    gate = _GATE * float(np.quantile(some, 0.05)) if some.size else 0.0
    columns = 2 * max(1, fixed.shape[1] // (2 * (cell // 2)))
    cells = columns * max(1, fixed.shape[0] // cell)
    quota = int(min(cell * (cell // 2), max(8, count // cells)))
    # A band that samples left of the centre shows a place of the scene further right in its own array.
    offsets = np.zeros((3, 2)) if offsets_px is None else -np.asarray(offsets_px, dtype=np.float64) / scale
    reach = math.sqrt((shape[0] ** 2 + shape[1] ** 2) / 12.0)
    geometry = np.array([scale, (shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0, reach])
    xy, counts = choose(energy, cell, cell // 2, quota, gate)
    places = Places(xy, counts, offsets, geometry)
    at_places = gradient_sums.template(fixed, gradient_sums.least_share(fixed), places)
    power = np.einsum("cnia,cnia->cn", at_places.gradient, at_places.gradient)
    some = power[at_places.weight > 0.0]
    typical = max(float(np.median(some)), 1e-30) if some.size else 1.0
    first_weight = (1.0 / (1.0 + power / typical)).astype(np.float32)
    mixed = offsets_px is not None
    value, first, _ = gradient_sums.spline_power()
    noise = noise**2 * value * first
    return Level(
        scale, moving, gradient_sums.least_share(moving), places, columns, mixed, local, at_places,
        first_weight, noise,
    )  # fmt: skip


def _colour_maps(level: Level, cells: np.ndarray) -> np.ndarray:
    """Return the map from fixed to moving gradients of each cell, (cells, 3, 3), from the gradients' `moments`."""
    if not level.mixed:
        cells *= np.eye(3)
    common = cells.sum(axis=0)
    power = float(np.trace(common[0])) + 1e-30
    whole = np.linalg.solve(common[0] + 1e-6 * power * np.eye(3), common[1].T).T
    if not level.local:
        return np.ascontiguousarray(np.broadcast_to(whole, (level.places.counts.size, 3, 3)))
    pull = _PULL * power / level.places.counts.size * np.eye(3)
    maps = np.linalg.solve(cells[:, 0] + pull, (cells[:, 1] + whole @ pull).swapaxes(1, 2))
    return np.ascontiguousarray(maps.swapaxes(1, 2))


def evaluate(level: Level, turn: complex, shift: complex, weight: np.ndarray) -> SimilarityFit | None:
    """Return the sums at a similarity, with the places weighted as given in the colour map; None without overlap."""
    affine = affine_of_level(turn, shift, complex(level.places.geometry[1], level.places.geometry[2]), level.scale)
    moving = gradient_sums.sample(level.moving, level.least, affine, level.places, level.fixed)
    used = np.flatnonzero(moving.valid > 0.0)
    if used.size < _LEAST_PLACES:
        return None
    colour = _colour_maps(level, gradient_sums.gradient_moments(level.places.counts, level.fixed, moving, weight))
    some = np.ascontiguousarray(used[:: -(-used.size // _MEDIAN_PLACES)])  # strided, it would compile a loop of its own
    predicted, left = gradient_sums.residuals(level.fixed.gradient, moving.gradient, colour, some)
    found = predicted + left
    # The floor keeps noiseless pictures from dividing by nothing.
    sigma = 1.4826 * np.median(np.abs(left).reshape(3, -1), axis=1)
    sigma = np.maximum(sigma, 1e-3 * math.sqrt(np.einsum("ina,ina->", found, found) / found.size) + 1e-12)
    expected = gradient_sums.Residuals(colour, sigma, _SLOPE)
    sums, weight = gradient_sums.score(level.places, level.fixed, moving, expected)
    share = float(np.minimum(0.5, (colour**2).mean(axis=0) @ level.noise / sigma**2).sum())
    scale = (sigma**-2.0).astype(np.float32)
    both = np.einsum("i,ina,ina->n", scale, predicted, found)
    energy = np.einsum("i,ina,ina->n", scale, predicted, predicted) + np.einsum("i,ina,ina->n", scale, found, found)
    coherence = float((2.0 * both / np.maximum(energy, np.float32(1e-30))).mean())
    return SimilarityFit(turn, shift, sums, weight, coherence, used.size, share)


def information_of(sums: np.ndarray) -> np.ndarray:
    """Return the (4, 4) information of all cells on shift, and on scale and rotation times the picture's radius."""
    upper = sums[:, 4:20].sum(axis=0).reshape(4, 4)
    return np.triu(upper) + np.triu(upper, 1).T


def align(
    level: Level, turn: complex, shift: complex, iterations: int, tolerance: float, free=(0, 1, 2, 3)
) -> SimilarityFit | None:
    """Return the Gauss-Newton solution at one level, over some of: shift x, y, scale, rotation.

    Ends with a step below ``tolerance``, pixels of the level; the sums of the result are those before that step.
    """
    reach, weight = level.places.geometry[3], level.first_weight
    precision = np.array([_PRIOR[0], _PRIOR[0], _PRIOR[2] * reach, _PRIOR[1] * reach]) ** -2.0
    chosen = np.ix_(free, free)
    for _ in range(iterations):
        fit = evaluate(level, turn, shift, weight)
        if fit is None:
            return None
        # A step of the fixed frame is minus a step of the map, to first order.
        state = np.array([shift.real, shift.imag, (turn.real - 1.0) * reach, turn.imag * reach])
        pull = fit.sums[:, :4].sum(axis=0) + precision * state
        step = np.zeros(4)
        step[list(free)] = np.linalg.solve((information_of(fit.sums) + np.diag(precision))[chosen], pull[list(free)])
        length = math.hypot(*step)
        step *= min(1.0, 2.0 * level.scale / max(length, 1e-30))
        turn /= 1.0 + complex(step[2], step[3]) / reach
        shift -= turn * complex(step[0], step[1])
        weight = fit.weight
        if length < tolerance * level.scale:
            return fit._replace(turn=turn, shift=shift)
    return evaluate(level, turn, shift, weight)


def search(fixed, moving, scale: float) -> list[complex]:
    """Return the likeliest shifts in superpixels, from the gradient magnitudes of one level."""
    from scipy import fft  # slow to import, and a good start needs no search

    parts = []
    for picture in (fixed, moving):
        energy = gradient_energy(picture, noise_of(picture))
        mask = np.zeros(energy.shape)
        mask[1:-1, 1:-1] = picture[1:-1, 1:-1, 3] > 0.5
        parts += [energy**0.25 * mask, mask]
    reach = math.ceil(_REACH_PX / scale) + 1
    shape = [fft.next_fast_len(n + reach, real=True) for n in fixed.shape[:2]]
    f, inside_f, m, inside_m = (fft.rfft2(part, shape) for part in parts)
    ff, mm = fft.rfft2(parts[0] ** 2, shape), fft.rfft2(parts[2] ** 2, shape)

    def correlate(a, b):
        return fft.irfft2(np.conj(a) * b, shape)

    overlap = np.maximum(np.round(correlate(inside_f, inside_m)), 1.0)
    sum_f, sum_m = correlate(f, inside_m), correlate(inside_f, m)
    power_f = correlate(ff, inside_m) - sum_f**2 / overlap
    power_m = correlate(inside_f, mm) - sum_m**2 / overlap
    tiny = max(1e-9 * max(power_f.max(), power_m.max()), 1e-30)
    score = correlate(f, m) - sum_f * sum_m / overlap
    score /= np.sqrt(np.maximum(power_f, tiny) * np.maximum(power_m, tiny))
    span = np.arange(-reach, reach + 1)
    window = score[np.ix_(span % shape[0], span % shape[1])]
    found = []
    for _ in range(_CANDIDATES):
        y, x = np.unravel_index(np.argmax(window), window.shape)
        found.append(scale * complex(span[x], span[y]))
        window[max(0, y - 1) : y + 2, max(0, x - 1) : x + 2] = -np.inf
    return found
