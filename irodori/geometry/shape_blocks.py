"""Schema variants of the key ``shape``, read from the files of the shapes without importing them.

Only the standard library is imported, so that the Snakefile can use this module quickly. The file of a shape has its
variants of the key ``shape`` as the literal ``SCHEMA``, and the literal ``IS_FLAT``.
"""

import ast
import functools
from pathlib import Path
from typing import NamedTuple

_FOLDER = Path(__file__).resolve().parent / "shapes"


class _Block(NamedTuple):
    schema: dict[str, dict]  # variant of the key by the name of the schema, ``object`` or ``scene``
    is_flat: bool

    @property
    def name(self) -> str:
        return next(iter(self.schema.values()))["properties"]["kind"]["const"]


_outside: list[_Block] = []


def add_block(schema: dict[str, dict], is_flat: bool) -> None:
    """Register the schema variants of a shape from outside the package; call it before any definition is read."""
    _outside.append(_Block(schema, is_flat))


@functools.cache
def _own() -> list[_Block]:
    found = []
    for file in sorted(_FOLDER.glob("*.py")):
        literals = {}
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) in ("SCHEMA", "IS_FLAT"):
                literals[ast.unparse(node.targets[0])] = ast.literal_eval(node.value)
        if literals:
            found.append(_Block(literals["SCHEMA"], literals["IS_FLAT"]))
    return found


def variants(of: str) -> list[dict]:
    """Return the variants of the key ``shape`` in a schema.

    Parameters
    ----------
    of : {"object", "scene"}
        The schema: of photographed objects, or of scenes with bodies.
    """
    return [block.schema[of] for block in [*_own(), *_outside] if of in block.schema]


def outside_schema(name: str) -> dict | None:
    """Return the schema variant of a shape from outside the package, by its name; None if there is none."""
    found = [variant for block in _outside if block.name == name for variant in block.schema.values()]
    return found[0] if found else None


def is_flat(name: str) -> bool:
    """Return whether the shape with this name is flat: lies in one plane and has only one visible side.

    Raises
    ------
    ValueError
        If the name is unknown.
    """
    known = {block.name: block.is_flat for block in [*_own(), *_outside]}
    if name not in known:
        raise ValueError(f"unknown shape {name!r}; accepted: {', '.join(known)}")
    return known[name]
