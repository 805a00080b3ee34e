"""Named tuples that compiled functions hand on by their address are read as the tuples themselves."""

from typing import NamedTuple

import numba
import numpy as np
import pytest

from irodori.jit.compilation import njit, uncounted
from irodori.jit.references import address_of, at_address


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
def _at_address(whole_at):
    return _handed_on(at_address(whole_at))


@uncounted()
def _by_address(whole):
    return _at_address(address_of(whole))


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


def test_every_call_reads_the_tuple_that_was_written_for_it():
    """Also where the function that writes it is made a part of a loop."""

    @uncounted()
    def total(at, times):
        named, found = at_address(at), 0.0
        for turn in range(times):
            for place in range(named.values.size):
                named.values[place] += turn
            found += named.values[0] * named.place.x
        return found

    @uncounted()
    def once(buffers, times):
        return total(address_of(buffers), times)

    @njit
    def filled(size, times):
        found = np.zeros(times)
        for turn in range(times):
            place = Place(float(turn), 0.0)
            buffers = Named(np.full(size + turn, float(turn)), place, (0, 0.0), np.zeros((1, 1), np.int32), False)
            found[turn] = once(buffers, times)
        return found

    sums = np.cumsum(np.arange(50))
    assert np.array_equal(filled(1000, 50), [(turn * (turn + sums)).sum() for turn in range(50)])


def test_classes_of_one_name_are_told_apart():
    class Other(NamedTuple):
        y: float
        x: float

    Other.__name__ = Other.__qualname__ = "Place"

    @uncounted()
    def x_of(at):
        return at_address(at).x

    @uncounted()
    def read(place):
        return x_of(address_of(place))

    kernel = njit(lambda place: read(place))
    assert (kernel(Place(1.0, 2.0)), kernel(Other(3.0, 4.0))) == (1.0, 4.0)


@uncounted()
def _absent(at):
    return at_address(at).absent


@uncounted()
def _unread(at):
    return at.count


@uncounted()
def _ask_for_absent(whole):
    return _absent(address_of(whole))


@uncounted()
def _read_at_once(whole):
    return _unread(address_of(whole))


@pytest.mark.parametrize(("ask", "named"), [(_ask_for_absent, "absent"), (_read_at_once, "count")])
def test_a_field_that_there_is_not_is_named_and_an_address_alone_has_none(ask, named):
    with pytest.raises(numba.core.errors.TypingError, match=named):
        njit(lambda whole: ask(whole))(made())


def test_a_function_that_counts_references_takes_no_address():
    """It would free the arrays of a tuple at its last use by name."""
    with pytest.raises(numba.core.errors.NumbaError, match="uncounted functions"):
        njit(lambda whole: _at_address(address_of(whole)))(made())
    with pytest.raises(numba.core.errors.TypingError):
        njit(lambda values: address_of(values))(np.zeros(3))
