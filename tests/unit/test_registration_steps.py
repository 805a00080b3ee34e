"""Steps of the registration of objects: what each says of pictures that were drawn, or of numbers written down."""

import math
from dataclasses import replace

import numpy as np
import pytest
from drawn_plates import PLATE, SETUP, SMALL, VIEWS, correction, drawn, linear_file, picture
from scipy.spatial import ConvexHull

from irodori.config.capture_table import Pose
from irodori.config.models import Placing
from irodori.config.parts import TexturedObject
from irodori.geometry.lamp import Lamp
from irodori.geometry.mesh import make_mesh
from irodori.geometry.rig_frame import rig_from_camera, rig_from_object, rotation_x, rotation_y, rotation_z, to_light
from irodori.geometry.shapes.plate import Plate
from irodori.geometry.shapes.sphere import Sphere
from irodori.geometry.shapes.triangle_mesh import TriangleMesh
from irodori.rectification import object_registration
from irodori.rectification.object_registration import (
    _descend,
    _first_reach,
    _prepare,
    _problem,
    _spacing,
    _weigh,
    _window,
    register,
)
from irodori.rectification.placement_correction import CAMERA, COUNT, LIGHT, Correction, prior_sigma
from irodori.rectification.pose_residuals import _displacement, _is_clearer, _shift, _suspect, pose_residuals
from irodori.rectification.registration_equations import (
    Outline,
    add_texture,
    equations,
    linearised_textures,
    measure_outline,
    outline_scale,
    outline_variance,
)
from irodori.rectification.registration_problem import Problem, View, texels_of
from irodori.rectification.texture_agreement import TextureRows, blocks, mean_texture
from irodori.rectification.told_values import diagonal_of_inverse

MM_PER_PX = 2.0 * 900.0 / 2400.0


def problem_without_pictures(shape, poses, *, columns=24, rows=20, setup=SETUP, placing=None) -> Problem:
    sigma = np.concatenate([prior_sigma(placing or Placing()), np.full(len(poses), 0.3)])
    return Problem(shape, setup, texels_of(shape, columns, rows), [View(p) for p in poses], sigma, np.zeros(len(sigma)))


def prepared(problem, reach=4.0, blur=2.0) -> Problem:
    """What photographs show at a level of the search, as `_descend` has it done."""
    texels = problem.texels
    problem.block = blocks(texels.columns, texels.rows, _spacing(problem), blur)[texels.number]
    for number in range(len(problem.views)):
        _prepare(problem, number, reach, blur)
    return problem


# Where things are.


def test_points_are_seen_where_a_pinhole_by_the_corrected_numbers_puts_them():
    rng = np.random.default_rng(3)
    values = rng.uniform(-2.0, 2.0, COUNT + 2)
    problem = problem_without_pictures(Plate(60.0, 50.0), [Pose(45.0, 0.0), Pose(60.0, 20.0, 10.0, 30.0)])
    points = rng.uniform(-30.0, 30.0, (40, 3))
    x, y, z = (math.radians(angle) for angle in values[3:6])
    lain = points @ (rotation_z(z) @ rotation_y(y) @ rotation_x(x)).T + values[:3]
    placed = lain @ (rotation_y(math.radians(10.0)) @ rotation_z(math.radians(30.0))).T
    angle = math.radians(20.0 + values[CAMERA] + values[COUNT + 1])
    forward, right = (
        np.array([math.sin(angle), 0.0, -math.cos(angle)]),
        np.array([math.cos(angle), 0.0, math.sin(angle)]),
    )
    ray = placed + (900.0 + values[6]) * forward
    focal = 2400.0 * (1.0 + values[7] / 100.0) / (ray @ forward)
    mosaic = np.stack([160.0 + values[8] + focal * (ray @ right), 120.0 + values[9] - focal * ray[:, 1]], axis=1)
    np.testing.assert_allclose(problem.seen(1, points, values), mosaic / 2.0 - 0.5, atol=1e-9)


def test_derivatives_are_what_places_change_by():
    problem = problem_without_pictures(Plate(60.0, 50.0), VIEWS)
    problem.unknowns = np.random.default_rng(4).uniform(-1.0, 1.0, COUNT + len(VIEWS))
    points = problem.texels.position[::7]
    found = problem.derivative(lambda v, values: problem.seen(v, points, values), 1)
    for number in range(COUNT):
        moved = problem.unknowns.copy()
        moved[number] += 1e-4
        change = problem.seen(1, points, moved) - problem.seen(1, points, problem.unknowns)
        np.testing.assert_allclose(found[..., number], change / 1e-4, rtol=1e-3, atol=1e-3)


def test_shading_is_the_cosine_of_incidence_times_the_power_of_a_near_lamp():
    pose = Pose(50.0, 0.0, 10.0, 40.0)
    near = replace(SETUP, lamp=Lamp(200.0), white_pose=pose)
    problem = problem_without_pictures(Sphere(30.0), [pose], setup=near)
    normal = problem.texels.position @ rig_from_object(pose).T / 30.0
    way = 200.0 * to_light(pose) - 30.0 * normal
    distance = np.linalg.norm(way, axis=1)
    expected = np.sum(normal * way, axis=1) / distance * (200.0 / distance) ** 2
    lit = expected > 0.0
    assert 0.2 < lit.mean() < 0.6
    found = problem.shading(0)
    np.testing.assert_allclose(found[lit], expected[lit], rtol=1e-9)
    assert np.isnan(found[~lit]).all()


def test_texels_are_the_objects_own_or_as_many_as_are_compared():
    own = texels_of(Plate(60.0, 50.0), 24, 20)
    assert (own.columns, own.rows) == (24, 20) and np.array_equal(own.number, np.arange(480))
    fine = texels_of(Plate(60.0, 30.0), 2000, 1000)
    assert fine.columns * fine.rows == pytest.approx(3600, rel=0.02) and fine.columns / fine.rows == pytest.approx(
        2.0, rel=0.02
    )
    np.testing.assert_allclose(
        np.ptp(fine.position, axis=0), [60.0 - 60.0 / fine.columns, 30.0 - 30.0 / fine.rows, 0.0]
    )
    # A slope needs two texels along each side.
    assert (texels_of(Plate(60.0, 50.0), 1, 2).columns, texels_of(Plate(60.0, 50.0), 2, 1).rows) == (2, 2)


def test_a_window_holds_the_object_and_a_margin():
    problem = problem_without_pictures(Plate(60.0, 50.0), [Pose(45.0, 0.0), Pose(45.0, 0.0, 0.0, 90.0)])
    # The principal point is at superpixel 79.5, 59.5. Half a texel counts by the side that has fewer.
    half, middle = np.array([30.0, 25.0]) / MM_PER_PX, np.array([79.5, 59.5])
    found = np.array(_window(problem, 0, 5.0))
    np.testing.assert_allclose(found, [*(middle - half - 5.0), *(middle + half + 5.0)], atol=0.5)
    found = np.array(_window(problem, 1, 0.0))
    np.testing.assert_allclose(found, [*(middle - half[::-1]), *(middle + half[::-1])], atol=0.5)
    # Exactly: half a texel is that of the whole extent of the centres, by the fewer texels along a side.
    centres = np.array([57.5, 47.5])
    half = centres / 2.0 + centres / (2.0 * 19.0)
    expected = [*(middle - half / MM_PER_PX - 5.0), *(middle + half / MM_PER_PX + 5.0)]
    np.testing.assert_allclose(_window(problem, 0, 5.0), expected, atol=1e-6)
    problem.unknowns[6] = -1000.0  # behind the camera
    assert _window(problem, 0, 5.0) == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_the_search_begins_as_far_off_as_the_prior_allows_within_the_objects_size(scale):
    def reach(mm, width=60.0, height=60.0):
        alone = {name: 0.0 for name in vars(Placing()) if name != "max_residual_px"} | {"translation_mm": mm}
        problem = problem_without_pictures(Plate(width, height), [Pose(45.0, 0.0)] * 3, placing=Placing(**alone))
        for view in problem.views:
            view.picture = picture(np.zeros((2, 2, 3)), scale=scale)
        return _first_reach(problem)

    # Two and a half standard deviations; along the optical axis nearly nothing is seen of a displacement.
    assert reach(2.0) == pytest.approx(2.5 * 2.0 / MM_PER_PX * scale, rel=0.01)
    assert reach(0.1) == 4.0
    assert reach(40.0, 2000.0, 2000.0) == 40.0
    for width, height in ((30.0, 50.0), (50.0, 30.0)):  # by the side that is narrower
        assert reach(40.0, width, height) == pytest.approx(max(4.0, 0.35 * 15.0 / MM_PER_PX * scale), rel=0.02)


def test_the_spacing_of_texels_is_that_in_the_picture():
    def spacing(pose, scale, width):
        problem = problem_without_pictures(Plate(width, 50.0), [pose] * 2)
        for view in problem.views:
            view.picture = picture(np.zeros((2, 2, 3)), scale=scale)
        return _spacing(problem)

    for turn in (0.0, 30.0, 90.0):
        assert spacing(Pose(45.0, 0.0, 0.0, turn), 1.0, 60.0) == pytest.approx(2.5 / MM_PER_PX, rel=0.01)
        assert spacing(Pose(45.0, 60.0, 0.0, turn), 2.0, 120.0) == pytest.approx(2.0 * 2.5 / MM_PER_PX, rel=0.01)


# What photographs show.


def test_texels_have_a_say_where_they_are_seen_lit_matt_and_away_from_the_rim(tmp_path):
    poses = [
        Pose(45.0, 0.0),
        Pose(45.0, 40.0),
        Pose(88.0, 0.0),
    ]  # matt; in the direction of gloss; lit along the surface
    problem = prepared(_problem(drawn(tmp_path, Correction(), poses, poses), PLATE, SETUP, Placing()), blur=2.0)
    matt, gloss, dark = (view.weight for view in problem.views)
    inward = np.min([30.0, 25.0] - np.abs(problem.texels.position[:, :2]), axis=1) / MM_PER_PX
    within = inward > 2.0 * 2.0 + 1.5 + 0.3
    phi = math.radians(45.0 / 2.0)
    np.testing.assert_allclose(matt[within], (phi / 0.35) ** 2 if phi < 0.35 else 1.0, rtol=1e-6)
    assert (matt[inward < 2.0 * 2.0 + 1.5 - 0.3] == 0.0).all()
    assert gloss[within].max() < 0.05 and not dark.any()
    assert len(problem.views[0].rim) > 50 and len(problem.views[1].rim) > 50 and len(problem.views[2].rim) == 0
    np.testing.assert_allclose(np.linalg.norm(problem.views[0].outward, axis=1), 1.0)
    full = prepared(_problem(drawn(tmp_path, Correction(), poses, poses), PLATE, SETUP, Placing()), blur=1.0)
    assert (full.views[0].weight > 0).sum() > (matt > 0).sum()


def test_the_outline_of_a_sphere_is_looked_for_where_it_is_lit():
    pose = Pose(60.0, 10.0)
    problem = problem_without_pictures(Sphere(30.0), [pose], columns=48, rows=24)
    problem.views[0].picture = picture(np.full((120, 160, 3), 0.5))
    view = prepared(problem).views[0]
    cosine = view.rim @ to_light(pose) / 30.0
    assert cosine.min() > 0.15 - 0.04 and cosine.max() > 0.9  # by the normal of the next texel, of 4 degrees
    # The light on it from there inwards, of which a ball has more as it faces the camera.
    light, facing = view.inner.light, view.inner.facing
    np.testing.assert_allclose(light[:, 0], cosine, atol=0.05)
    assert (light[:, -1] > light[:, 0])[cosine < 0.5].all()
    deep = np.arange(2, 12) / 2.0 / 40.0  # of the radius of 40 superpixels
    np.testing.assert_allclose(facing[:, 2:12] ** 2, np.tile(2.0 * deep - deep**2, (len(facing), 1)), rtol=0.03)
    assert not problem.tells_texture


FACING = [Pose(45.0, 0.0), Pose(45.0, 0.0, 0.0, 90.0)]


def plain(folder, poses=FACING, **lies) -> Problem:
    """A plate without texture that lies elsewhere than it is said to."""
    files = drawn(folder, correction(**lies), poses, poses, contrast=0.0)
    return prepared(_problem(files, PLATE, SETUP, Placing()))


def test_the_distance_of_an_outline_is_what_lies_between_plate_and_prior_along_the_normals(tmp_path):
    problem = plain(tmp_path, x_mm=0.6, y_mm=-0.9)
    for number, moved in ((0, [0.6, 0.9]), (1, [0.9, -0.6])):
        distance, _, change, found = measure_outline(problem, number, 4.0)
        outward = problem.views[number].outward[found]
        assert found.sum() > 150
        np.testing.assert_allclose(distance, outward @ moved / MM_PER_PX, atol=0.02)
        by_xy = np.array([[1.0, 0.0], [0.0, -1.0]] if number == 0 else [[0.0, -1.0], [-1.0, 0.0]])
        np.testing.assert_allclose(change[:, :2], outward @ by_xy.T / MM_PER_PX, atol=0.01)


def test_an_object_of_few_texels_has_an_outline_all_round(tmp_path):
    """Its sides lie far beyond the centres of the outermost texels."""
    few = TexturedObject.of(
        {"shape": {"kind": "plate", "width_mm": 60.0, "height_mm": 50.0}, "texels": {"width": 5, "height": 4}}
    )
    problem = prepared(_problem(drawn(tmp_path, Correction(), FACING, FACING, contrast=0.0), few, SETUP, Placing()))
    for view in problem.views:
        x, y = view.rim[:, 0] / 30.0, view.rim[:, 1] / 25.0
        assert min((one > 0.99).sum() for one in (x, -x, y, -y)) > 20


def test_pictures_are_searched_as_they_are_at_the_end_and_smoothed_before():
    problem = problem_without_pictures(Plate(60.0, 50.0), [Pose(45.0, 0.0)])
    response = np.random.default_rng(16).uniform(0.3, 0.7, (120, 160, 3))
    view = problem.views[0]
    view.picture = picture(response)
    np.testing.assert_array_equal(prepared(problem).views[0].search.bands, np.moveaxis(view.picture.response, -1, 0))
    assert np.std(prepared(problem, reach=16.0).views[0].search.bands) < 0.25 * np.std(response)


def test_nothing_is_said_of_an_outline_of_few_points(tmp_path):
    problem = plain(tmp_path)
    view = problem.views[0]
    for count in (0, 11, 12):
        view.rim, view.outward, view.change = (one[:count] for one in (view.rim, view.outward, view.change))
        distance, _, change, found = measure_outline(problem, 0, 4.0)
        said = count if count >= 12 else 0
        assert (len(distance), len(change), found.sum(), len(found)) == (said, said, said, count)
        problem = prepared(problem)
        view = problem.views[0]


def test_the_normal_equations_are_those_of_the_outlines_distances_and_the_prior(tmp_path):
    problem = plain(tmp_path, x_mm=0.01, y_mm=-0.01, about_z_deg=0.01)
    problem.unknowns = np.random.default_rng(6).normal(0.0, 0.003, COUNT + 2)
    matrix, right = equations(problem, 4.0)
    cost = np.zeros((2, COUNT + 2))
    step = 0.02

    def half_square(values):
        """Half the sum of squares: five points as one of 0.1 superpixels, outliers with less weight, and the prior."""
        before, problem.unknowns = problem.unknowns, values
        off = np.concatenate([measure_outline(problem, number, 4.0)[0] for number in (0, 1)])
        problem.unknowns = before
        # Cauchy's, whose derivative is the distance times its weight.
        outlines = 0.5 * np.sum(0.2**2 * np.log1p((off / 0.2) ** 2)) / (0.1**2 * 5.0)
        return outlines + 0.5 * np.sum((values / problem.sigma) ** 2)

    for number in range(COUNT + 2):
        for end, sign in enumerate((1.0, -1.0)):
            values = problem.unknowns.copy()
            values[number] += sign * step
            cost[end, number] = half_square(values)
    scale = np.sqrt(np.diag(matrix))
    np.testing.assert_allclose(right / scale, (cost[1] - cost[0]) / (2.0 * step) / scale, rtol=0.03, atol=0.03)
    slope = []
    for number in range(COUNT + 2):
        ends = []
        for sign in (1.0, -1.0):
            values = problem.unknowns.copy()
            values[number] += sign * step
            moved = replace(problem, unknowns=values)
            ends.append(equations(moved, 4.0)[1])
        slope.append((ends[1] - ends[0]) / (2.0 * step))
    np.testing.assert_allclose(np.array(slope) / np.outer(scale, scale), matrix / np.outer(scale, scale), atol=0.1)
    # What has no room has no prior either.
    fixed = replace(problem, sigma=np.where(np.arange(COUNT + 2) == 3, 0.0, problem.sigma))
    without = equations(fixed, 4.0)
    expected = np.zeros(COUNT + 2)
    expected[3] = 1.0 / problem.sigma[3] ** 2
    np.testing.assert_allclose(matrix - without[0], np.diag(expected), atol=1e-9)
    np.testing.assert_allclose(right - without[1], -expected * problem.unknowns, atol=1e-9)


def silenced(problem) -> Problem:
    """The same without a say of any texel."""
    for view in problem.views:
        view.weight = np.zeros_like(view.weight)
    return problem


def test_textures_are_compared_at_the_end_and_where_there_is_no_outline(tmp_path):
    files = drawn(tmp_path, Correction(), FACING, FACING)
    for reach, has_a_say in ((16.0, False), (4.0, True)):
        problem = prepared(_problem(files, PLATE, SETUP, Placing()), reach)
        whole = equations(problem, reach)[0]
        by_outline = equations(silenced(problem), reach)[0]
        assert (not np.array_equal(whole, by_outline)) == has_a_say
        assert by_outline[0, 0] > 2.0 / problem.sigma[0] ** 2
    beyond = textured(tmp_path)
    assert not np.array_equal(equations(beyond, 16.0)[0], equations(silenced(beyond), 16.0)[0])


def test_the_texture_of_round_objects_is_not_compared():
    problem = problem_without_pictures(Sphere(30.0), FACING, columns=48, rows=24)
    response = np.random.default_rng(15).uniform(0.45, 0.55, (120, 160, 3))
    for view in problem.views:
        view.picture = picture(response)
    prepared(problem)
    for reach in (16.0, 4.0):
        matrix, right = equations(problem, reach)
        np.testing.assert_allclose(matrix, np.diag(1.0 / problem.sigma**2), rtol=1e-12)
        assert not right.any()


@pytest.mark.parametrize("reach", [4.0, 16.0])
def test_textures_are_blurred_by_a_third_of_the_reach_and_more_than_half_a_texel_in_blocks_of_that_blur(
    tmp_path, reach
):
    files = drawn(tmp_path, Correction(), FACING[:1], FACING[:1], contrast=0.0)
    for columns in (24, 60):
        shape = {"kind": "plate", "width_mm": 60.0, "height_mm": 50.0}
        plate = TexturedObject.of({"shape": shape, "texels": {"width": columns, "height": 20}})
        problem = _problem(files, plate, SETUP, Placing())
        texels, spacing = problem.texels, _spacing(problem)
        blur = max(1.0, reach / 3.0, 0.6 * spacing)
        _descend(problem, reach, 1)
        for view in problem.views:
            np.testing.assert_array_equal(view.level.bands, view.picture.level(blur).bands)
        expected = blocks(texels.columns, texels.rows, spacing, blur)[texels.number]
        np.testing.assert_array_equal(problem.block, expected)


def test_steps_end_where_they_are_a_fiftieth_of_what_is_still_unsure(tmp_path, monkeypatch):
    problem, steps = _problem(drawn(tmp_path, correction(x_mm=0.6, y_mm=-0.9), FACING, FACING, contrast=0.0), PLATE,
                              SETUP, Placing()), []  # fmt: skip
    real = object_registration.equations

    def counted(*arguments):
        matrix, right = real(*arguments)
        steps.append(problem.unknowns.copy())
        return matrix, right

    monkeypatch.setattr(object_registration, "equations", counted)
    _descend(problem, 4.0, 2)
    assert len(steps) == 2
    matrix = _descend(problem, 4.0, 50)
    moved = np.abs(np.diff([*steps[2:], problem.unknowns], axis=0))
    unsure = np.sqrt(diagonal_of_inverse(matrix, problem.sigma))
    assert 1 <= len(moved) < 50 and (moved[-1] <= 0.02 * unsure).all()
    assert all((one > 0.015 * unsure).any() for one in moved[:-1])
    np.testing.assert_allclose(problem.unknowns[:2], [0.6, -0.9], atol=0.1)
    expected, right = real(problem, 4.0)
    np.testing.assert_allclose(np.diag(matrix), np.diag(expected), rtol=0.05)
    assert np.abs(right / np.sqrt(np.diag(expected))).max() < 0.05


@pytest.mark.parametrize("radius_mm", [20.0, 45.0])
def test_a_ball_bends_by_its_curvature_everywhere_and_in_every_direction(radius_mm):
    problem = problem_without_pictures(Sphere(radius_mm), FACING, columns=48, rows=24)
    points = problem.skin[0].data
    normal = points / np.linalg.norm(points, axis=1)[:, None]
    across = np.eye(3) - normal[:, :, None] * normal[:, None]
    # Chords are shorter than arcs, and points near the poles lie in few directions.
    off = np.linalg.norm(problem.bends @ across - across / radius_mm, axis=(1, 2)) * radius_mm
    assert np.median(off) < 0.02 and np.percentile(off, 95.0) < 0.1
    assert problem.bend_per_mm == pytest.approx(1.0 / radius_mm, rel=0.02)


def test_a_surface_does_not_bend_at_an_edge():
    """The sides of a box are flat, also beside another side."""
    corners = np.stack(np.meshgrid([-15.0, 15.0], [-12.0, 12.0], [0.0, 18.0], indexing="ij"), axis=-1).reshape(-1, 3)
    sides = ConvexHull(corners)
    outward = np.cross(*(corners[sides.simplices[:, k]] - corners[sides.simplices[:, 0]] for k in (1, 2)))
    faces = np.where((np.sum(outward * sides.equations[:, :3], axis=1) > 0.0)[:, None], sides.simplices,
                     sides.simplices[:, ::-1])  # fmt: skip
    # Each triangle with a part of the texture to itself.
    uv = (
        np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]]) + np.array([(n % 4, n // 4) for n in range(12)])[:, None]
    ) / 4.0
    problem = problem_without_pictures(TriangleMesh(make_mesh(corners[faces], uv)), FACING)
    assert np.ptp(problem.skin[1], axis=0).min() > 1.9
    np.testing.assert_allclose(problem.bends, 0.0, atol=1e-9)


def test_at_the_end_no_outline_is_thought_to_scatter_much():
    """Before, points at other edges than the outline scatter by superpixels."""
    change = np.zeros((400, COUNT + 2))
    distance = np.random.default_rng(5).normal(0.0, 3.0, 400)
    far = [Outline(distance, np.zeros(400), change, np.ones(400, dtype=bool))]
    before, at_end = (outline_scale(far, is_last=last) for last in (False, True))
    assert before == pytest.approx(3.0, rel=0.1) and at_end < 0.5


# Textures.

LARGE = TexturedObject.of(
    {"shape": {"kind": "plate", "width_mm": 130.0, "height_mm": 104.0}, "texels": {"width": 60, "height": 48}}
)
HALF_TURNED = [Pose(45.0, 0.0), Pose(45.0, 0.0, 0.0, 180.0)]


def textured(folder, shown=HALF_TURNED, stated=HALF_TURNED, **lies) -> Problem:
    """A plate that reaches beyond the pictures."""
    files = drawn(folder, correction(**lies), shown, stated, (130.0, 104.0))
    return prepared(_problem(files, LARGE, SETUP, Placing()), blur=1.0)


def test_rows_of_a_texture_are_what_texels_show_and_what_that_changes_by(tmp_path):
    problem = textured(tmp_path)
    rows = linearised_textures(problem)
    assert [row.change.shape for row in rows] == [(60 * 48, 3, COUNT + 2)] * 2
    # Texels at the rim of what is seen have no slope; of whole blocks the mean is that of their own texels.
    said = np.all([row.weight > 0 for row in rows], axis=0)
    count = np.bincount(problem.block)
    inner = (np.bincount(problem.block, said) == count)[problem.block]
    assert inner.sum() > 300

    def changed(after, number):
        by = after[number].value - rows[number].value
        mean = np.array([np.bincount(problem.block, np.nan_to_num(band), len(count)) for band in by.T])
        return (by - (mean / np.maximum(count, 1)).T[problem.block])[inner]

    for column, step in ((0, 0.2), (1, 0.2), (5, 0.2), (6, 2.0), (CAMERA, 0.5)):
        values = problem.unknowns.copy()
        values[column] += step
        after = linearised_textures(replace(problem, unknowns=values))
        for number in (0, 1):
            expected = rows[number].change[inner][..., column] * step
            assert np.std(changed(after, number) - expected) < 0.15 * np.std(expected)
    for axis in (0, 1):  # of a photograph on its own
        view = problem.views[0]
        view.picture = replace(view.picture, corner=view.picture.corner - 0.2 * np.eye(2)[axis])
        after = linearised_textures(problem)
        view.picture = replace(view.picture, corner=view.picture.corner + 0.2 * np.eye(2)[axis])
        expected = rows[0].change[inner][..., COUNT + axis] * 0.2
        assert np.std(changed(after, 0) - expected) < 0.15 * np.std(expected)


def rows_of(seed, *, views=3, count=40, size=1e-5, bands=2):
    """Made-up textures of one colour each texel, but for what a step of the unknowns explains; and that step."""
    rng = np.random.default_rng(seed)
    step = size * rng.normal(size=COUNT + views)
    colour = rng.normal(size=(count, bands))
    rows = []
    for view in range(views):
        change = rng.normal(size=(count, bands, COUNT + 2))
        by = change[..., :COUNT] @ step[:COUNT] + change[..., CAMERA] * step[COUNT + view]
        weight = np.where(rng.uniform(size=count) < 0.7, rng.uniform(0.3, 1.0, count), 0.0)
        rows.append(TextureRows(weight, colour - by, change))
    return rows, step


def test_normal_equations_of_textures_are_those_whose_colours_are_unknowns_too():
    rows, _ = rows_of(7)
    size, bands = COUNT + len(rows), 2
    matrix, right = np.zeros((size, size)), np.zeros(size)
    add_texture(rows, matrix, right)
    lines, values = [], []
    seen = np.sum([row.weight > 0 for row in rows], axis=0)
    for view, row in enumerate(rows):
        for texel in np.flatnonzero((row.weight > 0) & (seen > 1)):
            for band in range(bands):
                line = np.zeros(size + 40 * bands)
                line[:COUNT] = row.change[texel, band, :COUNT]
                line[COUNT + view] = row.change[texel, band, CAMERA]
                line[size + texel * bands + band] = -1.0
                # Measurements of 0.01, of which 75 count as one.
                root = math.sqrt(row.weight[texel] / (0.01**2 * 75.0))
                lines.append(root * line)
                values.append(-root * row.value[texel, band])
    a = np.array(lines)
    full, b = a.T @ a, a.T @ np.array(values)
    used = np.flatnonzero(np.diag(full) > 0)
    colours = used[used >= size]
    over = full[:size, colours] @ np.linalg.inv(full[np.ix_(colours, colours)])
    expected, expected_right = full[:size, :size] - over @ full[colours, :size], b[:size] - over @ b[colours]
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(matrix / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-5)
    np.testing.assert_allclose(right / scale, expected_right / scale, atol=1e-5 * np.abs(expected_right / scale).max())


def test_highlights_have_no_say_in_where_a_texture_lies():
    rows, step = rows_of(8, count=300, size=1e-3)
    spoilt = rows[0].value.copy()
    spoilt[::20] += 2.0
    rows[0] = rows[0]._replace(value=spoilt)
    matrix, right = np.zeros((COUNT + 3,) * 2), np.zeros(COUNT + 3)
    add_texture(rows, matrix, right)
    ridge = 1e-6 * np.diag(np.diag(matrix))  # the cameras' own angles together are every camera angle
    found = np.linalg.solve(matrix + ridge, right)
    free = [number for number in range(COUNT) if number != CAMERA]
    np.testing.assert_allclose(found[free], step[free], atol=2e-4)


def test_what_scatters_more_tells_less():
    def information(scatter):
        rows, _ = rows_of(9, count=400)
        rng = np.random.default_rng(10)
        rows = [row._replace(value=row.value + scatter * rng.normal(size=row.value.shape)) for row in rows]
        matrix = np.zeros((COUNT + 3,) * 2)
        add_texture(rows, matrix, np.zeros(COUNT + 3))
        return matrix[0, 0]

    assert information(0.1) / information(0.2) == pytest.approx(4.0, rel=0.02)
    assert information(0.0) == pytest.approx(information(0.001), rel=0.01)  # as little as 0.01


def test_textures_that_no_two_photographs_show_say_nothing():
    rows, _ = rows_of(11)
    apart = [row._replace(weight=np.where(np.arange(40) % 3 == view, 1.0, 0.0)) for view, row in enumerate(rows)]
    matrix, right = np.zeros((COUNT + 3,) * 2), np.zeros(COUNT + 3)
    add_texture(apart, matrix, right)
    assert not matrix.any() and not right.any()


@pytest.mark.parametrize("size_mm", [(60.0, 50.0), (130.0, 104.0)], ids=["outlines", "textures"])
def test_photographs_that_contradict_each_other_tell_less(tmp_path, size_mm):
    """Of the places in the picture; what none of them tells, the angle of the light, is as it was."""

    def told(by_mm):
        poses, files = [Pose(45.0, 0.0, 0.0, turn) for turn in (0.0, 180.0, 90.0)], []
        for number, pose in enumerate(poses):
            (folder := tmp_path / f"{by_mm}-{number}").mkdir()
            lies = correction(x_mm=by_mm * (1.0, -1.0, 0.0)[number], y_mm=by_mm * (-1.0, 0.0, 1.0)[number])
            contrast = 0.0 if size_mm == (60.0, 50.0) else 1.0
            files += drawn(folder, lies, [pose], [pose], size_mm, contrast=contrast)
        problem = _problem(files, PLATE if size_mm == (60.0, 50.0) else LARGE, SETUP, Placing())
        matrix = _descend(problem, 4.0, 6)
        _weigh(problem, matrix)
        return matrix, equations(problem, 4.0)[0], problem.sigma

    alike, contradicting = told(0.0), told(0.15)
    for matrix, found, sigma in (alike, contradicting):
        np.testing.assert_allclose(found[LIGHT], matrix[LIGHT], rtol=1e-9)
        assert matrix[LIGHT, LIGHT] == pytest.approx(1.0 / sigma[LIGHT] ** 2)
        np.testing.assert_allclose(found, found.T, rtol=1e-6, atol=1e-9)
        # The prior is left of what was typed, whatever photographs say.
        assert np.linalg.eigvalsh(found * np.outer(sigma, sigma)).min() > 0.9
    place = np.ix_([0, 1], [0, 1])
    shares = [
        np.linalg.eigvalsh(found[place]) / np.linalg.eigvalsh(matrix[place])
        for matrix, found, _ in (alike, contradicting)
    ]
    assert shares[0].min() > 0.9 and shares[1].min() < 0.7 and shares[1].max() < shares[0].max()


# What each photograph is off by.


def displaced(by, *, count=200, weight=0.8, slopes=None, only_this=0):
    """Textures of three photographs, of which the first lies beside the others, (2,) superpixels, and their means."""
    rng = np.random.default_rng(12)
    colour = rng.normal(size=(count, 3))
    slope = rng.normal(0.0, 0.1, (count, 3, 2)) if slopes is None else slopes
    change = np.concatenate([rng.normal(size=(count, 3, COUNT)), slope], axis=2)
    weights = [np.full(count, weight), rng.uniform(0.2, 1.0, count), rng.uniform(0.2, 1.0, count)]
    values = [colour - slope @ by, colour, colour]
    if only_this:
        values[0][:only_this] += 100.0
        for other in (1, 2):
            weights[other][:only_this] = 0.0
    rows = [TextureRows(w, v, change) for w, v in zip(weights, values, strict=True)]
    return rows[0], mean_texture(values, weights), np.sum(weights, axis=0)


@pytest.mark.parametrize("by", [(1.5, 0.0), (0.0, -0.7), (-0.4, 2.0)])
def test_a_photographs_texture_lies_beside_that_of_the_others(by):
    np.testing.assert_allclose(_shift(*displaced(by)), by, atol=1e-6)
    # What it shows alone is compared with nothing.
    np.testing.assert_allclose(_shift(*displaced(by, only_this=90)), by, atol=1e-6)
    row, mean, total = displaced(by)
    off = np.where(np.arange(200) % 10 == 0, 3.0, 0.0)[:, None]
    others = total - row.weight
    # The highlights of one photograph have their part in the mean of all.
    share = (row.weight / (row.weight + others))[:, None]
    found = _shift(row._replace(value=row.value + off), mean + share * off, total)
    np.testing.assert_allclose(found, by, atol=0.2)


def test_a_photograph_is_not_judged_by_a_texture_that_tells_too_little():
    flat = np.random.default_rng(17).normal(0.0, 1e-3, (200, 3, 2))
    striped = np.random.default_rng(13).normal(0.0, 0.1, (200, 3, 1)) * [1.0, 0.0]
    for one in (
        displaced((0.5, 0.0), slopes=flat),
        displaced((0.5, 0.0), slopes=striped),  # along the stripes nobody can tell
        displaced((0.5, 0.0), weight=0.25),  # of the directions of gloss
        displaced((0.5, 0.0), weight=0.0),
        displaced((0.5, 0.0), only_this=200),
    ):
        np.testing.assert_array_equal(_shift(*one), [math.nan, math.nan], strict=True)
    row, mean, total = displaced((0.5, 0.0), weight=0.4)
    # Texels that it does not show are none that it shows in gloss.
    half = row._replace(weight=np.where(np.arange(200) % 2, 0.4, 0.0))
    np.testing.assert_allclose(_shift(half, mean, total - row.weight + half.weight)[1], 0.0, atol=0.5)
    assert np.isfinite(_shift(half, mean, total - row.weight + half.weight)).all()


@pytest.mark.parametrize(
    "angle, named, by",
    [
        ("camera_deg", "camera_deg or tilt_deg", 2.0),
        ("tilt_deg", "camera_deg or tilt_deg", -1.5),
        ("turn_deg", "turn_deg", 2.5),
    ],
)
def test_the_angle_that_explains_a_photograph_best_is_named(angle, named, by):
    """Of the camera's angle and the tilt what is seen is their sum."""
    typed = Pose(45.0, 40.0, 20.0, 30.0)
    true = replace(typed, **{angle: getattr(typed, angle) + by})
    problem = problem_without_pictures(Plate(60.0, 50.0), [Pose(45.0, 0.0), typed])
    view, other = problem.views[1], View(true)
    rng = np.random.default_rng(14)
    view.rim = problem.texels.position[rng.integers(0, 480, 60)]
    direction = rng.uniform(0.0, 2.0 * math.pi, 60)
    view.outward = np.stack([np.cos(direction), np.sin(direction)], axis=1)
    here = problem.seen(1, view.rim, problem.unknowns)
    problem.views[1] = other
    there = problem.seen(1, view.rim, problem.unknowns)
    problem.views[1] = view
    found = rng.uniform(size=60) < 0.8
    distance = np.sum((there - here) * view.outward, axis=1)[found]
    name, off = _suspect(problem, 1, distance, found, np.full(2, np.nan))
    assert name == named and off == pytest.approx(by, rel=0.1) and view.pose == typed


def test_without_an_outline_the_angle_is_told_by_the_textures_shift():
    """A sphere high above the table: its tilt moves it across the picture as a whole."""
    pose = Pose(45.0, 0.0)
    problem = problem_without_pictures(Plate(60.0, 50.0), [pose])
    problem.unknowns[2] = 100.0
    middle = np.zeros((1, 3))
    moved = []
    for by in (0.0, 2.0):
        problem.views[0].pose = replace(pose, tilt_deg=by)
        moved.append(problem.seen(0, middle, problem.unknowns)[0])
    problem.views[0].pose = pose
    nothing = np.zeros(0), np.zeros(0, dtype=bool)
    name, off = _suspect(problem, 0, *nothing, moved[1] - moved[0])
    assert name == "camera_deg or tilt_deg" and off == pytest.approx(2.0, rel=0.05)
    assert _suspect(problem, 0, *nothing, np.full(2, np.nan))[1] == 0.0


@pytest.mark.parametrize("matrix", [[[0.0, -0.04], [0.04, 0.0]], [[0.02, 0.0], [0.0, -0.05]], [[0.0, 0.0], [0.0, 0.0]]])
def test_the_displacement_of_an_outline_is_that_as_a_whole_whatever_single_points_say(matrix):
    turn = np.linspace(0.0, 2.0 * math.pi, 121)[:-1]
    outward = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    xy = [300.0, 200.0] + outward * [60.0, 40.0]
    # It is turned or stretched about its middle, and moved.
    distance = np.sum(((xy - [300.0, 200.0]) @ np.transpose(matrix) + [0.8, -0.3]) * outward, axis=1)
    expected = math.sqrt(np.mean(distance**2))
    assert _displacement(xy, outward, distance) == pytest.approx(expected, rel=1e-4)
    spoilt = distance.copy()
    spoilt[10:20] = 7.0  # another edge
    assert _displacement(xy, outward, spoilt) == pytest.approx(expected, rel=0.05)


def test_an_outline_whose_points_disagree_says_nothing_of_its_photograph():
    """As before shadows, or paints beside the outline: of a third strays are left out, of half nothing is judged."""
    rng, turn = np.random.default_rng(11), 2.0 * math.pi * np.arange(120) / 120.0
    outward = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    xy, distance = 40.0 * outward, outward @ [2.0, -1.0] + rng.normal(0.0, 0.05, 120)
    strays = rng.permutation(120)
    for count in (40, 60):
        spoilt = distance.copy()
        spoilt[strays[:count]] = rng.uniform(-6.0, 6.0, count)
        found = _displacement(xy, outward, spoilt)
        assert math.isnan(found) if count == 60 else found == pytest.approx(math.sqrt(2.5), rel=0.1)


def test_a_photographs_residual_is_how_far_it_shows_the_object_from_the_others(tmp_path):
    # The third was taken where the plate lay elsewhere: turned in the picture by 90 degrees, as the table is.
    poses = [Pose(45.0, 0.0), Pose(45.0, 0.0, 0.0, 180.0), Pose(45.0, 0.0, 0.0, 90.0)]
    files = drawn(tmp_path, Correction(), poses, poses, contrast=0.0)
    (tmp_path / "moved").mkdir()
    moved = drawn(tmp_path / "moved", correction(x_mm=3.0), poses[2:], poses[2:], contrast=0.0)
    problem = prepared(_problem([*files[:2], *moved], PLATE, SETUP, Placing()))
    residual, points, _ = pose_residuals(problem, 10.0)
    assert (points > 100).all()
    np.testing.assert_allclose(residual[:2], 0.0, atol=0.02)
    # Of the sides across its way all points are off by 3 mm, of those along it none.
    view = problem.views[2]
    across = np.abs(view.outward @ [0.0, 1.0])
    assert residual[2] == pytest.approx(3.0 / MM_PER_PX * math.sqrt(np.mean(across**2)), rel=0.2)


def silhouette(folder, name, centre_mm):
    """An evenly bright sphere of 20 mm whose centre lies elsewhere, seen from above."""
    grid = np.stack(np.meshgrid(np.arange(160.0), np.arange(120.0)), axis=-1)
    middle = SMALL.project(np.array(centre_mm), np.array([0.0, 0.0, 900.0]), rig_from_camera(Pose(45.0, 0.0)))
    radius = 20.0 / math.sqrt(900.0**2 - 20.0**2) * 1200.0
    shown = np.clip(radius - np.linalg.norm(grid - middle, axis=-1) + 0.5, 0.0, 1.0)
    return linear_file(folder / name, 0.5 * np.repeat(shown[..., None], 3, axis=2), pose=(45.0, 0.0, 0.0, 0.0))


def test_a_round_object_is_judged_by_its_outline_alone(tmp_path):
    ball = TexturedObject.of({"shape": {"kind": "sphere", "radius_mm": 20.0}, "texels": {"width": 48, "height": 24}})
    files = [silhouette(tmp_path, f"{n}.h5", at) for n, at in enumerate([(0, 0, 0), (0, 0, 0), (3.0, 0, 0)])]
    problem = prepared(_problem(files, ball, SETUP, Placing()))
    residual, points, suspects = pose_residuals(problem, 10.0)
    # A disc is no matt ball with gloss: it is found almost, not quite, where it is.
    assert (points > 50).all() and residual[:2].max() < 0.06
    # Only the lit part of the outline counts, which lies along the way.
    across = problem.views[2].outward @ [1.0, 0.0]
    assert residual[2] == pytest.approx(3.0 / MM_PER_PX * math.sqrt(np.mean(across**2)), rel=0.05)
    assert suspects[2][0] in ("camera_deg or tilt_deg", "turn_deg")
    # Where any paint could lie just inside the outline, it judges nobody.
    for view in problem.views:
        view.inner = view.inner._replace(unsure=np.full(view.inner.light.shape, 2.0))
    residual, points, _ = pose_residuals(problem, 10.0)
    assert (points > 50).all() and np.isnan(residual).all()


def test_a_photograph_that_shows_the_object_beyond_what_was_searched_is_named_all_the_same(tmp_path):
    (tmp_path / "moved").mkdir()
    poses = [Pose(45.0, 0.0), Pose(45.0, 0.0, 0.0, 90.0), Pose(45.0, 0.0, 0.0, 180.0), Pose(45.0, 0.0)]
    files = drawn(tmp_path, Correction(), poses[:3], poses[:3], contrast=0.0)
    moved = drawn(tmp_path / "moved", correction(x_mm=4.5), poses[3:], poses[3:], contrast=0.0)
    sure = {name: 0.02 for name in vars(Placing()) if name != "max_residual_px"}
    found = register([*files, *moved], PLATE, SETUP, Placing(**sure))
    # Six superpixels, where four were searched; two of the four sides lie across the way.
    assert found.residual_px[3] == pytest.approx(6.0 * math.sqrt(0.5), rel=0.2)
    assert found.residual_px[:3].max() < 0.1 and found.correction.values == (0.0,) * COUNT


def test_of_a_texture_without_outline_the_residual_is_its_shift(tmp_path):
    poses = [Pose(45.0, 0.0), Pose(45.0, 0.0, 0.0, 180.0), Pose(45.0, 0.0)]
    (tmp_path / "moved").mkdir()
    files = drawn(tmp_path, Correction(), poses, poses, (130.0, 104.0))
    moved = drawn(tmp_path / "moved", correction(x_mm=0.6, y_mm=0.3), poses[2:], poses[2:], (130.0, 104.0))
    problem = prepared(_problem([*files[:2], *moved], LARGE, SETUP, Placing()), blur=1.5)
    residual, points, suspects = pose_residuals(problem, 10.0)
    assert not points.any()
    assert residual[2] == pytest.approx(math.hypot(0.6, 0.3) / MM_PER_PX, rel=0.1)
    assert residual[:2].max() < 0.6 * residual[2] and len(suspects) == 3


@pytest.mark.parametrize("scale", [1.0, 0.25])
def test_an_outline_is_clearer_elsewhere_by_a_twentieth_a_few_samples_beside_it(scale):
    """A disc, in pictures of full and of a quarter of the resolution: the outline of 40 superpixels is expected."""
    around = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    outward = np.stack([np.cos(around), np.sin(around)], axis=1)
    view = problem_without_pictures(Plate(60.0, 50.0), [Pose(45.0, 0.0)]).views[0]
    x, y = np.meshgrid(*(np.arange(int(200 * scale)),) * 2)
    place = np.stack([x, y], axis=-1) / scale + 0.5 / scale - 0.5
    xy = 100.0 + 40.0 * outward
    for radius, is_clearer in ((40.0, False), (52.0, True)):
        level = np.where(np.hypot(*np.moveaxis(place - 100.0, -1, 0)) < radius, 0.6, 0.1)
        view.picture = picture(np.repeat(level[..., None], 3, axis=2), scale=scale)
        assert _is_clearer(view, xy, outward, np.full(200, 12.0)) == is_clearer
        assert not _is_clearer(view, xy, outward, np.where(np.arange(200) % 2, 12.0, -30.0))
    # Brightness is read one and a half samples beside an outline: a ring that is narrower than that is not seen.
    distance = np.hypot(*np.moveaxis(place - 100.0, -1, 0))
    level = np.where(np.abs(distance - 52.0) < 0.7 / scale, 0.6, 0.1)
    view.picture = picture(np.repeat(level[..., None], 3, axis=2), scale=scale)
    assert not _is_clearer(view, xy, outward, np.full(200, 12.0 - 4.0 / scale))


def test_points_of_an_outline_share_their_doubt_with_a_side_and_with_photographs_under_the_same_angles():
    poses = [Pose(45.0, 10.0), Pose(45.0, 10.0, 0.0, 90.0), Pose(60.0, 20.0)]
    problem = problem_without_pictures(Plate(60.0, 50.0), poses)
    for count in (3, 40):
        doubt = np.linspace(0.0, 0.8, count)
        outline = Outline(np.zeros(count), doubt, np.zeros((count, COUNT)), np.ones(count, dtype=bool))
        for number, alike in ((0, 2), (1, 2), (2, 1)):
            found = outline_variance(problem, number, outline, 0.3)
            # Five neighbouring points err as one; four sides of an object err each by itself.
            expected = 5.0 * 0.3 * 0.3 + doubt * doubt * max(1.0, count / 4.0) * alike
            np.testing.assert_allclose(found, expected, rtol=1e-12)
