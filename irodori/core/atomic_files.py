"""Atomic writes with checksums."""

import argparse
import errno
import hashlib
import os
import re
import secrets
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from irodori.core.errors import InputError, PlainError

_DAMAGED = ".damaged"
#: Errors that writing alone has: what a block reads is not blamed on its output.
_OF_THE_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG)


class DiskError(PlainError, OSError):
    """A disk that is full, or takes nothing."""


@contextmanager
def written_whole(path) -> Iterator[Path]:
    """Yield a temporary name in the same folder; what is written there takes its own name if the block ends well.

    What a killed job of the same output left is removed first. A job that outlived its Snakemake and still writes there
    then fails when it ends, instead of replacing what its successor wrote.

    Parameters
    ----------
    path : path
        File to write; its folder must exist. The temporary name ends in the same suffix.

    Raises
    ------
    DiskError
        If the disk is full or takes nothing; nothing is left behind.
    OSError
        If the folder cannot be written.
    """
    path = Path(path)
    for left in _unfinished(path):
        left.unlink(missing_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}-{secrets.token_hex(4)}.part{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:
        number = _number_of(error)
        if number not in _OF_THE_DISK:
            raise
        reason = os.strerror(number)
        raise DiskError(f"{path}: cannot be stored: {reason}; what was made before stays") from None
    finally:
        temporary.unlink(missing_ok=True)


def _number_of(error: OSError | RuntimeError) -> int | None:
    """Return the system's number of an error; HDF5 has it in its text alone where a file is closed."""
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


def digest_path(path) -> Path:
    """Return where a file's hash stands: beside it, in the form that ``sha256sum --check`` reads."""
    path = Path(path)
    return path.with_name(f".{path.name}.sha256")


def write_digest(path) -> None:
    """Note the hash of a complete result.

    Raises
    ------
    OSError
        If the file is missing or the disk is full.
    """
    path = Path(path)
    digest = file_sha256(path)
    with written_whole(digest_path(path)) as temporary:
        temporary.write_text(f"{digest}  {path.name}\n", encoding="utf-8")


def verified_sha256(path) -> str:
    """Return the hash of a file that is as its rule left it, or that no rule made.

    A file that has changed since is renamed, so that the next run makes it again; a file without a noted hash, such as
    a photograph or a table of the user's, is what it is.

    Returns
    -------
    str
        64 hexadecimal digits.

    Raises
    ------
    InputError
        If the file is not the one whose hash was noted: cut short, damaged on the disk, or edited.
    OSError
        If it cannot be read.
    """
    path = Path(path)
    digest = file_sha256(path)
    try:
        noted = digest_path(path).read_text(encoding="utf-8", errors="replace").split()[:1]
    except FileNotFoundError:
        return digest
    if noted != [digest]:
        found = f"other bytes than its rule wrote ({_set_aside(path)})"
        raise InputError(path, "", found, "the file as it was written: the next run makes it again")
    return digest


def _set_aside(path: Path) -> str:
    """Rename a damaged file and forget its hash, and say what was done."""
    aside = path.with_name(path.name + _DAMAGED)
    try:
        os.replace(path, aside)
        digest_path(path).unlink(missing_ok=True)
    except FileNotFoundError:
        return "another job has set it aside"
    except OSError as error:
        return f"cannot be set aside, remove it: {error.strerror}"
    return f"set aside as {aside.name}; renamed back, it is used as it is"


def damaged_results(folder) -> list[str]:
    """Compare every result under a folder with the hash beside it, set aside what has changed, and name it.

    Snakemake sees a changed file by its time alone; this sees every bit, also of pictures and pages that no rule reads.

    Raises
    ------
    InputError
        If there is no such folder.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(folder, "", "no such folder", "a folder of results")
    said = []
    for digest in sorted(folder.rglob(".*.sha256")):
        path = digest.with_name(digest.name.removeprefix(".").removesuffix(".sha256"))
        if path.is_file():
            try:
                verified_sha256(path)
            except InputError as error:
                said.append(str(error))
    return said


def main(arguments: list[str] | None = None, prog: str = "python -m irodori.core.atomic_files") -> int:
    """Check the results under a folder; 1 where one was damaged."""
    parser = argparse.ArgumentParser(prog=prog, description=damaged_results.__doc__)
    parser.add_argument("folder", nargs="?", default="results")
    try:
        said = damaged_results(parser.parse_args(arguments).folder)
    except InputError as error:
        said = [str(error)]
    print("\n".join(said), end="\n" if said else "")
    return int(bool(said))


if __name__ == "__main__":
    sys.exit(main())
