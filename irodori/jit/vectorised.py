"""Elementary functions on vectors, generic over float32 and float64.

numba calls the C library for `math.exp` and `math.log`, one number at a time, and computes a float32 times a constant
in float64. The polynomials here are vectorised, in single precision with twice the numbers in a vector.
"""

import math

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

from irodori.jit.exponential import exp_negative
from irodori.jit.native import njit

TILE = 32  # pixels that `blend_tile` takes: two vectors of 512 bits in single precision, four in double
OUTPUTS = 6  # sums that it keeps in registers

_LOG2_E = np.float32(1.4426950408889634)
_LN2_HIGH, _LN2_LOW = np.float32(0.693145752), np.float32(1.42860677e-06)
_HALF, _ONE = np.float32(0.5), np.float32(1.0)
_C3, _C4, _C5, _C6 = (np.float32(1.0 / math.factorial(n)) for n in (3, 4, 5, 6))
_SMALLEST_EXPONENT = np.float32(-80.0)  # results stay normal numbers
_SQUARE_ROOT_OF_TWO, _LN2 = math.sqrt(2.0), math.log(2.0)


@intrinsic
def _power_of_two(typingctx, exponent):
    """Return 2 to a whole float32 within -126..127."""

    def codegen(context, builder, signature, values):
        biased = builder.add(builder.fptosi(values[0], ir.IntType(32)), ir.Constant(ir.IntType(32), 127))
        return builder.bitcast(builder.shl(biased, ir.Constant(ir.IntType(32), 23)), ir.FloatType())

    return types.float32(types.float32), codegen


@intrinsic
def _exponent(typingctx, value):
    """Return the whole part of the logarithm to base 2 of a normal positive float64, as float64."""

    def codegen(context, builder, signature, values):
        bits = builder.bitcast(values[0], ir.IntType(64))
        biased = builder.lshr(bits, ir.Constant(ir.IntType(64), 52))
        return builder.sitofp(builder.sub(biased, ir.Constant(ir.IntType(64), 1023)), ir.DoubleType())

    return types.float64(types.float64), codegen


@intrinsic
def _fraction(typingctx, value):
    """Return a normal positive float64 over 2 to its `_exponent`, in 1..2."""

    def codegen(context, builder, signature, values):
        bits = builder.bitcast(values[0], ir.IntType(64))
        bits = builder.and_(bits, ir.Constant(ir.IntType(64), (1 << 52) - 1))
        return builder.bitcast(builder.or_(bits, ir.Constant(ir.IntType(64), 1023 << 52)), ir.DoubleType())

    return types.float64(types.float64), codegen


def decaying(x):
    """Return exp(x) for x <= 0, in compiled code only: 3e-7 of its value and above 1e-35 in float32."""
    raise NotImplementedError


@overload(decaying, jit_options={"fastmath": {"contract"}})
def _decaying(x):
    if x == types.float32:

        def single(x):
            bounded = x if x > _SMALLEST_EXPONENT else _SMALLEST_EXPONENT
            whole = np.floor(bounded * _LOG2_E + _HALF)
            r = (bounded - whole * _LN2_HIGH) - whole * _LN2_LOW
            p = ((((_C6 * r + _C5) * r + _C4) * r + _C3) * r + _HALF) * r
            return ((p + _ONE) * r + _ONE) * _power_of_two(whole)

        return single
    if x == types.float64:
        return lambda x: exp_negative(x)
    return None


@njit(cache=True, fastmath={"contract"}, inline="always")
def logarithm(x):
    """Return log(x) of a normal positive float64 to 1e-10."""
    whole, fraction = _exponent(x), _fraction(x)
    large = fraction > _SQUARE_ROOT_OF_TWO
    fraction = 0.5 * fraction if large else fraction
    whole = whole + 1.0 if large else whole
    s = (fraction - 1.0) / (fraction + 1.0)
    q = s * s
    p = ((((q / 11.0 + 1.0 / 9.0) * q + 1.0 / 7.0) * q + 1.0 / 5.0) * q + 1.0 / 3.0) * q + 1.0
    return whole * _LN2 + 2.0 * s * p


@intrinsic
def blend_tile(typingctx, shares, column, members, count, table, offset, sums, row):
    """Set `OUTPUTS` rows of sums from ``row`` on, in the `TILE` columns from ``column`` on, to shares times a table.

    Row ``row + q`` becomes Σ_r shares[r, column...] table[offset + OUTPUTS members[r] + q] over the first ``count``
    rows of shares. The sums stay in registers; a compiler that is given the loops keeps them in memory.

    shares and sums are C-contiguous (rows, columns), table and members C-contiguous (n,), members int64, the others of
    one type, float32 or float64; nothing is checked.
    """
    single = shares.dtype == types.float32
    element, size = (ir.FloatType(), 4) if single else (ir.DoubleType(), 8)
    lanes = 64 // size
    vector = ir.VectorType(element, lanes)
    place = ir.IntType(32)

    def codegen(context, builder, signature, values):
        integer = context.get_value_type(types.intp)
        rows, group, numbers, out = (
            context.make_array(signature.args[i])(context, builder, value=values[i]) for i in (0, 2, 4, 6)
        )
        column, count, offset, row = (values[i] for i in (1, 3, 5, 7))
        width, out_width = (builder.extract_value(array.shape, 1) for array in (rows, out))

        def vector_at(data, index):
            return builder.bitcast(builder.gep(data, [index]), vector.as_pointer())

        totals = [
            [cgutils.alloca_once_value(builder, ir.Constant(vector, None)) for _ in range(TILE // lanes)]
            for _ in range(OUTPUTS)
        ]
        with cgutils.for_range(builder, count, intp=integer) as loop:
            start = builder.add(builder.mul(loop.index, width), column)
            parts = [
                builder.load(vector_at(rows.data, builder.add(start, ir.Constant(integer, p * lanes))), align=size)
                for p in range(TILE // lanes)
            ]
            member = builder.load(builder.gep(group.data, [loop.index]))
            first = builder.add(offset, builder.mul(member, ir.Constant(integer, OUTPUTS)))
            for q, own in enumerate(totals):
                factor = builder.load(builder.gep(numbers.data, [builder.add(first, ir.Constant(integer, q))]))
                spread = builder.insert_element(ir.Constant(vector, ir.Undefined), factor, ir.Constant(place, 0))
                spread = builder.shuffle_vector(spread, spread, ir.Constant(ir.VectorType(place, lanes), None))
                for part, total in zip(parts, own, strict=True):
                    product = builder.fmul(spread, part, flags=("contract",))
                    builder.store(builder.fadd(builder.load(total), product, flags=("contract",)), total)
        for q, own in enumerate(totals):
            start = builder.add(builder.mul(builder.add(row, ir.Constant(integer, q)), out_width), column)
            for p, total in enumerate(own):
                target = vector_at(out.data, builder.add(start, ir.Constant(integer, p * lanes)))
                builder.store(builder.load(total), target, align=size)
        return context.get_dummy_value()

    return types.void(shares, types.intp, members, types.intp, table, types.intp, sums, types.intp), codegen


@intrinsic
def any_above_zero(typingctx, rows, row, column):
    """Return whether any of `TILE` numbers from a place of a C-contiguous (rows, columns) on is above zero.

    Nothing is checked. The vectors are compared whole, without a sum across their lanes.
    """
    single = rows.dtype == types.float32
    element, size = (ir.FloatType(), 4) if single else (ir.DoubleType(), 8)
    vector = ir.VectorType(element, TILE)

    def codegen(context, builder, signature, values):
        array = context.make_array(signature.args[0])(context, builder, value=values[0])
        place = builder.add(builder.mul(values[1], builder.extract_value(array.shape, 1)), values[2])
        pointer = builder.bitcast(builder.gep(array.data, [place]), vector.as_pointer())
        above = builder.fcmp_ordered(">", builder.load(pointer, align=size), ir.Constant(vector, None))
        bits = builder.bitcast(above, ir.IntType(TILE))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(TILE), 0))

    return types.boolean(rows, types.intp, types.intp), codegen
