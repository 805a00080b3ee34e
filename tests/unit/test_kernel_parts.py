"""Parts of a compiled kernel, numba's own functions and parallel loops included, still work on their own."""

import numba
import numpy as np
import pytest

from irodori.jit.compilation import njit


@numba.njit
def half_of_it(x):
    return x


@numba.njit
def somebody_elses(x):
    return half_of_it(x) + half_of_it(x)


@njit(parallel=True)
def doubled(values):
    out = np.empty_like(values)
    for i in numba.prange(values.size):
        out[i] = somebody_elses(values[i])
    return out


@njit(parallel=True)
def doubled_and_sorted(values):
    twice = doubled(values)
    below = np.zeros(values.size, dtype=np.int64)
    for i in numba.prange(values.size):
        below[i] = (twice < twice[i]).sum()
    return np.sort(twice), below, np.ascontiguousarray(twice[::-1])


def test_a_parallel_kernel_calls_another_and_python_calls_every_part():
    values = np.array([3.0, -1.0, 7.0, 2.0])
    ordered, below, backwards = doubled_and_sorted(values)
    assert ordered.tolist() == [-2.0, 4.0, 6.0, 14.0]
    assert below.tolist() == [2, 0, 3, 1]
    assert backwards.tolist() == [4.0, 14.0, -2.0, 6.0]
    assert doubled(values).tolist() == [6.0, -2.0, 14.0, 4.0]
    assert somebody_elses(1.5) == 3.0


@pytest.mark.parametrize(
    "function", [lambda x: np.sort(x)[0], lambda x: np.cumsum(x)[-1], lambda x: np.interp(0.5, x, x)]
)
def test_others_compile_with_numba_what_a_kernel_has_compiled_before(function):
    """numba keeps its own functions, such as those of sorting, for all that a process compiles."""
    values = np.array([0.0, 0.25, 1.0])
    assert njit(function)(values) == numba.njit(function)(values) == function(values)
