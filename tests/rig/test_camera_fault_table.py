"""The camera's table of faults: fault, command, camera; what the person is told, and how long after the fault.

On a clock that only waiting moves, with the deadline of a real camera. ``-s`` prints the table.
"""

import sys

import pytest
from made import made
from simulated_gphoto2 import Bench, CameraStorageInformation, fault, make_module
from test_camera_contract import DRIVER, RAW, shot

from irodori.capture.camera.gphoto_camera import GphotoCamera
from irodori.capture.rig.devices import DeviceError
from irodori.config.models import CameraDriver

DEADLINE_S = DRIVER["deadline_s"]
NIKON = "Nikon DSC D750"
COMMANDS = {
    "prepare": lambda camera, folder: camera.prepare([shot(0.02)]),
    "shoot": lambda camera, folder: camera.capture(shot(0.02), folder / "a.raw"),
    "status": lambda camera, folder: camera.status(),
}


def eos() -> tuple[Bench, dict]:
    return Bench(delivers=[(0.5, "capt{}.cr2", RAW)]), {}


def nikon() -> tuple[Bench, dict]:
    bench = Bench(delivers=[(0.5, "DSC_{}.NEF", RAW)], seen=[(NIKON, "usb:001,007")])
    for old, new in {"aperture": "f-number", "imageformat": "imagequality"}.items():
        bench.values[new], bench.choices[new] = bench.values.pop(old), bench.choices.pop(old)
    bench.choices |= {"f-number": ["f/5.6", "f/8"], "imagequality": ["NEF (Raw)", "JPEG Fine"]}
    return bench, {"model": NIKON, "image_format": "NEF (Raw)"}


CAMERAS = {"EOS 40D": eos, "D750": nikon}


def pull_for_four_seconds(bench: Bench) -> None:
    seen = bench.seen
    bench.unplug()
    back_s = bench.clock.time_s + 4.0
    bench.script["autodetect"] = [lambda: bench.clock.time_s >= back_s and setattr(bench, "seen", seen)] * 99


def switch_to_card(bench: Bench, images: int) -> None:
    del bench.values["capturetarget"]
    bench.stores = [CameraStorageInformation(128 | 256, "/store_1", 1024 * images, images)]


def refuse(bench: Bench, **values) -> None:
    bench.values |= values
    bench.refuses = True


# Fault: what happens, by command what it ends in (None where it is done all the same), the longest time to it, s.
FAULTS = {
    "busy twice": (
        lambda b: b.script.update({"get_single_config": [fault("GP_ERROR_CAMERA_BUSY")] * 2}),
        {"prepare": None, "shoot": None, "status": None},
        5.0,
    ),
    "busy for ever": (
        lambda b: b.script.update({"get_single_config": [fault("GP_ERROR_CAMERA_BUSY")] * 999}),
        dict.fromkeys(COMMANDS, "I/O in progress"),
        DEADLINE_S,
    ),
    "cable pulled for 4 s": (pull_for_four_seconds, {"prepare": None, "shoot": None, "status": None}, 8.0),
    "cable pulled for good": (
        lambda b: b.unplug(),
        dict.fromkeys(COMMANDS, "not found, is it switched on and plugged in"),
        DEADLINE_S,
    ),
    "autofocus on": (
        lambda b: refuse(b, focusmode="One Shot"),
        {"prepare": "focuses on its own", "shoot": "focuses on its own (focusmode One Shot)", "status": None},
        1.0,
    ),
    "card full": (
        lambda b: (switch_to_card(b, 0), refuse(b)),
        {"prepare": "no room on its card", "shoot": "no room on its card", "status": None},
        1.0,
    ),
    "only JPEG comes": (
        lambda b: setattr(b, "delivers", [(0.5, "capt{}.jpg", RAW)]),
        {"prepare": None, "shoot": "is image_format a RAW format", "status": None},
        DEADLINE_S + 1.0,
    ),
    "no file comes": (
        lambda b: setattr(b, "delivers", []),
        {"prepare": None, "shoot": "no file in 20.02 s after the shutter", "status": None},
        DEADLINE_S + 1.0,
    ),
}
#: What stands wrong before the session opens the camera.
BEFORE = ("autofocus on", "card full")


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("name", FAULTS)
def test_the_person_is_told_the_cause_in_time(monkeypatch, tmp_path, name, command, camera):
    bench, changes = CAMERAS[camera]()
    monkeypatch.setitem(sys.modules, "gphoto2", make_module(bench))
    act, said, within_s = FAULTS[name]
    if name in BEFORE:
        act(bench)
    definition = made(CameraDriver, {**DRIVER, "retries": 9, **changes})
    with GphotoCamera(definition, sleep=bench.clock.sleep, now=bench.clock.now) as device:
        began_s = bench.clock.time_s
        if name not in BEFORE:
            act(bench)
        words = ""
        try:
            COMMANDS[command](device, tmp_path)
        except DeviceError as error:
            words = str(error)
        took_s = bench.clock.time_s - began_s
    print(f"| {name} | {command} | {camera} | {words or 'done'} | {took_s:.1f} s |")
    assert took_s <= within_s
    assert (said[command] or "") in words and bool(words) == bool(said[command]), words
    assert (tmp_path / "a.raw").exists() == (command == "shoot" and not words)
