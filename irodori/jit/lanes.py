"""Vector of eight float64 lanes for compiled loops.

The compiler vectorises a loop over observations, but not what comes after it: roots, divisions and choices, one texel
at a time, wait for each other. A function written for lanes computes them for eight texels in the time of one. Its
source is that of scalar code, but for `select` in place of a branch; written with the functions below, it serves both.
Eight lanes are one register where the processor has 512 bits, and a few shorter ones elsewhere.

In nopython code only: ``+ - * /``, unary minus and comparisons of lanes with lanes or numbers, ``& |`` of masks, and
the functions below, which take numbers and truth values just as well. Numbers become equal lanes by themselves.
"""

import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils, typeconv
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model

COUNT = 8
_DOUBLE, _LONG = ir.VectorType(ir.DoubleType(), COUNT), ir.VectorType(ir.IntType(64), COUNT)
_BITS = ir.VectorType(ir.IntType(1), COUNT)
_FUSED = ("contract", "nsz")
_LOG2_E, _LN2_HIGH, _LN2_LOW = 1.4426950408889634, 6.93147180369123816490e-01, 1.90821492927058770002e-10
_SQUARE_ROOT_OF_HALF = 0x3FE6A09E667F3BCD  # bits of the float64
_SMALLEST_EXPONENT = -170.0  # as in `irodori.jit.exponential`


class _LanesType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="Lanes")

    def can_convert_from(self, typingctx, other):
        """Let numbers stand for equal lanes."""
        if isinstance(other, (types.Float, types.Integer)):
            return typeconv.Conversion.safe
        return None


class _MaskType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="LanesMask")


LANES, MASK = _LanesType(), _MaskType()


@register_model(_LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager, kind) -> None:
        super().__init__(manager, kind, _DOUBLE)


@register_model(_MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager, kind) -> None:
        super().__init__(manager, kind, _BITS)


def _is_lanes(kind) -> bool:
    return isinstance(kind, (_LanesType, _MaskType))


def _splat(builder, number):
    vector = builder.insert_element(ir.Constant(_DOUBLE, ir.Undefined), number, ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), COUNT), [0] * COUNT)
    return builder.shuffle_vector(vector, ir.Constant(_DOUBLE, ir.Undefined), mask)


def _like(x, value: float):
    """Return a constant of the kind of x, lanes or a number."""
    return ir.Constant(x.type, [value] * COUNT if x.type == _DOUBLE else value)


@lower_cast(types.Float, _LanesType)
@lower_cast(types.Integer, _LanesType)
def _lanes_from_number(context, builder, from_type, to_type, value):
    return _splat(builder, context.cast(builder, value, from_type, types.float64))


def _operation(function, result, codegen) -> None:
    """Give an operator to lanes and numbers of which one at least is lanes."""

    @infer_global(function)
    class Template(AbstractTemplate):
        def generic(self, args, kws):
            numbers = (types.Float, types.Integer, _LanesType)
            if any(isinstance(a, _LanesType) for a in args) and all(isinstance(a, numbers) for a in args):
                return signature(result, *[LANES] * len(args))
            return None

    @lower_builtin(function, *[LANES] * (1 if function is operator.neg else 2))
    def lower(context, builder, sig, args):
        return codegen(builder, *args)


_operation(operator.add, LANES, lambda b, x, y: b.fadd(x, y, flags=_FUSED))
_operation(operator.sub, LANES, lambda b, x, y: b.fsub(x, y, flags=_FUSED))
_operation(operator.mul, LANES, lambda b, x, y: b.fmul(x, y, flags=_FUSED))
_operation(operator.truediv, LANES, lambda b, x, y: b.fdiv(x, y))
_operation(operator.neg, LANES, lambda b, x: b.fneg(x))
for _function, _sign in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="), (operator.eq, "=="),
):  # fmt: skip
    _operation(_function, MASK, lambda b, x, y, sign=_sign: b.fcmp_ordered(sign, x, y))


def _mask_operation(function, codegen) -> None:
    @infer_global(function)
    class Template(AbstractTemplate):
        def generic(self, args, kws):
            return signature(MASK, *args) if all(isinstance(a, _MaskType) for a in args) else None

    @lower_builtin(function, MASK, MASK)
    def lower(context, builder, sig, args):
        return codegen(builder, *args)


_mask_operation(operator.and_, lambda b, x, y: b.and_(x, y))
_mask_operation(operator.or_, lambda b, x, y: b.or_(x, y))


def _function(result, arguments, codegen, about: str):
    """Return a function for compiled code.

    Arguments of the kinds `LANES` and `MASK` are numbers and truth values instead where all are such, and so is the
    result; None keeps what is given.
    """
    scalar = {LANES: types.float64, MASK: types.boolean}

    def typed(typingctx, *given):
        wide = any(_is_lanes(g) for g in given) or not any(a in scalar for a in arguments)
        kinds = [g if a is None else a if wide else scalar.get(a, a) for g, a in zip(given, arguments, strict=True)]
        answer = result if wide else scalar.get(result, result)
        return answer(*kinds), lambda context, builder, sig, args: codegen(context, builder, sig, *args)

    names = ", ".join(f"a{i}" for i in range(len(arguments)))
    namespace = {"typed": typed}
    exec(f"def made(typingctx, {names}):\n    return typed(typingctx, {names})\n", namespace)
    made = namespace["made"]
    made.__doc__ = about
    return intrinsic(made)


def _call(builder, name: str, x):
    suffix = "v8f64" if x.type == _DOUBLE else "f64"
    kind = ir.FunctionType(x.type, [x.type])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.{suffix}"), [x])


def _address(context, builder, sig, array, place):
    data = context.make_array(sig.args[0])(context, builder, array).data
    return builder.bitcast(builder.gep(data, [place]), _DOUBLE.as_pointer())


def _load(context, builder, sig, array, place):
    found = builder.load(_address(context, builder, sig, array, place))
    found.align = 8
    return found


def _store(context, builder, sig, array, place, value):
    builder.store(value, _address(context, builder, sig, array, place), align=8)
    return context.get_dummy_value()


def _least(context, builder, sig, x, y):
    return builder.select(builder.fcmp_ordered("<", x, y), x, y)


def _largest(context, builder, sig, x, y):
    return builder.select(builder.fcmp_ordered(">", x, y), x, y)


def _polynomial(builder, x, coefficients):
    total = _like(x, coefficients[0])
    for c in coefficients[1:]:
        total = builder.fadd(builder.fmul(total, x, flags=_FUSED), _like(x, c), flags=_FUSED)
    return total


def _times_minus(builder, x, y, constant: float):
    """Return x - y times a constant."""
    return builder.fsub(x, builder.fmul(y, _like(y, constant), flags=_FUSED), flags=_FUSED)


def _whole(x, value: int):
    """Return a constant of 64-bit integers, as many as x has lanes."""
    return ir.Constant(_LONG, [value] * COUNT) if x.type == _DOUBLE else ir.Constant(ir.IntType(64), value)


def _exponential(context, builder, sig, x):
    x = _largest(context, builder, sig, x, _like(x, _SMALLEST_EXPONENT))
    whole = _call(builder, "rint", builder.fmul(x, _like(x, _LOG2_E)))
    r = _times_minus(builder, _times_minus(builder, x, whole, _LN2_HIGH), whole, _LN2_LOW)
    factorials = np.cumprod([1.0, *range(1, 13)])[::-1]
    value = _polynomial(builder, r, [1.0 / f for f in factorials])
    power = builder.add(builder.fptosi(whole, _whole(x, 0).type), _whole(x, 1023))
    return builder.fmul(value, builder.bitcast(builder.shl(power, _whole(x, 52)), x.type))


def _log(context, builder, sig, x):
    word = builder.bitcast(x, _whole(x, 0).type)
    # The mantissa is taken within √½ .. √2, where the series in s = (m - 1) / (m + 1) converges fast.
    exponent = builder.ashr(builder.sub(word, _whole(x, _SQUARE_ROOT_OF_HALF)), _whole(x, 52))
    mantissa = builder.bitcast(builder.sub(word, builder.shl(exponent, _whole(x, 52))), x.type)
    whole = builder.sitofp(exponent, x.type)
    s = builder.fdiv(builder.fsub(mantissa, _like(x, 1.0)), builder.fadd(mantissa, _like(x, 1.0)))
    z = builder.fmul(s, s)
    small = builder.fmul(builder.fmul(s, z), _polynomial(builder, z, [2.0 / n for n in range(21, 1, -2)]))
    small = builder.fadd(builder.fadd(builder.fmul(whole, _like(x, _LN2_LOW)), small), builder.fmul(s, _like(x, 2.0)))
    return builder.fadd(builder.fmul(whole, _like(x, _LN2_HIGH)), small)


def lanes_times_tables(width: int):
    """Return a function for compiled code: sums of lanes times the numbers in some columns of two tables.

    Returns
    -------
    callable ``(lanes, place, count, table, first, second, stride, sums, into, step)``, in nopython code only
        ``lanes`` holds ``count`` vectors from the flat ``place`` on, the tables begin at ``first`` and ``second`` in
        ``table``, rows ``stride`` apart. Sets the vectors at ``into + c COUNT`` in ``sums`` to the sums over the rows j
        of lanes j times column c of the first table, for all c below ``width``; those ``step`` further to that of the
        second. Arrays are C-contiguous float64, places count from their first number, and nothing is checked.
    """

    def codegen(context, builder, sig, args):
        lanes, table, sums = (context.make_array(sig.args[i])(context, builder, args[i]).data for i in (0, 3, 7))
        _, place, count, _, first, second, stride, _, into, step = args
        totals = [cgutils.alloca_once_value(builder, ir.Constant(_DOUBLE, [0.0] * COUNT)) for _ in range(2 * width)]

        def vector(data, index):
            return builder.bitcast(builder.gep(data, [index]), _DOUBLE.as_pointer())

        def moved(index, by: int):
            return builder.add(index, ir.Constant(index.type, by))

        for total in totals:
            builder.store(ir.Constant(_DOUBLE, [0.0] * COUNT), total)
        with cgutils.for_range(builder, count) as loop:
            at = builder.add(place, builder.mul(loop.index, ir.Constant(loop.index.type, COUNT)))
            factor = builder.load(vector(lanes, at), align=8)
            row = builder.mul(loop.index, stride)
            for t, begin in enumerate((first, second)):
                for c in range(width):
                    number = builder.load(builder.gep(table, [moved(builder.add(begin, row), c)]))
                    product = builder.fmul(factor, _splat(builder, number), flags=_FUSED)
                    total = totals[t * width + c]
                    builder.store(builder.fadd(builder.load(total), product, flags=_FUSED), total)
        for t in range(2):
            begin = into if t == 0 else builder.add(into, step)
            for c in range(width):
                builder.store(builder.load(totals[t * width + c]), vector(sums, moved(begin, c * COUNT)), align=8)
        return context.get_dummy_value()

    def typed(typingctx, lanes, place, count, table, first, second, stride, sums, into, step):
        whole = types.intp
        return types.void(lanes, whole, whole, table, whole, whole, whole, sums, whole, whole), codegen

    return intrinsic(typed)


load = _function(
    LANES, [None, types.intp], _load, "Return eight numbers of a C-contiguous float64 array, from a flat place on."
)
store = _function(
    types.void, [None, types.intp, LANES], _store, "Store lanes to a C-contiguous float64 array at a flat place."
)
select = _function(
    LANES,
    [MASK, LANES, LANES],
    lambda context, builder, sig, mask, x, y: builder.select(mask, x, y),
    "Return x where the mask is set, y elsewhere.",
)
negated = _function(
    MASK,
    [MASK],
    lambda context, builder, sig, mask: builder.not_(mask),
    "Return the mask that is set where one is not.",
)
root = _function(
    LANES,
    [LANES],
    lambda context, builder, sig, x: _call(builder, "sqrt", x),
    "Return square roots; NaN of negative numbers.",
)
magnitude = _function(
    LANES, [LANES], lambda context, builder, sig, x: _call(builder, "fabs", x), "Return absolute values."
)
lower_of = _function(LANES, [LANES, LANES], _least, "Return the lower of two; the second where either is NaN.")
upper_of = _function(LANES, [LANES, LANES], _largest, "Return the upper of two; the second where either is NaN.")
exponential = _function(
    LANES, [LANES], _exponential, "Return exp(x) for x < 700 to 1e-15 of its value; below -170 it stays at 1e-74."
)
log = _function(LANES, [LANES], _log, "Return the natural logarithm of normal positive numbers to 1e-15.")
spread = intrinsic(lambda typingctx, number: (LANES(LANES), lambda context, builder, sig, args: args[0]))
spread.__doc__ = "Return equal lanes of a number."
lane = intrinsic(
    lambda typingctx, x, number: (
        types.float64(LANES, types.int32),
        lambda context, builder, sig, args: builder.extract_element(*args),
    )
)
lane.__doc__ = "Return one lane, counted from 0."
bits = intrinsic(
    lambda typingctx, mask: (
        types.uint8(MASK),
        lambda context, builder, sig, args: builder.bitcast(args[0], ir.IntType(8)),
    )
)
bits.__doc__ = "Return a mask as eight bits, lane 0 the lowest."
