"""The virtual camera's pixels gather light over their areas: an edge shows where it is, not where rays are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from irodori.simulation.virtual_rig.aperture import gather_rows, place_in_cell

SIZE_PX = 64


def photograph_edge(edge_px: float, along: str) -> np.ndarray:
    """Return the picture of a white half plane left of (``along`` y) or above (``along`` x) an edge."""
    row, column = np.indices((2 * SIZE_PX + 2, 2 * SIZE_PX + 2), sparse=True)
    x, y = np.broadcast_arrays(*place_in_cell(row - 1, column - 1))
    white = (x if along == "y" else y) < edge_px
    image = np.empty((SIZE_PX, SIZE_PX))
    gather_rows(np.repeat(white[..., None].astype(np.float64), 3, axis=-1), 0, image)
    return image


@given(edge_px=st.floats(4.0, SIZE_PX - 4.0), along=st.sampled_from("xy"))
def test_an_upright_edge_anywhere_shows_as_a_ramp_over_the_two_pixels_of_the_aperture(edge_px, along):
    image = photograph_edge(edge_px, along).mean(axis=0 if along == "y" else 1)
    ramp = np.clip(0.5 * (edge_px - (np.arange(SIZE_PX) - 0.5)), 0.0, 1.0)
    # Rays on a regular lattice half a pixel apart are off by up to 0.125 in a pixel and 0.25 in the sum.
    assert np.abs(image - ramp).max() <= 0.015
    assert abs(image.sum() - edge_px) <= 0.01


@pytest.mark.parametrize("along", ["x", "y"])
def test_edges_at_any_angle_lie_where_they_are(along):
    row, column = np.indices((2 * SIZE_PX + 2, 2 * SIZE_PX + 2), sparse=True)
    x, y = place_in_cell(row - 1, column - 1)
    x, y = np.broadcast_arrays(*((x, y) if along == "y" else (y, x)))
    rng, errors, image = np.random.default_rng(1), [], np.empty((SIZE_PX, SIZE_PX))
    for _ in range(100):
        slope, middle = rng.uniform(-0.8, 0.8), SIZE_PX / 2 + rng.uniform(-1.0, 1.0)
        white = (x < middle + slope * (y - SIZE_PX / 2)).astype(np.float64)
        gather_rows(np.repeat(white[..., None], 3, axis=-1), 0, image)
        errors.append(image.sum() / SIZE_PX - middle)
    # Independent random places would leave 0.5 / sqrt(12 * 130 rows) = 0.013 pixels.
    assert np.sqrt(np.mean(np.square(errors))) <= 0.02


@given(row=st.integers(-1, 10_000), column=st.integers(-1, 10_000))
def test_every_quarter_of_a_pixel_has_its_own_ray(row, column):
    x, y = place_in_cell(row, column)
    assert column / 2 <= x <= (column + 1) / 2
    assert row / 2 <= y <= (row + 1) / 2
