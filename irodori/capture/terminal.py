"""The terminal at the bench: whether there is one, what is shown on it, and the lines that are typed."""

import os
import select
import sys

#: What the end of the input stands for: stop.
_END = "q"


class Terminal:
    """Lines typed on standard input, and words on standard error; without a terminal there are no lines."""

    @property
    def is_there(self) -> bool:
        """Whether standard input is a terminal."""
        return self._source() is not None

    def forget_typed(self) -> None:
        """Drop what was typed so far: it is no answer to a question that comes after it."""
        import termios

        if (source := self._source()) is not None:
            termios.tcflush(source, termios.TCIFLUSH)

    def show(self, words: str, end: str = "\n") -> None:
        """Show words on the terminal."""
        print(words, end=end, file=sys.stderr, flush=True)

    def line(self, wait_s: float) -> str | None:
        """Return the next line, None where none came in a time (s); `_END` at the end of the input (Ctrl-D)."""
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
        """Return the lines that wait to be read; none where the program runs in the terminal's background."""
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
    """Return whether reading is allowed: a program in the background would be stopped by it."""
    try:
        return os.tcgetpgrp(source) == os.getpgrp()
    except OSError:  # another program's terminal, which has no foreground of ours
        return True
