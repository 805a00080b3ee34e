"""Brightness inside an outline: paints that a photograph shows at grazing angles, and others from the front."""

import numpy as np
import pytest
from drawn_plates import SETUP, linear_file

from irodori.config.capture_table import Pose
from irodori.config.models import Placing
from irodori.config.parts import TexturedObject
from irodori.geometry.rig_frame import rig_from_camera, rig_from_object, to_camera, to_light
from irodori.rectification.inner_brightness import paint_contrast, painted
from irodori.rectification.object_registration import _descend, _prepare, _problem
from irodori.rectification.registration_equations import measure_outline

RADIUS_MM = 25.0
BALL = TexturedObject.of({"shape": {"kind": "sphere", "radius_mm": RADIUS_MM}, "texels": {"width": 64, "height": 32}})
#: The last is seen from 25 degrees beside the pole: at its outline it shows latitudes up to 25 degrees.
POSES = [Pose(40.0, 0.0, 0.0, turn) for turn in (0.0, 90.0, 180.0, 270.0)] + [Pose(45.0, 25.0)]
_FINE = 6  # rays along each side of a superpixel


def a_ball(folder, border_deg, dark, poses=POSES, gloss=0.0):
    """Linear files of a ball, with a darker paint below a latitude, its superpixels as averages of many rays.

    It is matt but for a highlight of 8 degrees about the mirror direction.
    """
    files = []
    for number, pose in enumerate(poses):
        size = np.array([320, 240]) // 2
        x, y = ((np.arange(side * _FINE) + 0.5) / _FINE * 2.0 for side in size)
        rays = SETUP.pinhole.directions(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2), rig_from_camera(pose))
        eye = SETUP.camera_distance_mm * to_camera(pose)
        along = rays @ eye
        root = along**2 - eye @ eye + RADIUS_MM**2
        normal = (eye - (along + np.sqrt(np.maximum(root, 0.0)))[:, None] * rays) / RADIUS_MM
        paint = np.where((normal @ rig_from_object(pose))[:, 2] > np.sin(np.radians(border_deg)), 0.6, 0.6 * dark)
        half = to_light(pose) - rays
        away = np.arccos(np.clip(np.sum(normal * half, axis=1) / np.linalg.norm(half, axis=1), -1.0, 1.0))
        paint = paint + gloss * np.exp(-0.5 * (away / np.radians(8.0)) ** 2)
        shown = np.where(root > 0.0, paint * np.maximum(normal @ to_light(pose), 0.0), 0.0)
        shown = shown.reshape(size[1], _FINE, size[0], _FINE).mean(axis=(1, 3)) + 0.002
        files.append(linear_file(folder / f"{number}.h5", np.repeat(shown[..., None], 3, axis=2), pose=pose.angles_deg))
    return files


def prepared(files):
    problem = _problem(files, BALL, SETUP, Placing())
    for number in range(len(problem.views)):
        _prepare(problem, number, 4.0, 1.0)
    return problem


def test_normals_between_the_points_of_a_surface_are_those_of_the_ball(tmp_path):
    problem = prepared(a_ball(tmp_path, 0.0, 1.0, POSES[-1:]))
    surface = problem.views[0].surface
    np.testing.assert_allclose(np.linalg.norm(surface.point, axis=2), RADIUS_MM, rtol=1e-6)
    # The points of the grid are up to 6 degrees apart.
    away = np.degrees(np.arccos(np.minimum(np.sum(surface.normal * surface.point, axis=2) / RADIUS_MM, 1.0)))
    assert away.max() < 0.3


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("dark", [0.4, 1.0, 1.8])
@pytest.mark.parametrize("border_deg", [28.0, 32.0])
def test_a_border_just_inside_an_outline_is_known_from_other_photographs(tmp_path, border_deg, dark):
    """It lies 0.05 to 0.3 superpixels inside at the brightest place and goes inwards from there."""
    problem = prepared(a_ball(tmp_path, border_deg, dark))
    last = len(POSES) - 1
    view = problem.views[last]
    even, view.inner = measure_outline(problem, last, 4.0), painted(problem, last, paint_contrast(problem))
    known = measure_outline(problem, last, 4.0)
    assert known.found.sum() > 0.75 * len(known.found)
    assert abs(np.median(known.distance)) < 0.02 and np.percentile(np.abs(known.distance), 90.0) < 0.12
    at_ends = view.inner.paint[:, 0] / view.inner.paint[:, -1]
    if dark == 1.0:
        assert at_ends == pytest.approx(1.0, abs=0.05) and known.doubt.max() < 0.05
    else:
        # Somewhere along the outline, the border lies between the first depth and the last.
        assert np.abs(np.log(at_ends)).max() == pytest.approx(abs(np.log(dark)), abs=0.15)
        assert np.percentile(np.abs(even.distance), 90.0) > 2.0 * np.percentile(np.abs(known.distance), 90.0)
        assert np.percentile(known.doubt, 90.0) > 0.05


def test_what_no_other_photograph_shows_is_taken_for_evenly_painted(tmp_path):
    """A photograph alone, and one of two that show opposite sides."""
    opposite = [Pose(60.0, 0.0), Pose(60.0, 0.0, 0.0, 180.0)]
    for poses in (POSES[-1:], opposite):
        problem = prepared(a_ball(tmp_path, 20.0, 0.5, poses))
        side = painted(problem, 0, 0.3)
        np.testing.assert_allclose(side.paint, 1.0, atol=0.05)
        # What else it could be painted with makes the place of its edge unsure.
        np.testing.assert_allclose(side.unsure, 0.3, rtol=1e-6)
        sure = measure_outline(problem, 0, 4.0).doubt
        problem.views[0].inner = side
        assert (measure_outline(problem, 0, 4.0).doubt > sure + 0.1).all()


def test_the_contrast_of_paints_is_that_of_what_the_photographs_show(tmp_path):
    assert paint_contrast(prepared(a_ball(tmp_path, 0.0, 1.0))) < 0.02
    # Two paints: at most half their difference over their mean, if each covers half of what is seen lit.
    assert 0.15 < paint_contrast(prepared(a_ball(tmp_path, 35.0, 0.5))) < 0.25 / 0.75


def test_of_an_object_that_nothing_shows_from_the_front_no_contrast_of_paints_is_known(tmp_path):
    """It is lit from behind the only photograph."""
    problem = prepared(a_ball(tmp_path, 30.0, 0.4, [Pose(175.0, 0.0)]))
    assert paint_contrast(problem) == 0.0


def test_highlights_are_taken_for_paint_hardly_anywhere(tmp_path):
    """Each photograph has one, five times as bright as the paint; of the same point others tell the paint."""
    glossy = paint_contrast(prepared(a_ball(tmp_path, 0.0, 1.0, gloss=3.0)))
    assert glossy < 0.1


def test_paints_are_looked_up_at_the_last_level_of_the_search_alone(tmp_path):
    """Before, the object does not lie where it is yet, and they would be those beside the place."""
    problem = _problem(a_ball(tmp_path, 30.0, 0.4), BALL, SETUP, Placing())
    _descend(problem, 16.0, 1)
    for view in problem.views:
        np.testing.assert_array_equal(view.inner.paint, 1.0)
    _descend(problem, 4.0, 1)
    paint = problem.views[-1].inner.paint
    assert np.abs(np.log(paint[:, 0] / paint[:, -1])).max() == pytest.approx(np.log(1.0 / 0.4), abs=0.15)
