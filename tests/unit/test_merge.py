"""Merging brackets: linear over four decades, no lean from weights or clipping, the best noise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from raw_studio import SENSOR

from irodori.ingest.develop import empty_response
from irodori.ingest.flat_field import evaluate_flat
from irodori.ingest.merge import ABSENT, ExposureBracket, PatternPlanes, merge

GAIN = SENSOR.electrons_per_dn
READ_DN2 = (SENSOR.read_noise_e / GAIN) ** 2 + 1 / 12
FULL = SENSOR.white_level - SENSOR.black_level
GREY = np.array([0.25, 0.5, 0.25])  # of the bands, one share a mosaic pixel


def photograph(level: np.ndarray, exposures, rng):
    return np.stack([SENSOR.expose(level, e, rng) for e in exposures])


def merged(frames, exposures, dark=True, noise=(GAIN, READ_DN2), saturation=0.98, white=None):
    """Merge an RGGB bracket by what is truly known of the sensor."""
    exposures = np.array(exposures)
    count = len(exposures)
    black = np.full((4, count), float(SENSOR.black_level))
    clip = black + saturation * FULL
    if dark:
        black = black + SENSOR.dark_current_e_per_s * exposures / GAIN
    samples = tuple(frames[:, r::2, c::2] for r in (0, 1) for c in (0, 1))
    planes = PatternPlanes(samples, np.array([0, 1, 1, 2]), black, clip, (ABSENT,) * 4, (ABSENT,) * 4, (0.0, 0.0))
    bracket = ExposureBracket(exposures * FULL, exposures, np.full(count, noise[0]), np.full(count, noise[1]))
    height, width = (side // 2 for side in frames.shape[1:])
    out, clipped = empty_response(height, width, 1), np.zeros((height, width), np.bool_)
    shares = merge(planes, bracket, white, 2, out, clipped)
    return out, clipped, shares


def true_rate(response):
    return response / SENSOR.response_at_full_well / SENSOR.base_exposure_s


BRACKETS = ([0.002, 0.02], [0.0002, 0.02], [0.00125, 0.005, 0.02])


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("exposures", BRACKETS, ids=["1:10", "1:100", "1:4:16"])
def test_the_response_is_linear_to_a_thousandth_over_four_decades(exposures):
    rng = np.random.default_rng(31)
    worst = 0.0
    for level in np.geomspace(0.0015, 15.0, 13):
        side = 1024 if level < 0.02 else 256
        out, clipped, _ = merged(photograph(np.full((side, side), level), exposures, rng), exposures)
        grey = out.reshape(-1, 3) @ GREY
        assert not clipped.any()
        error, deviation = grey.std() / np.sqrt(grey.size) / true_rate(level), grey.mean() / true_rate(level) - 1
        # The mean of so many samples is known well enough to see a thousandth.
        assert 4 * error < 1e-3
        worst = max(worst, abs(deviation))
    assert worst < 1e-3


@pytest.mark.parametrize("exposures", BRACKETS, ids=["1:10", "1:100", "1:4:16"])
def test_no_lean_where_the_long_exposure_nears_clipping(exposures):
    rng = np.random.default_rng(32)
    # From half the range of the longest exposure to beyond it: selection by noise would show as a dip or a bump.
    for fraction in np.arange(0.5, 1.1, 0.05):
        level = fraction * SENSOR.response_at_full_well
        out, clipped, _ = merged(photograph(np.full((256, 256), level), exposures, rng), exposures)
        assert not clipped.any()
        assert abs(float((out.reshape(-1, 3) @ GREY).mean()) / true_rate(level) - 1) < 5e-4


@pytest.mark.parametrize("exposures", BRACKETS, ids=["1:10", "1:100", "1:4:16"])
def test_texture_near_clipping_is_measured_pixel_by_pixel(exposures):
    rng = np.random.default_rng(33)
    level = (
        np.exp(rng.uniform(np.log(0.02), np.log(8.0), (512, 512))).repeat(2, axis=0).repeat(2, axis=1)
    )  # an even superpixel each
    out, clipped, _ = merged(photograph(level, exposures, rng), exposures)
    ratio = (out @ GREY) / true_rate(level[::2, ::2])
    assert not clipped.any()
    for low, high in ((0.02, 0.5), (0.5, 1.0), (1.0, 1.4), (1.4, 1.8), (1.8, 8.0)):
        inside = (level[::2, ::2] >= low) & (level[::2, ::2] < high)
        assert abs(ratio[inside].mean() - 1) < 1e-3, (low, high)


@pytest.mark.parametrize("level", [0.002, 0.02, 0.2, 1.0])
def test_a_bracket_has_the_variance_of_the_inverse_variance_mean(level):
    rng = np.random.default_rng(34)
    exposures = np.array([0.01, 0.02])
    out, _, _ = merged(photograph(np.full((512, 512), level), exposures, rng), exposures)
    electrons = level * SENSOR.full_well_e / SENSOR.response_at_full_well * exposures / SENSOR.base_exposure_s
    variances = (electrons / GAIN**2 + READ_DN2) / (exposures * FULL) ** 2
    best = 1 / np.sum(1 / variances)
    assert out[..., 0].var() == pytest.approx(best, rel=0.03)
    assert out[..., 1].var() == pytest.approx(best / 2, rel=0.03)  # two greens


def test_without_known_noise_samples_weigh_by_exposure():
    rng = np.random.default_rng(35)
    frames = photograph(np.full((64, 64), 0.3), [0.002, 0.02], rng)
    out, _, _ = merged(frames, [0.002, 0.02], dark=False, noise=(np.nan, np.nan))
    signal = frames.astype(float) - SENSOR.black_level
    expected = signal.sum(axis=0) / (0.022 * FULL)
    assert np.allclose(out[..., 0], expected[::2, ::2], rtol=1e-5)


@pytest.mark.stability(stage="ingest", case="clipped samples in a bracket")
def test_samples_at_the_clip_level_are_never_used():
    rng = np.random.default_rng(36)
    frames = photograph(np.full((64, 64), 0.3), [0.002, 0.02], rng)
    frames[1, 10:20, 10:20] = SENSOR.white_level  # a flash in the long exposure alone
    frames[:, 40:44, 40:44] = SENSOR.white_level
    out, clipped, shares = merged(frames, [0.002, 0.02])
    # Of each band's samples every exposure gave those that are not clipped: green has two in a superpixel.
    lost = np.array([[4, 4 + 25], [8, 8 + 50], [4, 4 + 25]]) / np.array([[1024], [2048], [1024]])
    assert shares == pytest.approx(1.0 - lost)
    assert merged(frames[1:], [0.02])[2].tolist() == [[1.0]] * 3
    short = (frames[0, 10:20, 10:20].astype(float) - SENSOR.black_level - 0.002 * 2 / GAIN) / (0.002 * FULL)
    assert np.allclose(out[5:10, 5:10, 0], short[::2, ::2], rtol=1e-5)
    expected = np.zeros((32, 32), bool)
    expected[20:22, 20:22] = True
    assert np.array_equal(clipped, expected) and (out[expected] == 0).all()


@given(
    levels=st.lists(st.floats(0.0, 100.0), min_size=1, max_size=6),
    exposures=st.lists(st.floats(1e-4, 10.0), min_size=1, max_size=4, unique=True),
    noise=st.sampled_from([(GAIN, READ_DN2), (np.nan, np.nan), (1e-3, 1e-3), (1e4, 1e6)]),
)
@settings(deadline=None, max_examples=40)
def test_no_bracket_gives_a_number_that_is_not_finite(levels, exposures, noise):
    rng = np.random.default_rng(37)
    exposures = sorted(exposures)
    level = np.resize(levels, (22, 34))
    out, clipped, shares = merged(photograph(level, exposures, rng), exposures, noise=noise)
    assert np.isfinite(out).all() and (out[clipped] == 0).all()
    assert ((shares >= 0) & (shares <= 1)).all()
    # What the shortest exposure holds by a wide margin is measured.
    held = level * exposures[0] / SENSOR.base_exposure_s < 0.8 * SENSOR.response_at_full_well
    assert not clipped[held.reshape(11, 2, 17, 2).all(axis=(1, 3))].any()


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("exposures", [[0.02], [0.002, 0.02]], ids=["one", "two"])
def test_the_flat_field_is_divided_out_where_it_lies(exposures):
    rng = np.random.default_rng(38)
    white = np.zeros((3, 15))
    white[:, 0], white[:, 1:] = [20.0, 25.0, 30.0], rng.uniform(-1.0, 1.0, (3, 14))
    frames = photograph(np.full((64, 96), 0.5), exposures, rng)
    plain, _, _ = merged(frames, exposures)
    flat, _, _ = merged(frames, exposures, white=white)
    assert np.allclose(flat * evaluate_flat(white, 32, 48), plain, rtol=1e-5, atol=1e-6)
    # A level of each band alone is the same all over the picture, also in one that is a single superpixel.
    for part in (frames, frames[:, :2, :2]):
        level, _, _ = merged(part, exposures, white=white[:, 0])
        assert np.allclose(level * white[:, 0], merged(part, exposures)[0], rtol=1e-5, atol=1e-6)
