"""Examples in docstrings give what they show."""

import doctest
import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WITH_EXAMPLES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in (ROOT / "irodori").rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_examples_give_what_they_show(module):
    found = doctest.testmod(importlib.import_module(module))
    # An example that doctest does not find would be one that nobody runs.
    shown = (ROOT / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8").count(">>> ")
    assert found == doctest.TestResults(failed=0, attempted=shown)


def test_there_are_examples():
    assert len(WITH_EXAMPLES) >= 5
