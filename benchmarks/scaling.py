"""Scaling of the workflow: throughput on one and two cores, and a prediction for a cluster.

``python -m benchmarks.scaling [--megapixels 2] [--poses 12] [--project FOLDER] [--objects 10] [--nodes 100]``, at the
top of the repository. The prediction is that of `benchmarks.scaling_model` with constants measured here. Snakemake runs
the workflow on one core: twice for a small project, once to compile and once to measure the start of jobs, and then for
the given size, unless a finished project of `benchmarks.ten_megapixels` is given. The speeds of the disk and of hashing
are measured. The time that Slurm needs for an empty job is an argument, which `tests/cluster/run` prints; the interval
at which Snakemake checks the states of jobs is in the profile.
"""

import argparse
import hashlib
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from benchmarks.fit import inputs, scene
from benchmarks.render import Studio, make_inputs
from benchmarks.scaling_model import BINDING, Cluster, Constants, Phase, Work, binds_first, phases, total_s
from benchmarks.table import medians_s
from benchmarks.ten_megapixels import (
    OBJECT,
    ROOT,
    Cost,
    Size,
    costs,
    make_pictures,
    make_project,
    photograph,
    working_folder,
)
from irodori.core.threads import use_threads
from irodori.fitting.solvers import FitOptions, fit

_TEXELS, _IMAGE_PX, _ENVIRONMENT_PX = 200_000, (320, 240), 500
_SMALL_MEGAPIXELS = 0.48
_DISK_BYTES = 256 << 20
_PROFILE = yaml.safe_load((ROOT / "profiles/slurm/config.yaml").read_text(encoding="utf-8"))
_JOBS = 6


def throughputs(runs: int) -> list[tuple[str, str, float, float]]:
    """Return name, counted unit and rate per second on one and on two cores, for fits and rendering."""
    options = FitOptions(solver="varpro")
    own, shared = (inputs(scene(_TEXELS)[3], kind) for kind in ("own", "shared"))
    with tempfile.TemporaryDirectory() as folder:
        make_inputs(_ENVIRONMENT_PX, Path(folder))
        studio = Studio(Path(folder), *_IMAGE_PX)
    prepared = studio.prepare("coefficients")
    work = {
        ("fit, own geometry", "texels", _TEXELS): lambda: fit(*own, options),
        ("fit, shared geometry", "texels", _TEXELS): lambda: fit(*shared, options),
        ("render", "pixels", _IMAGE_PX[0] * _IMAGE_PX[1]): lambda: studio.frame(prepared, 0),
    }
    rates: dict[tuple, list[float]] = {key: [] for key in work}
    for threads in (1, 2):
        use_threads(threads)
        for key, seconds in medians_s(work, runs).items():
            rates[key].append(key[2] / seconds)
    return [(name, unit, *rates[name, unit, count]) for name, unit, count in work]


def start_seconds(folder: Path) -> float:
    """Return the time of Snakemake and Python for a job that only imports the fit, s.

    It is the difference between two runs on one core, with one job and with several, so that work done once cancels.
    """
    (folder / "job.py").write_text("import irodori.fitting\nopen(snakemake.output[0], 'w').close()\n")
    (folder / "Snakefile").write_text(
        "rule all:\n    input: expand('{i}', i=range(config['jobs']))\n"
        "rule one:\n    output: '{i}'\n    script: 'job.py'\n"
    )
    seconds = []
    for jobs in (1, 1, 1 + _JOBS):
        command = [sys.executable, "-m", "snakemake", "--cores", "1", "--forceall", "--config", f"jobs={jobs}"]
        begun = time.perf_counter()
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        subprocess.run(command, cwd=folder, check=True, capture_output=True, env=environment)
        seconds.append(time.perf_counter() - begun)
    return max(seconds[2] - seconds[1], 0.0) / _JOBS


def hash_mb_per_s() -> float:
    """Return the speed at which one core hashes data in memory, MB/s."""
    content = np.random.default_rng(0).bytes(64 << 20)
    seconds = []
    for _ in range(5):
        begun = time.perf_counter()
        hashlib.sha256(content).digest()
        seconds.append(time.perf_counter() - begun)
    return len(content) / 1e6 / statistics.median(seconds)


def disk_mb_per_s(folder: Path) -> float:
    """Return the speed of writing to the disk including synchronisation, MB/s."""
    content = np.random.default_rng(0).bytes(_DISK_BYTES)
    begun = time.perf_counter()
    with (folder / "disk").open("wb") as out:
        out.write(content)
        out.flush()
        os.fsync(out.fileno())
    seconds = time.perf_counter() - begun
    (folder / "disk").unlink()
    return len(content) / 1e6 / seconds


@dataclass(frozen=True)
class Project:
    """Costs of the rules of a finished project, and sizes of its files."""

    size: Size
    costs: dict[str, Cost]
    raw_mb: float
    linear_mb: float
    observations_mb: float
    brdf_mb: float
    material_mb: float

    @classmethod
    def read(cls, folder: Path, size: Size) -> "Project":
        """Read costs and file sizes of a finished project from its folder."""

        def megabytes(pattern: str) -> float:
            return sum(file.stat().st_size for file in (folder / "results" / OBJECT).glob(pattern)) / 1e6

        patterns = ("captures/*.dng", "linear/*.h5", "observations/*.h5", "brdf/*.h5", "material.h5")
        return cls(size, {cost.rule: cost for cost in costs(folder)}, *map(megabytes, patterns))

    @property
    def megatexels(self) -> float:
        """Size of the texture, millions of texels."""
        return self.size.texels_side**2 / 1e6

    def job_s(self, rule: str) -> float:
        """Return the mean time of a rule's jobs, s."""
        return self.costs[rule].seconds / self.costs[rule].jobs


def run_project(folder: Path, size: Size) -> Project:
    """Make a project, run it on one core, and return its costs and file sizes."""
    folder.mkdir()
    make_project(folder, size)
    photograph(folder, 2)
    make_pictures(folder, 1)
    return Project.read(folder, size)


def chain_constants(small: Project, large: Project, measured: dict[str, float]) -> Constants:
    """Return the constants that follow from the difference of two projects, in which the start of jobs cancels.

    Parameters
    ----------
    small, large : Project
        Projects with tiles of equal size; the jobs of the second have more work than those of the first.
    measured : dict of str to float
        The other constants, measured separately.

    Raises
    ------
    ValueError
        If a job of the large project took less time than one of the small, because the machine was too busy or the
        projects are too similar.
    """

    def slope(rule: str, work) -> float:
        work_each, seconds = [], []
        for project in (small, large):
            work_each.append(work(project) / project.costs[rule].jobs)
            hashed_s = project.linear_mb / measured["hash_mb_per_s"] if rule == "rectify_object" else 0.0
            seconds.append(project.job_s(rule) - hashed_s)
        found = (seconds[1] - seconds[0]) / (work_each[1] - work_each[0])
        if not found > 0:
            raise ValueError(f"{rule}: jobs of {work_each} took {seconds} s; accepted: longer for more work")
        return found

    pixels, texels = large.size.megapixels * large.size.poses, large.megatexels
    return Constants(
        ingest_s=slope("ingest_raw", lambda p: p.size.megapixels * p.size.poses),
        rectify_s=slope("rectify_object", lambda p: p.megatexels * p.size.poses),
        fit_s=slope("fit_brdf", lambda p: p.megatexels * p.size.poses),
        compress_s=slope("compress_reflectance", lambda p: p.megatexels),
        raw_mb=large.raw_mb / pixels,
        linear_mb=large.linear_mb / pixels,
        observations_mb=large.observations_mb / (texels * large.size.poses),
        brdf_mb=large.brdf_mb / texels,
        material_mb=large.material_mb / texels,
        **measured,
    )


def print_prediction(work: Work, cluster: Cluster, constants: Constants) -> None:
    """Print the predicted phases of the work on a cluster and the bottleneck of each."""
    found: list[Phase] = phases(work, cluster, constants)
    print(f"\n{work.objects} objects, {work.megapixels:g} megapixels, {work.poses} poses, tiles of {work.tile_texels} "
          f"texels, on {cluster.nodes} nodes of {cluster.cores_per_node} cores")  # fmt: skip
    header = ("phase", "jobs", "waves", *(f"{name}, s" for name in BINDING), "lasts, s", "binds")
    print("".join(f"{cell:>18}" for cell in header))
    for phase in found:
        parts = phase.parts_s(constants)
        cells = (phase.name, phase.jobs, phase.waves, *(f"{parts[name]:.1f}" for name in BINDING),
                 f"{phase.lasts_s(constants):.1f}", phase.binds(constants))  # fmt: skip
        print("".join(f"{cell:>18}" for cell in cells))
    print(f"together {total_s(found, constants):.0f} s; first to bind: {binds_first(found, constants)}")


def main() -> None:
    """Measure, print the constants, and predict."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=7, help="timed runs of fit and render (default 7)")
    parser.add_argument("--megapixels", type=float, default=2.0, help="of the project that is measured (default 2)")
    parser.add_argument("--poses", type=int, default=12)
    parser.add_argument("--project", type=Path, help="finished project of benchmarks.ten_megapixels of that size")
    parser.add_argument("--tile-texels", type=int, default=200_000)
    parser.add_argument("--objects", type=int, default=10)
    parser.add_argument("--nodes", type=int, default=100)
    parser.add_argument("--cores-per-node", type=int, default=16)
    parser.add_argument("--submit-s", type=float, default=0.1, help="one submission to Slurm, s")
    parser.add_argument(
        "--latency-s", type=float, default=1.0, help="until an empty job has run, s (tests/cluster/run)"
    )
    parser.add_argument("--storage-mb-per-s", type=float, help="of the cluster's storage; this disk's otherwise")
    options = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.1f}")
    print(f"{'':>24}{'unit':>10}{'1 core /s':>14}{'2 cores /s':>14}{'ratio':>8}")
    for name, unit, one, two in throughputs(options.runs):
        print(f"{name:>24}{unit:>10}{one:>14.0f}{two:>14.0f}{two / one:>8.2f}")
    size = Size(options.megapixels, options.poses, options.tile_texels)
    with working_folder(None) as folder:
        little = Size(_SMALL_MEGAPIXELS, 6, options.tile_texels)
        run_project(folder / "compiling", little)
        small = run_project(folder / "small", little)
        given = options.project
        large = run_project(folder / "large", size) if given is None else Project.read(given, size)
        measured = {
            "start_s": start_seconds(folder),
            "submit_s": options.submit_s,
            "latency_s": options.latency_s,
            "poll_s": float(_PROFILE["slurm-init-seconds-before-status-checks"]),
            "hash_mb_per_s": hash_mb_per_s(),
            "storage_mb_per_s": options.storage_mb_per_s or disk_mb_per_s(folder),
        }
        constants = chain_constants(small, large, measured)
    print("\nconstants (see benchmarks.scaling_model)")
    for name, value in vars(constants).items():
        print(f"{name:>24} {value:.4g}")
    cluster = Cluster(options.nodes, options.cores_per_node)
    for tile_texels in (40_000, options.tile_texels):
        print_prediction(Work(options.objects, tile_texels=tile_texels), cluster, constants)


if __name__ == "__main__":
    main()
