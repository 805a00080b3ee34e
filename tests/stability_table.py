"""Outcomes of the tests marked ``stability``: a table of case, stage and outcome, printed and written.

Printed where the tests are selected by ``-m stability``; written as CSV with ``--stability-table=FILE``.
"""

import csv
from collections import Counter
from pathlib import Path

import depth
import pytest
from hard_cases import HARD_CASES

from benchmarks.stability import COLUMNS, EXPECTED, UNEXPECTED
from irodori.core.atomic_files import written_whole

MARK = "stability"


class Outcomes:
    """What became of the tests of each hard case."""

    def __init__(self) -> None:
        self._of: dict[tuple[str, str], dict[str, str]] = {(case.stage, case.case): {} for case in HARD_CASES}
        self._reasons: dict[tuple[str, str], str] = {}

    def note(self, report) -> None:
        """Take a report of pytest's: of setting up, of the test itself, or of cleaning up."""
        for key in (tuple(key) for name, keys in report.user_properties if name == MARK for key in keys):
            if report.failed:
                self._of[key][report.nodeid] = "failed"
            elif report.skipped:
                self._of[key].setdefault(report.nodeid, "skipped")
                self._reasons[key] = str(report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr)
            elif report.when == "call":
                self._of[key].setdefault(report.nodeid, "passed")

    def rows(self) -> list[dict]:
        """Return a row for each hard case, in the order of their list."""
        found = []
        for case in HARD_CASES:
            key = case.stage, case.case
            count = Counter(self._of[key].values())
            if count["failed"]:
                outcome = UNEXPECTED
            elif count["passed"]:
                outcome = EXPECTED
            else:
                outcome = f"not tried: {self._reasons[key]}" if key in self._reasons else "not tried"
            counts = {name: count[name] for name in ("passed", "failed", "skipped")}
            found.append({**case._asdict(), "tests": count.total(), **counts, "outcome": outcome})
        return found


_KNOWN = {(case.stage, case.case) for case in HARD_CASES}
_SESSION = Outcomes()


def pytest_addoption(parser):
    parser.getgroup("irodori").addoption("--stability-table", metavar="FILE", help="CSV of hard cases and outcomes")


def pytest_configure(config):
    selected = config.option.markexpr or "heavy"
    depth.ask_for_heavy("heavy" in selected and "not heavy" not in selected)
    config.addinivalue_line(
        "markers",
        "stability(stage, case, **parameters): the test tries this hard case of tests/hard_cases.py; of a parametrised "
        "test those runs whose parameters have the values given (of a tuple, one of its values)",
    )


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        marks = list(item.iter_markers(MARK))
        tried = [(m.kwargs["stage"], m.kwargs["case"]) for m in marks if _applies(m, item)]
        unknown = [key for key in tried if key not in _KNOWN]
        if unknown:
            raise pytest.UsageError(f"{item.nodeid}: {unknown[0]} is no hard case of tests/hard_cases.py")
        if tried:
            item.user_properties.append((MARK, [list(key) for key in tried]))
        elif marks:  # parameters that no mark means are not asked for by -m stability
            item.own_markers = [mark for mark in item.own_markers if mark.name != MARK]


def _applies(mark, item) -> bool:
    """Whether a mark means this run of a parametrised test."""
    wanted = {key: value for key, value in mark.kwargs.items() if key not in ("stage", "case")}
    if not wanted:
        return True
    found = item.callspec.params
    missing = wanted.keys() - found.keys()
    if missing:
        raise pytest.UsageError(f"{item.nodeid}: has no parameter {missing.pop()!r}; it has {', '.join(found)}")
    return all(found[k] in v if isinstance(v, tuple) else found[k] == v for k, v in wanted.items())


def pytest_runtest_logreport(report):
    _SESSION.note(report)


def pytest_terminal_summary(terminalreporter, exitstatus, config):
    if config.option.collectonly or exitstatus not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        return  # nothing was tried, or not all
    if MARK in (config.option.markexpr or ""):
        _print(terminalreporter, _SESSION.rows())
    path = config.getoption("--stability-table")
    if path:
        write_table(Path(path), _SESSION.rows())
        terminalreporter.write_line(f"hard cases and outcomes: {path}")


def _print(terminal, table: list[dict]) -> None:
    width = max(len(row["case"]) for row in table)
    tried = sum(row["outcome"] == EXPECTED for row in table)
    terminal.section(f"hard cases: {tried} of {len(table)} as expected")
    group = None
    for row in table:
        if (row["part"], row["stage"]) != group:
            group = row["part"], row["stage"]
            terminal.write_line(f"{row['stage']} (part {row['part']})", bold=True)
        colour = {EXPECTED: "green", UNEXPECTED: "red"}.get(row["outcome"], "yellow")
        terminal.write(f"  {row['case']:<{width}}  {row['tests']:4d} tests  ")
        terminal.write(row["outcome"], **{colour: True})
        terminal.write_line(f" ({row['expected']})")


def write_table(path: Path, table: list[dict]) -> None:
    """Write rows as CSV, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)
