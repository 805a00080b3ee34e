"""The command `irodori init`: a project of somebody's own photographs from the folder alone."""

import re
import shutil
import struct
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from documented import of_kind, words_of
from linear_files import develop_linearly
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
from irodori.first_project import init_command
from irodori.first_project.light_places import lamp_of_poses, read_lamps, read_light_places, write_lamps
from irodori.first_project.questions import name_in_files, numbers, pose_of_references, positive, shape
from irodori.first_project.raw_folder import Photograph, photographs, raw_files
from irodori.first_project.recognition import recognise
from irodori.geometry.rig_frame import to_light
from irodori.geometry.shapes.shape import Shape
from irodori.ingest.plausibility import Look
from irodori.simulation.virtual_rig.bench import Bench
from irodori.simulation.virtual_rig.virtual_camera import VirtualCamera

SIZE = {"width_px": 400, "height_px": 300, "pixel_pitch_um": 19.2, "principal_point_px": [200.0, 150.0]}
ANSWERS = {
    "camera_distance_mm": 900, "lamp": "A", "focal_length_mm": 50, "pixel_pitch_um": 19.2, "shape": "plate 90",
    "light_deg": 45, "camera_deg": [20, 60],
}  # fmt: skip


@pytest.fixture(scope="module")
def taken(tmp_path_factory):
    """Return a folder of photographs whose names tell the order alone, and by name what each is."""
    folder = tmp_path_factory.mktemp("photographs") / "My plate"
    folder.mkdir()
    plate, camera, rig = definitions(poses=[{"light_deg": [45.0], "camera_deg": [20.0, 60.0]}])
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


@pytest.fixture(scope="module")
def looked(taken):
    """Return the same photographs as the command sees them."""
    return photographs(taken[0])[0]


@pytest.fixture(scope="module")
def recognised(looked):
    """Return what they were recognised as."""
    return recognise(looked)


@pytest.fixture
def seen(taken, looked, recognised, monkeypatch, tmp_path):
    """Return the folder in which the command runs; it need not look at the photographs again."""
    monkeypatch.setattr(init_command, "photographs", lambda place, linear, order: (looked, "the camera's clock"))
    monkeypatch.setattr(init_command, "recognise", lambda found: recognised)
    monkeypatch.chdir(tmp_path)
    return taken[0]


def init(folder, *more: str) -> int:
    return main(["init", str(folder), *more])


def written(path, content) -> str:
    path.write_text(yaml.safe_dump(content))
    return str(path)


def patterned(name: str, level: float, seed: int, exposure_s: float = 0.02, **changes) -> Photograph:
    """Return a photograph of a view that a seed makes, without a file."""
    green = np.random.default_rng(seed).uniform(0.2, 1.0, (12, 16, 1)).astype(np.float32)
    picture = level * green * np.array([0.8, 1.0, 0.6], dtype=np.float32)
    look = Look((32, 24), name, "body", "", "", 0.0, 0.0, np.nan, picture, np.ones((12, 16), dtype=bool))
    return Photograph(Path(name), replace(look, **changes), exposure_s, 100.0, 8.0)


def test_every_photograph_is_told_by_what_it_shows(taken, recognised):
    _, truth = taken
    poses: dict[int, set] = {}
    for one in recognised:
        real = truth[one.photograph.path.name]
        assert (one.role, one.filter) == (real.role, "out" if real.role == "dark" else real.filter), real.file
        if one.role == "object":
            poses.setdefault(one.pose, set()).add(real.pose)
    assert sorted(poses) == [0, 1] and all(len(each) == 1 for each in poses.values())


def test_few_answers_make_the_table_that_a_person_would_have_written(seen, taken, tmp_path, capsys):
    folder, truth = taken
    assert init(folder, "--answers", written(tmp_path / "answers.yaml", ANSWERS)) == 0
    out = capsys.readouterr().out
    assert "0 gaps" in out
    shots = read_captures("config/captures/my-plate.csv", folder)
    assert len(shots) == len(truth)
    for shot in shots:
        real = truth[shot.file]
        assert shot.exposure_s == pytest.approx(real.exposure_s, rel=1e-3)
        if real.role != "dark":
            assert shot.pose == real.pose, shot.file
    loaded = load_definitions(read_yaml("config/my-plate.yaml"), tmp_path, "config/my-plate.yaml")
    assert loaded.cameras["my-plate-camera"].optics.width_px == 400
    plate = loaded.objects["my-plate"]
    assert plate.shape.height_mm == 90.0 and (plate.lobes, plate.coat) == (("auto",), "auto")
    # What nobody said is printed, and stands in the file that it concerns.
    for file, words in (
        ("cameras/my-plate-camera.yaml", "white.reflectance_factor: 0.99"),
        ("cameras/my-plate-camera.yaml", "45 0 degrees"),
        ("objects/my-plate.yaml", "refractive_index: n 1.5"),
        ("objects/my-plate.yaml", "tilt_deg in config/captures/my-plate.csv: 0"),
        ("environments/my-plate-lamp.yaml", "D65"),
    ):
        notes = [line for line in Path("config", file).read_text().splitlines() if line.startswith("#")]
        assert any(words in note for note in notes), (file, words)
        assert any(f"config/{file}: " in line and words in line for line in out.splitlines()), (file, words)
    before = (tmp_path / "config/my-plate.yaml").read_bytes()
    assert init(folder, "--answers", "answers.yaml") == 2
    assert "there already" in capsys.readouterr().err
    assert (tmp_path / "config/my-plate.yaml").read_bytes() == before


def test_a_definition_that_must_be_corrected_is_named_after_it_is_written(taken, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    answers = written(tmp_path / "answers.yaml", ANSWERS | {"lamp": "halogen"})
    assert init(taken[0], "--into", "my config", "--answers", answers) == 1
    said = capsys.readouterr()
    assert "written, and to be corrected: " in said.err and "'halogen'" in said.err and "next:" not in said.out
    assert list((tmp_path / "my config").glob("*.yaml"))


def test_a_project_that_exists_is_refused_before_a_photograph_is_read(seen, taken, tmp_path, monkeypatch, capsys):
    folder = taken[0]
    assert init(folder, "--answers", written(tmp_path / "answers.yaml", ANSWERS)) == 0
    files = sorted(path.relative_to(tmp_path) for path in (tmp_path / "config").rglob("*") if path.is_file())
    assert len(files) == 7

    def read(*given):
        raise AssertionError("a photograph is read")

    def refused() -> str:
        capsys.readouterr()
        assert init(folder, "--answers", "answers.yaml") == 2
        return capsys.readouterr().err

    with monkeypatch.context() as patched:
        patched.setattr(init_command, "photographs", read)
        said = refused()
        assert all(str(path) in said.partition("removed: ")[2] for path in files), said
        for file in ("my-plate.yaml", "captures/my-plate.csv"):
            Path("config", file).unlink()
        said = refused()
        assert "rigs/my-plate-rig.yaml" in said and "captures/my-plate.csv" not in said
        # A project of another name, also one of a chart alone, is not in the way.
        with pytest.raises(AssertionError, match="a photograph is read"):
            init(folder, "--answers", "answers.yaml", "--name", "other")
    # What only some projects of the name have is found when the photographs are known, and nothing is written.
    Path("config/rigs/my-plate-rig.yaml").unlink()
    camera = Path("config/cameras/my-plate.yaml")
    camera.write_text("of another project")
    said = refused()
    assert "cameras/my-plate-camera.yaml" in said and str(camera) not in said
    assert not Path("config/my-plate.yaml").exists()
    for path in files:
        path.unlink(missing_ok=True)
    assert init(folder, "--answers", "answers.yaml") == 0 and camera.read_text() == "of another project"


def light_file(path, places) -> str:
    lines = [str(len(places)), *(f"{name} {x} {y} {z}" for name, (x, y, z) in places.items())]
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def test_a_light_position_file_says_where_the_lamp_of_each_pose_stood(seen, taken, recognised, tmp_path):
    folder = taken[0]
    of_pose = {0: (0.5, 0.5, 0.5**0.5), 1: (0.0, -300.0, 400.0)}
    # As programs for domes list them: the JPEG beside a RAW file, a whole path, any of a pose's photographs.
    first = {one.pose: one.photograph.path.stem for one in reversed(recognised) if one.role == "object"}
    places = {f"C:\\dome\\{first[pose]}.jpg": xyz for pose, xyz in of_pose.items()}
    lights = light_file(tmp_path / "dome.lp", places)
    answers = {key: value for key, value in ANSWERS.items() if key not in ("light_deg", "camera_deg")}
    assert init(folder, "--lights", lights, "--answers", written(tmp_path / "answers.yaml", answers)) == 0
    pose_of = {one.photograph.path.name: one.pose for one in recognised}
    shots = read_captures("config/captures/my-plate.csv", folder)
    for shot in shots:
        if shot.role == "object":
            wanted = np.array(of_pose[pose_of[shot.file]])
            np.testing.assert_allclose(to_light(shot.pose), wanted / np.linalg.norm(wanted), atol=1e-5)
            assert shot.pose.camera_deg == 0.0
        else:
            assert shot.pose.light_azimuth_deg == 0.0
    loaded = load_definitions(read_yaml("config/my-plate.yaml"), tmp_path, "config/my-plate.yaml")
    assert loaded.rigs["my-plate-rig"].limits.light_azimuth_deg.max == 360.0
    assert "camera_deg" in Path("config/objects/my-plate.yaml").read_text()


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", "an empty file"),
        ("2\na.jpg 0 0 1\n", "'2' above 1 photograph"),
        ("1\na.jpg 0 0 0\n", "'a.jpg 0 0 0'"),
        ("1\na.jpg 0 one 1\n", "'a.jpg 0 one 1'"),
        ("1\na.jpg 0 1\n", "'a.jpg 0 1'"),
        ("1\na.jpg nan 0 1\n", "'a.jpg nan 0 1'"),
        ("2\na.jpg 0 0 1\nA.JPG 1 0 0\n", "'A.JPG' again"),
        (b"\xff\xfe1\x00", "can't decode"),
    ],
)
def test_a_light_position_file_with_a_fault_is_refused_by_its_line(tmp_path, text, found):
    path = tmp_path / "dome.lp"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError) as caught:
        read_light_places(path)
    assert found in caught.value.found and "dome.lp" in str(caught.value)


def test_a_pose_that_no_light_is_listed_for_or_two_are_is_named(recognised, tmp_path):
    names = {one.photograph.path.name: one.pose for one in recognised if one.role == "object"}
    listed = {Path(name).stem.lower(): (0.0, pose, 1.0) for name, pose in names.items()}
    assert lamp_of_poses(listed, recognised, "dome.lp") == [(0.0, 0, 1.0), (0.0, 1, 1.0)]
    with pytest.raises(InputError, match=r"dome.lp: found none of IMG"):
        lamp_of_poses({}, recognised, "dome.lp")
    other = Path(next(iter(names))).stem.lower()
    with pytest.raises(InputError, match="different lamps for IMG"):
        lamp_of_poses(listed | {other: (1.0, 0.0, 1.0)}, recognised, "dome.lp")


def test_a_table_of_lamps_says_how_bright_the_lamp_of_each_pose_was(seen, taken, recognised, tmp_path):
    of_pose = {0: (45.0, 90.0, 1.04), 1: (30.0, -120.0, 0.97)}
    first = {one.pose: one.photograph.path.stem for one in reversed(recognised) if one.role == "object"}
    write_lamps(tmp_path / "lamps.csv", {f"{first[pose]}.tif": lamp for pose, lamp in of_pose.items()})
    answers = {key: value for key, value in ANSWERS.items() if key not in ("light_deg", "camera_deg")}
    said = written(tmp_path / "answers.yaml", answers)
    assert init(taken[0], "--lights", str(tmp_path / "lamps.csv"), "--answers", said) == 0
    pose_of = {one.photograph.path.name: one.pose for one in recognised}
    for shot in read_captures("config/captures/my-plate.csv", taken[0]):
        found = shot.pose.light_deg, shot.pose.light_azimuth_deg, shot.light_level
        if shot.role == "object":
            assert found == pytest.approx(of_pose[pose_of[shot.file]], rel=1e-4)
        else:
            assert shot.light_level == 1.0


@pytest.mark.parametrize("answered", ["plate 90 60", "sphere 25", "mesh lid.obj", "mesh absent.obj"])
def test_the_first_picture_is_filled_by_the_object_and_shows_a_table_under_it(answered, seen, tmp_path, capsys):
    Path("lid.obj").write_bytes((Path(__file__).parents[2] / "config/meshes/lid.obj").read_bytes())
    answers = ANSWERS | {"shape": answered}
    try:
        init(seen, "--answers", written(tmp_path / "answers.yaml", answers))
    except InputError as error:  # of the definitions, once all files are written
        assert "absent.obj" in str(error) and "absent" in answered
    assert ("the file's coordinates are in mm, and z is up" in capsys.readouterr().out) == ("mesh" in answered)
    scene = yaml.safe_load(Path("config/scenes/my-plate-scene.yaml").read_text())
    view, (table,) = scene["views"]["front"], scene["bodies"]
    block = yaml.safe_load(Path("config/objects/my-plate.yaml").read_text())["shape"]
    if "absent" in answered:
        return
    texels = {"width": 4, "height": 4}
    shown = Shape.from_definition(made(Object, {"camera": "c", "shape": block, "texels": texels}).shape)
    point = shown.facetted(1.0).vertices_mm
    eye, target = (np.array(view[key]) for key in ("position_mm", "target_mm"))
    ahead = (target - eye) / np.linalg.norm(target - eye)
    up = np.cross(np.cross(ahead, [0.0, 0.0, 1.0]), ahead)
    up /= np.linalg.norm(up)
    height = ((point - eye) @ up) / ((point - eye) @ ahead) / np.tan(np.radians(view["field_of_view_deg"] / 2))
    assert -1.0 < height.min() < -0.3 and 0.3 < height.max() < 1.0
    below = point[:, 2].min() - table["position_mm"][2]
    assert 0.0 < below < 0.05 * np.ptp(point, axis=0).max()


@pytest.mark.parametrize(
    ("body", "found"),
    [
        ("file,level\na.tif,1\n", "found file, level"),
        ("a.tif,45,0,0\n", "a.tif,45,0,0"),
        ("a.tif,45,north,1\n", "a.tif,45,north,1"),
        ("a.tif,45,0,1\nA.TIF,45,0,1\n", "'A.TIF' again"),
    ],
)
def test_a_table_of_lamps_with_a_fault_is_refused_by_its_line(body, found, tmp_path):
    header = "" if body.startswith("file") else "file,light_deg,light_azimuth_deg,light_level\n"
    (tmp_path / "lamps.csv").write_text(header + body)
    with pytest.raises(InputError, match=re.escape(found)) as caught:
        read_lamps(tmp_path / "lamps.csv")
    assert "lamps.csv" in str(caught.value)


def test_what_other_programs_lay_beside_photographs_is_no_photograph(tmp_path):
    for name in ("a.dng", "a.dng.dop", "a.on1", "clip.MOV", "notes.odt", "b.dng"):
        (tmp_path / name).write_bytes(b"no RAW file")
    assert [file.name for file in raw_files(tmp_path)] == ["a.dng", "b.dng"]
    with pytest.raises(InputError, match=r"a\.dng: found a file LibRaw cannot decode \([^b'\"]") as caught:
        photographs(tmp_path)
    assert "b'" not in str(caught.value)


def test_what_a_person_says_is_not_called_assumed(seen, taken, tmp_path, capsys):
    more = {"white_reflectance": 0.9, "reference_pose": [45, 10], "tilt_deg": 5, "turn_deg": 0}
    more["light_azimuth_deg"] = -30
    assert init(taken[0], "--answers", written(tmp_path / "answers.yaml", ANSWERS | more)) == 0
    out = capsys.readouterr().out
    assert "reflectance_factor" not in out and "tilt_deg" not in out and "refractive_index" in out
    loaded = load_definitions(read_yaml("config/my-plate.yaml"), tmp_path, "config/my-plate.yaml")
    assert loaded.cameras["my-plate-camera"].white.reflectance_factor == 0.9
    shots = [shot for shot in read_captures("config/captures/my-plate.csv") if shot.role == "object"]
    assert {(shot.pose.tilt_deg, shot.pose.light_azimuth_deg) for shot in shots} == {(5, -30)}


def test_what_nobody_says_is_a_gap_that_the_check_names(seen, taken, tmp_path, capsys):
    folder, truth = taken
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


def test_a_terminal_is_asked_until_it_is_understood(seen, taken, monkeypatch, tmp_path, capsys):
    lines = {
        "camera_distance_mm": ["90 cm", "-4", "900"], "lamp": ["A"], "reference_pose": ["45", ""],
        "white_reflectance": [""], "focal_length_mm": ["50"], "pixel_pitch_um": ["19.2"],
        "shape": ["cube 3", "plate 90 80"], "light_deg": ["45"], "camera_deg": ["20 60 70", "20 60"],
        "light_azimuth_deg": [""], "tilt_deg": [""], "turn_deg": EOFError,
    }  # fmt: skip
    shown = []

    def typed(words: str) -> str:
        shown.append(words)
        left = lines[words.splitlines()[-1].strip(" :")]
        if left is EOFError:
            raise EOFError
        return left.pop(0)

    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", typed)
    assert init(taken[0]) == 0
    assert not any(left for left in lines.values() if left is not EOFError), "each line was read"
    assert [words for words in shown if "accepted: a number above 0" in words]
    assert [words for words in shown if "accepted: one number, or 2 in the order of the photographs" in words]
    loaded = load_definitions(read_yaml("config/my-plate.yaml"), tmp_path, "config/my-plate.yaml")
    plate = loaded.objects["my-plate"].shape
    assert (plate.width_mm, plate.height_mm) == (90.0, 80.0)
    assert loaded.rigs["my-plate-rig"].camera_distance_mm == 900.0
    assert "turn_deg in config/captures/my-plate.csv: 0" in capsys.readouterr().out


def test_a_decimal_comma_is_refused_and_not_taken_for_two_numbers(seen, tmp_path, capsys):
    answers = written(tmp_path / "answers.yaml", ANSWERS | {"shape": "plate 90,5"})
    assert init(seen, "--answers", answers) == 2
    assert "accepted: numbers, with a decimal point" in capsys.readouterr().err
    assert not Path("config").exists()


def test_a_folder_of_another_script_needs_a_name(seen, tmp_path, monkeypatch, capsys):
    places = [tmp_path / "お皿", tmp_path / "茶碗"]
    for place in places:
        place.symlink_to(seen)
    answers = written(tmp_path / "answers.yaml", ANSWERS)
    assert init(places[0], "--answers", answers) == 2
    said = capsys.readouterr().err
    assert "found 'お皿'; accepted: a name of the letters a to z, digits and hyphens" in said and said.count("\n") == 1
    assert init(places[0], "--answers", answers, "--name", "お皿") == 2
    for place, name in zip(places, ("plate", "Bowl 2"), strict=True):
        assert init(place, "--answers", answers, "--name", name) == 0
    assert "name: bowl-2\n" in capsys.readouterr().out
    assert Path("config/plate.yaml").is_file() and Path("config/bowl-2.yaml").is_file()
    # On a terminal it is asked for, and nothing is written without one.
    asked = iter(["茶碗", "bowl", *[""] * 20])
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", lambda words: next(asked))
    assert init(places[1]) == 1 and Path("config/bowl.yaml").is_file()
    monkeypatch.setattr("builtins.input", lambda words: "")
    assert init(places[1]) == 2


def test_what_cannot_be_written_and_a_stop_are_one_sentence(seen, tmp_path, monkeypatch, capsys):
    answers = written(tmp_path / "answers.yaml", ANSWERS)
    for into in ("answers.yaml", "answers.yaml/deeper", "x" * 300):
        assert init(seen, "--answers", answers, "--into", into) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and said.startswith((str(tmp_path / "answers.yaml"), into))
    assert init(seen, "--answers", answers, "--name", "x" * 260) == 2
    assert "at most 100 of them" in capsys.readouterr().err

    def stopped(words):
        raise KeyboardInterrupt

    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", stopped)
    assert init(seen) == 130
    assert capsys.readouterr().err == "\nstopped; typed answers are not kept, those in a file are (--answers)\n"
    assert not Path("config").exists()


@pytest.mark.parametrize(
    ("read", "text", "value"),
    [
        (numbers(3), "4", [4.0, 4.0, 4.0]),
        (numbers(3), "1, 2 3", [1.0, 2.0, 3.0]),
        (numbers(3), "1 2", None),
        (numbers(1), "nan", None),
        (numbers(3), "0,20,35", [0.0, 20.0, 35.0]),
        (numbers(2), "45,5", None),
        (positive, "0,99", None),
        (pose_of_references, "45,5", None),
        (shape, "plate 90,5", None),
        (shape, "sphere 40,5", None),
        (shape, "plate 90.5", {"kind": "plate", "width_mm": 90.5, "height_mm": 90.5}),
        (name_in_files, "My plate 2", "my-plate-2"),
        (name_in_files, "お皿", None),
        (name_in_files, "Teller für 2", None),
        (name_in_files, "x" * 260, None),
        (positive, "0", None),
        (shape, "sphere 30", {"kind": "sphere", "radius_mm": 30.0}),
        (shape, "plate 90", {"kind": "plate", "width_mm": 90.0, "height_mm": 90.0}),
        (shape, "sphere 30 30", None),
        (shape, "plate 90 -3", None),
        (shape, "mesh a lid.obj", {"kind": "mesh", "file": "a lid.obj", "unit": "mm", "up": "z"}),
        (shape, "mesh lid.GLB", {"kind": "mesh", "file": "lid.GLB", "unit": "m", "up": "y"}),
        (shape, "mesh", None),
    ],
)
def test_answers_are_read_as_they_are_meant_or_not_at_all(read, text, value):
    if value is None:
        with pytest.raises(ValueError, match=r"\w"):
            read(text)
    else:
        assert read(text) == value


@pytest.mark.heavy
def test_one_photograph_of_a_chart_makes_a_camera(taken, tmp_path, monkeypatch, capsys):
    folder, truth = taken
    monkeypatch.chdir(tmp_path)
    chart = next(name for name, shot in truth.items() if shot.role == "chart" and shot.filter == "out")
    assert init(folder / chart, "--name", "eye", "--answers", written(tmp_path / "answers.yaml", {"lamp": "A"})) == 0
    out = capsys.readouterr().out
    assert "camera_distance_mm: 1000" in out and "--configfile=config/eye.yaml calibrate" in out
    loaded = load_definitions(read_yaml("config/eye.yaml"), tmp_path, "config/eye.yaml")
    assert list(loaded.cameras) == ["eye"] and not loaded.objects
    assert main(["check", "config/eye.yaml"]) == 0
    assert main(["preview", "--configfile", "config/eye.yaml"]) == 0
    page = Path("contact_sheet.html").read_text()
    assert page.count("<polygon") == 24, "the chart that was found is drawn"
    # The virtual chart is 90 mm wide, six patches, in the middle of the picture: 15 mm from patch to patch.
    corners = [[float(c) for c in p.split(",")] for p in page.split('<polygon points="')[1].split('"')[0].split()]
    middle = np.mean(corners, axis=0)
    scale = 50.0 / 900.0 / (2.0 * 0.0192)
    assert np.abs(middle - [100.0 - 37.5 * scale, 75.0 - 22.5 * scale]).max() < 2.0


@pytest.mark.heavy
def test_linear_pictures_make_the_project_that_their_raw_files_make(taken, tmp_path, monkeypatch, capsys):
    """But for exposure times, which most programs drop: here those of the white surface are all one."""
    folder, truth = taken
    monkeypatch.chdir(tmp_path)
    for name, shot in truth.items():
        if shot.filter == "out" and shot.exposure_s == 0.02 and shot.role != "dark":
            develop_linearly(folder / name, Path(name.replace(".dng", ".png")))
    answers = ANSWERS | {"pixel_pitch_um": 38.4}
    assert init(Path(), "--answers", written(tmp_path / "answers.yaml", answers)) == 2
    assert "or --linear, if you know" in capsys.readouterr().err
    assert init(Path(), "--linear", "--name", "my-plate", "--answers", "answers.yaml") == 0
    assert "exposure_s in config/captures/my-plate.csv: 1 where the file states none" in capsys.readouterr().out
    shots = read_captures("config/captures/my-plate.csv", Path())
    assert {shot.role for shot in shots} == {"chart", "white", "object"} and all(shot.linear for shot in shots)
    for shot in shots:
        real = truth[shot.file.replace(".png", ".dng")]
        assert (shot.role, shot.pose) == (real.role, real.pose)
    optics = load_definitions(read_yaml("config/my-plate.yaml"), tmp_path, "x").cameras["my-plate-camera"].optics
    # A mosaic pixel is half a pixel of the picture: the lens is that of the RAW files.
    assert (optics.width_px, optics.height_px, optics.pixel_pitch_um) == (400, 300, 19.2)


@pytest.mark.parametrize("command", of_kind("first project"))
def test_a_documented_command_writes_a_first_project(command, seen, taken, recognised, tmp_path, monkeypatch):
    words = words_of(command)[1:]
    Path("My plate").symlink_to(taken[0])
    written(Path("answers.yaml"), ANSWERS)
    shown = {one.photograph.path.name: (0.0, 0.5, 1.0) for one in recognised if one.role == "object"}
    light_file(Path("dome.lp"), shown)
    Path("dome").mkdir()
    write_lamps("dome/lamps.csv", dict.fromkeys(shown, (30.0, 90.0, 1.02)))
    alone = words[1].endswith(".CR2")
    if alone:
        monkeypatch.undo()
        monkeypatch.chdir(tmp_path)
        chart = next(name for name, shot in taken[1].items() if shot.role == "chart" and shot.filter == "out")
        shutil.copy(taken[0] / chart, words[1])
    if "--linear" in words:
        monkeypatch.undo()
        monkeypatch.chdir(tmp_path)
        Path("My plate").unlink()
        Path("My plate").mkdir()
        for name, shot in taken[1].items():
            if shot.filter == "out" and shot.exposure_s == 0.02 and shot.role != "dark":
                develop_linearly(taken[0] / name, Path("My plate", name.replace(".dng", ".tif")))
    # What no answer tells is left as gaps, which are said by status 1.
    assert main(words) == (0 if "--answers" in words else 1)
    assert Path("config", "eye.yaml" if alone else "my-plate.yaml").is_file()


@pytest.mark.heavy
def test_a_pose_without_its_second_photograph_is_left_open(taken, looked, recognised, capsys):
    _, truth = taken
    lost = [name for name, shot in truth.items() if shot.role == "object" and shot.filter == "in"][1]
    found = recognise([one for one in looked if one.path.name != lost])
    alone = [name for name, shot in truth.items() if shot.capture == truth[lost].capture and name != lost]
    assert [one.photograph.path.name for one in found if not one.filter] == alone


@pytest.fixture
def no_chart(monkeypatch):
    monkeypatch.setattr("irodori.first_project.recognition._has_chart", lambda one, spectra: False)


def test_photographs_out_of_order_are_told_apart_no_longer(no_chart):
    pairs = [
        patterned(f"{view}-{state}", level, view) for view in range(4) for state, level in (("out", 0.8), ("in", 0.2))
    ]
    sound = recognise(pairs)
    assert [(one.pose, one.filter) for one in sound] == [(view, state) for view in range(4) for state in ("out", "in")]
    mixed = pairs[0:1] + pairs[2:3] + pairs[1:2] + pairs[3:]
    found = recognise(mixed)
    assert [one.photograph.path.name for one in found if not one.filter] == ["0-out", "1-out", "0-in", "1-in"]
    assert [one.filter for one in found[4:]] == ["out", "in"] * 2, "the others are as they were"


def test_a_lamp_that_was_moved_is_no_filter(no_chart):
    """The view stays, and the light of the second pose is as much weaker as a filter's could be."""
    shots = [(level * share, seconds) for level in (0.8, 0.43, 0.9) for share, seconds in ((1.0, 0.02), (0.75, 0.05))]
    found = recognise([patterned(f"{n}.dng", level, 1, seconds) for n, (level, seconds) in enumerate(shots)])
    assert [(one.pose, one.filter) for one in found] == [(view, state) for view in range(3) for state in ("out", "in")]


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


def with_time(path, source, time: str, fraction: str = "") -> None:
    """Write a DNG again with the time of its camera's clock, in a directory of tags before its own."""
    content = source.read_bytes()
    assert content[:4] == b"II*\0"
    texts = [(36867, time.encode() + b"\0")] + ([(37521, fraction.encode() + b"\0")] if fraction else [])
    at = len(content) + len(content) % 2
    end = at + 2 + 12 * len(texts) + 4
    entries, values = b"", b""
    for tag, text in texts:
        inline = len(text) <= 4
        value = text.ljust(4, b"\0") if inline else struct.pack("<I", end + len(values))
        entries += struct.pack("<HHI", tag, 2, len(text)) + value
        values += b"" if inline else text
    # The new directory is the last of the chain, so that the picture stays in the first.
    chain = struct.unpack_from("<I", content, 4)[0]
    while following := struct.unpack_from("<I", content, chain + 2 + 12 * struct.unpack_from("<H", content, chain)[0])[
        0
    ]:
        chain = following
    link = chain + 2 + 12 * struct.unpack_from("<H", content, chain)[0]
    whole = bytearray(content.ljust(at, b"\0") + struct.pack("<H", len(texts)) + entries + bytes(4) + values)
    struct.pack_into("<I", whole, link, at)
    path.write_bytes(whole)


def timed(folder, taken, *times: tuple[str, str, str]):
    """Return a folder with copies of one photograph by names, each with a time and its fraction of a second."""
    folder.mkdir()
    for name, time, fraction in times:
        with_time(folder / name, next(taken[0].glob("*.dng")), time, fraction)
    return folder


def test_photographs_of_one_second_are_in_the_order_of_its_fractions(taken, tmp_path):
    second = "2026:10:25 02:50:00"
    folder = timed(tmp_path / "raw", taken, ("b.dng", second, "05"), ("a.dng", second, "5"), ("c.dng", second, "47"))
    found, order = photographs(folder)
    assert [one.path.name for one in found] == ["b.dng", "c.dng", "a.dng"] and order == "the camera's clock"
    assert found[0].look.time == "2026-10-25T02:50:00.05"


def test_a_clock_of_zeros_is_no_time(taken, tmp_path):
    zero = ("IMG_0003.dng", "0000:00:00 00:00:00", "00")
    others = [(f"IMG_000{n}.dng", f"2026:10:25 02:50:0{n}", "") for n in (2, 4)]
    found, order = photographs(timed(tmp_path / "raw", taken, zero, *others))
    assert [one.path.stem for one in found] == ["IMG_0002", "IMG_0003", "IMG_0004"]
    assert order == "their names, because not every file states its time"


def test_a_clock_set_back_between_two_photographs_is_refused_before_anything_is_written(
    taken, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    times = [("IMG_0001.dng", "2026:10:25 02:59:50", ""), ("IMG_0002.dng", "2026:10:25 02:00:10", "")]
    assert init(timed(tmp_path / "raw", taken, *times)) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert "IMG_0002.dng: time: found 2026-10-25T02:00:10, before 2026-10-25T02:59:50 of IMG_0001.dng" in said
    assert "--order names" in said and not (tmp_path / "config").exists()
    for order, names in (("names", ["IMG_0001", "IMG_0002"]), ("clock", ["IMG_0002", "IMG_0001"])):
        assert [one.path.stem for one in photographs(tmp_path / "raw", False, order)[0]] == names
    # The command passes the statement on: what it misses then is the chart.
    assert init(tmp_path / "raw", "--order", "names") == 2
    assert "no ColorChecker" in capsys.readouterr().err


@pytest.mark.parametrize("alone", [False, True])
def test_links_out_of_the_folder_are_refused_before_anything_is_looked_at_or_written(
    alone, taken, tmp_path, capsys, monkeypatch
):
    """Tables, and with them every later command, refuse such a file."""
    monkeypatch.chdir(tmp_path)
    Path("raw").mkdir()
    link, target = Path("raw", "IMG_0001.dng"), next(taken[0].glob("*.dng"))
    link.symlink_to(target)
    assert init(link if alone else "raw", "--name", "plate") == 2
    said = capsys.readouterr().err
    assert said == (
        f"{link}: found 'IMG_0001.dng', a link that leads out of raw to {target}; accepted: a file in raw itself, or "
        "the folder where the files are.\n"
    )
    assert not Path("config").exists()


def test_links_within_the_folder_and_of_the_folder_itself_are_followed(taken, tmp_path):
    (tmp_path / "raw").mkdir()
    shutil.copy(next(taken[0].glob("*.dng")), tmp_path / "raw" / "IMG_0001.dng")
    (tmp_path / "raw" / "IMG_0002.dng").symlink_to("IMG_0001.dng")
    (tmp_path / "link").symlink_to("raw")
    assert [one.path.name for one in photographs(tmp_path / "link")[0]] == ["IMG_0001.dng", "IMG_0002.dng"]
    (tmp_path / "raw" / "IMG_0003.dng").symlink_to("IMG_0004.dng")
    with pytest.raises(InputError, match=r"IMG_0003\.dng: found a link to no file"):
        photographs(tmp_path / "raw")


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
