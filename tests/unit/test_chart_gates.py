"""Charts that are not what they are said to be: refused with the likeliest cause, or named."""

import numpy as np
import pytest
from made import made
from made_up_camera import patches, system

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.stage import calibrate_camera
from irodori.config.models import Camera
from irodori.config.parts import CalibratedCamera
from irodori.core import store
from irodori.core.errors import InputError
from irodori.report.calibration_part import camera_calibrations
from irodori.report.html_page import fragment
from irodori.spectra.published import chart_spectra

NAMES = chart_spectra("BabelColor Average")[0]
CORNERS = {"first": [11, 11], "row_end": [111, 11], "column_end": [11, 71], "last": [111, 71]}
CHART = {"spectra": "BabelColor Average", "rows": 4, "columns": 6, "patch_px": 12, "centres_px": CORNERS}
PINV = {"estimator": "pinv", "bases": 6}


def picture(responses=None) -> np.ndarray:
    """Return a picture of 4 x 6 patches in a dark frame, (82, 122, bands)."""
    responses = patches() @ system().T if responses is None else responses
    cells = np.full((4, 6, 20, 20, responses.shape[1]), 0.04)
    cells[:, :, 1:19, 1:19] = responses.reshape(4, 6, 1, 1, -1)
    whole = cells.swapaxes(1, 2).reshape(80, 120, -1)
    noise = 0.0005 * np.random.default_rng(0).standard_normal((82, 122, whole.shape[2]))
    return np.pad(whole, ((1, 1), (1, 1), (0, 0)), constant_values=0.04) + noise


def calibrate(folder, response, chart=CHART, settings=None, **selection) -> Calibration:
    """Run the stage on a picture and return what it wrote."""
    linear = folder / "chart.h5"
    with store.create(linear, store.Provenance("test")) as out:
        out.write("response", response.astype(np.float32), units="1", dims="row,column,band", quantity="response")
        valid = np.ones(response.shape[:2], np.uint8)
        out.write("valid", valid, units="1", dims="row,column", quantity="valid")
        out.attribute("pose_deg", [0.0, 0.0, 0.0, 0.0])
        out.attribute("sample_px", 2)
        out.attribute("filters", ["out", "in"][: response.shape[2] // 3])
    camera = made(Camera | CalibratedCamera, {"chart": chart, "calibration": PINV if settings is None else settings})
    calibrate_camera(linear, camera, "A", folder / "c.h5", folder / "c.csv", store.Provenance("test"), **selection)
    return Calibration.load(folder / "c.h5")


def refusal(folder, response, **changes) -> InputError:
    with pytest.raises(InputError) as caught:
        calibrate(folder, response, **changes)
    assert [path.name for path in folder.iterdir()] == ["chart.h5"]
    return caught.value


def named(**corners) -> dict:
    return {name: CORNERS[at] for name, at in corners.items()}


ROWS_AND_COLUMNS = named(first="first", row_end="column_end", column_end="row_end", last="last")
HEAD_DOWN = named(first="last", row_end="column_end", column_end="row_end", last="first")
MIRRORED = named(first="row_end", row_end="first", column_end="last", last="column_end")


@pytest.mark.parametrize(("said", "kept"), [({}, 0.05), ({"light_error_percent": 1.5}, 0.015)])
def test_how_far_the_lamp_may_differ_is_what_is_said_or_what_a_name_allows(tmp_path, said, kept):
    assert calibrate(tmp_path, picture(), **said).light_error == pytest.approx(kept)


@pytest.mark.stability(stage="calibrate", case="chart read in another order")
@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rows": 6, "columns": 4}, "read as 4 rows of 6 columns (spectral"),
        ({"centres_px": ROWS_AND_COLUMNS}, "read with row_end and column_end of its corners exchanged (spectral"),
        ({"rows": 6, "columns": 4, "centres_px": ROWS_AND_COLUMNS},
         "read as 4 rows of 6 columns, with row_end and column_end of its corners exchanged (spectral"),
        ({"centres_px": HEAD_DOWN}, "read turned (spectral"),
        ({"centres_px": MIRRORED}, "read mirrored (spectral"),
    ],
)  # fmt: skip
def test_a_chart_read_in_another_order_is_refused_with_the_order_that_fits(tmp_path, changes, said):
    error = refusal(tmp_path, picture(), chart=CHART | changes)
    assert error.field == "chart" and said in error.found


@pytest.mark.stability(stage="calibrate", case="patches covered")
@pytest.mark.parametrize(
    ("patch", "cover"), [(5, 0.02), (5, 0.3), (8, 0.8), (14, 0.3), (14, 0.8), (20, 0.02), (20, 0.9)]
)
def test_a_covered_patch_is_named(tmp_path, patch, cover):
    responses = patches() @ system().T
    responses[patch] = cover
    error = refusal(tmp_path, picture(responses))
    assert f"CIEDE2000 of {NAMES[patch]} (" in error.found and "covered" in error.found
    assert " and " not in error.found


@pytest.mark.stability(stage="calibrate", case="patches exchanged")
@pytest.mark.parametrize(("one", "other"), [(0, 7), (1, 8), (12, 13), (18, 23)])
def test_two_patches_exchanged_are_named(tmp_path, one, other):
    responses = patches() @ system().T
    responses[[one, other]] = responses[[other, one]]
    found = refusal(tmp_path, picture(responses)).found
    assert f"of {NAMES[one]} (" in found and f" and {NAMES[other]} (" in found and found.endswith("as if exchanged")


def test_a_chart_covered_by_something_alike_is_no_fault(tmp_path):
    responses = patches() @ system().T
    responses[8] *= 1.02
    assert calibrate(tmp_path, picture(responses)).estimator == "pinv"


@pytest.mark.stability(stage="calibrate", case="all patches dirty")
def test_a_chart_of_dirty_patches_is_refused_and_a_few_are_not(tmp_path):
    dirty = picture()
    for row in range(4):
        for column in range(6):
            dirty[20 * row + 6 : 20 * row + 11, 20 * column + 6 : 20 * column + 11] *= 0.5
            if (row, column) == (0, 2):
                assert calibrate(tmp_path, dirty).estimator == "pinv"
                for path in tmp_path.iterdir():
                    path.unlink()
    error = refusal(tmp_path, dirty)
    assert error.field == "chart" and "24 of 24 patches with dirt" in error.found


@pytest.mark.stability(stage="calibrate", case="spectra of no such chart")
def test_a_large_error_of_patches_left_out_is_refused_beyond_the_limit(tmp_path):
    unlike = picture(np.random.default_rng(3).permutation(patches()) @ system().T)
    error = refusal(tmp_path, unlike)
    assert "in the mean over patches left out (D65)" in error.found
    assert "calibration.max_leave_one_out_error, 10:" in error.accepted
    lenient = PINV | {"max_leave_one_out_error": 100.0, "max_noise_amplification": 1000.0}
    assert "calibration.max_level_difference" in refusal(tmp_path, unlike, settings=lenient).accepted


@pytest.mark.default_cases(2)
@pytest.mark.stability(stage="calibrate", case="white reference in other light than the chart")
@pytest.mark.parametrize("level", [0.7, 1.43])
@pytest.mark.parametrize(("bands", "named"), [(slice(0, 6), "filter"), (slice(3, 6), "filter in")])
def test_a_chart_that_contradicts_the_white_reference_is_refused(tmp_path, level, bands, named):
    """No patch contradicts the others then: gloss weights, or colours, would be wrong by as much, and nothing else."""
    responses = patches() @ system().T
    responses[:, bands] *= level
    error = refusal(tmp_path, picture(responses))
    assert error.field == "chart" and f"a chart {level:.2f}" in error.found and named in error.found
    assert "the white reference say" in error.found and "calibration.max_level_difference" in error.accepted
    calibrate(tmp_path, picture(responses), settings=PINV | {"max_level_difference": 0.5})


@pytest.mark.parametrize(("level", "is_said"), [(1.0, False), (1.02, False), (0.95, True)])
def test_the_level_of_the_chart_is_kept_and_a_small_difference_is_said(tmp_path, caplog, level, is_said):
    calibrate(tmp_path, picture(level * patches() @ system().T))
    with store.open_file(tmp_path / "c.h5") as file:
        assert file.attribute("level") == pytest.approx([level] * 6, rel=0.01)
    assert ("gloss or colours may be wrong by as much" in caplog.text) == is_said


def test_the_limit_of_the_error_is_the_configured_one(tmp_path):
    error = refusal(tmp_path, picture(), settings=PINV | {"max_leave_one_out_error": 0.3})
    assert "calibration.max_leave_one_out_error, 0.3:" in error.accepted


@pytest.mark.heavy
@pytest.mark.stability(stage="calibrate", case="spectra of another published chart")
def test_a_published_chart_that_fits_better_is_named_in_log_and_report(tmp_path, caplog):
    table = {"selection": tmp_path / "s.csv"}
    for spectra, is_named in (("ISO 17321-1", True), ("BabelColor Average", False)):
        caplog.clear()
        calibrate(tmp_path, picture(), chart=CHART | {"spectra": spectra}, **table)
        assert ("agrees clearly better with the spectra of BabelColor Average" in caplog.text) == is_named
        written = [[tmp_path / name] for name in ("c.h5", "c.csv", "s.csv")]
        page = fragment("calibration.html.j2", calibrations=camera_calibrations(["a"], *written))
        assert ("agree clearly better with the photograph of chart" in page) == is_named


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(("bands", "settings", "estimator", "bases"), [
    (3, {"estimator": "pinv"}, "pinv", {3}),
    (6, {"estimator": "wiener"}, "wiener", {6}),
    (3, {}, "broad", {3, 4, 5, 6, 7, 8, 10, 12}),
])  # fmt: skip
def test_what_a_camera_leaves_unsaid_follows_from_its_bands(tmp_path, bands, settings, estimator, bases):
    found = calibrate(tmp_path, picture(patches() @ system()[:bands].T), settings=settings)
    assert found.estimator == estimator and found.basis.shape[1] in bases
