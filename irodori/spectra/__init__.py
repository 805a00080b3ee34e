"""Spectral grid and measured spectra.

Every spectral array of the package has the wavelength on its last axis: 61 samples, 400..700 nm, step 5 nm.
"""

from irodori.spectra.grid import SAMPLES, STEP_NM, TRAPEZOID_NM, WAVELENGTH_NM
from irodori.spectra.published import (
    camera_sensitivities,
    chart_spectra,
    light,
    read_columns_csv,
    read_spectra,
    read_wide_csv,
    refractive_index,
    refractive_index_at,
    spectrum,
)
from irodori.spectra.resampling import resample
from irodori.spectra.white import white_reflectance

__all__ = [
    "SAMPLES",
    "STEP_NM",
    "TRAPEZOID_NM",
    "WAVELENGTH_NM",
    "camera_sensitivities",
    "chart_spectra",
    "light",
    "read_columns_csv",
    "read_spectra",
    "read_wide_csv",
    "refractive_index",
    "refractive_index_at",
    "resample",
    "spectrum",
    "white_reflectance",
]
