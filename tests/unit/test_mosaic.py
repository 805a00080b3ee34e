"""Decoding RAW files: bit-exact numbers in the sensor's own frame, levels, settings, refusals."""

import errno
import math
from pathlib import Path

import numpy as np
import pytest
import rawpy
from dng_files import write_any_dng
from hypothesis import given, settings
from hypothesis import strategies as st
from raw_studio import BLACK, DATA, WHITE, dng, random_mosaic

from irodori.core.errors import InputError, PlainError
from irodori.ingest.mosaic import _stated, decode, demosaic


@pytest.mark.parametrize(
    ("height", "width", "black", "white"), [(64, 96, 600, 16383), (66, 38, 0, 4095), (200, 200, 1023, 65535)]
)
def test_dng_decodes_bit_exactly(tmp_path, height, width, black, white):
    mosaic = random_mosaic(np.random.default_rng(height), height, width, white)
    with rawpy.imread(str(dng(tmp_path / "a.dng", mosaic, black, white))) as file:
        assert np.array_equal(file.raw_image_visible, mosaic)
        assert file.white_level == white
        assert list(file.black_level_per_channel) == [black] * 4
        colours = file.color_desc.decode()
        pattern = [[colours[c] for c in row] for row in file.raw_colors_visible[:2, :2]]
        assert pattern == [["R", "G"], ["G", "B"]]


def test_a_disk_that_takes_no_dng_leaves_nobody_a_view_of_what_was_to_be_written(tmp_path, monkeypatch):
    """A view that an error's frames hold on to crashes Python 3.12 once the buffer behind it is collected."""
    views = []

    def full(path, data):
        views.append(data)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(PlainError, match="No space left"):
        dng(tmp_path / "a.dng", random_mosaic(np.random.default_rng(1), 64, 96))
    with pytest.raises(ValueError, match="released"):
        len(views[0])


def test_a_last_row_and_column_that_no_superpixel_holds_are_left_out(tmp_path):
    mosaic = random_mosaic(np.random.default_rng(4), 65, 97)
    path = write_any_dng(tmp_path / "a.dng", mosaic)
    decoded = decode(path)
    assert decoded.size == (96, 64) and np.array_equal(decoded.values, mosaic[:64, :96])
    assert decoded.superpixels.shape == (32, 48, 3)
    offset = np.full((64, 96), 10)
    assert demosaic(path, "linear", offset).shape == (64, 96, 3)


def test_masked_pixels_take_the_median_of_the_nearest_of_their_colour(tmp_path):
    """Of the eight, those beyond an edge are the ones on the other side of the pixel."""
    mosaic = random_mosaic(np.random.default_rng(5), 40, 60)
    masked = np.array([[0, 0], [0, 58], [39, 1], [39, 59], [1, 20], [17, 30], [18, 34], [20, 0]])
    bands = demosaic(write_any_dng(tmp_path / "a.dng", mosaic), "linear", masked_px=masked)
    for row, column in masked:
        near = []
        for dy in (-2, 0, 2):
            for dx in (-2, 0, 2):
                y = row + dy if 0 <= row + dy < 40 else row - dy
                x = column + dx if 0 <= column + dx < 60 else column - dx
                near += [mosaic[y, x]] if (dy, dx) != (0, 0) else []
        assert bands[row, column, row % 2 + column % 2] == int(np.median(near))


@given(exposure_s=st.floats(1e-4, 30.0))
@settings(deadline=None, max_examples=20)
def test_exposure_time_survives_the_file(tmp_path_factory, exposure_s):
    path = tmp_path_factory.mktemp("exposure") / "a.dng"
    dng(path, np.full((64, 64), 700, np.uint16), exposure_s=exposure_s)
    assert decode(path).exposure_s == pytest.approx(exposure_s, rel=1e-2)


def test_superpixels_are_red_mean_green_blue_above_black(tmp_path):
    rng = np.random.default_rng(1)
    mosaic = random_mosaic(rng)
    decoded = decode(dng(tmp_path / "a.dng", mosaic))
    numbers = mosaic.astype(np.float64)
    red, green_a, green_b, blue = numbers[::2, ::2], numbers[::2, 1::2], numbers[1::2, ::2], numbers[1::2, 1::2]
    expected = np.stack([red - BLACK, (green_a + green_b) / 2 - BLACK, blue - BLACK], axis=-1)
    assert decoded.superpixels.dtype == np.float32
    assert np.array_equal(decoded.superpixels, expected)
    assert decoded.full_scale == WHITE - BLACK
    largest = np.max([red, green_a, green_b, blue], axis=0)
    assert np.array_equal(decoded.values, mosaic) and decoded.size == (96, 64)
    assert np.allclose(decoded.largest, (largest - BLACK) / (WHITE - BLACK), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("mosaic", [np.zeros((65, 64), np.uint16), np.zeros((64, 63), np.uint16), np.zeros((64, 64))])
def test_mosaics_that_no_sensor_gives_are_not_written(tmp_path, mosaic):
    with pytest.raises(ValueError, match="accepted"):
        dng(tmp_path / "a.dng", mosaic)
    assert list(tmp_path.iterdir()) == []


def refused(path):
    with pytest.raises(InputError) as caught:
        decode(path)
    assert str(path) in str(caught.value)


# What to keep of a file's n bytes.
CUTS = {
    "nothing": lambda n: 0, "one byte": lambda n: 1, "header": lambda n: 8, "tags": lambda n: 512,
    "quarter": lambda n: n // 4, "half": lambda n: n // 2, "three quarters": lambda n: 3 * n // 4,
    "all but 1000 bytes": lambda n: n - 1000, "all but two bytes": lambda n: n - 2,
    "all but one byte": lambda n: n - 1,
}  # fmt: skip


@pytest.mark.stability(stage="workflow", case="RAW file truncated")
@pytest.mark.parametrize("cut", CUTS)
@pytest.mark.parametrize("size", [(64, 96), (600, 800)], ids=["small", "large"])
def test_a_truncated_dng_is_refused(tmp_path, size, cut):
    path = dng(tmp_path / "cut.dng", random_mosaic(np.random.default_rng(2), *size))
    content = path.read_bytes()
    path.write_bytes(content[: CUTS[cut](len(content))])
    refused(path)


@pytest.mark.parametrize("cut", ["header", "half", "all but 1000 bytes"])
def test_a_truncated_camera_file_is_refused(tmp_path, cut):
    source = DATA / "powershot_s40_chart.crw"
    if not source.is_file():
        pytest.skip(f"no real photograph at {source}")
    content = source.read_bytes()
    path = tmp_path / "cut.crw"
    path.write_bytes(content[: CUTS[cut](len(content))])
    refused(path)


def test_what_is_no_raw_file_is_refused(tmp_path):
    text = tmp_path / "text.dng"
    text.write_text("This is not a photograph.\n" * 500)
    noise = tmp_path / "noise.dng"
    noise.write_bytes(np.random.default_rng(3).bytes(50_000))
    for path in (text, noise, tmp_path / "missing.dng", tmp_path):
        refused(path)
    with pytest.raises(InputError, match="no such file"):
        decode(tmp_path / "missing.dng")


class Maker:
    """A RAW file as LibRaw gives it, with white levels of its channels that a maker's notes state."""

    def __init__(self, raw, levels):
        self._raw, self.camera_white_level_per_channel = raw, levels

    def __getattr__(self, name):
        return getattr(self._raw, name)

    def __enter__(self):
        self._raw.__enter__()
        return self

    def __exit__(self, *error):
        return self._raw.__exit__(*error)


@pytest.mark.parametrize(
    ("levels", "white"),
    [
        (None, [WHITE] * 4),
        ([16000, 15000, 15500, 15100], [16000, 15000, 15100, 15500]),
        ([0, 15000, 15500, 15100], [WHITE, 15000, 15100, 15500]),  # left empty
        ([16000, 70000, 15500, 15100], [16000, WHITE, 15100, 15500]),  # above what the file says of itself
        ([16000, BLACK, 15500, 15100], [16000, WHITE, 15100, 15500]),  # no light at all
    ],
)
def test_a_channel_s_own_white_level_counts_where_it_can_be_one(tmp_path, monkeypatch, levels, white):
    path = dng(tmp_path / "a.dng", random_mosaic(np.random.default_rng(4)))
    imread = rawpy.imread
    monkeypatch.setattr(rawpy, "imread", lambda name: Maker(imread(name), levels))
    # LibRaw counts red, green, blue and the other green.
    assert decode(path).white.ravel().tolist() == white


@pytest.mark.parametrize(
    ("colours", "words"),
    [
        ([[0, 1], [1, 1]], "found RGGG; accepted: a 2 x 2 pattern"),
        ([[0, 1], [3, 2], [1, 0], [2, 3]], "a pattern that does not repeat every 2 pixels"),
        ([[0, 1, 0, 1, 2, 1], [3, 2, 3, 2, 3, 0]], "a pattern that does not repeat every 2 pixels"),
        ([[0, 1], [7, 2]], r"RG\?B"),
    ],
)
def test_a_mosaic_of_another_pattern_is_refused(tmp_path, monkeypatch, colours, words):
    path = dng(tmp_path / "a.dng", random_mosaic(np.random.default_rng(4)))
    imread, side = rawpy.imread, np.shape(colours)

    def other(name):
        maker = Maker(imread(name), None)
        maker.raw_color = lambda row, column: colours[row % side[0]][column % side[1]]
        return maker

    monkeypatch.setattr(rawpy, "imread", other)
    with pytest.raises(InputError, match=words):
        decode(path)


def test_the_largest_of_each_superpixel_is_the_one_nearest_to_its_white_level(tmp_path):
    values = random_mosaic(np.random.default_rng(5))
    found = decode(dng(tmp_path / "a.dng", values)).largest
    blocks = values.reshape(32, 2, 48, 2).astype(float).max(axis=(1, 3))
    np.testing.assert_allclose(found, (blocks - BLACK) / (WHITE - BLACK), rtol=1e-6)


@given(content=st.binary(max_size=300), tiff=st.booleans())
@settings(deadline=None, max_examples=60)
def test_no_bytes_raise_anything_else(tmp_path_factory, content, tiff):
    path = tmp_path_factory.mktemp("bytes") / "a.dng"
    path.write_bytes(b"II*\0\x08\0\0\0" + content if tiff else content)
    refused(path)


PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")


@pytest.mark.parametrize("pattern", PATTERNS)
def test_any_phase_of_the_mosaic_gives_the_same_bands(tmp_path, pattern):
    colours = {"R": 1000, "G": 2000, "B": 3000}
    mosaic = np.tile(np.array([colours[letter] for letter in pattern], np.uint16).reshape(2, 2), (32, 48))
    decoded = decode(write_any_dng(tmp_path / "a.dng", mosaic, pattern=pattern))
    assert decoded.pattern == pattern
    assert np.array_equal(decoded.superpixels, np.broadcast_to([400.0, 1400.0, 2400.0], (32, 48, 3)))


@pytest.mark.stability(stage="ingest", case="sensor's black level in any pattern")
@pytest.mark.parametrize("pattern", PATTERNS)
def test_a_black_level_for_each_place_is_subtracted_at_its_place(tmp_path, pattern):
    black = np.array([[600, 610], [620, 640]])
    mosaic = np.tile((black + 100).astype(np.uint16), (32, 48))
    decoded = decode(write_any_dng(tmp_path / "a.dng", mosaic, pattern=pattern, black=black))
    assert np.array_equal(decoded.black, black)
    assert np.array_equal(decoded.superpixels, np.full((32, 48, 3), 100.0))
    assert decoded.full_scale == 16383 - 640


@pytest.mark.stability(stage="ingest", case="sensor's black level in any pattern")
def test_a_black_level_that_the_pattern_cannot_hold_is_refused(tmp_path):
    black = np.arange(600, 608).reshape(4, 2)
    path = write_any_dng(tmp_path / "a.dng", np.full((64, 96), 700, np.uint16), black=black)
    with pytest.raises(InputError, match="4 x 2"):
        decode(path)


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_data_stay_in_the_sensors_frame_whatever_the_orientation_tag(tmp_path, orientation):
    mosaic = random_mosaic(np.random.default_rng(orientation))
    decoded = decode(write_any_dng(tmp_path / "a.dng", mosaic, orientation=orientation))
    assert np.array_equal(decoded.values, mosaic)
    assert decoded.orientation == {1: 0, 3: 3, 6: 6, 8: 5}[orientation]


@given(iso=st.integers(25, 25600), tenths=st.integers(10, 320))
@settings(deadline=None, max_examples=15)
def test_iso_and_aperture_come_from_the_file(tmp_path_factory, iso, tenths):
    path = tmp_path_factory.mktemp("settings") / "a.dng"
    decoded = decode(write_any_dng(path, np.full((64, 64), 700, np.uint16), iso=iso, f_number=tenths / 10))
    assert decoded.iso == pytest.approx(iso) and decoded.f_number == pytest.approx(tenths / 10, rel=1e-3)


def test_what_the_file_does_not_state_is_zero(tmp_path):
    decoded = decode(write_any_dng(tmp_path / "a.dng", np.full((64, 64), 700, np.uint16)))
    assert decoded.iso == 0.0 and decoded.f_number == 0.0


def real(name):
    path = DATA / name
    if not path.is_file():
        pytest.skip(f"no real photograph at {path}")
    return path


@pytest.mark.parametrize(
    ("name", "size", "pattern", "black", "white"),
    [
        ("powershot_s40_chart.crw", (2312, 1720), "RGGB", 32, 1023),
        ("powershot_s40_chart_zoom.crw", (2312, 1720), "RGGB", 32, 1023),
        ("powershot_s40_glossy_box.crw", (2312, 1720), "RGGB", 32, 1023),
        ("dc120_chart.kdc", (848, 976), "GRBG", 0, 255),
    ],
)
def test_real_cameras_files_decode(name, size, pattern, black, white):
    decoded = decode(real(name))
    assert decoded.size == size and decoded.pattern == pattern
    assert (decoded.black == black).all() and (decoded.white == white).all() and decoded.values.max() <= white
    assert not decoded.early_clipping
    assert 1e-4 < decoded.exposure_s < 1 and 25 < decoded.iso < 400 and 2 < decoded.f_number < 8
    # Neighbours of one colour agree: the mosaic is read in its own order.
    green = decoded.superpixels[..., 1]
    assert np.corrcoef(green[:, :-1].ravel(), green[:, 1:].ravel())[0, 1] > 0.95


@pytest.mark.parametrize(("said", "taken"), [(0.02, 0.02), (math.inf, 0.0), (math.nan, 0.0), (-1.0, 0.0), (0.0, 0.0)])
def test_what_a_file_states_is_a_positive_number_or_nothing(said, taken):
    assert _stated(said) == taken


STATED, CLIPS = 20_000, 16_383  # white level in the file, and where the sensor's numbers end


def noisy(rng, level, top=CLIPS, electrons_per_dn=2.5):
    """Return numbers of a sensor under light of a level above black, DN, (height, width)."""
    counted = rng.poisson(electrons_per_dn * np.asarray(level, float)) / electrons_per_dn
    return np.minimum(np.rint(BLACK + counted), top).astype(np.uint16)


@pytest.mark.parametrize("side", [7, 150, 298])
def test_numbers_that_end_below_the_stated_white_level_are_saturated_there(tmp_path, side):
    """Of a highlight of 7 x 7 pixels, one colour has 16 and one 9."""
    level = np.linspace(50.0, 12_000.0, 300)[:, None] * np.ones(300)
    level[:side, :side] = 40_000.0
    decoded = decode(dng(tmp_path / "a.dng", noisy(np.random.default_rng(3), level), white=STATED))
    assert (decoded.white == CLIPS).all() and decoded.full_scale == STATED - BLACK
    assert f"white level: {side * side} pixels have exactly {CLIPS}" in decoded.early_clipping
    assert f"but the file states {STATED}: they are taken as saturated" in decoded.early_clipping
    assert np.count_nonzero(decoded.largest >= 1.0) == (-(-side // 2)) ** 2


def test_a_colour_that_ends_before_the_others_is_saturated_at_its_own_number(tmp_path):
    level = np.linspace(50.0, 12_000.0, 200)[:, None] * np.ones(300)
    level[:20] = 40_000.0
    mosaic = noisy(np.random.default_rng(3), level, STATED)
    mosaic[1::2, 1::2] = np.minimum(mosaic[1::2, 1::2], 15_000)
    decoded = decode(dng(tmp_path / "a.dng", mosaic, white=STATED))
    assert decoded.white.tolist() == [[STATED, STATED], [STATED, 15_000]]
    assert "white level: 1500 pixels have exactly 15000" in decoded.early_clipping


@pytest.mark.parametrize(
    ("level", "electrons_per_dn"),
    [
        (np.full((200, 300), 9_000.0), 2.5),  # an evenly lit surface
        (np.full((200, 300), 9_000.0), 8.0),
        (np.where(np.arange(300) < 40, 12_000.0, 80.0) * np.ones((200, 1)), 2.5),  # a lamp in the dark
        (np.zeros((200, 300)), 2.5),  # with the cap on
        (np.full((200, 300), 3.0), 2.5),
        (np.full((200, 300), 700.0), 8.0),
    ],
)
def test_an_honest_maximum_is_no_plateau(tmp_path, level, electrons_per_dn):
    mosaic = noisy(np.random.default_rng(4), level, STATED, electrons_per_dn)
    for step in (1, 2, 16):  # of an amplifier, or of a file of fewer bits
        decoded = decode(dng(tmp_path / "a.dng", mosaic // step * step, white=STATED))
        assert (decoded.white == STATED).all() and not decoded.early_clipping


def test_coarse_numbers_tell_no_plateau(tmp_path):
    """In 255 steps or fewer, an even surface may have a single number."""
    level = np.full((200, 300), 180.0)
    level[100:] = 40.0
    decoded = decode(dng(tmp_path / "a.dng", level.astype(np.uint16), black=0, white=255))
    assert (decoded.white == 255).all() and not decoded.early_clipping
