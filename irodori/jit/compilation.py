"""Decorators that compile the package's loops: `njit`, `uncounted` and `cfunc`.

Every module takes them from here, so that what they set holds for all loops of the package: whole vectors of the
machine, calls of copies of their own, and the cache of `irodori.jit.kernel_cache`.
"""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

import numba
from llvmlite import binding
from numba import _dynfunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Flags, compile_extra
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import _FunctionCompiler
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.sigutils import normalize_signature

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


#: Packages whose compiled functions, kernels apart, are parts of kernels only; bodies of parallel loops are dynamic.
_NEVER_CALLED_BY_PYTHON = ("numba", "<dynamic>", "irodori")


class _Library(JITCodeLibrary):
    """Compiled code; its declarations of what is defined elsewhere are not handed to the optimiser one by one."""

    def _optimize_functions(self, ll_module) -> None:
        ll_module.data_layout = self._codegen._data_layout
        for function in ll_module.functions:
            if not function.is_declaration:
                manager, builder = self._codegen._function_pass_manager()
                manager.run(function, builder)


class _SeparateCopies(_Library):
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


class _ForLinking(_Library):
    """Code that is only ever linked into that of a caller, and optimised and turned into machine code there."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


@contextmanager
def _uncollected() -> Iterator[None]:
    """Leave Python's collector of cycles off: the compiler leaves few, and it took an eighth of the compiling time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@contextmanager
def _libraries(codegen, kind: type) -> Iterator[None]:
    """Make the libraries that are compiled meanwhile of a kind; others of the process stay as they are."""
    with global_compiler_lock:
        usual = codegen._library_class
        codegen._library_class = kind
        try:
            yield
        finally:
            codegen._library_class = usual


@contextmanager
def _only_linked(context) -> Iterator[None]:
    """Neither optimise nor turn into machine code, on their own, the parts of a kernel that is compiled meanwhile.

    numba does so with its own functions, and up to three times with the body of a parallel loop: alone, in a wrapper,
    and in the kernel that it is linked into, the only one that needs it.
    """
    usual = context.get_executable

    def executable(library, description, environment):
        if type(library) is _ForLinking:
            package, name = description.modname.partition(".")[0], description.qualname.split(".")[-1]
            if package in _NEVER_CALLED_BY_PYTHON:
                return _dynfunc.make_function(description.lookup_module(), name, "", 0, environment, (library,))
            library.__class__ = _SeparateCopies
        return usual(library, description, environment)

    context.get_executable = executable
    try:
        with _libraries(context.codegen(), _ForLinking):
            yield
    finally:
        context.get_executable = usual


class _KernelCompiler(_FunctionCompiler):
    """Compiler of what Python calls: one library of machine code, whatever the function calls."""

    def _compile_core(self, args, return_type):
        flags = Flags()
        self.targetdescr.options.parse_as_flags(flags, self.targetoptions)
        flags.no_cfunc_wrapper = True
        context = self.targetdescr.target_context
        library = context.codegen().create_library(self.py_func.__qualname__)
        library.enable_object_caching()
        with _only_linked(context):
            return compile_extra(
                self.targetdescr.typing_context, context, self.py_func, args, return_type, flags, self.locals, library,
                self.pipeline_class,
            )  # fmt: skip


class _InnerCompiler(_FunctionCompiler):
    """Compiler of functions that other compiled functions call: no wrappers for Python, no machine code."""

    def _compile_core(self, args, return_type):
        flags = Flags()
        self.targetdescr.options.parse_as_flags(flags, self.targetoptions)
        flags.no_cpython_wrapper = flags.no_cfunc_wrapper = flags.no_compile = True
        context = self.targetdescr.target_context
        library = _ForLinking(context.codegen(), self.py_func.__qualname__)
        library.enable_object_caching()
        return compile_extra(
            self.targetdescr.typing_context, context, self.py_func, args, return_type, flags, self.locals, library,
            self.pipeline_class,
        )  # fmt: skip


class Kernel(CPUDispatcher):
    """A compiled function of this package.

    What Python calls is kept by `irodori.jit.kernel_cache` and calls its own copies of other functions. A kernel that
    another one calls is compiled as a part of it: numba would first optimise it, turn it into machine code and wrap it
    for Python on its own, at every level of calls anew, which made half of the time that a fit took to compile.
    """

    _depth = 0  # of kernels being compiled, one within the other; the compiler's lock is held meanwhile

    def __init__(self, *given, **options) -> None:
        super().__init__(*given, **options)
        given_to_compiler = (
            self.py_func, self.targetdescr, self.targetoptions, self._compiler.locals, self._compiler.pipeline_class  # type: ignore[has-type]
        )  # fmt: skip
        self._compiler = _KernelCompiler(*given_to_compiler)
        self._inner_compiler = _InnerCompiler(*given_to_compiler)
        self._parts: set[tuple] = set()  # argument types for which the function is a part of others only
        self._kept = False

    def enable_caching(self) -> None:
        """Keep what is compiled, where there is a place for it; found when something is, for most kernels are parts."""
        self._kept = True

    def compile(self, sig):
        """Load or compile the function for a signature."""
        with global_compiler_lock:
            if Kernel._depth and not self.targetoptions.get("parallel"):
                return self._compile_part(sig)
            if self._kept and not isinstance(self._cache, KernelCache) and cache_folder() is not None:  # type: ignore[has-type]
                self._cache = KernelCache(self.py_func)
            args, _ = normalize_signature(sig)
            if tuple(args) in self._parts:  # now Python calls it
                self._parts.remove(tuple(args))
                del self.overloads[tuple(args)]
            Kernel._depth += 1
            try:
                with _libraries(self.targetctx.codegen(), _SeparateCopies), _uncollected():
                    return super().compile(sig)
            finally:
                Kernel._depth -= 1
                if isinstance(self._cache, KernelCache):
                    self._cache.release()

    def _compile_part(self, sig):
        """Compile the function as a part of the kernel that is being compiled."""
        args, return_type = normalize_signature(sig)
        args = tuple(args)
        if args not in self.overloads:
            with self._compiling_counter:
                result = self._inner_compiler.compile(args, return_type)
            result = result._replace(entry_point=_Part())
            self.targetctx.insert_user_function(result.entry_point, result.fndesc, [result.library])
            self.overloads[args] = result
            self._parts.add(args)
        return self.overloads[args].entry_point


class _Part:
    """Stand-in for the address of a function that has none."""


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
        with global_compiler_lock:
            Kernel._depth += 1
            try:
                with _libraries(cpu_target.target_context.codegen(), _SeparateCopies), _uncollected():
                    return numba.cfunc(signature, **options)(function)
            finally:
                Kernel._depth -= 1

    return made


def uncounted(*, cache=True, **options):
    """Return `njit` for a function that allocates nothing: no references to its arrays are counted.

    A loop that hands tuples of arrays from function to function otherwise spends most of its time counting, with
    operations that two threads do in turn. What such a function calls for the first time is compiled in the same way,
    so it may call only what allocates nothing. It may make views; it returns them, or what holds them, only to another
    uncounted function, for elsewhere they would be given up too early. An array that it allocates is never freed.
    """
    return njit(cache=cache, _nrt=False, **options)


use_whole_vectors()
