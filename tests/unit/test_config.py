"""All definitions together: reading, names that lead from file to file, agreement between files."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from definitions import CAMERA_FILE, PLATE_FILE, ROOM_FILE, ROOT, edit, fault, load

from irodori.config.definitions import read_yaml
from irodori.config.models import IndexTable
from irodori.core.errors import InputError

DATA = ROOT.parent / "shared" / "data"
POSE = "l0450-c0000-t000-r0000"
BODY = {"shape": {"kind": "sphere", "radius_mm": 5}, "position_mm": [0, 0, 5], "material": {"spectrum": "TCS3"}}


# ---- all definitions together


def test_nothing_heavy_is_imported():
    code = "import sys, irodori.config.definitions, irodori.core.provenance; print({'numpy', 'numba'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_the_repository_s_own_configuration_loads():
    definitions = load(ROOT)
    assert list(definitions.scenes) == ["still-life"]
    assert list(definitions.environments) == ["classroom"]
    assert list(definitions.cameras) == ["d5100-comb"]
    assert list(definitions.rigs) == ["virtual"]
    assert definitions.config.fit.solver == "varpro"
    for name in definitions.objects:
        captures = definitions.captures_of("objects", name)
        assert captures == sorted(set(captures)) and len(captures) >= 10
        assert definitions.is_virtual("objects", name)
    assert definitions.captures_of("cameras", "d5100-comb") == ["chart"]
    assert definitions.captures_of("environments", "classroom") == [
        "environment", "room-chart-desk", "room-chart-window"
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["lid", "turntable"])
def test_scenes_beside_the_default_run_load(name):
    assert list(load(ROOT, scenes=[name]).scenes) == [name]


def test_the_real_camera_loads_where_its_data_is_present():
    if not (DATA / "raw" / "powershot_s40_chart.crw").is_file():
        pytest.skip("the real data is not beside this checkout")
    real = read_yaml(ROOT / "config" / "real.yaml")
    definitions = load(ROOT, **real["make"])
    assert list(definitions.cameras) == ["powershot-s40"]
    assert not definitions.is_virtual("cameras", "powershot-s40")
    assert definitions.captures_of("cameras", "powershot-s40") == ["chart"]


def test_the_real_camera_without_its_data_says_which_photograph_is_missing_and_how_ones_own_takes_its_place(root):
    error = fault(root, **read_yaml(root / "config" / "real.yaml")["make"])
    assert error.file.endswith("powershot-s40.yaml") and error.field == "captures"
    assert "no such file" in error.found and "powershot_s40_chart.crw" in error.found
    assert "PowerShot S40, as published" in error.accepted and "captures/powershot-s40.csv" in error.accepted


@pytest.mark.parametrize(
    ("file", "path", "value", "named_by", "field", "accepted"),
    [
        ("config.yaml", "make.scenes", ["stil-life"], "config.yaml", "make.scenes[0]",
         "did you mean 'still-life'?"),
        ("config.yaml", "make.cameras", ["d5100"], "config.yaml", "make.cameras[0]", "cameras that exist"),
        ("scenes/still-life.yaml", "objects.1.object", "vermillion-sphere", "still-life.yaml",
         "objects[1].object",
         "did you mean 'vermilion-sphere'? (objects that exist: celadon-lid, indigo-sphere, leaf-sphere, "),
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
        (PLATE_FILE, "refractive_index", {"file": "~/gold.csv"}, "refractive_index.file", "~/gold.csv", "without ~"),
        (PLATE_FILE, "refractive_index", {"file": "gold.csv"}, "refractive_index.file", "no such file",
         "CSV"),
        (PLATE_FILE, "plan", {"mu_rad": [0.3, 0.1]}, "plan.mu_rad", "[0.3, 0.1]", "smaller value first"),
        (CAMERA_FILE, "poses.chart.light_deg", 80.0, "poses.chart.light_deg", "the light at 80 degrees",
         "from 0 to below 80"),
        (CAMERA_FILE, "poses.white", {"light_deg": 35.0, "camera_deg": 0.0, "tilt_deg": 40.0},
         "poses.white.light_deg", "the light at -5 degrees", "from 0 to below 80"),
        (CAMERA_FILE, "calibration.bases", 7, "calibration.bases", "7", "1 to 6, 3 for each filter state"),
        (CAMERA_FILE, "chart.rows", 5, "chart.rows", "5 rows of 6 patches, 30 in all", "make 24 patches"),
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
        ("scenes/still-life.yaml", "bodies", [BODY | {"material": {"spectrum": "D65"}}],
         "bodies[0].material.spectrum", "'D65'", "TCS0"),
        ("scenes/still-life.yaml", "bodies",
         [BODY, BODY | {"material": {"spectrum": "TCS3", "refractive_index": {"file": "gold.csv"}}}],
         "bodies[1].material.refractive_index.file", "no such file", "wavelength_nm, n, k"),
        ("scenes/still-life.yaml", "lights",
         [{"kind": "collimated", "spectrum": "D66", "azimuth_deg": 0, "elevation_deg": 40, "irradiance": 1}],
         "lights[0].spectrum", "'D66'", "did you mean 'D65'"),
        ("scenes/still-life.yaml", "views.front.target_mm", [0.0, -330.0, 190.0], "views.front.target_mm",
         "own position", "another point"),
        ("scenes/still-life.yaml", "views.front.up", [0.0, 0.0, 0.0], "views.front.up", "no length",
         "points up"),
        ("scenes/still-life.yaml", "views.front.up", [0.0, 330.0, -168.0], "views.front.up",
         "line of sight", "up"),
        ("scenes/still-life.yaml", "frames",
         {"kind": "light_sweep", "count": 4, "turned": "both", "from_deg": 0.0, "to_deg": 90.0}, "frames.turned",
         "the scene has no lights beside", "lights in the scene"),
        ("scenes/still-life.yaml", "frames",
         {"kind": "illuminant_change", "from_illuminant": "D65", "illuminants": ["A", "FL22"]}, "frames.illuminants[1]",
         "'FL22'", "did you mean 'FL2"),
    ],
)  # fmt: skip
def test_what_no_schema_sees(root, file, path, value, field, found, accepted):
    edit(root, file, path, value)
    error = fault(root)
    assert Path(error.file).name == Path(file).name
    assert error.field == field
    assert found in error.found
    assert accepted in error.accepted


def test_a_printed_sheet_needs_the_registration_that_reads_it(root):
    edit(root, PLATE_FILE, "markers", {"paper": "A4"})
    assert load(root).objects["tile-plate"].markers.paper == "A4"
    edit(root, "config.yaml", "place.register", False)
    error = fault(root)
    assert error.field == "markers" and "place.register: true" in error.accepted


TOGETHER = [["leaf-sphere", "tile-plate"], ["celadon-lid", "indigo-sphere"]]


def test_objects_photographed_together_are_loaded_together(root):
    edit(root, "scenes/still-life.yaml", "objects", [{"object": "tile-plate", "position_mm": [0.0, 0.0, 0.0]}])
    edit(root, "config.yaml", "photographed_together", TOGETHER)
    assert sorted(load(root).objects) == ["leaf-sphere", "tile-plate"]
    edit(root, "config.yaml", "photographed_together", [])
    assert list(load(root).objects) == ["tile-plate"]


@pytest.mark.parametrize(
    ("sets", "key", "found", "accepted"),
    [
        ([*TOGETHER, ["indigo-sphere", "vermilion-sphere"]], "[2][0]", "indigo-sphere, which photographed_together[1]",
         "each object in one set"),
        ([["tile-plate", "leaf-spher"]], "[0][1]", "'leaf-spher', for which there is no", "did you mean 'leaf-sphere'"),
        ([["tile-plate"]], "[0]", "tile-plate", "a list of 2 to 1000"),
        ([["tile-plate", "tile-plate"]], "[0]", "twice", "once"),
    ],
)  # fmt: skip
def test_sets_of_objects_photographed_together_are_checked(root, sets, key, found, accepted):
    edit(root, "config.yaml", "photographed_together", sets)
    error = fault(root)
    assert error.field == f"photographed_together{key}" and Path(error.file).name == "config.yaml"
    assert found in error.found and accepted in error.accepted


def test_two_cameras_do_not_photograph_together(root):
    (root / "config/cameras/other.yaml").write_text((root / "config" / CAMERA_FILE).read_text())
    edit(root, "objects/leaf-sphere.yaml", "camera", "other")
    error = fault(root)
    assert error.field == "photographed_together[0][1]"
    assert error.found == "leaf-sphere by the camera other, where indigo-sphere is by d5100-comb"


def test_a_lens_needs_an_integrator_that_samples(root):
    scene = "scenes/still-life.yaml"
    edit(root, scene, "views.front.lens", {"diameter_mm": 8.0, "focus_mm": 380.0})
    load(root)
    edit(root, scene, "integrator", {"kind": "interactive"})
    error = fault(root)
    assert error.field == "views.front.lens" and "reference" in error.accepted


def test_the_interactive_integrator_takes_collimated_lights_alone(root):
    scene = "scenes/still-life.yaml"
    lamp = {"kind": "sphere", "spectrum": "A", "position_mm": [0.0, 0.0, 90.0], "radius_mm": 4.0, "radiance": 5.0}
    edit(root, scene, "lights", [lamp])
    load(root)
    edit(root, scene, "integrator", {"kind": "interactive"})
    error = fault(root)
    assert error.field == "lights" and "a sphere light" in error.found and "reference" in error.accepted


def test_a_scene_without_an_integrator_is_rendered_by_paths(root):
    path = root / "config/scenes/still-life.yaml"
    keys = yaml.safe_load(path.read_text(encoding="utf-8"))
    path.write_text(
        yaml.safe_dump({key: value for key, value in keys.items() if key != "integrator"}), encoding="utf-8"
    )
    plain = load(root).scenes["still-life"].integrator
    edit(root, "scenes/still-life.yaml", "integrator", {"kind": "reference"})
    assert plain == load(root).scenes["still-life"].integrator
    assert plain.kind == "reference" and plain.samples % 8 == 0


def test_every_step_within_the_limits_is_on_the_step(root):
    angles = [tenths / 10 for tenths in range(0, 1401)]
    edit(root, PLATE_FILE, "poses", [{"light_deg": [35.0, 35.5, 125.0], "camera_deg": angles}])
    assert len(load(root).captures_of("objects", "tile-plate")) == 3 * 1401


def test_a_spectrum_file_that_exists_is_accepted(root):
    (root / "red.csv").write_text("name," + ",".join(map(str, range(400, 701, 10))) + "\nred" + ",0.5" * 31 + "\n")
    edit(root, PLATE_FILE, "virtual.materials.0.spectrum", "red.csv")
    assert load(root).objects["tile-plate"].virtual.materials[0].spectrum == "red.csv"


def test_virtual_materials_take_any_registered_lobe_and_no_other(root):
    edit(root, PLATE_FILE, "virtual.materials.1.lobe", "ggx")
    assert load(root).objects["tile-plate"].virtual.materials[1].lobe == "ggx"
    edit(root, PLATE_FILE, "virtual.materials.1.further_gloss", [{"lobe": "gausian", "beta": 1.0, "mu_rad": 0.1}])
    where = r"virtual\.materials\[1\]\.further_gloss\[0\]\.lobe: found 'gausian'; .*did you mean 'gaussian'"
    with pytest.raises(InputError, match=where):
        load(root)


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
        assert load(root).objects["tile-plate"].refractive_index == IndexTable(file="metal.csv")
    else:
        error = fault(root)
        assert (Path(error.file).name, error.field.split(",")[0]) == ("metal.csv", field)


# ---- environments that no camera photographs, and mirror balls


def environment(root, **definition):
    (root / "config" / ROOM_FILE).write_text(yaml.safe_dump(definition), encoding="utf-8")


SUN = {"spectrum": "D65", "azimuth_deg": 10, "elevation_deg": 40, "irradiance": 1}


def test_an_environment_of_placed_lights_needs_no_camera(root):
    environment(root, source={"kind": "lights", "lights": [SUN]}, image={"width": 64, "height": 32})
    definitions = load(root)
    assert definitions.environments["classroom"].source.lights[0].diameter_deg == 0.0
    assert definitions.captures_of("environments", "classroom") == []
    assert not definitions.is_virtual("environments", "classroom")


@pytest.mark.parametrize("kind", ["rgb", "spectral"])
def test_an_environment_of_a_file_that_is_there(root, kind):
    (root / "sky.exr").write_bytes(b"")
    environment(root, source={"kind": kind, "file": "sky.exr"})
    source = load(root).environments["classroom"].source
    assert source.plain() == {"kind": kind, "file": "sky.exr", "scale": 1.0, "centre_azimuth_deg": 0.0}


LIGHTS = {"kind": "lights", "lights": [SUN]}
SIZE = {"width": 64, "height": 32}
BALL = {"kind": "mirror_ball", "centre_px": [50, 50], "radius_px": 40, "reflectance_factor": 0.9}


@pytest.mark.parametrize(
    ("definition", "field", "found"),
    [
        ({"source": LIGHTS}, "image", "no such key"),
        ({"source": LIGHTS, "image": SIZE, "camera": "d5100-comb"}, "camera", "does not use"),
        ({"source": LIGHTS, "image": SIZE, "lamps_error_percent": 1.5}, "lamps_error_percent", "does not use"),
        ({"source": {"kind": "rgb", "file": "no.exr"}}, "source.file", "no such file: no.exr"),
        ({"source": {"kind": "rgb", "file": "no.exr"}, "image": SIZE}, "image", "does not use"),
        ({"source": {"kind": "captures"}, "image": SIZE}, "camera", "no such key"),
        ({"source": {"kind": "sphere"}}, "source.kind", "sphere"),
        ({"source": {**LIGHTS, "ligths": []}, "image": SIZE}, "source.ligths", "unknown key"),
        ({"source": {"kind": "lights", "lights": [{**SUN, "radiance": 1}]}, "image": SIZE},
         "source.lights[0].irradiance", "both"),
        ({"source": {"kind": "lights", "lights": [{k: v for k, v in SUN.items() if k != "irradiance"}]}, "image": SIZE},
         "source.lights[0].irradiance", "neither"),
        ({"source": {"kind": "lights", "lights": [{**{k: v for k, v in SUN.items() if k != "irradiance"},
                                                   "radiance": 1}]}, "image": SIZE},
         "source.lights[0].diameter_deg", "gives no light"),
        ({"source": {"kind": "lights", "lights": [{**SUN, "spectrum": "D56"}]}, "image": SIZE},
         "source.lights[0].spectrum", "D56"),
        ({"source": BALL, "image": SIZE, "camera": "d5100-comb"}, "source.kind", "virtual"),
        ({"source": {**BALL, "refractive_index": {"n": 2, "k": 3}}, "image": SIZE, "camera": "d5100-comb"},
         "source.refractive_index", "both"),
        ({"source": {k: v for k, v in BALL.items() if k != "reflectance_factor"}, "image": SIZE,
          "camera": "d5100-comb"}, "source.refractive_index", "no such key"),
        ({"source": {**{k: v for k, v in BALL.items() if k != "reflectance_factor"},
                     "refractive_index": {"file": "x.csv"}}, "image": SIZE, "camera": "d5100-comb"},
         "source.refractive_index.file", "no such file"),
    ],
)  # fmt: skip
def test_what_does_not_fit_the_source_of_the_light(root, definition, field, found):
    environment(root, **definition)
    error = fault(root)
    assert Path(error.file).name == "classroom.yaml"
    assert error.field == field
    assert found in error.found


# ---- names in results/


@pytest.mark.parametrize("name", ["cameras", "environments", "logs", "benchmarks", "benchmark"])
def test_names_of_folders_of_the_results_are_reserved(root, name):
    (root / "config/scenes/still-life.yaml").rename(root / f"config/scenes/{name}.yaml")
    error = fault(root, scenes=[name])
    assert error.file.endswith(f"scenes/{name}.yaml") and repr(name) in error.found
    (root / f"config/scenes/{name}.yaml").rename(root / "config/scenes/still-life.yaml")
    (root / "config" / PLATE_FILE).rename(root / f"config/objects/{name}.yaml")
    edit(root, "scenes/still-life.yaml", "objects.0.object", name)
    edit(root, "config.yaml", "photographed_together", [])
    error = fault(root)
    assert error.file.endswith(f"objects/{name}.yaml") and "another name" in error.accepted


def test_an_object_and_a_scene_do_not_share_a_name(root):
    (root / "config/scenes/still-life.yaml").rename(root / "config/scenes/tile-plate.yaml")
    error = fault(root, scenes=["tile-plate"])
    assert error.file.endswith("scenes/tile-plate.yaml")
    assert "config/objects/tile-plate.yaml has as well" in error.found
    assert "results/tile-plate" in error.accepted


def test_questions_about_what_is_not_there():
    definitions = load(ROOT)
    with pytest.raises(ValueError, match="no photographs of 'object'; did you mean 'objects'"):
        definitions.captures_of("object", "tile-plate")
    with pytest.raises(ValueError, match="no 'tile-plat' in objects; did you mean 'tile-plate'"):
        definitions.is_virtual("objects", "tile-plat")


# ---- lamps and charts in a place


@pytest.mark.parametrize(
    ("lamps", "field", "found"),
    [
        (["FL11", "D56"], "lamps[1]", "'D56'"),
        (["lamp.csv"], "lamps[0]", "no such file"),
        (["FL11", "FL11"], "lamps", "FL11"),
    ],
)
def test_a_lamp_of_a_room_that_is_at_fault_is_named(root, lamps, field, found):
    edit(root, ROOM_FILE, "lamps", lamps)
    error = fault(root)
    assert error.field == field and found in error.found


def test_an_error_of_lamps_needs_lamps(root):
    edit(root, ROOM_FILE, "lamps_error_percent", 1.5)
    error = fault(root)
    assert (error.field, error.found) == ("lamps_error_percent", "a key without lamps")
    edit(root, ROOM_FILE, "lamps", ["FL11"])
    assert load(root).environments["classroom"].lamps_error_percent == 1.5


@pytest.mark.parametrize(
    ("key", "value", "field", "found"),
    [
        ("virtual.charts.desk", ..., "virtual.charts.desk", "no such key"),
        ("room_charts.desk", ..., "virtual.charts.desk", "a place without a chart"),
        ("room_charts.desk.rows", 5, "room_charts.desk.rows", "30 in all"),
        ("room_charts.desk.find", "edges", "room_charts.desk.centres_px", "no corners"),
        ("virtual.charts.desk.position_m", [4.6, 0.0, 1.0], "virtual.charts.desk.position_m", "outside the room"),
        ("virtual.charts.desk.facing", [0.0, 0.0, 0.0], "virtual.charts.desk.facing", "0, 0, 0"),
    ],
)
def test_a_chart_in_a_room_that_is_at_fault_is_named(root, key, value, field, found):
    edit(root, ROOM_FILE, key, value)
    error = fault(root)
    assert error.field == field and found in error.found


def test_a_surface_that_reflects_nothing_is_refused(root):
    edit(root, PLATE_FILE, "refractive_index", {"n": 1.0, "k": 0.0})
    error = fault(root)
    assert error.field == "refractive_index.n" and "from which nothing is reflected" in error.found
    edit(root, PLATE_FILE, "refractive_index", {"n": 1.0, "k": 0.5})
    load(root)


def test_corners_of_a_chart_on_a_line_are_refused(root):
    corners = {"first": [100.0, 80.0], "row_end": [200.0, 80.0], "column_end": [100.0, 140.0], "last": [200.0, 140.0]}
    file = "cameras/d5100-comb.yaml"
    edit(root, file, "chart.find", "edges")
    edit(root, file, "chart.centres_px", corners)
    load(root)
    for wrong in ([100.0, 80.0], [200.0, 20.0], [300.0, 80.01]):
        edit(root, file, "chart.centres_px", corners | {"column_end": wrong})
        error = fault(root)
        assert error.field == "chart.centres_px" and error.found.endswith("on a line")


@pytest.mark.parametrize(
    "file, key, value, field, said",
    [
        (PLATE_FILE, "placements", [{"rotation_deg": [180.0, 0.0, 0.0]}], "placements", "flat object"),
        (
            "objects/leaf-sphere.yaml",
            "placements",
            [{"rotation_deg": [90.0, 0.0, 0.0]}],
            "placements[0]",
            "no photograph",
        ),
        (
            "objects/leaf-sphere.yaml",
            "poses",
            [{"light_deg": [45.0], "camera_deg": [0.0], "placement": [1, 2]}],
            "poses[0].placement",
            "1 to 1",
        ),
    ],
)
def test_placements_and_photographs_agree(root, file, key, value, field, said):
    edit(root, file, key, value)
    with pytest.raises(InputError, match=said) as raised:
        load(root)
    assert raised.value.field == field
