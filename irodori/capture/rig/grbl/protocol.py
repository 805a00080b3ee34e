"""Parsing of the lines that Grbl 1.1, grblHAL and FluidNC send, and the bytes and lines that they accept.

Nothing here waits or writes. Positions are in the controller's own units, which Grbl calls mm.
Source: gnea/grbl, doc/markdown/interface.md; report.c of grblHAL/core; Report.cpp of bdring/FluidNC.
"""

import re
from dataclasses import dataclass

from irodori.capture.rig.devices import GarbledError
from irodori.capture.rig.grbl.codes import SETTINGS

STATUS, HOLD, RESUME, SOFT_RESET, JOG_CANCEL = b"?", b"!", b"~", b"\x18", b"\x85"
#: Request for a report with every field, which only grblHAL answers; the others discard the byte.
FULL_STATUS = b"\x87"
#: Bytes that the controller's serial buffer holds, and the longest line with its end.
RX_BUFFER_BYTES, LINE_BYTES = 128, 80
LETTERS = "XYZABC"
#: Supported firmwares.
GRBL, GRBLHAL, FLUIDNC = FIRMWARES = ("Grbl", "grblHAL", "FluidNC")
STATES = ("Idle", "Run", "Hold", "Jog", "Home", "Alarm", "Check", "Door", "Sleep", "Tool")
#: States with a number behind a colon, and the largest. Those of Run and Alarm are grblHAL's.
_SUBSTATES = {"Hold": 1, "Door": 3, "Run": 2, "Alarm": 99}

_COORDINATE = r"-?\d{1,7}\.\d{3,4}"
_COORDINATES = re.compile(rf"{_COORDINATE}(?:,{_COORDINATE}){{0,5}}", re.ASCII)
_SETTING = re.compile(r"\$(\d{1,3})=(-?\d{1,9}(?:\.\d{1,6})?)(?: \(.*\))?", re.ASCII)
_STARTUP = re.compile(r"\$N\d=.*|>.*:(?:ok|error:\d{1,3})", re.ASCII)
# Settings of grblHAL that are not numbers: a host name, an address, a list.
_TEXT_SETTING = re.compile(r"\$(\d{1,3})=(.*)", re.ASCII)
# Setting in FluidNC's configuration tree: $/axes/x/homing/mpos_mm=0.000
_CONFIGURED = re.compile(r"\$?(/[A-Za-z0-9_/]{1,60})=(.*)", re.ASCII)
_BANNER = re.compile(r"Grbl(HAL)? (\d{1,3}\.\d{1,3}[a-z]?) \[(FluidNC)?.*\]", re.ASCII)
_CODE = re.compile(r"(error|ALARM):(\d{1,3})", re.ASCII)
_FEEDBACK = re.compile(r"\[([A-Za-z0-9. ]{1,24}):(.*)\]", re.ASCII)


@dataclass(frozen=True)
class Report:
    """Status report ``<Idle|MPos:0.000,0.000,0.000|...>``.

    Parameters
    ----------
    state : str
        One of `STATES`.
    substate : int, optional
        Hold: 0 complete, 1 still slowing down. Door: 0 closed, 1 open, 2 opening while slowing down, 3 resuming.
        Alarm (grblHAL): the alarm's code.
    machine : tuple of float, optional
        ``MPos``, in the controller's units; None if the controller is set to report work positions.
    pins : str
        ``Pn``: letters of the inputs that are active.
    homed : bool, optional
        ``H``, in full reports of grblHAL: whether every axis was homed and has not lost its position since.
    """

    state: str
    substate: int | None = None
    machine: tuple[float, ...] | None = None
    pins: str = ""
    homed: bool | None = None

    @property
    def moving(self) -> bool:
        """Whether the axes may be in motion."""
        slowing = (self.state == "Hold" and self.substate != 0) or (self.state == "Door" and self.substate in (2, 3))
        return self.state in ("Run", "Jog", "Home") or slowing


@dataclass(frozen=True)
class Ok:
    """Answer ``ok``: the oldest unanswered line was executed, or is in the planner."""


@dataclass(frozen=True)
class Error:
    """Answer ``error:N``: the oldest unanswered line was refused."""

    code: int


@dataclass(frozen=True)
class Alarm:
    """Message ``ALARM:N``: the controller stopped by an alarm."""

    code: int


@dataclass(frozen=True)
class Setting:
    """Setting ``$N=value``."""

    number: int
    value: float


@dataclass(frozen=True)
class TextSetting:
    """Setting ``$N=text`` that is not a number, or ``$/path=text`` of FluidNC's tree; `name` is without the $."""

    name: str
    text: str


@dataclass(frozen=True)
class Feedback:
    """Message ``[MSG:...]`` or another bracketed answer (``GC``, ``VER``, ``OPT``, ``G54``, ``HLP``, ...)."""

    kind: str
    text: str


@dataclass(frozen=True)
class Banner:
    """Message ``Grbl 1.1h ['$' for help]``: the controller has just started, or was reset.

    `firmware` is one of `FIRMWARES`, according to the banner; grblHAL can be built with the banner of Grbl.
    """

    version: str
    firmware: str = GRBL


@dataclass(frozen=True)
class Startup:
    """Start-up line of the user, listed or executed."""

    text: str


Message = Report | Ok | Error | Alarm | Setting | TextSetting | Feedback | Banner | Startup


def parse_line(line: str) -> Message:
    """Return the message that a line from the controller contains.

    Parameters
    ----------
    line : str
        Line without its end; not empty.

    Raises
    ------
    GarbledError
        If no firmware of `FIRMWARES` sends such a line.
    """
    if line == "ok":
        return Ok()
    if line.startswith("<"):
        return _report(line)
    if found := _CODE.fullmatch(line):
        return (Error if found[1] == "error" else Alarm)(int(found[2]))
    if found := _SETTING.fullmatch(line):
        return Setting(int(found[1]), float(found[2]))
    if found := _BANNER.fullmatch(line):
        return Banner(found[2], GRBLHAL if found[1] else FLUIDNC if found[3] else GRBL)
    # Grbl's own settings are numbers: text there is a garbled number.
    if (found := _TEXT_SETTING.fullmatch(line)) and int(found[1]) not in SETTINGS:
        return TextSetting(found[1], found[2])
    if found := _CONFIGURED.fullmatch(line):
        return TextSetting(found[1], found[2])
    if found := _FEEDBACK.fullmatch(line):
        return Feedback(found[1], found[2])
    if _STARTUP.fullmatch(line):
        return Startup(line)
    raise garbled(line)


def garbled(line: str) -> GarbledError:
    """Return the error for a line that Grbl does not send."""
    shown = line if len(line) <= 60 else line[:57] + "..."
    return GarbledError(f"the controller sent {shown!r}, which Grbl does not send: the line is garbled")


def _report(line: str) -> Report:
    state, *fields = line[1:-1].split("|") if line.endswith(">") else [""]
    name, colon, number = state.partition(":")
    if name not in STATES or (colon and not (name in _SUBSTATES and number in map(str, range(_SUBSTATES[name] + 1)))):
        raise garbled(line)
    found: dict[str, str] = {}
    for field in fields:
        key, separator, text = field.partition(":")
        if not separator or key in found:
            raise garbled(line)
        found[key] = text
    places = found.get("MPos", found.get("WPos", ""))
    if not _COORDINATES.fullmatch(places):
        raise garbled(line)
    machine = tuple(map(float, places.split(","))) if "MPos" in found else None
    homed = found["H"][:1] == "1" if "H" in found else None
    return Report(name, int(number) if colon else None, machine, found.get("Pn", ""), homed)


def motion_line(targets: dict[str, float], feed: float) -> str:
    """Return the command for a straight move in machine coordinates, without its line end.

    It does not depend on the controller's state: units, mode and coordinate system are part of it.

    Parameters
    ----------
    targets : dict
        {axis letter: machine coordinate, units}.
    feed : float
        Speed along the line, units/min.
    """
    words = "".join(f"{letter}{target:.3f}" for letter, target in targets.items())
    return f"G21G90G94G53G1{words}F{feed:.3f}"


def jog_line(targets: dict[str, float], feed: float) -> str:
    """Return the command for a jog in machine coordinates; parameters as in `motion_line`."""
    return "$J=G21G90G53" + "".join(f"{letter}{target:.3f}" for letter, target in targets.items()) + f"F{feed:.3f}"
