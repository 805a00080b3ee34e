"""The table of a session when the process dies: a crash after, or in place of, each single step on the disk."""

import os
from dataclasses import replace
from pathlib import Path

import pytest
from sessions import QuickCamera, assert_whole, contents, hold, shots

from irodori.capture.journal import Journal
from irodori.capture.operator import AutoOperator
from irodori.capture.session import Session, take_stock
from irodori.config.capture_table import read_captures
from irodori.core.atomic_files import file_sha256

PLAN = shots(4)


@pytest.fixture(autouse=True)
def quick_disk(monkeypatch):
    """Spare the waiting: a power cut, for which the bytes are flushed, is none of these tests'."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)


class _Crash(BaseException):
    """The process is gone: nothing that it would still have done to the disk happens."""


class _Disk:
    """Counts what is done to the disk; at one of these steps the process dies, before or after it."""

    def __init__(self, monkeypatch, step: int, done: bool):
        self.step, self.done, self.count, self.names = step, done, 0, []
        for place, name in (
            (os, "replace"), (os, "fsync"), (os, "truncate"), (Path, "unlink"), (Path, "mkdir"), (Path, "write_bytes"),
        ):  # fmt: skip
            monkeypatch.setattr(place, name, self.wrapped(getattr(place, name), name))

    def wrapped(self, action, name):
        def act(*arguments, **options):
            self.count += 1
            self.names.append(name)
            if self.count > self.step:
                raise _Crash
            if self.count == self.step and not self.done:
                raise _Crash
            result = action(*arguments, **options)
            if self.count == self.step:
                raise _Crash
            return result

        return act


SITUATIONS = {
    "an empty folder": lambda folder: None,
    "a session broken off": lambda folder: hold(folder, shots(3)[:2]),
    "another plan": lambda folder: hold(folder, [*shots(3, iso=400.0), *shots(5)[3:4]]),
    "lines without hashes": lambda folder: (
        hold(folder, [*shots(3)[:2], *shots(5)[3:4]]),
        _unhash(folder / "captures.csv"),
    ),
    "a changed file": lambda folder: (hold(folder, shots(3)), _spoil(folder / shots(3)[1].file)),
}


def _unhash(table: Path) -> None:
    header, *lines = table.read_text().splitlines()
    table.write_text("\n".join([header, *(line.rpartition(",")[0] + "," for line in lines), ""]))


def _spoil(path: Path) -> None:
    raw = bytearray(path.read_bytes())
    raw[-1] ^= 1
    path.write_bytes(raw)


@pytest.mark.default_cases(2)
@pytest.mark.stability(stage="capture", case="session killed at random moments")
@pytest.mark.parametrize("done", [False, True], ids=["before the step", "after the step"])
@pytest.mark.parametrize("situation", SITUATIONS)
def test_a_crash_at_any_step_loses_nothing_and_doubles_nothing(tmp_path, situation, done):
    planned = shots(3)
    SITUATIONS[situation](tmp_path / "whole") if (tmp_path / "whole").mkdir() is None else None
    first = contents(tmp_path / "whole")
    hold(tmp_path / "whole", planned)
    expected = contents(tmp_path / "whole")
    steps = set()
    for step in range(1, 1000):
        folder = tmp_path / f"{step}"
        folder.mkdir()
        for name, content in first.items():
            (folder / name).write_bytes(content)
        with pytest.MonkeyPatch.context() as patch:
            disk = _Disk(patch, step, done)
            try:
                hold(folder, planned)
            except _Crash:
                steps.add(disk.names[step - 1])
            else:
                break
        hold(folder, planned)
        assert contents(folder) == expected, f"step {step}: {disk.names[step - 1]}"
        assert_whole(folder, planned)
    assert step > 10 and steps >= {"replace", "fsync", "unlink"}


@pytest.mark.parametrize("done", [False, True], ids=["before the step", "after the step"])
def test_a_crash_while_a_photograph_makes_way_for_a_newer_one_loses_neither(tmp_path, done):
    """The older one stays under some name in every case, and the newer one once it has its own."""

    class Other(QuickCamera):
        def capture(self, shot, path):
            super().capture(replace(shot, file=f"{path.parent}{path}{len(self.taken)}"), path)

    planned = shots(2)
    for step in range(1, 100):
        folder = tmp_path / f"{step}"
        folder.mkdir()
        hold(folder, planned, Other())
        path, newer = folder / planned[1].file, folder / ".part-newer.dng"
        old = path.read_bytes()
        Other().capture(planned[1], newer)
        new, journal = newer.read_bytes(), Journal(folder / "captures.csv")
        with pytest.MonkeyPatch.context() as patch:
            disk = _Disk(patch, step, done)
            try:
                journal.make_way(planned[1].file)
                os.replace(newer, path)
                journal.append(planned[1], file_sha256(path))
            except _Crash:
                pass
        placed = not newer.exists()
        hold(folder, planned, Other())
        kept = [found.read_bytes() for found in folder.glob("*.dng")]
        assert old in kept and (new in kept) == placed, f"step {step}: {disk.names}"
        assert read_captures(folder / "captures.csv", folder) == planned
        if disk.count < step:
            break
    assert step > 5 and "-retaken-" in (folder / "captures-retired.csv").read_text()


def test_lines_are_on_the_disk_before_the_next_photograph(tmp_path):
    """Read from outside while the session runs, the table lists all that was taken before."""
    seen = []

    class Watching(QuickCamera):
        def capture(self, shot, path):
            table = (tmp_path / "captures.csv").read_text().splitlines()[1:]
            seen.append([line.split(",")[0] for line in table])
            super().capture(shot, path)

    journal = Journal(tmp_path / "captures.csv")
    operator = AutoOperator(lambda settings: None)
    Session(Watching(), operator, journal, None, take_stock(journal, PLAN)).run(PLAN, "test")
    names = [shot.file for shot in PLAN]
    assert seen == [names[:i] for i in range(len(PLAN))]
