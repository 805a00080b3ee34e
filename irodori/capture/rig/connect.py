"""Opening of a rig from its definition: with the controller on its port, or with a simulated controller."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from irodori.capture.rig.ascii_description import Description
from irodori.capture.rig.ascii_rig import AsciiRig
from irodori.capture.rig.devices import Link, RigDevice, SettingError
from irodori.capture.rig.drives import Drive, drives_of
from irodori.capture.rig.grbl.driver import GrblRig
from irodori.capture.rig.grbl.settings_check import ACCELERATION, RATE, STEPS, TRAVEL, number
from irodori.capture.rig.homings import Homings
from irodori.capture.rig.serial_link import SerialLink
from irodori.config.models import Motion, Rig

if TYPE_CHECKING:
    from irodori.simulation.controllers.peer_client import Simulator

SIMULATOR = "simulator"
_HOMING_SEARCH = 4.0


def _motion(rig: Rig) -> Motion:
    if rig.motion is None:
        raise SettingError("the rig's file has no block motion: nothing of this rig is driven")
    return rig.motion


def _description(motion: Motion) -> Description:
    if motion.ascii is None:
        raise SettingError("the rig's file has no block motion.ascii, which describes its controller")
    return Description.of(motion.ascii)


@contextmanager
def open_rig(rig: Rig, checked: bool = True, name: str = "") -> Iterator[RigDevice]:
    """Open the rig of a definition; stop it on an exception, and close its connection at the end.

    Parameters
    ----------
    rig : Rig
        With the block ``motion``. The port ``simulator`` starts a simulated controller.
    checked : bool
        Whether a controller with settings that contradict the definition is refused; see `GrblRig`.
    name : str
        Name of the rig, under which its homings are recorded; without it, or if it is simulated, they are forgotten.

    Yields
    ------
    RigDevice
        On the port ``simulator``, its attribute ``simulator`` is the
        `irodori.simulation.controllers.peer_client.Simulator`, from which a virtual camera gets the true positions of
        the axes (see `true_position_deg`); otherwise it is None.

    Raises
    ------
    DeviceError
    """
    motion = _motion(rig)
    with ExitStack() as stack:
        simulator = stack.enter_context(start_simulator(rig)) if motion.port == SIMULATOR else None
        link = SerialLink(
            simulator.port if simulator else motion.port,
            motion.baud,
            write_timeout_s=motion.timeout_s,
            line_end=b"\n" if motion.protocol == "grbl" else _description(motion).line_end,
        )
        stack.callback(link.close)
        opened = _DRIVERS[motion.protocol](link, drives_of(rig), motion, checked, homings_of(name, rig))
        opened.simulator = simulator
        yield stack.enter_context(opened)


def homings_of(name: str, rig: Rig) -> Homings:
    """Return the record of a rig's homings; one that is not stored for a simulated rig, or without its name."""
    stored = name and rig.motion and rig.motion.port != SIMULATOR
    return Homings(Path("results/rig") / name / "homings.jsonl" if stored else None)


@contextmanager
def start_simulator(rig: Rig) -> "Iterator[Simulator]":
    """Start a simulated controller with settings that agree with a rig's definition; see `open_rig`."""
    # Imported here, so that a real rig does not wait for the simulator's import.
    from irodori.simulation.controllers import ascii_simulator, grbl_simulator

    motion = _motion(rig)
    given = motion.simulator
    scale, seed, rms = given.time_scale, given.seed, given.homing_rms_units
    if motion.protocol == "grbl":
        settings = grbl_settings(drives_of(rig), motion.homing)
        running = grbl_simulator.simulate(settings, time_scale=scale, seed=seed, homing_rms=rms)
    else:
        running = ascii_simulator.simulate(rig, time_scale=scale, seed=seed, homing_rms=rms)
    with running as simulator:
        yield simulator


def grbl_settings(drives: Mapping[str, Drive], homing: bool) -> dict[int, float]:
    """Return Grbl's ``$`` settings that agree with drives, as a person would set them for such a rig.

    The pull-off is 1 unit, or less if the limits of an axis begin at a smaller distance from its switch, so that after
    homing every axis is at its first limit or between this limit and the switch.
    """
    pull_off = min([1.0, *(-drive.reach[1] for drive in drives.values() if drive.reach[1] < 0.0)])
    settings: dict[int, float] = {20: int(homing), 21: int(homing), 22: int(homing), 26: 25, 27: round(pull_off, 3)}
    # Controller axes that the rig does not use are homed with the others, and must not delay them.
    others = {TRAVEL: 10.0, ACCELERATION: max(drive.acceleration for drive in drives.values())}
    settings |= {first + index: value for first, value in others.items() for index in range(3)}
    for drive in drives.values():
        finest = min(drive.axis.step_deg, 0.1) * abs(drive.units_per_deg)
        settings[number(STEPS, drive)] = max(100.0, round(10.0 / finest, 3))
        settings[number(RATE, drive)] = round(drive.speed * 60.0 + 5e-4, 3)
        settings[number(ACCELERATION, drive)] = round(drive.acceleration + 5e-4, 3)
        settings[number(TRAVEL, drive)] = round(pull_off - drive.reach[0] + 5e-4, 3)
    settings[25] = round(max(drive.speed for drive in drives.values()) * 60.0, 3)
    settings[24] = round(settings[25] / _HOMING_SEARCH, 3)
    return settings


def true_position_deg(rig: RigDevice) -> dict[str, float]:
    """Return the true angles of a simulated rig's axes, degrees, as a camera would see them.

    The angles are measured from the limit switches: after an ideal homing they are those that the controller reports,
    and they remain correct when the controller loses steps.

    Raises
    ------
    ValueError
        If the rig is not simulated.
    """
    if rig.simulator is None:
        raise ValueError("only a simulated rig knows where it truly stands")
    places = rig.simulator.true_position()
    return {name: drive.to_deg(places[drive.channel]) for name, drive in rig.drives.items()}


def _open_grbl(link: Link, drives: Mapping[str, Drive], motion: Motion, checked: bool, homings: Homings) -> RigDevice:
    return GrblRig(link, drives, timeout_s=motion.timeout_s, homing=motion.homing, checked=checked, homings=homings)


def _open_ascii(link: Link, drives: Mapping[str, Drive], motion: Motion, checked: bool, homings: Homings) -> RigDevice:
    words = _description(motion)
    return AsciiRig(link, drives, words, timeout_s=motion.timeout_s, homing=motion.homing)


_DRIVERS: dict[str, Callable[[Link, Mapping[str, Drive], Motion, bool, Homings], RigDevice]] = {
    "grbl": _open_grbl,
    "ascii": _open_ascii,
}
