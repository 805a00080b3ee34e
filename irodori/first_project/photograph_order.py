"""Order in which photographs were taken, by the camera's clock and by the numbers in the names of their files."""

import os
import re
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping
from itertools import groupby, pairwise
from pathlib import Path
from typing import NamedTuple

from irodori.core.errors import InputError

#: Ways to state the order of photographs whose clock and names contradict each other.
ORDERS = ("clock", "names")
#: Cameras count in four digits up to the last of these numbers, and then begin again at 0 or 1. Up to four digits more
#: precede them, of a folder or a day: P5049999.ORF, DSC09999.ARW.
_DIGITS, _MOST_DIGITS, _FIRST, _LAST = 4, 8, 1, 9999
#: A name without its ending: what precedes its last number, the number, and what follows it.
_NUMBERED = re.compile(r"(.*?)(\d+)(\D*)", re.DOTALL)
#: A name that ends with day and time, as phones give it: 20260504_101500.
_DATED = re.compile(r".*\d{8}\D\d{6}\D*", re.DOTALL)

_BY_CLOCK = "--order clock if files were renamed or have names that do not count photographs"


class _Numbered(NamedTuple):
    """Name without its ending, in small letters: what precedes its last number, the number, and what follows it.

    ``is_count`` tells whether the number can be that of a camera.
    """

    before: str
    digits: str
    after: str
    is_count: bool

    @property
    def series(self) -> str:
        """Part of the name before the last four digits, which are the camera's count."""
        return self.before + self.digits[:-_DIGITS]

    @property
    def number(self) -> int:
        """The last four digits."""
        return int(self.digits[-_DIGITS:])


class _Restart(NamedTuple):
    """A count that begins again after 9999 within a folder, if smaller numbers are not of earlier photographs.

    Parameters
    ----------
    begin : int
        First number of the folder; smaller ones are later.
    last, first : str
        Names with the largest and with the smallest number, between which the count would have begun again.
    is_sure : bool
        Whether no number is missing from the first to the last photograph, with two or more on each side.
    """

    begin: int
    last: str
    first: str
    is_sure: bool


def in_counting_order(names: Iterable[str]) -> list[str]:
    """Sort names with numbers in them by the values of the numbers: a2 before a10.

    a9999 comes before a0001 if no number is missing between the first and the last and two or more are on each side.
    """
    names = list(names)
    restarts = _sure(_restarts(names))
    return sorted(names, key=lambda name: _key(name, restarts))


def in_order(times: Mapping[Path, str], said: str = "") -> tuple[list[Path], str]:
    """Sort the photographs of one camera in the order in which they were taken.

    Parameters
    ----------
    times : dict
        Time of the camera's clock, ISO 8601, by the path of the photograph; empty if its file states none.
    said : str
        One of ORDERS; if empty, clock and names must agree.

    Returns
    -------
    paths : list of Path
        By time, those of one time by name; all by name if a file states no time. Within a second, names that differ in
        nothing but a number outweigh its fractions, because some cameras write 7 ms as 7, which means 0.7 s.
    order : str
        What the order is that of, as a phrase.

    Raises
    ------
    InputError
        If clock and names contradict each other, because the clock was set meanwhile, files were renamed or names do
        not count photographs; if it cannot be told whether the count began again after 9999; for the order ``clock``,
        if a file states no time.
    """
    silent = [path for path, time in times.items() if not time]
    if said == "clock" and silent:
        raise InputError(silent[0], "time", "none", "--order clock where every file states its time")
    possible = _restarts(path.name for path in times)
    restarts = _sure(possible)
    by_name = _by_name(times, restarts)
    if said == "names":
        return by_name, "their names, as --order says"
    if said == "clock":
        return sorted(by_name, key=times.__getitem__), "the camera's clock, as --order says"
    seconds = {path: time.partition(".")[0] for path, time in times.items()}
    restarts |= _told_by_clock(possible, seconds)
    by_name = _by_name(times, restarts)
    # Where a file states no time, names alone tell its place, and have to be right for all others too.
    found = _contradiction(by_name, seconds, _folder if silent else _counter)
    if found is not None:
        raise _refusal(*found, times, silent)
    if silent:
        return by_name, "their names, because not every file states its time"
    ordered: list[Path] = []
    for _, same in groupby(sorted(by_name, key=seconds.__getitem__), seconds.__getitem__):
        second = list(same)
        agrees = _contradiction(second, times, _but_number) is None
        ordered += sorted(second, key=times.__getitem__) if agrees else second
    return ordered, "the camera's clock"


def _told_by_clock(restarts: Mapping[str, _Restart], times: Mapping[Path, str]) -> dict[str, _Restart]:
    """Return those restarts that are not sure by the names, but which the clock requires.

    Raises
    ------
    InputError
        If the clock contradicts neither the count with nor that without the restart, or both.
    """
    told = {}
    for series, restart in restarts.items():
        if restart.is_sure:
            continue
        own = [path for path in times if _numbered(path.name).series == series]
        is_possible, is_possible_without = (
            _contradiction(_by_name(own, reading), times, _counter) is None for reading in ({series: restart}, {})
        )
        if is_possible == is_possible_without:
            by_clock = f"{_BY_CLOCK}, " if not is_possible and all(times.values()) else ""
            raise _untold(restart, f"{by_clock}--order names if it has not, or ")
        if is_possible:
            told[series] = restart
    return told


def _by_name(paths: Iterable[Path], restarts: Mapping[str, _Restart]) -> list[Path]:
    return sorted(paths, key=lambda path: _key(path.name, restarts))


def _key(name: str, restarts: Mapping[str, _Restart]) -> list[str | tuple[int, bool, int]]:
    """Return texts and numbers in turn; after a restart of the count, its last four digits are larger than before."""
    numbered = _numbered(name)
    restart = restarts.get(numbered.series) if numbered.is_count else None
    is_later = restart is not None and numbered.number < restart.begin
    last = 2 * len(re.findall(r"\d+", numbered.before)) + 1
    return [
        (int(part) // (_LAST + 1), is_later and at == last, int(part) % (_LAST + 1)) if at % 2 else part.lower()
        for at, part in enumerate(re.split(r"(\d+)", name))
    ]


def _numbered(name: str) -> _Numbered:
    stem = os.path.splitext(name)[0]
    found = _NUMBERED.fullmatch(stem)
    if found is None:
        return _Numbered(stem.lower(), "", "", False)
    is_count = _DIGITS <= len(found[2]) <= _MOST_DIGITS and _DATED.fullmatch(stem) is None
    return _Numbered(found[1].lower(), found[2], found[3].lower(), is_count)


def _restarts(names: Iterable[str]) -> dict[str, _Restart]:
    """Return where counts may have begun again, by what precedes the last four digits.

    They may if fewer numbers are missing from the largest over 9999 to the smallest than between two others.
    """
    counted: dict[str, dict[int, str]] = defaultdict(dict)
    for name in names:
        numbered = _numbered(name)
        if numbered.is_count and not numbered.after:
            counted[numbered.series][numbered.number] = name
    restarts = {}
    for series, found in counted.items():
        counts = sorted(found)
        least, most = counts[0], counts[-1]
        gap, at = max(((b - a, at) for at, (a, b) in enumerate(pairwise(counts), 1)), default=(0, 0))
        if gap > least + _LAST - most:
            none_missing = most == _LAST and least <= _FIRST and gap + len(counts) == most - least + 2
            is_sure = none_missing and 2 <= at <= len(counts) - 2
            restarts[series] = _Restart(counts[at], found[most], found[least], is_sure)
    return restarts


def _sure(restarts: Mapping[str, _Restart]) -> dict[str, _Restart]:
    return {series: restart for series, restart in restarts.items() if restart.is_sure}


def _contradiction(
    by_name: list[Path], times: Mapping[Path, str], run: Callable[[Path], Hashable]
) -> tuple[Path, Path] | None:
    """Return the first photograph of a run whose time is earlier than that of the one before it, and that one first.

    Photographs without a time are passed over, as are those of the run None.
    """
    before: dict[Hashable, Path] = {}
    for path in by_name:
        key = run(path)
        if key is None or not times[path]:
            continue
        if key in before and times[path] < times[before[key]]:
            return before[key], path
        before[key] = path
    return None


def _folder(path: Path) -> Hashable:
    """Return the same for all photographs, for `_contradiction`."""
    return ""


def _counter(path: Path) -> Hashable:
    """Return what photographs of one counter have in common; None for a name that ends with no camera's count."""
    numbered = _numbered(path.name)
    return numbered.before if numbered.is_count and not numbered.after else None


def _but_number(path: Path) -> Hashable:
    """Return what names have in common that differ in nothing but their last number."""
    numbered = _numbered(path.name)
    return numbered.before, numbered.after


def _refusal(one: Path, other: Path, times: Mapping[Path, str], silent: list[Path]) -> InputError:
    found = f"{times[other]}, before {times[one]} of {one.name}, which by name is the earlier one"
    otherwise = (
        f"or names in the order of the photographs, because {silent[0].name} states no time" if silent else _BY_CLOCK
    )
    return InputError(other, "time", found, f"--order names if the clock was set between them, {otherwise}")


def _untold(restart: _Restart, accepted: str = "") -> InputError:
    last, first = (Path(name).name for name in (restart.last, restart.first))
    found = f"numbers up to {last}, after which the count may have begun again with {first}"
    renamed = f"names that tell, such as a-{last} before b-{first} if it has"
    return InputError(restart.last, "", found, accepted + renamed)
