"""Iteration over a picture's pixels by tiles, of an array or as they are read.

One tile is read while others are processed; a picture may be read any number of times.
"""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import numba
import numpy as np
from threadpoolctl import threadpool_limits

TILE_BYTES = 8 << 20


class Tiles:
    """A picture that can be read tile by tile, several times.

    Parameters
    ----------
    source : array or iterable of arrays
        Array: (pixels, bands) or (height, width, bands). Iterable: tiles of either shape, the same tiles at each
        iteration. Values are converted to float32.
    tile_bytes : int
        Approximate size of an array's tile as float32. Tiles of an iterable keep their size, and up to two for each
        worker are held at once: the iterable must not overwrite them meanwhile.

    Raises
    ------
    ValueError
        If the source has other axes, has no pixel, or can be iterated only once.
    """

    def __init__(self, source, tile_bytes: int = TILE_BYTES) -> None:
        self._source, self._bytes = source, tile_bytes
        if isinstance(source, np.ndarray):
            if source.ndim not in (2, 3) or 0 in source.shape:
                raise ValueError(
                    f"a picture of shape {source.shape}; accepted: (pixels, bands) or (height, width, bands)"
                )
        elif iter(source) is source:
            raise ValueError("tiles that can be read once only; accepted: what can be iterated twice, such as a list")

    def map(self, function: Callable[[np.ndarray, int, int], object]) -> Iterator:
        """Yield ``function(tile, first, worker)`` for every tile, in order.

        There are as many workers, w, as numba has threads. Each processes every w-th tile without waiting for the
        others. Meanwhile BLAS is limited to one thread.

        Parameters
        ----------
        function : callable
            Called with a contiguous tile (pixels, bands) float32, which is valid only during the call; the number of
            its first pixel; and the number of the worker, which processes its tiles in order and one at a time.
        """
        workers = numba.get_num_threads()

        def work(tile, first: int, worker: int):
            return function(_rows(tile), first, worker)

        with ExitStack() as stack:
            stack.enter_context(threadpool_limits(1, user_api="blas"))
            pools = [stack.enter_context(ThreadPoolExecutor(1, "tiles")) for _ in range(workers)]
            waiting: deque = deque()
            first = 0
            for number, tile in enumerate(self._parts() if isinstance(self._source, np.ndarray) else self._source):
                worker = number % workers
                waiting.append(pools[worker].submit(work, tile, first, worker))
                first += int(np.prod(np.shape(tile)[:-1]))
                if len(waiting) == 2 * workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()

    def _parts(self) -> Iterator[np.ndarray]:
        """Yield the tiles of an array: whole rows, or parts of a long row."""
        source = self._source
        row_bytes = int(np.prod(source.shape[1:])) * 4
        if source.ndim == 3 and row_bytes > self._bytes:
            columns = max(1, self._bytes // (source.shape[2] * 4))
            for row in source:
                for first in range(0, len(row), columns):
                    yield row[first : first + columns]
            return
        rows = max(1, self._bytes // row_bytes)
        for first in range(0, len(source), rows):
            yield source[first : first + rows]


def _rows(tile) -> np.ndarray:
    tile = np.asarray(tile)
    return np.ascontiguousarray(tile.reshape(-1, tile.shape[-1]), dtype=np.float32)
