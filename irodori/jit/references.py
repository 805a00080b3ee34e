"""Named tuples in memory that compiled functions hand on by their address.

numba hands on a tuple as one argument for each number in it, and as seven for each array. A scene has hundreds of them.
By value, every function of a kernel takes them apart and puts them together again for each of its calls; compiling that
took a third of the frames' kernel.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import NumbaTypeError
from numba.core.imputils import impl_ret_borrowed, lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import intrinsic, models, register_model


class Reference(types.Type):
    """Address of a named tuple that is not written to; its fields are read as those of the tuple itself.

    Parameters
    ----------
    target : numba type of a named tuple
    """

    def __init__(self, target) -> None:
        self.target = target
        super().__init__(name=f"{type(self).__name__}({target.name})")

    @property
    def key(self) -> tuple:
        """Identity of the type: two classes of named tuples may have the same name."""
        return type(self), self.target

    @property
    def instance_class(self) -> type:
        """Class of the named tuple, as of its own numba type."""
        return self.target.instance_class


class Address(Reference):
    """The same in the function that wrote the tuple, in which nothing is read from it."""


@register_model(Reference)
@register_model(Address)
class _AddressModel(models.PrimitiveModel):
    def __init__(self, manager, address) -> None:
        super().__init__(manager, address, manager.lookup(address.target).get_value_type().as_pointer())


@intrinsic
def address_of(typingctx, value):
    """Write a named tuple to memory and return its `Address`, for a function that is called with it at once.

    The memory is the caller's: it ends with it, and the same statement, in a loop, writes to it again. Only uncounted
    functions may do so: others would free arrays of the tuple at their last use by name.
    """
    if not isinstance(value, types.BaseNamedTuple):
        return None

    def codegen(context, builder, signature, arguments):
        if context.enable_nrt:
            raise NumbaTypeError("addresses are taken in uncounted functions, which free no array meanwhile")
        return cgutils.alloca_once_value(builder, arguments[0])

    return Address(value)(value), codegen


@intrinsic
def at_address(typingctx, address):
    """Return the `Reference` to a named tuple whose address was handed on.

    The function that calls this is never made a part of its callers. Within it nothing changes the tuple, which the
    compiler is told; within the one that writes it, that would not be true.
    """
    if not isinstance(address, Address):
        return None

    def codegen(context, builder, signature, arguments):
        builder.function.attributes.add("noinline")
        return arguments[0]

    return Reference(address.target)(address), codegen


@infer_getattr
class _FieldTypes(AttributeTemplate):
    key = Reference

    def generic_resolve(self, reference, name):
        if isinstance(reference, Address) or name not in reference.target.fields:
            return None
        field = reference.target.types[reference.target.fields.index(name)]
        return Reference(field) if isinstance(field, types.BaseNamedTuple) else field


@lower_getattr_generic(Reference)
def _field(context, builder, reference, pointer, name):
    at = reference.target.fields.index(name)
    field, place = reference.target.types[at], cgutils.gep_inbounds(builder, pointer, 0, at)
    if isinstance(field, types.BaseNamedTuple):
        return place
    return impl_ret_borrowed(context, builder, field, _load(builder, place))


def _load(builder, place):
    """Load a value number by number, each as one that never changes, so that it may be read once before a loop."""
    kind = place.type.pointee
    if not isinstance(kind, ir.LiteralStructType | ir.ArrayType):
        loaded = builder.load(place)
        loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
        return loaded
    whole = ir.Constant(kind, ir.Undefined)
    for at in range(len(kind.elements) if isinstance(kind, ir.LiteralStructType) else kind.count):
        whole = builder.insert_value(whole, _load(builder, cgutils.gep_inbounds(builder, place, 0, at)), at)
    return whole
