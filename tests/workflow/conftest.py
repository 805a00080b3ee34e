"""One small run of the whole workflow, shared by the tests of this folder."""

import fcntl
import os
import shutil
from pathlib import Path

import pytest
from project import small_project, snakemake


@pytest.fixture(scope="session")
def finished(tmp_path_factory) -> Path:
    """Return a working directory in which the whole chain has run; the processes of a test run share one.

    The first that asks runs the chain, and the others wait for it. It is to be read: what plans or runs in it takes a
    copy, `again`, for others may be copying it.
    """
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent
    folder, done = shared / "still-life", shared / "still-life.done"
    with open(shared / "still-life.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)  # of a run that failed
            run = snakemake(small_project(folder))
            assert run.returncode == 0, run.stderr[-4000:]
            (folder / "terminal.txt").write_text(run.stderr)
            done.touch()
    return folder


@pytest.fixture
def again(finished, tmp_path) -> Path:
    """Return a copy of the finished working directory that a test may change."""
    return Path(shutil.copytree(finished, tmp_path / "copy", copy_function=shutil.copy2))
