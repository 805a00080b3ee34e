"""``python -m irodori.rig``: what each command says and returns, on the simulated rig."""

import contextlib
import io
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from pathlib import Path

import patience
import pytest
import yaml
from documented import of_kind, words_of
from driven import CAMERA, Studio, project
from made import made
from motion_rigs import definition
from sessions import ROOT, assert_whole
from simulated_gphoto2 import make_module

from irodori.capture import command, stage
from irodori.capture.camera.gphoto_camera import GphotoCamera
from irodori.capture.command import main
from irodori.capture.operator import AutoOperator
from irodori.capture.rig.connect import open_rig, start_simulator, true_position_deg
from irodori.capture.rig.devices import DeviceError
from irodori.config.capture_table import read_captures
from irodori.config.definitions import load_one
from irodori.config.models import Camera, Object, Rig
from irodori.config.parts import PhotographedObject
from irodori.core.yaml_files import read_own_yaml


@pytest.fixture(autouse=True)
def bench(tmp_path, monkeypatch):
    """Return a working directory with a small virtual rig, a real one at a simulated board, and few poses."""
    folder = project(tmp_path / "bench")
    optics = {"width_px": 120, "height_px": 80, "pixel_pitch_um": 66.0, "principal_point_px": [60.0, 40.0]}
    change(folder / "config/cameras/d5100-comb.yaml", lambda camera: camera["optics"].update(optics))
    poses = [{"light_deg": [45.0], "camera_deg": [0.0, 20.0], "tilt_deg": [0.0, 10.0]}]
    change(folder / "config/objects/tile-plate.yaml", lambda plate: plate.update(poses=poses))
    monkeypatch.chdir(folder)
    return folder


def change(path: Path, action) -> None:
    content = read_own_yaml(path)
    action(content)
    path.write_text(yaml.dump(content, Dumper=yaml.CSafeDumper))


def run(capsys, *arguments: str, code: int = 0) -> tuple[list[str], list[str]]:
    """Run a command in this process; return the lines of its output and of its messages."""
    assert main(list(arguments)) == code
    said = capsys.readouterr()
    return said.out.splitlines(), said.err.splitlines()


@pytest.fixture
def board(bench):
    """Return the simulated board of the rig ``gonio-grbl``, which runs on between two commands as a real one does."""
    definition = load_one("rigs", "gonio-grbl").rigs["gonio-grbl"]
    with start_simulator(made(Rig, definition)) as simulator:
        change(
            bench / "config/rigs/gonio-grbl.yaml", lambda rig: rig["motion"].update(port=simulator.port, timeout_s=20.0)
        )
        yield simulator


# ---- rig


def test_status_says_state_angles_and_limits(capsys, board):
    out, err = run(capsys, "status", "gonio-grbl")
    assert out[0].startswith("state alarm, not homed, ") and "unlock" in out[0]
    assert re.fullmatch(r"camera_deg -?\d+\.\d{3} \(0 to 140, 10 degrees/s\)", out[1])
    assert re.fullmatch(r"turn_deg -?\d+\.\d{3} \(0 to 359.5, 20 degrees/s\)", out[2])
    assert not err


def test_setup_lists_what_disagrees_and_changes_it_on_request(capsys, bench, board):
    out, err = run(capsys, "setup", "gonio-grbl")
    assert out == ["gonio-grbl: the controller's settings agree with the rig's file"] and not err

    def faster(rig):
        for axis in rig["motion"]["axes"].values():
            axis["speed_deg_per_s"] *= 2.0
            axis["acceleration_deg_per_s2"] *= 3.0

    change(bench / "config/rigs/gonio-grbl.yaml", faster)
    out, err = run(capsys, "setup", "gonio-grbl", code=1)
    assert [line.split()[0] for line in out] == ["$110=1200", "$120=60", "$111=2400", "$121=120"]
    assert err == ["gonio-grbl: 4 to be changed; --write changes those with a value"]
    out, err = run(capsys, "status", "gonio-grbl", code=1)
    assert all(setting in err[0] for setting in ("$110", "$120", "$111", "$121"))
    out, err = run(capsys, "setup", "gonio-grbl", "--write")
    assert "agree" in out[0] and not err
    run(capsys, "move", "gonio-grbl", "camera_deg=30", "--home")


def test_home_finds_the_reference_position_and_the_board_remembers_it(capsys, board):
    assert run(capsys, "home", "gonio-grbl")[0][0] == "state idle, homed"
    board.fault("slip 0.5")
    assert run(capsys, "recount", "gonio-grbl")[0][:3] == [
        "camera_deg stood -0.500 degrees off its count",
        "turn_deg stood +0.000 degrees off its count",
        "state idle, homed",
    ]
    assert run(capsys, "status", "gonio-grbl")[0][0] == "state idle, homed"


def test_move_and_jog_go_where_they_are_told(capsys, board):
    run(capsys, "home", "gonio-grbl")
    out, _ = run(capsys, "move", "gonio-grbl", "camera_deg=30", "turn_deg=90.5")
    assert out[1].startswith("camera_deg 30.000") and out[2].startswith("turn_deg 90.500")
    out, _ = run(capsys, "jog", "gonio-grbl", "camera_deg=-0.5", "turn_deg=1")
    assert out[1].startswith("camera_deg 29.500") and out[2].startswith("turn_deg 91.500")


def test_a_real_rig_is_not_homed_unless_asked_to(capsys, board):
    before = board.true_position()
    _, err = run(capsys, "move", "gonio-grbl", "camera_deg=30", code=1)
    assert len(err) == 1 and "home it first" in err[0]
    assert board.true_position() == before
    out, _ = run(capsys, "move", "gonio-grbl", "camera_deg=30", "--home")
    assert out[1].startswith("camera_deg 30.000")


def test_the_virtual_rig_homes_itself_for_it_has_just_been_switched_on(capsys):
    out, _ = run(capsys, "move", "virtual", "camera_deg=30")
    assert out[0] == "state idle, homed" and out[1].startswith("camera_deg 30.000")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["move", "camera_deg=140.5"], "camera_deg 140.5: out of reach; accepted: 0 to 140"),
        (["move", "turn_deg=10", "camera_deg=-1"], "camera_deg -1: out of reach"),
        (["move", "camera_deg=nan", "--home"], "camera_deg nan: out of reach"),
        (["move", "camera_deg=150", "--home"], "camera_deg 150: out of reach"),
        (["jog", "camera_deg=200"], "out of reach"),
        (["move", "light_deg=45"], "light_deg: not a motorised axis of this rig; accepted: camera_deg, turn_deg"),
        (["jog", "light_deg=1", "--home"], "light_deg: not a motorised axis of this rig"),
        (["jog", "camera_deg=1", "camera_deg=2"], "camera_deg: given twice"),
    ],
)
def test_a_target_out_of_reach_is_refused_before_anything_moves(capsys, board, arguments, said):
    name, *rest = arguments
    if "--home" not in rest:
        run(capsys, "home", "gonio-grbl")
    board.forget()
    before = board.true_position()
    _, err = run(capsys, name, "gonio-grbl", *rest, code=1)
    assert len(err) == 1 and said in err[0]
    seen = board.snapshot()
    assert seen["low"] == seen["high"] == before


@pytest.mark.parametrize("word", ["camera_deg", "camera_deg=", "camera_deg=left", "=3"])
def test_what_is_no_angle_is_refused_with_an_example(capsys, board, word):
    try:
        assert main(["move", "gonio-grbl", word]) == 1
    except SystemExit as refused:
        assert refused.code == 2
    assert "camera_deg" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["status", "virtaul"], "did you mean 'virtual'"),
        (["status", "copy-stand"], "copy-stand.yaml: motion: found no such key; accepted: a rig with motors"),
        (["plan", "tile-palte"], "did you mean 'tile-plate'"),
        (["capture", "--camera", "powershot-s40"], "of kind files, whose photographs somebody else takes"),
        (["shoot", "d5100-comb", "a.dng", "--exposure", "0.02"], "d5100-comb.yaml: driver: found no such key"),
        (["plan", "tile-plate", "--best", "2"], "--best: found 2 poses; accepted: 4 or more, for 3 parameters."),
        (["plan", "d5100-comb", "--camera", "--best", "6"], "--best: found a camera"),
        (["capture", "tile-plate", "--port", "0"], "--port: found no --page that it belongs to"),
        (["capture", "tile-plate", "--page", "--address", "0.0.0.0"], "0.0.0.0, which stands for many; accepted: one"),
    ],
)
def test_a_mistake_is_one_sentence(capsys, bench, arguments, said):
    change(bench / "config/cameras/powershot-s40.yaml", lambda camera: camera.update(captures={"table": "a.csv"}))
    for name in ("a.csv", "a.cr2"):
        (bench / name).write_text("file,role,light_deg,camera_deg,filter,exposure_s\na.cr2,chart,45,0,out,0.02\n")
    change(
        bench / "config/cameras/powershot-s40.yaml", lambda camera: camera["chart"].update(spectra="BabelColor Average")
    )
    out, err = run(capsys, *arguments, code=1)
    assert not out and len(err) == 1 and said in err[0]


def test_a_port_that_is_not_there_is_named(capsys, bench):
    change(bench / "config/rigs/gonio-grbl.yaml", lambda rig: rig["motion"].update(port="/dev/ttyNOBODY"))
    _, err = run(capsys, "status", "gonio-grbl", code=1)
    assert err == ["/dev/ttyNOBODY: no such port"]


def test_without_a_folder_of_definitions_it_says_which_file_it_looked_for(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, err = run(capsys, "status", "virtual", code=1)
    assert err == ["config/config.yaml: found no such file; accepted: a YAML file."]


# ---- plan


def test_plan_prints_the_order_and_what_it_takes(capsys):
    out, _ = run(capsys, "plan", "tile-plate")
    *lines, estimate = out
    assert len(lines) == 8
    found = load_one("objects", "tile-plate")
    aim = stage.Target("tile-plate", made(Camera, found.cameras["d5100-comb"]), made(Rig, found.rigs["virtual"]))
    planned = aim.ordered(
        stage.object_shots(
            made(Object | PhotographedObject, found.objects["tile-plate"]), made(Camera, aim.camera), ".dng"
        )
    )
    assert [line.split()[-1] for line in lines] == [shot.file for shot in planned]
    assert re.match(r"object light 45 camera \d+ tilt \d+ turn 0 filter (in|out) 0\.0\d s  l0450-", lines[0])
    assert estimate == str(aim.estimate(planned)) and estimate.startswith("8 shots, about ")


def test_plan_of_a_camera_begins_with_the_cap_on(capsys):
    out, _ = run(capsys, "plan", "--camera", CAMERA)
    assert out[0].startswith("dark") and out[-2].startswith("chart") and out[-2].endswith(".cr2")
    assert "hand step" in out[-1]


def test_plan_best_chooses_so_many_poses(capsys):
    out, _ = run(capsys, "plan", "tile-plate", "--best", "6")
    poses = [line for line in out if line.startswith("light ")]
    angles = [angle for line in poses for angle in re.findall(r"[\d.]+", line.split("camera ")[1])]
    assert len(angles) == 6
    assert all(re.match(r"light [\d.]+, tilt [\d.]+, turn [\d.]+: camera ", line) for line in poses)
    assert any("standard error of mu" in line for line in out)


# ---- capture and shoot


def test_capture_resumes_with_what_is_missing(capsys, monkeypatch):
    whole, taken = stage.VirtualCamera.capture, []

    def failing(self, shot, path):
        if len(taken) == 3:
            raise DeviceError("the shutter is stuck")
        taken.append(shot.file)
        whole(self, shot, path)

    monkeypatch.setattr(stage.VirtualCamera, "capture", failing)
    _, err = run(capsys, "capture", "tile-plate", code=1)
    assert err[-1] == "the shutter is stuck"
    assert any("8 of 8 photographs to take" in line for line in err)
    monkeypatch.setattr(stage.VirtualCamera, "capture", whole)
    _, err = run(capsys, "capture", "tile-plate")
    assert any("5 of 8 photographs to take" in line for line in err)
    assert any("taken 5, kept 3" in line for line in err)
    # The simulated controller starts anew with the command.
    assert any("lost its count of steps after 3 photographs" in line for line in err)
    folder = Path("results/rig/bench/tile-plate")
    assert len(json.loads((folder / "captures.json").read_text())["never_checked"]) == 3
    assert_whole(folder, read_captures(folder / "captures.csv"))


def test_files_of_a_session_that_somebody_damaged_are_named(capsys):
    folder = Path("results/rig/bench/tile-plate")
    run(capsys, "capture", "tile-plate")
    for name, content, said in (
        (".session", b"\xff\xfe\x80", "found something else than the name of a subject; accepted: object tile-plate"),
        (".session", b"object a\nobject b\n", "found something else than the name of a subject"),
        ("captures.json", b'{"position": null}', "found something else than such a record"),
        ("captures.json", b'{"position": [1]}', "found something else than such a record"),
        ("captures-retired.csv", None, "found no file that can be read (Is a directory); accepted: the log as it was"),
    ):
        path = folder / name
        before = path.read_bytes() if path.exists() else b""
        path.mkdir() if content is None else path.write_bytes(content)
        _, err = run(capsys, "capture", "tile-plate", code=1)
        assert err[-1].startswith(f"{path}: {said}") and "Traceback" not in "".join(err)
        path.rmdir() if content is None else path.write_bytes(before)
    _, err = run(capsys, "capture", "tile-plate")
    assert any("0 of 8 photographs to take" in line for line in err)
    # What does not say that the photographs are of this definition means that they are of another: they are computed
    # again.
    (folder / ".made-from").write_bytes(b"\xff\xfe\x80")
    _, err = run(capsys, "capture", "tile-plate")
    assert any("8 of 8 photographs to take" in line for line in err)
    assert_whole(folder, read_captures(folder / "captures.csv"))


def observed(*words: str) -> dict:
    """Hold a session with a page, of which an observer reads the address; return what it saw before it finished it."""

    def address() -> re.Match | None:
        # What is said is looked at and not taken, for what is said meanwhile would be lost with it.
        return re.search(r"http://(127\.0\.0\.1:\d+)/\?token=(\S+)\s", said.getvalue())

    def observe():
        patience.until(address)
        host, token = address().groups()
        cookie = {"Cookie": f"irodori-{host.partition(':')[2]}={token}"}
        asked = urllib.request.Request(f"http://{host}/news", headers=cookie)
        with urllib.request.urlopen(asked, timeout=patience.LONG_S) as news:
            for line in news:
                if line.startswith(b"data: {") and (view := json.loads(line[6:]))["state"] == "complete":
                    break
        body = json.dumps({"action": "done", "turn": view["turn"]}).encode()
        headers = {**cookie, "Origin": f"http://{host}", "Content-Type": "application/json"}
        acted = urllib.request.Request(f"http://{host}/act", body, headers)
        urllib.request.urlopen(acted, timeout=patience.LONG_S).close()
        seen.append(view)

    said, seen, observer = io.StringIO(), [], threading.Thread(target=observe, daemon=True)
    observer.start()
    with contextlib.redirect_stderr(said):
        assert main(list(words)) == 0
    observer.join(patience.LONG_S)
    return seen[0]


def test_capture_shows_a_page_whose_address_the_terminal_says():
    seen = observed("capture", "tile-plate", "--page", "--port", "0")
    assert (seen["done"], seen["total"], seen["name"]) == (8, 8, "tile-plate")
    folder = Path("results/rig/bench/tile-plate")
    assert_whole(folder, read_captures(folder / "captures.csv"))


def test_capture_says_that_another_session_is_at_work(capsys):
    folder = Path("results/rig/bench/tile-plate")
    with stage.claimed(folder / "captures.csv", folder, "object tile-plate"):
        _, err = run(capsys, "capture", "tile-plate", code=1)
    assert "another session is at work there" in err[-1]


def test_shoot_takes_one_photograph_and_verifies_it(capsys, monkeypatch):
    studio = Studio()
    monkeypatch.setitem(sys.modules, "gphoto2", make_module(studio.bench))
    out, _ = run(capsys, "shoot", CAMERA, "one.cr2", "--exposure", "0.02")
    assert "battery 75%" in out[0] and out[-1] == "one.cr2"
    assert Path("one.cr2").stat().st_size > 1000
    _, err = run(capsys, "shoot", CAMERA, "one.cr2", "--exposure", "0.021", code=1)
    assert "not on offer" in err[-1]
    _, err = run(capsys, "shoot", CAMERA, "nowhere/one.cr2", "--exposure", "0.02", code=1)
    assert len(err) == 1 and "nowhere/one.cr2: cannot be stored: No such file or directory" in err[0]


@pytest.mark.parametrize("exposure", ["-1", "0", "nan", "inf", "3600.5"])
def test_shoot_refuses_a_time_that_no_exposure_has_before_it_opens_the_camera(capsys, exposure):
    _, err = run(capsys, "shoot", CAMERA, "one.cr2", "--exposure", exposure, code=1)
    assert err == [f"--exposure: found {float(exposure)}; accepted: above 0 and up to 3600 s."]


def test_ctrl_c_returns_130_and_says_that_the_rig_stands_still(capsys, monkeypatch):
    stood = []

    def interrupted(rig):
        try:
            rig.home()
            raise KeyboardInterrupt
        finally:
            stood.append(true_position_deg(rig))

    monkeypatch.setattr(command, "_print_status", interrupted)
    _, err = run(capsys, "status", "virtual", code=130)
    assert err == ["stopped; the rig stands still, and what was taken stays"]
    assert stood


MOVE, JOG, HOME = ["move", "turn_deg=359.5"], ["jog", "turn_deg=359.5"], ["home"]


@pytest.mark.parametrize(
    ("arguments", "number", "code", "message"),
    [
        (MOVE, signal.SIGINT, 130, ["stopped; the rig stands still, and what was taken stays"]),
        pytest.param(MOVE, signal.SIGTERM, 143, [], marks=pytest.mark.heavy),
        pytest.param(JOG, signal.SIGHUP, 129, [], marks=pytest.mark.heavy),
        pytest.param(HOME, signal.SIGTERM, 143, [], marks=pytest.mark.heavy),
    ],
)
def test_what_ends_a_command_from_outside_stops_the_rig_in_mid_move(bench, board, arguments, number, code, message):
    """The whole command in a process of its own, a real signal, the table in mid-move."""
    definition = load_one("rigs", "gonio-grbl").rigs["gonio-grbl"]
    with open_rig(made(Rig, definition)) as rig:
        rig.home()
        rig.move({"turn_deg": 0.0})
    # At the pace of the board the table turns by 359.5 degrees in 18 s.
    board.pace(1.0)
    board.forget()
    name, *rest = arguments
    command = [sys.executable, "-m", "irodori.rig", name, "gonio-grbl", *rest]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}

    def turned(seen: dict) -> float:
        return seen["high"]["Y"] - seen["low"]["Y"]

    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as running:
        patience.until(lambda: turned(board.snapshot()) >= 5.0 or running.poll() is not None)
        assert running.poll() is None, running.communicate()
        running.send_signal(number)
        patience.wait(running)
        said = running.stderr.read()
    assert running.returncode == code
    assert said.splitlines() == message
    before = board.snapshot()
    assert not before["moving"] and turned(before) < 300.0
    assert before["state"].lower() == ("alarm" if name == "home" else "idle")
    time.sleep(0.2)
    assert board.snapshot() == before


def test_saying_where_a_rig_stands_waits_for_no_import_that_only_photographs_or_simulators_need():
    code = "import sys, irodori.capture.command; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    loaded = run.stdout.split()
    assert not {"numpy", "numba", "scipy", "rawpy", "h5py", "jsonschema"} & set(loaded)
    assert not [name for name in loaded if name.startswith(("irodori.simulation", "irodori.ingest"))]


# ---- what the documents let one type


@pytest.fixture
def studio(monkeypatch):
    """Put a simulated camera before the bench, which shows what each photograph of a session is of."""
    studio = Studio()
    monkeypatch.setitem(sys.modules, "gphoto2", make_module(studio.bench))
    monkeypatch.setattr(GphotoCamera, "capture", studio.following(GphotoCamera.capture))
    monkeypatch.setattr(stage, "make_operator", lambda *_, **__: AutoOperator(lambda request: None))


def simulate(module: str, *words: str) -> None:
    """Start a simulated controller as a program, until it has printed its port."""
    process = subprocess.Popen(
        [sys.executable, "-m", module, *words], stdout=subprocess.PIPE, env=os.environ | {"PYTHONPATH": str(ROOT)}
    )
    try:
        assert os.path.exists(process.stdout.readline().decode().strip()), "the port that it printed"
    finally:
        process.terminate()
        patience.wait(process)
        process.stdout.close()


@pytest.mark.parametrize("documented", of_kind("bench"))
def test_a_documented_command_of_the_bench_does_its_work(documented, capsys, board, studio):
    program, *words = words_of(documented)
    words = [{"RIG": "gonio-grbl", "OBJECT": "tile-plate"}.get(word, word) for word in words]
    if program.startswith("irodori.simulation."):
        Path("config/rigs/NAME.yaml").write_text(yaml.safe_dump(definition("ascii")))
        simulate(program, *words)
        return
    if "--page" in words:
        seen = observed(*words, "--port", "0")
        assert (seen["done"], seen["total"], seen["name"]) == (8, 8, "jar")
        return
    if words[0] in ("move", "jog", "recount"):
        run(capsys, "home", "gonio-grbl")
    if words[0] == "jog":
        run(capsys, "move", "gonio-grbl", "turn_deg=10")
    if words[:2] == ["plan", "jar"] and "--best" in words:
        words[1] = "tile-plate"  # what its best poses would tell is known of a virtual object
    out, err = run(capsys, *words)
    assert out or err
    if words[0] == "capture":
        name = "photographs/eos-40d-comb/captures.csv" if "--camera" in words else "photos/jar.csv"
        assert len(read_captures(name)) >= 7
    if words[0] == "shoot":
        assert Path("try.cr2").stat().st_size > 1000
