"""Prompts to the person at the bench for steps that no motor does, and their answers.

Nothing is kept between runs. A person may have moved anything since, so that after a restart the first step states
every setting that its shot needs, once.
"""

import os
import select
import shlex
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from irodori.capture.rig.devices import DeadlineError, DeviceError
from irodori.config.validation import suggest
from irodori.core.progress import LOGGER

#: The order in which a step names its settings: the subject first, the filter last.
SETTINGS = ("subject", "light_deg", "camera_deg", "tilt_deg", "turn_deg", "filter")

_ANGLE_PHRASES = {
    "light_deg": "set the light to {}",
    "camera_deg": "set the camera to {}",
    "tilt_deg": "tilt the table to {}",
    "turn_deg": "turn the table to {}",
}
_FILTER_PHRASES = {"in": "put the comb filter in", "out": "take the comb filter out"}
_SUBJECT_PHRASES = {
    "dark": "put the lens cap on",
    "white": "put the white reference in place",
    "chart": "put the colour chart in place",
    "object": "put the object in place",
    "environment": "point the camera at the environment",
    "scene": "point the camera at the scene",
}
#: Before the name of a chart, see `irodori.config.capture_table.Shot.subject`.
_CHARTS = {"chart-": "put the colour chart {} in place", "room-chart-": "point the camera at the colour chart {}"}
_YES, _NO = ("", "y", "yes", "ok", "done"), ("q", "quit", "a", "abort", "n", "no", "stop")
_AGAIN, _LONGEST_ANSWER = ("r", "retake", "again"), 200
_PROGRESS_S, _POLL_S = 60.0, 0.5


class OperatorAbort(DeviceError):
    """The person at the bench answered that the session is to stop."""


def _chart_phrase(subject) -> str:
    """Return what to do for a chart that has a name, empty for any other subject."""
    phrases = [text.format(str(subject).removeprefix(p)) for p, text in _CHARTS.items() if str(subject).startswith(p)]
    return phrases[0] if phrases else ""


@dataclass(frozen=True)
class Change:
    """One setting that a person changes.

    Parameters
    ----------
    name : str
        Of SETTINGS.
    old : float, str or None
        What stands there now, None where that is not known. Angles in degrees.
    new : float or str
    """

    name: str
    old: float | str | None
    new: float | str

    def __post_init__(self) -> None:
        if self.name not in SETTINGS:
            raise ValueError(f"no setting {self.name!r}; {suggest(self.name, SETTINGS)}")
        words = {"filter": _FILTER_PHRASES, "subject": _SUBJECT_PHRASES}.get(self.name)
        if self.name == "subject" and _chart_phrase(self.new):
            return
        if words is not None and self.new not in words:
            raise ValueError(f"no {self.name} {self.new!r}; {suggest(str(self.new), words)}")

    def __str__(self) -> str:
        if self.name == "filter":
            return _FILTER_PHRASES[str(self.new)]
        if self.name == "subject":
            # After dark frames, and after a restart, the cap may be on.
            capped = self.new != "dark" and self.old in (None, "dark")
            phrase = _chart_phrase(self.new) or _SUBJECT_PHRASES[str(self.new)]
            return ("take the lens cap off and " if capped else "") + phrase
        phrase = _ANGLE_PHRASES[self.name].format(_degrees(float(self.new)))
        return phrase if self.old is None else f"{phrase} (it stands at {_degrees(float(self.old))})"


@dataclass(frozen=True)
class Step:
    """Settings to change by hand before the next photograph, in the order of SETTINGS; false where there are none."""

    changes: tuple[Change, ...]

    @classmethod
    def between(cls, stands: Mapping[str, float | str], wanted: Mapping[str, float | str]) -> "Step":
        """Return the step from what stands to what is wanted; what `stands` lacks is unknown and is stated.

        Raises
        ------
        ValueError
            For a setting that is none of SETTINGS.
        """
        for name in wanted:
            if name not in SETTINGS:
                raise ValueError(f"no setting {name!r}; {suggest(name, SETTINGS)}")
        names = [name for name in SETTINGS if name in wanted and stands.get(name) != wanted[name]]
        return cls(tuple(Change(name, stands.get(name), wanted[name]) for name in names))

    @property
    def new(self) -> dict[str, float | str]:
        """Settings after the step."""
        return {change.name: change.new for change in self.changes}

    def __bool__(self) -> bool:
        return bool(self.changes)

    def __str__(self) -> str:
        sentence = ", ".join(str(change) for change in self.changes)
        return sentence[:1].upper() + sentence[1:]


class Operator(ABC):
    """Interface of whoever changes the settings that no motor drives, and looks at what is doubtful."""

    #: Whether `judge` reaches a person; where not, a doubtful photograph is taken again once, then the session stops.
    attended = False

    def ask(self, step: Step) -> None:
        """Have a step done; return when it is. Raises as `confirm` does."""
        self.confirm(str(step))

    @abstractmethod
    def confirm(self, request: str) -> None:
        """Have a person do something and say so; return when that was said.

        Parameters
        ----------
        request : str
            What is to be done, a sentence that begins with a verb, without its full stop.

        Raises
        ------
        OperatorAbort
            If the person answers to stop.
        DeadlineError
            If nobody answers in time.
        DeviceError
            If nobody can be asked.
        """

    def judge(self, doubt: str) -> str:
        """Have a person look at a doubtful photograph, and return the reason to keep it, empty to take it again.

        Parameters
        ----------
        doubt : str
            Which photograph, and what is wrong with it; a sentence without its full stop.

        Raises
        ------
        OperatorAbort, DeadlineError, DeviceError
            As `confirm`.
        """
        raise DeviceError(f"nobody can be asked: {doubt}")


class HandSettings:
    """Hand settings at the bench as far as this run knows them; asks for those that differ."""

    def __init__(self, operator: Operator) -> None:
        self.operator = operator
        self._stands: dict[str, float | str] = {}

    @property
    def stands(self) -> dict[str, float | str]:
        """Confirmed settings by name; what is not there is unknown."""
        return dict(self._stands)

    def set(self, wanted: Mapping[str, float | str]) -> Step:
        """Have the wanted settings stand, and return the step that was asked for, false where none was needed.

        A step that fails may be half done: its settings are unknown afterwards.
        """
        step = Step.between(self._stands, wanted)
        if step:
            for change in step.changes:
                self._stands.pop(change.name, None)
            self.operator.ask(step)
            self._stands |= step.new
        return step


class PromptOperator(Operator):
    """Asks on the terminal; Enter confirms, or takes a photograph again; ``q`` stops the session.

    Parameters
    ----------
    deadline_s : float, optional
        Longest wait for an answer, s.
    """

    def __init__(self, deadline_s: float | None = None) -> None:
        self.deadline_s = deadline_s

    attended = True

    def confirm(self, request: str) -> None:
        """Ask, and wait for Enter. What was typed before the question does not count."""
        instead = f"nobody can be asked to {request[:1].lower()}{request[1:]}"
        question = f"{request}. Enter when done, q to stop: "
        while self._answer(request, question, instead).lower() not in _YES:
            pass

    def judge(self, doubt: str) -> str:
        """Ask; Enter takes the photograph again, ``q`` stops, other words are the reason to keep it."""
        question = f"{doubt}. Enter to take it again, q to stop, or why it is right: "
        answer = self._answer(doubt, question, f"nobody can be asked: {doubt}")
        return "" if answer.lower() in (*_YES, *_AGAIN) else answer

    def _answer(self, request: str, question: str, instead: str) -> str:
        """Return what a person types; `_NO`, and the end of the input, stop the session."""
        import termios

        try:
            source = sys.stdin.fileno()
            if not os.isatty(source):
                raise OSError("not a terminal")
            termios.tcflush(source, termios.TCIFLUSH)
        except (AttributeError, OSError, ValueError, termios.error):
            raise DeviceError(
                f"{instead}: the input is no terminal; start it on a terminal, or give the rig operator: file"
            ) from None
        LOGGER.info("asked on the terminal: %s", request)
        limit = None if self.deadline_s is None else time.monotonic() + self.deadline_s
        print(question, end="", file=sys.stderr, flush=True)
        answer = _read_answer(source, limit)
        if answer is None:
            print(file=sys.stderr)
            raise DeadlineError(f"nobody answered in {self.deadline_s:g} s: {request}")
        text = answer.decode(errors="replace").strip()
        if answer == b"" or text.lower() in _NO:
            raise OperatorAbort(f"stopped by the person at the bench, before: {request}")
        return text


class FileOperator(Operator):
    """Waits for a file that the message names; the person makes it with ``touch``. It is removed afterwards.

    The message goes to the log and to stderr. Each question has a name of its own, so that an answer to an earlier one
    is never taken for it.

    Parameters
    ----------
    folder : path
        Where the file is to appear, such as ``results/rig/NAME``; made where it is missing.
    deadline_s : float, optional
        Longest wait, s.
    poll_s, progress_s : float
        Time between two looks at the folder, and between two lines that say that the rig still waits, s.
    """

    def __init__(
        self, folder: Path, deadline_s: float | None = None, poll_s: float = _POLL_S, progress_s: float = _PROGRESS_S
    ) -> None:
        self.folder, self.deadline_s = Path(folder), deadline_s
        self.poll_s, self.progress_s = poll_s, progress_s
        self._asked = 0

    attended = True

    def confirm(self, request: str) -> None:
        """Name a file and wait until it is there."""
        self._answer(request, "When done: touch {}")
        LOGGER.info("confirmed: %s", request)

    def judge(self, doubt: str) -> str:
        """Name a file; empty it takes the photograph again, ``stop`` ends the session, other words keep it."""
        how = "To take it again: touch {0}; to keep it: echo WHY > {0}; to end: echo stop > {0}"
        answer = self._answer(doubt, how)
        if answer.lower() in _NO:
            raise OperatorAbort(f"stopped by the person at the bench: {doubt}")
        return "" if answer.lower() in (*_YES, *_AGAIN) else answer

    def _answer(self, request: str, how: str) -> str:
        """Name a file, wait until it is there, and return what it holds."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self._asked += 1
        # The second part keeps a late answer to a run that was killed from confirming a step of this one.
        path = self.folder.absolute() / f"confirm-{self._asked}-{os.urandom(2).hex()}"
        path.unlink(missing_ok=True)
        told = how.format(shlex.quote(str(path)))
        _say(f"{request}. {told}")
        begun = said = time.monotonic()
        try:
            # Listing the folder sees a new file over NFS earlier than asking for its name.
            while path.name not in os.listdir(self.folder):
                now = time.monotonic()
                if self.deadline_s is not None and now - begun >= self.deadline_s:
                    raise DeadlineError(f"{path} did not appear in {self.deadline_s:g} s: {request}")
                if now - said >= self.progress_s:
                    said = now
                    _say(f"waiting for {(now - begun) / 60.0:.0f} min: {request}. {told}")
                time.sleep(self.poll_s)
            if "{0}" in how and path.stat().st_size == 0:
                time.sleep(self.poll_s)  # a shell makes the file before it writes what is in it
            return path.read_bytes()[:_LONGEST_ANSWER].decode(errors="replace").strip()
        finally:
            path.unlink(missing_ok=True)


class AutoOperator(Operator):
    """Sets the virtual rig: calls a function with the settings of the step."""

    def __init__(self, set_bench: Callable[[dict[str, float | str]], None]) -> None:
        self._set_bench = set_bench

    def ask(self, step: Step) -> None:
        """Set the bench."""
        self._set_bench(step.new)

    def confirm(self, request: str) -> None:
        """Refuse: what only a person can do has no function."""
        raise DeviceError(f"nobody can be asked to {request[:1].lower()}{request[1:]}: the rig has operator: auto")


def make_operator(
    kind: str,
    folder: Path,
    deadline_s: float | None = None,
    set_bench: Callable[[dict[str, float | str]], None] | None = None,
) -> Operator:
    """Return the operator that a rig's definition names.

    Parameters
    ----------
    kind : str
        ``prompt``, ``file`` or ``auto``.
    folder : path
        Where confirmation files appear.
    deadline_s : float, optional
        Longest wait for a person, s.
    set_bench : callable, optional
        What sets the virtual rig; only ``auto`` needs it.

    Raises
    ------
    ValueError
        For another kind, with the valid ones.
    DeviceError
        For ``auto`` on a rig that a person sets.
    """
    if kind == "prompt":
        return PromptOperator(deadline_s)
    if kind == "file":
        return FileOperator(folder, deadline_s)
    if kind != "auto":
        raise ValueError(f"no operator {kind!r}; {suggest(kind, ('prompt', 'file', 'auto'))}")
    if set_bench is None:
        raise DeviceError("operator: auto is for the virtual rig; this one needs prompt or file")
    return AutoOperator(set_bench)


def _degrees(angle: float) -> str:
    """Return an angle with one decimal, with more where it needs them."""
    angle += 0.0  # no -0.0
    text = f"{angle:.1f}"
    return f"{text if float(text) == angle else f'{angle:.10g}'}°"


def _say(message: str) -> None:
    LOGGER.info("%s", message)
    print(message, file=sys.stderr, flush=True)


def _read_answer(source: int, limit: float | None) -> bytes | None:
    """Return a line from a terminal, empty at its end (Ctrl-D), None where none came before `limit`."""
    left = None if limit is None else max(0.0, limit - time.monotonic())
    # A terminal in its usual mode hands out whole lines.
    return os.read(source, 4096) if select.select([source], [], [], left)[0] else None
