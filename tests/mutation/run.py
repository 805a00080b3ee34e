"""Mutation testing: which small faults in the package do its tests notice?

``python tests/mutation/run.py [--sample 60] [--seed TEXT] [--rooms ingest light] [--jobs 2]``, at the top of the
repository. Mutants are drawn at random, by the seed (the commit where none is given), so that every commit tries others.
Each is put into a process of its own, forked from one that has imported everything: the code of the function is replaced
where it stands. The process runs the tests that pass over the mutant's line, the shortest first, and ends at the first
that fails. Survivors are printed; the exit status is 1 where fewer than ``--least`` of the mutants were noticed.

Only the tests of a room's own files are asked (`ROOMS`), and of these only such as take less than `LONGEST_S`: a fault
that a long test alone would notice counts as a survivor.
"""

import argparse
import functools
import os
import pickle
import random
import resource
import subprocess
import sys
import tempfile
import threading
import time
import types
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

import pytest  # noqa: E402
from mutants import Mutant, mutated, mutants_of  # noqa: E402

#: Room of the package -> its modules (folders or files under irodori/) and the files of its tests (under tests/).
ROOMS = {
    "ingest": (
        ("ingest",),
        ("unit/test_ingest.py", "unit/test_mosaic.py", "unit/test_demosaic.py", "unit/test_dark_frames.py",
         "unit/test_merge.py", "unit/test_photon_transfer.py", "unit/test_linearity.py", "unit/test_registration.py",
         "unit/test_shot_alignment.py", "unit/test_white_reference.py", "unit/test_first_look.py"),
    ),
    "rectification": (("rectification",), ("unit/test_rectification.py", "rig/test_near_light.py")),
    "light": (
        ("light",),
        ("unit/test_environment.py", "unit/test_light_sources.py", "unit/test_irradiance.py", "unit/test_gloss.py",
         "unit/test_gloss_components.py", "unit/test_mirror_ball.py", "unit/test_negative_light.py"),
    ),
    "evaluation": (
        ("evaluation",),
        ("unit/test_report_errors.py", "unit/test_photograph_comparison.py", "unit/test_error_budget.py",
         "unit/test_error_prediction.py", "unit/test_report_registration.py"),
    ),
    "reflection": (
        ("reflection",),
        ("unit/test_brdf.py", "unit/test_fresnel.py", "unit/test_reflection_lobes.py"),
    ),
    "capture limits": (
        ("capture/rig",),
        ("rig/test_rig_contract.py", "rig/test_driven.py", "rig/test_rig_faults.py", "rig/test_grbl_driver.py",
         "rig/test_grbl_protocol.py", "rig/test_rig_interrupts.py"),
    ),
}  # fmt: skip
LONGEST_S = 3.0
_LEAST_CPU_S, _WALL_S = 20.0, 120.0


@dataclass
class Baseline:
    """What the tests do without a fault: the tests over each line, how long each takes, and what they import."""

    over: dict[tuple[str, int], set[str]] = field(default_factory=lambda: defaultdict(set))
    seconds: dict[str, float] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)
    modules: list[str] = field(default_factory=list)


def modules_of(room: str) -> dict[str, Path]:
    """Return the modules of a room by name."""
    files = [f for part in ROOMS[room][0] for f in sorted((ROOT / "irodori" / part).rglob("*.py"))]
    return {".".join(f.relative_to(ROOT).with_suffix("").parts): f for f in files if f.name != "__init__.py"}


def drawn(rooms: list[str], count: int, seed: str) -> list[Mutant]:
    """Return a sample of the rooms' mutants, each as likely as any other."""
    every = [m for room in rooms for name, path in modules_of(room).items() for m in mutants_of(name, path)]
    chosen = random.Random(seed).sample(every, min(count, len(every)))
    print(f"{len(chosen)} of {len(every)} mutants, seed {seed}", flush=True)
    return chosen


class Runner:
    """Plugin of pytest that runs the collected tests, not once, but for every mutant."""

    def __init__(self, mutants: list[Mutant], jobs: int) -> None:
        self.mutants, self.jobs = mutants, jobs
        self.paths = {name: path for room in ROOMS for name, path in modules_of(room).items()}
        self.outcome: dict[Mutant, str] = {}

    def pytest_sessionstart(self, session) -> None:
        from hypothesis import settings

        settings.register_profile("mutation", derandomize=True, deadline=None, database=None, max_examples=25)
        settings.load_profile("mutation")

    def pytest_runtestloop(self, session) -> bool:
        if session.testsfailed:
            raise session.Interrupted("tests cannot be collected")
        begun = time.monotonic()
        baseline = self._forked(lambda: self._baseline(session.items))
        if not isinstance(baseline, Baseline):
            raise session.Interrupted(f"the tests without a mutant: {baseline}")
        print(f"{len(baseline.seconds)} tests without a mutant: {time.monotonic() - begun:.0f} s", flush=True)
        if baseline.failed:
            raise session.Interrupted(f"tests fail without a mutant: {', '.join(baseline.failed)}")
        for name in baseline.modules:  # once here, and not in every process
            __import__(name)
        items = {item.nodeid: item for item in session.items}
        waiting, lock = list(self.mutants), threading.Lock()
        running: dict[int, tuple[Mutant, str, float]] = {}
        del lock
        while waiting or running:
            while waiting and len(running) < self.jobs:
                mutant = waiting.pop()
                self._start(mutant, baseline, items, running)
            self._reap(running)
        return True

    def _baseline(self, items) -> Baseline:
        found = Baseline()
        files = {str(path): name for name, path in self.paths.items()}
        lines: set[tuple[str, int]] = set()

        def within(frame, event, argument):
            lines.add((files[frame.f_code.co_filename], frame.f_lineno))
            return within

        def called(frame, event, argument):
            if frame.f_code.co_filename in files:
                lines.add((files[frame.f_code.co_filename], frame.f_lineno))
                return within
            return None

        for item, following in zip(items, [*items[1:], None], strict=True):
            lines.clear()
            threading.settrace(called)
            sys.settrace(called)
            begun = time.process_time()
            failed = _run(item, following)
            found.seconds[item.nodeid] = time.process_time() - begun
            sys.settrace(None)
            threading.settrace(None)
            if failed:
                found.failed.append(item.nodeid)
            for line in lines:
                found.over[line].add(item.nodeid)
        found.modules = [n for n in sys.modules if n.startswith(("irodori.", "scipy.", "cv2", "skimage."))]
        return found

    def _forked(self, work):
        """Return what a function gives in a process of its own, or what became of that process."""
        with tempfile.TemporaryFile() as file:
            child = os.fork()
            if not child:
                _silent()
                try:
                    pickle.dump(work(), file)
                    file.flush()
                    os._exit(0)
                except BaseException as error:  # noqa: BLE001 (whatever it is, the parent says it)
                    file.seek(0)
                    pickle.dump(repr(error), file)
                    file.flush()
                    os._exit(0)
            _, status = os.waitpid(child, 0)
            file.seek(0)
            return pickle.load(file) if not status else f"status {status}"

    def _start(self, mutant: Mutant, baseline: Baseline, items: dict, running: dict) -> None:
        tests = baseline.over.get((mutant.module, mutant.line), set())
        tests = sorted((t for t in tests if baseline.seconds[t] <= LONGEST_S), key=lambda t: baseline.seconds[t])
        if not tests:
            self._conclude(mutant, "no test", "")
            return
        limit = int(_LEAST_CPU_S + 10 * sum(baseline.seconds[t] for t in tests))
        child = os.fork()
        if not child:
            _silent()
            resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5))
            status = 3
            try:
                status = 0 if _put(mutant, self.paths[mutant.module]) else 4
                for name, following in zip(tests, [*tests[1:], None], strict=True) if not status else ():
                    if _run(items[name], items[following] if following else None):
                        status = 1
                        break
            finally:
                os._exit(status)
        running[child] = mutant, f"{len(tests)} tests", time.monotonic() + _WALL_S + 10 * limit

    def _reap(self, running: dict) -> None:
        child, status = os.waitpid(-1, os.WNOHANG)
        if not child:
            time.sleep(0.01)
            for late in [c for c, (*_, until) in running.items() if time.monotonic() > until]:
                os.kill(late, 9)
            return
        if child not in running:
            return
        mutant, tests, _ = running.pop(child)
        code = os.waitstatus_to_exitcode(status)
        # A fault that ends the process or never ends is noticed as well.
        self._conclude(mutant, {0: "survived", 1: "killed", 4: "not made"}.get(code, f"killed ({code})"), tests)

    def _conclude(self, mutant: Mutant, what: str, tests: str) -> None:
        self.outcome[mutant] = what
        if what in ("survived", "no test", "not made"):
            print(f"  {what}: {mutant} {tests}", flush=True)


def _silent() -> None:
    """Send what a process prints to nowhere."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):
        os.dup2(nowhere, number)


def _run(item, following) -> bool:
    """Run a test; return whether it failed."""
    from _pytest.runner import runtestprotocol

    return any(report.failed for report in runtestprotocol(item, log=False, nextitem=following))


def _put(mutant: Mutant, path: Path) -> bool:
    """Replace the code of a function by the mutant's; return whether the function was found."""
    import ast

    tree = mutated(mutant, path)
    body: list[ast.stmt] = tree.body
    for part in mutant.function.split("."):
        node = next(n for n in body if isinstance(n, ast.ClassDef | ast.FunctionDef) and n.name == part)
        body = node.body
    code: types.CodeType = compile(tree, str(path), "exec", dont_inherit=True)
    for part in mutant.function.split("."):
        code = _named(code, part, node.lineno if part == mutant.function.rpartition(".")[2] else None)
    owner: object = sys.modules[mutant.module]
    *outer, last = mutant.function.split(".")
    for part in outer:
        owner = getattr(owner, part)
    function = vars(owner)[last]
    while not isinstance(function, types.FunctionType):
        if isinstance(function, property | functools.cached_property):
            function = function.fget if isinstance(function, property) else function.func
        elif hasattr(function, "cache_clear"):
            function.cache_clear()
            function = function.__wrapped__
        elif hasattr(function, "__func__") or hasattr(function, "__wrapped__"):
            function = getattr(function, "__func__", None) or function.__wrapped__
        else:
            return False
    while hasattr(function, "__wrapped__"):
        function = function.__wrapped__
    function.__code__ = code
    return True


def _named(code: types.CodeType, name: str, line: int | None) -> types.CodeType:
    found = [c for c in code.co_consts if isinstance(c, types.CodeType) and c.co_name == name]
    exact = [c for c in found if c.co_firstlineno == line]
    return (exact or found)[0]


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sample", type=int, default=60, help="mutants, spread over the rooms at random")
    parser.add_argument("--seed", default="", help="any text; the commit where absent")
    parser.add_argument("--rooms", nargs="+", default=list(ROOMS), choices=list(ROOMS))
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--least", type=float, default=0.9, help="share of the mutants that must be noticed")
    given = parser.parse_args()
    os.environ["CI"] = "1"
    os.chdir(ROOT)
    seed = given.seed or subprocess.run(
        ["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True
    ).stdout.strip()  # fmt: skip
    mutants = drawn(given.rooms, given.sample, seed)
    runner = Runner(mutants, given.jobs)
    asked = {m.module for m in mutants}
    files = [f"tests/{f}" for room in ROOMS if asked & set(modules_of(room)) for f in ROOMS[room][1]]
    begun = time.monotonic()
    options = ["-q", "-p", "no:xdist", "-p", "no:cacheprovider", "-o", "addopts=", "-m", "not heavy"]
    status = pytest.main([*options, *dict.fromkeys(files)], plugins=[runner])
    if status not in (0, pytest.ExitCode.NO_TESTS_COLLECTED) or len(runner.outcome) < len(mutants):
        return 2
    noticed = sum(what.startswith("killed") for what in runner.outcome.values())
    share = noticed / len(mutants)
    print(f"{noticed} of {len(mutants)} mutants noticed, {share:.0%}, in {time.monotonic() - begun:.0f} s")
    return int(share < given.least)


if __name__ == "__main__":
    sys.exit(main())
