"""Tests of `irodori.jit.chunks`."""

import os
import threading
import time

import numba
import numpy as np
import pytest

from irodori.jit.chunks import parallel_map, run_chunks


@pytest.fixture(autouse=True)
def two_threads():
    before = numba.get_num_threads()
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one processor")
    numba.set_num_threads(2)
    yield
    numba.set_num_threads(before)


def fill(out, first, last):
    out[first:last] += np.arange(first, last)


def test_every_number_is_in_one_chunk():
    out = np.zeros(103)
    for chunk in (1, 7, 64, 103, 500):
        out[:] = 0.0
        run_chunks(fill, len(out), chunk, out)
        assert np.array_equal(out, np.arange(103))
    run_chunks(fill, 0, 7, out[:0])


def test_chunks_run_at_the_same_time():
    both = threading.Barrier(2, timeout=30)
    run_chunks(lambda first, last: both.wait(), 2, 1)


def test_chunks_that_have_chunks_themselves_end():
    out = np.zeros((8, 40))

    def inner(first, last):
        for row in range(first, last):
            run_chunks(fill, out.shape[1], 5, out[row])

    run_chunks(inner, len(out), 1)
    assert np.array_equal(out, np.broadcast_to(np.arange(40.0), out.shape))


def test_after_an_error_nothing_is_written_any_more():
    written = np.zeros(50)

    def failing(first, last):
        if first == 0:
            raise ValueError("the first chunk")
        time.sleep(0.01)
        written[first:last] = 1.0

    with pytest.raises(ValueError, match="the first chunk"):
        run_chunks(failing, len(written), 1)
    as_left = written.copy()
    assert not as_left.all()
    time.sleep(0.1)
    assert np.array_equal(written, as_left)
    run_chunks(fill, len(written), 7, written)  # and the next call has its threads


# From Python 3.12 on, any fork of a process with threads is warned of; that its child does not wait for them is tested.
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_forked_process_has_threads_of_its_own():
    out = np.zeros(20)
    run_chunks(fill, len(out), 3, out)
    child = os.fork()
    if child == 0:
        try:
            run_chunks(fill, len(out), 3, out)
            os._exit(0 if np.array_equal(out, 2 * np.arange(20)) else 1)
        finally:
            os._exit(2)
    deadline = time.monotonic() + 60.0
    while (ended := os.waitpid(child, os.WNOHANG)) == (0, 0):
        if time.monotonic() > deadline:
            os.kill(child, 9)
            os.waitpid(child, 0)
            pytest.fail("the child waits for threads that it does not have")
        time.sleep(0.01)
    assert os.waitstatus_to_exitcode(ended[1]) == 0


def test_the_number_of_threads_may_change():
    out = np.zeros(30)
    for threads in (2, 1, 2):
        numba.set_num_threads(threads)
        run_chunks(fill, len(out), 4, out)
    assert np.array_equal(out, 3 * np.arange(30))


def test_items_are_done_at_the_same_time_and_come_in_order():
    both, begun = threading.Barrier(2, timeout=30), []

    def square(number):
        begun.append(number)
        if number < 2:
            both.wait()
        time.sleep(0.001 * (number % 3))
        return number**2, numba.get_num_threads()

    found = []
    for number, threads in parallel_map(square, range(20)):
        found.append(number)
        assert threads == 1 and len(begun) <= len(found) + 2
    assert found == [number**2 for number in range(20)]
    assert list(parallel_map(square, [5])) == [(25, 2)] and list(parallel_map(square, [])) == []


def test_an_error_of_an_item_is_raised_after_those_before_it():
    found = []
    with pytest.raises(ZeroDivisionError):
        for one in parallel_map(lambda number: 1 / (number - 3), range(10)):
            found.append(one)
    assert len(found) == 3
