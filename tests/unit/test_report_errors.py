"""Errors of the report: what is left out of them, and how bright pixels are compared."""

import numpy as np
import pytest

from irodori.material import Material
from irodori.report.errors import interior, radiance_delta_e
from irodori.spectra import spectrum


def checks(height: int, width: int, side: int) -> Material:
    """Return a truth of two materials in checks."""
    row, column = np.indices((height, width)) // side
    index = (row + column) % 2
    flat = np.full((height, width), 0.5)
    one_hot = np.eye(2, dtype=np.float32)[index]
    return Material(flat, flat, flat, flat, one_hot, np.full((61, 2), 0.5), np.ones(61), np.zeros(61), 0.0, (1.0, 0.1))


def test_two_texels_on_either_side_of_a_seam_are_left_out_and_the_border_is_kept():
    inside = interior(checks(20, 30, 10))
    rows = np.array([r not in (8, 9, 10, 11) for r in range(20)])
    columns = np.array([c not in (8, 9, 10, 11, 18, 19, 20, 21) for c in range(30)])
    np.testing.assert_array_equal(inside, rows[:, None] & columns[None, :])


def test_a_single_material_has_no_seam():
    assert interior(checks(12, 12, 100)).all()


def test_equal_pictures_differ_by_nothing_and_a_tint_shows_however_bright():
    white = spectrum("D65")
    grey = np.stack([white * level for level in (0.01, 0.5, 1.0, 50.0)])
    np.testing.assert_allclose(radiance_delta_e(grey, grey, white), 0.0, atol=1e-9)
    tinted = grey * np.linspace(0.95, 1.05, 61)
    difference = radiance_delta_e(grey, tinted, white)
    assert (difference > 0.1).all()
    # Above white both are scaled alike: the same tint is the same difference.
    assert difference[3] == pytest.approx(difference[2], rel=1e-9)
