"""Statistics of patches: means, variances, flags, and what becomes of squares beside their patches."""

import numpy as np
import pytest
from definitions import CAMERA_FILE, edit, fault, load
from hypothesis import given, settings
from hypothesis import strategies as st
from made import made
from scipy import stats
from shortcuts import read_patches

from irodori.config.models import Chart

SIDE, PITCH = 40, 60
CORNERS = {"first": [40, 40], "row_end": [160, 40], "column_end": [40, 100], "last": [160, 100]}
CHART = {"rows": 2, "columns": 3, "patch_px": SIDE, "centres_px": CORNERS}
LEVELS = np.array([[0.8, 0.5, 0.3], [0.05, 0.2, 0.6], [0.9, 0.9, 0.9], [0.03, 0.04, 0.05], [0.4, 0.1, 0.2], [0.3] * 3])


def picture(sigma: float = 0.0, rng=None) -> np.ndarray:
    out = np.full((140, 200, 3), 0.01)
    for number, level in enumerate(LEVELS):
        y, x = 40 + PITCH * (number // 3), 40 + PITCH * (number % 3)
        out[y - 25 : y + 25, x - 25 : x + 25] = level
    return out + (sigma * rng.normal(size=out.shape) if sigma else 0.0)


def read(image, valid=None):
    return read_patches(image, np.ones(image.shape[:2], bool) if valid is None else valid, made(Chart, CHART), "x.h5")


def patch(number: int) -> tuple[slice, slice]:
    """The pixels that are averaged in a patch."""
    y, x = 40 + PITCH * (number // 3), 40 + PITCH * (number % 3)
    return slice(y - SIDE // 2, y + SIDE // 2), slice(x - SIDE // 2, x + SIDE // 2)


def test_means_are_exact_and_a_clean_chart_is_not_flagged():
    reading = read(picture())
    assert np.allclose(reading.mean, LEVELS, rtol=1e-12)
    assert (reading.count == SIDE**2).all() and (reading.invalid_share == 0).all() and not reading.uneven.any()
    assert np.abs(reading.pixel_variance).max() < 1e-20 and np.abs(reading.gradient).max() < 1e-9


@given(seed=st.integers(0, 2**32 - 1), sigma=st.floats(1e-4, 0.05))
@settings(deadline=None, max_examples=6)
def test_variances_are_those_of_the_noise_and_of_repeated_means(seed, sigma):
    rng = np.random.default_rng(seed)
    readings = [read(picture(sigma, rng)) for _ in range(20)]
    # 6 patches, 3 bands, 20 repeats of 1600 pixels: the mean variance is known to well under a percent.
    assert np.mean([r.pixel_variance for r in readings]) == pytest.approx(sigma**2, rel=0.03)
    repeated = np.var([r.mean for r in readings], axis=0, ddof=1).mean()
    predicted = np.mean([r.mean_variance for r in readings])
    # 342 degrees of freedom; the larger of two estimates is above the truth, by up to a third.
    low, high = stats.chi2.ppf([1e-5, 1 - 1e-5], 342) / 342
    assert low < repeated / predicted * 1.15 and repeated / predicted < high
    assert sum(r.uneven.sum() for r in readings) <= 2


def test_light_that_falls_off_is_slope_and_not_noise():
    rng = np.random.default_rng(1)
    y, x = np.mgrid[0:140, 0:200]
    light = 1.0 + 0.002 * (x - 100) - 0.001 * (y - 70)
    reading = read(picture(0.002, rng) * light[..., None])
    assert np.allclose(np.sqrt(reading.pixel_variance), 0.002, rtol=0.3)
    at = light[reading.centres_px[:, 1].round().astype(int), reading.centres_px[:, 0].round().astype(int)]
    bright = LEVELS > 0.2
    for axis, slope in enumerate((0.002, -0.001)):
        measured = reading.log_slope[:, axis]
        assert np.allclose(measured[bright], (slope / at)[:, None].repeat(3, 1)[bright], atol=1e-4)
    assert np.allclose(reading.gradient[2], np.hypot(0.002, 0.001) * SIDE / at[2], rtol=0.05)
    assert not reading.uneven.any()


@pytest.mark.parametrize(
    ("number", "what"), [(0, "corner"), (2, "hair"), (4, "shadow"), (5, "edge"), (1, "speck"), (3, "hot")]
)
def test_dirt_and_edges_are_flagged_on_their_patch_and_specks_are_not(number, what):
    rng = np.random.default_rng(2)
    image, valid = picture(0.002, rng), np.ones((140, 200), bool)
    ys, xs = patch(number)
    square = image[ys, xs]
    clean = read(image).mean
    if what == "corner":
        square[:10, :10] *= 0.5
    elif what == "hair":
        square[18:24] *= 0.7
    elif what == "shadow":
        square *= np.linspace(1.0, 0.75, SIDE)[:, None, None]
    elif what == "edge":
        square[:, :6] = 0.01
    elif what == "speck":
        square[3, 7] = 30.0
    else:
        hot = rng.uniform(size=square.shape[:2]) < 0.2
        square[hot], valid[ys, xs] = 50.0, ~hot
    reading = read(image, valid)
    flagged = what in ("corner", "hair", "shadow", "edge")
    assert np.flatnonzero(reading.uneven).tolist() == ([number] if flagged else [])
    others = np.arange(6) != number
    assert np.array_equal(reading.mean[others], clean[others])
    if not flagged:
        assert np.allclose(reading.mean[number], clean[number], atol=3e-4)
    if what == "hot":
        assert reading.invalid_share[number] == pytest.approx(0.2, abs=0.04)
        assert reading.count[number] == round((1 - reading.invalid_share[number]) * SIDE**2)
    if what in ("corner", "hair"):
        assert reading.mean_variance[number].max() > 5 * reading.mean_variance[others].max()


@pytest.mark.parametrize("side", [1, 2, 3, 5])
def test_tiny_patches_have_means_and_no_slopes(side):
    image = picture(0.001, np.random.default_rng(3))
    reading = read_patches(image, np.ones((140, 200), bool), made(Chart, CHART | {"patch_px": side}), "x.h5")
    assert np.allclose(reading.mean, LEVELS, atol=0.01) and np.isfinite(reading.mean_variance).all()
    if side < 4:
        assert np.isnan(reading.gradient).all() and not reading.uneven.any()


def test_dividing_by_the_light_divides_means_and_variances():
    reading = read(picture(0.01, np.random.default_rng(4)))
    field = np.random.default_rng(5).uniform(0.5, 1.5, LEVELS.shape)
    even = reading.divided(field)
    assert np.allclose(even.mean * field, reading.mean)
    assert np.allclose(even.mean_variance * field**2, reading.mean_variance)
    assert np.allclose(even.pixel_variance * field**2, reading.pixel_variance)


EIGHT_SIDES = [(dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dx, dy) != (0, 0)]


def moved(by_px: int, side: tuple[int, int]) -> dict:
    corners = {name: [x + by_px * side[0], y + by_px * side[1]] for name, (x, y) in CORNERS.items()}
    return CHART | {"centres_px": corners}


@pytest.mark.stability(stage="calibrate", case="patches moved by 3 pixels")
@pytest.mark.parametrize("side", EIGHT_SIDES)
def test_squares_within_their_patches_read_the_same_and_those_over_an_edge_are_flagged(side):
    image, valid = picture(), np.ones((140, 200), bool)
    within = read_patches(image, valid, made(Chart, moved(3, side)), "x.h5")
    assert np.allclose(within.mean, LEVELS, rtol=1e-12) and not within.uneven.any(), "patches of 50, squares of 40"
    over = read_patches(image, valid, made(Chart, moved(12, side)), "x.h5")
    assert over.uneven.all(), "a chart of more than half such patches is refused"


# ---- configuration


def test_a_chart_that_is_found_needs_neither_corners_nor_a_size(root):
    edit(root, CAMERA_FILE, "chart.find", "chart")
    edit(root, CAMERA_FILE, "chart.centres_px", ...)
    edit(root, CAMERA_FILE, "chart.patch_px", ...)
    chart = load(root).cameras["d5100-comb"].chart
    assert chart.find == "chart" and chart.patch_px is None


def test_corners_are_taken_as_they_are_where_nothing_is_said(root):
    assert load(root).cameras["d5100-comb"].chart.find == "nothing"


@pytest.mark.parametrize(
    ("changes", "field", "accepted"),
    [
        ({"find": "chart"}, "chart.centres_px", "either centres_px, or find: chart"),
        ({"centres_px": ...}, "chart.centres_px", "or find: chart"),
        ({"centres_px": ..., "find": "edges"}, "chart.centres_px", "or find: chart"),
        ({"patch_px": ...}, "chart.patch_px", "a side in superpixels"),
        ({"find": "corners"}, "chart.find", "nothing"),
        ({"find": "chart", "centres_px": ..., "rows": 6, "columns": 4}, "chart.find", "4 x 6"),
    ],
)
def test_patches_are_placed_exactly_once(root, changes, field, accepted):
    for key, value in changes.items():
        edit(root, CAMERA_FILE, f"chart.{key}", value)
    error = fault(root)
    assert error.field == field and accepted in error.accepted
