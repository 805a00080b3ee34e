"""Reader of text tables (CSV) as spreadsheets save them.

Cells are separated by commas, semicolons or tabs, whichever the header has. If they are not separated by commas,
numbers may have a decimal comma, throughout the file. The encoding is UTF-8, with or without a byte-order mark, or
UTF-16 with one (Excel's "Unicode text"); line endings are of any kind. Empty columns to the right of the last name are
removed. The module does not import numpy, so that the Snakefile can use it.
"""

import codecs
import csv
import io
import re
from pathlib import Path

from irodori.core.errors import InputError

#: Enough for two million numbers or a hundred thousand photographs, which take a gigabyte of memory.
MOST_BYTES = 16 << 20

_COMMA_NUMBER = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_POINT_NUMBER = re.compile(r"[+-]?(\d+\.\d*|\.\d+)([eE][+-]?\d+)?")
_SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}
#: Two adjacent characters of hiragana, katakana or Chinese: bytes of an accented letter and the next can look like one.
_JAPANESE = re.compile(r"[\u3040-\u30ff\u3400-\u9fff]{2}")


def read_text(path, wanted: str) -> str:
    """Return the text of a file, without its byte-order mark.

    Parameters
    ----------
    path : path
        In UTF-8, or in UTF-16 with a byte-order mark.
    wanted : str
        Description of the expected file, for the message.

    Raises
    ------
    InputError
        For a file that is absent, unreadable, larger than MOST_BYTES or in another encoding; the message names the
        likely encoding.
    """
    try:
        with Path(path).open("rb") as file:
            content = file.read(MOST_BYTES + 1)
    except FileNotFoundError:
        raise InputError(path, "", "no such file", wanted) from None
    except (OSError, ValueError) as error:
        found = getattr(error, "strerror", None) or str(error)
        raise InputError(path, "", found, f"{wanted} that can be read") from None
    if len(content) > MOST_BYTES:
        raise InputError(path, "", f"more than {MOST_BYTES} bytes", f"{wanted} of at most {MOST_BYTES} bytes")
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        return content.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        found = _encoding(content)
        accepted = f'{wanted}, in UTF-8 (a spreadsheet saves it as "CSV UTF-8")'
        raise InputError(path, f"byte {error.start}", found, accepted) from None


def table_rows(path, wanted: str) -> list[tuple[int, list[str]]]:
    """Return the rows of a table that are not empty, the header first, with decimal commas replaced by points.

    Parameters
    ----------
    path : path
    wanted : str
        Description of the expected file, for the messages.

    Returns
    -------
    list of (line number, cells)
        Cells as in the file, except for decimal commas; an empty list for a file without text.

    Raises
    ------
    InputError
        For a file that `read_text` refuses or that is not a valid CSV table, and for decimal points beside decimal
        commas.
    """
    text = read_text(path, wanted)
    header = next((line for line in text.splitlines() if line.strip()), "")
    separator = next((mark for mark in (";", "\t") if mark in header), ",")
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    rows = []
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                rows.append((reader.line_num, cells))
    except csv.Error as error:
        accepted = f"{wanted}, its cells parted by {_SEPARATORS[separator]}"
        raise InputError(path, f"line {reader.line_num}", str(error), accepted) from None
    rows = _without_empty_columns(rows)
    return rows if separator == "," else with_decimal_points(rows, path)


def with_decimal_points(rows: list[tuple[int, list[str]]], path) -> list[tuple[int, list[str]]]:
    """Return rows of cells with decimal commas replaced by points.

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


def _without_empty_columns(rows: list[tuple[int, list[str]]]) -> list[tuple[int, list[str]]]:
    """Remove empty cells to the right of the header's last name; a filled one is kept, for the caller to refuse."""
    if not rows:
        return rows
    names = max(column for column, cell in enumerate(rows[0][1], 1) if cell.strip())
    out = []
    for line, cells in rows:
        behind = "".join(cells[names:]).strip()
        out.append((line, cells if behind else cells[:names]))
    return out


def _encoding(content: bytes) -> str:
    """Return a phrase for the likely encoding of bytes that are not UTF-8."""
    if b"\0" in content[:1000]:
        return "bytes that are no text"
    if _JAPANESE.search(content.decode("cp932", errors="ignore")):
        return "text in Shift-JIS"
    return "text in an encoding of one byte a letter, such as Windows-1252"
