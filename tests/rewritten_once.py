"""Assertions of all test files rewritten once, before the processes of a run begin.

Of a new checkout, each of the processes would rewrite every file: they collect the same files at the same time, and
none would find what another one has kept. It is half of what collection computes there.
"""

import os
import sys

import pytest
from _pytest.assertion import rewrite


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session):
    """Rewrite and keep what is new, on two cores, where processes are about to collect everything."""
    config = session.config
    everything = config.args == config.getini("testpaths")
    if sys.dont_write_bytecode or not everything or not config.getoption("numprocesses", 0):
        return
    files = [file for folder in config.args for file in sorted((config.rootpath / folder).rglob("test_*.py"))]
    kept = {file: rewrite.get_cache_dir(file) / f"{file.stem}{rewrite.PYC_TAIL}" for file in files}
    new = [file for file in files if rewrite._read_pyc(file, kept[file]) is None]
    other = os.fork() if new else None
    for file in new[other == 0 :: 2]:
        if rewrite.try_makedirs(kept[file].parent):
            source_hash, code = rewrite._rewrite_test(file, config)
            rewrite._write_pyc(config.stash[rewrite.assertstate_key], code, source_hash, kept[file])
    if other == 0:
        os._exit(0)
    if other:
        os.waitpid(other, 0)
