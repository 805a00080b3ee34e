"""Thread limits for numba, BLAS and Embree."""

import os
import sys

from threadpoolctl import threadpool_limits


def use_threads(threads: int) -> None:
    """Limit this process to a number of threads, at most as many as the machine has."""
    threads = max(1, int(threads))
    if "numba" in sys.modules:
        import numba

        most = numba.config.NUMBA_NUM_THREADS  # set when numba is loaded
        numba.set_num_threads(min(threads, most))
    else:  # importing numba takes longer than a whole job without kernels
        os.environ["NUMBA_NUM_THREADS"] = str(min(threads, int(os.environ.get("NUMBA_NUM_THREADS", threads))))
    threadpool_limits(limits=threads)
    os.environ["IRODORI_BUILD_THREADS"] = str(threads)
    os.environ["BLOSC_NTHREADS"] = str(threads)  # read for each chunk that is packed or unpacked
