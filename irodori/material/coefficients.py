"""Storage of spectral coefficients: precision, chunks and compression.

Half precision has 11 significant bits from 6.1e-5 to 65504. If the largest coefficient of a basis vector is scaled to
about 32768, all coefficients down to 2e-9 of the largest keep these 11 bits. A picture with a light a million times
brighter than its shadows therefore loses nothing in the shadows. Scales are powers of two, so that scaling is exact and
decoding and encoding again changes nothing.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import h5py
import numpy as np

from irodori.core import store
from irodori.core.errors import InputError
from irodori.jit.half_precision import half_from_single, single_from_half

STORAGES = ("half", "single")
#: The codecs of the configuration and how `irodori.core.store` calls them.
CODECS = {"gzip": "small", "lzf": "fast"}
_COMPONENT = "component"
AXES = f"row,column,{_COMPONENT}"
_SUFFIX = "_scale"
_HALF_TOP = 2.0**15
_TILE_VALUES = 1 << 20
_CACHED_VALUES = 1 << 16
_SIDE_BY_SIDE = 64


def require_storage(storage: str, codec: str = "gzip") -> None:
    """Refuse an unknown storage or codec.

    Raises
    ------
    ValueError
    """
    if storage not in STORAGES:
        raise ValueError(f"unknown storage {storage!r}; accepted: {', '.join(STORAGES)}")
    if codec not in CODECS:
        raise ValueError(f"unknown codec {codec!r}; accepted: {', '.join(CODECS)}")


def half_scale(largest: np.ndarray) -> np.ndarray:
    """Return the power of two by which the coefficients of each basis vector are divided for half precision.

    Parameters
    ----------
    largest : (k,) float
        Bound on the magnitude of the coefficients of each basis vector.

    Returns
    -------
    (k,) float32; 1 where the bound is 0. Division brings the bound to between 16384 and 32768.

    Examples
    --------
    >>> half_scale([1.0, 100000.0, 0.0]).tolist()
    [3.0517578125e-05, 4.0, 1.0]
    """
    largest = np.asarray(largest, dtype=np.float64)
    if not np.isfinite(largest).all():
        raise ValueError("a bound on coefficients that is not finite; accepted: finite numbers")
    exponent = np.ceil(np.log2(np.where(largest > 0, largest, _HALF_TOP) / _HALF_TOP))
    # Single precision holds the scale, whatever the unit of the picture.
    return np.exp2(np.clip(exponent, -126, 127)).astype(np.float32)


def scale_of(coefficients: np.ndarray) -> np.ndarray:
    """Return the scales of `half_scale` for the coefficients of a whole picture, (..., k) float; NaN are ignored."""
    last = coefficients.shape[-1]
    flat = coefficients.reshape(-1, last)
    # NumPy reduces long rows with vector instructions: many pixels are put side by side in one row.
    whole = len(flat) // _SIDE_BY_SIDE * _SIDE_BY_SIDE
    largest = np.zeros(last)
    for part in (flat[:whole].reshape(-1, _SIDE_BY_SIDE * last), flat[whole:]):
        low, high = (reduce(part, axis=0, initial=0.0).reshape(-1, last) for reduce in (np.fmin.reduce, np.fmax.reduce))
        largest = np.maximum(largest, np.maximum(-low.min(axis=0).astype(np.float64), high.max(axis=0)))
    return half_scale(largest)


def to_half(coefficients: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Return coefficients divided by their scale, rounded to half precision, (..., k) float16; NaN stays NaN."""
    with np.errstate(under="ignore"):
        return half_from_single((coefficients * (1.0 / scale)).astype(np.float32, copy=False))


def from_half(stored: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Return coefficients decoded from the half precision that `to_half` made, (..., k) float32."""
    out = np.empty(stored.shape, dtype=np.float32)
    _decode(stored.reshape(-1, stored.shape[-1]), np.asarray(scale), out.reshape(-1, stored.shape[-1]))
    return out


def _decode(stored: np.ndarray, scale: np.ndarray, out: np.ndarray) -> None:
    """Decode the coefficients of pixels (n, k) into ``out``, in flat pieces that fit the processor's cache."""
    pixels = max(1, _CACHED_VALUES // max(scale.size, 1))
    scales = np.tile(scale, min(pixels, len(stored)))
    for first in range(0, len(stored), pixels):
        piece = out[first : first + pixels].reshape(-1)
        half = stored[first : first + pixels].reshape(-1)
        np.multiply(single_from_half(half), scales[: piece.size], out=piece)


def write_coefficients(
    out: store.Writer,
    name: str,
    coefficients: np.ndarray,
    *,
    quantity: str,
    storage: str = "single",
    codec: str = "gzip",
    dims: str = AXES,
    basis: str = "basis",
) -> None:
    """Write the coefficients of a picture's pixels; those of pixels without data are NaN.

    Parameters
    ----------
    out : store.Writer
    name : str
        Name of the dataset; for half precision the dataset ``<name>_scale`` (k,) is written too.
    coefficients : (height, width, k) float
    quantity : str
    storage : str
        ``half`` or ``single``.
    codec : str
        ``gzip`` or ``lzf``.
    dims : str
        Names of the axes; the last is ``component`` if the numbers are coefficients on a basis.
    basis : str
        Name of the dataset of that basis, (61, k), which the attribute ``decoding`` states.
    """
    coefficients = np.asarray(coefficients)
    scale = scale_of(coefficients) if storage == "half" else None
    dataset = reserve_coefficients(
        out,
        name,
        coefficients.shape,
        quantity=quantity,
        storage=storage,
        codec=codec,
        scale=scale,
        dims=dims,
        basis=basis,
    )
    rows = max(1, _TILE_VALUES // max(int(np.prod(coefficients.shape[1:])), 1))
    for first in range(0, len(coefficients), rows):
        tile = coefficients[first : first + rows]
        dataset[first : first + rows] = tile if scale is None else to_half(tile, scale)


def reserve_coefficients(
    out: store.Writer,
    name: str,
    shape: tuple,
    *,
    quantity: str,
    storage: str,
    codec: str,
    scale: np.ndarray | None,
    dims: str = AXES,
    basis: str = "basis",
) -> h5py.Dataset:
    """Create and return an empty dataset for coefficients, to be filled a block of rows at a time.

    In half precision the caller writes coefficients that `to_half` made, already divided by their scale.

    Parameters
    ----------
    shape : (height, width, k)
    scale : (k,) float32
        For half precision; see `half_scale`.
    """
    require_storage(storage, codec)
    half = storage == "half"
    if half:
        what, last = "what the stored numbers are multiplied with", dims.rpartition(",")[2]
        out.write(name + _SUFFIX, np.asarray(scale, dtype=np.float32), units="1", dims=last, quantity=what)
    dataset = out.reserve(
        name,
        shape,
        np.float16 if half else np.float32,
        units="1",
        dims=dims,
        quantity=quantity,
        compression=CODECS[codec],
    )
    dataset.attrs["decoding"] = _decoding(name, dims, basis, half)
    return dataset


def _decoding(name: str, dims: str, basis: str, half: bool) -> str:
    """Return the formula from stored numbers to spectra, for readers that use the file without this module."""
    picture, _, last = dims.rpartition(",")
    stored = f"/{name}[{dims}]" + (f" * /{name}{_SUFFIX}[{last}]" if half else "")
    if last != _COMPONENT:
        return f"value[{dims}] = {stored}"
    return f"spectrum[{picture},wavelength] = sum over {last} of {stored} * /{basis}[wavelength,{last}]"


def read_coefficients(file: store.Reader, name: str, rows: slice = slice(None)) -> np.ndarray:
    """Return coefficients in single precision, from a dataset of half or single precision.

    Parameters
    ----------
    file : store.Reader
    name : str
    rows : slice
        Rows of the picture to read, in steps of one.

    Returns
    -------
    (height, width, k) float32, or with the axes of the dataset if it has others; rows are along the first

    Raises
    ------
    InputError
        If the dataset is absent, damaged, of another element type, or half precision without its scale.
    """
    dataset = file.dataset(name)
    if dataset.dtype not in (np.float16, np.float32):
        raise InputError(file.path, name, f"values of type {dataset.dtype}", "half or single precision")
    scale = None
    if dataset.dtype == np.float16:
        scale = file.read(name + _SUFFIX)
        if scale.shape != dataset.shape[-1:]:
            found, accepted = f"shape {scale.shape}", f"one number for each of {dataset.shape[-1]} bases"
            raise InputError(file.path, name + _SUFFIX, found, accepted)
    first, last, _ = rows.indices(dataset.shape[0])
    out = np.empty((max(last - first, 0), *dataset.shape[1:]), dtype=np.float32)
    try:
        if scale is None:
            for part, tile in _row_tiles(dataset, first, last):
                dataset.read_direct(out[tile], np.s_[part])
        else:
            _read_halves(dataset, scale, first, last, out)
    except OSError as error:
        raise InputError(file.path, name, f"unreadable data ({error})", "a complete file") from None
    return out


def _read_halves(dataset: h5py.Dataset, scale: np.ndarray, first: int, last: int, out: np.ndarray) -> None:
    """Fill ``out`` from rows ``first`` to ``last`` in half precision; decode a tile while the next is read."""
    with ThreadPoolExecutor(1, "decode") as pool:
        waiting = None
        for part, tile in _row_tiles(dataset, first, last):
            stored, target = dataset[part].reshape(-1, scale.size), out[tile].reshape(-1, scale.size)
            if waiting is not None:
                waiting.result()
            waiting = pool.submit(_decode, stored, scale, target)
        if waiting is not None:
            waiting.result()


def _row_tiles(dataset: h5py.Dataset, first: int, last: int) -> Iterator[tuple[slice, slice]]:
    """Yield slices of tiles of rows, aligned to the dataset's chunks: in the dataset, and relative to ``first``."""
    rows = max(1, _TILE_VALUES // max(int(np.prod(dataset.shape[1:])), 1))
    chunk = (dataset.chunks or (1,))[0]
    rows = -(-rows // chunk) * chunk
    start = first
    while start < last:
        stop = min((start // rows + 1) * rows, last)
        yield slice(start, stop), slice(start - first, stop - first)
        start = stop
