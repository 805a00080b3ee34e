"""One small run of the whole workflow, shared by the tests of this folder."""

import shutil
from pathlib import Path

import pytest
from project import small_project, snakemake


@pytest.fixture(scope="session")
def finished(tmp_path_factory) -> Path:
    """Return a working directory in which the whole chain has run."""
    folder = small_project(tmp_path_factory.mktemp("still-life"))
    run = snakemake(folder)
    assert run.returncode == 0, run.stderr[-4000:]
    return folder


@pytest.fixture
def again(finished, tmp_path) -> Path:
    """Return a copy of the finished working directory that a test may change."""
    return Path(shutil.copytree(finished, tmp_path / "copy", copy_function=shutil.copy2))
