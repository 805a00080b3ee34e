"""A fixture of several files of tests: the configuration."""

import shutil

import pytest
from definitions import ROOT


@pytest.fixture
def root(tmp_path):
    """Return a working directory with a copy of the repository's configuration."""
    shutil.copytree(ROOT / "config", tmp_path / "work" / "config")
    return tmp_path / "work"
