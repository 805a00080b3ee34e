"""The verdict of heritage-imaging guidelines: every tolerance met by the metric that it is written for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from irodori.calibration.verdict import (
    TOLERANCES,
    colour_differences,
    differences_of_lab,
    judge,
    neutral_differences,
)
from irodori.report.calibration_part import guideline_rows
from irodori.spectra.published import chart_spectra

GREYS = np.linspace(0.05, 0.9, 30)[:, None] * np.ones(61)
LAB = st.tuples(st.floats(0.0, 100.0), st.floats(-80.0, 80.0), st.floats(-80.0, 80.0))


def levels_reached(verdicts) -> dict[str, str]:
    """Return the highest level of each guideline all of whose colour limits are kept; ``none`` where none is."""
    reached = {}
    for guideline in dict.fromkeys(v.tolerance.guideline for v in verdicts):
        own = [v for v in verdicts if v.tolerance.guideline == guideline and v.tolerance.quantity == "colour accuracy"]
        # Levels stand from the strictest on.
        levels = dict.fromkeys(v.tolerance.level for v in own)
        passed = (level for level in levels if all(v.passes for v in own if v.tolerance.level == level))
        reached[guideline] = next(passed, "none")
    return reached


def lightness(greys):
    y = greys[:, 0]
    return np.where(y > (6 / 29) ** 3, 116.0 * np.cbrt(y) - 16.0, 116.0 * y * (29 / 6) ** 2 / 3)


def test_a_difference_in_lightness_is_weighed_as_each_metric_weighs_it():
    other = 1.1 * GREYS
    step, mean = lightness(other) - lightness(GREYS), 0.5 * (lightness(other) + lightness(GREYS))
    differences = colour_differences(GREYS, other)
    weight = 1.0 + 0.015 * (mean - 50.0) ** 2 / np.sqrt(20.0 + (mean - 50.0) ** 2)
    assert differences["CIE 1976"] == pytest.approx(step, abs=1e-6)
    assert differences["CIEDE2000 S_L=1"] == pytest.approx(step, abs=1e-6)
    assert differences["CIEDE2000"] == pytest.approx(step / weight, abs=1e-6)


@given(first=LAB, second=LAB)
def test_without_the_weight_of_lightness_ciede2000_is_as_large_or_larger(first, second):
    differences = differences_of_lab(np.array([first]), np.array([second]))
    assert differences["CIEDE2000 S_L=1"][0] >= differences["CIEDE2000"][0] - 1e-9


@given(first=LAB, chroma=st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0)))
def test_colours_of_one_lightness_differ_alike_with_and_without_the_weight(first, chroma):
    second = (first[0], first[1] + chroma[0], first[2] + chroma[1])
    differences = differences_of_lab(np.array([first]), np.array([second]))
    assert differences["CIEDE2000 S_L=1"] == pytest.approx(differences["CIEDE2000"], abs=1e-9)


def test_a_perfect_calibration_reaches_the_highest_level_of_every_guideline():
    _, patches = chart_spectra("BabelColor Average")
    verdicts = judge(patches, patches)
    assert len(verdicts) == len(TOLERANCES) and all(v.passes and v.measured < 1e-9 for v in verdicts)
    reached = levels_reached(verdicts)
    assert reached == {
        "FADGI 2016": "4 star",
        "FADGI 2023": "4 star",
        "Metamorfoze 1.0": "full",
        "Metamorfoze 2.0": "full",
        "ISO 19264-1:2021": "level A",
    }


def test_a_calibration_without_any_colour_reaches_none():
    _, patches = chart_spectra("BabelColor Average")
    grey = np.broadcast_to(patches.mean(axis=1, keepdims=True), patches.shape)
    assert set(levels_reached(judge(patches, grey)).values()) == {"none"}


def test_levels_fall_one_by_one_as_the_error_grows():
    _, patches = chart_spectra("BabelColor Average")
    order = ["4 star", "3 star", "2 star", "1 star", "none"]
    seen = []
    for error in np.linspace(0.0, 2.0, 80):
        reached = levels_reached(judge(patches, patches * (1.0 + error * np.linspace(1.0, 0.0, 61))))["FADGI 2016"]
        seen.append(order.index(reached))
    assert seen == sorted(seen) and set(seen) == set(range(5))


def test_one_bad_patch_fails_a_maximum_and_no_mean():
    _, patches = chart_spectra("BabelColor Average")
    estimate = patches.copy()
    estimate[0] = patches[12]
    rows = by_kind(judge(patches, estimate))
    assert rows["Metamorfoze 1.0", "full", "CIE 1976", "mean"].passes
    assert not rows["Metamorfoze 1.0", "full", "CIE 1976", "max"].passes
    assert not rows["ISO 19264-1:2021", "level C", "largest of the three formulas", "max"].passes
    assert rows["FADGI 2023", "4 star", "CIEDE2000", "p90"].passes
    # The patch is brown: what is neutral is as it was.
    assert rows["ISO 19264-1:2021", "level A", "ΔL*", "max"].measured < 1e-9


def by_kind(verdicts) -> dict:
    return {(v.tolerance.guideline, v.tolerance.level, v.tolerance.metric, v.tolerance.statistic): v for v in verdicts}


def test_measured_values_are_those_of_the_tolerances_metric_and_statistic():
    _, patches = chart_spectra("BabelColor Average")
    estimate = patches * np.linspace(0.9, 1.05, 61)
    differences = colour_differences(patches, estimate)
    largest = [max(of_patch) for of_patch in zip(*differences.values(), strict=True)]
    values = {**differences, **neutral_differences(patches, estimate), "largest of the three formulas": largest}
    statistics = {"mean": np.mean, "max": np.max, "p90": lambda values: np.percentile(values, 90)}
    for verdict in judge(patches, estimate):
        line = verdict.tolerance
        assert verdict.measured == pytest.approx(statistics[line.statistic](values[line.metric]))
        expected = verdict.measured < line.limit if line.strict else verdict.measured <= line.limit
        assert verdict.passes == expected
        assert (line.metric == "CIE 1976") == (line.guideline == "Metamorfoze 1.0")


def test_greys_that_come_back_darker_differ_in_lightness_alone():
    found = neutral_differences(GREYS, 0.9 * GREYS)
    assert found["ΔL*"] == pytest.approx(lightness(GREYS) - lightness(0.9 * GREYS), abs=1e-6)
    assert np.abs(found["Δ(a*, b*)"]).max() < 1e-9


def test_a_chart_without_a_neutral_patch_has_no_tone_response_and_reaches_nothing_by_it():
    colours = np.linspace(0.1, 0.9, 61) * np.linspace(0.3, 1.0, 5)[:, None]
    rows = guideline_rows(attributes(judge(colours, colours)))
    of_tone = [row for row in rows if row["quantity"] in ("tone response", "white balance")]
    assert of_tone and all(np.isnan(row["measured"]) for row in of_tone)
    assert {row["reached"] for row in of_tone} == {"not measured: no neutral patch"}
    assert {row["reached"] for row in rows if row not in of_tone} == {"4 star", "full", "level A"}


def attributes(verdicts) -> list[dict]:
    return [{**vars(v.tolerance), "measured": v.measured, "passes": v.passes} for v in verdicts]


def test_the_table_has_one_row_for_each_guideline_quantity_and_statistic_with_the_source_of_every_limit():
    _, patches = chart_spectra("BabelColor Average")
    # 3 % darker: the white patch loses about 1.2 of lightness.
    rows = guideline_rows(attributes(judge(patches, 0.97 * patches)))
    assert len(rows) == len({(v.guideline, v.metric, v.statistic) for v in TOLERANCES})
    assert {row["guideline"] for row in rows if row["read_in"] == "the document"} == {"FADGI 2016", "Metamorfoze 1.0"}
    assert all(row["source"] for row in rows)
    iso = next(row for row in rows if row["guideline"].startswith("ISO") and row["metric"] == "ΔL*")
    assert iso["limits"] == "level A ≤ 2, level B ≤ 3, level C ≤ 4" and iso["reached"] == "level A"
    assert iso["read_in"] == "a secondary source, not the document"
    older = next(row for row in rows if row["guideline"] == "FADGI 2016")
    assert older["limits"] == "4 star < 2, 3 star < 4, 2 star < 6, 1 star < 10"


@pytest.mark.parametrize(
    ("truth", "estimate"), [(GREYS, GREYS[:3]), (GREYS[:0], GREYS[:0]), (GREYS[0], GREYS[0]), (GREYS, GREYS * np.nan)]
)
def test_what_cannot_be_judged_is_refused(truth, estimate):
    with pytest.raises(ValueError, match="accepted"):
        judge(truth, estimate)
