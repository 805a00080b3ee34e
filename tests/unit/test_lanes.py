"""Eight numbers side by side in compiled code: the same as numpy, and the same functions for one number."""

import numba
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from irodori.jit import lanes

EIGHT = st.lists(st.floats(1e-150, 1e150), min_size=8, max_size=8).map(np.array)


@numba.njit
def _algebra(a, b, out):
    x, y = lanes.load(a, 0), lanes.load(b, 0)
    lanes.store(out, 0, x + 2.0 * y)
    lanes.store(out, 8, 3 - x / y)
    lanes.store(out, 16, lanes.select((x > y) & lanes.negated(x == 5.0), x, -y))
    lanes.store(out, 24, lanes.lower_of(x, y))
    lanes.store(out, 32, lanes.upper_of(x, 1.0))
    lanes.store(out, 40, lanes.root(x))
    lanes.store(out, 48, lanes.log(x))
    lanes.store(out, 56, lanes.magnitude(-x))
    return lanes.bits((x < y) | (x >= 1e100)), lanes.lane(x, 3)


@given(EIGHT, EIGHT)
def test_lanes_compute_what_numpy_does(a, b):
    out = np.empty((8, 8))
    mask, third = _algebra(a, b, out)
    expected = (
        a + 2 * b, 3 - a / b, np.where((a > b) & (a != 5), a, -b), np.minimum(a, b), np.maximum(a, 1.0), np.sqrt(a),
        np.log(a), a,
    )  # fmt: skip
    for row, values in zip(out, expected, strict=True):
        assert_allclose(row, values, rtol=4e-16, atol=1e-15)
    assert_array_equal(np.unpackbits(np.uint8(mask), bitorder="little").astype(bool), (a < b) | (a >= 1e100))
    assert third == a[3]


@numba.njit
def _either(x, y):
    return lanes.select(x > y, lanes.root(x), lanes.upper_of(lanes.exponential(-x), y)) * lanes.log(x)


@numba.njit
def _eight(a, b, out):
    lanes.store(out, 0, _either(lanes.load(a, 0), lanes.load(b, 0)))


@given(EIGHT, EIGHT)
def test_one_source_serves_numbers_and_lanes(a, b):
    out = np.empty(8)
    _eight(a, b, out)
    assert_allclose(out, [_either(x, y) for x, y in zip(a, b, strict=True)], rtol=1e-14)


@numba.njit
def _exponentials(a, out):
    for i in range(0, a.size, 8):
        lanes.store(out, i, lanes.exponential(lanes.load(a, i)))


def test_the_exponential_is_exact_to_a_few_units_and_never_denormal():
    x = np.linspace(-900.0, 600.0, 80_000)
    out = np.empty_like(x)
    _exponentials(x, out)
    inside = x > -169.0
    assert_allclose(out[inside], np.exp(x[inside]), rtol=2e-15)
    assert (out[x < -171.0] == out[0]).all() and 1e-75 < out[0] < 1e-73


def test_not_a_number_is_the_first_to_give_way():
    out = np.empty((8, 8))
    a = np.array([np.nan, 1.0] * 4)
    _algebra(a, np.full(8, 2.0), out)
    assert_array_equal(out[3], [2.0, 1.0] * 4)
    assert_array_equal(out[4], [1.0, 1.0] * 4)


@numba.njit
def _tables(rows, table, out):
    _sum(rows, 8, 3, table, 2, 12, 5, out, 8, 24)


_sum = lanes.lanes_times_tables(2)


def test_lanes_times_tables_are_sums_of_products():
    rng = np.random.default_rng(3)
    rows, table, out = rng.normal(size=(4, 8)), rng.normal(size=40), np.zeros((6, 8))
    _tables(rows.ravel(), table, out.ravel())
    for first, into in ((2, 1), (12, 4)):
        for column in range(2):
            numbers = table[first + column + 5 * np.arange(3)]
            assert_allclose(out[into + column], numbers @ rows[1:4], rtol=1e-12)
    assert not out[[0, 3]].any()
