"""Validation of definitions against their schemas, with defaults filled in and readable error messages.

The schemas are in ``schemas/``. Variants (``oneOf``) are distinguished by their key ``kind``, so that a fault is
reported for the variant that the author chose and not for all of them.
"""

import difflib
import functools
import json
import math
import re
from pathlib import Path

from irodori.core.errors import InputError
from irodori.core.yaml_files import read_own_yaml
from irodori.geometry.shape_blocks import variants

SCHEMA_FOLDER = Path(__file__).resolve().parent / "schemas"
SCHEMAS = ("config", "object", "scene", "camera", "environment", "rig")

_TYPE_WORDS = {
    "string": "text",
    "number": "a number",
    "integer": "a whole number",
    "boolean": "true or false",
    "array": "a list",
    "object": "a block of keys",
}


def validate(instance: dict, schema_name: str, file: Path | str) -> dict:
    """Check one definition and fill in the defaults.

    Parameters
    ----------
    instance : dict
        Content of the file. It is not changed.
    schema_name : str
        One of ``SCHEMAS``.
    file : path
        File of the definition, for the error message.

    Returns
    -------
    dict
        Deep copy with defaults; numbers are float where the schema says number and int where it says integer,
        so that 45 and 45.0 in a file are one and the same definition.

    Raises
    ------
    ValueError
        If `schema_name` is not one of ``SCHEMAS``.
    InputError
        For the most informative fault; the field is a dotted path such as ``objects[1].scale``.
    """
    schema = load_schema(schema_name)
    try:
        _refuse_odd_values(instance, (), file)
        faults = [leaf for error in _validator(schema).iter_errors(instance) for leaf in _leaves(error)]
        if faults:
            raise _input_error(min(faults, key=_rank), schema, instance, file)
        return _complete(schema, instance)
    except RecursionError:
        raise InputError(file, "", "blocks nested too deep", "a plain definition") from None


def schema_faults(instance: dict, schema_name: str, file: Path | str) -> list[InputError]:
    """Return all faults that `validate` finds in a definition, at most one for each field, best messages first."""
    schema = load_schema(schema_name)
    found: dict[str, InputError] = {}
    try:
        _refuse_odd_values(instance, (), file)
        faults = [leaf for error in _validator(schema).iter_errors(instance) for leaf in _leaves(error)]
        for leaf in sorted(faults, key=_rank):
            error = _input_error(leaf, schema, instance, file)
            found.setdefault(error.field, error)
    except InputError as error:
        return [error]
    except RecursionError:
        return [InputError(file, "", "blocks nested too deep", "a plain definition")]
    return list(found.values())


@functools.cache
def load_schema(name: str) -> dict:
    """Return a schema with its references resolved; callers must not change it.

    Raises
    ------
    ValueError
        If there is no schema of that name.
    """
    if name not in SCHEMAS:
        raise ValueError(f"no schema {name!r}; schemas: {', '.join(SCHEMAS)}")
    file = f"{name}.schema.yaml"
    return _inline(_read_schema(file), file)


@functools.cache
def _read_schema(file: str) -> dict:
    return read_own_yaml(SCHEMA_FOLDER / file)


def _inline(node, file: str):
    """Replace references by their targets; keys beside a reference (description, default) take precedence.

    ``{$shapes: object}`` stands for the variants that the registered shapes define.
    """
    if isinstance(node, list):
        return [_inline(item, file) for item in node]
    if not isinstance(node, dict):
        return node
    if "$shapes" in node:
        return _inline(variants(node["$shapes"]), file)
    if isinstance(node.get("$ref"), str):
        other, _, pointer = node["$ref"].partition("#")
        other = other or file
        target = functools.reduce(lambda part, key: part[key], pointer.strip("/").split("/"), _read_schema(other))
        beside = {key: value for key, value in node.items() if key != "$ref"}
        return {**_inline(target, other), **_inline(beside, file)}
    return {key: _inline(value, file) for key, value in node.items()}


def _validator(schema: dict):
    from jsonschema import Draft202012Validator  # slow to import; most jobs read no configuration

    return Draft202012Validator(schema)


def dotted(path) -> str:
    """Return a path of keys and indexes as text: ``("objects", 1, "scale")`` is ``objects[1].scale``."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def suggest(word: str, valid, label: str = "") -> str:
    """Return a hint for an unknown word: ``did you mean 'nearest'? (accepted here: a, b)``, or ``one of a, b``."""
    valid = [str(item) for item in valid]
    near = difflib.get_close_matches(str(word), valid, n=1)
    listing = ", ".join(valid) if valid else "none"
    if near:
        return f"did you mean {near[0]!r}? ({label or 'accepted here'}: {listing})"
    return f"{label}: {listing}" if label else f"one of {listing}"


def _refuse_odd_values(value, path: tuple, file) -> None:
    """Refuse keys that are not text, numbers that are not finite, and paths with ``~``, which only a shell expands."""
    if isinstance(value, dict):
        for key, item in value.items():
            if not isinstance(key, str):
                raise InputError(file, dotted(path), f"the key {key!r}", "keys that are text; put it in quotes")
            _refuse_odd_values(item, (*path, key), file)
    elif isinstance(value, list):
        for index, item in enumerate(value):
            _refuse_odd_values(item, (*path, index), file)
    elif isinstance(value, float) and not math.isfinite(value):
        raise InputError(file, dotted(path), repr(value), "a finite number")
    elif isinstance(value, str) and value.startswith("~/"):
        # A shell replaces it; Snakemake, and another user's home on a cluster, do not.
        raise InputError(file, dotted(path), repr(value), "the folder written out, without ~")


def _branch(schema: dict, instance) -> int | None:
    """Return the index of the variant that the author meant, or None if it is unclear."""
    variants = schema["oneOf"]
    if not isinstance(instance, dict):
        return next(
            (i for i, variant in enumerate(variants) if _validator(variant).is_valid(instance)),
            None,
        )
    kinds = [variant.get("properties", {}).get("kind", {}).get("const") for variant in variants]
    if any(kinds):
        defaults = [variant["properties"]["kind"].get("default") for variant in variants]
        kind = instance.get("kind", next(filter(None, defaults), None))
        return kinds.index(kind) if kind in kinds else None
    shared = [len(instance.keys() & variant.get("properties", {}).keys()) for variant in variants]
    return shared.index(max(shared))


def _leaves(error):
    """Yield the single faults in a validation error; of a ``oneOf`` only those of the variant that was meant."""
    branch = _branch(error.schema, error.instance) if error.validator == "oneOf" else None
    if branch is None:
        yield error
        return
    for inner in error.context:
        if inner.schema_path[0] == branch:
            yield from _leaves(inner)


def _rank(error) -> tuple:
    """Sort key of faults: unknown keys first (a misspelt key is also missing), then wrong values, then missing keys."""
    order = {"additionalProperties": 0, "required": 2}.get(error.validator, 1)
    return order, -len(error.absolute_path), [str(part) for part in error.absolute_path]


def _input_error(error, schema: dict, instance, file) -> InputError:
    path, rules, value = tuple(error.absolute_path), error.schema, error.instance
    at = _at(schema, instance, path)
    if error.validator == "additionalProperties":
        return _unknown_key(path, rules, value, file)
    if error.validator == "required":
        missing = next(key for key in error.validator_value if key not in value)
        wanted = describe(_at(schema, instance, (*path, missing)) or {})
        return InputError(file, dotted((*path, missing)), "no such key", wanted)
    if error.validator == "not":
        path, kind = (*path, rules["not"]["required"][0]), value["kind"]
        return InputError(file, dotted(path), f"a key that the kind {kind!r} does not have", "to leave it out")
    if error.validator == "oneOf" and isinstance(value, dict):
        kinds = [variant["properties"]["kind"]["const"] for variant in rules["oneOf"]]
        found = _found(value["kind"]) if "kind" in value else "no such key"
        return InputError(file, dotted((*path, "kind")), found, suggest(value.get("kind", ""), kinds))
    if error.validator == "enum":
        return InputError(file, dotted(path), _found(value), suggest(value, rules["enum"]))
    if error.validator == "uniqueItems":
        twice = next(item for index, item in enumerate(value) if item in value[:index])
        return InputError(file, dotted(path), f"{_found(twice)} twice", describe(at) + ", each item once")
    return InputError(file, dotted(path), _found(value), describe(at) + _hint(value, at))


def _unknown_key(path: tuple, rules: dict, value: dict, file) -> InputError:
    known, patterns = rules.get("properties", {}), rules.get("patternProperties", {})
    extra = next(key for key in value if key not in known and not any(re.search(p, key) for p in patterns))
    accepted = "a name of small letters, digits and hyphens" if patterns else suggest(extra, known)
    return InputError(file, dotted((*path, extra)), f"the unknown key {extra!r}", accepted)


def _at(schema: dict, instance, path: tuple) -> dict:
    """Return the schema for a path in the instance; an empty one if there is none."""
    for part in path:
        if "oneOf" in schema:
            branch = _branch(schema, instance)
            schema = {} if branch is None else schema["oneOf"][branch]
        if isinstance(part, int):
            schema = schema.get("items", {})
            instance = instance[part]
            continue
        patterns = schema.get("patternProperties", {})
        by_name = [rules for pattern, rules in patterns.items() if re.search(pattern, part)]
        schema = schema.get("properties", {}).get(part) or (by_name[0] if by_name else {})
        instance = instance.get(part) if isinstance(instance, dict) else None
    return schema


def describe(schema: dict) -> str:
    """Return a phrase for what a schema accepts, with its description: ``a number above 0 (Radius, in mm)``."""
    text = accepts(schema)
    about = schema.get("description", "").rstrip(".")
    return f"{text} ({about})" if about else text


def accepts(schema: dict) -> str:
    """Return a phrase for what a schema accepts: ``a number above 0``."""
    if "const" in schema:
        return str(schema["const"])
    if "enum" in schema:
        return "one of " + ", ".join(map(str, schema["enum"]))
    if "oneOf" in schema:
        return ", or ".join(accepts(variant) for variant in schema["oneOf"])
    text = _TYPE_WORDS.get(schema.get("type", ""), "a value")
    if schema.get("type") == "object" and schema.get("properties"):
        kind = schema["properties"].get("kind", {}).get("const")
        return (f"of kind {kind}, " if kind else "") + f"{text} ({', '.join(schema['properties'])})"
    if schema.get("type") == "array":
        return _list_words(schema)
    if "pattern" in schema:
        text += " of small letters, digits and hyphens"
    if schema.get("minLength"):
        text += " that is not empty"
    if schema.get("multipleOf"):
        text += f" divisible by {schema['multipleOf']}"
    return text + _range_words(schema)


def _list_words(schema: dict) -> str:
    low, high = schema.get("minItems", 0), schema.get("maxItems")
    count = f"exactly {low}" if low == high else f"{low} or more" if high is None else f"{low} to {high}"
    return f"a list of {count} items, each {accepts(schema.get('items', {}))}"


def _range_words(schema: dict) -> str:
    low, above = schema.get("minimum"), schema.get("exclusiveMinimum")
    high, below = schema.get("maximum"), schema.get("exclusiveMaximum")
    parts = [f"from {low:.10g}"] if low is not None else [f"above {above:.10g}"] if above is not None else []
    if high is not None:
        parts.append(f"to {high:.10g}" if low is not None else f"up to {high:.10g}")
    elif below is not None:
        parts.append(f"and below {below:.10g}" if parts else f"below {below:.10g}")
    return " " + " ".join(parts) if parts else ""


def _found(value) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, (dict, list)):
        text = json.dumps(value, ensure_ascii=False, default=str)
    else:
        text = str(value).lower() if isinstance(value, bool) else repr(value)
    text = text if len(text) <= 80 else text[:77] + "..."
    return f"the text {text}" if isinstance(value, str) else text


def _hint(value, schema: dict) -> str:
    """Return a hint on YAML 1.1, which reads 1e4 as text and only 1.0e+4 as a number; empty if it does not apply."""
    types = [rules.get("type") for rules in (schema, *schema.get("oneOf", ()))]
    if not isinstance(value, str) or not {"number", "integer"} & set(types):
        return ""
    try:
        number = float(value)
    except ValueError:
        return ""
    written = f"{number:e}" if "e" in value.lower() else value.strip()
    return f"; YAML reads this as text, write {written} without quotes, with a point and a signed exponent"


def _complete(schema: dict, instance):
    """Return a deep copy of a valid instance with its defaults and with the schema's types of numbers."""
    if "oneOf" in schema:
        branch = _branch(schema, instance)
        schema = schema["oneOf"][branch] if branch is not None else {}
    if isinstance(instance, dict):
        patterns = schema.get("patternProperties", {})
        rules: dict[str, dict] = {
            key: next((r for p, r in patterns.items() if re.search(p, key)), {}) for key in instance
        }
        rules.update(schema.get("properties", {}))
        given = {
            key: instance[key] if key in instance else rule["default"]
            for key, rule in rules.items()
            if key in instance or "default" in rule
        }
        return {key: _complete(rules[key], value) for key, value in given.items()}
    if isinstance(instance, list):
        return [_complete(schema.get("items", {}), item) for item in instance]
    if schema.get("type") in ("number", "integer") and not isinstance(instance, bool):
        return float(instance) if schema["type"] == "number" else int(instance)
    return instance
