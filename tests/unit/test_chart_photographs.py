"""Real photographs of a ColorChecker: found as by corners, steady when moved, and their vignetting."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import yaml
from chart_pictures import COLUMNS, ROWS
from definitions import ROOT
from made import made
from shortcuts import leave_one_out

from irodori.calibration.chart import locate_patches, read_located
from irodori.calibration.illumination import illumination
from irodori.colour.colorimetry import delta_e_reflectance, spectral_rmse
from irodori.config.models import Chart
from irodori.core.errors import InputError
from irodori.ingest.mosaic import decode
from irodori.spectra.published import chart_spectra

DATA = ROOT.parent / "shared" / "data"
TABLE = DATA / "reflectance" / "colorchecker_classic_24.csv"
#: As another person read the corners off the photograph, the last of them 17 superpixels from its patch.
ROUGH = {"first": [175.0, 162.0], "row_end": [956.0, 162.0], "column_end": [184.0, 629.0], "last": [969.0, 632.0]}
FOUND = {"spectra": str(TABLE), "rows": ROWS, "columns": COLUMNS, "find": "chart"}


def photograph(name: str):
    """Superpixels of a photograph and where they are valid; the test is skipped where it is not there."""
    for path in (DATA / "raw" / name, TABLE):
        if not path.is_file():
            pytest.skip(f"no {path.name} at {path}")
    mosaic = decode(DATA / "raw" / name)
    return mosaic.superpixels.astype(np.float64), mosaic.largest < 0.98


@pytest.fixture(scope="module")
def chart():
    """The photograph of the whole chart, its configuration, and where the chart is found."""
    response, valid = photograph("powershot_s40_chart.crw")
    configured = yaml.safe_load((ROOT / "config/cameras/powershot-s40.yaml").read_text())["chart"]
    configured["spectra"] = str(TABLE)
    located = locate_patches(response, valid, made(Chart, FOUND | {"patch_px": configured["patch_px"]}), "chart.crw")
    return response, valid, configured, located


def errors(mean: np.ndarray) -> tuple[float, float]:
    """Mean spectral RMSE and CIEDE2000 under D65, leave-one-patch-out, three bases."""
    spectra = chart_spectra(str(TABLE))[1]
    recovered = leave_one_out(mean, spectra, 3, np.ones(61))
    return spectral_rmse(spectra, recovered).mean(), delta_e_reflectance(spectra, recovered, "D65").mean()


def distances(one, other) -> np.ndarray:
    return np.linalg.norm(one.centres_px - other.centres_px, axis=1)


@pytest.mark.heavy
def test_patches_found_and_by_corners_agree_to_two_superpixels(chart):
    response, valid, configured, found = chart
    assert configured["find"] == "edges"
    by_corners = locate_patches(response, valid, made(Chart, configured), "chart.crw")
    assert distances(found, by_corners).max() <= 2.0
    assert by_corners.found["moved_px"] <= 4.0, "the corners themselves, but for what the lens bends"
    rough = locate_patches(response, valid, made(Chart, configured | {"centres_px": ROUGH}), "chart.crw")
    assert distances(found, rough).max() <= 2.0 < rough.found["moved_px"]
    # The corner patches, where no perspective map is between the reading and the finding, as read by eye.
    read = np.array([configured["centres_px"][k] for k in ("first", "row_end", "column_end", "last")])
    assert np.linalg.norm(found.centres_px[[0, 5, 18, 23]] - read, axis=1).max() <= 2.0
    assert found.found["rmse"] < 0.05 < 0.2 < found.found["next_rmse"]


@pytest.mark.heavy
@pytest.mark.parametrize("quarters", [1, 2])
def test_a_photograph_that_lies_on_its_side_or_head_is_read_right(chart, quarters):
    response, valid, _, upright = chart
    found = locate_patches(np.rot90(response, quarters), np.rot90(valid, quarters), made(Chart, FOUND), "chart.crw")
    height, width = valid.shape
    x, y = upright.centres_px.T
    expected = {1: np.stack([y, width - 1 - x], axis=1), 2: np.stack([width - 1 - x, height - 1 - y], axis=1)}
    assert np.linalg.norm(found.centres_px - expected[quarters], axis=1).max() < 0.05


@pytest.mark.heavy
def test_a_cut_chart_and_a_box_are_refused():
    with pytest.raises(InputError, match=r"3 x 5 squares.*cut by the picture's edge.*corners as chart\.centres_px"):
        locate_patches(*photograph("powershot_s40_chart_zoom.crw"), made(Chart, FOUND), "zoom.crw")
    with pytest.raises(InputError, match="no chart"):
        locate_patches(*photograph("powershot_s40_glossy_box.crw"), made(Chart, FOUND), "box.crw")


def test_a_camera_with_oblong_pixels_shows_oblong_patches_and_is_found():
    response, valid = photograph("dc120_chart.kdc")
    found = locate_patches(response, valid, made(Chart, FOUND), "chart.kdc")
    steps = np.abs(np.diff(found.centres_px.reshape(ROWS, COLUMNS, 2), axis=1))[..., 0].mean()
    across = np.abs(np.diff(found.centres_px.reshape(ROWS, COLUMNS, 2), axis=0))[..., 1].mean()
    assert across / steps == pytest.approx(1.54, abs=0.05)
    assert found.found["rmse"] < 0.07 < 0.2 < found.found["next_rmse"]


def test_moving_the_patches_by_three_superpixels_hardly_changes_the_error(chart):
    response, valid, _, located = chart
    in_place = errors(read_located(response, valid, located, "chart.crw").mean)[1]
    for side in itertools.product((-3.0, 0.0, 3.0), repeat=2):
        shifted = replace(located, centres_px=located.centres_px + side)
        reading = read_located(response, valid, shifted, "chart.crw")
        assert not reading.uneven.any() and abs(errors(reading.mean)[1] - in_place) <= 0.05


def test_vignetting_told_from_the_chart_lowers_errors_that_had_no_say_in_it(chart):
    response, valid, _, located = chart
    reading = read_located(response, valid, located, "chart.crw")
    assert not reading.uneven.any() and (np.sqrt(reading.mean_variance) < 0.01 * reading.mean).all()
    light = illumination(response, valid, located, "chart.crw")
    assert light.correctable and light.standard_error <= 0.01
    # Only slopes within patches decide; the spectra do not enter.
    plain, corrected = errors(reading.mean), errors(reading.divided(light.field).mean)
    assert corrected[0] <= 0.047 < plain[0]
    assert corrected[1] < plain[1]
    # A lens darkens towards the corners: along the middle rows the light falls to both sides.
    rows = light.field.mean(axis=1).reshape(ROWS, COLUMNS)
    assert (rows[:, 2:4].min(axis=1) > rows[:, [0, 5]].max(axis=1)).all()
