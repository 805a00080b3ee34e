"""A small project, and how to run Snakemake in it."""

import atexit
import functools
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import patience
import yaml
from planner import Planner

from irodori.core.yaml_files import read_own_yaml

ROOT = Path(__file__).resolve().parents[2]


def edit(path: Path, changes: dict) -> None:
    """Set dotted keys of a YAML file."""
    document = read_own_yaml(path)
    for key, value in changes.items():
        *parents, last = key.split(".")
        block = document
        for parent in parents:
            block = block[parent]
        block[last] = value
    path.write_text(yaml.dump(document, Dumper=yaml.CSafeDumper, sort_keys=False))


def snakemake(
    folder: Path,
    *arguments: str,
    snakefile: Path = ROOT / "Snakefile",
    cores: int | None = 2,
    search_path: Path | None = None,
    forked: bool | None = None,
) -> subprocess.CompletedProcess:
    """Run Snakemake in a working directory with the repository's Snakefile; some commands need no number of cores.

    `search_path` is where Python looks for packages before it looks among the installed ones. What takes long is waited
    for as long as it gets on. With the repository's own Snakefile, and where `forked` says so, Snakemake and its jobs
    are forked from a process that has imported the repository's package, see `planner`.
    """
    number = ["--cores", str(cores)] if cores else []
    given = ["--snakefile", str(snakefile), *number, *arguments]
    if (snakefile == ROOT / "Snakefile" and search_path is None) if forked is None else forked:
        with tempfile.TemporaryDirectory() as said:
            out, err = Path(said, "out"), Path(said, "err")
            status = _planner().run(folder, given, out, err)
            return subprocess.CompletedProcess(given, status, out.read_text(), err.read_text())
    environment = os.environ | ({"PYTHONPATH": str(search_path)} if search_path else {})
    return patience.run([sys.executable, "-m", "snakemake", *given], cwd=folder, env=environment)


@functools.cache
def _planner() -> Planner:
    """Start the process that runs Snakemake for all tests of this one."""
    started = Planner()
    atexit.register(started.close)
    return started


def small_project(folder: Path) -> Path:
    """Copy the configuration and shrink it: a plate and a sphere at 16 x 16 texels, a small room and picture."""
    shutil.copytree(ROOT / "config", folder / "config")
    config = folder / "config"
    edit(
        config / "config.yaml",
        {
            "photographed_together": [["leaf-sphere", "tile-plate"]],
            "rectify.tile_texels": 128,
            "fit.level_by_photograph": True,
            "environment.irradiance": {"max_error": 0.002, "max_height": 64},
        },
    )
    edit(config / "environments" / "classroom.yaml", {"image": {"width": 100, "height": 50}})
    # Texels of half a superpixel's size would see the seams between paints: four paints, four checks.
    edit(
        config / "objects" / "tile-plate.yaml",
        {
            "texels": {"width": 16, "height": 16},
            "poses": [{"light_deg": [45.0], "camera_deg": [0.0, 20.0, 35.0, 41.0, 45.0, 49.0, 55.0, 65.0]}],
            "virtual.pattern": {"kind": "checks", "columns": 2, "rows": 2},
        },
    )
    edit(
        config / "objects" / "leaf-sphere.yaml",
        {
            "texels": {"width": 16, "height": 16},
            "poses": [
                {"light_deg": [35.0], "camera_deg": [0.0], "turn_deg": [0.0, 90.0, 180.0, 270.0], "placement": [1, 2]},
            ],
            "placements": [{"rotation_deg": [180.0, 0.0, 0.0]}],
            "virtual.pattern": {"kind": "uniform"},
        },
    )
    edit(
        config / "scenes" / "still-life.yaml",
        {
            "image": {"width": 48, "height": 36},
            "objects": [
                {"object": "tile-plate", "position_mm": [0.0, 0.0, 0.0], "scale": 2.4},
                {"object": "leaf-sphere", "position_mm": [0.0, 0.0, 30.1], "rotation_deg": [60.0, 0.0, 0.0]},
            ],
        },
    )
    return folder


def planned(run: subprocess.CompletedProcess) -> list[tuple[str, dict]]:
    """Return rule and wildcards of every job of a dry run."""
    assert run.returncode == 0, run.stderr[-4000:]
    jobs: list[tuple[str, dict]] = []
    for line in (run.stdout + run.stderr).splitlines():
        words = line.strip().split()
        if len(words) == 2 and words[0] in ("rule", "localrule", "checkpoint"):
            jobs.append((words[1].rstrip(":"), {}))
        elif words[:1] == ["wildcards:"]:
            jobs[-1][1].update(pair.split("=", 1) for pair in line.split(":", 1)[1].strip().split(", "))
    return jobs
