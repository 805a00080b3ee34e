"""Fit of a similarity transform at one level of a pyramid."""

import math
from typing import NamedTuple

import numpy as np

from irodori.ingest.registration import gradient_sums
from irodori.ingest.registration.gradient_sums import Fixed, Places
from irodori.ingest.registration.pyramid import choose, gradient_energy, noise_of

_REACH_PX = 12.0  # largest shift in the search, superpixels
_CANDIDATES = 3
_PRIOR = (8.0, math.radians(0.5), 0.01)  # shift in superpixels, rotation in rad, scale
_SLOPE = 0.1  # spread of a residual as a share of its gradient
_PULL = 0.1  # weight of the whole picture's colour map in that of a cell, as a share of the mean gradient energy
_GATE = 12.0  # smallest gradient energy of a place over the 5 % quantile; noise exceeds it with a probability of 0.2 %
_LEAST_PLACES = 16
_MEDIAN_PLACES = 4096  # places, up to twice as many, for the spread of residuals; 8192 values determine it to 2 %


def affine_of_level(turn: complex, shift: complex, centre: complex, scale: float) -> np.ndarray:
    """Return a similarity as a (2, 3) matrix in pixels of a level, each ``scale`` superpixels wide.

    ``turn`` (rotation and scale), ``shift`` and ``centre`` are complex numbers, in superpixels.
    """
    half = 0.5 + 0.5j
    offset = (centre + shift + half + turn * (scale * half - half - centre)) / scale - half
    return np.array([[turn.real, -turn.imag, offset.real], [turn.imag, turn.real, offset.imag]])


class Level(NamedTuple):
    """A level of the two pyramids, with the places that are compared."""

    scale: float  # superpixels per pixel of the level
    moving: np.ndarray  # (h, w, 4)
    least: np.ndarray  # (h, w) share of valid pixels of the moving picture, see `least_share`
    places: Places
    columns: int  # number of columns of cells
    mixed: bool  # whether the colour map mixes bands
    local: bool  # whether it varies from cell to cell
    fixed: Fixed
    first_weight: np.ndarray  # (cells, quota), weights of the places for the first colour map
    noise: np.ndarray  # (3,) variance of a gradient of the fixed picture due to noise


class SimilarityFit(NamedTuple):
    """A similarity p -> c + turn (p - c) + shift, with places as complex numbers, and the sums evaluated there."""

    turn: complex
    shift: complex
    sums: np.ndarray  # (cells, 25), see `irodori.ingest.registration.gradient_sums.Scores`
    weight: np.ndarray  # (cells, quota)
    coherence: float  # of predicted and measured gradients, -1..1
    places: int  # number of places that lie in both pictures
    noise_share: float  # share of the residuals' variance due to noise of the fixed picture, summed over bands


def make_level(fixed, moving, scale: float, *, shape, count: int, offsets_px, local: bool) -> Level:
    """Choose the places of a level, and compute the derivatives of the fixed picture there.

    ``shape`` is the shape of level 0, ``count`` the approximate number of places.
    """
    cell = int(min(32, max(8, min(fixed.shape[:2]) // 6)))
    noise = noise_of(fixed)
    energy = gradient_energy(fixed, noise)
    some = energy[1 :: max(1, energy.shape[0] // 64)]
    some = some[some > 0.0]  # without the border
    gate = _GATE * float(np.quantile(some, 0.05)) if some.size else 0.0
    columns = 2 * max(1, fixed.shape[1] // (2 * (cell // 2)))
    cells = columns * max(1, fixed.shape[0] // cell)
    quota = int(min(cell * (cell // 2), max(8, count // cells)))
    # In the array of a band that is sampled left of the centre, a point of the scene appears further right.
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
    """Return the colour map from fixed to moving gradients in each cell, (cells, 3, 3), from `gradient_moments`."""
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
    """Evaluate a similarity, with the given weights of places for the colour map; None with too little overlap."""
    affine = affine_of_level(turn, shift, complex(level.places.geometry[1], level.places.geometry[2]), level.scale)
    moving = gradient_sums.sample(level.moving, level.least, affine, level.places, level.fixed)
    used = np.flatnonzero(moving.valid > 0.0)
    if used.size < _LEAST_PLACES:
        return None
    colour = _colour_maps(level, gradient_sums.gradient_moments(level.places.counts, level.fixed, moving, weight))
    some = np.ascontiguousarray(used[:: -(-used.size // _MEDIAN_PLACES)])  # contiguous: avoids compiling another loop
    predicted, left = gradient_sums.residuals(level.fixed.gradient, moving.gradient, colour, some)
    found = predicted + left
    # The lower limit avoids a division by zero for pictures without noise.
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
    """Return the Fisher information, (4, 4), of all cells on the shift, and on scale and rotation times the radius."""
    upper = sums[:, 4:20].sum(axis=0).reshape(4, 4)
    return np.triu(upper) + np.triu(upper, 1).T


def align(
    level: Level, turn: complex, shift: complex, iterations: int, tolerance: float, free=(0, 1, 2, 3)
) -> SimilarityFit | None:
    """Find the similarity at one level by Gauss-Newton steps; None without overlap.

    ``free`` lists the parameters to fit: 0 and 1 shift x and y, 2 scale, 3 rotation. The iteration ends with a step
    below ``tolerance``, pixels of the level; the sums in the result are those before this step.
    """
    reach, weight = level.places.geometry[3], level.first_weight
    precision = np.array([_PRIOR[0], _PRIOR[0], _PRIOR[2] * reach, _PRIOR[1] * reach]) ** -2.0
    chosen = np.ix_(free, free)
    for _ in range(iterations):
        fit = evaluate(level, turn, shift, weight)
        if fit is None:
            return None
        # To first order, a step in the fixed frame is the negative of a step of the transform.
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
    """Return the likeliest shifts, complex, superpixels, from the correlation of gradient magnitudes at one level."""
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
