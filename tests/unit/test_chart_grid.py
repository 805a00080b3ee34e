"""The grid of a chart: lattices of squares, the fit to edges, corners of the configuration."""

import numpy as np
import pytest
from chart_pictures import COLUMNS, NAME, ROWS, noisy, shot, truth, view
from hypothesis import given, settings
from hypothesis import strategies as st
from made import made

from irodori.calibration.chart import locate_patches, read_located
from irodori.calibration.chart_grid import even_picture, fit_to_edges, homography, nodes, project
from irodori.calibration.square_lattice import lattices
from irodori.config.models import Chart
from irodori.core.errors import InputError

WIDTH, HEIGHT = 720, 520


def everywhere(picture: np.ndarray) -> np.ndarray:
    return np.ones(picture.shape[:2], dtype=bool)


# ---- lattices


@given(seed=st.integers(0, 2**32 - 1), turn_deg=st.floats(-180, 180), tilt=st.floats(0, 0.7))
@settings(deadline=None, max_examples=60)
def test_a_lattice_keeps_its_places_with_squares_missing_and_strangers_between(seed, turn_deg, tilt):
    rng = np.random.default_rng(seed)
    image_from_grid = view(WIDTH, HEIGHT, 70, turn_deg, tilt)
    grid = nodes(ROWS, COLUMNS)
    kept = np.sort(rng.permutation(24)[: rng.integers(20, 25)])
    corner = 0.43 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    squares = project(image_from_grid, grid[kept][:, None] + corner) + rng.normal(size=(len(kept), 4, 2))
    strangers = rng.uniform(0, 500, (4, 1, 2)) + 7.0 * corner
    # A detector starts anywhere around a square.
    squares = np.concatenate([np.roll(s, rng.integers(4), axis=0)[None] for s in squares] + [strangers])
    found = lattices(squares[rng.permutation(len(squares))])
    assert len(found) == 1
    centres = project(image_from_grid, grid)
    number = np.linalg.norm(found[0].centres[:, None] - centres, axis=2).argmin(axis=1)
    assert 10 <= len(number) <= len(kept) and len(set(number)) == len(number)
    # The chart's own places up to half a turn, shifted where a whole row or column is missing; never mirrored.
    step = grid[number] - grid[number].min(axis=0)
    turned = grid[number].max(axis=0) - grid[number]
    assert np.array_equal(found[0].places, step) or np.array_equal(found[0].places, turned)


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 30))
@settings(deadline=None, max_examples=60)
def test_scattered_squares_are_no_lattice(seed, count):
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(0.5, 2, (count, 1, 1))
    squares = rng.uniform(0, 2000, (count, 1, 2)) + size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    assert lattices(squares) == []


# ---- the grid and the configuration's corners


CHART = {"spectra": NAME, "rows": ROWS, "columns": COLUMNS}


def corners(points) -> dict:
    return dict(zip(("first", "row_end", "column_end", "last"), points[[0, 5, 18, 23]].tolist(), strict=True))


@pytest.fixture(scope="module")
def barrel():
    """A picture through a lens with distortion, and where its patches are."""
    image_from_grid = view(WIDTH, HEIGHT, 95, 3, 0.2)
    picture = noisy(shot([image_from_grid], distortion=-0.05), np.random.default_rng(11), 0.003)
    return picture, truth(image_from_grid, -0.05, (WIDTH, HEIGHT))


@pytest.mark.heavy
def test_rough_corners_are_enough_where_the_grid_is_fitted_to_edges(barrel):
    picture, expected = barrel
    rough = expected[[0, 5, 18, 23]] + [[9, -6], [-8, 9], [5, 10], [-11, -4]]
    names = dict(zip(("first", "row_end", "column_end", "last"), rough.tolist(), strict=True))
    located = locate_patches(
        picture, everywhere(picture), made(Chart, CHART | {"centres_px": names, "find": "edges"}), "x.h5"
    )
    assert np.linalg.norm(located.centres_px - expected, axis=1).max() < 0.2
    assert located.found["edges"] > 80 and 5 < located.found["moved_px"] < 20
    assert located.side_px == pytest.approx(0.5 * located.patch_side_px)
    itself = locate_patches(picture, everywhere(picture), made(Chart, CHART | {"find": "chart"}), "x.h5")
    assert np.abs(itself.centres_px - located.centres_px).max() < 0.05


@pytest.mark.heavy
def test_places_are_the_same_at_full_resolution(barrel):
    picture, _ = barrel
    valid = everywhere(picture)
    half = picture[:512, :720].reshape(256, 2, 360, 2, 3).mean(axis=(1, 3))
    coarse = locate_patches(half, everywhere(half), made(Chart, CHART | {"find": "chart"}), "x.h5")
    fine = locate_patches(picture[:512], valid[:512], made(Chart, CHART | {"find": "chart"}), "x.h5", sample_px=1)
    assert np.abs(coarse.centres_px - fine.centres_px).max() < 0.1
    assert coarse.side_px == pytest.approx(fine.side_px, rel=0.01)
    one = read_located(half, everywhere(half), coarse, "x.h5")
    other = read_located(picture[:512], valid[:512], coarse, "x.h5", sample_px=1)
    assert np.allclose(one.mean, other.mean, atol=5e-4)


@pytest.mark.parametrize("shift_px", [(48, 0), (30, 30), (300, 0)])
def test_corners_off_the_patches_are_refused(barrel, shift_px):
    picture, expected = barrel
    chart = CHART | {"centres_px": corners(expected + np.array(shift_px)), "find": "edges"}
    with pytest.raises(InputError, match=r"x\.h5: chart\.centres_px"):
        locate_patches(picture, everywhere(picture), made(Chart, chart), "x.h5")


def test_edges_that_are_not_there_are_refused():
    chart = CHART | {"centres_px": corners(truth(view(WIDTH, HEIGHT, 90))), "find": "edges"}
    picture = np.random.default_rng(12).uniform(0.4, 0.6, (HEIGHT, WIDTH, 3))
    with pytest.raises(InputError, match="of 96 patch edges"):
        locate_patches(picture, everywhere(picture), made(Chart, chart), "x.h5")


def test_a_square_larger_than_its_patch_is_refused(barrel):
    picture, expected = barrel
    chart = CHART | {"centres_px": corners(expected), "find": "edges", "patch_px": 90}
    with pytest.raises(InputError, match=r"chart\.patch_px"):
        locate_patches(picture, everywhere(picture), made(Chart, chart), "x.h5")


def test_other_layouts_and_unknown_ways_are_refused(barrel):
    picture, _ = barrel
    with pytest.raises(InputError, match="the 140 spectra of a ColorChecker"):
        locate_patches(
            picture, everywhere(picture), made(Chart, CHART | {"find": "chart", "rows": 10, "columns": 14}), "x.h5"
        )
    with pytest.raises(ValueError, match="nothing, edges, chart"):
        locate_patches(picture, everywhere(picture), made(Chart, CHART | {"find": "magic"}), "x.h5")


def test_corners_alone_are_taken_as_they_are(barrel):
    picture, expected = barrel
    chart = CHART | {"centres_px": corners(expected), "patch_px": 30}
    located = locate_patches(picture, everywhere(picture), made(Chart, chart), "x.h5")
    assert np.allclose(located.centres_px[[0, 5, 18, 23]], expected[[0, 5, 18, 23]])
    assert located.side_px == 30 and np.isnan(located.patch_side_px) and not located.found


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=3)
@pytest.mark.heavy
def test_the_fit_does_not_depend_on_where_it_starts(barrel, seed):
    picture, expected = barrel
    start = expected + 6.0 * np.random.default_rng(seed).normal(size=(24, 2)).clip(-1.5, 1.5)
    grid = fit_to_edges(even_picture(picture, everywhere(picture)), homography(nodes(4, 6), start), 4, 6)
    assert np.linalg.norm(grid.image(nodes(4, 6)) - expected, axis=1).max() < 0.2
    assert grid.distortion == pytest.approx(-0.05, abs=0.005)
