"""Lens distortion: OpenCV's own numbers, its inverse, and where the map folds."""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from made import made

from irodori.config.capture_table import Pose
from irodori.config.models import Distortion, Optics
from irodori.core.errors import InputError
from irodori.geometry import rig_frame
from irodori.geometry.distortion import COEFFICIENTS, coefficients_of, distort, fold_radius, undistort
from irodori.geometry.pinhole import Pinhole

COEFFICIENT = st.floats(-0.4, 0.4)
TANGENTIAL = st.floats(-0.02, 0.02)
LENS = st.tuples(COEFFICIENT, COEFFICIENT, TANGENTIAL, TANGENTIAL, COEFFICIENT, COEFFICIENT, COEFFICIENT, COEFFICIENT)
PLACE = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
#: Barrel distortion of a wide lens: it folds at 1 / sqrt(0.9).
BARREL = (-0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
OPTICS = {
    "focal_length_mm": 10.0, "pixel_pitch_um": 10.0, "width_px": 800, "height_px": 600,
    "principal_point_px": [400.0, 300.0],
}  # fmt: skip


@given(lens=LENS, place=PLACE)
@settings(deadline=None, max_examples=200)
def test_points_are_seen_where_opencv_sees_them(lens, place):
    cv2 = pytest.importorskip("cv2")
    found = distort(np.array(lens), fold_radius(lens), *place)
    assume(not math.isnan(found[0]))
    points, _ = cv2.projectPoints(np.array([[*place, 1.0]]), np.zeros(3), np.zeros(3), np.eye(3), np.array(lens))
    assert found == pytest.approx(points.ravel(), rel=1e-12, abs=1e-12)


@given(lens=LENS, place=PLACE)
@settings(deadline=None, max_examples=400)
@example(lens=BARREL, place=(0.0, 0.0))
@example(lens=(0.0,) * 8, place=(1.0, -1.0))
def test_what_is_seen_somewhere_is_found_again(lens, place):
    coefficients, fold = np.array(lens), fold_radius(lens)
    seen = distort(coefficients, fold, *place)
    assume(not math.isnan(seen[0]))
    back = undistort(coefficients, fold, *seen)
    assert not math.isnan(back[0])
    # Where the map is flat, near its fold, rounding of what is seen is more in what it came from.
    again = distort(coefficients, fold, *back)
    assert again == pytest.approx(seen, abs=1e-11)
    step = 1e-6
    sides = [distort(coefficients, fold, place[0] + a * step, place[1] + b * step) for a, b in ((1, 0), (0, 1))]
    jacobian = (np.array(sides) - seen) / step
    assume(np.isfinite(jacobian).all() and np.linalg.svd(jacobian)[1].min() > 0.05)
    assert back == pytest.approx(place, abs=1e-10)


@given(lens=LENS, place=PLACE)
@settings(deadline=None, max_examples=200)
def test_opencv_finds_the_same_inverse_where_it_converges(lens, place):
    cv2 = pytest.importorskip("cv2")
    mild = np.array(lens) * 0.2
    fold = fold_radius(mild)
    back = undistort(mild, fold, *place)
    assume(not math.isnan(back[0]))
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-15)
    points = cv2.undistortPointsIter(np.array([[place]]), np.eye(3), mild, np.eye(3), np.eye(3), stop)
    again = distort(mild, fold, *points.ravel())
    assume(not math.isnan(again[0]) and np.abs(np.subtract(again, place)).max() < 1e-12)
    assert back == pytest.approx(points.ravel(), abs=1e-9)


@given(k1=st.floats(-2.0, -0.01))
def test_a_barrel_folds_where_its_slope_is_zero(k1):
    lens = np.array([k1, 0, 0, 0, 0, 0, 0, 0], dtype=float)
    fold = fold_radius(lens)
    assert fold == pytest.approx(1 / math.sqrt(-3 * k1), rel=1e-9)
    edge = fold * (1 + k1 * fold**2)  # the furthest place at which anything is seen
    assert not math.isnan(undistort(lens, fold, 0.999 * edge, 0.0)[0])
    assert math.isnan(undistort(lens, fold, 1.001 * edge, 0.0)[0])
    assert not math.isnan(distort(lens, fold, 0.999 * fold, 0.0)[0])
    # What lies beyond would be seen once more inside the picture.
    assert math.isnan(distort(lens, fold, 1.001 * fold, 0.0)[0])
    assert math.isnan(distort(lens, fold, 1.5 * fold, 0.0)[0])


@pytest.mark.parametrize("lens", [(0.0,) * 8, (0.2, 0.1, 0, 0, 0.05, 0, 0, 0), (0.0, 0, 0.01, 0.01, 0, -0.0, 0, 0)])
def test_a_lens_whose_radial_part_grows_throughout_does_not_fold(lens):
    assert fold_radius(lens) == math.inf


def test_the_rational_part_folds_at_its_turning_point_or_its_pole():
    assert fold_radius((0, 0, 0, 0, 0, 0.1, 0, 0)) == pytest.approx(math.sqrt(10))  # of r / (1 + r²/10)
    assert fold_radius((0, 0, 0, 0, 0, -0.25, 0, 0)) == pytest.approx(2.0)


def test_coefficients_come_by_name_and_are_zero_where_absent():
    assert COEFFICIENTS == ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    assert coefficients_of(made(Distortion, {"k3": 0.3, "p2": -0.1})).tolist() == [0, 0, 0, -0.1, 0.3, 0, 0, 0]
    assert not coefficients_of(None).any()


@given(
    k1=st.floats(-0.3, 0.3), k2=st.floats(-0.1, 0.1), p1=TANGENTIAL, p2=TANGENTIAL,
    mosaic=st.tuples(st.floats(0.0, 800.0), st.floats(0.0, 600.0)), distance=st.floats(10.0, 2000.0),
)  # fmt: skip
@settings(deadline=None, max_examples=100)
def test_a_pixels_ray_projects_back_to_the_pixel_through_a_lens(k1, k2, p1, p2, mosaic, distance):
    lens = {"k1": k1, "k2": k2, "p1": p1, "p2": p2}
    camera = Pinhole.from_optics(made(Optics, {**OPTICS, "distortion": lens}))
    rotation, position = rig_frame.rig_from_camera(Pose(45.0, 30.0)), np.array([10.0, -20.0, 500.0])
    direction = camera.directions(np.array(mosaic), rotation)
    assert np.linalg.norm(direction) == pytest.approx(1.0, abs=1e-14)
    seen = camera.project(position + distance * direction, position, rotation)
    assert seen == pytest.approx(np.array(mosaic) / 2 - 0.5, abs=1e-7)


def test_a_lens_that_folds_inside_its_picture_is_refused():
    with pytest.raises(InputError, match=r"optics\.distortion.*folds over"):
        Pinhole.from_optics(made(Optics, {**OPTICS, "distortion": {"k1": -2.0}}))
    assert Pinhole.from_optics(made(Optics, {**OPTICS, "distortion": {"k1": -0.3}})).is_distorted


def test_what_lies_beyond_the_fold_is_not_seen():
    camera = Pinhole.from_optics(made(Optics, {**OPTICS, "distortion": {"k1": -0.3}}))
    # At 1.5 the barrel would bring the point back to 0.49 of unit distance, well inside the picture.
    points = np.array([[0.4, 0.0, 1.0], [1.5, 0.0, 1.0], [0.0, 0.0, -1.0]])
    seen = camera.project(points, np.zeros(3), np.eye(3))
    assert np.isfinite(seen[0]).all() and np.isnan(seen[1:]).all()


def test_a_camera_without_distortion_is_the_plain_pinhole():
    plain, zero = (
        Pinhole.from_optics(made(Optics, OPTICS)),
        Pinhole.from_optics(made(Optics, {**OPTICS, "distortion": {"k1": 0.0}})),
    )
    assert plain == zero and not plain.is_distorted
