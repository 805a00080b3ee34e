"""Plans for rigs of kind files: a list whose places a person can measure out, before there is any photograph."""

import math
import re
from dataclasses import replace

import pytest
from made import made
from plans import PLATE_OBJECT, RIG, SIDEWAYS, SPHERE_OBJECT
from sessions import definitions
from test_check import CORNERS, SIZE, write

from irodori.capture.followed_plan import by_hand, followed
from irodori.capture.shot_planner.planner import Planner, plan_best
from irodori.command_line import main
from irodori.config.definitions import load_one
from irodori.config.models import Object, Rig
from irodori.config.parts import PlannedObject
from irodori.core.errors import InputError
from irodori.first_project.questions import numbers
from irodori.geometry.rig_frame import to_camera, to_light

PLACE = r"(?:(\d+) mm to the (right|left)|straight)(?:, (\d+) mm (towards|away from) you)?, (\d+) mm (up|down)"


def place(words: str) -> tuple[float, float, float]:
    """Return a place in words as millimetres to the right, away from the person, and up."""
    aside, side, behind, towards, along, way = re.search(PLACE, words).groups()
    signs = (-1.0 if word in ("left", "towards", "down") else 1.0 for word in (side, towards, way))
    return tuple(sign * float(length or 0.0) for sign, length in zip(signs, (aside, behind, along), strict=True))


def measured_out(words: str) -> tuple[float, float]:
    """Return the distance from the object's middle and the angle from straight above it of a place in words."""
    x, y, z = place(words)
    return math.hypot(x, y, z), math.degrees(math.atan2(math.hypot(x, y), z))


def listed(lines) -> list[dict]:
    """Return the angles that a list tells, and those of the places in it."""
    found, setting = [], {}
    for line in lines:
        if lamp := re.match(r"lamp at ([\d.]+) degrees(?:, azimuth -?[\d.]+)?: (.*)", line):
            assert "to the left" not in line or "azimuth" in line
            setting = {"light_deg": float(lamp[1]), "lamp": measured_out(lamp[2])}
        elif line.startswith("object "):
            tilt, turn = re.search(r"tilted by ([\d.]+)", line), re.search(r"turned by ([\d.]+)", line)
            setting |= {"tilt_deg": float(tilt[1]) if tilt else 0.0, "turn_deg": float(turn[1]) if turn else 0.0}
        elif camera := re.match(r" *(\d+)\. camera at ([\d.]+) degrees: (.*)", line):
            assert "to the right" not in line and int(camera[1]) == len(found) + 1
            found.append(setting | {"camera_deg": float(camera[2]), "camera": measured_out(camera[3])})
    return found


@pytest.mark.parametrize("definition", [PLATE_OBJECT, SPHERE_OBJECT], ids=["plate", "sphere"])
def test_the_places_of_the_list_are_the_poses_of_the_plan(definition):
    rig = by_hand(made(Rig, RIG | {"light": {"spectrum": "A", "distance_mm": 1200.0}}))
    plan = plan_best(made(Object | PlannedObject, definition), rig, 8)
    lines = followed(plan, rig, {"out", "in"})
    found = listed(lines)
    assert len(found) == 8
    for pose, told in zip(plan.poses, found, strict=True):
        for axis in ("light_deg", "camera_deg", "tilt_deg", "turn_deg"):
            assert told[axis] == getattr(pose, axis)
        assert told["camera"] == (pytest.approx(900.0, abs=1.0), pytest.approx(pose.camera_deg, abs=0.1))
        assert told["lamp"] == (pytest.approx(1200.0, abs=1.0), pytest.approx(pose.light_deg, abs=0.1))
        assert pose.light_deg <= 80.0 and pose.camera_deg <= 80.0
    # What init asks for, as it reads it.
    for axis in ("light_deg", "camera_deg", "tilt_deg", "turn_deg"):
        (answer,) = [line.partition(": ")[2] for line in lines if line.startswith(f"{axis}: ")]
        assert numbers(8)(answer) == [getattr(pose, axis) for pose in plan.poses]
    settings = {(p.light_deg, p.tilt_deg, p.turn_deg) for p in plan.poses}
    assert lines[0].startswith(f"8 poses: lamp and object are set {len(settings)} times")
    assert "twice, without the filter and with it" in lines[1]


@pytest.mark.parametrize(
    ("stated", "by_program", "by_person"), [({}, 5.0, 10.0), ({"clearance_deg": 25.0}, 25.0, 25.0)]
)
def test_the_camera_is_never_in_the_lamps_way(stated, by_program, by_person):
    """A lamp behind the camera tells most of a sphere's gloss, if the camera does not stop its light."""
    coarse = {"light_deg": 45.0, "light_azimuth_deg": 60.0, "camera_deg": 5.0, "tilt_deg": 45.0, "turn_deg": 180.0}
    sphere, rig = made(Object | PlannedObject, SPHERE_OBJECT), made(Rig, SIDEWAYS | stated)
    for used, least_deg in ((rig, by_program), (by_hand(rig), by_person)):
        poses = Planner(sphere, used, coarse_deg=coarse).poses
        apart_deg = [math.degrees(math.acos(min(1.0, to_light(pose) @ to_camera(pose)))) for pose in poses]
        assert min(apart_deg) == pytest.approx(least_deg)


def test_a_list_with_lamps_beside_the_plane_says_where_they_stand():
    coarse = {"light_deg": 45.0, "light_azimuth_deg": 60.0, "camera_deg": 40.0, "tilt_deg": 45.0, "turn_deg": 90.0}
    rig = by_hand(made(Rig, SIDEWAYS | {"light": {"spectrum": "A"}}))
    plan = plan_best(made(Object | PlannedObject, SPHERE_OBJECT), rig, 8, coarse_deg=coarse)
    lines = followed(plan, rig)
    azimuths = {pose.light_azimuth_deg for pose in plan.poses}
    assert len(azimuths) > 1
    for line in lines:
        if lamp := re.match(r"lamp at ([\d.]+) degrees(?:, azimuth (-?[\d.]+))?: ", line):
            x, y, _ = place(line)
            assert measured_out(line) == (pytest.approx(1000.0, abs=1.5), pytest.approx(float(lamp[1]), abs=0.1))
            assert math.degrees(math.atan2(y, x)) % 360.0 == pytest.approx(float(lamp[2] or 0.0) % 360.0, abs=0.1)
    (answer,) = [line.partition(": ")[2] for line in lines if line.startswith("light_azimuth_deg: ")]
    assert numbers(8)(answer) == [pose.light_azimuth_deg for pose in plan.poses]


def test_a_lamp_of_no_known_distance_is_placed_by_the_metre():
    rig = by_hand(made(Rig, RIG | {"light": {"spectrum": "A"}}))
    plan = plan_best(made(Object | PlannedObject, PLATE_OBJECT), rig, 5)
    assert "once." in followed(plan, rig, {"out"})[1] and "where there is a filter" in followed(plan, rig)[1]
    lamps = [line for line in followed(plan, rig) if line.startswith("lamp at ")]
    assert lamps
    for line in lamps:
        assert line.endswith(", for each metre that it stands away")
        assert measured_out(line)[0] == pytest.approx(1000.0, abs=1.0)


def test_a_rig_that_reaches_low_angles_alone_keeps_its_lowest():
    limits = made(Rig, RIG).limits
    low = replace(made(Rig, RIG), limits=replace(limits, light_deg=replace(limits.light_deg, min=90.0)))
    light, camera = by_hand(low).limits.light_deg, by_hand(low).limits.camera_deg
    assert (light.min, light.max) == (90.0, 90.0) and (camera.min, camera.max) == (0.0, 80.0)


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A camera and a plate that nobody has photographed yet, on a copy stand."""
    _, camera, _ = definitions(poses=[{"light_deg": [45.0], "camera_deg": [20.0]}])
    chart = {"spectra": "BabelColor Average", "rows": 4, "columns": 6, "patch_px": 6}
    chart["centres_px"] = {name: [120.0 + 80.0 * x, 80.0 + 80.0 * y] for name, (x, y) in CORNERS.items()}
    own = {"rig": "stand", "optics": camera["optics"] | SIZE, "white": {"reflectance_factor": 0.99}, "chart": chart}
    rig = {key: RIG[key] for key in ("kind", "limits", "camera_distance_mm")} | {"light": {"spectrum": "A"}}
    write(tmp_path, {
        "config.yaml": {"definitions": "config", "make": {"scenes": []}},
        "rigs/stand.yaml": rig,
        "cameras/own.yaml": own | {"captures": {"table": "camera/captures.csv"}},
        "objects/plate.yaml": {"camera": "own", "shape": PLATE_OBJECT["shape"], "texels": {"width": 8, "height": 8},
                               "plan": {"count": 6, "max_manual": 2}, "captures": {"table": "plate/captures.csv"}},
    })  # fmt: skip
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_an_object_is_planned_before_it_is_photographed(project, capsys):
    assert main(["plan", "plate"]) == 0
    said = capsys.readouterr().out.splitlines()
    found = listed(said)
    assert len(found) == 6  # plan.count
    assert len({(one["light_deg"], one["tilt_deg"]) for one in found}) <= 2  # plan.max_manual
    assert main(["plan", "plate", "--best", "7"]) == 0
    assert len(listed(capsys.readouterr().out.splitlines())) == 7
    # A session, and the workflow, want the photographs.
    with pytest.raises(InputError, match=r"captures\.table: found no such file"):
        load_one("objects", "plate")
    assert main(["capture", "plate"]) == 1
    assert "no such file: camera/captures.csv" in capsys.readouterr().err


def test_a_shape_is_planned_without_any_definition_but_the_rigs(project, capsys):
    assert main(["plan", "stand", "--shape", "sphere 30", "--best", "5"]) == 0
    assert len(listed(capsys.readouterr().out.splitlines())) == 5


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["stand", "--shape", "egg 30"], "--shape: found 'egg 30'; accepted: plate WIDTH HEIGHT"),
        (["stand", "--shape", "mesh no.obj"], "no.obj"),
        (["stand", "--shape", "plate 90", "--camera"], "--shape: found --camera beside it"),
        (
            ["stand", "--shape", "plate 90", "--best", "3"],
            "--best: found 3 poses; accepted: 4 or more, for 3 parameters.",
        ),
        (["plate", "--best", "2"], "--best: found 2 poses; accepted: 4 or more, for 3 parameters."),
        (["own", "--camera"], "of kind files, whose photographs somebody else takes"),
        (["plat"], "did you mean 'plate'"),
    ],
)
def test_a_plan_that_cannot_be_is_refused_in_one_sentence(project, capsys, words, said):
    assert main(["plan", *words]) == 1
    out, err = capsys.readouterr()
    assert not out and said in err and len(err.strip().splitlines()) == 1
