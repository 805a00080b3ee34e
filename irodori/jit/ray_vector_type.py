"""Numba type and operators of the vectors of `irodori.jit.ray_vectors`."""

import operator

from llvmlite import ir
from numba import types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_model

SCALARS = {"f": ir.FloatType(), "i": ir.IntType(32), "b": ir.IntType(1)}
#: Products may be fused with sums; NaN and infinity keep their meaning.
FLAGS = ("contract",)


class Lanes(types.Type):
    """A vector of ``count`` numbers of a kind."""

    def __init__(self, kind: str, count: int) -> None:
        self.kind, self.count = kind, count
        super().__init__(name=f"Lanes({kind}, {count})")

    @property
    def vector(self) -> ir.VectorType:
        """The compiler's type."""
        return ir.VectorType(SCALARS[self.kind], self.count)


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager, lanes) -> None:
        super().__init__(manager, lanes, lanes.vector)


def widened(context, builder, value, kind, lanes):
    """Return a value as a vector: one already, or a scalar repeated."""
    if isinstance(kind, Lanes):
        return value
    scalar = context.cast(builder, value, kind, types.float32 if lanes.kind == "f" else types.int32)
    return _repeated(builder, scalar, lanes)


def _repeated(builder, scalar, lanes):
    first = builder.insert_element(ir.Constant(lanes.vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(ir.IntType(32), lanes.count), None))


def common(args):
    """Return the vector type of two operands, None where they do not fit."""
    kinds = [a for a in args if isinstance(a, Lanes)]
    if not kinds or any(k != kinds[0] for k in kinds):
        return None
    if any(not isinstance(a, (Lanes, types.Number)) for a in args):
        return None
    return kinds[0]


_ARITHMETIC = {
    operator.add: {"f": "fadd", "i": "add"},
    operator.sub: {"f": "fsub", "i": "sub"},
    operator.mul: {"f": "fmul", "i": "mul"},
    operator.truediv: {"f": "fdiv"},
    operator.and_: {"i": "and_", "b": "and_"},
    operator.or_: {"i": "or_", "b": "or_"},
    operator.rshift: {"i": "ashr"},
    operator.lshift: {"i": "shl"},
}
_COMPARISONS = {operator.lt: "<", operator.le: "<=", operator.gt: ">", operator.ge: ">=", operator.eq: "=="}


def _add_arithmetic(function, names) -> None:
    class Typing(AbstractTemplate):
        def generic(self, args, kws):
            lanes = common(args) if len(args) == 2 else None
            return signature(lanes, *args) if lanes is not None and lanes.kind in names else None

    infer_global(function)(Typing)

    def lower(context, builder, sig, args):
        lanes = sig.return_type
        a, b = (widened(context, builder, v, t, lanes) for v, t in zip(args, sig.args, strict=True))
        method = getattr(builder, names[lanes.kind])
        return method(a, b, flags=FLAGS) if lanes.kind == "f" else method(a, b)

    for left, right in ((Lanes, Lanes), (Lanes, types.Number), (types.Number, Lanes)):
        lower_builtin(function, left, right)(lower)


def _add_comparison(function, symbol) -> None:
    class Typing(AbstractTemplate):
        def generic(self, args, kws):
            lanes = common(args) if len(args) == 2 else None
            return signature(Lanes("b", lanes.count), *args) if lanes is not None and lanes.kind in "fi" else None

    infer_global(function)(Typing)

    def lower(context, builder, sig, args):
        lanes = next(t for t in sig.args if isinstance(t, Lanes))
        a, b = (widened(context, builder, v, t, lanes) for v, t in zip(args, sig.args, strict=True))
        return (builder.fcmp_ordered if lanes.kind == "f" else builder.icmp_signed)(symbol, a, b)

    for left, right in ((Lanes, Lanes), (Lanes, types.Number), (types.Number, Lanes)):
        lower_builtin(function, left, right)(lower)


for _function, _names in _ARITHMETIC.items():
    _add_arithmetic(_function, _names)
for _function, _symbol in _COMPARISONS.items():
    _add_comparison(_function, _symbol)


@infer_global(operator.neg)
class _Negative(AbstractTemplate):
    def generic(self, args, kws):
        return signature(args[0], *args) if isinstance(args[0], Lanes) and args[0].kind == "f" else None


@lower_builtin(operator.neg, Lanes)
def _negative(context, builder, sig, args):
    return builder.fneg(args[0])


@infer_global(operator.invert)
class _Inverse(AbstractTemplate):
    def generic(self, args, kws):
        return signature(args[0], *args) if isinstance(args[0], Lanes) and args[0].kind == "b" else None


@lower_builtin(operator.invert, Lanes)
def _inverse(context, builder, sig, args):
    return builder.not_(args[0])
