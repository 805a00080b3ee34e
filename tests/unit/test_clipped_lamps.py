"""Clipped lamps and negative light in picture files: a warning, or a refusal where it is certain."""

import logging

import numpy as np
import pytest
from made import made
from test_light_sources import OPTIONS, write_exr, write_hdr

from irodori.config.models import LightsSource, RgbSource, SpectralSource
from irodori.core.errors import InputError
from irodori.export.pictures import layer_names
from irodori.light.clipped_lamps import LargestNumbers
from irodori.light.light_files import rgb_picture, spectral_picture
from irodori.light.stage import make_environment
from irodori.report.html_page import fragment
from irodori.report.page import environments


def glowing(channels=3, seed=0):
    """A dim room (32, 64, n) with noise, and a lamp of 60 pixels that is brightest in its middle, at 200."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform(0.2, 0.6, (32, 64, channels))
    towards = np.hypot(*(np.mgrid[-3:3, -5:5] + 0.5))
    pixels[6:12, 20:30] = (200.0 * np.exp(-towards / 4.0))[..., None] * rng.uniform(0.95, 1.0, (6, 10, channels))
    return pixels


def warned(reader, path):
    picture = reader(path)
    _ = picture.weights
    return picture.origin["warnings"]


@pytest.mark.parametrize("kind", ["float", "half", "tif", "hdr"])
def test_a_lamp_that_is_cut_off_is_warned_of_and_a_whole_one_is_not(tmp_path, kind):
    def write(name, pixels):
        if kind == "hdr":
            return write_hdr(tmp_path / f"{name}.hdr", pixels)
        return write_exr(
            tmp_path / f"{name}.{'tif' if kind == 'tif' else 'exr'}", pixels, kind=kind.replace("tif", "float")
        )

    assert warned(rgb_picture, write("whole", glowing())) == []
    (text,) = warned(rgb_picture, write("clipped", np.minimum(glowing(), 1.0)))
    assert text.startswith("60 pixels have exactly 1") and "if lamps were clipped there, the light is too dark" in text


def test_layers_of_spectra_are_judged_too(tmp_path):
    names = layer_names("S0")
    assert warned(spectral_picture, write_exr(tmp_path / "a.exr", glowing(61), names)) == []
    (text,) = warned(spectral_picture, write_exr(tmp_path / "b.exr", np.minimum(glowing(61), 5.0), names))
    assert "60 pixels have exactly 5 in S0." in text


def test_one_clipped_channel_is_named(tmp_path):
    (text,) = warned(rgb_picture, write_exr(tmp_path / "a.exr", np.minimum(glowing(), [np.inf, 3.0, np.inf])))
    assert "60 pixels have exactly 3 in G," in text


def test_even_light_and_pictures_of_few_numbers_are_not_warned_of(tmp_path):
    even = np.full((32, 64, 3), 0.5)
    sky = np.concatenate([np.ones((16, 64, 3)), np.full((16, 64, 3), 0.3)])
    steps = np.random.default_rng(1).integers(90, 101, (32, 64, 3)).astype(float)
    for pixels in (even, sky, steps):
        assert warned(rgb_picture, write_exr(tmp_path / "a.exr", pixels)) == []


@pytest.mark.parametrize("count", [15, 16])
def test_numbers_are_counted_over_all_bands(count):
    rows = np.random.default_rng(2).uniform(0.0, 0.9, (40, 40, 1))
    rows[:count, 3] = 1.0
    found = LargestNumbers(["Y"], rows.size)
    for row in rows:
        found.add(row[None])
    assert bool(found.clipping()) == (count == 16)
    near = rows.copy()
    near[20:23, 5:8] = 0.97  # nine pixels of one number
    again = LargestNumbers(["Y"], rows.size)
    again.add(near)
    assert not again.clipping()


def test_the_end_of_half_precision_is_refused(tmp_path):
    pixels = np.minimum(glowing() * 1e3, 65504.0)
    assert (pixels == 65504.0).any()
    with pytest.raises(InputError, match=r"a\.exr: found \d+ pixels of exactly 65504 in rows 0 to 31"):
        _ = rgb_picture(write_exr(tmp_path / "a.exr", pixels, kind="half")).weights
    assert rgb_picture(write_exr(tmp_path / "b.exr", np.minimum(pixels, 65472.0), kind="half")).weights.max() == 65472


def test_much_negative_light_is_warned_of_in_the_log_and_the_report(tmp_path, caplog):
    pixels = np.random.default_rng(3).uniform(0.4, 0.6, (32, 64, 3))
    assert warned(rgb_picture, write_exr(tmp_path / "few.exr", np.where(pixels > 0.596, -0.5, pixels))) == []
    pixels[::4] = -0.3
    source = {"kind": "rgb", "file": str(write_exr(tmp_path / "a.exr", pixels)), "scale": 1.0, "centre_azimuth_deg": 0}
    with caplog.at_level(logging.WARNING):
        make_environment(made(RgbSource | SpectralSource | LightsSource, source), None, tmp_path / "e.h5", *OPTIONS)
    expected = "negative values of 20 % of the positive ones were set to 0"
    assert sum(expected in record.getMessage() for record in caplog.records) == 1
    page = fragment("light.html.j2", environments=environments(["room"], [tmp_path / "e.h5"]))
    assert f"Warning: {expected}" in page


def test_a_picture_that_is_read_twice_is_warned_of_once(tmp_path, caplog):
    picture = rgb_picture(write_exr(tmp_path / "a.exr", np.minimum(glowing(), 1.0)))
    with caplog.at_level(logging.WARNING):
        first, second = picture.weights, picture.weights
    assert np.array_equal(first, second) and len(picture.origin["warnings"]) == 1
    assert sum("have exactly" in record.getMessage() for record in caplog.records) == 1
