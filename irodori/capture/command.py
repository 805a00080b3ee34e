"""Command line of the rig, for the person at the bench: status, moves, plans and capture sessions.

::

    python -m irodori.rig status RIG
    python -m irodori.rig setup RIG --write
    python -m irodori.rig move RIG camera_deg=30 turn_deg=90
    python -m irodori.rig plan OBJECT --best 12
    python -m irodori.rig capture OBJECT
"""

import argparse
import importlib
import logging
import sys
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from pathlib import Path

from irodori.capture.dialogue import Dialogue
from irodori.capture.operator import PromptOperator
from irodori.capture.rig.connect import open_rig
from irodori.capture.rig.devices import LimitError, RigDevice, SettingError
from irodori.capture.rig.grbl.driver import GrblRig
from irodori.config.definitions import load_one
from irodori.core.errors import InputError, PlainError
from irodori.core.progress import LOGGER
from irodori.core.termination import ending_in_order


def main(arguments: Sequence[str] | None = None, prog: str = "python -m irodori.rig") -> int:
    """Run one command; return 0 after success, 1 after a `PlainError`, which is printed, and 130 after Ctrl-C."""
    options = _parser(prog).parse_args(arguments)
    handler = logging.StreamHandler(sys.stderr)
    # These modules print their messages for the person themselves; the log file has them too.
    handler.addFilter(lambda record: record.module not in ("operator", "dialogue"))
    logging.getLogger().addHandler(handler)
    LOGGER.setLevel(logging.INFO)
    try:
        options.run(options)
    except PlainError as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped; the rig stands still, and what was taken stays", file=sys.stderr)
        return 130
    finally:
        logging.getLogger().removeHandler(handler)
    return 0


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=prog, description="The rig, for the person at the bench.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, run, text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text)
        sub.set_defaults(run=run)
        return sub

    for name, run, text in (
        ("status", _status, "Say where the axes of a rig stand and what its controller says."),
        ("home", _home, "Find the reference position of every axis."),
        ("recount", _recount, "Home, and say what the axes have lost in steps since they were homed."),
    ):
        command(name, run, text).add_argument("rig", help="name of a file in config/rigs")
    for name, run, text in (
        ("move", _move, "Move axes to angles, such as camera_deg=30 turn_deg=90."),
        ("jog", _jog, "Move axes by a little, such as camera_deg=-0.5."),
    ):
        sub = command(name, run, text)
        sub.add_argument("rig", help="name of a file in config/rigs")
        sub.add_argument("angles", nargs="+", metavar="AXIS=DEGREES", type=_angle)
        text = "find the reference position first, where the rig does not know where it stands"
        sub.add_argument("--home", action="store_true", help=text)
    sub = command("setup", _setup, "List the settings of a rig's controller that contradict the rig's file.")
    sub.add_argument("rig", help="name of a file in config/rigs")
    sub.add_argument("--write", action="store_true", help="change those in the controller that have a value to be set")
    sub = command("shoot", _of_a_camera("shoot"), "Take one photograph with a real camera.")
    sub.add_argument("camera", help="name of a file in config/cameras")
    sub.add_argument("file", type=Path, help="where to store the RAW file")
    sub.add_argument("--exposure", type=float, required=True, metavar="S", help="exposure time in seconds")
    text = "Print the photographs of an object or a camera in their order, and what they take."
    sub = command("plan", _of_a_camera("plan"), text)
    _add_subject(sub)
    sub.add_argument("--best", type=int, metavar="K", help="choose the K poses that tell most about an object instead")
    text = "choose poses for a shape, such as 'plate 90' or 'sphere 30' (mm), where NAME is that of a rig"
    sub.add_argument("--shape", metavar="SHAPE", help=text)
    sub = command("capture", _of_a_camera("capture"), "Hold a session, or continue one: take what is missing.")
    _add_subject(sub)
    sub.add_argument("--page", action="store_true", help="show the session in a browser, and take answers there too")
    text = "of the page: an address of this computer in the network that is to reach it; this computer alone if absent"
    sub.add_argument("--address", help=text)
    sub.add_argument("--port", type=int, help="of the page; 0 for one that is free, 8462 if absent")
    return parser


def _of_a_camera(name: str) -> Callable[[argparse.Namespace], None]:
    """Return a command that imports `irodori.capture.camera_commands` only when run, because that takes seconds."""
    return lambda options: getattr(importlib.import_module("irodori.capture.camera_commands"), name)(options)


def _add_subject(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("name", help="name of a file in config/objects, or in config/cameras with --camera")
    sub.add_argument("--camera", action="store_true", help="the chart, white and dark frames that calibrate a camera")


def _angle(text: str) -> tuple[str, float]:
    name, _, angle = text.partition("=")
    try:
        return name, float(angle)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}; accepted: an axis and degrees, such as camera_deg=30") from None


@contextmanager
def _rig(name: str, checked: bool = True):
    """Open a rig by the name of its definition; see `open_rig`."""
    definition = load_one("rigs", name).rigs[name]
    if definition.motion is None:
        raise InputError(f"config/rigs/{name}.yaml", "motion", "no such key", "a rig with motors")
    with ending_in_order(), open_rig(definition, checked, name) as rig:
        rig.on_hold = PromptOperator(Dialogue(definition.operator_deadline_s)).confirm
        yield rig


def _print_status(rig: RigDevice) -> None:
    status = rig.status()
    words = [f"state {status.state}", "homed" if status.homed else "not homed", status.message]
    print(", ".join(filter(None, words)))
    for name, angle in status.position_deg.items():
        axis = rig.axes[name]
        print(f"{name} {angle:.3f} ({axis.min_deg:g} to {axis.max_deg:g}, {axis.speed_deg_per_s:g} degrees/s)")


def _status(options) -> None:
    with _rig(options.rig) as rig:
        _print_status(rig)


def _home(options) -> None:
    with _rig(options.rig) as rig:
        rig.home()
        _print_status(rig)


def _recount(options) -> None:
    with _rig(options.rig) as rig:
        for name, lost in rig.recount().items():
            print(f"{name} stood {lost:+.3f} degrees off its count")
        _print_status(rig)


def _setup(options) -> None:
    with _rig(options.rig, checked=False) as rig:
        if not isinstance(rig, GrblRig):
            raise SettingError(f"{options.rig}: its controller has no settings to compare; accepted: protocol grbl")
        if options.write:
            rig.write_settings({d.number: d.wanted for d in rig.disagreements() if d.wanted is not None})
        found = rig.disagreements()
        for disagreement in found:
            wanted = "by hand" if disagreement.wanted is None else f"${disagreement.number}={disagreement.wanted:g}"
            print(f"{wanted:>14}  {disagreement.why}")
        if found:
            raise SettingError(f"{options.rig}: {len(found)} to be changed; --write changes those with a value")
        print(f"{options.rig}: the controller's settings agree with the rig's file")


def _move(options) -> None:
    with _rig(options.rig) as rig:
        targets = _by_axis(rig, options.angles)
        rig.check(targets)
        _ready(rig, options.home)
        rig.move(targets)
        _print_status(rig)


def _jog(options) -> None:
    with _rig(options.rig) as rig:
        steps = _by_axis(rig, options.angles)
        _ready(rig, options.home)
        position = rig.position()
        rig.move({name: position[name] + by for name, by in steps.items()})
        _print_status(rig)


def _by_axis(rig: RigDevice, angles: Sequence[tuple[str, float]]) -> dict[str, float]:
    """Return {axis: angle} after a check that each axis belongs to the rig and is named once."""
    for name, _ in angles:
        if name not in rig.axes:
            raise LimitError(f"{name}: not a motorised axis of this rig; accepted: {', '.join(rig.axes)}")
        if sum(name == other for other, _ in angles) > 1:
            raise LimitError(f"{name}: given twice; accepted: each axis once")
    return dict(angles)


def _ready(rig: RigDevice, home: bool) -> None:
    """Home a rig that is not homed, if ``--home`` was given or the rig is simulated, and so has just started."""
    if (home or rig.simulator is not None) and not rig.status().homed:
        rig.home()
