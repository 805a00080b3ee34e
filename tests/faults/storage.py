"""Disks that are full or read-only: a results folder on a small file system in memory."""

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from running import fresh_project, judge, last_fault, run

#: Size of the file system over that of all the results.
FILLED = (0.15, 0.4, 0.6, 0.75, 0.85, 0.93)
_MB = 1 << 20
_FULL, _WRITE_PROTECTED = "cannot be stored: No space left on device", "Write-protected output files"


class CannotMountError(Exception):
    """Why no file system can be mounted here."""


@contextmanager
def small_disk(folder: Path, size_bytes: int) -> Iterator[None]:
    """Mount a file system of a size on a folder, and unmount it in the end.

    Raises
    ------
    CannotMountError
    """
    if os.geteuid() != 0:
        raise CannotMountError("only root may mount a file system")
    folder.mkdir(parents=True, exist_ok=True)
    _mount("-t", "tmpfs", "-o", f"size={size_bytes}", "tmpfs", str(folder))
    try:
        yield
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def _mount(*arguments: str) -> None:
    done = subprocess.run(["mount", *arguments], capture_output=True, text=True)
    if done.returncode:
        raise CannotMountError(done.stderr.strip())


def remount(folder: Path, *options: str) -> None:
    """Change a mounted file system: ``size=...``, ``ro``, ``rw``."""
    _mount("-o", ",".join(("remount", *options)), str(folder))


def _needed_bytes(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def fill_disk(folder: Path, expected: Path) -> Iterator[dict]:
    """Run on disks too small for the results, each larger than the last, then on one that is large enough."""
    needed = _needed_bytes(expected)
    project = fresh_project(folder / "full")
    disk = project / "results"
    with small_disk(disk, int(FILLED[0] * needed)):
        for part in FILLED:
            remount(disk, f"size={int(part * needed)}")
            status, said = run(project)
            wrong = judge(project, expected, partial=True)
            good = bool(status) and not wrong and _FULL in said
            reason = f"stops: {_reason(said, _FULL)}" if status else "ran to its end on a disk that is too small"
            outcome = wrong or reason
            yield {"case": f"disk of {part * needed / _MB:.0f} MB", "good": good, "outcome": outcome}
        remount(disk, f"size={2 * needed}")
        status, said = run(project)
        wrong = last_fault(said) if status else judge(project, expected)
        row = {"case": "rerun on a larger disk", "good": not wrong}
        yield row | {"outcome": wrong or "completes, all results identical"}
        yield from _lock_disk(project, expected)


def _lock_disk(project: Path, expected: Path) -> Iterator[dict]:
    """Ask for a missing result on a read-only disk, then on one that can be written again."""
    disk = project / "results"
    (disk / "still-life/front.exr").unlink()
    remount(disk, "ro")
    try:
        status, said = run(project)
        wrong = judge(project, expected, partial=True)
    finally:
        remount(disk, "rw")
    # Snakemake refuses outputs that exist before any job starts.
    good = bool(status) and not wrong and _WRITE_PROTECTED in said
    outcome = wrong or f"stops: {_reason(said, _WRITE_PROTECTED)}"
    yield {"case": "read-only results", "good": good, "outcome": outcome}
    status, said = run(project)
    wrong = last_fault(said) if status else judge(project, expected)
    yield {"case": "rerun, writable again", "good": not wrong, "outcome": wrong or "completes, all results identical"}


def _reason(said: str, wanted: str) -> str:
    """Return the line of a run's output that names the fault."""
    lines = [line.strip() for line in said.splitlines() if wanted in line]
    return lines[0][:200] if lines else last_fault(said)
