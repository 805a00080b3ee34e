"""Linearity from an exposure series: a curved camera is found, a drifting lamp is not mistaken for one."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from raw_studio import BLACK, SIZE, SUPERPIXELS, Studio, dng
from raw_studio import WHITE as RAW_WHITE

from irodori.config.capture_table import Pose, Shot
from irodori.core import store
from irodori.core.errors import InputError
from irodori.ingest.camera_reference import ingest_reference
from irodori.ingest.dark_frames import Dark
from irodori.ingest.linearity import exposure_series, linear_fit, measure_linearity

WHITE = np.full((SIZE[0] // 2, SIZE[1] // 2, 6), 0.9)
EXPOSURES = (0.002, 0.006, 0.02, 0.035)


def compressed(strength):
    """A sensor whose response falls short by a share of the level: by `strength` at full well."""
    return lambda well: well * (1.0 - strength * np.minimum(well, 1.0))


def series(folder, seed, *, strength=0.0, drift=0.0, repeats=3, exposures=EXPOSURES, role="white"):
    studio = Studio(folder, seed)
    studio.curve = compressed(strength)
    lamp = np.random.default_rng([seed, 1])
    offset = drift * lamp.normal()
    memory = np.exp(-1 / 60)
    for _ in range(repeats):
        for exposure_s in exposures:
            offset = memory * offset + np.sqrt(1 - memory**2) * lamp.normal(scale=drift)
            studio.light = 1.0 + offset
            studio.shoot(role, WHITE, exposure_s=exposure_s)
    return studio


def measured(studio, limit=0.02):
    return measure_linearity(studio.shots, studio.table(), studio.folder, None, limit)


def test_a_linear_camera_in_steady_light_is_linear(tmp_path):
    found = measured(series(tmp_path, 61))
    assert found.exposure_s == EXPOSURES
    assert found.largest < 2e-3 and found.repeatability < 2e-3


@pytest.mark.parametrize("seed", range(62, 68))
def test_drift_of_the_light_is_not_mistaken_for_a_curve(tmp_path, seed):
    found = measured(series(tmp_path, seed, drift=0.01))
    assert found.largest < 4 * found.repeatability + 1e-3
    assert found.largest < 0.02


@pytest.mark.stability(stage="ingest", case="camera not linear")
def test_a_curved_camera_is_refused_with_what_was_found(tmp_path):
    studio = series(tmp_path, 68, strength=0.08, drift=0.01)
    with pytest.raises(InputError, match=r"deviates by .*max_nonlinearity"):
        measured(studio)
    found = measured(studio, limit=0.5)
    # Truth: rate of each exposure falls by its level; the brightest colour rules.
    wells = 0.9 * np.array(EXPOSURES) / 0.02 / studio.sensor.response_at_full_well
    rate = 1.0 - 0.08 * wells * 0.9  # vignetting takes a tenth on average
    assert found.deviation == pytest.approx(rate / rate.mean() - 1, abs=0.012)
    assert found.deviation[0] > found.deviation[-1] + 0.03


def test_without_repeats_the_doubt_is_said(tmp_path):
    studio = series(tmp_path, 69, strength=0.2, repeats=1)
    assert np.isnan(measured(studio, limit=0.5).repeatability)
    with pytest.raises(InputError, match="drift of the light counts too"):
        measured(studio)


def test_the_chart_serves_where_the_white_reference_has_no_series(tmp_path):
    studio = series(tmp_path, 70, role="chart", repeats=1)
    studio.shoot("white", WHITE)
    assert {s.role for s in exposure_series(studio.shots)} == {"chart"}
    assert measured(studio).largest < 3e-3


def test_a_series_of_the_white_reference_serves_before_a_longer_one_of_the_chart():
    def shots(role, *times):
        return [Shot(f"{role}-{time_s:g}.dng", role, Pose(45.0, 0.0), "out", time_s) for time_s in times]

    chart, dark = shots("chart", 0.01, 0.02, 0.04), shots("dark", 0.01, 0.02, 0.04, 0.08)
    white = shots("white", 0.01, 0.02)
    assert exposure_series([*dark, *chart, *white]) == white
    assert exposure_series([*dark, *chart, *white[:1]]) == chart
    assert exposure_series([*dark, *white[:1]]) == []


def test_two_exposures_are_a_series(tmp_path):
    """Of a camera that loses a fifth at full well, two levels show it, and the limit is met or not."""
    studio = series(tmp_path, 74, strength=0.2, exposures=(0.002, 0.03))
    found = measured(studio, limit=0.5)
    assert len(found.exposure_s) == 2 and found.deviation[0] > 0.02 > -0.02 > found.deviation[1]
    allowed = found.largest - 2.0 * found.repeatability
    measured(studio, limit=allowed + 1e-4)
    with pytest.raises(InputError, match="at a relative exposure of"):
        measured(studio, limit=allowed - 1e-4)


def test_one_exposure_tells_nothing(tmp_path):
    studio = series(tmp_path, 71, exposures=(0.02,))
    assert measured(studio) is None


def test_clipped_exposures_are_left_out_and_not_taken_for_a_curve(tmp_path):
    found = measured(series(tmp_path, 72, exposures=(0.002, 0.01, 0.02, 0.4)))
    assert found is None or found.largest < 3e-3


def test_the_reference_stores_the_series(tmp_path):
    studio = series(tmp_path, 73, drift=0.01)
    with store.open_file(studio.reference(SUPERPIXELS)) as file:
        values = file.read("linearity")
        assert tuple(file.read("exposure")) == EXPOSURES
        assert file.attribute("max_nonlinearity") == pytest.approx(np.abs(values).max())
        assert 0 < file.attribute("linearity_repeatability") < 0.02
    studio.curve = compressed(0.2)
    for exposure_s in EXPOSURES:
        studio.shoot("white", WHITE, exposure_s=exposure_s)
    studio.shots = studio.shots[-4:] * 1
    with pytest.raises(InputError, match="max_nonlinearity"):
        ingest_reference(studio.table(), tmp_path, tmp_path / "b.h5", store.Provenance("t"), 0.95, SUPERPIXELS)


def plain_series(folder, rate, dark_rate=0.0, iso=0.0, spoiled=(), offset=0):
    """Write frames of an even light, DN/s, and a dark signal, DN/s at ISO 100, some pixels at a level of their own.

    The offset, DN, is one that the black level does not tell.
    """
    shots = []
    for number, exposure_s in enumerate((0.01, 0.02, 0.04)):
        level = BLACK + offset + (rate + dark_rate * (iso / 100.0 if iso else 1.0)) * exposure_s
        mosaic = np.full((64, 96), round(level), np.uint16)
        for row, column in spoiled:
            mosaic[row, column] = BLACK + 3000
        dng(folder / f"{number}.dng", mosaic, exposure_s=exposure_s)
        shots.append(Shot(f"{number}.dng", "white", Pose(45.0, 0.0), "out", exposure_s, iso))
    return shots


@pytest.mark.parametrize("curved", ["R", "B"])
def test_of_a_camera_the_colour_that_deviates_most_is_told(tmp_path, curved):
    """One colour falls short by a fifth in the longest of three exposures, as its place in the mosaic alone shows."""
    shots = []
    for number, exposure_s in enumerate((0.01, 0.02, 0.04)):
        mosaic = np.full((64, 96), BLACK + 100_000 * exposure_s)
        rate = 0.8 if exposure_s == 0.04 else 1.0
        place = (slice(0, None, 2),) * 2 if curved == "R" else (slice(1, None, 2),) * 2
        mosaic[place] = BLACK + rate * 60_000 * exposure_s
        dng(tmp_path / f"{number}.dng", np.rint(mosaic).astype(np.uint16), exposure_s=exposure_s)
        shots.append(Shot(f"{number}.dng", "white", Pose(45.0, 0.0), "out", exposure_s))
    found = measure_linearity(shots, tmp_path / "t.csv", tmp_path, None, 0.2)
    expected = np.array([1.0, 1.0, 0.8]) / (2.8 / 3.0) - 1.0
    assert found.deviation == pytest.approx(expected, abs=1e-3) and found.exposure_s == (0.01, 0.02, 0.04)
    # A twentieth of a colour's pixels has to be below nine tenths of the range.
    for share, counted in ((0.04, 0.0), (0.06, 1.0)):
        spoilt = np.full((64, 96), 16000)
        spoilt[:, : round(96 * share / 2) * 2] = BLACK + 4000
        dng(tmp_path / "2.dng", spoilt.astype(np.uint16), exposure_s=0.04)
        measured_ = measure_linearity(shots, tmp_path / "t.csv", tmp_path, None, 0.5)
        assert (measured_ is not None) == bool(counted)


def dark_of(rate: float, hot=((0, 0),)) -> Dark:
    return Dark(None, np.ones((64, 96), np.int16), 0.0, rate, 100.0, (1.0,), np.array(hot, np.int32))


@pytest.mark.parametrize("iso", [0.0, 100.0, 400.0])
def test_the_dark_signal_is_no_part_of_the_response(tmp_path, iso):
    rate, dark_rate = 100_000.0, 20_000.0
    shots = plain_series(tmp_path, rate, dark_rate, iso)
    found = measure_linearity(shots, tmp_path / "t.csv", tmp_path, dark_of(dark_rate), 0.001)
    assert found.largest < 2e-4
    # In proportion to time it would pass for light; of frames at another ISO it would not.
    with pytest.raises(InputError, match="max_nonlinearity"):
        offset = replace(dark_of(dark_rate), offset=np.full((64, 96), 500, np.int16), offset_step_dn=1.0)
        measure_linearity(shots, tmp_path / "t.csv", tmp_path, offset, 0.02)
    lifted = plain_series(tmp_path, rate, dark_rate, iso, offset=500)
    assert measure_linearity(lifted, tmp_path / "t.csv", tmp_path, offset, 0.001).largest < 2e-4


def test_of_a_series_of_apertures_the_dark_signal_is_that_of_the_iso(tmp_path):
    """Frames of one time: the darkness is the same in all, four times that of the dark frames at ISO 100."""
    shots = []
    for number, f_number in enumerate((8.0, 5.6, 4.0)):
        level = BLACK + 1000.0 + 2000.0 * (4.0 / f_number) ** 2
        dng(tmp_path / f"{number}.dng", np.full((64, 96), round(level), np.uint16), exposure_s=0.02)
        shots.append(Shot(f"{number}.dng", "white", Pose(45.0, 0.0), "out", 0.02, 400.0, f_number))
    found = measure_linearity(shots, tmp_path / "t.csv", tmp_path, dark_of(250.0 / 0.02), 0.002)
    assert len(found.exposure_s) == 3 and found.largest < 1e-3


@pytest.mark.parametrize(("share", "counted"), [(0.0048, 2), (0.0053, 3)])
def test_an_exposure_counts_from_a_two_hundredth_of_the_range_between_black_and_white_on(tmp_path, share, counted):
    shots = plain_series(tmp_path, share * (RAW_WHITE - BLACK) / 0.01)
    found = measure_linearity(shots, tmp_path / "t.csv", tmp_path, None, 0.02)
    assert len(found.exposure_s) == counted


def test_hot_pixels_do_not_bend_the_response(tmp_path):
    spoiled = [(row, column) for row in range(0, 64, 4) for column in range(0, 96, 4)]
    shots = plain_series(tmp_path, 100_000.0, spoiled=spoiled)
    with pytest.raises(InputError, match="max_nonlinearity"):
        measure_linearity(shots, tmp_path / "t.csv", tmp_path, None, 0.02)
    assert measure_linearity(shots, tmp_path / "t.csv", tmp_path, dark_of(0.0, spoiled), 0.001).largest < 2e-4


@given(
    deviation=st.lists(st.floats(-0.1, 0.1), min_size=2, max_size=6),
    slope=st.floats(-0.05, 0.05),
    repeats=st.integers(3, 6),
)
@example(deviation=[0.0, 0.05], slope=0.05, repeats=2)  # the fewest photographs that tell both
@settings(deadline=None, max_examples=40)
def test_a_steady_drift_falls_out_of_interleaved_exposures(deviation, slope, repeats):
    count = len(deviation)
    exposure = np.tile(np.geomspace(0.001, 1.0, count), repeats)
    rate = 3.0 * (1.0 + np.tile(deviation, repeats)) * 1.0
    rate = rate + 3.0 * slope * np.linspace(-0.5, 0.5, len(rate))
    _, found, error = linear_fit(exposure, rate)
    truth = (1.0 + np.array(deviation)) / (1.0 + np.mean(deviation)) - 1.0
    assert np.allclose(found, truth, atol=1e-9) and error < 1e-9


@pytest.mark.parametrize("drift", [0.0, 0.01])
def test_the_standard_error_of_a_deviation_is_its_scatter(drift):
    """Of the exposure that is known least: the shortest is photographed once, the others more often."""
    rng, exposure = np.random.default_rng(8), np.array([1.0, 2.0, 4.0, 2.0, 4.0, 2.0, 4.0, 4.0])
    rate = 5.0 * (1.0 + drift * np.linspace(-1.0, 1.0, 8) + rng.normal(0.0, 0.003, (800, 8)))
    found = [linear_fit(exposure, one) for one in rate]
    scatter = np.std([deviation for _, deviation, _ in found], axis=0)
    stated = np.sqrt(np.mean([error**2 for *_, error in found]))
    assert scatter[0] == scatter.max() and stated == pytest.approx(scatter[0], rel=0.08)
