"""Request for memory that is soon read, so that the processor need not wait for it then."""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from irodori.jit.vector_memory import pointer


@intrinsic
def prefetch(typingctx, array, place):
    """Ask for the line of the cache that holds the element of an array at a flat index, which is not checked."""

    def codegen(context, builder, sig, args):
        byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        at = builder.bitcast(pointer(context, builder, sig.args[0], args[0], args[1]), byte)
        function = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        target = cgutils.get_or_insert_function(builder.module, function, "llvm.prefetch.p0i8")
        builder.call(target, [at, *(ir.Constant(number, value) for value in (0, 3, 1))])
        return context.get_dummy_value()

    return types.void(array, types.intp), codegen
