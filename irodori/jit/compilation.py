"""Decorators that compile the package's loops: `njit`, `uncounted` and `cfunc`.

Every module takes them from here, so that what they set holds for all loops of the package: whole vectors of the
machine, calls of copies of their own, and the cache of `irodori.jit.kernel_cache`.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numba
from llvmlite import binding
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher, cpu_target

from irodori.jit.kernel_cache import KernelCache, cache_folder


def use_whole_vectors() -> None:
    """Let loops that are compiled from now on use vectors of 512 bits where the processor has them.

    LLVM keeps to 256 on server processors, which once slowed their clocks for longer vectors. The loops of the fit take
    half the time with 512. Without effect elsewhere, and where ``NUMBA_CPU_FEATURES`` is set.
    """
    if numba.config.CPU_FEATURES is None:
        features = binding.get_host_cpu_features()
        if features.get("avx512f"):
            numba.config.CPU_FEATURES = f"{features.flatten()},-prefer-256-bit"


class _SeparateCopies(JITCodeLibrary):
    """Compiled code that calls the copies of other functions that it was compiled with.

    numba links them as weak symbols: of all copies that a process holds the one loaded first serves every caller, and
    copies differ in the last place of their results by what was optimised around them. A process that compiles, which
    holds each function alone as well, then computed other bits than one that reads its loops from the disk.
    """

    def _optimize_final_module(self) -> None:
        for function in self._final_module.functions:
            # Functions of numba's runtime keep their names: passes that count references look for them.
            weak = function.linkage == binding.Linkage.linkonce_odr and not function.is_declaration
            if weak and function.name.startswith("_ZN"):
                function.linkage = binding.Linkage.internal
        super()._optimize_final_module()


@contextmanager
def _separate_copies(codegen) -> Iterator[None]:
    """Make the libraries that are compiled meanwhile `_SeparateCopies`; others of the process stay as they are."""
    with global_compiler_lock:
        usual = codegen._library_class
        codegen._library_class = _SeparateCopies
        try:
            yield
        finally:
            codegen._library_class = usual


class Kernel(CPUDispatcher):
    """A compiled function of this package: it is kept by `irodori.jit.kernel_cache` and calls its own copies."""

    def enable_caching(self) -> None:
        """Keep what is compiled, where there is a place for it."""
        if cache_folder() is not None:
            self._cache = KernelCache(self.py_func)

    def compile(self, sig):
        """Load or compile the function for a signature."""
        with _separate_copies(self.targetctx.codegen()):
            try:
                return super().compile(sig)
            finally:
                if isinstance(self._cache, KernelCache):
                    self._cache.release()


def njit(function=None, *, cache=False, boundscheck=None, **options):
    """Return a `Kernel` of a function, or a decorator that makes one; the options are those of ``numba.njit``."""
    if function is None:
        return lambda decorated: njit(decorated, cache=cache, boundscheck=boundscheck, **options)
    if numba.config.DISABLE_JIT:
        return function
    kernel = Kernel(function, targetoptions={"nopython": True, "boundscheck": boundscheck, **options})
    if cache:
        kernel.enable_caching()
    return kernel


def cfunc(signature, **options):
    """Return ``numba.cfunc(signature, ...)``, which calls its own copies of other functions as kernels do."""

    def made(function):
        with _separate_copies(cpu_target.target_context.codegen()):
            return numba.cfunc(signature, **options)(function)

    return made


def uncounted(**options):
    """Return `njit` for a function that allocates nothing: no references to its arrays are counted.

    A loop that hands tuples of arrays from function to function otherwise spends most of its time counting. What such
    a function calls for the first time is compiled in the same way, so it may call only what allocates nothing and
    returns numbers: an array that such a function makes is never freed, one that it returns too early elsewhere.
    """
    return njit(cache=True, _nrt=False, **options)


use_whole_vectors()
