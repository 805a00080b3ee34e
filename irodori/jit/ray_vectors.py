"""Short vectors as values in compiled code: sixteen rays of a packet, or the channels of a colour.

numba has no such type, and whether its compiler forms vectors from loops over arrays hangs on what it can prove about
them. Here the width is part of the type: ``load(array, index, 16) * 2.0`` is one multiplication on a machine with
vectors of 512 bits, and two or four elsewhere. Arithmetic and comparisons work between vectors of one kind and width,
and between a vector and a scalar. In nopython code only; indices are not checked.

The kinds are ``f`` (float32), ``i`` (int32) and ``b`` (mask).
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from irodori.jit.array_views import MemoryType, element
from irodori.jit.ray_vector_type import FLAGS, SCALARS, Lanes, common, widened

_KIND_OF = {types.float32: "f", types.int32: "i", types.uint16: "f"}


def _pointer(context, builder, array_type, array, index):
    if isinstance(array_type, MemoryType):
        return element(context, builder, array_type, array, index)
    return builder.gep(context.make_array(array_type)(context, builder, value=array).data, [index])


def _load(context, builder, array_type, array, index, lanes):
    pointer = _pointer(context, builder, array_type, array, index)
    if array_type.dtype == types.uint16:
        half = ir.VectorType(ir.HalfType(), lanes.count)
        value = builder.load(builder.bitcast(pointer, half.as_pointer()), align=2)
        return builder.fpext(value, lanes.vector)
    return builder.load(builder.bitcast(pointer, lanes.vector.as_pointer()), align=4)


@intrinsic(prefer_literal=True)
def load(typingctx, array, index, count):
    """Return ``count`` (literal) numbers of a flat array or `Memory` from an index on; uint16 are read as halves."""
    lanes = Lanes(_KIND_OF[array.dtype], count.literal_value)

    def codegen(context, builder, sig, args):
        return _load(context, builder, sig.args[0], args[0], args[1], lanes)

    return lanes(array, types.intp, count), codegen


@intrinsic
def load_like(typingctx, array, index, like):
    """Return as many numbers as ``like`` has, a vector."""
    lanes = Lanes(_KIND_OF[array.dtype], like.count)

    def codegen(context, builder, sig, args):
        return _load(context, builder, sig.args[0], args[0], args[1], lanes)

    return lanes(array, types.intp, like), codegen


@intrinsic
def store(typingctx, array, index, value):
    """Write a vector to a flat array from an index on."""

    def codegen(context, builder, sig, args):
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1])
        builder.store(args[2], builder.bitcast(pointer, value.vector.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, value), codegen


@intrinsic
def gather(typingctx, array, indices):
    """Return the numbers of a flat array at a vector of indices."""
    lanes = Lanes(_KIND_OF[array.dtype], indices.count)

    def codegen(context, builder, sig, args):
        data = _pointer(context, builder, sig.args[0], args[0], ir.Constant(ir.IntType(64), 0))
        out = ir.Constant(lanes.vector, ir.Undefined)
        for lane in range(lanes.count):
            place = ir.Constant(ir.IntType(32), lane)
            index = builder.sext(builder.extract_element(args[1], place), ir.IntType(64))
            out = builder.insert_element(out, builder.load(builder.gep(data, [index])), place)
        return out

    return lanes(array, indices), codegen


@intrinsic
def compress(typingctx, array, index, mask, value):
    """Write the numbers of the lanes that a mask chooses, close together, to a flat array from an index on."""

    def codegen(context, builder, sig, args):
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1])
        scalar = SCALARS[value.kind]
        name = f"llvm.masked.compressstore.v{value.count}{'f32' if value.kind == 'f' else 'i32'}"
        function = ir.FunctionType(ir.VoidType(), [value.vector, pointer.type, mask.vector])
        target = cgutils.get_or_insert_function(builder.module, function, name)
        builder.call(target, [args[3], builder.bitcast(pointer, scalar.as_pointer()), args[2]])
        return context.get_dummy_value()

    return types.void(array, types.intp, mask, value), codegen


# --- functions of vectors -----------------------------------------------------------------------------------------


def _unary(name: str):
    def typed(typingctx, value):
        def codegen(context, builder, sig, args):
            function = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(value.vector, [value.vector]), f"llvm.{name}.v{value.count}f32"
            )
            return builder.call(function, args)

        return value(value), codegen

    return intrinsic(typed)


def _binary(name: str):
    def typed(typingctx, a, b):
        lanes = common((a, b))

        def codegen(context, builder, sig, args):
            wide = [widened(context, builder, v, t, lanes) for v, t in zip(args, sig.args, strict=True)]
            function = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(lanes.vector, [lanes.vector] * 2), f"llvm.{name}.v{lanes.count}f32"
            )
            return builder.call(function, wide)

        return lanes(a, b), codegen

    return intrinsic(typed)


root, absolute = _unary("sqrt"), _unary("fabs")
least, greatest, with_sign = _binary("minnum"), _binary("maxnum"), _binary("copysign")


@intrinsic
def select(typingctx, mask, a, b):
    """Return ``a`` where the mask is set and ``b`` elsewhere; one of them may be a scalar."""
    lanes = common((a, b))

    def codegen(context, builder, sig, args):
        return builder.select(args[0], *(widened(context, builder, args[i], sig.args[i], lanes) for i in (1, 2)))

    return lanes(mask, a, b), codegen


def _conversion(kind: str, method: str):
    def typed(typingctx, value):
        lanes = Lanes(kind, value.count)

        def codegen(context, builder, sig, args):
            return getattr(builder, method)(args[0], lanes.vector)

        return lanes(value), codegen

    return intrinsic(typed)


#: To int32 towards zero, to float32, and the bits of one as the other.
truncated, as_float = _conversion("i", "fptosi"), _conversion("f", "sitofp")
bits_as_int, bits_as_float = _conversion("i", "bitcast"), _conversion("f", "bitcast")


@intrinsic(prefer_literal=True)
def repeated(typingctx, value, count):
    """Return a vector of ``count`` (literal) times a scalar: float32 of a float, int32 of an integer."""
    lanes = Lanes("f" if isinstance(value, types.Float) else "i", count.literal_value)

    def codegen(context, builder, sig, args):
        return widened(context, builder, args[0], sig.args[0], lanes)

    return lanes(value, count), codegen


@intrinsic
def zeros_like(typingctx, like):
    """Return a vector of float zeros, as many as ``like`` has."""
    lanes = Lanes("f", like.count)

    def codegen(context, builder, sig, args):
        return ir.Constant(lanes.vector, [0.0] * lanes.count)

    return lanes(like), codegen


@intrinsic
def channel_count(typingctx, like):
    """Return how many numbers a vector has, a constant."""

    def codegen(context, builder, sig, args):
        return ir.Constant(ir.IntType(64), like.count)

    return types.int64(like), codegen


@intrinsic
def total(typingctx, value):
    """Return the sum of a vector's numbers."""

    def codegen(context, builder, sig, args):
        function = ir.FunctionType(ir.FloatType(), [ir.FloatType(), value.vector])
        target = cgutils.get_or_insert_function(builder.module, function, f"llvm.vector.reduce.fadd.v{value.count}f32")
        return builder.call(target, [ir.Constant(ir.FloatType(), 0.0), args[0]], fastmath=("reassoc",))

    return types.float32(value), codegen


@intrinsic
def largest(typingctx, value):
    """Return the largest of a vector's numbers."""

    def codegen(context, builder, sig, args):
        function = ir.FunctionType(ir.FloatType(), [value.vector])
        target = cgutils.get_or_insert_function(builder.module, function, f"llvm.vector.reduce.fmax.v{value.count}f32")
        return builder.call(target, [args[0]])

    return types.float32(value), codegen


@intrinsic(prefer_literal=True)
def numbered(typingctx, count):
    """Return 0, 1, 2... as a vector of ``count`` (literal) int32."""
    lanes = Lanes("i", count.literal_value)

    def codegen(context, builder, sig, args):
        return ir.Constant(lanes.vector, list(range(lanes.count)))

    return lanes(count), codegen


@intrinsic
def mask_bits(typingctx, mask):
    """Return a mask as an integer, lane 0 in the lowest bit."""

    def codegen(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(mask.count)), ir.IntType(64))

    return types.int64(mask), codegen


@intrinsic
def halves_summed(typingctx, value):
    """Return the first half of a vector plus its second."""
    lanes = Lanes(value.kind, value.count // 2)

    def codegen(context, builder, sig, args):
        low, high = (
            builder.shuffle_vector(
                args[0],
                args[0],
                ir.Constant(ir.VectorType(ir.IntType(32), lanes.count), list(range(a, a + lanes.count))),
            )
            for a in (0, lanes.count)
        )
        return builder.fadd(low, high)

    return lanes(value), codegen


@intrinsic
def pair_mixed(typingctx, value, share):
    """Return (1 - share) times the first half of a vector plus share times its second."""
    lanes = Lanes(value.kind, value.count // 2)

    def codegen(context, builder, sig, args):
        low, high = (
            builder.shuffle_vector(
                args[0],
                args[0],
                ir.Constant(ir.VectorType(ir.IntType(32), lanes.count), list(range(a, a + lanes.count))),
            )
            for a in (0, lanes.count)
        )
        part = widened(context, builder, args[1], sig.args[1], lanes)
        rest = builder.fsub(ir.Constant(lanes.vector, [1.0] * lanes.count), part, flags=FLAGS)
        products = builder.fmul(rest, low, flags=FLAGS), builder.fmul(part, high, flags=FLAGS)
        return builder.fadd(*products, flags=FLAGS)

    return lanes(value, share), codegen


@intrinsic
def lane(typingctx, value, index):
    """Return the number in one lane of a vector."""
    scalar = {"f": types.float32, "i": types.int32}[value.kind]

    def codegen(context, builder, sig, args):
        return builder.extract_element(args[0], args[1])

    return scalar(value, types.int64), codegen


@intrinsic
def cycles(typingctx):
    """Return the processor's count of cycles, for profiles."""

    def codegen(context, builder, sig, args):
        function = ir.FunctionType(ir.IntType(64), [])
        return builder.call(cgutils.get_or_insert_function(builder.module, function, "llvm.readcyclecounter"), [])

    return types.int64(), codegen


def width_of(count: int) -> int:
    """Return the smallest usual width, a power of two from 4, that holds a count of numbers."""
    return max(4, 1 << int(np.ceil(np.log2(count))))
