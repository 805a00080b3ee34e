"""Iteration over a picture's pixels by tiles: arrays, memory maps, HDF5 datasets, generators.

One tile is read while others are processed; a picture may be read any number of times.
"""

import mmap
import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import NamedTuple

import numba
import numpy as np
from threadpoolctl import threadpool_limits

TILE_BYTES = 8 << 20


class Tiles:
    """A picture that can be read tile by tile, several times.

    Parameters
    ----------
    source : array, h5py.Dataset, or iterable of arrays
        Array-like: (pixels, bands) or (height, width, bands). Iterable: tiles of either shape, the same tiles at each
        iteration. Values are converted to float32.
    tile_bytes : int
        Approximate size of a tile as float32; each worker holds one. Tiles of an iterable keep their size, and up to
        two for each worker are held at once: the iterable must not overwrite them meanwhile.

    Raises
    ------
    ValueError
        If the source has other axes, has no pixel, or can be iterated only once.
    """

    def __init__(self, source, tile_bytes: int = TILE_BYTES) -> None:
        self._source, self._bytes = source, tile_bytes
        self._is_array = hasattr(source, "shape") and hasattr(source, "dtype")
        # Read once: HDF5 locks the file while another thread writes a chunk, and reading the shape would wait for it.
        self._shape: tuple[int, ...] = tuple(source.shape) if self._is_array else ()
        self._place = _place_in_file(source)
        if self._is_array:
            if len(self._shape) not in (2, 3) or 0 in self._shape:
                raise ValueError(
                    f"a picture of shape {self._shape}; accepted: (pixels, bands) or (height, width, bands)"
                )
        elif iter(source) is source:
            raise ValueError(
                "tiles that can be read once only; accepted: what can be iterated twice, a list or a dataset"
            )

    def map(self, function: Callable[[np.ndarray, int, int], object]) -> Iterator:
        """Yield ``function(tile, first, worker)`` for every tile, in order.

        There are as many workers, w, as numba has threads. Each reads and processes every w-th tile without waiting for
        the others. Meanwhile BLAS is limited to one thread.

        Parameters
        ----------
        function : callable
            Called with a contiguous tile (pixels, bands) float32, which is valid only during the call; the number of
            its first pixel; and the number of the worker, which processes its tiles in order and one at a time.
        """
        workers = numba.get_num_threads()
        buffers = [np.empty(0, dtype=np.float32) for _ in range(workers)]

        def work(item, first: int, worker: int):
            if self._is_array:
                item = self._read(item, buffers, worker)
            return function(_rows(item), first, worker)

        with ExitStack() as stack:
            stack.enter_context(threadpool_limits(1, user_api="blas"))
            pools = [stack.enter_context(ThreadPoolExecutor(1, "tiles")) for _ in range(workers)]
            waiting: deque = deque()
            first = 0
            for number, item in enumerate(self._parts() if self._is_array else self._source):
                worker = number % workers
                waiting.append(pools[worker].submit(work, item, first, worker))
                first += self._pixels(item)
                if len(waiting) == 2 * workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()

    def _pixels(self, item) -> int:
        if not self._is_array:
            return int(np.prod(np.shape(item)[:-1]))
        return int(np.prod([s.stop - s.start for s in item] + list(self._shape[len(item) : -1])))

    def _read(self, part: tuple[slice, ...], buffers: list, worker: int) -> np.ndarray:
        source = self._source
        if type(source) is np.ndarray:
            return source[part]
        if self._place is not None:
            return self._place.mapped(part, self._shape)
        shape = (*(s.stop - s.start for s in part), *self._shape[len(part) :])
        size = int(np.prod(shape))
        if buffers[worker].size < size:
            buffers[worker] = np.empty(size, dtype=np.float32)
        tile = buffers[worker][:size].reshape(shape)
        if hasattr(source, "read_direct"):
            source.read_direct(tile, part)
        else:
            np.copyto(tile, source[part], casting="unsafe")
        return tile

    def _parts(self) -> Iterator[tuple[slice, ...]]:
        """Yield slices of the leading axes for each tile: whole rows, aligned to chunks, or parts of a long row."""
        shape = self._shape
        row_bytes = int(np.prod(shape[1:])) * 4
        if len(shape) == 3 and row_bytes > self._bytes:
            columns = max(1, self._bytes // (shape[2] * 4))
            for row in range(shape[0]):
                for first in range(0, shape[1], columns):
                    yield slice(row, row + 1), slice(first, min(first + columns, shape[1]))
            return
        rows = max(1, self._bytes // row_bytes)
        chunk = (getattr(self._source, "chunks", None) or (1,))[0]
        rows = -(-rows // chunk) * chunk if chunk * row_bytes <= 4 * self._bytes else rows
        for first in range(0, shape[0], rows):
            yield (slice(first, min(first + rows, shape[0])),)


def _rows(tile) -> np.ndarray:
    tile = np.asarray(tile)
    return np.ascontiguousarray(tile.reshape(-1, tile.shape[-1]), dtype=np.float32)


class _Place(NamedTuple):
    """Position of a contiguous, uncompressed dataset in its file."""

    file: str
    first_byte: int

    def mapped(self, part: tuple[slice, ...], shape: tuple[int, ...]) -> np.ndarray:
        """Return a tile as a memory map of the file, without a copy; the map is released with the array."""
        strides = [int(np.prod(shape[axis + 1 :])) * 4 for axis in range(len(part))]
        begin = self.first_byte + sum(s.start * stride for s, stride in zip(part, strides, strict=True))
        page = begin // mmap.ALLOCATIONGRANULARITY * mmap.ALLOCATIONGRANULARITY
        tile = (*(s.stop - s.start for s in part), *shape[len(part) :])
        count = int(np.prod(tile))
        file = os.open(self.file, os.O_RDONLY)
        try:
            flags = mmap.MAP_SHARED | getattr(mmap, "MAP_POPULATE", 0)
            view = mmap.mmap(file, begin - page + 4 * count, flags=flags, prot=mmap.PROT_READ, offset=page)
        finally:
            os.close(file)
        return np.frombuffer(view, dtype=np.float32, count=count, offset=begin - page).reshape(tile)


def _place_in_file(source) -> _Place | None:
    """Return the position of a contiguous HDF5 dataset of float32 in a file open for reading; None for the rest."""
    plain = hasattr(source, "id") and hasattr(source, "chunks") and source.chunks is None
    if not plain or source.dtype != np.float32 or source.file.mode != "r":
        return None
    first_byte = source.id.get_offset()
    return None if first_byte is None else _Place(source.file.filename, first_byte)
