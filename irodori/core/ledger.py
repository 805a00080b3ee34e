"""Ledger of the user's files: their hashes, so that what has changed is made again whatever its time stamp.

Snakemake compares times and parameters. The user's files are inputs whose time counts for nothing (``ancient``), and
the hash of their content is a parameter: a photograph put back from an older copy is seen, and one that was only
touched makes nothing again. Light enough for the Snakefile.
"""

import hashlib
import json
import os
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from irodori.core.atomic_files import file_sha256, written_whole

_LINE = ("size", "mtime_ns", "ctime_ns", "sha256")
#: A file that changed this short a time ago may change again within the grain of its time stamp.
_SETTLED_NS = 2_000_000_000


class Ledger:
    """Hashes of files, remembered with size and times on the disk; a file is read again when one of them differs.

    The time of the last change of the file's entry counts too, which no program sets: a copy that keeps the time of an
    earlier file of the same size is seen.

    Parameters
    ----------
    path : path
        JSON in which the hashes are remembered. It is written where its folder exists, so that a dry run in a new
        project leaves nothing; without it, all files are read again.
    """

    def __init__(self, path) -> None:
        self._path = Path(path)
        self._known: dict[str, list] = self._read()
        self._changed = False

    def _read(self) -> dict[str, list]:
        try:
            known = json.loads(self._path.read_bytes())
        except (OSError, ValueError):
            return {}
        lines = known.items() if isinstance(known, dict) else ()
        return {file: line for file, line in lines if isinstance(line, list) and len(line) == len(_LINE)}

    def content(self, *files_of: Callable[[Any], list[str]]) -> Callable[[Any], str]:
        """Return a function from wildcards to one hash over the contents of the files that functions name for them."""

        def hash_of_files(wildcards) -> str:
            total = hashlib.sha256()
            for file in (file for function in files_of for file in function(wildcards)):
                total.update(f"{file}\0{self._sha256(file)}\n".encode())
            self._save()
            return total.hexdigest()

        return hash_of_files

    def altered(self, noted_of: Callable[[Any], Mapping[str, str]]) -> Callable[[Any], list[str]]:
        """Return a function from wildcards to the files, each with its hash, that differ from the hash noted for them.

        Of photographs that the workflow takes itself: before they are taken there are none, and afterwards none
        differs, so that taking them makes nothing again.
        """

        def altered_files(wildcards) -> list[str]:
            found = {file: (self._sha256(file), noted) for file, noted in noted_of(wildcards).items()}
            self._save()
            return [f"{file} {sha256}" for file, (sha256, noted) in found.items() if sha256 not in (noted, "absent")]

        return altered_files

    def _sha256(self, file: str) -> str:
        """Return a file's hash, ``absent`` where there is none: Snakemake says so itself."""
        try:
            found = os.stat(file)
        except OSError:
            return "absent"
        stamp = [found.st_size, found.st_mtime_ns, found.st_ctime_ns]
        known = self._known.get(file)
        if known is not None and known[:-1] == stamp:
            return known[-1]
        sha256 = file_sha256(file)
        if time.time_ns() - max(stamp[1:]) > _SETTLED_NS:
            self._known[file] = [*stamp, sha256]
            self._changed = True
        return sha256

    def _save(self) -> None:
        """Write what is new; what other processes have written meanwhile stays."""
        if not self._changed or not self._path.parent.is_dir():
            return
        # Nothing is lost where it cannot be stored: the files are read again.
        with suppress(OSError), written_whole(self._path) as temporary:
            temporary.write_text(json.dumps(self._read() | self._known, indent=0), encoding="utf-8")
        self._changed = False
