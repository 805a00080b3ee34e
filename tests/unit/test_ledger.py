"""Hashes of the user's files follow their content, and a file that did not change is not read again."""

import json
import os
import time

import pytest

from irodori.core import ledger as module
from irodori.core.ledger import Ledger

OLD_NS = 1_000_000_000_000_000_000


@pytest.fixture
def project(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results").mkdir()
    write(tmp_path / "a.dng", b"first")
    (tmp_path / "b.csv").write_bytes(b"table")
    return tmp_path


@pytest.fixture
def read(monkeypatch) -> list[str]:
    """Return the files that are read, in order."""
    files: list[str] = []
    whole = module.file_sha256
    monkeypatch.setattr(module, "file_sha256", lambda path: files.append(str(path)) or whole(path))
    return files


@pytest.fixture
def settled(monkeypatch):
    """Let every file be old enough to be remembered."""
    now = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: now() + 3_000_000_000)


def write(path, content: bytes, time_ns: int = OLD_NS) -> None:
    path.write_bytes(content)
    os.utime(path, ns=(time_ns, time_ns))


def content(*files) -> str:
    return Ledger("results/inputs.json").content(lambda wildcards: list(files))(None)


def test_a_file_is_read_once_however_many_runs_ask_for_it(project, read, settled):
    first = content("a.dng", "b.csv")
    assert read == ["a.dng", "b.csv"]
    assert content("a.dng", "b.csv") == first and len(read) == 2
    os.utime("a.dng")
    assert content("a.dng", "b.csv") == first and read[2:] == ["a.dng"]


@pytest.mark.parametrize("time_ns", [OLD_NS, OLD_NS - 10**15, OLD_NS + 10**15])
def test_other_content_is_seen_whatever_its_size_and_time(project, settled, time_ns):
    first = content("a.dng")
    write(project / "a.dng", b"other", time_ns)
    assert content("a.dng") != first
    write(project / "a.dng", b"first", time_ns)
    assert content("a.dng") == first


def test_a_file_that_changed_a_moment_ago_is_read_again(project, read):
    content("b.csv")
    content("b.csv")
    assert read == ["b.csv", "b.csv"]


def test_a_missing_file_is_another_content_and_no_error(project):
    first = content("a.dng")
    (project / "a.dng").unlink()
    assert content("a.dng") != first


@pytest.mark.parametrize("damage", [b"", b"[1]", b"\xff{", b'{"a.dng": 3}', b'{"a.dng": []}'])
def test_a_damaged_or_unwritable_ledger_costs_reading_and_nothing_else(project, settled, damage):
    first = content("a.dng")
    (project / "results/inputs.json").write_bytes(damage)
    assert content("a.dng") == first
    (project / "results/inputs.json").unlink()
    (project / "results/inputs.json").mkdir()
    assert content("a.dng") == first


def test_a_dry_run_in_a_new_project_leaves_nothing(project, settled):
    (project / "results").rmdir()
    content("a.dng")
    assert sorted(os.listdir(project)) == ["a.dng", "b.csv"]


def test_jobs_beside_each_other_keep_what_the_others_have_read(project, settled, read):
    one, other = Ledger("results/inputs.json"), Ledger("results/inputs.json")
    one.content(lambda wildcards: ["a.dng"])(None)
    other.content(lambda wildcards: ["b.csv"])(None)
    assert set(json.loads((project / "results/inputs.json").read_text())) == {"a.dng", "b.csv"}


def test_photographs_of_a_session_are_named_where_they_are_not_those_it_took(project):
    noted = {"a.dng": "0" * 64, "b.csv": "", "gone.dng": "1" * 64}
    found = Ledger("results/inputs.json").altered(lambda wildcards: noted)(None)
    assert [line.split()[0] for line in found] == ["a.dng", "b.csv"]
    noted["a.dng"], noted["b.csv"] = (line.split()[1] for line in found)
    assert Ledger("results/inputs.json").altered(lambda wildcards: noted)(None) == []
