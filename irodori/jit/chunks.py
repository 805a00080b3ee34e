"""Kernels run in chunks on several threads."""

from concurrent.futures import ThreadPoolExecutor

import numba


def run_chunks(kernel, count: int, chunk: int, *arguments) -> None:
    """Run ``kernel(*arguments, first, last)`` over 0..count in chunks, on as many threads as numba may use.

    The code of a parallel loop of numba's takes a third longer to compile. The types of the arguments, a millisecond
    for nested tuples, are worked out once for all chunks.

    Parameters
    ----------
    kernel : callable
        Compiled with ``nogil``; chunks may run in any order.
    """
    pieces = [(first, min(first + chunk, count)) for first in range(0, count, chunk)]
    if not pieces:
        return
    if hasattr(kernel, "compile"):  # not where numba is switched off
        kernel = kernel.compile(tuple(numba.typeof(argument) for argument in (*arguments, *pieces[0])))
    threads = min(numba.get_num_threads(), len(pieces))
    if threads == 1:
        for piece in pieces:
            kernel(*arguments, *piece)
        return
    with ThreadPoolExecutor(threads) as pool:
        for done in [pool.submit(kernel, *arguments, *piece) for piece in pieces]:
            done.result()
