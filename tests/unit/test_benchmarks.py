"""What the benchmarks compare with, and how they run processes of their own."""

import subprocess

import numpy as np
import pytest
from scipy.optimize import nnls

from benchmarks.fit import K, N, angles, brute_force, scene
from benchmarks.table import printed_by
from irodori.reflection.equation5 import gloss_factors


@pytest.mark.parametrize("noise", [0.01, 0.3])
def test_the_dense_scan_finds_the_least_nonnegative_least_squares_of_its_grid(noise):
    response, mus = scene(12, noise=noise)[3], np.geomspace(0.01, 1.2, 25)
    geometry = angles().astype(np.float32).astype(np.float64)
    cosine, plain = np.cos(geometry[:, 0]), gloss_factors(geometry, N, K)
    lobes = [plain * np.exp(-np.square(geometry[:, 3] / mu)) for mu in mus]
    expected = [
        min(nnls(np.stack([cosine, lobe], axis=1), rho)[1] ** 2 for lobe in lobes)
        for rho in response.astype(np.float64)
    ]
    # The sum of squares is a difference of numbers up to 1e5 times as large.
    np.testing.assert_allclose(brute_force(response, mus), expected, rtol=1e-9)


def test_a_black_texel_leaves_nothing_and_one_below_zero_is_left_as_it_is():
    response = np.stack([np.zeros(48), np.full(48, -0.1)]).astype(np.float32)
    found = brute_force(response, np.geomspace(0.01, 1.2, 25))
    np.testing.assert_allclose(found, np.sum(response.astype(np.float64) ** 2, axis=1), rtol=1e-12)


def test_a_process_that_fails_is_not_taken_for_one_that_prints_nothing():
    assert "usage" in printed_by("stability", [("--help",)])[0]
    with pytest.raises(subprocess.CalledProcessError):
        printed_by("stability", [("--help",), ("--nonsense",)])
