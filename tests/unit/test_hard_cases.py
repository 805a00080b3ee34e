"""Every hard case of the project's parts has a test that says so."""

import ast
import html
from pathlib import Path
from types import SimpleNamespace

import pytest
from hard_cases import HARD_CASES
from stability_table import MARK, Outcomes, write_table

from benchmarks.stability import read_outcomes, try_hard_cases, write_stability_page
from irodori.core.errors import InputError, PlainError

TESTS = Path(__file__).resolve().parents[1]


def marked(source: str) -> set[tuple[str, str]]:
    """Return (stage, case) of every ``pytest.mark.stability(...)`` in a file's text."""
    return {
        tuple(ast.literal_eval(next(k.value for k in node.keywords if k.arg == name)) for name in ("stage", "case"))
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "stability"
    }


def test_every_hard_case_has_a_test_and_every_mark_names_a_hard_case():
    tried = {key for file in TESTS.rglob("test_*.py") for key in marked(file.read_text(encoding="utf-8"))}
    listed = {(case.stage, case.case) for case in HARD_CASES}
    assert len(listed) == len(HARD_CASES)
    assert sorted(listed - tried) == []
    assert sorted(tried - listed) == []


def report(case, outcome="passed", when="call", name="test_a", longrepr=""):
    """What pytest tells of a part of a test that tries a case."""
    properties = [(MARK, [[case.stage, case.case]])]
    return SimpleNamespace(
        user_properties=properties, failed=outcome == "failed", skipped=outcome == "skipped", when=when, nodeid=name,
        longrepr=longrepr,
    )  # fmt: skip


def test_the_table_tells_failures_from_successes_and_from_what_was_not_tried():
    good, bad, spoiled, absent, none = HARD_CASES[:5]
    outcomes = Outcomes()
    for case, name, outcome, when, why in [
        (good, "a", "passed", "call", ""), (good, "b", "passed", "call", ""),
        (good, "c", "skipped", "setup", ("f", 1, "Skipped: no data")),
        (bad, "a", "passed", "call", ""), (bad, "b", "failed", "call", "AssertionError"),
        (spoiled, "a", "passed", "call", ""), (spoiled, "a", "failed", "teardown", "OSError"),
        (absent, "a", "skipped", "setup", ("f", 1, "Skipped: no data")),
        (none, "a", "passed", "setup", ""),
    ]:  # fmt: skip
        outcomes.note(report(case, outcome, when, name, why))
    rows = outcomes.rows()
    assert [row["outcome"] for row in rows[:5]] == [
        "as expected", "NOT as expected", "NOT as expected", "not tried: Skipped: no data", "not tried",
    ]  # fmt: skip
    assert [(r["tests"], r["passed"], r["failed"], r["skipped"]) for r in rows[:4]] == [
        (3, 2, 0, 1), (2, 1, 1, 0), (1, 0, 1, 0), (1, 0, 0, 1),
    ]  # fmt: skip
    assert [(row["stage"], row["case"]) for row in rows] == [(case.stage, case.case) for case in HARD_CASES]


def test_the_page_shows_every_case_and_first_those_that_went_wrong(tmp_path):
    outcomes = Outcomes()
    for case in HARD_CASES:
        outcomes.note(report(case, "failed" if case is HARD_CASES[7] else "passed"))
    write_table(tmp_path / "s.csv", outcomes.rows())
    write_stability_page(read_outcomes(tmp_path / "s.csv"), tmp_path / "page.html")
    page = html.unescape((tmp_path / "page.html").read_text())
    assert f"{len(HARD_CASES) - 1} of {len(HARD_CASES)} end as expected" in page
    assert all(case.case in page and case.expected in page for case in HARD_CASES)
    assert page.index("Those that do not") < page.index(HARD_CASES[7].case) < page.index("workflow (part A)")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["page.html", "s.csv"]


def test_another_table_is_refused_by_name(tmp_path):
    with pytest.raises(InputError, match=r"s\.csv: found no such file"):
        read_outcomes(tmp_path / "s.csv")
    (tmp_path / "s.csv").write_text("stage,case\n")
    with pytest.raises(InputError, match=r"s\.csv: columns: found stage, case; accepted: part, stage"):
        read_outcomes(tmp_path / "s.csv")


@pytest.mark.heavy
def test_the_table_is_that_of_a_run_of_its_own(tmp_path):
    rows = try_hard_cases(tmp_path / "s.csv", 0, ["tests/unit/test_store.py", "tests/unit/test_self_describing.py"])
    of_store = [row for row in rows if row["stage"] == "store"]
    assert of_store and all(row["outcome"] == "as expected" and int(row["tests"]) > 0 for row in of_store)
    assert {row["outcome"] for row in rows if row["stage"] != "store"} == {"not tried"}
    assert rows == read_outcomes(tmp_path / "s.csv")


def test_tests_that_cannot_be_run_leave_no_table(tmp_path):
    with pytest.raises(PlainError, match="pytest ended with code 4"):
        try_hard_cases(tmp_path / "s.csv", 0, ["tests/unit/no_such_test.py"])
    assert not (tmp_path / "s.csv").exists()
