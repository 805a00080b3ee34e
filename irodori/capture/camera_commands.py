"""Commands of the person at the bench that photograph, or say what is to be photographed.

Each takes the options that `irodori.capture.command` has parsed.
"""

import sys
from contextlib import nullcontext
from pathlib import Path

from irodori.capture.camera.gphoto_camera import GphotoCamera
from irodori.capture.dialogue import Dialogue
from irodori.capture.journal import storing
from irodori.capture.page_server import Address, served
from irodori.capture.session import verify
from irodori.capture.shot_list import camera_shots, object_shots
from irodori.capture.shot_planner.fisher_information import Weighting
from irodori.capture.shot_planner.planner import default_noise, plan_best
from irodori.capture.stage import Target, capture_camera, capture_object
from irodori.config.capture_table import Pose, Shot
from irodori.config.definition import as_plain
from irodori.config.definitions import load_one
from irodori.config.models import Object
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.core.provenance import code_hash, config_hash
from irodori.core.store import Provenance
from irodori.core.termination import ending_in_order


def shoot(options) -> None:
    """Take one photograph with a real camera, and verify it."""
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


def plan(options) -> None:
    """Print the photographs of an object or a camera in their order, and what they take."""
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
        # An azimuth is told where there is one.
        pose = {name: value for name, value in vars(shot.pose).items() if value or name != "light_azimuth_deg"}
        angles = " ".join(f"{name.removesuffix('_deg')} {value:g}" for name, value in pose.items())
        print(f"{shot.role} {angles} filter {shot.filter} {shot.exposure_s:g} s  {shot.file}")
    print(target.estimate(planned))


def capture(options) -> None:
    """Hold a session, or continue one."""
    target, definition = _target(options)
    described = as_plain({"definition": definition, "camera": target.camera, "rig": target.rig})
    made = Provenance("bench", config_hash(described), code_hash("irodori.capture.stage"))
    # Not the workflow's record: it would take photographs for whole that another definition asked for.
    record = Path(target.table).with_suffix(".json")
    if not target.is_virtual:
        # The workflow looks at the photographs again: its own record says nothing of what is taken now.
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
