"""Functions take six parameters by position at most, compiled or not; what more they need is named by the caller."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MOST = 6


def functions(tree: ast.AST, prefix: str = "") -> Iterator[tuple[str, ast.FunctionDef]]:
    """Yield name and definition of every function; those within others have the outer name before theirs."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef):
            yield prefix + node.name, node
        name = f"{node.name}." if isinstance(node, ast.ClassDef | ast.FunctionDef) else ""
        yield from functions(node, prefix + name)


def by_position(node) -> int:
    names = [one.arg for one in (*node.args.posonlyargs, *node.args.args)]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def is_called_by_pytest(name: str) -> bool:
    """Whether a function is a test: what it takes are fixtures and parameters, which pytest gives by name."""
    return name.rpartition(".")[2].startswith("test_")


@pytest.mark.parametrize("folder", ["irodori", "benchmarks", "tests", "workflow"])
def test_functions_take_six_parameters_by_position_at_most(folder):
    files = sorted((ROOT / folder).rglob("*.py"))
    assert files
    found = {
        f"{file.relative_to(ROOT)}: {name}": by_position(node)
        for file in files
        for name, node in functions(ast.parse(file.read_text(encoding="utf-8")))
        if by_position(node) > MOST and not is_called_by_pytest(name)
    }
    assert found == {}


def test_the_scan_counts_what_a_caller_gives_by_position():
    source = "class A:\n    def f(self, a, b, c, d, e, f, *, g): ...\n@njit\ndef h(a, b, /, c):\n    def i(d): ...\n"
    counted = [(name, by_position(node)) for name, node in functions(ast.parse(source))]
    assert counted == [("A.f", 6), ("h", 3), ("h.i", 1)]
