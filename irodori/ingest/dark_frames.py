"""Dark signal of each mosaic pixel, and unreliable pixels, from dark frames."""

from dataclasses import dataclass

import numpy as np

from irodori.config.capture_table import Shot, shot_path
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER, track
from irodori.ingest.mosaic import decode
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit

_HOT_SIGMAS = 8.0
_HOT_CHANCE = 1e-9  # probability that a normal pixel has such a variance
_SAMPLES = 1_000_000  # pixels that suffice for a median
_ROWS = 64  # rows that a thread takes at a time
_STEPS = 32_767


@dataclass(frozen=True)
class Dark:
    """Dark signal of each mosaic pixel above the black level: offset + rate x exposure time.

    Parameters
    ----------
    offset : (height, width) int16 or None
        Offset in steps of `offset_step_dn`; None if all dark frames have the same exposure time.
    rate : (height, width) int16
        Rate in steps of `rate_step_dn_per_s`.
    offset_step_dn, rate_step_dn_per_s : float
    iso : float
        ISO of the dark frames, 0 if unknown; the dark signal is proportional to it.
    exposures_s : tuple of float
        Exposure times of the frames, ascending, s.
    hot_px : (n, 2) int32
        Row and column of hot mosaic pixels; offset and rate are 0 there.
    """

    offset: np.ndarray | None
    rate: np.ndarray
    offset_step_dn: float
    rate_step_dn_per_s: float
    iso: float
    exposures_s: tuple[float, ...]
    hot_px: np.ndarray

    def signal_dn(self, exposure_s: float) -> np.ndarray:
        """Return the dark signal above the black level, (height, width) float32, DN."""
        signal = np.float32(self.rate_step_dn_per_s * exposure_s) * self.rate
        return signal if self.offset is None else signal + np.float32(self.offset_step_dn) * self.offset


@njit(cache=True, nogil=True)
def _add_row(values, black, total, squares):
    for column in range(values.size):
        signal = np.float32(values[column]) - black[column % 2]
        total[column] += signal
        squares[column] += signal * signal


@njit(cache=True, nogil=True)
def _add(values, black, total, squares, first, last):
    for row in range(first, last):
        _add_row(values[row], black[row % 2], total[row], squares[row])


def hot_pixels(level_dn: np.ndarray, variance_dn2: np.ndarray | None, freedom: int) -> np.ndarray:
    """Return the hot pixels: those that are too bright in the dark, or too noisy.

    Parameters
    ----------
    level_dn : (height, width) float
        Dark signal, mean of the frames.
    variance_dn2 : (height, width) float, optional
        Sample variance between equal frames.
    freedom : int
        Degrees of freedom of the variance.

    Returns
    -------
    (height, width) bool

    Notes
    -----
    Too bright: more than 8 standard deviations above the median of all pixels, with a standard deviation from the
    median absolute deviation, at least that of rounding. Too noisy: a variance that a normal pixel exceeds with a
    probability of 1e-9, by the chi-squared distribution scaled to the median variance. A minority of hot pixels hardly
    changes these medians.
    """
    from scipy import special  # slow to import; captures only read what is measured here

    sample = level_dn.ravel()[:: max(1, level_dn.size // _SAMPLES)]
    median = np.median(sample)
    sigma = max(1.4826 * float(np.median(np.abs(sample - median))), np.sqrt(1 / 12))
    hot = level_dn > median + _HOT_SIGMAS * sigma
    if variance_dn2 is not None:
        sample = variance_dn2.ravel()[:: max(1, variance_dn2.size // _SAMPLES)]
        typical = max(float(np.median(sample)) / (2.0 * special.gammaincinv(freedom / 2.0, 0.5) / freedom), 1 / 12)
        hot |= variance_dn2 > typical * special.chdtri(freedom, _HOT_CHANCE) / freedom
    return hot


def measure_dark(shots: list[Shot], table, folder) -> Dark | None:
    """Measure the dark signal of a camera from its dark frames; None if there are none.

    A straight line over exposure time is fitted to each pixel. With a single exposure time only its slope is fitted,
    and the signal at zero exposure is taken to be the black level of the file.

    Raises
    ------
    InputError
        If the frames differ in size or in ISO.
    """
    shots = sorted((s for s in shots if s.role == "dark"), key=lambda s: s.exposure_s)
    if not shots:
        return None
    isos = {s.iso for s in shots}
    if len(isos) > 1:
        found = f"dark frames of ISO {', '.join(f'{iso:g}' for iso in sorted(isos))}"
        raise InputError(table, "iso", found, "dark frames of one ISO")
    times = sorted({s.exposure_s for s in shots})
    frames = np.array([sum(s.exposure_s == t for s in shots) for t in times])
    sums: dict[str, np.ndarray] | None = None
    for time_s in track(times, "dark frames"):
        group = [s for s in shots if s.exposure_s == time_s]
        total, squares = _sum_frames(group, table, folder, sums)
        if sums is None:
            sums = {name: np.zeros_like(total) for name in ("plain", "by_time", "within")}
        sums["plain"] += total
        sums["by_time"] += np.float32(time_s) * total
        sums["within"] += np.maximum(squares - total * total / np.float32(len(group)), 0.0)
    assert sums is not None  # there is a shot
    freedom = int((frames - 1).sum())
    variance = sums["within"] / np.float32(freedom) if freedom else None
    hot = hot_pixels(sums["plain"] / np.float32(frames.sum()), variance, freedom)
    offset, rate = _line(sums, np.array(times), frames)
    if offset is None:
        LOGGER.info(
            "dark frames of %g s alone: their signal above black is taken to grow in proportion to exposure time",
            times[0],
        )
    LOGGER.info("%d hot pixels of %d (%.4f %%)", hot.sum(), hot.size, 100 * hot.mean())
    rate, rate_step = _in_steps(rate, hot)
    offset, offset_step = (None, 0.0) if offset is None else _in_steps(offset, hot)
    return Dark(offset, rate, offset_step, rate_step, isos.pop(), tuple(times), np.argwhere(hot).astype(np.int32))


def _sum_frames(group: list[Shot], table, folder, sums) -> tuple[np.ndarray, np.ndarray]:
    """Return the sum, and the sum of squares, of the signals above black in equal frames, (height, width) float32."""
    total: np.ndarray | None = None
    squares: np.ndarray | None = None
    for shot in group:
        path = shot_path(shot, table, folder)
        mosaic = decode(path, shot.linear)
        if total is None or squares is None:
            total, squares = (np.zeros(mosaic.values.shape, dtype=np.float32) for _ in range(2))
        before = total if sums is None else sums["plain"]
        if mosaic.values.shape != before.shape:
            height, width = before.shape
            found = f"{mosaic.size[0]} x {mosaic.size[1]} pixels"
            raise InputError(path, "size", found, f"{width} x {height}, as the first dark frame")
        run_chunks(_add, len(total), _ROWS, mosaic.values, mosaic.black, total, squares)
    assert total is not None and squares is not None  # there is a shot
    return total, squares


def _line(sums: dict, times: np.ndarray, frames: np.ndarray):
    """Return offset (None with a single exposure time) and rate of each pixel by least squares over all frames."""
    count, t1, t2 = frames.sum(), (frames * times).sum(), (frames * times**2).sum()
    if len(times) == 1:
        return None, sums["plain"] / np.float32(t1)
    determinant = count * t2 - t1 * t1
    rate = (count * sums["by_time"] - t1 * sums["plain"]) / determinant
    return (sums["plain"] - t1 * rate) / count, rate


def _in_steps(values: np.ndarray, hot: np.ndarray) -> tuple[np.ndarray, float]:
    """Return values as integer multiples of a step, and the step; hot pixels are 0, to keep the step fine."""
    values = np.where(hot, 0.0, values)
    step = max(float(np.abs(values).max()) / _STEPS, float(np.finfo(np.float32).tiny))
    return np.rint(values / step).astype(np.int16), step
