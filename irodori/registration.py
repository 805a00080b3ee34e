"""Registration of two pictures of one object, taken without and with a comb-filter plate before the lens.

DOC
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import fft

from irodori import registration_kernels as kernels
from irodori.resampling import resample_affine

_COARSEST_PX = 160
_REACH_PX = 12.0
_FINEST_PIXELS = 800_000
_PLACES = (60_000, 12_000)  # at the finest level, at the others
_CANDIDATES = 3
_PRIOR = (8.0, math.radians(0.5), 0.01)  # shift in superpixels, rotation in rad, scale
_SLOPE = 0.1
_STEP_PX = 1e-3
_UNDETERMINED_PX = 1.0
_FLOOR_PX = 0.05
_LEAST_LEVEL_PX = 24
_LEAST_COHERENCE = 0.1


@dataclass(frozen=True)
class Registration:
    """The similarity that leads from the fixed to the moving picture: c + scale R(rotation) (p - c) + (dx, dy).

    Superpixel coordinates, x right, y down; the centre of a superpixel is an integer. A positive rotation turns x
    towards y.

    Parameters
    ----------
    dx_px, dy_px : float, superpixels
    rotation_rad : float, rad
    scale : float
    residual_px : float, superpixels
        Displacement (rms over local blocks, weighted with what each block can tell, without its noise) that the
        similarity leaves unexplained. NaN where nothing could be measured.
    sigma_px : float, superpixels
        Predicted standard error of the alignment, rms over the picture; inf where the content does not determine it.
    centre_px : (2,) tuple of float, superpixels
        Centre c of the picture, x then y: ((W - 1) / 2, (H - 1) / 2).
    """

    dx_px: float
    dy_px: float
    rotation_rad: float
    scale: float
    residual_px: float
    sigma_px: float
    centre_px: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def identity(cls) -> "Registration":
        """Return the map that moves nothing, taken as exact; it needs no centre."""
        return cls(0.0, 0.0, 0.0, 1.0, 0.0, 0.0)

    def affine(self, centre_px=None) -> np.ndarray:
        """Return the (2, 3) matrix moving_from_fixed, about another centre if one is given."""
        centre = complex(*(self.centre_px if centre_px is None else centre_px))
        return _affine(*self._complex(), centre, 1.0)

    def moving_from_fixed(self, xy) -> np.ndarray:
        """Return where places of the fixed picture lie in the moving one, (..., 2) to (..., 2), superpixels."""
        matrix = self.affine()
        return np.asarray(xy, dtype=np.float64) @ matrix[:, :2].T + matrix[:, 2]

    def _complex(self) -> tuple[complex, complex]:
        turn = complex(math.cos(self.rotation_rad), math.sin(self.rotation_rad))
        return self.scale * turn, complex(self.dx_px, self.dy_px)


def _affine(turn: complex, shift: complex, centre: complex, scale: float) -> np.ndarray:
    """Return the (2, 3) map in the pixels of a level, each ``scale`` superpixels wide."""
    half = 0.5 + 0.5j
    offset = (centre + shift + half + turn * (scale * half - half - centre)) / scale - half
    return np.array([[turn.real, -turn.imag, offset.real], [turn.imag, turn.real, offset.imag]])


class _Level(NamedTuple):
    """A level of the two pyramids with the places of the fixed picture that are compared there."""

    scale: float
    moving: np.ndarray  # (h, w, 4)
    places: np.ndarray  # (cells, quota, 2)
    counts: np.ndarray  # (cells,)
    offsets: np.ndarray  # (3, 2) pixels of the level
    gradient: np.ndarray  # (cells, quota, 3, 2)
    curvature: np.ndarray  # (cells, quota, 3, 3)
    weight: np.ndarray  # (cells, quota)
    columns: int
    geometry: np.ndarray  # (4,)
    diagonal: bool


class _Fit(NamedTuple):
    """A similarity with the sums at it."""

    turn: complex
    shift: complex
    sums: np.ndarray  # (cells, 25)
    colour: np.ndarray  # (3, 3)
    sigma: np.ndarray  # (3,)
    coherence: float
    weight: np.ndarray


def _level(fixed, moving, scale, shape, count, offsets, diagonal) -> _Level:
    cell = int(min(32, max(8, min(fixed.shape[:2]) // 6)))
    height, width = cell, cell // 2
    cells = max(1, fixed.shape[0] // height) * 2 * max(1, fixed.shape[1] // (2 * width))
    quota = int(min(height * width, max(8, count // cells)))
    places, counts = kernels.choose(kernels.gradient_energy(fixed), height, width, quota)
    offsets = np.asarray(offsets) / scale
    gradient, curvature, weight = kernels.template(fixed, places, counts, offsets)
    reach = math.sqrt((shape[0] ** 2 + shape[1] ** 2) / 12.0)
    geometry = np.array([scale, (shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0, reach])
    columns = 2 * max(1, fixed.shape[1] // (2 * width))
    return _Level(scale, moving, places, counts, offsets, gradient, curvature, weight, columns, geometry, diagonal)


_LOCAL = 0.1


def _colour_map(level: _Level, moving, weight):
    cells = kernels.moments(level.gradient, moving, weight, level.counts)
    sums = cells.sum(axis=0)
    power = np.diag(sums[0])
    if not (power > 0.0).any():
        return np.zeros((level.counts.size, 3, 3))
    if level.diagonal:
        common = np.diag(np.diag(sums[1]) / np.where(power > 0, power, np.inf))
    else:
        ridge = 1e-6 * power.max() * np.eye(3)
        common = np.linalg.solve(sums[0] + ridge, sums[1].T).T
    if _LOCAL == 0.0:
        return np.ascontiguousarray(np.broadcast_to(common, (level.counts.size, 3, 3)))
    pull = _LOCAL * power.max() / level.counts.size
    if level.diagonal:
        i = np.arange(3)
        out = np.zeros((level.counts.size, 3, 3))
        out[:, i, i] = (cells[:, 1, i, i] + pull * common[i, i]) / (cells[:, 0, i, i] + pull + 1e-30)
        return out
    pull = (pull + 1e-30) * np.eye(3)
    return np.ascontiguousarray(
        np.linalg.solve(cells[:, 0] + pull, (cells[:, 1] + common @ pull).swapaxes(1, 2)).swapaxes(1, 2)
    )


def _evaluate(level: _Level, turn: complex, shift: complex, weight, shifts=None) -> _Fit | None:
    centre = complex(level.geometry[1], level.geometry[2])
    if shifts is None:
        shifts = np.zeros((level.counts.size, 2))
    affine = _affine(turn, shift, centre, level.scale)
    moving, valid = kernels.sample(level.moving, level.places, level.counts, level.offsets, affine, shifts)
    valid = np.minimum(valid, level.weight)
    used = valid > 0.0
    if np.count_nonzero(used) < 16:
        return None
    if weight is None:
        energy = (level.gradient**2).sum(axis=(2, 3))
        weight = 1.0 / (1.0 + energy / max(float(np.median(energy[used])), 1e-30))
    colour = _colour_map(level, moving, (weight * valid).astype(np.float32))
    residual = kernels.residuals(level.gradient, moving, colour, level.counts)
    rows = np.flatnonzero(used.ravel())[:: max(1, np.count_nonzero(used) // 8192)]
    some = residual.reshape(-1, 3, 2)[rows]
    other = moving.reshape(-1, 3, 2)[rows]
    spread = np.median(np.abs(some), axis=(0, 2)) * 1.4826
    floor = 1e-3 * np.sqrt((other.astype(np.float64) ** 2).mean()) + 1e-12
    sigma = np.maximum(spread, floor)
    sums, weight = kernels.scores(
        level.places, residual, level.gradient, level.curvature, colour, valid, level.counts, sigma, _SLOPE,
        level.geometry,
    )  # fmt: skip
    model = (other - some) / sigma[:, None]
    other = other / sigma[:, None]
    energy = (model**2).sum(axis=(1, 2)) + (other**2).sum(axis=(1, 2))
    coherence = float((2.0 * (model * other).sum(axis=(1, 2)) / np.maximum(energy, 1e-30)).mean())
    return _Fit(turn, shift, sums, colour, sigma, coherence, weight)


def _information(total: np.ndarray) -> np.ndarray:
    matrix = total[4:20].reshape(4, 4)
    return np.triu(matrix) + np.triu(matrix, 1).T


def _align(level: _Level, turn: complex, shift: complex, iterations: int, free=(0, 1, 2, 3)) -> _Fit | None:
    """Gauss-Newton at one level; steps are taken in the fixed picture's frame (inverse composition)."""
    reach, weight, free = level.geometry[3], None, list(free)
    precision = np.array([_PRIOR[0], _PRIOR[0], _PRIOR[2] * reach, _PRIOR[1] * reach]) ** -2.0
    fit = None
    for iteration in range(iterations + 1):
        fit = _evaluate(level, turn, shift, weight)
        if fit is None or iteration == iterations:
            return fit
        total = fit.sums.sum(axis=0)
        state = np.array([shift.real, shift.imag, (turn.real - 1.0) * reach, turn.imag * reach])
        information = _information(total) + np.diag(precision)
        # A step of the fixed frame is minus a step of the map, to first order.
        gain = total[:4] + precision * state
        step = np.zeros(4)
        step[free] = np.linalg.solve(information[np.ix_(free, free)], gain[free])
        length = math.hypot(*step)
        limit = 2.0 * level.scale
        if length > limit:
            step *= limit / length
        turn = turn / (1.0 + complex(step[2], step[3]) / reach)
        shift = shift - turn * complex(step[0], step[1])
        weight = fit.weight
        if length < _STEP_PX:
            return fit._replace(turn=turn, shift=shift)
    return fit


def _search(fixed, moving, scale: float) -> list[complex]:
    """Return the likeliest shifts at one level by masked normalised correlation of gradient magnitudes [Padfield]."""
    parts = []
    for picture in (fixed, moving):
        energy = kernels.gradient_energy(picture)
        mask = np.zeros(energy.shape)
        mask[1:-1, 1:-1] = picture[1:-1, 1:-1, 3] > 0.5
        parts += [energy**0.25 * mask, mask]
    shape = [fft.next_fast_len(n + int(_REACH_PX / scale) + 2, real=True) for n in fixed.shape[:2]]
    f, mf, m, mm = (fft.rfft2(p, shape) for p in parts)
    f2, m2 = fft.rfft2(parts[0] ** 2, shape), fft.rfft2(parts[2] ** 2, shape)

    def correlate(a, b):
        return fft.irfft2(np.conj(a) * b, shape)

    overlap = np.maximum(np.round(correlate(mf, mm)), 1.0)
    sf, sm = correlate(f, mm), correlate(mf, m)
    top = correlate(f, m) - sf * sm / overlap
    vf, vm = correlate(f2, mm) - sf**2 / overlap, correlate(mf, m2) - sm**2 / overlap
    tiny = 1e-9 * max(vf.max(), vm.max(), 1e-30)
    score = top / np.sqrt(np.maximum(vf, tiny) * np.maximum(vm, tiny))
    reach = int(math.ceil(_REACH_PX / scale)) + 1
    span = np.arange(-reach, reach + 1)
    window = score[np.ix_(span % shape[0], span % shape[1])].copy()
    found = []
    for _ in range(_CANDIDATES):
        y, x = np.unravel_index(np.argmax(window), window.shape)
        if not np.isfinite(window[y, x]):
            break
        found.append(scale * complex(span[x], span[y]))
        window[max(0, y - 1) : y + 2, max(0, x - 1) : x + 2] = -np.inf
    return found


def _pyramid(image, valid, finest: int, coarsest: int) -> dict[int, np.ndarray]:
    levels = {finest: kernels.pack(image, valid) if finest == 0 else kernels.pack_halve(image, valid)}
    for n in range(1, finest):
        levels[finest] = kernels.halve(levels[finest])
    for n in range(finest + 1, coarsest + 1):
        levels[n] = kernels.halve(levels[n - 1])
    return levels


def register(
    fixed,
    moving,
    fixed_valid,
    moving_valid,
    start: Registration | None = None,
    *,
    offsets=None,
    _finest=None,
    _places=_PLACES,
) -> Registration:
    shape = fixed.shape[:2]
    diagonal = offsets is None
    offsets = np.zeros((3, 2)) if offsets is None else offsets
    coarsest = max(0, math.ceil(math.log2(max(max(shape) / _COARSEST_PX, 1))))
    finest = min(max(0, math.ceil(math.log(max(shape[0] * shape[1] / _FINEST_PIXELS, 1), 4))), coarsest)
    if _finest is not None:
        finest = min(_finest, coarsest)
    f, m = (_pyramid(i, v, finest, coarsest) for i, v in ((fixed, fixed_valid), (moving, moving_valid)))
    scale = float(2**coarsest)
    level = _level(f[coarsest], m[coarsest], scale, shape, _PLACES[1], offsets, diagonal)
    candidates = [(1.0 + 0.0j, d) for d in _search(f[coarsest], m[coarsest], scale)]
    if start is not None:
        candidates.append(start._complex())
    best = None
    for turn, shift in candidates:
        fit = _align(level, turn, shift, 3, (0, 1))
        fit = fit and _align(level, turn, fit.shift, 5)
        if fit is not None and (best is None or fit.coherence > best.coherence):
            best = fit
    fit = best
    for n in range(coarsest, finest - 1, -1):
        if fit is None:
            break
        last = n == finest
        level = _level(f[n], m[n], float(2**n), shape, _places[0 if last else 1], offsets, diagonal)
        fit = _align(level, fit.turn, fit.shift, 8 if last else 3)
    return _report(level, fit, shape)


def _report(level, fit, shape):
    centre = ((shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0)
    if fit is None or fit.coherence < _LEAST_COHERENCE:
        return Registration(0.0, 0.0, 0.0, 1.0, math.nan, math.inf, centre)
    fit = _evaluate(level, fit.turn, fit.shift, fit.weight)
    total = fit.sums.sum(axis=0)
    info = _information(total)
    sigma = _sigma(level, fit, info)
    return Registration(
        fit.shift.real, fit.shift.imag, math.atan2(fit.turn.imag, fit.turn.real), abs(fit.turn),
        _residual(level, fit), sigma, centre,
    )  # fmt: skip


def _sigma(level, fit, info):
    values = np.linalg.eigvalsh(info)
    if values[0] <= 0 or values[0] ** -0.5 > _UNDETERMINED_PX:
        return math.inf
    g = fit.sums[:, :4]
    model = np.linalg.inv(info)
    n = np.count_nonzero(fit.sums[:, 23])
    sandwich = model @ (g.T @ g) @ model * n / max(n - 4, 1)
    return math.sqrt(max(np.trace(model), np.trace(sandwich)))


def _residual(level, fit):
    cells = level.counts.size
    axx, axy, ayy = fit.sums[:, 20], fit.sums[:, 21], fit.sums[:, 22]
    a = np.stack([np.stack([axx, axy], -1), np.stack([axy, ayy], -1)], -2)
    eye = np.eye(2)
    damp = np.linalg.inv(eye + _FLOOR_PX**2 * a)
    b = damp @ a
    h = (damp @ fit.sums[:, :2, None])[..., 0]
    top = (h[0::2] * h[1::2]).sum()
    bottom = np.einsum("nij,nji->", b[0::2], b[1::2])
    if not bottom > 0:
        return math.nan
    return math.sqrt(max(0.0, 2.0 * top / bottom))


def resample(image, valid, registration: Registration):
    height, width = image.shape[:2]
    affine = registration.affine(((width - 1) / 2.0, (height - 1) / 2.0))
    return resample_affine(np.ascontiguousarray(image, dtype=np.float32), valid, affine)
