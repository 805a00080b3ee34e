"""Fault injection into whole runs: kill -9, full and read-only disks, two runs at once, damaged files.

Prints a table case x outcome and writes it as CSV; ends with 1 where a case is not as it should be.
"""

import argparse
import csv
import os
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path

from damage import damage_finals, damage_results, run_twice
from kills import kill_often
from running import end_all_under, fresh_project, judge, last_fault, run
from storage import CannotMountError, fill_disk

CASES = ("kills", "storage", "twice", "damage")
COLUMNS = ("case", "moment_s", "at_work", "good", "outcome")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=30, help="kills in all (default 30)")
    parser.add_argument("--seed", type=int, default=1, help="of moments, victims and damaged bytes (default 1)")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=CASES)
    parser.add_argument("--all-damages", action="store_true", help="cut short and flip a bit of every file")
    parser.add_argument("--csv", type=Path, default=Path("faults.csv"), help="table to write (default faults.csv)")
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="irodori-faults-"))
    # A file system mounted here must be gone afterwards, and so must every process, however this ends.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        rows = run_cases(options, folder)
    finally:
        end_all_under(folder)
        shutil.rmtree(folder)
    bad = sum(not row["good"] for row in rows)
    print(f"{len(rows)} rows, {bad} not as they should be; seed {options.seed}")
    return int(bad > 0)


def run_cases(options: argparse.Namespace, folder: Path) -> list[dict]:
    """Run the cases asked for, printing each row and keeping the table up to date, and return its rows."""
    rows = []
    with options.csv.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS, restval="")
        writer.writeheader()
        for row in _rows(options, folder):
            moment = f"{row['moment_s']:.1f}" if "moment_s" in row else ""
            writer.writerow({**row, "moment_s": moment})
            stream.flush()
            verdict = "ok " if row["good"] else "BAD"
            print(
                f"{verdict} {row['case']:<58}{moment:>7} {row.get('at_work', '')}\n      {row['outcome']}", flush=True
            )
            rows.append(row)
    return rows


def _rows(options: argparse.Namespace, folder: Path):
    project = fresh_project(folder / "reference")
    begun = time.monotonic()
    status, said = run(project)
    if status:
        raise SystemExit(f"the undisturbed run fails: {last_fault(said)}")
    expected = folder / "expected"
    shutil.copytree(project / "results", expected)
    # Where it compiles loops, all others read them.
    row = {"case": "undisturbed run", "moment_s": time.monotonic() - begun, "good": True}
    yield row | {"outcome": "the reference"}
    again = fresh_project(folder / "again")
    begun = time.monotonic()
    status, said = run(again)
    took_s = time.monotonic() - begun
    wrong = last_fault(said) if status else judge(again, expected)
    row = {"case": "second undisturbed run", "moment_s": took_s, "good": not wrong}
    yield row | {"outcome": wrong or "all results identical"}
    shutil.rmtree(again)
    if "kills" in options.cases:
        yield from kill_often(folder / "kills", expected, options.moments, options.seed, took_s)
    if "storage" in options.cases:
        try:
            yield from fill_disk(folder / "storage", expected)
        except CannotMountError as error:
            row = {"case": "full and read-only disks", "good": True}
            yield row | {"outcome": f"NOT TESTED: no file system can be mounted here ({error})"}
    if "twice" in options.cases:
        yield from run_twice(project, expected)
    if "damage" in options.cases:
        yield from damage_results(project, expected, options.seed, options.all_damages)
        yield from damage_finals(project, expected, options.seed)


if __name__ == "__main__":
    os.umask(0o022)
    sys.exit(main())
