"""Definition from which a material or a light was made, stored in its file, so that no other is combined with it."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from irodori.core import store
from irodori.core.custody import content_sha256
from irodori.core.errors import InputError
from irodori.core.provenance import config_hash


def made_of(definition: Mapping[str, Any], files: Iterable[str]) -> dict[str, Any]:
    """Return parts of a definition together with the hashes of the files that they name, {path: SHA-256}.

    Raises
    ------
    OSError
        If a file cannot be read.
    """
    return {**definition, "files": {str(path): content_sha256(path) for path in files}}


def refuse_changed_definition(path: Path, now: Mapping[str, Any], definition_file: Path, command: str) -> None:
    """Refuse a material or a light if the definition of its object or its environment has changed since.

    A file that states no definition, because an earlier version or no rule wrote it, is accepted.

    Parameters
    ----------
    path : path
    now : mapping
        What `made_of` returns today.
    definition_file : path
        File of the definition, for the error message.
    command : str
        Command that makes the result anew, for the error message.

    Raises
    ------
    InputError
        The message names the keys that have changed.
    """
    with store.open_unread(path) as file:
        if not file.has_attribute(store.MADE_OF):
            return
        then = file.attribute(store.MADE_OF, dict)
    changed = [key for key in now if config_hash({key: now[key]}) != config_hash({key: then.get(key)})]
    if changed:
        found = f"a result made before {', '.join(changed)} of {definition_file} changed"
        raise InputError(path, store.MADE_OF, found, f"what '{command}' makes of the definition of today")
