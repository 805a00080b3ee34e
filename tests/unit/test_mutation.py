"""Mutants of a made-up module: each kind of fault is made, and nothing that would not be noticed."""

import ast
import importlib.util
import os
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
import patience
import psutil
import pytest
from documented import of_kind, words_of
from scipy.stats import binom

ROOT = Path(__file__).resolve().parents[2]
#: Mutants of a sample, and the share of them that must be noticed.
MOST, LEAST = 60, 0.75

MODULE = '''
from numba import njit

LIMIT = 5


def clamped(value, low, high=10):
    """Return a value within bounds 1 and 2."""
    if not low <= value and low < high:
        raise ValueError(f"{value - low} under {low + 1}")
    LOGGER.info("%d", value + 1)
    check(value)
    return min(value * 3, high)


@njit(cache=True)
def kernel(x):
    return x + 1


class Rig:
    @property
    def reach(self):
        return sub(self.near, self.far)
'''


def loaded(name: str):
    """Return a module of the folder of mutants, which is on nobody's path."""
    spec = importlib.util.spec_from_file_location(name, ROOT / f"tests/mutation/{name}.py")
    sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


@pytest.fixture(scope="module")
def mutants():
    return loaded("mutants")


def test_faults_stand_in_what_functions_do_and_in_no_message_default_or_kernel(mutants, tmp_path):
    path = tmp_path / "made.py"
    path.write_text(MODULE)
    found = {f"{m.function}: {m.kind}: {m.text}" for m in mutants.mutants_of("made", path)}
    test = "not low <= value and low < high"
    assert found == {
        f"clamped: condition: {test} -> True", f"clamped: condition: {test} -> False",
        f"clamped: operator: {test} -> not low <= value or low < high",
        "clamped: sign or negation dropped: not low <= value -> low <= value",
        "clamped: comparison: low <= value -> low > value", "clamped: comparison: low < high -> low >= high",
        "clamped: call dropped: check(value) -> pass", "clamped: operator: value * 3 -> value / 3",
        "clamped: term removed: value * 3 -> value", "clamped: constant in value * 3: 3 -> 4",
        "Rig.reach: arguments swapped: sub(self.near, self.far) -> sub(self.far, self.near)",
    }  # fmt: skip


@pytest.mark.heavy
def test_faults_without_effect_are_not_made_and_each_that_is_named_is_one(mutants, tmp_path):
    path = tmp_path / "made.py"
    path.write_text(
        "def made():\n    return 1\n\n\nTABLE = made()\n\n\n"
        "def flat(x):\n    return [a.reshape(-1) for a in x if max(a, 1e-9) for _ in zip(a, x, strict=True)]\n"
    )
    assert not mutants.mutants_of("made", path)
    named = list(mutants.equivalent())
    modules = {one.split()[0]: ROOT / f"{one.split()[0].replace('.', '/')}.py" for one in named}
    every = {mutant.lasting for module, file in modules.items() for mutant in mutants.mutants_of(module, file, True)}
    assert [one for one in named if one not in every] == [], "no longer mutants"


def test_a_mutant_differs_from_its_module_by_its_fault_alone(mutants, tmp_path):
    path = tmp_path / "made.py"
    path.write_text(MODULE)
    whole = ast.unparse(ast.parse(MODULE)).splitlines()
    for mutant in mutants.mutants_of("made", path):
        changed = ast.unparse(mutants.mutated(mutant, path)).splitlines()
        assert sum(a != b for a, b in zip(whole, changed, strict=True)) == 1, mutant


def test_a_mutant_that_makes_no_sense_is_made_and_left_to_the_tests(mutants, tmp_path):
    path = tmp_path / "made.py"
    path.write_text("def column(x):\n    return ((1.0 - x) ** 2)[:, None]\n")
    for mutant in mutants.mutants_of("made", path):
        loaded = {}
        exec(mutants.compiled(mutants.mutated(mutant, path), path), loaded)
        assert callable(loaded["column"])


def test_statements_that_are_marked_say_when_they_are_passed(mutants, tmp_path):
    path, passed = tmp_path / "made.py", []
    path.write_text("def f(x):\n    if x:\n        y = 1\n    elif x is None:\n        y = 2\n    return 3\n")
    loaded = {"passed": passed.append}
    exec(mutants.compiled(mutants.marked(path, {2, 3, 4, 6}, "passed"), path), loaded)
    assert loaded["f"](1) == 3 and passed == [2, 3, 6]
    passed.clear()
    assert loaded["f"](0) == 3 and passed == [2, 4, 6]


def imported(file: Path) -> set[str]:
    """Return the modules of the package that a file imports, and what it imports from them, by their whole names."""
    found = re.findall(r"from (irodori[\w.]*) import (\([^)]*\)|[^\n]*)", file.read_text(encoding="utf-8"))
    return {module for module, _ in found} | {f"{m}.{name}" for m, names in found for name in re.findall(r"\w+", names)}


def test_a_module_that_tests_import_is_among_what_the_tests_of_its_room_import():
    """Otherwise nobody would be asked about its mutants, all of which would survive."""
    run, tests = loaded("run"), ROOT / "tests"
    found = {file.relative_to(tests).as_posix(): imported(file) for file in tests.rglob("test_*.py")}
    for room, (_, files) in run.ROOMS.items():
        own, all_of = set().union(*(found[file] for file in files)), set().union(*found.values())
        assert set(run.modules_of(room)) & all_of <= own, room


def test_a_mutant_computes_anew_what_it_may_change_and_what_belongs_to_a_process():
    from irodori.config import validation
    from irodori.geometry import embree
    from irodori.light import irradiance
    from irodori.rendering.interactive import round_lobes

    runner = loaded("run").Runner("light", [], False)
    runner._caches = [validation.load_schema, embree._device, round_lobes._reflectance]
    assert runner._forgetting(irradiance.__name__) == [embree._device, round_lobes._reflectance]
    assert runner._forgetting(validation.__name__)[0] is validation.load_schema


def verdicts(share: float, is_told) -> tuple[float, float]:
    """Return how often a sample of tests that notice a share fails, and how many mutants it takes, both exactly."""
    failed, taken, going = 0.0, 0.0, {0: 1.0}  # noticed -> probability
    for tried in range(1, MOST + 1):
        taken += sum(going.values())
        after = defaultdict(float)
        for noticed, chance in going.items():
            after[noticed + 1] += chance * share
            after[noticed] += chance * (1.0 - share)
        going = {n: chance for n, chance in after.items() if tried < MOST and not is_told(n, tried)}
        failed += sum(chance for n, chance in after.items() if n not in going and n < LEAST * tried)
    return failed, taken


def test_a_sample_that_ends_early_judges_as_sixty_mutants_do():
    is_told = loaded("sequential").is_told
    for share in np.arange(0.5, 1.0, 0.05):
        failed, taken = verdicts(share, is_told)
        assert failed == pytest.approx(binom.cdf(LEAST * MOST - 1, MOST, share), abs=0.03), share
        assert taken < 47.0
    (false_alarms, taken), (_, of_better) = (verdicts(share, is_told) for share in (0.9, 0.95))
    assert false_alarms < 1e-3 and taken < 26.0 and of_better < 17.0


@pytest.mark.heavy
def test_a_sample_of_mutants_is_put_to_the_tests():
    """Of one room, others at every commit, as many as tell good tests from bad ones; survivors are printed.

    Where tests notice nine in ten, a sample has fewer than three in four once in a thousand runs: CONTRIBUTING.md has
    the scores.
    """
    command = run_of("--room", "--sample", f"{MOST}", "--until-told", "--jobs", "1", "--least", f"{LEAST}",
                     "--parent", str(os.getpid()))  # fmt: skip
    done = subprocess.run(command, cwd=ROOT, env=outside_of_pytest(), capture_output=True, text=True)
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]


@pytest.mark.heavy
def test_a_run_that_is_killed_leaves_no_process_behind(tmp_path):
    said = tmp_path / "said"  # a file, for the end of a pipe would end the processes too
    command = run_of("--rooms", "reflection", "--sample", "100", "--jobs", "1")
    with said.open("w") as out, subprocess.Popen(command, cwd=ROOT, env=outside_of_pytest(), stdout=out) as run:
        patience.until(lambda: "tests without a mutant" in said.read_text(), polls=60_000)
        started = psutil.Process(run.pid)
        # A room's process, and below it that of a mutant.
        patience.until(lambda: any(room.children() for room in started.children()))
        family = started.children(recursive=True)
        run.kill()
    # Left alone, they would go on for half a minute at least.
    patience.until(lambda: not any(map(is_alive, family)), lambda: str(family), polls=1000)


def is_alive(process: psutil.Process) -> bool:
    """Return whether a process runs; one that nobody has waited for yet does not."""
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def run_of(*words: str) -> list[str]:
    """Return the documented command with other words."""
    (documented,) = of_kind("mutation")
    return [sys.executable, words_of(documented)[1], *words]


def outside_of_pytest() -> dict[str, str]:
    """Return the environment without what tells a program that pytest runs it."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
