"""Check of the amount of data that a mesh file declares, before it is read."""

import json
import struct
from pathlib import Path

from irodori.core.errors import InputError

_PLY_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1), **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64", "int64", "uint64"), 8),
}  # fmt: skip
_LONGEST_HEADER = 1 << 16
_GLTF_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_GLTF_NUMBERS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
#: Largest plausible factor by which accessors of a glTF share the same bytes.
_SHARED = 4
_JSON_CHUNK = b"JSON"


def check_declared(path, held: int) -> None:
    """Check that a PLY, GLB or glTF does not declare more data than it contains.

    Parameters
    ----------
    path : path
    held : int
        Size in bytes of the file and the buffers to which it refers.

    Raises
    ------
    InputError
        If it declares more, or its header cannot be read.
    """
    suffix = Path(path).suffix.lower()
    try:
        if suffix == ".ply":
            declared = _ply_bytes(path)
        elif suffix in (".glb", ".gltf"):
            declared = _gltf_bytes(path, suffix == ".glb") / _SHARED
        else:
            return
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, struct.error, RecursionError) as error:
        found = f"a damaged header ({type(error).__name__})"
        raise InputError(path, "", found, f"a valid {suffix[1:].upper()} file of triangles") from None
    if not 0 <= declared <= held:
        found = f"a header that declares {declared:g} bytes of geometry in a file of {held}"
        raise InputError(path, "", found, "a whole file, as long as its header says")


def _ply_bytes(path) -> float:
    """Return the smallest number of bytes that the elements declared in the header of a PLY can take."""
    with open(path, "rb") as file:
        header = file.read(_LONGEST_HEADER).split(b"end_header", 1)[0].decode("ascii", "replace")
    least, count, is_text, total = 0, 0, True, 0.0
    for words in map(str.split, header.splitlines()):
        if words[:1] == ["format"]:
            is_text = words[1] == "ascii"
        elif words[:1] == ["element"]:
            total += count * least
            least, count = 0, int(words[2])
            if count < 0:
                raise ValueError(header)
        elif words[:1] == ["property"]:
            # A list has at least its length; a number in text has at least a digit and a separator.
            least += 2 if is_text else _PLY_BYTES[words[2] if words[1] == "list" else words[1]]
    return total + count * max(least, 1)


def _gltf_bytes(path, binary: bool) -> float:
    """Return the number of bytes that the accessors of a glTF declare."""
    with open(path, "rb") as file:
        if binary:
            magic, _, _, length, kind = struct.unpack("<4sIII4s", file.read(20))
            # Not read(length), which would allocate that much memory even if the file is shorter.
            content = file.read()[:length]
            if magic != b"glTF" or kind != _JSON_CHUNK or len(content) != length:
                raise ValueError(magic)
        else:
            content = file.read()
    total = 0.0
    for accessor in json.loads(content).get("accessors", []):
        count = accessor["count"]
        if not isinstance(count, int) or count < 0:
            raise ValueError(count)
        total += count * _GLTF_BYTES[accessor["componentType"]] * _GLTF_NUMBERS[accessor["type"]]
    return total
