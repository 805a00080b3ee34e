"""Stability page: the hard cases of every stage and the outcome of their tests."""

import csv

from irodori.core.errors import InputError
from irodori.report.html_page import write_page

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
        If the table is missing or has other columns.
    """
    write_page(page_file, "stability.html.j2", rows=read_outcomes(outcomes), expected=EXPECTED)
