"""Limits of a job's threads."""

import sys
from subprocess import run

import pytest
from threadpoolctl import threadpool_info

from irodori.core.threads import use_threads


@pytest.mark.parametrize("first", ["", "import numba"])
def test_a_job_has_its_number_of_threads_whenever_numba_is_loaded(first):
    use = f"""
{first}
from irodori.core.threads import use_threads
use_threads(1)
import numba
print(numba.get_num_threads())
"""
    assert run([sys.executable, "-c", use], capture_output=True, text=True, check=True).stdout == "1\n"


def blas_threads() -> set[int]:
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_a_job_in_a_test_has_its_threads():
    use_threads(2)
    assert blas_threads() == {2}


def test_the_tests_after_it_have_one_again():
    assert blas_threads() == {1}
