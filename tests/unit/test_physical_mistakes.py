"""Every mistake of the list is made by a test, says what the list says, and stands in the troubleshooting page."""

import ast
from functools import cache
from pathlib import Path

import pytest
from physical_mistakes import CORRECTED, MISTAKES, REFUSED, WARNED

ROOT = Path(__file__).resolve().parents[2]
NAMES = [mistake.what for mistake in MISTAKES]


@cache
def parsed(file: str) -> ast.Module:
    return ast.parse((ROOT / file).read_text(encoding="utf-8"))


@cache
def texts(file: str) -> list[str]:
    """Return the text constants of a file; of those in parts, the parts."""
    return [one.value for one in ast.walk(parsed(file)) if isinstance(one, ast.Constant) and isinstance(one.value, str)]


def test_there_are_as_many_mistakes_as_were_asked_for_and_each_stands_once():
    assert len(NAMES) >= 25 and len(set(NAMES)) == len(NAMES)
    assert {mistake.outcome for mistake in MISTAKES} == {REFUSED, WARNED, CORRECTED}


@pytest.mark.parametrize("mistake", MISTAKES, ids=NAMES)
def test_a_mistake_has_tests_that_find_the_words_of_its_message(mistake):
    assert mistake.tests
    for name in mistake.tests:
        file, _, rest = name.partition("::")
        function, _, case = rest.removesuffix("]").partition("[")
        (found,) = [one for one in parsed(file).body if isinstance(one, ast.FunctionDef) and one.name == function]
        marks = {one.attr for mark in found.decorator_list for one in ast.walk(mark) if isinstance(one, ast.Attribute)}
        assert not marks & {"skip", "skipif", "xfail"}
        assert any(isinstance(one, ast.Assert) for one in ast.walk(found)) or "raises" in ast.unparse(found)
        assert not case or case in texts(file)
        assert any(mistake.said in text.replace("\\", "") for text in texts(file))
    assert any(mistake.said in text for text in texts(mistake.module))


def test_the_troubleshooting_page_has_the_list():
    page = (ROOT / "docs/troubleshooting.md").read_text(encoding="utf-8")
    table = page.partition("| mistake | noticed |")[2].partition("\n\n")[0].splitlines()[2:]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table]
    assert rows == [[one.what, one.noticed, one.outcome, f"…{one.said}…"] for one in MISTAKES]
