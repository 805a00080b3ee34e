"""Stability page: the hard cases of every stage and the outcome of their tests."""

import csv
import html
from pathlib import Path

from irodori.core.errors import InputError
from irodori.report.markup import table, write_page

COLUMNS = ("part", "stage", "case", "expected", "tests", "passed", "failed", "skipped", "outcome")
#: Outcomes of a case whose tests all passed, and of one with a test that failed; others say why nothing was tried.
EXPECTED, UNEXPECTED = "as expected", "NOT as expected"
_SHOWN = ("case", "expected", "tests", "outcome")


def read_outcomes(path) -> list[dict]:
    """Return the rows of a table of hard cases.

    Raises
    ------
    InputError
        If it is no such table.
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


def write_stability_page(outcomes, page_file) -> None:
    """Write the page of hard cases, those that did not end as expected first.

    Parameters
    ----------
    outcomes : path
        CSV of the columns ``COLUMNS``.
    page_file : path

    Raises
    ------
    InputError
        If the table is missing or another one.
    """
    rows = read_outcomes(outcomes)
    good = sum(row["outcome"] == EXPECTED for row in rows)
    parts = [f"<h1>Hard cases</h1><p>{good} of {len(rows)} end as expected.</p>"]
    others = [row for row in rows if row["outcome"] != EXPECTED]
    if others:
        lines = [[row["stage"], *(row[name] for name in _SHOWN)] for row in others]
        parts.append("<h2>Those that do not</h2>" + table(["stage", *_SHOWN], lines))
    for part, stage in dict.fromkeys((row["part"], row["stage"]) for row in rows):
        group = [row for row in rows if (row["part"], row["stage"]) == (part, stage)]
        lines = [[row[name] for name in _SHOWN] for row in group]
        parts.append(f"<h2>{html.escape(stage)} (part {html.escape(part)})</h2>" + table(list(_SHOWN), lines))
    write_page(Path(page_file), "Irodori: hard cases", "".join(parts))
