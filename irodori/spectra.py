"""Spectral grid and measured spectra.

Every spectral array of the package has the wavelength on its last axis: 61 samples, 400..700 nm, step 5 nm.
"""

import csv
import re
from pathlib import Path

import numpy as np

from irodori.errors import InputError

WAVELENGTH_NM = np.arange(400.0, 701.0, 5.0)
SAMPLES = WAVELENGTH_NM.size
STEP_NM = 5.0
#: Trapezoidal weights on the grid, nm: ``integral = spectrum @ TRAPEZOID_NM`` [eq. 1].
TRAPEZOID_NM = np.full(SAMPLES, STEP_NM)
TRAPEZOID_NM[[0, -1]] *= 0.5

_TCS_NAME = re.compile(r"TCS(\d{1,2})")
_PATCH_NAME = re.compile(r"[A-Z]\d+")


def resample(wavelength_nm: np.ndarray, values: np.ndarray, file, field: str = "wavelength") -> np.ndarray:
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
    if wavelength_nm.size < 2 or not np.all(np.diff(wavelength_nm) > 0):
        raise InputError(file, field, "wavelengths that do not increase", "strictly increasing wavelengths in nm")
    if wavelength_nm[0] > WAVELENGTH_NM[0] or wavelength_nm[-1] < WAVELENGTH_NM[-1]:
        found = f"{wavelength_nm[0]:g}..{wavelength_nm[-1]:g} nm"
        raise InputError(file, field, found, "a range that covers 400..700 nm")
    inside = (wavelength_nm >= WAVELENGTH_NM[0] - 20) & (wavelength_nm <= WAVELENGTH_NM[-1] + 20)
    gaps = np.diff(wavelength_nm[inside])
    if gaps.max() > 20.0 + 1e-9:
        before = wavelength_nm[inside][gaps.argmax()]
        raise InputError(file, field, f"no sample for {gaps.max():g} nm after {before:g} nm", "steps up to 20 nm")
    if not np.isfinite(values).all():
        raise InputError(file, field, "a missing or non-finite value", "a finite number at every wavelength")
    flat = values.reshape(-1, wavelength_nm.size)
    out = np.stack([np.interp(WAVELENGTH_NM, wavelength_nm, row) for row in flat])
    return out.reshape((*values.shape[:-1], SAMPLES))


def _number(text: str, file, field: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(file, field, repr(text), "a number") from None


def read_wide_csv(path) -> tuple[list[str], np.ndarray]:
    """Read spectra from a wide CSV: a name, then one column a wavelength in nm.

    Returns
    -------
    names : list of str, one a row
    spectra : (rows, 61) float64

    Raises
    ------
    InputError
        Naming file, column and value; a wavelength column without a value is an error.
    """
    rows = _csv_rows(path)
    header = rows[0]
    wavelength = np.array([_number(cell, path, f"header column {i + 2}") for i, cell in enumerate(header[1:])])
    names, values = [], []
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(header):
            raise InputError(path, f"line {number}", f"{len(row)} columns", f"{len(header)} columns")
        names.append(row[0])
        values.append([_number(c, path, f"line {number}, {w:g} nm") for c, w in zip(row[1:], wavelength, strict=True)])
    return names, resample(wavelength, np.array(values), path)


def read_columns_csv(path) -> tuple[list[str], np.ndarray]:
    """Read spectra from a CSV whose first column is the wavelength in nm and whose others are quantities.

    Returns
    -------
    names : list of str, one a column after the first
    spectra : (columns, 61) float64
    """
    rows = _csv_rows(path)
    header = rows[0]
    table = []
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(header):
            raise InputError(path, f"line {number}", f"{len(row)} columns", f"{len(header)} columns")
        table.append([_number(c, path, f"line {number}, {h}") for c, h in zip(row, header, strict=True)])
    values = np.array(table, dtype=np.float64).reshape(-1, len(header))
    return header[1:], resample(values[:, 0], values[:, 1:].T, path, header[0])


def _csv_rows(path) -> list[list[str]]:
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "", "no such file", "a CSV of spectra")
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = [row for row in csv.reader(stream) if row]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, "", f"unreadable text ({error})", "a CSV in UTF-8") from None
    if len(rows) < 2 or len(rows[0]) < 2:
        raise InputError(path, "", f"{len(rows)} lines", "a header and at least one row of two columns")
    return rows


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
        names, table = read_columns_csv(definition["file"])
        if names != ["n", "k"]:
            raise InputError(definition["file"], "header", ", ".join(names), "wavelength_nm, n, k")
        return table[0], table[1]
    return np.full(SAMPLES, float(definition["n"])), np.full(SAMPLES, float(definition.get("k", 0.0)))


def refractive_index_at(definition: dict, wavelength_nm: float = 550.0) -> tuple[float, float]:
    """Return n and k at one wavelength, by default where a green band is centred."""
    n, k = refractive_index(definition)
    return float(np.interp(wavelength_nm, WAVELENGTH_NM, n)), float(np.interp(wavelength_nm, WAVELENGTH_NM, k))
