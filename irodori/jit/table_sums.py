"""Sums of vectors times tables that stay in registers; a compiler that is given the loops keeps them in memory.

Arrays are C-contiguous, places count from their first number, and nothing is checked.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from irodori.jit.vector_memory import load_vector, pointer, store_vector
from irodori.jit.vectors import FLAGS, LANES, Vector, constant, repeated

TILE = 32  # pixels that `blend_tile` takes: two vectors of 512 bits in single precision, four in double
OUTPUTS = 6  # sums that it keeps in registers
_EIGHT = Vector(types.float64, LANES)


def _zeroed(builder, kind: Vector, count: int) -> list:
    return [cgutils.alloca_once_value(builder, constant(kind, 0.0)) for _ in range(count)]


def _add_product(builder, total, x, y) -> None:
    product = builder.fmul(x, y, flags=FLAGS)
    builder.store(builder.fadd(builder.load(total), product, flags=FLAGS), total)


def _moved(builder, index, by: int):
    return builder.add(index, ir.Constant(index.type, by))


def lanes_times_tables(width: int):
    """Return a function for compiled code: sums of lanes times the numbers in some columns of two tables.

    Returns
    -------
    callable ``(lanes, place, count, table, first, second, stride, sums, into, step)``, in nopython code only
        ``lanes`` holds ``count`` vectors of `LANES` from the flat ``place`` on, the tables begin at ``first`` and
        ``second`` in ``table``, rows ``stride`` apart. Sets the vectors at ``into + c LANES`` in ``sums`` to the sums
        over the rows j of lanes j times column c of the first table, for all c below ``width``; those ``step`` further
        to that of the second. Arrays are float64.
    """

    def codegen(context, builder, sig, args):
        lanes, table, sums = (
            lambda index, i=i: pointer(context, builder, sig.args[i], args[i], index) for i in (0, 3, 7)
        )
        _, place, count, _, first, second, stride, _, into, step = args
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
    def typed(typingctx, lanes, place, count, table, first, second, stride, sums, into, step):
        whole = types.intp
        return types.void(lanes, whole, whole, table, whole, whole, whole, sums, whole, whole), codegen

    return typed


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
        numbers at ``offset + j width`` in the table. Arrays are float64, and the length of a vector is a multiple of
        ``parts``.
    """
    columns = width // LANES

    def codegen(context, builder, sig, args):
        integer = context.get_value_type(types.intp)
        vectors, table, sums = (
            lambda index, i=i: pointer(context, builder, sig.args[i], args[i], index) for i in (0, 2, 4)
        )
        _, v, _, offset, _, into = args
        count = builder.extract_value(context.make_array(sig.args[0])(context, builder, value=args[0]).shape, 1)
        row = builder.mul(v, count)
        totals = [_zeroed(builder, _EIGHT, columns) for _ in range(parts)]
        step = ir.Constant(integer, parts)
        with cgutils.for_range_slice(builder, ir.Constant(integer, 0), count, step, intp=integer) as (j, _):
            for part, own in enumerate(totals):
                observation = _moved(builder, j, part)
                factor = repeated(builder, builder.load(vectors(builder.add(row, observation))), _EIGHT)
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
    def typed(typingctx, vectors, v, table, offset, sums, place):
        return types.void(vectors, types.intp, table, types.intp, sums, types.intp), codegen

    return typed


@intrinsic
def blend_tile(typingctx, shares, column, members, count, table, offset, sums, row):
    """Set `OUTPUTS` rows of sums from ``row`` on, in the `TILE` columns from ``column`` on, to shares times a table.

    Row ``row + q`` becomes Σ_r shares[r, column...] table[offset + OUTPUTS members[r] + q] over the first ``count``
    rows of shares.

    shares and sums are (rows, columns), table and members (n,), members int64, the others of one type, float32 or
    float64.
    """
    kind = Vector(shares.dtype, 512 // shares.dtype.bitwidth)
    parts = [p * kind.count for p in range(TILE // kind.count)]

    def codegen(context, builder, sig, args):
        integer = context.get_value_type(types.intp)
        rows, group, numbers, out = (
            lambda index, i=i: pointer(context, builder, sig.args[i], args[i], index) for i in (0, 2, 4, 6)
        )
        column, count, offset, row = (args[i] for i in (1, 3, 5, 7))
        width, out_width = (
            builder.extract_value(context.make_array(sig.args[i])(context, builder, value=args[i]).shape, 1)
            for i in (0, 6)
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

    return types.void(shares, types.intp, members, types.intp, table, types.intp, sums, types.intp), codegen


@intrinsic
def any_above_zero(typingctx, rows, row, column):
    """Return whether any of `TILE` numbers of (rows, columns) from a place on is above zero.

    The vectors are compared whole, without a sum across their lanes.
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
