"""First pass over a picture: second moments in double precision and a sample of pixels.

Pixels are sorted into classes of brightness, each a factor of 1024 wide, and the moments of each class are summed
separately. Squares span twice as many decades as the values; in a single sum, the shadows of a picture with the sun
would be lost to rounding.
"""

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from irodori.jit.compilation import uncounted
from irodori.jit.vector_memory import load, spread, store
from irodori.jit.vectors import LANES
from irodori.material.principal_components.pixel_tiles import Tiles

SAMPLE_PIXELS = 1 << 16
_BLOCK = 64  # pixels that are multiplied together, in the first cache
_CLASS_EXPONENTS, _LOWEST_EXPONENT = 20, -400
_CLASSES = 40
#: Eigenvalues of a class below this share of its largest are rounding of single-precision pixels.
_ROUNDING = 61 * 2.0**-52


@dataclass(frozen=True)
class Moments:
    """Second moments of a picture and a sample of it.

    Parameters
    ----------
    root : (m, bands) float64
        ``root.T @ root`` is the sum of x xᵀ over the pixels.
    pixels, masked : int
        All pixels, and those that are not finite; the latter are left out of everything.
    largest_norm : float
        Largest Euclidean length of a pixel.
    sample : (n, bands) float32
        Pixels drawn at random without repetition; all finite pixels if the picture has no more than the sample.
    """

    root: np.ndarray
    pixels: int
    masked: int
    largest_norm: float
    sample: np.ndarray


@uncounted(nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _take(rows, p, blocks, level, place):
    """Copy pixel ``p`` of ``rows`` into the block of a class and return its squared length."""
    total = 0.0
    for j in range(rows.shape[1]):
        value = np.float64(rows[p, j])
        blocks[level, place, j] = value
        total += value * value
    return total


@uncounted(nogil=True, error_model="numpy")
def _multiply_two(block, side, i, j, moment):
    """Add to a moment matrix the products of 8 columns of a block, from ``i`` on, with 16 columns, from ``j`` on."""
    a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = spread(0.0)
    b0 = b1 = b2 = b3 = b4 = b5 = b6 = b7 = spread(0.0)
    for p in range(0, _BLOCK * side, side):
        y, z, x = load(block, p + j), load(block, p + j + LANES), p + i
        a0, b0 = a0 + block[x] * y, b0 + block[x] * z
        a1, b1 = a1 + block[x + 1] * y, b1 + block[x + 1] * z
        a2, b2 = a2 + block[x + 2] * y, b2 + block[x + 2] * z
        a3, b3 = a3 + block[x + 3] * y, b3 + block[x + 3] * z
        a4, b4 = a4 + block[x + 4] * y, b4 + block[x + 4] * z
        a5, b5 = a5 + block[x + 5] * y, b5 + block[x + 5] * z
        a6, b6 = a6 + block[x + 6] * y, b6 + block[x + 6] * z
        a7, b7 = a7 + block[x + 7] * y, b7 + block[x + 7] * z
    _add(moment, side, i * side + j, (a0, a1, a2, a3, a4, a5, a6, a7))
    _add(moment, side, i * side + j + LANES, (b0, b1, b2, b3, b4, b5, b6, b7))


@uncounted(nogil=True, error_model="numpy")
def _multiply_one(block, side, i, j, moment):
    """Add to a moment matrix the products of 8 columns of a block, from ``i`` on, with 8 columns, from ``j`` on."""
    a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = spread(0.0)
    for p in range(0, _BLOCK * side, side):
        y, x = load(block, p + j), p + i
        a0, a1 = a0 + block[x] * y, a1 + block[x + 1] * y
        a2, a3 = a2 + block[x + 2] * y, a3 + block[x + 3] * y
        a4, a5 = a4 + block[x + 4] * y, a5 + block[x + 5] * y
        a6, a7 = a6 + block[x + 6] * y, a7 + block[x + 7] * y
    _add(moment, side, i * side + j, (a0, a1, a2, a3, a4, a5, a6, a7))


@uncounted(nogil=True, error_model="numpy")
def _add(moment, side, place, rows):
    """Add 8 rows of 8 numbers to a flat matrix with rows of ``side``, the first at flat index ``place``."""
    for row in rows:
        store(moment, place, load(moment, place) + row)
        place += side


@uncounted(nogil=True, error_model="numpy")
def _multiply(block, side, moment):
    """Add the products of a block's columns to a moment matrix, upper 8 x 8 blocks; both are flat, rows of ``side``."""
    for i in range(0, side, LANES):
        j = i
        while j + LANES < side:
            _multiply_two(block, side, i, j, moment)
            j += 2 * LANES
        if j < side:
            _multiply_one(block, side, i, j, moment)


@uncounted(nogil=True, error_model="numpy")
def _accumulate(rows, blocks, flat_blocks, waiting, moments, totals):
    """Add pixels to the moments of their classes; ``totals`` gets the masked count and the largest squared length."""
    level = 0
    for p in range(rows.shape[0]):
        # Neighbours are mostly of one class: the pixel is copied there while its length is computed.
        square = _take(rows, p, blocks, level, waiting[level])
        if not square < np.inf:
            totals[0] += 1.0
            continue
        totals[1] = max(totals[1], square)
        if square == 0.0:
            continue
        own = (math.frexp(square)[1] - _LOWEST_EXPONENT) // _CLASS_EXPONENTS
        own = min(max(own, 0), moments.shape[0] - 1)
        if own != level:
            level = own
            _take(rows, p, blocks, level, waiting[level])
        waiting[level] += 1
        if waiting[level] == _BLOCK:
            _multiply(flat_blocks[level], blocks.shape[2], moments[level])
            waiting[level] = 0


@uncounted(nogil=True)
def _finish(side, blocks, waiting, moments):
    for level in range(len(blocks)):
        if waiting[level]:
            block = blocks[level]
            for place in range(waiting[level] * side, block.size):
                block[place] = 0.0
            _multiply(block, side, moments[level])


class _Sums:
    """Buffers in which one worker computes the moments of its tiles, one after the other."""

    def __init__(self, bands: int) -> None:
        self.bands, self._side = bands, -(-bands // LANES) * LANES
        self._moments = np.zeros((_CLASSES, self._side**2))
        self._blocks, self._waiting = np.zeros((_CLASSES, _BLOCK, self._side)), np.zeros(_CLASSES, dtype=np.int64)

    def of(self, rows: np.ndarray) -> "_OfTile":
        """Return the moments of a tile, (pixels, bands)."""
        self._moments[:], self._waiting[:] = 0.0, 0
        totals, flat = np.zeros(2), self._blocks.reshape(_CLASSES, -1)
        _accumulate(rows, self._blocks, flat, self._waiting, self._moments, totals)
        _finish(self._side, flat, self._waiting, self._moments)
        moments = {}
        for level in np.flatnonzero(self._moments.any(axis=1)).tolist():
            upper = np.triu(self._moments[level].reshape(self._side, self._side)[: self.bands, : self.bands])
            moments[level] = upper + np.triu(upper, 1).T
        return _OfTile(len(rows), int(totals[0]), float(totals[1]), moments)


class _OfTile(NamedTuple):
    """Number of pixels in a tile and of masked ones, largest squared length, moments (bands, bands) of each class."""

    pixels: int
    masked: int
    largest: float
    moments: dict[int, np.ndarray]


class _Sampler:
    """Random sample of pixels without repetition: each pixel gets a random number, and the least numbers are kept."""

    def __init__(self, size: int) -> None:
        self._size, self._lock = size, threading.Lock()
        self._keys: list[np.ndarray] = []
        self._rows: list[np.ndarray] = []
        self._limit = 2.0

    def add(self, rows: np.ndarray, first: int) -> None:
        """Add the pixels of a tile; the sample does not depend on the order of the tiles."""
        keys = np.random.default_rng((0, first)).random(len(rows))
        chosen = np.flatnonzero(keys < self._limit)
        picked = rows[chosen]
        finite = np.isfinite(picked).all(axis=1)
        with self._lock:
            self._keys.append(keys[chosen][finite])
            self._rows.append(picked[finite])
            if sum(map(len, self._keys)) > 2 * self._size:
                self._thin()

    def _thin(self) -> None:
        keys, rows = np.concatenate(self._keys), np.concatenate(self._rows)
        if len(keys) > self._size:
            order = np.argpartition(keys, self._size)[: self._size]
            keys, rows = keys[order], rows[order]
            self._limit = float(keys.max())
        self._keys, self._rows = [keys], [rows]

    def rows(self) -> np.ndarray:
        self._thin()
        return self._rows[0][np.argsort(self._keys[0], kind="stable")]


def second_moments(
    source,
    sample_pixels: int = SAMPLE_PIXELS,
    also: Callable[[np.ndarray, int], None] | None = None,
) -> Moments:
    """Read a picture once and return its second moments about zero.

    Parameters
    ----------
    source : Tiles, or what `Tiles` takes
    sample_pixels : int
    also : callable, optional
        Called in several threads with every tile (pixels, bands) and the number of its first pixel, for other
        statistics from the same pass.

    Returns
    -------
    Moments

    Raises
    ------
    ValueError
        If no pixel is finite, or tiles differ in their number of bands.
    """
    tiles = source if isinstance(source, Tiles) else Tiles(source)
    workers: dict[int, _Sums] = {}
    sampler, lock = _Sampler(sample_pixels), threading.Lock()

    def add(rows: np.ndarray, first: int, worker: int) -> _OfTile:
        with lock:
            own = workers.setdefault(worker, _Sums(rows.shape[1]))
            if rows.shape[1] != workers[min(workers)].bands:
                found = f"a tile of {rows.shape[1]} bands among others of {workers[min(workers)].bands}"
                raise ValueError(f"{found}; accepted: the same in all")
        of_tile = own.of(rows)
        sampler.add(rows, first)
        if also is not None:
            also(rows, first)
        return of_tile

    pixels, masked, largest = 0, 0, 0.0
    moments: dict[int, np.ndarray] = {}
    # Tiles are added in order, so that the sums have the same bits with any number of threads.
    for tile in tiles.map(add):
        pixels, masked, largest = pixels + tile.pixels, masked + tile.masked, max(largest, tile.largest)
        for level, values in tile.moments.items():
            moments[level] = moments[level] + values if level in moments else values
    if masked == pixels:
        raise ValueError(f"a picture without a finite pixel among {pixels}; accepted: at least one")
    root = _root([moments[level] for level in sorted(moments)], workers[0].bands)
    return Moments(root, pixels, masked, math.sqrt(largest), sampler.rows())


def _root(moments: list[np.ndarray], bands: int) -> np.ndarray:
    """Return R (m, bands) such that R.T @ R is the sum of the classes' moments; one row of zeros if all is black."""
    rows = [np.zeros((1, bands))]
    for moment in moments:
        values, vectors = np.linalg.eigh(moment)
        kept = values > _ROUNDING * values[-1]
        if kept.any():
            rows.append(np.sqrt(values[kept])[:, None] * vectors[:, kept].T)
    return np.concatenate(rows)
