"""Compiled loops are those of the source: an equation corrected in one file is computed so in all."""

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PROBE = """
import numpy as np
from irodori.reflection.equation5 import gloss_factors
print(repr(float(gloss_factors(np.array([[0.5, 0.4, 0.45, 0.05]]), 1.5, 0.0)[0])))
"""


def probe(folder: Path) -> float:
    """Return a factor that compiled code computes in a process of its own."""
    run = subprocess.run([sys.executable, "-c", PROBE], cwd=folder, capture_output=True, text=True, timeout=200)
    assert run.returncode == 0, run.stderr
    return float(run.stdout)


def test_an_edited_equation_is_not_served_from_the_cache(tmp_path):
    shutil.copytree(ROOT / "irodori", tmp_path / "irodori", ignore=shutil.ignore_patterns("__pycache__"))
    before = probe(tmp_path)
    caches = sorted((tmp_path / "irodori" / "__pycache__").glob("kernels-*"))
    module = tmp_path / "irodori" / "reflection" / "equation5.py"
    module.write_text(module.read_text().replace("return 0.5 * rs * (1.0 +", "return 0.25 * rs * (1.0 +"))
    assert probe(tmp_path) == before / 2
    assert set(caches) < set((tmp_path / "irodori" / "__pycache__").glob("kernels-*"))
