"""The first pass over a picture: second moments in double precision, what is masked, and a sample of its pixels.

Pixels are gathered by brightness, a factor of 1024 to a class, and each class has a matrix of its own: squares span
twice the decades of what is squared, and a sun would leave nothing of the shadows in the last digits of one sum.
"""

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np

from irodori.principal.tiles import Tiles

SAMPLE_PIXELS = 1 << 16
_BLOCK = 64  # pixels that are multiplied together, in the first cache
_SIDE = 4  # entries of the matrix that are held in registers, along each side
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
        Pixels drawn at random without repetition; all of them where there are no more.
    """

    root: np.ndarray
    pixels: int
    masked: int
    largest_norm: float
    sample: np.ndarray


@numba.njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _squared_norm(row):
    total = 0.0
    for j in range(row.size):
        value = np.float64(row[j])
        total += value * value
    return total


@numba.njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _multiply(block, moment):
    """Add the products of a block's columns (bands, pixels) with one another, upper blocks of 4 x 4."""
    for i in range(0, block.shape[0], _SIDE):
        for j in range(i, block.shape[0], _SIDE):
            s00 = s01 = s02 = s03 = s10 = s11 = s12 = s13 = 0.0
            s20 = s21 = s22 = s23 = s30 = s31 = s32 = s33 = 0.0
            for p in range(_BLOCK):
                x0, x1, x2, x3 = block[i, p], block[i + 1, p], block[i + 2, p], block[i + 3, p]
                y0, y1, y2, y3 = block[j, p], block[j + 1, p], block[j + 2, p], block[j + 3, p]
                s00, s01, s02, s03 = s00 + x0 * y0, s01 + x0 * y1, s02 + x0 * y2, s03 + x0 * y3
                s10, s11, s12, s13 = s10 + x1 * y0, s11 + x1 * y1, s12 + x1 * y2, s13 + x1 * y3
                s20, s21, s22, s23 = s20 + x2 * y0, s21 + x2 * y1, s22 + x2 * y2, s23 + x2 * y3
                s30, s31, s32, s33 = s30 + x3 * y0, s31 + x3 * y1, s32 + x3 * y2, s33 + x3 * y3
            m0, m1, m2, m3 = moment[i], moment[i + 1], moment[i + 2], moment[i + 3]
            m0[j], m0[j + 1], m0[j + 2], m0[j + 3] = m0[j] + s00, m0[j + 1] + s01, m0[j + 2] + s02, m0[j + 3] + s03
            m1[j], m1[j + 1], m1[j + 2], m1[j + 3] = m1[j] + s10, m1[j + 1] + s11, m1[j + 2] + s12, m1[j + 3] + s13
            m2[j], m2[j + 1], m2[j + 2], m2[j + 3] = m2[j] + s20, m2[j + 1] + s21, m2[j + 2] + s22, m2[j + 3] + s23
            m3[j], m3[j + 1], m3[j + 2], m3[j + 3] = m3[j] + s30, m3[j + 1] + s31, m3[j + 2] + s32, m3[j + 3] + s33


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _accumulate(rows, blocks, waiting, moments, totals):
    """Add pixels; ``totals`` holds the masked pixels and the largest squared length."""
    bands = rows.shape[1]
    for p in range(rows.shape[0]):
        square = _squared_norm(rows[p])
        if not square < np.inf:
            totals[0] += 1.0
            continue
        totals[1] = max(totals[1], square)
        if square == 0.0:
            continue
        level = (math.frexp(square)[1] - _LOWEST_EXPONENT) // _CLASS_EXPONENTS
        level = min(max(level, 0), moments.shape[0] - 1)
        place = waiting[level]
        for j in range(bands):
            blocks[level, j, place] = rows[p, j]
        waiting[level] = place + 1
        if place + 1 == _BLOCK:
            _multiply(blocks[level], moments[level])
            waiting[level] = 0


@numba.njit(cache=True, nogil=True)
def _finish(blocks, waiting, moments):
    for level in range(len(blocks)):
        if waiting[level]:
            blocks[level, :, waiting[level] :] = 0.0
            _multiply(blocks[level], moments[level])


class _Sums:
    """What one worker adds up."""

    def __init__(self, bands: int) -> None:
        side = -(-bands // _SIDE) * _SIDE
        self.bands = bands
        self.totals = np.zeros(2)
        self.moments = np.zeros((_CLASSES, side, side))
        self._blocks, self._waiting = np.zeros((_CLASSES, side, _BLOCK)), np.zeros(_CLASSES, dtype=np.int64)

    def add(self, rows: np.ndarray) -> None:
        _accumulate(rows, self._blocks, self._waiting, self.moments, self.totals)

    def finished(self) -> np.ndarray:
        """Return the moments of every class, (classes, bands, bands)."""
        _finish(self._blocks, self._waiting, self.moments)
        upper = np.triu(self.moments[:, : self.bands, : self.bands])
        return upper + np.triu(upper, 1).transpose(0, 2, 1)


class _Sampler:
    """Draws pixels without repetition: each gets a random number, and those with the least are kept."""

    def __init__(self, size: int, seed: int) -> None:
        self._size, self._seed, self._lock = size, seed, threading.Lock()
        self._keys, self._rows, self._limit = [], [], 2.0

    def add(self, rows: np.ndarray, first: int) -> None:
        """Take in a tile; in whatever order tiles come, the sample is the same."""
        keys = np.random.default_rng((self._seed, first)).random(len(rows))
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
    seed: int = 0,
    also: Callable[[np.ndarray, int], None] | None = None,
) -> Moments:
    """Read a picture once and return its second moments about zero.

    Parameters
    ----------
    source : Tiles, or what `Tiles` takes
    sample_pixels : int
    seed : int
        Of the sample.
    also : callable, optional
        Takes every tile (pixels, bands) and the number of its first pixel, from several threads: what else one reading
        can give.

    Returns
    -------
    Moments

    Raises
    ------
    ValueError
        If no pixel is finite, or tiles differ in their bands.
    """
    tiles = source if isinstance(source, Tiles) else Tiles(source)
    sums: dict[int, _Sums] = {}
    sampler, lock = _Sampler(sample_pixels, seed), threading.Lock()

    def add(rows: np.ndarray, first: int, worker: int) -> int:
        with lock:
            own = sums.setdefault(worker, _Sums(rows.shape[1]))
            if rows.shape[1] != sums[min(sums)].bands:
                found = f"a tile of {rows.shape[1]} bands among others of {sums[min(sums)].bands}"
                raise ValueError(f"{found}; accepted: the same in all")
        own.add(rows)
        sampler.add(rows, first)
        if also is not None:
            also(rows, first)
        return len(rows)

    pixels = sum(tiles.map(add))
    totals = np.array([own.totals for own in sums.values()]).reshape(-1, 2)
    masked = int(totals[:, 0].sum())
    if masked == pixels:
        raise ValueError(f"a picture without a finite pixel among {pixels}; accepted: at least one")
    root = _root(np.sum([sums[worker].finished() for worker in sorted(sums)], axis=0))
    return Moments(root, pixels, masked, math.sqrt(totals[:, 1].max()), sampler.rows())


def _root(moments: np.ndarray) -> np.ndarray:
    """Return rows whose products sum to those of the classes, (m, bands); a row of zeros where all is black."""
    rows = [np.zeros((1, moments.shape[-1]))]
    for moment in moments:
        if not moment.any():
            continue
        values, vectors = np.linalg.eigh(moment)
        kept = values > _ROUNDING * values[-1]
        if kept.any():
            rows.append(np.sqrt(values[kept])[:, None] * vectors[:, kept].T)
    return np.concatenate(rows)
