"""A working directory with the repository's configuration, and how the tests of configuration change and load it."""

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


def edit(root: Path, file: str, path: str, value) -> None:
    """Change one key of a file; `path` is dotted, numbers are indexes, value ... removes the key."""
    target = root / "config" / file
    block = content = read_yaml(target)
    *parents, last = [int(part) if part.isdigit() else part for part in path.split(".")]
    for part in parents:
        block = block[part]
    if value is ...:
        del block[last]
    else:
        block[last] = value
    target.write_text(yaml.safe_dump(content), encoding="utf-8")


def load(root: Path, **make) -> Loaded:
    config = read_yaml(root / "config" / "config.yaml")
    config["make"].update(make)
    return load_definitions(config, root)


def fault(root: Path, **make) -> InputError:
    with pytest.raises(InputError) as caught:
        load(root, **make)
    return caught.value
