"""The command `irodori check` on a project of somebody's own photographs."""

import copy
import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml
from dng_files import write_any_dng
from made import made
from sessions import definitions

from irodori.capture.journal import Journal
from irodori.capture.operator import AutoOperator
from irodori.capture.session import Session, take_stock
from irodori.capture.shot_list import camera_shots, object_shots
from irodori.capture.shot_planner.planner import as_fitted, default_noise, plan_best
from irodori.check import angles
from irodori.check.angles import of_object, told_share
from irodori.command_line import main
from irodori.config.capture_table import Pose, expand_poses
from irodori.config.models import Camera, MeshShape, Object, Rig
from irodori.config.project import load_project
from irodori.ingest.mosaic import decode
from irodori.simulation.virtual_rig.bench import Bench
from irodori.simulation.virtual_rig.dng_writer import write_dng
from irodori.simulation.virtual_rig.virtual_camera import VirtualCamera

SIZE = {"width_px": 240, "height_px": 160, "pixel_pitch_um": 33.0, "principal_point_px": [120.0, 80.0]}
CORNERS = {"first": (-0.5, -0.3), "row_end": (0.5, -0.3), "column_end": (-0.5, 0.3), "last": (0.5, 0.3)}
LIMITS = {axis: {"min": 0.0, "max": 140.0, "step": 0.1} for axis in ("light_deg", "camera_deg", "tilt_deg", "turn_deg")}
RIG = {"kind": "files", "limits": LIMITS, "camera_distance_mm": 900.0, "light": {"spectrum": "A"}}
LAMP = {"spectrum": "D65", "azimuth_deg": -90, "elevation_deg": 45, "irradiance": 1.0}
LIGHT = {"image": {"width": 32, "height": 16}, "source": {"kind": "lights", "lights": [LAMP]}}
SCENE = {
    "environment": "lamp",
    "image": {"width": 40, "height": 30},
    "views": {"front": {"position_mm": [0, -330, 190], "target_mm": [0, 0, 20], "field_of_view_deg": 34}},
    "objects": [{"object": "plate", "position_mm": [0, 0, 0]}],
    "bodies": [
        {"shape": {"kind": "sphere", "radius_mm": 20}, "position_mm": [0, 0, 20], "material": {"spectrum": "TCS71"}}
    ],
}


def write(folder, files: dict) -> None:
    for name, content in files.items():
        path = folder / "config" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(yaml.safe_dump(content))


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A folder with a project of files: a camera's chart and white, a plate of one pose, and a scene."""
    folder = tmp_path_factory.mktemp("project")
    plate, camera, rig = definitions(poses=[{"light_deg": [45.0], "camera_deg": [20.0, 38.0, 42.0, 45.0, 50.0]}])
    camera["optics"] |= SIZE
    camera |= {"dark_frames": 0, "white_frames": 1, "linearity_exposure_s": []}
    bench, eye, stand = Bench(), made(Camera, camera), made(Rig, rig)
    subject = made(Object, plate)
    for name, planned, what in (
        ("camera", camera_shots(eye, ".dng"), None),
        ("plate", object_shots(subject, eye, ".dng"), subject),
    ):
        (folder / name).mkdir()
        journal, device = Journal(folder / name / "captures.csv"), VirtualCamera(eye, stand, bench, name, planned, what)
        Session(device, AutoOperator(bench.set), journal, None, take_stock(journal, planned)).run(planned, name)
    # The virtual chart is 90 mm wide; a millimetre is 50 / 900 / 0.066 superpixels.
    scale = 75.0 * 50.0 / 900.0 / 0.066
    chart = {"spectra": "BabelColor Average", "rows": 4, "columns": 6, "patch_px": 6}
    chart["centres_px"] = {name: [59.5 + scale * x, 39.5 + scale * y] for name, (x, y) in CORNERS.items()}
    own = {"rig": "table", "optics": camera["optics"], "white": {"reflectance_factor": 0.99}, "chart": chart}
    shape = {"kind": "plate", "width_mm": 90.0, "height_mm": 90.0}
    write(folder, {
        "config.yaml": {"definitions": "config", "make": {"scenes": ["desk"]}},
        "rigs/table.yaml": RIG,
        "cameras/own.yaml": own | {"captures": {"table": "camera/captures.csv"}},
        "objects/plate.yaml": {"camera": "own", "shape": shape, "texels": {"width": 16, "height": 16},
                               "captures": {"table": "plate/captures.csv"}},
        "environments/lamp.yaml": LIGHT,
        "scenes/desk.yaml": SCENE,
    })  # fmt: skip
    return folder


def said(folder, capsys) -> tuple[int, list[str]]:
    status = main(["check", "--directory", str(folder)])
    return status, capsys.readouterr().out.splitlines()


def test_a_sound_project_has_no_findings(project, capsys, monkeypatch):
    monkeypatch.chdir(project)
    assert said(project, capsys) == (0, ["14 photographs looked at: 0 errors, 0 warnings"])


@pytest.mark.parametrize("camera", [0.0, 20.0, 38.0])
def test_photographs_of_one_set_of_angles_are_said_to_leave_gloss_open(project, monkeypatch, camera):
    """Turns of the table tell no more of a plate."""
    monkeypatch.chdir(project)
    loaded = load_project([])
    plate, _, _ = definitions(
        poses=[{"light_deg": [45.0], "camera_deg": [camera], "turn_deg": [0.0, 90.0, 180.0, 270.0]}]
    )
    loaded.objects["plate"] = replace(made(Object, plate), camera="own")
    (found,) = list(of_object(loaded, "plate"))
    start = "config/objects/plate.yaml: poses: found 4 poses with angles that tell gloss from colour in "
    assert not found.is_error and found.text.startswith(start)
    assert "as `irodori plan plate --best 12` chooses them" in found.text


def test_poses_that_the_planner_chooses_tell_gloss(project, monkeypatch):
    monkeypatch.chdir(project)
    loaded = load_project([])
    plate = loaded.objects["plate"]
    rig = loaded.rigs["table"]
    fitted = as_fitted(loaded.config, rig)
    poses = plan_best(plate, rig, 8, **fitted).poses
    assert told_share(plate, rig, poses, fitted) > 0.9
    assert told_share(plate, rig, [Pose(45.0, 20.0)], fitted) == 0.0


@pytest.mark.parametrize(
    ("where", "change"),
    [
        ("rectify", {"max_angle_deg": 50.0}),
        ("fit", {"model_error": 0.2}),
        ("sensor", {"full_well_e": 30.0}),
        ("exposure_s", {"out": [0.002]}),
    ],
)
def test_angles_are_judged_with_the_weights_noise_and_limit_of_the_fit(project, monkeypatch, where, change):
    monkeypatch.chdir(project)
    monkeypatch.setattr(angles, "_LEAST", 2.0)  # so that the share is always said
    loaded = load_project([])
    groups = [{"light_deg": [45.0], "camera_deg": [0.0, 30.0, 40.0, 48.0]}, {"light_deg": [60.0], "camera_deg": [58.0]}]
    plate, camera, rig = definitions(poses=groups)
    camera["virtual"]["sensor"]["full_well_e"] = 1000.0
    shares = []
    for changed in ({}, change):
        if where == "sensor":
            camera["virtual"]["sensor"] |= changed
        elif where == "exposure_s":
            plate["exposure_s"] |= changed
        else:
            block = replace(getattr(loaded.config, where), **changed)
            loaded = replace(loaded, config=replace(loaded.config, **{where: block}))
        fit, eye, table, subject = loaded.config.fit, made(Camera, camera), made(Rig, rig), made(Object, plate)
        fitted = {
            "noise": default_noise(table, eye.virtual.sensor, subject.exposure_s.out, fit),
            "model_error": fit.model_error,
            "max_angle_deg": loaded.config.rectify.max_angle_deg,
        }
        loaded.rigs["table"], loaded.cameras["own"] = table, replace(eye, rig="table")
        loaded.objects["plate"] = replace(subject, camera="own")
        (found,) = of_object(loaded, "plate")
        shares.append(f"in {told_share(subject, table, expand_poses(subject.poses), fitted):.0%} of the materials")
        assert shares[-1] in found.text
    assert shares[0] != shares[1]


def test_of_a_table_the_angles_that_were_photographed_count(project, tmp_path, capsys, monkeypatch):
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    table = folder / "plate/captures.csv"
    lines = table.read_text().splitlines()
    table.write_text("\n".join([lines[0], *(line for line in lines if line.startswith("l0450-c0200"))]))
    status, told = said(folder, capsys)
    words = "plate/captures.csv: angles: found 1 pose with angles that tell gloss from colour in 0% of"
    assert status == 0 and [words in line for line in told] == [True, False]


def test_a_fault_of_another_table_hides_no_warning(project, tmp_path, monkeypatch):
    """Of an object, its own table alone is read."""
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    loaded = load_project([])
    table = folder / "plate/captures.csv"
    lines = table.read_text().splitlines()
    table.write_text("\n".join([lines[0], *(line for line in lines if line.startswith("l0450-c0200"))]))
    (folder / "camera/captures.csv").write_text("no table\n")
    (found,) = of_object(loaded, "plate")
    assert "found 1 pose with angles" in found.text
    table.write_text("no table\n")
    assert not list(of_object(loaded, "plate"))  # the check of the photographs says what is wrong with it


def test_no_mesh_is_read_for_the_angles_of_an_object_that_is_not_flat(project, monkeypatch):
    monkeypatch.chdir(project)
    loaded = load_project([])
    mesh = MeshShape(kind="mesh", file="no-such-file.obj", unit="mm")
    loaded.objects["plate"] = replace(loaded.objects["plate"], shape=mesh)
    assert not list(of_object(loaded, "plate"))


def test_a_mistake_of_a_configuration_on_top_names_its_file(project, tmp_path, capsys, monkeypatch):
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    write(folder, {"top.yaml": {"make": {"scenes": ["dusk"]}}})
    assert main(["check", "config/top.yaml"]) == 1
    assert "config/top.yaml: make.scenes[0]: found 'dusk'" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["check", "preview", "crate"])
def test_a_folder_without_a_project_is_named(command, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([command]) == 1
    assert "config/config.yaml: found no such file" in capsys.readouterr().out
    assert main([command, "--directory", "nowhere"]) == 1
    assert "nowhere: found No such file or directory; accepted: the folder of a project" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("unit", "words"),
    [("mm", "mm, in which it is 0.127 mm wide and 0.2"), ("inch", "and 5.4 pixels"), ("m", None)],
)
def test_a_mesh_in_another_unit_is_a_speck(project, tmp_path, capsys, monkeypatch, unit, words):
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    corners = "v -0.045 -0.045 0\nv 0.045 -0.045 0\nv 0.045 0.045 0\nv -0.045 0.045 0\n"
    (folder / "square.obj").write_text(corners + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n")
    plate = yaml.safe_load((folder / "config/objects/plate.yaml").read_text())
    plate["shape"] = {"kind": "mesh", "file": "square.obj", "unit": unit}
    write(folder, {"objects/plate.yaml": plate})
    lines = said(folder, capsys)[1]
    specks = [line for line in lines if line.startswith("error: square.obj: shape.unit")]
    assert len(specks) == (words is not None), lines
    assert all(words in line and "pixels in the picture" in line for line in specks)


def test_charts_that_overlap_are_found_before_anything_is_photographed(project, tmp_path, capsys, monkeypatch):
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    corners = "v -45 -45 0\nv 45 -45 0\nv 45 45 0\nv -45 45 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0.9 0.1\n"
    (folder / "folded.obj").write_text(corners + "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n")
    plate = yaml.safe_load((folder / "config/objects/plate.yaml").read_text())
    plate["shape"] = {"kind": "mesh", "file": "folded.obj", "unit": "mm"}
    write(folder, {"objects/plate.yaml": plate})
    lines = said(folder, capsys)[1]
    assert any("folded.obj: UV: found charts that overlap" in line for line in lines), lines


def test_all_mistakes_are_listed_at_once(project, tmp_path, capsys, monkeypatch):
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    scene = copy.deepcopy(SCENE)
    scene["views"]["away"] = SCENE["views"]["front"] | {"target_mm": [0, -600, 190]}
    scene["views"]["within"] = SCENE["views"]["front"] | {"position_mm": [-29, 30, 13]}
    scene["bodies"][0]["position_mm"] = [0, 0, 35]
    scene["bodies"].append(copy.deepcopy(SCENE["bodies"][0]) | {"position_mm": [-30, 30, 12]})
    scene["bodies"][1]["material"] |= {"beta": 50.0, "mu_rad": 0.5}
    leaf = {"shape": {"kind": "disc", "radius_mm": 6.0}, "position_mm": scene["objects"][0]["position_mm"]}
    scene["bodies"].append({"material": SCENE["bodies"][0]["material"], "transmittance": 0.0} | leaf)
    camera = yaml.safe_load((folder / "config/cameras/own.yaml").read_text())
    for corner in camera["chart"]["centres_px"].values():
        corner[0] += 5.0
    write(folder, {"scenes/desk.yaml": scene, "cameras/own.yaml": camera})
    table = folder / "plate/captures.csv"
    table.write_text(table.read_text().replace(",in,", ",?,").replace(",out,", ",in,").replace(",?,", ",out,"))
    status, lines = said(folder, capsys)
    assert status == 1 and lines[-1].endswith("9 errors, 3 warnings")
    for start, words in (
        ("error: config/scenes/desk.yaml: views.away", "sees none of objects[0] (plate)"),
        ("error: config/scenes/desk.yaml: views.within.position_mm", "an eye inside bodies[1] (sphere)"),
        ("error: config/scenes/desk.yaml: bodies[1].material", "allow_energy_gain: true in the scene"),
        ("warning: config/scenes/desk.yaml: bodies[0] (sphere)", "floats 8.26 mm from all else"),
        ("warning: config/scenes/desk.yaml: objects[0] (plate)", "and bodies[1] (sphere) stand 8 mm in each other"),
        ("warning: config/scenes/desk.yaml: objects[0] (plate)", "and bodies[2] (disc) lie in one plane"),
        ("error: camera/chart-out-20000us.dng: chart", "of 24 patches with dirt, an edge or a shadow"),
        ("error: plate/", "no filter adds light"),
    ):
        assert any(line.startswith(start) and words in line for line in lines), (start, lines)


def test_what_an_endless_plane_hides_is_named(project, tmp_path, capsys, monkeypatch):
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    scene = copy.deepcopy(SCENE)
    floor = {"shape": {"kind": "plane"}, "position_mm": [0, 0, -1], "material": {"spectrum": "TCS71"}}
    ball = SCENE["bodies"][0] | {"position_mm": [0, 0, -40]}
    scene["bodies"] = [floor, ball]
    scene["views"]["cellar"] = SCENE["views"]["front"] | {"position_mm": [0, -200, -100]}
    write(folder, {"scenes/desk.yaml": scene})
    status, lines = said(folder, capsys)
    found = [line for line in lines if line.startswith("warning: config/scenes/desk.yaml")]
    assert status == 0 and [line.partition("yaml: ")[2] for line in found] == [
        "views.cellar: the eye is behind bodies[0] (plane), whose back is black and hides all in front of it",
        "bodies[1] (sphere) is wholly behind bodies[0] (plane) and hidden by it; a floor faces +z",
    ]
    # Over the floor, turned away from it, or lying in it, nothing is hidden.
    scene["views"]["cellar"]["target_mm"] = [0, -200, -400]
    scene["bodies"][1] = SCENE["bodies"][0] | {"position_mm": [0, 0, 40]}
    floor["position_mm"][2] = SCENE["objects"][0]["position_mm"][2]
    write(folder, {"scenes/desk.yaml": scene})
    assert not [line for line in said(folder, capsys)[1] if "behind" in line]


def test_white_reference_and_chart_in_each_other_s_place_are_named(project, tmp_path, capsys, monkeypatch):
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    table = folder / "camera/captures.csv"
    exchanged = table.read_text().replace(",chart,", ",?,").replace(",white,", ",chart,").replace(",?,", ",white,")
    table.write_text(exchanged)
    status, lines = said(folder, capsys)
    named = [line for line in lines if line.startswith("error: camera/chart-") and "about a smooth surface" in line]
    assert status == 1 and len(named) == 2
    for line in named:
        assert "are white reference and chart exchanged? white-" in line and "shows an even surface" in line


def test_a_white_reference_with_an_edge_is_said_before_any_job(project, tmp_path, capsys, monkeypatch):
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    white = next((folder / "camera").glob("white-out-*"))
    taken = decode(white)
    taken.values[:, 180:] = 700
    write_dng(
        white, taken.values, black_level=600, white_level=16383, exposure_s=taken.exposure_s, model="virtual camera"
    )
    table = folder / "camera/captures.csv"
    table.write_text("\n".join(line.rpartition(",")[0] for line in table.read_text().splitlines()))  # its old hashes
    status, lines = said(folder, capsys)
    assert status == 1
    assert any(f"error: camera/{white.name}: white: a picture that varies by" in line for line in lines)
    assert any("does the white reference fill the picture" in line for line in lines)


def test_a_broken_file_hides_no_other_fault_and_bodies_are_compared_between_sets(
    project, tmp_path, capsys, monkeypatch
):
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    for file in ("camera/white-in-50000us-00.dng", "camera/chart-in-50000us.dng"):
        (folder / file).write_bytes((folder / file).read_bytes()[:2000])
    plate = sorted((folder / "plate").glob("*-out-*.dng"))[0]
    taken = decode(plate)
    plate.unlink()
    write_dng(plate, taken.values, black_level=600, white_level=16383, exposure_s=taken.exposure_s, model="spare")
    table = folder / "plate/captures.csv"
    table.write_text("\n".join(line.rpartition(",")[0] for line in table.read_text().splitlines()))  # its old hashes
    status, lines = said(folder, capsys)
    assert status == 1 and [line.split(": ")[1] for line in lines[:-1]] == [
        "camera/white-in-50000us-00.dng",
        "camera/chart-in-50000us.dng",
        f"plate/{plate.name}",
    ]
    assert "body: taken with 'Irodori spare', white-out-20000us-00.dng with" in lines[2]


def test_a_mosaic_of_another_pattern_than_the_camera_s_is_named(project, tmp_path, capsys, monkeypatch):
    """All photographs of the plate agree, and the camera's white reference contradicts them."""
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    table = folder / "plate/captures.csv"
    table.write_text("\n".join(line.rpartition(",")[0] for line in table.read_text().splitlines()))  # its old hashes
    files = sorted((folder / "plate").glob("*.dng"))
    for file in files:
        taken = decode(file)
        file.unlink()
        write_any_dng(file, taken.values, pattern="BGGR", exposure_s=taken.exposure_s)
    status, lines = said(folder, capsys)
    named = [
        line for line in lines if ": mosaic: a mosaic of BGGR, white-" in line and "has one of RGGB: was it" in line
    ]
    assert status == 1 and {line.split(": ")[1] for line in named} == {f"plate/{file.name}" for file in files}


@pytest.mark.parametrize(
    ("light", "exposures_s", "at", "saturated"),
    [
        ({}, [0.02], 20, 24),
        ({}, [0.02, 0.002], 20, 0),
        (
            {"kind": "mirror_ball", "centre_px": [31.5, 15.5], "radius_px": 12, "reflectance_factor": 0.9},
            [0.02],
            30,
            24,
        ),
        ({"kind": "mirror_ball", "centre_px": [31.5, 15.5], "radius_px": 12, "reflectance_factor": 0.9}, [0.02], 2, 0),
    ],
)
def test_a_light_saturated_in_every_exposure_is_said_before_any_job(
    project, tmp_path, capsys, monkeypatch, light, exposures_s, at, saturated
):
    """Through the filter other pixels are saturated than without it; both count, and so do those of the ball alone."""
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    (folder / "room").mkdir()
    lines, rng = ["file,role,light_deg,camera_deg,filter,exposure_s"], np.random.default_rng(7)
    for state, row in (("out", 20), ("in", 26)):
        for seconds in exposures_s:
            level = np.full((64, 128), 3000.0)
            level[row : row + 6, 2 * at : 2 * at + 8] = 90_000.0
            counted = rng.poisson(2.0 * level * seconds / 0.02) / 2.0
            file = f"environment-{state}-{1e6 * seconds:.0f}us.dng"
            mosaic = np.minimum(np.rint(600.0 + counted), 16383).astype(np.uint16)
            write_any_dng(folder / "room" / file, mosaic, exposure_s=seconds)
            lines.append(f"{file},environment,0,0,{state},{seconds}")
    (folder / "room/captures.csv").write_text("\n".join(lines) + "\n")
    if light:
        light = {"source": light | {"camera_azimuth_deg": 0.0, "camera_elevation_deg": 0.0}}
    room = {"camera": "own", "image": {"width": 64, "height": 32}, "captures": {"table": "room/captures.csv"}}
    write(folder, {"environments/room.yaml": room | light, "scenes/desk.yaml": SCENE | {"environment": "room"}})
    found = [line for line in said(folder, capsys)[1] if "saturated" in line]
    shortest = f"environment-out-{1e6 * min(exposures_s):.0f}us.dng"
    words = (
        f"error: room/{shortest}: exposure_s: found {saturated} pixels saturated in every bracket; accepted: a shorter"
    )
    assert len(found) == (saturated > 0) and all(line.startswith(words) for line in found), found


@pytest.mark.parametrize(("radius", "said_of_it"), [(30, ""), (38, "error"), (25, "error")])
def test_a_mirror_ball_that_is_not_where_it_was_typed_is_said_before_any_job(
    project, tmp_path, capsys, monkeypatch, radius, said_of_it
):
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    (folder / "room").mkdir()
    rows, columns = np.indices((200, 200)) // 2
    level = np.where(np.hypot(rows - 50, columns - 47) < 30.0, 6000.0, 2000.0)
    counted = np.random.default_rng(7).poisson(2.0 * level) / 2.0
    lines = ["file,role,light_deg,camera_deg,filter,exposure_s"]
    for state in ("out", "in"):
        mosaic = np.rint(600.0 + counted).astype(np.uint16)
        write_any_dng(folder / f"room/{state}.dng", mosaic, exposure_s=0.02)
        lines.append(f"{state}.dng,environment,0,0,{state},0.02")
    (folder / "room/captures.csv").write_text("\n".join(lines) + "\n")
    ball = {"kind": "mirror_ball", "centre_px": [47, 50], "radius_px": radius, "reflectance_factor": 0.9}
    room = {"camera": "own", "image": {"width": 64, "height": 32}, "captures": {"table": "room/captures.csv"}}
    light = {"environments/room.yaml": room | {"source": ball}, "scenes/desk.yaml": SCENE | {"environment": "room"}}
    write(folder, light)
    found = [line for line in said(folder, capsys)[1] if "radius_px" in line]
    assert [line.split(": ")[0] for line in found] == ([said_of_it] if said_of_it else [])
    assert all("edges like those of a ball about" in line for line in found)


def test_faults_of_several_files_and_lines_are_listed_together_and_each_once(project, tmp_path, capsys, monkeypatch):
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    scene, rig = copy.deepcopy(SCENE), copy.deepcopy(RIG)
    scene["image"]["width"], scene["colour"] = 0, "red"
    del rig["light"]
    plate = yaml.safe_load((folder / "config/objects/plate.yaml").read_text())
    plate["shape"]["width_mm"] = "?"
    write(folder, {"scenes/desk.yaml": scene, "rigs/table.yaml": rig, "objects/plate.yaml": plate})
    table = folder / "camera/captures.csv"
    first, *lines = table.read_text().splitlines()
    at = first.split(",").index("exposure_s")
    rows = [line.split(",") for line in lines]
    for row in rows[:2]:
        row[at] = "?"
    table.write_text("\n".join([first, *(",".join(row) for row in rows)]))
    status, told = said(folder, capsys)
    assert status == 1 and told[-1] == f"{len(told) - 1} errors; no photograph was looked at"
    places = [": ".join(line.split(": ")[1:3]) for line in told[:-1]]
    assert sorted(places) == sorted(set(places)) == sorted([
        "config/scenes/desk.yaml: colour",
        "config/scenes/desk.yaml: image.width",
        "config/objects/plate.yaml: shape.width_mm",
        "config/rigs/table.yaml: light",
        "camera/captures.csv: line 2, exposure_s",
        "camera/captures.csv: line 3, exposure_s",
    ])  # fmt: skip


def test_a_file_that_is_missing_and_one_that_is_no_yaml_are_listed_with_the_others(
    project, tmp_path, capsys, monkeypatch
):
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    (folder / "config/environments/lamp.yaml").unlink()
    (folder / "config/cameras/own.yaml").write_text("rig: [")
    status, told = said(folder, capsys)
    assert status == 1 and len(told) == 3
    assert "config/scenes/desk.yaml: environment: found 'lamp', for which there is no" in told[0]
    assert told[1].startswith("error: config/cameras/own.yaml: ") and told[2].startswith("2 errors;")


def test_a_fault_between_files_is_the_one_that_a_run_would_name(project, tmp_path, capsys, monkeypatch):
    folder = shutil.copytree(project, tmp_path / "project")
    monkeypatch.chdir(folder)
    scene = copy.deepcopy(SCENE) | {"integrator": {"kind": "interactive"}}
    scene["views"]["front"]["lens"] = {"diameter_mm": 5, "focus_mm": 380}
    write(folder, {"scenes/desk.yaml": scene})
    status, told = said(folder, capsys)
    assert status == 1 and len(told) == 2 and "views.front.lens" in told[0]
