"""The dialogue of a session with the person at the bench: what is asked, what the person may do now, and the answer.

A session has one dialogue. The terminal and the page (`irodori.capture.page_server`) show it and hand actions to it;
what is allowed is decided here alone, so that both offer the same. An action says which turn it answers: a turn ends
with each question and each photograph, so that nothing confirms a later question than the person has seen.
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
    """The person at the bench answered that the session is to stop."""


class Refused(PlainError):
    """An action that the session does not take now; nothing has changed."""


class RetakeLast(Exception):
    """The person wants the photograph that was the newest taken again before the session goes on.

    Parameters
    ----------
    file : str
        Its name in the table.
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
    """States of a session: its activity, or the answer that it waits for."""

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
        Its name on the page.
    key : str
        What is typed for it on the terminal, besides Enter.
    prompt : str
        How the terminal names it.
    """

    action: Action
    button: str
    key: str
    prompt: str


_LAST = Offer(Action.RETAKE_LAST, "Retake last", "l", "l to retake the last")
_TEST = Offer(Action.TEST, "Test exposure", "t", "t for a test exposure")
_STOP = Offer(Action.STOP, "Stop", "q", "q to stop")

#: What the person may do in each state; the first is what Enter does.
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
#: A pause is the person's own, and a complete session loses nothing: neither ends at the operator's deadline.
_WITHOUT_DEADLINE = (State.PAUSED, State.COMPLETE)


@dataclass(frozen=True)
class Shown:
    """A photograph as the person sees it.

    Parameters
    ----------
    number : int
        Counts the photographs shown, from 1.
    file : str
        Name in the table; empty for a test exposure.
    finding : str
        What was found about it, a sentence.
    preview : Preview
    outline : Outline, optional
        Where the object lies by its typed pose; None where there is no object, or nothing is known of the lens.
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
        Grows with every change.
    state : State
    words : str
        What the person is to do, or what the session does.
    turn : int
        To be named with an action.
    offers : tuple of Offer
        Actions that are possible.
    wanted : Action or None
        What is done as soon as the photograph under way is stored.
    done, total : int
        Photographs in the table and in the plan.
    left_s : float
        Estimated time that is left, s.
    note : str
        What else is to be said, such as why a test exposure failed.
    shown : Shown or None
        The newest photograph.
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
    """Questions of a session, which waits for their answers; actions come from any thread.

    Parameters
    ----------
    deadline_s : float, optional
        Longest wait for a person, s.
    watched : bool
        Whether a page shows it.
    halt : callable
        Stops a session that is at work, at once. Without it the session stops before the next photograph.
    """

    deadline_s: float | None = None
    watched: bool = False
    halt: Callable[[], None] = lambda: None
    #: Takes a test exposure and shows it; None where no camera is at hand.
    on_test: Callable[[], None] | None = None
    _terminal: Terminal = field(default_factory=Terminal)
    _view: SessionView = field(default_factory=SessionView)
    _answer: tuple[Action, str] | None = None
    #: What the session does while it asks for nothing.
    _work: str = ""
    _last: str = ""
    _retaken: str = ""
    _changed: threading.Condition = field(default_factory=threading.Condition)

    # ---- for those who look on

    @property
    def view(self) -> SessionView:
        """Snapshot of the session as it is now."""
        with self._changed:
            return self._view

    def changed_view(self, version: int, wait_s: float) -> SessionView:
        """Return what there is to be seen, once it is another version than one known, or after a time (s)."""
        with self._changed:
            self._changed.wait_for(lambda: self._view.version != version, wait_s)
            return self._view

    def act(self, action: Action, turn: int | None = None, reason: str = "") -> None:
        """Hand in what the person does.

        Parameters
        ----------
        action : Action
        turn : int, optional
            That of the view which the person has seen; to stop and to pause need none.
        reason : str
            Why a doubtful photograph is kept.

        Raises
        ------
        Refused
            If the session does not take it now; nothing has changed.
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
            # Whatever else comes with words, such as the letter that was typed, they are no reason.
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
        """Ask the person, and return the reason to keep a photograph; empty for other answers that go on.

        Parameters
        ----------
        state : State
            What is waited for: one with `OFFERS`.
        words : str
            A sentence that begins with a verb, without its full stop.

        Raises
        ------
        OperatorAbort
            If the person stops the session.
        RetakeLast
            If the person wants the newest photograph again.
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
        """Return when the next photograph may be begun: at once, or after the pause that the person wants.

        Raises
        ------
        OperatorAbort, RetakeLast, DeviceError
            As `ask`.
        """
        for line in self._terminal.typed():
            # Enter and other words answer a question that is not asked.
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
        """Say what the session does, how many photographs are in the table, and the time that is left (s)."""
        with self._changed:
            self._work = words
            self._change(done=done, total=total, left_s=left_s)
            self._set(State.WORKING, words)

    def show(self, file: str, finding: str, preview: "Preview", outline: "Outline | None" = None) -> None:
        """Show a photograph; `file` is empty for a test exposure."""
        with self._changed:
            number = self._view.shown.number + 1 if self._view.shown else 1
            self._change(shown=Shown(number, file, finding, preview, outline), note="")
        if not file and self._terminal.is_there:
            self._terminal.show(f"{finding}\n{preview.sketch()}")

    def stored(self, file: str) -> None:
        """Note the name of the newest photograph of the table, which may be taken again."""
        with self._changed:
            self._last = file
            self._set(self._view.state, self._view.words)

    def note(self, words: str) -> None:
        """Say something that asks for nothing."""
        LOGGER.warning("%s", words)
        with self._changed:
            self._change(note=words)

    def end(self, words: str) -> None:
        """Say how the session ended; no action is possible any more."""
        with self._changed:
            self._set(State.ENDED, words)

    # ----

    def _change(self, **changes) -> None:
        self._view = replace(self._view, version=self._view.version + 1, **changes)
        self._changed.notify_all()

    def _set(self, state: State, words: str) -> None:
        """Begin a turn."""
        out = [Action.RETAKE_LAST] if not self._last else []
        out += [Action.TEST] if self.on_test is None else []
        offers = tuple(offer for offer in OFFERS[state] if offer.action not in out)
        self._change(state=state, words=words, turn=self._view.turn + 1, offers=offers)

    def _answered(self, state: State, words: str) -> tuple[Action, str]:
        """Ask once, and return what the person does."""
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
        """Hand in what was typed; return whether it was an answer."""
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
            # The page was quicker, or what was typed is too long.
            self._terminal.show(str(refusal))
            return False
        return True
