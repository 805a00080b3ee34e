"""All definitions together: reading, names that lead from file to file, agreement between files."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from irodori.captures import COLUMNS
from irodori.config import captures_of, is_virtual, load_definitions, read_yaml
from irodori.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"
POSE = "l0450-c0000-t000-r0000"


# ---- reading YAML


@pytest.mark.parametrize(
    ("text", "place", "found"),
    [
        (b"a: 1\nb: [1, 2\n", "line 3", "expected"),
        (b"a: 1\nb: 2\na: 3\n", "line 3, column 1", "the key 'a' twice"),
        (b"a:\n  b: 1\n  b: 2\n", "line 3, column 3", "the key 'b' twice"),
        (b"a: 1\nwhen: 2010-13-45\n", "line 2", "month"),
        (b"a: \xff\xfe\n", "", ""),
        (b"", "", "an empty file"),
        (b"- 1\n", "", "a list"),
        (b"? [1, 2]\n: 3\n", "line 1", "unhashable"),
        (b"a: !!python/name:os.system\n", "line 1", "constructor"),
        (b"[" * 100_000, "", "nested too deep"),
    ],
)
def test_a_broken_yaml_names_its_line(tmp_path, text, place, found):
    path = tmp_path / "x.yaml"
    path.write_bytes(text)
    with pytest.raises(InputError) as caught:
        read_yaml(path)
    assert caught.value.file == str(path)
    assert caught.value.field.startswith(place)
    assert found in caught.value.found


def test_a_yaml_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_yaml(tmp_path / "x.yaml")
    with pytest.raises(InputError):
        read_yaml(tmp_path)


@settings(deadline=None, max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=60))
def test_any_bytes_give_a_block_or_an_input_error(tmp_path, content):
    path = tmp_path / "x.yaml"
    path.write_bytes(content)
    try:
        assert isinstance(read_yaml(path), dict)
    except InputError as error:
        assert error.found


# ---- all definitions together


def test_nothing_heavy_is_imported():
    code = "import sys, irodori.config, irodori.provenance; print({'numpy', 'numba'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.fixture
def root(tmp_path):
    """Return a working directory with a copy of the repository's configuration."""
    shutil.copytree(ROOT / "config", tmp_path / "work" / "config")
    return tmp_path / "work"


def edit(root: Path, file: str, path: str, value) -> None:
    """Change one key of a file; `path` is dotted, numbers are indexes, value ... removes the key."""
    target = root / "config" / file
    block = content = read_yaml(target)
    *parents, last = [int(part) if part.isdigit() else part for part in path.split(".")]
    for part in parents:
        block = block[part]
    if value is ...:
        del block[last]
    else:
        block[last] = value
    target.write_text(yaml.safe_dump(content), encoding="utf-8")


def load(root: Path, **make) -> dict:
    config = read_yaml(root / "config" / "config.yaml")
    config["make"].update(make)
    return load_definitions(config, root)


def fault(root: Path, **make) -> InputError:
    with pytest.raises(InputError) as caught:
        load(root, **make)
    return caught.value


def test_the_repository_s_own_configuration_loads():
    definitions = load(ROOT)
    assert list(definitions["scenes"]) == ["still-life"]
    assert list(definitions["environments"]) == ["classroom"]
    assert list(definitions["cameras"]) == ["d5100-comb"]
    assert list(definitions["rigs"]) == ["virtual"]
    assert definitions["fit"]["solver"] == "nlopt"
    for name in definitions["objects"]:
        captures = captures_of(definitions, "objects", name)
        assert captures == sorted(set(captures)) and len(captures) >= 10
        assert is_virtual(definitions, "objects", name)
    assert captures_of(definitions, "cameras", "d5100-comb") == ["chart"]
    assert captures_of(definitions, "environments", "classroom") == ["environment"]


def test_the_real_camera_loads_where_its_data_is_present():
    if not (DATA / "raw" / "powershot_s40_chart.crw").is_file():
        pytest.skip("the real data is not beside this checkout")
    real = read_yaml(ROOT / "config" / "real.yaml")
    definitions = load(ROOT, **real["make"])
    assert list(definitions["cameras"]) == ["powershot-s40"]
    assert not is_virtual(definitions, "cameras", "powershot-s40")
    assert captures_of(definitions, "cameras", "powershot-s40") == ["chart"]


def test_the_real_camera_without_its_data_names_the_missing_file(root):
    error = fault(root, **read_yaml(root / "config" / "real.yaml")["make"])
    assert error.file.endswith("powershot-s40.csv") and error.field == "line 2, file"
    assert "no such file" in error.found and "powershot_s40_chart.crw" in error.found


@pytest.mark.parametrize(
    ("file", "path", "value", "named_by", "field", "accepted"),
    [
        ("config.yaml", "make.scenes", ["stil-life"], "config.yaml", "make.scenes[0]",
         "did you mean 'still-life'?"),
        ("config.yaml", "make.cameras", ["d5100"], "config.yaml", "make.cameras[0]", "cameras that exist"),
        ("scenes/still-life.yaml", "objects.1.object", "vermillion-sphere", "still-life.yaml",
         "objects[1].object",
         "did you mean 'vermilion-sphere'? (objects that exist: indigo-sphere, leaf-sphere, tile-plate, "),
        ("scenes/still-life.yaml", "environment", "x", "still-life.yaml", "environment", "classroom"),
        ("objects/leaf-sphere.yaml", "camera", "x", "leaf-sphere.yaml", "camera", "d5100-comb"),
        ("cameras/d5100-comb.yaml", "rig", "virtuel", "d5100-comb.yaml", "rig", "did you mean 'virtual'?"),
    ],
)  # fmt: skip
def test_an_unknown_name_lists_the_existing_ones(root, file, path, value, named_by, field, accepted):
    edit(root, file, path, value)
    error = fault(root)
    assert error.file.endswith(named_by)
    assert error.field == field
    assert accepted in error.accepted


PLATE_FILE, CAMERA_FILE, ROOM_FILE = (
    "objects/tile-plate.yaml",
    "cameras/d5100-comb.yaml",
    "environments/classroom.yaml",
)


@pytest.mark.parametrize(
    ("file", "path", "value", "field", "found", "accepted"),
    [
        (PLATE_FILE, "poses.0.camera_deg.2", 141.0, "poses[0].camera_deg[2]", "141",
         "0 to 140 degrees in steps of 0.1"),
        (PLATE_FILE, "poses.0.camera_deg.2", 34.95, "poses[0].camera_deg[2]", "34.95", "in steps of 0.1"),
        (PLATE_FILE, "poses.1.light_deg.0", 34.5, "poses[1].light_deg[0]", "34.5", "35 to 125"),
        (PLATE_FILE, "poses.2.tilt_deg.0", 20.25, "poses[2].tilt_deg[0]", "20.25", "in steps of 0.5"),
        (PLATE_FILE, "poses.0.turn_deg", [360.0], "poses[0].turn_deg[0]", "360", "limits.turn_deg"),
        (PLATE_FILE, "poses.0.camera_deg.1", 0.0, "poses", f"{POSE} twice", "each pose once"),
        (PLATE_FILE, "poses", ..., "poses", "no such key", "kind virtual"),
        (PLATE_FILE, "exposure_s", ..., "exposure_s", "no such key", "kind virtual"),
        (PLATE_FILE, "virtual", ..., "virtual", "no such key", "kind virtual"),
        (PLATE_FILE, "exposure_s.in", ..., "exposure_s", "out", "in, out, as in"),
        (PLATE_FILE, "virtual.materials.0.spectrum", "paints/red.csv", "virtual.materials[0].spectrum",
         "no such file: paints/red.csv", "published name"),
        (PLATE_FILE, "refractive_index", {"file": "gold.csv"}, "refractive_index.file", "no such file",
         "CSV"),
        (CAMERA_FILE, "poses.white.light_deg", 130.0, "poses.white.light_deg", "130", "35 to 125"),
        (CAMERA_FILE, "poses.white", ..., "poses.white", "no such key", "kind virtual"),
        (CAMERA_FILE, "optics", ..., "optics", "no such key", "kind virtual"),
        (CAMERA_FILE, "virtual", ..., "virtual", "no such key", "kind virtual"),
        (CAMERA_FILE, "exposure_s", ..., "exposure_s", "no such key", "kind virtual"),
        (CAMERA_FILE, "chart.spectra", "chart.ti3", "chart.spectra", "no such file", "published name"),
        (CAMERA_FILE, "virtual.sensitivities", "x/y", "virtual.sensitivities", "no such file",
         "published name"),
        (CAMERA_FILE, "virtual.sensor.black_level", 16383, "virtual.sensor.black_level", "16383",
         "below 16383"),
        (ROOM_FILE, "virtual", ..., "virtual", "no such key", "kind virtual"),
        (ROOM_FILE, "exposure_s", ..., "exposure_s", "no such key", "kind virtual"),
        (ROOM_FILE, "virtual.ambient_light", "sky.csv", "virtual.ambient_light", "no such file",
         "published name"),
        ("rigs/virtual.yaml", "limits.light_deg.min", 126.0, "limits.light_deg.min", "126",
         "below the largest"),
        ("rigs/virtual.yaml", "light.spectrum", "lamp.CSV", "light.spectrum", "no such file",
         "published name"),
        ("config.yaml", "report.lights", ["D65", "lamp.txt"], "report.lights[1]", "no such file",
         "published name"),
        ("config.yaml", "fit.bounds.alpha", [1.0, 1.0], "fit.bounds.alpha", "[1, 1]", "smaller value first"),
        ("scenes/still-life.yaml", "views.front.target_mm", [0.0, -330.0, 190.0], "views.front.target_mm",
         "own position", "another point"),
        ("scenes/still-life.yaml", "views.front.up", [0.0, 0.0, 0.0], "views.front.up", "no length",
         "points up"),
        ("scenes/still-life.yaml", "views.front.up", [0.0, 330.0, -168.0], "views.front.up",
         "line of sight", "up"),
    ],
)  # fmt: skip
def test_what_no_schema_sees(root, file, path, value, field, found, accepted):
    edit(root, file, path, value)
    error = fault(root)
    assert Path(error.file).name == Path(file).name
    assert error.field == field
    assert found in error.found
    assert accepted in error.accepted


def test_every_step_within_the_limits_is_on_the_step(root):
    angles = [tenths / 10 for tenths in range(0, 1401)]
    edit(root, PLATE_FILE, "poses", [{"light_deg": [35.0, 35.5, 125.0], "camera_deg": angles}])
    assert len(captures_of(load(root), "objects", "tile-plate")) == 3 * 1401


def test_a_spectrum_file_that_exists_is_accepted(root):
    (root / "red.csv").write_text("name," + ",".join(map(str, range(400, 701, 10))) + "\nred" + ",0.5" * 31 + "\n")
    edit(root, PLATE_FILE, "virtual.materials.0.spectrum", "red.csv")
    assert load(root)["objects"]["tile-plate"]["virtual"]["materials"][0]["spectrum"] == "red.csv"


@pytest.mark.parametrize(
    ("content", "field"),
    [
        ("wavelength_nm,n,k\n380,0.2,3\n\n" + "".join(f"{w},0.3,4\n" for w in range(430, 731, 50)), None),
        ("wavelength_nm,k,n\n380,1,2\n400,1,2\n450,1,2\n500,1,2\n550,1,2\n600,1,2\n650,1,2\n700,1,2\n", "line 1"),
        ("", ""),
        ("wavelength_nm,n,k\n380,0.2,x\n", "line 2"),
        ("wavelength_nm,n,k\n380,0.2\n", "line 2"),
        ("wavelength_nm,n,k\n" + "".join(f"{w},0,4\n" for w in range(380, 731, 50)), "380 nm"),
        ("wavelength_nm,n,k\n380,1,nan\n", "line 2"),
        ("wavelength_nm,n,k\n380,1,0\n380,1,0\n", "wavelength_nm"),
        ("wavelength_nm,n,k\n", ""),
        ("wavelength_nm,n,k\n410,1,0\n720,1,0\n", "wavelength_nm"),
        ("wavelength_nm,n,k\n380,1,0\n720,1,0\n", "wavelength_nm"),
    ],
)
def test_a_table_of_the_refractive_index(root, content, field):
    (root / "metal.csv").write_text(content)
    edit(root, PLATE_FILE, "refractive_index", {"file": "metal.csv"})
    if field is None:
        assert load(root)["objects"]["tile-plate"]["refractive_index"] == {"file": "metal.csv"}
    else:
        error = fault(root)
        assert (Path(error.file).name, error.field.split(",")[0]) == ("metal.csv", field)


# ---- a real rig


@pytest.fixture
def studio(root):
    """Return a working directory in which the plate, its camera and the room come from files."""
    for name, rows in {
        "camera": ["chart,45,0,out", "white,45,0,out"],
        "room": ["environment,0,0,out"],
        "plate": ["object,45,20,out", "object,45,20,in", "object,45,0,out", "dark,0,0,out"],
    }.items():
        lines = [",".join(COLUMNS)]
        (root / name).mkdir()
        for number, row in enumerate(rows):
            role, light, camera, state = row.split(",")
            (root / name / f"{number}.dng").write_bytes(b"raw")
            lines.append(f"{number}.dng,{role},{light},{camera},0,0,{state},0.02")
        (root / name / "captures.csv").write_text("\n".join(lines))  # fmt: skip
    edit(root, CAMERA_FILE, "rig", "copy-stand")
    edit(root, CAMERA_FILE, "captures", {"table": "camera/captures.csv"})
    edit(root, ROOM_FILE, "captures", {"table": "room/captures.csv", "folder": "room"})
    edit(root, PLATE_FILE, "captures", {"table": "plate/captures.csv"})
    edit(root, "scenes/still-life.yaml", "objects", [{"object": "tile-plate", "position_mm": [0, 0, 0]}])
    return root


def test_a_scene_of_a_real_rig_loads(studio):
    definitions = load(studio)
    assert not is_virtual(definitions, "objects", "tile-plate")
    captures = ["l0450-c0000-t000-r0000", "l0450-c0200-t000-r0000"]
    assert captures_of(definitions, "objects", "tile-plate", studio) == captures


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


def test_files_of_a_real_rig_are_checked(studio):
    table = studio / "plate" / "captures.csv"
    good = table.read_text()
    table.write_text(good.replace("object,45,20", "object,126,20"))
    assert fault(studio).field == "light_deg of 0.dng"
    table.write_text(good.replace("object,45,0,0,0,out", "object,45,0,0,0,in"))
    assert "only with the filter in" in fault(studio).found
    table.write_text(good)
    (studio / "plate" / "3.dng").write_bytes(b"")
    assert "an empty file" in fault(studio).found


def test_questions_about_what_is_not_there():
    definitions = load(ROOT)
    with pytest.raises(ValueError, match="no photographs of 'object'; did you mean 'objects'"):
        captures_of(definitions, "object", "tile-plate")
    with pytest.raises(ValueError, match="no 'tile-plat' in objects; did you mean 'tile-plate'"):
        is_virtual(definitions, "objects", "tile-plat")
