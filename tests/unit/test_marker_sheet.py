"""The printed sheet on which an object stands: what its corners tell of camera and table, and what is refused."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from documented import of_kind, words_of
from drawn_markers import BALL, LENS, PAPER, PLATE, SETUP, SHEET_LIES, VIEWS, drawn, turned, wrong
from drawn_plates import correction

from irodori.command_line import main
from irodori.config.capture_table import Pose
from irodori.config.models import Markers, Placing
from irodori.core import store
from irodori.core.errors import InputError, PlainError
from irodori.geometry.rig_frame import rig_from_camera, to_camera
from irodori.geometry.shapes.shape import Shape
from irodori.lens.printed_sheets import LENS_SHEET, OBJECT_SHEET
from irodori.rectification.marker_sheet import SHEET_QUANTITIES, MarkerSheet, check_first_size, corners_in
from irodori.rectification.object_registration import _lay_sheet, _settle, in_words, register, register_object
from irodori.rectification.placement_correction import COUNT, QUANTITIES, Correction, prior_sigma
from irodori.rectification.registration_covariance import RegisteredAngleErrors
from irodori.rectification.registration_file import AngleChanges, Estimate
from irodori.rectification.registration_problem import Problem, Registered, View, texels_of
from irodori.rectification.told_values import inverse

SHEET = Markers.of({"paper": PAPER})
#: All that the photographs have to tell, as far off as the issue asks for.
OFF = {
    "x_mm": 1.2, "y_mm": -1.5, "z_mm": 0.6, "camera_distance_mm": 50.0, "focal_length_percent": -5.0,
    "principal_x_px": 3.0, "principal_y_px": -2.0,
}  # fmt: skip
TURNED = {"about_x_deg": 0.6, "about_y_deg": 0.5, "about_z_deg": -1.0}
NAMES = [quantity.name for quantity in QUANTITIES]


def error_at_object_mm(found: Registered, lies: Correction, shape: Shape) -> float:
    """The largest distance in the pictures of points of the object from where they are expected, mm at the object."""
    points, worst = shape.atlas(9, 9).position.reshape(-1, 3), 0.0
    for pose in VIEWS:
        places = []
        for one in (lies, found.correction):
            real, camera = one.pose(pose), SETUP.corrected(one)
            eye = camera.camera_distance_mm * to_camera(real)
            world = one.placements(shape, real, 0.0)[0].points(points)
            places.append(camera.pinhole.project(world, eye, rig_from_camera(real)))
        worst = max(worst, np.linalg.norm(places[0] - places[1], axis=1).max())
    return worst * found.mm_per_px


def test_a_sheet_that_no_typed_pose_lets_the_camera_see_is_refused_in_a_sentence():
    sheet = MarkerSheet.of(SHEET, Shape.from_definition(BALL.shape), Placing())
    corners = [np.array([[1.0, 1.0], [2.0, 1.0], [1.0, 2.0], [2.0, 2.0]])]
    _, size = sheet.first_place(corners, [600.0 + 10.0 * corners[0]], [Pose(45.0, 89.0)], SETUP)  # above the horizon
    assert math.isnan(size)
    with pytest.raises(InputError, match="sees no table"):
        check_first_size(["linear/a.h5"], sheet, size, SETUP, Placing())


@pytest.mark.heavy
@pytest.mark.parametrize("definition, lies", [(BALL, OFF), (PLATE, OFF | TURNED)], ids=["uniform ball", "plate"])
def test_camera_and_object_are_found_by_the_sheet_that_the_object_partly_hides(tmp_path, definition, lies):
    lies = correction(**lies)
    found = register(drawn(tmp_path, lies, definition), definition, SETUP, Placing(), SHEET)
    off = np.array(found.correction.values) - lies.values
    assert np.abs(off[:3]).max() <= 0.05 and np.abs(off[3:6]).max() <= 0.05
    # The camera is found as exactly as the printed size is known: half a percent.
    told = dict(zip(NAMES, found.estimate.told, strict=True))
    assert told["camera_distance_mm"] and told["focal_length_percent"]
    assert abs(off[6]) < 5.0 and abs(off[7]) < 0.5 and np.abs(off[8:10]).max() < 0.1
    assert error_at_object_mm(found, lies, Shape.from_definition(definition.shape)) <= 0.1
    sheet = found.sheet
    np.testing.assert_allclose(sheet.values[:6], SHEET_LIES, atol=0.06)
    assert (sheet.corners > 30).all() and (sheet.corners < 48).any() and np.nanmax(found.residual_px) < 0.1


@pytest.mark.heavy
def test_without_the_sheet_a_uniform_ball_does_not_tell_where_the_camera_stands(tmp_path):
    lies = correction(**OFF)
    found = register(drawn(tmp_path, lies, BALL), BALL, SETUP, Placing())
    assert not found.estimate.told[NAMES.index("camera_distance_mm")] and found.sheet is None
    assert abs(found.correction.values[6] - 50.0) > 20.0


# What the corners tell, without pictures.

BOARD = np.stack(np.meshgrid(np.arange(1.0, 16.0), np.arange(1.0, 11.0)), axis=-1).reshape(-1, 2)
RING = BOARD[(BOARD == 1.0).any(axis=1) | (BOARD == [15.0, 10.0]).any(axis=1)]


def with_corners(truth, placing, noise_px, rng, views=VIEWS):
    """A problem whose photographs show corners where the truth puts them, and the covariance of the fit to them.

    The truth: 12 common numbers, one of each photograph, and 9 of the sheet.
    """
    shape = Shape.from_definition(BALL.shape)
    sheet = MarkerSheet.of(SHEET, shape, placing)
    sigma = np.concatenate([prior_sigma(placing), np.full(len(views), placing.camera_deg)])
    problem = Problem(shape, SETUP, texels_of(shape, 8, 4), [View(pose) for pose in views], sigma, np.zeros(len(sigma)))
    problem.sheet, common, of_sheet = sheet, truth[:COUNT], truth[COUNT + len(views) :]
    for number, view in enumerate(problem.views):
        square = 12.0 * (1.0 + of_sheet[6:8] / 100.0) * [1.0, -1.0]
        flat = np.concatenate([(RING - [8.0, 5.5]) * square, np.zeros((len(RING), 1))], axis=1)
        table = flat @ turned(of_sheet[3:6]).T + [*of_sheet[:2], -30.0 + of_sheet[2]]
        pose, camera_deg = view.pose, view.pose.camera_deg + common[10] + truth[COUNT + number]
        world = table @ (turned((0.0, pose.tilt_deg, 0.0)) @ turned((0.0, 0.0, pose.turn_deg))).T
        angle = math.radians(camera_deg)
        back, right = np.array([-math.sin(angle), 0, math.cos(angle)]), np.array([math.cos(angle), 0, math.sin(angle)])
        depth, focal = 900.0 + common[6] - world @ back, LENS.focal_px * (1.0 + common[7] / 100.0)
        mosaic = np.stack([focal * (world @ right) / depth, -focal * world[:, 1] / depth], axis=1)
        xy = (mosaic + LENS.centre_px + common[8:10]) / 2.0 - 0.5
        view.corners, view.corners_px = RING, xy + rng.normal(0.0, noise_px, xy.shape)
    _lay_sheet(problem, ["one.h5"], placing)
    return problem, inverse(_settle(problem, None, 8), problem.sigma)


def test_errors_of_what_the_sheet_tells_are_as_large_as_they_are_stated():
    """Over draws of all that may be off, each from its prior, with corners that are off by a tenth of a superpixel."""
    placing, rng, scores = Placing(), np.random.default_rng(4), []
    sigma = np.concatenate([prior_sigma(placing), np.full(len(VIEWS), placing.camera_deg)])
    of_sheet = MarkerSheet.of(SHEET, Shape.from_definition(BALL.shape), placing).sigma
    for _ in range(12):
        truth = rng.normal(0.0, 1.0, len(sigma) + 9) * [*sigma, 5.0, 5.0, *of_sheet[2:5], 40.0, *of_sheet[6:]]
        problem, covariance = with_corners(truth, placing, 0.1, rng)
        error = np.sqrt(np.diag(covariance))
        scores.append((problem.unknowns - truth) / error)
        assert error[6] < 6.0 and error[7] < 0.6 and (error[8:10] < 0.2).all() and error[10] < 0.03
    scores = np.array(scores)
    camera, sheet, own = scores[:, 6:11], scores[:, -9:], scores[:, COUNT:-9]  # 60, 108 and 72 numbers
    for z in (camera, sheet, own):
        assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.2)


def test_a_table_that_is_not_turned_leaves_what_only_turning_tells():
    """Principal point along y and the sheet's place along it move all pictures alike, and so do two tilts."""
    still, placing = [replace(pose, turn_deg=0.0) for pose in VIEWS], Placing(principal_point_px=20.0, camera_deg=1.0)
    truth = np.zeros(COUNT + len(VIEWS) + 9)
    _, covariance = with_corners(truth, placing, 0.05, np.random.default_rng(1), still)
    still_error = np.sqrt(np.diag(covariance))
    _, covariance = with_corners(truth, placing, 0.05, np.random.default_rng(1))
    error = np.sqrt(np.diag(covariance))
    assert still_error[9] > 20.0 * error[9] and still_error[-5] > 0.3 > 0.02 > error[-5]
    assert still_error[10] > 1.5 * error[10]


def test_a_wrong_turn_moves_nothing_of_what_the_others_tell():
    placing, rng = Placing(), np.random.default_rng(2)
    truth = np.zeros(COUNT + len(VIEWS) + 9)
    truth[6:8], truth[-9:-7] = (20.0, 2.0), (3.0, -4.0)
    problem, covariance = with_corners(truth, placing, 0.05, rng)
    right = problem.unknowns.copy()
    problem.views[2].pose = replace(VIEWS[2], turn_deg=93.0)
    _settle(problem, None, 8)
    moved = np.abs(problem.unknowns - right) / np.sqrt(np.diag(covariance))
    assert np.delete(moved, COUNT + 2).max() < 3.0


# What is refused.


def refused(tmp_path, files, words, markers=SHEET, definition=BALL) -> str:
    output = tmp_path / "out.h5"
    with pytest.raises(InputError, match=words) as caught:
        register_object(
            files, definition, SETUP, Placing(), markers, output=output, provenance=store.Provenance("test")
        )
    assert not output.exists()
    return str(caught.value)


@pytest.mark.heavy
@pytest.mark.stability(stage="rectify", case="a printed sheet that is missing or contradicts pose or size")
@pytest.mark.parametrize(
    "number, angles, words",
    [
        (3, {"turn_deg": 178.0}, r"turn_deg is off by \+2\.0"),
        (1, {"camera_deg": 21.0}, r"camera_deg or tilt_deg is off by -(1\.0|0\.[89])"),
    ],
)
def test_a_photograph_whose_sheet_contradicts_its_pose_is_named_with_its_angle(tmp_path, number, angles, words):
    """Of a ball: its outline does not change with the turn."""
    files = drawn(tmp_path, correction(), stated=wrong(number, **angles))
    said = refused(tmp_path, files, rf"{number}\.h5: pose_deg: found the printed sheet .* most likely {words}")
    assert "superpixels" in said


@pytest.mark.stability(stage="rectify", case="a printed sheet that is missing or contradicts pose or size")
@pytest.mark.parametrize(
    "sheet, count, words",
    [
        (None, 1, "the sheet in none of 1 photograph; acc"),
        (None, 2, "the sheet in none of 2 photographs; acc"),
        (LENS_SHEET, 2, "but that of irodori lens; acc"),
    ],
)
def test_photographs_without_the_sheet_are_refused_by_the_key(tmp_path, sheet, count, words):
    said = refused(tmp_path, drawn(tmp_path, correction(), sheet=sheet, shown=VIEWS[:count]), words)
    assert "markers: found" in said and "irodori markers" in said


@pytest.mark.heavy
@pytest.mark.stability(stage="rectify", case="a printed sheet that is missing or contradicts pose or size")
def test_a_sheet_printed_smaller_is_used_if_that_is_said_and_refused_if_not(tmp_path):
    lies = correction(x_mm=1.0, y_mm=-1.0)
    files = drawn(tmp_path, lies, stretched=(0.97, 0.97), shown=VIEWS[:4])
    told = Markers.of({"paper": PAPER, "square_mm": 0.97 * 12.0})
    found = register(files, BALL, SETUP, Placing(), told)
    np.testing.assert_allclose(found.correction.values, lies.values, atol=0.05)
    said = refused(tmp_path, files, r"squares of 11\.6[3-5] x 11\.6[3-5] mm beside an object of the typed size")
    assert "markers.square_mm" in said and "12 mm" in said


def test_a_sheet_on_another_paper_is_refused(tmp_path):
    refused(
        tmp_path,
        drawn(tmp_path, correction(), shown=VIEWS[:2]),
        r"squares of 12 mm at the typed",
        Markers.of({"paper": "A4"}),
    )


# What is written and said.


def test_a_sheet_that_some_photographs_lack_is_used_and_the_file_says_so(tmp_path):
    lies, output = correction(x_mm=1.2, camera_distance_mm=20.0), tmp_path / "out.h5"
    files = drawn(tmp_path, lies, without=(0, 4))
    register_object(files, BALL, SETUP, Placing(), SHEET, output=output, provenance=store.Provenance("test"))
    values = Correction.load(output).values
    assert abs(values[0] - 1.2) < 0.05 and abs(values[6] - 20.0) < 6.0
    with store.open_file(output) as file:
        corners, left = file.read("sheet_corners"), file.read("sheet_residual_px")
        assert (corners[[0, 4]] == 0).all() and (corners[[1, 2, 3, 5]] > 30).all()
        assert np.isnan(left[[0, 4]]).all() and left[1] < 0.1
        place, sigma = file.read("sheet_place"), file.read("sheet_place_sigma")
        assert len(place) == len(SHEET_QUANTITIES) and (np.abs(place - [*SHEET_LIES, 0, 0, 0]) < 4 * sigma + 0.02).all()
        assert f"the printed sheet was found in 4 of 6 photographs, {corners.sum()} corners" in file.attribute(
            "sentence"
        )


def test_the_sentence_of_an_object_without_a_sheet_does_not_speak_of_one():
    none = Registered(
        Estimate(np.zeros(COUNT), np.eye(COUNT), np.ones(COUNT), np.zeros(COUNT)),
        np.zeros(2),
        np.zeros(2),
        np.zeros(2),
        0.2,
        np.zeros(2),
        (("turn_deg", 0.0),) * 2,
        RegisteredAngleErrors(np.ones(4), np.ones((2, 4)), np.ones((4, 2)), AngleChanges(np.zeros(0), np.zeros(0))),
    )
    assert "sheet" not in in_words(none)


@pytest.mark.parametrize("pose", [Pose(45.0, 10.0), Pose(45.0, -20.0, 15.0, 70.0)])
def test_a_place_on_the_sheet_and_its_place_in_the_picture_belong_together(pose):
    sheet = MarkerSheet.of(Markers.of({"paper": "A4", "z_mm": -12.0}), Shape.from_definition(BALL.shape), Placing())
    values = np.array([3.0, -5.0, 1.0, 2.0, -1.0, 100.0, 1.0, -2.0, 0.0])
    assert sheet.z_mm == -12.0
    table = turned((0.0, pose.tilt_deg, 0.0)) @ turned((0.0, 0.0, pose.turn_deg))
    world = sheet.on_table(RING, values) @ table.T
    xy = LENS.project(world, 900.0 * to_camera(pose), rig_from_camera(pose))
    np.testing.assert_allclose(sheet.on_sheet(xy, pose, SETUP, values), RING, atol=1e-9)
    # The chessboard is two squares wide: lines that end in the black middle do not lie over it.
    along = np.tile([1.0, 0.0], (len(xy), 1))
    middle = LENS.project(
        sheet.on_table(np.array([[8.0, 5.5], [-3.0, 5.0]]), values) @ table.T,
        900.0 * to_camera(pose),
        rig_from_camera(pose),
    )
    assert sheet.is_over_print(xy, along, 1.0, pose, SETUP, values).all()
    assert sheet.is_over_print(middle, along[:2], 1.0, pose, SETUP, values).tolist() == [False, False]
    assert sheet.is_over_print(middle, along[:2], 320.0, pose, SETUP, values)[0]


def test_a_sheet_is_first_placed_by_all_photographs_and_one_wrong_pose_does_not_move_it():
    sheet = MarkerSheet.of(SHEET, Shape.from_definition(BALL.shape), Placing())
    lies = np.zeros(len(SHEET_QUANTITIES))
    lies[:2], lies[5] = (14.0, -9.0), 37.0
    printed = replace(sheet, square_mm=0.9 * sheet.square_mm)
    seen, stated = [], []
    for number, pose in enumerate(VIEWS):
        table = turned((0.0, pose.tilt_deg, 0.0)) @ turned((0.0, 0.0, pose.turn_deg))
        world = printed.on_table(RING, lies) @ table.T
        seen.append(LENS.project(world, 900.0 * to_camera(pose), rig_from_camera(pose)))
        stated.append(replace(pose, turn_deg=pose.turn_deg + 25.0) if number == 1 else pose)
    values, size = sheet.first_place([RING] * len(seen), seen, stated, SETUP)
    np.testing.assert_allclose(values, lies, atol=1e-6)
    assert size == pytest.approx(0.9, rel=1e-9)


def test_without_opencv_one_sentence_says_which_system_packages_are_missing(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(PlainError, match=r"markers needs OpenCV, which does not start .* libgl1 and libglib2\.0-0"):
        corners_in(np.zeros((8, 8), np.float32))
    for name in ("markers", "lens"):
        assert main([name, "A4"]) == 2
        assert capsys.readouterr().err.startswith(f"irodori {name} needs OpenCV")


def test_the_documented_commands_print_a_sheet(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for command in of_kind("markers"):
        _, *words = words_of(command)
        assert main(words) == 0, command
        assert "16 squares of" in capsys.readouterr().out
    assert list(tmp_path.glob("*.pdf"))
    assert main(["markers", "sheet.png"]) == 2 and "ends in .pdf" in capsys.readouterr().err


def test_the_command_and_the_schema_know_the_papers_of_the_sheet():
    from typing import get_args, get_type_hints

    from irodori.lens.markers_command import _PAPERS

    assert set(_PAPERS) == set(OBJECT_SHEET.papers_mm) == set(get_args(get_type_hints(Markers)["paper"]))
