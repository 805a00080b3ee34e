"""Capture stage: photograph an object, a camera's references or an environment, on a real or virtual rig."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from irodori.capture.camera.gphoto_camera import RAW_SUFFIXES, GphotoCamera
from irodori.capture.dialogue import Dialogue
from irodori.capture.journal import RETIRED, UNCHECKED, Journal, claimed, storing
from irodori.capture.operator import AutoOperator, Operator, Step, make_operator
from irodori.capture.rig.connect import homings_of, open_rig, true_position_deg
from irodori.capture.rig.devices import Axis, CameraDevice, RigDevice
from irodori.capture.rig.drives import drives_of
from irodori.capture.session import PositionError, Session, confirm, take_stock
from irodori.capture.shot_list import camera_shots, object_shots, shots_without_rig, with_drift_frames
from irodori.capture.shot_order import Estimate, estimate_s, order_shots
from irodori.config.capture_table import Shot
from irodori.config.models import Camera, EnvironmentDefinition, Object, Rig, ScenePhotograph
from irodori.config.parts import AnyCamera, PhotographedObject, SceneRadiance
from irodori.core.atomic_files import file_sha256, written_whole
from irodori.core.confined_paths import confined
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.core.store import Provenance
from irodori.core.termination import ending_in_order
from irodori.geometry.projected_outline import Outline, ProjectedOutlines
from irodori.simulation.virtual_rig.bench import Bench
from irodori.simulation.virtual_rig.virtual_camera import Photographed, VirtualCamera

#: Time of a step by hand in the order of photographs, s, by operator; on the virtual rig it takes none.
_STEP_S = {"prompt": 30.0, "file": 30.0, "auto": 0.0}
#: Time of a photograph beyond its exposure: mirror, read-out, the file over the cable, the check.
_READ_OUT_S = 4.0
#: File with the hash of the definition and code that made a virtual session's photographs.
_MADE_FROM = ".made-from"


@dataclass(frozen=True)
class Target:
    """Subject, devices and destination of a session.

    Parameters
    ----------
    name : str
        Name of the object, the camera or the environment.
    camera : Camera or PhotographingCamera
    rig : Rig
        Definitions.
    rig_name : str
        Name of the rig, used for the folder of confirmation files.
    table : path
        ``captures.csv``.
    folder : path, optional
        Folder of the RAW files; by default that of the table.
    """

    name: str
    camera: AnyCamera
    rig: Rig
    rig_name: str = ""
    table: str | Path = "captures.csv"
    folder: str | Path | None = None

    @property
    def is_virtual(self) -> bool:
        """Whether the photographs are computed."""
        return self.rig.kind == "virtual"

    @property
    def suffix(self) -> str:
        """Suffix of the RAW files' names, with the dot."""
        if self.is_virtual:
            return VirtualCamera.suffix
        if self.camera.driver is None:
            raise ValueError("a camera without the block driver on a rig that is not virtual; accepted: one with it")
        model = self.camera.driver.model
        return next((known[0] for maker, known in RAW_SUFFIXES.items() if model.startswith(maker)), ".raw")

    @property
    def settle_s(self) -> float:
        """Time from the arrival of the motors to the shutter, s."""
        return self.rig.motion.settle_s if self.rig.motion else 0.0

    def axes(self) -> dict[str, Axis]:
        """Return the motorised axes by name; other angles of a pose are set by hand."""
        return {name: drive.axis for name, drive in drives_of(self.rig).items()} if self.rig.motion else {}

    def ordered(self, shots: Sequence[Shot]) -> list[Shot]:
        """Return photographs in the order in which they are taken; drift frames are inserted for an object."""
        axes = self.axes()
        ordered = order_shots(shots, axes, {}, _STEP_S[self.rig.operator])
        is_object = any(shot.role == "object" for shot in ordered)
        return with_drift_frames(ordered, self.rig.drift_every if is_object else 0, axes)

    def estimate(self, shots: Sequence[Shot]) -> Estimate:
        """Return the time that photographs take in their order, with unknown settings at the beginning."""
        overhead_s = 0.0 if self.is_virtual else _READ_OUT_S
        return estimate_s(shots, self.axes(), {}, _STEP_S[self.rig.operator], overhead_s, self.settle_s)


class _VirtualHands(Operator):
    """Operator that asks another operator, then makes the settings on the virtual rig as a person would."""

    def __init__(self, inner: Operator, bench: Bench) -> None:
        self.inner, self.bench, self.attended = inner, bench, inner.attended

    def ask(self, step: Step) -> None:
        self.inner.ask(step)
        self.bench.set(step.new)

    def confirm(self, request: str) -> None:
        self.inner.confirm(request)

    def judge(self, doubt: str) -> str:
        return self.inner.judge(doubt)


@contextmanager
def _equipment(
    target: Target, planned: Sequence[Shot], subject: Photographed | None, on_rig: bool, dialogue: Dialogue
) -> Iterator[tuple[RigDevice | None, CameraDevice, Operator]]:
    """Open the rig, the camera and the operator of a session."""
    rig = target.rig
    moved = open_rig(rig, name=target.rig_name) if on_rig and rig.motion else nullcontext()
    with moved as opened:
        folder = Path("results/rig") / target.rig_name
        if not target.is_virtual:
            assert target.camera.driver is not None  # `Target.suffix` refuses a camera without
            with GphotoCamera(target.camera.driver) as camera:
                LOGGER.info("camera: %s", ", ".join(f"{key} {value}" for key, value in camera.status().items()))
                yield opened, camera, make_operator(rig.operator, folder, dialogue)
            return
        bench = Bench(motors_deg=lambda: true_position_deg(opened) if opened is not None else {})
        operator = make_operator(rig.operator, folder, dialogue, set_bench=bench.set)
        if not isinstance(operator, AutoOperator):
            operator = _VirtualHands(operator, bench)
        yield opened, VirtualCamera(target.camera, rig, bench, target.name, planned, subject), operator


def photograph(
    shots: Sequence[Shot],
    target: Target,
    subject: Photographed | None,
    record,
    provenance: Provenance,
    *,
    owner: str,
    on_rig: bool = True,
    dialogue: Dialogue | None = None,
    outline_of: Callable[[Shot], Outline | None] = lambda shot: None,
) -> dict[str, str]:
    """Hold a session, or continue one, and write its record.

    If no photograph is missing, and lost steps were looked for after each, no device is opened and nothing moves.

    Parameters
    ----------
    shots : sequence of Shot
        Photographs in any order.
    target : Target
    subject : Photographed or None
        Definition of what a virtual camera photographs.
    record : path
        JSON file to write when the session is complete, with its counts and the hash of the table.
    provenance : Provenance
        Origin of a virtual session: photographs of another definition or of other code are taken again. Photographs of
        a real rig are kept as long as the plan requires them.
    owner : str
        Subject that the folder is reserved for, such as ``object jar``.
    on_rig : bool
        Whether the subject is on the rig.
    dialogue : Dialogue, optional
        Dialogue of a page; by default there is only the terminal.
    outline_of : callable, optional
        See `Session`.

    Returns
    -------
    dict
        {path of a photograph: hash} of all photographs in the table.

    Raises
    ------
    DeviceError, InputError
        Photographs taken before are kept, and are not taken again.
    """
    table = Path(target.table)
    folder = table.parent if target.folder is None else Path(target.folder)
    planned, status, drift = target.ordered(shots), {}, list[dict]()
    kept_record = Path(record) if target.is_virtual else table.with_suffix(".json")
    dialogue = dialogue or Dialogue(target.rig.operator_deadline_s)
    with claimed(table, folder, owner), ending_in_order():
        if target.is_virtual:
            _start_over_if_changed(table, kept_record, provenance)
        journal = Journal(table, folder)
        position = _earlier_checks(kept_record)
        tally = take_stock(journal, planned)
        missing = journal.missing(planned)
        needs = target.estimate(missing)
        LOGGER.info("%s: %d of %d photographs to take; %s", target.name, len(missing), len(planned), needs)
        open_ends = _open_ends(journal, target) if on_rig else []
        if missing or open_ends:
            with _equipment(target, planned, subject, on_rig, dialogue) as (rig, camera, operator):
                session = Session(
                    camera,
                    operator,
                    journal,
                    rig,
                    tally,
                    settle_s=target.settle_s,
                    dialogue=dialogue,
                    left_s=lambda shots: target.estimate(shots).total_s,
                    outline_of=outline_of,
                )
                session.run(planned, target.name)
                status, drift = camera.status(), [frame.plain() for frame in session.drift]
                position += [check.plain() for check in session.position]
        journal.finish(planned)
        if never := list(journal.unchecked):
            found = "%s: the rig lost its count of steps after %d photographs; whether it skipped any is not known: %s"
            LOGGER.warning(found, table, len(never), ", ".join(never))
        LOGGER.info("%s: %s", target.name, ", ".join(f"{key} {value:g}" for key, value in vars(tally).items()))
        content = {
            "photographs": len(planned),
            "table_sha256": file_sha256(table),
            "session": vars(tally),
            "camera": status,
            "drift": drift,
            "position": position,
            "never_checked": never,
        }
        # Snakemake deletes its own record before each job; that of a session at a real rig is kept beside the table.
        for path in {kept_record, Path(record)}:
            _write_record(path, content)
        return {str(folder / file): sha256 for file, sha256 in journal.sha256.items()}


def _open_ends(journal: Journal, target: Target) -> list[str]:
    """Return photographs that are in doubt, or whose angles the rig may still confirm.

    Raises
    ------
    PositionError
        If the rig has no limit switches any more, so that nobody would be asked about photographs in doubt.
    """
    homings, motion = homings_of(target.rig_name, target.rig), target.rig.motion
    doubtful = confirm(journal, homings, target.axes())
    if motion is None or not motion.homing:
        if doubtful:
            why = f"{journal.table}: {', '.join(dict.fromkeys(doubtful.values()))}: steps were lost"
            raise PositionError(f"{why}; remove these photographs, which are then taken again: {', '.join(doubtful)}")
        return []
    return [*doubtful, *(file for file, homing in journal.unchecked.items() if homing == homings.current)]


def _start_over_if_changed(table: Path, record: Path, provenance: Provenance) -> None:
    """Remove a virtual session's photographs if their definition or the code that made them has changed.

    Raises
    ------
    InputError
        If their folder is a link to another place, which may have real photographs.
    """
    confined(table.parent.parent, table.parent.name, table, "")
    mark = table.with_name(_MADE_FROM)
    wanted = f"{provenance.config_hash} {provenance.code_hash} {provenance.input_sha256}\n"
    with storing(mark):
        if mark.is_file() and mark.read_bytes() == wanted.encode():
            return
    with storing(table.parent):
        for path in (
            table,
            record,
            table.with_name(RETIRED),
            table.with_name(f"{table.stem}{UNCHECKED}"),
            *table.parent.glob(f"*{VirtualCamera.suffix}"),
        ):
            path.unlink(missing_ok=True)
        mark.write_text(wanted, encoding="utf-8")


def _earlier_checks(record: Path) -> list[dict]:
    """Return the comparisons with limit switches from earlier sittings, which records of old versions lack.

    Raises
    ------
    InputError
        If the record is not valid JSON, or its comparisons are no list of JSON objects.
    """
    if not record.is_file():
        return []
    try:
        checks = json.loads(record.read_text(encoding="utf-8")).get("position", [])
    except (ValueError, AttributeError):
        checks = None
    if not isinstance(checks, list) or not all(isinstance(check, dict) for check in checks):
        accepted = "the record of a session, or no such file"
        raise InputError(record, "", "something else than such a record", accepted)
    return checks


def _write_record(path: Path, content: Mapping) -> None:
    with storing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(path) as temporary:
            temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def capture_object(
    definition: Object | PhotographedObject,
    target: Target,
    record,
    provenance: Provenance,
    dialogue: Dialogue | None = None,
) -> dict[str, str]:
    """Photograph an object in all its poses, without and with the comb filter; see `photograph`."""
    shots = object_shots(definition, target.camera, target.suffix)
    owner, outlines = f"object {target.name}", _outlines(definition, target)
    return photograph(
        shots, target, definition, record, provenance, owner=owner, dialogue=dialogue, outline_of=outlines
    )


def _outlines(definition: Object | PhotographedObject, target: Target) -> Callable[[Shot], Outline | None]:
    """Return a function from a shot to the object's outline; it returns None for other subjects or without optics."""
    if target.camera.optics is None:
        return lambda shot: None
    known = ProjectedOutlines(definition.shape, target.camera.optics, target.rig.camera_distance_mm)
    return lambda shot: known.of(shot.pose) if shot.subject == "object" else None


def capture_camera(target: Target, record, provenance: Provenance, dialogue: Dialogue | None = None) -> dict[str, str]:
    """Photograph dark frames, the white reference and the chart that calibrate a camera; see `photograph`."""
    assert isinstance(target.camera, Camera)  # its chart and its white reference are photographed
    shots = camera_shots(target.camera, target.suffix)
    return photograph(shots, target, None, record, provenance, owner=f"camera {target.name}", dialogue=dialogue)


def capture_environment(
    definition: EnvironmentDefinition, target: Target, record, provenance: Provenance
) -> dict[str, str]:
    """Photograph a virtual room with an omnidirectional camera; see `photograph`."""
    shots = shots_without_rig(definition, target.camera, target.suffix)
    return photograph(shots, target, definition, record, provenance, owner=f"environment {target.name}", on_rig=False)


def capture_photograph(
    definition: ScenePhotograph, radiance, target: Target, record, provenance: Provenance
) -> dict[str, str]:
    """Photograph a scene from one position with a virtual camera; see `photograph`.

    Parameters
    ----------
    definition : ScenePhotograph
    radiance : path
        File of the radiance in front of the camera, see `irodori.simulation.virtual_rig.scene_view`.
    """
    shots = shots_without_rig(definition, target.camera, target.suffix)
    subject = SceneRadiance(radiance=str(radiance))
    return photograph(shots, target, subject, record, provenance, owner=f"photograph {target.name}", on_rig=False)
