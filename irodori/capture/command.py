"""Command line for the person at the bench.

::

    python -m irodori.rig status RIG
    python -m irodori.rig move RIG camera_deg=30 turn_deg=90
    python -m irodori.rig plan OBJECT --best 12
    python -m irodori.rig capture OBJECT
"""

import argparse
import logging
import sys
from collections.abc import Sequence
from contextlib import contextmanager
from pathlib import Path

from irodori.capture.camera.gphoto_camera import GphotoCamera
from irodori.capture.journal import storing
from irodori.capture.operator import PromptOperator
from irodori.capture.rig.connect import open_rig
from irodori.capture.rig.devices import LimitError, RigDevice
from irodori.capture.session import verify
from irodori.capture.shot_list import camera_shots, object_shots
from irodori.capture.shot_planner.fisher_information import Weighting
from irodori.capture.shot_planner.planner import default_noise, plan_best
from irodori.capture.stage import Target, capture_camera, capture_object
from irodori.config.capture_table import Pose, Shot
from irodori.config.definition import as_plain
from irodori.config.definitions import load_one
from irodori.config.models import Object
from irodori.core.errors import InputError, PlainError
from irodori.core.progress import LOGGER
from irodori.core.provenance import code_hash, config_hash
from irodori.core.store import Provenance
from irodori.core.termination import ending_in_order


def main(arguments: Sequence[str] | None = None, prog: str = "python -m irodori.rig") -> int:
    """Run one command; return 0, 1 after a fault that was said in one sentence, 130 after Ctrl-C."""
    options = _parser(prog).parse_args(arguments)
    handler = logging.StreamHandler(sys.stderr)
    # An operator speaks to the person by itself; its words go to the log for those who read a log.
    handler.addFilter(lambda record: record.module != "operator")
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
    sub = command("shoot", _shoot, "Take one photograph with a real camera.")
    sub.add_argument("camera", help="name of a file in config/cameras")
    sub.add_argument("file", type=Path, help="where to store the RAW file")
    sub.add_argument("--exposure", type=float, required=True, metavar="S", help="exposure time in seconds")
    sub = command("plan", _plan, "Print the photographs of an object or a camera in their order, and what they take.")
    _add_subject(sub)
    sub.add_argument("--best", type=int, metavar="K", help="choose the K poses that tell most about an object instead")
    _add_subject(command("capture", _capture, "Hold a session, or continue one: take what is missing."))
    return parser


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
def _rig(name: str):
    """Open a rig by name."""
    definition = load_one("rigs", name).rigs[name]
    if definition.motion is None:
        raise InputError(f"config/rigs/{name}.yaml", "motion", "no such key", "a rig with motors")
    with ending_in_order(), open_rig(definition) as rig:
        rig.on_hold = PromptOperator(definition.operator_deadline_s).confirm
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
    """Return angles by axis, each axis once and one of the rig's."""
    for name, _ in angles:
        if name not in rig.axes:
            raise LimitError(f"{name}: not a motorised axis of this rig; accepted: {', '.join(rig.axes)}")
        if sum(name == other for other, _ in angles) > 1:
            raise LimitError(f"{name}: given twice; accepted: each axis once")
    return dict(angles)


def _ready(rig: RigDevice, home: bool) -> None:
    """Home a rig that was not, where asked to; a simulated one, which has just been switched on, always."""
    if (home or rig.simulator is not None) and not rig.status().homed:
        rig.home()


def _shoot(options) -> None:
    camera = load_one("cameras", options.camera).cameras[options.camera]
    if camera.driver is None:
        raise InputError(f"config/cameras/{options.camera}.yaml", "driver", "no such key", "a camera that is driven")
    shot = Shot(options.file.name, "object", Pose(0.0, 0.0), "out", options.exposure)
    with GphotoCamera(camera.driver) as device:
        with storing(options.file):
            device.capture(shot, options.file)
        print(", ".join(f"{key} {value}" for key, value in device.status().items()))
    verify(options.file, shot)
    print(options.file)


def _target(options) -> tuple[Target, Object | None]:
    """Return what a session of the named object or camera photographs, and the object's definition."""
    kind = "cameras" if options.camera else "objects"
    loaded = load_one(kind, options.name)
    definition = None if options.camera else loaded.objects[options.name]
    camera = loaded.cameras[options.name if definition is None else definition.camera]
    rig, named = loaded.rigs[camera.rig], definition or camera
    if named.exposure_s is None:
        found = f"a rig of kind {rig.kind}, whose photographs somebody else takes"
        raise InputError(f"config/{kind}/{options.name}.yaml", "rig", found, "a rig of kind driven or virtual")
    captures = named.captures
    # What is computed at the bench, for practice, stands apart from what the workflow has computed.
    table = captures.table if captures else Path("results/rig/bench", options.name, "captures.csv")
    target = Target(options.name, camera, rig, camera.rig, table, captures.folder if captures else None)
    return target, definition


def _as_fitted(definition: Object, target: Target) -> dict:
    """Return noise, weights and largest angle as the configuration's fit will have them."""
    config = load_one("objects", target.name).config
    fit, sensor = config.fit, target.camera.virtual.sensor if target.camera.virtual else None
    exposures_s = definition.exposure_s.out if sensor and definition.exposure_s else ()
    return {
        "noise": default_noise(target.rig, sensor, exposures_s, fit),
        "weighting": Weighting(fit.weights, fit.model_error),
        "max_angle_deg": config.rectify.max_angle_deg,
    }


def _plan(options) -> None:
    target, definition = _target(options)
    if options.best is not None:
        if definition is None:
            raise InputError("--best", "", "a camera", "an object: a camera's own photographs need no choice of poses")
        try:
            best = plan_best(definition, target.rig, options.best, **_as_fitted(definition, target))
        except ValueError as error:
            raise InputError("--best", "", str(options.best), str(error)) from None
        print("\n".join(best.lines()))
        return
    if definition is None:
        shots = camera_shots(target.camera, target.suffix)
    else:
        shots = object_shots(definition, target.camera, target.suffix)
    planned = target.ordered(shots)
    for shot in planned:
        angles = " ".join(f"{name.removesuffix('_deg')} {value:g}" for name, value in vars(shot.pose).items())
        print(f"{shot.role} {angles} filter {shot.filter} {shot.exposure_s:g} s  {shot.file}")
    print(target.estimate(planned))


def _capture(options) -> None:
    target, definition = _target(options)
    described = as_plain({"definition": definition, "camera": target.camera, "rig": target.rig})
    made = Provenance("bench", config_hash(described), code_hash("irodori.capture.stage"))
    # Not the workflow's record: it would take photographs for whole that another definition asked for.
    record = Path(target.table).with_suffix(".json")
    if not target.is_virtual:
        # The workflow looks at the photographs again: its own record says nothing of what is taken now.
        folder = Path("results", *(["cameras"] if options.camera else []), options.name, "captures")
        (folder / "session.json").unlink(missing_ok=True)
    if definition is None:
        capture_camera(target, record, made)
    else:
        capture_object(definition, target, record, made)
    LOGGER.info("%s", record)
