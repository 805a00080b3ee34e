"""The same project on a Slurm and on this machine alone: what ran, how long it took, and whether the results agree."""

import argparse
import shutil
import subprocess
import sys
import time
from pathlib import Path

from comparison import differences, results
from project import ROOT, small_project


def make_project(folder: Path, name: str) -> Path:
    """Make a project in a new folder: the repository's own, or the small one of the workflow's tests."""
    folder.mkdir()
    if name == "small":
        return small_project(folder)
    shutil.copytree(ROOT / "config", folder / "config")
    return folder


def snakemake(folder: Path, *arguments: str) -> tuple[str, float]:
    """Run Snakemake in a project and return what it said and how long it took, s.

    Raises
    ------
    SystemExit
        If it fails, with the end of what it said.
    """
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), *arguments]
    begun = time.monotonic()
    done = subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(arguments)} failed:\n{done.stdout[-6000:]}")
    return done.stdout, time.monotonic() - begun


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("project", choices=("default", "small"))
    options = parser.parse_args()
    locally = make_project(options.folder / "locally", options.project)
    _, local_s = snakemake(locally, "--cores", "2")
    print(f"locally, compiling what is not compiled yet: {local_s:.0f} s", flush=True)
    on_slurm = make_project(options.folder / "on-slurm", options.project)
    # Statuses come from squeue: this Slurm keeps no accounts.
    said, slurm_s = snakemake(
        on_slurm, "--profile", str(ROOT / "profiles/slurm"), "--slurm-status-command", "squeue", "--slurm-no-account",
    )  # fmt: skip
    submitted = said.count("has been submitted with SLURM jobid")
    done = len(list((on_slurm / "results/benchmarks").rglob("*.tsv")))
    print(f"on Slurm: {slurm_s:.0f} s, {submitted} Slurm jobs for {done} of the workflow")
    if not submitted:
        raise SystemExit("nothing was submitted to Slurm")
    wrong = differences(on_slurm / "results", locally / "results")
    compared = len(results(locally / "results"))
    print(f"{compared} files compared, {len(wrong)} differ")
    print("\n".join(wrong), end="\n" if wrong else "")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
