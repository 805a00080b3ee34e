"""HDF5 files with atomic writes, units and provenance; the only module that opens HDF5.

A file is written under a temporary name in the same folder and renamed when complete, so that every existing file is
complete. Its head holds the hash of its content, its path and the hashes of its inputs; a file that does not match its
hash is not opened (`irodori.core.custody`). Root attributes: ``schema_version``, ``rule``, ``config_hash``,
``code_hash``, ``created_by``; every dataset has ``units``, ``dims`` and ``quantity`` (see docs/files.md).

Axes are named: an axis has one length in a file, and every axis has an HDF5 dimension scale in the file's root, so that
h5py, netCDF readers and xarray recognise it. A scale with values is a coordinate (`Writer.coordinate`); one without is
what netCDF calls a dimension without a variable, and holds only the axis's length.
"""

import hashlib
import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import IntEnum
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from irodori import __version__
from irodori.core import custody
from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError
from irodori.core.units import VOCABULARY, require_unit

#: 2: materials and fitted tiles name their lobes (attribute ``lobes``). 3: axes have dimension scales, codes are
#: enumerations, units are UCUM's, blurred light is of half precision, nothing needs a plugin of HDF5.
SCHEMA_VERSION = 3
_CHUNK_BYTES = 1 << 20
#: Cache while a dataset is written in pieces, bytes: a chunk that two pieces share is then packed only once.
_CACHE_BYTES = 16 << 20
#: HDF5 1.10 and later: all structures of a file, and the small datasets inside them, have a checksum, so that a flipped
#: bit is found on reading. Chunks have their own (Fletcher's), which costs less than packing them.
_FORMAT = "v110"
#: Elements up to which a dataset is stored inside its header.
_COMPACT = 64
#: How a dataset is packed, each after its bytes were sorted by significance. ``small`` is gzip, which every program
#: reads; ``fast`` is LZF, which packs floats nearly as well at half of the time, for what is large and passes from one
#: stage to the next; ``none`` lies in one piece, for what is streamed at the speed of the disk; it alone has no
#: checksum.
_COMPRESSIONS: dict[str, dict] = {
    "small": {"compression": "gzip", "compression_opts": 1, "shuffle": True},
    "fast": {"compression": "lzf", "shuffle": True},
    "none": {},
}
#: Attribute of a file with LZF data, for users of programs that cannot read them.
_LZF_NOTE = (
    "Datasets with the filter 32000 are packed by LZF, which every h5py reads; another program needs LZF from the HDF "
    "Group's package hdf5_plugins, or a copy of the file made with h5repack from there."
)
#: Plugins by which files of schema versions 1 and 2 were packed.
_PLUGINS = {32001: "Blosc", 32026: "Blosc2"}
#: Largest ratio of unpacked to packed size of a chunk with these plugins: Blosc2 packs a megabyte of one value in 32 B.
_MOST_UNFOLDED = 1 << 16
#: The name that netCDF gives to a dimension scale that is no variable; the length follows.
_NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable."
_SPECTRAL = "wavelength"
#: Descriptive attributes of a dataset, which are not HDF5's own.
_FOR_PEOPLE = ("units", "quantity", "flag_values", "flag_meanings", "decoding")
_JSON = "json:"  # marks an attribute that holds a list or a dictionary


#: A unit code, or the enumeration of a dataset of status codes.
Units = str | type[IntEnum]


class Mask(IntEnum):
    """Values of a yes-or-no mask; the dataset's attribute ``quantity`` states the question."""

    NO = 0
    YES = 1


#: Attribute with the definition that a file was made of.
MADE_OF = "made_of"


@dataclass(frozen=True)
class Provenance:
    """Origin of a file; each stage fills it from its rule's parameters.

    Parameters
    ----------
    rule : str
    config_hash, code_hash : str
        Hashes of the parameters and of the code that made the file.
    inputs : dict
        {path: hash} of the files read; a script may add files that it finds only while it runs.
    made_of : dict, optional
        Definition that HDF5 files state, see `irodori.core.made_of`.
    """

    rule: str
    config_hash: str = ""
    code_hash: str = ""
    inputs: dict[str, str] = field(default_factory=dict)
    made_of: dict | None = None

    @property
    def input_sha256(self) -> str:
        """Return one hash over the contents of the input files, in their order."""
        return hashlib.sha256("".join(self.inputs.values()).encode()).hexdigest()


class Writer:
    """An HDF5 file being written; get one from `create`."""

    def __init__(self, file: h5py.File) -> None:
        self._file = file
        self._lengths: dict[str, int] = {}
        self._coordinates: set[str] = set()
        self._reserved: list[tuple[h5py.Dataset, list[str]]] = []

    def write(self, name: str, values, *, units: Units, dims: str, quantity: str, compression: str = "small") -> None:
        """Write a whole dataset.

        Parameters
        ----------
        name : str
            Path inside the file, snake_case.
        values : array_like
        units : str or IntEnum
            Unit code of UCUM, ``1`` for a pure number; for a dataset of status codes, their enumeration.
        dims : str
            Names of the axes, separated by commas; empty for a scalar.
        quantity : str
            Description of the stored quantity.
        compression : str
            ``small`` (gzip), ``fast`` (LZF) or ``none``.

        Raises
        ------
        ValueError
            For an unknown compression or unit; for axes that do not fit the values, have another length elsewhere in
            the file, or occur twice.
        """
        values = np.asarray(values)
        dataset = self.reserve(
            name, values.shape, values.dtype, units=units, dims=dims, quantity=quantity, compression=compression
        )
        dataset[()] = values

    def reserve(
        self,
        name: str,
        shape: tuple,
        dtype,
        *,
        units: Units,
        dims: str,
        quantity: str,
        compression: str = "small",
    ) -> h5py.Dataset:
        """Create a dataset and return it, to be filled in pieces along its first axis; parameters as in `write`."""
        if compression not in _COMPRESSIONS:
            raise ValueError(f"unknown compression {compression!r}; accepted: {', '.join(_COMPRESSIONS)}")
        self._note_axes(name, axes := [axis for axis in dims.split(",") if axis], shape)
        dtype, codes = np.dtype(dtype), {}
        if isinstance(units, str):
            require_unit(units)
        else:
            dtype = h5py.enum_dtype({code.name: code.value for code in units}, basetype=dtype)
            meanings = " ".join(code.name.lower() for code in units)
            codes = {"flag_values": np.array([*units], dtype.str), "flag_meanings": meanings}
            units = "1"
        dataset = self._file.create_dataset(name, shape, dtype, **_layout(shape, dtype, compression))
        dataset.attrs.update({"units": units, "dims": dims, "quantity": quantity})
        dataset.attrs.update(codes)
        if compression == "fast":
            self.attribute("packing", _LZF_NOTE)
        self._reserved.append((dataset, axes))
        return dataset

    def coordinate(self, axis: str, values, *, units: str, quantity: str) -> None:
        """Write the coordinate values of an axis, numbers or ASCII text; a second call for an axis does nothing."""
        if axis in self._coordinates:
            return
        values = np.asarray(values)
        values = values.astype("S") if values.dtype.kind == "U" else values
        self._coordinates.add(axis)
        self.write(axis, values, units=units, dims=axis, quantity=quantity)

    def _note_axes(self, name: str, axes: list[str], shape: tuple) -> None:
        """Refuse axes that have no name, occur twice in a dataset, or have two lengths in the file."""
        if len(axes) != len(shape) or len(set(axes)) != len(axes):
            raise ValueError(f"{name}: {len(shape)} axes but dims {','.join(axes)!r}; accepted: one name for each")
        for axis, length in zip(axes, shape, strict=True):
            if self._lengths.setdefault(axis, int(length)) != length:
                raise ValueError(f"{name}: {length} along {axis}; accepted: {self._lengths[axis]}, as elsewhere")

    def attach_scales(self) -> None:
        """Attach a dimension scale to every axis; to be called once, after all datasets are written.

        Raises
        ------
        ValueError
            If an axis has the name of a dataset that is not its coordinate, or the axis ``wavelength`` no coordinate.
        """
        if _SPECTRAL in self._lengths and _SPECTRAL not in self._coordinates:
            raise ValueError(f"an axis {_SPECTRAL} without its values; accepted: one with a coordinate")
        for axis, length in self._lengths.items():
            if axis in self._coordinates:
                self._file[axis].make_scale(axis)
                continue
            if axis in self._file:
                raise ValueError(f"the axis {axis} has the name of a dataset; accepted: another name, or a coordinate")
            scale = self._file.create_dataset(axis, (length,), ">f4")
            scale.attrs.update({"units": "1", "dims": axis, "quantity": f"length of the axis {axis}, without values"})
            scale.make_scale(f"{_NO_VARIABLE}{length:10d}")
        for dataset, axes in self._reserved:
            for number, axis in enumerate(axes):
                if dataset.name != f"/{axis}":
                    dataset.dims[number].attach_scale(self._file[axis])

    def attribute(self, name: str, value) -> None:
        """Write a root attribute; dictionaries and lists are stored as JSON."""
        _set_attribute(self._file, name, _JSON + json.dumps(value) if isinstance(value, dict | list) else value)


def _set_attribute(file: h5py.File, name: str, value) -> None:
    """Write an attribute; text has a fixed length, because HDF5 stores variable-length text without a checksum."""
    if isinstance(value, str) and value and "\0" not in value:
        content = value.encode()
        file.attrs.create(name, content, dtype=h5py.string_dtype("utf-8", len(content)))
    else:
        file.attrs[name] = value


def _layout(shape: tuple[int, ...], dtype: np.dtype, compression: str) -> dict:
    """Return h5py's keyword arguments for the storage layout of a dataset."""
    size = np.prod(shape, dtype=np.int64)
    if size and size <= _COMPACT and dtype.kind in "fiub":
        properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        properties.set_layout(h5py.h5d.COMPACT)
        return {"dcpl": properties}
    if size <= _COMPACT or compression == "none":
        return {}
    return {"chunks": _chunk_shape(shape, dtype.itemsize), "fletcher32": True, **_COMPRESSIONS[compression]}


def _chunk_shape(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    """Return the shape of chunks of about 1 MB with whole trailing axes, so that rows of a picture are read at once."""
    chunk = list(shape)
    for axis in range(len(shape)):
        row = int(np.prod(chunk[axis + 1 :], dtype=np.int64)) * itemsize
        chunk[axis] = max(1, min(shape[axis], _CHUNK_BYTES // max(row, 1)))
        if row < _CHUNK_BYTES:
            break
    return tuple(max(1, c) for c in chunk)


@contextmanager
def create(path, provenance: Provenance) -> Iterator[Writer]:
    """Open a new HDF5 file for writing; it gets its final name only if the block ends without an exception.

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
            writer.attribute("units_vocabulary", VOCABULARY)
            if provenance.made_of is not None:
                writer.attribute(MADE_OF, provenance.made_of)
            yield writer
            writer.attach_scales()
        custody.write_head(temporary, str(path), inputs)


@contextmanager
def _whole(path, name: str = "") -> Iterator[None]:
    """Turn the many kinds of errors that HDF5 and JSON raise for damaged data into an `InputError`."""
    try:
        yield
    except InputError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError) as error:
        reason = " ".join(str(error).split())
        raise InputError(path, name, f"unreadable data ({reason})", "a complete file") from None


class Layout(NamedTuple):
    """Shape, type and descriptive attributes of a dataset."""

    shape: tuple[int, ...]
    dtype: np.dtype
    attributes: dict[str, Any]


class Reader:
    """An HDF5 file being read; get one from `open_file`, or from `open_unread`."""

    def __init__(self, path: Path, file: h5py.File, *, is_verified: bool = True) -> None:
        self.path, self._file = path, file
        self._is_verified = is_verified
        self._checked: set[str] = set()

    def __contains__(self, name: str) -> bool:
        with _whole(self.path, name):
            return name in self._file

    def dataset(self, name: str) -> h5py.Dataset:
        """Return a dataset for reading in pieces.

        Raises
        ------
        InputError
            If the file has no such dataset, its header is damaged, or the file was opened by `open_unread` and its
            content does not match its hash.
        """
        if not self._is_verified:
            custody.verified(self.path)
            self._is_verified = True
        return self._described(name)

    def _described(self, name: str) -> h5py.Dataset:
        with _whole(self.path, name):
            # Not get(), which treats a damaged header as a missing dataset.
            found = None
            if name in self._file:
                found = self._file[name]
            if not isinstance(found, h5py.Dataset):
                raise InputError(self.path, name, "no such dataset", f"one of: {', '.join(sorted(self._names()))}")
            if name not in self._checked:
                self._check_held(name, found)
                self._checked.add(name)
            return found

    def layout(self, name: str) -> Layout:
        """Return the shape, the type and the attributes of a dataset.

        Raises
        ------
        InputError
            If the file has no such dataset, or its header is damaged.
        """
        found = self._described(name)
        with _whole(self.path, name):
            kept = (key for key in _FOR_PEOPLE if key in found.attrs)
            return Layout(found.shape, np.dtype(found.dtype.str), {key: found.attrs[key] for key in kept})

    def maps(self) -> list[str]:
        """Return the names of the datasets in the file's root that hold numbers, in order."""
        with _whole(self.path):
            found = [name for name in self._file if _is_variable(self._file[name])]
            return [name for name in found if self._file[name].dtype.kind in "fiub"]

    def attributes(self) -> list[str]:
        """Return the names of the root attributes, in order."""
        with _whole(self.path):
            return sorted(self._file.attrs)

    def _check_held(self, name: str, dataset: h5py.Dataset) -> None:
        """Refuse a dataset that is stored in another file, needs a missing filter, or declares too many bytes."""
        if dataset.file.filename != self._file.filename or dataset.external or dataset.is_virtual:
            raise InputError(self.path, name, "a dataset that stands in another file", "one that this file holds")
        filters = dataset.id.get_create_plist()
        for number in range(filters.get_nfilters()):
            code = filters.get_filter(number)[0]
            if not h5py.h5z.filter_avail(code):
                packed = f"data packed by {_PLUGINS.get(code, f'the filter {code} of HDF5')}"
                accepted = "a file of this version: run snakemake again, or import the package hdf5plugin beforehand"
                raise InputError(self.path, name, packed, accepted)
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
        """Raise an error unless datasets hold numbers and have the given axes, each with one length in all of them.

        Parameters
        ----------
        axes : dict
            {dataset: names of its axes, separated by commas}.
        **lengths : int
            Required lengths of axes, by name.

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
            values = dataset[part]
        # Plain integers, also if the file declares an enumeration for them.
        return values.view(values.dtype.str) if values.dtype.metadata else values

    def has_attribute(self, name: str) -> bool:
        """Whether the file has a root attribute."""
        with _whole(self.path, name):
            return name in self._file.attrs

    def attribute(self, name: str, kind: type | tuple[type, ...] = object):
        """Return a root attribute; JSON objects and lists are decoded.

        Raises
        ------
        InputError
            If the file has no such attribute, it is damaged, or it is not of the type `kind`.
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
        self._file.visititems(lambda name, item: names.append(name) if _is_variable(item) else None)
        return names


def _is_variable(item) -> bool:
    """Whether an HDF5 object is a dataset with values, rather than a group or a scale without values."""
    if not isinstance(item, h5py.Dataset):
        return False
    named = item.attrs.get("NAME", b"")
    return not (isinstance(named, bytes) and named.startswith(_NO_VARIABLE.encode()))


@contextmanager
def open_unread(path) -> Iterator[Reader]:
    """Open a file of this project; its content is compared with its hash when a dataset is first read.

    Raises
    ------
    InputError
        As for `open_file`, except for content that does not match its hash.
    """
    with _opened(path) as file:
        yield Reader(Path(path), file, is_verified=False)


@contextmanager
def open_file(path) -> Iterator[Reader]:
    """Open a file of this project for reading.

    Raises
    ------
    InputError
        If the file is missing, truncated, not HDF5, of another program or of a newer schema version, has no hash of its
        content, or does not match it.
    """
    with _opened(path) as file:
        custody.verified(path)
        yield Reader(Path(path), file)


@contextmanager
def _opened(path) -> Iterator[h5py.File]:
    """Open an HDF5 file after a check that it is of this project and of the present or an older schema version."""
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
        yield file


def write_maps(writer: Writer, maps: dict, dims: str, compression: str = "small") -> None:
    """Write several datasets with common axes.

    Parameters
    ----------
    maps : dict
        {name: (values, units, quantity)}.
    dims : str
        Names of the axes, separated by commas; a dataset with fewer dimensions has the first of them.
    compression : str
        As in `Writer.write`.
    """
    for name, (values, units, quantity) in maps.items():
        axes = ",".join(dims.split(",")[: np.ndim(values)])
        writer.write(name, values, units=units, dims=axes, quantity=quantity, compression=compression)
