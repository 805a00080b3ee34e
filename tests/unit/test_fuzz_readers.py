"""Every reader of files, given damaged ones: each ends in a result or in one sentence, soon and in little memory."""

import json
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest
from depth import inputs
from reader_fuzzer import GROUPS, LONGEST_S, ROOT

#: Files for each reader of a group; together with 28 readers more than 10,000 where heavy tests are asked for.
_EACH = {"text": (8, 300), "pictures": (15, 450), "meshes": (25, 550), "HDF5": (15, 250)}
_MOST_MB = 1000.0
#: For a process that reads thousands of files in a minute on a quiet machine.
_DEADLINE_S = 1200.0


@pytest.mark.stability(stage="fuzzing", case="files of every reader damaged")
@pytest.mark.parametrize("group", GROUPS)
def test_damaged_files_are_read_or_refused_in_one_sentence(tmp_path, group):
    seed = 0 if os.environ.get("CI") else random.randrange(2**31)
    count = inputs(*_EACH[group])
    command = [sys.executable, Path(__file__).with_name("reader_fuzzer.py"), group, tmp_path, count, seed]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (ROOT, ROOT / "tests")))}
    run = subprocess.run(map(str, command), capture_output=True, text=True, timeout=_DEADLINE_S, env=environment)
    assert run.returncode == 0, f"seed {seed}, {tmp_path}: {run.stderr[-2000:]}"
    found = json.loads(run.stdout)
    for name, outcomes in found.items():
        assert outcomes.pop("slowest_s") < LONGEST_S, f"{name}, seed {seed}"
        assert outcomes.pop("grown_mb") < _MOST_MB, f"{name}, seed {seed}"
        assert set(outcomes) <= {"read", "refused"}, f"{name}, seed {seed}: {outcomes}"
        assert sum(outcomes.values()) == count, f"{name}, seed {seed}: {outcomes}"
    assert sum(outcomes.get("refused", 0) for outcomes in found.values()) > len(found)


def test_heavy_runs_read_ten_thousand_inputs():
    assert sum(len(readers()) * _EACH[group][1] for group, readers in GROUPS.items()) >= 10_000
