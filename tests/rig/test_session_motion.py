"""A session and the rig that it moves: feed holds, and the time in which a rig settles."""

import pytest
from sessions import QuickCamera, assert_whole, definitions, hold

from irodori.captures import Pose, Shot
from irodori.rig.connect import open_rig
from irodori.rig.devices import DeviceError
from irodori.rig.journal import Journal
from irodori.rig.operator import AutoOperator
from irodori.rig.session import Session, take_stock


@pytest.fixture
def rig():
    with open_rig(definitions(motion=True)[2]) as opened:
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
    session = Session(camera, operator, journal, rig, take_stock(journal, planned))
    if somebody:
        session.run(planned, "test")
        assert len(asked) == 1 and asked[0].startswith("Clear the cause of the feed hold")
        assert_whole(tmp_path, planned)
        return
    with pytest.raises(DeviceError, match=r"nobody can be asked to clear .* operator: auto"):
        session.run(planned, "test")
    assert camera.taken == [planned[0].file] and rig.status().state == "idle"
    hold(tmp_path, planned, camera, rig)
    assert_whole(tmp_path, planned)
