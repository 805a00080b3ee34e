"""Paths of the files that make up a mesh, found with the standard library only."""

import json
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

from irodori.core.confined_paths import confined
from irodori.core.errors import InputError, is_file

if TYPE_CHECKING:
    from irodori.config.models import ObjectShape

MESH_SUFFIXES = (".obj", ".ply", ".glb", ".gltf")


def mesh_files(path) -> list[str]:
    """Return the paths of a mesh file and of the buffers to which it refers.

    Parameters
    ----------
    path : path
        OBJ, PLY, GLB or glTF. Only a glTF refers to other files with geometry; pictures and material libraries are not
        read.

    Raises
    ------
    InputError
        If the file does not exist or has an unknown suffix, a glTF or one of its buffers cannot be read, or a buffer
        lies outside the folder of the glTF.
    """
    path = Path(path)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(path, "", f"a file of the kind {path.suffix!r}", f"one of {', '.join(MESH_SUFFIXES)}")
    if not is_file(path):
        raise InputError(path, "", "no such file", "a triangle mesh with UV coordinates")
    if path.suffix.lower() != ".gltf":
        return [str(path)]
    try:
        buffers = json.loads(path.read_text(encoding="utf-8")).get("buffers", [])
        names = [str(buffer["uri"]) for buffer in buffers if "uri" in buffer]
    except (ValueError, AttributeError, TypeError, KeyError, RecursionError) as error:
        raise InputError(path, "buffers", f"{type(error).__name__}: {error}", "glTF 2.0") from None
    found = [str(path)]
    for name in names:
        if name.startswith("data:"):
            continue
        buffer = confined(path.parent, unquote(name), path, "buffers")
        if not is_file(buffer):
            raise InputError(path, "buffers", f"the buffer {name}, which does not exist", "a file beside the glTF")
        found.append(str(buffer))
    return found


def shape_files(shape: "ObjectShape", root: str | Path = "") -> list[str]:
    """Return the paths of the files that define a shape; empty unless its configuration names a file.

    Parameters
    ----------
    shape : ObjectShape
    root : path
        Folder to which relative paths refer.

    Raises
    ------
    InputError
        See `mesh_files`.
    """
    file = getattr(shape, "file", None)
    return [] if file is None else mesh_files(Path(root, file))
