"""On-disk cache of compiled kernels, keyed by everything that they are compiled from.

A kernel lies in a folder that is named after its module and after the hash of the module's import closure: the syntax
trees, without docstrings and comments, of the module and of all local modules that it imports, directly or not. An edit
elsewhere leaves it valid; an edit of a function that it calls does not. numba's index inside the folder tells
processors, signatures and versions of Python apart, so that hosts which share a folder never load each other's code.

Of several processes that need the same kernel one compiles it, and the others wait for it and load what it stored.
"""

import fcntl
import functools
import hashlib
import logging
import os
import shutil
import stat
import sys
import time
from pathlib import Path

import llvmlite
import numba
import numpy as np
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
from numba.core.runtime import rtsys

from irodori.core.parsed_sources import parsed, recall, store
from irodori.core.provenance import imported_modules, local_sources
from irodori.jit.outside_sources import outside_sources, revision

_LOGGER = logging.getLogger("irodori")
_PACKAGE = Path(__file__).resolve().parents[1]
_DIGITS = 16
#: File, beside the kernels, of what was read out of sources that have not changed.
_SOURCES = "sources.json"
#: States of a module whose kernels are kept, besides every one that was used within the last days.
_KEPT_STATES, _KEPT_S = 2, 14 * 24 * 3600.0


def closure_hash(module: str, root: Path) -> str:
    """Return the hash of a module's import closure: 16 hexadecimal digits.

    Parameters
    ----------
    module : str
        Dotted name.
    root : path
        Folder of the module's top package; what is imported from elsewhere does not count, but for the versions of the
        compiler and of NumPy, and for the files of `irodori.jit.outside_sources`.
    """
    digest = hashlib.sha256(f"{numba.__version__} {llvmlite.__version__} {np.__version__}\n".encode())
    sources = local_sources(module, root)
    if root != _PACKAGE.parent:  # what stands outside the package and uses it
        for name in {used for file in sources.values() for used in imported_modules(file, _PACKAGE.parent)}:
            sources |= local_sources(name, _PACKAGE.parent)
    for name, file in sorted(sources.items()):
        digest.update(f"{name} {parsed(file).code}\n".encode())
    for file in outside_sources(sources):
        digest.update(f"outside {parsed(file).code}\n".encode())
    return digest.hexdigest()[:_DIGITS]


def is_private(folder: Path) -> bool:
    """Return whether nobody but this user and the superuser can have written into a folder, which is no link."""
    try:
        status = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022


def _usable(folder: Path) -> bool:
    """Make a folder for this user alone if it is not there; return whether it is one and can be written."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return False
    return is_private(folder) and os.access(folder, os.W_OK)


@functools.cache
def cache_folder() -> Path | None:
    """Return where compiled kernels are kept, or None, with a warning, where there is no safe place.

    ``NUMBA_CACHE_DIR`` if it is set; else beside the package; else the user's cache folder, which is said when it is
    made. A loaded kernel is executed, so a folder that another user owns or may write into is never taken.
    """
    given = numba.config.CACHE_DIR
    if given and _usable(Path(given)):
        return Path(given)
    if given:
        _LOGGER.warning("NUMBA_CACHE_DIR %s is no folder that only this user can write: it is not used", given)
    if is_private(_PACKAGE) and _usable(_PACKAGE / "__pycache__" / "kernels"):
        return _PACKAGE / "__pycache__" / "kernels"
    import platformdirs

    folder = Path(platformdirs.user_cache_dir("irodori")) / "kernels"
    is_new = not folder.exists()
    if _usable(folder):
        if is_new:
            _LOGGER.warning("%s is not only this user's to write: compiled kernels are kept in %s", _PACKAGE, folder)
        return folder
    _LOGGER.warning("no folder for compiled kernels that only this user can write: every process compiles its own")
    return None


def prune(base: Path, module: str, kept: Path) -> None:
    """Remove folders of earlier states of a module's kernels that were not used for a fortnight, newest two apart."""

    def used(folder: Path) -> float:
        try:
            return folder.stat().st_mtime
        except OSError:  # another process removes it
            return 0.0

    earlier = sorted((f for f in base.glob(f"{module}-{'?' * _DIGITS}") if f != kept), key=used, reverse=True)
    for folder in earlier[_KEPT_STATES:]:
        if time.time() - used(folder) > _KEPT_S:
            shutil.rmtree(folder, ignore_errors=True)


@functools.lru_cache(maxsize=1024)
def _folder_of(module: str, file: str, _revision: int) -> Path | None:
    base = cache_folder()
    if base is None:
        return None
    source = Path(file).resolve()
    depth = module.count(".") + (source.name == "__init__.py")
    parts = source.with_suffix("").parts
    if depth < len(source.parents) and ".".join(parts[len(parts) - depth - 1 :]).removesuffix(".__init__") == module:
        root = source.parents[depth]
    else:  # a script, or a module that was loaded under another name than its file's
        module, root = source.stem, source.parent
    if not _folder_of.cache_info().currsize:
        recall(base / _SOURCES)
    folder = base / f"{module}-{closure_hash(module, root)}"
    store(base / _SOURCES)
    if folder.is_dir():
        os.utime(folder)
    else:
        prune(base, module, folder)
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return folder


class _Locator(_CacheLocator):
    """Locator of numba's cache: the folder says which sources a kernel was compiled from, so that it needs no stamp."""

    def __init__(self, py_func, py_file) -> None:
        self._py_func, self._py_file = py_func, py_file
        self._lineno = py_func.__code__.co_firstlineno
        self._folder = _folder_of(py_func.__module__, py_file, revision())

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(self._folder)

    def get_source_stamp(self):
        """Return nothing that changes: the folder's name holds the hash of the sources."""
        return ""

    def get_disambiguator(self):
        """Return the position of the function in its file, which tells functions of one name apart."""
        return None

    @classmethod
    def from_function(cls, py_func, py_file):
        """Return the locator, or None where kernels cannot be kept."""
        if not os.path.isfile(py_file):
            return None
        made = cls(py_func, py_file)
        return None if made._folder is None else made


class _Implementation(CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012 (as numba declares it)

    def get_filename_base(self, fullname, abiflags):
        """Return the name of a kernel's files: its own, without the line it stands at, which no code depends on."""
        name = self._qualified_name.replace("<", "").replace(">", "")
        return f"{name}-py{sys.version_info[0]}{sys.version_info[1]}{abiflags}"

    def __init__(self, py_func) -> None:
        self._qualified_name = py_func.__qualname__
        super().__init__(py_func)

    def rebuild(self, target_context, payload):
        """Return a stored kernel; one that hashes needs symbols which numba's own functions define when imported."""
        _, _, (machine_code, _) = payload[0]
        if b"_numba_hashsecret" in machine_code:
            target_context.refresh()
        return super().rebuild(target_context, payload)


class KernelCache(FunctionCache):
    """Cache of one kernel, with a lock by which one process compiles while others wait.

    Unlike numba's, it loads without the import of all that numba can compile, 0.4 s of CPU time a process.
    """

    _impl_class = _Implementation

    def __init__(self, py_func) -> None:
        super().__init__(py_func)
        self._lock_file = Path(self._cache_path) / f"{self._impl.filename_base}.lock"
        self._locked: int | None = None

    def load_overload(self, sig, target_context):
        """Return the stored kernel; else None, with the lock held, so that this process compiles it."""
        rtsys.initialize(target_context)  # what compiled code allocates with
        found = self._load_overload(sig, target_context)
        if found is None and self._locked is None:
            self._lock()
            found = self._load_overload(sig, target_context)  # stored while this process waited
            if found is not None:
                self.release()
        return found

    def _lock(self) -> None:
        try:
            descriptor = os.open(self._lock_file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError:  # full or removed disk: compile without company
            return
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        except OSError:  # a file system without locks
            os.close(descriptor)
            return
        self._locked = descriptor

    def release(self) -> None:
        """Let other processes load the kernel, or compile it if this one failed to."""
        if self._locked is not None:
            os.close(self._locked)
            self._locked = None
