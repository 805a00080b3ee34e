"""Contract of every camera driver.

Another camera joins by a line in CASES: its name and a function that takes a pytest fixture request and returns a Case.
"""

import importlib.util
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from made import made
from simulated_gphoto2 import MODEL, Bench, make_module

from irodori.capture.camera.gphoto_camera import GphotoCamera
from irodori.capture.camera.gphoto_settings import WIDGETS
from irodori.capture.rig.devices import CameraDevice, DeviceError
from irodori.config.capture_table import Pose, Shot
from irodori.config.models import CameraDriver

RAW = bytes(range(256)) * 64
STATUS_KEYS = {"model", "battery", "storage", "settings"}
DRIVER = {
    "kind": "gphoto2",
    "model": MODEL,
    "iso": 100.0,
    "f_number": 8.0,
    "white_balance": "Daylight",
    "image_format": "RAW",
    "deadline_s": 20.0,
    "retries": 3,
}


@dataclass
class Case:
    """A camera, a shot that it can take, one that it must refuse, and what a whole file looks like."""

    camera: CameraDevice
    good: Shot
    bad: Shot
    is_whole: Callable[[Path], bool]


def shot(exposure_s: float) -> Shot:
    return Shot("", "object", Pose(45.0, 0.0), "out", exposure_s)


def simulated_gphoto(request) -> Case:
    bench = Bench(delivers=[(1.5, "capt{}.cr2", RAW)])
    request.getfixturevalue("monkeypatch").setitem(sys.modules, "gphoto2", make_module(bench))
    camera = GphotoCamera(made(CameraDriver, DRIVER), sleep=bench.clock.sleep, now=bench.clock.now)
    return Case(camera, shot(0.02), shot(45.0), lambda path: path.read_bytes() == RAW)


class NikonOfLibgphoto2(GphotoCamera):
    """The PTP camera that libgphoto2 simulates: it has few settings and delivers only files named JPG."""

    widgets = {name: WIDGETS[name] for name in ("f_number", "exposure_s", "capture_target")}  # noqa: RUF012
    raw_suffixes = (".jpg",)


def real_libgphoto2(request) -> Case:
    """The real python-gphoto2 and libgphoto2, with its PTP protocol, against the camera that it simulates."""
    found = importlib.util.find_spec("gphoto2")
    if found is None:
        pytest.skip("python-gphoto2 is not installed (requirements-rig.txt)")
    ports = Path(found.origin).parent / "libgphoto2" / "vusb"
    if not ports.is_dir():
        pytest.skip("this python-gphoto2 comes without libgphoto2's simulated camera")
    monkeypatch, folder = (request.getfixturevalue(name) for name in ("monkeypatch", "tmp_path_factory"))
    pictures = folder.mktemp("pictures")
    (pictures / "picture.jpg").write_bytes(RAW)
    monkeypatch.setenv("VCAMERADIR", os.fspath(pictures))
    import gphoto2  # noqa: F401, reads the environment; sets IOLIBS itself only where it was not imported before

    monkeypatch.setenv("IOLIBS", os.fspath(ports))
    camera = NikonOfLibgphoto2(made(CameraDriver, {**DRIVER, "model": "Nikon DSC D750", "deadline_s": 5.0}))
    return Case(camera, shot(0.02), shot(45.0), lambda path: path.read_bytes() == RAW)


CASES = {
    "simulated EOS 40D": simulated_gphoto,
    "libgphoto2": real_libgphoto2,
}


@pytest.fixture(params=CASES)
def case(request):
    made = CASES[request.param](request)
    yield made
    made.camera.close()


def test_a_photograph_is_stored_whole_under_exactly_its_path(case, tmp_path):
    for name in ("one" + case.camera.suffix, "two" + case.camera.suffix):
        case.camera.capture(case.good, tmp_path / name)
        assert case.is_whole(tmp_path / name)
    assert sorted(p.name.split(".")[0] for p in tmp_path.iterdir()) == ["one", "two"]


def test_a_photograph_takes_the_place_of_a_broken_file(case, tmp_path):
    path = tmp_path / "shot.raw"
    path.write_bytes(b"half a photograph")
    case.camera.capture(case.good, path)
    assert case.is_whole(path)


def test_a_refused_shot_leaves_nothing_behind_and_the_next_one_works(case, tmp_path):
    with pytest.raises(DeviceError):
        case.camera.capture(case.bad, tmp_path / "shot.raw")
    assert list(tmp_path.iterdir()) == []
    case.camera.capture(case.good, tmp_path / "shot.raw")
    assert case.is_whole(tmp_path / "shot.raw")


def test_a_folder_that_is_not_there_leaves_nothing_behind(case, tmp_path):
    with pytest.raises(OSError):
        case.camera.capture(case.good, tmp_path / "missing" / "shot.raw")
    assert list(tmp_path.iterdir()) == []


def test_the_status_says_in_words_what_the_bench_must_know(case):
    status = case.camera.status()
    assert status.keys() >= STATUS_KEYS
    assert all(isinstance(words, str) and words for words in status.values())


def test_the_suffix_is_the_end_of_a_file_name(case):
    assert case.camera.suffix.startswith(".") and len(case.camera.suffix) > 1


def test_closing_twice_is_harmless_and_a_closed_camera_takes_nothing(case, tmp_path):
    with case.camera as camera:
        camera.close()
        camera.close()
    with pytest.raises(DeviceError):
        case.camera.capture(case.good, tmp_path / "shot.raw")
    assert list(tmp_path.iterdir()) == []
