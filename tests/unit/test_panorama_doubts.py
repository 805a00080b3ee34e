"""Panoramas with the steps of a picture for a display, with an ICC profile, or upside down."""

import numpy as np
import OpenImageIO as oiio
import pytest
from scenes import DATA
from test_clipped_lamps import glowing, warned
from test_light_sources import write_exr, write_hdr

from irodori.colour.display import standard_display
from irodori.colour.icc import Profile, write_profile
from irodori.colour.tone_curves import ParametricCurve
from irodori.core.errors import InputError
from irodori.export.pictures import layer_names, picture_bands, picture_header
from irodori.light.light_files import rgb_picture, spectral_picture
from irodori.light.panorama_doubts import LightFromBelow

QUESTION = "is the panorama upside down?"
PLACES = ("hall", "lobby", "museum", "workshop")


@pytest.mark.parametrize("name", PLACES)
def test_a_measured_place_is_warned_of_only_upside_down(tmp_path, name):
    path = DATA / "environments" / f"{name}.exr"
    channels = [picture_header(path).channels.index(channel) for channel in "RGB"]
    pixels = np.concatenate([band[..., channels] for _, band in picture_bands(path, 32)])
    assert not any("upside" in text for text in warned(rgb_picture, path))
    turned = write_exr(tmp_path / "a.exr", pixels[::-1, ::-1])
    assert any(QUESTION in text for text in warned(rgb_picture, turned))


def test_light_of_spectra_from_below_is_warned_of_too(tmp_path):
    pixels = np.ones((32, 64, 61))
    pixels[16:] = 3.0
    (text,) = warned(spectral_picture, write_exr(tmp_path / "a.exr", pixels, layer_names("S0")))
    assert text == "a level surface gets 3.0 times the light from below that it gets from above: " + QUESTION


@pytest.mark.parametrize(("below", "said"), [(1.9, None), (2.1, "2.1 times the light"), (np.inf, "all light")])
def test_light_from_below_is_that_on_a_level_surface(below, said):
    picture = np.ones((64, 128, 3))
    picture[32:] *= below if below < np.inf else 1.0
    picture[:32] *= below < np.inf
    light = LightFromBelow(64)
    for first in (32, 0, 32):  # in any order, and again
        light.add(picture[first : first + 32], first)
    assert [said in text for text in light.warnings()] == ([True] if said else [])


def test_light_along_the_horizon_counts_little():
    picture = np.ones((64, 128, 3))
    picture[32] = 10.0  # just under the horizon: more than all of the sky, but a level surface gets little of it
    light = LightFromBelow(64)
    light.add(picture, 0)
    assert light.warnings() == []


def picture_of_8_bits():
    """A room as a display shows it, (32, 64, 3), whole numbers from 0 to 255."""
    return np.rint(255.0 * np.clip(glowing(), 0.0, 1.0) ** (1.0 / 2.2))


@pytest.mark.parametrize("kind", ["float", "half", "tif"])
@pytest.mark.parametrize(("one", "said"), [(255.0, "multiples of 1/255"), (1.0, "whole numbers up to 255")])
def test_a_picture_for_a_display_is_known_by_its_steps(tmp_path, kind, one, said):
    name, depth = f"a.{'tif' if kind == 'tif' else 'exr'}", kind.replace("tif", "float")
    texts = warned(rgb_picture, write_exr(tmp_path / name, picture_of_8_bits() / one, kind=depth))
    (text,) = [text for text in texts if "8 bits for a display" in text]
    assert text.startswith(f"all numbers are {said}, as in")


def test_numbers_of_other_pictures_are_no_such_steps(tmp_path):
    drawn = np.ones((32, 64, 3))
    drawn[8:16] = np.abs(np.arange(64) - 32)[:, None]  # few whole numbers, as of a drawing
    for number, pixels in enumerate((glowing(), drawn, picture_of_8_bits() / 255.0 * 1.7, picture_of_8_bits() + 300.0)):
        assert not any("display" in t for t in warned(rgb_picture, write_exr(tmp_path / f"{number}.exr", pixels)))
    # Radiance HDR rounds to as few steps as a display has.
    assert not any("display" in t for t in warned(rgb_picture, write_hdr(tmp_path / "a.hdr", glowing())))


def write_with_profile(path, profile):
    spec = oiio.ImageSpec(64, 32, 3, "float")
    spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(profile)}]"), np.frombuffer(profile, dtype=np.uint8))
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(glowing().astype(np.float32))
    output.close()
    return path


def linear_profile(name):
    line = ParametricCurve(1.0)
    return write_profile(Profile(f"linear {name}", standard_display(name).xyz_from_rgb, (line, line, line)))


@pytest.mark.parametrize(("profile", "said"), [
    (standard_display("sRGB").profile,
     "found 'sRGB built-in', with a tone curve; accepted: linear light of the primaries of sRGB"),
    (standard_display("Adobe RGB (1998)").profile, "found 'Adobe RGB (1998)', with a tone curve"),
    (linear_profile("Display P3"), "found 'linear Display P3', with other primaries"),
    (b"no profile" * 30, "no whole ICC profile"),
])  # fmt: skip
def test_a_tiff_whose_icc_profile_is_not_of_linear_srgb_is_refused(tmp_path, profile, said):
    with pytest.raises(InputError) as error:
        rgb_picture(write_with_profile(tmp_path / "a.tif", profile))
    assert str(error.value).startswith(str(tmp_path / "a.tif")) and said in str(error.value)


def test_a_tiff_with_the_profile_of_linear_srgb_is_read_as_one_without(tmp_path):
    stated = rgb_picture(write_with_profile(tmp_path / "a.tif", linear_profile("sRGB")))
    plain = rgb_picture(write_exr(tmp_path / "b.tif", glowing()))
    assert np.array_equal(stated.weights, plain.weights)
