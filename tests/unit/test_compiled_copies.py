"""A process that compiles a loop computes what one computes that reads it from the disk, to the last bit."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
_FIT = """
import sys
import numpy as np
sys.path[:0] = [sys.argv[2]]
from benchmarks.fit import inputs, scene
from irodori.fitting.solvers import FitOptions, fit
found = [fit(*inputs(scene(256)[3], kind), FitOptions()) for kind in ("own", "shared")]
np.save(sys.argv[1], np.stack([np.concatenate([r.alpha, r.beta, r.mu, r.beta_error]) for r in found]))
"""


@pytest.mark.heavy
def test_a_fit_that_was_just_compiled_has_the_bits_of_one_that_was_read(tmp_path):
    results = []
    for turn in ("compiles", "reads"):
        output = tmp_path / f"{turn}.npy"
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
        subprocess.run([sys.executable, "-c", _FIT, str(output), str(ROOT)], env=environment, check=True)
        results.append(np.load(output).view(np.uint64))
        assert list((tmp_path / "kernels").rglob("*.nbc"))
    assert np.isfinite(results[0].view(np.float64)).mean() > 0.5
    assert np.array_equal(*results)


def test_every_compiled_loop_is_told_to_keep_its_copies():
    for file in sorted((ROOT / "irodori").rglob("*.py")):
        source = file.read_text(encoding="utf-8")
        if file == ROOT / "irodori/jit/compilation.py":
            continue
        assert not re.search(r"numba\.(njit|jit|guvectorize|vectorize|cfunc)\b", source), file
        if re.search(r"@(njit|uncounted|cfunc)\b", source):
            assert re.search(r"^from irodori\.jit\.(native|compilation) import", source, re.MULTILINE), file
