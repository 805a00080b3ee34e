"""Calls in a loop ask the system for memory again and again, but not where they have room."""

import resource
from concurrent.futures import ThreadPoolExecutor

import pytest

from irodori.core.frame_memory import with_room_for_calls

CALLS = 500


def _small(number):
    return number


def _most_faults(first: int = 0, last: int = 400) -> int:
    """Return the most pages that the system gave to a loop of calls, of loops at many depths of calls."""
    before = resource.getrusage(resource.RUSAGE_THREAD).ru_minflt
    for number in range(CALLS):
        _small(number)
    here = resource.getrusage(resource.RUSAGE_THREAD).ru_minflt - before
    return here if first == last else max(here, _most_faults(first + 1, last))


@pytest.mark.parametrize("has_room", [False, True])
def test_calls_that_have_room_ask_for_no_memory_at_any_depth(has_room):
    # A thread of its own: the calls of a test have room.
    with ThreadPoolExecutor(1) as thread:
        function = with_room_for_calls(lambda: _most_faults()) if has_room else _most_faults
        faults = thread.submit(function).result()
    # Otherwise the memory of a piece is new at each call, so that its first page has to be given.
    assert faults < 0.1 * CALLS if has_room else faults >= CALLS
