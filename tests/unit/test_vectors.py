"""Vectors in compiled code: the same as numpy, for both precisions, and the same functions for one number."""

import math

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core.errors import TypingError
from numpy.testing import assert_allclose, assert_array_equal

from irodori.jit.functions import (
    circle_point,
    exp,
    log,
    lower_of,
    magnitude,
    negated,
    root,
    select,
    truncated,
    upper_of,
    with_sign,
)
from irodori.jit.table_sums import Place, Tables, lanes_times_tables
from irodori.jit.vector_memory import compress, lane, largest, load, mask_bits, spread, store, total, zeros_like

EIGHT = st.lists(st.floats(2.0**-60, 2.0**60, width=32), min_size=8, max_size=8)
PRECISIONS = pytest.mark.parametrize("dtype", [np.float32, np.float64])


@numba.njit
def _algebra(a, b, out):
    x, y = load(a, 0), load(b, 0)
    store(out, 0, x + 2.0 * y)
    store(out, 8, 3 - x / y)
    store(out, 16, select((x > y) & negated(x == 5.0), x, -y))
    store(out, 24, lower_of(x, y))
    store(out, 32, upper_of(x, 1.0))
    store(out, 40, root(x))
    store(out, 48, log(x))
    store(out, 56, magnitude(-x))
    store(out, 64, with_sign(x, -y))
    return mask_bits((x < y) | (x >= 1e10)), lane(x, 3), total(zeros_like(x) + 1.0), largest(x)


@PRECISIONS
@given(a=EIGHT, b=EIGHT)
@settings(deadline=None)
def test_vectors_compute_what_numpy_does(dtype, a, b):
    a, b, out = np.array(a, dtype), np.array(b, dtype), np.empty((9, 8), dtype)
    mask, third, ones, most = _algebra(a, b, out)
    expected = (
        a + 2 * b, 3 - a / b, np.where((a > b) & (a != 5), a, -b), np.minimum(a, b), np.maximum(a, 1.0), np.sqrt(a),
        np.log(a.astype(np.float64)), a, -a,
    )  # fmt: skip
    rounding = 2.0 * np.finfo(dtype).eps
    for row, values in zip(out, expected, strict=True):
        assert_allclose(row, values, rtol=rounding, atol=3.0 * rounding)
    assert_array_equal(np.unpackbits(np.uint8(mask), bitorder="little").astype(bool), (a < b) | (a >= 1e10))
    assert (third, ones, most) == (a[3], 8.0, a.max())


@numba.njit
def _either(x, y):
    return select(x > y, root(x), upper_of(exp(-x), y)) * log(x)


@numba.njit
def _eight(a, b, out):
    store(out, 0, _either(load(a, 0), load(b, 0)))


@PRECISIONS
@given(a=EIGHT, b=EIGHT)
@settings(deadline=None)
def test_one_source_serves_numbers_and_vectors(dtype, a, b):
    a, b, out = np.array(a, dtype), np.array(b, dtype), np.empty(8, dtype)
    _eight(a, b, out)
    alone = [_either(x, y) for x, y in zip(a, b, strict=True)]
    assert_allclose(out, alone, rtol=16 * np.finfo(dtype).eps)
    assert all(type(x) is float for x in alone)  # numba boxes both so


@numba.njit
def _vector_exp(a, out):
    for i in range(0, a.size, 8):
        store(out, i, exp(load(a, i)))


@numba.njit(fastmath={"reassoc", "contract", "nsz", "arcp"})
def _number_exp(a, out):
    for i in range(a.size):
        out[i] = exp(a[i])


@numba.njit
def _vector_log(a, out):
    for i in range(0, a.size, 8):
        store(out, i, log(load(a, i)))


@numba.njit(fastmath={"reassoc", "contract", "nsz", "arcp"})
def _number_log(a, out):
    for i in range(a.size):
        out[i] = log(a[i])


def units(found: np.ndarray, exact: np.ndarray) -> float:
    """The largest error in units in the last place."""
    return float((np.abs(found.astype(exact.dtype) - exact) / np.spacing(np.abs(exact).astype(found.dtype))).max())


@PRECISIONS
@pytest.mark.parametrize("loop", [_vector_exp, _number_exp])
def test_the_exponential_errs_by_at_most_two_units(dtype, loop):
    smallest, finer = {np.float32: (-80.0, np.float64), np.float64: (-170.0, np.longdouble)}[dtype]
    x = np.concatenate([np.linspace(smallest, 85.0, 160_000), -np.geomspace(1e-18, 1.0, 1000)]).astype(dtype)
    out = np.empty_like(x)
    loop(x, out)
    assert units(out, np.exp(x.astype(finer))) <= 2.0
    least = np.empty(8, dtype)
    loop(np.array([-1e30, -np.inf, np.nan, 1.5 * smallest] * 2, dtype), least)
    assert (least == out[0]).all() and out[0] == pytest.approx(math.exp(smallest), rel=1e-6)


@PRECISIONS
@pytest.mark.parametrize("loop", [_vector_log, _number_log])
def test_the_logarithm_errs_by_at_most_two_units(dtype, loop):
    finer = {np.float32: np.float64, np.float64: np.longdouble}[dtype]
    tiny = np.finfo(dtype).tiny
    x = np.concatenate([np.geomspace(tiny, 1.0 / tiny, 160_000), np.linspace(0.4, 2.2, 160_000), [1.0] * 8])
    x = x.astype(dtype)
    out = np.empty_like(x)
    loop(x, out)
    assert units(out, np.log(x.astype(finer))) <= 2.0
    assert (out[-8:] == 0.0).all()


@numba.njit
def _circle_points(turns, out):
    for number in range(turns.size):
        out[number] = circle_point(turns[number])


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=30))
def test_points_on_a_circle_are_those_of_the_mathematical_library(turns):
    turns = np.concatenate([turns, np.arange(-16, 17) / 8, np.linspace(0.0, 1.0, 1000, endpoint=False)])
    out = np.empty((len(turns), 2))
    _circle_points(turns, out)
    angle = 2.0 * np.pi * (turns - np.round(turns))  # exact, and small enough that an angle in radians keeps its digits
    assert_allclose(out, np.stack([np.cos(angle), np.sin(angle)], axis=1), rtol=0.0, atol=1.5e-15)
    exact = {0.0: (1.0, 0.0), 0.25: (0.0, 1.0), 0.5: (-1.0, 0.0), 0.75: (0.0, -1.0)}
    for turn, point in exact.items():
        _circle_points(np.array([turn]), out[:1])
        assert tuple(out[0]) == point


def test_not_a_number_is_the_first_to_give_way():
    out = np.empty((9, 8))
    a = np.array([np.nan, 1.0] * 4)
    _algebra(a, np.full(8, 2.0), out)
    assert_array_equal(out[3], [2.0, 1.0] * 4)
    assert_array_equal(out[4], [1.0, 1.0] * 4)


@numba.njit
def _precisions_mixed(a, b):
    return lane(load(a, 0) + load(b, 0), 0)


@numba.njit
def _fraction_added(a):
    return lane(truncated(load(a, 0)) + 0.5, 0)


@numba.njit
def _strided(a):
    return lane(load(a, 0), 0)


def test_what_does_not_fit_is_refused_by_the_compiler():
    single, double = np.zeros(16, np.float32), np.zeros(16)
    with pytest.raises(TypingError):
        _precisions_mixed(single, double)
    with pytest.raises(TypingError):
        _fraction_added(single)  # of whole numbers
    with pytest.raises(TypingError, match="accepted: C-contiguous"):
        _strided(double[::2])


@numba.njit
def _sixteen(out):
    store(out, 0, spread(np.float32(2.5), 16) * 2.0)
    return lane(spread(-3, 4), 2)


def test_numbers_are_spread_over_as_many_lanes_as_are_asked_for():
    out = np.zeros(17, np.float32)
    assert _sixteen(out) == -3
    assert (out[:16] == 5.0).all() and out[16] == 0.0


@numba.njit
def _selected(values, chosen, out):
    compress(out, 3, load(chosen, 0, 16) > 0.5, load(values, 0, 16))


@PRECISIONS
@given(chosen=st.one_of(st.just([True] * 16), st.just([False] * 16), st.lists(st.booleans(), min_size=16, max_size=16)))
@settings(deadline=None)
def test_the_lanes_of_a_mask_are_stored_without_gaps_and_no_others(dtype, chosen):
    values, out = np.arange(1.0, 17.0, dtype=dtype), np.full(24, -1.0, dtype)
    _selected(values, np.array(chosen, dtype), out)
    kept = values[np.array(chosen)]
    assert_array_equal(out[3 : 3 + len(kept)], kept)
    assert (np.delete(out, np.arange(3, 3 + len(kept))) == -1.0).all()


@numba.njit
def _tables(rows, table, out):
    _sum(Place(rows, 8), 3, Tables(table, 2, 10, 5), Place(out, 8), 24)


_sum = lanes_times_tables(2)


def test_lanes_times_tables_are_sums_of_products():
    rng = np.random.default_rng(3)
    rows, table, out = rng.normal(size=(4, 8)), rng.normal(size=40), np.zeros((6, 8))
    _tables(rows.ravel(), table, out.ravel())
    for first, into in ((2, 1), (12, 4)):
        for column in range(2):
            numbers = table[first + column + 5 * np.arange(3)]
            assert_allclose(out[into + column], numbers @ rows[1:4], rtol=1e-12)
    assert not out[[0, 3]].any()
