"""Runs of the workflow in a small project, to be watched, killed and judged."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
from comparison import differences
from project import ROOT, edit, small_project

#: Where Snakemake puts the script of a job: what stands in the command line of every worker.
_SCRIPTS = ".snakemake/scripts/"
_DEADLINE_S = 3600.0
#: What every run makes: pictures, and the errors that read all that was recovered and its truth.
TARGETS = ("results/still-life/front.exr", "results/still-life/front.png", "results/still-life/errors.csv")


class Run:
    """Snakemake at work in a folder, in a process group of its own; without arguments it makes `TARGETS`."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.folder, self.log = folder, folder / "run.log"
        command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), "--cores", "2"]
        self._stream = self.log.open("wb")
        self.begun = time.monotonic()
        self.process = subprocess.Popen(
            [*command, *(arguments or TARGETS)],
            cwd=folder,
            stdout=self._stream,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )

    @property
    def is_over(self) -> bool:
        """Whether Snakemake has ended."""
        return self.process.poll() is not None

    def rules(self) -> str:
        """Return the rules at work, from the names of their scripts."""
        names = []
        for process in workers_in(self.folder):
            with contextlib.suppress(psutil.Error):
                names += [Path(word).stem.split(".", 1)[-1] for word in process.cmdline() if _SCRIPTS in word]
        return "+".join(sorted(names)) or "none"

    def end(self) -> str:
        """Wait for the end and return what was said."""
        try:
            self.process.wait(_DEADLINE_S)
        finally:
            self._stream.close()
        return self.log.read_text(errors="replace")

    def kill(self, victim: str, choice) -> None:
        """SIGKILL ``worker`` (one of them), ``workers``, ``snakemake`` alone, or ``everything`` at once.

        Parameters
        ----------
        victim : str
        choice : random.Random
        """
        workers = workers_in(self.folder)
        if victim == "worker":
            workers = [choice.choice(workers)] if workers else []
        # Snakemake first: it would tidy up after workers that it sees die.
        if victim in ("snakemake", "everything"):
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.process.pid, signal.SIGKILL)
        if victim in ("worker", "workers", "everything"):
            for process in workers:
                with contextlib.suppress(psutil.Error):
                    process.send_signal(signal.SIGKILL)


def workers_in(folder: Path) -> list[psutil.Process]:
    """Return the processes that run a rule's script in a folder, whether or not their Snakemake lives."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if _SCRIPTS in " ".join(process.cmdline()) and process.cwd() == str(folder):
                found.append(process)
    return found


def wait_for_workers(folder: Path) -> int:
    """Wait for the workers that outlived their Snakemake, and return how many there were."""
    found = workers_in(folder)
    psutil.wait_procs(found, timeout=_DEADLINE_S)
    return len(found)


def end_all_under(folder: Path) -> None:
    """SIGKILL the processes whose working directory lies under a folder."""
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if Path(process.cwd()).is_relative_to(folder):
                process.kill()


def last_fault(said: str) -> str:
    """Return the sentence of a run's output that tells what went wrong: a plain fault's, or the last lines."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    plain = [line for line in lines if "; accepted: " in line or "LockException" in line or "Errno" in line]
    return (plain[0] if plain else " / ".join(lines[-3:]))[:220]


def run(folder: Path, *arguments: str) -> tuple[int, str]:
    """Run Snakemake to its end and return its exit status and what it said."""
    job = Run(folder, *arguments)
    said = job.end()
    return job.process.returncode, said


def unlock(folder: Path) -> None:
    """Do what Snakemake asks for after it was killed."""
    status, said = run(folder, "--unlock")
    assert status == 0, said


def fresh_project(folder: Path) -> Path:
    """Make the small project of the workflow's tests in a new folder, with its sphere alone."""
    folder.mkdir(parents=True)
    project = small_project(folder)
    sphere = {"object": "leaf-sphere", "position_mm": [0.0, 0.0, 30.1], "rotation_deg": [60.0, 0.0, 0.0]}
    edit(project / "config/scenes/still-life.yaml", {"objects": [sphere]})
    return project


def judge(folder: Path, expected: Path, partial: bool = False) -> str:
    """Return what is wrong with results, empty where they are those of an undisturbed run, or a part of them."""
    return "; ".join(differences(folder / "results", expected, partial)[:5])
