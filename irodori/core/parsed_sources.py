"""Imports and executed code of source files, remembered from process to process by the files' content."""

import ast
import hashlib
import json
import sys
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from irodori.core.atomic_files import written_whole

#: Sources that are remembered, at most; the latest stay.
_MOST = 4000


class ImportStatement(NamedTuple):
    """One import: ``from LEVEL dots MODULE import NAMES``; without names, ``import MODULE``."""

    level: int
    module: str
    names: tuple[str, ...]


class Source(NamedTuple):
    """Imports of a source file, and the hash of its syntax tree without docstrings and comments."""

    imports: tuple[ImportStatement, ...]
    code: str


#: Fields of a syntax tree's nodes that hold statements; most of a tree is expressions, which hold none.
_STATEMENTS = ("body", "handlers", "orelse", "finalbody", "cases")

_known: dict[str, Source] = {}
_new: set[str] = set()


def parsed(file: Path) -> Source:
    """Return what a Python file imports and the hash of what it executes.

    Raises
    ------
    OSError
        If it cannot be read.
    SyntaxError
        If it is no Python.
    """
    status = file.stat()
    return _parsed(file, status.st_mtime_ns, status.st_size)


def imports_of(file: Path) -> tuple[ImportStatement, ...]:
    """Return what a Python file imports, as `parsed` does, at a fraction of the time where nothing is remembered."""
    status = file.stat()
    return _imports_of(file, status.st_mtime_ns, status.st_size)


def _key(content: bytes) -> str:
    """Return under which name a text is remembered: its syntax tree differs between versions of Python."""
    return f"{sys.version_info[0]}.{sys.version_info[1]} {hashlib.sha256(content).hexdigest()}"


@lru_cache(maxsize=4096)
def _imports_of(file: Path, _modified_ns: int, _size: int) -> tuple[ImportStatement, ...]:
    content = file.read_bytes()
    known = _known.get(_key(content))
    return known.imports if known else tuple(_imports(ast.parse(content, filename=str(file))))


@lru_cache(maxsize=4096)
def _parsed(file: Path, _modified_ns: int, _size: int) -> Source:
    content = file.read_bytes()
    key = _key(content)
    if key not in _known:
        tree = ast.parse(content, filename=str(file))
        imports = tuple(_imports(tree))
        code = hashlib.sha256(ast.dump(_WithoutDocstrings().visit(tree)).encode()).hexdigest()
        _known[key] = Source(imports, code)
        _new.add(key)
    return _known[key]


def _imports(tree: ast.AST) -> Iterator[ImportStatement]:
    for node in _executed(tree):
        if isinstance(node, ast.Import):
            yield from (ImportStatement(0, alias.name, ()) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield ImportStatement(node.level, node.module or "", tuple(alias.name for alias in node.names))


def _executed(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield all statements under a node but those under ``if TYPE_CHECKING:``, which no run comes to."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
            waiting += node.orelse
        else:
            for field in _STATEMENTS:
                waiting += getattr(node, field, ())


class _WithoutDocstrings(ast.NodeTransformer):
    """Remove docstrings, so that only what is executed is left of a syntax tree."""

    def _strip(self, node):
        self.generic_visit(node)
        first = node.body[0] if node.body else None
        if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str):
            node.body = node.body[1:] or [ast.Pass()]
        return node

    visit_Module = visit_ClassDef = visit_FunctionDef = visit_AsyncFunctionDef = _strip


def recall(file: Path) -> None:
    """Read what an earlier process stored; a file that is absent or damaged counts as empty."""
    try:
        stored = json.loads(file.read_bytes())
        for key, (imports, code) in stored.items():
            statements = tuple(ImportStatement(level, module, tuple(names)) for level, module, names in imports)
            _known.setdefault(key, Source(statements, code))
    except (OSError, ValueError, TypeError, AttributeError):
        return


def store(file: Path) -> None:
    """Store what was parsed since, beside what others have stored; a file that cannot be written is left as it is."""
    if not _new:
        return
    recall(file)
    latest = dict(list(_known.items())[-_MOST:])
    try:
        with written_whole(file) as temporary:
            temporary.write_text(json.dumps(latest), encoding="utf-8")
    except OSError:
        return
    _new.clear()
