"""Compiler support: vector width of the machine, private copies of called functions, C libraries.

Every module takes `njit` from here, so that what is set below holds for all loops of the package.

numba cannot cache code that holds the address of a C function; here the address is an argument, so the compiled
loops are kept on disk and shared by every process.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import numba
import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Flags, compile_extra
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import _FunctionCompiler
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.sigutils import normalize_signature
from numba.extending import intrinsic

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


class _ForLinking(JITCodeLibrary):
    """Code that is only ever linked into that of a caller, and optimised and turned into machine code there."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


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
        self._inner_compiler = _InnerCompiler(
            self.py_func, self.targetdescr, self.targetoptions, self._compiler.locals, self._compiler.pipeline_class
        )
        self._parts: set[tuple] = set()  # argument types for which the function is a part of others only

    def enable_caching(self) -> None:
        """Keep what is compiled, where there is a place for it."""
        if cache_folder() is not None:
            self._cache = KernelCache(self.py_func)

    def compile(self, sig):
        """Load or compile the function for a signature."""
        with global_compiler_lock:
            if Kernel._depth and not self.targetoptions.get("parallel"):
                return self._compile_part(sig)
            args, _ = normalize_signature(sig)
            if tuple(args) in self._parts:  # now Python calls it
                self._parts.remove(tuple(args))
                del self.overloads[tuple(args)]
            Kernel._depth += 1
            try:
                with _libraries(self.targetctx.codegen(), _SeparateCopies):
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
    """What stands for the address of a function that has none."""


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
                with _libraries(cpu_target.target_context.codegen(), _SeparateCopies):
                    return numba.cfunc(signature, **options)(function)
            finally:
                Kernel._depth -= 1

    return made


def c_function(result, *arguments):
    """Return a function for compiled code that calls a C function by its address.

    Parameters
    ----------
    result, *arguments : numba types
        The C signature; pointers are ``types.uintp``.

    Returns
    -------
    callable ``(address, *arguments) -> result``, in nopython code only
    """

    def call(typingctx, address, *values):
        signature = result(types.uintp, *arguments)

        def codegen(context, builder, signature, values):
            c_arguments = [context.get_value_type(t) for t in arguments]
            c_result = ir.VoidType() if result == types.void else context.get_value_type(result)
            pointer = builder.inttoptr(values[0], ir.FunctionType(c_result, c_arguments).as_pointer())
            answer = builder.call(pointer, list(values[1:]))
            if result == types.void:
                return cgutils.get_null_value(ir.IntType(8).as_pointer())
            return answer

        return signature, codegen

    # intrinsic() reads the parameters of the function it decorates, so it is given one with the right count.
    names = ", ".join(f"a{i}" for i in range(len(arguments)))
    namespace = {"call": call}
    exec(f"def typed(typingctx, address, {names}):\n    return call(typingctx, address, {names})\n", namespace)
    return intrinsic(namespace["typed"])


def uncounted(**options):
    """Return `njit` for a function that allocates nothing: no references to its arrays are counted.

    A loop that hands tuples of arrays from function to function otherwise spends most of its time counting. What such
    a function calls for the first time is compiled in the same way, so it may call only what allocates nothing and
    returns numbers: an array that such a function makes is never freed, one that it returns too early elsewhere.
    """
    return njit(cache=True, _nrt=False, **options)


LANES = 8  # float64 in a vector of 512 bits; shorter ones are used in pairs or fours


def run_chunks(kernel, count: int, chunk: int, *arguments) -> None:
    """Run ``kernel(*arguments, first, last)`` over 0..count in chunks, on as many threads as numba may use.

    For large kernels: in a parallel loop of numba's the same code takes a third longer to compile.

    Parameters
    ----------
    kernel : callable
        Compiled with ``nogil``; chunks may run in any order.
    """
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        pieces = [(first, min(first + chunk, count)) for first in range(0, count, chunk)]
        for done in [pool.submit(kernel, *arguments, *piece) for piece in pieces]:
            done.result()


@njit(cache=True)
def aligned(count):
    """Return ``count`` zeros, (count,) float64, that begin with a line of the cache: no vector of them spans two."""
    room = np.zeros(count + LANES)
    first = (-(room.ctypes.data // 8)) % LANES
    return room[first : first + count]


def vector_times_table(width: int, parts: int):
    """Return a function for compiled code: a vector times the rows of a table, without a sum across a vector's lanes.

    A compiler that is given the loops vectorises each column's sum and spends most of the time adding up lanes.

    Parameters
    ----------
    width : int
        Columns of the table, a multiple of `LANES`.
    parts : int
        Interleaved partial sums that are added at the end, to hide the latency of an addition: 1, 2, 4 or 8.

    Returns
    -------
    callable ``(vectors, v, table, offset, sums, place)``, in nopython code only
        Sets the ``width`` numbers at ``place`` in ``sums`` to the sum over j of ``vectors[v, j]`` times the ``width``
        numbers at ``offset + j width`` in the table. Arrays are C-contiguous float64, places count from their first
        number, and the length of a vector is a multiple of ``parts``; nothing is checked.
    """
    lanes = ir.VectorType(ir.DoubleType(), LANES)

    def at(builder, pointer, index):
        return builder.bitcast(builder.gep(pointer, [index]), lanes.as_pointer())

    def codegen(context, builder, signature, values):
        integer = context.get_value_type(types.intp)
        vectors, table, sums = (
            context.make_array(signature.args[i])(context, builder, value=values[i]) for i in (0, 2, 4)
        )
        count = builder.extract_value(vectors.shape, 1)
        row = builder.gep(vectors.data, [builder.mul(values[1], count)])
        base = builder.gep(table.data, [values[3]])
        totals = [
            [cgutils.alloca_once_value(builder, ir.Constant(lanes, None)) for _ in range(width // LANES)]
            for _ in range(parts)
        ]
        step = ir.Constant(integer, parts)
        with cgutils.for_range_slice(builder, ir.Constant(integer, 0), count, step, intp=integer) as (j, _):
            for part, columns in enumerate(totals):
                observation = builder.add(j, ir.Constant(integer, part))
                factor = builder.load(builder.gep(row, [observation]))
                spread = builder.insert_element(
                    ir.Constant(lanes, ir.Undefined), factor, ir.Constant(ir.IntType(32), 0)
                )
                mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), None)
                spread = builder.shuffle_vector(spread, spread, mask)
                start = builder.mul(observation, ir.Constant(integer, width))
                for c, total in enumerate(columns):
                    place = at(builder, base, builder.add(start, ir.Constant(integer, c * LANES)))
                    product = builder.fmul(spread, builder.load(place, align=8), flags=("contract",))
                    builder.store(builder.fadd(builder.load(total), product, flags=("contract",)), total)
        out = builder.gep(sums.data, [values[5]])
        for c in range(width // LANES):
            whole = builder.load(totals[0][c])
            for columns in totals[1:]:
                whole = builder.fadd(whole, builder.load(columns[c]))
            builder.store(whole, at(builder, out, ir.Constant(integer, c * LANES)), align=8)
        return context.get_dummy_value()

    def typed(typingctx, vectors, v, table, offset, sums, place):
        return types.void(vectors, types.intp, table, types.intp, sums, types.intp), codegen

    return intrinsic(typed)


use_whole_vectors()
