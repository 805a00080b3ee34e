"""A process that compiles a loop computes what one computes that reads it from the disk, to the last bit."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scenes import fresnel

from irodori.jit.compilation import njit

ROOT = Path(__file__).resolve().parents[2]
#: Fits of a lobe from outside, for which no other test compiles the fit: every texel's own geometry, and one for all.
_FIT = """
import sys
import numpy as np
import toy_lobe
from irodori.fitting.solvers import FitOptions, fit
from irodori.reflection.lobe import Lobe
from irodori.reflection.registry import register
register(Lobe.of_module(toy_lobe))
given, options = np.load(sys.argv[1]), FitOptions(lobes=("toy",), bounds={"mu_rad": (0.005, 1.2)})
response, geometry = given["response"], given["geometry"]
found = [fit(response, each, np.ones_like(response), options=options)
         for each in (np.tile(geometry, (len(response), 1, 1)), geometry)]
np.save(sys.argv[2], np.stack([[r.alpha, r.beta, r.mu, r.beta_error] for r in found]))
"""


def toy_plates():
    """Return angles, true α, β and μ of four plates, (3, 4), and their responses, exact and with noise."""
    # Its lobe from outside would count among the package's own where tests are collected after this file.
    from test_lobes_rendered import term

    light, view = np.radians(np.mgrid[0:70:6j, 10:60:5j].reshape(2, -1))
    geometry = np.stack([light, view, (light + view) / 2, abs(light - view) / 2], axis=1)
    mu = np.array([0.06, 0.1, 0.2, 0.4])
    cos_i, cos_r, cos_h, cos_phi = np.cos(geometry).T
    gloss = np.stack([fresnel(cos_h, 1.5, 0.0) * term("toy", m, cos_i, cos_r, cos_phi, cos_h) for m in mu])
    beta = 1.0 / gloss.max(axis=1)
    exact = 0.3 * cos_i + beta[:, None] * gloss
    noisy = np.tile(exact, (63, 1)) * np.random.default_rng(1).normal(1.0, 0.01, (252, len(geometry)))
    return geometry, np.stack([0.3 + 0.0 * mu, beta, mu]), np.concatenate([exact, noisy])


@pytest.mark.heavy
def test_a_fit_that_was_just_compiled_has_the_bits_of_one_that_was_read(tmp_path):
    """And noiseless plates come back to six digits: slopes are the lobe's own, not the package's."""
    geometry, truth, response = toy_plates()
    np.savez(tmp_path / "given.npz", geometry=geometry, response=response)
    results, paths = [], os.pathsep.join([str(ROOT), str(Path(__file__).parent)])
    for turn in ("compiles", "reads"):
        output = tmp_path / f"{turn}.npy"
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kernels"), "PYTHONPATH": paths}
        command = [sys.executable, "-c", _FIT, str(tmp_path / "given.npz"), str(output)]
        subprocess.run(command, env=environment, check=True)
        results.append(np.load(output))
        assert list((tmp_path / "kernels").rglob("*.nbc"))
    assert np.isfinite(results[0]).mean() > 0.5
    assert np.array_equal(*(found.view(np.uint64) for found in results))
    for found in results[0]:
        np.testing.assert_allclose(found[:3, :4], truth, rtol=1e-6)


def test_every_compiled_loop_is_told_to_keep_its_copies():
    for file in sorted((ROOT / "irodori").rglob("*.py")):
        source = file.read_text(encoding="utf-8")
        if file == ROOT / "irodori/jit/compilation.py":
            continue
        assert not re.search(r"numba\.(njit|jit|guvectorize|vectorize|cfunc)\b", source), file
        if re.search(r"@(njit|uncounted|cfunc)\b", source):
            assert re.search(r"^from irodori\.jit\.(native|compilation) import", source, re.MULTILINE), file


def test_a_resolved_loop_is_that_of_the_types_of_its_arguments():
    @njit
    def weighted(parts):
        values, weight = parts
        total = 0 * weight
        for index in range(values.size):
            total += values[index] * weight
        return total // 2

    numbers = np.arange(1, 9)
    given = [(numbers, 3), (numbers[::2], 3), (numbers, 2.5), (numbers.astype(np.float32), 3), (numbers > 4, 3)]
    loops = [weighted.resolved(parts) for parts in given]
    assert len(set(loops)) == len(given)
    assert weighted.resolved((numbers[:2] + 5, 9)) is loops[0]
    assert [loop(parts) for loop, parts in zip(loops, given, strict=True)] == [54, 24, 45.0, 54.0, 6]
