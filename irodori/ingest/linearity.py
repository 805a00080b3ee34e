"""Linearity of a camera, measured from an exposure series of one subject."""

from dataclasses import dataclass

import numpy as np

from irodori.config.capture_table import Shot, shot_path
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER, track
from irodori.ingest.dark_frames import Dark
from irodori.ingest.exposure_settings import iso_ratio, relative_exposure_s
from irodori.ingest.mosaic import Mosaic, decode

_MAX_LEVEL = 0.9  # largest usable level, relative to saturation
_MIN_LEVEL = 0.005  # smallest usable level, relative to saturation: below, black level and stray light dominate
_SIGMAS = 2.0


@dataclass(frozen=True)
class Linearity:
    """Deviation of the response rate over a series of exposures.

    Parameters
    ----------
    exposure_s : tuple of float
        Relative exposures of the series, s, ascending.
    deviation : tuple of float
        Rate of each exposure relative to the mean of all, minus 1, for the colour with the largest deviation. If
        exposures are repeated, a linear drift of the light over the series is removed.
    repeatability : float
        Standard error of a deviation, from frames of equal exposure; NaN if no exposure is repeated.
    """

    exposure_s: tuple[float, ...]
    deviation: tuple[float, ...]
    repeatability: float

    @property
    def largest(self) -> float:
        """Largest absolute deviation."""
        return max(abs(d) for d in self.deviation)


def linear_fit(exposure: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Separate the deviation of each exposure from the drift of the light.

    Parameters
    ----------
    exposure : (shots,) float
        Relative exposures, s.
    rate : (shots,) float
        Response rates, in the order of the photographs.

    Returns
    -------
    exposures : (n,) float
        Different exposures, ascending.
    deviation : (n,) float
    repeatability : float
        Standard error of a deviation; NaN if no exposure is repeated.
    """
    levels, index = np.unique(exposure, return_inverse=True)
    shots, count = len(rate), len(levels)
    relative = rate / rate.mean()
    design = (index[:, None] == np.arange(count)).astype(float)
    time = np.linspace(-0.5, 0.5, shots)
    with_drift = np.concatenate([design, time[:, None]], axis=1)
    # Drift and deviation cannot be separated unless exposures are repeated, and hardly if repeats follow in blocks.
    if shots > count + 1 and np.linalg.cond(with_drift) < 100.0:
        design = with_drift
    solution, *_ = np.linalg.lstsq(design, relative, rcond=None)
    deviation = solution[:count] / solution[:count].mean() - 1.0
    freedom = shots - design.shape[1]
    if freedom < 1:
        return levels, deviation, np.nan
    spread = np.sum((relative - design @ solution) ** 2) / freedom
    covariance = spread * np.linalg.inv(design.T @ design)[:count, :count]
    centred = np.eye(count) - 1.0 / count
    return levels, deviation, float(np.sqrt(np.diag(centred @ covariance @ centred.T).max()))


def _plane_rates(series: list[Shot], table, folder, dark: Dark | None) -> np.ndarray:
    """Return the mean response rate of each shot and band over pixels unclipped in the longest exposure, (shots, 3)."""
    ordered = sorted(range(len(series)), key=lambda i: -relative_exposure_s(series[i]))
    good, rates = {}, np.full((len(series), 3), np.nan)
    for at in track(ordered, "linearity"):
        shot = series[at]
        mosaic = decode(shot_path(shot, table, folder), shot.linear)
        signal = (
            mosaic.values
            if dark is None
            else mosaic.values - dark.signal_dn(shot.exposure_s * iso_ratio(shot, dark.iso))
        )
        for row, column, band in mosaic.places():
            place = (slice(row, None, 2), slice(column, None, 2))
            if (row, column) not in good:
                good[row, column] = _usable(mosaic, place, row, column, dark)
            mask = good[row, column]
            if mask.mean() < 0.05:
                continue
            range_dn = float(mosaic.white[row, column] - mosaic.black[row, column])
            level = float(np.mean(signal[place][mask], dtype=np.float64)) - float(mosaic.black[row, column])
            if level > _MIN_LEVEL * range_dn:
                rates[at, band] = level / relative_exposure_s(shot)
    return rates


def _usable(mosaic: Mosaic, place, row: int, column: int, dark: Dark | None) -> np.ndarray:
    """Return the pixels at one place of the mosaic pattern that are below saturation in this frame, and not hot."""
    black, white = float(mosaic.black[row, column]), float(mosaic.white[row, column])
    mask = mosaic.values < black + _MAX_LEVEL * (white - black)
    if dark is not None:
        mask[dark.hot_px[:, 0], dark.hot_px[:, 1]] = False
    return mask[place]


def exposure_series(shots: list[Shot]) -> list[Shot]:
    """Return the longest series of exposures of the white reference, or else of the chart.

    The shots have the same chart, filter state and pose. The list is empty if no two exposures differ.
    """
    for role in ("white", "chart"):
        groups: dict[tuple, list[Shot]] = {}
        for shot in (s for s in shots if s.role == role):
            groups.setdefault((shot.filter, shot.pose, shot.chart), []).append(shot)
        best = max(groups.values(), key=lambda g: len({relative_exposure_s(s) for s in g}), default=[])
        if len({relative_exposure_s(s) for s in best}) > 1:
            return best
    return []


def measure_linearity(shots: list[Shot], table, folder, dark: Dark | None, limit: float) -> Linearity | None:
    """Measure the linearity of a camera; None if the table has no exposure series.

    Parameters
    ----------
    limit : float
        Largest accepted deviation, a ratio. Twice the standard error from repeated exposures is added to it.

    Raises
    ------
    InputError
        If a deviation is above the limit.
    """
    series = exposure_series(shots)
    if not series:
        return None
    rates = _plane_rates(series, table, folder, dark)
    exposure = np.array([relative_exposure_s(s) for s in series])
    found = []
    for band in range(3):
        known = np.isfinite(rates[:, band])
        if len(np.unique(exposure[known])) > 1:
            found.append(linear_fit(exposure[known], rates[known, band]))
    if not found:
        return None
    levels, deviation, error = max(found, key=lambda item: np.abs(item[1]).max())
    result = Linearity(tuple(levels.tolist()), tuple(deviation.tolist()), error)
    LOGGER.info(
        "linearity over %d exposures: largest deviation %.2f %%, repeatability %s",
        len(levels), 100 * result.largest, "unknown" if np.isnan(error) else f"{100 * error:.2f} %",
    )  # fmt: skip
    allowed = limit + (0.0 if np.isnan(error) else _SIGMAS * error)
    if result.largest > allowed:
        worst = levels[int(np.argmax(np.abs(deviation)))]
        doubt = "no exposure repeats, so drift of the light counts too" if np.isnan(error) else f"± {error:.2%}"
        text = f"a response that deviates by {result.largest:.1%} ({doubt}) at a relative exposure of {worst:g} s"
        raise InputError(table, "exposure_s", text, f"at most {limit:.1%} (ingest.max_nonlinearity)")
    return result
