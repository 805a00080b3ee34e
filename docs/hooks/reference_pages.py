"""Reference pages, made from the package: what every command prints as its help, and the docstrings of every room.

Docstrings are read from the source, so that nothing is imported for them; the help is that of the commands themselves.
"""

import ast
import contextlib
import io
import os
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

_SECTIONS = ("Parameters", "Returns", "Yields", "Raises", "Attributes", "Notes", "Examples")
_PACKAGE = "irodori"
_COLUMNS = "100"
#: At the head of a page: a search finds the documents that people wrote first.
_FOUND_LATER = "---\nsearch:\n  boost: 0.2\n---\n\n"


class Room(NamedTuple):
    """A folder of the package, or its root: name of its page, title, and its modules."""

    name: str
    title: str
    modules: tuple[Path, ...]


def rooms(root: Path) -> list[Room]:
    """Return the rooms of the package at the top of a repository, by name."""
    package = root / _PACKAGE
    folders = sorted(path for path in package.iterdir() if (path / "__init__.py").exists())
    own = tuple(sorted(path for path in package.glob("*.py") if not path.name.startswith("__")))
    found = [Room(path.name, f"{_PACKAGE}.{path.name}", tuple(sorted(path.rglob("*.py")))) for path in folders]
    return [Room("root", _PACKAGE, own), *found]


# ---- commands


def commands_page() -> str:
    """Return the page of all commands: the help of ``irodori`` and of each of its subcommands."""
    from irodori.command_line import SUBCOMMANDS

    lines = [
        "# Commands",
        "",
        "What every command prints with `--help`. Without an installation, `python -m irodori` stands for `irodori`;",
        "the workflow itself is run by `snakemake`.",
        "",
        "## irodori",
        "",
        *_help_block([]),
    ]
    for name, subcommand in SUBCOMMANDS.items():
        lines += [f"## irodori {name}", "", f"{subcommand.help[0].upper()}{subcommand.help[1:]}.", ""]
        lines += _help_block([name])
    return "\n".join(lines)


def _help_block(words: list[str]) -> list[str]:
    return ["```text", _help_of(words).strip(), "```", ""]


def _help_of(words: list[str]) -> str:
    """Return what the command prints with these words and ``--help``."""
    from irodori.command_line import main

    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = _COLUMNS
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
            main([*words, "--help"])
    finally:
        if before is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = before
    return said.getvalue()


# ---- docstrings


def package_pages(root: Path) -> dict[str, str]:
    """Return the Markdown of every page of the package by name; ``index`` lists the rooms."""
    found = rooms(root)
    pages = {room.name: _room_page(room, root) for room in found}
    rows = [f"| [`{room.title}`]({room.name}.md) | {_about(room, root)} |" for room in found]
    head = "# The package\n\nMade from the docstrings. Names with an underscore in front are their module's own.\n"
    return {"index": "\n".join([head, "| room | holds |", "|---|---|", *rows, ""]), **pages}


def _about(room: Room, root: Path) -> str:
    file = root / _PACKAGE / ("" if room.name == "root" else room.name) / "__init__.py"
    return markdown(_parsed(file)[1].partition("\n\n")[0]).replace("\n", " ").replace("|", "\\|")


def _room_page(room: Room, root: Path) -> str:
    parts = [f"{_FOUND_LATER}# {room.title}", ""]
    for file in room.modules:
        tree, about = _parsed(file)
        dotted = ".".join(file.relative_to(root).with_suffix("").parts).removesuffix(".__init__")
        if file.name == "__init__.py" and file.parent.parent == root / _PACKAGE:
            parts += [markdown(about), ""]
            continue
        parts += [f"## {dotted}", "", markdown(about), ""]
        for node in _public(tree.body):
            parts += _entry("###", node.name, node)
            if isinstance(node, ast.ClassDef):
                for method in _public(node.body):
                    parts += _entry("####", f"{node.name}.{method.name}", method)
    return "\n".join(parts)


def _parsed(file: Path) -> tuple[ast.Module, str]:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return tree, ast.get_docstring(tree) or ""


def _public(body: list[ast.stmt]) -> Iterator[ast.FunctionDef | ast.ClassDef]:
    """Yield the documented public functions and classes of a module's or a class's body."""
    for node in body:
        named = isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")
        if named and ast.get_docstring(node):
            yield node


def _entry(level: str, name: str, node: ast.FunctionDef | ast.ClassDef) -> list[str]:
    """Return what a page shows of a function, a class or a method: how it is called, and its docstring."""
    return [f"{level} {name}", "", "```python", _signature(node), "```", "", markdown(ast.get_docstring(node)), ""]


def _signature(node: ast.FunctionDef | ast.ClassDef) -> str:
    if isinstance(node, ast.FunctionDef):
        returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
        return f"{node.name}({ast.unparse(node.args)}){returns}"
    bases = ", ".join(map(ast.unparse, node.bases))
    return f"class {node.name}" + (f"({bases})" if bases else "")


def markdown(docstring: str) -> str:
    """Return a docstring in numpy's style as Markdown: its sections as lists, names as code."""
    lines, out, at = docstring.splitlines(), [], 0
    while at < len(lines):
        if lines[at] in _SECTIONS and at + 1 < len(lines) and set(lines[at + 1]) == {"-"}:
            end = at + 2
            while end < len(lines) and not (end + 1 < len(lines) and set(lines[end + 1]) == {"-"}):
                end += 1
            out += ["", f"**{lines[at]}**", "", *_section(lines[at], lines[at + 2 : end]), ""]
            at = end
        else:
            out.append(_inline(lines[at]))
            at += 1
    return "\n".join(out)


def _section(name: str, lines: list[str]) -> list[str]:
    """Return a section: items with what stands indented under them, or text as it is."""
    if name in ("Notes", "Examples"):
        text = "\n".join(lines).strip("\n")
        return ["```python", text, "```"] if ">>>" in text else [_inline(line) for line in text.splitlines()]
    items: list[list[str]] = []
    for line in lines:
        if line and not line.startswith(" "):
            items.append([line])
        elif line.strip() and items:
            items[-1].append(line)
    out = []
    for head, *rest in items:
        about = _inline(textwrap.dedent("\n".join(rest)).replace("\n", " "))
        title, colon, kind = head.partition(" : ")
        shown = f"`{title}`, {_inline(kind)}" if colon else _inline(head)
        out.append(f"- {shown}" + (f": {about}" if about else ""))
    return out


def _inline(text: str) -> str:
    """Return a line of a docstring with its code in single backquotes and nothing that Markdown takes for a tag."""
    text = re.sub(r"``(.+?)``", r"`\1`", text)
    pieces = re.split(r"(`[^`]*`)", text)
    return "".join(p if p.startswith("`") else p.replace("<", "&lt;").replace("](", "] (") for p in pieces)
