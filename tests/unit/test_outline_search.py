"""Outlines of objects: where they are expected, and where pictures have their edges."""

import math

import numpy as np
import pytest
from drawn_plates import PINHOLE, correction, picture

from irodori.config.capture_table import Pose
from irodori.geometry.embree import Tracer
from irodori.geometry.rig_frame import rig_from_camera, to_camera
from irodori.geometry.shapes.plate import Plate
from irodori.geometry.shapes.sphere import Sphere
from irodori.rectification.outline_search import InnerSide, _between, _normals, find_edges, find_rim, first_hit, held
from irodori.rectification.placement_correction import Correction


def edge_distances(*args, **options) -> np.ndarray:
    return find_edges(*args, **options).distance


def edge(at, inner=0.5, outer=0.02, sharpness=0.8, size=80):
    """A picture, bright to the left of a column and dark to the right of it, and blurred a little."""
    x = np.arange(size) - at
    step = 0.5 * (1.0 - np.vectorize(math.erf)(x / (sharpness * math.sqrt(2.0))))
    return np.tile((outer + (inner - outer) * step)[None, :, None], (size, 1, 3))


def test_rows_are_read_between_their_values_up_to_the_last():
    rng = np.random.default_rng(1)
    rows, places = rng.uniform(size=(5, 4)), np.concatenate([rng.uniform(0.0, 3.0, (5, 20)), np.full((5, 1), 3.0)], 1)
    expected = [np.interp(at, np.arange(4), row) for row, at in zip(rows, places, strict=True)]
    np.testing.assert_allclose(_between(rows, places), expected, atol=1e-12)


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


def test_before_something_dark_the_end_of_the_lit_part_is_no_outline():
    """From the dark side outward: the lit part begins by a greater step than that with which it ends."""
    response = edge(34.0, 0.0, 1.0) * edge(46.0, 0.1, 0.03)
    seen, xy, out = picture(response), np.array([[40.0, 40.0]]), np.array([[1.0, 0.0]])
    np.testing.assert_allclose(edge_distances(seen, seen.level(0.0), xy, out, 8.0), -6.0, atol=0.2)
    found = edge_distances(seen, seen.level(0.0), xy, out, 8.0, is_dark_outside=True)
    np.testing.assert_allclose(found, 6.0, atol=0.2)
    bright = picture(edge(41.0, 0.03, 0.1))
    assert np.isnan(edge_distances(bright, bright.level(0.0), xy, out, 8.0, is_dark_outside=True)).all()


def normals_of(curve):
    """Unit normals of a closed curve's points, to either side."""
    along = np.roll(curve, -1, axis=0) - np.roll(curve, 1, axis=0)
    return np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (4.0, -3.0, 2.0)])
def test_the_outline_of_a_sphere_is_where_rays_graze_it(at):
    pose, radius = Pose(45.0, 20.0), 30.0
    placed = correction(x_mm=at[0], y_mm=at[1], z_mm=at[2]).placements(Sphere(radius), pose, 0.0)
    eye, axes = 900.0 * to_camera(pose), rig_from_camera(pose)
    # The circle in which the cone of grazing rays touches it.
    way = eye - at
    distance = np.linalg.norm(way)
    towards, sine = way / distance, radius / distance
    across = np.cross(towards, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    turn = np.linspace(0.0, 2.0 * math.pi, 2001)[:-1, None]
    round_it = np.cos(turn) * across + np.sin(turn) * np.cross(towards, across)
    curve = PINHOLE.project(at + radius * (sine * towards + math.sqrt(1.0 - sine**2) * round_it), eye, axes)
    rim = find_rim(Tracer(placed), PINHOLE, eye, axes, (*curve.min(axis=0), *curve.max(axis=0)))
    world = rim.point + at
    to_eye = eye - world
    to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)
    np.testing.assert_allclose(np.linalg.norm(rim.point, axis=1), radius, rtol=1e-4)
    assert np.abs(np.sum(to_eye * rim.point / radius, axis=1)).max() < 0.003
    seen = PINHOLE.project(world, eye, axes)
    nearest = np.linalg.norm(seen[:, None] - curve, axis=2).argmin(axis=1)
    assert np.abs(np.sum((seen - curve[nearest]) * rim.outward, axis=1)).max() < 0.01  # superpixels
    assert np.abs(np.sum(rim.outward * normals_of(curve)[nearest], axis=1)).min() > math.cos(0.003)
    radial = seen - curve.mean(axis=0)
    assert np.sum(radial * rim.outward, axis=1).min() > 0.0
    angle = np.sort(np.degrees(np.arctan2(*radial.T)))
    # 1.8 degrees apart on average, unevenly: points are picked by the rows of the picture.
    assert len(angle) == 200 and np.diff([*angle, angle[0] + 360.0]).max() < 9.0


@pytest.mark.parametrize("pose", [Pose(45.0, 0.0), Pose(45.0, 40.0, 10.0, 25.0)])
def test_the_outline_of_a_plate_is_its_four_sides_without_the_corners(pose):
    placed = Correction().placements(Plate(50.0, 30.0), pose, 0.0)
    eye, axes = 900.0 * to_camera(pose), rig_from_camera(pose)
    corners = PINHOLE.project(placed[0].corners(), eye, axes)
    rim = find_rim(Tracer(placed), PINHOLE, eye, axes, (*corners.min(axis=0), *corners.max(axis=0)))
    assert len(rim.point) == 200
    x, y = np.abs(rim.point[:, 0]) / 25.0, np.abs(rim.point[:, 1]) / 15.0
    np.testing.assert_allclose(np.maximum(x, y), 1.0, atol=1e-4)
    np.testing.assert_allclose(rim.point[:, 2], 0.0, atol=1e-3)
    assert np.minimum(x, y).max() < 0.99  # a corner has no direction
    seen, sides = PINHOLE.project(placed[0].points(rim.point), eye, axes), []
    for first, second in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (second - first) / np.linalg.norm(second - first)
        out = np.array([-along[1], along[0]])  # rows go down, so that the corners are passed clockwise
        out = out if (first - corners.mean(axis=0)) @ out > 0.0 else -out
        own = np.abs((seen - first) @ out) < 0.01
        np.testing.assert_allclose(rim.outward[own], np.tile(out, (own.sum(), 1)), atol=2e-3)
        place = np.sort((seen[own] - first) @ along) / np.linalg.norm(second - first)
        assert place[0] < 0.15 and place[-1] > 0.85 and np.diff(place).max() < 0.1
        sides.append(own)
    assert (np.sum(sides, axis=0) == 1).all()


@pytest.mark.parametrize("radius", [0.1, 0.3, 3.0])
def test_a_speck_in_the_picture_has_an_outline_too(radius):
    """It may be a larger thing whose size was typed wrong."""
    pose = Pose(45.0, 0.0)
    eye, axes = 900.0 * to_camera(pose), rig_from_camera(pose)
    tracer = Tracer(Correction().placements(Sphere(radius), pose, 0.0))
    middle, half = PINHOLE.project(np.zeros(3), eye, axes), radius * 10_000.0 / 900.0 / 2.0
    rim = find_rim(tracer, PINHOLE, eye, axes, (*(middle - half), *(middle + half)))
    assert len(rim.point) == len(rim.outward) >= 60
    np.testing.assert_allclose(np.linalg.norm(rim.point, axis=1), radius, rtol=1e-3)
    # Seen from far away the outline is the equator.
    assert np.abs(rim.point[:, 2]).max() < 0.02 * radius


def test_what_is_not_in_the_window_has_no_outline():
    pose = Pose(45.0, 0.0)
    eye, axes = 900.0 * to_camera(pose), rig_from_camera(pose)
    rim = find_rim(Tracer(Correction().placements(Sphere(5.0), pose, 0.0)), PINHOLE, eye, axes, (0.0, 0.0, 20.0, 20.0))
    assert rim.point.shape == (0, 3) and rim.outward.shape == (0, 2)


def found_at(response, reach=4.0, noise=(1e-6, 0.0)):
    """What is found beside column 40 of a picture."""
    seen = picture(response, noise=noise)
    return edge_distances(seen, seen.level(0.0), np.array([[40.0, 40.0]]), np.array([[1.0, 0.0]]), reach)[0]


@pytest.mark.parametrize("reach", [4.0, 10.0])
def test_an_edge_is_found_as_far_as_the_search_goes(reach):
    for side in (1.0, -1.0):
        near, beyond = side * (reach - 0.3), side * (reach + 0.4)
        assert found_at(edge(40.0 + near), reach) == pytest.approx(near, abs=0.03)
        assert math.isnan(found_at(edge(40.0 + beyond), reach))


def test_an_edge_stands_out_by_a_quarter_of_its_logarithm_and_six_standard_deviations():
    for step, is_seen in ((0.23, False), (0.27, True)):
        outer = 0.1
        inner = (outer + 0.01) * math.exp(step) - 0.01
        assert math.isfinite(found_at(edge(41.0, inner, outer))) == is_seen
        assert math.isfinite(found_at(edge(41.0, outer, inner))) == is_seen
    for sigmas, is_seen in ((5.6, False), (6.4, True)):
        sigma = 0.3 / sigmas
        assert math.isfinite(found_at(edge(41.0, 0.4, 0.1), noise=(sigma**2, 0.0))) == is_seen
        # Noise of photons is that of the brighter side.
        assert math.isfinite(found_at(edge(41.0, 0.4, 0.1), noise=(0.0, sigma**2 / 0.4))) == is_seen
        assert math.isfinite(found_at(edge(41.0, 0.1, 0.4), noise=(0.0, sigma**2 / 0.4))) == is_seen


def test_of_a_camera_whose_noise_is_not_known_a_hundredth_is_taken_at_any_level():
    for step, is_seen in ((0.056, False), (0.064, True)):
        assert math.isfinite(found_at(edge(41.0, 0.1 + step, 0.1), noise=(math.nan, math.nan))) == is_seen


def test_of_two_like_edges_the_one_nearer_to_where_it_is_expected_is_taken():
    for first, second, nearer in ((32.0, 45.0, 5.0), (35.0, 48.0, -5.0)):
        stripe = edge(first, 0.02, 0.5) * edge(second, 1.0, 0.04)  # dark, bright between, dark
        assert found_at(stripe, 12.0) == pytest.approx(nearer, abs=0.15)


@pytest.mark.parametrize("slope", [-0.02, 0.01])
def test_texture_that_changes_evenly_towards_the_edge_of_a_flat_object_does_not_move_it(slope):
    x = np.arange(80.0)[None, :, None]
    for at in (39.2, 40.0, 41.7):
        painted = (edge(at, 1.0, 0.0) * (0.5 + slope * (x - at))) + 0.02
        assert found_at(painted) == pytest.approx(at - 40.0, abs=0.02)


DEPTH = 0.5 * np.arange(13)  # samples


BALL = np.sqrt(DEPTH / 40.0)  # cosine between normal and view of one of 80 samples


def inner_side(light, facing=BALL, paint=1.0, unsure=0.0) -> InnerSide:
    """A surface of which light, the cosine between normal and view, and paint are known."""
    light = np.asarray(light)
    return InnerSide(0.5, light, *(np.broadcast_to(one, light.shape).copy() for one in (facing, paint, unsure)))


def shaded(at, irradiance, outer=0.02, fine=20, blur=0.6):
    """A picture, blurred a little, of a surface that ends at a column: its irradiance by the depth inside, samples."""
    x = (np.arange(80 * fine) + 0.5) / fine - 0.5 - at
    inner = np.where(x < 0.0, irradiance(np.maximum(-x, 0.0)), outer)
    weights = np.exp(-0.5 * ((np.arange(-4 * fine, 4 * fine + 1)) / (blur * fine)) ** 2)
    soft = np.convolve(np.pad(inner, 4 * fine, mode="edge"), weights / weights.sum(), mode="valid")
    return np.tile(soft.reshape(80, fine).mean(axis=1)[None, :, None], (80, 1, 3))


def test_the_outline_of_a_ball_is_found_where_it_ends_however_it_is_lit():
    """A ball of a radius of 80 samples, seen from 70 degrees beside the lamp, half of it in half-shadow."""
    lit, xy, out = (
        np.linspace(0.2, 0.9, 15),
        np.stack([np.full(15, 40.0), np.arange(2.0, 77.0, 5.0)], axis=1),
        [1.0, 0.0],
    )
    balls = [lambda deep, lit=one: lit * (1.0 - deep / 80.0) + 0.34 * np.sqrt(deep / 40.0) for one in lit]
    light = np.stack([ball(DEPTH) for ball in balls])
    out = np.tile(out, (15, 1))
    for at in (38.6, 39.5, 40.3, 41.2):
        response = np.concatenate([shaded(at, lambda deep, ball=ball: 0.5 * ball(deep))[:5] for ball in balls])
        seen = picture(np.concatenate([response, response[-5:]]))
        found = edge_distances(seen, seen.level(0.0), xy, out, 4.0, inner=inner_side(light)) - (at - 40.0)
        assert np.abs(found).max() < 0.1 and abs(np.median(found)) < 0.04
        # A ball that is taken for an even surface seems smaller, most where it is dark.
        even = edge_distances(seen, seen.level(0.0), xy, out, 4.0, inner=inner_side(np.ones((15, 13)), 0.0)) - (
            at - 40.0
        )
        assert not np.abs(even[:5]).max() < 0.2


def test_a_disc_that_is_as_bright_everywhere_is_found_whatever_light_is_expected():
    """The shading is that of the photograph: of a matt ball, a brighter rim or none, all round or on one side."""
    xy, out = np.stack([np.full(9, 40.0), np.arange(30.0, 39.0)], axis=1), np.tile([1.0, 0.0], (9, 1))
    light = np.tile(0.3 + 0.34 * np.sqrt(DEPTH / 40.0), (9, 1))
    seen = picture(edge(40.7, 0.5, 0.02))
    np.testing.assert_allclose(
        edge_distances(seen, seen.level(0.0), xy, out, 4.0, inner=inner_side(light)), 0.7, atol=0.03
    )


@pytest.mark.parametrize("strip", [0.3, 0.7, 1.7])
@pytest.mark.parametrize("outermost", [1.0 / 3.0, 0.6, 1.6])
def test_a_known_border_of_paints_within_the_blur_of_an_edge_does_not_move_it(strip, outermost):
    """A matt ball whose outermost samples, ``strip`` wide, are of a darker or a brighter paint."""
    xy, out = np.stack([np.full(9, 40.0), np.arange(30.0, 39.0)], axis=1), np.tile([1.0, 0.0], (9, 1))

    def paint(deep):
        return np.where(deep < strip, outermost, 1.0)

    def light(deep):
        return 0.6 + 0.2 * np.sqrt(deep / 40.0)

    fine = np.linspace(0.0, 7.0, 1401)
    around = np.maximum(1.0 - np.abs(fine - DEPTH[:, None]) / 0.5, 0.0)
    mean_paint = around @ paint(fine) / around.sum(axis=1)
    for at in (39.7, 40.4):
        seen = picture(shaded(at, lambda deep: 0.3 * light(deep) * paint(deep), blur=0.3))
        known, unknown = (
            find_edges(seen, seen.level(0.0), xy, out, 4.0, inner=inner_side(np.tile(light(DEPTH), (9, 1)), paint=one))
            for one in (mean_paint, 1.0)
        )
        moved = np.abs(unknown.distance - (at - 40.0))
        np.testing.assert_allclose(known.distance, at - 40.0, atol=0.03)
        assert (moved > 0.1).all()
        # The doubt is a part of what the paint changes.
        assert (known.doubt > 0.1 * moved).all() and (known.doubt < 0.6 * moved).all()


def test_gloss_that_rises_from_an_outline_inwards_is_told_from_its_place():
    """The doubt grows with what the gloss changes."""
    xy, out = np.stack([np.full(9, 40.0), np.arange(30.0, 39.0)], axis=1), np.tile([1.0, 0.0], (9, 1))
    light, doubts = np.tile(0.6 + 0.2 * np.sqrt(DEPTH / 40.0), (9, 1)), []
    for gloss in (0.0, 0.5, 1.5):
        seen = picture(shaded(40.4, lambda deep, gloss=gloss: 0.3 * (0.6 + (0.2 + gloss) * np.sqrt(deep / 40.0))))
        found = find_edges(seen, seen.level(0.0), xy, out, 4.0, inner=inner_side(light))
        np.testing.assert_allclose(found.distance, 0.4, atol=0.03)
        doubts.append(np.median(found.doubt))
    assert doubts[0] < 0.02 < doubts[1] < doubts[2]


def test_a_few_places_that_brighten_otherwise_do_not_change_how_gloss_is_told_along_an_outline():
    """The median over neighbours is taken: three places of nine darken inwards, where gloss brightens the others."""
    xy, out = np.stack([np.full(9, 40.0), np.arange(14.0, 59.0, 5.0)], axis=1), np.tile([1.0, 0.0], (9, 1))
    light = np.tile(0.6 + 0.2 * np.sqrt(DEPTH / 40.0), (9, 1))
    glossy, odd = (
        shaded(40.4, lambda deep, gloss=gloss: 0.3 * (0.6 + (0.2 + gloss) * np.sqrt(deep / 40.0)))
        for gloss in (1.5, -0.4)
    )
    for strange in ([0, 3, 7], [1, 4, 5]):
        response = glossy.copy()
        for number in strange:
            row = 14 + 5 * number
            response[row - 2 : row + 3] = odd[row - 2 : row + 3]
        seen = picture(response)
        found = find_edges(seen, seen.level(0.0), xy, out, 4.0, inner=inner_side(light))
        plain = np.setdiff1d(np.arange(9), strange)
        np.testing.assert_allclose(found.distance[plain], 0.4, atol=0.03)


def test_one_point_of_an_outline_is_read_as_many_are():
    light = 0.6 + 0.2 * np.sqrt(DEPTH / 40.0)
    seen = picture(shaded(40.4, lambda deep: 0.3 * (0.6 + 0.5 * np.sqrt(deep / 40.0))))
    found = []
    for count in (1, 2, 9):
        xy, out = np.stack([np.full(count, 40.0), np.full(count, 34.0)], axis=1), np.tile([1.0, 0.0], (count, 1))
        inner = inner_side(np.tile(light, (count, 1)))
        found.append(find_edges(seen, seen.level(0.0), xy, out, 4.0, inner=inner))
    for one in found:
        np.testing.assert_allclose(one.distance, found[-1].distance[0], rtol=1e-9)
        np.testing.assert_allclose(one.doubt, found[-1].doubt[0], rtol=1e-9)


def test_deeper_than_the_surface_is_known_it_goes_on_as_at_its_last_depth():
    xy, out = np.stack([np.full(9, 40.0), np.arange(30.0, 39.0)], axis=1), np.tile([1.0, 0.0], (9, 1))
    light = np.tile(0.6 + 0.2 * np.sqrt(DEPTH / 40.0), (9, 1))
    seen = picture(shaded(40.4, lambda deep: 0.3 * (0.6 + 0.2 * np.sqrt(deep / 40.0))))
    short = InnerSide(0.5, *(one[:, :9] for one in inner_side(light)[1:]))
    padded = InnerSide(0.5, *(np.pad(one, ((0, 0), (0, 4)), mode="edge") for one in short[1:]))
    found = [find_edges(seen, seen.level(0.0), xy, out, 4.0, inner=inner) for inner in (short, padded)]
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9)
    assert (np.abs(found[0].distance - 0.4) < 0.1).all()


def test_an_edge_beside_the_border_of_two_paints_is_not_read():
    """Nor one before a background that changes; most edges of the photograph are plain."""
    rows, borders = np.arange(80), {20: 38.5, 30: 37.5, 50: 42.5}
    response = edge(40.4, 0.3, 0.02)
    for row, border in borders.items():
        response[row - 1 : row + 2] += edge(border, 0.3, 0.0)[:3] if border < 40.0 else edge(border, 0.0, 0.2)[:3]
    seen = picture(response)
    xy = np.stack([np.full(7, 40.0), rows[10:80:10]], axis=1).astype(float)
    found = edge_distances(seen, seen.level(0.0), xy, np.tile([1.0, 0.0], (7, 1)), 4.0)
    np.testing.assert_array_equal(np.isnan(found), [row in borders for row in rows[10:80:10]])
    np.testing.assert_allclose(found[np.isfinite(found)], 0.4, atol=0.03)


def test_a_blurred_edge_is_found_where_it_is():
    xy, out = np.stack([np.full(9, 40.0), np.arange(30.0, 39.0)], axis=1), np.tile([1.0, 0.0], (9, 1))
    flat = inner_side(np.ones((9, 13)), 0.0)
    for sharpness, inner, within in ((1.2, None, 0.02), (2.0, None, 0.2), (2.0, flat, 0.1)):
        seen = picture(edge(40.7, 0.5, 0.02, sharpness))
        found = edge_distances(seen, seen.level(0.0), xy, out, 6.0, inner=inner)
        np.testing.assert_allclose(found, 0.7, atol=within)


def test_rays_that_miss_are_told_from_those_that_hit_and_gaps_hold_the_value_before():
    pose = Pose(45.0, 0.0)
    eye, axes = 900.0 * to_camera(pose), rig_from_camera(pose)
    tracer = Tracer(Correction().placements(Sphere(10.0), pose, 0.0))
    middle = PINHOLE.project(np.zeros(3), eye, axes)
    point, is_on = first_hit(tracer, PINHOLE, eye, axes, middle + np.array([[0.0, 0.0], [1000.0, 0.0]]))
    assert is_on.tolist() == [True, False]
    np.testing.assert_allclose(point[0], [0.0, 0.0, 10.0], atol=1e-3)
    gaps = np.array([[0.2, math.nan, 0.3, math.nan, math.nan], [math.nan] * 5])
    np.testing.assert_array_equal(held(gaps), [[0.2, 0.2, 0.3, 0.3, 0.3], [1.0] * 5])


def test_an_edge_at_the_end_of_a_picture_is_not_judged():
    assert math.isnan(found_at(edge(41.0)[:, :44])) and math.isfinite(found_at(edge(41.0)[:, :56]))


def test_normals_of_a_curve_are_those_of_a_parabola_through_its_neighbours_and_corners_have_none():
    turn = np.random.default_rng(4).permutation(2.0 * math.pi * np.arange(600) / 600.0)
    out = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    curve, across = out * [60.0, 30.0], out / [60.0, 30.0]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    for sign in (1.0, -1.0):  # to the side that is said to be outward, however roughly
        normal, is_smooth = _normals(curve, sign * out)
        assert is_smooth.all()
        np.testing.assert_allclose(normal, sign * across, atol=2e-3)
    # A roof of two straight sides, twenty points each: where it is steep, points whose twelve neighbours lie on both.
    for slope, reach in ((0.15, -1), (0.24, 4), (0.5, 5)):
        x = np.arange(-20.0, 21.0)
        normal, is_smooth = _normals(np.stack([x, -slope * np.abs(x)], axis=1), np.tile([0.0, 1.0], (41, 1)))
        np.testing.assert_array_equal(is_smooth, np.abs(x) > reach)
        far = np.abs(x) > 12.0
        side = np.stack([slope * np.sign(x[far]), np.ones(far.sum())], axis=1)
        np.testing.assert_allclose(normal[far], side / math.hypot(1.0, slope), atol=1e-6)
