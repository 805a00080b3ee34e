"""Sources outside the package that compiled loops are specialised on: their kernels are kept apart from all others."""

from pathlib import Path

_files: dict[str, list[Path]] = {}


def add_outside_source(registry: str, file: Path) -> None:
    """Key the kernels of modules that import a registry, directly or not, by a further file from now on.

    Parameters
    ----------
    registry : str
        Dotted name of the module through which kernels learn of what the file holds.
    file : path
    """
    _files.setdefault(registry, []).append(file)


def outside_sources(modules) -> list[Path]:
    """Return the files that some modules, by their dotted names, were told of, in the order in which they came."""
    return [file for registry, files in _files.items() if registry in modules for file in files]


def revision() -> int:
    """Return a number that changes with every file that is added."""
    return sum(map(len, _files.values()))
