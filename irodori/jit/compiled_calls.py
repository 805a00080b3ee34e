"""Faster calls of compiled loops whose arguments have complicated types."""

import numba
import numpy as np
from numba.core.dispatcher import Dispatcher

_FOUND: dict = {}


def _kind(argument):
    """Return what an argument's compiled type depends on, as a key."""
    if isinstance(argument, np.ndarray):
        flags = argument.flags
        return argument.dtype, argument.ndim, flags.c_contiguous, flags.f_contiguous, flags.writeable, flags.aligned
    if isinstance(argument, tuple):
        return (type(argument), *map(_kind, argument))
    return argument if isinstance(argument, Dispatcher) else type(argument)


def resolved(kernel, *arguments):
    """Return the compiled function that a kernel would run for arguments of these types.

    A call of the kernel determines the types of all arguments again, which takes milliseconds for a scene of nested
    tuples. A call of the returned function does not, but all its arguments must have the same types. What was found is
    kept.

    Parameters
    ----------
    kernel : callable
        Kernel made by `irodori.jit.compilation.njit`.
    arguments
        Arguments of any one call: arrays, numbers, compiled functions, and tuples of these.
    """
    if not hasattr(kernel, "compile"):
        return kernel  # numba is switched off
    key = kernel, _kind(arguments)
    if key not in _FOUND:
        _FOUND[key] = kernel.compile(tuple(numba.typeof(argument) for argument in arguments))
    return _FOUND[key]
