"""Hashes of the code, configuration and files behind a result."""

import functools
import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path

from irodori.core.parsed_sources import imports_of

_ROOT = Path(__file__).resolve().parents[2]
_DIGITS = 16
_TEXTS = ("templates", "page")  # folders of a package with files that become part of its output


@functools.cache
def code_hash(*modules: str, root: Path = _ROOT) -> str:
    """Return one hash over the sources of modules and of all local modules that they import, directly or not.

    The templates, parts of pages and tables of a package among them are included. The sources are parsed, not imported.
    The result is cached, because the code does not change while a workflow is planned.

    Parameters
    ----------
    *modules : str
        Dotted names, such as ``irodori.fitting``. Modules in the root are local. If other packages are installed in the
        root, only the module's own top-level package and this one are local.
    root : path
        Folder of the top packages: the repository, or where this package is installed.

    Returns
    -------
    str
        16 hexadecimal digits.

    Raises
    ------
    ValueError
        If there is no such module.
    """
    digest = hashlib.sha256()
    sources = {name: file for module in modules for name, file in _closure(module, root, _unchanged_imports).items()}
    for name, file in sorted(sources.items()):
        # A package without __init__ has no file here, and no parts or tables either.
        for part in (file, *(_beside(file.parent) if file.name == "__init__.py" else ())):
            status = part.stat()
            digest.update(f"{name}\0{_content_hash(part, status.st_mtime_ns, status.st_size)}\n".encode())
    return digest.hexdigest()[:_DIGITS]


def _beside(package: Path) -> list[Path]:
    """Return the templates, parts of pages and tables of a package."""
    parts = [f for f in package.glob("*/*") if f.is_file() and f.parent.name in _TEXTS]
    return sorted([*parts, *package.glob("*.h5")])


@functools.lru_cache(maxsize=4096)
def _content_hash(file: Path, _modified_ns: int, _size: int) -> str:
    """Return the SHA-256 of a file, cached because the stages of a workflow share most of their sources."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def local_sources(module: str, root: Path = _ROOT) -> dict[str, Path]:
    """Return {dotted name: file} of a module and of all local modules that it imports, directly or not.

    Raises
    ------
    ValueError
        If there is no such module.
    """
    return _closure(module, Path(root), _imports)


def _closure(module: str, root: Path, imports: Callable[[str, Path, Path], list[str]]) -> dict[str, Path]:
    """Return `local_sources`, given the function (module, file, root) that returns the imported local modules."""
    if not _exists(module, root):
        top = module.partition(".")[0]
        known = sorted(".".join(file.relative_to(root).with_suffix("").parts) for file in root.glob(f"{top}/**/*.py"))
        known = [name.removesuffix(".__init__") for name in known]
        raise ValueError(f"no module {module!r}; modules: {', '.join(known) or 'none'}")
    own = {module.partition(".")[0], __name__.partition(".")[0]} if _holds_installed_packages(root) else None
    found: dict[str, Path] = {}
    seen: set[str] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        # Importing a submodule runs the __init__ of the packages around it.
        if "." in name:
            waiting.append(name.rpartition(".")[0])
        file = _file(name, root)
        if file is not None:
            found[name] = file
            waiting += [other for other in imports(name, file, root) if own is None or other.partition(".")[0] in own]
    return found


def modules_of(package: str, root: Path = _ROOT) -> list[str]:
    """Return the dotted names of all modules of a package, sorted."""
    files = (file.relative_to(root).with_suffix("") for file in sorted(Path(root, package).rglob("*.py")))
    return [".".join(file.parts).removesuffix(".__init__") for file in files]


@functools.cache
def _holds_installed_packages(root: Path) -> bool:
    """Whether a folder contains installed packages, so that a package beside this one, such as numpy, is not local."""
    return next(root.glob("*.dist-info"), None) is not None


def _file(module: str, root: Path) -> Path | None:
    base = os.path.join(root, *module.split("."))
    # Planning calls this thousands of times; strings are several times as fast as Path objects.
    return next((Path(file) for file in (f"{base}/__init__.py", f"{base}.py") if os.path.isfile(file)), None)


def _exists(module: str, root: Path) -> bool:
    """Whether there is such a module or package; a package need not have an ``__init__``."""
    return _file(module, root) is not None or (bool(module) and os.path.isdir(os.path.join(root, *module.split("."))))


def imported_modules(file: Path, root: Path) -> list[str]:
    """Return the modules in the root that a file outside of it imports directly."""
    return _imports(file.stem, file, root)


def _imports(name: str, file: Path, root: Path) -> list[str]:
    """Return the local modules that a file imports at any place, except under ``if TYPE_CHECKING:``."""
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    wanted = []
    for level, module, names in imports_of(file):
        base = module
        if level:
            parents = package.split(".")
            parents = parents[: len(parents) - level + 1]
            base = ".".join([*parents, module] if module else parents)
        # What follows "import" may be a submodule or a name inside the module.
        wanted += [base, *(f"{base}.{name}" for name in names)]
    return [module for module in wanted if _exists(module, root)]


#: Cached, because stages share most imports; `code_hash` may assume that no source changes in between.
_unchanged_imports = functools.cache(_imports)


def config_hash(obj) -> str:
    """Return the hash of a configuration: 16 hexadecimal digits of its canonical JSON.

    The order of keys, a list or a tuple, and 45 or 45.0 make no difference. Paths count as their text.

    Raises
    ------
    TypeError
        If a value cannot be represented in JSON.
    ValueError
        If a number is not finite.
    """
    text = json.dumps(_canonical(obj), sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()[:_DIGITS]


def _canonical(value):
    if isinstance(value, dict):
        for key in value:
            if not isinstance(key, str):
                raise TypeError(f"the key {key!r} is not text")
        return {key: _canonical(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_canonical(item) for item in value]
    if isinstance(value, float) and value.is_integer():
        return int(value)
    return str(value) if isinstance(value, Path) else value
