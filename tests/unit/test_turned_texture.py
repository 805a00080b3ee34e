"""The turn of a ball from its first placement, by photographs of both that are computed from a known texture."""

import math
from dataclasses import replace

import numpy as np
import pytest
from drawn_plates import SETUP, picture
from laid_balls import OVER, POSES, angle_deg
from test_registration_steps import problem_without_pictures

from irodori.config.capture_table import Pose
from irodori.config.models import Placing
from irodori.core.errors import InputError
from irodori.geometry.rig_frame import rig_from_camera, rotation_xyz, to_camera, to_light
from irodori.geometry.shapes.sphere import Sphere
from irodori.rectification import turned_texture
from irodori.rectification.placement_correction import COUNT, LIGHT, Correction, prior_sigma
from irodori.rectification.registration_file import Estimate
from irodori.rectification.turned_texture import Side, Texture, Turned, turned, with_turn

BALL = Sphere(24.0)
WAVES = np.random.default_rng(7).normal(size=(3, 6, 3))
PHASES = np.random.default_rng(8).uniform(0.0, 2.0 * math.pi, (3, 6))


def paints(point, seed_shift=0.0):
    """Reflectances (..., 3) of points on the unit sphere: waves of six directions in each band."""
    waves = np.sin(2.5 * np.einsum("bkj,...j->...bk", WAVES, point) + PHASES + seed_shift)
    return 0.35 * np.exp(0.35 * waves.sum(axis=-1))


def one_paint(point):
    return np.broadcast_to([0.3, 0.35, 0.4], point.shape)


def photograph(pose, real: Correction, colours, level=1.0):
    """What a camera sees of a matt ball that lies as a correction says: no picture of it is read or rendered."""
    lain = real.placements(BALL, pose, 0.0)[0]
    centres = np.stack(np.meshgrid(np.arange(1.0, 320.0, 2.0), np.arange(1.0, 240.0, 2.0)), axis=-1)
    way = SETUP.pinhole.directions(centres, rig_from_camera(pose))
    way = way / np.linalg.norm(way, axis=-1, keepdims=True)
    start = SETUP.camera_distance_mm * to_camera(pose) - lain.translation_mm
    along = way @ start
    inside = along**2 - (start @ start - BALL.ball_mm**2)
    at = start + (-along - np.sqrt(np.maximum(inside, 0.0)))[..., None] * way
    normal = at / BALL.ball_mm
    cosine = np.maximum(normal @ to_light(pose), 0.0)
    seen = np.where(inside > 0.0, level * cosine, 0.0)[..., None] * colours(normal @ lain.rotation)
    return picture(seen)


def side(number, real_deg=(0.0, 0.0, 0.0), colours=paints, poses=POSES, typed=OVER, shown=None):
    """A placement of the ball as registration has it, turned in truth by further angles about the table's axes."""
    typed = (0.0, 0.0, 0.0) if number == 1 else typed
    said = Correction.laid(BALL, typed)
    poses = [replace(pose, placement=number) for pose in poses]
    problem = problem_without_pictures(BALL, poses, columns=48, rows=24, setup=replace(SETUP, correction=said))
    real = replace(said, values=(0.0, 0.0, 0.0, *real_deg, *(0.0,) * 6))
    for view in problem.views:
        view.picture = photograph(view.pose, real, colours)
    for at, other in (shown or {}).items():
        problem.views[at].picture = photograph(poses[at], other, colours)
    return Side(problem, [f"{number}-{n}.h5" for n in range(len(poses))], np.zeros(COUNT), number)


def off_deg(found: Turned, real_deg) -> float:
    return angle_deg(rotation_xyz(found.rotation_deg) @ rotation_xyz(real_deg).T)


@pytest.fixture(scope="module")
def first():
    return side(1)


def whole(spread=0.4, seed=0):
    """An estimate of all numbers of a registration with correlated errors."""
    rng, size = np.random.default_rng(seed), COUNT + 3
    root = rng.normal(size=(size, size))
    covariance = spread * (root @ root.T / size + 0.1 * np.eye(size))
    values = rng.normal(size=COUNT)
    values[[1, 8, LIGHT]] = 0.0  # as typed
    return Estimate(rng.normal(size=size), covariance, prior_sigma(Placing()), values)


# How far it is turned.


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("real_deg", [(2.0, -1.5, 1.0), (9.0, 4.0, -6.0)])
def test_the_turn_is_found_within_its_stated_error(first, real_deg):
    found = turned(first, side(2, real_deg), 5.0)
    sigma = np.sqrt(np.diag(found.covariance))
    assert (np.abs(found.rotation_deg - real_deg) < 2.0 * sigma).all()
    assert (sigma > 0.3).all() and (sigma < 1.5).all()  # of a texel, which is 7.5 degrees
    assert off_deg(found, real_deg) < 1.0


def test_what_was_typed_counts_by_its_error(first):
    """A rotation that is typed for sure stays, and one of which less is known has the larger error."""
    own = side(2, (0.5, -0.4, 0.3))
    sure, loose = (turned(first, own, sigma) for sigma in (0.05, 20.0))
    assert np.linalg.norm(sure.rotation_deg) < 0.03
    assert (np.diag(sure.covariance) < 0.05**2).all()
    assert (np.diag(loose.covariance) > 10.0 * np.diag(sure.covariance)).all()


@pytest.mark.heavy
def test_the_level_of_the_lamp_does_not_matter(first):
    own, brighter = side(2, (1.0, 0.0, -1.0)), side(2, (1.0, 0.0, -1.0), lambda p: paints(p) * [1.3, 1.2, 1.5])
    here, there = (turned(first, one, 5.0).rotation_deg for one in (own, brighter))
    np.testing.assert_allclose(here, there, atol=0.1)


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("other", [one_paint, lambda p: paints(p, 2.0)], ids=["one paint", "other paints"])
def test_paints_that_do_not_agree_tell_nothing(first, other):
    assert turned(first, side(2, colours=other), 5.0) is None


def test_placements_without_a_side_in_common_tell_nothing():
    above = [Pose(30.0, 10.0), Pose(35.0, 15.0)]
    assert turned(side(1, poses=above), side(2, poses=above), 5.0) is None


def test_a_rotation_that_was_typed_wrong_is_refused_with_that_which_the_paints_show(first):
    own = side(2, typed=(90.0, 0.0, 0.0))
    for view in own.problem.views:
        view.picture = photograph(view.pose, Correction.laid(BALL, OVER), paints)
    with pytest.raises(InputError, match=r"\[90, 0, 0\], though .* placement 2 show") as raised:
        turned(first, own, 5.0)
    assert raised.value.field == "placements[0].rotation_deg" and raised.value.file == "2-0.h5"
    said = [float(angle) for angle in raised.value.found.rpartition("[")[2].strip("]").split(",")]
    assert angle_deg(rotation_xyz(said) @ rotation_xyz(OVER).T) < 12.0


def test_a_wrong_rotation_of_a_symmetric_ball_is_not_refused_but_warned_of(caplog):
    """Turned by 180 degrees about its axis, this ball looks the same: two rotations agree equally well."""

    def symmetric(point):
        return 0.5 * (paints(point) + paints(point * [-1.0, -1.0, 1.0]))

    own = side(2, typed=(90.0, 0.0, 0.0))
    for view in own.problem.views:
        view.picture = photograph(view.pose, Correction.laid(BALL, OVER), symmetric)
    with caplog.at_level("WARNING"):
        turned(side(1, colours=symmetric), own, 5.0)
    assert "placement 2: the photographs agree better with several other rotations" in caplog.text


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("number", [1, 2])
def test_a_photograph_of_the_other_placement_is_refused_by_its_name(first, number):
    there = Correction.laid(BALL, OVER) if number == 1 else Correction()
    wrong = side(number, shown={2: there})
    with pytest.raises(InputError, match=rf"found {number}, though .* in placement {3 - number}") as raised:
        turned(*((wrong, side(2)) if number == 1 else (first, wrong)), 5.0)
    assert raised.value.field == "placement" and raised.value.file == f"{number}-2.h5"


# Two textures.


def textures(rng, count=200, scatter=0.4, difference=0.1):
    value = scatter * rng.normal(size=(count, 3))
    weights = rng.uniform(0.5, 2.0, (2, count))
    return Texture(value, weights[0]), Texture(value + difference * rng.normal(size=value.shape) + 3.0, weights[1])


def test_the_misfit_is_the_scatter_of_the_difference_over_that_of_both():
    """By the sum over texels; the weight of a difference is that of two independent errors together."""
    one, other = textures(np.random.default_rng(1))
    misfit, scatter = turned_texture._misfit(one, other)
    weight = 1.0 / (1.0 / one.weight + 1.0 / other.weight)
    weight /= weight.sum()
    a, b = (value - weight @ value for value in (one.value, other.value))
    assert scatter == pytest.approx(np.sum(weight[:, None] * (a * a + b * b)) / 3.0, rel=1e-12)
    assert misfit * scatter == pytest.approx(np.sum(weight[:, None] * (a - b) * (a - b)) / 3.0, rel=1e-12)


def test_textures_with_little_in_common_or_little_contrast_have_no_misfit():
    one, other = textures(np.random.default_rng(2))
    for count, is_known in ((39, False), (40, True)):
        shown = other._replace(weight=np.where(np.arange(len(other.weight)) < count, other.weight, 0.0))
        assert np.isfinite(turned_texture._misfit(one, shown)[0]) == is_known
    for contrast, is_known in ((0.08, False), (0.12, True)):
        pair = textures(np.random.default_rng(3), 4000, contrast, 0.0)
        assert np.isfinite(turned_texture._misfit(*pair)[0]) == is_known


def test_of_many_turns_of_a_ball_its_own_has_the_least_misfit_by_far():
    rng, problem = np.random.default_rng(4), side(1, poses=POSES[:1]).problem
    turns = np.stack([rotation_xyz(angles) for angles in rng.uniform(-180.0, 180.0, (450, 3))])
    unit = problem.texels.position / BALL.ball_mm
    at = rotation_xyz((30.0, 20.0, -60.0))
    here = Texture(np.log(paints(unit)), np.ones(len(unit)))
    for number in (0, 199, 200, 449):
        # A point carries the paint of where it was in the first placement.
        brighter = np.array([1.3, 0.8, 1.1])  # lamps differ
        there = Texture(np.log(brighter * paints(unit @ (at.T @ turns[number] @ at))), np.ones(len(unit)))
        misfits = turned_texture._misfits(problem, here, there, at, turns)
        assert misfits[number] < 0.05 and (np.delete(misfits, number) > 2.0 * misfits[number]).all()
        # Where the second placement shows a small cap, few turns bring enough of it to where the first was seen.
        cap = there._replace(weight=(unit[:, 2] > 0.9).astype(float))
        assert np.isinf(turned_texture._misfits(problem, here, cap, at, turns)).all()
    same = turned_texture._misfits(problem, here, here, at, np.eye(3)[None])
    assert same[0] < 0.01
    faint = Texture(0.05 * here.value, here.weight)
    assert np.isinf(turned_texture._misfits(problem, faint, faint, at, np.eye(3)[None])).all()


def test_the_misfit_under_a_turn_is_that_of_the_textures_that_it_brings_together():
    """Against `_misfit`, of textures that are known at every point, where half of the ball is seen."""
    problem = side(1, poses=POSES[:1]).problem
    unit, (one, other) = problem.texels.position / BALL.ball_mm, (np.eye(3), rotation_xyz((0.0, 0.0, 90.0)))
    carried = np.log(paints(unit, 0.5))
    here = Texture(np.log(paints(unit)), np.ones(len(unit)))
    there = Texture(carried, (unit[:, 1] > 0.0).astype(float))
    for turn in (one, other):
        # A quarter turn about the axis of the texture's columns leaves the grid's points on the grid.
        moved = np.log(paints(unit @ turn.T, 0.5))
        seen = ((unit @ turn.T)[:, 1] > 0.0).astype(float)
        exact, _ = turned_texture._misfit(here, Texture(moved, seen))
        found = turned_texture._misfits(problem, here, there, np.eye(3), turn[None])
        assert found[0] == pytest.approx(exact, rel=0.05)


# What else it tells.


def test_an_estimate_with_a_turn_is_that_of_both_measurements_together():
    """Against the sum of their information, which is inverted at once."""
    estimate, found = whole(), Turned(np.array([0.4, -0.7, 1.1]), np.diag([0.02, 0.05, 0.1]) + 0.01)
    told = with_turn(estimate, found)
    measured = np.zeros((3, COUNT + 3))
    measured[:, 3:6] = np.eye(3)
    information = np.linalg.inv(estimate.covariance) + measured.T @ np.linalg.inv(found.covariance) @ measured
    right = np.linalg.solve(estimate.covariance, estimate.probable)
    right += measured.T @ np.linalg.solve(found.covariance, found.rotation_deg)
    np.testing.assert_allclose(told.covariance, np.linalg.inv(information), atol=1e-9)
    np.testing.assert_allclose(told.probable, np.linalg.solve(information, right), atol=1e-9)


def test_what_was_corrected_moves_with_the_turn_and_what_is_as_typed_stays():
    estimate = whole()
    told = with_turn(estimate, Turned(np.array([0.4, -0.7, 1.1]), 0.01 * np.eye(3)))
    typed = np.flatnonzero(estimate.values == 0.0)
    assert (told.values[typed] == 0.0).all() and len(typed) == 3
    np.testing.assert_array_equal(told.values[3:6], told.probable[3:6])
    moved = [n for n in range(COUNT) if n not in (*typed, 3, 4, 5)]
    change = (told.probable - estimate.probable)[moved]
    np.testing.assert_allclose((told.values - estimate.values)[moved], change, atol=1e-12)
    assert (np.abs(change) > 1e-4).all()
    assert with_turn(estimate, None) is estimate
