"""Requests to the person at the bench for settings that no motor makes, and the answers.

Nothing is stored between runs, because a person may have moved anything: after a restart the first request states every
setting that its shot requires.
"""

import os
import shlex
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from irodori.capture.dialogue import AGAIN, LONGEST_REASON, NO, YES, Dialogue, OperatorAbort, State
from irodori.capture.rig.devices import DeadlineError, DeviceError
from irodori.config.validation import suggest
from irodori.core.progress import LOGGER

#: The order in which a step names its settings: the subject first, the filter last.
SETTINGS = ("subject", "placement", "light_deg", "light_azimuth_deg", "camera_deg", "tilt_deg", "turn_deg", "filter")

_ANGLE_PHRASES = {
    "light_deg": "set the light to {}",
    "light_azimuth_deg": "set the light's azimuth to {}",
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
#: Phrases by the prefix of a chart's name, see `irodori.config.capture_table.Shot.subject`.
_CHARTS = {"chart-": "put the colour chart {} in place", "room-chart-": "point the camera at the colour chart {}"}
#: Assumed values of settings before the first request: the lamp is in the rig's plane unless somebody moves it, and an
#: object that is put in place lies as it does first.
_AT_FIRST = {"light_azimuth_deg": 0.0, "placement": 1}
_PROGRESS_S, _POLL_S = 60.0, 0.5


def _chart_phrase(subject) -> str:
    """Return the request for a chart with a name, empty for any other subject."""
    phrases = [text.format(str(subject).removeprefix(p)) for p, text in _CHARTS.items() if str(subject).startswith(p)]
    return phrases[0] if phrases else ""


@dataclass(frozen=True)
class Change:
    """Change of one setting by a person.

    Parameters
    ----------
    name : str
        One of SETTINGS.
    old : float, str or None
        Present value, None if it is unknown. Angles in degrees.
    new : float or str
        Required value.
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
        if self.name == "placement":
            return f"lay the object down as in placement {self.new:.0f}"
        phrase = _ANGLE_PHRASES[self.name].format(_degrees(float(self.new)))
        return phrase if self.old is None else f"{phrase} (it stands at {_degrees(float(self.old))})"


@dataclass(frozen=True)
class Step:
    """Settings to change by hand before the next photograph, in the order of SETTINGS; false if there are none."""

    changes: tuple[Change, ...]

    @classmethod
    def between(cls, stands: Mapping[str, float | str], wanted: Mapping[str, float | str]) -> "Step":
        """Return the changes from the present to the required settings; those missing in `stands` count as unknown.

        Raises
        ------
        ValueError
            For a setting that is not in SETTINGS.
        """
        for name in wanted:
            if name not in SETTINGS:
                raise ValueError(f"no setting {name!r}; {suggest(name, SETTINGS)}")
        stands = {**_AT_FIRST, **stands}
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
    """Interface of a person, or a substitute, who changes settings without a motor and judges doubtful photographs."""

    #: Whether `judge` reaches a person; if not, a doubtful photograph is taken again once, then the session stops.
    attended = False

    def ask(self, step: Step) -> None:
        """Ask for the changes of a step and return when they are made. Raises as `confirm` does."""
        self.confirm(str(step))

    @abstractmethod
    def confirm(self, request: str) -> None:
        """Ask a person to do something, and return when it was confirmed.

        Parameters
        ----------
        request : str
            Request: a sentence that begins with a verb, without its full stop.

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
        """Ask a person to judge a doubtful photograph; return the reason to keep it, empty to take it again.

        Parameters
        ----------
        doubt : str
            Name of the photograph and description of the doubt; a sentence without its full stop.

        Raises
        ------
        OperatorAbort, DeadlineError, DeviceError
            As for `confirm`.
        """
        raise DeviceError(f"nobody can be asked: {doubt}")


class HandSettings:
    """Present settings by hand, as far as this run knows them; those that differ are requested from the operator."""

    def __init__(self, operator: Operator) -> None:
        self.operator = operator
        self._stands: dict[str, float | str] = {}  # confirmed settings; others are unknown

    def set(self, wanted: Mapping[str, float | str]) -> Step:
        """Request the changes to the wanted settings, and return them as a step, which is false if none was needed.

        After a step that failed its settings are unknown, because it may be half done.
        """
        step = Step.between(self._stands, wanted)
        if step:
            for change in step.changes:
                self._stands.pop(change.name, None)
            self.operator.ask(step)
            self._stands |= step.new
        return step


class PromptOperator(Operator):
    """Operator who is asked on the terminal and, if there is one, on the page.

    Parameters
    ----------
    dialogue : Dialogue
    """

    def __init__(self, dialogue: Dialogue) -> None:
        self.dialogue = dialogue

    attended = True

    def ask(self, step: Step) -> None:
        """Ask for a step and wait until it is done; the session's other actions are offered too."""
        self.dialogue.ask(State.STEP, str(step))

    def confirm(self, request: str) -> None:
        """Ask to clear what has stopped the rig, and wait for the answer."""
        self.dialogue.ask(State.HELD, request)

    def judge(self, doubt: str) -> str:
        """Ask whether to keep a doubtful photograph, and why."""
        return self.dialogue.ask(State.DOUBT, doubt)


class FileOperator(Operator):
    """Operator who confirms by creating a file, for example with ``touch``; the file is removed afterwards.

    The request, with the path of the file, goes to the log and to stderr. Each request has a file name of its own, so
    that a late answer to an earlier request does not count for it.

    Parameters
    ----------
    folder : path
        Folder of the files, such as ``results/rig/NAME``; created if it is missing.
    deadline_s : float, optional
        Longest wait, s.
    poll_s, progress_s : float
        Interval between two checks of the folder, and between two messages that the rig still waits, s.
    """

    def __init__(
        self, folder: Path, deadline_s: float | None = None, poll_s: float = _POLL_S, progress_s: float = _PROGRESS_S
    ) -> None:
        self.folder, self.deadline_s = Path(folder), deadline_s
        self.poll_s, self.progress_s = poll_s, progress_s
        self._asked = 0

    attended = True

    def confirm(self, request: str) -> None:
        """Request a file as confirmation, and wait until it exists."""
        self._answer(request, "When done: touch {}")
        LOGGER.info("confirmed: %s", request)

    def judge(self, doubt: str) -> str:
        """Request a file: an empty one takes the photograph again, ``stop`` ends the session, other text keeps it."""
        how = "To take it again: touch {0}; to keep it: echo WHY > {0}; to end: echo stop > {0}"
        answer = self._answer(doubt, how)
        if answer.lower() in NO:
            raise OperatorAbort(f"stopped by the person at the bench: {doubt}")
        return "" if answer.lower() in (*YES, "r", *AGAIN) else answer

    def _answer(self, request: str, how: str) -> str:
        """Request a file, wait until it exists, and return its text."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self._asked += 1
        # Because of the random part, a late answer to a run that was killed does not confirm a step of this one.
        path = self.folder.absolute() / f"confirm-{self._asked}-{os.urandom(2).hex()}"
        path.unlink(missing_ok=True)
        told = how.format(shlex.quote(str(path)))
        _say(f"{request}. {told}")
        begun = said = time.monotonic()
        try:
            # Over NFS, a listing of the folder shows a new file earlier than a query for its name.
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
            return path.read_bytes()[:LONGEST_REASON].decode(errors="replace").strip()
        finally:
            path.unlink(missing_ok=True)


class AutoOperator(Operator):
    """Operator of the virtual rig: a function that makes the settings of a step.

    Parameters
    ----------
    set_bench : callable
        Called with {setting: value}.
    dialogue : Dialogue, optional
        If a page shows it, its person is asked for confirmations and judgements; otherwise nobody can be asked.
    """

    def __init__(self, set_bench: Callable[[dict[str, float | str]], None], dialogue: Dialogue | None = None) -> None:
        self._set_bench = set_bench
        self._person = PromptOperator(dialogue) if dialogue is not None and dialogue.watched else None
        if self._person is not None:
            self.attended = True

    def ask(self, step: Step) -> None:
        """Make the settings of a step on the virtual rig."""
        self._set_bench(step.new)

    def confirm(self, request: str) -> None:
        """Ask on the page; without a page raise `DeviceError`, because only a person can do what is asked."""
        if self._person is None:
            raise DeviceError(f"nobody can be asked to {request[:1].lower()}{request[1:]}: the rig has operator: auto")
        self._person.confirm(request)

    def judge(self, doubt: str) -> str:
        """Ask on the page; without a page raise `DeviceError`."""
        return super().judge(doubt) if self._person is None else self._person.judge(doubt)


def make_operator(
    kind: str,
    folder: Path,
    dialogue: Dialogue,
    set_bench: Callable[[dict[str, float | str]], None] | None = None,
) -> Operator:
    """Return the operator that a rig's definition names; if there is a page, it is used in place of files.

    Parameters
    ----------
    kind : str
        ``prompt``, ``file`` or ``auto``.
    folder : path
        Folder of confirmation files.
    dialogue : Dialogue
        Dialogue of the session; its deadline holds for files too.
    set_bench : callable, optional
        Function that sets the virtual rig; only ``auto`` needs it.

    Raises
    ------
    ValueError
        For an unknown kind.
    DeviceError
        For ``auto`` on a rig that is not virtual.
    """
    if kind == "prompt" or (kind == "file" and dialogue.watched):
        return PromptOperator(dialogue)
    if kind == "file":
        return FileOperator(folder, dialogue.deadline_s)
    if kind != "auto":
        raise ValueError(f"no operator {kind!r}; {suggest(kind, ('prompt', 'file', 'auto'))}")
    if set_bench is None:
        raise DeviceError("operator: auto is for the virtual rig; this one needs prompt or file")
    return AutoOperator(set_bench, dialogue)


def _degrees(angle: float) -> str:
    """Return an angle as text with one decimal, or with more if needed."""
    angle += 0.0  # no -0.0
    text = f"{angle:.1f}"
    return f"{text if float(text) == angle else f'{angle:.10g}'}°"


def _say(message: str) -> None:
    LOGGER.info("%s", message)
    print(message, file=sys.stderr, flush=True)
