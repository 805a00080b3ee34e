"""Tables of text as spreadsheets save them.

Cells are separated by commas, semicolons or tabs, whichever the header has. Where they are not separated by commas a
number may be written with a decimal comma, if the whole file does so. UTF-8, with or without a byte-order mark, or
UTF-16 with one (Excel's "Unicode text"); any line ends. Empty columns behind the last name are left out. Read without
numpy, so that the Snakefile can.
"""

import codecs
import csv
import io
import re
from pathlib import Path

from irodori.core.errors import InputError

#: Two million numbers, or a hundred thousand photographs; read, they take a gigabyte.
MOST_BYTES = 16 << 20

_COMMA_NUMBER = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_POINT_NUMBER = re.compile(r"[+-]?(\d+\.\d*|\.\d+)([eE][+-]?\d+)?")
_SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}
#: Two characters in a row of hiragana, katakana or Chinese: one alone may be an accented letter and the one behind it.
_JAPANESE = re.compile(r"[\u3040-\u30ff\u3400-\u9fff]{2}")


def read_text(path, wanted: str) -> str:
    """Return the text of a file, without its byte-order mark.

    Parameters
    ----------
    path : path
        In UTF-8, or in UTF-16 with a byte-order mark.
    wanted : str
        What the file should be, for the message.

    Raises
    ------
    InputError
        For a file that is absent, unreadable, larger than MOST_BYTES or in another encoding, which is named where its
        bytes tell.
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
    """Return the rows of a table that hold something, the header first, numbers written with a decimal point.

    Parameters
    ----------
    path : path
    wanted : str
        What the file should be, for the messages.

    Returns
    -------
    list of (line number, cells)
        Cells as the file writes them, but for decimal commas; none for a file without text.

    Raises
    ------
    InputError
        For a file that `read_text` refuses or that is no table, and for decimal points beside decimal commas.
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


def _without_empty_columns(rows: list[tuple[int, list[str]]]) -> list[tuple[int, list[str]]]:
    """Cut the empty cells behind the header's last name; a cell that holds something there stays, to be refused."""
    if not rows:
        return rows
    names = max(column for column, cell in enumerate(rows[0][1], 1) if cell.strip())
    out = []
    for line, cells in rows:
        behind = "".join(cells[names:]).strip()
        out.append((line, cells if behind else cells[:names]))
    return out


def _encoding(content: bytes) -> str:
    """Name the likely encoding of bytes that are no UTF-8."""
    if b"\0" in content[:1000]:
        return "bytes that are no text"
    if _JAPANESE.search(content.decode("cp932", errors="ignore")):
        return "text in Shift-JIS"
    return "text in an encoding of one byte a letter, such as Windows-1252"
