"""Geometry of the virtual rig as the camera sees it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from irodori.config.capture_table import Pose


@dataclass
class Bench:
    """State of the virtual rig: hands and motors change it, the camera sees it.

    Parameters
    ----------
    motors_deg : callable
        Returns the true angle of each motorised axis, degrees.
    by_hand_deg : dict
        Angle of the axes that a hand sets, degrees.
    filter : str
        State of the comb filter, ``out`` or ``in``.
    subject : str
        What stands before the lens, see `irodori.config.capture_table.Shot.subject`; ``dark`` is the cap on the lens.
    """

    motors_deg: Callable[[], Mapping[str, float]] = dict
    by_hand_deg: dict[str, float] = field(default_factory=dict)
    filter: str = "out"
    subject: str = "object"

    def set(self, settings: Mapping[str, float | str]) -> None:
        """Set what a hand sets: ``subject``, ``filter``, or the angle of an axis without motor, degrees."""
        self.subject = str(settings.get("subject", self.subject))
        self.filter = str(settings.get("filter", self.filter))
        self.by_hand_deg |= {k: float(angle) for k, angle in settings.items() if k not in ("subject", "filter")}

    def pose(self) -> Pose:
        """Return where light, camera and table stand; what nobody has moved stands at 0."""
        angles = {"light_deg": 0.0, "camera_deg": 0.0, **self.by_hand_deg, **self.motors_deg()}
        return Pose(**angles)
