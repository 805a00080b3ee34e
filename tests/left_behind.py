"""What tests would leave to those after them: threads that a job was given, and an open browser.

A job limits the process in which it runs. Tests run many jobs in one process, and without this plugin those after a job
of two threads would all use two for linear algebra. Their matrices are small. While other tests keep the cores busy,
threads that wait for each other burn many times the processor time of the work. A browser is a dozen processes, which
the tests of hundreds of files would carry on: it is closed after the last test of a file.
"""

import os
import sys

import pytest
from threadpoolctl import threadpool_limits

#: Variables that `irodori.core.threads.use_threads` sets; the first always.
_SET = ("IRODORI_BUILD_THREADS", "BLOSC_NTHREADS", "NUMBA_NUM_THREADS")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item, nextitem):
    """Restore what `use_threads` has set, if anything in the test has called it; close browsers after a file."""
    before = {name: os.environ.pop(name, None) for name in _SET[:1]} | {n: os.environ.get(n) for n in _SET[1:]}
    try:
        return (yield)
    finally:
        if _SET[0] in os.environ:
            threadpool_limits(1)
            if numba := sys.modules.get("numba"):
                numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
            for name in _SET:
                os.environ.pop(name, None)
        os.environ.update({name: value for name, value in before.items() if value is not None})
        browser = sys.modules.get("irodori.viewer.browser")
        if browser and (nextitem is None or nextitem.path != item.path):
            browser.close_browsers()
            if times := item.config.pluginmanager.get_plugin("cpu times of tests"):
                times.begin()  # what processes have computed that ended now is known to nobody any more
