"""Base class of rig drivers: waiting, feed hold and stop, independent of the controller's protocol."""

import contextlib
import time
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence

from irodori.capture.rig.deadline import Deadline
from irodori.capture.rig.devices import AlarmError, Axis, CommandError, DeadlineError, DeviceError, HeldError, RigDevice
from irodori.capture.rig.drives import Drive
from irodori.capture.rig.homings import Homings

POLL_S = 0.03
#: Time after the acceptance of a command in which the controller may still report that it is idle, s.
START_S = 0.3
#: Share of its computed time by which a move may take longer.
MARGIN = 0.25


class ControlledRig(RigDevice):
    """Rig with one controller for all axes.

    A feed hold (a pause, usually by the controller's button) that is reported before or during a move is taken for the
    person's: once the axes are at rest, `on_hold` is called, then the controller is told to resume, and the deadline of
    the move starts anew. If nobody can be asked, the move fails. A hold that existed when the rig was opened is
    cancelled like any other motion: the controller discards its move.

    Parameters
    ----------
    drives : dict
        {angle of a pose: drive}.
    timeout_s : float
        Longest time for a reply, s.
    homing : bool
        Whether the axes have limit switches.
    """

    #: Advice for a rig without limit switches that has lost its position.
    _without_switches = "put it where it was switched on and start anew"

    def __init__(self, drives: Mapping[str, Drive], timeout_s: float, homing: bool) -> None:
        self.axes: Mapping[str, Axis] = {name: drive.axis for name, drive in drives.items()}
        self.drives, self._timeout_s, self._homing = dict(drives), timeout_s, homing
        self.homings = Homings()
        self._brake_s = max((d.speed / d.acceleration for d in drives.values()), default=0.0)
        #: Whether the last stop was answered; if not, the next command first stops the rig.
        self._in_step = self._homed = False

    # ---- what a controller's language decides

    @abstractmethod
    def _look(self) -> tuple[str, dict[str, float]]:
        """Return the state, ``idle``, ``run`` or ``hold`` (once the axes are at rest), and positions, controller units.

        Raises
        ------
        AlarmError, CommandError, DeadlineError, LinkError
            In every other state.
        """

    @abstractmethod
    def _halt(self) -> None:
        """Bring the axes to rest and discard all moves. Raises `DeviceError` if the controller does not answer."""

    @abstractmethod
    def _get_in_step(self) -> None:
        """Stop the rig if the last stop was not answered."""

    @abstractmethod
    def _find_switches(self) -> None:
        """Home all axes, and wait until they are at rest at their positions after homing."""

    @abstractmethod
    def _send_resume(self) -> None:
        """Tell the controller to resume after a feed hold, without waiting for it."""

    @abstractmethod
    def _tolerance(self, drive: Drive) -> float:
        """Return the largest accepted distance of a drive from its target at rest, controller units."""

    @abstractmethod
    def _astray(self, what: str) -> DeviceError:
        """Return the error for axes that are off the way of their command."""

    def _check_resume(self) -> None:
        """Raise `CommandError` if the controller has no command to end a hold."""

    def _check_places(self, places: Mapping[str, float]) -> None:
        """Raise `AlarmError` if no move may start from the present positions, controller units."""

    # ---- what every rig does

    def home(self) -> None:
        """Move all axes to their limit switches; see `RigDevice.home`."""
        if not self._homing:
            raise CommandError("this rig has no limit switches (motion.homing is false): it cannot be homed")
        with self._stopping_on_failure():
            self._homed = False
            if not self.cannot_recount:
                self.homings.begin()
            self._find_switches()
            self._homed = True

    def stop(self) -> None:
        """Stop all axes; never raises an error, even if the line is lost."""
        try:
            self._halt()
        except DeviceError:
            # The stop was sent as far as the line permits; the next command first brings the rig to rest.
            self._in_step = False

    def resume(self) -> None:
        """End a feed hold and wait until the axes are at rest; see `RigDevice.resume`."""
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
            # All that is known of the resumed move is that it ends within the reach.
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
        """Stop the rig if the block ends with an exception, also with Ctrl-C."""
        try:
            yield
        except BaseException as error:
            if isinstance(error, AlarmError):
                self._homed = False
            self.stop()
            raise

    def _ready(self) -> dict[str, float]:
        """Wait until the controller accepts a move, and return the positions of the axes, controller units."""
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
        """Wait until the axes are at rest at the last corner of a path; check that they stay within its range."""
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
        """Ask a person to clear the cause of a feed hold, then end the hold."""
        where = ", ".join(f"{name} {self.drives[name].to_deg(place):.4g}" for name, place in places.items())
        self._check_resume()
        if self.on_hold is None:
            raise HeldError(f"the rig is held at {where} and its move is given up: clear the cause and start again")
        self.on_hold(f"Clear the cause of the feed hold: the rig is held at {where}, and moves on when you confirm")
        # The person may as well have ended it with the controller's own buttons.
        if self._look()[0] == "hold":
            self._end_hold()

    def _end_hold(self) -> None:
        """Tell the controller to resume, only once: a second command could end a later hold."""
        self._send_resume()
        deadline = Deadline(self._timeout_s)
        while self._look()[0] == "hold":
            if deadline.passed:
                raise DeadlineError("the rig was told to go on and stays held: is its hold button still pressed?")
            time.sleep(POLL_S)

    def _off_target(self, places: Mapping[str, float], target: Mapping[str, float]) -> str:
        """Return a phrase that names an axis off its target; empty if there is none."""
        for name, drive in self.drives.items():
            if abs(places[name] - target[name]) > self._tolerance(drive):
                return f"{name} at {drive.to_deg(places[name]):.6g} instead of {drive.to_deg(target[name]):.6g} degrees"
        return ""

    def _watch_way(self, places: Mapping[str, float], corners: Sequence[Mapping[str, float]]) -> None:
        for name, drive in self.drives.items():
            slack, ways = self._tolerance(drive), [corner[name] for corner in corners]
            if not min(ways) - slack <= places[name] <= max(ways) + slack:
                raise self._astray(f"{name} is at {drive.to_deg(places[name]):.6g} degrees, off its way")
