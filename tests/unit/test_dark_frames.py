"""Dark signal by exposure time, and the hot pixels that no later stage may use."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from raw_studio import ANGLE, BALANCE, BLACK, SENSOR, SIZE, SUPERPIXELS, WHITE, Studio, dng
from scipy import stats

from irodori.config.capture_table import Pose, Shot
from irodori.core import store
from irodori.core.errors import InputError
from irodori.ingest.camera_reference import Reference, ingest_reference
from irodori.ingest.dark_frames import hot_pixels, measure_dark
from irodori.ingest.flat_field import evaluate_flat
from irodori.ingest.ingest_options import IngestOptions

DARKNESS = np.zeros((SIZE[0] // 2, SIZE[1] // 2, 6))
POSE = Pose(ANGLE, 0.0).name


def pattern(rng):
    """Offset in DN and rate in DN/s of every mosaic pixel."""
    return rng.uniform(-8.0, 8.0, SIZE[1])[None, :] * np.ones(SIZE), rng.gamma(2.0, 60.0, SIZE)


def with_pattern(studio, offset, rate):
    # What is added is rounded at random, so that its mean is exact.
    studio.spoil = lambda mosaic, t: np.clip(
        np.floor(mosaic + offset + rate * t + studio.rng.uniform(size=SIZE)), 0, WHITE
    ).astype(np.uint16)


def dark_of(studio) -> Reference:
    return Reference.load(studio.reference()).dark


def test_offset_and_rate_of_each_pixel_come_from_two_exposure_times(tmp_path):
    studio = Studio(tmp_path, seed=51)
    offset, rate = pattern(studio.rng)
    with_pattern(studio, offset, rate)
    for exposure_s in (0.01, 0.5):
        for _ in range(24):
            studio.shoot("dark", DARKNESS, exposure_s=exposure_s)
    dark = dark_of(studio)
    assert dark.exposures_s == (0.01, 0.5)
    sound = np.ones(SIZE, bool)
    sound[dark.hot_px[:, 0], dark.hot_px[:, 1]] = False
    assert sound.mean() > 0.999
    current = SENSOR.dark_current_e_per_s / SENSOR.electrons_per_dn
    # An exposure between those of the frames, and one beyond: the error of the mean of 24 frames, and its lever.
    for exposure_s, bound in ((0.25, 0.5), (1.0, 1.6)):
        error = (dark.signal_dn(exposure_s) - offset - (rate + current) * exposure_s)[sound]
        assert error.std() < bound and abs(error.mean()) < 0.02


def test_one_exposure_time_is_exact_there_and_in_proportion_elsewhere(tmp_path):
    studio = Studio(tmp_path, seed=52)
    _, rate = pattern(studio.rng)
    with_pattern(studio, 0.0, rate)
    for _ in range(16):
        studio.shoot("dark", DARKNESS, exposure_s=0.4)
    dark = dark_of(studio)
    assert dark.offset is None
    sound = np.ones(SIZE, bool)
    sound[dark.hot_px[:, 0], dark.hot_px[:, 1]] = False
    for exposure_s in (0.1, 0.4):
        error = (dark.signal_dn(exposure_s) - (rate + SENSOR.dark_current_e_per_s / 2.53) * exposure_s)[sound]
        assert error.std() < 0.8 and abs(error.mean()) < 0.3 * exposure_s


def test_the_pattern_of_darkness_does_not_enter_the_responses(tmp_path):
    studio = Studio(tmp_path, seed=53)
    offset, rate = pattern(studio.rng)
    with_pattern(studio, 6.0 * offset, rate)
    for exposure_s in (0.02, 0.4):
        for _ in range(12):
            studio.shoot("dark", DARKNESS, exposure_s=exposure_s)
    studio.references(frames=4, darks=0)
    for state, exposure_s in (("out", 0.02), ("in", 0.05)):
        studio.shoot("object", np.full(DARKNESS.shape, 0.1), state, exposure_s)
    response, valid, _, _ = studio.ingest(POSE)
    columns = response[..., 1].mean(axis=0)
    assert valid.mean() > 0.99
    assert columns.std() < 0.1 * np.abs(6.0 * offset[0]).mean() / (0.1 * SENSOR.full_well_e / 1.6 / 2.53)
    assert np.allclose(response[valid > 0].mean(axis=0), 0.1, rtol=0.005)


def hot_places(rng, count=60):
    """Places of mosaic pixels of which no two share a superpixel."""
    at = rng.choice((SIZE[0] // 2 - 2) * (SIZE[1] // 2 - 2), count, replace=False)
    rows, columns = np.divmod(at, SIZE[1] // 2 - 2)
    return np.stack([2 * rows + rng.integers(2, 4, count), 2 * columns + rng.integers(2, 4, count)], axis=1)


@pytest.mark.stability(stage="ingest", case="hot pixels")
def test_hot_pixels_are_found_counted_and_masked_in_every_capture(tmp_path):
    studio = Studio(tmp_path, seed=54)
    places = hot_places(studio.rng)
    bright, restless = places[:40], places[40:]

    def spoil(mosaic, exposure_s):
        numbers = mosaic.astype(float)
        numbers[tuple(bright.T)] += 20_000.0 * exposure_s
        # A pixel that jumps between two states: its mean is not conspicuous, its variance is.
        numbers[tuple(restless.T)] += studio.rng.choice([-60.0, 60.0], len(restless))
        return np.clip(numbers, 0, WHITE).astype(np.uint16)

    studio.spoil = spoil
    studio.references(frames=2, darks=8)
    truth = np.full(DARKNESS.shape, 0.4)
    truth[20:24, 30:34] = 5.0
    for state, exposure_s in (("out", 0.02), ("in", 0.05)):
        studio.shoot("object", truth, state, exposure_s)
    path = studio.linear(POSE)
    found = {tuple(p) for p in Reference.load(tmp_path / "reference.h5").dark.hot_px}
    assert {tuple(p) for p in bright} <= found
    assert len(found & {tuple(p) for p in restless}) >= 0.9 * len(restless)
    assert len(found - {tuple(p) for p in places}) <= 1
    with store.open_file(tmp_path / "reference.h5") as file:
        assert file.attribute("hot_pixels") == len(found)
    with store.open_file(path) as file:
        valid, clipped = file.read("valid").astype(bool), file.read("clipped").astype(bool)
    expected = np.zeros(valid.shape, bool)
    rows, columns = np.array(sorted(found)).T
    expected[rows // 2, columns // 2] = True
    highlight = np.zeros(valid.shape, bool)
    highlight[20:24, 30:34] = True
    # Hot and clipped stay apart: a later stage can tell a highlight from a fault of the sensor.
    assert np.array_equal(clipped, highlight)
    assert np.array_equal(~valid, expected | highlight)


def test_hot_pixels_do_not_lean_the_white_reference(tmp_path):
    means = []
    for hot in (False, True):
        folder = tmp_path / str(hot)
        folder.mkdir()
        studio = Studio(folder, seed=55)
        places = hot_places(studio.rng, 400)
        if hot:
            studio.spoil = lambda mosaic, t, at=tuple(places.T): np.where(
                np.isin(np.arange(mosaic.size).reshape(mosaic.shape), np.ravel_multi_index(at, SIZE)),
                WHITE - 1500,
                mosaic,
            ).astype(np.uint16)
        studio.references(darks=4)
        white = Reference.load(studio.reference()).white["out"]
        means.append(evaluate_flat(white, SIZE[0] // 2, SIZE[1] // 2).mean(axis=(0, 1)))
    assert np.allclose(means[1], means[0], rtol=1e-3)


@given(
    seed=st.integers(0, 2**32 - 1),
    sigma=st.floats(0.1, 30.0),
    offset=st.floats(-100.0, 100.0),
    fraction=st.floats(0.0, 0.2),
)
@settings(deadline=None, max_examples=25)
def test_a_minority_of_hot_pixels_does_not_hide_itself(seed, sigma, offset, fraction):
    rng = np.random.default_rng(seed)
    frames = rng.normal(offset, sigma, (6, 100, 100))
    hot = rng.uniform(size=(100, 100)) < fraction
    frames[:, hot] += 20.0 * max(sigma, 1.0)
    found = hot_pixels(frames.mean(axis=0), frames.var(axis=0, ddof=1), 5)
    assert found[hot].all() and found[~hot].mean() < 1e-3


def test_an_environment_keeps_its_balance_and_none_of_the_sensors_faults(tmp_path):
    studio = Studio(tmp_path, seed=56)
    studio.references(darks=4)
    level = np.full((100, 200), 0.5)
    for state, exposure_s in (("out", 0.02), ("in", 0.05)):
        y, x = np.indices(level.shape)
        balance = BALANCE[("out", "in").index(state)][y % 2 + x % 2]
        studio.expose("environment", level * balance, state, exposure_s)
    response, valid, _, _ = studio.ingest("environment", IngestOptions())
    assert valid.all() and np.allclose(response.mean(axis=(0, 1)), 0.5, rtol=0.01)


@pytest.mark.parametrize("iso", [200.0])
def test_dark_frames_of_two_isos_are_refused(tmp_path, iso):
    studio = Studio(tmp_path, seed=57)
    studio.references()
    shots = [s.__class__(**{**s.__dict__, "iso": iso if n == 0 else 100.0}) for n, s in enumerate(studio.shots)]
    studio.shots = shots
    with pytest.raises(InputError, match="dark frames of ISO 100, 200"):
        ingest_reference(studio.table(), tmp_path, tmp_path / "r.h5", store.Provenance("t"), 1.0, SUPERPIXELS)


@pytest.mark.parametrize("freedom", [1, 3, 12])
@pytest.mark.parametrize("variance", [0.001, 4.0])
def test_a_restless_pixel_is_one_that_chance_does_not_give(freedom, variance):
    """All pixels of one variance, which is the median of their chi-square distribution, and one that varies more."""
    typical = max(variance * freedom / stats.chi2.median(freedom), 1 / 12)
    limit = typical * stats.chi2.isf(1e-9, freedom) / freedom
    seen = np.full((20, 30), variance)
    seen[3, 4], seen[5, 6] = 0.999 * limit, 1.001 * limit
    assert np.argwhere(hot_pixels(np.zeros((20, 30)), seen, freedom)).tolist() == [[5, 6]]


@pytest.mark.parametrize("sigma", [0.0, 3.0])
def test_a_bright_pixel_is_eight_deviations_above_the_others(sigma):
    # A median absolute deviation of sigma / 1.4826, and no less than what rounding leaves.
    level = 5.0 + np.where(np.arange(600) % 2, 1.0, -1.0).reshape(20, 30) * sigma / 1.4826
    limit = np.median(level) + 8.0 * max(sigma, np.sqrt(1 / 12))
    level[3, 5], level[5, 7] = limit - 0.1, limit + 0.1  # of the upper half, so that the median stays
    assert np.argwhere(hot_pixels(level, None, 0)).tolist() == [[5, 7]]


def test_the_line_of_each_pixel_is_that_of_least_squares_over_all_frames(tmp_path):
    """Of three exposure times, one of which was photographed three times; frames of equal time differ by chance alone.

    A pixel that is hot has neither an offset nor a rate, whatever it would make of the steps of the others.
    """
    rng, times = np.random.default_rng(9), np.array([0.4, 0.1, 0.4, 0.2, 0.1, 0.4])
    level = 500.0 + rng.uniform(-20.0, 20.0, (64, 96)) + rng.uniform(0.0, 100.0, (64, 96)) * times[:, None, None]
    frames = np.rint(level + 10.0 * (times[:, None, None] == 0.2) + rng.normal(0.0, 2.0, level.shape))
    frames[:, 7, 9] += 9000.0
    shots = [Shot("white.dng", "white", Pose(45.0, 0.0), "out", 0.1)]
    for number, (frame, time_s) in enumerate(zip(frames, times, strict=True)):
        dng(tmp_path / f"{number}.dng", (BLACK + frame).astype(np.uint16), exposure_s=time_s)
        shots.append(Shot(f"{number}.dng", "dark", Pose(45.0, 0.0), "out", float(time_s), 200.0))
    found = measure_dark(shots, tmp_path / "t.csv", tmp_path)
    rate, offset = np.polyfit(times, frames.reshape(6, -1), 1).reshape(2, 64, 96)
    sound = np.arange(64 * 96).reshape(64, 96) != 7 * 96 + 9
    assert found.exposures_s == (0.1, 0.2, 0.4) and found.iso == 200.0 and found.hot_px.tolist() == [[7, 9]]
    for stored, step, expected in ((found.rate, found.rate_step_dn_per_s, rate),
                                   (found.offset, found.offset_step_dn, offset)):  # fmt: skip
        assert not stored[7, 9] and step == pytest.approx(np.abs(expected[sound]).max() / 32_767, rel=1e-3)
        np.testing.assert_allclose((step * stored)[sound], expected[sound], atol=0.6 * step + 2e-3)
    for time_s in (0.0, 0.3):
        np.testing.assert_allclose(found.signal_dn(time_s)[sound], (offset + rate * time_s)[sound], atol=0.05)
    # Of one exposure time alone the signal is in proportion to time, without an offset.
    alone = measure_dark([s for s in shots if s.exposure_s == 0.4], tmp_path / "t.csv", tmp_path)
    mean = frames[times == 0.4].mean(axis=0)
    assert alone.offset is None
    np.testing.assert_allclose(alone.signal_dn(0.2)[sound], mean[sound] / 2.0, atol=0.02)
    assert measure_dark(shots[:1], tmp_path / "t.csv", tmp_path) is None
    # A frame of another size is named, wherever among the others it stands.
    dng(tmp_path / "3.dng", np.full((64, 98), BLACK + 500, np.uint16), exposure_s=0.2)
    with pytest.raises(InputError, match=r"3\.dng.*98 x 64 pixels.*96 x 64, as the first dark frame"):
        measure_dark(shots, tmp_path / "t.csv", tmp_path)
