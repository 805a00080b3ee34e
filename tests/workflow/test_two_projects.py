"""Two configurations in one folder, run one after the other: each keeps its report, and its crate has its own files."""

import json
import shutil
from pathlib import Path

import pytest
import yaml
from project import ROOT, planned, snakemake

from irodori.command_line import main

OF_CAMERA = ("--configfile", "config/camera.yaml")
OF_PLATE = ("--configfile", "config/plate.yaml")
_REPORT_NAMED = "Pictures, errors and times: "


@pytest.fixture
def folder(again) -> Path:
    """Return the finished project, in which somebody begins two more: one of a plate, one of the camera alone."""
    shutil.copytree(ROOT / "workflow", again / "workflow", ignore=shutil.ignore_patterns("__pycache__"))
    scene = yaml.safe_load((again / "config/scenes/still-life.yaml").read_text())
    scene |= {"photographs": {}, "objects": [{"object": "tile-plate", "position_mm": [0.0, 0.0, 0.0]}]}
    scene.pop("lesson", None)
    (again / "config/scenes/plate-scene.yaml").write_text(yaml.safe_dump(scene))
    (again / "config/plate.yaml").write_text("make: {scenes: [plate-scene], cameras: []}\n")
    (again / "config/camera.yaml").write_text("make: {scenes: [], cameras: [d5100-comb]}\n")
    return again


def state(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Return time and content of every result, and not of the list of the user's files, which runs add to."""
    files = (path for path in (folder / "results").rglob("*") if path.is_file() and path.name != "inputs.json")
    return {path.relative_to(folder).as_posix(): (path.stat().st_mtime_ns, path.read_bytes()) for path in files}


def changed(before: dict, folder: Path) -> list[str]:
    """Return the results that are no longer as they were."""
    now = state(folder)
    return [name for name, one in before.items() if now.get(name) != one]


def written(run) -> list[str]:
    """Return the files that the jobs of a dry run write: outputs, logs and benchmarks."""
    assert run.returncode == 0, run.stderr[-3000:]
    lines = (line.strip().partition(": ") for line in (run.stdout + run.stderr).splitlines())
    return [file for key, _, files in lines if key in ("output", "log", "benchmark") for file in files.split(", ")]


def named_reports(run) -> list[str]:
    """Return the reports that a run says it has made."""
    assert run.returncode == 0, run.stderr[-3000:]
    said = (run.stdout + run.stderr).splitlines()
    return [line.removeprefix(_REPORT_NAMED) for line in said if line.startswith(_REPORT_NAMED)]


def files_of_crate(folder: Path) -> set[str]:
    graph = json.loads((folder / "ro-crate-metadata.json").read_text(encoding="utf-8"))["@graph"]
    return {one["@id"] for one in graph if "File" in one["@type"]}


def test_a_second_project_plans_to_write_no_file_of_the_first(folder):
    run = snakemake(folder, "--dry-run", *OF_PLATE)
    files = written(run)
    assert {"results/plate-scene/report.html", "results/plate-scene/errors.csv"} <= set(files)
    assert [file for file in files if (folder / file).exists()] == []
    # What the two share is there already.
    shared = {"compress_reflectance", "prepare_environment", "calibrate_camera", "measure_registration"}
    assert not shared & {rule for rule, _ in planned(run)}


@pytest.mark.heavy
def test_a_second_project_leaves_the_first_as_it_was_and_each_crate_holds_one(folder, capsys):
    before = state(folder)
    # A partial target names no report: it makes none, though one lies there.
    assert named_reports(snakemake(folder, *OF_CAMERA, "--", "results/cameras/d5100-comb/errors.csv")) == []
    assert named_reports(snakemake(folder, *OF_CAMERA)) == ["results/cameras/d5100-comb/report.html"]
    page = (folder / "results/cameras/d5100-comb/report.html").read_text(encoding="utf-8")
    assert "leave-one-patch-out CIEDE2000" in page and "FADGI 2023" in page and "tile-plate" not in page
    assert "<h2>Calibration" in page and not any(f"<h2>{part}" in page for part in ("Pictures", "Objects", "Light"))
    assert changed(before, folder) == []
    again = snakemake(folder)
    assert "Nothing to be done" in again.stdout + again.stderr and named_reports(again) == []

    crate = ["crate", "--directory", str(folder)]
    assert main([*crate, "--configfile", "config/camera.yaml"]) == 0
    files = files_of_crate(folder)
    results = {name for name in files if name.startswith("results/")}
    assert {"config/camera.yaml", "config/config.yaml", "results/cameras/d5100-comb/report.html"} <= files
    assert any(name.endswith(".dng") for name in results)
    assert {Path(name).parts[1] for name in results} == {"cameras"}
    assert main(crate) == 0
    default = files_of_crate(folder)
    assert "results/still-life/report.html" in default and results - default == {
        "results/cameras/d5100-comb/report.html", "results/cameras/d5100-comb/errors.csv"}  # fmt: skip
    capsys.readouterr()
    # A project that was not run to its end has no crate yet.
    assert main([*crate, "--configfile", "config/plate.yaml"]) == 1
    assert "results/plate-scene/front.png: found no such file; accepted: a finished run" in capsys.readouterr().out


@pytest.mark.heavy
def test_a_second_scene_leaves_the_first_as_it_was(folder):
    before = state(folder)
    assert named_reports(snakemake(folder, *OF_PLATE)) == ["results/plate-scene/report.html"]
    page = (folder / "results/plate-scene/report.html").read_text(encoding="utf-8")
    # The sphere tells of the camera that photographed both.
    assert "<h3>tile-plate" in page and "<h3>leaf-sphere" not in page and "still-life" not in page
    assert "leaf-sphere, leaf-sphere in placement 2, tile-plate tell together" in page
    assert changed(before, folder) == []
    again = snakemake(folder)
    assert "Nothing to be done" in again.stdout + again.stderr
    assert main(["crate", "--directory", str(folder), "--configfile", "config/plate.yaml"]) == 0
    parts = {Path(name).parts[1] for name in files_of_crate(folder) if name.startswith("results/")}
    assert parts == {"cameras", "environments", "leaf-sphere", "plate-scene", "tile-plate"}
    sphere = {name for name in files_of_crate(folder) if name.startswith("results/leaf-sphere/")}
    assert "results/leaf-sphere/registration.h5" in sphere and "results/leaf-sphere/material.h5" not in sphere
