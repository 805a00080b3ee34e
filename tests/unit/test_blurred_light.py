"""Light blurred for rough reflection, against sums over pixels, and the file that keeps it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ive

from irodori.core import store
from irodori.core.errors import InputError
from irodori.light.blurred_light import (
    WIDTHS_RAD,
    _bessel_series,
    _divided,
    _row_series,
    _thinned,
    prefiltered,
    row_angles,
)
from irodori.light.environment_file import Environment, directions
from irodori.light.equirectangular import look_up
from irodori.light.gloss_maps import GlossMaps


def blurred(coefficients, unit, width_rad):
    """Σ of power times the von Mises-Fisher lobe, over 4 x 4 parts of every pixel."""
    fine = coefficients.repeat(4, axis=0).repeat(4, axis=1)
    pixel, solid_angle = directions(fine.shape[1], fine.shape[0])
    kappa = width_rad**-2
    lobe = kappa / (2 * np.pi * -np.expm1(-2 * kappa)) * np.exp(kappa * (unit @ pixel.reshape(-1, 3).T - 1))
    return lobe @ (fine * solid_angle[..., None]).reshape(-1, fine.shape[2])


def looked_up(level, unit):
    out = np.empty((len(unit), level.shape[2]))
    look_up(level, np.ascontiguousarray(unit), out)
    return out


@pytest.mark.default_cases(2)
@pytest.mark.stability(stage="environment", case="poles and seam")
@pytest.mark.parametrize("place", [None, (0, 5), (63, 0), (32, 127), (20, 64)])
def test_blurred_light_is_the_sum_over_the_pixels_at_poles_and_seam_too(place):
    rng = np.random.default_rng(1)
    coefficients = rng.uniform(0, 1, (64, 128, 2)).astype(np.float32)
    unit = rng.normal(size=(20, 3))
    if place is not None:
        coefficients *= 1e-6
        coefficients[place] = [1e3, 10.0]
        unit[:10] = directions(128, 64)[0][place] + 0.03 * unit[:10]
    unit = np.concatenate([unit / np.linalg.norm(unit, axis=1, keepdims=True), [[0, 0, 1.0], [0, 0, -1.0]]])
    first, levels = prefiltered(coefficients)
    assert first + len(levels) == len(WIDTHS_RAD) and WIDTHS_RAD[first] < 2 * np.pi / 64
    power = (coefficients * directions(128, 64)[1][..., None]).sum(axis=(0, 1))
    for level, width_rad in zip(levels, WIDTHS_RAD[first:], strict=True):
        expected = blurred(coefficients, unit, width_rad)
        # A third of the width between pixels: bilinear look-up errs by up to 2 % of a sharp highlight's peak.
        assert np.abs(looked_up(level, unit) - expected).max() <= 0.02 * expected.max()
        kept = (level * directions(level.shape[1], level.shape[0])[1][..., None]).sum(axis=(0, 1))
        assert np.allclose(kept, power, rtol=0.006)


@pytest.mark.parametrize("row", [0, 1, -1])
def test_light_beside_a_pole_keeps_its_power_and_place_in_the_widest_blurs(row):
    coefficients = np.zeros((200, 400, 1), np.float32)
    coefficients[row, 30] = 1e4
    unit_, solid_angle = directions(400, 200)
    first, levels = prefiltered(coefficients, (len(WIDTHS_RAD) - 3, len(WIDTHS_RAD)))
    for level, width_rad in zip(levels, WIDTHS_RAD[first:], strict=True):
        own, weight = directions(level.shape[1], level.shape[0])
        power = level * weight[..., None]
        assert power.sum() == pytest.approx(1e4 * solid_angle[row, 30], rel=0.006)
        mean = np.einsum("yxk,yxa->a", power, own)
        assert mean / np.linalg.norm(mean) == pytest.approx(unit_[row, 30], abs=0.004)
        assert level.max() == pytest.approx(power.sum() / (2.0 * np.pi * width_rad**2), rel=0.1)


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("size", [(24, 48), (90, 60)])
def test_every_width_is_the_light_under_its_lobe_at_the_maps_own_places(size):
    """At the poles, the seam and between: light that varies from pixel to pixel, each shining evenly over its area.

    Between a map's places a look-up adds a sixth of their distance squared to the width's, which the map leaves out.
    """
    height, width = size
    rng, parts = np.random.default_rng(1), 6
    sky = rng.gamma(0.3, 1.0, (height, width, 2)).astype(np.float32)
    sky[0, 3], sky[height // 2, width - 1] = 60.0, 90.0
    unit_, solid_angle = directions(width * parts, height * parts)
    power = sky.repeat(parts, axis=0).repeat(parts, axis=1) * solid_angle[..., None]
    first, levels = prefiltered(sky)
    pitch = max(np.pi / height, 2.0 * np.pi / width)
    assert len(levels) == len(WIDTHS_RAD) - first and 1.0 <= WIDTHS_RAD[first] / (0.6 * pitch) < math.sqrt(2.0)
    for width_rad, level in zip(WIDTHS_RAD[first:], levels, strict=True):
        rows = level.shape[0]
        assert level.shape == (rows, 2 * rows, 2) and 3.0 <= rows * width_rad / np.pi < 3.0 + width_rad / np.pi
        kappa = 1.0 / (width_rad**2 - (np.pi / rows) ** 2 / 6.0)
        some = np.ix_(np.unique([0, 1, rows // 3, rows // 2, rows - 2, rows - 1]), np.arange(0, 2 * rows, rows // 4))
        cosine = directions(2 * rows, rows)[0][some].reshape(-1, 3) @ unit_.reshape(-1, 3).T
        lobe = kappa / (2.0 * np.pi * -np.expm1(-2.0 * kappa)) * np.exp(kappa * (cosine - 1.0))
        expected = lobe @ power.reshape(-1, 2)
        found = level[some].reshape(-1, 2)
        assert np.abs(found - expected).max() <= 4e-3 * expected.max()
        assert found == pytest.approx(expected, rel=0.015)


def test_only_the_widths_that_are_asked_for_are_made():
    sky = np.random.default_rng(3).uniform(0.0, 1.0, (24, 48, 1)).astype(np.float32)
    first, every = prefiltered(sky)
    for wanted, expected in (
        ((first + 2, first + 4), (first + 2, 2)),
        ((0, first + 1), (first, 1)),
        ((0, 1), (first, 1)),
    ):
        found, levels = prefiltered(sky, wanted)
        assert (found, len(levels)) == expected
        for one, other in zip(levels, every[found - first :], strict=False):
            assert one == pytest.approx(other, rel=5e-3)


@pytest.mark.parametrize("size", [(32, 64), (33, 50), (100, 200)])
def test_constant_light_stays_constant_when_blurred(size):
    for level in prefiltered(np.full((*size, 1), 3.0, np.float32))[1]:
        assert np.abs(level / 3.0 - 1.0).max() <= 0.01


@given(z=st.floats(300.0, 1e5), terms=st.integers(2, 1500))
@settings(deadline=None, max_examples=40)
def test_the_series_of_a_narrow_lobe_is_of_bessel_functions(z, terms):
    found = _bessel_series(np.zeros((1, 1)), np.array([[z]]), terms)[0]
    assert np.abs(found - ive(np.arange(terms), z)).max() <= 2e-6 * ive(0, z)


@pytest.mark.parametrize("size", [(3, 7), (70, 8), (2, 1)])
def test_the_series_of_a_row_is_that_of_light_which_is_even_over_each_pixel(size):
    """Also of more terms than there are pixels; written out: the integral of exp(-imφ) over each pixel."""
    height, width = size
    sky = np.random.default_rng(4).uniform(0.0, 1.0, (height, width, 2))
    found = _row_series(sky, 3 * width + 2)
    edges, solid_angle = 2.0 * np.pi * np.arange(width + 1) / width, directions(width, height)[1]
    for m in range(3 * width + 2):
        whole = edges if m == 0 else 1j * np.exp(-1j * m * edges) / m
        mean = np.diff(whole) * width / (2.0 * np.pi)
        expected = np.einsum("yxk,yx,x->yk", sky, solid_angle, mean)
        np.testing.assert_allclose(found[:, m], expected, atol=1e-5 * solid_angle.max() * width)


@pytest.mark.parametrize("parts", [1, 3])
def test_a_divided_row_keeps_its_light_each_part_by_its_solid_angle(parts):
    series = np.random.default_rng(5).normal(size=(4, 6, 2)).astype(np.complex64)
    found, theta = _divided(series, parts)
    fine = directions(1, 4 * parts)[1][:, 0]
    np.testing.assert_allclose(theta, row_angles(4 * parts))
    edges = np.cos(np.linspace(0.0, np.pi, 4 * parts + 1))
    np.testing.assert_allclose(np.cos(theta), (edges[1:] + edges[:-1]) / 2.0, atol=1e-12)
    for row in range(4):
        own = slice(row * parts, (row + 1) * parts)
        expected = fine[own, None, None] / fine[own].sum() * series[row]
        np.testing.assert_allclose(found[own], expected, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("height", [2, 7, 10])
def test_of_half_as_many_rows_each_has_the_light_of_those_about_it_and_beyond_a_pole_half_a_turn_away(height):
    series = np.random.default_rng(6).normal(size=(height, 5, 2)).astype(np.complex64)
    theta = row_angles(height)
    found, places = _thinned(series, theta)
    rows = height // 2
    np.testing.assert_allclose(places, np.pi * (np.arange(rows) + 0.5) / rows)
    expected = np.zeros((rows, 5, 2), complex)
    for one, angle in zip(series, theta, strict=True):
        at = angle / np.pi * rows - 0.5
        for row, share in ((math.floor(at), 1.0 - at % 1.0), (math.floor(at) + 1, at % 1.0)):
            turned = 1.0 if 0 <= row < rows else (-1.0) ** np.arange(5)[:, None]
            expected[min(max(row, 0), rows - 1)] += share * turned * one
    np.testing.assert_allclose(found, expected, atol=1e-5)


@given(height=st.integers(1, 40), width=st.integers(1, 60), seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=15)
def test_pictures_of_any_size_keep_their_power(height, width, seed):
    coefficients = np.random.default_rng(seed).uniform(0, 1, (height, width, 1)).astype(np.float32)
    power = (coefficients[..., 0] * directions(width, height)[1]).sum()
    for level in prefiltered(coefficients)[1]:
        assert (level[..., 0] * directions(level.shape[1], level.shape[0])[1]).sum() == pytest.approx(power, rel=0.01)


def test_gloss_maps_in_a_file(tmp_path):
    maps = GlossMaps.of(np.tile(np.float32([2.0, 0.5]), (128, 256, 1)))
    light = Environment(np.ones((8, 16, 2), np.float32), np.ones((61, 2)), np.ones((4, 8, 2), np.float32))
    light.save(tmp_path / "e.h5", store.Provenance("test"), gloss=maps)
    read = GlossMaps.load(tmp_path / "e.h5")
    assert read.first == maps.first
    assert all(np.array_equal(a, b) for a, b in zip(read.levels, maps.levels, strict=True))
    some = GlossMaps.load(tmp_path / "e.h5", (maps.first + 1, maps.first + 3))
    assert some.first == maps.first + 1 and len(some.levels) == 2
    assert np.array_equal(some.levels[1], maps.levels[2])
    finer = GlossMaps.load(tmp_path / "e.h5", (0, maps.first))
    assert finer.first == maps.first and len(finer.levels) == 1
    assert GlossMaps.stored(light) is None
    assert GlossMaps.stored(Environment.load(tmp_path / "e.h5")).first == maps.first
    light.save(tmp_path / "none.h5", store.Provenance("test"))
    assert GlossMaps.stored(Environment.load(tmp_path / "none.h5")) is None
    with pytest.raises(InputError, match="gloss/width"):
        GlossMaps.load(tmp_path / "none.h5")
