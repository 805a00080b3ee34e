"""The documented commands of benchmarks run, each on so little that its figures say nothing.

What a benchmark takes from measured results it takes from those that the tests share. The tables of sizes, which the
options ``--size`` choose from, are replaced by one tiny size, of which each variant is timed once.
"""

import csv
import functools
import importlib
import shutil
import sys
import timeit
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from documented import of_kind, words_of
from project import ROOT, planned, snakemake

from benchmarks import (
    coverage,
    exports,
    imperfections,
    published_tables,
    render,
    scaling,
    site_figures,
    table,
    ten_megapixels,
)
from irodori.config.models import Size
from irodori.evaluation.result_tables import ErrorRow, read_rows
from irodori.viewer import stage

_FRAME = {"environment": 64, "width": 16, "height": 12}
_LIGHT = importlib.import_module("benchmarks.light")
_MATERIALS = importlib.import_module("benchmarks.materials")
_CALIBRATE = importlib.import_module("benchmarks.calibrate")


def in_this_process(monkeypatch, capsys):
    """Return what stands in for the processes in which the render benchmark makes its inputs and measures memory."""

    def printed_by(name, calls):
        found = []
        for words in calls:
            monkeypatch.setattr("sys.argv", [name, "--size", "small", *words])
            render.main()
            found.append(capsys.readouterr().out)
        return found

    return printed_by


#: Names of each benchmark that are replaced, and what is added to the documented words.
_TINY = {
    "calibrate": {
        "CAMERAS": _CALIBRATE.CAMERAS[1:2] * 2,
        "NOISES": (0.003,),
        "SEEDS": (0,),
        "ESTIMATORS": ("pinv", "ridge"),
        "SETS": dict.fromkeys(_CALIBRATE.SETS, _CALIBRATE.SETS["classic"]),
        "cross_validate": lambda training: ({}, {}),
        "choose": lambda *_: ("ridge", 6),
        "print_response_models": functools.partial(
            _CALIBRATE.print_response_models, ("canon_eos_40d",), ("MIDOPT_NF550",)
        ),
    },
    "compress": {"SIZES": {"small": (120, 240)}, "VARIANTS": {"small": ("pca-4", "decode-pca-4")}},
    "environment": {"HEIGHTS": {"small": 16}, "MAX_HEIGHTS": {"small": 16}},
    "fit": {
        "TEXELS": {"small": {"varpro": 500, "nlopt": 40, "nlopt-reference": 10}},
        "CHECKED": {"small": 20},
        "CHECKED_OF_REFERENCE": 10,
    },
    "ingest": {"SIZES_PX": {"small": (480, 320)}},
    "light": {
        "HEIGHTS": {"small": 8},
        "CIE": _LIGHT.CIE[:1],
        "errors": functools.partial(_LIGHT.errors, names=_LIGHT.CIE[:1]),
        "medians_s": lambda work, runs: {name: timeit.timeit(once, number=1) for name, once in work.items()},
        "WALLS": _LIGHT.WALLS[:1],
        "VARIANTS": {name: _LIGHT.VARIANTS[name] for name in ("rig-lamp", "mixture")},
        "published_lamps": lambda: _LIGHT_LAMPS[:6],
    },
    "materials": {
        "MATERIALS": ("nist_ptfe",),
        "CORNELL": _MATERIALS.CORNELL[:1],
        "_SCAN": 50,
        "_SURFACES": 20,
        "_PAINTS_NM": (550.0,),
        "_DRAWS": 1,
    },
    "plan": {"SIZES": {"small": _FRAME}},
    "poses": {"POSES": (6,), "MATERIALS": 40},
    "reference": {"SIZES": {"small": {"pixels": "8x6", "converged": 64, "scenes": ["spheres"], "no_growth": True}}},
    "render": {"SIZES": {"small": _FRAME | {"variants": ["spectral"]}}},
    # Without the page: a browser takes seconds to compile its shaders, and the viewer has tests of its own.
    "viewer": {"SIZES": {"small": (64, Size(width=16, height=12))}, "browser_command": lambda: None},
}
_LIGHT_LAMPS = _LIGHT.published_lamps()
_ADDED = {"plan": ["--scenes", "one-lamp"], "reference": ["--variants"]}
_SIZED = ("compress", "environment", "fit", "ingest", "light", "plan", "reference", "render", "viewer")
_MEASURED = ROOT.parent / "shared" / "data"


#: Options with which a benchmark prints a table of its own, and writes none.
_PRINTED = {"--table", "--error-bars", "--response-models"}


@pytest.fixture(autouse=True)
def caches_of_benchmarks():
    """Forget what benchmarks have kept of their tiny inputs, lest later tests of this process take it for measured."""
    yield
    for name, module in list(sys.modules.items()):
        if name.startswith("benchmarks."):
            for function in vars(module).values():
                if callable(clear := getattr(function, "cache_clear", None)):
                    clear()


@pytest.mark.heavy
@pytest.mark.usefixtures("coarse_light_maps")
@pytest.mark.parametrize("name", _TINY)
def test_a_documented_benchmark_measures(name, tmp_path, monkeypatch, capsys):
    if name in ("calibrate", "materials") and not _MEASURED.is_dir():
        pytest.skip(f"no measured data at {_MEASURED}")
    module = importlib.import_module(f"benchmarks.{name}")
    for key, value in _TINY[name].items():
        monkeypatch.setattr(module, key, value)
    if name == "render":
        monkeypatch.setattr(module, "printed_by", in_this_process(monkeypatch, capsys))
    monkeypatch.setattr(table, "_LEAST_RUNS", 1)
    if name == "viewer":  # which also exports the page, whose errors the export would measure in a browser
        monkeypatch.setattr(stage, "browser_command", lambda: None)
    output = tmp_path / "table.csv"
    documented = [words_of(c)[1:] for c in of_kind("benchmark") if words_of(c)[0] == f"benchmarks.{name}"]
    printing = [words for words in documented if _PRINTED & set(words)]
    others = [words for words in documented if words not in printing]
    for words in [*printing, *([max(others, key=len)] if others else [])]:
        if words not in printing:
            words = ["--output", str(output), *words]
        if name in _SIZED:
            words = [*words, "--size", "small", "--runs", "1", *_ADDED.get(name, [])]
        if name in (*_SIZED, "calibrate"):  # threads of tiny work would wait for each other
            words = [*words, "--threads", "1"]
        monkeypatch.setattr("sys.argv", [name, *words])
        module.main()
        assert len(capsys.readouterr().out.splitlines()) > 2
        assert _PRINTED & set(words) or len(output.read_text().splitlines()) > 1


@pytest.mark.heavy
def test_the_documented_benchmarks_of_whole_projects_plan_theirs_and_read_a_finished_one(
    finished, tmp_path, monkeypatch, capsys
):
    """Snakemake plans what it would make; what rules took is that of the finished project."""
    made, runs = [], []

    def run_chain(folder, cores, *targets):
        made.append({rule for rule, _ in planned(snakemake(folder, "--dry-run", *targets))})
        if len(made) == 2:
            shutil.copytree(finished / "results", folder / "results")
        return 1.0

    monkeypatch.setattr(ten_megapixels, "run_chain", run_chain)
    monkeypatch.setattr("sys.argv", ["ten_megapixels", "--megapixels", "0.48", "--poses", "6"])
    ten_megapixels.main()
    said = capsys.readouterr().out
    assert made[0] >= {"capture_object", "capture_camera"} and made[1] >= {
        "calibrate_camera",
        "fit_brdf",
        "render_view",
    }
    assert "peak memory of a job" in said and "the largest costs: " in said

    def run_project(folder, size):
        """Return a project whose jobs took as long as they are large."""
        runs.append(size)
        costs = {cost.rule: replace(cost, seconds=10.0 * size.megapixels * cost.jobs) for cost in found}
        return scaling.Project(size, costs, 8.0, 4.0, 2.0, 1.0, 1.0)

    found = ten_megapixels.costs(finished)
    for key, value in {
        "run_project": run_project, "start_seconds": lambda folder: 1.0, "_TEXELS": 500, "_IMAGE_PX": (16, 12),
        "_ENVIRONMENT_PX": 64, "_DISK_BYTES": 1 << 20,
    }.items():  # fmt: skip
        monkeypatch.setattr(scaling, key, value)
    monkeypatch.setattr("sys.argv", ["scaling", "--runs", "1"])
    scaling.main()
    said = capsys.readouterr().out
    assert [size.megapixels for size in runs] == [0.48, 0.48, 2.0] and said.count("first to bind: ") == 2


@pytest.mark.heavy
def test_the_documented_tables_and_figures_are_made_of_a_finished_run(again, tmp_path, monkeypatch):
    """Exports are measured of the small project; tables of a whole run are those beside the documents."""
    monkeypatch.setattr(exports, "CALLS", ("tile-plate --to tiff", "tile-plate --to envi"))
    monkeypatch.setattr("sys.argv", ["exports", "--results", str(again / "results")])
    monkeypatch.chdir(again)
    exports.main()
    measured = (again / "results/benchmark/exports.csv").read_text().splitlines()
    pictures = [f"results/still-life/front.{kind}" for kind in ("exr", "png", "tif", "xyz.exr")]
    assert sorted({line.split(",")[0] for line in measured[1:]}) == [*pictures, "tile-plate envi", "tile-plate tiff"]
    for name, place in published_tables.SOURCES.items():
        (tmp_path / "results" / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(published_tables.FIGURES / name, tmp_path / "results" / place)
    for document in published_tables.DOCUMENTS:
        (tmp_path / document).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / document, tmp_path / document)
    monkeypatch.setattr(published_tables, "ROOT", tmp_path)
    monkeypatch.setattr(published_tables, "FIGURES", tmp_path / "docs/figures")
    monkeypatch.setattr("sys.argv", ["published_tables", "--results", str(tmp_path / "results")])
    published_tables.main()
    for document in published_tables.DOCUMENTS:
        assert (tmp_path / document).read_text(encoding="utf-8") == (ROOT / document).read_text(encoding="utf-8")
    # Two figures show a sphere and a texture that the small project does not have.
    drawn = {
        name: draw for name, draw in site_figures.DRAWN.items() if name not in ("photographs.png", "rectified.png")
    }
    monkeypatch.setattr(site_figures, "DRAWN", drawn)
    monkeypatch.setattr(site_figures, "FIGURES", tmp_path / "docs/figures")
    monkeypatch.setattr(site_figures, "photograph_viewer", lambda _, path: Path(path).write_bytes(b"drawn"))
    site_figures.main(["--results", str(again / "results")])
    assert {path.name for path in (tmp_path / "docs/figures").iterdir()} >= {*drawn, "viewer.png"}


@pytest.mark.heavy
def test_the_benchmark_counts_the_materials_that_each_rig_makes(finished, tmp_path, monkeypatch, capsys):
    seeds = []

    def run_chain(folder, cores, *targets):
        seeds.append(yaml.safe_load((folder / "config/rigs/virtual.yaml").read_text())["virtual"]["seed"])
        assert "results/tile-plate/material.h5" in targets
        shutil.copytree(finished / "results", folder / "results")
        return 1.0

    monkeypatch.setattr(coverage, "run_chain", run_chain)
    output = tmp_path / "coverage.csv"
    arguments = ["coverage", "--rigs", "2", "--objects", "tile-plate", "leaf-sphere", "--output", str(output)]
    monkeypatch.setattr("sys.argv", arguments)
    coverage.main()
    assert seeds == [1, 2] and "tile-plate" in capsys.readouterr().out
    with output.open(newline="") as stream:
        rows = {(row["object"], row["quantity"]): row for row in csv.DictReader(stream)}
    assert {name for name, _ in rows} == {"tile-plate", "leaf-sphere"}
    alpha = rows["tile-plate", "alpha"]
    assert int(alpha["rigs"]) == 2 and int(alpha["values"]) > 2 * 50
    assert 0.4 < float(alpha["within_1_sigma"]) < float(alpha["within_2_sigma"]) <= 1.0


def test_the_benchmark_measures_the_plate_on_a_rig_with_each_fault_alone(finished, tmp_path, monkeypatch, capsys):
    made = []

    def run_chain(folder, cores, *targets):
        faults = yaml.safe_load((folder / "config/rigs/virtual.yaml").read_text())["virtual"]["imperfections"]
        plate = yaml.safe_load((folder / "config/objects/tile-plate.yaml").read_text())["virtual"]["materials"]
        made.append(({name for name in faults if faults[name]["enabled"]}, {one.get("lobe") for one in plate}))
        jobs = planned(snakemake(folder, "--dry-run", *targets))
        assert {named["object"] for _, named in jobs if "object" in named} == {"tile-plate"}
        shutil.copytree(finished / "results/tile-plate", folder / "results/tile-plate")
        return 1.0

    monkeypatch.setattr(imperfections, "run_chain", run_chain)
    output, every = tmp_path / "imperfections.csv", set(imperfections.FAULTS)
    monkeypatch.setattr("sys.argv", ["imperfections", "--faults", "laid_off", "--output", str(output)])
    imperfections.main()
    assert made == [(set(), {None}), ({"laid_off"}, {None}), (every, {None}), (every, {"ggx"})]
    rows = read_rows(output, ErrorRow)
    assert list(dict.fromkeys(row.subject for row in rows)) == ["none", "laid_off alone", "all", "all, GGX"]
    (own,) = (row for row in rows if row.subject == "all" and row.light == "D65")
    known = read_rows(finished / "results/still-life/errors.csv", ErrorRow)
    (same,) = (r for r in known if (r.subject, r.quantity, r.light) == ("tile-plate", own.quantity, "D65"))
    assert own == replace(same, subject="all")
    assert f"mean {own.mean:.4g}" in capsys.readouterr().out


def test_every_documented_benchmark_is_run_here():
    here = {*_TINY, "coverage", "exports", "imperfections", "published_tables", "scaling", "site_figures",
            "ten_megapixels"}  # fmt: skip
    assert {words_of(command)[0].removeprefix("benchmarks.") for command in of_kind("benchmark")} == here
