"""On-disk cache of compiled kernels, with keys that depend on all sources from which they are compiled.

The folder of a kernel is named after its module and the hash of the import closure of the module: the syntax trees,
without docstrings and comments, of the module and all local modules that it imports, directly or indirectly. A kernel
remains valid after edits elsewhere, but not after an edit of a function that it calls. The numba index in the folder
distinguishes processors, signatures and versions of Python, so that computers that share a folder do not load each
other's code. If several processes need the same kernel, one compiles it; the others wait and load the stored code.
"""

import fcntl
import functools
import hashlib
import logging
import os
import re
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
#: File with results of the parsing of source files, for those that have not changed since.
_SOURCES = "sources.json"
#: Number of earlier states of a module whose kernels are kept, and time (s) since the last use until others are
#: removed.
_KEPT_STATES, _KEPT_S = 2, 14 * 24 * 3600.0


def closure_hash(module: str, root: Path) -> str:
    """Return the hash of the import closure of a module: 16 hexadecimal digits.

    Parameters
    ----------
    module : str
        Dotted name.
    root : path
        Folder that contains the top-level package of the module. Of imports from elsewhere, only the versions of numba,
        llvmlite and NumPy, the modules of Irodori, and the files of `irodori.jit.outside_sources` are included.
    """
    digest = hashlib.sha256(f"{numba.__version__} {llvmlite.__version__} {np.__version__}\n".encode())
    sources = local_sources(module, root)
    if root != _PACKAGE.parent:  # a module outside the package that uses it
        for name in {used for file in sources.values() for used in imported_modules(file, _PACKAGE.parent)}:
            sources |= local_sources(name, _PACKAGE.parent)
    for name, file in sorted(sources.items()):
        digest.update(f"{name} {parsed(file).code}\n".encode())
    for file in outside_sources(sources):
        digest.update(f"outside {parsed(file).code}\n".encode())
    return digest.hexdigest()[:_DIGITS]


def is_private(folder: Path) -> bool:
    """Return whether a path is a folder, not a link, into which only this user and the superuser can write."""
    try:
        status = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022


def _usable(folder: Path) -> bool:
    """Create a private folder if it does not exist; return whether it is private and writable."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return False
    return is_private(folder) and os.access(folder, os.W_OK)


@functools.cache
def cache_folder() -> Path | None:
    """Return the folder for compiled kernels; if there is no safe one, log a warning and return None.

    This is ``NUMBA_CACHE_DIR`` if it is set, else a folder in the package, else the cache folder of the user; when the
    latter is created, a warning is logged. Since loaded kernels are executed, a folder that another user owns or can
    write to is never used.
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
    """Remove kernels of earlier states of a module that were not used for two weeks, except the two newest states."""

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
    else:  # a script, or a module that was loaded under another name than that of its file
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
    """Locator for the cache of numba, without a source stamp: the folder name contains a hash of the sources."""

    def __init__(self, py_func, py_file) -> None:
        self._py_func, self._py_file = py_func, py_file
        self._lineno = py_func.__code__.co_firstlineno
        self._folder = _folder_of(py_func.__module__, py_file, revision())

    def get_cache_path(self) -> str:
        """Return the folder of the kernels of the module."""
        return str(self._folder)

    def get_source_stamp(self):
        """Return a constant, as the name of the folder contains the hash of the sources."""
        return ""

    def get_disambiguator(self):
        """Return None: file names do not need the position of a function."""
        return None

    @classmethod
    def from_function(cls, py_func, py_file):
        """Return the locator, or None if kernels cannot be stored."""
        if not os.path.isfile(py_file):
            return None
        made = cls(py_func, py_file)
        return None if made._folder is None else made


class _Implementation(CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012 (as numba declares it)

    def get_filename_base(self, fullname, abiflags):
        """Return the base name of the files of a kernel: its name without its line number, which may change."""
        name = self._qualified_name.replace("<", "").replace(">", "")
        return f"{name}-py{sys.version_info[0]}{sys.version_info[1]}{abiflags}"

    def __init__(self, py_func) -> None:
        self._qualified_name = py_func.__qualname__
        super().__init__(py_func)

    def rebuild(self, target_context, payload):
        """Load a stored kernel; for kernels that use hashes, first load the symbols that numba defines for these."""
        _, _, (machine_code, _) = payload[0]
        if b"_numba_hashsecret" in machine_code:
            target_context.refresh()
        return super().rebuild(target_context, payload)


def _lock(file: Path) -> int | None:
    """Lock a file and return the lock for `_release`; None where files cannot be made or locked."""
    try:
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError:  # full or removed disk
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
    except OSError:
        os.close(descriptor)
        return None  # a file system without locks
    return descriptor


def _release(locked: int | None) -> None:
    if locked is not None:
        os.close(locked)


class KernelCache(FunctionCache):
    """Cache of one kernel, with a lock for each signature, so that one process compiles it while others wait.

    Another lock is held while a kernel is stored, because all signatures share one index. Unlike the cache of numba,
    this one does not import everything that numba can compile, which takes 0.4 s of CPU time.
    """

    _impl_class = _Implementation

    def __init__(self, py_func) -> None:
        super().__init__(py_func)
        self._locks = Path(self._cache_path) / self._impl.filename_base
        self._locked: int | None = None

    def load_overload(self, sig, target_context):
        """Return the stored kernel; if there is none, acquire the lock and return None: the caller then compiles."""
        rtsys.initialize(target_context)  # memory allocation for compiled code
        found = self._load_overload(sig, target_context)
        if found is None and self._locked is None:
            named = re.sub(r" at 0x[0-9a-f]+", "", str(sig))  # addresses differ between processes
            digest = hashlib.blake2b(named.encode(), digest_size=8).hexdigest()
            self._locked = _lock(Path(f"{self._locks}-{digest}.lock"))
            found = self._load_overload(sig, target_context)  # stored while this process waited
            if found is not None:
                self.release()
        return found

    def save_overload(self, sig, data) -> None:
        """Store a kernel and its entry in the index."""
        locked = _lock(Path(f"{self._locks}.lock"))
        try:
            super().save_overload(sig, data)
        finally:
            _release(locked)

    def release(self) -> None:
        """Release the lock, so that other processes can load the kernel, or compile it if this one failed."""
        _release(self._locked)
        self._locked = None
