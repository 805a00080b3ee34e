"""Injectable faults of a serial line and a controller.

A fault is one line of text, ``[when] what``:

=====================  ==================================================================================
when
=====================  ==================================================================================
``now``                at once (may be left out)
``line N``             when the N-th line from now has arrived at the controller
``move F``             in the next motion, once the part F (0..1) of its path is behind
=====================  ==================================================================================

=====================  ==================================================================================
what
=====================  ==================================================================================
``drop-output N``      the next N bytes from the controller are lost
``drop-input N``       the next N bytes to the controller are lost
``drop-report N``      the next N status reports of a Grbl controller are lost whole
``garble``             one byte in three of the next line from the controller becomes another
``stall [S]``          nothing comes from the controller for S seconds of real time, or for ever; then all of it
``hangup [S]``         the line hangs up; it is back after S seconds of real time, or never. Motion goes on
``reset``              the controller loses its power for a moment
``alarm N``            the controller raises an alarm without cause
``hold``               somebody presses the feed hold at the bench
``slip U``             the motor of the first axis loses steps: it stands U units below its controller's count
=====================  ==================================================================================
"""

import math
from dataclasses import dataclass

#: Fault: its argument as "" (none), "count", "number", or "seconds" (may be left out: for ever).
KINDS = {
    "drop-output": "count",
    "drop-input": "count",
    "drop-report": "count",
    "garble": "",
    "stall": "seconds",
    "hangup": "seconds",
    "reset": "",
    "alarm": "count",
    "hold": "",
    "slip": "number",
}
_WHENS = ("now", "line", "move")


@dataclass
class Fault:
    """A fault and when it happens; `value` is its argument, `at` that of `when`."""

    kind: str
    value: float = 0.0
    when: str = "now"
    at: float = 0.0

    def due(self, lines: int, progress: float | None) -> bool:
        """Return whether the moment is there: `lines` lines after the fault was asked for, or at a part of a path."""
        if self.when == "line":
            return lines >= self.at
        return self.when == "now" or (progress is not None and progress >= self.at)


def parse_fault(text: str) -> Fault:
    """Return the fault that a line of text asks for.

    Raises
    ------
    ValueError
        With a sentence that lists what is accepted.
    """
    words = text.split()
    when, at = "now", 0.0
    if words and words[0] in _WHENS:
        when = words.pop(0)
        if when != "now":
            at = _number(words.pop(0) if words else "", text)
    if not words or words[0] not in KINDS:
        raise ValueError(f"no fault {text!r}; faults: {', '.join(KINDS)}, after nothing, now, line N or move F")
    kind, *rest = words
    if len(rest) > (1 if KINDS[kind] else 0) or (KINDS[kind] in ("count", "number") and not rest):
        raise ValueError(f"{text!r}: {kind} takes {KINDS[kind] or 'nothing'}")
    return Fault(kind, _number(rest[0], text) if rest else math.inf, when, at)


def _number(word: str, text: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not 0.0 <= value < math.inf:
        raise ValueError(f"{text!r}: {word!r} is not a number from 0 on")
    return value
