"""Progress bars on a terminal, plain lines in a log, and the log of a rule's script."""

import logging
import sys
import time
from collections.abc import Iterable, Iterator, Sized
from contextlib import contextmanager

from irodori.core.errors import PlainError

LOGGER = logging.getLogger("irodori")
_EVERY_S = 5.0  # between two lines in a log


def track(items: Iterable, label: str) -> Iterator:
    """Yield the items, reporting how many are done.

    Parameters
    ----------
    items : iterable
    label : str
        Name of the items in the report.
    """
    total = len(items) if isinstance(items, Sized) else None
    # Inside a rule the terminal is Snakemake's and may show several jobs at once: progress goes to the rule's log.
    if sys.stderr.isatty() and not LOGGER.handlers:
        from tqdm import tqdm

        yield from tqdm(items, desc=label, total=total)
        return
    last = time.monotonic()
    for done, item in enumerate(items, start=1):
        yield item
        now = time.monotonic()
        if now - last >= _EVERY_S or done == total:
            LOGGER.info("%s: %d of %s", label, done, total if total is not None else "?")
            last = now


@contextmanager
def rule_log(path) -> Iterator[None]:
    """Send the messages and any traceback of a rule's script to the rule's log file.

    Raises
    ------
    SystemExit
        After a `PlainError`; its message goes to the log and to stderr, without a traceback.
    """
    with open(str(path), "w", encoding="utf-8") as stream:
        handler = logging.StreamHandler(stream)
        handler.setFormatter(logging.Formatter("%(asctime)s %(message)s", datefmt="%H:%M:%S"))
        LOGGER.addHandler(handler)
        LOGGER.setLevel(logging.INFO)
        try:
            yield
        except PlainError as error:
            LOGGER.error("%s", error)
            print(error, file=sys.stderr)
            raise SystemExit(1) from None
        except Exception:
            LOGGER.exception("stopped")
            raise
        finally:
            LOGGER.removeHandler(handler)
            handler.close()
