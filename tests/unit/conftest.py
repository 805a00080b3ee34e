"""Fixtures of several files of tests: the configuration, and light maps of few texels."""

import math
import shutil

import pytest
from definitions import ROOT

from irodori.rendering import light_transfer
from irodori.rendering.interactive import surroundings


@pytest.fixture
def root(tmp_path):
    """Return a working directory with a copy of the repository's configuration."""
    shutil.copytree(ROOT / "config", tmp_path / "work" / "config")
    return tmp_path / "work"


@pytest.fixture
def coarse_light_maps(monkeypatch):
    """Give light maps as few texels as tests of other things need; a hundredth of the rays is traced."""
    monkeypatch.setattr(light_transfer, "_FEWEST_TEXELS", 64)
    monkeypatch.setattr(light_transfer, "MOST_ERROR", math.inf)
    monkeypatch.setattr(surroundings, "TEXELS", 16)
