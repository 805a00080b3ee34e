"""Commands that take photographs or plan them: ``shoot``, ``plan`` and ``capture``.

Their argument is the options that `irodori.capture.command` has parsed.
"""

import sys
from contextlib import nullcontext
from pathlib import Path

from irodori.capture.camera.gphoto_camera import GphotoCamera
from irodori.capture.dialogue import Dialogue
from irodori.capture.followed_plan import by_hand, followed
from irodori.capture.journal import storing
from irodori.capture.page_server import Address, served
from irodori.capture.session import verify
from irodori.capture.shot_list import camera_shots, object_shots
from irodori.capture.shot_planner.planner import Plan, as_fitted, plan_best
from irodori.capture.stage import Target, capture_camera, capture_object
from irodori.config.capture_table import LONGEST_S, Pose, Shot, read_captures
from irodori.config.definition import as_plain, typed
from irodori.config.definitions import load_one
from irodori.config.loaded import Loaded
from irodori.config.models import Camera, Object, ObjectShape, PosePlan, Rig
from irodori.config.parts import PlannedObject
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.core.provenance import code_hash, config_hash
from irodori.core.store import Provenance
from irodori.core.termination import ending_in_order
from irodori.first_project.questions import shape as read_shape
from irodori.geometry.mesh_sources import shape_files


def shoot(options) -> None:
    """Take one photograph with a real camera, and verify it."""
    if not 0.0 < options.exposure <= LONGEST_S:
        raise InputError("--exposure", "", str(options.exposure), f"above 0 and up to {LONGEST_S} s")
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


def _target(options, loaded: Loaded | None = None) -> tuple[Target, Object | None]:
    """Return the target of a session for the named object or camera, and the object's definition if it is one."""
    kind = "cameras" if options.camera else "objects"
    loaded = loaded or load_one(kind, options.name)
    definition = None if options.camera else loaded.objects[options.name]
    camera = loaded.cameras[options.name if definition is None else definition.camera]
    rig, named = loaded.rigs[camera.rig], definition or camera
    if named.exposure_s is None:
        found = f"a rig of kind {rig.kind}, whose photographs somebody else takes"
        raise InputError(f"config/{kind}/{options.name}.yaml", "rig", found, "a rig of kind driven or virtual")
    captures = named.captures
    # Virtual photographs of this command, for practice, are kept apart from those of the workflow.
    table = captures.table if captures else Path("results/rig/bench", options.name, "captures.csv")
    target = Target(options.name, camera, rig, camera.rig, table, captures.folder if captures else None)
    return target, definition


def _of_shape(options) -> PlannedObject:
    """Return the definition for a plan of which only the shape is known (``--shape``)."""
    if options.camera:
        raise InputError("--shape", "", "--camera beside it", "one of them: a camera's photographs need no poses")
    try:
        block = typed(ObjectShape, read_shape(options.shape))
    except ValueError as error:
        raise InputError("--shape", "", repr(options.shape), str(error)) from None
    shape_files(block, Path())
    return PlannedObject(shape=block, refractive_index=Object.refractive_index, plan=PosePlan())


def _best(definition: Object | PlannedObject, rig: Rig, count: int | None, fitted: dict) -> Plan:
    """Return the plan with a number of poses, by default the object's ``plan.count``."""
    try:
        return plan_best(definition, rig, count, **fitted)
    except ValueError as error:
        found, _, accepted = str(error).partition("; accepted: ")
        raise InputError("--best", "", found, accepted) from None


def _states(camera: Camera) -> set[str]:
    """Return the filter states in a camera's photographs of its chart; empty before they are taken."""
    if camera.captures is None or not Path(camera.captures.table).is_file():
        return set()
    return {shot.filter for shot in read_captures(camera.captures.table) if shot.role == "chart"}


def plan(options) -> None:
    """Print the photographs of an object or a camera in their order, with an estimate of the time.

    If a person takes them, on a rig of the kind ``files``, poses are chosen and printed as a list to follow.
    """
    if options.shape is not None:
        loaded, what = load_one("rigs", options.name), _of_shape(options)
        rig = by_hand(loaded.rigs[options.name])
        print("\n".join(followed(_best(what, rig, options.best, as_fitted(loaded.config, rig)), rig)))
        return
    loaded = load_one("cameras" if options.camera else "objects", options.name, photographs=False)
    definition = None if options.camera else loaded.objects[options.name]
    if options.best is not None and definition is None:
        raise InputError("--best", "", "a camera", "an object: a camera's own photographs need no choice of poses")
    camera = None if definition is None else loaded.cameras[definition.camera]
    if definition is not None and camera is not None and loaded.rigs[camera.rig].kind == "files":
        rig = by_hand(loaded.rigs[camera.rig])
        best = _best(definition, rig, options.best, as_fitted(loaded.config, rig))
        print("\n".join(followed(best, rig, _states(camera))))
        return
    target, definition = _target(options, loaded)
    if options.best is not None and definition is not None:
        fitted = as_fitted(loaded.config, target.rig, definition, camera)
        print("\n".join(_best(definition, target.rig, options.best, fitted).lines()))
        return
    if definition is None:
        shots = camera_shots(loaded.cameras[options.name], target.suffix)
    else:
        shots = object_shots(definition, target.camera, target.suffix)
    planned = target.ordered(shots)
    for shot in planned:
        # An azimuth of 0 and the first placement are not printed.
        usual = {"light_azimuth_deg": 0.0, "placement": 1}
        pose = {name: value for name, value in vars(shot.pose).items() if usual.get(name) != value}
        angles = " ".join(f"{name.removesuffix('_deg').replace('_', ' ')} {value:g}" for name, value in pose.items())
        print(f"{shot.role} {angles} filter {shot.filter} {shot.exposure_s:g} s  {shot.file}")
    print(target.estimate(planned))


def capture(options) -> None:
    """Hold a session, or continue one."""
    target, definition = _target(options)
    described = as_plain({"definition": definition, "camera": target.camera, "rig": target.rig})
    made = Provenance("bench", config_hash(described), code_hash("irodori.capture.stage"))
    # Not the workflow's record, which would then count photographs of another definition as complete.
    record = Path(target.table).with_suffix(".json")
    if not target.is_virtual:
        # Makes the workflow check the photographs again, because its own record lacks those that are taken now.
        folder = Path("results", *(["cameras"] if options.camera else []), options.name, "captures")
        (folder / "session.json").unlink(missing_ok=True)
    dialogue = Dialogue(target.rig.operator_deadline_s)
    where = {name: value for name in ("address", "port") if (value := getattr(options, name)) is not None}
    if where and not options.page:
        raise InputError(f"--{next(iter(where))}", "", "no --page that it belongs to", "it together with --page")
    page = served(dialogue, Address(**where), target.name) if options.page else nullcontext()
    with ending_in_order(), page as server:
        if server is not None:
            print(f"the session's page: {server.url}", file=sys.stderr, flush=True)
        if definition is None:
            capture_camera(target, record, made, dialogue)
        else:
            capture_object(definition, target, record, made, dialogue)
    LOGGER.info("%s", record)
