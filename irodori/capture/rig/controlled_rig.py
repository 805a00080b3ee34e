"""Base class of rig drivers: waiting, feed hold and stop, independent of the controller's protocol."""

import contextlib
import time
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence

from irodori.capture.rig.deadline import Deadline
from irodori.capture.rig.devices import AlarmError, Axis, CommandError, DeadlineError, DeviceError, HeldError, RigDevice
from irodori.capture.rig.drives import Drive

POLL_S = 0.03
#: A moment after a command was accepted the controller may still say that it is idle, s.
START_S = 0.3
#: Part of its computed time that a move may take longer.
MARGIN = 0.25


class ControlledRig(RigDevice):
    """A rig whose axes one controller moves.

    A feed hold that is reported while a move waits, or before one begins, is the person's: `on_hold` is asked once the
    axes stand, then the controller is told to go on and the deadline of the move starts anew. Where nobody can be
    asked the move is given up. A hold that was there when the rig was opened is ended like any other motion: the
    controller forgets what it was doing.

    Parameters
    ----------
    drives : dict
        Angle of a pose: drive.
    timeout_s : float
        Time that an answer may take, s.
    homing : bool
        Whether the axes have limit switches.
    """

    #: What helps a rig without limit switches that does not know where it stands.
    _without_switches = "put it where it was switched on and start anew"

    def __init__(self, drives: Mapping[str, Drive], timeout_s: float, homing: bool) -> None:
        self.axes: Mapping[str, Axis] = {name: drive.axis for name, drive in drives.items()}
        self.drives, self._timeout_s, self._homing = dict(drives), timeout_s, homing
        self._brake_s = max((d.speed / d.acceleration for d in drives.values()), default=0.0)
        #: Whether the last stop was answered; where not, the rig is stopped before anything else.
        self._in_step = self._homed = False

    # ---- what a controller's language decides

    @abstractmethod
    def _look(self) -> tuple[str, dict[str, float]]:
        """Return ``idle``, ``run`` or ``hold`` (once the axes stand), and where they stand, controller units.

        Raises
        ------
        AlarmError, CommandError, DeadlineError, LinkError
            In every other state.
        """

    @abstractmethod
    def _halt(self) -> None:
        """Bring the axes to rest; the controller then holds no move. Raises `DeviceError` where it does not answer."""

    @abstractmethod
    def _get_in_step(self) -> None:
        """Stop the rig where the last stop was not answered."""

    @abstractmethod
    def _find_switches(self) -> None:
        """Home all axes, and wait until they stand where homing ends."""

    @abstractmethod
    def _send_resume(self) -> None:
        """Tell the controller to go on after a feed hold, without waiting for what it does."""

    @abstractmethod
    def _tolerance(self, drive: Drive) -> float:
        """Return how far from a target a drive may come to rest, units."""

    @abstractmethod
    def _astray(self, what: str) -> DeviceError:
        """Return the error for axes that are where no command sends them."""

    def _check_resume(self) -> None:
        """Refuse to end a hold where the controller has no command for it. Raises `CommandError`."""

    def _check_places(self, places: Mapping[str, float]) -> None:
        """Refuse to move from where the axes stand, controller units. Raises `AlarmError`."""

    # ---- what every rig does

    def home(self) -> None:
        """Find the limit switches; see `RigDevice.home`."""
        if not self._homing:
            raise CommandError("this rig has no limit switches (motion.homing is false): it cannot be homed")
        with self._stopping_on_failure():
            self._homed = False
            self._find_switches()
            self._homed = True

    def stop(self) -> None:
        """Stop all axes; never raises for a line that is lost."""
        try:
            self._halt()
        except DeviceError:
            # What stops it is sent, as far as the line takes it; the next command brings it to rest first.
            self._in_step = False

    def resume(self) -> None:
        """End a feed hold and wait until the axes stand; see `RigDevice.resume`."""
        self._get_in_step()
        self._check_resume()
        slowing = Deadline(self._brake_s * (1 + MARGIN) + self._timeout_s)
        while (state := self._look()[0]) == "run" and not slowing.passed:
            time.sleep(POLL_S)
        if state != "hold":
            raise CommandError(f"the rig is not held but says {state}: there is no feed hold to end")
        reach = {n: d.axis.min_deg for n, d in self.drives.items()}, {n: d.axis.max_deg for n, d in self.drives.items()}
        with self._stopping_on_failure():
            self._end_hold()
            # Of what was under way nothing is known but that it ends within the reach.
            deadline = Deadline(self.travel_s(*reach) * (1 + MARGIN) + self._timeout_s)
            while (state := self._look()[0]) != "idle":
                if state == "hold":
                    raise HeldError("the rig is held again: clear the cause and start again")
                if deadline.passed:
                    raise DeadlineError(f"no rest within {deadline.seconds:.3g} s after a feed hold")
                time.sleep(POLL_S)

    # ---- steps of moves

    @contextlib.contextmanager
    def _stopping_on_failure(self) -> Iterator[None]:
        """Stop the rig whatever ends the block before its time, Ctrl-C included."""
        try:
            yield
        except BaseException as error:
            if isinstance(error, AlarmError):
                self._homed = False
            self.stop()
            raise

    def _ready(self) -> dict[str, float]:
        """Return where the axes stand, controller units, once the controller takes a move."""
        self._get_in_step()
        state, places = self._look()
        if state == "hold":
            self._go_on(places)
            state, places = self._look()
        if state != "idle":
            raise CommandError(
                f"the controller is not idle but says {state}: another program or its buttons hold or move it"
            )
        self._check_places(places)
        if not self._homed:
            how = "home it first" if self._homing else self._without_switches
            raise AlarmError(f"the rig does not know where it stands: {how}")
        return places

    def _await_arrival(self, corners: Sequence[Mapping[str, float]], deadline: Deadline) -> None:
        """Wait until the axes stand at the last of the corners; watch that they stay between them all on the way."""
        began = Deadline(START_S)
        while True:
            state, places = self._look()
            self._watch_way(places, corners)
            off = self._off_target(places, corners[-1])
            if state == "idle" and not off:
                return
            if state == "hold":
                self._go_on(places)
                began, deadline = Deadline(START_S), Deadline(deadline.seconds)
                continue
            if state != "idle":
                began = Deadline(START_S)
            elif began.passed:
                raise self._astray(f"the rig came to rest elsewhere: {off}")
            if deadline.passed:
                where = off or "all axes at their targets"
                raise DeadlineError(f"no arrival within {deadline.seconds:.3g} s: the rig says {state}, {where}")
            time.sleep(POLL_S)

    def _go_on(self, places: Mapping[str, float]) -> None:
        """Have a person clear the cause of a feed hold, then end it."""
        where = ", ".join(f"{name} {self.drives[name].to_deg(place):.4g}" for name, place in places.items())
        self._check_resume()
        if self.on_hold is None:
            raise HeldError(f"the rig is held at {where} and its move is given up: clear the cause and start again")
        self.on_hold(f"Clear the cause of the feed hold: the rig is held at {where}, and moves on when you confirm")
        # The person may as well have ended it with the controller's own buttons.
        if self._look()[0] == "hold":
            self._end_hold()

    def _end_hold(self) -> None:
        """Tell the controller to go on, once: told again it could end a hold that was pressed since."""
        self._send_resume()
        deadline = Deadline(self._timeout_s)
        while self._look()[0] == "hold":
            if deadline.passed:
                raise DeadlineError("the rig was told to go on and stays held: is its hold button still pressed?")
            time.sleep(POLL_S)

    def _off_target(self, places: Mapping[str, float], target: Mapping[str, float]) -> str:
        """Return in words which axis is off its target, empty where none is."""
        for name, drive in self.drives.items():
            if abs(places[name] - target[name]) > self._tolerance(drive):
                return f"{name} at {drive.to_deg(places[name]):.6g} instead of {drive.to_deg(target[name]):.6g} degrees"
        return ""

    def _watch_way(self, places: Mapping[str, float], corners: Sequence[Mapping[str, float]]) -> None:
        for name, drive in self.drives.items():
            slack, ways = self._tolerance(drive), [corner[name] for corner in corners]
            if not min(ways) - slack <= places[name] <= max(ways) + slack:
                raise self._astray(f"{name} is at {drive.to_deg(places[name]):.6g} degrees, off its way")
