"""References and child processes of the benchmarks, and peers that cannot run."""

import os
import subprocess

import numpy as np
import pytest
from equation5_written_out import gloss_factors
from scipy.optimize import nnls

from benchmarks import compress, reference, table
from benchmarks.fit import K, N, angles, brute_force, scene
from benchmarks.speed_page import front, is_measured, read_rows, write_speed_report
from benchmarks.table import COLUMNS, printed_by, row_without_figures, why_it_fails


@pytest.mark.parametrize("noise", [0.01, 0.3])
def test_the_dense_scan_finds_the_least_nonnegative_least_squares_of_its_grid(noise):
    response, mus = scene(12, noise=noise)[3], np.geomspace(0.01, 1.2, 25)
    geometry = angles().astype(np.float32).astype(np.float64)
    cosine, plain = np.cos(geometry[:, 0]), gloss_factors(geometry, N, K)
    lobes = [plain * np.exp(-np.square(geometry[:, 3] / mu)) for mu in mus]
    expected = [
        min(nnls(np.stack([cosine, lobe], axis=1), rho)[1] ** 2 for lobe in lobes)
        for rho in response.astype(np.float64)
    ]
    # The sum of squares is a difference of numbers up to 1e5 times as large.
    np.testing.assert_allclose(brute_force(response, mus), expected, rtol=1e-9)


def test_a_black_texel_leaves_nothing_and_one_below_zero_is_left_as_it_is():
    response = np.stack([np.zeros(48), np.full(48, -0.1)]).astype(np.float32)
    found = brute_force(response, np.geomspace(0.01, 1.2, 25))
    np.testing.assert_allclose(found, np.sum(response.astype(np.float64) ** 2, axis=1), rtol=1e-12)


def test_a_process_that_fails_is_not_taken_for_one_that_prints_nothing():
    assert "usage" in printed_by("stability", [("--help",)])[0]
    with pytest.raises(subprocess.CalledProcessError):
        printed_by("stability", [("--help",), ("--nonsense",)])


def figures(variant: str) -> dict:
    """Return a row of a variant that was measured."""
    values = ("render", variant, "9", "paths", "1.0", "9", "mean CIEDE2000", "0.4", "200", variant, "1.0")
    return dict(zip(COLUMNS, values, strict=True))


@pytest.mark.parametrize(
    ("program", "expected"),
    [
        ("pass", ""),
        ("import os, sys; print('a warning', file=sys.stderr); print('LLVM ERROR: no such thing\\n  more', "
         "file=sys.stderr, flush=True); os.abort()", "ended by SIGABRT: LLVM ERROR: no such thing"),
        ("import os; os.kill(os.getpid(), 11)", "ended by SIGSEGV: nothing said"),
        ("raise ImportError('no library')", "ImportError: no library"),
        ("raise SystemExit(3)", "nothing said"),
    ],
)  # fmt: skip
def test_a_peer_is_tried_in_a_process_that_may_crash(program, expected):
    assert why_it_fails("-c", program) == expected


def test_a_peer_that_hangs_is_given_up(monkeypatch):
    monkeypatch.setattr(table, "_PROBE_S", 0.5)
    assert why_it_fails("-c", "import time; time.sleep(60)") == "no answer in 0 s"


@pytest.fixture
def broken_mitsuba(tmp_path, monkeypatch):
    """Put a Mitsuba on the path of processes that loads every scene and is ended by a signal at the first picture."""
    (tmp_path / "mitsuba.py").write_text(
        "import os, sys\n"
        "class ScalarTransform4f:\n"
        "    def __init__(self, *matrix): pass\n"
        "    def look_at(self, *places): return self\n"
        "def set_variant(name): pass\n"
        "def load_dict(scene): return scene\n"
        "def render(*scene, **options):\n"
        "    print('LLVM ERROR: Cannot select: fminimum', file=sys.stderr, flush=True)\n"
        "    os.abort()\n"
    )
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))


def test_a_mitsuba_that_a_signal_ends_leaves_its_row_and_everything_else_is_measured(
    broken_mitsuba, monkeypatch, tmp_path
):
    compared = []

    def compare(name, stage, arguments):
        compared.append((name, arguments.variants))
        return [figures(f"reference-spectral {name}")]

    monkeypatch.setattr(reference, "compare", compare)
    output = tmp_path / "reference.csv"
    monkeypatch.setattr("sys.argv", ["reference", "--size", "small", "--runs", "5", "--output", str(output),
                                     "--variants", "llvm_ad_spectral"])  # fmt: skip
    reference.main()
    assert compared == [("spheres", [])]
    measured, absent = read_rows(output)
    assert is_measured(measured) and not is_measured(absent)
    reason = "cannot run: ended by SIGABRT: LLVM ERROR: Cannot select: fminimum"
    assert {name: value for name, value in absent.items() if value} == {
        "stage": "render", "variant": "mitsuba-llvm spheres", "error_metric": reason}  # fmt: skip
    assert front([measured, absent]) == ["reference-spectral spheres"]
    (tmp_path / "materials.csv").write_text("part\n")
    write_speed_report(
        [output], tmp_path / "materials.csv", "small", tmp_path / "speed_error.csv", tmp_path / "page.html"
    )
    assert f"mitsuba-llvm spheres: {reason}" in (tmp_path / "page.html").read_text()
    assert read_rows(tmp_path / "speed_error.csv") == [measured, absent]


def test_without_scikit_learn_the_compression_is_measured_all_the_same(monkeypatch, tmp_path):
    monkeypatch.setitem(compress.PEERS, "sklearn-incremental", "raise ImportError('no scikit-learn')")
    monkeypatch.setattr(compress, "make_picture", lambda *_: None)
    monkeypatch.setattr(compress, "measured", lambda folder, name: {"peak_mb": 100.0})
    monkeypatch.setattr(compress, "run", lambda *_: None)
    rows = compress.measure(tmp_path, "small", ["sklearn-incremental", "pca-4"], 5, 1)
    assert [row["variant"] for row in rows if is_measured(row)] == ["read-blas", "pca-4"]
    assert rows[-1] == row_without_figures("compress", "sklearn-incremental", "ImportError: no scikit-learn")
