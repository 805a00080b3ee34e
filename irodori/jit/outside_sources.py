"""Source files outside the package for which kernels are specialised; they become a part of the cache key."""

from pathlib import Path

_files: dict[str, list[Path]] = {}


def add_outside_source(registry: str, file: Path) -> None:
    """Add a file to the cache keys of kernels in modules that import a registry, directly or indirectly.

    Parameters
    ----------
    registry : str
        Dotted name of the module through which kernels use the contents of the file.
    file : path
    """
    _files.setdefault(registry, []).append(file)


def outside_sources(modules) -> list[Path]:
    """Return the files added for any of the modules (registries), given by dotted names, in the order of addition."""
    return [file for registry, files in _files.items() if registry in modules for file in files]


def revision() -> int:
    """Return a number that changes whenever a file is added."""
    return sum(map(len, _files.values()))
