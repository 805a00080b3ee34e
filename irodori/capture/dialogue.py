"""Dialogue of a session with the person at the bench: questions, possible actions, and answers.

A session has one dialogue. The terminal and the page (`irodori.capture.page_server`) show it and send actions to it;
only this module decides which actions are allowed, so that both offer the same. An action names the turn that it
answers: a new turn begins with each question and each photograph, so that an action cannot confirm a question that the
person has not seen.
"""

import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING

from irodori.capture.rig.devices import DeadlineError, DeviceError
from irodori.capture.terminal import Terminal
from irodori.core.errors import PlainError
from irodori.core.progress import LOGGER

if TYPE_CHECKING:
    from irodori.geometry.projected_outline import Outline
    from irodori.ingest.preview import Preview

_POLL_S = 0.1
#: Answers on the terminal beside the keys that a question names.
YES, NO, AGAIN = ("", "y", "yes", "ok", "done"), ("q", "quit", "a", "abort", "n", "no", "stop"), ("retake", "again")
LONGEST_REASON = 200


class OperatorAbort(DeviceError):
    """Error raised when the person at the bench stops the session."""


class Refused(PlainError):
    """Error for an action that is not possible now; nothing has changed."""


class RetakeLast(Exception):
    """Exception raised when the person asks to take the latest photograph again before the session continues.

    Parameters
    ----------
    file : str
        Name of the photograph in the table.
    """

    def __init__(self, file: str) -> None:
        super().__init__(file)
        self.file = file


class Action(StrEnum):
    """Actions of a person at the bench."""

    DONE = "done"
    RETAKE = "retake"
    KEEP = "keep"
    RETAKE_LAST = "retake-last"
    TEST = "test"
    PAUSE = "pause"
    STOP = "stop"


class State(StrEnum):
    """States of a session: its activity, or the kind of answer that it waits for."""

    WORKING = "working"
    STEP = "step"
    HELD = "held"
    DOUBT = "doubt"
    PAUSED = "paused"
    COMPLETE = "complete"
    ENDED = "ended"


@dataclass(frozen=True)
class Offer:
    """An action that is possible now.

    Parameters
    ----------
    action : Action
    button : str
        Label of its button on the page.
    key : str
        Key for it on the terminal; empty for Enter alone.
    prompt : str
        Its description on the terminal.
    """

    action: Action
    button: str
    key: str
    prompt: str


_LAST = Offer(Action.RETAKE_LAST, "Retake last", "l", "l to retake the last")
_TEST = Offer(Action.TEST, "Test exposure", "t", "t for a test exposure")
_STOP = Offer(Action.STOP, "Stop", "q", "q to stop")

#: Actions that are possible in each state; Enter stands for the first.
OFFERS: dict[State, tuple[Offer, ...]] = {
    State.WORKING: (Offer(Action.PAUSE, "Pause", "p", "p to pause"), _LAST, _STOP),
    State.STEP: (Offer(Action.DONE, "Done", "", "Enter when done"), _LAST, _TEST, _STOP),
    State.HELD: (Offer(Action.DONE, "Done", "", "Enter when done"), _STOP),
    State.DOUBT: (
        Offer(Action.RETAKE, "Retake this", "r", "Enter to take it again"),
        _TEST,
        _STOP,
        Offer(Action.KEEP, "Keep it", "", "or why it is right"),
    ),
    State.PAUSED: (Offer(Action.DONE, "Go on", "", "Enter to go on"), _LAST, _TEST, _STOP),
    State.COMPLETE: (Offer(Action.DONE, "Finish", "", "Enter to finish"), _LAST),
    State.ENDED: (),
}
#: States without a deadline: the person asked for a pause, and a complete session loses nothing by waiting.
_WITHOUT_DEADLINE = (State.PAUSED, State.COMPLETE)


@dataclass(frozen=True)
class Shown:
    """Photograph as it is shown to the person.

    Parameters
    ----------
    number : int
        Number of the photograph among those shown, from 1.
    file : str
        Name in the table; empty for a test exposure.
    finding : str
        Sentence with the result of the checks.
    preview : Preview
    outline : Outline, optional
        Outline of the object in the stated pose; None if there is no object, or the lens is unknown.
    """

    number: int
    file: str
    finding: str
    preview: "Preview"
    outline: "Outline | None" = None


@dataclass(frozen=True)
class SessionView:
    """Snapshot of a session for the terminal and the page.

    Parameters
    ----------
    version : int
        Number that grows with every change.
    state : State
    words : str
        Request to the person, or description of the session's activity.
    turn : int
        Number of the turn, which an action must name.
    offers : tuple of Offer
        Actions that are possible.
    wanted : Action or None
        Action that will be done as soon as the present photograph is stored.
    done, total : int
        Photographs in the table and in the plan.
    left_s : float
        Estimated remaining time, s.
    note : str
        Further message, such as the reason why a test exposure failed.
    shown : Shown or None
        The latest photograph.
    """

    version: int = 0
    state: State = State.WORKING
    words: str = "The session is being prepared."
    turn: int = 0
    offers: tuple[Offer, ...] = ()
    wanted: Action | None = None
    done: int = 0
    total: int = 0
    left_s: float = 0.0
    note: str = ""
    shown: Shown | None = None


@dataclass
class Dialogue:
    """Dialogue of a session. The session's thread waits for answers; actions may come from any thread.

    Parameters
    ----------
    deadline_s : float, optional
        Longest wait for a person, s.
    watched : bool
        Whether a page shows the dialogue.
    halt : callable
        Function that stops a working session at once. By default the session stops before the next photograph.
    """

    deadline_s: float | None = None
    watched: bool = False
    halt: Callable[[], None] = lambda: None
    #: Function that takes a test exposure and shows it; None if no camera is open.
    on_test: Callable[[], None] | None = None
    _terminal: Terminal = field(default_factory=Terminal)
    _view: SessionView = field(default_factory=SessionView)
    _answer: tuple[Action, str] | None = None
    #: Description of the session's activity while no question is open.
    _work: str = ""
    _last: str = ""
    _retaken: str = ""
    _changed: threading.Condition = field(default_factory=threading.Condition)

    # ---- for those who look on

    @property
    def view(self) -> SessionView:
        """Snapshot of the session's present state."""
        with self._changed:
            return self._view

    def changed_view(self, version: int, wait_s: float) -> SessionView:
        """Wait for a view with another version, at most ``wait_s`` seconds, and return the present view."""
        with self._changed:
            self._changed.wait_for(lambda: self._view.version != version, wait_s)
            return self._view

    def act(self, action: Action, turn: int | None = None, reason: str = "") -> None:
        """Perform an action of the person.

        Parameters
        ----------
        action : Action
        turn : int, optional
            Turn of the view that the person has seen; not needed for stop and pause.
        reason : str
            Reason to keep a doubtful photograph.

        Raises
        ------
        Refused
            If the action is not possible now; nothing has changed.
        """
        with self._changed:
            view = self._view
            possible = [offer.action for offer in view.offers]
            if action not in possible:
                raise Refused(f"{action} is not possible now; possible: {', '.join(possible) or 'nothing'}.")
            if action not in (Action.STOP, Action.PAUSE) and turn != view.turn:
                raise Refused("The session has gone on since; look at what it says now.")
            if view.wanted is not None and action is not Action.STOP and view.state is State.WORKING:
                raise Refused(f"The session will {view.wanted.replace('-', ' ')} first.")
            # With other actions the text, such as the key that was typed, is not a reason.
            reason = " ".join(reason.split()) if action is Action.KEEP else ""
            if action is Action.KEEP and not 0 < len(reason) <= LONGEST_REASON:
                raise Refused(f"To keep a photograph, say why it is right, in at most {LONGEST_REASON} characters.")
            # While the session works the next photograph comes, which the person has not seen.
            if action is Action.RETAKE_LAST:
                self._retaken = self._last
            if view.state is State.WORKING:
                self._change(wanted=action)
                if action is Action.STOP:
                    self.halt()
            else:
                self._answer = (action, reason)
                self._set(State.WORKING, self._work)

    # ---- for the session

    def ask(self, state: State, words: str) -> str:
        """Ask the person and wait; return the reason to keep a photograph, empty for other answers that continue.

        Parameters
        ----------
        state : State
            State of the session while it waits, which determines the `OFFERS`.
        words : str
            A sentence that begins with a verb, without its full stop.

        Raises
        ------
        OperatorAbort
            If the person stops the session.
        RetakeLast
            If the person wants to take the latest photograph again.
        DeadlineError
            If nobody answers in time.
        DeviceError
            If there is neither a terminal nor a page.
        """
        while True:
            action, reason = self._answered(state, words)
            if action is Action.TEST and self.on_test is not None:
                self.on_test()
                continue
            if action is Action.STOP:
                raise OperatorAbort(f"stopped by the person at the bench, before: {words}")
            if action is Action.RETAKE_LAST:
                raise RetakeLast(self._retaken)
            return reason

    def between_shots(self) -> None:
        """Carry out what the person has asked for since the last photograph: pause, retake or stop.

        The method returns when the next photograph may begin.

        Raises
        ------
        OperatorAbort, RetakeLast, DeviceError
            As for `ask`.
        """
        for line in self._terminal.typed():
            # No question is open: Enter and other text mean nothing.
            if action := next((o.action for o in self.view.offers if line.lower() == o.key), None):
                with contextlib.suppress(Refused):  # the page was quicker
                    self.act(action, self.view.turn)
        with self._changed:
            wanted = self._view.wanted
            self._change(wanted=None)
        if wanted is Action.PAUSE:
            self.ask(State.PAUSED, "Paused: nothing moves until you go on")
        elif wanted is Action.RETAKE_LAST:
            raise RetakeLast(self._retaken)
        elif wanted is Action.STOP:
            raise OperatorAbort("stopped by the person at the bench, between two photographs")

    def working(self, words: str, done: int, total: int, left_s: float) -> None:
        """Update the view: the session's activity, the photographs in the table and in the plan, the time left (s)."""
        with self._changed:
            self._work = words
            self._change(done=done, total=total, left_s=left_s)
            self._set(State.WORKING, words)

    def show(self, file: str, finding: str, preview: "Preview", outline: "Outline | None" = None) -> None:
        """Show a photograph to the person; `file` is empty for a test exposure."""
        with self._changed:
            number = self._view.shown.number + 1 if self._view.shown else 1
            self._change(shown=Shown(number, file, finding, preview, outline), note="")
        if not file and self._terminal.is_there:
            self._terminal.show(f"{finding}\n{preview.sketch()}")

    def stored(self, file: str) -> None:
        """Record the name of the latest photograph in the table, which the person may take again."""
        with self._changed:
            self._last = file
            self._set(self._view.state, self._view.words)

    def note(self, words: str) -> None:
        """Log and show a message that needs no answer."""
        LOGGER.warning("%s", words)
        with self._changed:
            self._change(note=words)

    def end(self, words: str) -> None:
        """Show how the session ended; no action is possible any more."""
        with self._changed:
            self._set(State.ENDED, words)

    # ----

    def _change(self, **changes) -> None:
        self._view = replace(self._view, version=self._view.version + 1, **changes)
        self._changed.notify_all()

    def _set(self, state: State, words: str) -> None:
        """Begin a turn with a state and its message."""
        out = [Action.RETAKE_LAST] if not self._last else []
        out += [Action.TEST] if self.on_test is None else []
        offers = tuple(offer for offer in OFFERS[state] if offer.action not in out)
        self._change(state=state, words=words, turn=self._view.turn + 1, offers=offers)

    def _answered(self, state: State, words: str) -> tuple[Action, str]:
        """Ask once, and return the person's action and reason."""
        on_terminal = self._terminal.is_there
        if not on_terminal and not self.watched:
            asked = f"{words[:1].lower()}{words[1:]}"
            way_out = "the input is no terminal; start it on a terminal, or give the rig operator: file"
            raise DeviceError(f"nobody can be asked to {asked}: {way_out}")
        LOGGER.info("asked: %s", words)
        self._terminal.forget_typed()
        with self._changed:
            self._answer = None
            self._set(state, words)
            question = f"{words}. {', '.join(offer.prompt for offer in self._view.offers)}: "
        if on_terminal:
            self._terminal.show(question, end="")
        timed = self.deadline_s is not None and state not in _WITHOUT_DEADLINE
        limit, typed = time.monotonic() + (self.deadline_s or 0.0), False
        try:
            while True:
                with self._changed:
                    if self._answer is None and not on_terminal:
                        self._changed.wait(_POLL_S)
                    if self._answer is not None:
                        break
                if timed and time.monotonic() >= limit:
                    raise DeadlineError(f"nobody answered in {self.deadline_s:g} s: {words}")
                if on_terminal and (line := self._terminal.line(_POLL_S)) is not None:
                    typed = self._typed(line)
                    if not typed:
                        self._terminal.show(question, end="")
            if on_terminal and not typed:
                self._terminal.show("answered on the page")
            return self._answer
        finally:
            with self._changed:
                if self._view.state is state:
                    self._set(State.WORKING, self._work)

    def _typed(self, line: str) -> bool:
        """Perform the action of a typed line; return whether it was an answer."""
        view, key = self.view, line.lower()
        actions = {offer.key: offer.action for offer in view.offers if offer.key}
        if view.offers:
            actions |= dict.fromkeys((*YES, *AGAIN) if view.state is State.DOUBT else YES, view.offers[0].action)
        actions |= dict.fromkeys(NO, Action.STOP)
        keeps = any(offer.action is Action.KEEP for offer in view.offers)
        action = actions.get(key, Action.KEEP if keeps else None)
        if action is None:
            return False
        try:
            self.act(action, view.turn, line)
        except Refused as refusal:
            # The page was quicker, or the reason is too long.
            self._terminal.show(str(refusal))
            return False
        return True
