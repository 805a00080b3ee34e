"""A session and the rig that it moves: feed holds, and the time in which a rig settles."""

import time
from types import SimpleNamespace

import pytest
from made import made
from sessions import QuickCamera, assert_whole, definitions, hold

from irodori.capture import session
from irodori.capture.journal import Journal
from irodori.capture.operator import AutoOperator
from irodori.capture.rig.connect import open_rig
from irodori.capture.rig.devices import DeviceError
from irodori.capture.session import Session, take_stock
from irodori.config.capture_table import Pose, Shot
from irodori.config.models import Rig


@pytest.fixture
def rig():
    with open_rig(made(Rig, definitions(motion=True)[2])) as opened:
        opened.home()
        yield opened


@pytest.mark.parametrize("somebody", [True, False])
def test_a_feed_hold_in_a_session_is_the_person_s_to_end(tmp_path, rig, somebody):
    asked = []

    class Person(AutoOperator):
        def confirm(self, request):
            asked.append(request)

    planned = [Shot(f"{angle}.dng", "object", Pose(45.0, angle), "out", 0.02) for angle in (10.0, 130.0)]
    rig.move({"camera_deg": 10.0, "turn_deg": 0.0})
    rig.simulator.fault("move 0.5 hold")
    journal, camera = Journal(tmp_path / "captures.csv"), QuickCamera()
    operator = (Person if somebody else AutoOperator)(dict)
    held = Session(camera, operator, journal, rig, take_stock(journal, planned))
    if somebody:
        held.run(planned, "test")
        assert len(asked) == 1 and asked[0].startswith("Clear the cause of the feed hold")
        assert_whole(tmp_path, planned)
        return
    with pytest.raises(DeviceError, match=r"nobody can be asked to clear .* operator: auto"):
        held.run(planned, "test")
    assert camera.taken == [planned[0].file] and rig.status().state == "idle"
    hold(tmp_path, planned, camera, rig)
    assert_whole(tmp_path, planned)


def test_what_the_camera_will_not_take_is_said_before_anything_moves_or_anybody_is_asked(tmp_path, rig):
    class Dialled(QuickCamera):
        def prepare(self, shots):
            assert [shot.file for shot in shots] == ["a.dng"], "what is there already is not asked for"
            raise DeviceError("turn the mode dial to M")

    class Nobody(AutoOperator):
        def ask(self, step):
            pytest.fail("nobody is asked")

    planned = [Shot("a.dng", "object", Pose(45.0, 100.0), "out", 0.02)]
    rig.simulator.power()
    before = rig.simulator.true_position()
    with pytest.raises(DeviceError, match="mode dial"):
        Session(Dialled(), Nobody(dict), Journal(tmp_path / "captures.csv"), rig).run(planned, "test")
    assert rig.simulator.true_position() == before


@pytest.fixture
def slept(monkeypatch):
    """Return the times that sessions sleep, s, as they grow; they sleep them."""
    times = []

    def sleep(seconds):
        times.append(seconds)
        time.sleep(seconds)

    monkeypatch.setattr(session, "time", SimpleNamespace(sleep=sleep, monotonic=time.monotonic))
    return times


def test_the_shutter_waits_until_the_rig_has_settled_after_a_move_and_only_then(tmp_path, rig, slept):
    arrived, opened, move = [], [], rig.move

    def noted(targets):
        move(targets)
        arrived.append(time.monotonic())

    class Eye(QuickCamera):
        def capture(self, shot, path):
            opened.append(time.monotonic())
            super().capture(shot, path)

    rig.move = noted
    places = [Pose(45.0, 10.0), Pose(45.0, 20.0)]
    planned = [Shot(f"{p.name}-{s}.dng", "object", p, "out", s) for p in places for s in (0.02, 0.05)]
    journal = Journal(tmp_path / "captures.csv")
    settled = Session(Eye(), AutoOperator(dict), journal, rig, take_stock(journal, planned), settle_s=0.3)
    settled.run(planned, "test")
    for number in (0, 2):
        assert slept[number] > 0.0 and opened[number] - arrived[number] >= 0.3
    assert slept[1] == slept[3] == 0.0, "the second exposure of a place follows its first"


def test_a_step_by_hand_counts_as_settling(tmp_path, rig, slept):
    class Slow(AutoOperator):
        def ask(self, step):
            time.sleep(0.3)

    planned = [Shot("a.dng", "object", Pose(45.0, 10.0), "out", 0.02)]
    Session(QuickCamera(), Slow(dict), Journal(tmp_path / "captures.csv"), rig, settle_s=0.25).run(planned, "test")
    assert slept == [0.0]
