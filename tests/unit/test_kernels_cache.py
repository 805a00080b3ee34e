"""Compiled kernels are those of the source, are compiled once, and are loaded only from where nobody else can write."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import patience
import pytest

from irodori.core.parsed_sources import parsed
from irodori.jit.kernel_cache import closure_hash, is_private, prune

ROOT = Path(__file__).resolve().parents[2]
PROBE = """
import numpy as np
from irodori.reflection import fresnel
value = float(fresnel.fresnel_array(np.array([0.9]), 1.5, 0.0)[0])
compiled = sum(fresnel._fill.stats.cache_misses.values())
print(repr(value), compiled)
"""
#: The same, and it imports less than all that numba can compile.
LIGHT_PROBE = PROBE + 'import sys\nassert "numba.np.linalg" not in sys.modules\n'


def start(folder: Path, probe: str = PROBE, **variables) -> subprocess.Popen:
    """Start a process that computes a factor by compiled code."""
    environment = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"} | variables
    return subprocess.Popen(
        [sys.executable, "-c", probe], cwd=folder, env=environment, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def result(run: subprocess.Popen) -> tuple[float, int, str]:
    """Return the factor, how many kernels the process compiled for it, and what it said."""
    patience.wait(run)
    out, said = run.communicate()
    assert run.returncode == 0, said
    value, compiled = out.split()
    return float(value), int(compiled), said


@pytest.fixture
def package(tmp_path) -> Path:
    """Return a folder with a copy of the package that has no compiled kernels."""
    shutil.copytree(ROOT / "irodori", tmp_path / "irodori", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def edit(file: Path, old: str, new: str) -> None:
    """Replace the text that stands once in a file."""
    text = file.read_text()
    assert text.count(old) == 1
    file.write_text(text.replace(old, new))


def test_an_edited_equation_is_not_served_from_the_cache_and_an_edit_elsewhere_costs_nothing(package):
    """Nothing: neither compiling nor the imports that only compiling needs."""
    before, compiled, _ = result(start(package))
    assert compiled == 1
    edit(package / "irodori/report/page.py", "import csv", "import csv\n\nUNUSED = 1\n# a comment")
    equation = package / "irodori/reflection/fresnel.py"
    edit(equation, "    # Both are 0 at", "    # a line more\n    # Both are 0 at")
    assert result(start(package, LIGHT_PROBE))[:2] == (before, 0)
    edit(equation, "return lower_of(1.0,", "return 0.5 * lower_of(1.0,")
    assert result(start(package))[:2] == (before / 2, 1)


def test_of_several_processes_one_compiles(package):
    runs = [start(package) for _ in range(3)]
    assert sorted(result(run)[1] for run in runs) == [0, 0, 1]


SUMS = """
import sys
import numpy as np
from irodori.jit.compilation import njit

@njit(cache=True)
def summed(values):
    total = values[0]
    for value in values[1:]:
        total += value
    return total

for kind in sys.argv[1].split(","):
    assert summed(np.arange(1, 5).astype(kind)) == 10
print(10.0, sum(summed.stats.cache_misses.values()))
"""
KINDS = ["float32", "float64", "int64", "uint8", "complex128"]


@pytest.mark.heavy
def test_signatures_of_one_kernel_are_compiled_at_the_same_time_and_all_are_stored(tmp_path):
    script = tmp_path / "summed.py"
    script.write_text(SUMS)

    def run(kinds: str) -> subprocess.Popen:
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kernels"), "PYTHONPATH": str(ROOT)}
        return subprocess.Popen([sys.executable, str(script), kinds], env=environment, text=True,
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE)  # fmt: skip

    assert [result(one)[1] for one in [run(kind) for kind in KINDS]] == [1] * len(KINDS)
    assert result(run(",".join(KINDS)))[1] == 0


HASHING = """
from irodori.jit.compilation import njit

@njit(cache=True)
def hashed(text):
    return hash(text)

assert hashed("vermilion") == hash("vermilion")
print(sum(hashed.stats.cache_misses.values()))
"""


@pytest.mark.heavy
def test_a_stored_kernel_that_hashes_finds_what_it_needs_in_a_process_that_compiles_nothing(tmp_path):
    script = tmp_path / "hashing.py"
    script.write_text(HASHING)
    (tmp_path / "kernels").mkdir(mode=0o700)
    variables = {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    for compiled in ("1", "0"):
        run = subprocess.run([sys.executable, script], env=os.environ | variables, capture_output=True, text=True)
        assert run.stdout.split() == [compiled], run.stderr


def test_a_hash_ignores_what_is_not_executed(tmp_path):
    module = tmp_path / "module.py"
    hashes = []
    for text in (
        "def f(x):\n    return x + 1\n",
        '"""A module."""\n\n# a comment\ndef f(x):\n    """Add one."""\n    return x + 1\n',
        "def f(x):\n    return x + 2\n",
    ):
        module.write_text(text)
        hashes.append(parsed(module).code)
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.mark.heavy
def test_what_was_read_of_a_source_is_remembered_by_its_content_and_no_longer(tmp_path):
    package, stored = tmp_path / "package", tmp_path / "sources.json"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "other.py").write_text("ANSWER = 42\n")
    module = package / "module.py"
    module.write_text("from . import other\n")
    program = (
        "import sys; from pathlib import Path; import irodori.core.parsed_sources as p;"
        "from irodori.jit.kernel_cache import closure_hash; import ast; stored = Path(sys.argv[2]); p.recall(stored);"
        "print(len(p._known), closure_hash('package.module', Path(sys.argv[1])), len(p._new)); p.store(stored)"
    )

    def run() -> list[str]:
        done = subprocess.run(
            [sys.executable, "-c", program, tmp_path, stored], cwd=ROOT, check=True, capture_output=True, text=True
        )
        return done.stdout.split()

    first, second = run(), run()
    assert first[0] == second[2] == "0" and first[2] == second[0] != "0" and first[1] == second[1]
    module.write_text("from . import other  \n")
    assert run()[1] == first[1]
    module.write_text("from . import other\nprint(other)\n")
    changed = run()
    assert changed[1] != first[1] and changed[2] == "1"
    (package / "other.py").write_text("ANSWER = 43\n")
    assert run()[1] != changed[1]
    damaged = ["", "[1, 2]", '{"3.11 ab": 7}', "{"]
    program = (
        "import sys; from pathlib import Path; import irodori.core.parsed_sources as p; file = Path(sys.argv[1])\n"
        "for damaged in sys.argv[2:]: file.write_text(damaged); p.recall(file); print(len(p._known))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, stored, *damaged], cwd=ROOT, check=True, capture_output=True, text=True
    )
    assert done.stdout.split() == ["0"] * len(damaged)


def test_a_closure_is_what_a_module_imports():
    ours = closure_hash("irodori.reflection.equation5", ROOT)
    assert ours != closure_hash("irodori.fitting.varpro", ROOT)
    assert ours == closure_hash("irodori.reflection.equation5", ROOT)


def test_kernels_are_never_loaded_from_a_folder_that_others_can_write(tmp_path):
    own, open_to_all, link = tmp_path / "own", tmp_path / "open", tmp_path / "link"
    own.mkdir(mode=0o700)
    open_to_all.mkdir()
    open_to_all.chmod(0o777)
    link.symlink_to(own)
    assert is_private(own)
    assert not is_private(open_to_all)
    assert not is_private(link)
    assert not is_private(tmp_path / "missing")


@pytest.mark.heavy
def test_an_installation_that_others_can_write_keeps_its_kernels_with_the_user(package, tmp_path):
    (package / "irodori").chmod(0o777)
    home = tmp_path / "home"
    _, compiled, said = result(start(package, XDG_CACHE_HOME=str(home)))
    assert compiled == 1 and f"kept in {home}" in said
    assert result(start(package, XDG_CACHE_HOME=str(home)))[1:] == (0, "")  # said once
    assert not (package / "irodori/__pycache__/kernels").exists()
    kept = home / "irodori" / "kernels"
    assert kept.stat().st_mode & 0o777 == 0o700
    assert list(kept.rglob("*.nbc"))
    kept.chmod(0o777)
    _, compiled, said = result(start(package, XDG_CACHE_HOME=str(home)))
    assert compiled == 1
    assert said.count("every process compiles its own") == 1


def test_a_folder_that_is_asked_for_is_used_only_where_nobody_else_can_write(package, tmp_path):
    asked = tmp_path / "asked"
    asked.mkdir(mode=0o700)
    assert result(start(package, NUMBA_CACHE_DIR=str(asked)))[1:] == (1, "")
    assert list(asked.rglob("*.nbi"))
    shutil.rmtree(asked)
    asked.mkdir()
    asked.chmod(0o777)
    _, compiled, said = result(start(package, NUMBA_CACHE_DIR=str(asked)))
    assert compiled == 1 and not list(asked.rglob("*"))
    assert f"NUMBA_CACHE_DIR {asked} is no folder that only this user can write" in said
    assert result(start(package, NUMBA_CACHE_DIR="/proc/none"))[1] == 0  # as kept beside the package


def test_states_that_nobody_used_for_long_are_removed(tmp_path):
    now = tmp_path / f"m-{'9' * 16}"
    for number in range(6):
        folder = tmp_path / f"m-{str(number) * 16}"
        folder.mkdir()
        if number < 5:
            os.utime(folder, (1e9 + number, 1e9 + number))
    other = tmp_path / f"m.n-{'0' * 16}"
    other.mkdir()
    prune(tmp_path, "m", now)
    assert sorted(f.name[2] for f in tmp_path.glob("m-*")) == ["4", "5"]
    assert other.is_dir()
