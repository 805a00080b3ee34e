"""A session: stopped, with a camera or a rig at fault, with a person in it; nothing is lost or doubled."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import patience
import pytest
import yaml
from made import made
from motion_rigs import wait_until_still
from sessions import (
    MADE,
    ROOT,
    QuickCamera,
    assert_whole,
    capture,
    contents,
    definitions,
    hold,
    shots,
    target,
)
from virtual_time import FaultyBench

from irodori.capture import stage
from irodori.capture.journal import Journal
from irodori.capture.operator import AutoOperator, Operator
from irodori.capture.rig.connect import open_rig, true_position_deg
from irodori.capture.rig.devices import DeviceError, LimitError
from irodori.capture.rig.homings import Homings
from irodori.capture.session import Session, take_stock
from irodori.capture.shot_list import object_shots
from irodori.capture.stage import Target, capture_camera, capture_environment, capture_object, photograph
from irodori.config.capture_table import Pose, Shot, read_captures
from irodori.config.models import Camera, EnvironmentDefinition, Object, Rig
from irodori.config.parts import PhotographedObject, SceneRadiance
from irodori.core.errors import InputError

# ---- what a session leaves


def test_a_session_photographs_all_and_a_second_one_nothing(tmp_path, monkeypatch):
    planned = capture(tmp_path, motion=True)
    assert_whole(tmp_path, planned)
    record = json.loads((tmp_path / "session.json").read_text())
    assert record["photographs"] == record["session"]["taken"] == len(planned) == 8
    position = [{"photographs": 8, "lost_deg": {"camera_deg": 0.0, "turn_deg": 0.0}}]
    assert record["position"] == position
    before = contents(tmp_path)
    times = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.dng")} | {
        tmp_path / "captures.csv": (tmp_path / "captures.csv").stat().st_mtime_ns
    }

    def refuse(rig):
        raise AssertionError("a rig was opened though nothing is missing")

    monkeypatch.setattr(stage, "open_rig", refuse)
    capture(tmp_path, motion=True)
    record = json.loads((tmp_path / "session.json").read_text())
    assert (record["session"]["taken"], record["session"]["kept"]) == (0, 8)
    assert record["position"] == position, "what the switches showed stays said"
    assert contents(tmp_path) == before
    assert all(path.stat().st_mtime_ns == then for path, then in times.items())


def test_a_camera_and_an_environment_are_photographed_too(tmp_path):
    _, camera, rig = definitions()
    aim = Target("small", made(Camera, camera), made(Rig, rig), "virtual", tmp_path / "camera/captures.csv")
    capture_camera(aim, tmp_path / "camera/session.json", MADE)
    record = json.loads((tmp_path / "camera/session.json").read_text())
    # The cap goes on once, and the white reference and the chart are put in place with each filter state.
    assert record["photographs"] == 20 and record["session"]["operator_steps"] == 5
    room = yaml.safe_load((ROOT / "config/environments/classroom.yaml").read_text()) | {
        "image": {"width": 60, "height": 30}
    }
    aim = Target("room", made(Camera, camera), made(Rig, rig), table=tmp_path / "room/captures.csv")
    capture_environment(made(EnvironmentDefinition, room), aim, tmp_path / "room/session.json", MADE)
    # The panorama and the two charts, each in two brackets of two.
    assert json.loads((tmp_path / "room/session.json").read_text())["session"]["taken"] == 12
    roles = {shot.subject for shot in read_captures(tmp_path / "room/captures.csv")}
    assert roles == {"environment", "room-chart-desk", "room-chart-window"}


def test_a_virtual_session_of_another_definition_begins_anew(tmp_path):
    definition, aim = target(tmp_path)
    capture_object(made(Object | PhotographedObject, definition), aim, tmp_path / "session.json", MADE)
    other = stage.Provenance("test", "another", "code")
    capture_object(made(Object | PhotographedObject, definition), aim, tmp_path / "session.json", other)
    assert json.loads((tmp_path / "session.json").read_text())["session"]["taken"] == 8


# ---- a camera at fault


def test_a_camera_that_delivers_a_broken_file_twice_is_asked_a_third_time(tmp_path):
    planned = shots(3)
    camera = QuickCamera([None, "broken", "broken"])
    assert hold(tmp_path, planned, camera).retries == 2
    assert camera.taken == [planned[0].file, *[planned[1].file] * 3, planned[2].file]
    assert_whole(tmp_path, planned)


@pytest.mark.parametrize(("fault", "said"), [("broken", "LibRaw"), (0.5, "exposure time: found 0.5 s; accepted: 0.02")])
def test_a_camera_that_never_delivers_what_it_should_stops_the_session_with_the_name_of_the_file(tmp_path, fault, said):
    planned = shots(3)
    camera = QuickCamera([None, fault, fault, fault])
    with pytest.raises(InputError, match=re.escape(said)) as caught:
        hold(tmp_path, planned, camera)
    assert caught.value.file == str(tmp_path / planned[1].file)
    assert len(camera.taken) == 4
    assert sorted(contents(tmp_path)) == sorted(["captures.csv", planned[0].file])
    hold(tmp_path, planned)
    assert_whole(tmp_path, planned)


def test_an_exposure_that_the_camera_rounds_is_taken_for_the_one_asked_for(tmp_path):
    planned = shots(1, exposure_s=0.02)
    assert hold(tmp_path, planned, QuickCamera([0.0204])).retries == 0


# ---- a rig at fault


@pytest.fixture
def rig():
    with open_rig(made(Rig, definitions(motion=True)[2])) as opened:
        opened.home()
        yield opened


def stands_still(rig, seconds: float = 0.4) -> dict[str, float]:
    """Return where the axes of a rig truly stand, and fail where they still move."""
    before = true_position_deg(rig)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        assert true_position_deg(rig) == before
        time.sleep(0.05)
    assert not rig.simulator.snapshot()["moving"]
    return before


@pytest.mark.parametrize("fault", [DeviceError("the battery is empty"), KeyboardInterrupt(), RuntimeError("a bug")])
def test_whatever_breaks_a_session_off_leaves_the_rig_stopped_and_the_photographs_in_place(tmp_path, fault):
    planned = [Shot(f"{i}.dng", "object", Pose(45.0, 20.0 * i), "out", 0.02) for i in range(4)]
    with pytest.raises(type(fault)), open_rig(made(Rig, definitions(motion=True)[2])) as opened:
        try:
            hold(tmp_path, planned, QuickCamera([None, None, fault]), opened)
        finally:
            assert stands_still(opened)["camera_deg"] == pytest.approx(40.0, abs=0.01)
    assert sorted(contents(tmp_path)) == ["0.dng", "1.dng", "captures-unchecked.txt", "captures.csv"]
    assert_whole(tmp_path, planned[:2])


@pytest.mark.parametrize("fault", ["move 0.5 alarm 1", "move 0.5 reset", "move 0.5 hangup 0.5"])
def test_a_rig_that_fails_in_mid_move_ends_the_session_and_the_next_one_goes_on(tmp_path, monkeypatch, fault):
    """Photographs before the alarm of a switch are in doubt."""
    planned = [Shot(f"{i}.dng", "object", Pose(45.0, 40.0 * i), "out", 0.02) for i in range(4)]

    class Faulty(QuickCamera):
        def capture(self, shot, path):
            super().capture(shot, path)
            if len(self.taken) == 2:
                bench.fault(fault)

    definition = definitions(motion=True)[2]
    definition["motion"] = {**definition["motion"], "timeout_s": 0.5}
    bench = FaultyBench(made(Rig, definition), monkeypatch)
    homings = Homings()
    with pytest.raises(DeviceError), open_rig(made(Rig, definition)) as opened:
        opened.homings = homings
        try:
            hold(tmp_path, planned, Faulty(), opened)
        finally:
            position = wait_until_still(bench)["position"]
            bench.sleep(0.4)
            assert bench.true_position() == position
    assert_whole(tmp_path, planned[:2])
    patience.until(lambda: bench.faulty.plugged)
    definition["motion"]["timeout_s"] = 3.0  # only the fault is to be found soon
    with open_rig(made(Rig, definition)) as opened:
        camera, opened.homings = QuickCamera(), homings
        hold(tmp_path, planned, camera, opened)
    assert camera.taken == [shot.file for shot in (planned if "alarm" in fault else planned[2:])]
    assert len(Journal(tmp_path / "captures.csv").unchecked) == (2 if "reset" in fault else 0)
    assert_whole(tmp_path, planned)


def test_a_plan_out_of_reach_is_refused_before_anything_moves(tmp_path):
    planned = [*shots(2), Shot("far.dng", "object", Pose(45.0, 150.0), "out", 0.02)]
    with open_rig(made(Rig, definitions(motion=True)[2])) as opened:
        before = true_position_deg(opened)
        camera = QuickCamera()
        with pytest.raises(LimitError, match="camera_deg 150: out of reach"):
            hold(tmp_path, planned, camera, opened)
        assert true_position_deg(opened) == before and not camera.taken


def test_the_motors_stand_before_the_hand_is_asked_for(tmp_path, rig):
    """Nobody has a hand at the lens while the arm swings, and the camera looks once both are done."""
    events = []

    class Hand(Operator):
        def ask(self, step):
            events.append(("hand", round(stands_still(rig, 0.05)["camera_deg"]), step.new))

        def confirm(self, request):
            raise AssertionError(request)

    class Eye(QuickCamera):
        def capture(self, shot, path):
            events.append(("photograph", round(true_position_deg(rig)["camera_deg"]), shot.filter))
            super().capture(shot, path)

    planned = [Shot(f"{i}-{s}.dng", "object", Pose(45.0, 30.0 * i), s, 0.02) for i in (1, 2) for s in ("out", "in")]
    journal = Journal(tmp_path / "captures.csv")
    Session(Eye(), Hand(), journal, rig, take_stock(journal, planned)).run(planned, "test")
    assert [(kind, angle) for kind, angle, _ in events] == [
        ("hand", 30), ("photograph", 30), ("hand", 30), ("photograph", 30),
        ("hand", 60), ("photograph", 60), ("hand", 60), ("photograph", 60),
    ]  # fmt: skip


# ---- the person at the bench


@pytest.mark.parametrize("motion", [False, True])
@pytest.mark.parametrize("kind", ["object", "camera"])
def test_the_person_is_asked_as_often_as_the_estimate_says(tmp_path, motion, kind):
    definition, camera, rig = definitions(
        poses=[{"light_deg": [45.0, 60.0], "camera_deg": [0.0, 20.0], "tilt_deg": [0.0, 10.0]}], motion=motion
    )
    rig["operator"] = "prompt"
    aim = Target("plate", made(Camera, camera), made(Rig, rig))
    taken = (
        object_shots(made(Object | PhotographedObject, definition), made(Camera, camera), ".dng")
        if kind == "object"
        else stage.camera_shots(made(Camera, camera), ".dng")
    )
    planned = aim.ordered(taken)
    asked = []

    class Counting(AutoOperator):
        def ask(self, step):
            asked.append(str(step))

    def hold_on(rig):
        journal = Journal(tmp_path / "captures.csv")
        tally = take_stock(journal, planned)
        return Session(QuickCamera(), Counting(None), journal, rig, tally).run(planned, "test")

    if motion:
        with open_rig(made(Rig, rig)) as opened:
            tally = hold_on(opened)
    else:
        tally = hold_on(None)
    assert tally.operator_steps == len(asked) == aim.estimate(planned).steps


def python(folder: Path, code: str, **how) -> subprocess.Popen:
    """Start a process that runs a session of these tests in a folder."""
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests"), str(ROOT / "tests/rig")])
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-c", code, str(folder)],
        env={**os.environ, "PYTHONPATH": path}, cwd=folder, text=True, **how,
    )  # fmt: skip


ASKING = """
import sys
from dataclasses import replace
from pathlib import Path
from sessions import MADE, target
from irodori.capture.stage import capture_object
folder = Path(sys.argv[1])
definition, aim = target(folder, poses=[{"light_deg": [45.0, 60.0], "camera_deg": [0.0]}])
aim = replace(aim, rig=replace(aim.rig, operator="%s"))
capture_object(definition, aim, folder / "session.json", MADE)
"""


def expected_steps() -> int:
    definition, camera, rig = definitions(poses=[{"light_deg": [45.0, 60.0], "camera_deg": [0.0]}])
    rig["operator"] = "file"
    aim = Target("plate", made(Camera, camera), made(Rig, rig))
    return aim.estimate(
        aim.ordered(object_shots(made(Object | PhotographedObject, definition), made(Camera, camera), ".dng"))
    ).steps


@pytest.mark.heavy
def test_a_session_waits_for_the_file_that_its_message_names(tmp_path):
    with python(tmp_path, ASKING % "file", stderr=subprocess.PIPE) as run:
        questions = []
        for line in run.stderr:
            if found := re.search(r"When done: touch (\S+)", line):
                questions.append(line)
                Path(found[1]).touch()
    assert run.returncode == 0
    assert len(questions) == expected_steps() == 4
    assert "set the light to 45.0°" in questions[0] and "filter" in questions[1]
    record = json.loads((tmp_path / "session.json").read_text())
    assert record["session"]["operator_steps"] == 4 and record["session"]["taken"] == 4
    assert list((tmp_path / "results/rig/virtual").iterdir()) == []


def test_a_session_asks_on_a_terminal_and_q_stops_it(tmp_path):
    import pty

    def answer(text: bytes, times: int) -> tuple[int, str]:
        controller, terminal = pty.openpty()
        said = b""
        with python(tmp_path, ASKING % "prompt", stdin=terminal, stdout=terminal, stderr=terminal) as run:
            os.close(terminal)
            try:
                while chunk := os.read(controller, 4096):
                    said += chunk
                    if said.count(b"q to stop: ") > times:
                        times += 1
                        os.write(controller, text)
            except OSError:  # the other end is closed
                pass
        os.close(controller)
        return run.returncode, said.decode()

    code, said = answer(b"q\n", 0)
    assert code != 0 and "stopped by the person at the bench" in said
    assert not list(tmp_path.glob("*.dng"))
    code, said = answer(b"\n", 0)
    assert code == 0, said
    assert said.count("q to stop: ") == expected_steps()
    assert json.loads((tmp_path / "session.json").read_text())["session"]["taken"] == 4


# ---- signals


INTERRUPTED = """
import sys, threading, time
from dataclasses import replace
from irodori.config.models import SimulatorOptions
from pathlib import Path
from sessions import MADE, definitions, target
from irodori.capture import stage
folder = Path(sys.argv[1])
definition, aim = target(folder, motion=True, poses=[{"light_deg": [45.0], "camera_deg": [0.0, 70.0, 140.0]}])
slow = SimulatorOptions(time_scale=8.0, seed=0, homing_rms_units=0.0)
aim = replace(aim, rig=replace(aim.rig, motion=replace(aim.rig.motion, simulator=slow, timeout_s=60.0)))
moves = []

def tell(simulator):
    while not simulator.snapshot()["moving"]:
        time.sleep(0.01)
    print("under way", flush=True)

def kept_open(rig, name):
    opened = real(rig)
    class Watched:
        def __enter__(self):
            self.rig = opened.__enter__()
            move = self.rig.move
            def noted(targets):
                print("moving", flush=True)
                moves.append(targets)
                if len(moves) == 3:
                    self.rig.simulator.pace(0.2)  # so that the signal meets it on its way
                    threading.Thread(target=tell, args=(self.rig.simulator,), daemon=True).start()
                move(targets)
            self.rig.move = noted
            return self.rig
        def __exit__(self, kind, error, trace):
            self.rig.stop()
            for _ in range(5):
                seen = self.rig.simulator.snapshot()
                print("after", kind.__name__ if kind else None, seen["moving"], seen["position"]["X"], flush=True)
                time.sleep(0.05)
            return opened.__exit__(kind, error, trace)
    return Watched()

real, stage.open_rig = stage.open_rig, kept_open
stage.capture_object(definition, aim, folder / "session.json", MADE)
"""


@pytest.mark.parametrize(
    "number", [signal.SIGTERM, *(pytest.param(s, marks=pytest.mark.heavy) for s in (signal.SIGINT, signal.SIGHUP))]
)
def test_an_interrupted_session_leaves_the_rig_stopped_and_the_table_whole(tmp_path, number):
    """Ctrl-C, the end of a batch job, and a lost ssh connection, each while the arm swings."""
    with python(tmp_path, INTERRUPTED, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as run:
        # For the second photograph of a pose nothing moves; for the third the arm swings 70 degrees.
        said = [run.stdout.readline() for _ in range(4)]
        assert said == ["moving\n"] * 3 + ["under way\n"], run.stderr.read()
        run.send_signal(number)
        said = run.stdout.read()
        patience.wait(run)
    after = [line.split() for line in said.splitlines() if line.startswith("after")]
    assert len(after) == 5, said
    assert len({(moving, place) for _, _, moving, place in after}) == 1 and after[0][2] == "False"
    assert after[0][1] == ("KeyboardInterrupt" if number == signal.SIGINT else "SystemExit")
    assert run.returncode in ((-signal.SIGINT, 1) if number == signal.SIGINT else (128 + number,))
    assert not [name for name in contents(tmp_path) if "part" in name]
    taken = (tmp_path / "captures.csv").read_text().splitlines()[1:]
    assert len(taken) == len(list(tmp_path.glob("*.dng"))) == 2


def test_a_session_outside_the_main_thread_leaves_signals_alone(tmp_path):
    definition, aim = target(tmp_path)
    before = signal.getsignal(signal.SIGTERM)
    thread = threading.Thread(target=capture_object, args=(definition, aim, tmp_path / "session.json", MADE))
    thread.start()
    thread.join()
    assert (tmp_path / "session.json").exists()
    assert signal.getsignal(signal.SIGTERM) is before


def test_the_record_appears_only_when_the_session_is_complete(tmp_path, monkeypatch):
    definition, aim = target(tmp_path)
    planned = object_shots(made(Object | PhotographedObject, definition), made(Camera, aim.camera), ".dng")
    whole = stage.VirtualCamera.capture

    def failing(self, shot, path):
        if shot.file == aim.ordered(planned)[5].file:
            raise DeviceError("the shutter is stuck")
        whole(self, shot, path)

    monkeypatch.setattr(stage.VirtualCamera, "capture", failing)
    with pytest.raises(DeviceError, match="stuck"):
        photograph(
            planned,
            aim,
            made(Object | PhotographedObject | EnvironmentDefinition | SceneRadiance, definition),
            tmp_path / "session.json",
            MADE,
            owner="object plate",
        )
    assert not (tmp_path / "session.json").exists()
    monkeypatch.undo()
    photograph(
        planned,
        aim,
        made(Object | PhotographedObject | EnvironmentDefinition | SceneRadiance, definition),
        tmp_path / "session.json",
        MADE,
        owner="object plate",
    )
    record = json.loads((tmp_path / "session.json").read_text())
    assert (record["session"]["kept"], record["session"]["taken"]) == (5, 3)
