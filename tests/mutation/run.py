"""Mutation testing: which small faults in the package do its tests notice?

``python tests/mutation/run.py [--sample 60] [--seed TEXT] [--rooms ingest light] [--jobs 2]``, at the top of the
repository. Mutants are drawn at random, by the seed (the commit where none is given): every commit tries others. Each
is put into a process of its own, forked from one that has run all tests and loaded all compiled loops: the code of the
function is replaced where it stands. The process runs the tests that pass over the mutant's line, the shortest first,
and ends at the first that fails. Survivors are printed; the exit status is 1 where fewer than ``--least`` of the
mutants were noticed.

Only the tests of a room's own files are asked (`ROOMS`), and of these only such as take less than `LONGEST_S`: a fault
that a long test alone would notice counts as a survivor, as does one that shows only under a near lamp. Times are those
of the processor, whoever else uses it.
"""

import argparse
import ast
import functools
import gc
import multiprocessing
import os
import pickle
import random
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
import types
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

import pytest  # noqa: E402
from mutants import Mutant, mutants_of, mutated  # noqa: E402

#: Room of the package -> its modules (folders or files under irodori/) and the files of its tests (under tests/).
ROOMS = {
    "ingest": (
        ("ingest",),
        ("unit/test_ingest.py", "unit/test_mosaic.py", "unit/test_demosaic.py", "unit/test_dark_frames.py",
         "unit/test_merge.py", "unit/test_photon_transfer.py", "unit/test_linearity.py", "unit/test_registration.py",
         "unit/test_shot_alignment.py", "unit/test_white_reference.py", "unit/test_first_look.py",
         "unit/test_fuzz_raw.py", "unit/test_dng_levels.py", "unit/test_exposure_settings.py"),
    ),
    "rectification": (("rectification",), ("unit/test_rectification.py",)),
    "light": (
        ("light",),
        ("unit/test_environment.py", "unit/test_light_sources.py", "unit/test_irradiance.py", "unit/test_gloss.py",
         "unit/test_gloss_components.py", "unit/test_mirror_ball.py", "unit/test_negative_light.py"),
    ),
    "evaluation": (
        ("evaluation",),
        ("unit/test_report_errors.py", "unit/test_photograph_comparison.py", "unit/test_error_budget.py",
         "unit/test_error_prediction.py", "unit/test_report_registration.py", "unit/test_report_planning.py",
         "unit/test_report_light.py", "unit/test_imperfection_costs.py"),
    ),
    "reflection": (
        ("reflection",),
        ("unit/test_brdf.py", "unit/test_fresnel.py", "unit/test_reflection_lobes.py"),
    ),
    "capture limits": (
        ("capture/rig",),
        ("rig/test_rig_contract.py", "rig/test_driven.py", "rig/test_grbl_driver.py", "rig/test_grbl_protocol.py",
         "rig/test_rig_waits.py", "rig/test_described_rig.py"),
    ),
}  # fmt: skip
LONGEST_S = 2.0
EXAMPLES = 10  # of a property-based test, at most
LEAST_CPU_S = 10.0


@dataclass
class Baseline:
    """What the tests do without a fault: the tests over each line, how long each takes, which fail."""

    over: dict[tuple[str, int], set[str]] = field(default_factory=lambda: defaultdict(set))
    seconds: dict[str, float] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)


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

    def __init__(self, mutants: list[Mutant]) -> None:
        self.mutants = mutants
        self.paths = {name: path for room in ROOMS for name, path in modules_of(room).items()}
        self.outcome: dict[Mutant, str] = {}

    def pytest_sessionstart(self, session) -> None:
        from hypothesis import settings

        settings.register_profile("mutation", derandomize=True, deadline=None, database=None, max_examples=EXAMPLES)
        settings.load_profile("mutation")

    def pytest_collection_modifyitems(self, items) -> None:
        from hypothesis import settings

        for item in items:
            given = getattr(item.obj, "_hypothesis_internal_use_settings", None)
            if given is not None:
                item.obj._hypothesis_internal_use_settings = settings(
                    given, max_examples=min(given.max_examples, EXAMPLES)
                )

    def pytest_runtestloop(self, session) -> bool:
        import cv2

        if session.testsfailed:
            raise session.Interrupted("tests cannot be collected")
        cv2.setNumThreads(1)
        begun = time.process_time()
        baseline = self._unspoilt(session.items)
        # What passes here may fail or hang in a forked process for reasons of its own: that is no mutant noticed.
        again = _forked(lambda: [n for n in baseline.seconds if _run(self._items[n], None)])
        if isinstance(again, str):
            raise session.Interrupted(f"the tests without a mutant, in a forked process: {again}")
        for name in (*baseline.failed, *again):
            print(f"  not asked, for it fails without a mutant: {name}", flush=True)
            baseline.seconds.pop(name, None)
        print(f"{len(baseline.seconds)} tests without a mutant: {time.process_time() - begun:.0f} s", flush=True)
        for mutant in self.mutants:
            self._try(mutant, baseline)
        return True

    def _unspoilt(self, items) -> Baseline:
        """Run the tests without a fault; compiled loops are loaded here for all mutants."""
        found, self._items = Baseline(), {item.nodeid: item for item in items}
        files = {str(path): name for name, path in self.paths.items()}
        lines: set[tuple[str, int]] = set()

        def within(frame, event, argument):
            lines.add((files[frame.f_code.co_filename], frame.f_lineno))
            return within

        def called(frame, event, argument):
            return within(frame, event, argument) if frame.f_code.co_filename in files else None

        for item, following in zip(items, [*items[1:], None], strict=True):
            lines.clear()
            threading.settrace(called)
            sys.settrace(called)
            begun = time.process_time()
            failed = _run(item, following)
            seconds = time.process_time() - begun
            sys.settrace(None)
            threading.settrace(None)
            if failed:
                found.failed.append(item.nodeid)
            elif seconds <= LONGEST_S:
                found.seconds[item.nodeid] = seconds
                for line in lines:
                    found.over[line].add(item.nodeid)
        return found

    def _try(self, mutant: Mutant, baseline: Baseline) -> None:
        # Part of an expression of several lines is not always a line to Python: then the statement's tests count.
        lines = (mutant.line, mutant.first)
        over = next((t for n in lines if (t := baseline.over.get((mutant.module, n)))), set())
        tests = sorted(over & set(baseline.seconds), key=lambda t: baseline.seconds[t])
        if not tests:
            self._conclude(mutant, "no test")
            return
        limit = int(LEAST_CPU_S + 5 * sum(baseline.seconds[t] for t in tests))

        def work() -> str:
            resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5))
            # What was computed once for all is computed anew, by the mutant.
            for one in gc.get_objects():
                if isinstance(one, functools._lru_cache_wrapper) and str(one.__module__).startswith("irodori."):
                    one.cache_clear()
            if not _put(mutant, self.paths[mutant.module]):
                return "not made"
            for name, following in zip(tests, [*tests[1:], None], strict=True):
                if _run(self._items[name], self._items[following] if following else None):
                    return f"killed by {name}"
            return f"survived {len(tests)} tests"

        # A fault that ends the process or never ends is noticed as well.
        self._conclude(mutant, _forked(work, wall_s=20.0 * limit))

    def _conclude(self, mutant: Mutant, what: str) -> None:
        self.outcome[mutant] = what
        if not what.startswith("killed"):
            print(f"  {what}: {mutant}", flush=True)


def _forked(work, wall_s: float = 3600.0):
    """Return what a function gives in a process of its own, or "killed" and why where that process came to an end."""
    with tempfile.TemporaryFile() as file:
        child = os.fork()
        if not child:
            _silent()
            try:
                found = work()
            except BaseException as error:
                found = f"killed by {error!r}"
            pickle.dump(found, file)
            file.flush()
            os._exit(0)
        late = threading.Timer(wall_s, os.kill, (child, signal.SIGKILL))
        late.start()
        _, status = os.waitpid(child, 0)
        late.cancel()
        file.seek(0)
        return f"killed by status {status}" if status else pickle.load(file)


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
    os.chdir(ROOT)
    seed = given.seed or subprocess.run(
        ["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True
    ).stdout.strip()  # fmt: skip
    mutants = drawn(given.rooms, given.sample, seed)
    begun = time.monotonic()
    shares = [given.rooms[n :: given.jobs] for n in range(min(given.jobs, len(given.rooms)))]
    found: dict[Mutant, str] = {}
    with ThreadPoolExecutor(len(shares)) as pool:
        for outcome in pool.map(lambda rooms: _in_process(rooms, mutants), shares):
            if outcome is None:
                return 2
            found |= outcome
    noticed = sum(what.startswith("killed") for what in found.values())
    share = noticed / len(found)
    print(f"{noticed} of {len(found)} mutants noticed, {share:.0%}, in {time.monotonic() - begun:.0f} s")
    return int(share < given.least)


def _in_process(rooms: list[str], mutants: list[Mutant]) -> dict[Mutant, str] | None:
    """Return what became of the mutants of some rooms, found in a process of its own; None where that failed."""
    context = multiprocessing.get_context("spawn")
    own = [m for m in mutants if any(m.module in modules_of(room) for room in rooms)]
    if not own:
        return {}
    with context.Pool(1) as pool:
        return pool.apply(_try_all, (rooms, own))


def _try_all(rooms: list[str], mutants: list[Mutant]) -> dict[Mutant, str] | None:
    # One thread: a process with others beside the first cannot be forked safely.
    os.environ |= {"CI": "1", "NUMBA_THREADING_LAYER": "workqueue", "NUMBA_NUM_THREADS": "1"}
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    runner, asked = Runner(mutants), {m.module for m in mutants}
    files = [f"tests/{f}" for room in rooms if asked & set(modules_of(room)) for f in ROOMS[room][1]]
    options = ["-q", "-p", "no:xdist", "-p", "no:cacheprovider", "-o", "addopts=", "-m", "not heavy"]
    status = pytest.main([*options, *dict.fromkeys(files)], plugins=[runner])
    done = status in (0, pytest.ExitCode.NO_TESTS_COLLECTED) and len(runner.outcome) == len(mutants)
    return runner.outcome if done else None


if __name__ == "__main__":
    sys.exit(main())
