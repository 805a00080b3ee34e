"""Vectorisable exponential function.

numba calls the C library for `math.exp`, one number at a time. The polynomial here is exact to a few units in the last
place, and a loop that calls it is vectorised.
"""

import math

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from irodori.jit.native import njit

_LOG2_E = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
# Denormal numbers are slow: the result ends where its square and its products with weights are still normal.
_SMALLEST_EXPONENT = -170.0


@intrinsic
def _power_of_two(typingctx, exponent):
    """Return 2 to a whole float64 within -1022..1023."""
    signature = types.float64(types.float64)

    def codegen(context, builder, signature, values):
        whole = builder.fptosi(values[0], ir.IntType(64))
        biased = builder.add(whole, ir.Constant(ir.IntType(64), 1023))
        return builder.bitcast(builder.shl(biased, ir.Constant(ir.IntType(64), 52)), ir.DoubleType())

    return signature, codegen


@njit(cache=True, fastmath={"contract"}, inline="always")
def exp_negative(x):
    """Return exp(x) for x <= 0 to 1e-15 of its value; below -170 it stays at 1e-74."""
    bounded = x if x > _SMALLEST_EXPONENT else _SMALLEST_EXPONENT
    whole = math.floor(bounded * _LOG2_E + 0.5)
    r = (bounded - whole * _LN2_HIGH) - whole * _LN2_LOW
    p = 1.0 / 479001600.0
    p = p * r + 1.0 / 39916800.0
    p = p * r + 1.0 / 3628800.0
    p = p * r + 1.0 / 362880.0
    p = p * r + 1.0 / 40320.0
    p = p * r + 1.0 / 5040.0
    p = p * r + 1.0 / 720.0
    p = p * r + 1.0 / 120.0
    p = p * r + 1.0 / 24.0
    p = p * r + 1.0 / 6.0
    p = p * r + 0.5
    p = p * r + 1.0
    p = p * r + 1.0
    return p * _power_of_two(whole)
