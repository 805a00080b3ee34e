"""G-code parser of the Grbl 1.1 simulator, for the commands that move axes."""

import re
from dataclasses import dataclass, field

_MM_PER_INCH = 25.4
_LARGEST_TOOL = 255
_WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))", re.ASCII)
_GROUPS = {
    **dict.fromkeys((0, 1), "motion"),
    **dict.fromkeys((4, 53), "once"),
    80: "motion",
    17: "plane",
    **dict.fromkeys((20, 21), "units"),
    **dict.fromkeys((90, 91), "distance"),
    **dict.fromkeys((93, 94), "feed mode"),
    **dict.fromkeys(range(54, 60), "coordinates"),
}
_M_CODES = (0, 1, 2, 3, 4, 5, 7, 8, 9, 30)
#: Words of a jog: everything else is prohibited there.
_JOG_G = (20, 21, 53, 90, 91)


class GcodeError(Exception):
    """Raised for a line that Grbl refuses; `code` is the number in its reply ``error:N``."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


@dataclass
class Modes:
    """Modal state of the G-code parser, which persists from line to line."""

    motion: int = 0
    units: int = 21
    distance: int = 90
    coordinates: int = 54
    feed_mode: int = 94
    feed: float = 0.0
    tool: int = 0

    def report(self) -> str:
        """Return the reply to ``$G``, the modal state as text."""
        modal = f"G{self.motion} G{self.coordinates} G17 G{self.units} G{self.distance} G{self.feed_mode} M5 M9"
        return f"[GC:{modal} T{self.tool} F{self.feed:g} S0]"


@dataclass
class Move:
    """Move or dwell that a G-code line commands.

    Parameters
    ----------
    targets : dict
        Axis letter -> machine coordinate, or distance if `relative`, units.
    feed : float or None
        Feed rate, units/min; None for the fastest.
    relative : bool
        Whether `targets` are distances.
    inverse_time : bool
        Whether `feed` is the inverse of the time of the move, 1/min.
    dwell_s : float or None
        Time to wait after all earlier moves, s.
    """

    targets: dict[str, float] = field(default_factory=dict)
    feed: float | None = None
    relative: bool = False
    inverse_time: bool = False
    dwell_s: float | None = None


def parse_block(line: str, modes: Modes, letters: str, jog: bool = False) -> Move:
    """Parse a G-code line, update the modal state and return the commanded move.

    Parameters
    ----------
    line : str
        Line in capitals, without spaces and comments; for a jog the part after ``$J=``.
    modes : Modes
        Updated by an accepted line, but never by a jog.
    letters : str
        Letters of the machine's axes.
    jog : bool
        Whether the line is a jog.

    Raises
    ------
    GcodeError
    """
    groups: dict[str, int] = {}
    words: dict[str, float] = {}
    for letter, value in _words(line):
        if letter == "G":
            _take_g(value, groups, jog)
        elif letter == "M":
            if jog or value not in _M_CODES:
                raise GcodeError(16 if jog else 20)
        elif letter not in letters + "FSPNT":
            raise GcodeError(20)
        elif letter in words:
            raise GcodeError(25)
        elif value < 0 and letter in "FSPNT":
            raise GcodeError(4)
        else:
            words[letter] = value
    new = Modes(
        groups.get("motion", modes.motion),
        groups.get("units", modes.units),
        groups.get("distance", modes.distance),
        groups.get("coordinates", modes.coordinates),
        groups.get("feed mode", modes.feed_mode),
        # A feed is undefined after a change of its mode, and in each line by inverse time.
        modes.feed if groups.get("feed mode", modes.feed_mode) == modes.feed_mode == 94 else 0.0,
        modes.tool,
    )
    move = _move(words, groups, new, letters, jog)
    if not jog:
        vars(modes).update(vars(new))
    return move


def _words(line: str):
    place = 0
    while place < len(line):
        if not "A" <= line[place] <= "Z":
            raise GcodeError(1)
        found = _WORD.match(line, place)
        if not found:
            raise GcodeError(2)
        place = found.end()
        yield found[1], float(found[2])


def _take_g(value: float, groups: dict[str, int], jog: bool) -> None:
    if value not in _GROUPS or (jog and value not in _JOG_G):
        raise GcodeError(16 if jog and value in _GROUPS else 20)
    code = int(value)
    if _GROUPS[code] in groups:
        raise GcodeError(21)
    groups[_GROUPS[code]] = code


def _move(words: dict[str, float], groups: dict[str, int], new: Modes, letters: str, jog: bool) -> Move:
    scale = _MM_PER_INCH if new.units == 20 else 1.0
    axes = {letter: words[letter] * scale for letter in letters if letter in words}
    # One over a time has no length in it.
    feed = words["F"] * (1.0 if new.feed_mode == 93 and not jog else scale) if "F" in words else None
    if jog:
        if not feed:
            raise GcodeError(22)
        if not axes:
            raise GcodeError(26)
        return Move(axes, feed, new.distance == 91 and groups.get("once") != 53)
    if feed is not None:
        new.feed = feed
    if words.get("T", 0.0) > _LARGEST_TOOL:
        raise GcodeError(38)
    new.tool = int(words.get("T", new.tool))
    if groups.get("once") == 4:
        if "P" not in words:
            raise GcodeError(28)
        return Move(dwell_s=words["P"])
    if axes and new.motion == 80:
        raise GcodeError(31)
    if not axes and groups.get("motion") == 1 and "F" not in words and not new.feed:
        raise GcodeError(22)
    if axes and new.motion == 1 and not new.feed:
        raise GcodeError(22)
    relative = new.distance == 91 and groups.get("once") != 53
    inverse_time = new.feed_mode == 93
    return Move(axes, new.feed if new.motion == 1 else None, relative, inverse_time)
