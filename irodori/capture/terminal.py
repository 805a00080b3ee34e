"""Terminal of the person at the bench: messages to it, and the lines typed on it, if there is one."""

import os
import select
import sys

#: Line that the end of the input counts as: stop.
_END = "q"


class Terminal:
    """Terminal with input from stdin and output to stderr; if stdin is not a terminal, there is no input."""

    @property
    def is_there(self) -> bool:
        """Whether standard input is a terminal."""
        return self._source() is not None

    def forget_typed(self) -> None:
        """Discard what was typed so far, so that it does not answer a later question."""
        import termios

        if (source := self._source()) is not None:
            termios.tcflush(source, termios.TCIFLUSH)

    def show(self, words: str, end: str = "\n") -> None:
        """Print text on the terminal."""
        print(words, end=end, file=sys.stderr, flush=True)

    def line(self, wait_s: float) -> str | None:
        """Return the next line, None after ``wait_s`` seconds without one, and ``q`` at the end of input (Ctrl-D)."""
        source = self._source()
        # A terminal in its usual mode hands out whole lines.
        if source is None or not select.select([source], [], [], wait_s)[0]:
            return None
        try:
            typed = os.read(source, 4096)
        except OSError:  # it was closed
            typed = b""
        return typed.decode(errors="replace").strip() if typed else _END

    def typed(self) -> list[str]:
        """Return the lines that were typed and not yet read; none if the program runs in the background."""
        source = self._source()
        if source is None or not _in_foreground(source):
            return []
        found: list[str] = []
        while _END not in found and (line := self.line(0.0)) is not None:
            found += line.split("\n")
        return found

    def _source(self) -> int | None:
        try:
            source = sys.stdin.fileno()
            return source if os.isatty(source) else None
        except (AttributeError, OSError, ValueError):
            return None


def _in_foreground(source: int) -> bool:
    """Return whether the program is in the terminal's foreground; one in the background would be stopped by reading."""
    try:
        return os.tcgetpgrp(source) == os.getpgrp()
    except OSError:  # the terminal of another session
        return True
