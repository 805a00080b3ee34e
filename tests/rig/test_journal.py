"""The table of a session: what a crash, a person or another plan may have done to it and to its files."""

import csv
import errno
import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
from sessions import ROOT, QuickCamera, assert_whole, contents, hold, shots

from irodori.capture.journal import RETIRED, Journal, StorageError, claimed
from irodori.capture.rig.devices import DeviceError
from irodori.config.capture_table import Pose, Shot, read_captures
from irodori.core.errors import InputError

PLAN = shots(4)


@pytest.fixture(autouse=True)
def quick_disk(monkeypatch):
    """Spare the waiting: a power cut, for which the bytes are flushed, is none of these tests'."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)


@pytest.fixture
def done(tmp_path):
    """Return a folder in which a session is complete."""
    hold(tmp_path, PLAN)
    assert_whole(tmp_path, PLAN)
    return tmp_path


def retired(folder: Path) -> dict[str, dict]:
    with open(folder / RETIRED, newline="") as file:
        return {row["file"]: row for row in csv.DictReader(file)}


# ---- the table


@pytest.mark.stability(stage="capture", case="line of the table torn")
def test_a_line_torn_at_any_byte_costs_nothing(done, caplog):
    before = contents(done)
    whole = before["captures.csv"]
    start = whole.rstrip(b"\n").rfind(b"\n") + 1
    for cut in range(start, len(whole)):
        (done / "captures.csv").write_bytes(whole[:cut])
        camera = QuickCamera()
        caplog.clear()
        tally = hold(done, PLAN, camera)
        assert contents(done) == before
        # Only the line break may lack; a line without a hash, as a person writes it, is left to the plan.
        is_complete, is_unhashed = cut == len(whole) - 1, cut == whole.rfind(b",") + 1
        assert not camera.taken and (tally.kept, tally.adopted) == ((4, 0) if is_complete else (3, 1))
        is_removed = "captures.csv: its last line is incomplete and was removed: " in caplog.text
        assert is_removed != (is_complete or is_unhashed or cut == start)


def test_a_last_line_without_a_line_break_is_kept_and_the_next_photograph_has_its_own_line(tmp_path):
    """Some editors end no last line: as much as a table in which nothing is missing."""
    hold(tmp_path, PLAN[:3])
    table = tmp_path / "captures.csv"
    table.write_bytes(table.read_bytes().removesuffix(b"\n"))
    before = read_captures(table, tmp_path)
    assert list(Journal(table).shots.values()) == before and len(before) == 3
    table.write_bytes(table.read_bytes().removesuffix(b"\n"))
    camera = QuickCamera()
    hold(tmp_path, PLAN, camera)
    assert camera.taken == [PLAN[3].file] and read_captures(table, tmp_path) == PLAN


@pytest.mark.parametrize("left", ["", "file,role,li", "the header"])
def test_a_table_without_photographs_is_begun_anew_and_finds_the_files(done, left):
    before = contents(done)
    header = before["captures.csv"].split(b"\n")[0].decode() + "\n"
    (done / "captures.csv").write_text(header if left == "the header" else left)
    assert hold(done, PLAN).adopted == 4
    assert contents(done) == before


@pytest.mark.parametrize("text", ["name,when\na.dng,noon\n", "what is this", "\n\n", "file,role\n"])
def test_a_foreign_table_is_refused_and_left_as_it_is(tmp_path, text):
    (tmp_path / "captures.csv").write_text(text)
    with pytest.raises(InputError, match=r"captures\.csv: line 1: found another header; accepted: .*file,role,light"):
        Journal(tmp_path / "captures.csv")
    assert (tmp_path / "captures.csv").read_text() == text


def test_a_damaged_line_in_the_middle_is_the_persons_to_mend(done):
    table = done / "captures.csv"
    table.write_text(table.read_text().replace("object,45.0", "object,sideways", 1))
    with pytest.raises(InputError, match="light_deg"):
        Journal(table)


def test_a_table_that_a_spreadsheet_saved_is_still_one(done):
    before = contents(done)
    table = done / "captures.csv"
    table.write_bytes(b"\xef\xbb\xbf" + table.read_bytes().replace(b"\n", b"\r\n"))
    assert hold(done, PLAN).kept == 4
    assert read_captures(table, done) == PLAN
    assert set(contents(done)) == set(before)


def test_a_table_that_vanishes_in_mid_session_does_not_begin_again_without_its_header(tmp_path):
    class Careless(QuickCamera):
        def capture(self, shot, path):
            super().capture(shot, path)
            if len(self.taken) == 3:
                (tmp_path / "captures.csv").unlink()

    with pytest.raises(StorageError, match=r"captures\.csv: cannot be stored: No such file"):
        hold(tmp_path, PLAN, Careless())
    hold(tmp_path, PLAN)
    assert_whole(tmp_path, PLAN)


# ---- the files


def test_a_deleted_file_is_taken_again_and_no_other(done):
    before = contents(done)
    (done / PLAN[1].file).unlink()
    camera = QuickCamera()
    hold(done, PLAN, camera)
    assert camera.taken == [PLAN[1].file]
    assert contents(done) == before


def test_a_file_that_changed_on_the_disk_is_kept_aside_and_taken_again(done):
    before = contents(done)
    path = done / PLAN[2].file
    changed = bytearray(path.read_bytes())
    changed[-1] ^= 1
    path.write_bytes(changed)
    # A session that is killed right after it saw the change must not leave the file to be adopted by the next.
    Journal(done / "captures.csv")
    camera = QuickCamera()
    assert hold(done, PLAN, camera).adopted == 0
    assert camera.taken == [PLAN[2].file]
    after = contents(done)
    aside = [name for name in after if "-changed-" in name]
    assert [after.pop(name) for name in aside] == [bytes(changed)]
    assert after == before


def test_a_file_without_a_line_is_noted_once_it_is_verified(done):
    before = contents(done)
    table = done / "captures.csv"
    lines = table.read_text().splitlines(keepends=True)
    table.write_text("".join(lines[:2] + lines[3:]))
    camera = QuickCamera()
    tally = hold(done, PLAN, camera)
    assert not camera.taken and (tally.kept, tally.adopted, tally.taken) == (3, 1, 0)
    assert contents(done) == before


@pytest.mark.parametrize("damage", [lambda raw: raw[:100], lambda raw: b"", lambda raw: b"nonsense"])
def test_a_broken_file_without_a_line_is_taken_again(done, damage):
    before = contents(done)
    table, path = done / "captures.csv", done / PLAN[3].file
    table.write_text("".join(table.read_text().splitlines(keepends=True)[:4]))
    broken = damage(path.read_bytes())
    path.write_bytes(broken)
    camera = QuickCamera()
    tally = hold(done, PLAN, camera)
    assert camera.taken == [PLAN[3].file] and (tally.adopted, tally.taken) == (0, 1)
    after = contents(done)
    # A file is never written over: what could not be vouched for is kept beside the new one.
    aside = [name for name in after if "-broken-" in name]
    assert [after.pop(name) for name in aside] == [broken] and after == before


def test_a_folder_without_one_photograph_of_the_table_is_refused_and_the_table_kept(done, tmp_path):
    table = done / "captures.csv"
    before = table.read_bytes()
    with pytest.raises(InputError, match=f"none of the {len(PLAN)} photographs"):
        Journal(table, tmp_path / "not-mounted")
    assert table.read_bytes() == before


def test_a_file_without_a_line_and_of_another_exposure_is_taken_again(tmp_path):
    QuickCamera([0.5]).capture(PLAN[0], tmp_path / PLAN[0].file)
    assert hold(tmp_path, PLAN).adopted == 0
    assert_whole(tmp_path, PLAN)


def test_leftovers_of_a_killed_session_are_cleared(done):
    name = PLAN[0].file
    for left in (f".part-{name}", f"..part-{name}.part", ".captures.csv.part", f".{RETIRED}.part"):
        (done / left).write_bytes(b"half")
    (done / "notes.txt").write_text("light bulb changed")
    hold(done, PLAN)
    assert_whole(done, PLAN)
    assert (done / "notes.txt").exists()


# ---- another plan


def test_what_a_changed_plan_does_not_ask_for_is_listed_and_kept_and_comes_back(done):
    before = contents(done)
    assert hold(done, PLAN[:2]).retired == 2
    assert read_captures(done / "captures.csv") == PLAN[:2]
    assert set(retired(done)) == {shot.file for shot in PLAN[2:]}
    assert set(contents(done)) == {*before, RETIRED}
    camera = QuickCamera()
    assert hold(done, PLAN, camera).adopted == 2
    assert not camera.taken
    assert contents(done) == before


def test_a_photograph_of_the_same_name_with_another_setting_never_passes_for_the_new_one(done):
    """The name of a file tells neither the sensitivity nor where the chart stood."""
    before, faster = contents(done), shots(4, iso=400.0)
    camera = QuickCamera()
    tally = hold(done, faster, camera)
    assert (tally.retired, tally.taken, tally.adopted) == (4, 4, 0)
    assert_whole(done, faster)
    after = contents(done)
    for name, row in retired(done).items():
        assert name in after and row["iso"] == ""
        assert after[name] in before.values()
    assert len(retired(done)) == 4
    # And there and back: two retired photographs of one bracket are no contradiction in a log.
    hold(done, shots(4, iso=800.0))
    hold(done, faster)
    assert_whole(done, faster)
    assert {row["iso"] for row in retired(done).values()} == {"", "400.0", "800.0"}


def test_a_retired_photograph_is_not_adopted_for_another_one_of_its_name(done):
    hold(done, PLAN[:2])
    faster = shots(4, iso=400.0)
    tally = hold(done, [*PLAN[:2], *faster[2:]])
    assert (tally.kept, tally.adopted, tally.taken) == (2, 0, 2)
    kept = [name for name in contents(done) if "-retired-" in name]
    assert len(kept) == 2 and set(kept) == set(retired(done))


def test_the_pose_of_the_chart_may_change_between_sessions(tmp_path):
    one, two = (Shot("chart-out.dng", "chart", Pose(angle, 0.0), "out", 0.02) for angle in (45.0, 30.0))
    hold(tmp_path, [one])
    camera = QuickCamera()
    hold(tmp_path, [two], camera)
    assert camera.taken == ["chart-out.dng"]
    assert_whole(tmp_path, [two])


# ---- lines that a person wrote


def unhash(table: Path, *files: str, old: str = "", new: str = "") -> None:
    """Take the hashes out of lines, and change their text."""
    lines = table.read_text().splitlines(keepends=True)
    for number, line in enumerate(lines):
        if line.split(",")[0] in files:
            lines[number] = line.rstrip("\n").rpartition(",")[0].replace(old, new) + ",\n"
    table.write_text("".join(lines))


def test_a_line_without_a_hash_is_as_good_as_its_file(done):
    before = contents(done)
    unhash(done / "captures.csv", PLAN[1].file)
    camera = QuickCamera()
    tally = hold(done, PLAN, camera)
    assert not camera.taken and (tally.kept, tally.adopted, tally.retired) == (3, 1, 0)
    assert contents(done) == before


def test_a_line_without_a_hash_that_no_plan_asks_for_is_listed_with_the_retired_and_its_file_kept(done):
    before = contents(done)
    unhash(done / "captures.csv", PLAN[2].file, PLAN[3].file)
    assert hold(done, PLAN[:2]).retired == 2
    after = contents(done)
    assert set(retired(done)) == {shot.file for shot in PLAN[2:]}
    for name, row in retired(done).items():
        assert row["sha256"] == hashlib.sha256(before[name]).hexdigest() and after[name] == before[name]
    assert read_captures(done / "captures.csv") == PLAN[:2]
    # And it comes back as others do.
    camera = QuickCamera()
    assert hold(done, PLAN, camera).adopted == 2
    assert not camera.taken and contents(done) == before


def test_a_line_without_a_hash_of_another_pose_never_passes_for_the_one_that_is_asked_for(done):
    """Nothing in the file says where the light stood: the person's line does."""
    before = contents(done)
    unhash(done / "captures.csv", PLAN[1].file, old="object,45.0", new="object,60.0")
    camera = QuickCamera()
    assert hold(done, PLAN, camera).retired == 1
    assert camera.taken == [PLAN[1].file]
    assert_whole(done, PLAN)
    ((name, row),) = retired(done).items()
    assert "-retired-" in name and row["light_deg"] == "60.0" and contents(done)[name] == before[PLAN[1].file]


def test_looking_at_a_table_loses_no_line_without_a_hash(done):
    table = done / "captures.csv"
    unhash(table, PLAN[0].file)
    (done / PLAN[3].file).unlink()  # makes the table be written again
    Journal(table)
    assert [line.split(",")[0] for line in table.read_text().splitlines()[1:]] == [
        PLAN[1].file, PLAN[2].file, PLAN[0].file,
    ]  # fmt: skip


# ---- the disk, and others at work


@pytest.mark.stability(stage="capture", case="disk full")
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EIO])
def test_a_disk_that_refuses_is_said_in_one_sentence_and_costs_only_the_last_photograph(tmp_path, number):
    camera = QuickCamera([None, None, OSError(number, os.strerror(number))])
    with pytest.raises(StorageError) as caught:
        hold(tmp_path, PLAN, camera)
    said = str(caught.value)
    assert PLAN[2].file in said and os.strerror(number) in said and "stays" in said
    camera = QuickCamera()
    hold(tmp_path, PLAN, camera)
    assert camera.taken == [shot.file for shot in PLAN[2:]]
    assert_whole(tmp_path, PLAN)


@pytest.mark.stability(stage="capture", case="disk full")
def test_a_disk_that_fills_up_under_the_table_costs_no_photograph(tmp_path, monkeypatch):
    whole, calls = os.fsync, []

    def full(handle):
        calls.append(handle)
        if len(calls) == 9:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return whole(handle)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match="No space left"):
        hold(tmp_path, PLAN)
    monkeypatch.undo()
    hold(tmp_path, PLAN)
    assert_whole(tmp_path, PLAN)


def test_a_folder_that_takes_no_files_is_named(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    # Permissions do not bind the superuser, as whom tests may run: a refusal of the system stands for them.
    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(StorageError, match=r"raw/captures\.csv: cannot be stored: Permission denied"):
        Journal(tmp_path / "raw/captures.csv")


def test_a_file_in_the_place_of_a_folder_is_named(tmp_path):
    (tmp_path / "raw").write_text("")
    for begin in (Journal, lambda table: claimed(table, table.parent, "object jar").__enter__()):
        with pytest.raises(StorageError, match=r"cannot be stored: .*(exists|[Nn]ot a directory)"):
            begin(tmp_path / "raw/captures.csv")


HOLDING = """
import sys
from pathlib import Path
from irodori.capture.journal import claimed
folder = Path(sys.argv[1])
with claimed(folder / "captures.csv", folder, "object jar"):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_one_session_at_a_time_writes_a_folder(tmp_path):
    mine = (tmp_path / "captures.csv", tmp_path, "object jar")
    command = [sys.executable, "-c", HOLDING, str(tmp_path)]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "held\n"
        with pytest.raises(DeviceError, match="another session is at work"), claimed(*mine):
            pass
        other.kill()
        other.wait()
    with claimed(*mine):
        pass


def test_photographs_of_two_objects_never_share_a_folder_or_a_table(tmp_path):
    table, folder = tmp_path / "jar.csv", tmp_path / "raw"
    with claimed(table, folder, "object jar"):
        pass
    with claimed(table, folder, "object jar"):
        pass
    for places in ((tmp_path / "cup.csv", folder), (table, tmp_path / "cup")):
        with pytest.raises(InputError, match="photographs of the object jar"), claimed(*places, "object cup"):
            pass
    with claimed(tmp_path / "cup.csv", tmp_path / "cup2", "object cup"):
        pass


def test_a_table_is_not_finished_while_a_photograph_is_missing(tmp_path):
    journal = Journal(tmp_path / "captures.csv")
    with pytest.raises(ValueError, match="2 photographs are missing"):
        journal.finish(PLAN[:2])


def test_a_table_of_an_earlier_version_is_continued_and_gains_its_columns(done):
    table = done / "captures.csv"
    names = ["file", "role", "light_deg", "camera_deg", "tilt_deg", "turn_deg", "filter", "exposure_s"]
    names += ["iso", "f_number", "sha256"]
    now, rows = table.read_text(), list(csv.DictReader(table.read_text().splitlines()))
    table.write_text("".join(",".join(row) + "\n" for row in [names, *([r[name] for name in names] for r in rows)]))
    camera = QuickCamera()
    assert hold(done, PLAN, camera).kept == len(PLAN) and not camera.taken
    assert table.read_text() == now
