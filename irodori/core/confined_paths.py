"""Checks that paths in a user's table, definition or journal stay inside their folder."""

import os
from pathlib import Path

from irodori.core.errors import InputError


def require_inside(name: str, file, field: str) -> None:
    """Raise an error for a path that is absolute or contains ``..``.

    Parameters
    ----------
    name : str
        Path as written in the data.
    file, field : path and str
        Place of the path in the user's files, for the error message.

    Raises
    ------
    InputError
        If the path is absolute or contains ``..`` or a null character.
    """
    path = Path(name)
    if "\0" in name or path.is_absolute() or ".." in path.parts:
        found = f"the path {name!r}, which leaves its folder"
        raise InputError(file, field, found, "a path inside the folder, without .. and without a slash in front")


def confined(folder, name: str, file, field: str) -> Path:
    """Return ``folder / name`` after a check that it is inside the folder, also when symbolic links are followed.

    Parameters
    ----------
    folder : path
        Folder that must contain the path; it may itself be reached by a link.
    name : str
        Path inside the folder, as written in the data; the file need not exist.
    file, field : path and str
        Place of the path in the user's files, for the error message.

    Returns
    -------
    Path
        ``folder / name``, not resolved: messages keep the names that the user knows.

    Raises
    ------
    InputError
        If the name is absolute, contains ``..``, or a link leads out of the folder.
    """
    require_inside(name, file, field)
    path = Path(folder) / name
    root, end = os.path.realpath(folder), os.path.realpath(path)
    if end != root and not end.startswith(os.path.join(root, "")):
        found = f"{name!r}, a link that leads out of {folder} to {end}"
        raise InputError(file, field, found, f"a file in {folder} itself, or the folder where the files are")
    return path
