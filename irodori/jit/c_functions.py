"""Calls of C functions by their address from compiled loops.

numba cannot cache code that contains the address of a C function. Here the address is an argument, so that kernels can
be stored on disk and used by all processes.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


def c_function(result, *arguments):
    """Make a function, for use in compiled code, that calls a C function by its address.

    Parameters
    ----------
    result, *arguments : numba types
        The C signature; pointers are ``types.uintp``.

    Returns
    -------
    callable ``(address, *arguments) -> result``, in nopython code only
    """

    def call(typingctx, address, *values):
        signature = result(types.uintp, *arguments)

        def codegen(context, builder, signature, values):
            c_arguments = [context.get_value_type(t) for t in arguments]
            c_result = ir.VoidType() if result == types.void else context.get_value_type(result)
            pointer = builder.inttoptr(values[0], ir.FunctionType(c_result, c_arguments).as_pointer())
            answer = builder.call(pointer, list(values[1:]))
            if result == types.void:
                return cgutils.get_null_value(ir.IntType(8).as_pointer())
            return answer

        return signature, codegen

    # intrinsic() inspects the parameters of the decorated function, so a function with the right number is made.
    names = ", ".join(f"a{i}" for i in range(len(arguments)))
    namespace = {"call": call}
    exec(f"def typed(typingctx, address, {names}):\n    return call(typingctx, address, {names})\n", namespace)
    return intrinsic(namespace["typed"])
