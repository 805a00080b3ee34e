"""Check of a Grbl controller's settings against the rig's definition, before anything moves."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from irodori.capture.rig.devices import SettingError
from irodori.capture.rig.drives import Drive
from irodori.capture.rig.grbl.codes import SETTINGS
from irodori.capture.rig.grbl.protocol import LETTERS

STEPS, RATE, ACCELERATION, TRAVEL = 100, 110, 120, 130
#: For controllers without positions after homing in a file of their own.
NOWHERE: Mapping[str, float] = MappingProxyType({})
_SLACK = 1e-3
_NEEDED = (10, 13, 20, 22, 23, 24, 25, 26, 27)


@dataclass(frozen=True)
class Disagreement:
    """Contradiction between a controller's setting and the rig's file.

    Parameters
    ----------
    number : int
        Number of the ``$`` setting; 0 if no setting resolves the contradiction.
    wanted : float or None
        Value that agrees; None if a person must decide, or must change the rig's file.
    why : str
        Description of the contradiction and of the change that resolves it.
    """

    number: int
    wanted: float | None
    why: str


def check_settings(
    settings: Mapping[int, float],
    options: str,
    drives: Mapping[str, Drive],
    homing: bool,
    homes: Mapping[str, float] = NOWHERE,
) -> None:
    """Raise an error for a controller with settings that contradict the rig's file; see `disagreements`.

    Raises
    ------
    SettingError
        The message lists every contradiction and the setting to change.
    """
    found = [disagreement.why for disagreement in disagreements(settings, options, drives, homing, homes)]
    if found:
        raise SettingError("; ".join(found))


def disagreements(
    settings: Mapping[int, float],
    options: str,
    drives: Mapping[str, Drive],
    homing: bool,
    homes: Mapping[str, float] = NOWHERE,
) -> list[Disagreement]:
    """Return the settings of a controller that contradict the rig's file, in an order in which they can be changed.

    Parameters
    ----------
    settings : dict
        ``$`` settings by number.
    options : str
        Letters of the build's options, from ``$I``.
    drives : dict
        {angle: drive}, with speeds and limits of the rig's file.
    homing : bool
        Whether the rig has limit switches to home to.
    homes : dict
        {axis letter: position after homing, units}, for a controller that has it in a file of its own (FluidNC).

    Raises
    ------
    SettingError
        If a channel is not an axis of a Grbl controller.
    """
    for drive in drives.values():
        if len(drive.channel) != 1 or drive.channel not in LETTERS:
            raise SettingError(f"{drive.axis.name}: no axis {drive.channel!r}; accepted: {', '.join(LETTERS)}")
    needed = {number(first, drive): drive for drive in drives.values() for first in (STEPS, RATE, ACCELERATION, TRAVEL)}
    found = [
        Disagreement(0, None, f"the controller's settings lack ${key} ({SETTINGS.get(key, 'of a further axis')})")
        for key in (*_NEEDED, *needed)
        if key not in settings
    ]
    if int(settings.get(10, 1)) & 1 == 0:
        wanted = int(settings[10]) | 1
        found.append(Disagreement(10, wanted, f"the controller reports work positions: set $10={wanted}"))
    if settings.get(13):
        found.append(Disagreement(13, 0, "the controller reports in inches: set $13=0"))
    if bool(settings.get(22, homing)) != homing:
        wanted_words = "true, but homing is off in the controller: set $22=1" if homing else "false, but $22=1 locks it"
        found.append(Disagreement(22, int(homing), f"motion.homing is {wanted_words}, or change the rig's file"))
    if homing and not settings.get(20, 1):
        why = "soft limits are off in the controller: set $20=1, and $21=1 where it has hard limits"
        if homes:
            why = "soft limits are off: start the board anew, or set soft_limits: true for each axis in its config.yaml"
        found.append(Disagreement(20, None if homes else 1, why))
    for drive in drives.values():
        if all(key in settings for key, other in needed.items() if other is drive):
            found += _of_drive(settings, drive)
            if homing and settings.keys() >= {23, 27}:
                found += _of_reach(settings, options, drive, homes)
    return found


def number(first: int, drive: Drive) -> int:
    """Return the number of a drive's setting in the group that begins with 100, 110, 120 or 130."""
    return first + LETTERS.index(drive.channel)


def home_position(
    settings: Mapping[int, float], options: str, drive: Drive, homes: Mapping[str, float] = NOWHERE
) -> float:
    """Return the position of a drive after homing, controller units; parameters as in `disagreements`."""
    if drive.channel in homes:
        return homes[drive.channel]
    if "Z" in options:
        return 0.0
    return settings[27] - settings[number(TRAVEL, drive)] if _homes_down(settings, drive) else -settings[27]


def switch_position(settings: Mapping[int, float], drive: Drive, home: float) -> float:
    """Return the position at which a drive's limit switch closes, given its position after homing; controller units."""
    return home - settings[27] if _homes_down(settings, drive) else home + settings[27]


def travel_of(
    settings: Mapping[int, float], options: str, drive: Drive, homes: Mapping[str, float] = NOWHERE
) -> tuple[float, float]:
    """Return the smallest and largest position within a drive's soft limits, controller units; see `disagreements`."""
    length = settings[number(TRAVEL, drive)]
    if drive.channel in homes:
        home = homes[drive.channel]
        return (home, home + length) if _homes_down(settings, drive) else (home - length, home)
    if "Z" in options and _homes_down(settings, drive):
        return 0.0, length
    return -length, 0.0


def _homes_down(settings: Mapping[int, float], drive: Drive) -> bool:
    """Return whether a drive's limit switch is at the negative end of its travel."""
    return bool(int(settings[23]) >> LETTERS.index(drive.channel) & 1)


def homing_s(settings: Mapping[int, float], drives: Mapping[str, Drive]) -> float:
    """Return the longest time of homing, s: two groups of axes, each with a full search and a slow approach."""
    # All axes of the controller are homed, also those that the rig does not use.
    travel = max(value for key, value in settings.items() if TRAVEL <= key < TRAVEL + len(LETTERS))
    ramp = max(settings[25] / 60.0 / settings[number(ACCELERATION, drive)] for drive in drives.values())
    seek, locate, pull_off = settings[25] / 60.0, settings[24] / 60.0, settings[27]
    group = (
        (1.5 * travel + 2.0 * pull_off) / seek + 5.0 * pull_off / locate + 4.0 * (settings[26] / 1000.0 + 2.0 * ramp)
    )
    return 2.0 * group


def _of_drive(settings: Mapping[int, float], drive: Drive) -> list[Disagreement]:
    axis, name, found = drive.axis, drive.axis.name, []
    steps, rate, acceleration = (settings[number(first, drive)] for first in (STEPS, RATE, ACCELERATION))
    if not (steps > 0 and rate > 0 and acceleration > 0):
        why = f"{name}: steps, rate or acceleration of {drive.channel} are 0 in the controller"
        return [Disagreement(0, None, why)]
    if drive.speed > rate / 60.0 * (1 + _SLACK):
        key, allowed = number(RATE, drive), rate / 60.0 / abs(drive.units_per_deg)
        why = (
            f"{name}: speed_deg_per_s {axis.speed_deg_per_s:g} is above what the controller allows, {allowed:g} "
            f"(${key}={rate:g})"
        )
        found.append(Disagreement(key, _up(drive.speed * 60.0), why))
    if drive.acceleration > acceleration * (1 + _SLACK):
        key, allowed = number(ACCELERATION, drive), acceleration / abs(drive.units_per_deg)
        why = (
            f"{name}: acceleration_deg_per_s2 {axis.acceleration_deg_per_s2:g} is above what the controller allows, "
            f"{allowed:g} (${key}={acceleration:g})"
        )
        found.append(Disagreement(key, _up(drive.acceleration), why))
    step_deg = 1.0 / (steps * abs(drive.units_per_deg))
    if step_deg > axis.step_deg * (1 + _SLACK):
        # Motor and gear determine the step: another number would only make the axis move by a wrong angle.
        why = (
            f"{name}: one step of the motor is {step_deg:g} degrees, coarser than the axis's step {axis.step_deg:g} "
            f"(${number(STEPS, drive)}={steps:g})"
        )
        found.append(Disagreement(number(STEPS, drive), None, why))
    return found


def _of_reach(
    settings: Mapping[int, float], options: str, drive: Drive, homes: Mapping[str, float]
) -> list[Disagreement]:
    """Return the obstacle between a drive and its limits: the end of the travel, or the limit switch."""
    axis, (low, high) = drive.axis, travel_of(settings, options, drive, homes)
    limits = f"{axis.name}: limits {axis.min_deg:g} to {axis.max_deg:g} are {drive.channel} {drive.reach[0]:g} to "
    limits += f"{drive.reach[1]:g}, but the controller"
    if not (low - _SLACK <= drive.reach[0] and drive.reach[1] <= high + _SLACK):
        key = number(TRAVEL, drive)
        longer = drive.reach[1] <= high + _SLACK and high == 0.0
        why = f"{limits} travels from {low:g} to {high:g} (${key})"
        return [Disagreement(key, _up(-drive.reach[0]) if longer else None, why)]
    home = home_position(settings, options, drive, homes)
    inside = home - drive.reach[0] if _homes_down(settings, drive) else drive.reach[1] - home
    if inside > _SLACK:
        why = (
            f"{limits} stands at {home:g} once it has pulled off its switch ($27={settings[27]:g}), and nearer to the "
            f"switch a move ends in an alarm: shift zero_deg by {inside / abs(drive.units_per_deg):g} degrees, or end "
            "the limits before"
        )
        return [Disagreement(27, None, why)]
    return []


def _up(value: float) -> float:
    """Return a value rounded up to the three decimals that Grbl stores."""
    return math.ceil(round(value * 1000.0, 6)) / 1000.0
