"""Capture tables damaged in every way: read, or refused with file and line; and no table is left behind half-made."""

import numpy as np
import pytest
from damage import cut, flip, places, shares
from depth import examples
from hypothesis import given, settings
from raw_studio import dng, random_mosaic

from irodori.config.capture_table import Pose, Shot, read_captures, write_captures
from irodori.core.errors import InputError
from irodori.ingest.first_look import check_captures


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """A folder with a table of three photographs and their files."""
    folder = tmp_path_factory.mktemp("session")
    shots = [
        Shot("a.dng", "object", Pose(45.0, 20.0), "out", 0.02),
        Shot("b.dng", "object", Pose(45.0, 20.0), "in", 0.02),
        Shot("c.dng", "white", Pose(45.0, 0.0), "out", 0.02),
    ]
    for number, shot in enumerate(shots):
        dng(folder / shot.file, random_mosaic(np.random.default_rng(number)))
    write_captures(folder / "captures.csv", shots)
    return folder


def check(session, content: bytes) -> None:
    table, output = session / "damaged.csv", session / "checked.csv"
    table.write_bytes(content)
    output.unlink(missing_ok=True)
    try:
        check_captures(table, session, output, ["object", "white"])
    except InputError as error:
        assert error.found and error.accepted and "\n" not in str(error)
        assert error.file in (str(table), *(str(file) for file in session.glob("*.dng"))) or "damaged" in str(error)
        assert not output.exists()
    else:
        assert {shot.file for shot in read_captures(output)} <= {"a.dng", "b.dng", "c.dng"}
    # Whatever happened, nothing lies about.
    names = {"a.dng", "b.dng", "c.dng", "captures.csv", "damaged.csv", "checked.csv"}
    assert {file.name for file in session.iterdir()} <= names


@pytest.mark.stability(stage="fuzzing", case="captures.csv")
@given(damage=places)
@settings(deadline=None, max_examples=examples(60))
def test_a_table_with_flipped_bits_is_read_or_refused(session, damage):
    check(session, flip((session / "captures.csv").read_bytes(), damage))


@pytest.mark.stability(stage="fuzzing", case="captures.csv")
@given(share=shares)
@settings(deadline=None, max_examples=examples(30))
def test_a_table_cut_short_is_read_or_refused(session, share):
    check(session, cut((session / "captures.csv").read_bytes(), share))
