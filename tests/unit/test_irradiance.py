"""The irradiance map against sums over all pixels and against closed forms; the size it takes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shortcuts import irradiance_map

from irodori.light.environment_file import directions, row_solid_angles
from irodori.light.equirectangular import look_up
from irodori.light.irradiance import Integrator, fitted_irradiance_map, irradiance_at, midpoints
from irodori.reflection.coat import passed_array


def interpolated(width, height):
    """Return the directions of pixels, and the solid angles for which they count in an interpolated picture."""
    return directions(width, height)[0], np.repeat(row_solid_angles(width, height)[:, None], width, axis=1)


def test_a_pixel_counts_with_the_integral_of_its_share_in_the_interpolated_picture():
    """By the mean over many directions of a picture with one bright pixel, at a pole and elsewhere."""
    rng, (width, height) = np.random.default_rng(5), (12, 6)
    towards = rng.normal(size=(2_000_000, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    for row in range(height):
        picture, out = np.zeros((height, width, 1)), np.empty((len(towards), 1))
        picture[row, 4] = 1.0
        look_up(picture, towards, out)
        assert 4.0 * np.pi * out.mean() == pytest.approx(row_solid_angles(width, height)[row], rel=0.02)
    assert row_solid_angles(width, height).sum() * width == pytest.approx(4.0 * np.pi, rel=1e-12)


def exact(coefficients, normals):
    """Σ max(N·ω, 0) L dΩ over all pixels, and the same of |L|."""
    unit, solid_angle = interpolated(coefficients.shape[1], coefficients.shape[0])
    light = coefficients.reshape(-1, coefficients.shape[2]) * solid_angle.reshape(-1, 1)
    cosine = np.maximum(normals.reshape(-1, 3) @ unit.reshape(-1, 3).T, 0.0)
    power = cosine @ np.linalg.norm(light, axis=1)
    return (cosine @ light).reshape(*normals.shape[:-1], -1), power.reshape(normals.shape[:-1])


def random_normals(seed, count=200):
    normals = np.random.default_rng(seed).normal(size=(count, 3))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


@pytest.mark.parametrize("size", [(1000, 500), (514, 258), (256, 128)])
def test_constant_light_gives_pi_everywhere(size):
    radiance = np.array([1.0, 0.0, 7.5])
    out = irradiance_map(np.tile(radiance.astype(np.float32), (size[1], size[0], 1)), 64, 32)
    assert np.abs(out / np.pi - radiance).max() <= 0.0005 * 7.5
    assert np.abs(out[..., 0] / np.pi - 1).max() <= 0.0005


@pytest.mark.stability(stage="environment", case="one-texel sun")
@pytest.mark.stability(stage="environment", case="poles and seam")
@pytest.mark.parametrize(
    "place", [(0, 0), (0, 130), (3, 10), (60, 200), (63, 255), (64, 0), (64, 128), (100, 255), (127, 17)]
)
def test_one_bright_texel_is_exact_everywhere(place):
    coefficients = np.zeros((128, 256, 2), dtype=np.float32)
    coefficients[place] = [5.0, 0.3]
    # The map's normals, and normals that have the texel on their horizon.
    sun = directions(256, 128)[0][place]
    beside = np.cross(sun, random_normals(1)) + 1e-3 * np.random.default_rng(2).normal(size=(200, 1)) * sun
    normals = np.concatenate([directions(40, 21)[0].reshape(-1, 3), beside / np.linalg.norm(beside, axis=1)[:, None]])
    expected, _ = exact(coefficients, normals)
    assert np.abs(Integrator(coefficients)(normals) - expected).max() <= 1e-6 * expected.max()


@pytest.mark.parametrize("n", [1.1, 1.5, 2.5])
def test_light_that_passes_a_coat_counts_by_its_angle(n):
    """Against the sum over all pixels, in even light, in light of random pixels, and in light of one."""
    normals, sun = random_normals(3), np.full((128, 256, 1), 1e-3, dtype=np.float32)
    sun[40, 70] = 500.0
    uneven = np.exp(2.0 * np.random.default_rng(4).normal(size=(128, 256, 2))).astype(np.float32)
    for coefficients in (np.ones((128, 256, 1), np.float32), uneven, sun):
        unit, solid_angle = interpolated(256, 128)
        cosine = np.maximum(normals @ unit.reshape(-1, 3).T, 0.0)
        expected = (cosine * passed_array(cosine, n, 0.0)) @ (coefficients * solid_angle[..., None]).reshape(
            cosine.shape[1], -1
        )
        found = Integrator(coefficients)(normals, lambda cosine: passed_array(cosine, n, 0.0))
        np.testing.assert_allclose(found, expected, rtol=2e-3)


@given(
    seed=st.integers(0, 2**32 - 1),
    height=st.integers(1, 80),
    width=st.integers(1, 160),
    bases=st.integers(1, 4),
    spread=st.floats(0.0, 6.0),
    signed=st.booleans(),
)
@settings(deadline=None, max_examples=60)
def test_random_light_is_exact_relative_to_each_normals_own_irradiance(seed, height, width, bases, spread, signed):
    rng = np.random.default_rng(seed)
    coefficients = np.exp(spread * rng.normal(size=(height, width, 1))) * rng.uniform(-signed, 1, (1, 1, bases))
    coefficients = coefficients.astype(np.float32)
    normals = random_normals(seed, 50)
    expected, power = exact(coefficients, normals)
    error = np.linalg.norm(Integrator(coefficients)(normals) - expected, axis=-1)
    assert (error <= 0.002 * power + 1e-6 * power.max()).all()
    assert error.max() <= 0.0005 * power.max()


@pytest.mark.stability(stage="environment", case="1×N images")
@pytest.mark.parametrize("size", [(1, 300), (300, 1), (1, 1), (7, 5), (9, 8)])
def test_pictures_of_one_row_or_one_column(size):
    coefficients = np.random.default_rng(3).uniform(0, 1, (*size, 2)).astype(np.float32)
    normals = random_normals(4)
    expected, _ = exact(coefficients, normals)
    assert np.abs(Integrator(coefficients)(normals) - expected).max() <= 0.0005 * expected.max()


@pytest.mark.stability(stage="environment", case="all-black")
@pytest.mark.parametrize("size", [(48, 96), (50, 70), (9, 200)])
def test_cells_of_every_level_hold_their_pixels_closely_and_all_their_light(size):
    """Cells that are too narrow would lose light at the horizon, and too wide ones cost the time that they save."""
    coefficients = np.random.default_rng(3).uniform(-1.0, 2.0, (*size, 2)).astype(np.float32)
    cells = Integrator(coefficients).cells
    (height, width), (unit, solid_angle) = size, interpolated(size[1], size[0])
    light = coefficients * solid_angle[..., None]
    length, side, end = np.linalg.norm(light, axis=-1), 8, 0
    for first, rows, columns in zip(cells.first, cells.rows, cells.columns, strict=True):
        assert (first, rows, columns) == (end, -(-height // side), -(-width // side))
        end = first + rows * columns
        for at in range(first, end, 1 if end - first < 12 else 5):
            row, column = divmod(at - first, columns)
            block = np.s_[row * side : (row + 1) * side, column * side : (column + 1) * side]
            apart = np.arccos(np.clip(unit[block] @ cells.centre[at], -1.0, 1.0)).max()
            assert apart <= cells.radius[at] <= 2.5 * apart + np.pi / height + np.pi / width
            sine = np.sin(cells.radius[at]) if cells.radius[at] < np.pi / 2 else 2.0
            assert cells.sine[at] == pytest.approx(sine)
            assert cells.power[at] == pytest.approx(length[block].sum(), rel=1e-5)
            moment = np.einsum("yxk,yxa->ka", light[block], unit[block])
            assert cells.moment[at] == pytest.approx(moment, rel=1e-4, abs=1e-5)
            assert cells.power_moment[at] == pytest.approx(
                np.einsum("yx,yxa->a", length[block], unit[block]), rel=1e-4, abs=1e-5
            )
        side *= 2
    assert end == len(cells.power) and rows * columns <= 32


@pytest.mark.parametrize("size", [(48, 96), (50, 70), (9, 200)])
def test_a_cells_radius_is_the_way_along_its_meridian_and_then_along_its_longest_parallel(size):
    cells, (height, width), side = Integrator(np.ones((*size, 1), np.float32)).cells, size, 8
    for first, rows, columns in zip(cells.first, cells.rows, cells.columns, strict=True):
        for row in range(rows):
            top, bottom = np.pi * np.array([row * side, min((row + 1) * side, height)]) / height
            longest = 1.0 if top < np.pi / 2 < bottom else max(np.sin(top), np.sin(bottom))
            for column in range(columns):
                left, right = 2 * np.pi * np.array([column * side, min((column + 1) * side, width)]) / width
                at, theta, azimuth = first + row * columns + column, (top + bottom) / 2, (left + right) / 2
                expected = (bottom - top) / 2 + longest * (right - left) / 2
                assert cells.radius[at] == pytest.approx(expected)
                centre = np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)
                assert cells.centre[at] == pytest.approx(centre)
        side *= 2


def test_a_black_sky_gives_nothing():
    found, errors = fitted_irradiance_map(np.zeros((16, 32, 2), np.float32), 0.002, 64)
    assert (found == 0).all() and errors["max_error"] == 0.0


def test_irradiance_of_a_smooth_sky_matches_spherical_harmonics():
    unit, _ = directions(512, 256)
    axis = np.array([0.48, -0.6, 0.64])
    cosine = unit @ axis
    # L = 2 + cos + (3 cos² - 1): the clamped cosine multiplies degrees 0, 1, 2 by π, 2π/3, π/4 (Ramamoorthi 2001).
    coefficients = (2 + cosine + (3 * cosine**2 - 1))[..., None].astype(np.float32)
    normal = directions(40, 20)[0] @ axis
    expected = 2 * np.pi + 2 * np.pi / 3 * normal + np.pi / 4 * (3 * normal**2 - 1)
    assert np.allclose(irradiance_map(coefficients, 40, 20)[..., 0], expected, rtol=0.0005)


@given(seed=st.integers(0, 2**32 - 1), factor=st.floats(1e-3, 1e3))
@settings(deadline=None, max_examples=20)
def test_irradiance_is_linear_and_turns_with_the_sky(seed, factor):
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0, 1, (2, 32, 64, 3)).astype(np.float32)
    one, other = irradiance_map(a, 16, 8), irradiance_map(b, 16, 8)
    both = irradiance_map((a + np.float32(factor) * b).astype(np.float32), 16, 8)
    assert np.allclose(both, one + factor * other, rtol=1e-3)
    # A quarter turn about the zenith: 16 columns of the sky are 4 columns of the map.
    assert np.allclose(irradiance_map(np.roll(a, 16, axis=1), 16, 8), np.roll(one, 4, axis=1), rtol=1e-5)


def test_light_from_above_does_not_reach_normals_below():
    sky = np.zeros((64, 128, 1), dtype=np.float32)
    sky[:32] = 1.0
    out = irradiance_map(sky, 32, 33)[..., 0]
    theta = np.pi * (np.arange(33) + 0.5) / 33
    # A hemisphere seen by a tilted plane: π (1 + cosθ) / 2.
    assert np.allclose(out, (np.pi * (1 + np.cos(theta)) / 2)[:, None], atol=0.001 * np.pi)


# --- the map's size ------------------------------------------------------------------------------------------------


def test_a_smooth_sky_takes_a_small_map_and_a_sun_a_large_one():
    smooth = (2 + directions(128, 64)[0][..., 2:]).astype(np.float32)
    _, errors = fitted_irradiance_map(smooth, 0.002, 512)
    assert errors["height"] <= 64 and errors["max_error"] <= 0.002
    sun = np.zeros((64, 128, 1), np.float32)
    sun[20, 3] = 1.0
    larger, errors = fitted_irradiance_map(sun, 0.004, 512)
    assert larger.shape == (errors["height"], 2 * errors["height"], 1)
    assert errors["height"] >= 128 and errors["max_error"] <= 0.004
    _, bounded = fitted_irradiance_map(sun, 1e-6, 64)
    assert bounded["height"] == 64 and bounded["max_error"] > 1e-6


@pytest.mark.parametrize(
    ("most", "max_error", "height"), [(20, 1e-6, 20), (50, 1e-6, 50), (50, 1.0, 32), (200, 0.008, 64)]
)
def test_a_map_has_the_first_of_doubled_heights_that_errs_little_and_states_its_errors_between_its_normals(
    most, max_error, height
):
    sky = np.random.default_rng(6).gamma(0.2, 1.0, (24, 48, 2)).astype(np.float32)
    sky[6, 10] = 60.0
    found, errors = fitted_irradiance_map(sky, max_error, most)
    assert found.shape == (height, 2 * height, 2) and errors["height"] == height and found.dtype == np.float32
    expected, _ = exact(sky, directions(2 * height, height)[0])
    assert np.abs(found - expected).max() <= 2e-3 * expected.max()
    between = midpoints(height)
    true = Integrator(sky)(between)
    off = np.linalg.norm(irradiance_at(found, between) - true, axis=1) / np.linalg.norm(true, axis=1).max()
    assert (errors["max_error"], errors["mean_error"]) == pytest.approx((off.max(), off.mean()))
    assert off.max() <= max_error or height == most


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("place", [(0, 5), (31, 127), (32, 0), (12, 64)])
def test_the_stated_error_holds_at_any_normal(place):
    sky = np.full((64, 128, 1), 1e-4, np.float32)
    sky[place] = 100.0
    found, errors = fitted_irradiance_map(sky, 0.01, 256)
    normals = np.concatenate([random_normals(7, 4000), [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    expected, _ = exact(sky, normals)
    worst = np.abs(irradiance_at(found, normals) - expected).max() / expected.max()
    assert worst <= 1.1 * errors["max_error"] <= 0.011


def test_midpoints_are_the_corners_between_four_pixels_and_the_poles():
    found = midpoints(3)
    theta, azimuth = np.repeat([np.pi / 3, 2 * np.pi / 3], 6), np.tile(np.arange(6) * np.pi / 3, 2)
    corners = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=1)
    np.testing.assert_allclose(found, [[0, 0, 1], [0, 0, -1], *corners], atol=1e-12)
    # Of many an even selection: in each of 8 x 16 parts of the grid nearly as many.
    many = midpoints(400)[2:]
    row = np.arccos(many[:, 2]) / np.pi * 400
    column = np.arctan2(many[:, 1], many[:, 0]) % (2 * np.pi) / np.pi * 400
    assert np.abs(row - np.rint(row)).max() < 1e-6 and np.abs(column - np.rint(column)).max() < 1e-6
    assert len(np.unique(np.rint(row) * 800 + np.rint(column) % 800)) == len(many) > 30_000
    parts = np.histogram2d(row, column % 800, (8, 16), ((0.5, 399.5), (-0.5, 799.5)))[0]
    assert parts.min() > 0.9 * parts.mean() and parts.max() < 1.1 * parts.mean()


def test_midpoints_are_between_the_normals_and_bounded_in_number():
    few, many = midpoints(8), midpoints(512)
    assert len(few) == 2 + 7 * 16 and 30_000 < len(many) <= 2 + 32_768
    assert np.allclose(np.linalg.norm(many, axis=1), 1.0)
    nearest = (few[2:] @ directions(16, 8)[0].reshape(-1, 3).T).max(axis=1)
    assert np.degrees(np.arccos(nearest)).min() > 0.5 * 180 / 8


@pytest.mark.stability(stage="environment", case="poles and seam")
def test_looking_up_is_continuous_over_poles_and_seam():
    picture = np.random.default_rng(5).uniform(0, 1, (16, 32, 2)).astype(np.float32)
    azimuth = np.linspace(0, 2 * np.pi, 7)
    for pole in (1e-7, np.pi - 1e-7):
        here = np.stack([np.sin(pole) * np.cos(azimuth), np.sin(pole) * np.sin(azimuth),
                         np.full(7, np.cos(pole))], axis=-1)  # fmt: skip
        there = here * [-1, -1, 1]
        assert np.allclose(irradiance_at(picture, here), irradiance_at(picture, there), atol=1e-5)
    left, right = np.array([[0.6, 1e-9, 0.8], [0.6, -1e-9, 0.8]])
    assert np.allclose(irradiance_at(picture, left), irradiance_at(picture, right), atol=1e-6)
    unit = directions(32, 16)[0]
    assert np.allclose(irradiance_at(picture, unit), picture, atol=1e-5)
