"""CSV tables of spectra, read and checked without numpy.

Cells are separated by commas, semicolons or tabs, whichever the header has. Where they are not separated by commas a
number may be written with a decimal comma, if the whole file does so. UTF-8, with or without a byte-order mark, any
line ends.
"""

import csv
import math
import re
from itertools import pairwise
from pathlib import Path

from irodori.core.errors import InputError, is_file

#: A table of text: two million numbers, which take a gigabyte while they are read.
_MOST_BYTES = 16 << 20
FIRST_NM, LAST_NM = 400.0, 700.0
MAX_GAP_NM = 20.0
#: Measured refractive indices of metals stand up to 50 nm apart and vary slowly.
MAX_INDEX_GAP_NM = 60.0

#: Complex refractive index n + ik of any material in the visible; silver has the smallest n, 0.04.
LEAST_N, MOST_N, MOST_K = 1e-3, 10.0, 20.0

_COMMA_NUMBER = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_POINT_NUMBER = re.compile(r"[+-]?(\d+\.\d*|\.\d+)([eE][+-]?\d+)?")


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
    if not pairs:
        raise InputError(file, field, f"{len(wavelength_nm)} wavelengths", "a range that covers 400..700 nm")
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
    """Read a CSV whose first column is the wavelength in nm and whose others are quantities.

    Returns
    -------
    names : list of str, one a column after the first
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
    """Return the rows of a CSV that hold something, with their line numbers; numbers written with a decimal point.

    Raises
    ------
    InputError
        For a file that is absent, no text or no table, and for decimal points beside decimal commas.
    """
    text = read_text(path, "a CSV of spectra")
    header = next((line for line in text.splitlines() if line.strip()), "")
    separator = next((mark for mark in (";", "\t") if mark in header), ",")
    try:
        reader = csv.reader(text.splitlines(keepends=True), delimiter=separator)
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise InputError(path, "", f"unreadable text ({error})", "a CSV in UTF-8") from None
    if len(rows) < 2 or len(rows[0][1]) < 2:
        raise InputError(path, "", f"{len(rows)} lines", "a header and at least one row of two columns")
    return rows if separator == "," else with_decimal_points(rows, path)


def number_rows(rows: list[tuple[int, list[str]]], path) -> list[list[float]]:
    """Return what the rows of `csv_rows` under the header hold, a number under each name.

    Raises
    ------
    InputError
        For a row of another length than the header, and for a cell that holds no finite number.
    """
    header, found = rows[0][1], []
    for line, row in rows[1:]:
        check_length(row, header, path, line)
        found.append([number(c, path, f"line {line}, {h.strip()}") for c, h in zip(row, header, strict=True)])
    return found


def with_decimal_points(rows: list[tuple[int, list[str]]], path) -> list[tuple[int, list[str]]]:
    """Return rows whose decimal commas, where the file writes them, are points.

    Raises
    ------
    InputError
        If one number of the file has a comma and another one a point: either may then be a thousands separator.
    """
    if not any(_COMMA_NUMBER.fullmatch(cell.strip()) for _, row in rows for cell in row):
        return rows
    out = []
    for line, row in rows:
        if point := next((cell for cell in row if _POINT_NUMBER.fullmatch(cell.strip())), None):
            accepted = "decimal points or decimal commas throughout the file"
            raise InputError(path, f"line {line}", f"{point.strip()!r} beside numbers with a decimal comma", accepted)
        cells = [cell.replace(",", ".") if _COMMA_NUMBER.fullmatch(cell.strip()) else cell for cell in row]
        out.append((line, cells))
    return out


def read_text(path, wanted: str) -> str:
    """Return the text of a file in UTF-8, without its byte-order mark.

    Raises
    ------
    InputError
    """
    path = Path(path)
    if not is_file(path):
        raise InputError(path, "", "no such file", wanted)
    if path.stat().st_size > _MOST_BYTES:
        raise InputError(path, "", f"{path.stat().st_size} bytes", f"{wanted} of at most {_MOST_BYTES} bytes")
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(path, "", f"unreadable text ({error})", f"{wanted} in UTF-8") from None


def check_length(row: list, header: list, path, line: int) -> None:
    """Refuse a row that has not as many cells as the header."""
    if len(row) != len(header):
        raise InputError(path, f"line {line}", f"{len(row)} columns", f"{len(header)} columns")


def number(text: str, path, field: str) -> float:
    """Return the finite number that a cell holds.

    Raises
    ------
    InputError
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(path, field, repr(text) if text.strip() else "nothing", "a finite number")
    return value
