"""Kernels run in chunks on several threads."""

from concurrent.futures import ThreadPoolExecutor

import numba


def run_chunks(kernel, count: int, chunk: int, *arguments) -> None:
    """Run ``kernel(*arguments, first, last)`` over 0..count in chunks, on as many threads as numba may use.

    For large kernels: in a parallel loop of numba's the same code takes a third longer to compile.

    Parameters
    ----------
    kernel : callable
        Compiled with ``nogil``; chunks may run in any order.
    """
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        pieces = [(first, min(first + chunk, count)) for first in range(0, count, chunk)]
        for done in [pool.submit(kernel, *arguments, *piece) for piece in pieces]:
            done.result()
