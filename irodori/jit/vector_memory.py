"""Conversion between vectors and numbers or arrays: load, store, gather, access to lanes, reductions.

Arrays are C-contiguous, with any number of dimensions; a place is a flat index, which is not checked. The functions are
for nopython code only, and widths are literals.
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic

from irodori.jit.compilation import njit
from irodori.jit.functions import suffix
from irodori.jit.vectors import FLAGS, LANES, SCALARS, Vector, constant, llvm_type, widened

#: Types that are converted when loaded and stored; uint16 contains the bits of half-precision numbers.
_READ_AS = {types.uint16: types.float32}


def _dtype_of(array):
    dtype = _READ_AS.get(array.dtype, array.dtype)
    if dtype not in SCALARS or dtype == types.boolean or getattr(array, "layout", "C") != "C":
        raise TypingError(f"a vector in {array}; accepted: C-contiguous float32, float64, int32, int64 or uint16")
    return dtype


def _width(count) -> int:
    """Return the width from a literal, or from the default value of the argument if it is not given."""
    return int(count) if isinstance(count, int) else count.literal_value


def _given(count):
    return types.Omitted(count) if isinstance(count, int) else count


def pointer(context, builder, array_type, array, index):
    """Return the LLVM pointer to the element at a flat index."""
    return builder.gep(context.make_array(array_type)(context, builder, value=array).data, [index])


def load_vector(builder, at, kind: Vector):
    """Load a vector from a pointer to its first element."""
    return builder.load(builder.bitcast(at, llvm_type(kind).as_pointer()), align=kind.dtype.bitwidth // 8)


def store_vector(builder, value, at, kind: Vector) -> None:
    """Store a vector at a pointer to its first element."""
    builder.store(value, builder.bitcast(at, llvm_type(kind).as_pointer()), align=kind.dtype.bitwidth // 8)


def _load(context, builder, sig, args):
    kind, at = sig.return_type, pointer(context, builder, sig.args[0], args[0], args[1])
    if sig.args[0].dtype == types.uint16:
        half = ir.VectorType(ir.HalfType(), kind.count)
        return builder.fpext(builder.load(builder.bitcast(at, half.as_pointer()), align=2), llvm_type(kind))
    return load_vector(builder, at, kind)


@intrinsic(prefer_literal=True)
def load(typingctx, array, place, count=LANES):
    """Load a vector of ``count`` elements of an array, starting at a flat index."""
    return Vector(_dtype_of(array), _width(count))(array, types.intp, _given(count)), _load


@intrinsic
def load_like(typingctx, array, place, like):
    """Load a vector with the width of ``like`` from an array, starting at a flat index."""
    return Vector(_dtype_of(array), like.count)(array, types.intp, like), _load


@intrinsic
def store(typingctx, array, place, value):
    """Store a vector in an array of the type that `load` reads from it, starting at a flat index."""
    if not isinstance(value, Vector) or _dtype_of(array) != value.dtype:
        raise TypingError(f"store found {value} for {array}; accepted: a vector of the array's type")

    def codegen(context, builder, sig, args):
        at = pointer(context, builder, sig.args[0], args[0], args[1])
        if array.dtype == types.uint16:
            half = ir.VectorType(ir.HalfType(), value.count)
            builder.store(builder.fptrunc(args[2], half), builder.bitcast(at, half.as_pointer()), align=2)
        else:
            store_vector(builder, args[2], at, value)
        return context.get_dummy_value()

    return types.void(array, types.intp, value), codegen


@intrinsic
def gather(typingctx, array, indices):
    """Load the elements of an array at a vector of flat indices."""
    kind = Vector(_dtype_of(array), indices.count)
    if array.dtype in _READ_AS:
        raise TypingError(f"gather found {array}; accepted: numbers of the vector's type")

    def codegen(context, builder, sig, args):
        data = pointer(context, builder, sig.args[0], args[0], ir.Constant(ir.IntType(64), 0))
        out = ir.Constant(llvm_type(kind), ir.Undefined)
        for lane_number in range(kind.count):
            place = ir.Constant(ir.IntType(32), lane_number)
            index = builder.extract_element(args[1], place)
            index = builder.sext(index, ir.IntType(64)) if indices.dtype == types.int32 else index
            out = builder.insert_element(out, builder.load(builder.gep(data, [index])), place)
        return out

    return kind(array, indices), codegen


@intrinsic
def compress(typingctx, array, place, mask, value):
    """Store the lanes selected by a mask contiguously in an array, starting at a flat index."""

    def codegen(context, builder, sig, args):
        at = pointer(context, builder, sig.args[0], args[0], args[1])
        function = ir.FunctionType(ir.VoidType(), [llvm_type(value), at.type, llvm_type(mask)])
        name = f"llvm.masked.compressstore.{suffix(value)}"
        target = cgutils.get_or_insert_function(builder.module, function, name)
        bits = ir.IntType(mask.count)
        # Most masks select all lanes. Without AVX-512 each lane of the others is stored after a branch of its own.
        whole = builder.icmp_unsigned("==", builder.bitcast(args[2], bits), ir.Constant(bits, -1))
        with builder.if_else(whole, likely=True) as (all_lanes, some):
            with all_lanes:
                store_vector(builder, args[3], at, value)
            with some:
                builder.call(target, [args[3], at, args[2]])
        return context.get_dummy_value()

    return types.void(array, types.intp, mask, value), codegen


@intrinsic(prefer_literal=True)
def spread(typingctx, number, count=LANES):
    """Return a vector of ``count`` equal numbers; the type of float32 and float64 is kept, integers become int32."""
    given = types.unliteral(number)
    kind = Vector(given if isinstance(given, types.Float) else types.int32, _width(count))

    def codegen(context, builder, sig, args):
        return widened(context, builder, args[0], sig.args[0], kind)

    return kind(number, _given(count)), codegen


@intrinsic
def zeros_like(typingctx, like):
    """Return a vector of zeros with the type and width of another."""

    def codegen(context, builder, sig, args):
        return constant(like, 0.0)

    return like(like), codegen


@intrinsic(prefer_literal=True)
def numbered(typingctx, count):
    """Return 0, 1, 2... as a vector of ``count`` int32."""
    kind = Vector(types.int32, count.literal_value)

    def codegen(context, builder, sig, args):
        return ir.Constant(llvm_type(kind), list(range(kind.count)))

    return kind(count), codegen


@intrinsic
def channel_count(typingctx, like):
    """Return the number of elements of a vector, a constant."""

    def codegen(context, builder, sig, args):
        return ir.Constant(ir.IntType(64), like.count)

    return types.int64(like), codegen


@intrinsic
def lane(typingctx, value, number):
    """Return the element in one lane of a vector; lanes are counted from 0."""

    def codegen(context, builder, sig, args):
        return builder.extract_element(args[0], args[1])

    return value.dtype(value, types.int64), codegen


@intrinsic
def mask_bits(typingctx, mask):
    """Convert a mask to an integer with lane 0 in the lowest bit."""

    def codegen(context, builder, sig, args):
        bits = builder.bitcast(args[0], ir.IntType(mask.count))
        return bits if mask.count == 64 else builder.zext(bits, ir.IntType(64))

    return types.int64(mask), codegen


def _reduction(name: str, about: str, *start):
    """Make a function from one of the reductions of LLVM, with a start value for those that need one."""

    def typed(typingctx, value):
        def codegen(context, builder, sig, args):
            scalar = SCALARS[value.dtype]
            function = ir.FunctionType(scalar, [scalar] * len(start) + [llvm_type(value)])
            target = cgutils.get_or_insert_function(
                builder.module, function, f"llvm.vector.reduce.{name}.{suffix(value)}"
            )
            flags = ("reassoc",) if start else ()
            return builder.call(target, [*(ir.Constant(scalar, s) for s in start), args[0]], fastmath=flags)

        return value.dtype(value), codegen

    made = intrinsic(typed)
    made.__doc__ = about
    return made


total = _reduction("fadd", "Return the sum of a vector's numbers.", 0.0)
largest = _reduction("fmax", "Return the largest of a vector's numbers.")


def _halves(builder, value, kind: Vector):
    for first in (0, kind.count):
        places = list(range(first, first + kind.count))
        yield builder.shuffle_vector(value, value, ir.Constant(ir.VectorType(ir.IntType(32), kind.count), places))


@intrinsic
def pair_mixed(typingctx, value, share):
    """Return (1 - share) times the first half of a vector plus share times its second half."""
    kind = Vector(value.dtype, value.count // 2)

    def codegen(context, builder, sig, args):
        low, high = _halves(builder, args[0], kind)
        part = widened(context, builder, args[1], sig.args[1], kind)
        rest = builder.fsub(constant(kind, 1.0), part, flags=FLAGS)
        products = builder.fmul(rest, low, flags=FLAGS), builder.fmul(part, high, flags=FLAGS)
        return builder.fadd(*products, flags=FLAGS)

    return kind(value, share), codegen


@njit(cache=True)
def aligned(count):
    """Return zeros, (count,) float64, aligned to a cache line, so that no vector in them spans two cache lines."""
    room = np.zeros(count + LANES)
    first = (-(room.ctypes.data // 8)) % LANES
    return room[first : first + count]
