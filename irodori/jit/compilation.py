"""Decorators that compile the loops of the package: `njit`, `uncounted` and `cfunc`.

All modules use these instead of those of numba, so that the same settings apply to all loops: the full vector width of
the processor, calls of own copies of inlined functions, and the cache of `irodori.jit.kernel_cache`.
"""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

import numba
import numpy as np
from llvmlite import binding
from numba import _dynfunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Flags, compile_extra
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import _FunctionCompiler
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.sigutils import normalize_signature

from irodori.core.frame_memory import with_room_for_calls
from irodori.jit.kernel_cache import KernelCache, cache_folder


def use_whole_vectors() -> None:
    """Make the compiler use vectors of 512 bits from now on if the processor has them.

    LLVM limits vectors to 256 bits on server processors, because early ones reduced their clock rate for longer
    vectors. With 512 bits the loops of the fit take half the time. There is no effect on other processors, or if
    ``NUMBA_CPU_FEATURES`` is set.
    """
    if numba.config.CPU_FEATURES is None:
        features = binding.get_host_cpu_features()
        if features.get("avx512f"):
            numba.config.CPU_FEATURES = f"{features.flatten()},-prefer-256-bit"


#: Packages whose compiled functions, except kernels, are used only within kernels. The module name of bodies of
#: parallel loops is ``<dynamic>``.
_NEVER_CALLED_BY_PYTHON = ("numba", "<dynamic>", "irodori")
#: New objects from which on the garbage collector is spared them; a kernel that is loaded makes fewer.
_MANY = 100_000


class _Library(JITCodeLibrary):
    """Compiled code; function passes of the optimiser run only on defined functions, not on declarations."""

    def _optimize_functions(self, ll_module) -> None:
        ll_module.data_layout = self._codegen._data_layout
        for function in ll_module.functions:
            if not function.is_declaration:
                manager, builder = self._codegen._function_pass_manager()
                manager.run(function, builder)

    def finalize(self) -> None:
        self._linking_libraries: list = [_Alone(library) for library in _called(self._linking_libraries)]
        super().finalize()


class _SeparateCopies(_Library):
    """Compiled code that always calls the copies of other functions with which it was compiled.

    numba links such copies as weak symbols: of all copies in a process, the one loaded first is used by all callers.
    The last digits of results can differ between copies, since each is optimised with its surrounding code. Without
    this class, a process that compiles could obtain slightly different results than one that loads stored kernels.
    """

    def _optimize_final_module(self) -> None:
        for function in self._final_module.functions:
            # Functions of the numba runtime keep their linkage: the passes for reference counting need their names.
            weak = function.linkage == binding.Linkage.linkonce_odr and not function.is_declaration
            if weak and function.name.startswith("_ZN"):
                function.linkage = binding.Linkage.internal
        super()._optimize_final_module()


class _ForLinking(_Library):
    """Code that is only linked into kernels, where it is optimised and converted to machine code.

    It contains none of the functions that it calls: with them, a function would be copied once for each level of calls
    between it and the kernel. Only what others compile with numba, and not with this package, is given all together.
    """

    _together = None  # the module with all that it calls, for others

    def finalize(self) -> None:
        self._raise_if_finalized()
        self._finalize_dynamic_globals()
        self._finalized = True

    def module_alone(self):
        """Return the module of the function itself."""
        return super()._get_module_for_linking()

    def _get_module_for_linking(self):
        if self._together is None:
            self._together = self.module_alone().clone()
            for library in _called(self._linking_libraries):
                self._together.link_in(_Alone(library)._get_module_for_linking(), preserve=True)
        return self._together


class _Alone:
    """Stand-in for a library to be linked: without what it calls if that is linked as well, see `_called`."""

    def __init__(self, library) -> None:
        self._library = library
        self._reload_init = library._reload_init

    def _get_module_for_linking(self):
        library = self._library
        return library.module_alone() if isinstance(library, _ForLinking) else library._get_module_for_linking()


def _called(libraries: list) -> list:
    """Return libraries and all that those of them call which are only linked, each once and after all of its callers.

    Of a function that nothing calls yet, the linker keeps nothing.
    """
    found: dict = {}

    def add(library) -> None:
        if library not in found:
            if isinstance(library, _ForLinking):
                for called in library._linking_libraries:
                    add(called)
            found[library] = None

    for library in libraries:
        add(library)
    return list(reversed(found))


@contextmanager
def _uncollected() -> Iterator[None]:
    """Disable garbage collection; it takes an eighth of the compilation time, and the compiler makes few cycles."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            _keep_what_is_new()
            gc.enable()


def _keep_what_is_new() -> None:
    """Spare the garbage collector a look at all that the compiler has made, which stays and would take a tenth more.

    It joins the oldest objects, or those that are never looked at if the process has set some apart.
    """
    if gc.get_count()[0] > _MANY:
        some_are_apart = gc.get_freeze_count() > 0
        gc.freeze()
        if not some_are_apart:
            gc.unfreeze()


@contextmanager
def _libraries(codegen, kind: type) -> Iterator[None]:
    """Use a class of library for code that is compiled within the context; other code is not affected."""
    with global_compiler_lock:
        usual = codegen._library_class
        codegen._library_class = kind
        try:
            yield
        finally:
            codegen._library_class = usual


@contextmanager
def _only_linked(context) -> Iterator[None]:
    """Compile parts of a kernel within the context for linking only, without separate optimisation and machine code.

    numba would generate machine code for each of its own functions, and up to three times for the body of a parallel
    loop: separately, in a wrapper, and in the kernel. Only the one in the kernel is needed.
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
    """Compiler of functions that Python calls: all functions that they call are compiled into one library."""

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
    """Compiler of functions that only compiled functions call: without wrappers for Python and machine code."""

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

    Functions called by Python are stored by `irodori.jit.kernel_cache` and call their own copies of other functions. A
    kernel that is called by another one is compiled as a part of it. numba would also optimise it, convert it to
    machine code and make a Python wrapper, at each level of calls; this took half of the compilation time of a fit.
    """

    _depth = 0  # nesting depth of kernels being compiled; changed only while the compiler lock is held

    def __init__(self, *given, **options) -> None:
        super().__init__(*given, **options)
        given_to_compiler = (
            self.py_func, self.targetdescr, self.targetoptions, self._compiler.locals, self._compiler.pipeline_class  # type: ignore[has-type]
        )  # fmt: skip
        self._compiler = _KernelCompiler(*given_to_compiler)
        self._inner_compiler = _InnerCompiler(*given_to_compiler)
        self._parts: set[tuple] = set()  # argument types for which the function is a part of others only
        self._kept = False
        self._resolved: dict = {}

    def enable_caching(self) -> None:
        """Store compiled code on disk if possible; the folder is determined at the first compilation from Python."""
        self._kept = True

    @with_room_for_calls
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

    def resolved(self, *arguments):
        """Return the compiled function that a call with arguments of these types runs.

        numba determines the types of nested tuples anew in every call, which takes milliseconds. A call of the returned
        function does not, but all its arguments must have the same types.
        """
        form = tuple(map(_form, arguments))
        if form not in self._resolved:
            self._resolved[form] = self.compile(tuple(map(numba.typeof, arguments)))
        return self._resolved[form]

    def _compile_part(self, sig):
        """Compile the function as a part of the kernel that is currently compiled."""
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


def _form(argument):
    """Return a hashable value that differs between arguments whose types differ for numba."""
    if isinstance(argument, tuple):
        return type(argument), *map(_form, argument)
    if isinstance(argument, np.ndarray):
        flags = argument.flags
        return argument.dtype, argument.ndim, flags.c_contiguous, flags.f_contiguous, flags.writeable, flags.aligned
    return type(argument) if isinstance(argument, int | float | np.generic) else numba.typeof(argument)


class _Part:
    """Placeholder for the address of a function that has none."""


def njit(function=None, *, cache=False, boundscheck=None, **options):
    """Make a `Kernel` of a function, or return a decorator that does so; options are those of ``numba.njit``."""
    if function is None:
        return lambda decorated: njit(decorated, cache=cache, boundscheck=boundscheck, **options)
    if numba.config.DISABLE_JIT:
        return function
    kernel = Kernel(function, targetoptions={"nopython": True, "boundscheck": boundscheck, **options})
    if cache:
        kernel.enable_caching()
    return kernel


def cfunc(signature, **options):
    """Return the decorator ``numba.cfunc(signature, ...)`` for code that calls its own copies of functions."""

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
    """Return the decorator `njit` for a function that allocates nothing, without reference counting of arrays.

    Otherwise loops that pass tuples of arrays between functions spend most of their time on reference counting, with
    atomic operations for which threads wait. Functions that are first compiled for such a function are also compiled
    without counting, so it may call only functions that do not allocate. It may make views of arrays, but may return
    them only to another uncounted function: elsewhere they would be freed too early. An array that it allocates is
    never freed.
    """
    return njit(cache=cache, _nrt=False, **options)


use_whole_vectors()
# LLVM looks back over up to 100 instructions for what a load from memory reads. For kernels whose functions hand on
# tuples by address, which load them field by field, this took a third of the compilation; 20 give code as fast.
binding.set_option("", "-memdep-block-scan-limit=20")
