"""Photon transfer: gain and read noise against the sensor's truth, whatever the light does between two frames."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from raw_studio import SENSOR, SUPERPIXELS, Studio, dng

from irodori.config.capture_table import Pose, Shot
from irodori.ingest import photon_transfer
from irodori.ingest.camera_reference import Reference
from irodori.ingest.mosaic import Mosaic, decode
from irodori.ingest.photon_transfer import (
    PhotonTransfer,
    equal_pairs,
    fit_transfer,
    measure_noise,
    transfer_points,
)

NO_HOT = np.zeros((0, 2), np.int32)
HEIGHT, WIDTH = 400, 560
FALL = np.linspace(1.0, 0.55, WIDTH) * np.linspace(1.0, 0.8, HEIGHT)[:, None]  # vignetting gives many levels


def mosaic(sensor, values) -> Mosaic:
    black, white = (np.full((2, 2), float(v), np.float32) for v in (sensor.black_level, sensor.white_level))
    return Mosaic(values, "RGGB", black, white, float(sensor.white_level - sensor.black_level), 0.02, 0.0, 0.0, 0)


def pair(sensor, level, rng, drift=0.0, gain_spread=0.0):
    """Two frames at a fraction of the full well, the second by another light; pixels may differ in gain."""
    light = level * sensor.response_at_full_well * FALL * rng.normal(1.0, gain_spread, FALL.shape)
    balance = np.tile([[0.6, 1.0], [1.0, 0.4]], (HEIGHT // 2, WIDTH // 2))
    return [mosaic(sensor, sensor.expose(light * balance * k, sensor.base_exposure_s, rng)) for k in (1.0, 1.0 + drift)]


def measure(sensor, seed, drift=0.0, gain_spread=0.0):
    rng = np.random.default_rng(seed)
    pairs = [pair(sensor, level, rng, drift, gain_spread) for level in (0.0, 0.25, 0.75)]
    return fit_transfer(np.concatenate([transfer_points(*p, NO_HOT) for p in pairs]))


# Electrons per DN and read noise from a sensitive setting, whose read noise spans many numbers, to a coarse one, whose
# read noise is near the rounding.
CAMERAS = [(0.2, 3.0), (1.0, 2.0), (2.53, 6.0), (2.53, 25.0), (8.0, 6.0), (20.0, 15.0)]


@pytest.mark.default_cases(4)
@pytest.mark.parametrize(("gain", "read"), CAMERAS)
@pytest.mark.parametrize("drift", [0.0, 0.03], ids=["steady", "drifting"])
def test_gain_is_within_two_percent_of_the_truth(gain, read, drift):
    sensor = dataclasses.replace(SENSOR, full_well_e=gain * (SENSOR.white_level - 600), read_noise_e=read)
    found, error, read_dn, read_error = measure(sensor, 41, drift)
    assert found == pytest.approx(gain, rel=0.02)
    assert abs(found - gain) < 5 * error and error < 0.01 * gain
    expected = np.hypot(read / gain, np.sqrt(1 / 12))
    assert read_dn == pytest.approx(expected, rel=0.03)
    assert PhotonTransfer(found, error, read_dn, read_error).read_noise_e == pytest.approx(read, rel=0.06)


@given(gain=st.floats(0.3, 10.0), read_dn=st.floats(0.6, 10.0), seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=8)
def test_standard_errors_hold_for_any_sensor(gain, read_dn, seed):
    sensor = dataclasses.replace(SENSOR, full_well_e=gain * (SENSOR.white_level - 600), read_noise_e=gain * read_dn)
    found, error, read, read_error = measure(sensor, seed, drift=0.02)
    assert abs(found - gain) < 6 * error
    assert abs(read - np.hypot(read_dn, np.sqrt(1 / 12))) < 6 * read_error


def test_differences_between_pixels_are_no_noise():
    found, _, _, _ = measure(SENSOR, 42, drift=0.03, gain_spread=0.02)
    assert found == pytest.approx(SENSOR.electrons_per_dn, rel=0.02)


def test_each_tile_tells_its_level_and_the_variance_of_what_the_light_does_not_explain():
    """Tiles of 16 x 16 pixels of one place of the mosaic, those at the edges smaller; a few pixels are hot."""
    rng, black = np.random.default_rng(5), np.array([[300.0, 400.0], [500.0, 600.0]])
    level = rng.uniform(2000.0, 9000.0, (70, 94))
    level[:40, 60:] = 14_000.0  # above nine tenths of the range from the first place's black to white
    first = np.rint(np.tile(black, (35, 47)) + level + rng.normal(0.0, 30.0, level.shape)).astype(np.uint16)
    second = np.rint(np.tile(black, (35, 47)) + 0.8 * level + rng.normal(0.0, 30.0, level.shape)).astype(np.uint16)
    made = [Mosaic(values, "GRBG", black.astype("f4"), np.full((2, 2), 15_000.0, "f4"), 14_400.0, 0.02, 0.0, 0.0, 0)
            for values in (first, second)]  # fmt: skip
    hot = np.array([[3, 5], [66, 93]])
    found, expected = transfer_points(*made, hot), []
    sound = np.ones(first.shape, bool)
    sound[hot[:, 0], hot[:, 1]] = False
    above = [[m[row::2, column::2].mean() - black[row, column] for row, column in np.ndindex(2, 2)]
             for m in (first, second)]  # fmt: skip
    ratio = np.sum(above[0]) / np.sum(above[1])
    for (row, column), band in zip(np.ndindex(2, 2), (1, 0, 2, 1), strict=True):
        a, b, good = (one[row::2, column::2] for one in (first.astype(float), second.astype(float), sound))
        for y in range(0, a.shape[0], 16):
            for x in range(0, a.shape[1], 16):
                part = np.s_[y : y + 16, x : x + 16]
                kept = good[part]
                height = a[part][kept].mean() - black[row, column]
                if kept.sum() > 16 and height < 0.9 * (15_000.0 - black[row, column]):
                    off = (a[part] - ratio * b[part])[kept]
                    expected.append([band, kept.sum(), height, ratio, off.var(ddof=1)])
    assert 0 < len(expected) < 4 * 9
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_the_light_of_two_frames_is_compared_by_what_does_not_clip():
    """Where a place of the mosaic is brighter than nine tenths of its range in either frame, it tells no ratio."""
    values = [np.full((64, 64), 600 + 5000), np.full((64, 64), 600 + 4000)]
    for at, (one, other, expected) in enumerate(((13_000, 11_000, 1.25), (9000, 13_000, 1.25), (9000, 6000, 1.3333))):
        pair_ = [value.copy() for value in values]
        pair_[0][::2, ::2], pair_[1][::2, ::2] = 600 + one, 600 + other
        sensor = SimpleNamespace(black_level=600, white_level=600 + 14_000)
        found = transfer_points(*(mosaic(sensor, value.astype(np.uint16)) for value in pair_), NO_HOT)
        assert found[:, 3] == pytest.approx((3 * 5000 + one) / (3 * 4000 + other) if at == 2 else expected)


def test_hot_pixels_and_clipped_tiles_do_not_enter():
    rng = np.random.default_rng(43)
    first, second = pair(SENSOR, 0.75, rng)
    hot = np.stack([rng.integers(0, HEIGHT, 500), rng.integers(0, WIDTH, 500)], axis=1)
    first.values[hot[:, 0], hot[:, 1]] = rng.integers(600, 16000, 500)
    first.values[:64] = second.values[:64] = SENSOR.white_level
    points = transfer_points(first, second, hot)
    assert points[:, 2].max() < 0.9 * (SENSOR.white_level - 600)
    found, _, _, _ = fit_transfer(points)
    assert found == pytest.approx(SENSOR.electrons_per_dn, rel=0.03)


def test_darkness_alone_tells_read_noise_and_no_gain():
    rng = np.random.default_rng(44)
    gain, _, read, _ = fit_transfer(transfer_points(*pair(SENSOR, 0.0, rng), NO_HOT))
    assert np.isnan(gain)
    assert read == pytest.approx(np.hypot(SENSOR.read_noise_e / SENSOR.electrons_per_dn, np.sqrt(1 / 12)), rel=0.02)


@pytest.mark.parametrize(("share", "ratio"), [(0.0095, 1.0), (0.012, 1.25)])
def test_the_light_of_two_frames_is_compared_from_a_hundredth_of_the_range_on(share, ratio):
    """Below it there is next to none: the first frame is brighter by a quarter all the same."""
    rise = share * (SENSOR.white_level - SENSOR.black_level)
    two = [mosaic(SENSOR, np.full((64, 64), SENSOR.black_level + rise / k)) for k in (1.0, 1.25)]
    assert transfer_points(*two, NO_HOT)[:, 3] == pytest.approx(ratio)


@given(gain=st.floats(0.2, 30.0), read=st.floats(0.6, 20.0), drift=st.floats(-0.1, 0.1))
def test_points_without_scatter_give_the_line_that_they_lie_on(gain, read, drift):
    """The variance of a - r b is read² (1 + r²) + level (1 + r) / gain."""
    level, ratio = np.linspace(0.0, 20_000.0, 50), np.where(np.arange(50) % 2, 1.0 + drift, 1.0)
    count = np.where(np.arange(50) % 3, 256.0, 100.0)
    variance = read**2 * (1.0 + ratio**2) + level * (1.0 + ratio) / gain
    found = fit_transfer(np.stack([np.zeros(50), count, level, ratio, variance], axis=1))
    assert found[0] == pytest.approx(gain, rel=1e-6) and found[2] == pytest.approx(read, rel=1e-3)
    # Errors are those of the pixels' number, however well the points agree: a hundredfold count, a tenth of the error.
    more = fit_transfer(np.stack([np.zeros(50), 100.0 * count, level, ratio, variance], axis=1))
    assert 0.0 < found[1] < 0.1 * gain and more[1] == pytest.approx(found[1] / 10.0, rel=0.01)
    assert more[3] == pytest.approx(found[3] / 10.0, rel=0.01)


@pytest.mark.parametrize(("most", "told"), [(60.0, False), (95.0, True)])
def test_a_gain_is_told_by_levels_that_differ_by_ten_standard_deviations(most, told):
    level, one = np.linspace(0.0, most, 40), np.ones(40)
    variance = 2.0 * 25.0 + 2.0 * level / 5.0  # of a mean of about 64, whose root is 8
    gain, _, read, _ = fit_transfer(np.stack([0.0 * one, 4096.0 * one, level, one, variance], axis=1))
    assert math.isfinite(gain) == told and (not told or gain == pytest.approx(5.0, rel=1e-6))
    assert read == pytest.approx(5.0, rel=0.2)


def test_points_that_scatter_more_than_their_number_tells_have_larger_errors():
    level, count = np.linspace(0.0, 20_000.0, 400), np.full(400, 256.0)
    off = np.random.default_rng(3).normal(size=400) * np.sqrt(2.0 / 255.0)
    points = np.stack([0.0 * level, count, level, 0.0 * level + 1.0, 2.0 * 9.0 + 2.0 * level / 2.0], axis=1)
    found = []
    for times in (0.1, 5.0):
        scattered = points.copy()
        scattered[:, 4] *= 1.0 + times * off
        found.append(fit_transfer(scattered))
    assert found[1][1] == pytest.approx(5.0 * found[0][1], rel=0.2)
    assert abs(found[1][0] - 2.0) < 4.0 * found[1][1]


@pytest.mark.parametrize("points", [3, 5])
def test_the_stated_error_of_a_few_points_is_their_scatter(points):
    """Its mean square is the variance of the gains that many draws give, however few points tell of the scatter."""
    level, one = np.linspace(0.0, 20_000.0, points), np.ones(points)
    # Their number of pixels alone lets variances scatter by 0.022.
    scattered = np.random.default_rng(7).normal(2.0 * 9.0 + 2.0 * level / 2.0, 0.1 * (2.0 * 9.0 + level), (400, points))
    found = [fit_transfer(np.stack([0 * one, 4096 * one, level, one, row], axis=1)) for row in scattered]
    gain, error = np.array(found)[:, :2].T
    assert np.mean(error**2) == pytest.approx(np.var(gain), rel=0.3)


def test_points_that_determine_nothing_say_so():
    level = np.full(20, 5.0)
    one = np.ones(20)
    assert np.isnan(fit_transfer(np.stack([one, 256 * one, level, one, 0 * one], axis=1))).all()
    gain, gain_error, read, read_error = fit_transfer(np.stack([one, 256 * one, level, one, 8.0 * one], axis=1))
    # Noise of less than a number is noise.
    assert fit_transfer(np.stack([one, 256 * one, level, one, 0.5 * one], axis=1))[2] == pytest.approx(0.5)
    # Levels that do not differ tell the read noise alone: half of a difference's variance.
    assert np.isnan(gain) and np.isnan(gain_error) and read == pytest.approx(2.0)
    # Of 20 tiles of 256 pixels the variance is known within sqrt(2 / (20 * 255)), the deviation within half of that.
    assert read_error == pytest.approx(2.0 * 0.5 * np.sqrt(2.0 / (20 * 255)), rel=1e-3)


def frames(folder, exposures, iso=0.0, role="white", seed=0):
    """Write two frames of an exposure each of a sensor of 2.4 electrons a number, and return their shots."""
    rng, shots = np.random.default_rng(seed), []
    for number, exposure_s in enumerate(np.repeat(exposures, 2)):
        level = rng.poisson(24_000.0 * np.linspace(1.0, 50.0 * exposure_s, 96) * np.ones((64, 1))) / 2.4
        file = f"{role}-{iso:g}-{number}.dng"
        dng(folder / file, np.rint(600 + (0.0 if role == "dark" else 1.0) * level).astype(np.uint16))
        shots.append(Shot(file, role, Pose(45.0, 0.0), "out", float(exposure_s), iso))
    return shots


def test_the_noise_is_that_of_the_iso_of_most_lit_pairs(tmp_path):
    shots = frames(tmp_path, [0.005, 0.01], 200.0, seed=1) + frames(tmp_path, [0.005], 100.0, seed=2)
    shots += frames(tmp_path, [0.005] * 4, 100.0, "dark", seed=3)
    noise = measure_noise(shots, tmp_path / "t.csv", tmp_path, NO_HOT)
    assert noise.iso == 200.0 and noise.gain_e_per_dn == pytest.approx(2.4, rel=0.1)
    assert noise.gain_by_colour == pytest.approx((2.4,) * 3, rel=0.2)
    for few in (shots[:1], [s for s in shots if s.role == "dark"]):
        assert np.isnan(measure_noise(few, tmp_path / "t.csv", tmp_path, NO_HOT).gain_e_per_dn)


def test_of_many_pairs_the_first_twelve_of_all_levels_are_read(tmp_path, monkeypatch):
    read = []
    monkeypatch.setattr(photon_transfer, "decode", lambda path, linear: read.append(path.name) or decode(path, linear))
    first, second = frames(tmp_path, [0.005], seed=1), frames(tmp_path, [0.01], 50.0, seed=2)
    second = [dataclasses.replace(s, iso=0.0) for s in second]
    measure_noise(first * 12 + second * 3, tmp_path / "t.csv", tmp_path, NO_HOT)
    assert len(read) == 24 and sum(name.startswith("white-50") for name in read) == 6
    assert [name.startswith("white-50") for name in read[:8:2]] == [False, True, False, True]


def test_a_pair_is_two_shots_that_differ_in_nothing():
    shots = [
        Shot(f"{n}.dng", role, Pose(light, 0.0), "out", t, iso)
        for n, (role, light, t, iso) in enumerate(
            [("white", 45, 0.02, 100), ("white", 45, 0.02, 200), ("white", 45, 0.02, 100), ("white", 50, 0.02, 100),
             ("dark", 45, 0.02, 100), ("white", 45, 0.04, 100), ("white", 45, 0.02, 100), ("dark", 45, 0.02, 100)]
        )
    ]  # fmt: skip
    assert [(a.file, b.file) for a, b in equal_pairs(shots)] == [("0.dng", "2.dng"), ("4.dng", "7.dng")]


def test_noise_grows_with_amplification_and_rounding_does_not():
    noise = PhotonTransfer(gain_e_per_dn=4.0, read_noise_dn=2.0, iso=100.0)
    gain, read = noise.at(4.0)
    assert gain == 1.0 and read == pytest.approx((4.0 - 1 / 12) * 16 + 1 / 12)


def test_the_reference_keeps_the_gain_of_every_colour_with_its_error(tmp_path):
    studio = Studio(tmp_path, seed=45)
    superpixels = (300, 400, 6)
    for _ in range(2):
        studio.shoot("dark", np.zeros(superpixels))
    for n in range(4):
        studio.light = 1.0 + 0.02 * n
        studio.shoot("white", np.full(superpixels, 0.9), "out" if n < 2 else "in", 0.02 if n < 2 else 0.05)
    noise = Reference.load(studio.reference(SUPERPIXELS)).noise
    assert noise.gain_e_per_dn == pytest.approx(SENSOR.electrons_per_dn, rel=0.02)
    for gain, error in zip(noise.gain_by_colour, noise.gain_error_by_colour, strict=True):
        assert abs(gain - SENSOR.electrons_per_dn) < 5 * error and error < 0.05 * gain
