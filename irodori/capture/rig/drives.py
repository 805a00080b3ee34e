"""Conversion of axis angles to controller channels and units, for straight moves of several axes."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from irodori.capture.rig.devices import Axis

if TYPE_CHECKING:
    from irodori.config.models import Rig


@dataclass(frozen=True)
class Drive:
    """Axis with the controller channel that drives it.

    Parameters
    ----------
    axis : Axis
    channel : str
        Letter or name of the axis in the controller's commands.
    units_per_deg : float
        Controller units per degree; negative if they count in the opposite direction.
    zero_deg : float
        Angle at the controller's position 0, degrees.
    """

    axis: Axis
    channel: str
    units_per_deg: float
    zero_deg: float = 0.0

    def to_units(self, angle_deg: float) -> float:
        """Return the controller's position for an angle in degrees."""
        return (angle_deg - self.zero_deg) * self.units_per_deg

    def to_deg(self, position: float) -> float:
        """Return the angle in degrees for a controller's position."""
        return self.zero_deg + position / self.units_per_deg

    @property
    def speed(self) -> float:
        """Largest speed, units/s."""
        return self.axis.speed_deg_per_s * abs(self.units_per_deg)

    @property
    def acceleration(self) -> float:
        """Largest acceleration, units/s^2."""
        return self.axis.acceleration_deg_per_s2 * abs(self.units_per_deg)

    @property
    def reach(self) -> tuple[float, float]:
        """Smallest and largest position, units."""
        ends = self.to_units(self.axis.min_deg), self.to_units(self.axis.max_deg)
        return min(ends), max(ends)


def drives_of(rig: "Rig") -> dict[str, Drive]:
    """Return the drives of a rig's definition by the name of their angle.

    Parameters
    ----------
    rig : Rig
        Definition; without the block ``motion`` there are no drives.
    """
    drives = {}
    axes = vars(rig.motion.axes) if rig.motion else {}
    for name, given in axes.items():
        if given is None:
            continue
        limit = getattr(rig.limits, name)
        rates = given.speed_deg_per_s, given.acceleration_deg_per_s2
        axis = Axis(name, limit.min, limit.max, limit.step, *rates)
        drives[name] = Drive(axis, given.channel, given.units_per_deg, given.zero_deg)
    return drives


def along(move: list[float], speeds: list[float], accelerations: list[float]) -> tuple[float, float]:
    """Return the largest speed and acceleration along a straight move that keep every axis within its limits.

    Parameters
    ----------
    move, speeds, accelerations : list of float
        For each axis: signed distance (units), largest speed (units/s) and acceleration (units/s^2).

    Returns
    -------
    speed, acceleration : float
        Infinite for a move of no length.
    """
    length = math.hypot(*move)
    if not length:
        return math.inf, math.inf
    parts = [(abs(d) / length, v, a) for d, v, a in zip(move, speeds, accelerations, strict=True)]
    # A share so small that it underflows to zero limits nothing.
    return (
        min((v / part for part, v, _ in parts if part), default=math.inf),
        min((a / part for part, _, a in parts if part), default=math.inf),
    )


def straight_s(move: list[float], speeds: list[float], accelerations: list[float]) -> float:
    """Return the time of a straight move with a trapezoidal profile of speed, s; parameters as in `along`."""
    length = math.hypot(*move)
    if not length:
        return 0.0
    speed, acceleration = along(move, speeds, accelerations)
    ramp = speed / acceleration
    return length / speed + ramp if length >= speed * ramp else 2.0 * math.sqrt(length / acceleration)
