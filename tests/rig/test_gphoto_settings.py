"""A camera's choices as text, read as the numbers that they mean."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated_gphoto2 import SHUTTER

from irodori.capture.camera.gphoto_settings import NUMERIC, TOLERANCE, WIDGETS, find_choice, means, parse_number


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("1/50", 0.02), ("0.0200s", 0.02), ("10/25", 0.4), ("30", 30.0), ("1.3", 1.3), ("0.02 s", 0.02),
        ("f/8", 8.0), ("f/1.8", 1.8), ("F8", 8.0), ("5.6", 5.6), ("100", 100.0), ("ISO 100", 100.0),
        ("Auto", None), ("bulb", None), ("Lo 1", None), ("1/0", None), ("", None), ("implicit auto", None),
    ],
)  # fmt: skip
def test_a_choice_is_read_as_the_number_that_it_means(text, number):
    assert parse_number(text) == number


@given(st.sampled_from(SHUTTER), st.floats(-0.9 * TOLERANCE, 0.9 * TOLERANCE))
def test_an_exposure_within_the_tolerance_finds_its_own_choice(text, off):
    assert find_choice("exposure_s", parse_number(text) * (1.0 + off), ["bulb", *SHUTTER]) == text


@given(st.floats(1e-4, 100.0), st.lists(st.sampled_from(SHUTTER)))
def test_no_choice_is_taken_for_a_number_that_it_is_not(wanted, choices):
    found = find_choice("exposure_s", wanted, choices)
    close = [c for c in choices if math.isclose(parse_number(c), wanted, rel_tol=TOLERANCE)]
    assert (found is None) == (not close)
    assert found is None or (found in close and means("exposure_s", found, wanted))


def test_words_are_compared_whole():
    choices = ["RAW + Large Fine JPEG", "mRAW", "RAW"]
    assert find_choice("image_format", "raw", choices) == "RAW"
    assert find_choice("image_format", "NEF (Raw)", choices) is None


def test_every_numeric_setting_has_widgets():
    assert set(NUMERIC) <= set(WIDGETS)
