"""Limits of a job's threads."""

import sys
from subprocess import run

import pytest


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
