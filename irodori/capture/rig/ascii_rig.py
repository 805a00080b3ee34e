"""Rig driver for controllers with a text protocol that the rig's definition describes."""

import contextlib
import re
import time
from collections.abc import Mapping

from irodori.capture.rig.ascii_description import Description
from irodori.capture.rig.controlled_rig import MARGIN, POLL_S, START_S, ControlledRig
from irodori.capture.rig.deadline import Deadline
from irodori.capture.rig.devices import (
    AlarmError,
    CommandError,
    DeadlineError,
    DeviceError,
    GarbledError,
    HeldError,
    Link,
    RigStatus,
)
from irodori.capture.rig.drives import Drive

#: Longest way of homing, as a multiple of the reach, at the speed of the axis.
_HOMING_REACH = 3.0
_STOP_TRIES = 3
#: Number of times that a question is asked before its answer counts as missing.
_QUESTIONS = 3


class AsciiRig(ControlledRig):
    """Rig with a controller that has the text protocol of a `Description`.

    The driver sends one question at a time. It assumes that the controller loses its position without power: a rig with
    limit switches must be homed each time it is opened, and a position that changes between two commands counts as
    lost. For the same reason homing is done twice.

    Parameters
    ----------
    link : Link
        Closed by `close`; if this constructor raises an error, the caller must close it.
    drives : dict
        {angle of a pose: drive}.
    description : Description
    timeout_s : float
        Longest time for a reply, s.
    homing : bool
        Whether the axes have limit switches.

    Raises
    ------
    DeadlineError, LinkError, CommandError
    """

    def __init__(
        self,
        link: Link,
        drives: Mapping[str, Drive],
        description: Description,
        *,
        timeout_s: float = 3.0,
        homing: bool = True,
    ) -> None:
        super().__init__(drives, timeout_s, homing)
        self._link, self._words = link, description
        self._in_step, self._homed = True, not homing
        # Last known positions of the axes, and the targets of the present move, controller units.
        self._last: dict[str, float] = {}
        self._goal: dict[str, float] = {}
        self._last = self._wake()

    def move(self, targets_deg: Mapping[str, float]) -> None:
        """Move axes, each at its own speed, and wait until they have arrived; see `RigDevice.move`."""
        self.check(targets_deg)
        if not targets_deg:
            return
        with self._stopping_on_failure():
            places = self._ready()
            targets = {**places, **{name: self.drives[name].to_units(angle) for name, angle in targets_deg.items()}}
            start = {name: self.drives[name].to_deg(places[name]) for name in places}
            self._goal = targets
            for name in targets_deg:
                self._order_move(self.drives[name], targets[name])
            deadline = Deadline(self.travel_s(start, targets_deg) * (1 + MARGIN) + self._timeout_s)
            self._await_arrival([places, targets], deadline)
            self._last, self._goal = targets, {}

    def status(self) -> RigStatus:
        """Return the state that the controller reports; see `RigDevice.status`."""
        self._get_in_step()
        state, places = self._states(), self._places()
        if state == "alarm" or (state == "idle" and self._strayed(places)):
            self._homed = False
        named = {name: self.drives[name].to_deg(place) for name, place in places.items()}
        return RigStatus(state, named, self._homed)

    def close(self) -> None:
        """Close the connection."""
        self._link.close()

    # ---- steps of the above

    def _wake(self) -> dict[str, float]:
        """Bring a controller from any state to rest, and return the positions of its axes, controller units."""
        # Replies to another program may still be on their way.
        self._settle()
        knocking = Deadline(self._timeout_s)
        while True:
            try:
                if self._states() in ("run", "hold"):
                    self._halt()
                return self._places()
            except GarbledError:
                if knocking.passed:
                    raise
                self._settle()

    def _halt(self) -> None:
        """Stop the axes and wait until they are at rest."""
        for left in reversed(range(_STOP_TRIES)):
            self._link.write(self._words.line("stop"))
            try:
                self._settle()
                still = Deadline(self._brake_s * (1 + MARGIN) + self._timeout_s / _STOP_TRIES)
                while self._states() == "run":
                    if still.passed:
                        raise DeadlineError("the rig does not stop")
                    time.sleep(POLL_S / 3)
                break
            except (DeadlineError, GarbledError, CommandError):
                if not left:
                    raise
        places, self._in_step = self._places(), True
        for name, drive in self.drives.items():
            last = self._last.get(name, places[name])
            ends, slack = (last, self._goal.get(name, last)), self._tolerance(drive)
            if not min(ends) - slack <= places[name] <= max(ends) + slack:
                self._homed = False
        self._last, self._goal = places, {}

    def _settle(self) -> None:
        """Read and discard lines until none arrives."""
        deadline = Deadline(self._timeout_s / _STOP_TRIES)
        with contextlib.suppress(DeadlineError):
            while not deadline.passed:
                with contextlib.suppress(GarbledError):
                    self._link.read_line(2 * POLL_S)

    def _get_in_step(self) -> None:
        if not self._in_step:
            self._halt()

    def _find_switches(self) -> None:
        self._get_in_step()
        # Twice: a controller that loses power on the way counts from 0 at that position, and looks homed.
        for _ in range(2):
            self._home_once()
        self._last = self._places()

    def _home_once(self) -> None:
        for drive in self.drives.values():
            self._order_motion("home", axis=drive.channel)
            if not self._words.per_axis("home"):
                break
        ways = [(high - low) / drive.speed for drive in self.drives.values() for low, high in [drive.reach]]
        deadline = Deadline(_HOMING_REACH * max(ways) + 2 * self._brake_s + self._timeout_s)
        began, seen = Deadline(START_S), False
        while (state := self._look()[0]) != "idle" or not (seen or began.passed):
            if state == "hold":
                raise HeldError("the rig was held while it was homed: clear the cause, then home it again")
            seen = seen or state == "run"
            if deadline.passed:
                raise DeadlineError(f"the switches were not found within {deadline.seconds:.3g} s")
            time.sleep(POLL_S)

    def _send_resume(self) -> None:
        self._order("resume")

    def _check_resume(self) -> None:
        if "resume" not in self._words.commands:
            raise CommandError(
                "the rig's file has no motion.ascii.resume: end a feed hold of this controller with its own buttons"
            )

    def _astray(self, what: str) -> DeviceError:
        return AlarmError(f"{what}: do not trust its position, home it")

    def _look(self) -> tuple[str, dict[str, float]]:
        state, places = self._states(), self._places()
        if state == "alarm":
            raise AlarmError("the controller is in alarm: it stopped on its own; find the cause, then home it")
        return state, places

    def _check_places(self, places: Mapping[str, float]) -> None:
        if name := self._strayed(places):
            now, before = (self.drives[name].to_deg(at[name]) for at in (places, self._last))
            raise AlarmError(
                f"{name} is at {now:.6g} degrees and was left at {before:.6g}: "
                "its controller has restarted or was moved by hand; home it first"
            )

    def _strayed(self, places: Mapping[str, float]) -> str:
        """Return the name of an axis that is not at its last known position, empty if there is none."""
        for name, drive in self.drives.items():
            if abs(places[name] - self._last[name]) > self._tolerance(drive):
                return name
        return ""

    def _tolerance(self, drive: Drive) -> float:
        """Return the largest accepted distance of an axis from its target at rest: half of its smallest step."""
        return 0.5 * drive.axis.step_deg * abs(drive.units_per_deg)

    def _order_move(self, drive: Drive, target: float) -> None:
        """Order an axis to a target, controller units; if the controller refuses it in a feed hold, after the hold."""
        while True:
            try:
                self._order_motion("move", axis=drive.channel, target=target)
                return
            except CommandError:
                # The axes that were ordered before this one may still be slowing down.
                slowing = Deadline(self._brake_s * (1 + MARGIN) + self._timeout_s)
                while (found := self._look())[0] == "run" and not slowing.passed:
                    time.sleep(POLL_S)
                if found[0] != "hold":
                    raise
                self._go_on(found[1])

    def _order_motion(self, command: str, **values) -> None:
        """Send a command that moves; send it again if it or its answer was lost, which leads to the same position."""
        try:
            self._order(command, **values)
        except DeadlineError:
            if self._look()[0] == "idle":
                self._order(command, **values)

    def _order(self, command: str, **values) -> None:
        """Send a command and wait until it is accepted."""
        try:
            self._words.match("accepted", self._ask(command, **values))
        except CommandError as refusal:
            if self._states() == "alarm":
                raise AlarmError(f"{refusal}; it is in alarm: find the cause, then home it") from None
            raise

    def _inquire(self, question: str, drive: Drive) -> re.Match:
        """Return the answer to a question for an axis; the question is repeated if it is lost or garbled."""
        asked = 0
        while True:
            asked += 1
            try:
                line = self._ask(question, self._timeout_s / _QUESTIONS, axis=drive.channel)
                answer = self._words.match(question, line)
                if answer.groupdict().get("axis", drive.channel) != drive.channel:
                    raise GarbledError(f"the controller sent {line!r} when asked for its axis {drive.channel}")
            except (DeadlineError, GarbledError):
                if asked == _QUESTIONS:
                    raise
                continue
            # Late answers to the earlier questions must not be taken for answers to the next one.
            with contextlib.suppress(DeadlineError, GarbledError):
                for _ in range(asked - 1):
                    self._link.read_line(self._timeout_s / _QUESTIONS)
            return answer

    def _ask(self, command: str, timeout_s: float | None = None, **values) -> str:
        """Send a command and return its reply, waiting for at most ``timeout_s`` (by default the rig's), s.

        Raises
        ------
        CommandError
            If the command is refused.
        """
        # A late reply to the question before must not be taken for the reply to this one.
        self._link.discard_input()
        self._link.write(self._words.line(command, **values))
        deadline = Deadline(self._timeout_s if timeout_s is None else timeout_s)
        while not (line := self._link.read_line(deadline.remaining_s).strip()):
            if deadline.passed:
                raise DeadlineError(f"the controller sent nothing but empty lines for {deadline.seconds:.2g} s")
        refused = self._words.replies.get("refused")
        if refused and (found := refused.fullmatch(line)):
            said = found.groupdict().get("message") or line
            raise CommandError(f"the controller refused {self._words.commands[command]!r}: {said}")
        return line

    def _states(self) -> str:
        """Return the state of all axes: the first of ``alarm``, ``run``, ``hold``, ``idle`` that any axis has."""
        found = set()
        for drive in self.drives.values():
            found.add(self._words.state(self._inquire("status", drive)["state"]))
            if not self._words.per_axis("status"):
                break
        return next(state for state in ("alarm", "run", "hold", "idle") if state in found)

    def _places(self) -> dict[str, float]:
        """Return the positions of the axes, controller units."""
        places = {}
        for name, drive in self.drives.items():
            found = self._inquire("position", drive)
            try:
                places[name] = float(found["position"])
            except ValueError:
                raise GarbledError(f"the controller sent {found[0]!r}, in which the position is not a number") from None
        return places
