"""Faster calls of compiled loops whose arguments have complicated types."""


def resolved(kernel, *arguments):
    """Return the compiled function that a kernel would run for arguments of these types.

    See `irodori.jit.compilation.Kernel.resolved`; a call of the kernel would take a millisecond longer for a scene of
    nested tuples.

    Parameters
    ----------
    kernel : callable
        Kernel made by `irodori.jit.compilation.njit`.
    arguments
        Arguments of any one call.
    """
    return kernel.resolved(*arguments) if hasattr(kernel, "resolved") else kernel  # without, numba is switched off
