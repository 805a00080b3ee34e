"""The path tracer's points are spread as those of a Sobol sequence."""

import numpy as np
import pytest
from scipy.stats import qmc

from irodori.rendering.reference.random_numbers import make_numbers


def assert_net(points: np.ndarray) -> None:
    """A (0, m, 2)-net: one of 2^m points in each of the boxes of area 2^-m, whatever their shape (Sobol 1967)."""
    bits = (len(points) - 1).bit_length()
    for pair in range(0, points.shape[1], 2):
        x, y = points[:, pair].astype(np.int64), points[:, pair + 1].astype(np.int64)
        for split in range(bits + 1):
            box = (x >> (32 - split)) * 2 ** (bits - split) + (y >> (32 - bits + split))
            assert len(np.unique(box)) == len(points)


@pytest.mark.parametrize(("samples", "more"), [(2, 8), (32, 1), (32, 8), (8192, 1)])
def test_every_pair_of_dimensions_covers_all_elementary_intervals_of_its_size(samples, more):
    """The whole set, and the samples with which pixels begin that need fewer."""
    for points in make_numbers(samples, 3, replicates=2, more=more).points:
        assert_net(points)
        assert_net(points[: samples // 2])


@pytest.mark.parametrize("samples", [6, 200])
def test_other_numbers_of_samples_are_a_run_of_the_sequence(samples):
    """Scrambling is a triangular matrix of bits: x and y tell how many points there are in each half and quarter."""
    found = make_numbers(samples, 7, replicates=2).points[1]
    sobol = (qmc.Sobol(2, scramble=False).random_base2(7)[: samples // 2] * 2.0**32).astype(np.uint32)
    for pair in range(0, found.shape[1], 2):
        for bits in (1, 2):
            for one, other in zip(found[:, pair : pair + 2].T, sobol.T, strict=True):
                counts = [np.sort(np.bincount(v >> (32 - bits), minlength=2**bits)) for v in (one, other)]
                np.testing.assert_array_equal(*counts)


def test_pairs_and_replicates_and_seeds_are_independent():
    points = np.concatenate([make_numbers(512, seed, replicates=2).points for seed in (0, 1)], axis=2)
    values = points.swapaxes(0, 1).reshape(256, -1) * 2.0**-32
    correlation = np.corrcoef(values.T)[np.triu_indices(values.shape[1], 1)]
    assert np.abs(correlation).max() < 0.35 and np.abs(correlation).mean() < 0.07
