"""The documented commands of developers do what the documents say, each on little."""

import runpy
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import patience
import pytest
import trimesh
from documented import ROOT, of_kind, words_of

from irodori.calibration import filters
from irodori.config import write_models
from irodori.spectra import write_published_tables


def rank_filters(words, folder, monkeypatch, capsys):
    """Rank the neutral filter and a comb that the documents' two files could hold."""
    nm = np.arange(400, 701, 10)
    bands = np.exp(-0.5 * ((nm[:, None] - [610.0, 540.0, 460.0]) / 30.0) ** 2)
    lines = ["wavelength_nm,red,green,blue", *(",".join(map(str, (w, *row))) for w, row in zip(nm, bands, strict=True))]
    Path("sensitivities.csv").write_text("\n".join(lines))
    Path("transmittances").mkdir()
    for name, values in {"comb": 0.5 + 0.5 * np.cos(nm / 12.0), "neutral": np.full(len(nm), 0.5)}.items():
        rows = (f"{w},{v}" for w, v in zip(nm, values, strict=True))
        Path(f"transmittances/{name}.csv").write_text("\n".join(["wavelength_nm,transmittance", *rows]))
    assert filters.main(words) == 0
    printed = capsys.readouterr().out
    assert printed.index("comb") < printed.index("neutral")


def write_anew(words, folder, monkeypatch, capsys):
    """Write models and key tables to copies from which a line is missing: they become what is stored."""
    for name in ("MODELS", "README"):
        stored = getattr(write_models, name)
        copy = folder / stored.name
        text = stored.read_text(encoding="utf-8")
        copy.write_text(text if name == "README" else text[:100], encoding="utf-8")
        monkeypatch.setattr(write_models, name, copy)
    write_models.main()
    for copy, stored in (("models.py", "irodori/config/models.py"), ("README.md", "config/README.md")):
        assert (folder / copy).read_text(encoding="utf-8") == (ROOT / stored).read_text(encoding="utf-8")


def write_tables(words, folder, monkeypatch, capsys):
    """Write the published tables elsewhere: they hold what is stored."""
    write_published_tables.write_published_tables(folder / "tables.h5")
    with h5py.File(folder / "tables.h5") as made, h5py.File(write_published_tables.TABLES) as stored:
        names: list[str] = []
        made.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        assert len(names) > 4
        for name in names:
            assert np.array_equal(made[name][()], stored[name][()]), name


def turn_a_lid(words, folder, monkeypatch, capsys):
    """Write the example's mesh: that of the repository."""
    Path("config/meshes").mkdir(parents=True)
    monkeypatch.setattr(sys, "argv", ["lathe.py", *words])
    runpy.run_path(str(ROOT / "tests/lathe.py"), run_name="__main__")
    made, stored = (trimesh.load(path, force="mesh") for path in (words[0], ROOT / words[0]))
    assert np.array_equal(made.vertices, stored.vertices)


def make_environment(words, folder, monkeypatch, capsys):
    """Make it without pip, which takes seconds to unpack."""
    subprocess.run([sys.executable, "-m", "venv", *words, "--without-pip"], check=True)
    assert (folder / ".venv/bin/activate").is_file()


_RUNS = {
    "irodori.calibration.filters": rank_filters,
    "irodori.config.write_models": write_anew,
    "irodori.spectra.write_published_tables": write_tables,
    "tests/lathe.py": turn_a_lid,
    "venv": make_environment,
}


@pytest.mark.parametrize("command", of_kind("tool"))
def test_a_documented_tool_does_its_work(command, tmp_path, monkeypatch, capsys):
    words = [word for word in words_of(command) if word not in ("python", "python3", "-m")]
    monkeypatch.chdir(tmp_path)
    _RUNS[words[0]](words[1:], tmp_path, monkeypatch, capsys)


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("command", of_kind("pytest"))
def test_a_documented_selection_of_tests_selects_some(command, tmp_path):
    """One file, which has tests of every kind, stands for all of them; they are collected and not run."""
    words = words_of(command)[1:]
    words = [str(tmp_path / "table.csv").join(word.split("FILE")) for word in words]
    if not [word for word in words if word.startswith("tests/")]:
        words.append("tests/rig/test_rig_faults.py")
    run = patience.run([sys.executable, "-m", "pytest", "--collect-only", "-q", "-n", "0", *words], cwd=ROOT)
    assert run.returncode == 0 and "::test_" in run.stdout, run.stdout[-2000:]
