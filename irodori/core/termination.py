"""Conversion of the signals SIGTERM and SIGHUP to exceptions, so that a rig is stopped before the process ends."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def ending_in_order() -> Iterator[None]:
    """Raise an exception in the block on SIGTERM and SIGHUP, so that the rig is stopped as after Ctrl-C.

    A batch system sends SIGTERM to end a job; the system sends SIGHUP when a terminal is closed.

    Raises
    ------
    SystemExit
        With the status 128 plus the signal's number. A signal that already has a handler, or is ignored (``nohup``), is
        left as it is.
    """

    def end(number: int, frame) -> None:
        raise SystemExit(128 + number)

    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is signal.SIG_DFL:
                before[number] = signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
