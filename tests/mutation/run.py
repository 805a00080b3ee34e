"""Mutation testing: which small faults in the package do its tests notice?

``python tests/mutation/run.py [--sample 60] [--seed TEXT] [--rooms ingest light | --room] [--only TEXT]``, at the top
of the repository. As many mutants of each room are drawn at random, by the seed (the commit where none is given): every
commit tries others, with ``--room`` of one room only, for before the first mutant all tests of a room are run. With
``--until-told`` a room's mutants end as soon as they tell enough (`sequential`). Each is put into a process of its own,
forked from one that has run all tests and loaded all compiled loops: the code of the function is replaced where it
stands. The process runs the tests that pass over the mutant's statement, those of files with the module's name first,
the shortest first and one case of each before a second, and ends at the first that fails. Each mutant is printed, with
the test that noticed it or as a survivor, and how many of each room were noticed; the exit status is 1 where too few of
all were (``--least``).

Only the tests of a room's own files are asked (`ROOMS`), of these only those of a default run, such as take less than
`LONGEST_S` once their loops are loaded, and as many as take `TOGETHER_S` together: a fault that others alone would
notice counts as a survivor. Times are those of the processor, whoever else uses it. A mutant that never ends is
noticed: a test computes for ten times as long as it should and for `PATIENCE_S`, or its process hardly computes for
`QUIET_S`. So a run ends; a test that takes `HANGS_S` without a mutant ends it.
"""

import argparse
import ast
import bisect
import builtins
import ctypes
import faulthandler
import functools
import gc
import importlib
import itertools
import multiprocessing
import os
import pickle
import random
import select
import signal
import subprocess
import sys
import tempfile
import time
import types
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

import psutil  # noqa: E402
import pytest  # noqa: E402
from mutants import Mutant, compiled, marked, mutants_of, mutated  # noqa: E402
from scipy.stats import binomtest  # noqa: E402
from sequential import is_told  # noqa: E402

from irodori.core.provenance import local_sources  # noqa: E402

#: Room of the package -> its modules (folders or files under irodori/) and the files of its tests (under tests/).
ROOMS = {
    "ingest": (
        ("ingest",),
        ("unit/test_ingest.py", "unit/test_mosaic.py", "unit/test_demosaic.py", "unit/test_dark_frames.py",
         "unit/test_merge.py", "unit/test_photon_transfer.py", "unit/test_linearity.py", "unit/test_registration.py",
         "unit/test_shot_alignment.py", "unit/test_white_reference.py", "unit/test_first_look.py",
         "unit/test_plausibility.py", "rig/test_set_plausibility.py", "unit/test_linear_pictures.py",
         "unit/test_fuzz_raw.py", "unit/test_dng_levels.py", "unit/test_embedded_tiffs.py",
         "unit/test_exposure_settings.py", "rig/test_session_sees.py"),
    ),
    "rectification": (
        ("rectification", "geometry/circle_search.py"),
        ("unit/test_rectification.py", "unit/test_registration_parts.py", "unit/test_registration_steps.py",
         "unit/test_contradicted_definitions.py", "unit/test_outline_search.py", "unit/test_ball_outline.py",
         "unit/test_level_patch_parts.py", "unit/test_marker_sheet.py", "unit/test_inner_brightness.py",
         "unit/test_angle_errors.py", "unit/test_photometric_stereo.py", "unit/test_dome.py",
         "unit/test_shared_camera.py", "unit/test_turned_texture.py", "rig/test_level_patch.py",
         "rig/test_object_registration.py", "rig/test_plate_registration.py", "rig/test_placements.py"),
    ),
    "light": (
        ("light",),
        ("unit/test_environment.py", "unit/test_light_sources.py", "unit/test_irradiance.py",
         "unit/test_blurred_light.py", "unit/test_mirror_ball.py", "unit/test_light_recovery.py",
         "unit/test_room_charts.py", "unit/test_known_lamps.py", "unit/test_whole_sphere.py",
         "unit/test_clipped_lamps.py", "unit/test_panorama_doubts.py"),
    ),
    "evaluation": (
        ("evaluation",),
        ("unit/test_report_errors.py", "unit/test_photograph_comparison.py", "unit/test_error_budget.py",
         "unit/test_error_prediction.py", "unit/test_report_registration.py", "unit/test_report_light.py",
         "unit/test_gloss_components.py", "unit/test_left_out_photographs.py"),
    ),
    "reflection": (
        ("reflection",),
        ("unit/test_brdf.py", "unit/test_lobe_arrays.py", "unit/test_coat.py"),
    ),
    "capture limits": (
        ("capture/rig",),
        ("rig/test_rig_contract.py", "rig/test_driven.py", "rig/test_grbl_driver.py", "rig/test_grbl_protocol.py",
         "rig/test_rig_waits.py", "rig/test_described_rig.py", "rig/test_lost_steps.py", "rig/test_rig_faults.py",
         "rig/test_fault_table.py", "rig/test_feed_rates.py"),
    ),
}  # fmt: skip
#: Tests of these files that compute for longer than `LONGEST_S`, whatever is loaded: run, they would not be asked.
LONG = (
    "test_measured_places_become_environments", "test_the_memory_for_an_environment",
    "test_reconstruction_error_is_that_of_the_truncated_svd",
    "test_another_programs_chart_is_read_and_brought", "test_the_fewest_aligned_bases_meet_the_target",
    "test_any_plate_before_any_scene_is_found", "test_predicted_errors_are_those_that_occur",
    "test_a_named_lamp_is_recovered_better",
    "test_the_fit_finds_what_a_coupled_coat", "test_photographs_choose_the_coat", "test_left_out_directions_of",
    "test_under_even_light_the_path_tracer_shows_the_albedo_of_the_ground",
)  # fmt: skip
LONGEST_S = 4.0
TOGETHER_S = 6.0  # of the tests that one mutant is put to
EXAMPLES = 10  # of a property-based test, at most
PATIENCE_S = 4.0
QUIET_S = 30.0
QUIET_SHARE = 0.1
HANGS_S = 1500.0
PR_SET_PDEATHSIG = 1  # of linux/prctl.h
#: Modules that keep a device or threads, which a forked process has to make for itself.
_OF_A_PROCESS = ("irodori.geometry.embree", "irodori.jit.chunks")


@dataclass
class Baseline:
    """What the tests do without a fault: which of them pass over each statement, and for how long each computes, s."""

    over: dict[tuple[str, int], set[str]] = field(default_factory=lambda: defaultdict(set))
    seconds: dict[str, float] = field(default_factory=dict)


def modules_of(room: str) -> dict[str, Path]:
    """Return the modules of a room by name."""
    places = [ROOT / "irodori" / part for part in ROOMS[room][0]]
    files = [f for place in places for f in ([place] if place.is_file() else sorted(place.rglob("*.py")))]
    return {".".join(f.relative_to(ROOT).with_suffix("").parts): f for f in files if f.name != "__init__.py"}


def drawn(rooms: list[str], count: int, seed: str, only: str) -> dict[str, list[Mutant]]:
    """Return a sample of mutants whose names hold a text: as many of each room, within it all equally likely.

    What a room has too few of, the others have in addition.
    """
    found: dict[str, list[Mutant]] = {}
    every = {room: [m for name, path in modules_of(room).items() for m in mutants_of(name, path)] for room in rooms}
    every = {room: [m for m in mutants if only in str(m)] for room, mutants in every.items()}
    for room in sorted(rooms, key=lambda room: len(every[room])):
        share = -(-(count - sum(map(len, found.values()))) // (len(rooms) - len(found)))
        found[room] = random.Random(f"{seed} {room}").sample(every[room], min(share, len(every[room])))
    total = sum(map(len, every.values()))
    print(f"{sum(map(len, found.values()))} of {total} mutants, seed {seed}", flush=True)
    # The large rooms have the longest tests: what is left for the end is short.
    return dict(reversed(found.items()))


class Runner:
    """Plugin of pytest that runs the collected tests, not once, but for every mutant."""

    def __init__(self, room: str, mutants: list[Mutant], until_told: bool) -> None:
        self.room, self.mutants, self.paths = room, mutants, modules_of(room)
        self.noticed: list[bool] = []
        self.ended, self._until_told = False, until_told
        self._baseline, self._items, self._alone_s = Baseline(), {}, {}
        self._caches: list = []

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
        import OpenImageIO

        if session.testsfailed:
            raise session.Interrupted("tests cannot be collected")
        cv2.setNumThreads(1)
        # Its threads do not survive a fork, and who reads a picture would wait for them.
        OpenImageIO.attribute("threads", 1)
        OpenImageIO.attribute("exr_threads", -1)
        begun = time.process_time()
        self._run_unspoilt(session.items)
        gc.unfreeze()  # the settings of all tests have hidden from here what there was when tests were collected
        self._caches = [one for one in gc.get_objects() if isinstance(one, functools._lru_cache_wrapper)]
        self._caches = [one for one in self._caches if str(one.__module__).startswith("irodori.")]
        gc.freeze()
        passed, room = len(self._baseline.seconds), self.room
        print(f"{room}: {passed} tests without a mutant, {time.process_time() - begun:.0f} s of CPU time", flush=True)
        for number, mutant in enumerate(self.mutants, 1):
            begun = _computed_s()
            noticed, how = self._try(mutant)
            self.noticed.append(noticed)
            print(f"  {number} ({_computed_s() - begun:.1f} s) {how}: {mutant}", flush=True)
            if self._until_told and is_told(sum(self.noticed), number):
                break
        self.ended = True
        return True

    def _run_unspoilt(self, items) -> None:
        """Run the tests without a fault; compiled loops are loaded here for all mutants."""
        self._items = {item.nodeid: item for item in items}
        passed: set[tuple[str, int]] = set()
        restore = [put for module in {m.module for m in self.mutants} for put in self._mark(module, passed)]
        for item, following in zip(items, [*items[1:], None], strict=True):
            passed.clear()
            begun = time.process_time()
            # Where a test hangs without a mutant, its lines are printed and nothing is measured.
            faulthandler.dump_traceback_later(HANGS_S, exit=True)
            failed = _failed(item, following)
            faulthandler.cancel_dump_traceback_later()
            seconds = time.process_time() - begun
            if failed:
                print(f"  not asked, for it fails without a mutant: {item.nodeid}", flush=True)
                continue
            self._baseline.seconds[item.nodeid] = seconds
            for place in passed:
                self._baseline.over[place].add(item.nodeid)
        for put in restore:
            put()

    def _mark(self, module: str, passed: set[tuple[str, int]]) -> Iterator[Callable[[], None]]:
        """Let each statement of a module that a mutant changes say when it is passed; yield what ends that."""
        path, name = self.paths[module], f"passed_in_{module.replace('.', '_')}"
        setattr(builtins, name, lambda line: passed.add((module, line)))
        tree = marked(path, {m.first for m in self.mutants if m.module == module}, name)
        for qualified in {m.function for m in self.mutants if m.module == module}:
            found = _found(module, qualified, tree, path)
            if found is not None:
                function, code = found
                yield functools.partial(setattr, function, "__code__", function.__code__)
                function.__code__ = code

    def _forgetting(self, module: str) -> list:
        """Return the caches whose values may be those of a module's functions, by what their modules import.

        All others keep what is the same with every mutant of the module: hashes of sources, schemas, spectra.
        """
        kept_by = {cache.__module__ for cache in self._caches}
        touched = {name for name in kept_by if name in _OF_A_PROCESS or module in local_sources(name)}
        return [cache for cache in self._caches if cache.__module__ in touched]

    def _try(self, mutant: Mutant) -> tuple[bool, str]:
        """Return whether a test noticed a mutant, and in words which one, or how it survived."""
        tests = sorted(self._baseline.over.get((mutant.module, mutant.first), ()))
        path = self.paths[mutant.module]
        found = _found(mutant.module, mutant.function, mutated(mutant, path), path)
        if not tests or found is None:
            return False, "SURVIVED, for no test passes over it" if found else "SURVIVED, for it cannot be made"
        put = functools.partial(_put, *found, self._forgetting(mutant.module))
        seconds = self._baseline.seconds
        quick = [name for name in tests if seconds[name] <= LONGEST_S]
        found = self._ask(mutant, quick, put)
        if found is None:
            # The first test of a kind took long for what it loaded.
            long = [name for name in tests if seconds[name] > LONGEST_S]
            others = [name for name in long if 0.0 <= self._alone(name, LONGEST_S) <= LONGEST_S]
            quick += others
            found = self._ask(mutant, others, put)
        return found is not None, f"noticed by {found}" if found else f"SURVIVED {len(quick)} tests"

    def _alone(self, name: str, patience_s: float = PATIENCE_S) -> float:
        """Return how long a test computes in a forked process without a mutant, s; -1 where it fails, or for longer."""
        if name not in self._alone_s:
            begun = _computed_s()
            failed = self._forked([name], lambda: None, lambda _: patience_s)
            self._alone_s[name] = -1.0 if failed else _computed_s() - begun
        return self._alone_s[name]

    def _ask(self, mutant: Mutant, tests: Iterable[str], put: Callable[[], None]) -> str | None:
        """Return the first test that notices a fault; None where none does.

        The shortest are asked first, one case of each before the second of any: cases of one test notice the same.
        Those of a file that is called after the module, or after its folder in the room, come before all others.
        """
        folders = "/".join(ROOMS[self.room][0]).split("/")
        own = [part for part in mutant.module.split(".")[1:] if part not in folders]
        seconds = self._baseline.seconds | {name: s for name, s in self._alone_s.items() if s >= 0.0}
        shortest = sorted(tests, key=lambda name: (seconds[name], name))
        cases: dict[str, Iterator[int]] = defaultdict(itertools.count)
        case = {name: next(cases[name.partition("[")[0]]) for name in shortest}
        left = sorted(shortest, key=lambda name: (not any(part in name.partition("::")[0] for part in own), case[name]))
        together = list(itertools.accumulate(seconds[name] for name in left))
        left = left[: 1 + bisect.bisect(together, TOGETHER_S)]
        while left:
            found = self._forked(left, put, lambda name: PATIENCE_S + 10.0 * seconds[name])
            # What passes here may fail in a forked process for reasons of its own: that is no mutant noticed.
            if found is None or self._alone(found) >= 0.0:
                return found
            left.remove(found)
        return None

    def _forked(self, tests: list[str], put: Callable[[], None], patience_s: Callable[[str], float]) -> str | None:
        """Return the first of some tests that fails in a process of its own, or at which that process ends or hangs."""
        parent = os.getpid()
        with tempfile.TemporaryFile(buffering=0) as file:
            child = os.fork()
            if not child:
                end_with(parent)
                _silence()
                put()
                for number, (name, following) in enumerate(zip(tests, [*tests[1:], None], strict=True)):
                    os.pwrite(file.fileno(), pickle.dumps((number, False)), 0)
                    # At the end of this time of computing the process is ended by its signal.
                    signal.setitimer(signal.ITIMER_PROF, patience_s(name))
                    if _failed(self._items[name], self._items[following] if following else None):
                        os._exit(0)
                os.pwrite(file.fileno(), pickle.dumps((0, True)), 0)
                os._exit(0)
            _wait(child)
            number, passed = pickle.loads(os.pread(file.fileno(), 100, 0))
            return None if passed else tests[number]


def _put(function: types.FunctionType, code: types.CodeType, caches: list) -> None:
    """Let a function have other code, which then computes anew what was computed once for all."""
    for cache in caches:
        cache.cache_clear()
    function.__code__ = code


def end_with(parent: int) -> None:
    """Let this process be killed when the one that started it ends, however that ends."""
    if ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL):
        raise OSError(ctypes.get_errno(), "prctl")
    if os.getppid() != parent:  # it has ended before
        os._exit(1)


def _wait(child: int) -> None:
    """Wait for a process; end it where it computes for less than `QUIET_SHARE` of `QUIET_S`, as one that polls does."""
    ended, process = os.pidfd_open(child), psutil.Process(child)
    seen, since = 0.0, time.monotonic()
    while not select.select([ended], [], [], 1.0)[0]:
        if time.monotonic() - since < QUIET_S:
            continue
        computed = sum(process.cpu_times()[:4])
        if computed - seen < QUIET_SHARE * QUIET_S:
            process.kill()
        seen, since = computed, time.monotonic()
    os.close(ended)
    os.waitpid(child, 0)


def _computed_s() -> float:
    """Return the CPU time of the processes that this one has waited for, s."""
    times = os.times()
    return times.children_user + times.children_system


def _silence() -> None:
    """Send what a process prints to nowhere."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):
        os.dup2(nowhere, number)


def _failed(item, following) -> bool:
    """Run a test; return whether it failed."""
    from _pytest.runner import runtestprotocol

    try:
        return any(report.failed for report in runtestprotocol(item, log=False, nextitem=following))
    except (KeyboardInterrupt, pytest.exit.Exception):
        return True


def _found(
    module: str, qualified: str, tree: ast.Module, path: Path
) -> tuple[types.FunctionType, types.CodeType] | None:
    """Return a loaded function and its code in a changed tree; None where Python does not let it be replaced."""
    body: list[ast.stmt] = tree.body
    for part in qualified.split("."):
        node = next(n for n in body if isinstance(n, ast.ClassDef | ast.FunctionDef) and n.name == part)
        body = node.body
    code = compiled(tree, path)
    *outer, last = qualified.split(".")
    for part in outer:
        code = _named(code, part, None)
    # A decorated function begins at its first decorator.
    code = _named(code, last, min(one.lineno for one in (node, *node.decorator_list)))
    owner: object = importlib.import_module(module)
    for part in outer:
        owner = getattr(owner, part)
    function = vars(owner)[last]
    while not isinstance(function, types.FunctionType) or hasattr(function, "__wrapped__"):
        if isinstance(function, property | functools.cached_property):
            function = function.fget if isinstance(function, property) else function.func
        elif hasattr(function, "__func__") or hasattr(function, "__wrapped__"):
            function = getattr(function, "__func__", None) or function.__wrapped__
        else:
            return None
    return (function, code) if function.__code__.co_freevars == code.co_freevars else None


def _named(code: types.CodeType, name: str, line: int | None) -> types.CodeType:
    found = [c for c in code.co_consts if isinstance(c, types.CodeType) and c.co_name == name]
    return next((c for c in found if c.co_firstlineno == line), found[-1])


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sample", type=int, default=60, help="mutants, as many of each room")
    parser.add_argument("--seed", default="", help="any text; the commit where absent")
    parser.add_argument("--rooms", nargs="+", default=list(ROOMS), choices=list(ROOMS))
    parser.add_argument("--only", default="", metavar="TEXT", help="of all, only mutants whose printed name holds it")
    parser.add_argument("--room", action="store_true", help="only one of the rooms, drawn by the seed")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--least", type=float, default=0.9, help="share of the mutants that must be noticed")
    parser.add_argument("--until-told", action="store_true", help="no more mutants of a room than its verdict takes")
    parser.add_argument("--parent", type=int, help="process with which the run ends")
    given = parser.parse_args()
    if given.parent:
        end_with(given.parent)
    os.chdir(ROOT)
    seed = given.seed or subprocess.run(
        ["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True
    ).stdout.strip()  # fmt: skip
    rooms = [random.Random(seed).choice(given.rooms)] if given.room else given.rooms
    mutants = drawn(list(rooms), given.sample, seed, given.only)
    begun = time.monotonic()
    noticed, tried = 0, 0
    # One thread: a process with others beside the first cannot be forked safely.
    os.environ |= {"CI": "1", "NUMBA_THREADING_LAYER": "workqueue", "NUMBA_NUM_THREADS": "1"}
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    # A process for each room: it loads what that room's tests need, and is small to fork.
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(given.jobs, spawn, end_with, (os.getpid(),), max_tasks_per_child=1) as pool:
        for outcome in pool.map(functools.partial(_try_all, given.until_told), mutants, mutants.values()):
            if outcome is None:
                return 2
            noticed, tried = noticed + sum(outcome), tried + len(outcome)
    print(f"all: {_score(noticed, tried)}, in {time.monotonic() - begun:.0f} s, {_computed_s():.0f} s of CPU time")
    return int(noticed < given.least * tried)


def _score(noticed: int, tried: int) -> str:
    """Return a share in words, with the interval that holds the true one in 95 of 100 samples."""
    if not tried:
        return "no mutants"
    low, high = binomtest(noticed, tried).proportion_ci()
    return f"{noticed} of {tried} mutants noticed, {noticed / tried:.0%} ({low:.0%} to {high:.0%})"


def _try_all(until_told: bool, room: str, mutants: list[Mutant]) -> list[bool] | None:
    """Return which mutants of a room were noticed; None where its tests do not run."""
    runner = Runner(room, mutants, until_told)
    options = ["-q", "-p", "no:xdist", "-p", "no:cacheprovider", "-o", "addopts=", "-m", "not heavy"]
    options += ["-k", f"not ({' or '.join(LONG)})"]
    status = pytest.main([*options, *(f"tests/{f}" for f in ROOMS[room][1])], plugins=[runner])
    if status not in (0, pytest.ExitCode.NO_TESTS_COLLECTED) or not runner.ended:
        return None
    print(f"{room}: {_score(sum(runner.noticed), len(runner.noticed))}", flush=True)
    return runner.noticed


if __name__ == "__main__":
    sys.exit(main())
