"""Drawing directions from the light: densities that integrate to 1, frequencies that match them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from sky_draws import densities, drawn, light_of, shares

from irodori.light.environment_file import Environment, directions
from irodori.rendering.reference.sky_sampling import make_sky


def at_random(count, seed=0):
    return np.random.default_rng(seed).uniform(size=(count, 2))


@given(height=st.integers(1, 30), width=st.integers(1, 40), seed=st.integers(0, 2**32 - 1), spread=st.floats(0, 8))
@settings(deadline=None, max_examples=60)
def test_the_density_integrates_to_one_and_is_the_power_above_its_mean(height, width, seed, spread):
    rng = np.random.default_rng(seed)
    power = np.exp(spread * rng.normal(size=(height, width))) * (rng.uniform(size=(height, width)) < 0.7)
    sky = make_sky(light_of(power))
    unit, solid_angle = directions(width, height)
    above = np.maximum(power - (power * solid_angle).sum() / (4 * np.pi), 0.0) * solid_angle
    if sky.power == 0.0:
        assert above.sum() <= 2e-5 * (power * solid_angle).sum() and (densities(sky, unit) == 0.0).all()
        return
    assert shares(sky).sum() == pytest.approx(1.0, rel=1e-5)
    # In a pixel's middle nothing is interpolated.
    found = densities(sky, unit) * np.hypot(unit[..., 0], unit[..., 1]) * 2 * np.pi**2 / (width * height)
    assert np.allclose(found, above / above.sum(), rtol=1e-3, atol=1e-4 * above.max() / above.sum())


@pytest.mark.parametrize("seed", range(3))
def test_frequencies_match_the_density(seed):
    rng = np.random.default_rng(seed)
    power = rng.gamma(0.5, size=(9, 14))
    power[4] = power[2, 3] = 0.0
    sky = make_sky(light_of(power))
    unit, density = drawn(sky, at_random(200_000, seed))
    assert np.allclose(np.linalg.norm(unit, axis=1), 1.0)
    # The density returned is that of the direction returned.
    assert (np.isclose(densities(sky, unit), density, rtol=1e-6)).mean() > 0.9999
    row = np.minimum((np.arccos(unit[:, 2]) / np.pi * 9).astype(int), 8)
    column = (np.arctan2(unit[:, 1], unit[:, 0]) % (2 * np.pi) / (2 * np.pi) * 14).astype(int) % 14
    counts = np.bincount(row * 14 + column, minlength=9 * 14)
    expected = shares(sky).ravel() * len(unit)
    assert (counts[expected == 0] <= 1).all()
    often = expected > 5
    assert stats.chisquare(counts[often], expected[often] * counts[often].sum() / expected[often].sum()).pvalue > 1e-3


@pytest.mark.stability(stage="environment", case="one-texel sun")
@pytest.mark.stability(stage="environment", case="poles and seam")
@pytest.mark.parametrize("place", [(0, 0), (0, 63), (31, 40), (15, 0), (15, 63), (20, 31)])
def test_a_sun_of_one_texel_gets_every_sample_under_its_tent(place):
    power = np.zeros((32, 64))
    power[place] = 1e6
    unit, density = drawn(make_sky(light_of(power)), at_random(2000))
    theta, azimuth = np.arccos(unit[:, 2]), np.arctan2(unit[:, 1], unit[:, 0]) % (2 * np.pi)
    down = theta / np.pi * 32 - place[0] - 0.5
    turn = (azimuth / (2 * np.pi) * 64 - place[1] - 0.5 + 32) % 64 - 32
    assert np.abs(down).max() <= 1 + 1e-6 and np.abs(turn).max() <= 1 + 1e-6
    # The outer half of a polar row is flat.
    along = np.where((down < 0) if place[0] == 0 else (down > 0) & (place[0] == 31), 1.0, 1 - np.abs(down))
    tent = np.maximum(along, 0.0) * np.maximum(1 - np.abs(turn), 0.0) * 32 * 64 / (2 * np.pi**2)
    assert np.allclose(density * np.sin(theta), tent, rtol=1e-6, atol=1e-6 * tent.max())
    # Under a tent both halves weigh the same, and flat ones twice as much.
    outer = (down < 0).mean() if place[0] == 0 else (down > 0).mean()
    assert outer == pytest.approx(0.5, abs=0.05) and (turn > 0).mean() == pytest.approx(0.5, abs=0.05)


def test_light_at_the_ends_of_the_unit_square():
    power = np.zeros((5, 7))
    power[2, 3] = power[4, 6] = 1.0
    end = np.nextafter(1, 0)
    unit, density = drawn(make_sky(light_of(power)), np.array([[0.0, 0.0], [end, end], [0.0, end], [end, 0.0]]))
    assert np.allclose(np.linalg.norm(unit, axis=1), 1.0)
    assert np.isfinite(density).all() and (density >= 0).all()


@pytest.mark.stability(stage="environment", case="all-black")
@pytest.mark.parametrize("level", [0.0, 3.0])
def test_black_and_even_light_is_not_drawn_from(level):
    sky = make_sky(light_of(np.full((6, 8), level)))
    assert sky.power == 0.0 and (densities(sky, directions(16, 12)[0]) == 0.0).all()


@pytest.mark.stability(stage="environment", case="not finite radiance")
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_radiance_that_is_none_is_refused(value):
    power = np.ones((4, 8))
    power[1, 2] = value
    with pytest.raises(ValueError, match="not finite"):
        make_sky(light_of(power))


def test_an_environment_is_drawn_by_its_power_over_the_wavelengths():
    basis = np.stack([np.ones(61), np.linspace(-1, 2, 61)], axis=1)
    coefficients = np.random.default_rng(1).uniform(0, 1, (6, 12, 2)).astype(np.float32)
    coefficients[3, 4] = [1.0, -4.0]  # darker than nothing in the sum
    sky = make_sky(Environment(coefficients, basis, np.ones((2, 4, 2), np.float32)))
    power = np.maximum((coefficients @ basis.T).sum(axis=-1), 0.0)
    alone = make_sky(light_of(power))
    assert power[3, 4] == 0.0
    assert np.allclose(shares(sky), shares(alone), rtol=1e-4, atol=1e-9)
    assert densities(sky, directions(12, 6)[0])[3, 4] < 1e-12  # interpolated with no weight of its neighbours
