"""CSV tables of spectra, read and checked without NumPy; `irodori.core.text_tables` describes the accepted notation."""

import math
from itertools import pairwise

from irodori.core.errors import InputError, counted
from irodori.core.text_tables import table_rows

FIRST_NM, LAST_NM = 400.0, 700.0
MAX_GAP_NM = 20.0
#: Measured refractive indices of metals stand up to 50 nm apart and vary slowly.
MAX_INDEX_GAP_NM = 60.0

#: Complex refractive index n + ik of any material in the visible; silver has the smallest n, 0.04.
LEAST_N, MOST_N, MOST_K = 1e-3, 10.0, 20.0


def check_wavelengths(wavelength_nm, file, field: str = "wavelength", max_gap_nm: float = MAX_GAP_NM) -> None:
    """Raise an error for wavelengths that do not increase, do not cover 400 to 700 nm, or are too far apart.

    Parameters
    ----------
    wavelength_nm : sequence of float, nm
    file, field : origin of the wavelengths, for the error message
    max_gap_nm : float
        Largest accepted step, nm.

    Raises
    ------
    InputError
    """
    pairs = list(pairwise(wavelength_nm))
    if not pairs:
        raise InputError(file, field, counted(len(wavelength_nm), "wavelength"), "a range that covers 400..700 nm")
    for before, after in pairs:
        if not before < after:
            found = f"wavelengths that do not increase ({after:g} nm after {before:g} nm)"
            raise InputError(file, field, found, "strictly increasing wavelengths in nm, each once")
    if wavelength_nm[0] > FIRST_NM or wavelength_nm[-1] < LAST_NM:
        found = f"{wavelength_nm[0]:g}..{wavelength_nm[-1]:g} nm"
        raise InputError(file, field, found, "a range that covers 400..700 nm")
    for before, after in pairs:
        if after - before > max_gap_nm + 1e-9 and after > FIRST_NM and before < LAST_NM:
            found = f"no sample for {after - before:g} nm after {before:g} nm"
            raise InputError(file, field, found, f"steps up to {max_gap_nm:g} nm")


def wide_table(path) -> tuple[list[str], list[float], list[list[float]]]:
    """Read a wide CSV of spectra: a name, then one column for each wavelength in nm.

    Returns
    -------
    names : list of str, one for each row
    wavelength_nm : list of float
    values : list of rows

    Raises
    ------
    InputError
        For an invalid or missing value or invalid wavelengths; the message names file, line, wavelength and value.
    """
    rows = csv_rows(path)
    header = rows[0][1]
    wavelength = [number(cell, path, f"header column {i + 2}") for i, cell in enumerate(header[1:])]
    check_wavelengths(wavelength, path)
    names, values = [], []
    for line, row in rows[1:]:
        check_length(row, header, path, line)
        names.append(row[0])
        values.append([number(c, path, f"line {line}, {w:g} nm") for c, w in zip(row[1:], wavelength, strict=True)])
    return names, wavelength, values


def column_table(path, max_gap_nm: float = MAX_GAP_NM) -> tuple[list[str], list[float], list[list[float]]]:
    """Read a CSV with the wavelength in nm in the first column and quantities in the others.

    Returns
    -------
    names : list of str, one for each column after the first
    wavelength_nm : list of float
    values : list of columns
    """
    rows = csv_rows(path)
    header = [cell.strip() for cell in rows[0][1]]
    columns = [list(column) for column in zip(*number_rows(rows, path), strict=True)]
    check_wavelengths(columns[0], path, header[0], max_gap_nm)
    return header[1:], columns[0], columns[1:]


def index_table(path) -> tuple[list[float], list[float], list[float]]:
    """Read a CSV of wavelength_nm, n, k; n from 0.001 to 10, k from 0 to 20.

    Returns
    -------
    wavelength_nm, n, k : lists of float
    """
    names, wavelength, columns = column_table(path, MAX_INDEX_GAP_NM)
    if names != ["n", "k"]:
        raise InputError(path, "line 1", ", ".join(["wavelength_nm", *names]), "the header wavelength_nm,n,k")
    for at, n, k in zip(wavelength, *columns, strict=True):
        if not (LEAST_N <= n <= MOST_N and 0.0 <= k <= MOST_K):
            accepted = f"n from {LEAST_N:g} to {MOST_N:g}, k from 0 to {MOST_K:g}"
            raise InputError(path, f"{at:g} nm", f"n = {n:g}, k = {k:g}", accepted)
    return wavelength, columns[0], columns[1]


def brdf_table(path) -> tuple[list[float], list[list[float]], list[list[float]]]:
    """Read a CSV of measured reflection: four angles in rad, then the BRDF in 1/sr at each wavelength in nm.

    Returns
    -------
    wavelength_nm : list of float
    angles : list of rows, θ_i, φ_i, θ_r, φ_r in rad
    brdf : list of rows, 1/sr
    """
    rows = csv_rows(path)
    header = [cell.strip() for cell in rows[0][1]]
    wanted = ["theta_i_rad", "phi_i_rad", "theta_r_rad", "phi_r_rad"]
    if header[: len(wanted)] != wanted:
        accepted = f"{', '.join(wanted)}, then one column a wavelength in nm"
        raise InputError(path, "line 1", ", ".join(header[: len(wanted)]), accepted)
    wavelength = [number(cell, path, f"header column {i + 5}") for i, cell in enumerate(header[4:])]
    check_wavelengths(wavelength, path)
    table = number_rows(rows, path)
    return wavelength, [row[:4] for row in table], [row[4:] for row in table]


def csv_rows(path) -> list[tuple[int, list[str]]]:
    """Return line number and cells of each row of a table of spectra, see `irodori.core.text_tables.table_rows`.

    Raises
    ------
    InputError
        Also for a table without a row under its header, or with only one column.
    """
    rows = table_rows(path, "a CSV of spectra")
    if len(rows) < 2 or len(rows[0][1]) < 2:
        raise InputError(path, "", counted(len(rows), "line"), "a header and at least one row of two columns")
    return rows


def number_rows(rows: list[tuple[int, list[str]]], path) -> list[list[float]]:
    """Return the rows of `csv_rows` after the header as numbers.

    Raises
    ------
    InputError
        For a row with another length than the header, or a cell that is no finite number.
    """
    header, found = rows[0][1], []
    for line, row in rows[1:]:
        check_length(row, header, path, line)
        found.append([number(c, path, f"line {line}, {h.strip()}") for c, h in zip(row, header, strict=True)])
    return found


def check_length(row: list, header: list, path, line: int) -> None:
    """Raise an error for a row with another number of cells than the header."""
    if len(row) != len(header):
        raise InputError(path, f"line {line}", counted(len(row), "column"), counted(len(header), "column"))


def number(text: str, path, field: str) -> float:
    """Return the finite number in a cell of a table.

    Raises
    ------
    InputError
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    # float() also takes 1_000, which no spreadsheet writes.
    if not math.isfinite(value) or "_" in text:
        raise InputError(path, field, repr(text) if text.strip() else "nothing", "a finite number")
    return value
