"""Atomic writes, and the hash of a file."""

import errno
import hashlib
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from irodori.core.errors import PlainError

#: Errors that only writing can cause, so that a failed read in the block is not reported as a fault of its output.
_OF_THE_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG)


class DiskError(PlainError, OSError):
    """Error of a disk that cannot store a file: it is full, over quota or read-only, or the file is too large."""


@contextmanager
def written_whole(path) -> Iterator[Path]:
    """Yield a temporary path in the same folder; rename it to the file's name if the block ends without an error.

    Temporary files that a killed job left for the same output are removed first. If such a job still runs, because it
    has outlived its Snakemake, it then fails at its end instead of replacing the output of its successor.

    Parameters
    ----------
    path : path
        File to write; its folder must exist. The temporary name ends in the same suffix.

    Raises
    ------
    DiskError
        If the disk is full, over quota or read-only, or the file is too large for it; no temporary file is left.
    OSError
        If the folder cannot be written.
    """
    path = Path(path)
    for left in _unfinished(path):
        left.unlink(missing_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}-{os.urandom(4).hex()}.part{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:
        number = _number_of(error)
        if number not in _OF_THE_DISK:
            raise
        reason = os.strerror(number)
        told = DiskError(f"{path}: cannot be stored: {reason}; what was made before stays")
        told.strerror = reason  # for a caller whose message names another file
        raise told from None
    finally:
        temporary.unlink(missing_ok=True)


def _number_of(error: OSError | RuntimeError) -> int | None:
    """Return the errno of an error, None if it has none; if closing a file fails, HDF5 has it only in its message."""
    told = re.search(r"errno = (\d+)", str(error))
    return getattr(error, "errno", None) or (int(told[1]) if told else None)


def _unfinished(path: Path) -> list[Path]:
    before, after = f".{path.stem}.", f".part{path.suffix}"
    # Not a glob: names may hold its special characters.
    with suppress(FileNotFoundError):
        return [p for p in path.parent.iterdir() if p.name.startswith(before) and p.name.endswith(after)]
    return []


def file_sha256(path) -> str:
    """Return the SHA-256 of a file's bytes: 64 hexadecimal digits.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sync_folder(folder: Path) -> None:
    """Put the names of a folder's files on the disk: a new file without its name is lost in a power cut."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def append_line(path: Path, line: str) -> None:
    """Append a line to a file, created if it is missing, and put it on the disk.

    The line begins anew also after half of one, as a power cut leaves it; empty lines have no meaning in such a file.
    """
    is_new = not path.exists()
    with open(path, "a", encoding="utf-8") as out:
        out.write(f"\n{line}\n")
        out.flush()
        os.fsync(out.fileno())
    if is_new:
        sync_folder(path.parent)
