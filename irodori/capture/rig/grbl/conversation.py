"""Request and response with a Grbl controller: matching of replies, unsolicited messages."""

from irodori.capture.rig.deadline import Deadline
from irodori.capture.rig.devices import AlarmError, CommandError, DeadlineError, GarbledError, Link
from irodori.capture.rig.grbl.codes import HARD_LIMIT, alarm_text, error_text
from irodori.capture.rig.grbl.protocol import (
    GRBL,
    LINE_BYTES,
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

#: Silence after which no further message is expected, s.
_QUIET_S = 0.05
#: Most requests for one status report, and the time after which an unanswered request is repeated, s.
_QUESTIONS, _AGAIN_S = 3, 0.5
#: Interval between status requests during homing, s.
_HOMING_POLL_S = 1.0
HOW_TO_CLEAR = "find the cause, then home it"
RESTARTED = "the controller has restarted on its own, and its position is lost: home it before anything else"


class Conversation:
    """Exchange of lines with one controller.

    Parameters
    ----------
    link : Link
    timeout_s : float
        Longest time for a reply, s.

    Attributes
    ----------
    alarm : int or None
        Code of the last alarm that was not cleared.
    locked : bool
        Whether an alarm was received since the last reset: after some alarms, Grbl answers nothing until it is reset.
    restarted : bool
        Whether the controller restarted without a command.
    firmware : str
        Firmware according to the last banner.
    message : str
        Text of the controller's last ``[MSG:...]``.
    """

    def __init__(self, link: Link, timeout_s: float) -> None:
        self.link, self.timeout_s = link, timeout_s
        self.alarm: int | None = None
        self.restarted, self.locked, self.message = False, False, ""
        self.firmware = GRBL

    def receive(self, deadline: Deadline) -> Message:
        """Return the next message, and record the state that it reports.

        Raises
        ------
        DeadlineError, LinkError
        """
        while not (line := self.link.read_line(deadline.remaining_s).strip()):
            if deadline.passed:
                raise DeadlineError(f"the controller sent nothing but empty lines for {deadline.seconds:.2g} s")
        message = parse_line(line)
        if isinstance(message, Alarm):
            self.alarm, self.locked = message.code, True
        elif isinstance(message, Banner):
            self.restarted, self.locked, self.firmware = True, False, message.firmware
        elif isinstance(message, Feedback) and message.kind == "MSG":
            self.message = message.text.strip()
        return message

    def ask_report(self, timeout_s: float | None = None, question: bytes = STATUS) -> Report:
        """Request a status report and return it.

        The request is repeated if it or the report was lost or garbled, or if the controller has just started and lost
        the request.

        Parameters
        ----------
        timeout_s : float, optional
            Longest time for all requests together, s.
        question : bytes
            Byte that requests the report.

        Raises
        ------
        AlarmError
            At once if an alarm is received: the controller may answer nothing more until it is reset.
        CommandError
            If the controller refuses a line that was not sent: transmission has changed one.
        DeadlineError, LinkError
        """
        if self.locked and self.alarm is not None:
            raise self._stopped(self.alarm)
        deadline = Deadline(self.timeout_s if timeout_s is None else timeout_s)
        for asked in range(1, _QUESTIONS + 1):
            last = asked == _QUESTIONS
            self.link.write(question)
            share = Deadline(deadline.remaining_s if last else min(_AGAIN_S, deadline.remaining_s / 2.0))
            try:
                report = self._hear_report(share)
            except GarbledError:
                if last:
                    raise
                continue
            except DeadlineError:
                continue
            if report is not None:
                return report if asked == 1 else self._newest(report)
        raise DeadlineError(f"the controller sent no status report within {deadline.seconds:.2g} s")

    def home(self, timeout_s: float) -> None:
        """Send the command that homes, and wait for its end.

        Grbl sends no reports while it homes; if it reports another state, the command or its ``ok`` was lost, and the
        command is sent again.

        Parameters
        ----------
        timeout_s : float
            Longest time for homing, s.

        Raises
        ------
        AlarmError, CommandError, DeadlineError, LinkError
        """
        for again in (False, True):
            deadline = Deadline(timeout_s)
            self.link.write(b"$H\n")
            while not (ended := self._hear_home(deadline, again)):
                self.link.write(STATUS)
            if ended == "ok":
                # A report that was requested meanwhile arrives at the end of homing.
                self.settle()
                return

    def command(self, line: str, timeout_s: float | None = None) -> list[Message]:
        """Send a line and return the controller's messages before its ``ok``.

        Parameters
        ----------
        line : str
            Line without its end.
        timeout_s : float, optional
            Longest time for the answer, s.

        Raises
        ------
        CommandError
            If the line is refused.
        AlarmError, DeadlineError, LinkError
        """
        if len(line) + 1 > LINE_BYTES:
            raise CommandError(f"{line!r}: longer than the {LINE_BYTES - 1} bytes that the controller takes")
        self.link.write(line.encode("ascii") + b"\n")
        deadline = Deadline(self.timeout_s if timeout_s is None else timeout_s)
        said: list[Message] = []
        while not isinstance(message := self.receive(deadline), Ok):
            self._refuse(line, message)
            said.append(message)
            if deadline.passed:
                raise DeadlineError(f"no answer to {line!r} within {deadline.seconds:.2g} s")
        return said

    def soft_reset(self) -> None:
        """Reset the controller, which discards all lines and moves, and wait for its banner.

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
        self.restarted = self.locked = False
        self.settle()

    def settle(self) -> None:
        """Read and discard messages until none arrives.

        Raises
        ------
        LinkError
            If the connection is lost.
        """
        deadline = Deadline(self.timeout_s)
        again = self.restarted
        while not deadline.passed:
            try:
                self._receive_any(Deadline(_QUIET_S))
            except DeadlineError:
                break
        # A second banner after a reset that was sent twice is not a restart of the controller's own.
        self.restarted = again

    def _hear_report(self, deadline: Deadline) -> Report | None:
        """Return the next report, None if the controller starts first, which loses the request."""
        while True:
            message = self.receive(deadline)
            if isinstance(message, Report):
                return message
            if isinstance(message, Banner):
                return None
            if isinstance(message, Alarm):
                raise self._stopped(message.code)
            if isinstance(message, Error):
                raise CommandError(f"the controller refused a line out of turn: {error_text(message.code)}")
            if deadline.passed:
                raise DeadlineError(f"the controller sent no status report within {deadline.seconds:.2g} s")

    def _newest(self, report: Report) -> Report:
        """Return the last report that arrives, because several requests may have been answered late."""
        while True:
            try:
                message = self.receive(Deadline(_QUIET_S))
            except (DeadlineError, GarbledError):
                return report
            if isinstance(message, Report):
                report = message

    def _hear_home(self, deadline: Deadline, again: bool) -> str:
        """Return ``ok`` if homing has ended, ``lost`` if it has not begun or its end was lost, otherwise nothing."""
        poll = Deadline(min(_HOMING_POLL_S, deadline.remaining_s))
        while True:
            try:
                message = self.receive(poll)
            except (DeadlineError, GarbledError):
                if deadline.passed:
                    raise DeadlineError(f"no end of homing within {deadline.seconds:.3g} s") from None
                return ""
            if isinstance(message, Ok):
                return "ok"
            if isinstance(message, Report) and message.state != "Home":
                if isinstance(self._follows(), Ok):
                    return "ok"
                if again:
                    raise DeadlineError("the controller was told twice to home, and neither does so nor refuses")
                return "lost"
            self._refuse("$H", message)

    def _follows(self) -> Message | None:
        """Return the message that directly follows another, None if there is none."""
        try:
            return self.receive(Deadline(_QUIET_S))
        except (DeadlineError, GarbledError):
            return None

    def _receive_any(self, deadline: Deadline) -> Message | None:
        """Return the next message, None for a garbled line."""
        try:
            return self.receive(deadline)
        except GarbledError:
            return None

    @staticmethod
    def _stopped(code: int) -> AlarmError:
        return AlarmError(f"the controller stopped on its own: {alarm_text(code)}; {HOW_TO_CLEAR}", code == HARD_LIMIT)

    @staticmethod
    def _refuse(line: str, message: Message) -> None:
        """Raise an error if a message means that a line was refused, or that its execution was aborted."""
        if isinstance(message, Error):
            raise CommandError(f"the controller refused {line!r}: {error_text(message.code)}")
        if isinstance(message, Alarm):
            why = f"the controller stopped during {line!r}: {alarm_text(message.code)}; home it"
            raise AlarmError(why, message.code == HARD_LIMIT)
        if isinstance(message, Banner):
            raise AlarmError(RESTARTED)
