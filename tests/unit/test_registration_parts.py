"""Parts of the registration of objects, each against what can be written down."""

import math
import re
from dataclasses import replace

import h5py
import numpy as np
import pytest
import xarray as xr
from drawn_plates import NAMES, PINHOLE, PLATE, SETUP, VIEWS, correction, drawn, linear_file, picture

from irodori.config.capture_table import Pose
from irodori.config.models import Placing
from irodori.core import store
from irodori.core.custody import accept
from irodori.core.errors import InputError
from irodori.core.units import require_unit
from irodori.geometry.rig_frame import (
    rig_from_object,
    rotation_x,
    rotation_y,
    rotation_z,
)
from irodori.geometry.shapes.placement import on_table
from irodori.geometry.shapes.sphere import Sphere
from irodori.rectification import reduced_pictures
from irodori.rectification.contradicted_definitions import fault_of
from irodori.rectification.object_registration import in_words, register, register_object
from irodori.rectification.placement_correction import COUNT, QUANTITIES, Correction, prior_sigma
from irodori.rectification.pose_residuals import _displacement
from irodori.rectification.reduced_pictures import Picture
from irodori.rectification.registration_covariance import RegisteredAngleErrors
from irodori.rectification.registration_equations import cauchy_weight, robust_sigma
from irodori.rectification.registration_file import AngleChanges, Estimate
from irodori.rectification.registration_problem import Registered
from irodori.rectification.texture_agreement import (
    blocks,
    matt_weight,
    mean_texture,
    picture_slope,
    texel_values,
    texture_rows,
    without_levels,
)
from irodori.rectification.told_values import inverse, only_what_is_told, solve

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
    assert whole.response.shape == (40, 60, 3) and whole.scale == 1.0
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


def test_a_picture_with_a_mask_of_another_size_is_refused(tmp_path):
    path = linear_file(tmp_path / "one.h5", np.ones((40, 60, 3)))
    with h5py.File(path, "a") as file:
        del file["valid"]
        file["valid"] = np.ones((40, 61), np.uint8)
    accept(path)
    with pytest.raises(InputError, match=r"one\.h5: valid"):
        Picture.load(path)


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
    part = Picture.load(path, (30.0, 9.0, 59.0, 39.0))
    seen = [one.level(0.0).sampled(one.level(0.0).bands, one.place(np.array([[40.0, 28.0]]))) for one in (found, part)]
    assert part.response.shape == (15, 15, 3)
    np.testing.assert_allclose(seen[1], response[None, 28, 40], rtol=1e-5)
    np.testing.assert_allclose(*seen, rtol=1e-5)


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


@pytest.mark.parametrize("sigma", [1.0, 1.5])
def test_blur_is_a_gaussian_to_two_and_a_half_standard_deviations(sigma):
    response = np.zeros((31, 31, 2))
    response[15, 15] = [1.0, 3.0]
    level, reach = picture(response).level(sigma), int(2.5 * sigma + 0.5)
    bell = np.where(np.abs(np.arange(31) - 15) <= reach, np.exp(-0.5 * ((np.arange(31) - 15) / sigma) ** 2), 0.0)
    bell = np.outer(bell, bell) / bell.sum() ** 2
    np.testing.assert_allclose(level.bands, [bell, 3.0 * bell], atol=1e-6)
    assert (level.valid == 1.0).all()
    # What is valid to more than a half of the weight is known.
    valid = np.ones((31, 31))
    valid[:, 15:] = 0.0
    assert picture(response, valid=valid).level(sigma).valid[3].tolist() == [1.0] * 15 + [0.0] * 16


# Textures.


def test_gloss_directions_have_no_say():
    assert matt_weight(np.array([0.0, 0.175, 0.35, 1.0])).tolist() == pytest.approx([0.0, 0.25, 1.0, 1.0])


def test_blocks_are_squares_of_texels_that_grow_with_the_blur():
    found = blocks(20, 12, 2.0, 1.5).reshape(12, 20)  # 8 x 1.5 / 2 texels
    np.testing.assert_array_equal(np.unique(found[:6, :6]), found[0, 0])
    assert len({found[0, 0], found[0, 6], found[6, 0], found[6, 6]}) == 4
    assert len(np.unique(found)) == 4 * 2  # those at the right and at the bottom are smaller
    assert len(np.unique(blocks(20, 12, 2.0, 100.0))) == 1 and len(np.unique(blocks(20, 10, 2.0, 0.1))) == 8
    for blur, side in ((0.1, 5), (1.5, 12), (1.57, 13), (100.0, 20)):  # eight standard deviations, 5 to 20 texels
        found = blocks(50, 45, 1.0, blur).reshape(45, 50)
        assert (found[0] == found[0, 0]).sum() == (found[:, 0] == found[0, 0]).sum() == side


def test_the_slope_over_a_picture_is_that_of_a_plane():
    row, column = np.mgrid[:8, :9].astype(float)
    place = np.stack([3.0 * column + 0.5 * row, -0.4 * column + 2.0 * row + 7.0], axis=-1)
    values = (2.0 * place[..., 0] - 0.7 * place[..., 1])[..., None] * [1.0, -3.0]
    slope = picture_slope(values, place)
    np.testing.assert_allclose(slope, np.broadcast_to([[2.0, -0.7], [-6.0, 2.1]], slope.shape), rtol=1e-9)
    values[4, 4] = np.nan
    known = np.isfinite(picture_slope(values, place)).all(axis=(2, 3))
    beside = np.abs(np.array([row - 4.0, column - 4.0])).sum(axis=0) == 1.0
    assert not known[beside].any() and known[~beside & ((row != 4.0) | (column != 4.0))].all()


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
    # Shares count, and not how large all weights are.
    for one, other in zip(without, without_levels(values, [3.0 * w for w in weights], block), strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-9)
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
    step, covariance = solve(matrix, right, sigma), inverse(matrix, sigma)
    np.testing.assert_allclose(step[free], np.linalg.solve(matrix[np.ix_(free, free)], right[free]), rtol=1e-9)
    np.testing.assert_allclose(covariance[np.ix_(free, free)], np.linalg.inv(matrix[np.ix_(free, free)]), rtol=1e-9)
    assert step[1] == 0.0 and (covariance[1] == 0.0).all() and (covariance[:, 1] == 0.0).all()


def test_what_is_not_told_and_what_is_nothing_goes_back_to_what_was_typed():
    sigma, values, errors = np.full(COUNT, 2.0), np.zeros(COUNT), np.full(COUNT, 0.02)
    values[:6] = [1.0, 1.0, 0.03, 0.3, 0.11, 0.08]
    errors[1], errors[4], errors[5] = 1.5, 0.1, 0.02  # not told; within two errors; told, and more than 0.05 degrees
    found, room = only_what_is_told(values, information(errors), sigma)
    assert found[[0, 3, 5]].tolist() == pytest.approx([1.0, 0.3, 0.08])
    assert (found[[1, 2, 4]] == 0.0).all() and (found[6:] == 0.0).all()
    np.testing.assert_array_equal(room > 0, [True, False, False, True, False, True, *[False] * 6])


@pytest.mark.parametrize("prior", [0.5, 2.0])
def test_a_value_is_told_by_an_error_below_half_of_its_prior_whatever_its_unit(prior):
    for share, told in ((0.45, True), (0.55, False)):
        values, errors = np.zeros(COUNT), np.full(COUNT, 0.1 * prior)
        values[6], errors[6] = 5.0 * prior, share * prior
        found, room = only_what_is_told(values, information(errors), np.full(COUNT, prior))
        assert (found[6] != 0.0) == (room[6] != 0.0) == told


def test_of_two_that_are_told_as_a_sum_one_takes_all_of_it():
    sigma, values, errors = np.full(COUNT, 10.0), np.zeros(COUNT), np.full(COUNT, 10.0)
    values[0], values[3] = 1.0, 2.0
    found, _ = only_what_is_told(values, information(errors, between=(0, 3, 1e4)), sigma)
    assert sorted(found[[0, 3]]) == pytest.approx([0.0, 3.0], abs=1e-3) and np.count_nonzero(found) == 1


def test_outliers_lose_their_weight():
    values = np.array([0.01, -0.02, 0.015, -0.01, 5.0])
    sigma = robust_sigma(values, 0.001)
    weight = cauchy_weight(values, sigma)
    assert sigma == pytest.approx(1.4826 * 0.015) and weight[-1] < 1e-4 and weight[:4].min() > 0.8
    assert robust_sigma(values, 0.1) == 0.1 and robust_sigma(values, 0.001, 0.01) == 0.01
    assert robust_sigma(np.zeros(0), 0.3) == 0.3
    assert cauchy_weight(np.array([-0.4, 0.0]), 0.2).tolist() == [0.5, 1.0]  # half the say at two standard deviations


# Words.


NO_ANGLES = RegisteredAngleErrors(
    np.full(4, np.nan),
    np.full((2, 4), np.nan),
    np.full((4, 2), np.nan),
    AngleChanges(np.zeros((2, 4, COUNT + 1, COUNT + 1)), np.zeros(2, dtype=int)),
)


def registered(values, sigma, residual=(0.1, 0.2), suspects=(("turn_deg", 0.0), ("turn_deg", 0.0))) -> Registered:
    prior = np.full(COUNT, 2.0)
    return Registered(
        Estimate(np.array(values), np.diag(np.array(sigma) ** 2), prior, np.array(values)),
        np.zeros(2),
        np.array(residual),
        np.array(residual),
        0.2,
        np.array([10, 20]),
        suspects,
        NO_ANGLES,
    )


@pytest.mark.parametrize(("moved", "scatter", "tells"), [(4.0, 0.8, True), (0.2, 0.8, False), (0.2, 0.25, True)])
def test_an_outline_tells_where_it_lies_if_most_points_agree_to_a_quarter_of_the_move_or_closely(moved, scatter, tells):
    around = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    outward = np.stack([np.cos(around), np.sin(around)], axis=1)
    off = np.random.default_rng(7).uniform(-scatter, scatter, 400)
    found = _displacement(200.0 + 80.0 * outward, outward, moved * outward[:, 0] + off)
    # Moved along one axis, the outline of a disc is off along its normals by the cosine: by its root mean square.
    assert found == pytest.approx(moved / math.sqrt(2.0), abs=0.08) if tells else math.isnan(found)


def test_a_sentence_says_what_is_told_what_is_as_typed_and_what_is_not_told():
    values, sigma = np.zeros(COUNT), np.full(COUNT, 1.9)
    values[0], sigma[0], sigma[1] = 1.25, 0.02, 0.9  # less than half of what it was before
    assert in_words(registered(values, sigma)) == (
        "corrections of what was typed: object along the table's x +1.25 ± 0.02 mm; "
        "confirmed as typed: object along the table's y; "
        f"not determined by the photographs, kept as typed: {', '.join(quantity.text for quantity in QUANTITIES[2:])}"
    )
    unjudged = in_words(registered(values, sigma, residual=(0.1, np.nan, np.nan)))
    assert unjudged.endswith("; 2 of 3 photographs show too little to tell whether their poses are right")
    nothing = in_words(registered(np.zeros(COUNT), np.full(COUNT, 0.1)))
    assert (
        nothing.startswith("corrections of what was typed: none; confirmed as typed")
        and "not determined" not in nothing
    )


def test_the_photograph_that_is_furthest_off_is_refused():
    found = registered(
        np.zeros(COUNT), np.full(COUNT, 0.1), (0.5, 3.0), (("turn_deg", 0.0), ("camera_deg or tilt_deg", -1.5))
    )
    said = r"b\.h5: pose_deg.*3 superpixels \(0\.6 mm\).*camera_deg or tilt_deg is off by -1\.5.*at most 1 superpixels"
    assert re.search(said, str(fault_of(found, ["a.h5", "b.h5"], Placing())))
    assert fault_of(found, ["a.h5", "b.h5"], Placing(max_residual_px=3.0)) is None
    silent = registered(np.zeros(COUNT), np.ones(COUNT), (math.nan, math.nan))
    assert fault_of(silent, ["a.h5", "b.h5"], Placing()) is None
    # The most probable place, some numbers of which are not told and stay as typed, explains what is seen.
    explained = replace(found, least_residual_px=np.array([0.1, np.nan]))
    assert fault_of(explained, ["a.h5", "b.h5"], Placing()) is None


# All of it, on a plate whose pictures are drawn by hand.


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("lies", [(0.0,) * 6, (1.2, -0.9, 0.0, 0.0, 0.0, 1.5), (-0.8, 1.0, 0.0, 1.2, -1.0, -1.0)])
def test_a_drawn_plate_is_found_where_it_lies(tmp_path, lies):
    found = register(drawn(tmp_path, Correction.of([*lies, *[0.0] * 6]), contrast=0.3), PLATE, SETUP, Placing())
    # A superpixel is three quarters of a millimetre here.
    np.testing.assert_allclose(found.correction.values[:2], lies[:2], atol=0.01)
    np.testing.assert_allclose(found.correction.values[3:6], lies[3:], atol=0.1)
    assert found.correction.values[6:] == (0.0,) * 6
    assert (found.outline_points > 150).all() and np.nanmax(found.residual_px) < 0.05
    assert np.abs(found.own_camera_deg).max() < 0.03
    # Four outlines of 200 points, half of which tell of one direction; five of them count as one of 0.1 superpixels.
    assert (found.sigma[:2] < 0.75 * 0.1 / np.sqrt(4 * 100 / 5)).all()
    # These pictures have no noise, and agree better than that.
    assert (np.abs(found.estimate.probable[:2] - lies[:2]) < 3.0 * found.sigma[:2]).all()
    assert (
        found.mm_per_px == pytest.approx(0.75, rel=0.02)
        and found.estimate.prior.tolist() == prior_sigma(Placing()).tolist()
    )


def test_a_drawn_plate_turned_in_one_photograph_is_refused_for_its_turn(tmp_path):
    shown = [*VIEWS[:3], replace(VIEWS[3], turn_deg=184.0)]
    files = drawn(tmp_path, Correction(), shown)
    with pytest.raises(InputError, match=r"3\.h5: pose_deg.*turn_deg is off by \+(3\.[5-9]|4\.[0-5])"):
        register_object(files, PLATE, SETUP, Placing(), output=tmp_path / "out.h5", provenance=store.Provenance("test"))
    assert not (tmp_path / "out.h5").exists()


def test_the_file_says_how_far_each_photograph_is_off(tmp_path):
    shown, placing = [*VIEWS[:3], replace(VIEWS[3], turn_deg=184.0)], Placing(max_residual_px=100.0)
    output = tmp_path / "out.h5"
    files = drawn(tmp_path, Correction(), shown)
    register_object(files, PLATE, SETUP, placing, output=output, provenance=store.Provenance("test"))
    with store.open_file(output) as file:
        px, mm = file.read("residual_px"), file.read("residual_mm")
        assert np.argmax(px) == 3 and file.attribute("captures") == ["0", "1", "2", "3"]
        assert px[:3].max() < 0.5 * px[3]
    with xr.open_dataset(output, engine="h5netcdf") as opened:
        # The unit of each number stands beside it, and two numbers' in the covariance.
        units = dict(zip(opened["quantity"].values.tolist(), opened.quantity_unit.values.tolist(), strict=True))
        assert units[b"x_mm"] == b"mm" and units[b"about_x_deg"] == b"deg" and units[b"principal_x_px"] == b"{px}"
        for unit in units.values():
            require_unit(unit.decode())
        # Those of what is combined with other objects, too, along either axis.
        for axis in ("unknown", "other_unknown"):
            assert opened[f"{axis}_unit"].values.tolist() == [*units.values(), *[b"deg"] * 4]
        for axis in ("term", "other_term"):
            assert opened[f"{axis}_unit"].values.tolist() == [*units.values(), b"deg"]
        assert opened.angle_change.dims == ("capture", "angle", "term", "other_term") and len(opened.angle) == 4
        assert opened.covariance.dims == ("quantity", "other_quantity") and opened.residual_mm.dims == ("capture",)
        assert opened.residual_mm.attrs["units"] == "mm" and opened.capture.values.tolist() == [b"0", b"1", b"2", b"3"]
    np.testing.assert_allclose(mm / px, 0.75, rtol=0.03)


def test_the_file_says_what_is_told_and_moves_nothing_that_is_certain(tmp_path):
    certain = Placing(focal_length_percent=0.0, camera_distance_mm=0.0)
    lies, output = correction(x_mm=1.2, y_mm=-0.9, about_z_deg=1.5), tmp_path / "out.h5"
    files = drawn(tmp_path, lies, contrast=0.3)
    register_object(files, PLATE, SETUP, certain, output=output, provenance=store.Provenance("test"))
    values = np.array(Correction.load(output).values)
    np.testing.assert_allclose(values[[0, 1, 5]], [1.2, -0.9, 1.5], atol=0.1)
    assert (values[6:8] == 0.0).all()
    with store.open_file(output) as file:
        sigma, covariance, prior = (file.read(name) for name in ("sigma", "covariance", "prior_sigma"))
        np.testing.assert_allclose(sigma**2, np.diag(covariance), rtol=1e-12)
        assert (sigma[6:8] == 0.0).all() and prior.tolist() == prior_sigma(certain).tolist()
        told = file.attribute("told")
        assert told[0] and told[1] and told[5] and not told[11]  # no picture tells the light's angle
        assert f"object along the table's x {values[0]:+.2f} ± {sigma[0]:.2f} mm" in file.attribute("sentence")
        assert file.attribute("quantities")[:2] == ["x_mm, mm", "y_mm, mm"]
        assert (file.read("outline_points") > 100).all()
        assert file.read("own_camera_deg").shape == (4,)
