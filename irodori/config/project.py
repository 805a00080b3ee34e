"""Configuration of a project: the default file, overridden by further files as Snakemake merges them."""

import argparse
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from irodori.config.definitions import definition_faults, load_definitions, load_one
from irodori.config.loaded import Loaded
from irodori.core.errors import InputError
from irodori.core.yaml_files import read_yaml

__all__ = [
    "DEFAULT_FILE",
    "add_configfile",
    "configuration_files",
    "definitions_folder",
    "inside",
    "load_named",
    "load_project",
    "project_faults",
]

#: The default configuration, which further files override.
DEFAULT_FILE = "config/config.yaml"


def add_configfile(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--configfile`` to a command that also takes a name, which the option must not take as a file."""
    parser.add_argument(
        "--configfile",
        action="append",
        default=[],
        metavar="FILE",
        help=f"configuration on top of {DEFAULT_FILE}, as snakemake has it; may be given several times",
    )


def configuration_files(files: Sequence[str]) -> list[str]:
    """Return the default configuration, if it exists, and then further files."""
    default = [DEFAULT_FILE] if Path(DEFAULT_FILE).is_file() else []
    return default + [file for file in files if Path(file) != Path(DEFAULT_FILE)]


def load_project(files: list[str]) -> Loaded:
    """Load the default configuration, if it exists, overridden by further files as Snakemake merges them.

    Raises
    ------
    InputError
        For the first fault.
    """
    config, names = _project(files)
    return load_definitions(config, Path(), names)


def load_named(kind: str, name: str, files: Sequence[str] = ()) -> Loaded:
    """Load one definition of a project, and those that it requires; see `irodori.config.definitions.load_one`."""
    config, names = _project(files)
    return load_one(kind, name, file=names[0], config=config)


def definitions_folder(files: Sequence[str] = ()) -> Path:
    """Return the folder of a project's definitions.

    Raises
    ------
    InputError
        If a configuration cannot be read.
    """
    return Path(str(_project(files)[0].get("definitions", "config")))


def project_faults(files: list[str]) -> list[InputError]:
    """Return all faults of definitions and tables, see `irodori.config.definitions.definition_faults`."""
    try:
        config, names = _project(files)
    except InputError as error:
        return [error]
    return definition_faults(config, Path(), names)


def _project(files: Sequence[str]) -> tuple[dict, list[str]]:
    """Return a project's configuration, merged, and the files that it is merged from."""
    names = configuration_files(files) or [DEFAULT_FILE]
    config: dict = {}
    for name in names:
        config = _merged(config, read_yaml(Path(name)))
    return config, names


@contextmanager
def inside(directory: str) -> Iterator[None]:
    """Make a project's folder the working directory within the context.

    Raises
    ------
    InputError
        If there is no such folder.
    """
    before = os.getcwd()
    try:
        os.chdir(directory)
    except OSError as error:
        raise InputError(directory, "", error.strerror or str(error), "the folder of a project") from None
    try:
        yield
    finally:
        os.chdir(before)


def _merged(old: Mapping, new: Mapping) -> dict:
    """Return a configuration overridden by another, as Snakemake merges files: mappings by key, lists as a whole."""
    both = dict(old)
    for key, value in new.items():
        is_block = isinstance(value, Mapping) and isinstance(both.get(key), Mapping)
        both[key] = _merged(both[key], value) if is_block else value
    return both
