"""Small definitions, an instant camera and final checks, shared by the tests of sessions."""

import copy
import functools
import hashlib
import zlib
from pathlib import Path

import numpy as np
from made import made

from irodori.capture.journal import Journal
from irodori.capture.operator import AutoOperator
from irodori.capture.rig.devices import CameraDevice
from irodori.capture.session import Session, take_stock
from irodori.capture.shot_list import object_shots
from irodori.capture.stage import Target, capture_object
from irodori.config.capture_table import Pose, Shot, read_captures
from irodori.config.definitions import load_definitions, read_yaml
from irodori.config.models import Camera, Object, Rig
from irodori.config.parts import PhotographedObject
from irodori.core.store import Provenance
from irodori.ingest.mosaic import decode
from irodori.simulation.virtual_rig.dng_writer import write_dng

ROOT = Path(__file__).resolve().parents[2]
POSES = [{"light_deg": [45.0], "camera_deg": [0.0, 20.0], "tilt_deg": [0.0, 10.0]}]
MADE = Provenance("test", "config", "code")


@functools.cache
def _definitions() -> dict:
    return load_definitions(read_yaml(ROOT / "config/config.yaml"), ROOT).plain()


def definitions(poses=POSES, motion: bool = False) -> tuple[dict, dict, dict]:
    """Return object, camera and rig of the repository with a picture of 120 x 80 pixels and few poses."""
    found = copy.deepcopy(_definitions())
    definition, camera = found["objects"]["tile-plate"], found["cameras"]["d5100-comb"]
    rig = found["rigs"]["virtual"]
    definition["poses"] = poses
    camera["optics"].update(width_px=120, height_px=80, pixel_pitch_um=66.0, principal_point_px=[60.0, 40.0])
    rig["light"]["spectrum"] = str(ROOT / rig["light"]["spectrum"])  # some sessions run in folders of their own
    if not motion:
        del rig["motion"]
    return definition, camera, rig


def target(folder: Path, motion: bool = False, **changes) -> tuple[Object, Target]:
    """Return an object and a target whose table stands in a folder."""
    definition, camera, rig = definitions(motion=motion, **changes)
    return made(Object, definition), Target(
        "plate", made(Camera, camera), made(Rig, rig), "virtual", folder / "captures.csv"
    )


def shots(count: int, exposure_s: float = 0.02, **settings) -> list[Shot]:
    """Return photographs without and with the filter, their order unlike that of their names."""
    poses = [Pose(45.0, float(count - i)) for i in range((count + 1) // 2)]
    pairs = [(pose, state) for pose in poses for state in ("out", "in")]
    return [Shot(f"{p.name}-{s}.dng", "object", p, s, exposure_s, **settings) for p, s in pairs][:count]


class QuickCamera(CameraDevice):
    """Writes tiny DNG files of a light square with the noise of their name; does wrong what ``faults`` holds, in turn.

    A fault is an exception to raise, ``broken`` for half a file, or a number for another exposure time in the tags.
    """

    suffix = ".dng"
    is_virtual = True

    def __init__(self, faults=()) -> None:
        self.faults, self.taken = list(faults), []

    def capture(self, shot, path):
        self.taken.append(shot.file)
        fault = self.faults.pop(0) if self.faults else None
        if isinstance(fault, BaseException):
            raise fault
        rng = np.random.default_rng(zlib.crc32(shot.file.encode()))
        mosaic = rng.integers(590, 610, (24, 32)).astype(np.uint16)
        if shot.role != "dark":  # a light square on a dark ground, weaker behind the filter
            mosaic[8:16, 10:22] += round((1e5 if shot.filter == "in" else 3e5) * min(shot.exposure_s, 0.05))
        seconds = fault if isinstance(fault, float) else shot.exposure_s
        write_dng(path, mosaic, black_level=600, white_level=16383, exposure_s=seconds, model="quick", iso=shot.iso)
        if fault == "broken":
            path.write_bytes(path.read_bytes()[:500])

    def status(self):
        return {"model": "quick"}

    def close(self):
        pass


def hold(folder: Path, planned: list[Shot], camera: CameraDevice | None = None, rig=None):
    """Hold a session in a folder, or continue one, and return what it did."""
    journal = Journal(folder / "captures.csv")
    tally = take_stock(journal, planned)
    operator = AutoOperator(lambda settings: None)
    return Session(camera or QuickCamera(), operator, journal, rig, tally).run(planned, "test")


def contents(folder: Path) -> dict[str, bytes]:
    """Return what a folder holds, the record of the session aside: it says when and how, which differs."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "session.json"}


def assert_whole(folder: Path, planned: list[Shot]) -> None:
    """Fail unless the table lists the plan in its order, and each file decodes and is the one that the table means."""
    table = folder / "captures.csv"
    assert read_captures(table, folder) == planned
    digests = [line.rsplit(",", 1)[1] for line in table.read_text().splitlines()[1:]]
    for shot, digest in zip(planned, digests, strict=True):
        assert hashlib.sha256((folder / shot.file).read_bytes()).hexdigest() == digest
        assert abs(decode(folder / shot.file).exposure_s / shot.exposure_s - 1) < 1e-3
    left = [name for name in contents(folder) if "part" in name]
    assert not left, left


def capture(folder: Path, motion: bool = False, **changes) -> list[Shot]:
    """Photograph the plate into a folder, or go on with it, and return the plan in its order."""
    definition, aim = target(folder, motion, **changes)
    capture_object(made(Object | PhotographedObject, definition), aim, folder / "session.json", MADE)
    return aim.ordered(object_shots(made(Object | PhotographedObject, definition), aim.camera, ".dng"))
