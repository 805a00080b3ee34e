"""Conversion between single and half precision by instructions of the processor: four to six times NumPy's speed."""

import numpy as np

from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit
from irodori.jit.vector_memory import load, store

_GROUP = 16  # numbers that are converted at a time
_CHUNK = 16384  # groups that a thread takes at a time


@njit(cache=True, nogil=True)
def _convert_chunk(given, out, first, last):
    """Convert groups of numbers; one of the two arrays, uint16, contains the bits of half-precision numbers."""
    for group in range(first, last):
        store(out, group * _GROUP, load(given, group * _GROUP, 16))


def _converted(given: np.ndarray, kind: type[np.generic]) -> np.ndarray:
    """Return flat numbers as another type; halves are uint16."""
    out: np.ndarray = np.empty(given.size, dtype=kind)
    whole = given.size // _GROUP
    run_chunks(_convert_chunk, whole, _CHUNK, given, out)
    if rest := given.size - whole * _GROUP:
        last: np.ndarray = np.empty(_GROUP, dtype=kind)
        _convert_chunk(np.resize(given[-rest:], _GROUP), last, 0, 1)
        out[-rest:] = last[:rest]
    return out


def single_from_half(values: np.ndarray) -> np.ndarray:
    """Convert an array of any shape from float16 to float32, exactly."""
    flat = np.ascontiguousarray(values, dtype=np.float16).reshape(-1)
    return _converted(flat.view(np.uint16), np.float32).reshape(values.shape)


def half_from_single(values: np.ndarray) -> np.ndarray:
    """Convert an array of any shape from float32 to the nearest float16; NaN stays NaN, and 65520 becomes infinite."""
    flat = np.ascontiguousarray(values, dtype=np.float32).reshape(-1)
    return _converted(flat, np.uint16).view(np.float16).reshape(values.shape)
