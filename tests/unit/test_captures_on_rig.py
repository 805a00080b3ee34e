"""A real rig: what its definitions, tables and files must agree on."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
from definitions import CAMERA_FILE, PLATE_FILE, ROOM_FILE, ROOT, edit, fault, load

from irodori.capture.shot_list import camera_shots
from irodori.config.capture_table import COLUMNS
from irodori.config.definitions import read_yaml
from irodori.config.photograph_sets import PhotographSets
from irodori.core.errors import InputError

DATA = ROOT.parent / "shared" / "data"
POSE = "l0450-c0000-t000-r0000"


# ---- a real rig


@pytest.fixture
def studio(root):
    """Return a working directory in which the plate, its camera and the room come from files."""
    for name, rows in {
        "camera": ["chart,45,0,out", "chart,45,0,in", "white,45,0,out", "white,45,0,in"],
        "room": [
            f"{role},0,0,{state}"
            for role in ("environment", "room-chart-desk", "room-chart-window")
            for state in ("out", "in")
        ],
        "plate": ["object,45,20,out", "object,45,20,in", "object,45,0,out", "object,45,0,in", "dark,0,0,out"],
    }.items():
        lines = [",".join(COLUMNS)]
        (root / name).mkdir()
        for number, row in enumerate(rows):
            role, light, camera, state = row.split(",")
            (root / name / f"{number}.dng").write_bytes(b"raw")
            lines.append(f"{number}.dng,{role},{light},{camera},0,0,{state},0.02")
        (root / name / "captures.csv").write_text("\n".join(lines))
    for key in ("virtual", "poses", "exposure_s", "dark_frames", "white_frames", "linearity_exposure_s"):
        edit(root, CAMERA_FILE, key, ...)
    for key in ("virtual", "poses", "exposure_s"):
        edit(root, PLATE_FILE, key, ...)
    for key in ("virtual", "exposure_s"):
        edit(root, ROOM_FILE, key, ...)
    edit(root, CAMERA_FILE, "rig", "copy-stand")
    edit(root, CAMERA_FILE, "captures", {"table": "camera/captures.csv"})
    edit(root, ROOM_FILE, "captures", {"table": "room/captures.csv", "folder": "room"})
    edit(root, PLATE_FILE, "captures", {"table": "plate/captures.csv"})
    edit(root, "scenes/still-life.yaml", "objects", [{"object": "tile-plate", "position_mm": [0, 0, 0]}])
    edit(root, "scenes/still-life.yaml", "photographs", {})
    edit(root, "config.yaml", "photographed_together", ...)
    return root


def test_a_scene_of_a_real_rig_loads(studio):
    definitions = load(studio)
    assert not definitions.is_virtual("objects", "tile-plate")
    captures = ["l0450-c0000-t000-r0000", "l0450-c0200-t000-r0000"]
    assert definitions.captures_of("objects", "tile-plate", studio) == captures


def test_how_far_the_lamp_of_a_rig_may_differ_from_its_spectrum_is_what_its_definition_says(studio, monkeypatch):
    monkeypatch.chdir(studio)
    camera = SimpleNamespace(camera="d5100-comb")
    assert PhotographSets(load(studio)).light_error_percent(camera) is None
    edit(studio, f"rigs/{load(studio).cameras['d5100-comb'].rig}.yaml", "light.error_percent", 1.5)
    assert PhotographSets(load(studio)).light_error_percent(camera) == 1.5


def add_sheets(studio, *states) -> None:
    """Photograph the printed sheet with the camera, all photographs with the same exposure time."""
    table = studio / "camera/captures.csv"
    for number, state in enumerate(states):
        (studio / f"camera/sheet{number}.dng").write_bytes(b"raw")
        table.write_text(f"{table.read_text()}\nsheet{number}.dng,lens,0,0,0,0,{state},0.02")


def test_photographs_of_the_sheet_give_the_camera_a_measured_lens_which_its_objects_use(studio, monkeypatch):
    monkeypatch.chdir(studio)
    camera = SimpleNamespace(camera="d5100-comb")
    plate, room = SimpleNamespace(object="tile-plate"), SimpleNamespace(environment="classroom")
    before = PhotographSets(load(studio))
    assert before.sheet(camera) == before.lens(plate) == before.lenses(None) == []
    add_sheets(studio, "out", "out", "out")
    after = PhotographSets(load(studio))
    assert after.sheet(camera) == ["camera/captures.csv", *(f"camera/sheet{number}.dng" for number in range(3))]
    lens = ["results/cameras/d5100-comb/lens.yaml"]
    assert after.lens(camera) == after.lens(plate) == after.lens(room) == after.lenses(None) == lens
    # What calibrates the camera's colours reads no photograph of the sheet.
    assert after.own_photographs(camera) == before.own_photographs(camera)
    assert after.captures == before.captures


def test_photographs_of_the_sheet_through_the_filter_or_of_a_camera_without_optics_are_refused(studio):
    add_sheets(studio, "out", "in")
    error = fault(studio)
    assert error.file.endswith("captures.csv") and "the sheet with the filter in, sheet1.dng" in error.found
    table = studio / "camera/captures.csv"
    table.write_text(table.read_text().replace("lens,0,0,0,0,in", "lens,0,0,0,0,out"))
    edit(studio, CAMERA_FILE, "optics", ...)
    error = fault(studio, scenes=[], cameras=["d5100-comb"])
    assert error.field == "optics" and "photographs of the role lens" in error.found


def test_a_place_needs_optics_where_a_near_lamp_lit_the_white_reference(studio):
    """Without them nobody knows by how much, pixel by pixel."""
    second = "cameras/second.yaml"  # objects need optics anyway
    shutil.copy(studio / "config" / CAMERA_FILE, studio / "config" / second)
    edit(studio, second, "optics", ...)
    edit(studio, ROOM_FILE, "camera", "second")
    load(studio)
    edit(studio, "rigs/copy-stand.yaml", "light.distance_mm", 600.0)
    error = fault(studio)
    assert (error.file, error.field) == (f"config/{ROOM_FILE}", "camera")
    assert "'second' without optics" in error.found and "second.yaml" in error.accepted


@pytest.mark.parametrize(
    ("file", "path", "value", "field", "found"),
    [
        (PLATE_FILE, "captures", ..., "captures", "no such key"),
        (ROOM_FILE, "captures", ..., "captures", "no such key"),
        (CAMERA_FILE, "captures", ..., "captures", "no such key"),
        (CAMERA_FILE, "optics", ..., "camera", "without optics"),
        (
            PLATE_FILE,
            "captures.table",
            "plate/capture.csv",
            "captures.table",
            "no such file: plate/capture.csv",
        ),
        (PLATE_FILE, "captures.folder", "plates", "line 2, file", "no such file"),
        (PLATE_FILE, "captures.table", "camera/captures.csv", "role", "only chart, white"),
    ],
)
def test_what_a_real_rig_needs(studio, file, path, value, field, found):
    edit(studio, file, path, value)
    error = fault(studio)
    assert error.field == field
    assert found in error.found


@pytest.mark.parametrize(
    ("file", "path", "value", "found"),
    [
        (PLATE_FILE, "shape.width_mm", 0.09, None),
        (PLATE_FILE, "shape", {"kind": "plate", "width_mm": 0.09, "height_mm": 0.09}, "0.5 pixels in the picture"),
        (PLATE_FILE, "shape", {"kind": "sphere", "radius_mm": 900.0}, "a camera at 900 mm would stand"),
        (PLATE_FILE, "shape", {"kind": "plate", "width_mm": 900, "height_mm": 900}, "of which 2% lies in the frame"),
        (CAMERA_FILE, "optics.pixel_pitch_um", 0.01, "of which 0% lies in the frame"),
        (CAMERA_FILE, "optics.focal_length_mm", 0.05, "0.5 pixels in the picture"),
    ],
)
def test_lengths_in_another_unit_are_refused(studio, file, path, value, found):
    edit(studio, file, path, value)
    if found is None:  # a thread, a hair: one side alone tells no unit
        load(studio)
        return
    error = fault(studio)
    assert error.file.endswith(PLATE_FILE) and error.field == "shape"
    assert found in error.found and "lengths in mm" in error.accepted


@pytest.mark.parametrize("distance_mm", [0.9, 45.0])
def test_a_lamp_within_the_object_is_refused(studio, distance_mm):
    edit(studio, "rigs/copy-stand.yaml", "light.distance_mm", distance_mm)
    error = fault(studio)
    assert error.file.endswith("rigs/copy-stand.yaml") and error.field == "light.distance_mm"
    assert error.found == f"{distance_mm:g} mm from the middle of a plate 90 x 90 mm, and so within it"
    edit(studio, "rigs/copy-stand.yaml", "light.distance_mm", 900.0)
    load(studio)


AROUND = [
    ("exposure_s\n", "exposure_s,light_azimuth_deg\n"), ("out,0.02", "out,0.02,120"), ("in,0.02", "in,0.02,120"),
]  # fmt: skip


def test_a_lamp_beside_the_plane_needs_a_limit_of_its_azimuth(studio):
    edit(studio, "rigs/copy-stand.yaml", "limits.light_azimuth_deg", ...)
    error = refill(studio, "plate", *AROUND)
    assert error.field.startswith("light_azimuth_deg of 0.dng") and error.found == "120"
    assert "copy-stand.yaml has no limits.light_azimuth_deg" in error.accepted
    edit(studio, "rigs/copy-stand.yaml", "limits.light_azimuth_deg", {"min": -90.0, "max": 90.0, "step": 1.0})
    error = refill(studio, "plate", *AROUND)
    assert error.found == "120" and "-90 to 90 degrees" in error.accepted
    edit(studio, "rigs/copy-stand.yaml", "limits.light_azimuth_deg.max", 180.0)
    table = studio / "plate" / "captures.csv"
    for old, new in AROUND:
        table.write_text(table.read_text().replace(old, new))
    assert load(studio).captures_of("objects", "tile-plate", studio)[0] == "l0450-c0000-t000-r0000-a1200"


def refill(studio: Path, name: str, *changes: tuple[str, str]) -> InputError:
    """Return the fault of a table of which parts are replaced."""
    table = studio / name / "captures.csv"
    good = table.read_text()
    text = good
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    table.write_text(text)
    error = fault(studio)
    table.write_text(good)
    assert error.file.endswith(f"{name}/captures.csv")
    return error


def test_files_of_a_real_rig_are_checked(studio):
    assert refill(studio, "plate", ("object,45,20", "object,126,20")).field == "light_deg of 0.dng"
    assert "only with the filter in" in refill(studio, "plate", ("2.dng,object,45,0", "2.dng,dark,45,0")).found
    (studio / "plate" / "4.dng").write_bytes(b"")
    assert "an empty file" in fault(studio).found


WHITES = "\n2.dng,white,45,0,0,0,out,0.02\n3.dng,white,45,0,0,0,in,0.02"


def test_a_camera_that_photographs_needs_its_white_reference(studio):
    edit(studio, CAMERA_FILE, "white", ...)
    error = fault(studio)
    assert (Path(error.file).name, error.field) == ("d5100-comb.yaml", "white")
    assert "captures.csv lists photographs of the role white" in error.found
    assert "reflectance_factor" in error.accepted
    error = refill(studio, "camera", (WHITES, ""))
    assert error.field == "role"
    assert "no photograph of the role white, though config/objects/tile-plate.yaml" in error.found


def test_a_camera_of_a_chart_alone_needs_no_white_but_a_key_for_one(studio):
    edit(studio, CAMERA_FILE, "white", ...)
    only_camera = {"scenes": [], "cameras": ["d5100-comb"]}
    assert fault(studio, **only_camera).field == "white"
    table = studio / "camera" / "captures.csv"
    table.write_text(table.read_text().replace(WHITES, ""))
    assert load(studio, **only_camera).cameras["d5100-comb"].white is None


@pytest.mark.parametrize(
    ("name", "changes", "field", "found", "accepted"),
    [
        ("plate", [("\n3.dng,object,45,0,0,0,in,0.02", "")], f"filter of the capture {POSE}",
         "the filter states out", "out, in, as the chart has in "),
        ("room", [("\n1.dng,environment,0,0,0,0,in,0.02", "")], "filter of the capture environment",
         "the filter states out", "the filter states out, in"),
        ("room", [("room-chart-window", "room-chart-door")], "role of 4.dng", "no room_charts.door", "of room_charts"),
        ("room", [("room-chart-window", "dark")], "role", "no photograph of the role room-chart-window",
         "each of the room_charts of"),
        ("room", [("\n5.dng,room-chart-window,0,0,0,0,in,0.02", "")], "filter of the capture room-chart-window",
         "the filter states out", "the filter states out, in"),
        ("camera", [("\n3.dng,white,45,0,0,0,in,0.02", "")], "filter of the capture white",
         "the filter states out", "the filter states out, in"),
        ("camera", [("3.dng,white,45", "3.dng,white,50")], "light_deg of 3.dng", "50",
         "45, as of 2.dng: one pose for all photographs of the role white"),
        ("camera", [("1.dng,chart,45,0,0,0", "1.dng,chart,45,0,0,90")], "turn_deg of 1.dng", "90",
         "0, as of 0.dng: one pose for all photographs of the role chart"),
        ("camera", [("white,45", "white,126")], "light_deg of 2.dng", "126", "0 to 125 degrees"),
        ("camera", [("chart,45,0", "chart,45,141")], "camera_deg of 0.dng", "141", "0 to 140 degrees"),
        ("camera", [("chart,45,0", "chart,80,0")], "light_deg of 0.dng", "the light at 80 degrees",
         "from 0 to below 80 degrees"),
        ("camera", [("white,45,0,0", "white,20,0,30")], "light_deg of 2.dng", "the light at -10 degrees",
         "from 0 to below 80 degrees"),
        ("plate", [("object,45,20", "object,0.785398,0.349066"), ("object,45,0", "object,0.785398,0")],
         "light_deg of 0.dng", "0.785398, in radians", "degrees: 0.785398 rad are 45 degrees"),
    ],
)  # fmt: skip
def test_tables_of_a_real_rig_agree(studio, name, changes, field, found, accepted):
    error = refill(studio, name, *changes)
    assert error.field == field
    assert found in error.found
    assert accepted in error.accepted


def test_a_camera_of_three_bands_keeps_three_bases(studio):
    edit(studio, CAMERA_FILE, "calibration", {"estimator": "pinv", "bases": 6})
    for folder in ("camera", "room", "plate"):
        table = studio / folder / "captures.csv"
        table.write_text("\n".join(line for line in table.read_text().splitlines() if ",in," not in line))
    error = fault(studio)
    assert (error.field, error.found) == ("calibration.bases", "6")
    assert "1 to 3, 3 for each filter state of the chart (out)" in error.accepted
    for unsaid in ({"estimator": "pinv"}, ...):
        edit(studio, CAMERA_FILE, "calibration", unsaid)
        assert load(studio).cameras["d5100-comb"].calibration.bases is None


BRACKET = {"out": [0.02], "in": [0.05]}


@pytest.mark.parametrize(
    ("file", "key", "value"),
    [
        (PLATE_FILE, "virtual", ...),
        (PLATE_FILE, "poses", [{"light_deg": [45], "camera_deg": [0]}]),
        (PLATE_FILE, "exposure_s", BRACKET),
        (CAMERA_FILE, "virtual", ...),
        (CAMERA_FILE, "poses", {"chart": {"light_deg": 45, "camera_deg": 0}}),
        (CAMERA_FILE, "exposure_s", BRACKET),
        (CAMERA_FILE, "dark_frames", 0),
        (CAMERA_FILE, "white_frames", 2),
        (ROOM_FILE, "virtual", ...),
        (ROOM_FILE, "exposure_s", BRACKET),
    ],
)  # fmt: skip
def test_a_key_of_the_virtual_rig_is_refused_on_a_real_one(studio, file, key, value):
    edit(studio, file, key, read_yaml(ROOT / "config" / file)[key] if value is ... else value)
    error = fault(studio)
    assert (Path(error.file).name, error.field) == (Path(file).name, key)
    assert "a rig of kind files does not use" in error.found
    assert "leave it out (config/rigs/copy-stand.yaml" in error.accepted


@pytest.mark.parametrize("file", [PLATE_FILE, CAMERA_FILE, ROOM_FILE])
def test_a_table_of_photographs_is_refused_on_the_virtual_rig(root, file):
    edit(root, file, "captures", {"table": "captures.csv"})
    error = fault(root)
    assert (Path(error.file).name, error.field) == (Path(file).name, "captures")
    assert "a rig of kind virtual does not use" in error.found


def test_frames_that_the_virtual_rig_takes_have_defaults(root, studio):
    assert not {"dark_frames", "white_frames"} & load(studio).cameras["d5100-comb"].plain().keys()
    shutil.copy(ROOT / "config" / CAMERA_FILE, root / "config" / CAMERA_FILE)
    for key in ("dark_frames", "white_frames"):
        edit(root, CAMERA_FILE, key, ...)
    camera = load(root, scenes=[], cameras=["d5100-comb"]).cameras["d5100-comb"]
    frames = [shot.file for shot in camera_shots(camera, ".dng") if shot.role in ("dark", "white")]
    assert {file.split("-")[0] for file in frames} == {"white"}
    assert {file[-6:] for file in frames} == {"00.dng", "01.dng"}
