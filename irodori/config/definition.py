"""Base class of all definitions: frozen dataclasses made from validated mappings.

`irodori.config.models` has the classes themselves, generated from the schemas by `irodori.config.write_models`.
"""

import dataclasses
import functools
import json
import types
import typing
from collections.abc import Mapping
from keyword import iskeyword
from typing import Any, Self, Union

from irodori.geometry.shape_blocks import outside_schema

__all__ = ["Definition", "as_plain", "check_choices", "field_name", "typed"]


def field_name(key: str) -> str:
    """Return the name of the attribute for a key: the key itself, with an underscore if Python reserves the word."""
    return f"{key}_" if iskeyword(key) else key


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Definition:
    """Base class of the blocks of a definition; the attribute of an optional key that is absent is None.

    Comparison, hash and text are defined here once: generated for each of a hundred classes, they would take half of
    the import time of `irodori.config.models` in every job of a run.
    """

    def _values(self) -> tuple:
        return tuple(getattr(self, field.name) for field in dataclasses.fields(self))

    def __eq__(self, other: object) -> bool:
        """Return whether another definition is of the same class and has the same values."""
        return self._values() == other._values() if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        """Return a hash of the values."""
        return hash(self._values())

    def __repr__(self) -> str:
        """Return the name of the class with its values by name."""
        named = (f"{field.name}={getattr(self, field.name)!r}" for field in dataclasses.fields(self))
        return f"{type(self).__qualname__}({', '.join(named)})"

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Self:
        """Return the definition for a mapping that `irodori.config.validation.validate` has returned.

        Parameters
        ----------
        given : mapping
            Keys and values as in the file; blocks inside it become the dataclasses of their kinds, lists become tuples.

        Raises
        ------
        ValueError
            If a key is unknown, a required one is missing or no variant of a block fits. Ranges are checked by the
            schema and not here.
        """
        own: Any = cls
        types_of = _types_of(own)
        kind = cls.__dict__.get("kind")
        if kind is not None and given.get("kind", kind) != kind:
            raise ValueError(f"{cls.__name__} is of the kind {kind!r}, not {given['kind']!r}")
        unknown = [key for key in given if field_name(key) not in types_of]
        if unknown:
            raise ValueError(f"{cls.__name__} has no key {unknown[0]!r}; its keys: {', '.join(_keys_of(own))}")
        missing = [key for key in _needed_keys(own) if key not in given]
        if missing:
            raise ValueError(f"{cls.__name__} needs the key {missing[0]!r}")
        return cls(**{field_name(key): typed(types_of[field_name(key)], value) for key, value in given.items()})

    def given(self) -> dict[str, Any]:
        """Return {key of the file: value}, including defaults; absent keys are omitted."""
        values = [(field, getattr(self, field.name)) for field in dataclasses.fields(self)]
        return {field.name.rstrip("_"): value for field, value in values if value is not None}

    def plain(self) -> dict[str, Any]:
        """Return keys and values as in a file, with every default written out and absent keys omitted."""
        return {key: as_plain(value) for key, value in self.given().items()}


def check_choices(options: Definition) -> None:
    """Refuse a value that is none of its field's choices, for callers from Python, whom no schema checks.

    Raises
    ------
    ValueError
    """
    own: Any = type(options)
    for name, kind in _types_of(own).items():
        value, choices = getattr(options, name), typing.get_args(kind)
        if typing.get_origin(kind) is typing.Literal and value not in choices:
            raise ValueError(f"{name} {value!r}; accepted: {', '.join(choices)}")


def as_plain(value: Any) -> Any:
    """Return a definition, or a container of definitions, as mappings, lists and scalars for JSON."""
    if isinstance(value, Definition):
        return value.plain()
    if isinstance(value, Mapping):
        return {key: as_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [as_plain(item) for item in value]
    return value


@functools.cache
def _types_of(cls: Any) -> dict[str, Any]:
    return typing.get_type_hints(cls)


@functools.cache
def _keys_of(cls: Any) -> tuple[str, ...]:
    return tuple(name.rstrip("_") for name in _types_of(cls))


@functools.cache
def _needed_keys(cls: Any) -> tuple[str, ...]:
    missing = dataclasses.MISSING
    fields = dataclasses.fields(cls)
    return tuple(f.name.rstrip("_") for f in fields if f.default is missing and f.default_factory is missing)


def typed(kind: Any, value: Any) -> Any:
    """Convert a value from a file to a type: a definition, a union of some, or tuples and mappings of these.

    Raises
    ------
    ValueError
        As for `Definition.of`.
    """
    if isinstance(value, Definition):
        return value
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin in (Union, types.UnionType):
        return _variant(value, parts)
    if isinstance(kind, type) and issubclass(kind, Definition):
        return kind.of(value)
    if isinstance(value, list | tuple) and origin is tuple:
        return tuple(typed(parts[0], item) for item in value)
    if isinstance(value, Mapping) and origin is Mapping:
        return {key: typed(parts[1], item) for key, item in value.items()}
    return value


@functools.cache
def _outside_class(title: str, schema: str) -> Any:
    """Return the dataclass of a shape that was registered from outside the package."""
    block, needed, others = json.loads(schema), [], []
    for key, rules in block["properties"].items():
        if "const" in rules or "default" in rules or key not in block.get("required", ()):
            others.append((field_name(key), Any, dataclasses.field(default=rules.get("const", rules.get("default")))))
        else:
            needed.append((field_name(key), Any))
    return dataclasses.make_dataclass(
        title, [*needed, *others], bases=(Definition,), frozen=True, kw_only=True, repr=False, eq=False
    )


def _variant(value: Any, parts: tuple[Any, ...]) -> Any:
    """Convert a value to the member of a union that has its ``kind``, or otherwise fits its keys."""
    blocks: list[Any] = [part for part in parts if isinstance(part, type) and issubclass(part, Definition)]
    if not isinstance(value, Mapping):
        plain = [part for part in parts if part not in blocks]
        return typed(plain[0], value) if len(plain) == 2 and type(None) in plain else value
    if len(blocks) == 1:
        return blocks[0].of(value)
    for block in blocks:
        kind = block.__dict__.get("kind", None)
        if kind is not None and value.get("kind", None) not in (kind, None):
            continue
        if set(_needed_keys(block)) <= set(value) <= set(_keys_of(block)):
            return block.of(value)
    outside = outside_schema(value.get("kind", ""))
    if outside is not None:
        return _outside_class(outside["title"], json.dumps(outside)).of(value)
    kinds = ", ".join(str(block.__dict__.get("kind", block.__name__)) for block in blocks)
    raise ValueError(f"{value!r} fits none of the kinds {kinds}")
