"""Reader for spectral files of all accepted formats, recognised by suffix and content; it does not need NumPy.

* `.csv`, `.tsv`: wide (a name, then one column for each wavelength), columns (the wavelength, then one column for each
  spectrum), long (rows of name, wavelength, value), or two columns of numbers;
* `.txt`: any of these, two columns of numbers between comments, or CGATS;
* `.ti3`, `.cgats`, `.it8`, `.cie`, `.sp`: CGATS, see `irodori.spectra.cgats`;
* `.spd`: two columns of numbers, wavelength and value, between comments;
* `.spdx`: IES TM-27.
"""

import re
from collections import Counter
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from irodori.core.errors import InputError, counted
from irodori.core.text_tables import read_text
from irodori.core.text_tables import with_decimal_points as _with_points
from irodori.spectra.cgats import cgats_table
from irodori.spectra.tables import (
    check_length,
    check_wavelengths,
    column_table,
    csv_rows,
    number,
    wide_table,
)

_CSV, _CGATS = (".csv", ".tsv"), (".ti3", ".cgats", ".it8", ".cie", ".sp")
SUFFIXES = (*_CSV, ".txt", *_CGATS, ".spd", ".spdx")
#: Reflectance factors of a table; a little noise under 0 and fluorescence over 1 are real, percent are not.
REFLECTANCE = (-0.01, 1.2)
#: Transmittances of a table; noise of the measurement goes a little beyond 0 and 1.
TRANSMITTANCE = (-0.01, 1.02)
#: Noise of a spectroradiometer under 0, as a fraction of the largest power.
_POWER_NOISE = 0.01
#: Quantities as IES TM-27-14 names them, of surfaces and of lights, and adjectives that may stand before them.
_TRANSMITTANCES = frozenset({"transmittance", "t-factor"})
_FACTORS = _TRANSMITTANCES | {"reflectance", "r-factor"}
_POWERS = frozenset({"flux", "power", "intensity", "irradiance", "radiance", "exitance", "relative"})
_ADJECTIVES = frozenset({"relative", "spectral", "radiant"})
_NAMED = 8  # spectra of a table that a message names

_WAVELENGTH = re.compile(r"(wave[ _-]?length|lambda|λ|wl|nm)\b.*|wavelength_.*", re.IGNORECASE)
#: Words for numbers of photons in headers and comments, also as photon_flux; Photonics is the name of a firm.
_PHOTONS = re.compile(r"(?<![a-z])(photons?(flux)?|quanta|quantum flux|[uµμ]mol|micromol)(?![a-z])", re.IGNORECASE)
_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?")
_COMMENTS = ("#", "//", "%", "!", ";")
_CSV_WORDS = (
    "a CSV that is wide (a name, then a column a wavelength in nm), of columns (wavelength_nm, then a column a "
    "spectrum), or long (name, wavelength_nm, value)"
)
_ACCEPTED = f"a name that ends in one of {', '.join(SUFFIXES)}"


class SpectralTable(NamedTuple):
    """Spectra read from a file.

    Parameters
    ----------
    names : list of str
        Name of each spectrum.
    wavelength_nm : list of float
    values : list of lists of float
        Values of each spectrum.
    is_power : bool
        Whether the format is one for spectral power: SPD text, Argyll's .sp, TM-27 of a source.
    quantity : str
        Name of the quantity, if the file states it, as TM-27 does; else empty.
    """

    names: list[str]
    wavelength_nm: list[float]
    values: list[list[float]]
    is_power: bool = False
    quantity: str = ""


def spectral_table(path) -> SpectralTable:
    """Read a file of spectra in any accepted format.

    Raises
    ------
    InputError
        For an unknown suffix, content in no format of its suffix, a missing or non-finite value, two spectra of one
        name, or wavelengths that do not increase or do not cover 400..700 nm. The message names file, line or field,
        what was found and what is accepted.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(path, "", f"the suffix {suffix!r}" if suffix else "a file without a suffix", _ACCEPTED)
    if suffix == ".spdx":
        table = _tm27_table(path)
    elif suffix == ".spd":
        table = _two_columns(path)
    elif suffix in _CGATS or (suffix == ".txt" and "BEGIN_DATA_FORMAT" in read_text(path, "a file of spectra")):
        table = SpectralTable(*cgats_table(path), is_power=suffix == ".sp")
    else:
        table = _csv_table(path, suffix)
    check_wavelengths(table.wavelength_nm, path)
    names = [name.strip() for name in table.names]
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise InputError(path, "", f"two spectra of the name {twice!r}", "each name once")
    return table


def check_reflectance(table: SpectralTable, path) -> None:
    """Raise an error for values outside the range of reflectance factors, -0.01 to 1.2, such as percentages.

    A quantity that the file states must be a reflectance or a transmittance.

    Raises
    ------
    InputError
    """
    _check_quantity(table, _FACTORS, "reflectance", path)
    low, high = REFLECTANCE
    accepted = f"reflectance factors from {low:g} to {high:g}, where 1 is a perfect diffuser, not percent"
    _check_range(table, REFLECTANCE, accepted, path)


def check_transmittance(table: SpectralTable, path) -> None:
    """Raise an error for values outside the range of transmittances with measurement noise, -0.01 to 1.02.

    A quantity that the file states must be a transmittance.

    Raises
    ------
    InputError
    """
    _check_quantity(table, _TRANSMITTANCES, "transmittance", path)
    low, high = TRANSMITTANCE
    _check_range(table, TRANSMITTANCE, f"transmittances from {low:g} to {high:g}, not percent", path)


def _check_quantity(table: SpectralTable, names: frozenset[str], accepted: str, path) -> None:
    """Raise an error if a file states a quantity of another name, such as "spectral irradiance" or "R-Factor"."""
    words = table.quantity.lower().replace("_", " ").split()
    while len(words) > 1 and words[0] in _ADJECTIVES:
        del words[0]
    if words and " ".join(words) not in names:
        raise InputError(path, "SpectralQuantity", table.quantity, accepted)


def _check_range(table: SpectralTable, limits: tuple[float, float], accepted: str, path) -> None:
    """Raise an error for the first value outside limits; the message says if the table seems to be in percent."""
    percent = max(max(row) for row in table.values) > 2.0
    for name, row in zip(table.names, table.values, strict=True):
        for at, value in zip(table.wavelength_nm, row, strict=True):
            if not limits[0] <= value <= limits[1]:
                found = f"{value:g}" + (", as if the table were in percent" if percent else "")
                raise InputError(path, f"{name}, {at:g} nm", found, accepted)


def filter_row(table: SpectralTable, name: str | None, path) -> list[float]:
    """Return the transmittances of the filter with a given name, or of the only filter in a table.

    Raises
    ------
    InputError
        If the table holds several filters and no name is given, or no filter with the name; if a value is no
        transmittance, or all values are zero.
    """
    if name is None and len(table.names) != 1:
        raise InputError(path, "", f"{len(table.names)} spectra and no name", f"a name, such as {table.names[0]}")
    if name is not None and name not in table.names:
        raise InputError(path, name, "no spectrum of this name", f"one of: {', '.join(table.names[:_NAMED])}")
    row = table.values[table.names.index(name) if name else 0]
    one = table._replace(names=[name or table.names[0]], values=[row])
    check_transmittance(one, path)
    if max(row) <= 0.0:
        raise InputError(path, name or "", "no transmittance at any wavelength", "a filter that passes light")
    return row


def check_power(table: SpectralTable, path) -> None:
    """Raise an error for a light without power, or negative by more than a spectroradiometer's noise, 1 % of the peak.

    A quantity that the file states, also in a header or a comment, must be one of power, not of photons.

    Raises
    ------
    InputError
    """
    accepted = "the power of a light: flux, irradiance, radiance, intensity, exitance or relative"
    _check_quantity(table, _POWERS, accepted, path)
    if not table.quantity:
        _refuse_photons(path)
    for name, row in zip(table.names, table.values, strict=True):
        peak = max(row)
        if peak <= 0.0:
            raise InputError(path, name, "no power at any wavelength", "a light")
        for at, value in zip(table.wavelength_nm, row, strict=True):
            if value < -_POWER_NOISE * peak:
                accepted = f"power from {-_POWER_NOISE * peak:g}, a hundredth of the peak under 0"
                raise InputError(path, f"{name}, {at:g} nm", f"{value:g}", accepted)


def _refuse_photons(path) -> None:
    """Raise an error for a file whose headers or comments speak of numbers of photons."""
    accepted = "the power of a light, which is the number of photons divided by the wavelength"
    for line, text in enumerate(read_text(path, accepted).splitlines(), start=1):
        first = re.split(r"[,;\s]", text.strip())[0]
        words = text.partition("#")[2] if _NUMBER.fullmatch(first) else text
        if found := _PHOTONS.search(words):
            raise InputError(path, f"line {line}", f"{found[0]!r} in {words.strip()[:60]!r}", accepted)


def _csv_table(path, suffix: str) -> SpectralTable:
    """Read a CSV, whose layout follows from its header, or two columns of numbers."""
    lines = [line for line in read_text(path, _CSV_WORDS).splitlines() if line.strip()]
    separator = next((mark for mark in (";", "\t", ",") if lines and mark in lines[0]), ",")
    header = [cell.strip().strip('"') for cell in lines[0].split(separator)] if lines else []
    if len(header) > 1 and _NUMBER.fullmatch(header[1]) and not _NUMBER.fullmatch(header[0]):
        return SpectralTable(*wide_table(path))
    if len(header) == 3 and _WAVELENGTH.fullmatch(header[1]):
        return _long_table(path)
    if len(header) > 1 and _WAVELENGTH.fullmatch(header[0]):
        return SpectralTable(*column_table(path))
    if suffix == ".txt" or (len(header) == 2 and all(map(_NUMBER.fullmatch, header))):
        return _two_columns(path)
    found = ", ".join(header[:4]) + (", ..." if len(header) > 4 else "") or "nothing"
    raise InputError(path, "line 1", found, _CSV_WORDS)


def _long_table(path) -> SpectralTable:
    """Read rows of name, wavelength and value in any order; every spectrum must have every wavelength exactly once."""
    rows = csv_rows(path)
    spectra: dict[str, dict[float, float]] = {}
    for line, row in rows[1:]:
        check_length(row, rows[0][1], path, line)
        wavelength = number(row[1], path, f"line {line}, wavelength")
        spectrum = spectra.setdefault(row[0].strip(), {})
        if wavelength in spectrum:
            raise InputError(
                path, f"line {line}", f"{row[0].strip()} at {wavelength:g} nm twice", "each wavelength once"
            )
        spectrum[wavelength] = number(row[2], path, f"line {line}, {wavelength:g} nm")
    wavelengths = sorted({wavelength for spectrum in spectra.values() for wavelength in spectrum})
    for name, spectrum in spectra.items():
        if missing := [wavelength for wavelength in wavelengths if wavelength not in spectrum]:
            found = f"no value at {missing[0]:g} nm, which other spectra have"
            raise InputError(path, name, found, "the same wavelengths in every spectrum")
    return SpectralTable(list(spectra), wavelengths, [[s[w] for w in wavelengths] for s in spectra.values()])


def _two_columns(path) -> SpectralTable:
    """Read lines of wavelength and value between comments; the first line may be a header."""
    accepted = "two columns of numbers, wavelength in nm and value; comments start with " + " ".join(_COMMENTS)
    rows = []
    for line, text in enumerate(read_text(path, accepted).splitlines(), start=1):
        text = text.split("#")[0].strip()
        if not text or text.startswith(_COMMENTS):
            continue
        cells = [cell.rstrip(",") for cell in re.split(r"[;\s]+", text) if cell.strip(",")]
        rows.append((line, cells if len(cells) > 1 else text.split(",")))
    if rows and not _NUMBER.fullmatch(rows[0][1][0].strip()):
        rows = rows[1:]
    if not rows:
        raise InputError(path, "", "no numbers", accepted)
    rows = _with_points(rows, path)
    for line, row in rows:
        if len(row) != 2:
            raise InputError(path, f"line {line}", counted(len(row), "column"), accepted)
    wavelength = [number(row[0], path, f"line {line}, wavelength") for line, row in rows]
    values = [number(row[1], path, f"line {line}, {at:g} nm") for (line, row), at in zip(rows, wavelength, strict=True)]
    return SpectralTable([Path(path).stem], wavelength, [values], is_power=Path(path).suffix.lower() == ".spd")


def _tm27_table(path) -> SpectralTable:
    """Read an IES TM-27 file in the form that colour-science writes, without the slow import of that library."""
    accepted = "an IES TM-27 document"
    try:
        root = ElementTree.fromstring(read_text(path, accepted))
    except ElementTree.ParseError as error:
        raise InputError(path, "", f"broken XML ({error})", accepted) from None
    if "IESTM27" not in root.tag:
        raise InputError(path, "", f"an XML document {root.tag!r}", accepted)
    data = [element for element in root.iter() if element.tag.split("}")[-1] == "SpectralData"]
    wavelength = [number(e.get("wavelength", ""), path, f"SpectralData {i}") for i, e in enumerate(data, start=1)]
    values = [number(e.text or "", path, f"SpectralData, {at:g} nm") for e, at in zip(data, wavelength, strict=True)]
    quantity = next((e.text for e in root.iter() if e.tag.split("}")[-1] == "SpectralQuantity"), None)
    quantity = " ".join((quantity or "").split())
    is_power = quantity.lower() not in (*_FACTORS, "absorptance")
    return SpectralTable([Path(path).stem], wavelength, [values], is_power, quantity)
