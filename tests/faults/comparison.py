"""Bit-by-bit comparison of two result folders, and the choice of the files that are results at all.

Compared are all datasets and attributes of HDF5 files, the pixels and channel names of EXR files, the pixels of PNG
files, the values of JSON files, and the bytes of everything else: tables, capture records and RAW photographs. Left out
is what a clock or the course of a run writes, and nothing else: `LEFT_OUT`, `CLOCKED_ATTRIBUTES`,
`CLOCKED_COLUMNS`, `CLOCKED_KEYS`.

Both folders must be of runs that found their numba kernels compiled: a process that compiles a kernel itself rounds
differently in the last bit from one that reads it from the cache (measured: 13 of 128 fitted alphas, by 1 ulp).
"""

import csv
import json
from pathlib import Path

import h5py
import numpy as np
import OpenImageIO as oiio

#: Folders that hold times, and the ledger of the user's files, which remembers theirs.
LEFT_OUT = ("logs/", "benchmarks/", "benchmark/", "inputs.json")
#: Page of each scene that reports times.
_REPORT = "/report.html"
#: Attributes of HDF5 files that a clock writes.
CLOCKED_ATTRIBUTES = {"fit_seconds", "paint_seconds"}
#: Attributes by which HDF5 ties axes to their scales: places in a file, which `dims` names.
PLACES = {"DIMENSION_LIST", "REFERENCE_LIST"}
#: Columns of CSV files that a clock writes.
CLOCKED_COLUMNS = {"evaluation_ns_per_pixel"}
#: Keys of JSON files and attributes that a clock or a session's course writes: ``session`` counts what it took, kept
#: and retried, and ``camera`` is the camera's state after it, empty where a continued session had nothing left to take.
CLOCKED_KEYS = {
    "seconds", "seconds_to_prepare", "rays_per_second", "paths_per_second", "pixels_per_second", "session",
    "camera",
}  # fmt: skip
_RECORD = ".sha256"
_JSON = "json:"  # marks an attribute that holds a dictionary or a list


def results(folder: Path) -> dict[str, Path]:
    """Return the files of a results folder that are compared, by their path in it.

    The records beside them, as those in the heads of HDF5 files, are of files that hold times.
    """
    found = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*")) if path.is_file()}
    left_out = {name for name in found if name.startswith(LEFT_OUT) or name.endswith((_RECORD, _REPORT))}
    return {name: path for name, path in found.items() if name not in left_out}


def differences(found: Path, expected: Path, partial: bool = False) -> list[str]:
    """Return what differs between two results folders, a line each; nothing where they agree.

    Parameters
    ----------
    found, expected : path
    partial : bool
        Whether files of `expected` may be missing and some be `in_progress`: what stands under its own name must be
        right all the same.
    """
    ours, theirs = results(found), results(expected)
    said = [] if partial else [f"{name}: missing" for name in theirs if name not in ours]
    passed_over = in_progress(found) if partial else set()
    for name, path in ours.items():
        if name in passed_over:
            continue
        if name not in theirs:
            said.append(f"{name}: should not be there")
        elif difference := _difference(path, theirs[name]):
            said.append(f"{name}: {difference}")
    return said


def in_progress(folder: Path) -> set[str]:
    """Return the files of a broken-off run that pass for no result.

    These are temporary names, the renderer's scratch, what was set aside as damaged, and the journal of a session that
    has no record yet: it grows with every photograph.
    """
    names = results(folder)
    found = {name for name in names if ".part" in Path(name).name or name.endswith((".tiles", ".damaged"))}
    journals = {name for name in names if name.endswith("/captures/captures.csv")}
    return found | {name for name in journals if name.replace("captures.csv", "session.json") not in names}


def _difference(found: Path, expected: Path) -> str:
    """Return how two files of one name differ, empty where they do not; a file that cannot be read differs."""
    readers = {".h5": _hdf5, ".exr": _picture, ".png": _picture, ".json": _json, ".csv": _csv}
    read = readers.get(found.suffix)
    if read is None:
        return "" if found.read_bytes() == expected.read_bytes() else "other bytes"
    try:
        ours = read(found)
    except (OSError, ValueError, RuntimeError) as error:
        return f"unreadable ({error})"
    theirs = read(expected)
    keys = [key for key in ours.keys() | theirs.keys() if key not in ours or key not in theirs]
    keys += [key for key in ours.keys() & theirs.keys() if ours[key] != theirs[key]]
    return ", ".join(sorted(map(str, keys)))


def _bits(values) -> tuple:
    """Return what makes two arrays the same bit by bit: NaN equals NaN, 0.0 is not -0.0."""
    values = np.asarray(values)
    if values.dtype == object:
        return values.shape, "object", repr(values.tolist())
    return values.shape, str(values.dtype), values.tobytes()


def _hdf5(path: Path) -> dict:
    """Return every dataset and attribute of a file by its path in it."""
    content = {}

    def note(name: str, item) -> None:
        if isinstance(item, h5py.Dataset):
            content[name] = _bits(item[()])
        for key, value in item.attrs.items():
            if key not in CLOCKED_ATTRIBUTES | PLACES:
                value = value.decode() if isinstance(value, bytes) else value
                is_json = isinstance(value, str) and value.startswith(_JSON)
                content[f"{name}@{key}"] = _kept(json.loads(value.removeprefix(_JSON))) if is_json else _bits(value)

    with h5py.File(path, "r") as file:
        note("", file)
        file.visititems(note)
    return content


def _picture(path: Path) -> dict:
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise OSError(oiio.geterror())
    try:
        spec, pixels = source.spec(), source.read_image(format="unknown")
        if pixels is None:
            raise OSError(source.geterror())
        return {"channels": tuple(spec.channelnames), "pixels": _bits(pixels)}
    finally:
        source.close()


def _json(path: Path) -> dict:
    return _kept(json.loads(path.read_text(encoding="utf-8")))


def _kept(value):
    """Return a value of a JSON document without what a clock wrote."""
    if isinstance(value, dict):
        clocked = CLOCKED_KEYS | CLOCKED_ATTRIBUTES
        return {key: _kept(item) for key, item in value.items() if key not in clocked}
    return value


def _csv(path: Path) -> dict:
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.reader(stream))
    kept = [number for number, name in enumerate(rows[0] if rows else []) if name not in CLOCKED_COLUMNS]
    rows = [[row[number] for number in kept if number < len(row)] + row[len(rows[0]) :] for row in rows]
    return {f"line {number}": tuple(row) for number, row in enumerate(rows, 1)}
