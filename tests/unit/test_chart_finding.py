"""A ColorChecker found in a photograph: right to a part of a pixel, or refused."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from chart_pictures import (
    COLUMNS,
    PAPER,
    ROWS,
    SPECTRA,
    large_chart,
    light_field,
    noisy,
    sensitivities,
    shot,
    truth,
    view,
)  # fmt: skip

from irodori.calibration.detection import find_chart
from irodori.core.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
WIDTH, HEIGHT = 720, 520


def everywhere(picture: np.ndarray) -> np.ndarray:
    return np.ones(picture.shape[:2], dtype=bool)


def find(picture, spectra=SPECTRA):
    return find_chart(picture, everywhere(picture), spectra, "chart.h5")


def refusal(picture, valid=None) -> str:
    with pytest.raises(InputError) as caught:
        find_chart(picture, everywhere(picture) if valid is None else valid, SPECTRA, "chart.h5")
    assert (caught.value.file, caught.value.field) == ("chart.h5", "chart.find")
    assert "corners" in caught.value.accepted
    return caught.value.found


# ---- found right


@pytest.mark.parametrize(
    ("pitch", "turn_deg", "tilt", "noise", "blur_px", "light", "distortion", "tolerance_px"),
    [
        pytest.param(90, 180, 0.0, 0.003, 0, None, 0.0, 0.2, id="upside down", marks=pytest.mark.heavy),
        pytest.param(75, 37, 0.3, 0.003, 0, None, 0.0, 0.2, id="turned and tilted"),
        pytest.param(85, -8, 0.7, 0.003, 0, None, 0.0, 0.2, id="tilted by 45 degrees", marks=pytest.mark.heavy),
        pytest.param(90, 183, 0.2, 0.05, 0, None, 0.0, 0.4, id="noise of 5 percent"),
        pytest.param(90, 3, 0.0, 0.005, 3, None, 0.0, 1.0, id="out of focus", marks=pytest.mark.heavy),
        pytest.param(90, 3, 0.0, 0.003, 0, (0.5, 0.6), 0.0, 0.3, id="uneven light", marks=pytest.mark.heavy),
        pytest.param(95, 3, 0.0, 0.003, 0, None, -0.05, 0.2, id="barrel distortion", marks=pytest.mark.heavy),
        pytest.param(20, 3, 0.0, 0.003, 0, None, 0.0, 0.2, id="small", marks=pytest.mark.heavy),
    ],
)
def test_a_chart_is_found_whichever_way_it_lies(
    pitch, turn_deg, tilt, noise, blur_px, light, distortion, tolerance_px
):  # fmt: skip
    image_from_grid = view(WIDTH, HEIGHT, pitch, turn_deg, tilt)
    picture = shot([image_from_grid], WIDTH, HEIGHT, distortion=distortion)
    if light:
        picture *= light_field(WIDTH, HEIGHT, *light)
    found = find(noisy(picture, np.random.default_rng(1), noise, blur_px))
    expected = truth(image_from_grid, distortion, (WIDTH, HEIGHT))
    assert np.linalg.norm(found.centres - expected, axis=1).max() < tolerance_px
    ahead = expected[COLUMNS - 1] - expected[0]
    turned_deg = found.turn_deg - np.degrees(np.arctan2(ahead[1], ahead[0]))
    assert abs((turned_deg + 180) % 360 - 180) < 0.5
    assert found.edges >= 80 and found.rmse < 0.5 * found.next_rmse


@pytest.mark.heavy
def test_six_bands_and_dim_light_and_dead_pixels_do_not_matter():
    rng = np.random.default_rng(2)
    image_from_grid = view(WIDTH, HEIGHT, 80, 181, 0.2)
    picture = 1e-4 * noisy(shot([image_from_grid], responses=SPECTRA @ sensitivities(6).T), rng, 0.003)
    valid = rng.uniform(size=picture.shape[:2]) > 0.01
    picture[~valid] = 0.0
    found = find_chart(picture, valid, SPECTRA, "chart.h5")
    assert np.linalg.norm(found.centres - truth(image_from_grid), axis=1).max() < 0.3


@pytest.mark.heavy
def test_an_upright_picture_is_found_as_a_lying_one():
    image_from_grid = view(400, 640, 80, 88)
    found = find(noisy(shot([image_from_grid], 400, 640), np.random.default_rng(3), 0.003))
    assert np.linalg.norm(found.centres - truth(image_from_grid), axis=1).max() < 0.2


@pytest.mark.heavy
def test_a_saturated_white_patch_does_not_hide_the_chart():
    image_from_grid = view(WIDTH, HEIGHT, 90, 2)
    picture = shot([image_from_grid])
    x, y = truth(image_from_grid)[18].round().astype(int)
    valid = everywhere(picture)
    valid[y - 10 : y + 5, x - 20 : x + 20] = False
    picture[~valid] = 0.0
    found = find_chart(picture, valid, SPECTRA, "chart.h5")
    assert np.linalg.norm(found.centres - truth(image_from_grid), axis=1).max() < 0.3


@pytest.mark.stability(stage="calibrate", case="chart of 140 patches without corners")
@pytest.mark.heavy
@pytest.mark.parametrize(("pitch", "turn_deg"), [(45, 2.0), (33, 207.0)], ids=["upright", "upside down"])
def test_a_chart_of_140_patches_whose_letters_run_across_is_found(pitch, turn_deg):
    spectra = large_chart()
    lying = spectra.reshape(14, 10, -1).swapaxes(0, 1).reshape(140, -1)
    image_from_grid = view(WIDTH, HEIGHT, pitch, turn_deg, layout=(10, 14))
    picture = shot([image_from_grid], responses=lying @ sensitivities().T, layout=(10, 14))
    picture = noisy(picture, np.random.default_rng(11), 0.003)
    found = find_chart(picture, everywhere(picture), spectra, "chart.h5", (14, 10))
    expected = truth(image_from_grid, layout=(10, 14)).reshape(10, 14, 2).swapaxes(0, 1).reshape(140, 2)
    assert np.linalg.norm(found.centres - expected, axis=1).max() < 0.2
    with pytest.raises(InputError, match="do not answer"):
        find_chart(picture, everywhere(picture), spectra, "chart.h5", (10, 14))


def test_a_chart_of_another_layout_is_refused_with_those_that_are_found():
    picture = np.full((60, 80, 3), 0.5)
    with pytest.raises(InputError, match=r"found chart for 5 x 6 patches; accepted: 4 x 6 patches.*14 x 10"):
        find_chart(picture, everywhere(picture), SPECTRA, "chart.h5", (5, 6))


# ---- refused


@pytest.mark.heavy
def test_a_mirrored_chart_is_refused():
    assert "mirrored" in refusal(shot([view(WIDTH, HEIGHT, 90, 2)])[:, ::-1])


@pytest.mark.heavy
def test_opencv_that_does_not_start_stops_nothing_but_the_finding():
    """A bare machine has no libGL: every stage must run there, and finding must say what is missing."""
    program = (
        "import sys; sys.modules['cv2'] = None; sys.modules['colour_checker_detection'] = None\n"
        "import irodori.ingest.stage, irodori.calibration.stage, irodori.rectification.stage, irodori.fitting.stage\n"
        "import irodori.material.stage, irodori.capture.stage, irodori.report.page\n"
        "from irodori.calibration.detection import _library\n"
        "from irodori.core.errors import PlainError\n"
        "try: _library()\n"
        "except PlainError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert "libgl1" in done.stdout and "find: edges" in done.stdout


@pytest.mark.heavy
def test_two_charts_are_refused_with_their_places():
    maps = [view(WIDTH, HEIGHT, 50, 2, centre=(180, 150)), view(WIDTH, HEIGHT, 45, 175, centre=(520, 370))]
    said = refusal(noisy(shot(maps), np.random.default_rng(4), 0.003))
    assert "2 charts" in said and "(180, 150)" in said and "(520, 370)" in said


@pytest.mark.heavy
def test_a_chart_cut_by_the_picture_s_edge_is_refused():
    picture = shot([view(WIDTH, HEIGHT, 90, 2)])
    assert "cut by the picture" in refusal(picture[130:])
    assert "squares" in refusal(picture[:, :470])


@pytest.mark.heavy
def test_a_covered_patch_is_refused():
    image_from_grid = view(WIDTH, HEIGHT, 90, 2)
    picture = shot([image_from_grid])
    x, y = truth(image_from_grid)[8].round().astype(int)
    picture[y - 60 : y + 5, x - 60 : x + 30] = 0.3
    said = refusal(noisy(picture, np.random.default_rng(5), 0.003))
    assert "patch 8 uneven" in said or "patch edges" in said


@pytest.mark.heavy
def test_a_covered_column_is_refused():
    image_from_grid = view(WIDTH, HEIGHT, 90)
    picture = shot([image_from_grid])
    picture[:, : round(truth(image_from_grid)[0, 0] + 50)] = PAPER
    assert "squares" in refusal(noisy(picture, np.random.default_rng(6), 0.003))


@pytest.mark.heavy
def test_squares_of_other_colours_are_refused():
    rng = np.random.default_rng(7)
    responses = rng.uniform(0.15, 0.9, (ROWS * COLUMNS, 3))
    assert "do not answer" in refusal(noisy(shot([view(WIDTH, HEIGHT, 90)], responses=responses), rng, 0.003))


@pytest.mark.heavy
def test_spectra_of_another_order_are_refused():
    with pytest.raises(InputError, match="do not answer"):
        find(shot([view(WIDTH, HEIGHT, 90)]), np.random.default_rng(8).permutation(SPECTRA))


def test_paper_or_noise_or_nothing_holds_no_chart():
    rng = np.random.default_rng(9)
    for picture in (np.full((300, 400, 3), 0.5), rng.uniform(size=(300, 400, 3))):
        assert "no chart" in refusal(picture)
    assert "no chart" in refusal(np.zeros((300, 400, 3)), np.zeros((300, 400), dtype=bool))


@pytest.mark.heavy
def test_a_tiny_chart_is_refused():
    assert "no chart" in refusal(shot([view(WIDTH, HEIGHT, 8)]))


@pytest.mark.heavy
def test_light_that_falls_to_a_quarter_is_found_right_or_refused():
    image_from_grid = view(WIDTH, HEIGHT, 90, 3)
    picture = noisy(shot([image_from_grid]) * light_field(WIDTH, HEIGHT, 0.0, 1.4), np.random.default_rng(10), 0.003)
    try:
        assert np.linalg.norm(find(picture).centres - truth(image_from_grid), axis=1).max() < 0.5
    except InputError as error:
        assert "do not answer" in error.found
