"""Command set of a text-protocol controller, read from the rig's definition: templates and reply patterns."""

import itertools
import re
import string
from collections.abc import Mapping
from dataclasses import dataclass

from irodori.capture.rig.devices import GarbledError
from irodori.config.models import AsciiProtocol

LINE_ENDS = {"lf": b"\n", "cr": b"\r", "crlf": b"\r\n"}
#: Placeholders of each command: those that it must have, and those that it may have.
COMMANDS = {
    "home": ((), ("axis",)),
    "move": (("target",), ("axis",)),
    "stop": ((), ()),
    "position": ((), ("axis",)),
    "status": ((), ("axis",)),
}
#: Commands that a controller may lack.
OPTIONAL = {"resume": ((), ())}
#: Groups that the pattern of each reply must have.
REPLIES = {"accepted": (), "position": ("position",), "status": ("state",), "refused": ()}
#: Keys that list the words of a state.
STATES = ("idle", "busy", "hold", "alarm")
#: Values of the placeholders with which templates are tested.
SAMPLES = {"axis": "A", "target": 12.5, "position": 12.5, "state": "X", "message": "why"}
_NUMBER = r"[-+]?\d{1,9}(?:\.\d{0,9})?"


def placeholders(template: str) -> list[str]:
    """Return the names between a template's braces.

    Raises
    ------
    ValueError
        If the text is not a valid template, or a placeholder has no name.
    """
    found = []
    for _, name, _, _ in string.Formatter().parse(template):
        if name is not None:
            if not name.isidentifier():
                raise ValueError(f"a placeholder {{{name}}} without a plain name")
            found.append(name)
    return found


def template_pattern(template: str) -> re.Pattern:
    """Return a pattern that matches every command made from a template, with the groups ``axis`` and ``target``."""
    text = ""
    for literal, name, _, _ in string.Formatter().parse(template):
        text += re.escape(literal)
        if name is not None:
            text += f"(?P<{name}>{_NUMBER})" if name == "target" else rf"(?P<{name}>\S+?)"
    return re.compile(text, re.ASCII)


@dataclass(frozen=True)
class Description:
    """Text protocol of a controller, from the block ``motion.ascii`` of a rig's file.

    Parameters
    ----------
    line_end : bytes
    commands : dict
        {name of a command: template}. Those of `OPTIONAL` may be absent.
    replies : dict
        {name of a reply: pattern of a whole line}. ``refused`` may be absent.
    idle, busy, hold, alarm : tuple of str
        The controller's words for each state, as the pattern of the status extracts them.
    """

    line_end: bytes
    commands: Mapping[str, str]
    replies: Mapping[str, re.Pattern]
    idle: tuple[str, ...]
    busy: tuple[str, ...]
    hold: tuple[str, ...]
    alarm: tuple[str, ...]

    @classmethod
    def of(cls, block: AsciiProtocol) -> "Description":
        """Return the description from a validated block of the rig's file."""
        return cls(
            LINE_ENDS[block.line_end],
            {name: text for name in (*COMMANDS, *OPTIONAL) if (text := getattr(block, name)) is not None},
            {name: re.compile(text, re.ASCII) for name, text in vars(block.replies).items() if text is not None},
            *(getattr(block, state) for state in STATES),
        )

    def line(self, command: str, **values) -> bytes:
        """Return the bytes of a command."""
        return self.commands[command].format(**values).encode("ascii") + self.line_end

    def per_axis(self, command: str) -> bool:
        """Return whether a command is sent for each axis."""
        return "axis" in placeholders(self.commands[command])

    def match(self, reply: str, line: str) -> re.Match:
        """Return the match of a line with the pattern of a reply.

        Raises
        ------
        GarbledError
            If the line does not match.
        """
        found = self.replies[reply].fullmatch(line)
        if not found:
            raise GarbledError(
                f"the controller sent {line[:60]!r}, which is no reply {reply!r} of motion.ascii.replies"
            )
        return found

    def state(self, word: str) -> str:
        """Return the state, ``idle``, ``run``, ``hold`` or ``alarm``, for the controller's word for it.

        Raises
        ------
        GarbledError
            If the rig's file does not have the word.
        """
        words = {"idle": self.idle, "run": self.busy, "hold": self.hold, "alarm": self.alarm}
        for state, own in words.items():
            if word in own:
                return state
        known = ", ".join(itertools.chain(*words.values()))
        raise GarbledError(f"the controller says {word[:60]!r}; words of its state in the rig's file: {known}")
