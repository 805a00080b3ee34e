"""Array views without reference counts, for compiled loops that pass many arrays.

A numba array counts its owners, at every assignment and call, with operations that two threads do in turn. Tuples of
thirty arrays handed from function to function spent most of a frame on that. `Memory` is the address alone: whoever
made it keeps the array alive. Shapes of more than one dimension have all but the first in the type; nothing is checked.
"""

import operator

import numpy as np
from llvmlite import ir
from numba import from_dtype, types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import NativeValue, intrinsic, lower_builtin, models, register_model, typeof_impl, unbox


class Memory:
    """A contiguous array as compiled code is given it; ``array`` keeps it alive in Python."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = np.ascontiguousarray(array)
        self.address = self.array.ctypes.data


class MemoryType(types.Type):
    """An address of numbers of a type, in rows of a shape."""

    def __init__(self, dtype, trailing: tuple[int, ...] = ()) -> None:
        self.dtype, self.trailing = dtype, trailing
        super().__init__(name=f"Memory({dtype}, {trailing})")


@typeof_impl.register(Memory)
def _typeof(value, context):
    return MemoryType(from_dtype(value.array.dtype), value.array.shape[1:])


@register_model(MemoryType)
class _MemoryModel(models.PrimitiveModel):
    def __init__(self, manager, kind) -> None:
        super().__init__(manager, kind, ir.IntType(64))


@unbox(MemoryType)
def _unbox(kind, value, c):
    address = c.pyapi.object_getattr_string(value, "address")
    native = c.pyapi.long_as_ulonglong(address)
    c.pyapi.decref(address)
    return NativeValue(native, is_error=cgutils.is_not_null(c.builder, c.pyapi.err_occurred()))


def element(context, builder, kind, address, index):
    """Return the pointer to a number; ``index`` counts numbers."""
    pointer = builder.inttoptr(address, context.get_data_type(kind.dtype).as_pointer())
    return builder.gep(pointer, [index])


def _place(context, builder, kind, index_type, index):
    """Return the number at which an index, an integer or a tuple of them, points."""
    if not isinstance(index_type, types.BaseTuple):
        return context.cast(builder, index, index_type, types.intp)
    integer = context.get_value_type(types.intp)
    place = ir.Constant(integer, 0)
    for axis, item in enumerate(index_type.types):
        if axis:
            place = builder.mul(place, ir.Constant(integer, kind.trailing[axis - 1]))
        place = builder.add(place, context.cast(builder, builder.extract_value(index, axis), item, types.intp))
    return place


def _fits(kind, index) -> bool:
    if isinstance(index, types.Integer):
        return not kind.trailing
    return isinstance(index, types.BaseTuple) and len(index) == 1 + len(kind.trailing)


@infer_global(operator.getitem)
class _Get(AbstractTemplate):
    def generic(self, args, kws):
        if isinstance(args[0], MemoryType) and _fits(*args):
            return signature(args[0].dtype, *args)
        return None


@infer_global(operator.setitem)
class _Set(AbstractTemplate):
    def generic(self, args, kws):
        if isinstance(args[0], MemoryType) and _fits(*args[:2]):
            return signature(types.void, args[0], args[1], args[0].dtype)
        return None


def _get(context, builder, sig, args):
    kind = sig.args[0]
    place = _place(context, builder, kind, sig.args[1], args[1])
    return context.unpack_value(builder, kind.dtype, element(context, builder, kind, args[0], place))


def _set(context, builder, sig, args):
    kind = sig.args[0]
    place = _place(context, builder, kind, sig.args[1], args[1])
    context.pack_value(builder, kind.dtype, args[2], element(context, builder, kind, args[0], place))
    return context.get_dummy_value()


for _index in (types.Integer, types.BaseTuple):
    lower_builtin(operator.getitem, MemoryType, _index)(_get)
    lower_builtin(operator.setitem, MemoryType, _index, types.Any)(_set)


@intrinsic
def memory_of(typingctx, array, index):
    """Return the memory of a flat array from an index on; the array must outlive it."""

    def codegen(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, value=args[0]).data
        return builder.ptrtoint(builder.gep(data, [args[1]]), ir.IntType(64))

    return MemoryType(array.dtype)(array, types.intp), codegen


@intrinsic
def address_of(typingctx, memory):
    """Return the address of a memory."""

    def codegen(context, builder, sig, args):
        return args[0]

    return types.uintp(memory), codegen


@intrinsic
def as_integers(typingctx, memory):
    """Return float32 memory as int32."""

    def codegen(context, builder, sig, args):
        return args[0]

    return MemoryType(types.int32)(memory), codegen


@intrinsic
def moved(typingctx, memory, numbers):
    """Return the memory that begins a count of numbers later."""

    def codegen(context, builder, sig, args):
        pointer = element(context, builder, sig.args[0], args[0], args[1])
        return builder.ptrtoint(pointer, ir.IntType(64))

    return memory(memory, types.intp), codegen
