"""From the scene's white to the screen: white stays white, the tone curve is the standard's, clipping is counted."""

import colour
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from irodori.colour.colorimetry import xyz_from_reflectance
from irodori.colour.display import rgb_from_xyz, srgb

#: IEC 61966-2-1 prints matrix and white with four decimals: half a unit of the last place of the matrix times the sum
#: of white's XYZ (3.04), and half a unit of white times the absolute row sum of the matrix (5.28).
ROUNDED_STANDARD = 0.5e-4 * (3.04 + 5.28)
LIGHTS = st.sampled_from(["D65", "A", "D50", "FL2", "LED-B3"])
WHITE = arrays(np.float64, 3, elements=st.floats(0.3, 1.3)).map(lambda v: v * [100, 0, 100] + [0, 100, 0])


@given(white=WHITE)
@settings(deadline=None)
def test_the_white_of_any_scene_becomes_1_1_1(white):
    rgb = rgb_from_xyz(white) @ white
    assert rgb == pytest.approx(np.ones(3), abs=ROUNDED_STANDARD)
    encoded, found = srgb().encode(rgb[None])
    assert encoded.tolist() == [[255, 255, 255]] and found.outside == 0


@given(light=LIGHTS, grey=st.floats(0.0, 1.0))
@settings(deadline=None)
def test_a_grey_surface_stays_grey_under_any_light(light, grey):
    xyz = xyz_from_reflectance(light) @ np.full(61, grey)
    rgb = rgb_from_xyz(xyz_from_reflectance(light).sum(axis=1)) @ xyz
    assert rgb == pytest.approx(np.full(3, grey), abs=ROUNDED_STANDARD)


@pytest.mark.parametrize("light", ["A", "D65", "D50"])
def test_colours_agree_with_the_librarys_cat16_and_srgb(light):
    white = xyz_from_reflectance(light).sum(axis=1)
    xyz = np.random.default_rng(2).uniform(1, 90, (200, 3)) * white / 100
    srgb = colour.RGB_COLOURSPACES["sRGB"]
    adapted = colour.adaptation.chromatic_adaptation_VonKries(
        xyz / 100, white / 100, colour.xy_to_XYZ(srgb.whitepoint), transform="CAT16"
    )
    expected = colour.XYZ_to_RGB(adapted, "sRGB", chromatic_adaptation_transform=None)
    assert xyz @ rgb_from_xyz(white).T == pytest.approx(expected, abs=1e-9)


def test_white_under_d65_needs_no_adaptation():
    d65 = colour.xy_to_XYZ(colour.RGB_COLOURSPACES["sRGB"].whitepoint) * 100
    assert rgb_from_xyz(d65) * 100 == pytest.approx(colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB, abs=1e-12)


@given(linear=arrays(np.float64, (8, 3), elements=st.floats(0.0, 1.0)))
@settings(deadline=None)
def test_encoding_is_the_standards_curve_rounded_to_8_bits(linear):
    # IEC 61966-2-1, both branches.
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1 / 2.4) - 0.055)
    encoded, found = srgb().encode(linear)
    assert encoded.dtype == np.uint8 and found.outside == 0
    assert np.abs(encoded - 255 * curve).max() <= 0.5 + 1e-6


def test_encoding_agrees_with_the_librarys_srgb_and_inverts_every_code():
    codes = np.repeat(np.arange(256)[:, None], 3, axis=1)
    linear = colour.RGB_COLOURSPACES["sRGB"].cctf_decoding(codes / 255)
    encoded, _ = srgb().encode(linear)
    assert np.array_equal(encoded, codes)


def test_black_and_white_are_0_and_255():
    encoded, _ = srgb().encode(np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]))
    assert np.array_equal(encoded, [[0, 0, 0], [255, 255, 255]])


@given(over=st.integers(0, 10), under=st.integers(0, 10))
@settings(deadline=None)
def test_the_share_outside_counts_pixels_and_not_channels(over, under):
    picture = np.full((5, 8, 3), 0.5)
    flat = picture.reshape(-1, 3)
    flat[:over] = [1.5, 0.2, 2.0]
    flat[20 : 20 + under, 1] = -0.3
    encoded, found = srgb().encode(picture)
    assert found.outside == over + under
    assert encoded.shape == (5, 8, 3)
    if over:
        assert encoded.reshape(-1, 3)[0].tolist()[::2] == [255, 255]
    if under:
        assert encoded.reshape(-1, 3)[20, 1] == 0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_number_that_is_not_finite_has_no_code_value(value):
    with pytest.raises(ValueError, match="not finite"):
        srgb().encode(np.array([[0.5, value, 0.5], [0.5, 0.5, 0.5]]))


def test_rounding_at_the_ends_is_not_counted_as_outside():
    assert srgb().encode(np.array([[1.0 + 1e-6, -1e-6, 0.5]]))[1].outside == 0
