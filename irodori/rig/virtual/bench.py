"""The virtual rig as the camera sees it: what stands where, and an in-process rig that is there at once."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from irodori.captures import Pose
from irodori.rig.devices import Axis, LimitError, Rig, RigStatus


@dataclass
class Bench:
    """What stands on the virtual rig and where; hands and motors change it, the camera sees it.

    Parameters
    ----------
    motors_deg : callable
        Returns the true angle of each motorised axis, degrees.
    by_hand_deg : dict
        Angle of the axes that a hand sets, degrees.
    filter : str
        State of the comb filter, ``out`` or ``in``.
    subject : str
        What stands before the lens, a role of `irodori.captures.ROLES`; ``dark`` is the cap on the lens.
    """

    motors_deg: Callable[[], Mapping[str, float]] = dict
    by_hand_deg: dict[str, float] = field(default_factory=dict)
    filter: str = "out"
    subject: str = "object"

    def pose(self) -> Pose:
        """Return where light, camera and table stand; what nobody has moved stands at 0."""
        angles = {"light_deg": 0.0, "camera_deg": 0.0, **self.by_hand_deg, **self.motors_deg()}
        return Pose(**angles)


class VirtualRig(Rig):
    """A rig in the same process: it moves in no time, and is otherwise a peer of the real drivers.

    Parameters
    ----------
    axes : mapping of str to Axis
    """

    def __init__(self, axes: Mapping[str, Axis]) -> None:
        self.axes = dict(axes)
        self._position = {name: min(max(0.0, axis.min_deg), axis.max_deg) for name, axis in self.axes.items()}
        self._closed = False

    def home(self) -> None:
        """Go to the angle nearest to 0 that each axis reaches."""
        self.move({name: min(max(0.0, axis.min_deg), axis.max_deg) for name, axis in self.axes.items()})

    def move(self, targets_deg: Mapping[str, float]) -> None:
        """Stand at the targets."""
        if self._closed:
            raise LimitError("the virtual rig is closed; accepted: an open rig")
        self.check(targets_deg)
        self._position.update({name: float(angle) for name, angle in targets_deg.items()})

    def status(self) -> RigStatus:
        """Return an idle rig's status."""
        return RigStatus("idle", dict(self._position), homed=True)

    def stop(self) -> None:
        """Do nothing: the rig never is in motion."""

    def close(self) -> None:
        """Refuse further moves."""
        self._closed = True
