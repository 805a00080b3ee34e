"""Spectra by name: published ones, from tables of the library colour-science, or from files."""

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from irodori.core.errors import InputError, counted, is_file
from irodori.spectra.grid import SAMPLES, WAVELENGTH_NM
from irodori.spectra.published_names import (
    BLACKBODY_K,
    CAMERAS,
    CHART_PATCHES,
    DAYLIGHT_K,
    ILLUMINANTS,
    TEST_COLOURS,
    synthetic_light,
)
from irodori.spectra.published_tables import published_table
from irodori.spectra.resampling import is_finer_than_grid, resample
from irodori.spectra.spectral_files import SUFFIXES, SpectralTable, check_power, check_reflectance, spectral_table
from irodori.spectra.tables import MAX_INDEX_GAP_NM, index_table

if TYPE_CHECKING:
    from irodori.config.models import RefractiveIndex

_TCS_NAME = re.compile(r"TCS(\d{1,2})")
_PATCH_NAME = re.compile(r"[A-Z]\d+")

#: Standard deviations of smooth relative differences in spectrum: of a lamp from the published one of its type, and of
#: a measurement with a field spectroradiometer from the true spectrum, for definitions that state none.
NAMED_LAMP_ERROR, MEASURED_LAMP_ERROR = 0.05, 0.02


def read_spectra(path) -> tuple[list[str], np.ndarray]:
    """Read reflectances, transmittances or sensitivities from a file of any format in `irodori.spectra.spectral_files`.

    Returns
    -------
    names : list of str, one for each spectrum
    spectra : (spectra, 61) float64, resampled to the grid by Sprague's or linear interpolation, see `resample`
    """
    table = spectral_table(path)
    return table.names, _on_grid(table, path)


def _on_grid(table: SpectralTable, path, is_light: bool = False) -> np.ndarray:
    wavelength_nm = np.array(table.wavelength_nm)
    # Sampling at the grid's wavelengths would miss the narrow lines of a lamp or give them too much power.
    method = "average" if (is_light or table.is_power) and is_finer_than_grid(wavelength_nm) else "auto"
    return resample(wavelength_nm, np.array(table.values), path, method=method)


def _one_spectrum(path) -> SpectralTable:
    table = spectral_table(path)
    if len(table.names) != 1:
        raise InputError(path, "", f"{len(table.names)} spectra", "one spectrum")
    return table


def _synthetic(kind: str, temperature_k: float) -> np.ndarray:
    """Return the spectrum of CIE daylight or of a blackbody on the grid, (61,), 100 at 560 nm."""
    import colour  # slow, and seldom needed

    if kind == "D":
        made = colour.sd_CIE_illuminant_D_series(colour.temperature.CCT_to_xy_CIE_D(temperature_k))
    else:
        made = colour.sd_blackbody(temperature_k, colour.SpectralShape(360, 780, 5))
    power = np.interp(WAVELENGTH_NM, made.wavelengths, made.values)
    return 100.0 * power / power[WAVELENGTH_NM == 560.0]


def spectrum(name: str) -> np.ndarray:
    """Return a spectrum by name: a light, ``TCS<n>`` or a file of one spectrum.

    Parameters
    ----------
    name : str
        A CIE illuminant in colour-science (``D65``, ``A``, ``FL11``, ``LED-B3``); ``D<n>``, CIE daylight with a
        correlated colour temperature of 4000 to 25000 K (``D5500``; CIE 15:2018, 4.1.2; note that ``D65`` is 6504 K);
        ``P<n>``, a Planckian radiator of 1000 to 20000 K (``P2856``; c₂ = 1.4388e-2 m K); ``TCS0``..``TCS98``, the
        measured materials of CIE 224:2017, reflectance 0..1; or the path of a file, see
        `irodori.spectra.spectral_files`.

    Returns
    -------
    (61,) float64, relative power (lights by name: 100 at 560 nm) or reflectance factor 0..1
    """
    if match := _TCS_NAME.fullmatch(name):
        samples = published_table("test_colours").at(WAVELENGTH_NM)
        if int(match[1]) < len(samples):
            return samples[int(match[1])]
        raise InputError("spectrum", name, name, f"TCS0 to {TEST_COLOURS[-1]}")
    if name in ILLUMINANTS:
        return published_table(f"illuminants/{name}").at(WAVELENGTH_NM)[0]
    if made := synthetic_light(name):
        return _synthetic(*made)
    if Path(name).suffix:
        return _on_grid(_one_spectrum(name), name)[0]
    known = ", ".join(sorted(ILLUMINANTS))
    accepted = (
        f"TCS0 to TCS98, a file of one spectrum, D{DAYLIGHT_K[0]} to D{DAYLIGHT_K[1]} (daylight), P{BLACKBODY_K[0]} to "
        f"P{BLACKBODY_K[1]} (blackbody), or an illuminant of: {known}"
    )
    raise InputError("spectrum", name, repr(name), accepted)


def is_measured(lamp: str) -> bool:
    """Return whether a lamp is given by the file of a measured spectrum instead of a published name."""
    return lamp.lower().endswith(SUFFIXES)


def lamp_error(lamp: str, error_percent: float | None = None) -> float:
    """Return how far a lamp may differ from its spectrum, relative: as stated, or else by how the spectrum is given."""
    if error_percent is not None:
        return error_percent / 100.0
    return MEASURED_LAMP_ERROR if is_measured(lamp) else NAMED_LAMP_ERROR


def light(name: str) -> np.ndarray:
    """Return the spectrum of a light by its name or from a file; names are those of `spectrum`.

    A file must hold spectral power. If it is finer than the grid, it is averaged over ±5 nm, so that narrow lines keep
    their power, see `resample`.

    Returns
    -------
    (61,) float64, relative power

    Raises
    ------
    InputError
        If the spectrum is zero everywhere, or negative by more than a hundredth of its peak, or that of a surface; if
        the file states another quantity than power.
    """
    if _TCS_NAME.fullmatch(name):
        raise InputError("light", name, "the reflectance of a test colour", "the name of a light, such as D65")
    if not is_file(name):
        return spectrum(name)
    table = _one_spectrum(name)
    check_power(table, name)
    return _on_grid(table, name, is_light=True)[0]


def chart_spectra(name: str) -> tuple[list[str], np.ndarray]:
    """Return the reflectances of a colour chart's patches.

    ``name`` is a chart in colour-science or the path of a file, see `irodori.spectra.spectral_files`.

    Returns
    -------
    names : list of str, row by row; patches that are all named like A1 are sorted by letter, then number
    reflectance : (patches, 61) float64, 0..1

    Raises
    ------
    InputError
        For an unknown name, a file that cannot be read, and values outside -0.01..1.2.
    """
    if name in CHART_PATCHES:
        chart = published_table(f"charts/{name}")
        return list(chart.names), chart.at(WAVELENGTH_NM)
    if Path(name).suffix:
        table = spectral_table(name)
        check_reflectance(table, name)
        names, spectra = table.names, _on_grid(table, name)
        if all(_PATCH_NAME.fullmatch(n) for n in names):
            order = sorted(range(len(names)), key=lambda i: (names[i][0], int(names[i][1:])))
            return [names[i] for i in order], spectra[order]
        return names, spectra
    raise InputError("chart", name, repr(name), f"a file of spectra or one of: {', '.join(CHART_PATCHES)}")


def camera_sensitivities(name: str) -> np.ndarray:
    """Return the relative spectral sensitivities R_b(λ) of an RGB camera.

    Parameters
    ----------
    name : str
        A camera in colour-science, or the path of a file with three spectra, red, green and blue, such as a CSV with
        columns wavelength_nm, r, g, b.

    Returns
    -------
    (3, 61) float64
    """
    if name in CAMERAS:
        return published_table(f"cameras/{name}").at(WAVELENGTH_NM)
    if Path(name).suffix:
        names, spectra = read_spectra(name)
        if len(names) != 3:
            raise InputError(name, "", counted(len(names), "band"), "three bands: r, g, b")
        return spectra
    raise InputError("camera", name, repr(name), f"a file or one of: {', '.join(CAMERAS)}")


def refractive_index(definition: "RefractiveIndex") -> tuple[np.ndarray, np.ndarray]:
    """Return the complex refractive index n + ik on the grid.

    Parameters
    ----------
    definition : ConstantIndex or IndexTable
        One index for all wavelengths, or a file with columns wavelength_nm, n, k.

    Returns
    -------
    n, k : (61,) float64
    """
    if hasattr(definition, "file"):
        wavelength_nm, n, k = index_table(definition.file)
        table = resample(np.array(wavelength_nm), np.array([n, k]), definition.file, max_gap_nm=MAX_INDEX_GAP_NM)
        return table[0], table[1]
    return np.full(SAMPLES, definition.n), np.full(SAMPLES, definition.k)


def refractive_index_at(definition: "RefractiveIndex", wavelength_nm: float = 550.0) -> tuple[float, float]:
    """Return n and k at one wavelength in nm, by default the centre of a green band."""
    n, k = refractive_index(definition)
    return float(np.interp(wavelength_nm, WAVELENGTH_NM, n)), float(np.interp(wavelength_nm, WAVELENGTH_NM, k))
