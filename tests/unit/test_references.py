"""Named tuples that compiled functions hand on by their address are read as the tuples themselves."""

from typing import NamedTuple

import numba
import numpy as np
import pytest

from irodori.jit.compilation import njit, uncounted
from irodori.jit.references import referred


class Place(NamedTuple):
    x: float
    y: float


class Named(NamedTuple):
    values: np.ndarray
    place: Place
    pair: tuple[int, float]
    grid: np.ndarray
    is_lit: bool


class Outer(NamedTuple):
    inner: Named
    count: int
    nothing: None


def made() -> Outer:
    values, grid = np.arange(5.0), np.arange(6, dtype=np.int32).reshape(2, 3)
    return Outer(Named(values, Place(1.5, -2.0), (7, 0.25), grid, True), 3, None)


@uncounted()
def _read(named, place):
    return named.values[1:].sum() + place.x * named.place.y + named.pair[0] * named.pair[1] + named.grid[1, 2]


@uncounted()
def _handed_on(outer):
    inner = outer.inner
    inner.values[0] = 10.0 * outer.count
    inner.grid[0, 1] += 5
    return _read(inner, inner.place) + inner.values[0] if inner.is_lit and outer.nothing is None else -1.0


@uncounted()
def _by_address(whole):
    return _handed_on(referred(whole))


@uncounted()
def _by_value(whole):
    return _handed_on(whole)


@njit
def by_address(whole):
    return _by_address(whole)


@njit
def by_value(whole):
    return _by_value(whole)


def test_fields_of_any_kind_are_those_of_the_tuple_and_arrays_are_its_own():
    one, other = made(), made()
    assert by_address(one) == by_value(other) == 10.0 - 3.0 + 1.75 + 5.0 + 30.0
    for outer in (one, other):
        assert outer.inner.values.tolist() == [30.0, 1.0, 2.0, 3.0, 4.0]
        assert outer.inner.grid.tolist() == [[0, 6, 2], [3, 4, 5]]


def test_buffers_that_a_kernel_makes_live_as_long_as_their_reference():
    @uncounted()
    def fill(buffers, times):
        named = referred(buffers)
        for turn in range(times):
            for at in range(named.values.size):
                named.values[at] += turn
        return named.values.sum()

    @njit
    def filled(size, times):
        total = 0.0
        for _ in range(times):
            buffers = Named(np.zeros(size), Place(0.0, 0.0), (0, 0.0), np.zeros((1, 1), np.int32), False)
            total += fill(buffers, times)
        return total

    assert filled(10_000, 50) == 50 * 10_000 * sum(range(50))


def test_a_field_that_there_is_not_is_named():
    @uncounted()
    def absent(whole):
        return referred(whole).absent

    @njit
    def kernel(whole):
        return absent(whole)

    with pytest.raises(numba.core.errors.TypingError, match="absent"):
        kernel(made())


def test_a_function_that_counts_references_makes_none():
    """It would free the arrays of a tuple at its last use by value."""

    @njit
    def kernel(whole):
        return referred(whole).count

    with pytest.raises(numba.core.errors.NumbaError, match="uncounted functions"):
        kernel(made())
    with pytest.raises(numba.core.errors.TypingError):
        njit(lambda values: referred(values))(np.zeros(3))
