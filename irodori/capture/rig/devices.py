"""Interfaces of rigs and cameras, and the errors that they raise.

A device receives its `Link` from the caller, so that its driver cannot distinguish a controller on a cable from a
simulator on a pseudo-terminal. Every wait has a deadline; a target out of reach raises an error before anything moves.
Angles are in degrees, times in seconds. Axes have the names of a pose's angles (`irodori.config.capture_table.Pose`).
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
    from irodori.capture.rig.homings import Homings
    from irodori.config.capture_table import Shot
    from irodori.simulation.controllers.peer_client import Simulator

ANGLE_TOLERANCE_DEG = 1e-6
#: Value in a camera's status for what the camera does not report.
NOT_REPORTED = "not reported"


class DeviceError(PlainError):
    """Error of a device; the message is one sentence for the person at the bench."""


class LimitError(DeviceError):
    """Error for a target out of reach; nothing has moved."""


class LinkError(DeviceError):
    """Error for a connection that is lost, garbled, or in use by another process."""


class GarbledError(LinkError):
    """Error for received text that the device never sends: the connection works, but bytes were lost or changed."""


class DeadlineError(DeviceError):
    """Error for a device that did not answer, or did not reach its target, in time."""


class AlarmError(DeviceError):
    """Error for a controller that stopped by an alarm and may have lost its position: home it before anything else.

    Parameters
    ----------
    message : str
    of_switch : bool
        Whether an axis met its limit switch. Between soft limits it does, as a rule, because it has lost steps.
    """

    def __init__(self, message: str, of_switch: bool = False) -> None:
        super().__init__(message)
        self.of_switch = of_switch


class CommandError(DeviceError):
    """Error for a command that the controller refused; nothing has moved."""


class HeldError(DeviceError):
    """Error for a rig in feed hold when nobody can be asked to resume; it is at rest, and its move is discarded."""


class SettingError(DeviceError):
    """Error for controller settings that contradict the rig's file; nothing has moved."""


@dataclass(frozen=True)
class Axis:
    """Motorised axis.

    Parameters
    ----------
    name : str
        An angle of a pose, such as ``camera_deg``.
    min_deg, max_deg, step_deg : float
        Reach and step; steps count from `min_deg`.
    speed_deg_per_s, acceleration_deg_per_s2 : float
        Largest speed and acceleration, for deadlines and time estimates.
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
        Message of the controller; empty if there is none.
    """

    state: str
    position_deg: dict[str, float]
    homed: bool
    message: str = ""


class Link(ABC):
    """Connection to a device: it sends bytes and receives lines."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send bytes. Raises `LinkError` if the connection is lost, `DeadlineError` if it does not accept them."""

    @abstractmethod
    def read_line(self, timeout_s: float) -> str:
        """Return the next line without its end. Raises `DeadlineError` after the time, `LinkError` if it is lost."""

    @abstractmethod
    def discard_input(self) -> None:
        """Discard received bytes that were not read."""

    @abstractmethod
    def close(self) -> None:
        """Close the connection and release its lock; a second call has no effect."""


class RigDevice(ABC):
    """Motorised rig. As a context manager it stops all motion on an exception and closes its connection at the end."""

    #: Motorised axes by name; the other angles of a pose are set by hand.
    axes: Mapping[str, Axis]
    #: Drive of each axis.
    drives: "Mapping[str, Drive]"
    #: Record of the rig's homings.
    homings: "Homings"
    #: Handle on the simulated controller, None for a real one; see `irodori.capture.rig.connect`.
    simulator: "Simulator | None" = None
    #: Called with a request for the person when a move meets a feed hold: returns once the rig may resume, raises an
    #: error if it may not. If it is None, a hold ends the move with `HeldError`.
    on_hold: Callable[[str], None] | None = None

    @abstractmethod
    def home(self) -> None:
        """Move every axis to its reference position and wait for the end."""

    def recount(self) -> dict[str, float]:
        """Measure lost motor steps by comparing the controller's position with the limit switches, then home.

        Returns
        -------
        dict
            {axis: true angle minus the angle that the controller counted, degrees}.

        Raises
        ------
        CommandError
            If the comparison is not possible; `cannot_recount` is the reason.
        HeldError, AlarmError, LinkError, DeadlineError
            After a stop was sent.
        """
        raise CommandError(self.cannot_recount)

    @property
    def cannot_recount(self) -> str:
        """Reason, as a phrase, why `recount` is not possible; empty if it is."""
        return "its controller does not tell where a limit switch closes"

    @abstractmethod
    def move(self, targets_deg: Mapping[str, float]) -> None:
        """Move axes to angles, degrees, and wait until they are at rest there.

        Every target is checked before anything moves; the wait ends at a deadline derived from distance and speed.
        On a feed hold (a button at the rig) `on_hold` is called; then the rig resumes, and the deadline starts anew.

        Raises
        ------
        LimitError, CommandError, HeldError, AlarmError, LinkError, DeadlineError
            Before the last four, and before a KeyboardInterrupt, a stop was sent. If the connection is lost, the stop
            does not arrive: the axes then finish their present move, to a target that was checked.
        """

    @abstractmethod
    def resume(self) -> None:
        """End a feed hold (the state ``hold``), and wait until the rig is idle; `move` does this itself.

        The wait ends at a deadline, the time of a move over the whole reach. Opening a rig ends a hold too, but
        discards its move.

        Raises
        ------
        CommandError
            In every other state except an alarm, and if the controller has no command for it.
        HeldError, AlarmError, LinkError, DeadlineError
            After a stop was sent.
        """

    def jog(self, name: str, by_deg: float) -> None:
        """Move one axis by an angle relative to its present position, degrees; see `move`."""
        self.check({name: self.axes[name].min_deg} if name in self.axes else {name: by_deg})
        self.move({name: self.position()[name] + by_deg})

    @abstractmethod
    def status(self) -> RigStatus:
        """Return the state that the rig reports now; an alarm is a state and raises no error.

        Raises
        ------
        LinkError, DeadlineError
        """

    @abstractmethod
    def stop(self) -> None:
        """Stop all motion at once; raises no error if the connection is already lost."""

    @abstractmethod
    def close(self) -> None:
        """Close the connection; a second call has no effect."""

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
        """Return the time of a move with independent axes, s; a straight line takes somewhat longer."""
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

    #: Suffix of the names of its RAW files, with the dot.
    suffix: str
    #: Whether its photographs are computed, so that they have no time of day.
    is_virtual = False

    @abstractmethod
    def capture(self, shot: "Shot", path: Path) -> None:
        """Take one photograph and store the complete RAW file at `path`.

        Parameters
        ----------
        shot : Shot
            Settings of the photograph; a virtual camera also uses its subject and pose.
        path : Path

        Raises
        ------
        DeviceError
            If the camera refuses, is busy beyond the deadline, or cannot be set as the shot requires.
        """

    def prepare(self, shots: Sequence["Shot"]) -> None:  # noqa: B027, a camera that takes everything checks nothing
        """Raise an error for shots that the camera cannot take in its present state, before anything moves.

        Raises
        ------
        DeviceError
            The message lists all obstacles.
        """

    @abstractmethod
    def status(self) -> dict[str, str]:
        """Return the state that the camera reports: model, battery, storage, settings."""

    @abstractmethod
    def close(self) -> None:
        """Close the connection to the camera; a second call has no effect."""

    def __enter__(self) -> "CameraDevice":
        return self

    def __exit__(self, kind, error, trace) -> None:
        self.close()
