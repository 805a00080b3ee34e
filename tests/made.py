"""Definitions for tests, made of the keys that a test is about."""

import dataclasses
import types
import typing
from collections.abc import Mapping, Sequence

from irodori.config.definition import Definition, field_name, typed
from irodori.config.models import Scene, Size

_SCENE = {"environment": "light", "image": {"width": 1, "height": 1}, "views": {}, "objects": []}


def made(kind, value):
    """Return a definition of a kind, or of one of a union's; needed keys that a test does not give are None.

    A sequence or a mapping of definitions is made item by item; what is a definition already stays as it is. Keys of
    what is no definition are a TypeError.
    """
    if value is None or isinstance(value, Definition):
        return value
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin is tuple or (isinstance(origin, type) and issubclass(origin, Sequence)):
        return tuple(made(parts[0], one) for one in value)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {name: made(parts[1], one) for name, one in value.items()}
    if origin in (typing.Union, types.UnionType) and not isinstance(value, Mapping):
        kept = [one for one in parts if one is not types.NoneType]
        return made(kept[0], value) if len(kept) == 1 else value
    blocks = [one for one in (parts or (kind,)) if isinstance(one, type) and issubclass(one, Definition)]
    if not isinstance(value, Mapping):
        return typed(kind, value)
    if not blocks:
        raise TypeError(f"{kind} is no definition; accepted: one of irodori.config, or a union of some")
    fitting = [one for one in blocks if set(map(field_name, value)) <= set(one.__dataclass_fields__)]
    if len(blocks) > 1 and "kind" in value:
        fitting = [one for one in blocks if getattr(one, "kind", None) == value["kind"]]
        if not fitting:
            return typed(kind, value)
    (cls, *_) = fitting or blocks
    if not set(map(field_name, value)) <= set(cls.__dataclass_fields__):
        return cls.of(value)  # which says what is unknown
    value = (_SCENE if cls is Scene else {}) | dict(value)
    if cls is Size:
        value = {key: int(size) for key, size in value.items()}
    hints = typing.get_type_hints(cls)
    given = {field_name(key): made(hints[field_name(key)], item) for key, item in value.items()}
    absent = [f.name for f in dataclasses.fields(cls) if f.default is f.default_factory is dataclasses.MISSING]
    return cls(**dict.fromkeys(absent) | given)
