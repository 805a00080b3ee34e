"""Small balls: their outline in a picture, the normals within it, and lamps that their shading determines."""

import numpy as np
import pytest

from irodori.core.errors import InputError
from irodori.rectification.circle_search import Circle, circle_of_mask, find_circle
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
