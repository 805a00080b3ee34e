"""The first look at a set of RAW files: hashes, sizes, and settings against the table."""

import dataclasses
import hashlib

import numpy as np
import pytest
from dng_files import write_any_dng
from raw_studio import SIZE, Studio, dng

from irodori import raw
from irodori.captures import ROLES, Pose, Shot, read_captures, write_captures
from irodori.errors import InputError


def test_check_captures_notes_the_hash_of_every_file(tmp_path):
    studio = Studio(tmp_path, seed=18)
    studio.references()
    table, output = studio.table(), tmp_path / "checked.csv"
    raw.check_captures(table, tmp_path, output, ROLES)
    assert read_captures(output, tmp_path) == read_captures(table, tmp_path)
    lines = output.read_text().splitlines()
    assert lines[0].split(",")[-1] == "sha256"
    for line in lines[1:]:
        file, *_, digest = line.split(",")
        assert digest == hashlib.sha256((tmp_path / file).read_bytes()).hexdigest()


@pytest.mark.parametrize("fault", ["exposure", "size", "truncated", "missing"])
def test_check_captures_refuses(tmp_path, fault):
    studio = Studio(tmp_path, seed=19)
    studio.references()
    culprit = studio.shots[-1].file
    if fault == "exposure":
        studio.shots[-1] = dataclasses.replace(studio.shots[-1], exposure_s=studio.shots[-1].exposure_s * 1.2)
    elif fault == "size":
        dng(tmp_path / culprit, np.full((64, 64), 700, np.uint16), exposure_s=0.05)
    elif fault == "truncated":
        content = (tmp_path / culprit).read_bytes()
        (tmp_path / culprit).write_bytes(content[: len(content) // 2])
    else:
        (tmp_path / culprit).unlink()
    table, output = studio.table(), tmp_path / "checked.csv"
    with pytest.raises(InputError, match=culprit):
        raw.check_captures(table, tmp_path, output, ROLES)
    assert not output.exists()


def test_check_captures_holds_files_to_the_stated_size(tmp_path):
    studio = Studio(tmp_path, seed=25)
    studio.references()
    table = studio.table()
    raw.check_captures(table, tmp_path, tmp_path / "a.csv", ROLES, (SIZE[1], SIZE[0]))
    with pytest.raises(InputError, match="9000 x 6000"):
        raw.check_captures(table, tmp_path, tmp_path / "b.csv", ROLES, (9000, 6000))


def test_check_captures_keeps_the_shots_of_its_own_set(tmp_path):
    studio = Studio(tmp_path, seed=26)
    studio.references()
    studio.shoot("object", np.full((SIZE[0] // 2, SIZE[1] // 2, 6), 0.3))
    raw.check_captures(studio.table(), tmp_path, tmp_path / "object.csv", ["object"])
    assert [shot.role for shot in read_captures(tmp_path / "object.csv")] == ["object"]
