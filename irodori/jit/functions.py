"""Elementary functions for numbers and for `irodori.jit.vectors`, so that one formula serves both.

The result for float32 is float32, and float64 for other numbers (but numba computes an expression of a float32 number
and a float64 constant in float64). The code has no branches or library calls, so that the compiler can vectorise loops
over numbers that use these functions. They are for nopython code only.
"""

import math

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic

from irodori.jit.compilation import njit
from irodori.jit.vectors import FLAGS, Vector, common, constant, llvm_type, scalar_of, widened

#: Number of bits of the mantissa, and bias of the exponent.
_FORMAT = {types.float32: (23, 127), types.float64: (52, 1023)}
#: ln 2 as a sum of two parts; the larger part has so few digits that its product with an exponent is exact.
_LN2 = {
    types.float32: (0.693145751953125, 1.42860682030941723212e-06),
    types.float64: (6.93147180369123816490e-01, 1.90821492927058770002e-10),
}
#: Smallest argument of exp; smaller ones are replaced by it. Denormal numbers are slow: products of the result with
#: weights, and for float64 also its square, remain normal numbers.
_SMALLEST_EXPONENT = {types.float32: -80.0, types.float64: -170.0}
_SQUARE_ROOT_OF_HALF = {types.float32: 0x3F3504F3, types.float64: 0x3FE6A09E667F3BCD}  # bits
_EXP_DEGREE = {types.float32: 7, types.float64: 13}
_LOG_TERMS = {types.float32: 5, types.float64: 10}
#: Taylor series of sin(x) / x and cos(x) in x², from the highest power.
_SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(8, -1, -1))
_COSINE = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(9, -1, -1))


def _elementwise(arguments: int, codegen, about: str):
    """Make a function of one or two numbers or vectors, with code from ``codegen(builder, kind, *values)``."""

    def typed(*given):
        kind = common(*given)
        if kind is None or not isinstance(scalar_of(kind), types.Float):
            raise TypingError(f"{about} found {given}; accepted: numbers, or float vectors of one type")

        def emitted(context, builder, sig, args):
            values = [widened(context, builder, v, t, kind) for v, t in zip(args, sig.args, strict=True)]
            return codegen(builder, kind, *values)

        return kind(*given), emitted

    if arguments == 1:
        made = intrinsic(lambda typingctx, x: typed(x))
    else:
        made = intrinsic(lambda typingctx, x, y: typed(x, y))
    made.__doc__ = about
    return made


def suffix(kind) -> str:
    """Return the suffix of the names of LLVM intrinsics for a type, such as ``v8f64``."""
    bits = f"{'f' if isinstance(scalar_of(kind), types.Float) else 'i'}{scalar_of(kind).bitwidth}"
    return f"v{kind.count}{bits}" if isinstance(kind, Vector) else bits


def _call(builder, name: str, kind, *values):
    function = ir.FunctionType(llvm_type(kind), [llvm_type(kind)] * len(values))
    return builder.call(cgutils.get_or_insert_function(builder.module, function, f"llvm.{name}.{suffix(kind)}"), values)


def _add(builder, x, y):
    return builder.fadd(x, y, flags=FLAGS)


def _subtract(builder, x, y):
    return builder.fsub(x, y, flags=FLAGS)


def _multiply(builder, x, y):
    return builder.fmul(x, y, flags=FLAGS)


def _polynomial(builder, kind, x, coefficients):
    total = constant(kind, coefficients[0])
    for c in coefficients[1:]:
        total = _add(builder, _multiply(builder, total, x), constant(kind, c))
    return total


def _integers_like(kind):
    integer = types.int32 if scalar_of(kind) == types.float32 else types.int64
    return Vector(integer, kind.count) if isinstance(kind, Vector) else integer


def _lower(builder, kind, x, y):
    return builder.select(builder.fcmp_ordered("<", x, y), x, y)


def _upper(builder, kind, x, y):
    return builder.select(builder.fcmp_ordered(">", x, y), x, y)


def _exp(builder, kind, x):
    scalar = scalar_of(kind)
    mantissa, bias = _FORMAT[scalar]
    integers, (high, low) = _integers_like(kind), _LN2[scalar]
    x = _upper(builder, kind, x, constant(kind, _SMALLEST_EXPONENT[scalar]))
    # Adding a large number whose last bit represents 1 rounds to an integer, which is then in the last bits of the sum.
    # Few processors have a vector instruction for the conversion. FLAGS do not allow the compiler to cancel the sum.
    large = constant(kind, 1.5 * 2.0**mantissa)
    rounded = _add(builder, _multiply(builder, x, constant(kind, 1.0 / math.log(2.0))), large)
    whole = _subtract(builder, rounded, large)
    r = _subtract(builder, x, _multiply(builder, whole, constant(kind, high)))
    r = _subtract(builder, r, _multiply(builder, whole, constant(kind, low)))
    value = _polynomial(builder, kind, r, [1.0 / math.factorial(i) for i in range(_EXP_DEGREE[scalar], -1, -1)])
    power = builder.add(builder.bitcast(rounded, llvm_type(integers)), constant(integers, bias))
    power = builder.shl(power, constant(integers, mantissa))
    return _multiply(builder, value, builder.bitcast(power, llvm_type(kind)))


def _log(builder, kind, x):
    scalar = scalar_of(kind)
    mantissa, bias = _FORMAT[scalar]
    integers, (high, low) = _integers_like(kind), _LN2[scalar]
    word, one = builder.bitcast(x, llvm_type(integers)), constant(kind, 1.0)
    # The fraction m is in the range √½ to √2, where the series in s = (m - 1) / (m + 1) converges fast.
    shift, zero = constant(integers, mantissa), bias << mantissa
    exponent = builder.lshr(builder.add(word, constant(integers, zero - _SQUARE_ROOT_OF_HALF[scalar])), shift)
    fraction = builder.sub(builder.add(word, constant(integers, zero)), builder.shl(exponent, shift))
    fraction = builder.bitcast(fraction, llvm_type(kind))
    # The exponent is put into the last bits of a large number whose last bit represents 1; see `_exp`.
    whole = builder.or_(exponent, constant(integers, (bias + mantissa) << mantissa))
    whole = _subtract(builder, builder.bitcast(whole, llvm_type(kind)), constant(kind, 2.0**mantissa + bias))
    above = _subtract(builder, fraction, one)
    s = builder.fdiv(above, _add(builder, fraction, one), flags=FLAGS)
    z = _multiply(builder, s, s)
    series = [2.0 / (2 * i + 1) for i in range(_LOG_TERMS[scalar], 0, -1)]
    tail = _multiply(builder, z, _polynomial(builder, kind, z, series))
    # 2 s = m - 1 - s (m - 1), where m - 1 is exact, but the quotient s is not.
    tail = _multiply(builder, s, _subtract(builder, tail, above))
    tail = _add(builder, tail, _multiply(builder, whole, constant(kind, low)))
    return _add(builder, _multiply(builder, whole, constant(kind, high)), _add(builder, above, tail))


root = _elementwise(1, lambda b, kind, x: _call(b, "sqrt", kind, x), "Return square roots; NaN of negative numbers.")
magnitude = _elementwise(1, lambda b, kind, x: _call(b, "fabs", kind, x), "Return absolute values.")
with_sign = _elementwise(
    2, lambda b, kind, x, y: _call(b, "copysign", kind, x, y), "Return the absolute values of x with the signs of y."
)
lower_of = _elementwise(2, _lower, "Return the lower of two; the second where either is NaN.")
upper_of = _elementwise(2, _upper, "Return the upper of two; the second where either is NaN.")
exp = _elementwise(
    1,
    _exp,
    "Return exp(x) to 2 units in the last place, for x below 88 (float32) or 709 (float64); below -80 and -170 it stays"
    " at 2e-35 and 1e-74.",
)
log = _elementwise(1, _log, "Return the natural logarithm of normal positive numbers to 2 units in the last place.")


@intrinsic
def select(typingctx, mask, x, y):
    """Return x where the mask is set, and y elsewhere; with a vector mask, numbers are extended to vectors."""
    kind = common(x, y)
    if isinstance(mask, Vector) and mask.dtype == types.boolean and kind is not None:
        kind = kind if isinstance(kind, Vector) else Vector(kind, mask.count)
        fits = kind.count == mask.count
    else:
        fits = mask == types.boolean and kind is not None
    if not fits:
        raise TypingError(f"select found {mask}, {x}, {y}; accepted: a mask and two of one type and width")

    def codegen(context, builder, sig, args):
        return builder.select(args[0], *(widened(context, builder, args[i], sig.args[i], kind) for i in (1, 2)))

    return kind(mask, x, y), codegen


@intrinsic
def negated(typingctx, mask):
    """Return the logical negation of a mask or truth value."""
    if scalar_of(mask) != types.boolean:
        raise TypingError(f"negated found {mask}; accepted: a mask or a truth value")

    def codegen(context, builder, sig, args):
        return builder.not_(args[0])

    return mask(mask), codegen


def _conversion(from_type, to_type, method: str, about: str):
    def typed(typingctx, x):
        if scalar_of(x) != from_type:
            raise TypingError(f"{about} found {x}; accepted: {from_type}, numbers or a vector")
        kind = Vector(to_type, x.count) if isinstance(x, Vector) else to_type

        def codegen(context, builder, sig, args):
            return getattr(builder, method)(args[0], llvm_type(kind))

        return kind(x), codegen

    made = intrinsic(typed)
    made.__doc__ = about
    return made


truncated = _conversion(types.float32, types.int32, "fptosi", "Return float32 as int32, rounded towards zero.")
as_float = _conversion(types.int32, types.float32, "sitofp", "Return int32 as float32.")
bits_as_int = _conversion(types.float32, types.int32, "bitcast", "Return the bits of float32 as int32.")
bits_as_float = _conversion(types.int32, types.float32, "bitcast", "Return float32 of the bits in int32.")


@njit(cache=True, forceinline=True)
def circle_point(turns):
    """Return cosine and sine of an angle in turns, at most 2³⁰, with errors below 1e-15; of numbers only, in float64.

    This takes half the time of the mathematical library, whose functions reduce angles in radians of any size.
    """
    quarter = np.int64(np.floor(4.0 * turns + 0.5))
    x = (turns - 0.25 * quarter) * (2.0 * math.pi)  # from -π/4 to π/4
    y = x * x
    sine, cosine = 0.0, 0.0
    for factor in _SINE:
        sine = sine * y + factor
    for factor in _COSINE:
        cosine = cosine * y + factor
    sine *= x
    if quarter & 1:
        sine, cosine = cosine, -sine
    return (-cosine, -sine) if quarter & 2 else (cosine, sine)
