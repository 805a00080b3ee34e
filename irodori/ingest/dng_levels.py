"""Repeat pattern of a DNG's black levels, a tag that LibRaw does not report.

Read directly, for a damaged header must not cost more than its file: libraries that read whole directories make as many
objects as a count in them says, which after one flipped bit may be a thousand million.
"""

import mmap
import struct
from pathlib import Path

_BLACK_LEVEL_REPEAT, _SUB_DIRECTORIES = 50713, 330
_SHORT, _LONG, _IFD = 3, 4, 13
_ENTRY_BYTES = 12
#: A DNG has a handful of directories; what claims more is damaged and is LibRaw's to refuse.
_MOST_DIRECTORIES = 64


def black_level_repeats(path) -> list[tuple[int, int]]:
    """Return (rows, columns) of the repeat of the black level in each directory of a TIFF that states one.

    Parameters
    ----------
    path : path
        Any file; one that is no TIFF states none, and what a damaged one says beyond its end is left out.
    """
    if Path(path).stat().st_size == 0:
        return []
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        return _repeats(content)


def _repeats(content) -> list[tuple[int, int]]:
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(content[:4])
    if order is None:
        return []
    found: list[tuple[int, int]] = []
    seen: set[int] = set()
    waiting = _numbers(content, order, 4, _LONG, 1)
    while waiting and len(seen) < _MOST_DIRECTORIES:
        place = waiting.pop()
        if place in seen:
            continue
        seen.add(place)
        count = sum(_numbers(content, order, place, _SHORT, 1))
        first = place + 2
        for at in range(first, min(first + _ENTRY_BYTES * count, len(content) - _ENTRY_BYTES + 1), _ENTRY_BYTES):
            tag, kind, number = struct.unpack_from(order + "HHI", content, at)
            if tag == _BLACK_LEVEL_REPEAT and number == 2 and kind == _SHORT:
                rows, columns = _numbers(content, order, at + 8, kind, number)
                found.append((rows, columns))
            elif tag == _SUB_DIRECTORIES and kind in (_LONG, _IFD) and 1 <= number <= _MOST_DIRECTORIES:
                value = at + 8 if number == 1 else sum(_numbers(content, order, at + 8, _LONG, 1))
                waiting += _numbers(content, order, value, _LONG, number)
        waiting += [next_ for next_ in _numbers(content, order, first + _ENTRY_BYTES * count, _LONG, 1) if next_]
    return found


def _numbers(content, order: str, at: int, kind: int, count: int) -> list[int]:
    """Return numbers from a place of the file, none where they reach beyond its end."""
    layout = f"{order}{count}{'H' if kind == _SHORT else 'I'}"
    whole = 0 <= at <= len(content) - struct.calcsize(layout)
    return list(struct.unpack_from(layout, content, at)) if whole else []
