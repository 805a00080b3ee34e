"""The path tracer's points against SciPy's Sobol sequence."""

import numpy as np
import pytest
from scipy.stats import qmc

from irodori.rendering.reference.random_numbers import make_numbers


@pytest.mark.parametrize("samples", [2, 6, 32, 200, 8192])
@pytest.mark.parametrize("seed", [0, 7])
def test_the_points_are_those_of_scipys_scrambled_sobol_sequence(samples, seed):
    found = make_numbers(samples, seed, replicates=2).points
    size = found.shape[1]
    generator = np.random.default_rng([seed, 0x1D0])
    for replicate in found:
        for pair in range(0, found.shape[2], 2):
            sobol = qmc.Sobol(2, bits=32, rng=generator).random_base2(max(size - 1, 0).bit_length())[:size]
            expected = generator.permutation(sobol) * 2.0**32
            np.testing.assert_array_equal(replicate[:, pair : pair + 2], expected.astype(np.uint32))


def test_every_pair_of_dimensions_covers_all_elementary_intervals_of_its_size():
    """A (0, m, 2)-net: one of 2^m points in each of the boxes of area 2^-m, whatever their shape (Sobol 1967)."""
    points = make_numbers(128, 3, replicates=2).points[0]
    for pair in range(0, points.shape[1], 2):
        x, y = points[:, pair].astype(np.int64), points[:, pair + 1].astype(np.int64)
        for split in range(7):
            box = (x >> (32 - split)) * 2 ** (6 - split) + (y >> (26 + split))
            assert len(np.unique(box)) == 64
