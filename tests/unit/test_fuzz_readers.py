"""Every reader of files, given damaged ones: each ends in a result or in one sentence, soon and in little memory."""

import json
import os
import random
import sys
from pathlib import Path

import patience
import pytest
from reader_fuzzer import LONGEST_S, ROOT

#: Readers of each group, and damaged files for each of them: some hundred in all, and ten thousand.
_READERS = {"text": 15, "pictures": 6, "meshes": 4, "HDF5": 3}
_ORDINARY, _HEAVY = 12, 360
_MOST_MB = 1000.0


def read_damaged(folder, group: str, count: int) -> None:
    """Have every reader of a group read damaged files; where CI is set, the same ones every time."""
    seed = 0 if os.environ.get("CI") else random.randrange(2**31)
    command = [sys.executable, Path(__file__).with_name("reader_fuzzer.py"), group, folder, count, seed]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (ROOT, ROOT / "tests")))}
    run = patience.run(list(map(str, command)), env=environment)
    assert run.returncode == 0, f"seed {seed}, {folder}: {run.stderr[-2000:]}"
    found = json.loads(run.stdout)
    assert len(found) == _READERS[group]
    for name, outcomes in found.items():
        assert outcomes.pop("slowest_s") < LONGEST_S, f"{name}, seed {seed}"
        assert outcomes.pop("grown_mb") < _MOST_MB, f"{name}, seed {seed}"
        assert set(outcomes) <= {"read", "refused"}, f"{name}, seed {seed}: {outcomes}"
        assert sum(outcomes.values()) == count, f"{name}, seed {seed}: {outcomes}"
    assert sum(outcomes.get("refused", 0) for outcomes in found.values()) > len(found)


@pytest.mark.stability(stage="fuzzing", case="files of every reader damaged")
@pytest.mark.parametrize("group", _READERS)
def test_damaged_files_are_read_or_refused_in_one_sentence(tmp_path, group):
    read_damaged(tmp_path, group, _ORDINARY)


@pytest.mark.heavy
@pytest.mark.parametrize("group", _READERS)
def test_ten_thousand_damaged_files_are_read_or_refused_in_one_sentence(tmp_path, group):
    assert sum(_READERS.values()) * _HEAVY >= 10_000
    read_damaged(tmp_path, group, _HEAVY)
