"""Vectors (SIMD) as values in compiled code: texels of a fit, rays of a packet, channels of a colour.

numba has no such type, and its compiler vectorises loops over arrays only if it can prove that this is valid. Here the
type and number of the elements are part of the type: ``load(array, place, 16) * 2.0`` with float32 is one
multiplication on a machine with vectors of 512 bits, and two or four elsewhere.

Elements are float32, float64, int32, int64, or truth values (masks, the results of comparisons). ``+ - * /``, unary
minus and comparisons are defined between vectors of one type, and between a vector and a number, which is converted to
the type of the vector; ``& | ~`` between masks; ``& | << >>`` between integers. Thus one formula, with functions of
`irodori.jit.functions` and `select` instead of branches, can be used for numbers, vectors of texels and packets of
rays. All this is for nopython code only.
"""

import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import typeconv
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, lower_cast, models, register_model

#: Default width: float64 in 512 bits, which is compiled to several shorter vectors if the processor has no such long
#: ones.
LANES = 8
#: LLVM flags: products may be fused with sums; NaN and infinity are treated correctly.
FLAGS = ("contract",)
#: LLVM types for the elements of vectors.
SCALARS = {
    types.float32: ir.FloatType(), types.float64: ir.DoubleType(), types.int32: ir.IntType(32),
    types.int64: ir.IntType(64), types.boolean: ir.IntType(1),
}  # fmt: skip


class Vector(types.Type):
    """The numba type of a vector with ``count`` elements of ``dtype``, a key of `SCALARS`."""

    def __init__(self, dtype, count: int) -> None:
        self.dtype, self.count = dtype, count
        super().__init__(name=f"Vector({dtype}, {count})")

    def can_convert_from(self, typingctx, other):
        """Allow implicit conversion of numbers to vectors with equal lanes."""
        return typeconv.Conversion.safe if _takes(self, other) else None


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager, kind) -> None:
        super().__init__(manager, kind, llvm_type(kind))


def llvm_type(kind):
    """Return the LLVM type for the type of a vector or number."""
    return ir.VectorType(SCALARS[kind.dtype], kind.count) if isinstance(kind, Vector) else SCALARS[kind]


def scalar_of(kind):
    """Return the type of the elements of a vector, or the type of a number itself."""
    return kind.dtype if isinstance(kind, Vector) else kind


def constant(kind, value):
    """Return an LLVM constant of a type; for vectors it has the value in every lane."""
    return ir.Constant(llvm_type(kind), [value] * kind.count if isinstance(kind, Vector) else value)


def _takes(vector: Vector, kind) -> bool:
    """Return whether a type is that of numbers that can be converted to the elements of a vector."""
    if isinstance(vector.dtype, types.Float):
        return isinstance(kind, (types.Float, types.Integer))
    return isinstance(vector.dtype, types.Integer) and isinstance(kind, types.Integer)


def common(*kinds):
    """Return the type to which values of all given types can be converted, or None.

    This is the type of the vectors if there are any; else float32 if all numbers are float32, and float64 otherwise.
    """
    vectors = [k for k in kinds if isinstance(k, Vector)]
    if vectors:
        fits = all(k == vectors[0] if isinstance(k, Vector) else _takes(vectors[0], k) for k in kinds)
        return vectors[0] if fits else None
    if not all(isinstance(k, (types.Float, types.Integer)) for k in kinds):
        return None
    return types.float32 if all(k == types.float32 for k in kinds) else types.float64


def repeated(builder, number, kind: Vector):
    """Emit code for a vector with the number in every lane."""
    empty = ir.Constant(llvm_type(kind), ir.Undefined)
    first = builder.insert_element(empty, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(ir.IntType(32), kind.count), None))


def widened(context, builder, value, given, kind):
    """Emit code that converts a value from type ``given`` to ``kind``, a result of `common`."""
    if given == kind:
        return value
    number = context.cast(builder, value, given, scalar_of(kind))
    return repeated(builder, number, kind) if isinstance(kind, Vector) else number


def width_of(count: int) -> int:
    """Return the smallest width, a power of two of at least 4, for ``count`` numbers."""
    return max(4, 1 << int(np.ceil(np.log2(count))))


@lower_cast(types.Float, Vector)
@lower_cast(types.Integer, Vector)
def _vector_from_number(context, builder, from_type, to_type, value):
    return widened(context, builder, value, from_type, to_type)


def _is_float(kind: Vector) -> bool:
    return isinstance(kind.dtype, types.Float)


def _is_integer(kind: Vector) -> bool:
    return isinstance(kind.dtype, types.Integer)


def _is_mask(kind: Vector) -> bool:
    return kind.dtype == types.boolean


def _add_operator(function, result, codegen) -> None:
    """Define a binary operator between vectors, and between a vector and a number.

    ``result(kind)`` returns the type of the result for operands converted to ``kind``, or None if the operator is not
    defined for it. ``codegen(builder, kind, a, b)`` emits the operation.
    """

    @infer_global(function)
    class Typing(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) != 2 or not any(isinstance(a, Vector) for a in args):
                return None
            kind = common(*args)
            answer = None if kind is None else result(kind)
            return None if answer is None else signature(answer, *args)

    def lower(context, builder, sig, args):
        kind = common(*sig.args)
        return codegen(
            builder, kind, *(widened(context, builder, v, t, kind) for v, t in zip(args, sig.args, strict=True))
        )

    for left, right in ((Vector, Vector), (Vector, types.Number), (types.Number, Vector)):
        lower_builtin(function, left, right)(lower)


def _add_arithmetic(function, of_floats: str, of_integers: str = "") -> None:
    def result(kind):
        return kind if _is_float(kind) or (of_integers and _is_integer(kind)) else None

    def codegen(builder, kind, a, b):
        return (
            getattr(builder, of_floats)(a, b, flags=FLAGS) if _is_float(kind) else getattr(builder, of_integers)(a, b)
        )

    _add_operator(function, result, codegen)


def _add_comparison(function, symbol: str) -> None:
    def result(kind):
        return None if _is_mask(kind) else Vector(types.boolean, kind.count)

    def codegen(builder, kind, a, b):
        return (builder.fcmp_ordered if _is_float(kind) else builder.icmp_signed)(symbol, a, b)

    _add_operator(function, result, codegen)


def _add_bitwise(function, name: str, of_masks: bool) -> None:
    def result(kind):
        return kind if _is_integer(kind) or (of_masks and _is_mask(kind)) else None

    _add_operator(function, result, lambda builder, kind, a, b: getattr(builder, name)(a, b))


_add_arithmetic(operator.add, "fadd", "add")
_add_arithmetic(operator.sub, "fsub", "sub")
_add_arithmetic(operator.mul, "fmul", "mul")
_add_arithmetic(operator.truediv, "fdiv")
for _function, _symbol in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="), (operator.eq, "=="),
):  # fmt: skip
    _add_comparison(_function, _symbol)
_add_bitwise(operator.and_, "and_", True)
_add_bitwise(operator.or_, "or_", True)
_add_bitwise(operator.rshift, "ashr", False)
_add_bitwise(operator.lshift, "shl", False)


def _add_unary(function, takes, codegen) -> None:
    @infer_global(function)
    class Typing(AbstractTemplate):
        def generic(self, args, kws):
            return signature(args[0], *args) if isinstance(args[0], Vector) and takes(args[0]) else None

    @lower_builtin(function, Vector)
    def lower(context, builder, sig, args):
        return codegen(builder, args[0])


_add_unary(operator.neg, _is_float, lambda builder, x: builder.fneg(x))
_add_unary(operator.invert, _is_mask, lambda builder, x: builder.not_(x))
