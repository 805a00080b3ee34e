"""Cells of the sphere: every direction lies in its cell, on both sides of each meridian."""

import numpy as np

from irodori.rendering.light_cells import CELLS, COLUMNS, POOL, cell_directions, cell_of


def test_directions_of_a_cell_lie_in_it():
    found = cell_of(cell_directions().reshape(-1, 3)).reshape(CELLS, POOL)
    np.testing.assert_array_equal(found, np.repeat(np.arange(CELLS), POOL).reshape(CELLS, POOL))


def test_cells_of_a_mirrored_direction_are_mirrored():
    """In the plane of the meridian 0: a column from one end is as far from the other."""
    unit = np.random.default_rng(4).normal(size=(5000, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    row, column = np.divmod(cell_of(unit), COLUMNS)
    other_row, other_column = np.divmod(cell_of(unit * [1.0, -1.0, 1.0]), COLUMNS)
    np.testing.assert_array_equal(row, other_row)
    np.testing.assert_array_equal(column, COLUMNS - 1 - other_column)
