"""Paths that a user's table, definition or journal names inside a folder, and that must not lead out of it."""

import os
from pathlib import Path

from irodori.core.errors import InputError


def require_inside(name: str, file, field: str) -> None:
    """Refuse a name that is absolute or climbs with ``..``, whatever folder it is meant for.

    Parameters
    ----------
    name : str
        Path as the data writes it.
    file, field : path and str
        Where it stands, for the error message.

    Raises
    ------
    InputError
    """
    path = Path(name)
    if "\0" in name or path.is_absolute() or ".." in path.parts:
        found = f"the path {name!r}, which leaves its folder"
        raise InputError(file, field, found, "a path inside the folder, without .. and without a slash in front")


def confined(folder, name: str, file, field: str) -> Path:
    """Return the path of a name inside a folder, once it is sure that it ends there, links followed.

    Parameters
    ----------
    folder : path
        The folder that the data may speak of; it may itself be reached by a link.
    name : str
        Path inside it, as the data writes it; nothing need stand there.
    file, field : path and str
        Where it stands, for the error message.

    Returns
    -------
    Path
        ``folder / name``, not resolved: messages keep the names that the user knows.

    Raises
    ------
    InputError
        If the name is absolute, climbs with ``..``, or a link leads out of the folder.
    """
    require_inside(name, file, field)
    path = Path(folder) / name
    root, end = os.path.realpath(folder), os.path.realpath(path)
    if end != root and not end.startswith(os.path.join(root, "")):
        found = f"{name!r}, a link that leads out of {folder} to {end}"
        raise InputError(file, field, found, f"a file in {folder} itself, or the folder where the files are")
    return path
