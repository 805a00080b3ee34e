"""Small balls: their outline in a picture, the normals within it, and lamps that their shading determines."""

import math

import numpy as np
import pytest
from scipy.optimize import minimize

from irodori.core.errors import InputError
from irodori.geometry.circle_search import (
    Circle,
    _edges,
    _fitted,
    _outermost,
    _seen,
    _voted,
    circle_of_mask,
    find_circle,
)
from irodori.rectification.lamp_registration import geometry_of, register_lamps
from irodori.reflection.fresnel import fresnel_array
from irodori.reflection.lobe_arrays import evaluate

SIZE, BALL = (90, 120), Circle(66.3, 41.8, 27.4)
LAMP = np.array([-0.5, 0.4, 0.77]) / np.linalg.norm([-0.5, 0.4, 0.77])


def drawn(circle: Circle = BALL, ring: float = 0.0, seen: float = 1.0) -> np.ndarray:
    """Return a shaded ball, each pixel the mean of 16 places; it may have a bright ring, and a part cut away."""
    fine = Circle(4.0 * circle.x + 1.5, 4.0 * circle.y + 1.5, 4.0 * circle.radius)
    normals = fine.normals((4 * SIZE[0], 4 * SIZE[1]))
    shade = np.nan_to_num(0.3 + 0.7 * np.maximum(normals @ LAMP, 0.0), nan=0.02)
    if ring:
        shade = np.where(np.abs(np.hypot(normals[..., 0], normals[..., 1]) - ring) < 0.04, 0.9, shade)
    rows, columns = np.indices(shade.shape)
    angle = np.arctan2(rows - fine.y, columns - fine.x) / (2.0 * np.pi) % 1.0
    shade = np.where(angle < seen, shade, 0.02)
    return shade.reshape(SIZE[0], 4, SIZE[1], 4).mean(axis=(1, 3))


@pytest.mark.parametrize("ring", [0.0, 0.55])
@pytest.mark.parametrize("circle", [BALL, Circle(40.2, 50.6, 21.0)])
def test_the_outline_of_a_drawn_ball_is_found_within_a_third_of_a_pixel(circle, ring):
    noise = 0.01 * np.random.default_rng(3).standard_normal(SIZE)
    found = find_circle(drawn(circle, ring) + noise, "ball.png")
    assert np.abs(np.subtract(found, circle)).max() < 0.34


def test_half_of_an_outline_is_enough_and_a_quarter_is_refused():
    assert np.abs(np.subtract(find_circle(drawn(seen=0.6), "ball.png"), BALL)).max() < 1.0
    with pytest.raises(InputError, match="outline") as caught:
        find_circle(drawn(seen=0.22), "ball.png")
    assert caught.value.accepted.startswith("one ball, whole")


def test_a_picture_without_edges_is_refused():
    with pytest.raises(InputError, match="without edges"):
        find_circle(np.full(SIZE, 0.4), "grey.png")


def test_normals_point_to_where_the_circle_shows_them():
    normals = BALL.normals(SIZE)
    inside = np.isfinite(normals[..., 0])
    assert inside.sum() == pytest.approx(np.pi * BALL.radius**2, rel=0.01)
    rows, columns = np.nonzero(inside)
    a, b, c = normals[inside].T
    np.testing.assert_allclose(BALL.x + BALL.radius * a, columns)
    np.testing.assert_allclose(BALL.y - BALL.radius * b, rows)
    np.testing.assert_allclose(a * a + b * b + c * c, 1.0)
    assert (c > 0.0).all()


def test_the_circle_of_a_mask_has_its_centre_and_area_and_what_is_no_disc_is_refused():
    mask = np.isfinite(BALL.normals(SIZE)[..., 0]).astype(float)
    mask[2:6, 3:9] = 1.0  # a smaller bright part does not count
    assert np.abs(np.subtract(circle_of_mask(mask, "mask.png"), BALL)).max() < 0.2
    # A mask that a person has painted: its edge goes in and out by a pixel.
    rows, columns = np.indices(SIZE)
    turn = np.arctan2(rows - BALL.y, columns - BALL.x)
    ragged = np.hypot(rows - BALL.y, columns - BALL.x) < BALL.radius + np.sin(12.0 * turn)
    assert np.abs(np.subtract(circle_of_mask(ragged.astype(float), "mask.png"), BALL)).max() < 0.2
    mask[30:50, :] = 1.0
    with pytest.raises(InputError, match="no disc"):
        circle_of_mask(mask, "mask.png")


def photographed(lamps: np.ndarray, level: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return responses, normals, views and weights of 200 points of a ball of one paint, with 0.2 % of noise."""
    rng = np.random.default_rng(6)
    normal = rng.normal(size=(400, 3))
    normal = (normal / np.linalg.norm(normal, axis=1)[:, None])[normal[:, 2] > 0.3 * np.linalg.norm(normal, axis=1)]
    view = np.broadcast_to([0.0, 0.0, 1.0], normal.shape)
    angles = geometry_of(normal, view, lamps)
    cosine = np.maximum(np.cos(angles[..., 0]), 0.0)
    gloss = 1.5 * evaluate("gaussian", 0.35, angles) * fresnel_array(np.cos(angles[..., 2]), 1.5, 0.0)
    albedo = rng.uniform(0.3, 0.7, (len(normal), 1))
    weight = (normal @ lamps.T > 0.2).astype(float)
    response = level * (albedo * cosine + gloss) * (1.0 + 0.002 * rng.standard_normal(cosine.shape))
    return response, normal, view, weight


def test_levels_and_directions_of_lamps_follow_from_the_shading_of_a_ball():
    lamps = np.array([[0.5, 0.2, 0.8], [-0.5, 0.3, 0.8], [0.1, -0.6, 0.8], [-0.2, 0.6, 0.7], [0.0, 0.1, 1.0]])
    lamps /= np.linalg.norm(lamps, axis=1)[:, None]
    level = np.array([1.04, 0.97, 1.02, 0.95, 1.0])
    level /= np.exp(np.log(level).mean())
    given = photographed(lamps, level)
    exact = register_lamps(*given, lamps, error_deg=0.0, n=1.5, k=0.0)
    assert np.array_equal(exact.direction, lamps) and exact.moved_deg.max() < 1e-5
    np.testing.assert_allclose(exact.level, level, atol=0.002)
    off = lamps + np.radians(2.0) * np.cross(lamps, [0.0, 1.0, 0.0])
    off /= np.linalg.norm(off, axis=1)[:, None]
    found = register_lamps(*given, off, error_deg=3.0, n=1.5, k=0.0)
    apart = np.degrees(np.arccos(np.clip((found.direction * lamps).sum(axis=1), -1.0, 1.0)))
    before = np.degrees(np.arccos(np.clip((off * lamps).sum(axis=1), -1.0, 1.0)))
    assert apart.max() < 0.5 < 1.0 < before.min()
    np.testing.assert_allclose(found.level, level, atol=0.01)
    with pytest.raises(ValueError, match="3 photographs"):
        register_lamps(given[0][:, :3], *given[1:3], given[3][:, :3], lamps[:3], error_deg=0.0, n=1.5, k=0.0)


FIVE = np.array([[0.5, 0.2, 0.8], [-0.5, 0.3, 0.8], [0.1, -0.6, 0.8], [-0.2, 0.6, 0.7], [0.0, 0.1, 1.0]])
FIVE /= np.linalg.norm(FIVE, axis=1)[:, None]


def spoilt(count: int, index: float, seed: int = 3) -> tuple[np.ndarray, ...]:
    """Return responses, normals, views and weights of a few points, of which a fifth are off by far."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(count, 3)) * [0.4, 0.4, 0.0] + [0.0, 0.0, 1.0]
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    view = np.broadcast_to([0.0, 0.0, 1.0], normal.shape)
    angles = geometry_of(normal, view, FIVE)
    gloss = 2.0 * evaluate("gaussian", 0.3, angles) * fresnel_array(np.cos(angles[..., 2]), index, 0.0)
    cosine = np.maximum(np.cos(angles[..., 0]), 0.0)
    level = np.array([1.1, 0.9, 1.0, 1.05, 0.95])
    response = 40.0 * level * (rng.uniform(0.3, 0.7, (count, 1)) * cosine + gloss)
    response *= 1.0 + 0.02 * rng.standard_normal(cosine.shape)
    response *= np.where(rng.uniform(size=cosine.shape) < 0.2, rng.uniform(0.7, 1.4, cosine.shape), 1.0)
    return response, normal, view, rng.choice([0.0, 0.5, 1.0], p=[0.1, 0.2, 0.7], size=cosine.shape)


@pytest.mark.parametrize(("index", "error_deg"), [(1.0, 0.0), (1.0, 2.0), (1.5, 0.0)], ids=["matt", "moved", "gloss"])
def test_lamps_are_the_likeliest_of_a_cost_that_is_written_out(index, error_deg):
    """A photograph counts as a hundred readings of 2 % of its mean, far ones by their absolute value, priors in full.

    With a refractive index of 1 nothing is reflected but by the diffuse weights.
    """
    response, normal, view, weight = spoilt(16, index)
    mean = (weight * response).sum() / weight.sum()
    axes = [np.linalg.svd(one[None])[2][1:] for one in FIVE]

    def parted(x):
        level = np.exp([*x[:4], -sum(x[:4])])
        turns = np.radians(error_deg) * (x[4:14].reshape(5, 2) if error_deg else np.zeros((5, 2)))
        lamps = np.array([one + turn @ axis for one, turn, axis in zip(FIVE, turns, axes, strict=True)])
        return lamps / np.linalg.norm(lamps, axis=1)[:, None], level

    def cost(x):
        lamps, level = parted(x)
        angles, gloss = geometry_of(normal, view, lamps), 0.0
        if index > 1.0:
            lobe = evaluate("gaussian", math.exp(x[-1]), angles)
            gloss = math.exp(x[-2]) * lobe * fresnel_array(np.cos(angles[..., 2]), index, 0.0)
        lit, seen = level * np.maximum(np.cos(angles[..., 0]), 0.0), response / mean - level * gloss
        alpha = (weight * seen * lit).sum(axis=1) / (weight * lit**2).sum(axis=1)
        off = weight * (seen - alpha[:, None] * lit) / 0.02
        total = (100.0 / weight.sum(axis=0) * (np.sqrt(1.0 + off**2) - 1.0)).sum()
        return total + 0.5 * np.sum(x[4:14] ** 2) if error_deg else total

    first = np.zeros(14 if error_deg else 4)
    best = minimize(cost, np.append(first, [0.0, math.log(0.3)] if index > 1.0 else []), tol=1e-9)
    lamps, level = parted(best.x)
    found = register_lamps(response, normal, view, weight, FIVE, error_deg=error_deg, n=index, k=0.0)
    np.testing.assert_allclose(found.level, level, rtol=2e-3)
    np.testing.assert_allclose(found.direction, lamps, atol=2e-3)
    moved = np.degrees(np.arccos(np.clip((found.direction * FIVE).sum(axis=1), -1.0, 1.0)))
    np.testing.assert_allclose(found.moved_deg, moved, atol=1e-9)
    assert (moved.max() > 0.3) == bool(error_deg)
    assert np.log(found.level).sum() == pytest.approx(0.0, abs=1e-9)


def test_four_photographs_are_enough_in_any_order_and_unit_and_what_has_no_weight_has_no_say():
    response, normal, view, weight = (part[:, :4] if part.shape[1] == 5 else part for part in spoilt(12, 1.0, 5))
    found = register_lamps(response, normal, view, weight, FIVE[:4], error_deg=1.0, n=1.0, k=0.0)
    order = [2, 0, 3, 1]
    hidden = np.where(weight == 0.0, 1e3, 7.0 * response)[:, order]
    other = register_lamps(hidden, normal, view, weight[:, order], FIVE[order], error_deg=1.0, n=1.0, k=0.0)
    scale = (weight * response).sum() * 7.0 / (weight[:, order] * hidden).sum()
    assert scale == pytest.approx(1.0)
    np.testing.assert_allclose(other.level, found.level[order], rtol=1e-3)
    np.testing.assert_allclose(other.direction, found.direction[order], atol=1e-3)


# The circle, step by step.


def test_edges_lie_where_brightness_changes_most_and_point_to_the_brighter_side():
    """A dark disc on a bright ground, and a bright one on a dark ground, both blurred."""
    rows, columns = np.indices(SIZE)
    for sign in (1.0, -1.0):
        disc = 1.0 / (1.0 + np.exp(sign * (np.hypot(columns - BALL.x, rows - BALL.y) - BALL.radius) / 0.8))
        slope = np.stack([np.gradient(disc, axis=1), np.gradient(disc, axis=0)], axis=-1)
        place, towards = _edges(slope)
        away = place - [BALL.x, BALL.y]
        distance = np.hypot(*away.T)
        assert len(place) > 100 and np.abs(distance - BALL.radius).max() < 0.15
        np.testing.assert_allclose(np.hypot(*towards.T), 1.0)
        assert (sign * np.sum(away * towards, axis=1) / distance).max() < -0.98
    # No edge of a ground that brightens evenly, nor of one pixel of seven that are as steep as their neighbours.
    assert not len(_edges(np.ones((*SIZE, 2)))[0])


def on_circle(circle: Circle, count: int = 400, share: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Return places along a part of a circle, and directions towards its centre."""
    turn = 2.0 * math.pi * share * (np.arange(count) + 0.5) / count
    out = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return [circle.x, circle.y] + circle.radius * out, -out


def joined(*some) -> tuple[np.ndarray, np.ndarray]:
    return tuple(np.concatenate(parts) for parts in zip(*some, strict=True))


@pytest.mark.parametrize("inward", [1.0, -1.0])
@pytest.mark.parametrize("circle", [Circle(66.3, 41.8, 27.4), Circle(30.2, 60.6, 9.1), Circle(58.0, 44.0, 44.5)])
def test_most_votes_are_for_the_circle_on_which_edges_lie(circle, inward):
    place, towards = on_circle(circle)
    rng = np.random.default_rng(1)
    stray = rng.uniform(0.0, 90.0, (200, 2)), rng.normal(size=(200, 2))
    stray = stray[0], stray[1] / np.linalg.norm(stray[1], axis=1)[:, None]
    found = _voted(*joined((place, inward * towards), stray), SIZE)
    # To about a cell, of which there are 120 along the shorter side.
    assert np.abs(np.subtract(found, circle)).max() <= 1.5 * 90 / 120


def test_of_concentric_circles_the_largest_with_two_fifths_of_its_edges_is_the_balls():
    inner, outer = Circle(60.0, 44.0, 15.0), Circle(60.0, 44.0, 30.0)
    for share, is_seen in ((0.45, True), (0.35, False)):
        edges = joined(on_circle(inner), on_circle(outer, share=share))
        found = _outermost(*edges, inner, SIZE)
        assert found.radius == pytest.approx(30.0 if is_seen else 15.0, abs=1.0)
        assert _seen(*edges, outer, 0.02) == pytest.approx(share, abs=0.02)
    # Edges across a circle, and edges beside it, are none of its own.
    place, towards = on_circle(outer)
    across = towards[:, ::-1] * [1.0, -1.0]
    assert _seen(place, across, outer, 0.02) == 0.0 and _seen(place, towards, outer, 0.02) == 1.0
    for by, is_seen in ((0.015, 1.0), (0.025, 0.0)):
        for sign in (1.0, -1.0):
            beside = outer._replace(radius=outer.radius / (1.0 + sign * by))
            assert _seen(place, towards, beside, 0.02) == is_seen
    turned = math.radians(15.0)
    turned = towards @ np.array([[math.cos(turned), -math.sin(turned)], [math.sin(turned), math.cos(turned)]])
    assert _seen(place, turned, outer, 0.02) == 1.0
    turned = turned @ np.array([[math.cos(0.2), -math.sin(0.2)], [math.sin(0.2), math.cos(0.2)]])
    assert _seen(place, turned, outer, 0.02) == 0.0  # by 26 degrees


def test_a_circle_is_fitted_through_all_its_sectors_alike_and_past_edges_beside_it():
    true, start = Circle(60.4, 44.7, 30.2), Circle(60.0, 45.0, 30.0)
    plain = on_circle(true)
    assert np.abs(np.subtract(_fitted(*plain, start, 0.08), true)).max() < 1e-6
    # A reflection beside a fifth of the outline, twice as crowded.
    beside = on_circle(true._replace(radius=28.6), 160, 0.2)
    found = _fitted(*joined(plain, beside), start, 0.08)
    assert np.abs(np.subtract(found, true)).max() < 0.1
    # An ellipse is fitted by its mean radius, however crowded its edges are along one side.
    place, towards = on_circle(true)
    long = [true.x, true.y] + (place - [true.x, true.y]) * [1.01, 0.99]
    crowded = np.flatnonzero(place[:, 0] > true.x + 20.0).repeat(6)
    even, uneven = (_fitted(long[kept], towards[kept], start, 0.08) for kept in (slice(None), [*range(400), *crowded]))
    assert even.radius == pytest.approx(true.radius, rel=0.003)
    assert np.abs(np.subtract(uneven, even)).max() < 0.03
    # Of fewer edges than sectors nothing is fitted.
    few = tuple(part[::6] for part in plain)
    assert len(few[0]) < 72 and _fitted(*few, start, 0.08) is None
    assert _fitted(*(part[:72] for part in on_circle(true, 72)), start, 0.08) is not None


def test_the_circle_of_a_mask_is_that_of_its_brighter_half():
    rows, columns = np.indices(SIZE)
    distance = np.hypot(columns - 50.0, rows - 40.0)
    mask = np.where(distance < 20.0, 200, np.where(distance < 24.0, 90, 0)).astype(np.uint8)
    found = circle_of_mask(mask, "mask.png")
    assert np.abs(np.subtract(found, (50.0, 40.0, 20.0))).max() < 0.2
    assert circle_of_mask(1e-3 * mask, "mask.png") == found  # in whatever unit
    for wrong in (0 * mask, np.where(np.abs(columns - 50) < 10, mask, 0), np.full_like(mask, 255)):
        with pytest.raises(InputError, match=r"mask\.png.*a mask that is no disc.*bright on the ball"):
            circle_of_mask(wrong, "mask.png")
