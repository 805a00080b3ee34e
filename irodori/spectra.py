"""Spectral grid and measured spectra.

Every spectral array of the package has the wavelength on its last axis: 61 samples, 400..700 nm, step 5 nm.
"""

import re
from pathlib import Path

import numpy as np

from irodori.errors import InputError
from irodori.tables import MAX_GAP_NM, MAX_INDEX_GAP_NM, check_wavelengths, column_table, index_table, wide_table

WAVELENGTH_NM = np.arange(400.0, 701.0, 5.0)
SAMPLES = WAVELENGTH_NM.size
STEP_NM = 5.0
#: Trapezoidal weights on the grid, nm: ``integral = spectrum @ TRAPEZOID_NM`` [eq. 1].
TRAPEZOID_NM = np.full(SAMPLES, STEP_NM)
TRAPEZOID_NM[[0, -1]] *= 0.5

_TCS_NAME = re.compile(r"TCS(\d{1,2})")
_PATCH_NAME = re.compile(r"[A-Z]\d+")


def resample(
    wavelength_nm: np.ndarray, values: np.ndarray, file, field: str = "wavelength", max_gap_nm: float = MAX_GAP_NM
) -> np.ndarray:
    """Bring spectra to the grid by linear interpolation.

    Parameters
    ----------
    wavelength_nm : (n,) float, strictly increasing, nm
    values : (..., n) float
    file, field : where the spectra came from, for the error message

    Returns
    -------
    (..., 61) float64

    Raises
    ------
    InputError
        If the wavelengths do not increase, do not cover 400..700 nm (nothing is extrapolated), leave a gap over
        20 nm, or a value is not finite.
    """
    wavelength_nm = np.asarray(wavelength_nm, dtype=np.float64)
    values = np.asarray(values, dtype=np.float64)
    check_wavelengths(wavelength_nm, file, field, max_gap_nm)
    if not np.isfinite(values).all():
        raise InputError(file, field, "a missing or non-finite value", "a finite number at every wavelength")
    flat = values.reshape(-1, wavelength_nm.size)
    out = np.stack([np.interp(WAVELENGTH_NM, wavelength_nm, row) for row in flat])
    return out.reshape((*values.shape[:-1], SAMPLES))


def read_wide_csv(path) -> tuple[list[str], np.ndarray]:
    """Read spectra from a wide CSV, see `irodori.tables.wide_table`.

    Returns
    -------
    names : list of str, one a row
    spectra : (rows, 61) float64
    """
    names, wavelength_nm, values = wide_table(path)
    return names, resample(wavelength_nm, np.array(values), path)


def read_columns_csv(path) -> tuple[list[str], np.ndarray]:
    """Read spectra from a CSV of columns, see `irodori.tables.column_table`.

    Returns
    -------
    names : list of str, one a column after the first
    spectra : (columns, 61) float64
    """
    names, wavelength_nm, columns = column_table(path)
    return names, resample(wavelength_nm, np.array(columns), path)


def _align(distribution) -> np.ndarray:
    return np.asarray(np.interp(WAVELENGTH_NM, distribution.wavelengths, distribution.values))


def _test_colour_samples() -> np.ndarray:
    from colour import SpectralShape
    from colour.quality.cfi2017 import load_TCS_CIE2017

    samples = load_TCS_CIE2017(SpectralShape(380, 780, 5))
    return np.stack([np.interp(WAVELENGTH_NM, samples.wavelengths, column) for column in samples.values.T])


def spectrum(name: str) -> np.ndarray:
    """Return a spectrum by name: a CIE illuminant, ``TCS<n>`` or a CSV file.

    Parameters
    ----------
    name : str
        A CIE illuminant of colour-science (``D65``, ``A``, ``LED-B3``), ``TCS0``..``TCS98`` (the measured materials
        of CIE 224:2017, reflectance 0..1), or the path of a wide CSV with one row.

    Returns
    -------
    (61,) float64, relative power (illuminants: 100 at 560 nm) or reflectance factor 0..1
    """
    import colour

    if match := _TCS_NAME.fullmatch(name):
        samples = _test_colour_samples()
        if int(match[1]) < len(samples):
            return samples[int(match[1])]
        raise InputError("spectrum", name, name, f"TCS0 to TCS{len(samples) - 1}")
    if name in colour.SDS_ILLUMINANTS:
        return _align(colour.SDS_ILLUMINANTS[name])
    if Path(name).suffix:
        names, spectra = read_wide_csv(name)
        if len(names) != 1:
            raise InputError(name, "", f"{len(names)} spectra", "one spectrum")
        return spectra[0]
    known = ", ".join(sorted(colour.SDS_ILLUMINANTS))
    raise InputError("spectrum", name, repr(name), f"TCS0 to TCS98, a CSV file, or an illuminant of: {known}")


def chart_spectra(name: str) -> tuple[list[str], np.ndarray]:
    """Return the patches of a colour chart: a chart of colour-science, or a wide CSV file.

    Returns
    -------
    names : list of str, row by row; patches that are all named like A1 are put in order of letter, then number
    reflectance : (patches, 61) float64, 0..1
    """
    from colour.characterisation import SDS_COLOURCHECKERS

    if name in SDS_COLOURCHECKERS:
        chart = SDS_COLOURCHECKERS[name]
        return list(chart), np.stack([_align(patch) for patch in chart.values()])
    if Path(name).suffix:
        names, spectra = read_wide_csv(name)
        if all(_PATCH_NAME.fullmatch(n) for n in names):
            order = sorted(range(len(names)), key=lambda i: (names[i][0], int(names[i][1:])))
            return [names[i] for i in order], spectra[order]
        return names, spectra
    raise InputError("chart", name, repr(name), f"a CSV file or one of: {', '.join(SDS_COLOURCHECKERS)}")


def camera_sensitivities(name: str) -> np.ndarray:
    """Return spectral sensitivities R_b(λ) of an RGB camera, relative.

    Parameters
    ----------
    name : str
        A camera of colour-science, or a CSV with columns wavelength_nm, r, g, b.

    Returns
    -------
    (3, 61) float64
    """
    import colour

    if name in colour.MSDS_CAMERA_SENSITIVITIES:
        sensitivities = colour.MSDS_CAMERA_SENSITIVITIES[name]
        return np.stack([np.interp(WAVELENGTH_NM, sensitivities.wavelengths, c) for c in sensitivities.values.T])
    if Path(name).suffix:
        names, spectra = read_columns_csv(name)
        if len(names) != 3:
            raise InputError(name, "", f"{len(names)} bands", "three bands: r, g, b")
        return spectra
    raise InputError("camera", name, repr(name), f"a CSV or one of: {', '.join(colour.MSDS_CAMERA_SENSITIVITIES)}")


def refractive_index(definition: dict) -> tuple[np.ndarray, np.ndarray]:
    """Return complex refractive index n + ik on the grid.

    Parameters
    ----------
    definition : dict
        ``{n: float, k: float}``, or ``{file: path}`` of a CSV with columns wavelength_nm, n, k.

    Returns
    -------
    n, k : (61,) float64
    """
    if "file" in definition:
        wavelength_nm, n, k = index_table(definition["file"])
        table = resample(wavelength_nm, np.array([n, k]), definition["file"], max_gap_nm=MAX_INDEX_GAP_NM)
        return table[0], table[1]
    return np.full(SAMPLES, float(definition["n"])), np.full(SAMPLES, float(definition.get("k", 0.0)))


def refractive_index_at(definition: dict, wavelength_nm: float = 550.0) -> tuple[float, float]:
    """Return n and k at one wavelength, by default where a green band is centred."""
    n, k = refractive_index(definition)
    return float(np.interp(wavelength_nm, WAVELENGTH_NM, n)), float(np.interp(wavelength_nm, WAVELENGTH_NM, k))
