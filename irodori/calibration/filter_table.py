"""Transmittance of a filter from a table, with a model of how the filter may differ from its table.

No table is exact. A coating's passbands lie a nanometre off, by batch and temperature; a data sheet is measured at
normal incidence, and at an angle every wavelength shifts in proportion; the instrument's slit blurs edges; what is
blocked depends on its stray light; the level depends on the other surfaces in the path. What remains is a smooth factor
of unknown size.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from irodori.spectra.grid import STEP_NM, WAVELENGTH_NM
from irodori.spectra.spectral_files import filter_row, spectral_table

#: Names of a filter's departures from its table: shift at 550 nm and its increase over the next 150 nm, nm; variance of
#: the blur, nm²; transmittance that is added everywhere, relative to the largest.
DEPARTURES = ("shift_nm", "tilt_nm", "blur_nm2", "floor")
#: Standard deviations of all but the first.
_TILT_NM, _BLUR_NM2, _FLOOR = 1.0, 4.0, 0.005
_MIDDLE_NM, _SIDE_NM = 550.0, 150.0
_FINE_NM, _MARGIN_NM = 0.25, 40.0
_BLUR_STEP_NM = 2.0


@dataclass(frozen=True)
class FilterTable:
    """Transmittance of a filter at some wavelengths, in any unit.

    Parameters
    ----------
    wavelength_nm : (n,) float64, increasing, covering 400..700 nm
    transmittance : (n,) float64
    shift_nm : float
        Standard deviation of the filter's shift from its table.
    """

    wavelength_nm: np.ndarray
    transmittance: np.ndarray
    shift_nm: float = 2.0

    @property
    def spread(self) -> np.ndarray:
        """Standard deviations of the departures, (4,)."""
        return np.array([self.shift_nm, _TILT_NM, _BLUR_NM2, _FLOOR])

    @cached_property
    def _curve(self) -> tuple[np.ndarray, np.ndarray]:
        """Wavelengths in fine steps, nm, and relative transmittance; fine tables are smoothed by a ±5 nm triangle."""
        from scipy.interpolate import PchipInterpolator  # slow to import

        place = np.arange(WAVELENGTH_NM[0] - _MARGIN_NM, WAVELENGTH_NM[-1] + _MARGIN_NM + _FINE_NM, _FINE_NM)
        first, last = self.wavelength_nm[0], self.wavelength_nm[-1]
        value = PchipInterpolator(self.wavelength_nm, self.transmittance)(np.clip(place, first, last))
        value = np.maximum(value, 0.0)
        inside = (self.wavelength_nm >= WAVELENGTH_NM[0]) & (self.wavelength_nm <= WAVELENGTH_NM[-1])
        if np.diff(self.wavelength_nm[inside]).mean() < STEP_NM - 1e-6:
            steps = np.arange(-STEP_NM, STEP_NM + _FINE_NM, _FINE_NM)
            weight = STEP_NM - np.abs(steps)
            padded = np.pad(value, len(steps) // 2, mode="edge")
            value = np.convolve(padded, weight / weight.sum(), mode="valid")
        return place, value / value.max()

    def at(self, departures: np.ndarray) -> np.ndarray:
        """Return the transmittance of filters with departures, (..., 4), relative to the table's maximum, (..., 61)."""
        shift, tilt, blur, floor = np.moveaxis(np.asarray(departures)[..., None], -2, 0)
        place = WAVELENGTH_NM - shift - tilt * (WAVELENGTH_NM - _MIDDLE_NM) / _SIDE_NM
        beside = np.stack([place, place - _BLUR_STEP_NM, place + _BLUR_STEP_NM])
        middle, below, above = np.interp(beside, *self._curve)
        return middle + 0.5 * blur * (below + above - 2.0 * middle) / _BLUR_STEP_NM**2 + floor

    def slopes(self, departures: np.ndarray) -> np.ndarray:
        """Return the derivatives of the transmittance with respect to the departures, (61, 4)."""
        steps = np.diag([_FINE_NM, _FINE_NM, 1e-2, 1e-4])
        after, before = self.at(departures + np.stack([steps, -steps]))
        return ((after - before) / (2.0 * steps.max(axis=1, keepdims=True))).T


def read_filter(file, name: str | None, shift_nm: float) -> FilterTable:
    """Return the table of a filter from a file of spectra.

    Parameters
    ----------
    file : path
    name : str or None
        Name of the spectrum; required if the file has several.
    shift_nm : float
        Standard deviation of the filter's shift from its table.

    Raises
    ------
    InputError
        If the file cannot be read, does not cover 400 to 700 nm, does not have the filter, or has values that are not
        transmittances.
    """
    table = spectral_table(file)
    row = filter_row(table, name, file)
    return FilterTable(np.array(table.wavelength_nm, dtype=np.float64), np.array(row, dtype=np.float64), shift_nm)
