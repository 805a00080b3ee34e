"""Check of a Grbl controller's settings against the rig's definition, before anything moves."""

from collections.abc import Mapping

from irodori.capture.rig.devices import SettingError
from irodori.capture.rig.drives import Drive
from irodori.capture.rig.grbl.codes import SETTINGS
from irodori.capture.rig.grbl.protocol import LETTERS

STEPS, RATE, ACCELERATION, TRAVEL = 100, 110, 120, 130
_SLACK = 1e-3
_NEEDED = (10, 13, 20, 22, 23, 24, 25, 26, 27)


def check_settings(settings: Mapping[int, float], options: str, drives: Mapping[str, Drive], homing: bool) -> None:
    """Refuse a controller that is not set up as the rig's file says.

    Parameters
    ----------
    settings : dict
        ``$`` settings by number.
    options : str
        Letters of the build's options, from ``$I``.
    drives : dict
        Angle: drive; speeds and limits of the rig's file.
    homing : bool
        Whether the rig has limit switches to home to.

    Raises
    ------
    SettingError
        For the first disagreement, with the setting to change.
    """
    for drive in drives.values():
        if len(drive.channel) != 1 or drive.channel not in LETTERS:
            raise SettingError(f"{drive.axis.name}: no axis {drive.channel!r}; accepted: {', '.join(LETTERS)}")
    needed = [number(first, drive) for drive in drives.values() for first in (STEPS, RATE, ACCELERATION, TRAVEL)]
    for key in (*_NEEDED, *needed):
        if key not in settings:
            raise SettingError(f"the controller's settings lack ${key} ({SETTINGS.get(key, 'of a further axis')})")
    if not int(settings[10]) & 1:
        raise SettingError("the controller reports work positions: set $10=1")
    if settings[13]:
        raise SettingError("the controller reports in inches: set $13=0")
    if bool(settings[22]) != homing:
        wanted = "true, but homing is off in the controller: set $22=1" if homing else "false, but $22=1 locks it"
        raise SettingError(f"motion.homing is {wanted}, or change the rig's file")
    if homing and not settings[20]:
        raise SettingError("soft limits are off in the controller: set $20=1")
    for drive in drives.values():
        _check_drive(settings, options, drive, homing)


def number(first: int, drive: Drive) -> int:
    """Return the number of a drive's setting of a group: 100, 110, 120 or 130."""
    return first + LETTERS.index(drive.channel)


def home_position(settings: Mapping[int, float], options: str, drive: Drive) -> float:
    """Return where a drive stands after homing, controller units."""
    if "Z" in options:
        return 0.0
    negative = int(settings[23]) >> LETTERS.index(drive.channel) & 1
    return settings[27] - settings[number(TRAVEL, drive)] if negative else -settings[27]


def travel_of(settings: Mapping[int, float], options: str, drive: Drive) -> tuple[float, float]:
    """Return smallest and largest position that soft limits allow a drive, controller units."""
    length = settings[number(TRAVEL, drive)]
    if "Z" in options and int(settings[23]) >> LETTERS.index(drive.channel) & 1:
        return 0.0, length
    return -length, 0.0


def homing_s(settings: Mapping[int, float], drives: Mapping[str, Drive]) -> float:
    """Return the time that homing may take, s: two groups of axes, each its full search and its slow approach."""
    # All axes of the controller are homed, also those that are not the rig's.
    travel = max(value for key, value in settings.items() if TRAVEL <= key < TRAVEL + len(LETTERS))
    ramp = max(settings[25] / 60.0 / settings[number(ACCELERATION, drive)] for drive in drives.values())
    seek, locate, pull_off = settings[25] / 60.0, settings[24] / 60.0, settings[27]
    group = (
        (1.5 * travel + 2.0 * pull_off) / seek + 5.0 * pull_off / locate + 4.0 * (settings[26] / 1000.0 + 2.0 * ramp)
    )
    return 2.0 * group


def _check_drive(settings: Mapping[int, float], options: str, drive: Drive, homing: bool) -> None:
    axis, name = drive.axis, drive.axis.name
    steps, rate, acceleration = (settings[number(first, drive)] for first in (STEPS, RATE, ACCELERATION))
    if not (steps > 0 and rate > 0 and acceleration > 0):
        raise SettingError(f"{name}: steps, rate or acceleration of {drive.channel} are 0 in the controller")
    if drive.speed > rate / 60.0 * (1 + _SLACK):
        allowed = rate / 60.0 / abs(drive.units_per_deg)
        raise SettingError(
            f"{name}: speed_deg_per_s {axis.speed_deg_per_s:g} is above what the controller allows, {allowed:g} "
            f"(${number(RATE, drive)}={rate:g})"
        )
    if drive.acceleration > acceleration * (1 + _SLACK):
        allowed = acceleration / abs(drive.units_per_deg)
        raise SettingError(
            f"{name}: acceleration_deg_per_s2 {axis.acceleration_deg_per_s2:g} is above what the controller allows, "
            f"{allowed:g} (${number(ACCELERATION, drive)}={acceleration:g})"
        )
    step_deg = 1.0 / (steps * abs(drive.units_per_deg))
    if step_deg > axis.step_deg * (1 + _SLACK):
        raise SettingError(
            f"{name}: one step of the motor is {step_deg:g} degrees, coarser than the axis's step {axis.step_deg:g} "
            f"(${number(STEPS, drive)}={steps:g})"
        )
    low, high = travel_of(settings, options, drive)
    if homing and not (low - _SLACK <= drive.reach[0] and drive.reach[1] <= high + _SLACK):
        raise SettingError(
            f"{name}: limits {axis.min_deg:g} to {axis.max_deg:g} are {drive.channel} {drive.reach[0]:g} to "
            f"{drive.reach[1]:g}, but the controller travels from {low:g} to {high:g} (${number(TRAVEL, drive)})"
        )
