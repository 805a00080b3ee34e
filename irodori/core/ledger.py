"""Hashes of the user's files, so that Snakemake reruns the jobs that depend on changed content, whatever the times.

Snakemake compares modification times and parameters. The user's files are declared as inputs with an ignored time
(``ancient``), and the hash of their content is passed as a parameter. A photograph that was restored from an older copy
therefore causes a rerun, and one that was only touched does not. The module imports little, so that the Snakefile can
use it.
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
#: A file that changed less than this long ago may change again without a new time stamp: its hash is not cached.
_SETTLED_NS = 2_000_000_000


class Ledger:
    """Cache of file hashes; a file is read again if its size or one of its times differs from the cached ones.

    The times are those of the last modification and of the last change of the file's inode (ctime). Programs cannot set
    the latter, so that a copy with the size and the modification time of an earlier file is noticed.

    Parameters
    ----------
    path : path
        JSON file of the cached hashes. It is written only if its folder exists, so that a dry run in a new project
        leaves no file. Without the JSON file, all files are read.
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
        """Return a function that computes, for the wildcards of a job, one hash over the contents of its files.

        Parameters
        ----------
        *files_of : callable
            Functions that return the paths of a job's files, given its wildcards.
        """

        def hash_of_files(wildcards) -> str:
            total = hashlib.sha256()
            for file in (file for function in files_of for file in function(wildcards)):
                total.update(f"{file}\0{self._sha256(file)}\n".encode())
            self._save()
            return total.hexdigest()

        return hash_of_files

    def altered(self, noted_of: Callable[[Any], Mapping[str, str]]) -> Callable[[Any], list[str]]:
        """Return a function that lists, for the wildcards of a job, the files that differ from their noted hashes.

        It serves for photographs that the workflow takes itself: before they are taken none exists, and afterwards none
        differs, so that taking them causes no rerun.

        Parameters
        ----------
        noted_of : callable
            Returns {path: noted hash} of a job's files, given its wildcards. The list has ``path hash`` of each
            existing file with another hash.
        """

        def altered_files(wildcards) -> list[str]:
            found = {file: (self._sha256(file), noted) for file, noted in noted_of(wildcards).items()}
            self._save()
            return [f"{file} {sha256}" for file, (sha256, noted) in found.items() if sha256 not in (noted, "absent")]

        return altered_files

    def _sha256(self, file: str) -> str:
        """Return a file's SHA-256, or ``absent`` if the file is missing, which Snakemake reports itself."""
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
        """Write new hashes to the JSON file, and keep those that other processes have written in the meantime."""
        if not self._changed or not self._path.parent.is_dir():
            return
        # Nothing is lost if the hashes cannot be stored: the files are read again.
        with suppress(OSError), written_whole(self._path) as temporary:
            temporary.write_text(json.dumps(self._read() | self._known, indent=0), encoding="utf-8")
        self._changed = False
