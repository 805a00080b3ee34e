"""CSV tables of spectra, read and checked without numpy, so that the Snakefile can refuse a bad one at once."""

import csv
import math
from itertools import pairwise
from pathlib import Path

from irodori.errors import InputError

FIRST_NM, LAST_NM = 400.0, 700.0
MAX_GAP_NM = 20.0
#: Measured refractive indices of metals stand up to 50 nm apart and vary slowly.
MAX_INDEX_GAP_NM = 60.0


def check_wavelengths(wavelength_nm, file, field: str = "wavelength", max_gap_nm: float = MAX_GAP_NM) -> None:
    """Refuse wavelengths that do not increase, do not cover 400 to 700 nm, or stand too far apart.

    Parameters
    ----------
    wavelength_nm : sequence of float, nm
    file, field : where they came from, for the error message
    max_gap_nm : float, nm

    Raises
    ------
    InputError
    """
    pairs = list(pairwise(wavelength_nm))
    if not pairs or not all(a < b for a, b in pairs):
        raise InputError(file, field, "wavelengths that do not increase", "strictly increasing wavelengths in nm")
    if wavelength_nm[0] > FIRST_NM or wavelength_nm[-1] < LAST_NM:
        found = f"{wavelength_nm[0]:g}..{wavelength_nm[-1]:g} nm"
        raise InputError(file, field, found, "a range that covers 400..700 nm")
    for before, after in pairs:
        if after - before > max_gap_nm + 1e-9 and after > FIRST_NM and before < LAST_NM:
            found = f"no sample for {after - before:g} nm after {before:g} nm"
            raise InputError(file, field, found, f"steps up to {max_gap_nm:g} nm")


def wide_table(path) -> tuple[list[str], list[float], list[list[float]]]:
    """Read a wide CSV: a name, then one column a wavelength in nm.

    Returns
    -------
    names : list of str, one a row
    wavelength_nm : list of float
    values : list of rows

    Raises
    ------
    InputError
        Naming file, line, wavelength and value; a wavelength without a value is an error.
    """
    rows = _rows(path)
    header = rows[0][1]
    wavelength = [_number(cell, path, f"header column {i + 2}") for i, cell in enumerate(header[1:])]
    check_wavelengths(wavelength, path)
    names, values = [], []
    for line, row in rows[1:]:
        _check_length(row, header, path, line)
        names.append(row[0])
        values.append([_number(c, path, f"line {line}, {w:g} nm") for c, w in zip(row[1:], wavelength, strict=True)])
    return names, wavelength, values


def column_table(path, max_gap_nm: float = MAX_GAP_NM) -> tuple[list[str], list[float], list[list[float]]]:
    """Read a CSV whose first column is the wavelength in nm and whose others are quantities.

    Returns
    -------
    names : list of str, one a column after the first
    wavelength_nm : list of float
    values : list of columns
    """
    rows = _rows(path)
    header = [cell.strip() for cell in rows[0][1]]
    table = []
    for line, row in rows[1:]:
        _check_length(row, header, path, line)
        table.append([_number(c, path, f"line {line}, {h}") for c, h in zip(row, header, strict=True)])
    columns = [list(column) for column in zip(*table, strict=True)]
    check_wavelengths(columns[0], path, header[0], max_gap_nm)
    return header[1:], columns[0], columns[1:]


def index_table(path) -> tuple[list[float], list[float], list[float]]:
    """Read a CSV of wavelength_nm, n, k; n above 0, k from 0.

    Returns
    -------
    wavelength_nm, n, k : lists of float
    """
    names, wavelength, columns = column_table(path, MAX_INDEX_GAP_NM)
    if names != ["n", "k"]:
        raise InputError(path, "line 1", ", ".join(["wavelength_nm", *names]), "the header wavelength_nm,n,k")
    for at, n, k in zip(wavelength, *columns, strict=True):
        if n <= 0 or k < 0:
            raise InputError(path, f"{at:g} nm", f"n = {n:g}, k = {k:g}", "n above 0, k from 0")
    return wavelength, columns[0], columns[1]


def brdf_table(path) -> tuple[list[float], list[list[float]], list[list[float]]]:
    """Read a CSV of measured reflection: four angles in rad, then the BRDF in 1/sr at each wavelength in nm.

    Returns
    -------
    wavelength_nm : list of float
    angles : list of rows, θ_i, φ_i, θ_r, φ_r in rad
    brdf : list of rows, 1/sr
    """
    rows = _rows(path)
    header = [cell.strip() for cell in rows[0][1]]
    wanted = ["theta_i_rad", "phi_i_rad", "theta_r_rad", "phi_r_rad"]
    if header[: len(wanted)] != wanted:
        accepted = f"{', '.join(wanted)}, then one column a wavelength in nm"
        raise InputError(path, "line 1", ", ".join(header[: len(wanted)]), accepted)
    wavelength = [_number(cell, path, f"header column {i + 5}") for i, cell in enumerate(header[4:])]
    check_wavelengths(wavelength, path)
    table = []
    for line, row in rows[1:]:
        _check_length(row, header, path, line)
        table.append([_number(c, path, f"line {line}, {h}") for c, h in zip(row, header, strict=True)])
    return wavelength, [row[:4] for row in table], [row[4:] for row in table]


def _rows(path) -> list[tuple[int, list[str]]]:
    """Return the rows that hold something, with their line numbers."""
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "", "no such file", "a CSV of spectra")
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, "", f"unreadable text ({error})", "a CSV in UTF-8") from None
    if len(rows) < 2 or len(rows[0][1]) < 2:
        raise InputError(path, "", f"{len(rows)} lines", "a header and at least one row of two columns")
    return rows


def _check_length(row: list[str], header: list[str], path, line: int) -> None:
    if len(row) != len(header):
        raise InputError(path, f"line {line}", f"{len(row)} columns", f"{len(header)} columns")


def _number(text: str, path, field: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(path, field, repr(text) if text.strip() else "nothing", "a finite number")
    return value
