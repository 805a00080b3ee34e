"""True state of the virtual rig, which the virtual camera photographs: angles, filter and subject."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from irodori.config.capture_table import Pose


@dataclass
class Bench:
    """True state of the virtual rig, which a person and motors change and the virtual camera photographs.

    Parameters
    ----------
    motors_deg : callable
        Returns the true angle of each motorised axis, degrees.
    by_hand_deg : dict
        Angles of the axes that are set by hand, degrees.
    filter : str
        State of the comb filter, ``out`` or ``in``.
    subject : str
        Subject in front of the lens, see `irodori.config.capture_table.Shot.subject`; ``dark`` is a covered lens.
    placement : int
        Placement in which the object lies.
    """

    motors_deg: Callable[[], Mapping[str, float]] = dict
    by_hand_deg: dict[str, float] = field(default_factory=dict)
    filter: str = "out"
    subject: str = "object"
    placement: int = 1

    def set(self, settings: Mapping[str, float | str]) -> None:
        """Change what is set by hand: ``subject``, ``filter``, ``placement``, or an angle without motor, degrees."""
        self.subject = str(settings.get("subject", self.subject))
        self.filter = str(settings.get("filter", self.filter))
        self.placement = int(settings.get("placement", self.placement))
        others = ("subject", "filter", "placement")
        self.by_hand_deg |= {k: float(angle) for k, angle in settings.items() if k not in others}

    def pose(self) -> Pose:
        """Return the angles of light, camera and table, and the placement; an axis never moved stands at 0."""
        angles = {"light_deg": 0.0, "camera_deg": 0.0, **self.by_hand_deg, **self.motors_deg()}
        return Pose(**angles, placement=self.placement)
