"""Intermediate results that the disk has damaged, and two runs at once."""

import os
import random
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

from running import TARGETS, Run, judge, last_fault, run, workers_in

from irodori.core.custody import Chain

#: An intermediate result of every kind, and the result that reads it.
_READ_BY = (
    ("cameras/d5100-comb/captures.csv", "cameras/d5100-comb/reference.h5"),
    ("cameras/d5100-comb/reference.h5", "cameras/d5100-comb/linear/chart.h5"),
    ("cameras/d5100-comb/linear/chart.h5", "cameras/d5100-comb/calibration.h5"),
    ("cameras/d5100-comb/calibration.h5", "leaf-sphere/material.h5"),
    ("leaf-sphere/linear/l0350-c0100-t000-r0900.h5", "leaf-sphere/observations/tile-000.h5"),
    ("leaf-sphere/observations/tile-000.h5", "leaf-sphere/brdf/tile-000.h5"),
    ("leaf-sphere/brdf/tile-000.h5", "leaf-sphere/surface.h5"),
    ("leaf-sphere/surface.h5", "leaf-sphere/material.h5"),
    ("leaf-sphere/material.h5", "still-life/front.exr"),
    ("leaf-sphere/truth.h5", "still-life/truth/front.exr"),
    ("environments/classroom.h5", "still-life/front.exr"),
    ("still-life/front.exr", "still-life/errors.csv"),
    ("leaf-sphere/captures/l0350-c0100-t000-r0900-in-50000us.dng", "leaf-sphere/linear/l0350-c0100-t000-r0900.h5"),
)


def _cut_short(path: Path, choice: random.Random) -> None:
    os.truncate(path, choice.randrange(path.stat().st_size))


def _flip_a_bit(path: Path, choice: random.Random) -> None:
    content = bytearray(path.read_bytes())
    content[choice.randrange(len(content))] ^= 1 << choice.randrange(8)
    path.write_bytes(content)


_DAMAGES = {"cut short": _cut_short, "bit flipped": _flip_a_bit}


def damage_results(project: Path, expected: Path, seed: int, both: bool) -> Iterator[dict]:
    """Damage one file after another of a finished project while the result that reads it is asked for again.

    Parameters
    ----------
    project : path
        Finished; it is as before in the end.
    expected : path
    seed : int
    both : bool
        Both kinds of damage of every file, otherwise the one and the other in turn.
    """
    choice = random.Random(seed)
    for number, (damaged, wanted) in enumerate(_READ_BY):
        for kind, damage in list(_DAMAGES.items())[slice(None) if both else slice(number % 2, number % 2 + 1)]:
            yield _damage_one(project, expected, damaged, wanted, kind, lambda path, act=damage: act(path, choice))


def _damage_one(project: Path, expected: Path, damaged: str, wanted: str, kind: str, damage) -> dict:
    path = project / "results" / damaged
    before = path.stat()
    damage(path)
    # What decays on a disk keeps its time: Snakemake cannot see it, only the job that reads it.
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    row = {"case": f"{kind}: {damaged}"}
    # Snakemake makes nothing again for want of an intermediate result alone: its reader is asked for by name.
    again = [*TARGETS, "--forcerun", f"results/{wanted}"]
    status, said = run(project, *again)
    if status == 0:
        return row | {"good": False, "outcome": "taken for complete"}
    sentence = last_fault(said)
    named = path.name in sentence
    if path.suffix == ".dng":
        # Photographs are the user's: what to do about one is for the message to say, and for the user to do.
        again.append(f"results/{Path(damaged).parent}/session.json")
    status, said = run(project, *again)
    for left in (project / "results").rglob("*"):
        if left.name.endswith(".damaged") or "-changed-" in left.name:
            left.unlink()
    wrong = last_fault(said) if status else judge(project, expected)
    if not named:
        wrong = wrong or f"the message does not name the file: {sentence}"
    return row | {"good": not wrong, "outcome": wrong or "refused by name; the rerun completes, all results identical"}


def damage_finals(project: Path, expected: Path, seed: int) -> Iterator[dict]:
    """Flip a bit of results that no rule reads, verify the folder, and remove what it names."""
    choice = random.Random(seed)
    for damaged in ("still-life/front.png", "still-life/errors.csv"):
        path = project / "results" / damaged
        before = path.stat()
        _flip_a_bit(path, choice)
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
        said = next(Chain(project / "results").broken(), "")
        path.unlink()
        status, output = run(project)
        wrong = last_fault(output) if status else judge(project, expected)
        if path.name not in said:
            wrong = wrong or "not found by irodori verify"
        outcome = wrong or "found by irodori verify; the rerun completes, all results identical"
        yield {"case": f"bit flipped: {damaged}", "good": not wrong, "outcome": outcome}


def run_twice(project: Path, expected: Path) -> Iterator[dict]:
    """Start a second run beside a first."""
    for lost in ("leaf-sphere", "still-life"):
        shutil.rmtree(project / "results" / lost)
    first = Run(project)
    while not workers_in(project) and not first.is_over:
        time.sleep(0.05)
    beside = not first.is_over
    second = run(project)
    refused = second[0] != 0 and "cannot be locked" in second[1]
    first.end()
    wrong = judge(project, expected)
    good = beside and refused and first.process.returncode == 0 and not wrong
    outcome = "the second is refused; the first completes, all results identical"
    yield {"case": "two runs at once", "good": good, "outcome": wrong or (outcome if good else last_fault(second[1]))}
