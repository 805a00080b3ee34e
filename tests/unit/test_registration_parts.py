"""Parts of the registration of objects, each against what can be written down."""

import math
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from irodori.config.capture_table import Pose
from irodori.config.models import Placing
from irodori.config.parts import TexturedObject
from irodori.core import store
from irodori.core.errors import InputError
from irodori.core.units import require_unit
from irodori.geometry.embree import Tracer
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.rig_frame import (
    rig_from_camera,
    rig_from_object,
    rotation_x,
    rotation_y,
    rotation_z,
    to_camera,
    to_light,
)
from irodori.geometry.shapes.placement import on_table
from irodori.geometry.shapes.plate import Plate
from irodori.geometry.shapes.sphere import Sphere
from irodori.rectification import reduced_pictures
from irodori.rectification.object_registration import (
    Registered,
    _inverse,
    _only_what_is_told,
    _refuse_far,
    _robust,
    _solve,
    in_words,
    register,
    register_object,
)
from irodori.rectification.outline_search import edge_distances, find_rim
from irodori.rectification.placement_correction import COUNT, QUANTITIES, Correction, prior_sigma
from irodori.rectification.reduced_pictures import Picture
from irodori.rectification.stage import RigSetup
from irodori.rectification.texture_agreement import (
    blocks,
    matt_weight,
    mean_texture,
    picture_slope,
    texel_values,
    texture_rows,
    without_levels,
)

PINHOLE = Pinhole(10_000.0, (400.0, 300.0), 800, 600)
NAMES = [quantity.name for quantity in QUANTITIES]


def correction(**values) -> Correction:
    return Correction.of([values.get(name, 0.0) for name in NAMES])


def picture(response, *, valid=None, scale=1.0, corner=(0.0, 0.0), noise=(1e-6, 0.0)) -> Picture:
    response = np.asarray(response, np.float32)
    valid = np.ones(response.shape[:2], np.float32) if valid is None else np.asarray(valid, np.float32)
    return Picture("p.h5", Pose(45.0, 0.0), response, valid, scale, np.array(corner), np.array(noise))


def linear_file(path, response, valid=None, sample_px=2, pose=(45.0, 10.0, 5.0, 90.0)):
    height, width, bands = response.shape
    valid = np.ones((height, width), np.uint8) if valid is None else valid
    with store.create(path, store.Provenance("test")) as out:
        out.write("response", response.astype("f4"), units="1", dims="row,column,band", quantity="response")
        out.write("valid", valid, units="1", dims="row,column", quantity="valid")
        noise = np.stack([np.array([1e-4, 1e-3]) * (band + 1) for band in range(bands)])
        out.write("noise_model", noise, units="1", dims="band,term", quantity="noise")
        out.attribute("sample_px", sample_px)
        out.attribute("pose_deg", list(pose))
    return path


# Corrections.


def test_a_correction_adds_each_of_its_numbers_to_what_was_typed():
    found = correction(
        x_mm=1.0, y_mm=2.0, z_mm=3.0, camera_distance_mm=-7.0, focal_length_percent=2.0, principal_x_px=4.0,
        principal_y_px=-5.0, camera_deg=0.25, light_deg=-0.5,
    )  # fmt: skip
    assert found.translation_mm.tolist() == [1.0, 2.0, 3.0]
    assert found.camera_distance_mm(900.0) == 893.0
    camera = found.pinhole(PINHOLE)
    assert camera.focal_px == pytest.approx(10_200.0) and camera.centre_px == (404.0, 295.0)
    assert (camera.width_px, camera.height_px) == (800, 600)
    assert found.pose(Pose(45.0, 10.0, 5.0, 90.0), 0.5) == Pose(44.5, 10.75, 5.0, 90.0)
    assert found.pose(Pose(45.0, 10.0)) == Pose(44.5, 10.25)


@pytest.mark.parametrize("pose", [Pose(45.0, 0.0), Pose(45.0, 0.0, 20.0, 70.0)])
def test_an_object_is_turned_about_its_origin_and_moved_along_the_tables_axes(pose):
    found = correction(x_mm=1.0, y_mm=2.0, z_mm=3.0, about_x_deg=4.0, about_y_deg=5.0, about_z_deg=6.0)
    lain, table = found.placements(Sphere(30.0), pose, 25.0)
    typed, top = on_table(Sphere(30.0), rig_from_object(pose), 25.0)
    point, x, y, z = np.array([10.0, -20.0, 5.0]), *(math.radians(angle) for angle in (4.0, 5.0, 6.0))
    turned = rotation_z(z) @ rotation_y(y) @ rotation_x(x) @ point
    np.testing.assert_allclose(lain.points(point), rig_from_object(pose) @ (turned + found.translation_mm), atol=1e-12)
    # The table goes up and down with the object, and nowhere else.
    np.testing.assert_allclose(table.translation_mm - top.translation_mm, 3.0 * rig_from_object(pose)[:, 2], atol=1e-12)
    np.testing.assert_array_equal(table.rotation, typed.rotation)
    assert len(found.placements(Sphere(30.0), pose, 0.0)) == 1


def test_priors_stand_in_the_order_of_the_numbers():
    placing = Placing(
        translation_mm=1.0, rotation_deg=2.0, camera_distance_mm=3.0, focal_length_percent=4.0, principal_point_px=5.0,
        camera_deg=6.0, light_deg=7.0,
    )  # fmt: skip
    expected = {"x_mm": 1, "y_mm": 1, "z_mm": 1, "about_x_deg": 2, "about_y_deg": 2, "about_z_deg": 2}
    expected |= {"camera_distance_mm": 3, "focal_length_percent": 4, "principal_x_px": 5, "principal_y_px": 5}
    expected |= {"camera_deg": 6, "light_deg": 7}
    assert dict(zip(NAMES, prior_sigma(placing), strict=True)) == expected


# Pictures.


def test_a_picture_is_read_as_far_as_a_window_shows_it(tmp_path):
    response = np.random.default_rng(1).uniform(0.1, 1.0, (40, 60, 6))
    valid = np.ones((40, 60), np.uint8)
    valid[12, 20] = 0
    path = linear_file(tmp_path / "one.h5", response, valid)
    whole, part = Picture.load(path), Picture.load(path, (10.2, 5.7, 30.4, 25.0))
    assert whole.response.shape == (40, 60, 3) and whole.scale == 1.0 and whole.pose == Pose(45.0, 10.0, 5.0, 90.0)
    np.testing.assert_allclose(whole.noise, [2e-4, 2e-3])  # of the green band
    assert whole.response[12, 20].max() == 0.0 and whole.valid.sum() == 40 * 60 - 1
    assert part.corner.tolist() == [10.0, 5.0]
    np.testing.assert_array_equal(part.response, whole.response[5:26, 10:32])
    for xy in ([15.0, 12.0], [20.5, 7.25]):
        seen = [one.level(0.0).sampled(one.level(0.0).bands, one.place(np.array([xy]))) for one in (whole, part)]
        np.testing.assert_allclose(*seen, rtol=1e-6)


def test_a_place_at_full_resolution_is_that_of_the_same_mosaic_pixel(tmp_path):
    path = linear_file(tmp_path / "one.h5", np.ones((40, 60, 3)), sample_px=1)
    # The middle of superpixel 3 lies between its two mosaic pixels, 6 and 7.
    assert Picture.load(path).scale == 2.0
    np.testing.assert_allclose(Picture.load(path).place(np.array([3.0, 5.0])), [6.5, 10.5])


def test_a_large_picture_is_binned_over_what_is_valid(tmp_path, monkeypatch):
    monkeypatch.setattr(reduced_pictures, "_MOST", 20)
    response = np.arange(40 * 60 * 3, dtype=float).reshape(40, 60, 3)
    valid = np.ones((40, 60), np.uint8)
    valid[0, 0], valid[3:6, 3:5] = 0, 0
    path = linear_file(tmp_path / "one.h5", response, valid)
    found = Picture.load(path)
    assert found.response.shape == (13, 20, 3) and found.scale == pytest.approx(1.0 / 3.0)
    np.testing.assert_allclose(found.noise, np.array([2e-4, 2e-3]) / 9.0)
    np.testing.assert_allclose(found.response[5, 7], response[15:18, 21:24].mean(axis=(0, 1)), rtol=1e-5)
    corner = response[:3, :3].reshape(9, 3)[1:].mean(axis=0)
    np.testing.assert_allclose(found.response[0, 0], corner, rtol=1e-5)
    assert found.valid[0, 0] == 1.0 and found.valid[1, 1] == 0.0  # three of nine are measured
    np.testing.assert_allclose(found.place(np.array([1.0, 1.0])), [0.0, 0.0], atol=1e-12)


def test_blur_keeps_what_is_even_beside_what_is_not_valid():
    response, valid = np.full((30, 30, 2), 0.4), np.ones((30, 30))
    valid[9:14, 9:14] = 0.0
    level = picture(response * valid[..., None], valid=valid).level(1.5)
    np.testing.assert_allclose(level.bands[:, 20:, 20:], 0.4, rtol=1e-5)
    np.testing.assert_allclose(level.bands[:, 8, 8], 0.4, rtol=1e-5)
    assert level.valid[11, 11] == 0.0 and level.valid[20, 20] == 1.0
    assert np.isnan(level.sampled(level.bands, np.array([[11.0, 11.0], [-1.0, 5.0]]))).all()
    ramp = picture(np.tile(np.arange(30.0)[None, :, None], (30, 1, 1)))
    np.testing.assert_allclose(ramp.level(0.0).sampled(ramp.level(0.0).bands, np.array([[4.25, 9.0]])), [[4.25]])


# Outlines.


def edge(at, inner=0.5, outer=0.02, sharpness=0.8, size=80):
    """A picture, bright to the left of a column and dark to the right of it, and blurred a little."""
    x = np.arange(size) - at
    step = 0.5 * (1.0 - np.vectorize(math.erf)(x / (sharpness * math.sqrt(2.0))))
    return np.tile((outer + (inner - outer) * step)[None, :, None], (size, 1, 3))


@pytest.mark.parametrize("scale", [1.0, 2.0])
@pytest.mark.parametrize("inner, outer", [(0.5, 0.02), (0.02, 0.5), (0.05, 0.0)])
def test_an_edge_is_found_where_it_is_whatever_its_height(scale, inner, outer):
    seen = picture(edge(41.3, inner, outer), scale=scale)
    y = np.array([30.0, 35.0, 40.0])
    samples = np.stack([np.full(3, 40.0), y], axis=1)  # expected 1.3 samples before the edge
    xy = (samples + 0.5) / scale - 0.5
    out = np.tile([1.0, 0.0], (3, 1))
    np.testing.assert_allclose(edge_distances(seen, seen.level(0.0), xy, out, 4.0), 1.3 / scale, atol=0.02)
    np.testing.assert_allclose(edge_distances(seen, seen.level(0.0), xy, -out, 4.0), -1.3 / scale, atol=0.02)


@pytest.mark.parametrize("sharpness, within", [(0.5, 0.01), (0.8, 0.02), (1.2, 0.12)])
def test_blur_moves_no_edge_outward(sharpness, within):
    """Read where the ratio of both sides is greatest, on the dark side, they were found up to 0.9 samples outward."""
    xy, out = np.array([[40.0, 40.0]]), np.array([[1.0, 0.0]])
    for at in np.arange(39.0, 42.0, 0.23):
        seen = picture(edge(at, 0.5, 0.02, sharpness))
        for sign in (1.0, -1.0):
            found = sign * edge_distances(seen, seen.level(0.0), xy, sign * out, 4.0)[0]
            assert abs(found - (at - 40.0)) < within


def test_no_edge_is_found_where_none_stands_out():
    xy, out = np.array([[40.0, 40.0]]), np.array([[1.0, 0.0]])
    for response, noise in (
        (np.full((80, 80, 3), 0.5), (1e-6, 0.0)),
        (edge(41.0, 0.5, 0.45), (1e-6, 0.0)),  # too low a step
        (edge(41.0, 0.10, 0.04), (4e-4, 0.0)),  # less than six standard deviations
        (edge(41.0, 0.10, 0.04), (0.0, 4e-3)),
        (edge(41.0, 0.10, 0.04), (math.nan, math.nan)),  # of which nothing is known
        (edge(55.0), (1e-6, 0.0)),  # out of reach
    ):
        seen = picture(response, noise=noise)
        assert np.isnan(edge_distances(seen, seen.level(0.0), xy, out, 4.0)).all()


def test_of_two_edges_the_greater_step_is_taken():
    response = edge(36.0, 0.5, 0.2) * edge(47.0, 1.0, 0.02)
    seen = picture(response)
    xy, out = np.array([[40.0, 40.0]]), np.array([[1.0, 0.0]])
    np.testing.assert_allclose(edge_distances(seen, seen.level(0.0), xy, out, 8.0), 7.0, atol=0.1)


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (4.0, -3.0, 2.0)])
def test_the_outline_of_a_sphere_is_where_rays_graze_it(at):
    pose, radius = Pose(45.0, 20.0), 30.0
    placed = correction(x_mm=at[0], y_mm=at[1], z_mm=at[2]).placements(Sphere(radius), pose, 0.0)
    eye, axes = 900.0 * to_camera(pose), rig_from_camera(pose)
    xy = PINHOLE.project(np.array(at), eye, axes)
    window = (*(xy - 175.0), *(xy + 175.0))
    rim = find_rim(Tracer(placed), PINHOLE, eye, axes, window)
    assert len(rim.point) > 100
    world = rim.point + at
    to_eye = eye - world
    to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)
    np.testing.assert_allclose(np.linalg.norm(rim.point, axis=1), radius, rtol=2e-3)
    assert np.abs(np.sum(to_eye * rim.point / radius, axis=1)).max() < 0.02
    radial = PINHOLE.project(world, eye, axes) - xy
    radial /= np.linalg.norm(radial, axis=1, keepdims=True)
    assert np.sum(radial * rim.outward, axis=1).min() > 0.995
    np.testing.assert_allclose(np.linalg.norm(rim.outward, axis=1), 1.0, rtol=1e-6)


def test_the_outline_of_a_plate_is_its_four_sides_without_the_corners():
    pose = Pose(45.0, 0.0)
    placed = Correction().placements(Plate(50.0, 30.0), pose, 0.0)
    eye, axes = 900.0 * to_camera(pose), rig_from_camera(pose)
    middle = PINHOLE.project(np.zeros(3), eye, axes)
    half = np.array([25.0, 15.0]) * PINHOLE.focal_px / 900.0 / 2.0
    rim = find_rim(Tracer(placed), PINHOLE, eye, axes, (*(middle - half), *(middle + half)))
    x, y = np.abs(rim.point[:, 0]) / 25.0, np.abs(rim.point[:, 1]) / 15.0
    np.testing.assert_allclose(np.maximum(x, y), 1.0, atol=3e-3)
    assert np.minimum(x, y).max() < 1.0 and {(x > y).all(), (x < y).all()} == {False}
    out = np.where((x > y)[:, None], [[1.0, 0.0]], [[0.0, 1.0]])
    np.testing.assert_allclose(np.abs(rim.outward), out, atol=0.02)
    seen = PINHOLE.project(rim.point, eye, axes) - middle
    assert (np.sum(seen * rim.outward, axis=1) > 0).all()


def test_what_is_not_in_the_window_has_no_outline():
    pose = Pose(45.0, 0.0)
    eye, axes = 900.0 * to_camera(pose), rig_from_camera(pose)
    rim = find_rim(Tracer(Correction().placements(Sphere(5.0), pose, 0.0)), PINHOLE, eye, axes, (0.0, 0.0, 20.0, 20.0))
    assert rim.point.shape == (0, 3) and rim.outward.shape == (0, 2)


# Textures.


def test_gloss_directions_have_no_say():
    assert matt_weight(np.array([0.0, 0.175, 0.35, 1.0])).tolist() == pytest.approx([0.0, 0.25, 1.0, 1.0])


def test_blocks_are_squares_of_texels_that_grow_with_the_blur():
    found = blocks(20, 12, 2.0, 1.5).reshape(12, 20)  # 8 x 1.5 / 2 texels
    np.testing.assert_array_equal(np.unique(found[:6, :6]), found[0, 0])
    assert len({found[0, 0], found[0, 6], found[6, 0], found[6, 6]}) == 4
    assert len(np.unique(blocks(20, 12, 2.0, 100.0))) == 1 and len(np.unique(blocks(20, 10, 2.0, 0.1))) == 8


def test_the_slope_over_a_picture_is_that_of_a_plane():
    row, column = np.mgrid[:8, :9].astype(float)
    place = np.stack([3.0 * column + 0.5 * row, -0.4 * column + 2.0 * row + 7.0], axis=-1)
    values = (2.0 * place[..., 0] - 0.5 * place[..., 1])[..., None] * [1.0, -3.0]
    slope = picture_slope(values, place)
    np.testing.assert_allclose(slope, np.broadcast_to([[2.0, -0.5], [-6.0, 1.5]], slope.shape), rtol=1e-9)
    values[4, 4] = np.nan
    assert (picture_slope(values, place)[4, 3] == 0.0).all()


def test_a_texels_value_is_the_logarithm_of_what_it_reflects():
    seen = picture(np.full((9, 9, 3), 0.3))
    place, shading = np.array([[4.0, 4.0], [4.0, 4.0], [40.0, 4.0]]), np.array([0.5, np.nan, 0.5])
    found = texel_values(seen, seen.level(0.0), place, shading)
    np.testing.assert_allclose(found[0], math.log(0.6 + 0.01), rtol=1e-6)
    assert np.isnan(found[1:]).all()


def test_levels_of_photographs_drop_out_and_the_texture_stays():
    rng = np.random.default_rng(5)
    colour, block = rng.normal(0.0, 1.0, (60, 2)), np.repeat([0, 1, 2], 20)
    level = rng.normal(0.0, 0.5, (3, 3, 2))
    weights = [np.where(rng.uniform(size=60) < 0.8, rng.uniform(0.2, 1.0, 60), 0.0) for _ in range(3)]
    values = [np.where(w[:, None] > 0, colour + level[n][block], np.nan) for n, w in enumerate(weights)]
    without = without_levels(values, weights, block)
    for a in range(3):
        for b in range(a):
            both = (weights[a] > 0) & (weights[b] > 0)
            np.testing.assert_allclose(without[a][both], without[b][both], atol=0.02)
    mean = mean_texture(without, weights)
    unseen = np.sum(weights, axis=0) == 0
    assert np.isnan(mean[unseen]).all() and np.isfinite(mean[~unseen]).all()
    for one in range(3):
        seen = (block == one) & ~unseen
        np.testing.assert_allclose(np.ptp(mean[seen] - colour[seen], axis=0), 0.0, atol=0.03)


def test_a_texture_that_moves_as_a_whole_block_says_nothing_of_its_level():
    block, weight = np.array([0] * 5 + [1] * 2), np.array([1.0, 0.5, 0.25, 1.0, 0.0, 1.0, 1.0])
    slope = np.arange(14.0).reshape(7, 1, 2)
    moved = np.broadcast_to(np.eye(2), (7, 2, 2))
    rows = texture_rows(np.ones((7, 1)), slope, moved, weight, block)
    np.testing.assert_allclose((weight[:4, None, None] * rows.change[:4]).sum(axis=0), 0.0, atol=1e-12)
    difference = rows.change[1] - rows.change[0]
    np.testing.assert_allclose(difference, slope[1] - slope[0], rtol=1e-12)
    assert (rows.change[4] == 0.0).all()
    np.testing.assert_array_equal(rows.weight, [1.0, 0.5, 0.25, 1.0, 0.0, 0.0, 0.0])  # a block of two says nothing


# What is told.


def information(errors, *, between=None):
    """The normal equations' matrix of 12 numbers whose standard errors are given, two of them told as a sum alone."""
    matrix = np.diag(1.0 / np.array(errors) ** 2)
    if between is not None:
        a, b, strong = between
        matrix[np.ix_([a, b], [a, b])] += strong
    return matrix


def test_the_step_and_the_covariance_leave_out_what_has_no_room():
    rng = np.random.default_rng(2)
    root = rng.normal(size=(4, 4))
    matrix, right, sigma = root @ root.T + np.eye(4), rng.normal(size=4), np.array([2.0, 0.0, 1.0, 0.5])
    free = [0, 2, 3]
    step, covariance = _solve(matrix, right, sigma), _inverse(matrix, sigma)
    np.testing.assert_allclose(step[free], np.linalg.solve(matrix[np.ix_(free, free)], right[free]), rtol=1e-9)
    np.testing.assert_allclose(covariance[np.ix_(free, free)], np.linalg.inv(matrix[np.ix_(free, free)]), rtol=1e-9)
    assert step[1] == 0.0 and (covariance[1] == 0.0).all() and (covariance[:, 1] == 0.0).all()


def test_what_is_not_told_and_what_is_nothing_goes_back_to_what_was_typed():
    sigma, values, errors = np.full(COUNT, 2.0), np.zeros(COUNT), np.full(COUNT, 0.02)
    values[:6] = [1.0, 1.0, 0.03, 0.3, 0.11, 0.08]
    errors[1], errors[4], errors[5] = 1.5, 0.1, 0.02  # not told; within two errors; told, and more than 0.05 degrees
    found, room = _only_what_is_told(values, information(errors), sigma)
    assert found[[0, 3, 5]].tolist() == pytest.approx([1.0, 0.3, 0.08])
    assert (found[[1, 2, 4]] == 0.0).all() and (found[6:] == 0.0).all()
    np.testing.assert_array_equal(room > 0, [True, False, False, True, False, True, *[False] * 6])


def test_of_two_that_are_told_as_a_sum_one_takes_all_of_it():
    sigma, values, errors = np.full(COUNT, 10.0), np.zeros(COUNT), np.full(COUNT, 10.0)
    values[0], values[3] = 1.0, 2.0
    found, _ = _only_what_is_told(values, information(errors, between=(0, 3, 1e4)), sigma)
    assert sorted(found[[0, 3]]) == pytest.approx([0.0, 3.0], abs=1e-3) and np.count_nonzero(found) == 1


def test_outliers_lose_their_weight():
    values = np.array([0.01, -0.02, 0.015, -0.01, 5.0])
    weight, scale = _robust(values, 0.001)
    assert scale == pytest.approx(1.4826 * 0.015) and weight[-1] < 1e-4 and weight[:4].min() > 0.8
    assert _robust(values, 0.1)[1] == 0.1 and _robust(values, 0.001, 0.01)[1] == 0.01
    assert _robust(np.zeros(0), 0.3)[1] == 0.3


# Words.


def registered(values, sigma, residual=(0.1, 0.2), suspects=(("", 0.0), ("", 0.0))) -> Registered:
    prior = np.full(COUNT, 2.0)
    return Registered(
        Correction.of(values), np.diag(np.array(sigma) ** 2), prior, np.zeros(2), np.array(residual), 0.2,
        np.array([10, 20]), suspects,
    )  # fmt: skip


def test_a_sentence_says_what_is_told_what_is_as_typed_and_what_is_not_told():
    values, sigma = np.zeros(COUNT), np.full(COUNT, 1.9)
    values[0], sigma[:2] = 1.25, 0.02
    assert in_words(registered(values, sigma)) == (
        "beside what was typed, the photographs tell: object along the table's x +1.25 ± 0.02 mm; "
        "as typed, as far as can be told: object along the table's y; "
        f"not told, so that it stays as typed: {', '.join(quantity.text for quantity in QUANTITIES[2:])}"
    )
    nothing = in_words(registered(np.zeros(COUNT), np.full(COUNT, 0.1)))
    assert (
        nothing.startswith("beside what was typed, the photographs tell: nothing; as typed")
        and "not told" not in nothing
    )


def test_the_photograph_that_is_furthest_off_is_refused():
    found = registered(np.zeros(COUNT), np.full(COUNT, 0.1), (0.5, 3.0), (("", 0.0), ("tilt_deg", -1.5)))
    said = r"b\.h5: pose_deg.*3 superpixels \(0\.6 mm\).*likeliest is tilt_deg off by -1\.5.*at most 1 superpixels"
    with pytest.raises(InputError, match=said):
        _refuse_far(found, ["a.h5", "b.h5"], 1.0)
    _refuse_far(found, ["a.h5", "b.h5"], 3.0)
    _refuse_far(registered(np.zeros(COUNT), np.ones(COUNT), (math.nan, math.nan)), ["a.h5", "b.h5"], 1.0)


# All of it, on a plate whose pictures are drawn by hand.

SMALL = Pinhole(2_400.0, (160.0, 120.0), 320, 240)
SETUP = RigSetup(SMALL, 900.0, 0.0)
VIEWS = [Pose(45.0, 0.0), Pose(60.0, 20.0), Pose(45.0, 10.0, 0.0, 90.0), Pose(50.0, 30.0, 0.0, 180.0)]
PLATE = TexturedObject.of(
    {"shape": {"kind": "plate", "width_mm": 60.0, "height_mm": 50.0}, "texels": {"width": 24, "height": 20}}
)


def drawn(folder, lies, shown=VIEWS, stated=VIEWS):
    """Linear files of a matt plate of even checks, seen by rays through four points of every superpixel."""
    files = []
    for number, (pose, said) in enumerate(zip(shown, stated, strict=True)):
        real = lies.pose(pose)
        placed = lies.placements(Plate(60.0, 50.0), real, 0.0)[0]
        way = SETUP.corrected(lies)
        eye, total = way.camera_distance_mm * to_camera(real), 0.0
        for dx, dy in ((0.5, 0.5), (0.5, 1.5), (1.5, 0.5), (1.5, 1.5)):
            x, y = np.meshgrid(np.arange(0, 320, 2) + dx, np.arange(0, 240, 2) + dy)
            rays = way.pinhole.directions(np.stack([x, y], axis=-1), rig_from_camera(real)) @ placed.rotation
            start = (eye - placed.translation_mm) @ placed.rotation
            at = start + (-start[2] / rays[..., 2])[..., None] * rays
            u, v = at[..., 0] / 60.0 + 0.5, at[..., 1] / 50.0 + 0.5
            on = (u > 0) & (u < 1) & (v > 0) & (v < 1)
            red, green = 0.35 + 0.2 * np.sin(9.0 * u + 4.0 * v), 0.4 + 0.25 * np.cos(11.0 * v - 3.0 * u)
            colour = np.stack([red, green, 0.5 * u + 0.2], axis=-1)
            total = total + 0.25 * np.where(on[..., None], colour, 0.0)
        cosine = (placed.rotation[:, 2] @ to_light(real)).item()
        files.append(linear_file(folder / f"{number}.h5", total * cosine, pose=vars(said).values()))
    return files


@pytest.mark.parametrize("lies", [(0.0,) * 6, (1.2, -0.9, 0.0, 0.0, 0.0, 1.5), (-0.8, 1.0, 0.0, 1.2, -1.0, -1.0)])
def test_a_drawn_plate_is_found_where_it_lies(tmp_path, lies):
    found = register(drawn(tmp_path, Correction.of([*lies, *[0.0] * 6])), PLATE, SETUP, Placing())
    # A superpixel is three quarters of a millimetre here.
    np.testing.assert_allclose(found.correction.values[:2], lies[:2], atol=0.1)
    np.testing.assert_allclose(found.correction.values[3:6], lies[3:], atol=0.5)
    assert (found.outline_points > 20).all() and np.nanmax(found.residual_px) < 0.2
    assert found.mm_per_px == pytest.approx(0.75, rel=0.02) and found.prior.tolist() == prior_sigma(Placing()).tolist()


def test_a_drawn_plate_turned_in_one_photograph_is_refused_for_its_turn(tmp_path):
    shown = [*VIEWS[:3], replace(VIEWS[3], turn_deg=184.0)]
    files = drawn(tmp_path, Correction(), shown)
    with pytest.raises(InputError, match=r"3\.h5: pose_deg.*turn_deg off by \+[345]\."):
        register_object(files, PLATE, SETUP, Placing(), output=tmp_path / "out.h5", provenance=store.Provenance("test"))
    assert not (tmp_path / "out.h5").exists()


def test_the_file_says_how_far_each_photograph_is_off(tmp_path):
    shown, placing = [*VIEWS[:3], replace(VIEWS[3], turn_deg=184.0)], Placing(max_residual_px=100.0)
    output = tmp_path / "out.h5"
    register_object(
        drawn(tmp_path, Correction(), shown), PLATE, SETUP, placing, output=output, provenance=store.Provenance("test")
    )
    with store.open_file(output) as file:
        px, mm = file.read("residual_px"), file.read("residual_mm")
        assert np.argmax(px) == 3 and file.attribute("captures") == ["0", "1", "2", "3"]
    with xr.open_dataset(output, engine="h5netcdf") as opened:
        # The unit of each number stands beside it, and two numbers' in the covariance.
        units = dict(zip(opened["quantity"].values.tolist(), opened.quantity_unit.values.tolist(), strict=True))
        assert units[b"x_mm"] == b"mm" and units[b"about_x_deg"] == b"deg" and units[b"principal_x_px"] == b"{px}"
        for unit in units.values():
            require_unit(unit.decode())
        assert opened.covariance.dims == ("quantity", "other_quantity") and opened.residual_mm.dims == ("capture",)
        assert opened.residual_mm.attrs["units"] == "mm" and opened.capture.values.tolist() == [b"0", b"1", b"2", b"3"]
    np.testing.assert_allclose(mm / px, 0.75, rtol=0.03)
