"""Generator of the dataclasses of `irodori.config.models` and of the tables in config/README.md from the schemas.

Run ``python -m irodori.config.write_models`` after a change of a schema; a test fails until then. The title of a block
in a schema is the name of its class, and the title of a choice of blocks (``oneOf``) is the name of their union. Blocks
with the same title must agree in keys and types. A ``$comment`` appears only in the README, not in messages.
"""

import re
import textwrap
from pathlib import Path
from typing import NamedTuple

from irodori.config.definition import field_name
from irodori.config.validation import SCHEMAS, accepts, load_schema
from irodori.core.errors import InputError

MODELS = Path(__file__).with_name("models.py")
README = Path(__file__).parents[2] / "config" / "README.md"

_HEAD = '''"""Definitions as dataclasses, one for each block of the schemas beside this module.

Written by ``python -m irodori.config.write_models``; change the schemas instead.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from irodori.config.definition import Definition
'''
_SCALARS = {"string": "str", "number": "float", "integer": "int", "boolean": "bool"}
_WIDTH = 120
#: Classes with another name than their schema: the class Environment is the light itself, as maps.
_CLASSES = {"environment": "EnvironmentDefinition"}
#: Longest list with a type that states the number of items; the type of a spectrum would fill a page.
_COUNTED = 16
_OPTIONAL = "optional"


class _Field(NamedTuple):
    """Type, default and description of a key; type and default as source, the default empty for a required key."""

    kind: str
    default: str
    about: str


class _Class(NamedTuple):
    """Docstring and fields of a dataclass."""

    about: str
    fields: dict[str, _Field]


# ---- the dataclasses


def models_text() -> str:
    """Return the source of `irodori.config.models`.

    Raises
    ------
    ValueError
        If two blocks with the same title differ, or a block has no title.
    """
    found: dict[str, _Class | str] = {}
    for name in SCHEMAS:
        _type_of({**load_schema(name), "title": _CLASSES.get(name, name.capitalize())}, found)
    parts: list[str] = [_HEAD]
    before: _Class | str = ""
    for name, what in found.items():
        text = f"{name}: TypeAlias = {what}\n" if isinstance(what, str) else _class_text(name, what)
        parts.append("\n" if isinstance(what, str) and isinstance(before, str) and before else "\n\n")
        parts.append(text)
        before = what
    return "".join(parts)


def _type_of(schema: dict, found: dict) -> str:
    """Return the Python type of a schema; add its classes, inner ones first, to ``found``."""
    if "const" in schema:
        return f'Literal["{schema["const"]}"]'
    if "enum" in schema:
        return f"Literal[{', '.join(_quoted(value) for value in schema['enum'])}]"
    if "oneOf" in schema:
        about = schema.get("description", "")
        union = " | ".join(_type_of({"description": about, **one}, found) for one in schema["oneOf"])
        return _named_union(schema["title"], union, found) if "title" in schema else union
    if isinstance(schema["type"], list):
        return " | ".join(_SCALARS[one] for one in schema["type"])
    if schema["type"] == "array":
        inner, count = _type_of(schema["items"], found), schema.get("maxItems", 0)
        fixed = schema.get("minItems") == count and count <= _COUNTED
        return f"tuple[{', '.join([inner] * count)}]" if fixed and count else f"tuple[{inner}, ...]"
    if schema["type"] != "object":
        return _SCALARS[schema["type"]]
    if "patternProperties" in schema:
        (inner,) = schema["patternProperties"].values()
        return f"Mapping[str, {_type_of(inner, found)}]"
    return _class_of(schema, found)


def _named_union(title: str, union: str, found: dict) -> str:
    if found.setdefault(title, union) != union:
        raise ValueError(f"two choices have the title {title} and not the same kinds")
    return title


def _class_of(schema: dict, found: dict) -> str:
    title = schema.get("title", "")
    if not title.isidentifier():
        raise ValueError(f"a block of keys without the name of its class as title: {', '.join(schema['properties'])}")
    fields = {}
    for key, rules in schema["properties"].items():
        kind, default = _type_of(rules, found), ""
        if "default" in rules or "const" in rules:
            default = _literal(rules.get("default", rules.get("const")), rules)
        elif key not in schema.get("required", ()):
            kind, default = f"{kind} | None", _OPTIONAL
        fields[field_name(key)] = _Field(kind, default, rules["description"])
    kind = schema["properties"].get("kind", {})
    about = kind["description"] if "const" in kind else schema["description"]
    known = found.setdefault(title, _Class(about, fields)).fields
    if {name: field.kind for name, field in known.items()} != {name: field.kind for name, field in fields.items()}:
        raise ValueError(f"two blocks have the title {title} and not the same keys and types")
    for name, field in known.items():
        if field.default != fields[name].default:  # the class has only defaults that all its uses share
            known[name] = field._replace(default="")
    return title


def _literal(value, rules: dict) -> str:
    if "oneOf" in rules:
        kinds = rules["oneOf"]
        if isinstance(value, dict):
            rules = next(k for k in kinds if value.keys() <= k["properties"].keys()
                         and value.get("kind") == k["properties"].get("kind", {}).get("const"))  # fmt: skip
        else:
            return _quoted(value)
    if isinstance(value, dict):
        if "patternProperties" in rules:
            return "mapping"
        inner = (f"{key}={_literal(item, rules['properties'][key])}" for key, item in value.items() if key != "kind")
        return f"{rules['title']}({', '.join(inner)})"
    if isinstance(value, list):
        items = [_literal(item, rules["items"]) for item in value]
        return f"({', '.join(items)}{',' if len(items) == 1 else ''})"
    return repr(float(value)) if rules.get("type") == "number" else _quoted(value)


def _quoted(value) -> str:
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _class_text(name: str, what: _Class) -> str:
    lines = [
        "@dataclass(frozen=True, kw_only=True, repr=False, eq=False)",
        f"class {name}(Definition):",
        *_doc(what.about),
    ]
    for key, (kind, default, about) in what.fields.items():
        lines += ["", *_wrapped(about, "    #: "), *_field_lines(key, kind, default)]
    return "\n".join(lines) + "\n"


def _wrapped(text: str, indent: str) -> list[str]:
    return textwrap.wrap(text, _WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)


def _doc(about: str) -> list[str]:
    line = f'    """{about.rstrip(".")}."""'
    if len(line) <= _WIDTH:
        return [line]
    first, _, rest = re.split(r"([.;]) ", about, maxsplit=1)
    return [f'    """{first}.', "", *_wrapped(rest[0].upper() + rest[1:], "    "), '    """']


def _field_lines(key: str, kind: str, default: str) -> list[str]:
    mapping = kind.startswith("Mapping")
    if default == _OPTIONAL:
        value = " = None"
    elif default == "mapping":
        value = " = field(default_factory=dict, hash=False)"
    elif mapping:
        value = " = field(hash=False)"
    else:
        value = f" = {default}" if default else ""
    line = f"    {key}: {kind}{value}"
    if len(line) <= _WIDTH:
        return [line]
    head, _, inner = kind.partition("[")
    words, _, more = inner.rpartition("]")
    if len(f"        {words}") <= _WIDTH:
        return [f"    {key}: {head}[", f"        {words}", f"    ]{more}{value}"]
    return [f"    {key}: {head}[", *(f"        {word}," for word in words.split(", ")), f"    ]{more}{value}"]


# ---- the tables of the README


def readme_text(readme: str) -> str:
    """Return the text of config/README.md with the tables of all schemas inserted between their marks.

    Raises
    ------
    InputError
        If the marks of a table are missing.
    """
    for name in SCHEMAS:
        begin, end = f"<!-- keys of {name} -->\n", f"<!-- end of keys of {name} -->\n"
        if begin not in readme or end not in readme:
            raise InputError(README.name, "", f"no marks of the table of {name}", f"{begin.strip()} ... {end.strip()}")
        head, rest = readme.split(begin, 1)
        readme = f"{head}{begin}\n{key_table(name)}\n{end}{rest.split(end, 1)[1]}"
    return readme


def key_table(name: str) -> str:
    """Return a Markdown table of all keys of a schema, **required** ones in bold, with defaults, values and meaning."""
    rows = ["| key | default | accepts | what |", "|---|---|---|---|"]
    return "\n".join(rows + [f"| {' | '.join(row)} |" for row in _rows(load_schema(name), "")]) + "\n"


def _rows(schema: dict, path: str):
    """Yield (key, default, accepted values, meaning) of every key in a block, as cells of the table."""
    for key, rules in schema["properties"].items():
        yield from _rows_of_key(rules, f"{path}{key}", key in schema.get("required", ()))


def _rows_of_key(rules: dict, path: str, needed: bool):
    inner, at = rules, path
    while inner.get("type") == "array" and inner["items"].get("type", "object") == "object":
        inner, at = inner["items"], f"{at}[]"
    if "patternProperties" in inner:
        (inner,), at = inner["patternProperties"].values(), f"{at}.NAME"
    blocks = [kind for kind in inner.get("oneOf", ()) if kind.get("type") == "object"]
    blocks = blocks or ([inner] if "properties" in inner else [])
    default = f"`{_yaml(rules['default'])}`" if "default" in rules else ""
    words = accepts(rules) if not blocks else _block_words(rules, inner)
    shown = f"**`{path}`**" if needed else f"`{path}`"
    yield shown, default, _cell(words), _cell(" ".join(rules.get(key, "") for key in ("description", "$comment")))
    for block in blocks:
        kind = block["properties"].get("kind", {}).get("const")
        if kind is not None:
            yield f"`{at}.kind`", "", f"`{kind}`", _cell(block["properties"]["kind"]["description"])
            block = {**block, "properties": {k: v for k, v in block["properties"].items() if k != "kind"}}
        yield from _rows(block, f"{at}.")


def _block_words(rules: dict, inner: dict) -> str:
    words = "one of the kinds below" if len(inner.get("oneOf", ())) > 1 else "the keys below"
    if rules.get("type") == "array":
        return f"a list of {rules.get('minItems', 0)} to {rules['maxItems']}, each {words}"
    return f"by name, each {words}" if "patternProperties" in rules else words


def _yaml(value) -> str:
    """Return a value in the notation of a YAML file."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_yaml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_yaml, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return re.sub(r"^(\d+)e", r"\1.0e", repr(value)) if isinstance(value, float) else str(value)


def _cell(text: str) -> str:
    return text.strip().rstrip(".").replace("|", "\\|").replace("*", "\\*")


def main() -> None:
    """Write `irodori/config/models.py` and the tables of config/README.md."""
    MODELS.write_text(models_text(), encoding="utf-8")
    README.write_text(readme_text(README.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
