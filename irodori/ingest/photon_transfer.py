"""Noise model of a camera by photon transfer: the variance between equal frames as a function of their level.

With g electrons per digital number (DN), shot noise adds a variance of 1/g DN² per DN of level; the variance without
light is read noise and rounding (1/12 DN²). Frames of a pair are subtracted, which removes fixed patterns such as flat
field and pixel gain. One frame is first scaled to the mean of the other, which removes drift of the light [J. R.
Janesick, Photon Transfer, SPIE 2007].
"""

import itertools
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from irodori.config.capture_table import Shot, shot_path
from irodori.core.progress import LOGGER, track
from irodori.ingest.mosaic import Mosaic, decode
from irodori.jit.compilation import njit

ROUNDING_DN2 = 1 / 12
_TILE = 16  # pixels of one colour along the side of a tile
_MAX_LEVEL = 0.9  # largest usable level, relative to saturation
_MAX_PAIRS = 12
_LEAST_VARIANCE_DN2 = 0.3  # below, rounding errors do not have a variance of 1/12
_DARK_ROLE = "dark"


@dataclass(frozen=True)
class PhotonTransfer:
    """Gain and read noise of a camera at one ISO; NaN if not measurable.

    Parameters
    ----------
    gain_e_per_dn, gain_error : float
        Electrons per digital number, and its standard error.
    read_noise_dn, read_noise_error : float
        Standard deviation without light, including rounding, and its standard error, DN.
    gain_by_colour : tuple of float
        Gain from red, green and blue pixels separately.
    gain_error_by_colour : tuple of float
        Standard errors of these.
    iso : float
        ISO of the frames, 0 if unknown.
    """

    gain_e_per_dn: float = np.nan
    gain_error: float = np.nan
    read_noise_dn: float = np.nan
    read_noise_error: float = np.nan
    gain_by_colour: tuple[float, ...] = (np.nan,) * 3
    gain_error_by_colour: tuple[float, ...] = (np.nan,) * 3
    iso: float = 0.0

    @property
    def read_noise_e(self) -> float:
        """Standard deviation without light, excluding rounding, electrons."""
        return float(np.sqrt(max(self.read_noise_dn**2 - ROUNDING_DN2, 0.0)) * self.gain_e_per_dn)

    def at(self, iso_ratio: float) -> tuple[float, float]:
        """Return electrons per DN, and the variance without light in DN², at another amplification.

        Read noise is assumed to arise before the amplifier, so it scales with the amplification; rounding does not.
        """
        read = (self.read_noise_dn**2 - ROUNDING_DN2) * iso_ratio**2 + ROUNDING_DN2
        return self.gain_e_per_dn / iso_ratio, read


@njit(cache=True, nogil=True)
def _tile_point(a, b, ratio, sound):
    """Return number of pixels, mean of a, and variance of a - ratio b within one tile."""
    count, mean, level, square = 0, 0.0, 0.0, 0.0
    for y in range(a.shape[0]):
        for x in range(a.shape[1]):
            if not sound[y, x]:
                continue
            difference = float(a[y, x]) - ratio * float(b[y, x])
            count += 1
            level += float(a[y, x])
            step = difference - mean
            mean += step / count
            square += step * (difference - mean)
    if count < 2:
        return 0, 0.0, 0.0
    return count, level / count, square / (count - 1)


@njit(cache=True, nogil=True)
def _points(a, b, ratio, sound, tile, out):
    at = 0
    for y in range(0, a.shape[0], tile):
        for x in range(0, a.shape[1], tile):
            part = (slice(y, y + tile), slice(x, x + tile))
            out[at, 0], out[at, 1], out[at, 2] = _tile_point(a[part], b[part], ratio, sound[part])
            at += 1


def transfer_points(first: Mosaic, second: Mosaic, hot_px: np.ndarray) -> np.ndarray:
    """Compute the points that a pair of equal frames contributes to the photon-transfer curve.

    Parameters
    ----------
    first, second : Mosaic
    hot_px : (n, 2) int
        Row and column of mosaic pixels to leave out.

    Returns
    -------
    (n, 5) float64
        For each tile: band; number of pixels; level above black, DN; ratio of the first frame's level to the second's;
        variance of the first frame minus ratio times the second, DN². Tiles near saturation are left out.
    """
    sound = np.ones(first.values.shape, dtype=np.bool_)
    sound[hot_px[:, 0], hot_px[:, 1]] = False
    ratio, lit = _level_ratio(first, second)
    points = []
    for row, column, band in first.places():
        at = (slice(row, None, 2), slice(column, None, 2))
        a, b, black = first.values[at], second.values[at], float(first.black[row, column])
        out = np.empty((-(-a.shape[0] // _TILE) * -(-a.shape[1] // _TILE), 3))
        _points(a, b, ratio, sound[at], _TILE, out)
        # a - ratio b contains black x (1 - ratio), a constant that does not affect the variance.
        level = out[:, 1] - black
        keep = (out[:, 0] > _TILE) & (level < _MAX_LEVEL * (float(first.white[row, column]) - black))
        if not lit and keep.any():
            # Without light all tiles have the same level; the mean of a single tile would depend on its noise.
            level = np.full_like(level, level[keep].mean())
        count = int(keep.sum())
        points.append(
            np.stack([np.full(count, band), out[keep, 0], level[keep], np.full(count, ratio), out[keep, 2]], axis=1)
        )
    return np.concatenate(points)


def _level_ratio(first: Mosaic, second: Mosaic) -> tuple[float, bool]:
    """Return the ratio of the light in the first frame to that in the second, and whether the frames are lit.

    Frames with levels below a hundredth of the range count as unlit, and the ratio is 1.
    """
    top = total_a = total_b = 0.0
    for row, column, _ in first.places():
        a, b = (float(m.values[row::2, column::2].mean()) - float(m.black[row, column]) for m in (first, second))
        scale = float(first.white[row, column] - first.black[row, column])
        if max(a, b) < _MAX_LEVEL * scale:  # clipped values would hide the drift
            total_a, total_b, top = total_a + a, total_b + b, max(top, a / scale)
    lit = top > 0.01 and total_b > 0
    return (total_a / total_b if lit else 1.0), lit


def fit_transfer(points: np.ndarray) -> tuple[float, float, float, float]:
    """Fit gain and read noise to points of `transfer_points`.

    Returns
    -------
    gain_e_per_dn, gain_error, read_noise_dn, read_noise_error : float
        NaN if the points do not determine them.

    Notes
    -----
    The variance of a - r b is read² (1 + r²) + level (1 + r) / gain. Weights are computed from the fitted line and not
    from the variance of each point, which would bias the fit downwards.
    """
    nothing = (np.nan,) * 4
    _, count, level, ratio, variance = points.T
    if not (variance > 0).any():
        return nothing
    design = np.stack([1.0 + ratio**2, level * (1.0 + ratio)], axis=1)
    model = np.maximum(np.full_like(variance, variance.mean()), ROUNDING_DN2)
    # Unlit frames do not determine the gain.
    lit = level.max() > 100.0 * max(np.sqrt(variance.mean()), 1.0) or np.ptp(level) > 10.0 * np.sqrt(variance.mean())
    columns = [0, 1] if lit else [0]
    for _ in range(6):
        weight = (count - 1.0) / (2.0 * model**2)
        weight[model / design[:, 0] < _LEAST_VARIANCE_DN2] *= 1e-6 if (model / design[:, 0]).max() > 1.0 else 1.0
        part = design[:, columns]
        normal = part.T @ (weight[:, None] * part)
        if np.linalg.cond(normal / np.sqrt(np.outer(np.diag(normal), np.diag(normal)))) > 1e10:
            return nothing
        solution = np.linalg.solve(normal, part.T @ (weight * variance))
        model = np.maximum(part @ solution, 0.1 * ROUNDING_DN2)
    # If an electron is worth many digital numbers, variances scatter more than for a normal distribution.
    scatter = np.sum(weight * (variance - model) ** 2) / max(len(variance) - len(columns), 1)
    error = np.sqrt(np.diag(np.linalg.inv(normal)) * max(scatter, 1.0))
    # The variance of rounding is a lower limit; without dark frames the extrapolation may give less, even below zero.
    read = np.sqrt(max(float(solution[0]), ROUNDING_DN2))
    read_error = float(error[0] / (2.0 * read))
    if not lit or solution[1] <= 0:
        return np.nan, np.nan, float(read), read_error
    return float(1.0 / solution[1]), float(error[1] / solution[1] ** 2), float(read), read_error


def equal_pairs(shots: list[Shot]) -> list[tuple[Shot, Shot]]:
    """Return pairs of successive shots with the same settings; each shot is in at most one pair."""
    groups: dict[tuple, list[Shot]] = {}
    for shot in shots:
        key = (shot.role, shot.pose, shot.filter, shot.exposure_s, shot.iso, shot.f_number, shot.light_level)
        groups.setdefault(key, []).append(shot)
    return [pair for group in groups.values() for pair in zip(group[::2], group[1::2], strict=False)]


def measure_noise(shots: list[Shot], table, folder, hot_px: np.ndarray) -> PhotonTransfer:
    """Measure the noise of a camera from pairs of equal frames among its dark frames and white references.

    Only pairs with the ISO of most lit pairs are used, and at most 12, chosen over as many levels as possible.
    """
    pairs = [pair for pair in equal_pairs(shots) if pair[0].role in (_DARK_ROLE, "white")]
    lit = [first.iso for first, _ in pairs if first.role != _DARK_ROLE] or [first.iso for first, _ in pairs]
    if not pairs:
        return PhotonTransfer()
    iso = max(sorted(set(lit)), key=lit.count)
    pairs = [pair for pair in pairs if pair[0].iso == iso]
    pairs = _spread(pairs)[:_MAX_PAIRS]
    found = []
    for first, second in track(pairs, "photon transfer"):
        a, b = (decode(shot_path(shot, table, folder), shot.linear) for shot in (first, second))
        if np.array_equal(a.values, b.values):
            LOGGER.warning("%s and %s hold the same picture: they tell nothing of noise", first.file, second.file)
            continue
        found.append(transfer_points(a, b, hot_px))
    if not found:
        return PhotonTransfer()
    points = np.concatenate(found)
    overall = fit_transfer(points)
    by_colour = [fit_transfer(points[points[:, 0] == band]) for band in range(3)]
    noise = PhotonTransfer(*overall, tuple(c[0] for c in by_colour), tuple(c[1] for c in by_colour), iso)
    LOGGER.info(
        "photon transfer from %d pairs: gain %.4g ± %.2g e/DN, read noise %.4g ± %.2g DN",
        len(pairs), *overall,
    )  # fmt: skip
    return noise


def _spread(pairs: list) -> list:
    """Sort pairs: the first of every exposure level, then the second of every level, and so on."""
    ranks: dict[tuple, Iterator[int]] = defaultdict(itertools.count)
    return sorted(pairs, key=lambda pair: next(ranks[pair[0].role, pair[0].filter, pair[0].exposure_s]))
