"""Memory for the frames of nested calls, in one piece."""

from collections.abc import Callable

#: Slots of a frame of the length of a pointer: 256 kB, for which Python takes twice the memory and leaves half free.
_SLOTS = 1 << 15


def with_room_for_calls(function: Callable) -> Callable:
    """Give all calls that a function makes, at any depth, memory for their frames in one piece; return the function.

    CPython 3.11 to 3.13 take memory for the frames of Python functions in pieces of 16 kB. A call that does not fit
    into the last piece asks the system for another one, which is given back as the call returns. A loop at the end of a
    piece does this at each of its calls: numba asked 545,000 times while it compiled one kernel of the interactive
    renderer, for a fifth of the CPU time. A function with a large frame begins a piece for itself in which the frames
    of some thousand calls have room. Pages that no call reaches are never touched.

    Parameters
    ----------
    function : Python function that is no generator
        Its code is changed.
    """
    code = function.__code__
    function.__code__ = code.replace(co_stacksize=max(code.co_stacksize, _SLOTS))
    return function
