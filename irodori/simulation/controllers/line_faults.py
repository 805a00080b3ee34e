"""Injectable faults of a serial line and a controller.

A fault is one line of text, ``[when] what``:

=====================  ==================================================================================
when
=====================  ==================================================================================
``now``                at once (may be left out)
``line N``             when the N-th line from now has arrived at the controller
``move F``             in the next motion, after the share F (0..1) of its path
=====================  ==================================================================================

=====================  ==================================================================================
what
=====================  ==================================================================================
``drop-output N``      the next N bytes from the controller are lost
``drop-input N``       the next N bytes to the controller are lost
``drop-report N``      the next N status reports of a Grbl controller are lost completely
``garble``             one byte in three of the next line from the controller is replaced
``stall [S]``          output of the controller is held back for S seconds of real time, or for ever
``hangup [S]``         the line disconnects and returns after S seconds of real time, or never; motion continues
``reset``              the controller loses its power for a moment
``alarm N``            the controller raises alarm N without cause
``hold``               a person presses the feed-hold button
``slip U``             the motor of the first axis loses steps: the axis stands U units below the controller's count
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
    """A fault with its argument `value`, and the event `when`, with argument `at`, at which it happens."""

    kind: str
    value: float = 0.0
    when: str = "now"
    at: float = 0.0

    def due(self, lines: int, progress: float | None) -> bool:
        """Return whether the fault happens now, from the lines received since its request and the share of the path."""
        if self.when == "line":
            return lines >= self.at
        return self.when == "now" or (progress is not None and progress >= self.at)


def parse_fault(text: str) -> Fault:
    """Parse a fault from a line of text in the form ``[when] what``.

    Raises
    ------
    ValueError
        If the text is no fault; the message lists the accepted ones.
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
