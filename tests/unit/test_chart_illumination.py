"""Uneven light told from the chart itself: recovered to a percent, or said not to be known."""

from dataclasses import replace

import numpy as np
import pytest
from chart_pictures import SPECTRA, light_field, noisy, sensitivities, shot, truth, view
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from irodori.calibration.chart import Located, read_located
from irodori.calibration.illumination import illumination

WIDTH, HEIGHT, PITCH = 480, 340, 66
MAP = view(WIDTH, HEIGHT, PITCH, 2.0)
PLACE = Located(truth(MAP), 30.0, 4, 6, 0.87 * PITCH, {})
EVEN = shot([MAP], WIDTH, HEIGHT)


def at_patches(field: np.ndarray) -> np.ndarray:
    """A field at the patches, (24, bands), the mean of each band 1."""
    x, y = PLACE.centres_px.T
    values = np.stack([ndimage.map_coordinates(band, [y, x], order=1) for band in np.moveaxis(field, -1, 0)], axis=1)
    return values / values.mean(axis=0)


def told(picture, place=PLACE):
    return illumination(picture, np.ones(picture.shape[:2], bool), place, "x.h5")


def off(found, field) -> float:
    return float(np.abs(found.field / at_patches(field) - 1.0).max())


@given(
    seed=st.integers(0, 2**32 - 1),
    fall=st.floats(0.0, 0.5),
    lean=st.floats(-0.5, 0.5),
    noise=st.floats(0.0, 0.01),
)
@settings(deadline=None, max_examples=5)
def test_known_light_is_recovered_to_a_percent_or_not_corrected(seed, fall, lean, noise):
    field = light_field(WIDTH, HEIGHT, fall, lean)
    found = told(noisy(EVEN * field, np.random.default_rng(seed), noise, 0.7))
    assert found.correctable or found.standard_error > 0.01
    if found.correctable:
        assert off(found, field) < 0.01


@pytest.mark.parametrize(("fall", "lean"), [(0.4, 0.0), (0.0, 0.4), (0.3, -0.3)])
@pytest.mark.parametrize("noise", [0.001, 0.01])
def test_ordinary_vignetting_is_corrected(fall, lean, noise):
    field = light_field(WIDTH, HEIGHT, fall, lean)
    found = told(noisy(EVEN * field, np.random.default_rng(1), noise))
    assert found.correctable and "corrected" in found.reason
    assert off(found, field) < 0.01 < np.ptp(at_patches(field))
    assert found.degree == (2 if fall else 1)


def test_corrected_responses_are_those_of_even_light():
    field = light_field(WIDTH, HEIGHT, 0.4, 0.3)
    valid = np.ones((HEIGHT, WIDTH), bool)
    even = read_located(EVEN, valid, PLACE, "x.h5").mean
    reading = read_located(noisy(EVEN * field, np.random.default_rng(2), 0.003), valid, PLACE, "x.h5")
    corrected = reading.divided(told(EVEN * field).field).mean

    def scatter(mean):
        ratio = (mean / even)[LIGHT_PATCHES]
        return np.std(ratio / ratio.mean(axis=0))

    assert scatter(corrected) < 0.005 < 0.05 < scatter(reading.mean)


LIGHT_PATCHES = SPECTRA.mean(axis=1) > 0.15


@pytest.mark.parametrize("noise", [0.0, 0.003, 0.02])
def test_even_light_stays_even(noise):
    found = told(noisy(EVEN, np.random.default_rng(3), noise))
    assert found.correctable and np.abs(found.field - 1.0).max() < 0.01


def test_bands_that_fall_differently_get_a_field_each():
    fields = np.concatenate([light_field(WIDTH, HEIGHT, fall) for fall in (0.5, 0.3, 0.1)], axis=2)
    found = told(noisy(EVEN * fields, np.random.default_rng(4), 0.002))
    assert found.per_band and off(found, fields) < 0.01


def test_dirt_on_two_patches_does_not_rule_the_field():
    field = light_field(WIDTH, HEIGHT, 0.4)
    picture = noisy(EVEN * field, np.random.default_rng(5), 0.002)
    for number in (4, 18):
        x, y = PLACE.centres_px[number].astype(int)
        picture[y : y + 25, x : x + 25] *= 0.8
    found = told(picture)
    assert found.correctable and off(found, field) < 0.01


def test_scattered_light_changes_the_field_by_far_less_than_the_dark_frame():
    field = light_field(WIDTH, HEIGHT, 0.4)
    # Paper on one side reflects into the lens: a veil of 2 % of white over the left, none over the right.
    veil = 0.02 * np.linspace(1.0, 0.0, WIDTH)[None, :, None]
    veiled = told(noisy(EVEN * field + veil, np.random.default_rng(6), 0.001))
    assert off(veiled, field) < 0.1 * (veil.max() / EVEN.min())


def test_patches_too_small_for_slopes_are_not_corrected():
    found = told(EVEN, replace(PLACE, side_px=3.0, patch_side_px=np.nan))
    assert not found.correctable and "needed" in found.reason
    assert (found.field == 1.0).all() and np.isnan(found.standard_error)


def test_noise_that_hides_the_light_is_not_corrected():
    small = replace(PLACE, side_px=8.0, patch_side_px=np.nan)
    field = light_field(WIDTH, HEIGHT, 0.3, 0.5)
    found = told(noisy(EVEN * field, np.random.default_rng(7), 0.05), small)
    assert found.degree == 0 or (not found.correctable and "accepted 1%" in found.reason)
    assert (found.field == 1.0).all()


def test_without_the_patches_size_the_squares_tell_the_light():
    assert told(EVEN, replace(PLACE, patch_side_px=np.nan)).correctable


def test_six_bands_and_the_scale_of_responses_do_not_matter():
    six = shot([MAP], WIDTH, HEIGHT, SPECTRA @ sensitivities(6).T)
    field = light_field(WIDTH, HEIGHT, 0.4, 0.2)
    picture = noisy(six * field, np.random.default_rng(8), 0.002)
    found, scaled = told(picture), told(1e-6 * picture)
    assert found.field.shape == (24, 6) and off(found, field.repeat(6, axis=2)) < 0.01
    assert np.allclose(found.field, scaled.field, rtol=1e-6)
