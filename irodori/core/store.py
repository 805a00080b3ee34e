"""HDF5 files with atomic writes, units and provenance; the only module that opens HDF5.

A file is written under a temporary name in the same folder and renamed when complete, so that a file that exists is
whole. Its head holds the hash of its content, its name and the hashes of what it was made from, and a file whose
content is another is not opened (`irodori.core.custody`). Root attributes: ``schema_version``, ``rule``,
``config_hash``, ``code_hash``, ``created_by``; every dataset has ``units``, ``dims`` and ``quantity`` [design, §6].
"""

import hashlib
import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import h5py
import hdf5plugin
import numpy as np

from irodori import __version__
from irodori.core import custody
from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError

#: 2: materials and fitted tiles name their lobes (attribute ``lobes``).
SCHEMA_VERSION = 2
_CHUNK_BYTES = 1 << 20
#: Chunks held open while a dataset is written in pieces, so that one that two pieces share is packed once.
_CACHE_BYTES = 16 << 20
#: HDF5 1.10 and later: every structure of a file, and with it what is small, carries a checksum, so that a flipped bit
#: is found on reading. Chunks have their own (Fletcher's), which costs less than packing them.
_FORMAT = "v110"
#: Elements up to which a dataset is stored inside its header.
_COMPACT = 64
#: How a dataset is packed. ``small`` is gzip, which every program reads; ``fast`` is Blosc with LZ4, which packs floats
#: as well at a fifteenth of the time, for what is large and passes from one stage to the next; ``planes`` is Blosc2
#: with LZ4 over bit planes, which finds in half-precision numbers what shuffled bytes hide; ``none`` lies in one piece,
#: for what is streamed at the speed of the disk; it alone
#: has no checksum.
_COMPRESSIONS = {
    "small": {"compression": "gzip", "compression_opts": 1, "shuffle": True},
    "fast": dict(hdf5plugin.Blosc(cname="lz4", clevel=5, shuffle=hdf5plugin.Blosc.SHUFFLE)),
    "planes": dict(hdf5plugin.Blosc2(cname="lz4", clevel=5, filters=hdf5plugin.Blosc2.BITSHUFFLE)),
    "none": {},
}
#: The most that a chunk unfolds to, as a factor: Blosc2 keeps a megabyte of one value in 32 bytes.
_MOST_UNFOLDED = 1 << 16
_JSON = "json:"  # marks an attribute that holds a list or a dictionary


@dataclass(frozen=True)
class Provenance:
    """Origin of a file; each stage fills it from its rule's parameters.

    Parameters
    ----------
    rule : str
    config_hash, code_hash : str
        Hashes of the parameters and of the code that made the file.
    inputs : dict
        Path -> hash of each file read; a script may add what is known only while it runs.
    """

    rule: str
    config_hash: str = ""
    code_hash: str = ""
    inputs: dict[str, str] = field(default_factory=dict)

    @property
    def input_sha256(self) -> str:
        """Return one hash over the contents of the input files, in their order."""
        return hashlib.sha256("".join(self.inputs.values()).encode()).hexdigest()


class Writer:
    """An HDF5 file being written; get one from `create`."""

    def __init__(self, file: h5py.File) -> None:
        self._file = file

    def write(self, name: str, values, *, units: str, dims: str, quantity: str, compression: str = "small") -> None:
        """Write a whole dataset.

        Parameters
        ----------
        name : str
            Path inside the file, snake_case.
        values : array_like
        units : str
            Unit symbol, ``1`` for a pure number.
        dims : str
            Names of the axes, separated by commas; empty for a scalar.
        quantity : str
            What the numbers are.
        compression : str
            ``small`` (gzip), ``fast`` (Blosc with LZ4), ``planes`` (Blosc2 with LZ4 over bit planes) or ``none``.

        Raises
        ------
        ValueError
            For an unknown compression, or names of axes that do not fit the values.
        """
        values = np.asarray(values)
        dataset = self.reserve(
            name, values.shape, values.dtype, units=units, dims=dims, quantity=quantity, compression=compression
        )
        dataset[()] = values

    def reserve(
        self, name: str, shape: tuple, dtype, *, units: str, dims: str, quantity: str, compression: str = "small"
    ) -> h5py.Dataset:
        """Return a new dataset, to be written in pieces of its first axis; as `write` otherwise."""
        if compression not in _COMPRESSIONS:
            raise ValueError(f"unknown compression {compression!r}; accepted: {', '.join(_COMPRESSIONS)}")
        if len([d for d in dims.split(",") if d]) != len(shape):
            raise ValueError(f"{name}: {len(shape)} axes but dims {dims!r}")
        dataset = self._file.create_dataset(name, shape, dtype, **_layout(shape, np.dtype(dtype), compression))
        dataset.attrs.update({"units": units, "dims": dims, "quantity": quantity})
        return dataset

    def attribute(self, name: str, value) -> None:
        """Write a root attribute; dictionaries and lists are stored as JSON."""
        _set_attribute(self._file, name, _JSON + json.dumps(value) if isinstance(value, dict | list) else value)


def _set_attribute(file: h5py.File, name: str, value) -> None:
    """Write an attribute; text in a field of its own length, for HDF5 keeps text of any length without a checksum."""
    if isinstance(value, str) and value and "\0" not in value:
        content = value.encode()
        file.attrs.create(name, content, dtype=h5py.string_dtype("utf-8", len(content)))
    else:
        file.attrs[name] = value


def _layout(shape: tuple[int, ...], dtype: np.dtype, compression: str) -> dict:
    """Return how h5py shall lay a dataset out."""
    size = np.prod(shape, dtype=np.int64)
    if size and size <= _COMPACT and dtype.kind in "fiub":
        properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        properties.set_layout(h5py.h5d.COMPACT)
        return {"dcpl": properties}
    if size <= _COMPACT or compression == "none":
        return {}
    return {"chunks": _chunk_shape(shape, dtype.itemsize), "fletcher32": True, **_COMPRESSIONS[compression]}


def _chunk_shape(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    """Return chunks of whole trailing axes and about 1 MB, so that rows of a picture are read in one piece."""
    chunk = list(shape)
    for axis in range(len(shape)):
        row = int(np.prod(chunk[axis + 1 :], dtype=np.int64)) * itemsize
        chunk[axis] = max(1, min(shape[axis], _CHUNK_BYTES // max(row, 1)))
        if row < _CHUNK_BYTES:
            break
    return tuple(max(1, c) for c in chunk)


@contextmanager
def create(path, provenance: Provenance) -> Iterator[Writer]:
    """Open a new file for writing; it takes its name only if the block ends without an exception.

    Raises
    ------
    OSError
        If the folder cannot be written or the disk is full; nothing is left behind.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    inputs = dict(provenance.inputs)
    layout = {"userblock_size": custody.head_size(str(path), inputs), "rdcc_nbytes": _CACHE_BYTES, "libver": _FORMAT}
    with written_whole(path) as temporary:
        with h5py.File(temporary, "w", **layout) as file:
            file.attrs["schema_version"] = SCHEMA_VERSION
            writer = Writer(file)
            for key in ("rule", "config_hash", "code_hash"):
                writer.attribute(key, getattr(provenance, key))
            libraries = {name: version(name) for name in ("numpy", "h5py")}
            writer.attribute("created_by", {"irodori": __version__, **libraries})
            yield writer
        custody.write_head(temporary, str(path), inputs)


@contextmanager
def _whole(path, name: str = "") -> Iterator[None]:
    """Say of what HDF5 or JSON cannot make sense of that it is damaged; both have errors of many kinds for it."""
    try:
        yield
    except InputError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError) as error:
        reason = " ".join(str(error).split())
        raise InputError(path, name, f"unreadable data ({reason})", "a complete file") from None


class Reader:
    """An HDF5 file being read; get one from `open_file`."""

    def __init__(self, path: Path, file: h5py.File) -> None:
        self.path, self._file = path, file
        self._checked: set[str] = set()

    def __contains__(self, name: str) -> bool:
        with _whole(self.path, name):
            return name in self._file

    def dataset(self, name: str) -> h5py.Dataset:
        """Return a dataset for reading in pieces.

        Raises
        ------
        InputError
            If the file has no such dataset, or its description is damaged.
        """
        with _whole(self.path, name):
            # Not get(), which takes a damaged description for an absence.
            found = None
            if name in self._file:
                found = self._file[name]
            if not isinstance(found, h5py.Dataset):
                raise InputError(self.path, name, "no such dataset", f"one of: {', '.join(sorted(self._names()))}")
            if name not in self._checked:
                self._check_held(name, found)
                self._checked.add(name)
            return found

    def _check_held(self, name: str, dataset: h5py.Dataset) -> None:
        """Refuse a dataset that stands in another file, or declares more than its part of this one can unfold to."""
        if dataset.file.filename != self._file.filename or dataset.external or dataset.is_virtual:
            raise InputError(self.path, name, "a dataset that stands in another file", "one that this file holds")
        stored, unfolded = dataset.id.get_storage_size(), _MOST_UNFOLDED if dataset.chunks else 1
        if dataset.nbytes > stored * unfolded:
            found = f"a dataset of {dataset.shape} that declares {dataset.nbytes} bytes and holds {stored}"
            raise InputError(self.path, name, found, "a complete file")

    def read_within(self, name: str, low: float = -math.inf, high: float = math.inf) -> np.ndarray:
        """Return a dataset of numbers, refusing those that are not finite or outside a range.

        Raises
        ------
        InputError
            As `read`, and for the first number that is not finite, below `low` or above `high`.
        """
        values = self.read(name)
        wrong = ~(np.isfinite(values) & (values >= low) & (values <= high))
        if wrong.any():
            accepted = "finite numbers" if low == -math.inf else f"numbers from {low:g} to {high:g}"
            raise InputError(self.path, name, f"the value {values[wrong].flat[0]:g}", accepted)
        return values

    def require_axes(self, axes: dict[str, str], **lengths: int) -> None:
        """Refuse datasets that do not fit together: numbers, with axes that have one length wherever they occur.

        Parameters
        ----------
        axes : dict
            Dataset -> names of its axes, separated by commas.
        **lengths : int
            Of axes whose length is known.

        Raises
        ------
        InputError
            For the first dataset that is missing, holds no numbers, or has other axes.
        """
        for name, dims in axes.items():
            dataset = self.dataset(name)
            if dataset.dtype.kind not in "fiub" or dataset.shape is None:
                raise InputError(self.path, name, f"values of type {dataset.dtype}", "numbers")
            expected = [axis for axis in dims.split(",") if axis]
            if dataset.ndim != len(expected):
                raise InputError(self.path, name, f"{dataset.ndim} axes", f"{len(expected)}: {', '.join(expected)}")
            for axis, length in zip(expected, dataset.shape, strict=True):
                if lengths.setdefault(axis, length) != length:
                    found, accepted = f"{length} along the axis {axis}", f"{lengths[axis]}, as elsewhere in the file"
                    raise InputError(self.path, name, found, accepted)

    def read(self, name: str, part=()) -> np.ndarray:
        """Return a dataset, or a part of it: a slice of its first axis, or several.

        Raises
        ------
        InputError
            If the file has no such dataset, or the data is damaged.
        """
        dataset = self.dataset(name)
        with _whole(self.path, name):
            return dataset[part]

    def has_attribute(self, name: str) -> bool:
        """Whether the file has a root attribute."""
        with _whole(self.path, name):
            return name in self._file.attrs

    def attribute(self, name: str, kind: type | tuple[type, ...] = object):
        """Return a root attribute; JSON objects and lists are decoded.

        Raises
        ------
        InputError
            If the file has no such attribute, it is damaged, or it is not of the `kind` that is asked for.
        """
        with _whole(self.path, name):
            if name not in self._file.attrs:
                raise InputError(self.path, name, "no such attribute", f"one of: {', '.join(self._file.attrs)}")
            if (size := self._file.attrs.get_id(name).get_storage_size()) > self.path.stat().st_size:
                raise InputError(self.path, name, f"an attribute that declares {size} bytes", "a complete file")
            value = self._file.attrs[name]
            value = value.decode() if isinstance(value, bytes) else value
            if isinstance(value, str) and value.startswith(_JSON):
                value = json.loads(value.removeprefix(_JSON))
            elif isinstance(value, np.generic):
                value = value.item()
        if not isinstance(value, kind):
            accepted = " or ".join(one.__name__ for one in (kind if isinstance(kind, tuple) else (kind,)))
            raise InputError(self.path, name, f"a {type(value).__name__}", accepted)
        return value

    def _names(self) -> list[str]:
        names = []
        self._file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        return names


@contextmanager
def open_file(path) -> Iterator[Reader]:
    """Open a file of this project for reading.

    Raises
    ------
    InputError
        If the file is missing, truncated, not HDF5, not ours, of a newer schema version, or has no hash of its content
        or another content than its hash stands for.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "", "no such file", "an HDF5 file written by an earlier stage")
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise InputError(path, "", f"a file HDF5 cannot open ({error})", "a complete HDF5 file") from None
    with file:
        with _whole(path):
            found, ours = file.attrs.get("schema_version"), "rule" in file.attrs
        if found is None or not ours:
            raise InputError(path, "schema_version", "an HDF5 file of another program", "a file of this project")
        if not isinstance(found, np.integer):
            raise InputError(path, "schema_version", repr(found), f"a number up to {SCHEMA_VERSION}")
        if found > SCHEMA_VERSION:
            raise InputError(path, "schema_version", str(found), f"version {SCHEMA_VERSION} or older")
        custody.verified(path)
        yield Reader(path, file)


def write_maps(writer: Writer, maps: dict, dims: str) -> None:
    """Write several datasets of one shape family.

    Parameters
    ----------
    maps : dict
        name -> (values, units, quantity).
    dims : str
        Axes shared by all.
    """
    for name, (values, units, quantity) in maps.items():
        write_dims = ",".join(dims.split(",")[: np.ndim(values)])
        writer.write(name, values, units=units, dims=write_dims, quantity=quantity)
