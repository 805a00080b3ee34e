"""CGATS spectral files: Argyll's .ti3 and .sp, and spectrophotometer exports; without numpy.

CGATS.17, *Exchange format for colour and process control data*; the keywords SPECTRAL_BANDS, SPECTRAL_START_NM,
SPECTRAL_END_NM, SPECTRAL_NORM and the columns SPEC_xxx are ArgyllCMS's.
"""

import re
from dataclasses import dataclass, field

from irodori.core.errors import InputError, counted
from irodori.core.text_tables import read_text
from irodori.spectra.tables import number

_TOKEN = re.compile(r'#.*|"[^"]*"|\S+')
_BAND = re.compile(r"(?:SPEC|SPECTRAL|SPECTRAL_NM|NM|R)_?(\d+(?:\.\d+)?)(?:NM)?", re.IGNORECASE)
_NAMES = ("SAMPLE_LOC", "SAMPLE_NAME", "SAMPLE_ID")
_GRID = ("SPECTRAL_BANDS", "SPECTRAL_START_NM", "SPECTRAL_END_NM")


@dataclass
class _Table:
    """One table of a CGATS file: keywords with line numbers, names of columns, and rows with line numbers."""

    keywords: dict[str, tuple[int, str]] = field(default_factory=dict)
    columns: list[str] = field(default_factory=list)
    rows: list[tuple[int, list[str]]] = field(default_factory=list)

    @property
    def bands(self) -> dict[int, float]:
        """Indices of the columns with spectral values -> wavelengths in their names, nm."""
        found = {i: _BAND.fullmatch(name) for i, name in enumerate(self.columns)}
        return {i: float(match[1]) for i, match in found.items() if match}


def cgats_table(path) -> tuple[list[str], list[float], list[list[float]]]:
    """Read the spectra of a CGATS file.

    Values are divided by SPECTRAL_NORM if the file has it, so that a reflectance stored from 0 to 100 becomes one from
    0 to 1. Wavelengths follow from SPECTRAL_START_NM, SPECTRAL_END_NM and SPECTRAL_BANDS, from which the names of the
    columns may differ by rounding; without these keywords they are read from the names. A sample is named by
    SAMPLE_LOC, its place on the chart, or else by SAMPLE_NAME or SAMPLE_ID.

    Returns
    -------
    names : list of str, one for each sample
    wavelength_nm : list of float
    values : list of rows, one for each sample

    Raises
    ------
    InputError
        If the file is no CGATS file, has no spectral column, or several spectral tables; the message names file, line
        or keyword.
    """
    tables = [table for table in _tables(path) if table.bands]
    if len(tables) != 1:
        found = f"{counted(len(tables), 'table')} with columns of spectral values"
        raise InputError(path, "BEGIN_DATA_FORMAT", found, "one table with columns such as SPEC_400")
    table = tables[0]
    wavelength = _wavelengths(table, path)
    norm = _keyword(table, "SPECTRAL_NORM", path) if "SPECTRAL_NORM" in table.keywords else 1.0
    if not norm > 0.0:
        raise InputError(path, "SPECTRAL_NORM", f"{norm:g}", "a number above 0, the value that stands for 1")
    column = next((table.columns.index(name) for name in _NAMES if name in table.columns), None)
    names, values = [], []
    for count, (line, row) in enumerate(_whole_rows(table, path), start=1):
        names.append(str(count) if column is None else row[column])
        places = [f"line {line}, {w:g} nm" for w in wavelength]
        values.append([number(row[i], path, place) / norm for i, place in zip(table.bands, places, strict=True)])
    return names, wavelength, values


def named_columns(path, names: list[str]) -> list[list[float]]:
    """Read columns of numbers from a CGATS file by their names.

    Returns
    -------
    list of rows, the values of one sample in the order of ``names``

    Raises
    ------
    InputError
        If not exactly one table has all of these columns.
    """
    tables = [table for table in _tables(path) if set(names) <= set(table.columns)]
    if len(tables) != 1:
        found = f"{counted(len(tables), 'table')} with the columns {', '.join(names)}"
        raise InputError(path, "BEGIN_DATA_FORMAT", found, "one table with these columns")
    places = [(name, tables[0].columns.index(name)) for name in names]
    return [
        [number(row[i], path, f"line {line}, {name}") for name, i in places]
        for line, row in _whole_rows(tables[0], path)
    ]


def _tables(path) -> list[_Table]:
    """Return all tables of a file, also those without spectra."""
    tables, table, section = [], _Table(), ""
    for line, text in enumerate(read_text(path, "a CGATS file").splitlines(), start=1):
        tokens = [token.strip('"') for token in _TOKEN.findall(text) if not token.startswith("#")]
        if not tokens:
            continue
        if tokens[0] in ("BEGIN_DATA_FORMAT", "BEGIN_DATA"):
            section = tokens[0]
        elif tokens[0] == "END_DATA_FORMAT":
            section = ""
        elif tokens[0] == "END_DATA":
            tables.append(table)
            table, section = _Table(), ""
        elif section == "BEGIN_DATA_FORMAT":
            table.columns += tokens
        elif section == "BEGIN_DATA":
            table.rows.append((line, tokens))
        elif len(tokens) > 1:
            table.keywords[tokens[0]] = (line, tokens[1])
    if section or not tables:
        raise InputError(path, "", f"no {section.replace('BEGIN', 'END') or 'BEGIN_DATA'}", "a whole CGATS file")
    return tables


def _keyword(table: _Table, name: str, path) -> float:
    line, text = table.keywords[name]
    return number(text, path, f"line {line}, {name}")


def _wavelengths(table: _Table, path) -> list[float]:
    named = list(table.bands.values())
    given = [name for name in _GRID if name in table.keywords]
    if not given:
        return named
    if len(given) != len(_GRID):
        raise InputError(path, given[0], f"only {', '.join(given)}", f"all of {', '.join(_GRID)}, or none")
    bands, first, last = (_keyword(table, name, path) for name in _GRID)
    if bands != len(named) or bands < 2:
        raise InputError(path, "SPECTRAL_BANDS", f"{bands:g} bands for {len(named)} columns", "one column a band")
    exact = [first + (last - first) * i / (len(named) - 1) for i in range(len(named))]
    for name, wavelength in zip(named, exact, strict=True):
        if abs(name - wavelength) > 0.51:
            found = f"a column of {name:g} nm where the keywords have {wavelength:g} nm"
            raise InputError(path, "SPECTRAL_START_NM", found, "columns at the wavelengths of the keywords")
    return exact


def _whole_rows(table: _Table, path) -> list[tuple[int, list[str]]]:
    """Return one row for each sample; samples may span several lines if NUMBER_OF_SETS gives their number."""
    width = len(table.columns)
    rows = table.rows
    stated = int(_keyword(table, "NUMBER_OF_SETS", path)) if "NUMBER_OF_SETS" in table.keywords else None
    ragged = next(((line, row) for line, row in rows if len(row) != width), None)
    tokens = [(line, token) for line, row in rows for token in row]
    if ragged and (stated is None or stated * width != len(tokens)):
        line, row = ragged
        raise InputError(
            path, f"line {line}", counted(len(row), "value"), f"{width} values, one a column of the data format"
        )
    if ragged:
        rows = [(tokens[i][0], [token for _, token in tokens[i : i + width]]) for i in range(0, len(tokens), width)]
    if not rows or (stated is not None and stated != len(rows)):
        found = counted(len(rows), "sample") + ("" if stated is None else f" where NUMBER_OF_SETS is {stated}")
        raise InputError(path, "BEGIN_DATA", found, "as many samples as NUMBER_OF_SETS, one or more")
    return rows
