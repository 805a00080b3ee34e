"""Calls of compiled loops whose arguments have types that take long to work out."""

import numba


def resolved(kernel, *arguments):
    """Return what a kernel runs for arguments of these types.

    Calling a kernel works out the types of all arguments anew, a millisecond for a scene of nested tuples; calling
    what is returned does not, and arguments of other types are not allowed.

    Parameters
    ----------
    kernel : callable
        Made by `irodori.jit.compilation.njit`.
    arguments
        Of one call.
    """
    if not hasattr(kernel, "compile"):
        return kernel  # numba is switched off
    return kernel.compile(tuple(numba.typeof(argument) for argument in arguments))
