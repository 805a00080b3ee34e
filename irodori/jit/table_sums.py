"""Sums of products of vectors and tables, kept in registers; from loops, the compiler would keep them in memory.

Arrays are C-contiguous, positions are flat indices from their first element, and nothing is checked.
"""

from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from irodori.jit.vector_memory import load_vector, pointer, store_vector
from irodori.jit.vectors import FLAGS, LANES, Vector, constant, repeated

TILE = 32  # pixels that `blend_tile` takes: two vectors of 512 bits in single precision, four in double
OUTPUTS = 6  # rows of sums that it keeps in registers
_EIGHT = Vector(types.float64, LANES)


class Place(NamedTuple):
    """An array and the flat index of the first element to use."""

    array: np.ndarray
    first: int


class Tables(NamedTuple):
    """Two tables in one array.

    Parameters
    ----------
    array : (...) float64
    first : int
        Flat index of the first element of the first table.
    apart : int
        Offset from there to the first element of the second table.
    stride : int
        Offset from a row to the next.
    """

    array: np.ndarray
    first: int
    apart: int
    stride: int


def _unpacked(context, builder, kind, value):
    """Unpack a named tuple: return a function from index to pointer for its first field, an array, and other fields."""
    array, *numbers = (builder.extract_value(value, i) for i in range(len(kind.types)))
    casted = [
        context.cast(builder, number, given, types.intp) for number, given in zip(numbers, kind.types[1:], strict=True)
    ]
    return lambda index: pointer(context, builder, kind.types[0], array, index), *casted


def _zeroed(builder, kind: Vector, count: int) -> list:
    return [cgutils.alloca_once_value(builder, constant(kind, 0.0)) for _ in range(count)]


def _add_product(builder, total, x, y) -> None:
    product = builder.fmul(x, y, flags=FLAGS)
    builder.store(builder.fadd(builder.load(total), product, flags=FLAGS), total)


def _moved(builder, index, by: int):
    return builder.add(index, ir.Constant(index.type, by))


def lanes_times_tables(width: int):
    """Make a function, for use in compiled code, for sums of vectors times elements in columns of two tables.

    Returns
    -------
    callable ``(lanes, count, tables, sums, step)``, in nopython code only
        ``lanes`` is the `Place` of ``count`` vectors of `LANES` elements. For each column c below ``width``, the vector
        at offset c `LANES` from the `Place` ``sums`` is set to the sum over rows j of vector j times element (j, c) of
        the first of the `Tables`. The vector at offset ``step`` from there is set to the sum for the second table.
        Arrays are float64.
    """

    def codegen(context, builder, sig, args):
        lanes, place = _unpacked(context, builder, sig.args[0], args[0])
        table, first, apart, stride = _unpacked(context, builder, sig.args[2], args[2])
        sums, into = _unpacked(context, builder, sig.args[3], args[3])
        count, step, second = args[1], args[4], builder.add(first, apart)
        totals = _zeroed(builder, _EIGHT, 2 * width)
        with cgutils.for_range(builder, count) as loop:
            at = builder.add(place, builder.mul(loop.index, ir.Constant(loop.index.type, LANES)))
            factor = load_vector(builder, lanes(at), _EIGHT)
            row = builder.mul(loop.index, stride)
            for t, begin in enumerate((first, second)):
                for c in range(width):
                    number = builder.load(table(_moved(builder, builder.add(begin, row), c)))
                    _add_product(builder, totals[t * width + c], factor, repeated(builder, number, _EIGHT))
        for t in range(2):
            begin = into if t == 0 else builder.add(into, step)
            for c in range(width):
                store_vector(
                    builder, builder.load(totals[t * width + c]), sums(_moved(builder, begin, c * LANES)), _EIGHT
                )
        return context.get_dummy_value()

    @intrinsic
    def typed(typingctx, lanes, count, tables, sums, step):
        return types.void(lanes, types.intp, tables, sums, types.intp), codegen

    return typed


def vector_times_table(width: int, parts: int):
    """Make a function, for use in compiled code, for the product of a vector and a table, without sums across lanes.

    From loops, the compiler would vectorise the sum for each column, and adding up lanes would take most of the time.

    Parameters
    ----------
    width : int
        Columns of the table, a multiple of `LANES`.
    parts : int
        Number of interleaved partial sums that hide the latency of additions: 1, 2, 4 or 8. They are added at the end.

    Returns
    -------
    callable ``(vectors, v, table, sums)``, in nopython code only
        Sets the ``width`` elements at the `Place` ``sums`` to the sum over j of ``vectors[v, j]`` times row j of the
        table, which is at offset ``j width`` from the `Place` ``table``. Arrays are float64, and the length of a vector
        is a multiple of ``parts``.
    """
    columns = width // LANES

    def codegen(context, builder, sig, args):
        integer = context.get_value_type(types.intp)
        table, offset = _unpacked(context, builder, sig.args[2], args[2])
        sums, into = _unpacked(context, builder, sig.args[3], args[3])
        count = builder.extract_value(context.make_array(sig.args[0])(context, builder, value=args[0]).shape, 1)
        row = builder.mul(args[1], count)
        totals = [_zeroed(builder, _EIGHT, columns) for _ in range(parts)]
        step = ir.Constant(integer, parts)
        with cgutils.for_range_slice(builder, ir.Constant(integer, 0), count, step, intp=integer) as (j, _):
            for part, own in enumerate(totals):
                observation = _moved(builder, j, part)
                number = pointer(context, builder, sig.args[0], args[0], builder.add(row, observation))
                factor = repeated(builder, builder.load(number), _EIGHT)
                start = builder.add(offset, builder.mul(observation, ir.Constant(integer, width)))
                for c, total in enumerate(own):
                    number = load_vector(builder, table(_moved(builder, start, c * LANES)), _EIGHT)
                    _add_product(builder, total, factor, number)
        for c in range(columns):
            whole = builder.load(totals[0][c])
            for own in totals[1:]:
                whole = builder.fadd(whole, builder.load(own[c]))
            store_vector(builder, whole, sums(_moved(builder, into, c * LANES)), _EIGHT)
        return context.get_dummy_value()

    @intrinsic
    def typed(typingctx, vectors, v, table, sums):
        return types.void(vectors, types.intp, table, sums), codegen

    return typed


@intrinsic
def blend_tile(typingctx, shares, members, table, sums, corner):
    """Compute a tile of `OUTPUTS` rows and `TILE` columns of ``sums``, with its corner at (row, column).

    Row ``row + q`` is set to Σ_r shares[r, column...] table[OUTPUTS members[r] + q], with table indices relative to the
    `Place` ``table``. The arrays ``shares`` and ``sums`` are (rows, columns), ``table`` and ``members`` are (n,).
    Members are int64, and the others of one type, float32 or float64.
    """
    kind = Vector(shares.dtype, 512 // shares.dtype.bitwidth)
    parts = [p * kind.count for p in range(TILE // kind.count)]

    def codegen(context, builder, sig, args):
        integer = context.get_value_type(types.intp)
        rows, group, out = (
            lambda index, i=i: pointer(context, builder, sig.args[i], args[i], index) for i in (0, 1, 3)
        )
        numbers, offset = _unpacked(context, builder, sig.args[2], args[2])
        row, column = (
            context.cast(builder, builder.extract_value(args[4], i), sig.args[4].types[i], types.intp) for i in (0, 1)
        )
        width, count, out_width = (
            builder.extract_value(context.make_array(sig.args[i])(context, builder, value=args[i]).shape, axis)
            for i, axis in ((0, 1), (1, 0), (3, 1))
        )
        totals = [_zeroed(builder, kind, len(parts)) for _ in range(OUTPUTS)]
        with cgutils.for_range(builder, count, intp=integer) as loop:
            start = builder.add(builder.mul(loop.index, width), column)
            share = [load_vector(builder, rows(_moved(builder, start, p)), kind) for p in parts]
            member = builder.load(group(loop.index))
            first = builder.add(offset, builder.mul(member, ir.Constant(integer, OUTPUTS)))
            for q, own in enumerate(totals):
                factor = repeated(builder, builder.load(numbers(_moved(builder, first, q))), kind)
                for part, total in zip(share, own, strict=True):
                    _add_product(builder, total, factor, part)
        for q, own in enumerate(totals):
            start = builder.add(builder.mul(_moved(builder, row, q), out_width), column)
            for p, total in zip(parts, own, strict=True):
                store_vector(builder, builder.load(total), out(_moved(builder, start, p)), kind)
        return context.get_dummy_value()

    return types.void(shares, members, table, sums, corner), codegen


@intrinsic
def any_above_zero(typingctx, rows, row, column):
    """Return whether any of `TILE` elements of ``rows``, a matrix, is positive, from (row, column) on.

    Whole vectors are compared, without sums across lanes.
    """
    kind = Vector(rows.dtype, TILE)

    def codegen(context, builder, sig, args):
        width = builder.extract_value(context.make_array(sig.args[0])(context, builder, value=args[0]).shape, 1)
        place = builder.add(builder.mul(args[1], width), args[2])
        numbers = load_vector(builder, pointer(context, builder, sig.args[0], args[0], place), kind)
        above = builder.fcmp_ordered(">", numbers, constant(kind, 0.0))
        bits = builder.bitcast(above, ir.IntType(TILE))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(TILE), 0))

    return types.boolean(rows, types.intp, types.intp), codegen
