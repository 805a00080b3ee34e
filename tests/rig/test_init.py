"""The command `irodori init`: a project of somebody's own photographs from the folder alone."""

import shutil

import pytest
import yaml
from made import made
from sessions import definitions

from irodori.capture.journal import Journal
from irodori.capture.operator import AutoOperator
from irodori.capture.session import Session, take_stock
from irodori.capture.shot_list import camera_shots, object_shots
from irodori.command_line import main
from irodori.config.capture_table import read_captures
from irodori.config.definitions import load_definitions
from irodori.config.models import Camera, Object, Rig
from irodori.core.errors import InputError
from irodori.core.yaml_files import read_yaml
from irodori.simulation.virtual_rig.bench import Bench
from irodori.simulation.virtual_rig.virtual_camera import VirtualCamera

SIZE = {"width_px": 480, "height_px": 360, "pixel_pitch_um": 16.0, "principal_point_px": [240.0, 180.0]}
ANSWERS = {
    "camera_distance_mm": 900, "lamp": "A", "reference_pose": [45, 0], "white_reflectance": 0.99,
    "focal_length_mm": 50, "pixel_pitch_um": 16, "shape": "plate 90 90",
    "light_deg": 45, "camera_deg": [0, 20, 60], "tilt_deg": 0, "turn_deg": 0,
}  # fmt: skip


@pytest.fixture(scope="module")
def taken(tmp_path_factory):
    """Return a folder of photographs whose names tell the order alone, and by name what each is."""
    folder = tmp_path_factory.mktemp("photographs") / "My plate"
    folder.mkdir()
    plate, camera, rig = definitions(poses=[{"light_deg": [45.0], "camera_deg": [0.0, 20.0, 60.0]}])
    plate["exposure_s"] = {"out": [0.02, 0.01], "in": [0.05]}
    camera["optics"] |= SIZE
    camera |= {"dark_frames": 1, "white_frames": 1, "linearity_exposure_s": []}
    bench, eye, stand = Bench(), made(Camera, camera), made(Rig, rig)
    subject, truth = made(Object, plate), {}
    for name, planned, what in (
        ("camera", camera_shots(eye, ".dng"), None),
        ("plate", object_shots(subject, eye, ".dng"), subject),
    ):
        session = tmp_path_factory.mktemp(name)
        journal, device = Journal(session / "captures.csv"), VirtualCamera(eye, stand, bench, name, planned, what)
        Session(device, AutoOperator(bench.set), journal, None, take_stock(journal, planned)).run(planned, name)
        for shot in read_captures(session / "captures.csv"):
            file = f"IMG {len(truth):04d}.dng"
            shutil.copy(session / shot.file, folder / file)
            truth[file] = shot
    return folder, truth


def init(folder, *more: str) -> int:
    return main(["init", str(folder), *more])


def written(path, content) -> str:
    path.write_text(yaml.safe_dump(content))
    return str(path)


def test_eleven_answers_make_the_table_that_a_person_would_have_written(taken, tmp_path, monkeypatch, capsys):
    folder, truth = taken
    monkeypatch.chdir(tmp_path)
    values = sum(len(v) if isinstance(v, list) else len(str(v).split()) for v in ANSWERS.values())
    assert values <= 16
    assert init(folder, "--answers", written(tmp_path / "answers.yaml", ANSWERS)) == 0
    assert "0 gaps" in capsys.readouterr().out
    shots = read_captures("config/captures/my-plate.csv", folder)
    assert len(shots) == len(truth)
    for shot in shots:
        real = truth[shot.file]
        assert (shot.role, shot.filter) == (real.role, "out" if real.role == "dark" else real.filter), shot.file
        assert shot.exposure_s == pytest.approx(real.exposure_s, rel=1e-3)
        if real.role != "dark":
            assert shot.pose == real.pose, shot.file
    loaded = load_definitions(read_yaml("config/my-plate.yaml"), tmp_path, "config/my-plate.yaml")
    assert loaded.cameras["my-plate-camera"].optics.width_px == 480
    before = (tmp_path / "config/my-plate.yaml").read_bytes()
    assert init(folder, "--answers", "answers.yaml") == 2
    assert "there already" in capsys.readouterr().err
    assert (tmp_path / "config/my-plate.yaml").read_bytes() == before


def test_what_nobody_says_is_a_gap_that_the_check_names(taken, tmp_path, monkeypatch, capsys):
    folder, truth = taken
    monkeypatch.chdir(tmp_path)
    known = {key: value for key, value in ANSWERS.items() if key not in ("camera_distance_mm", "camera_deg")}
    assert init(folder, "--answers", written(tmp_path / "answers.yaml", known)) == 1
    objects = sum(shot.role == "object" for shot in truth.values())
    out = capsys.readouterr().out
    assert f"{1 + objects} gaps" in out and "rigs/my-plate-rig.yaml: camera_distance_mm" in out
    rig = tmp_path / "config/rigs/my-plate-rig.yaml"
    with pytest.raises(InputError, match=r"my-plate-rig.yaml: camera_distance_mm: found .*accepted: a number above 0"):
        load_definitions(read_yaml("config/my-plate.yaml"), tmp_path, "config/my-plate.yaml")
    rig.write_text(rig.read_text().replace("'?'", "900"))
    with pytest.raises(InputError, match=r"my-plate.csv: line \d+, camera_deg: found '\?'; accepted: a finite number"):
        load_definitions(read_yaml("config/my-plate.yaml"), tmp_path, "config/my-plate.yaml")


def test_one_photograph_of_a_chart_makes_a_camera(taken, tmp_path, monkeypatch, capsys):
    folder, truth = taken
    monkeypatch.chdir(tmp_path)
    chart = next(name for name, shot in truth.items() if shot.role == "chart" and shot.filter == "out")
    known = {key: ANSWERS[key] for key in ("camera_distance_mm", "lamp", "reference_pose")}
    assert init(folder / chart, "--name", "eye", "--answers", written(tmp_path / "answers.yaml", known)) == 0
    loaded = load_definitions(read_yaml("config/eye.yaml"), tmp_path, "config/eye.yaml")
    assert list(loaded.cameras) == ["eye"] and not loaded.objects
    assert main(["check", "config/eye.yaml"]) == 0


def test_a_pose_without_its_second_photograph_is_left_open(taken, tmp_path, monkeypatch, capsys):
    folder, truth = taken
    monkeypatch.chdir(tmp_path)
    some = shutil.copytree(folder, tmp_path / "some")
    lost = [name for name, shot in truth.items() if shot.role == "object" and shot.filter == "in"][1]
    (some / lost).unlink()
    assert init(some, "--answers", written(tmp_path / "answers.yaml", ANSWERS)) == 1
    gaps = [line for line in (tmp_path / "config/captures/some.csv").read_text().splitlines() if ",?," in line]
    alone = [name for name, shot in truth.items() if shot.capture == truth[lost].capture and name != lost]
    assert [line.split(",")[0] for line in gaps] == alone
    assert "out of order" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("files", "sentence"),
    [
        (None, "no such folder"),
        ({}, "an empty folder"),
        ({"a.jpg": b"\xff\xd8\xff\xe0"}, "no RAW file; a.jpg is a JPEG picture"),
    ],
)
def test_a_folder_without_photographs_is_one_sentence(tmp_path, capsys, monkeypatch, files, sentence):
    monkeypatch.chdir(tmp_path)
    if files is not None:
        (tmp_path / "raw").mkdir()
        for name, content in files.items():
            (tmp_path / "raw" / name).write_bytes(content)
    assert init(tmp_path / "raw") == 2
    said = capsys.readouterr().err
    assert sentence in said and said.count("\n") == 1 and not (tmp_path / "config").exists()


def test_two_cameras_in_one_folder_are_refused(taken, tmp_path, capsys, monkeypatch):
    folder, truth = taken
    monkeypatch.chdir(tmp_path)
    (tmp_path / "raw").mkdir()
    first, second, *_ = truth
    shutil.copy(folder / first, tmp_path / "raw")
    content = (folder / second).read_bytes()
    assert content.count(b"virtual camera\0") == 2
    (tmp_path / "raw" / second).write_bytes(content.replace(b"virtual camera\0", b"another camera\0"))
    assert init(tmp_path / "raw") == 2
    assert f"{second}: body: found" in capsys.readouterr().err
