"""Reading of TIFF tags that LibRaw does not report; most RAW formats are based on TIFF, and others contain TIFFs.

The tags are read directly, to limit time and memory for damaged files: libraries that read whole directories create as
many objects as a count in the file states, which after a single bit error may be a thousand million.
"""

import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from irodori.ingest.embedded_tiffs import embedded_tiffs

SHORT, LONG, RATIONAL = 3, 4, 5
_ASCII, _IFD = 2, 13
_SUB_DIRECTORIES, _EXIF = 330, 34665
_ENTRY_BYTES, _LONGEST_TEXT = 12, 256
#: Largest number of directories that are read; a RAW file has a handful, and a damaged one may claim more.
_MOST_DIRECTORIES = 64


@dataclass(frozen=True)
class Tag:
    """One entry of a directory: tag number, TIFF's code of the data type, and values (numbers, or a single text).

    A rational number is stored as two values, numerator and denominator.
    """

    number: int
    kind: int
    values: tuple[int | str, ...]


def read_tags(path, wanted: tuple[int, ...]) -> list[Tag]:
    """Read the wanted tags of every directory, including the Exif directory and sub-directories.

    Parameters
    ----------
    path : path
        Any file. One without a TIFF, see `irodori.ingest.embedded_tiffs`, has no tags; tags beyond the end of a
        truncated file are ignored.
    wanted : tuple of int
        Numbers of tags that hold a few integers or rational numbers, or a text.
    """
    if Path(path).stat().st_size == 0:
        return []
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        return [tag for tiff, order in embedded_tiffs(content) for tag in _tags(tiff, order, wanted)]


def _tags(content, order: str, wanted: tuple[int, ...]) -> Iterator[Tag]:
    seen: set[int] = set()
    waiting = _numbers(content, order, 4, LONG, 1)
    while waiting and len(seen) < _MOST_DIRECTORIES:
        place = waiting.pop()
        if place in seen:
            continue
        seen.add(place)
        count = sum(_numbers(content, order, place, SHORT, 1))
        first = place + 2
        for at in range(first, min(first + _ENTRY_BYTES * count, len(content) - _ENTRY_BYTES + 1), _ENTRY_BYTES):
            tag, kind, number = struct.unpack_from(order + "HHI", content, at)
            if tag in wanted:
                yield from _tag(content, order, at, tag)
            elif tag in (_SUB_DIRECTORIES, _EXIF) and kind in (LONG, _IFD) and 1 <= number <= _MOST_DIRECTORIES:
                value = at + 8 if number == 1 else sum(_numbers(content, order, at + 8, LONG, 1))
                waiting += _numbers(content, order, value, LONG, number)
        waiting += [next_ for next_ in _numbers(content, order, first + _ENTRY_BYTES * count, LONG, 1) if next_]


def _tag(content, order: str, at: int, tag: int) -> Iterator[Tag]:
    kind, number = struct.unpack_from(order + "HI", content, at + 2)
    size = {_ASCII: 1, SHORT: 2, LONG: 4, RATIONAL: 8}.get(kind, 0) * number
    if not 0 < size <= _LONGEST_TEXT:
        return
    value = at + 8 if size <= 4 else sum(_numbers(content, order, at + 8, LONG, 1))
    if kind == _ASCII:
        text = bytes(content[value : value + number]).partition(b"\0")[0].decode("ascii", errors="replace").strip()
        yield Tag(tag, kind, (text,))
    elif values := _numbers(content, order, value, kind, 2 * number if kind == RATIONAL else number):
        yield Tag(tag, kind, tuple(values))


def _numbers(content, order: str, at: int, kind: int, count: int) -> list[int]:
    """Read ``count`` integers at a position of the file; an empty list if they reach beyond its end."""
    layout = f"{order}{count}{'H' if kind == SHORT else 'I'}"
    whole = at <= len(content) - struct.calcsize(layout)
    return list(struct.unpack_from(layout, content, at)) if whole else []
