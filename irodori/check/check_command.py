"""The subcommand ``check``: all checks of a project that are possible before any long job."""

import argparse
import os
import sys
from collections.abc import Mapping
from itertools import chain
from pathlib import Path

from irodori.check.findings import Finding
from irodori.check.photographs import PhotographCheck
from irodori.check.scenes import of_scene
from irodori.config.definitions import definition_faults, load_definitions
from irodori.config.loaded import Loaded
from irodori.core.errors import InputError
from irodori.core.yaml_files import read_yaml

_CONFIG = "config/config.yaml"


def main(arguments: list[str] | None = None, prog: str = "irodori check") -> int:
    """Check definitions, scenes and photographs, print all errors and warnings, and write no file.

    Photographs that are still to be taken, such as those of the virtual rig, are skipped. The exit status is 1 if there
    is an error, and 0 if there are only warnings or none.
    """
    parser = argparse.ArgumentParser(prog=prog, description=main.__doc__)
    parser.add_argument("--directory", default=".", help="where the paths of definitions start, as that of snakemake")
    parser.add_argument(
        "config", nargs="*", help=f"configurations on top of {_CONFIG}, as snakemake --configfile has them"
    )
    asked = parser.parse_args(arguments)
    os.chdir(asked.directory)
    try:
        loaded = load_project(asked.config)
    except InputError as error:
        faults = project_faults(asked.config) or [error]
        for fault in faults:
            print(Finding(True, str(fault)))
        # Photographs are checked only if the definitions state correctly what they should show.
        print(f"{len(faults)} error{'' if len(faults) == 1 else 's'}; no photograph was looked at")
        return 1
    photographs, errors, warnings = PhotographCheck(loaded), 0, 0
    scenes = (finding for name in loaded.scenes for finding in of_scene(loaded, name))
    for finding in chain(scenes, photographs.findings()):
        print(finding, flush=True)
        errors, warnings = errors + finding.is_error, warnings + (not finding.is_error)
    print(f"{photographs.count} photographs looked at: {errors} errors, {warnings} warnings")
    return 1 if errors else 0


def load_project(files: list[str]) -> Loaded:
    """Load the default configuration, if it exists, overridden by further files as Snakemake merges them.

    Raises
    ------
    InputError
        For the first fault.
    """
    config, names = _project(files)
    return load_definitions(config, Path(), names)


def project_faults(files: list[str]) -> list[InputError]:
    """Return all faults of definitions and tables, see `irodori.config.definitions.definition_faults`."""
    try:
        config, names = _project(files)
    except InputError as error:
        return [error]
    return definition_faults(config, Path(), names)


def _project(files: list[str]) -> tuple[dict, list[str]]:
    """Return a project's configuration, merged, and the files that it is merged from."""
    names = [*([_CONFIG] if Path(_CONFIG).is_file() else []), *(file for file in files if Path(file) != Path(_CONFIG))]
    config: dict = {}
    for name in names:
        config = _merged(config, read_yaml(Path(name)))
    return config, names


def _merged(old: Mapping, new: Mapping) -> dict:
    """Return a configuration overridden by another, as Snakemake merges files: mappings by key, lists as a whole."""
    both = dict(old)
    for key, value in new.items():
        is_block = isinstance(value, Mapping) and isinstance(both.get(key), Mapping)
        both[key] = _merged(both[key], value) if is_block else value
    return both


if __name__ == "__main__":
    sys.exit(main())
