"""Drawing directions from the light: densities that integrate to 1, frequencies that match them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from irodori.light.environment_file import Environment, directions
from irodori.light.light_sampling import light_densities, light_sampler, sample_lights, sampler_of


def densities(sampler, unit):
    out = np.empty(len(unit))
    light_densities(sampler, np.ascontiguousarray(unit), out)
    return out


def drawn(sampler, count, seed=0):
    out, density = np.empty((count, 3)), np.empty(count)
    sample_lights(sampler, np.random.default_rng(seed).uniform(size=(count, 2)), out, density)
    return out, density


@given(height=st.integers(1, 30), width=st.integers(1, 40), seed=st.integers(0, 2**32 - 1), spread=st.floats(0, 8))
@settings(deadline=None, max_examples=60)
def test_the_density_integrates_to_one_and_is_power_over_the_whole(height, width, seed, spread):
    rng = np.random.default_rng(seed)
    power = np.exp(spread * rng.normal(size=(height, width))) * (rng.uniform(size=(height, width)) < 0.7)
    unit, solid_angle = directions(width, height)
    density = densities(light_sampler(power), unit.reshape(-1, 3)).reshape(height, width)
    assert (density * solid_angle).sum() == pytest.approx(1.0, rel=1e-9)
    expected = power / (power * solid_angle).sum() if power.any() else np.full(power.shape, 1 / (4 * np.pi))
    assert np.allclose(density, expected, rtol=1e-6, atol=1e-9 * expected.max())


@pytest.mark.parametrize("seed", range(3))
def test_frequencies_match_the_density(seed):
    rng = np.random.default_rng(seed)
    power = rng.gamma(0.5, size=(9, 14))
    power[4] = power[2, 3] = 0.0
    sampler = light_sampler(power)
    unit, density = drawn(sampler, 200_000, seed)
    assert np.allclose(np.linalg.norm(unit, axis=1), 1.0)
    # The density returned is that of the direction returned (edges of pixels aside, where rounding decides).
    assert (np.isclose(densities(sampler, unit), density, rtol=1e-9)).mean() > 0.9999
    row = np.minimum((np.arccos(unit[:, 2]) / np.pi * 9).astype(int), 8)
    column = (np.arctan2(unit[:, 1], unit[:, 0]) % (2 * np.pi) / (2 * np.pi) * 14).astype(int) % 14
    counts = np.bincount(row * 14 + column, minlength=9 * 14)
    expected = power * directions(14, 9)[1]
    expected = expected.ravel() / expected.sum() * len(unit)
    assert (counts[expected == 0] <= 1).all()
    often = expected > 5
    assert stats.chisquare(counts[often], expected[often] * counts[often].sum() / expected[often].sum()).pvalue > 1e-3


@pytest.mark.stability(stage="environment", case="one-texel sun")
@pytest.mark.stability(stage="environment", case="poles and seam")
@pytest.mark.parametrize("place", [(0, 0), (0, 63), (31, 40), (15, 0), (15, 63), (20, 31)])
def test_a_sun_of_one_texel_gets_every_sample(place):
    power = np.zeros((32, 64))
    power[place] = 1e6
    unit, density = drawn(light_sampler(power), 2000)
    assert np.allclose(density, 1 / directions(64, 32)[1][place], rtol=1e-9)
    theta, azimuth = np.arccos(unit[:, 2]), np.arctan2(unit[:, 1], unit[:, 0]) % (2 * np.pi)
    assert np.abs(theta / np.pi * 32 - place[0] - 0.5).max() <= 0.5 + 1e-6
    turn = (azimuth / (2 * np.pi) * 64 - place[1] - 0.5 + 32) % 64 - 32
    assert np.abs(turn).max() <= 0.5 + 1e-6


def test_samples_within_a_polar_pixel_are_even_in_solid_angle():
    unit, _ = drawn(light_sampler(np.array([[1.0], [0.0], [0.0]])), 20_000)
    height = (1 - unit[:, 2]) / (1 - np.cos(np.pi / 3))
    assert stats.kstest(height, "uniform").pvalue > 1e-3


def test_light_at_the_ends_of_the_unit_square():
    power = np.zeros((5, 7))
    power[2, 3] = power[4, 6] = 1.0
    sampler = light_sampler(power)
    ends = np.array([[0.0, 0.0], [np.nextafter(1, 0), np.nextafter(1, 0)], [0.0, np.nextafter(1, 0)]])
    out, density = np.empty((3, 3)), np.empty(3)
    sample_lights(sampler, ends, out, density)
    assert np.isfinite(out).all() and (density > 0).all()


@pytest.mark.stability(stage="environment", case="all-black")
def test_black_light_is_sampled_evenly():
    unit, density = drawn(light_sampler(np.zeros((6, 8))), 20_000)
    assert np.allclose(density, 1 / (4 * np.pi))
    assert stats.kstest(unit[:, 2], stats.uniform(-1, 2).cdf).pvalue > 1e-3


@pytest.mark.stability(stage="environment", case="not finite radiance")
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_radiance_that_is_none_is_refused(value):
    power = np.ones((4, 8))
    power[1, 2] = value
    with pytest.raises(ValueError, match="negative or not finite"):
        light_sampler(power)


def test_an_environment_is_sampled_by_its_power_over_the_wavelengths():
    basis = np.stack([np.ones(61), np.linspace(-1, 2, 61)], axis=1)
    coefficients = np.random.default_rng(1).uniform(0, 1, (6, 12, 2)).astype(np.float32)
    coefficients[3, 4] = [1.0, -4.0]  # darker than nothing in the sum
    sampler = sampler_of(Environment(coefficients, basis, np.ones((2, 4, 2), np.float32)))
    density = densities(sampler, directions(12, 6)[0].reshape(-1, 3)).reshape(6, 12)
    power = np.maximum((coefficients @ basis.T).sum(axis=-1), 0.0)
    assert density[3, 4] == 0.0
    assert np.allclose(density / density.max(), power / power.max(), rtol=1e-5)
