"""Functions of all benchmarks for timing, memory and result tables [design, section 6]."""

import argparse
import csv
import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba

from irodori.core.atomic_files import written_whole
from irodori.core.progress import LOGGER

COLUMNS = ("stage", "variant", "work", "unit", "seconds", "throughput", "error_metric", "error", "peak_mb", "reference",
           "ratio")  # fmt: skip
_SHOWN = ("variant", "seconds", "throughput", "error", "peak_mb", "ratio")
_LEAST_RUNS = 5
_PROBE_S = 300.0
_REASON = 200  # characters


def medians_s(work: Mapping[str, Callable[[], object]], runs: int) -> dict[str, float]:
    """Return the median time of each function, s; runs alternate, so that other load on the machine affects all."""
    seconds: dict[str, list[float]] = {name: [] for name in work}
    for run in range(runs + 1):
        for name, function in work.items():
            start = time.perf_counter()
            function()
            if run:  # the first warms up
                seconds[name].append(time.perf_counter() - start)
    return {name: statistics.median(values) for name, values in seconds.items()}


def median_s(function: Callable[[], object], runs: int) -> float:
    """Return the median time of a function after a warm-up run, s."""
    return medians_s({"": function}, runs)[""]


def least_processor_s(function: Callable[[], object], runs: int) -> float:
    """Return the least processor time of a function over several runs, summed over all threads, s.

    Other load on the machine affects it less than wall-clock time.
    """
    seconds = []
    for _ in range(runs):
        start = time.process_time()
        function()
        seconds.append(time.process_time() - start)
    return min(seconds)


def own_peak_mb() -> float:
    """Return the peak resident memory of this process, MB; ``ru_maxrss`` would include the parent's at the fork."""
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return float(status["VmHWM"].split()[0]) / 1024


def peak_mb_of(function: Callable[[], object]) -> float:
    """Return the peak resident memory of this process while a function runs, including memory held before, MB.

    Writing 5 to ``clear_refs`` resets the peak in the kernel [proc(5)].
    """
    Path("/proc/self/clear_refs").write_text("5")
    function()
    return own_peak_mb()


def printed_by(name: str, calls: Sequence[Sequence[str]]) -> list[str]:
    """Run a module of this folder with each list of arguments in a separate process and return the printed texts.

    Two processes run at a time, which does not change the peak memory of each, but makes times useless.
    """
    root = Path(__file__).resolve().parents[1]

    def printed(arguments: Sequence[str]) -> str:
        command = [sys.executable, "-m", f"benchmarks.{name}", *arguments]
        return subprocess.run(command, cwd=root, stdout=subprocess.PIPE, text=True, check=True).stdout

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(printed, calls))


def why_it_fails(*arguments: str) -> str:
    """Return the reason, in one line, why another program of a comparison cannot run here; empty if it can.

    It is tried in a separate process, because a library built against another version of its dependencies may end the
    process instead of raising an error.

    Parameters
    ----------
    *arguments : str
        Arguments of Python, such as ``-c`` and a program that does a small part of the real work.
    """
    root = Path(__file__).resolve().parents[1]
    try:
        done = subprocess.run(
            [sys.executable, *arguments], cwd=root, capture_output=True, text=True, errors="replace", timeout=_PROBE_S
        )
    except subprocess.TimeoutExpired:
        return f"no answer in {_PROBE_S:.0f} s"
    if done.returncode == 0:
        return ""
    said = done.stderr.strip().splitlines() or ["nothing said"]
    if done.returncode < 0:  # the error message comes before the state that a library prints when it ends the process
        words = next((line for line in said if "error" in line.lower()), said[0])
        return f"ended by {signal.Signals(-done.returncode).name}: {words.strip()[:_REASON]}"
    return said[-1].strip()[:_REASON]


def row_without_figures(stage: str, variant: str, reason: str) -> dict:
    """Return the row of a program that cannot run here: the reason is in ``error_metric``, other cells are empty."""
    return dict.fromkeys(COLUMNS, "") | {"stage": stage, "variant": variant, "error_metric": f"cannot run: {reason}"}


def arguments_of(description: str) -> argparse.ArgumentParser:
    """Return a parser with the command-line arguments that all benchmarks have."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--runs", type=_runs, default=7, help=f"timed runs of each variant, at least {_LEAST_RUNS}")
    parser.add_argument("--threads", type=int, default=min(2, numba.config.NUMBA_NUM_THREADS))
    parser.add_argument(
        "--size",
        choices=("small", "full"),
        default="full",
        help="small has smaller inputs and fewer variants; without effect where a benchmark has one size",
    )
    parser.add_argument("--output", type=Path, help="CSV to write")
    return parser


def _runs(text: str) -> int:
    if int(text) < _LEAST_RUNS:
        raise argparse.ArgumentTypeError(f"{text}; accepted: {_LEAST_RUNS} or more")
    return int(text)


def run_benchmark(name: str, output: str, threads: int | None = None, size: str | None = None) -> None:
    """Run a benchmark in a separate process and log its output.

    Raises
    ------
    RuntimeError
        If it fails; the message has the last line of its output.
    """
    output = Path(output).absolute()
    options = ["--threads", str(threads)] if threads else []
    options += ["--size", size, "--runs", str(_LEAST_RUNS if size == "small" else 2 * _LEAST_RUNS)] if size else []
    with written_whole(output) as part:
        command = [sys.executable, "-m", f"benchmarks.{name}", "--output", str(part), *options]
        root = Path(__file__).resolve().parents[1]
        done = subprocess.run(command, cwd=root, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        for line in done.stdout.splitlines():
            LOGGER.info("%s", line)
        if done.returncode:
            last = done.stdout.strip().splitlines()[-1:] or ["nothing printed"]
            raise RuntimeError(f"benchmarks.{name} ended with {done.returncode}: {last[0]}")


def report(rows: Sequence[dict], threads: int, output: Path | None) -> None:
    """Print the table and the machine's load; write the table if there is an output."""
    print(f"{threads} threads, load {os.getloadavg()[0]:.1f}")
    widths = {name: max(len(name), *(len(row[name]) for row in rows)) for name in _SHOWN}
    for row in ({name: name for name in _SHOWN}, *rows):
        print("  ".join(f"{row[name]:>{widths[name]}}" for name in _SHOWN))
    for row in rows:
        if not row["seconds"]:
            print(f"{row['variant']}: {row['error_metric']}")
    if output:
        write(rows, output)


def write(rows: Sequence[dict], output: Path) -> None:
    """Write rows to a CSV with the columns `COLUMNS`."""
    with output.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
