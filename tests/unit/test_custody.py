"""A result that is not what its rule wrote, or not made from what lies there, is never read."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import h5py
import numpy as np
import pytest

from irodori.core import store
from irodori.core.custody import Chain, beside, main, read_record, received, verified, write_record
from irodori.core.errors import InputError


@pytest.fixture
def project(tmp_path, monkeypatch):
    """Return the folder of two objects' tiles, their materials, and a picture of both, as jobs leave them."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "jar.csv").write_text("file,exposure_s\n")
    for name in ("jar", "lid"):
        make(f"results/{name}/brdf.h5", ["jar.csv"], alpha=0.4)
        make(f"results/{name}/material.h5", [f"results/{name}/brdf.h5"], alpha=0.4)
    picture = tmp_path / "results/scene/front.png"
    picture.parent.mkdir()
    picture.write_bytes(b"\x89PNG picture")
    write_record(picture, "results/scene/front.png", hashes("results/jar/material.h5", "results/lid/material.h5"))
    return tmp_path


def hashes(*files) -> dict[str, str]:
    return {file: received(file, {}) if file.startswith("results") else accepted_hash(file) for file in files}


def accepted_hash(file) -> str:
    return subprocess.run(["sha256sum", file], capture_output=True, text=True, check=True).stdout.split()[0]


def make(path, inputs, alpha) -> None:
    with store.create(path, store.Provenance("fit_brdf", inputs=hashes(*inputs))) as out:
        out.write("alpha", np.full((200, 300), alpha), units="1", dims="row,column", quantity="diffuse weight")
        out.attribute("lobes", ["gaussian"])


def halve(path) -> None:
    with h5py.File(path, "r+") as file:
        file["alpha"][...] *= 0.5


def verify(capsys, *arguments) -> tuple[int, str]:
    status = main([*arguments])
    return status, capsys.readouterr().out


MATERIAL = "results/jar/material.h5"


def test_results_that_nobody_touched_hold_together(project, capsys):
    assert verify(capsys) == (0, "every link holds (5 results)\n")
    assert received(MATERIAL, {}) == read_record(MATERIAL).sha256


def test_an_hdf5_file_carries_its_hash_wherever_it_goes(project):
    shutil.copy(MATERIAL, project / "elsewhere.h5")
    with store.open_file(project / "elsewhere.h5") as file:
        assert file.read("alpha")[0, 0] == 0.4
    halve(project / "elsewhere.h5")
    with pytest.raises(InputError, match=r"elsewhere\.h5: found content that its rule did not write"):
        store.open_file(project / "elsewhere.h5").__enter__()


def dataset() -> None:
    halve(MATERIAL)


def attribute() -> None:
    with h5py.File(MATERIAL, "r+") as file:
        file.attrs["lobes"] = 'json:["ggx"]'


def cut_short() -> None:
    os.truncate(MATERIAL, os.stat(MATERIAL).st_size - 100)


def beginning_only() -> None:
    os.truncate(MATERIAL, 300)


def swapped() -> None:
    shutil.copy("results/lid/material.h5", MATERIAL)


def renamed() -> None:
    os.replace(MATERIAL, "results/jar/old.h5")
    os.replace("results/lid/material.h5", MATERIAL)


def no_hash() -> None:
    content = Path(MATERIAL).read_bytes()
    Path(MATERIAL).write_bytes(content[content.index(b"\x89HDF") :])


def head_edited() -> None:
    content = Path(MATERIAL).read_bytes()
    known = read_record("results/jar/brdf.h5").sha256.encode()
    Path(MATERIAL).write_bytes(content.replace(known, known[::-1]))


def record_edited() -> None:
    """Let a file claim another name: the head is part of what the hash stands for."""
    content = Path("results/lid/material.h5").read_bytes()
    Path(MATERIAL).write_bytes(content.replace(b"results/lid/", b"results/jar/"))


ATTACKS = (dataset, attribute, cut_short, beginning_only, swapped, renamed, no_hash, head_edited, record_edited)


@pytest.mark.parametrize("attack", ATTACKS)
def test_no_rule_reads_what_is_not_what_its_rule_wrote(project, attack):
    attack()
    with pytest.raises(InputError, match=r"results/jar/material\.h5: found .*; accepted: .*as its rule wrote it"):
        received(MATERIAL, {})


@pytest.mark.parametrize("attack", ATTACKS)
def test_verify_names_the_broken_link_and_leaves_the_file(project, capsys, attack):
    attack()
    status, said = verify(capsys)
    assert status == 1 and "/results/jar/" in said and "front.png" not in said
    assert said.count("\n") == (3 if attack is renamed else 1), "each broken link on a line, and nothing else"
    assert os.path.exists(MATERIAL)


@pytest.mark.parametrize("lost", ["results/scene/front.png", MATERIAL, "results/jar/brdf.h5"])
def test_a_missing_result_is_named_and_the_rest_is_looked_at(project, capsys, lost):
    report = "results/scene/report.html"
    Path(report).write_text("<html>")
    write_record(report, report, hashes("results/scene/front.png"))
    halve("results/lid/brdf.h5")
    (project / lost).unlink()
    status, said = verify(capsys)
    accepted = f"a result of the files as they are now: run snakemake {lost}."
    assert status == 1 and f"{project / lost}: found no such file; accepted: {accepted}\n" in said
    assert "results/lid/brdf.h5: found content that its rule did not write" in said
    assert said.count("\n") == 2, "what was made from either is not to blame"


def test_a_folder_in_the_place_of_a_result_is_named(project, capsys):
    Path(MATERIAL).unlink()
    Path(MATERIAL).mkdir()
    status, said = verify(capsys)
    assert status == 1 and said.count("\n") == 1
    assert "results/jar/material.h5: found no file that can be read (Is a directory)" in said


def test_an_emptied_result_is_named_itself_and_cannot_be_accepted(project, capsys):
    os.truncate(MATERIAL, 0)
    status, said = verify(capsys)
    accepted = "the file as its rule wrote it; without the file, the next run makes it again"
    assert (status, said) == (1, f"{project / MATERIAL}: found an empty file; accepted: {accepted}.\n")
    status, said = verify(capsys, "--accept", MATERIAL)
    assert status == 1 and f"{MATERIAL}: found an empty file; accepted: a complete file" in said


@pytest.mark.parametrize("change", ["emptied", "edited", "removed"])
def test_a_sessions_photograph_is_named_itself_with_the_way_to_take_it_again(project, capsys, change):
    raw, session = Path("results/jar/captures/one.dng"), "results/jar/captures/session.json"
    raw.parent.mkdir()
    raw.write_bytes(b"light")
    Path(session).write_text("{}")
    write_record(session, session, hashes("jar.csv") | {str(raw): accepted_hash(raw)})
    make("results/jar/linear.h5", [session], alpha=0.4)
    assert verify(capsys)[0] == 0
    if change == "removed":
        raw.unlink()
    else:
        raw.write_bytes(b"dark" if change == "edited" else b"")
    found = {"emptied": "an empty file", "removed": "no such file"}.get(change, "content that does not match its hash")
    status, said = verify(capsys)
    assert status == 1 and said.startswith(f"{project / raw}: found {found}") and said.count("\n") == 1
    assert f"a copy, or a new one by snakemake --forcerun {session}." in said


def test_an_emptied_file_of_the_user_is_named_once(project, capsys):
    os.truncate("jar.csv", 0)
    accepted = "the file that results/jar/brdf.h5 was made from"
    assert verify(capsys) == (1, f"{project / 'jar.csv'}: found an empty file; accepted: {accepted}.\n")


def test_a_picture_of_an_older_material_is_found(project, capsys):
    make(MATERIAL, ["results/jar/brdf.h5"], alpha=0.3)
    status, said = verify(capsys)
    assert status == 1
    assert re.search(r"scene/front\.png: found a result of results/jar/material\.h5, which has changed", said)


def test_a_material_of_older_tiles_is_not_rendered(project):
    make("results/jar/brdf.h5", ["jar.csv"], alpha=0.3)
    with pytest.raises(InputError, match=r"material\.h5: found a result of another version of results/jar/brdf\.h5"):
        received(MATERIAL, {})


@pytest.mark.parametrize("change", ["edited", "removed"])
def test_a_users_file_that_changed_breaks_the_first_link(project, capsys, change):
    (project / "jar.csv").write_text("other\n") if change == "edited" else (project / "jar.csv").unlink()
    status, said = verify(capsys, "results")
    what = "has changed since" if change == "edited" else "is gone"
    assert status == 1 and f"brdf.h5: found a result of jar.csv, which {what}" in said


@pytest.mark.parametrize("tile", ["jar/observations/tile-000.h5", "cameras/one/linear/chart.h5"])
def test_intermediate_files_that_were_removed_break_no_link_but_are_counted(project, capsys, tile):
    tile, picture = f"results/{tile}", "results/scene/front.png"
    make(tile, ["jar.csv"], alpha=0.4)
    make(MATERIAL, ["results/jar/brdf.h5", tile], alpha=0.4)
    write_record(picture, picture, hashes(MATERIAL))
    assert "not kept" not in verify(capsys)[1]
    Path(tile).unlink()
    status, said = verify(capsys)
    assert status == 0 and "1 intermediate files are not kept" in said
    with pytest.raises(InputError, match="keep_intermediate: true"):
        Chain("results").made_from([Path(MATERIAL)])


def linear(pose: str) -> str:
    return f"results/jar/linear/{pose}.h5"


@pytest.fixture
def rerun(project):
    """Return the project after a run in which a pose has another name than in the run before."""
    for table, pose in (("file,exposure_s\n", "l0450-c0200"), ("file,exposure_s\na.dng,1\n", "l0440-c0200")):
        (project / "jar.csv").write_text(table)
        make(linear(pose), ["jar.csv"], alpha=0.4)
        make("results/jar/observations/tile-000.h5", [linear(pose)], alpha=0.4)
        make("results/jar/brdf.h5", ["jar.csv"], alpha=0.4)
        make(MATERIAL, ["results/jar/brdf.h5", "results/jar/observations/tile-000.h5"], alpha=0.4)
    make("results/lid/brdf.h5", ["jar.csv"], alpha=0.4)
    make("results/lid/material.h5", ["results/lid/brdf.h5"], alpha=0.4)
    picture = "results/scene/front.png"
    write_record(picture, picture, hashes(MATERIAL, "results/lid/material.h5"))
    return project


@pytest.mark.parametrize("folder", ["results", "results/jar", "results/jar/linear"])
@pytest.mark.parametrize("more", ["", "observations"])
def test_what_a_renamed_pose_has_left_is_named_and_breaks_no_link(rerun, capsys, folder, more):
    left = [linear("l0450-c0200")]
    if more:  # and what was made from it, as of a tile that is no more
        left.append("results/jar/observations/tile-001.h5")
        make(left[1], left[:1], alpha=0.4)
    status, said = verify(capsys, folder)
    *lines, last = said.splitlines()
    words = "left over: its inputs have changed since, and no present result was made from it; remove it"
    asked = [path for path in left if path.startswith(f"{folder}/")]
    assert status == 0 and last.startswith("every link holds (")
    assert lines == [f"{Path(path).absolute()}: {words}" for path in asked]
    for path in left:
        Path(path).unlink()
    status, said = verify(capsys, folder)
    assert status == 0 and said == last + "\n"


def test_a_stale_intermediate_file_of_a_present_result_is_still_a_broken_link(rerun, capsys):
    (rerun / "jar.csv").write_text("file,exposure_s\nb.dng,1\n")
    status, said = verify(capsys)
    for pose in ("l0440-c0200", "l0450-c0200"):  # whether the next run makes it again, no result tells yet
        assert f"{linear(pose)}: found a result of jar.csv, which has changed since" in said
    assert status == 1 and "left over" not in said


@pytest.mark.parametrize("missing", [MATERIAL, "jar.csv"])
def test_nothing_is_left_over_without_a_result_or_without_its_input(rerun, capsys, missing):
    """A material was removed, or a first run was broken off, and then a photograph is changed or lost."""
    Path(missing).unlink()
    if missing == MATERIAL:
        Path("results/scene/front.png").unlink()
    for folder in ("results", "results/jar/linear"):
        status, said = verify(capsys, folder)
        what = "is gone" if missing == "jar.csv" else "has changed since"
        assert status == 1 and f"{linear('l0450-c0200')}: found a result of jar.csv, which {what}" in said
        assert "left over" not in said


def test_what_is_behind_a_file_that_is_left_over_is_looked_at(rerun, capsys):
    """A photograph that is gone breaks the link of the checked table, which is no file of the folder."""
    table = "results/jar/captures.csv"
    Path("a.dng").write_bytes(b"light")
    for pose in ("l0450-c0200", "l0440-c0200"):
        Path(table).write_text(pose)
        write_record(table, table, hashes("a.dng"))
        make(linear(pose), [table], alpha=0.4)
        make("results/jar/observations/tile-000.h5", [linear(pose)], alpha=0.4)
        make(MATERIAL, ["results/jar/observations/tile-000.h5"], alpha=0.4)
    Path(linear("l0440-c0200")).rename("kept.h5")  # an intermediate file that was not kept
    assert verify(capsys, "results/jar/linear")[0] == 0
    Path("a.dng").unlink()
    status, said = verify(capsys, "results/jar/linear")
    assert status == 1 and f"{table}: found a result of a.dng, which is gone" in said


def test_an_intermediate_file_that_no_result_was_made_from_yet_is_not_left_over(project, capsys):
    make(linear("l0450-c0200"), ["jar.csv"], alpha=0.4)
    assert verify(capsys) == (0, "every link holds (6 results)\n")
    halve(linear("l0450-c0200"))
    assert verify(capsys)[0] == 1


def test_pictures_and_files_that_nobody_reads_must_have_a_record_too(project, capsys):
    beside("results/scene/front.png").unlink()
    status, said = verify(capsys)
    assert status == 1 and "front.png: found no hash of its content" in said
    (project / "results/scene/frames").mkdir()
    (project / "results/scene/frames/0001.png").write_bytes(b"frame")
    assert main(["--accept", "results/scene/front.png"]) == 0
    assert verify(capsys)[0] == 0


def test_a_changed_file_is_set_aside_and_taken_as_it_is_when_told_so(project, capsys):
    halve(MATERIAL)
    with pytest.raises(
        InputError, match=r"set aside as material\.h5\.damaged.*irodori verify --accept results/jar/mat"
    ):
        received(MATERIAL, {})
    os.replace(MATERIAL + ".damaged", MATERIAL)
    os.utime(MATERIAL, (1, 1))
    assert main(["--accept", MATERIAL]) == 0
    assert os.stat(MATERIAL).st_mtime > 1000, "what was made from it must be made again"
    assert received(MATERIAL, {}) and read_record(MATERIAL).inputs == hashes("results/jar/brdf.h5")
    with store.open_file(MATERIAL) as file:
        assert file.read("alpha")[0, 0] == 0.2
    status, said = verify(capsys)
    assert status == 1 and "front.png: found a result of results/jar/material.h5" in said
    assert main(["--accept", "results/scene/front.png"]) == 0
    # Taking a picture as it is says nothing about what it was made from.
    assert verify(capsys)[0] == 1


@pytest.mark.parametrize("attack", [dataset, swapped, no_hash, head_edited])
def test_an_accepted_file_is_read_and_told_of(project, capsys, attack):
    attack()
    (project / "results/scene/front.png").unlink()
    if attack is head_edited or attack is swapped:
        make("results/jar/brdf.h5", ["jar.csv"], alpha=0.4)
    assert main(["--accept", str(project / MATERIAL)]) == 0
    with store.open_file(MATERIAL) as file:
        assert np.isfinite(file.read("alpha")).all()
    if attack not in (head_edited,):
        assert received(MATERIAL, {})
        assert verify(capsys) == (0, f"{project / MATERIAL}: taken as it is\nevery link holds (4 results)\n")


def test_an_unchanged_result_stays_as_it_is_when_it_is_accepted(project, capsys):
    for path in (MATERIAL, "results/scene/front.png"):
        before = Path(path).read_bytes(), os.stat(path).st_mtime_ns, read_record(path)
        assert verify(capsys, "--accept", path) == (0, f"{path}: unchanged, nothing to accept\n")
        assert (Path(path).read_bytes(), os.stat(path).st_mtime_ns, read_record(path)) == before


@pytest.mark.parametrize("name", ["jar.csv", "results/notes.json", "results/logs/jar.log", "results/jar/one.dng"])
def test_a_file_that_is_no_result_is_not_accepted(project, capsys, name):
    path = Path(name)
    path.parent.mkdir(exist_ok=True)
    path.write_text("file,exposure_s\n")
    os.utime(path, (1, 1))
    accepted = "a result, which has a record"
    assert verify(capsys, "--accept", name) == (1, f"{name}: found no record of a result; accepted: {accepted}.\n")
    assert not beside(path).exists() and os.stat(path).st_mtime == 1


def test_what_is_not_there_cannot_be_accepted_nor_verified(project, capsys):
    assert verify(capsys, "--accept", "results/none.h5") == (
        1,
        "results/none.h5: found no such file; accepted: a result.\n",
    )
    assert verify(capsys, "nowhere") == (1, "nowhere: found no such folder; accepted: a folder of results.\n")


def test_a_copied_project_is_verified_where_it_lies(project, tmp_path_factory, capsys, monkeypatch):
    copy = tmp_path_factory.mktemp("copy")
    shutil.copytree(project, copy, dirs_exist_ok=True)
    monkeypatch.chdir("/")
    assert verify(capsys, str(copy / "results")) == (0, "every link holds (5 results)\n")
    assert verify(capsys, str(copy / "results/scene"))[0] == 0


@pytest.mark.parametrize("bit", [0, 7, 70, 9 * 8, 74 * 8 + 3, 4000 * 8, -1])
def test_one_flipped_bit_anywhere_refuses_a_file(project, bit):
    content = bytearray(Path(MATERIAL).read_bytes())
    content[bit // 8] ^= 1 << bit % 8
    Path(MATERIAL).write_bytes(content)
    with pytest.raises(InputError, match=r"material\.h5"):
        verified(MATERIAL)


def test_records_beside_files_are_in_the_form_of_sha256sum(project):
    record = beside("results/scene/front.png")
    done = subprocess.run(["sha256sum", "--check", record.name], cwd=record.parent, capture_output=True)
    assert done.returncode == 0


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"0" * 64 + b"  front.png\n", b"0" * 64 + b"  front.png\n# []"])
def test_a_damaged_record_vouches_for_nothing(project, content):
    beside("results/scene/front.png").write_bytes(content)
    with pytest.raises(InputError, match=r"front\.png"):
        verified("results/scene/front.png")


def test_a_file_of_a_thousand_inputs_carries_them_all(tmp_path):
    inputs = {f"results/jar/brdf/tile-{number:04d}.h5": f"{number:064d}" for number in range(1000)}
    with store.create(tmp_path / "m.h5", store.Provenance("compress", inputs=inputs)) as out:
        out.write("alpha", 1.0, units="1", dims="", quantity="x")
    assert verified(tmp_path / "m.h5").inputs == inputs
