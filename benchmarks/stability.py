"""Script that runs all tests marked ``stability`` and writes a table of their outcomes.

``python -m benchmarks.stability`` prints the table; ``snakemake stability`` puts it into the report.
"""

import argparse
import csv
import importlib.util
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from irodori.core.errors import InputError, PlainError
from irodori.core.progress import LOGGER
from irodori.report.html_page import write_page

_ROOT = Path(__file__).resolve().parents[1]
#: Of pytest: all passed, some failed. A test that fails is an outcome; anything else leaves no table.
_RAN = (0, 1)
COLUMNS = ("part", "stage", "case", "expected", "tests", "passed", "failed", "skipped", "outcome")
#: Outcomes of a case if all its tests passed, and if one failed; other texts give the reason why it was not tried.
EXPECTED, UNEXPECTED = "as expected", "NOT as expected"


def read_outcomes(path) -> list[dict]:
    """Return the rows of a table of hard cases.

    Raises
    ------
    InputError
        If the file is missing or has other columns.
    """
    try:
        with open(path, newline="", encoding="utf-8") as stream:
            reader = csv.DictReader(stream)
            found, rows = tuple(reader.fieldnames or ()), list(reader)
    except FileNotFoundError:
        raise InputError(path, "", "no such file", "the table that the tests marked stability write") from None
    if found != COLUMNS:
        raise InputError(path, "columns", ", ".join(found) or "nothing", ", ".join(COLUMNS))
    return rows


def try_hard_cases(table, threads: int, tests: Sequence[str] = ()) -> list[dict]:
    """Run the tests marked ``stability`` in a separate process, write the table of outcomes and return its rows.

    Parameters
    ----------
    table : path
        CSV with the columns `COLUMNS`.
    threads : int
        Number of tests that run in parallel.
    tests : sequence of str
        Files or folders of tests; all if empty.

    Raises
    ------
    PlainError
        If pytest is not installed, or could not run the tests.
    """
    if importlib.util.find_spec("pytest") is None:
        raise PlainError("pytest is not installed; install the test packages with pip install -r requirements-dev.txt.")
    command = [sys.executable, "-m", "pytest", "-m", "stability", "-n", str(threads), "-p", "no:cacheprovider"]
    command += [f"--stability-table={Path(table).resolve()}", *tests]
    # Variables that an outer pytest, if there is one, has set for its own processes are removed.
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST_")}
    run = subprocess.run(command, cwd=_ROOT, capture_output=True, text=True, env=environment)
    LOGGER.info("%s", run.stdout)
    if run.returncode not in _RAN:
        last = " ".join((run.stderr or run.stdout).split()[-60:])
        raise PlainError(f"pytest ended with code {run.returncode}: {last}")
    rows = read_outcomes(table)
    for row in rows:
        if row["outcome"] != EXPECTED:
            LOGGER.warning("%s, %s: %s", row["stage"], row["case"], row["outcome"])
    return rows


def write_stability_page(rows: list[dict], page_file) -> None:
    """Write the page of hard cases, those that did not end as expected first."""
    write_page(page_file, "stability.html.j2", rows=rows, expected=EXPECTED)


def main() -> None:
    """Run the tests and print the table of hard cases."""
    parser = argparse.ArgumentParser(description="Try every hard case of every stage.")
    parser.add_argument("--threads", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--output", type=Path, default=Path("results/benchmark/stability.csv"), help="CSV to write")
    arguments = parser.parse_args()
    rows = try_hard_cases(arguments.output, arguments.threads)
    for row in rows:
        print(f"{row['stage']:<14}{row['tests']:>5} tests  {row['outcome']:<14}  {row['case']} ({row['expected']})")


if __name__ == "__main__":
    main()
