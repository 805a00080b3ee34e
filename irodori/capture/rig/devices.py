"""Interfaces of rigs and cameras, and the errors that they raise.

A device *has* a `Link`; it is handed over from outside, so that a driver cannot tell a controller on a cable from a
simulator on a pseudo-terminal. Every wait has a deadline; a target out of reach raises before anything moves.
Angles are in degrees, times in seconds. Axes bear the names of a pose's angles (`irodori.config.capture_table.Pose`).
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from irodori.core.errors import PlainError

if TYPE_CHECKING:
    from irodori.capture.rig.drives import Drive
    from irodori.config.capture_table import Shot
    from irodori.simulation.controllers.peer_client import Simulator

ANGLE_TOLERANCE_DEG = 1e-6
#: What a camera's status says where the camera does not tell.
NOT_REPORTED = "not reported"


class DeviceError(PlainError):
    """A device at fault; the message is one sentence for the person at the bench."""


class LimitError(DeviceError):
    """A target out of reach; nothing has moved."""


class LinkError(DeviceError):
    """The line to a device is lost, garbled, or in use by another process."""


class GarbledError(LinkError):
    """A line arrived that the device does not send: the line is up, but bytes were lost or changed on it."""


class DeadlineError(DeviceError):
    """A device did not answer, or did not arrive, in the time that the request may take."""


class AlarmError(DeviceError):
    """A controller stopped on its own and may have lost its position: home it before anything else."""


class CommandError(DeviceError):
    """A controller refused a command; it stands where it stood."""


class HeldError(DeviceError):
    """A rig in feed hold, and nobody who could say that it may go on; it stands, and forgets its move."""


class SettingError(DeviceError):
    """A controller's own settings contradict the rig's file; nothing has moved."""


@dataclass(frozen=True)
class Axis:
    """One motorised axis.

    Parameters
    ----------
    name : str
        An angle of a pose, such as ``camera_deg``.
    min_deg, max_deg, step_deg : float
        Reach; steps count from `min_deg`.
    speed_deg_per_s, acceleration_deg_per_s2 : float
        What the axis does at most, for deadlines and time estimates.
    """

    name: str
    min_deg: float
    max_deg: float
    step_deg: float
    speed_deg_per_s: float
    acceleration_deg_per_s2: float

    def check(self, target_deg: float) -> None:
        """Refuse a target that is not a finite angle within the limits.

        Raises
        ------
        LimitError
        """
        low, high = self.min_deg - ANGLE_TOLERANCE_DEG, self.max_deg + ANGLE_TOLERANCE_DEG
        if not (math.isfinite(target_deg) and low <= target_deg <= high):
            raise LimitError(
                f"{self.name} {target_deg:g}: out of reach; accepted: {self.min_deg:g} to {self.max_deg:g}"
            )

    def travel_s(self, from_deg: float, to_deg: float) -> float:
        """Return the time of a move with a trapezoidal profile of speed, s."""
        distance = abs(to_deg - from_deg)
        ramp = self.speed_deg_per_s / self.acceleration_deg_per_s2
        if distance >= self.speed_deg_per_s * ramp:
            return distance / self.speed_deg_per_s + ramp
        return 2.0 * math.sqrt(distance / self.acceleration_deg_per_s2)


@dataclass(frozen=True)
class RigStatus:
    """State of a rig, as its controller reports it.

    Parameters
    ----------
    state : str
        ``idle``, ``run``, ``hold``, ``home``, ``jog``, ``door``, ``check``, ``sleep`` or ``alarm``.
    position_deg : dict
        Angle of each axis, degrees.
    homed : bool
        Whether the position is trustworthy.
    message : str
        The controller's own words, empty where it has none.
    """

    state: str
    position_deg: dict[str, float]
    homed: bool
    message: str = ""


class Link(ABC):
    """A line to a device: bytes out, lines in."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send bytes. Raises `LinkError` where the line is lost, `DeadlineError` where it does not take them."""

    @abstractmethod
    def read_line(self, timeout_s: float) -> str:
        """Return the next line without its end. Raises `DeadlineError` after the time, `LinkError` where lost."""

    @abstractmethod
    def discard_input(self) -> None:
        """Forget what has arrived and was not read."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the line and its lock; harmless when repeated."""


class RigDevice(ABC):
    """Mechanics that move camera and table. A context manager: it stops on an exception and closes its connection."""

    #: Motorised axes by name; the others of a pose are set by hand.
    axes: Mapping[str, Axis]
    #: How each of them is driven.
    drives: "Mapping[str, Drive]"
    #: Handle on the simulated controller, None for a real one; see `irodori.capture.rig.connect`.
    simulator: "Simulator | None" = None
    #: Asked, with a sentence, when a move meets a feed hold: returns once the rig may go on, raises where it may not.
    #: Where it is None, a hold ends the move with `HeldError`.
    on_hold: Callable[[str], None] | None = None

    @abstractmethod
    def home(self) -> None:
        """Find the reference position of every axis. Blocks."""

    def recount(self) -> dict[str, float]:
        """Hold the controller's count against the limit switches, and home. Blocks.

        Returns
        -------
        dict
            Axis: how far it stood above the angle that the controller counted, degrees; what its motor lost in steps.

        Raises
        ------
        CommandError
            Where `cannot_recount` says why.
        HeldError, AlarmError, LinkError, DeadlineError
            A stop was sent.
        """
        raise CommandError(self.cannot_recount)

    @property
    def cannot_recount(self) -> str:
        """Reason why the count cannot be held against limit switches, in words; empty where it can."""
        return "its controller does not tell where a limit switch closes"

    @abstractmethod
    def move(self, targets_deg: Mapping[str, float]) -> None:
        """Move axes and wait until they stand there.

        Every target is checked before anything moves; the wait ends at a deadline derived from distance and speed.
        A feed hold (somebody presses it at the bench) asks `on_hold`; then the rig goes on, and the deadline starts
        anew.

        Raises
        ------
        LimitError, CommandError, HeldError, AlarmError, LinkError, DeadlineError
            After the last four, and after KeyboardInterrupt, a stop was sent. What was sent over a lost line does not
            arrive: there the axes end the move that they were in, whose target was checked, and stand.
        """

    @abstractmethod
    def resume(self) -> None:
        """End a feed hold (the state ``hold``), and wait until the rig is idle; `move` does so on its own.

        The wait ends at a deadline, the time of the whole reach. Opening a rig ends a hold too, but gives up the move.

        Raises
        ------
        CommandError
            In every other state, an alarm aside, and where the controller has no command for it.
        HeldError, AlarmError, LinkError, DeadlineError
            A stop was sent.
        """

    def jog(self, name: str, by_deg: float) -> None:
        """Move one axis by an angle from where it stands, degrees; see `move`."""
        self.check({name: self.axes[name].min_deg} if name in self.axes else {name: by_deg})
        self.move({name: self.position()[name] + by_deg})

    @abstractmethod
    def status(self) -> RigStatus:
        """Return the state that the rig reports now.

        Raises
        ------
        LinkError, DeadlineError
            An alarm is a state, not an error.
        """

    @abstractmethod
    def stop(self) -> None:
        """Stop all motion at once; never raises for a line that is already lost."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the line; harmless when repeated."""

    def position(self) -> dict[str, float]:
        """Return the angle of each axis, degrees."""
        return self.status().position_deg

    def check(self, targets_deg: Mapping[str, float]) -> None:
        """Refuse targets out of reach and axes that the rig does not drive.

        Raises
        ------
        LimitError
        """
        for name, target in targets_deg.items():
            if name not in self.axes:
                raise LimitError(
                    f"{name}: not a motorised axis of this rig; accepted: {', '.join(self.axes) or 'none'}"
                )
            self.axes[name].check(target)

    def travel_s(self, from_deg: Mapping[str, float], to_deg: Mapping[str, float]) -> float:
        """Return the time of a move whose axes run side by side, s; in a straight line it takes somewhat longer."""
        return max((self.axes[name].travel_s(from_deg[name], to_deg[name]) for name in to_deg), default=0.0)

    def __enter__(self) -> "RigDevice":
        return self

    def __exit__(self, kind, error, trace) -> None:
        try:
            if kind is not None:
                self.stop()
        finally:
            self.close()


class CameraDevice(ABC):
    """Camera: a context manager that closes its connection."""

    #: End of the names of its RAW files, with the dot.
    suffix: str
    #: Whether its photographs are computed, at no time of any day.
    is_virtual = False

    @abstractmethod
    def capture(self, shot: "Shot", path: Path) -> None:
        """Take one photograph and store the RAW file at `path`, whole.

        Parameters
        ----------
        shot : Shot
            Its ``exposure_s`` is what a real camera is told; a virtual one also sees what stands before it.
        path : Path

        Raises
        ------
        DeviceError
            If the camera refuses, is busy beyond the deadline, or cannot be set to what the shot wants.
        """

    def prepare(self, shots: Sequence["Shot"]) -> None:  # noqa: B027, a camera that takes everything checks nothing
        """Refuse shots that the camera will not take as it stands, before anything moves.

        Raises
        ------
        DeviceError
            With everything that is in the way.
        """

    @abstractmethod
    def status(self) -> dict[str, str]:
        """Return the state that the camera reports: model, battery, storage, settings."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the camera; harmless when repeated."""

    def __enter__(self) -> "CameraDevice":
        return self

    def __exit__(self, kind, error, trace) -> None:
        self.close()
