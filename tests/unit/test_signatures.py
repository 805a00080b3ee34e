"""Functions take six parameters by position at most; what more they need is named by the caller."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MOST = 6
#: What compiles a function, or hands it to the compiler: kernels take what they need by position.
COMPILED = ("njit", "uncounted", "overload", "intrinsic", "vectorize", "cfunc", "lower_builtin")


def functions(tree: ast.AST, prefix: str = ""):
    """Yield name and definition of every function that nothing compiles."""
    for node in ast.iter_child_nodes(tree):
        compiled = [ast.unparse(one) for one in getattr(node, "decorator_list", ())]
        if isinstance(node, ast.FunctionDef) and not any(word in one for one in compiled for word in COMPILED):
            yield prefix + node.name, node
        name = f"{node.name}." if isinstance(node, ast.ClassDef) else ""
        yield from functions(node, name)


def by_position(node) -> int:
    names = [one.arg for one in (*node.args.posonlyargs, *node.args.args)]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def test_functions_take_six_parameters_by_position_at_most():
    found: dict[str, set[str]] = {}
    for file in sorted((ROOT / "irodori").rglob("*.py")):
        for name, node in functions(ast.parse(file.read_text(encoding="utf-8"))):
            if by_position(node) > MOST:
                found.setdefault(file.relative_to(ROOT / "irodori").parts[0], set()).add(name)
    assert found == {}


def test_the_scan_counts_what_a_caller_gives_by_position():
    source = "class A:\n    def f(self, a, b, c, d, e, f, *, g): ...\n@njit\ndef h(a, b, c, d, e, f, g): ...\n"
    assert [(name, by_position(node)) for name, node in functions(ast.parse(source))] == [("A.f", 6)]
