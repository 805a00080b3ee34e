"""Faster calls of compiled loops whose arguments have complicated types."""

import numba


def resolved(kernel, *arguments):
    """Return the compiled function that a kernel would run for arguments of these types.

    A call of the kernel determines the types of all arguments again, which takes a millisecond for a scene of nested
    tuples. A call of the returned function does not, but all its arguments must have the same types.

    Parameters
    ----------
    kernel : callable
        Kernel made by `irodori.jit.compilation.njit`.
    arguments
        Arguments of any one call.
    """
    if not hasattr(kernel, "compile"):
        return kernel  # numba is switched off
    return kernel.compile(tuple(numba.typeof(argument) for argument in arguments))
