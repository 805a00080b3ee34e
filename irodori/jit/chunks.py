"""Execution of kernels in chunks on several threads."""

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import lru_cache
from typing import TypeVar

import numba

Item = TypeVar("Item")
Result = TypeVar("Result")


@lru_cache(maxsize=1)
def _pool(threads: int) -> ThreadPoolExecutor:
    """Return threads that stay for the next call: to start new ones takes a tenth of a millisecond each time.

    A chunk that itself calls `run_chunks` gets one thread: it would wait for ever for those that wait for it.
    """
    return ThreadPoolExecutor(threads, "chunks", numba.set_num_threads, (1,))


# A process that was forked has none of its parent's threads.
os.register_at_fork(after_in_child=_pool.cache_clear)


def run_chunks(kernel, count: int, chunk: int, *arguments) -> None:
    """Run ``kernel(*arguments, first, last)`` for chunks of the range from 0 to ``count``, on the threads of numba.

    This is used instead of parallel loops of numba, which take a third longer to compile. If arguments are tuples, the
    loop for their types is looked up once for all chunks, see `irodori.jit.compilation.Kernel.resolved`: numba would
    determine these types anew in every call.

    Parameters
    ----------
    kernel : callable
        Function compiled with ``nogil``; chunks may run in any order.
    """
    pieces = [(first, min(first + chunk, count)) for first in range(0, count, chunk)]
    if not pieces:
        return
    # Without `resolved`, compilation by numba is disabled.
    if hasattr(kernel, "resolved") and any(isinstance(argument, tuple) for argument in arguments):
        kernel = kernel.resolved(*arguments, *pieces[0])
    threads = min(numba.get_num_threads(), len(pieces))
    if threads == 1:
        for piece in pieces:
            kernel(*arguments, *piece)
        return
    pool = _pool(threads)
    begun = [pool.submit(kernel, *arguments, *piece) for piece in pieces]
    try:
        for one in begun:
            one.result()
    finally:
        # After an error or an interrupt, nothing goes on writing to the arguments.
        for one in begun:
            one.cancel()
        wait(begun)


def parallel_map(work: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
    """Yield what a function makes of each item, in order; every thread of numba works on an item of its own.

    Besides the result that was taken last, there are at most as many as threads, because they take space.
    """
    threads = min(numba.get_num_threads(), len(items))
    if threads <= 1:
        yield from map(work, items)
        return
    with ThreadPoolExecutor(threads, initializer=numba.set_num_threads, initargs=(1,)) as pool:
        coming = deque(pool.submit(work, item) for item in items[:threads])
        for item in items[threads:]:
            done = coming.popleft().result()
            coming.append(pool.submit(work, item))  # before the result is used, so that no thread waits meanwhile
            yield done
        for one in coming:
            yield one.result()
