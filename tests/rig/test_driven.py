"""A driven rig from its files to its photographs: Grbl board, person and camera simulated behind the real drivers."""

import csv
import json
import os
import re
import sys
import threading
from pathlib import Path

import pytest
from driven import CAMERA, OBJECT, Studio, edit, project
from made import made
from simulated_gphoto2 import fault, make_module

from irodori.capture import operator, stage
from irodori.capture.camera.gphoto_camera import GphotoCamera
from irodori.capture.command import main
from irodori.capture.operator import Operator
from irodori.capture.rig.connect import start_simulator
from irodori.capture.rig.serial_link import SerialLink
from irodori.capture.shot_list import object_shots
from irodori.config.capture_table import read_captures
from irodori.config.definitions import load_one
from irodori.config.models import Camera, Object, Rig
from irodori.config.parts import PhotographedObject
from irodori.ingest.mosaic import decode


class Person(Operator):
    """Does what the sentences say, and remembers them."""

    def __init__(self):
        self.asked, self.stops_at = [], None

    def confirm(self, request):
        self.asked.append(request)
        if len(self.asked) == self.stops_at:
            raise operator.OperatorAbort(f"stopped by the person at the bench, before: {request}")


@pytest.fixture
def studio(monkeypatch):
    """Return the simulated camera that python-gphoto2 finds."""
    studio = Studio()
    monkeypatch.setitem(sys.modules, "gphoto2", make_module(studio.bench))
    monkeypatch.setattr(GphotoCamera, "capture", studio.following(GphotoCamera.capture))
    return studio


@pytest.fixture
def person(monkeypatch):
    person = Person()
    monkeypatch.setattr(stage, "make_operator", lambda *_, **__: person)
    return person


@pytest.fixture
def bench(tmp_path, monkeypatch):
    monkeypatch.chdir(project(tmp_path / "bench"))
    return tmp_path / "bench"


def planned(name: str = OBJECT):
    found = load_one("objects", name)
    camera = found.cameras[CAMERA]
    aim = stage.Target(name, made(Camera, camera), made(Rig, found.rigs["gonio-grbl"]))
    return aim, aim.ordered(
        object_shots(made(Object | PhotographedObject, found.objects[name]), made(Camera, camera), aim.suffix)
    )


@pytest.mark.heavy
def test_an_object_and_its_camera_are_photographed_into_the_folders_that_their_files_name(bench, studio, person):
    assert main(["capture", OBJECT]) == 0
    aim, plan = planned()
    assert read_captures("photos/jar.csv", "photos/jar") == plan and len(plan) == 8
    assert len(person.asked) == aim.estimate(plan).steps
    assert {shot.iso for shot in plan} == {100.0} and {shot.f_number for shot in plan} == {8.0}
    assert all(shot.file.endswith(".cr2") for shot in plan)
    for shot in plan:
        assert decode(Path("photos/jar") / shot.file).exposure_s == pytest.approx(shot.exposure_s, rel=1e-3)
    assert [release["shutterspeed"] for release in studio.bench.releases] == [
        {0.02: "1/50", 0.05: "1/20"}[shot.exposure_s] for shot in plan
    ]
    record = json.loads(Path("photos/jar.json").read_text())
    assert record["camera"]["serial_number"] == "1234567890"
    assert record["position"] == [{"photographs": 8, "lost_deg": {"camera_deg": 0.0, "turn_deg": 0.0}}]
    assert main(["capture", "--camera", CAMERA]) == 0
    roles = [shot.role for shot in read_captures(f"photographs/{CAMERA}/captures.csv")]
    assert roles == ["dark"] * 2 + ["white"] * 3 + ["chart"] * 2


@pytest.mark.heavy
def test_a_session_that_the_person_stops_goes_on_where_it_was(bench, studio, person):
    person.stops_at = 3
    assert main(["capture", OBJECT]) == 1
    _, plan = planned()
    taken = len(read_captures("photos/jar.csv", "photos/jar"))
    assert 0 < taken < len(plan)
    releases = len(studio.bench.releases)
    person.stops_at = None
    assert main(["capture", OBJECT]) == 0
    assert len(studio.bench.releases) == len(plan) and releases == taken
    assert read_captures("photos/jar.csv", "photos/jar") == plan


@pytest.mark.heavy
def test_a_camera_that_is_unplugged_in_mid_session_is_said_and_costs_one_photograph(bench, studio, person, capsys):
    studio.bench.script["file_get"] = [None, None, fault("GP_ERROR_IO_USB_FIND")]
    studio.bench.script["init"] = [None, *[fault("GP_ERROR_IO_USB_FIND")] * 50]
    edit(bench / f"config/cameras/{CAMERA}.yaml", driver__retries=2)
    assert main(["capture", OBJECT]) == 1
    said = capsys.readouterr().err.splitlines()[-1]
    assert "Canon EOS 40D" in said
    assert len(read_captures("photos/jar.csv", "photos/jar")) == 2
    studio.bench.script.clear()
    assert main(["capture", OBJECT]) == 0
    assert read_captures("photos/jar.csv", "photos/jar") == planned()[1]


@pytest.mark.heavy
def test_a_changed_bracket_keeps_what_still_belongs_to_the_plan(bench, studio, person):
    assert main(["capture", OBJECT]) == 0
    edit(bench / f"config/objects/{OBJECT}.yaml", exposure_s={"out": [0.02, 0.005], "in": [0.05]})
    assert main(["capture", OBJECT]) == 0
    assert len(studio.bench.releases) == 12
    edit(bench / f"config/objects/{OBJECT}.yaml", exposure_s={"out": [0.005], "in": [0.05]})
    assert main(["capture", OBJECT]) == 0
    assert len(studio.bench.releases) == 12
    with open("photos/captures-retired.csv", newline="") as file:
        retired = [row["file"] for row in csv.DictReader(file)]
    assert len(retired) == 4 and all((bench / "photos/jar" / name).is_file() for name in retired)


@pytest.mark.heavy
def test_another_sensitivity_photographs_all_again_and_keeps_the_old_files(bench, studio, person):
    assert main(["capture", OBJECT]) == 0
    edit(bench / f"config/cameras/{CAMERA}.yaml", driver__iso=200)
    assert main(["capture", OBJECT]) == 0
    assert len(studio.bench.releases) == 16
    assert {shot.iso for shot in read_captures("photos/jar.csv", "photos/jar")} == {200.0}
    assert len(list(Path("photos/jar").glob("*-retired-*.cr2"))) == 8


@pytest.mark.heavy
def test_a_complete_session_needs_neither_rig_nor_camera(bench, studio, person):
    assert main(["capture", OBJECT]) == 0
    studio.bench.seen.clear()
    opened = studio.bench.opened
    assert main(["capture", OBJECT]) == 0
    assert studio.bench.opened == opened


@pytest.mark.heavy
def test_a_confirmation_file_over_ssh_is_all_the_session_waits_for(bench, studio, capsys, monkeypatch):
    folder, end = bench / "results/rig/gonio-grbl", threading.Event()
    said: list[str] = []

    def watch():
        """Read the messages as a person would, and touch what they name."""
        done = set()
        while not end.wait(0.02):
            for line in list(said):
                path = re.search(r"touch (\S+)", line)[1]
                if path not in done:
                    done.add(path)
                    Path(path).touch()

    monkeypatch.setattr(operator, "_say", said.append)
    watching = threading.Thread(target=watch)
    watching.start()
    try:
        assert main(["capture", OBJECT]) == 0
    finally:
        end.set()
        watching.join()
    aim, plan = planned()
    assert len(said) == aim.estimate(plan).steps
    assert all(str(folder) in line for line in said) and not os.listdir(folder)


def test_nobody_answers_until_the_deadline(bench, studio, capsys):
    edit(bench / "config/rigs/gonio-grbl.yaml", operator_deadline_s=0.2)
    assert main(["capture", OBJECT]) == 1
    said = capsys.readouterr().err.splitlines()[-1]
    assert "did not appear in 0.2 s" in said and "put the object in place" in said


def test_a_prompt_without_a_terminal_says_what_to_do(bench, studio, capsys, monkeypatch):
    edit(bench / "config/rigs/gonio-grbl.yaml", operator="prompt")
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        assert main(["capture", OBJECT]) == 1
    assert "start it on a terminal, or give the rig operator: file" in capsys.readouterr().err


@pytest.mark.heavy
def test_two_sessions_do_not_move_one_rig(bench, studio, person, capsys):
    """The lock of the port says so in words, and nothing is photographed."""
    rig = load_one("rigs", "gonio-grbl").rigs["gonio-grbl"]
    with start_simulator(made(Rig, rig)) as simulator:
        edit(bench / "config/rigs/gonio-grbl.yaml", motion__port=simulator.port)
        held = SerialLink(simulator.port)
        assert main(["capture", OBJECT]) == 1
        assert f"{simulator.port}: in use by another program" in capsys.readouterr().err
        assert not person.asked and not studio.bench.releases
        held.close()
        # A real board is homed by the session, where it does not know where it stands.
        assert main(["capture", OBJECT]) == 0
        assert simulator.snapshot()["moving"] is False
    assert read_captures("photos/jar.csv", "photos/jar") == planned()[1]
