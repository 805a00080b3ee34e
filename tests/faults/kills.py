"""SIGKILL at random moments: what is left behind, and what a later run makes of it."""

import random
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

from running import Run, fresh_project, judge, last_fault, run, unlock, wait_for_workers, workers_in

VICTIMS = ("worker", "snakemake", "everything", "workers")
#: After so many kills of one project it is left alone to its end, and a new one begun: the whole chain is gone through
#: several times.
_KILLS_A_CHAIN = 6


def kill_often(folder: Path, expected: Path, moments: int, seed: int, undisturbed_s: float) -> Iterator[dict]:
    """Kill runs at random moments, continue each from what it left, and yield a row for every kill and every end.

    Parameters
    ----------
    folder : path
        Does not exist yet.
    expected : path
        Results of an undisturbed run.
    moments : int
        Kills in all; a run that ends before its moment is not counted.
    seed : int
    undisturbed_s : float, s
        How long a whole run takes: moments are drawn so that a chain is gone through in about six of them.
    """
    choice = random.Random(seed)
    done, begun = 0, 0
    while done < moments:
        chain = fresh_project(folder / f"chain-{begun:02d}")
        begun += 1
        killed, is_whole = 0, False
        while killed < min(_KILLS_A_CHAIN, moments - done) and not is_whole:
            victim = VICTIMS[(done + killed) % len(VICTIMS)]
            row = _kill_once(chain, expected, victim, choice, 0.4 * undisturbed_s)
            is_whole = row is None
            if row is not None:
                killed += row["case"].startswith("kill")
                yield row
        done += killed
        yield _end(chain, expected, killed)
        shutil.rmtree(chain)


def _kill_once(chain: Path, expected: Path, victim: str, choice: random.Random, longest_s: float) -> dict | None:
    """Run, kill at a random moment and judge what is left; None where the run ended in order before that."""
    moment_s = choice.uniform(0.5, longest_s)
    job = Run(chain)
    orphans = workers_in(chain)
    while time.monotonic() - job.begun < moment_s and not job.is_over:
        time.sleep(0.02)
    # A worker can be killed only while there is one.
    while victim in ("worker", "workers") and not job.is_over and not workers_in(chain):
        time.sleep(0.02)
    moment_s, rules, was_over = time.monotonic() - job.begun, job.rules(), job.is_over
    if not was_over:
        job.kill(victim, choice)
    said = job.end()
    if was_over and job.process.returncode == 0:
        return None
    wrong = judge(chain, expected, partial=True)
    row = {"case": f"kill {victim}", "moment_s": moment_s, "at_work": rules, "good": not wrong}
    if was_over:
        # Only beside the workers of a Snakemake that was killed alone may a run stop on its own: they hold a session.
        outlived = wait_for_workers(chain) if orphans else 0
        row |= {"case": "run beside orphans", "good": bool(orphans) and not wrong}
        return row | {"outcome": wrong or f"stops, {outlived} of them still at work: {last_fault(said)}"}
    if victim in ("snakemake", "everything"):
        unlock(chain)
    left = f"; {len(workers_in(chain))} workers live on" if victim == "snakemake" else ""
    return row | {"outcome": wrong or f"nothing half-written under its name{left}"}


def _end(chain: Path, expected: Path, killed: int) -> dict:
    """Let a project's run come to its end and compare all of it."""
    wait_for_workers(chain)
    begun = time.monotonic()
    status, said = run(chain)
    took_s = time.monotonic() - begun
    wrong = last_fault(said) if status else judge(chain, expected)
    row = {"case": f"rerun after {killed} kills", "moment_s": took_s, "at_work": "", "good": not wrong}
    return row | {"outcome": wrong or "completes, all results identical"}
