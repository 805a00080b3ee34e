"""A working directory with the repository's configuration, and how the tests of configuration change and load it."""

import copy
from pathlib import Path

import pytest
import yaml

from irodori.config.definitions import load_definitions, read_yaml
from irodori.config.loaded import Loaded
from irodori.core.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
PLATE_FILE, CAMERA_FILE, ROOM_FILE = (
    "objects/tile-plate.yaml",
    "cameras/d5100-comb.yaml",
    "environments/classroom.yaml",
)


def put(definition: dict, path: str, value) -> dict:
    """Return a copy with one key changed; `path` is dotted, numbers are indexes, ... removes the key."""
    changed = copy.deepcopy(definition)
    *parents, last = [int(part) if part.isdigit() else part for part in path.split(".")]
    block = changed
    for part in parents:
        block = block[part]
    if value is ...:
        del block[last]
    else:
        block[last] = value
    return changed


def edit(root: Path, file: str, path: str, value) -> None:
    """Change one key of a file as `put` does."""
    target = root / "config" / file
    changed = put(read_yaml(target), path, value)
    target.write_text(yaml.dump(changed, Dumper=yaml.CSafeDumper), encoding="utf-8")


def leaf_paths(value, path=()):
    """Yield the path of every key and item."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield (*path, key)
        yield from leaf_paths(inner, (*path, key))


def load(root: Path, **make) -> Loaded:
    config = read_yaml(root / "config" / "config.yaml")
    config["make"].update(make)
    return load_definitions(config, root)


def fault(root: Path, **make) -> InputError:
    with pytest.raises(InputError) as caught:
        load(root, **make)
    return caught.value
