"""A rig that the workflow drives: what its definitions need, refuse, and may leave to the session."""

from pathlib import Path

import pytest
from definitions import CAMERA_FILE, PLATE_FILE, ROOM_FILE, edit, fault, load

from irodori.capture.shot_list import camera_shots
from irodori.config.capture_table import COLUMNS
from irodori.config.definitions import load_one
from irodori.core.errors import InputError

DRIVER = {"kind": "gphoto2", "model": "Canon EOS 40D (PTP mode)", "iso": 100, "f_number": 8.0}
ONLY_PLATE = [{"object": "tile-plate", "position_mm": [0, 0, 0]}]


@pytest.fixture
def bench(root):
    """Return a working directory in which the plate and its camera are photographed on a driven rig."""
    edit(root, "rigs/gonio-grbl.yaml", "motion.port", "simulator")
    for file in (CAMERA_FILE, PLATE_FILE, ROOM_FILE):
        edit(root, file, "virtual", ...)
    edit(root, ROOM_FILE, "exposure_s", ...)
    edit(root, ROOM_FILE, "room_charts", ...)
    edit(root, CAMERA_FILE, "rig", "gonio-grbl")
    edit(root, CAMERA_FILE, "driver", dict(DRIVER))
    edit(root, CAMERA_FILE, "captures", {"table": "camera/captures.csv"})
    edit(root, PLATE_FILE, "captures", {"table": "tables/plate.csv", "folder": "plate"})
    edit(root, ROOM_FILE, "captures", {"table": "room/captures.csv"})
    edit(root, "scenes/still-life.yaml", "objects", ONLY_PLATE)
    edit(root, "scenes/still-life.yaml", "photographs", {})
    edit(root, "config.yaml", "photographed_together", ...)
    (root / "room").mkdir()
    rows = [f"{i}.dng,environment,0,0,0,0,{state},0.02" for i, state in enumerate(("out", "in"))]
    (root / "room/captures.csv").write_text("\n".join([",".join(COLUMNS), *rows]))
    for number in range(2):
        (root / f"room/{number}.dng").write_bytes(b"raw")
    return root


def test_the_example_of_a_real_rig_is_whole_and_nobody_asks_for_it(root):
    assert "eos-40d-comb" not in load(root).cameras
    found = load(root, scenes=[], cameras=["eos-40d-comb"])
    camera, rig = found.cameras["eos-40d-comb"], found.rigs["gonio-grbl"]
    assert rig.kind == "driven" and rig.operator == "prompt" and rig.virtual is None
    assert camera.driver.retries == 5 and camera.driver.white_balance == "Daylight"
    corners = vars(camera.chart.centres_px).values()
    assert all(0 < 2 * x < camera.optics.width_px and 0 < 2 * y < camera.optics.height_px for x, y in corners)
    assert load_one("rigs", "gonio-grbl", root).rigs == found.rigs


def test_the_lamp_of_a_driven_rig_stays_in_the_plane(bench):
    edit(bench, "rigs/gonio-grbl.yaml", "limits.light_azimuth_deg", {"min": -90.0, "max": 90.0, "step": 1.0})
    error = fault(bench)
    assert error.field == "limits.light_azimuth_deg" and "driven" in error.found


def test_a_driven_rig_loads_before_a_photograph_is_taken(bench):
    definitions = load(bench)
    for kind, name in (("objects", "tile-plate"), ("cameras", "d5100-comb")):
        assert definitions.is_taken_here(kind, name) and not definitions.is_virtual(kind, name)
    assert not definitions.is_taken_here("environments", "classroom")
    assert not (bench / "camera").exists() and not (bench / "plate").exists()
    assert "l0650-c0720-t000-r0000" in definitions.captures_of("objects", "tile-plate", bench)


@pytest.mark.parametrize(
    ("file", "key"),
    [
        (CAMERA_FILE, "driver"), (CAMERA_FILE, "captures"), (CAMERA_FILE, "white"), (CAMERA_FILE, "poses"),
        (CAMERA_FILE, "exposure_s"), (PLATE_FILE, "captures"), (PLATE_FILE, "poses"), (PLATE_FILE, "exposure_s"),
        (ROOM_FILE, "captures"),
    ],
)  # fmt: skip
def test_what_a_driven_rig_needs(bench, file, key):
    edit(bench, file, key, ...)
    error = fault(bench)
    assert (Path(error.file).name, error.field, error.found) == (Path(file).name, key, "no such key")
    assert "because the rig is of kind driven" in error.accepted


def test_a_driven_rig_needs_its_white_pose_and_its_motors(bench):
    edit(bench, CAMERA_FILE, "poses.white", ...)
    assert fault(bench).field == "poses.white"
    edit(bench, "rigs/gonio-grbl.yaml", "motion", ...)
    error = fault(bench)
    assert Path(error.file).name == "gonio-grbl.yaml" and "motion" in f"{error.field} {error.found} {error.accepted}"


@pytest.mark.parametrize("file", [CAMERA_FILE, PLATE_FILE, ROOM_FILE])
def test_a_driven_rig_refuses_what_only_the_virtual_one_reads(bench, root, file):
    from irodori.config.definitions import read_yaml

    edit(bench, file, "virtual", read_yaml(Path(__file__).resolve().parents[2] / "config" / file)["virtual"])
    error = fault(bench)
    assert (Path(error.file).name, error.field) == (Path(file).name, "virtual")
    assert "a rig of kind driven does not use" in error.found


def test_a_place_is_not_photographed_on_a_driven_rig(bench):
    edit(bench, ROOM_FILE, "exposure_s", {"out": [0.02], "in": [0.05]})
    assert "a rig of kind driven does not use" in fault(bench).found


@pytest.mark.parametrize(("kind", "file"), [("virtual", "virtual"), ("files", "copy-stand")])
def test_a_camera_of_another_kind_of_rig_has_no_driver(root, kind, file):
    edit(root, CAMERA_FILE, "rig", file)
    if kind == "files":
        for key in ("virtual", "poses", "exposure_s", "dark_frames", "white_frames", "linearity_exposure_s"):
            edit(root, CAMERA_FILE, key, ...)
        edit(root, CAMERA_FILE, "captures", {"table": "camera/captures.csv"})
    edit(root, CAMERA_FILE, "driver", dict(DRIVER))
    error = fault(root, scenes=[], cameras=["d5100-comb"])
    assert error.field == "driver" and f"a rig of kind {kind} does not use" in error.found


def test_nobody_but_the_virtual_rig_has_hands_of_its_own(bench):
    edit(bench, "rigs/gonio-grbl.yaml", "operator", "auto")
    error = fault(bench)
    assert error.field == "operator" and error.accepted == "prompt or file"


def test_the_linearity_series_is_that_of_the_white_reference(bench):
    edit(bench, CAMERA_FILE, "linearity_exposure_s", [0.004, 0.002])
    assert load(bench).cameras["d5100-comb"].linearity_exposure_s == (0.004, 0.002)
    edit(bench, CAMERA_FILE, "linearity_exposure_s", [0.004, -0.002])
    assert fault(bench).field == "linearity_exposure_s[1]"
    for key in ("dark_frames", "white_frames", "linearity_exposure_s"):
        edit(bench, CAMERA_FILE, key, ...)
    camera = load(bench).cameras["d5100-comb"]
    exposures = len(camera.exposure_s.out) + len(camera.exposure_s.in_)
    roles = [shot.role for shot in camera_shots(camera, ".dng")]
    assert (roles.count("dark"), roles.count("white")) == (0, 2 * exposures)


def test_poses_out_of_reach_are_refused_before_the_rig_is_opened(bench):
    edit(bench, PLATE_FILE, "poses", [{"light_deg": [45.0], "camera_deg": [141.0]}])
    error = fault(bench)
    assert error.field == "poses[0].camera_deg[0]" and "0 to 140 degrees" in error.accepted


@pytest.mark.parametrize(
    ("captures", "field"),
    [
        ({"table": "camera/captures.csv"}, "captures.table"),
        ({"table": "./camera/../camera/captures.csv", "folder": "plate"}, "captures.table"),
        ({"table": "tables/plate.csv", "folder": "camera"}, "captures.folder"),
        ({"table": "camera/plate.csv"}, "captures.table"),
    ],
)
def test_two_sessions_do_not_write_into_one_folder_or_table(bench, captures, field):
    """Their photographs bear the same names: one would pass for the other."""
    edit(bench, PLATE_FILE, "captures", captures)
    error = fault(bench)
    assert Path(error.file).name == "tile-plate.yaml"
    assert error.field == field
    assert "of its own" in error.accepted and "d5100-comb.yaml" in error.accepted


def test_one_definition_is_loaded_for_the_person_at_the_bench(bench):
    found = load_one("objects", "tile-plate", bench)
    assert set(found.objects) == {"tile-plate"} and set(found.rigs) == {"gonio-grbl"}
    assert not found.scenes and not found.environments
    with pytest.raises(InputError, match="tile-plate"):
        load_one("objects", "tile-plat", bench)
    with pytest.raises(ValueError, match="no definitions of 'object'"):
        load_one("object", "tile-plate", bench)
