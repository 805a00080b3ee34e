"""A session killed at any moment, and continued: nothing is lost or doubled, and every byte is that of a quiet one."""

import csv
import math
import random
from pathlib import Path

import pytest
from killable import Killable
from made import made
from sessions import assert_whole, capture, contents, target

from irodori.capture.shot_list import object_shots
from irodori.config.capture_table import read_captures
from irodori.config.models import Camera, Object
from irodori.config.parts import PhotographedObject


@pytest.fixture(scope="module")
def sessions():
    """Return what holds sessions to be killed: one process has imported everything for all of them."""
    with Killable(slow_s=0.01) as started:
        yield started


def assert_same(found: dict[str, bytes], expected: dict[str, bytes], when: str) -> None:
    """Fail unless two sessions left the same.

    Of a photograph that was stored but not yet listed nobody knows where the axes were read: its cells are empty.
    """
    found, expected = dict(found), dict(expected)
    # The simulated controller ends with the session: of photographs before nobody knows whether steps were lost.
    marked = found.pop("captures-unchecked.txt", b"").decode().split("\n")
    assert found.keys() >= {line.split(" ", 2)[2] for line in marked if line}, when
    rows, wanted = (list(csv.DictReader(one.pop("captures.csv").decode().splitlines())) for one in (found, expected))
    assert found == expected, when
    unread = [dict(row, **{key: "" for key in row if key.endswith("_read_deg")}) for row in wanted]
    assert all(row in pair for row, *pair in zip(rows, wanted, unread, strict=True)), when
    assert sum(row != right for row, right in zip(rows, wanted, strict=True)) <= 1, when


def kill_and_continue(tmp_path: Path, sessions: Killable, kills: int, seed: int) -> set[int]:
    """Kill sessions at random moments, let each end, compare it; return how many photographs stood at each kill."""
    for name in ("compiling", "whole", "again"):
        (tmp_path / name).mkdir()
        whole_s = sessions.run(tmp_path / name)
    expected = contents(tmp_path / "whole")
    definition, aim = target(tmp_path / "whole", sessions.motion)
    planned = aim.ordered(object_shots(made(Object | PhotographedObject, definition), made(Camera, aim.camera), ".dng"))
    assert_whole(tmp_path / "whole", planned)
    assert contents(tmp_path / "again") == expected
    rng, stood = random.Random(seed), set()
    for number in range(kills):
        folder = tmp_path / f"{number}"
        folder.mkdir()
        # One moment in each part of the run, so that they spread over the whole of it, from before the first photograph
        # to after the last.
        part, stand = math.modf((number + rng.random()) / kills * (len(planned) + 1))
        sessions.run(folder, part * whole_s / (len(planned) + 1), int(stand))
        stood.add(len(list(folder.glob("*.dng"))))
        capture(folder, sessions.motion)
        # Of the whole session, whose bytes these are, every photograph has been decoded.
        assert_same(contents(folder), expected, f"kill {number}")
        assert read_captures(folder / "captures.csv", folder) == planned, number
    return stood


@pytest.mark.heavy
@pytest.mark.stability(stage="capture", case="session killed at random moments")
def test_a_session_killed_at_twenty_random_moments_loses_nothing_and_doubles_nothing(tmp_path, sessions):
    sessions.motion = False
    stood = kill_and_continue(tmp_path, sessions, kills=20, seed=1)
    assert len(stood) > 4, "the kills fell between different photographs"


@pytest.mark.heavy
def test_a_session_of_a_moving_rig_killed_at_twenty_random_moments_loses_nothing_and_doubles_nothing(
    tmp_path, sessions
):
    sessions.motion = True
    stood = kill_and_continue(tmp_path, sessions, kills=20, seed=2)
    assert len(stood) > 4, "the kills fell between different photographs"


@pytest.mark.heavy
def test_one_session_killed_again_and_again_ends_the_same(tmp_path, sessions):
    """Each continuation is killed in its turn, before it has gone far."""
    rng, sessions.motion = random.Random(3), False
    for name in ("compiling", "whole", "killed"):
        (tmp_path / name).mkdir()
    sessions.run(tmp_path / "compiling")
    whole_s = sessions.run(tmp_path / "whole")
    for _ in range(8):
        sessions.run(tmp_path / "killed", rng.uniform(0.1, 0.4) * whole_s)
    sessions.run(tmp_path / "killed")
    assert contents(tmp_path / "killed") == contents(tmp_path / "whole")
