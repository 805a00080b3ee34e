"""Turn SIGTERM and SIGHUP into exceptions, so that a rig is left at rest."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def ending_in_order() -> Iterator[None]:
    """End as Ctrl-C does, the rig stopped, where a batch system ends the process or a terminal is closed.

    Raises
    ------
    SystemExit
        With 128 and the signal's number, on SIGTERM and SIGHUP; a signal that somebody else handles, or that is ignored
        (``nohup``), stays as it is.
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
