"""Mutants of a module: copies with one small fault each, found and made by its syntax tree.

Only bodies of functions are mutated. Left out are messages (what is raised or logged), assertions, annotations,
defaults of parameters, and compiled kernels: they are kept on disk by their source and would not notice, and compiling
them anew takes minutes; what they compute is compared with plain loops by tests of their own. So is what has run before
a mutant is put in: functions that their module calls as it is loaded, and what tells the compiler of a type.

Faults that change nothing for any input are not made where their kind tells it (`_SYMMETRIC`, tolerances, ``reshape``);
single ones stand in ``equivalent.txt``, each with the reason.
"""

import ast
import copy
import functools
import types
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

_COMPARISONS = {
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_ARITHMETIC = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip
_TERMS = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.BitAnd, ast.BitOr)
#: Decorators of compiled functions, and calls that say something and do nothing.
_COMPILED = {"njit", "uncounted", "cfunc", "intrinsic", "overload", "unbox", "lower_constant", "register_model"}
_TALK = {"LOGGER", "_LOGGER", "logging", "warnings"}
#: What gives the same with its arguments swapped.
_SYMMETRIC = {
    "maximum", "minimum", "max", "min", "hypot", "isclose", "allclose", "array_equal", "logical_and", "zip", "clip",
    "broadcast_shapes", "suppress", "delta_e", "delta_e_reflectance", "spectral_rmse", "goodness_of_fit",
}  # fmt: skip
#: A constant above zero and not above this is a tolerance, which is as good half as large again.
_TOLERANCE = 1e-6
#: Faults without effect: module, function, kind and text as in `Mutant`, wherever it stands in the function, and after
#: a tab the reason.
_EQUIVALENT = Path(__file__).with_name("equivalent.txt")


@dataclass(frozen=True)
class Mutant:
    """One fault at a line, in a statement that begins at ``first``; ``function`` is a qualified name.

    ``number`` counts the mutants of a file in the order of its tree.
    """

    module: str
    number: int
    line: int
    first: int
    function: str
    kind: str
    text: str

    def __str__(self) -> str:
        return f"{self.module}:{self.line} {self.function}: {self.kind}: {self.text}"

    @property
    def lasting(self) -> str:
        """Return what tells a mutant from others whatever is written above it."""
        return f"{self.module} {self.function}: {self.kind}: {self.text}"


def mutants_of(module: str, path: Path, known: bool = False) -> list[Mutant]:
    """Return all mutants of a module's file, those that are known to be without effect only if asked for."""
    every = [
        Mutant(module, number, node.lineno, first, function, kind, f"{_shown(node)} -> {_shown(changed)}")
        for number, (function, first, node, kind, changed, _) in enumerate(_sites(ast.parse(path.read_text("utf-8"))))
    ]
    return [mutant for mutant in every if known or mutant.lasting not in equivalent()]


@functools.cache
def equivalent() -> dict[str, str]:
    """Return the faults that are known to be without effect, as `Mutant.lasting` names them -> the reason."""
    lines = [line for line in _EQUIVALENT.read_text("utf-8").splitlines() if line and not line.startswith("#")]
    return dict(line.split("\t") for line in lines)


def mutated(mutant: Mutant, path: Path) -> ast.Module:
    """Return the tree of a module with a mutant's fault."""
    tree = ast.parse(path.read_text("utf-8"))
    for number, (*_, changed, put) in enumerate(_sites(tree)):
        if number == mutant.number:
            put(changed)
            return ast.fix_missing_locations(tree)
    raise ValueError(f"no mutant {mutant.number} in {path}")


def marked(path: Path, first: set[int], name: str) -> ast.Module:
    """Return the tree of a module that calls a function, with the line, before each statement that begins at one."""
    tree = ast.parse(path.read_text("utf-8"))
    for node in list(ast.walk(tree)):
        for field in ("body", "orelse", "finalbody"):
            statements = getattr(node, field, None)
            for one in [*statements] if isinstance(statements, list) else ():
                if one.lineno in first:
                    call = ast.parse(f"{name}({one.lineno})").body[0]
                    call = ast.fix_missing_locations(ast.copy_location(call, one))
                    statements.insert(statements.index(one), call)
    return ast.fix_missing_locations(tree)


def compiled(tree: ast.Module, path: Path) -> types.CodeType:
    """Return the code of a changed tree; that a number has no items, where a fault leaves one, is for tests to say."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SyntaxWarning)
        return compile(tree, str(path), "exec", dont_inherit=True)


def _shown(node: ast.AST) -> str:
    text = " ".join(ast.unparse(node).split())
    return text if len(text) <= 70 else f"{text[:67]}..."


_Site = tuple[str, int, ast.AST, str, ast.AST, Callable[[ast.AST], None]]


def _sites(tree: ast.Module) -> Iterator[_Site]:
    """Yield function, first line of the statement, node, kind of fault, changed node and what puts it in the tree."""
    loading = [node for node in tree.body if not isinstance(node, ast.FunctionDef | ast.ClassDef)]
    run = {_called(call) for node in loading for call in ast.walk(node) if isinstance(call, ast.Call)}
    for name, function in _functions(tree.body, ""):
        if name in run:
            continue
        for field, index, statement in _items(function, ("body",)):
            yield from _inside((name, statement.lineno), function, field, index, statement)


def _functions(body: list[ast.stmt], prefix: str) -> Iterator[tuple[str, ast.FunctionDef]]:
    for node in body:
        if not isinstance(node, ast.ClassDef | ast.FunctionDef):
            continue
        if _COMPILED & {_called(one) for one in node.decorator_list}:
            continue
        if isinstance(node, ast.ClassDef):
            yield from _functions(node.body, f"{prefix}{node.name}.")
        else:
            yield prefix + node.name, node


def _called(node: ast.AST) -> str:
    """Return the last name of what is called or named."""
    if isinstance(node, ast.Call):
        return _called(node.func)
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _items(node: ast.AST, fields=None) -> Iterator[tuple[str, int | None, ast.AST]]:
    for field in fields or node._fields:
        value = getattr(node, field, None)
        for index, one in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if isinstance(one, ast.AST):
                yield field, index, one


def _inside(place: tuple[str, int], parent: ast.AST, field: str, index: int | None, node: ast.AST) -> Iterator[_Site]:
    if isinstance(node, ast.stmt):
        place = (place[0], node.lineno)
    if _is_talk(node) or (
        field in ("annotation", "returns", "decorator_list", "args", "type_comment")
        and isinstance(parent, ast.FunctionDef | ast.AnnAssign)
    ):
        return
    if isinstance(node, ast.keyword) and node.arg == "strict":
        return  # of a zip: an assertion
    if isinstance(node, ast.UnaryOp) and _called(parent) == "reshape":
        return  # any number below zero is the length that is left
    put = _putter(parent, field, index)
    for kind, changed in _faults(node, parent, field):
        if isinstance(node, ast.Constant):
            kind = f"{kind} in {_shown(parent)}"  # a number alone does not say which is meant
        yield *place, node, kind, changed, put
    for below_field, below_index, below in _items(node):
        yield from _inside(place, node, below_field, below_index, below)


def _putter(parent: ast.AST, field: str, index: int | None) -> Callable[[ast.AST], None]:
    def put(changed: ast.AST) -> None:
        if index is None:
            setattr(parent, field, changed)
        else:
            getattr(parent, field)[index] = changed

    return put


def _is_talk(node: ast.AST) -> bool:
    if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr | ast.Import | ast.ImportFrom):
        return True
    named = node.value if isinstance(node, ast.Expr) else node
    if isinstance(named, ast.Call):
        root = named.func
        while isinstance(root, ast.Attribute):
            root = root.value
        return isinstance(root, ast.Name) and root.id in _TALK
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _faults(node: ast.AST, parent: ast.AST, field: str) -> Iterator[tuple[str, ast.AST]]:
    """Yield the kinds of fault that a node can have, each with the changed node."""
    if isinstance(node, ast.Compare):
        for at, operator in enumerate(node.ops):
            changed = copy.deepcopy(node)
            changed.ops[at] = _COMPARISONS[type(operator)]()
            yield "comparison", changed
    elif isinstance(node, ast.BinOp) and not _is_text(node.left) and not _is_text(node.right):
        if type(node.op) in _ARITHMETIC:
            yield "operator", ast.copy_location(ast.BinOp(node.left, _ARITHMETIC[type(node.op)](), node.right), node)
        if isinstance(node.op, _TERMS):
            yield "term removed", node.left
    elif isinstance(node, ast.AugAssign) and type(node.op) in _ARITHMETIC:
        yield "operator", ast.copy_location(ast.AugAssign(node.target, _ARITHMETIC[type(node.op)](), node.value), node)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub | ast.Invert):
        yield "sign or negation dropped", node.operand
    elif isinstance(node, ast.BoolOp):
        other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield "operator", ast.copy_location(ast.BoolOp(other, node.values), node)
    elif isinstance(node, ast.Constant) and type(node.value) in (bool, int, float) and not 0 < node.value <= _TOLERANCE:
        yield "constant", ast.copy_location(ast.Constant(_off(node.value)), node)
    elif isinstance(node, ast.Call) and len(node.args) > 1 and _called(node) not in _SYMMETRIC:
        if not any(isinstance(one, ast.Starred) for one in node.args[:2]) and not _same(*node.args[:2]):
            changed = copy.copy(node)
            changed.args = [node.args[1], node.args[0], *node.args[2:]]
            yield "arguments swapped", changed
    elif (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Call) and "super" not in ast.unparse(node.value.func)
    ):
        # With the only super() goes what makes the function one of a class, which no other can stand for.
        yield "call dropped", ast.copy_location(ast.Pass(), node)
    if field == "test" and isinstance(parent, ast.If | ast.IfExp | ast.While):
        for value in (True, False) if not isinstance(parent, ast.While) else (False,):
            if not isinstance(node, ast.Constant):
                yield "condition", ast.copy_location(ast.Constant(value), node)


def _same(one: ast.AST, other: ast.AST) -> bool:
    return ast.dump(one) == ast.dump(other)


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _off(value: bool | int | float) -> bool | int | float:
    if isinstance(value, bool):
        return not value
    return value + 1 if isinstance(value, int) else value * 1.5 if value else 1.0
