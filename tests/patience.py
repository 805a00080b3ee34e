"""Waiting on progress and not on the clock: a busy host makes a program slow, which is no failure."""

import contextlib
import subprocess
import tempfile
import time
from pathlib import Path

import psutil

#: A program without progress for so long hangs, s.
QUIET_S = 300.0
#: CPU time that counts as progress, s; a Snakemake that waits for a sleeping job takes none in a minute.
LEAST_CPU_S = 0.5
#: What something that answers on its own is given, s and, for a browser, ms: on a quiet machine it takes a moment.
LONG_S, LONG_MS = 300.0, 300_000.0
#: A program that has computed for so long never ends, s of CPU time.
MOST_CPU_S = 3600.0


class HungError(AssertionError):
    """A program that was killed since it did not get on."""


def _tree(pid: int) -> list[psutil.Process]:
    """Return a process and its descendants, those that still live."""
    with contextlib.suppress(psutil.Error):
        first = psutil.Process(pid)
        return [first, *first.children(recursive=True)]
    return []


def _cpu_s(pid: int) -> float:
    """Return the CPU time of a process and its descendants, those included that have been waited for, s."""
    total = 0.0
    for process in _tree(pid):
        with contextlib.suppress(psutil.Error):
            times = process.cpu_times()
            total += times.user + times.system + times.children_user + times.children_system
    return total


def wait(process: subprocess.Popen, *outputs: Path, quiet_s: float = QUIET_S) -> int:
    """Return the status of a process once it has ended.

    It is killed, with its descendants, where none of them has computed and none of its output files has changed for
    ``quiet_s`` seconds, or where together they have computed for `MOST_CPU_S`; then HungError is raised.
    """
    seen_cpu_s, seen_sizes, since = 0.0, (), time.monotonic()
    while True:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(min(1.0, quiet_s / 4.0))
        cpu_s, sizes = _cpu_s(process.pid), tuple(path.stat().st_size for path in outputs if path.exists())
        if abs(cpu_s - seen_cpu_s) >= LEAST_CPU_S or sizes != seen_sizes:
            seen_cpu_s, seen_sizes, since = cpu_s, sizes, time.monotonic()
        quiet = time.monotonic() - since > quiet_s
        if quiet or cpu_s > MOST_CPU_S:
            for living in _tree(process.pid):
                with contextlib.suppress(psutil.Error):
                    living.kill()
            process.wait()
            raise HungError(f"{process.args}: {'no progress' if quiet else 'no end'} after {cpu_s:.0f} s of CPU time")


def run(command: list, quiet_s: float = QUIET_S, **options) -> subprocess.CompletedProcess:
    """Run a command, waiting as `wait` does; return its status and, as text, what it said.

    ``options`` are those of subprocess.Popen. What a command that is killed has said is in the error.
    """
    with tempfile.TemporaryDirectory() as folder:
        out, err = Path(folder) / "out", Path(folder) / "err"
        with out.open("w") as to_out, err.open("w") as to_err:
            process = subprocess.Popen(command, stdout=to_out, stderr=to_err, **options)
            try:
                status = wait(process, out, err, quiet_s=quiet_s)
            except HungError as error:
                raise HungError(f"{error}\n{_end(out)}{_end(err)}") from None
        return subprocess.CompletedProcess(command, status, *(path.read_text(errors="replace") for path in (out, err)))


def _end(path: Path) -> str:
    """Return the end of a file."""
    return path.read_text(errors="replace")[-4000:]


def until(condition, failing=lambda: "", polls: int = 6000) -> None:
    """Wait until a condition holds; fail with a message after so many polls, 10 ms or more apart.

    Polls are counted and no seconds: where other programs take the cores from this one, they come more slowly.
    """
    for _ in range(polls):
        if condition():
            return
        time.sleep(0.01)
    raise AssertionError(failing())


__all__ = ["LONG_MS", "LONG_S", "HungError", "run", "until", "wait"]
