"""Noise model of a camera from photon transfer: variance of equal frames against their level.

Shot noise of g electrons per digital number makes the variance grow by 1/g per digital number; what is left at no
light is read noise and rounding (1/12 DN²). Pairs of frames are subtracted, so that what is fixed in the picture,
flat field and pixel gain, falls out, and one frame of a pair is scaled to the other's mean, so that drift of the light
does. [J. R. Janesick, Photon Transfer, SPIE 2007]
"""

from dataclasses import dataclass

import numpy as np

from irodori.config.capture_table import Shot, shot_path
from irodori.core.progress import LOGGER, track
from irodori.ingest.mosaic import Mosaic, decode
from irodori.jit.compilation import njit

ROUNDING_DN2 = 1 / 12
_TILE = 16  # pixels of one colour along the side of a tile
_MAX_LEVEL = 0.9  # of the range to saturation
_MAX_PAIRS = 12
_LEAST_VARIANCE_DN2 = 0.3  # below, rounding is no longer noise of 1/12
_DARK_ROLE = "dark"


@dataclass(frozen=True)
class PhotonTransfer:
    """Photon transfer of a camera, at one ISO.

    Parameters
    ----------
    gain_e_per_dn, gain_error : float
        Electrons per digital number and its standard error, NaN where not measurable.
    read_noise_dn, read_noise_error : float
        Standard deviation without light, rounding included, and its standard error.
    gain_by_colour : tuple of float
        Gain from the red, green and blue pixels alone.
    gain_error_by_colour : tuple of float
    iso : float
        ISO of the frames, 0 where unknown.
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
        """Standard deviation without light and without rounding, electrons."""
        return float(np.sqrt(max(self.read_noise_dn**2 - ROUNDING_DN2, 0.0)) * self.gain_e_per_dn)

    def at(self, iso_ratio: float) -> tuple[float, float]:
        """Return electrons per DN and the variance without light, DN², at another amplification.

        The read noise is taken to arise before the amplifier and grows with it; rounding does not.
        """
        read = (self.read_noise_dn**2 - ROUNDING_DN2) * iso_ratio**2 + ROUNDING_DN2
        return self.gain_e_per_dn / iso_ratio, read


@njit(cache=True, nogil=True)
def _tile_point(a, b, ratio, sound):
    """Return count, mean of a, and the variance of a - ratio b within one tile."""
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
    """Return the points that two equal frames add to the photon-transfer curve.

    Parameters
    ----------
    first, second : Mosaic
    hot_px : (n, 2) int
        Row and column of mosaic pixels to leave out.

    Returns
    -------
    (n, 5) float64
        Band; pixels; level above black, DN; ratio of the first frame's level to the second's; variance of the first
        frame minus ratio times the second, DN². Tiles near saturation are left out.
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
        # a - ratio b holds black x (1 - ratio), a constant that a variance does not see.
        level = out[:, 1] - black
        keep = (out[:, 0] > _TILE) & (level < _MAX_LEVEL * (float(first.white[row, column]) - black))
        if not lit and keep.any():
            # Without light the level is one, and a tile's own mean would carry the noise that is to be judged by it.
            level = np.full_like(level, level[keep].mean())
        count = int(keep.sum())
        points.append(
            np.stack([np.full(count, band), out[keep, 0], level[keep], np.full(count, ratio), out[keep, 2]], axis=1)
        )
    return np.concatenate(points)


def _level_ratio(first: Mosaic, second: Mosaic) -> tuple[float, bool]:
    """Return by how much the light of the first frame exceeded that of the second, and whether there is any.

    Below a hundredth of the range there is none, and the ratio is 1.
    """
    top = total_a = total_b = 0.0
    for row, column, _ in first.places():
        a, b = (float(m.values[row::2, column::2].mean()) - float(m.black[row, column]) for m in (first, second))
        scale = float(first.white[row, column] - first.black[row, column])
        if max(a, b) < _MAX_LEVEL * scale:  # a clipped plane knows no drift
            total_a, total_b, top = total_a + a, total_b + b, max(top, a / scale)
    lit = top > 0.01 and total_b > 0
    return (total_a / total_b if lit else 1.0), lit


def fit_transfer(points: np.ndarray) -> tuple[float, float, float, float]:
    """Fit the straight line of photon transfer to points of `transfer_points`.

    Returns
    -------
    gain_e_per_dn, gain_error, read_noise_dn, read_noise_error : float
        NaN where the points do not determine them.

    Notes
    -----
    The variance of a - r b is read² (1 + r²) + level (1 + r) / gain. Weights follow from the fitted line and not from
    each point's own scatter, which would pull the fit down.
    """
    nothing = (np.nan,) * 4
    _, count, level, ratio, variance = points.T
    if not (variance > 0).any():
        return nothing
    design = np.stack([1.0 + ratio**2, level * (1.0 + ratio)], axis=1)
    model = np.maximum(np.full_like(variance, variance.mean()), ROUNDING_DN2)
    # Without light there is no gain to see; with little difference between levels no read noise.
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
    # Single electrons of many digital numbers scatter more than a normal distribution would.
    scatter = np.sum(weight * (variance - model) ** 2) / max(len(variance) - len(columns), 1)
    error = np.sqrt(np.diag(np.linalg.inv(normal)) * max(scatter, 1.0))
    # Rounding alone leaves this much; pairs without dark frames may extrapolate to less, even below zero.
    read = np.sqrt(max(float(solution[0]), ROUNDING_DN2))
    read_error = float(error[0] / (2.0 * read))
    if not lit or solution[1] <= 0:
        return np.nan, np.nan, float(read), read_error
    return float(1.0 / solution[1]), float(error[1] / solution[1] ** 2), float(read), read_error


def equal_pairs(shots: list[Shot]) -> list[tuple[Shot, Shot]]:
    """Return pairs of shots that differ in nothing, each shot in one pair, next to each other in time."""
    groups: dict[tuple, list[Shot]] = {}
    for shot in shots:
        key = (shot.role, shot.pose, shot.filter, shot.exposure_s, shot.iso, shot.f_number)
        groups.setdefault(key, []).append(shot)
    return [pair for group in groups.values() for pair in zip(group[::2], group[1::2], strict=False)]


def measure_noise(shots: list[Shot], table, folder, hot_px: np.ndarray) -> PhotonTransfer:
    """Return a camera's noise from the pairs of equal frames among its dark frames and white references.

    Pairs of the ISO that most lit pairs have count; of more than 12 pairs the first of every level count.
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
    """Return pairs in the order: the first of every level, then the second of every level, and so on."""
    seen: dict[tuple, int] = {}
    ranked = []
    for number, pair in enumerate(pairs):
        key = (pair[0].role, pair[0].filter, pair[0].exposure_s)
        seen[key] = seen.get(key, -1) + 1
        ranked.append((seen[key], number, pair))
    return [pair for *_, pair in sorted(ranked, key=lambda item: item[:2])]
