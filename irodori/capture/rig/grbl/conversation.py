"""Request and response with a Grbl controller: matching of replies, flow control, unsolicited messages."""

from collections import deque
from collections.abc import Callable, Sequence

from irodori.capture.rig.deadline import Deadline
from irodori.capture.rig.devices import AlarmError, CommandError, DeadlineError, GarbledError, Link
from irodori.capture.rig.grbl.codes import alarm_text, error_text
from irodori.capture.rig.grbl.protocol import (
    LINE_BYTES,
    RX_BUFFER_BYTES,
    SOFT_RESET,
    STATUS,
    Alarm,
    Banner,
    Error,
    Feedback,
    Message,
    Ok,
    Report,
    parse_line,
)

FLOWS = ("send-response", "character-counting")
#: Silence after which nothing more is on its way, s.
_QUIET_S = 0.05
RESTARTED = "the controller has started anew by itself, and its position is lost: home it before anything else"


class Conversation:
    """The lines to and from one controller.

    Parameters
    ----------
    link : Link
    timeout_s : float
        Time that an answer may take, s.
    flow : {"send-response", "character-counting"}
        Whether a line waits for the answer to the one before, or only for room in the controller's serial buffer.

    Attributes
    ----------
    alarm : int or None
        Code of the last alarm that was not cleared.
    restarted : bool
        Whether the controller started anew without being told to.
    message : str
        The controller's last words in ``[MSG:...]``.

    Raises
    ------
    ValueError
        If there is no such flow control.
    """

    def __init__(self, link: Link, timeout_s: float, flow: str) -> None:
        if flow not in FLOWS:
            raise ValueError(f"no flow control {flow!r}; accepted: {', '.join(FLOWS)}")
        self.link, self.timeout_s, self.flow = link, timeout_s, flow
        self.alarm: int | None = None
        self.restarted, self.message = False, ""
        self.buffer_bytes = RX_BUFFER_BYTES

    def receive(self, deadline: Deadline) -> Message:
        """Return the next message; note what it says of the controller.

        Raises
        ------
        DeadlineError, LinkError
        """
        while not (line := self.link.read_line(deadline.remaining_s).strip()):
            if deadline.passed:
                raise DeadlineError(f"the controller sent nothing but empty lines for {deadline.seconds:.2g} s")
        message = parse_line(line)
        if isinstance(message, Alarm):
            self.alarm = message.code
        elif isinstance(message, Banner):
            self.restarted = True
        elif isinstance(message, Feedback) and message.kind == "MSG":
            self.message = message.text
        return message

    def ask_report(self, timeout_s: float | None = None) -> Report:
        """Ask for a status report and return it.

        Raises
        ------
        DeadlineError, LinkError
        CommandError
            If the controller refuses a line that nobody waits for: something on the way has changed one.
        """
        deadline = Deadline(self.timeout_s if timeout_s is None else timeout_s)
        self.link.write(STATUS)
        while True:
            message = self.receive(deadline)
            if isinstance(message, Report):
                return message
            if isinstance(message, Error):
                raise CommandError(f"the controller refused a line out of turn: {error_text(message.code)}")
            if deadline.passed:
                raise DeadlineError(f"the controller sent no status report within {deadline.seconds:.2g} s")

    def command(self, line: str, timeout_s: float | None = None) -> list[Message]:
        """Send a line and return what the controller said until its ``ok``; see `stream`."""
        return self.stream([line], timeout_s)

    def stream(
        self, lines: Sequence[str], timeout_s: float | None = None, idle: Callable[[], None] = lambda: None
    ) -> list[Message]:
        """Send lines under flow control, and return what the controller said until the last ``ok``.

        Parameters
        ----------
        lines : sequence of str
            Without their ends.
        timeout_s : float, optional
            Time that one answer may take, s: lines that move wait for room in the planner.
        idle : callable
            Called after each answer.

        Raises
        ------
        CommandError
            If a line is refused. Those behind it may be in the controller already: stop it.
        AlarmError, DeadlineError, LinkError
        """
        waiting: deque[str] = deque()
        said: list[Message] = []
        for line in lines:
            if len(line) + 1 > LINE_BYTES:
                raise CommandError(f"{line!r}: longer than the {LINE_BYTES - 1} bytes that the controller takes")
            while waiting and not self._fits(waiting, line):
                self._await_answer(waiting, said, timeout_s)
                idle()
            self.link.write(line.encode("ascii") + b"\n")
            waiting.append(line)
        while waiting:
            self._await_answer(waiting, said, timeout_s)
            idle()
        return said

    def soft_reset(self) -> None:
        """Reset the controller, which forgets all lines and moves, and wait until it is back.

        Raises
        ------
        DeadlineError, LinkError
        """
        tries, self.message = 2, ""
        for left in reversed(range(tries)):
            self.link.write(SOFT_RESET)
            deadline = Deadline(self.timeout_s / tries)
            try:
                while not isinstance(self._receive_any(deadline), Banner):
                    if deadline.passed:
                        raise DeadlineError(f"the controller did not come back from a reset in {self.timeout_s:.2g} s")
                break
            except DeadlineError:
                if not left:
                    raise
        self.restarted = False
        self.settle()

    def settle(self) -> None:
        """Read on until nothing comes, whatever it says.

        Raises
        ------
        LinkError
            If the line is lost.
        """
        deadline = Deadline(self.timeout_s)
        again = self.restarted
        while not deadline.passed:
            try:
                self._receive_any(Deadline(_QUIET_S))
            except DeadlineError:
                break
        # A second answer to a reset that was sent twice is no start of the controller's own.
        self.restarted = again

    def _receive_any(self, deadline: Deadline) -> Message | None:
        """Return the next message, None for a garbled line."""
        try:
            return self.receive(deadline)
        except GarbledError:
            return None

    def _fits(self, waiting: deque[str], line: str) -> bool:
        if self.flow == "send-response":
            return False
        return sum(len(other) + 1 for other in (*waiting, line)) <= self.buffer_bytes

    def _await_answer(self, waiting: deque[str], said: list[Message], timeout_s: float | None) -> None:
        deadline = Deadline(self.timeout_s if timeout_s is None else timeout_s)
        while True:
            message = self.receive(deadline)
            if isinstance(message, Ok):
                waiting.popleft()
                return
            if isinstance(message, Error):
                raise CommandError(f"the controller refused {waiting[0]!r}: {error_text(message.code)}")
            if isinstance(message, Alarm):
                raise AlarmError(f"the controller stopped during {waiting[0]!r}: {alarm_text(message.code)}; home it")
            if isinstance(message, Banner):
                raise AlarmError(RESTARTED)
            said.append(message)
            if deadline.passed:
                raise DeadlineError(f"no answer to {waiting[0]!r} within {deadline.seconds:.2g} s")
