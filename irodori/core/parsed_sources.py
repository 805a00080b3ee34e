"""Imports and code hashes of Python sources, cached between processes by the hash of each source's content."""

import ast
import hashlib
import json
import sys
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from irodori.core.atomic_files import written_whole

#: Most sources in the cache; the latest are kept.
_MOST = 4000


class ImportStatement(NamedTuple):
    """Import statement: ``from ..module import names`` with ``level`` dots, or ``import module`` without names."""

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
    """Return the imports of a Python file and the hash of its code.

    Raises
    ------
    OSError
        If it cannot be read.
    SyntaxError
        If it is not valid Python.
    """
    status = file.stat()
    return _parsed(file, status.st_mtime_ns, status.st_size)


def imports_of(file: Path) -> tuple[ImportStatement, ...]:
    """Return the imports of a Python file, as `parsed` does, but in a fraction of the time if they are not cached."""
    status = file.stat()
    return _imports_of(file, status.st_mtime_ns, status.st_size)


def _key(content: bytes) -> str:
    """Return the cache key of a source: Python's version, on which the syntax tree depends, and the content's hash."""
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
    """Yield a node and all statements below it, except those under ``if TYPE_CHECKING:``, which never run."""
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
    """Transformer that removes the docstrings of a syntax tree."""

    def _strip(self, node):
        self.generic_visit(node)
        first = node.body[0] if node.body else None
        if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str):
            node.body = node.body[1:] or [ast.Pass()]
        return node

    visit_Module = visit_ClassDef = visit_FunctionDef = visit_AsyncFunctionDef = _strip


def recall(file: Path) -> None:
    """Load the cache that an earlier process stored; a file that is absent or damaged counts as empty."""
    try:
        stored = json.loads(file.read_bytes())
        for key, (imports, code) in stored.items():
            statements = tuple(ImportStatement(level, module, tuple(names)) for level, module, names in imports)
            _known.setdefault(key, Source(statements, code))
    except (OSError, ValueError, TypeError, AttributeError):
        return


def store(file: Path) -> None:
    """Add newly parsed sources to the stored cache; if the file cannot be written, it is left as it is."""
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
