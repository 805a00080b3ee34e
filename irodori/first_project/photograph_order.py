"""Order in which photographs were taken, by the camera's clock and by the numbers in the names of their files."""

import os
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from irodori.core.errors import InputError

#: Ways to state the order of photographs whose clock and names contradict each other.
ORDERS = ("clock", "names")
#: Cameras count in four digits or more, up to the last of these numbers, and then begin again at 0 or 1.
_DIGITS, _FIRST, _LAST = 4, 1, 9999
#: A name without its ending: what precedes its last number, the number, and what follows it.
_NUMBERED = re.compile(r"(.*?)(\d+)(\D*)", re.DOTALL)
_BY_NAMES = "names that count up in the order of the photographs"


class _Restart(NamedTuple):
    """A count that begins again after 9999 within a folder, if smaller numbers are not of earlier photographs.

    Parameters
    ----------
    begin : int
        First number of the folder; smaller ones are later.
    last, first : str
        Names with the largest and with the smallest number, between which the count would have begun again.
    is_sure : bool
        Whether these numbers are 9999, and 0 or 1.
    """

    begin: int
    last: str
    first: str
    is_sure: bool


def in_counting_order(names: Iterable[str]) -> list[str]:
    """Sort names with numbers in them by the values of the numbers: a2 before a10, and a9999 before a0001.

    Raises
    ------
    InputError
        If it cannot be told whether a camera's count began again after 9999.
    """
    names = list(names)
    restarts = _restarts(names)
    for restart in restarts.values():
        if not restart.is_sure:
            raise _untold(restart, _BY_NAMES)
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
        By time, those of one time by name; all by name if a file states no time.
    order : str
        What the order is that of, as a phrase.

    Raises
    ------
    InputError
        If clock and names contradict each other, because the clock was set meanwhile or files were renamed; if it
        cannot be told whether the count began again after 9999; for the order ``clock``, if a file states no time.
    """
    restarts = _restarts([path.name for path in times])
    sure = {before: restart for before, restart in restarts.items() if restart.is_sure}
    silent = [path for path, time in times.items() if not time]
    by_name = _by_name(times, sure)
    if said == "names":
        return by_name, "their names, as --order says"
    if said == "clock":
        if silent:
            raise InputError(silent[0], "time", "none", "--order clock where every file states its time")
        return sorted(by_name, key=times.__getitem__), "the camera's clock, as --order says"
    unsure = next((restart for restart in restarts.values() if not restart.is_sure), None)
    fault = _contradiction(by_name, times)
    if unsure is not None:
        restarted = _by_name(times, restarts)
        fault_restarted = _contradiction(restarted, times)
        if fault is None and fault_restarted is None:
            raise _untold(unsure, f"--order names, if these are {_BY_NAMES}, or other names")
        if fault is not None:
            by_name, fault = restarted, fault_restarted
    if fault is not None:
        raise fault
    if silent:
        return by_name, "their names, because not every file states its time"
    return sorted(by_name, key=times.__getitem__), "the camera's clock"


def _by_name(paths: Iterable[Path], restarts: Mapping[str, _Restart]) -> list[Path]:
    return sorted(paths, key=lambda path: _key(path.name, restarts))


def _key(name: str, restarts: Mapping[str, _Restart]) -> list[str | int]:
    """Return texts and numbers in turn; a number after a restart of the count is larger than those before it."""
    key: list[str | int] = [int(p) if at % 2 else p.lower() for at, p in enumerate(re.split(r"(\d+)", name))]
    before, number, _ = _numbered(name)
    if before in restarts and number < restarts[before].begin:
        key[2 * len(re.findall(r"\d+", before)) + 1] = number + _LAST + 1
    return key


def _numbered(name: str) -> tuple[str, int, str]:
    """Return what precedes the last number of a name, the number, and what follows it before the name's ending."""
    found = _NUMBERED.fullmatch(os.path.splitext(name)[0])
    return (found[1].lower(), int(found[2]), found[3].lower()) if found else (name, 0, "")


def _restarts(names: Iterable[str]) -> dict[str, _Restart]:
    """Return where counts may have begun again, by what precedes the number.

    They may if fewer numbers are missing from the largest over 9999 to the smallest than between two others.
    """
    counted: dict[str, list[tuple[int, str]]] = defaultdict(list)
    for name in names:
        before, number, after = _numbered(name)
        if not after and re.search(rf"\d{{{_DIGITS}}}$", os.path.splitext(name)[0]):
            counted[before].append((number, name))
    restarts = {}
    for before, found in counted.items():
        found.sort()
        (least, first), (most, last) = found[0], found[-1]
        gap, begin = max(((b - a, b) for (a, _), (b, _) in pairwise(found)), default=(0, 0))
        if most <= _LAST and gap > least + _LAST - most:
            restarts[before] = _Restart(begin, last, first, most == _LAST and least <= _FIRST)
    return restarts


def _contradiction(by_name: list[Path], times: Mapping[Path, str]) -> InputError | None:
    """Return the sentence on the first photograph whose time contradicts its name; None if there is none.

    Only names that differ in nothing but their last number are compared, unless the names alone tell the place of a
    photograph without a time.
    """
    is_timed = all(times.values())
    runs: dict[tuple[str, str], list[Path]] = defaultdict(list)
    for path in by_name:
        if times[path]:
            before, _, after = _numbered(path.name)
            runs[(before, after) if is_timed else ("", "")].append(path)
    for run in runs.values():
        for one, other in pairwise(run):
            if times[other] < times[one]:
                found = f"{times[other]}, before {times[one]} of {one.name}, which by name is the earlier one"
                accepted = "--order names if the clock was set between them"
                by_clock = ", --order clock if files were renamed" if is_timed else ""
                return InputError(other, "time", found, accepted + by_clock)
    return None


def _untold(restart: _Restart, accepted: str) -> InputError:
    found = f"numbers up to {restart.last}, after which the count may have begun again with {restart.first}"
    return InputError(restart.last, "", found, accepted)
