"""The driver of a real camera, against a simulated EOS 40D that is busy, slow, wrong, unplugged or held by another."""

import importlib
import importlib.util
import logging
import sys
from dataclasses import replace

import pytest
import simulated_gphoto2
from made import made
from simulated_gphoto2 import MODEL, Bench, CameraStorageInformation, fault, make_module
from test_camera_contract import DRIVER, RAW, shot

from irodori.capture.camera.gphoto_camera import GphotoCamera
from irodori.capture.rig.devices import CommandError, DeadlineError, DeviceError, LinkError
from irodori.config.models import CameraDriver

ARRIVES_S = 1.5
FILE = (ARRIVES_S, "capt{}.cr2", RAW)


@pytest.fixture
def bench(monkeypatch):
    bench = Bench(delivers=[FILE])
    monkeypatch.setitem(sys.modules, "gphoto2", make_module(bench))
    return bench


def opened(bench, **changes) -> GphotoCamera:
    return GphotoCamera(made(CameraDriver, {**DRIVER, **changes}), sleep=bench.clock.sleep, now=bench.clock.now)


def busy(times: int) -> list:
    return [fault("GP_ERROR_CAMERA_BUSY") for _ in range(times)]


# ---- settings


def test_the_shutter_falls_with_everything_set(bench, tmp_path):
    with opened(bench) as camera:
        camera.capture(shot(0.02), tmp_path / "a.cr2")
        camera.capture(shot(1.3), tmp_path / "b.cr2")
    first, second = bench.releases
    wanted = {"iso": "100", "aperture": "8", "shutterspeed": "1/50", "whitebalance": "Daylight"}
    wanted |= {"imageformat": "RAW", "capturetarget": "Internal RAM", "autopoweroff": "0"}
    assert first.items() >= wanted.items()
    assert second == {**first, "shutterspeed": "1.3"}


def test_a_shot_s_own_iso_and_aperture_go_first(bench, tmp_path):
    with opened(bench) as camera:
        camera.capture(replace(shot(0.02), iso=800.0, f_number=11.0), tmp_path / "a.cr2")
        camera.capture(shot(0.02), tmp_path / "b.cr2")
    assert [(r["iso"], r["aperture"]) for r in bench.releases] == [("800", "11"), ("100", "8")]


def test_a_nikon_s_names_and_its_exact_shutter_are_used(bench, tmp_path):
    for old, new in {"aperture": "f-number", "imageformat": "imagequality"}.items():
        bench.values[new], bench.choices[new] = bench.values.pop(old), bench.choices.pop(old)
    bench.choices |= {"f-number": ["f/5.6", "f/8"], "imagequality": ["NEF (Raw)", "JPEG Fine"]}
    bench.values["shutterspeed2"], bench.choices["shutterspeed2"] = "1/60", ["1/800", "1/60"]
    bench.choices["shutterspeed"] = ["0.0012s", "0.0166s"]
    bench.seen = [("Nikon DSC D750", "usb:001,007")]
    bench.delivers = [(0.5, "DSC_{}.NEF", RAW)]
    with opened(bench, model="Nikon DSC D750", image_format="NEF (Raw)") as camera:
        camera.capture(shot(1 / 800), tmp_path / "a.nef")
        assert camera.suffix == ".nef"
    assert bench.releases[0]["shutterspeed2"] == "1/800" and bench.releases[0]["f-number"] == "f/8"


@pytest.mark.parametrize(
    ("changes", "exposure_s", "setting", "nearest"),
    [
        ({}, 0.03, "shutterspeed", "1/30"),
        ({}, 60.0, "shutterspeed", "30"),
        ({"iso": 125.0}, 0.02, "iso", "100"),
        ({"f_number": 7.1}, 0.02, "aperture", "8"),
        ({"white_balance": "Daylite"}, 0.02, "whitebalance", "Daylight"),
        ({"image_format": "NEF (Raw)"}, 0.02, "imageformat", "RAW"),
    ],
)
def test_a_value_not_on_offer_names_the_nearest_and_all(bench, tmp_path, changes, exposure_s, setting, nearest):
    with opened(bench, **changes) as camera, pytest.raises(CommandError) as caught:
        camera.capture(shot(exposure_s), tmp_path / "a.cr2")
    assert f"{setting} " in str(caught.value) and f"nearest {nearest}; on offer: " in str(caught.value)
    assert all(choice in str(caught.value) for choice in bench.choices[setting])
    assert bench.releases == []


def test_a_setting_that_the_camera_lacks_is_an_error(bench, tmp_path):
    del bench.values["iso"]
    with opened(bench) as camera, pytest.raises(CommandError, match="no setting iso"):
        camera.capture(shot(0.02), tmp_path / "a.cr2")


def test_an_aperture_ring_is_tolerated_only_where_it_is_configured(bench, tmp_path):
    bench.readonly.add("aperture")
    bench.values["aperture"] = "implicit auto"
    with opened(bench) as camera, pytest.raises(CommandError, match=r"aperture 8\.0 cannot be set.*f_number: manual"):
        camera.capture(shot(0.02), tmp_path / "a.cr2")
    bench.held = 0
    with opened(bench, f_number="manual") as camera:
        camera.capture(shot(0.02), tmp_path / "a.cr2")
    assert bench.releases[0]["aperture"] == "implicit auto"


def test_a_read_only_setting_that_stands_right_is_no_fault(bench, tmp_path):
    bench.readonly.add("aperture")
    bench.values["aperture"] = "8"
    with opened(bench) as camera:
        camera.capture(shot(0.02), tmp_path / "a.cr2")


def test_a_camera_that_reports_a_change_late_is_waited_for(bench, tmp_path):
    bench.lag_reads = 3
    with opened(bench) as camera:
        camera.capture(shot(0.02), tmp_path / "a.cr2")
    assert bench.releases[0]["shutterspeed"] == "1/50"


def test_a_camera_that_takes_another_value_is_found_out(bench, tmp_path):
    bench.stubborn = {"shutterspeed": "1/60"}
    with opened(bench) as camera, pytest.raises(CommandError, match="told shutterspeed 1/50, it stands at 1/60"):
        camera.capture(shot(0.02), tmp_path / "a.cr2")
    assert bench.releases == []


# ---- files


@pytest.mark.parametrize("jpeg_first", [True, False])
def test_of_raw_and_jpeg_the_raw_is_kept_and_the_camera_left_empty(bench, tmp_path, jpeg_first):
    jpeg = (ARRIVES_S + (-0.2 if jpeg_first else 0.1), "capt{}.jpg", b"small")
    bench.delivers = [FILE, jpeg, (1.0, "complete", b"")]
    with opened(bench, image_format="RAW + Large Fine JPEG") as camera:
        for name in ("a.cr2", "b.cr2"):
            camera.capture(shot(0.02), tmp_path / name)
            assert (tmp_path / name).read_bytes() == RAW
    assert bench.files == {}


def test_a_file_that_comes_slowly_is_waited_for_up_to_the_deadline(bench, tmp_path):
    bench.delivers = [(30.0 + 0.9 * DRIVER["deadline_s"], "capt{}.cr2", RAW)]
    with opened(bench) as camera:
        camera.capture(shot(30.0), tmp_path / "a.cr2")
    assert (tmp_path / "a.cr2").read_bytes() == RAW


@pytest.mark.parametrize("delivers", [[], [(1.0, "complete", b"")], [(0.1 * n, "unknown", b"") for n in range(999)]])
def test_a_file_that_never_comes_ends_at_the_deadline(bench, tmp_path, delivers):
    bench.delivers = delivers
    with opened(bench) as camera, pytest.raises(DeadlineError, match=r"no file in 20\.02 s"):
        camera.capture(shot(0.02), tmp_path / "a.cr2")
    assert bench.clock.time_s < DRIVER["deadline_s"] + 1.0
    assert list(tmp_path.iterdir()) == []


def test_a_camera_that_delivers_only_jpeg_is_told_apart(bench, tmp_path):
    bench.delivers = [(1.0, "IMG_{}.JPG", b"small")]
    with opened(bench) as camera, pytest.raises(DeadlineError, match=r"only IMG_0001.JPG, is image_format a RAW"):
        camera.capture(shot(0.02), tmp_path / "a.cr2")


def test_a_photograph_that_came_too_late_is_never_taken_for_the_next(bench, tmp_path):
    bench.delivers = [(DRIVER["deadline_s"] + 0.8, "capt{}.cr2", b"the first")]
    with opened(bench) as camera:
        with pytest.raises(DeadlineError):
            camera.capture(shot(0.5), tmp_path / "a.cr2")
        bench.delivers = [(1.0, "capt{}.cr2", b"the second")]
        camera.capture(shot(0.5), tmp_path / "b.cr2")
    assert (tmp_path / "b.cr2").read_bytes() == b"the second"


def test_a_photograph_taken_by_hand_between_two_shots_is_thrown_away(bench, tmp_path):
    with opened(bench) as camera:
        bench.coming = [(0.0, "hand.cr2", b"by hand")]
        camera.capture(shot(0.02), tmp_path / "a.cr2")
    assert (tmp_path / "a.cr2").read_bytes() == RAW and bench.files == {}


def test_an_empty_file_is_refused(bench, tmp_path):
    bench.delivers = [(1.0, "capt{}.cr2", b"")]
    with opened(bench) as camera, pytest.raises(CommandError, match="without content"):
        camera.capture(shot(0.02), tmp_path / "a.cr2")
    assert list(tmp_path.iterdir()) == []


def test_the_suffix_becomes_that_of_the_camera_s_own_file(bench, tmp_path):
    bench.delivers = [(1.0, "IMG_{}.CR3", RAW)]
    with opened(bench) as camera:
        assert camera.suffix == ".cr2"
        camera.capture(shot(0.02), tmp_path / "a.cr2")
        assert camera.suffix == ".cr3"


def test_a_fault_after_the_file_is_in_hand_does_not_cost_it(bench, tmp_path):
    bench.script["file_delete"] = [fault("GP_ERROR_IO")]
    with opened(bench) as camera:
        camera.capture(shot(0.02), tmp_path / "a.cr2")
        camera.capture(shot(0.02), tmp_path / "b.cr2")
    assert len(bench.releases) == 2
    assert (tmp_path / "a.cr2").read_bytes() == (tmp_path / "b.cr2").read_bytes() == RAW


# ---- busy, lost, held


CALLS = ["get_single_config", "set_single_config", "trigger_capture", "wait_for_event", "file_get", "file_delete"]


@pytest.mark.stability(stage="capture", case="camera busy")
@pytest.mark.parametrize("call", CALLS)
def test_a_busy_camera_is_asked_again_at_growing_intervals(bench, tmp_path, call):
    with opened(bench) as camera:
        bench.clock.slept_s.clear()
        bench.script[call] = busy(3)
        camera.capture(shot(0.02), tmp_path / "a.cr2")
    assert (tmp_path / "a.cr2").read_bytes() == RAW
    assert len(bench.releases) == 1 and bench.opened == 1
    waits = bench.clock.slept_s[:3]
    assert waits == sorted(set(waits)) and len(waits) == 3


@pytest.mark.stability(stage="capture", case="camera busy")
def test_a_camera_that_stays_busy_is_given_up_in_gphoto2_s_own_words(bench, tmp_path):
    with opened(bench) as camera:
        bench.script["trigger_capture"] = busy(99)
        with pytest.raises(DeadlineError, match=r"still busy .*4 times.*\[-110\] I/O in progress"):
            camera.capture(shot(0.02), tmp_path / "a.cr2")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("retries", [0, 99])
def test_the_deadline_holds_whatever_the_number_of_retries(bench, tmp_path, retries):
    with opened(bench, retries=retries) as camera:
        begun = bench.clock.time_s
        bench.script["trigger_capture"] = busy(10_000)
        with pytest.raises(DeadlineError):
            camera.capture(shot(0.02), tmp_path / "a.cr2")
    assert bench.clock.time_s - begun <= DRIVER["deadline_s"] + 0.02


@pytest.mark.parametrize("words", ["GP_ERROR_IO", "GP_ERROR_TIMEOUT", "GP_ERROR_IO_USB_FIND", "GP_ERROR_IO_READ"])
@pytest.mark.parametrize("call", CALLS)
def test_a_lost_line_is_opened_again_once_and_the_shot_repeated(bench, tmp_path, call, words):
    with opened(bench) as camera:
        bench.script[call] = [fault(words)]
        camera.capture(shot(0.02), tmp_path / "a.cr2")
        camera.capture(shot(0.02), tmp_path / "b.cr2")
    assert (tmp_path / "a.cr2").read_bytes() == (tmp_path / "b.cr2").read_bytes() == RAW
    assert bench.opened == 2 and bench.held == 0


@pytest.mark.stability(stage="capture", case="camera unplugged in mid-exposure")
def test_a_camera_unplugged_in_mid_exposure_and_back_at_another_port_finishes(bench, tmp_path):
    def unplug():
        bench.seen, bench.coming = [], []
        bench.script["autodetect"] = [None, lambda: setattr(bench, "seen", [(MODEL, "usb:001,009")])]
        raise fault("GP_ERROR_IO")

    with opened(bench) as camera:
        bench.script["wait_for_event"] = [None, unplug]
        camera.capture(shot(0.02), tmp_path / "a.cr2")
    assert (tmp_path / "a.cr2").read_bytes() == RAW and len(bench.releases) == 2


@pytest.mark.stability(stage="capture", case="camera unplugged in mid-exposure")
@pytest.mark.parametrize(
    ("port", "said"), [(None, "not found, is it switched on"), ("usb:001,004", "no such camera at usb")]
)
def test_a_camera_unplugged_for_good_is_reported_and_leaves_nothing(bench, tmp_path, port, said):
    def unplug():
        bench.seen = []
        raise fault("GP_ERROR_IO")

    with opened(bench, port=port) as camera:
        bench.script["wait_for_event"] = [None, unplug]
        with pytest.raises(LinkError, match=rf"{said}.*\(tried 4 times\)"):
            camera.capture(shot(0.02), tmp_path / "a.cr2")
    assert list(tmp_path.iterdir()) == [] and bench.held == 0


@pytest.mark.parametrize("call", CALLS)
def test_a_cable_that_is_pulled_for_four_seconds_costs_no_photograph(bench, tmp_path, call):
    def pull():
        bench.unplug()
        back_s = bench.clock.time_s + 4.0
        # Whoever looks for the camera finds it once the cable is back.
        bench.script["autodetect"] = [lambda: bench.clock.time_s >= back_s and bench.plug()] * 99

    with opened(bench, retries=9) as camera:
        bench.script[call] = [pull]
        camera.capture(shot(0.02), tmp_path / "a.cr2")
        camera.capture(shot(0.02), tmp_path / "b.cr2")
    assert (tmp_path / "a.cr2").read_bytes() == (tmp_path / "b.cr2").read_bytes() == RAW
    assert bench.opened == 2 and bench.held == 0


def test_a_dead_line_is_said_to_be_one(bench, tmp_path):
    with opened(bench) as camera:
        bench.unplug()
        with pytest.raises(LinkError, match=r"not found, is it switched on and plugged in.*\(tried 4 times\)"):
            camera.capture(shot(0.02), tmp_path / "a.cr2")
        with pytest.raises(LinkError, match="not found"):
            camera.status()


@pytest.mark.parametrize(
    ("values", "stores", "said"),
    [
        ({"focusmode": "AI Servo"}, [], r"focuses on its own \(focusmode AI Servo\): switch the lens to manual"),
        ({"focusmode": "Manual"}, [], "may not find focus, or its card may be full"),
        ({}, [CameraStorageInformation(128 | 256, "/store_1", 12, 0)], "no room on its card /store_1"),
    ],
)
def test_why_the_shutter_is_not_released_is_looked_for(bench, tmp_path, values, stores, said):
    bench.values |= values
    bench.stores = stores
    if stores:
        del bench.values["capturetarget"]
    with opened(bench) as camera:
        bench.refuses = True
        with pytest.raises(CommandError, match=rf"not released: .*{said}.*\[-1\]"):
            camera.capture(shot(0.02), tmp_path / "a.cr2")
        assert bench.opened == 1, "the line is up, and is not opened again"
        bench.refuses = False
        camera.capture(shot(0.02), tmp_path / "a.cr2")


def test_everything_that_a_plan_asks_in_vain_is_said_before_it_begins(bench):
    bench.values["focusmode"] = "One Shot"
    shots = [shot(0.02), shot(0.0123), shot(45.0), replace(shot(0.02), iso=250.0)]
    with opened(bench) as camera:
        with pytest.raises(CommandError) as caught:
            camera.prepare(shots)
        for words in (
            "focusmode One Shot",
            "shutterspeed 0.0123 is not",
            "shutterspeed 45.0 is not",
            "iso 250.0 is not",
        ):
            assert words in str(caught.value)
        assert not bench.releases
        bench.values["focusmode"] = "Manual"
        camera.prepare(shots[:1])
        assert bench.values["shutterspeed"] == "1/50" and bench.values["imageformat"] == "RAW"
        bench.values["iso"] = "400"
        bench.readonly.add("iso")
        with pytest.raises(CommandError, match=r"iso 100.0 cannot be set.*mode dial to M"):
            camera.prepare(shots[:1])
        camera.prepare([])


@pytest.mark.parametrize("words", ["GP_ERROR", "GP_ERROR_CAMERA_ERROR", "GP_ERROR_NO_SPACE"])
def test_any_other_error_is_raised_at_once_in_gphoto2_s_own_words(bench, tmp_path, words):
    with opened(bench) as camera:
        bench.script["trigger_capture"] = [fault(words)]
        with pytest.raises(CommandError) as caught:
            camera.capture(shot(0.02), tmp_path / "a.cr2")
        assert str(fault(words)) in str(caught.value)
        assert bench.calls.count("trigger_capture") == 1
        camera.capture(shot(0.02), tmp_path / "a.cr2")


def test_a_camera_held_by_another_program_says_what_to_do(bench):
    bench.held = 1
    with pytest.raises(LinkError, match=r"another program holds the camera.*gvfs.*gio mount -s gphoto2.*-53"):
        opened(bench)
    assert bench.calls.count("init") == 1


def test_a_busy_camera_opens_after_a_while(bench):
    bench.script["init"], bench.script["get_config"] = busy(2), busy(1)
    opened(bench).close()
    assert bench.held == 0


@pytest.mark.parametrize("call", ["get_config", "get_single_config"])
def test_a_camera_that_fails_while_it_is_opened_is_let_go(bench, call):
    bench.script[call] = [fault("GP_ERROR_CAMERA_ERROR")]
    with pytest.raises(CommandError, match="-113"):
        opened(bench)
    assert bench.held == 0


@pytest.mark.parametrize(
    ("seen", "changes", "said"),
    [
        ([], {}, "not found.*sees no camera"),
        ([("Canon EOS 5D", "usb:001,002")], {}, "not found.*Canon EOS 5D at usb:001,002"),
        ([(MODEL, "usb:001,004"), (MODEL, "usb:001,005")], {}, "usb:001,004, usb:001,005; name one as driver.port"),
        ([(MODEL, "usb:001,004")], {"port": "usb:001,005"}, "no such camera at usb:001,005"),
        ([("Canon EOS 5D", "usb:001,005")], {"port": "usb:001,005"}, r"no such camera at usb:001,005; .*\[-105\]"),
        ([(MODEL, "usb:001,004")], {"port": "serial:/dev/ttyS9"}, "no such camera at serial:/dev/ttyS9"),
        ([(MODEL, "usb:001,004")], {"model": "Canon EOS 40D"}, r"no camera 'Canon EOS 40D'; .*Canon EOS 40D \(PTP"),
    ],
)  # fmt: skip
def test_a_camera_that_cannot_be_found_says_what_is_there(bench, seen, changes, said):
    bench.seen = seen
    with pytest.raises(DeviceError, match=said):
        opened(bench, **changes)


def test_of_two_equal_cameras_the_port_names_one(bench, tmp_path):
    bench.seen = [(MODEL, "usb:001,004"), (MODEL, "usb:001,005")]
    with opened(bench, port="usb:001,005") as camera:
        camera.capture(shot(0.02), tmp_path / "a.cr2")


@pytest.mark.stability(stage="capture", case="python-gphoto2 absent")
def test_without_python_gphoto2_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "gphoto2", None)
    with pytest.raises(DeviceError, match=r"pip install -r requirements-rig\.txt"):
        GphotoCamera(made(CameraDriver, DRIVER))


# ---- what the camera says of itself


def test_the_status_reads_the_camera(bench):
    bench.stores = [CameraStorageInformation(128 + 256, "/store_00010001", 2048 * 1024, 150)]
    with opened(bench) as camera:
        status = camera.status()
    assert status["model"] == MODEL and status["serial_number"] == "1234567890"
    assert status["battery"] == "75%" and status["lens"] == "EF50mm f/1.8 II"
    assert status["storage"] == "/store_00010001: 2048 MB free, room for 150 pictures"
    assert "iso 400" in status["settings"] and "exposure_s 1/125" in status["settings"]


def test_the_status_without_a_card_and_with_unknown_figures(bench):
    with opened(bench) as camera:
        assert camera.status()["storage"] == "no card"
        bench.stores = [CameraStorageInformation(0, "/store_1", 0, 0)]
        assert camera.status()["storage"] == "/store_1: not reported"
        bench.script["get_storageinfo"] = [fault("GP_ERROR_NOT_SUPPORTED")]
        assert camera.status()["storage"] == "not reported"


@pytest.mark.parametrize(("level", "warned"), [("Low", True), ("25%", True), ("75%", False), ("unknown", False)])
def test_a_low_battery_is_warned_of_when_the_session_begins(bench, caplog, level, warned):
    bench.values["batterylevel"] = level
    with caplog.at_level(logging.WARNING, logger="irodori"):
        opened(bench).close()
    assert any(f"battery {level}" in message for message in caplog.messages) == warned


# ---- the stand-in against the real library


def test_the_stand_in_has_the_names_of_the_real_module():
    if importlib.util.find_spec("gphoto2") is None:
        pytest.skip("python-gphoto2 is not installed (requirements-rig.txt)")
    real = importlib.import_module("gphoto2")
    standin = make_module(Bench())
    for name, value in vars(standin).items():
        if name.startswith("GP_"):
            assert getattr(real, name) == value, name
        elif isinstance(value, type):
            members = [m for m in dir(value) if not m.startswith("_") and not hasattr(object, m)]
            # Attributes that the stand-in sets for itself are no part of the interface.
            missing = [m for m in members if not hasattr(getattr(real, name), m) and m not in ("models",)]
            assert missing == [], name
    for words, (code, text) in simulated_gphoto2.CODES.items():
        assert real.GPhoto2Error(code).string == text, words
        assert str(real.GPhoto2Error(code)) == str(fault(words))
