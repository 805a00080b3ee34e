"""Exposure, ISO and aperture by table and file: agreed within a twentieth, filled in, or refused."""

from dataclasses import replace

import numpy as np
import pytest

from irodori.config.capture_table import Pose, Shot
from irodori.core.errors import InputError
from irodori.ingest.exposure_settings import (
    filter_states,
    iso_ratio,
    known_settings,
    relative_exposure_s,
    settle,
    settle_set,
)
from irodori.ingest.mosaic import Mosaic

LEVELS = np.zeros((2, 2), np.float32)
WHITE = Shot("a.dng", "white", Pose(45.0, 0.0), "out", 0.02)


def mosaic(exposure_s=0.0, iso=0.0, f_number=0.0) -> Mosaic:
    return Mosaic(np.zeros((2, 2), np.uint16), "RGGB", LEVELS, LEVELS, 1.0, exposure_s, iso, f_number, 0)


@pytest.mark.parametrize("column", ["exposure_s", "iso", "f_number"])
@pytest.mark.parametrize(("own", "agrees"), [(1.049, True), (0.951, True), (1.051, False), (0.949, False)])
def test_a_file_agrees_with_its_table_within_a_twentieth(column, own, agrees):
    shot = replace(WHITE, **{column: 4.0})
    if agrees:
        assert getattr(settle(shot, mosaic(**{column: 4.0 * own}), "t.csv"), column) == 4.0
        return
    with pytest.raises(InputError, match=f"t.csv: {column}: .*{column} 4 for a.dng.*{4 * own:g} as the file itself"):
        settle(shot, mosaic(**{column: 4.0 * own}), "t.csv")


def test_what_one_is_silent_on_the_other_says():
    assert settle(WHITE, mosaic(0.02, 400.0, 5.6), "t.csv") == replace(WHITE, iso=400.0, f_number=5.6)
    stated = replace(WHITE, iso=200.0, f_number=8.0)
    assert settle(stated, mosaic(), "t.csv") == stated
    assert settle(WHITE, mosaic(), "t.csv") == WHITE


def test_a_set_takes_the_setting_that_some_of_its_files_know():
    known, silent = replace(WHITE, iso=100.0, f_number=8.0), replace(WHITE, file="b.dng")
    near = replace(WHITE, file="c.dng", iso=104.9, f_number=8.39)
    assert settle_set([silent, known, near], "t.csv") == [replace(silent, iso=100.0, f_number=8.0), known, near]
    assert settle_set([silent, silent], "t.csv") == [silent, silent]
    apart = replace(near, iso=200.0, f_number=16.0)
    assert settle_set([known, apart], "t.csv") == [known, apart]  # nobody is silent


@pytest.mark.parametrize("column", ["iso", "f_number"])
def test_a_set_whose_known_settings_differ_tells_nothing_of_the_silent(column):
    shots = [replace(WHITE, **{column: 100.0}), replace(WHITE, **{column: 105.1}), replace(WHITE, file="b.dng")]
    with pytest.raises(InputError, match=f"t.csv: {column}: .*no {column} for b.dng, while others have 100 to 105.1"):
        settle_set(shots, "t.csv")
    shots[1] = replace(WHITE, **{column: 104.9})
    assert getattr(settle_set(shots, "t.csv")[2], column) == 100.0


def test_the_aperture_of_a_dark_frame_does_not_count_and_its_iso_does():
    dark = replace(WHITE, role="dark", iso=100.0, f_number=22.0)
    shots = [dark, replace(WHITE, f_number=8.0), replace(WHITE, file="b.dng")]
    assert [s.f_number for s in settle_set(shots, "t.csv")] == [22.0, 8.0, 8.0]
    assert [s.iso for s in settle_set(shots, "t.csv")] == [100.0] * 3
    silent = replace(dark, f_number=0.0)
    assert settle_set([silent, replace(WHITE, iso=100.0, f_number=8.0)], "t.csv")[0].f_number == 0.0
    assert known_settings([dark]) == [] and known_settings([dark, replace(WHITE, f_number=8.0)]) == ["f_number"]
    assert known_settings([replace(WHITE, iso=100.0), WHITE]) == ["iso"]
    assert known_settings([replace(WHITE, iso=100.0, f_number=8.0)]) == ["iso", "f_number"]


def test_exposures_are_compared_by_time_amplification_and_aperture():
    assert relative_exposure_s(WHITE) == 0.02
    assert relative_exposure_s(replace(WHITE, iso=400.0)) == pytest.approx(0.08)
    assert relative_exposure_s(replace(WHITE, f_number=4.0)) == pytest.approx(0.02 / 16.0)
    assert relative_exposure_s(replace(WHITE, iso=50.0, f_number=2.0)) == pytest.approx(0.0025)
    assert iso_ratio(replace(WHITE, iso=400.0), 100.0) == 4.0
    assert iso_ratio(WHITE, 100.0) == iso_ratio(replace(WHITE, iso=400.0), 0.0) == 1.0


def test_states_of_the_filter_have_the_order_of_the_bands():
    inside = replace(WHITE, filter="in")
    assert filter_states([inside, WHITE, inside]) == filter_states(iter([WHITE, inside])) == ["out", "in"]
    assert filter_states([inside]) == ["in"] and filter_states([]) == []
