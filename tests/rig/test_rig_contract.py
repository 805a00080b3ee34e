"""Contract of every rig driver, each with its simulated controller."""

import os
import re
import subprocess
import sys

import patience
import pytest
from made import made
from motion_rigs import at_port, definition, start_simulator

from irodori.capture.rig.connect import open_rig, true_position_deg
from irodori.capture.rig.devices import (
    AlarmError,
    Axis,
    CommandError,
    HeldError,
    LimitError,
    LinkError,
    RigDevice,
    RigStatus,
)
from irodori.config.models import Rig

PEERS = ("grbl", "ascii")
STATES = {"idle", "run", "hold", "home", "jog", "door", "check", "sleep", "alarm"}


@pytest.fixture(scope="module", params=PEERS)
def peer(request):
    """Return (definition at the simulator's port, simulator)."""
    rig = definition(request.param)
    with start_simulator(made(Rig, rig)) as simulator:
        yield at_port(rig, simulator.port), simulator


@pytest.fixture
def opened(peer):
    """Return a homed rig, its simulator in order."""
    rig, simulator = peer
    simulator.clear()
    simulator.power()
    with open_rig(made(Rig, rig)) as opened:
        opened.simulator = simulator
        opened.home()
        yield opened


def test_it_has_the_axes_of_its_file(opened):
    assert isinstance(opened, RigDevice)
    assert opened.axes["camera_deg"] == Axis("camera_deg", 0.0, 140.0, 0.1, 400.0, 8000.0)
    assert set(opened.axes) == {"camera_deg", "turn_deg"}


def test_it_moves_where_it_is_told_and_says_so(opened):
    for targets in ({"camera_deg": 30.0}, {"camera_deg": 12.3, "turn_deg": 180.5}, {"turn_deg": 0.0}, {}):
        before = opened.position()
        opened.move(targets)
        for seen in (opened.position(), true_position_deg(opened)):
            assert seen == pytest.approx({**before, **targets}, abs=0.005)
        assert opened.status().state == "idle"


def test_the_ends_of_the_reach_are_reached(opened):
    for targets in ({"camera_deg": 140.0, "turn_deg": 359.5}, {"camera_deg": 0.0, "turn_deg": 0.0}):
        opened.move(targets)
        assert true_position_deg(opened) == pytest.approx(targets, abs=0.005)


@pytest.mark.stability(stage="capture", case="target out of limits")
@pytest.mark.parametrize(
    "targets",
    [
        {"camera_deg": -0.1},
        {"camera_deg": 140.1},
        {"camera_deg": 10.0, "turn_deg": 400.0},
        {"camera_deg": float("nan")},
        {"camera_deg": float("inf")},
        {"light_deg": 45.0},
        {"camera": 10.0},
    ],
)
def test_a_target_out_of_reach_is_refused_before_anything_moves(opened, targets):
    before = true_position_deg(opened)
    with pytest.raises(LimitError, match="accepted: "):
        opened.move(targets)
    assert true_position_deg(opened) == before
    assert opened.status().homed


def test_a_jog_goes_on_from_where_the_axis_stands(opened):
    opened.move({"camera_deg": 20.0})
    opened.jog("camera_deg", 2.5)
    opened.jog("camera_deg", -0.5)
    assert true_position_deg(opened)["camera_deg"] == pytest.approx(22.0, abs=0.005)


@pytest.mark.parametrize(("name", "by_deg"), [("camera_deg", 130.0), ("camera_deg", -21.0), ("light_deg", 1.0)])
def test_a_jog_beyond_the_limits_is_refused_before_anything_moves(opened, name, by_deg):
    opened.move({"camera_deg": 20.0})
    before = true_position_deg(opened)
    with pytest.raises(LimitError):
        opened.jog(name, by_deg)
    assert true_position_deg(opened) == before


def test_its_status_is_one_of_the_states(opened):
    status = opened.status()
    assert isinstance(status, RigStatus)
    assert status.state in STATES and status.homed
    assert set(status.position_deg) == set(opened.axes)


def test_a_rig_that_was_not_homed_refuses_to_move(peer):
    rig, simulator = peer
    simulator.power()
    with open_rig(made(Rig, rig)) as opened:
        assert not opened.status().homed
        before = simulator.true_position()
        with pytest.raises(AlarmError, match="home"):
            opened.move({"camera_deg": 10.0})
        with pytest.raises(AlarmError, match="home"):
            opened.jog("camera_deg", 1.0)
        assert simulator.true_position() == before
        opened.home()
        opened.move({"camera_deg": 10.0})


def test_homing_puts_the_count_right_again(opened):
    opened.move({"camera_deg": 50.0})
    opened.simulator.power()
    with pytest.raises(AlarmError, match="home"):
        opened.move({"camera_deg": 60.0})
    assert not opened.status().homed
    opened.home()
    opened.move({"camera_deg": 60.0})
    assert true_position_deg(opened)["camera_deg"] == pytest.approx(60.0, abs=0.005)


def until_held(rig: RigDevice) -> None:
    """Wait until the rig says that it is held."""
    patience.until(lambda: rig.status().state == "hold", lambda: str(rig.status()))


# ---- a feed hold that somebody presses at the bench


def test_a_resume_ends_a_hold_and_leaves_the_rig_as_it_was(opened):
    opened.move({"camera_deg": 20.0})
    before = true_position_deg(opened)
    opened.simulator.fault("hold")
    until_held(opened)
    opened.resume()
    assert opened.status().state == "idle" and opened.status().homed
    assert true_position_deg(opened) == before
    opened.move({"camera_deg": 30.0})
    assert true_position_deg(opened)["camera_deg"] == pytest.approx(30.0, abs=0.005)


def test_a_resume_without_a_hold_is_refused(opened):
    opened.move({"camera_deg": 20.0})
    with pytest.raises(CommandError, match=r"not held but says idle"):
        opened.resume()
    opened.move({"camera_deg": 30.0})


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9])
def test_a_move_that_is_held_asks_and_goes_on(opened, part):
    """That it has its whole time again is shown on a clock of its own: `test_rig_waits`."""
    opened.move({"camera_deg": 0.0, "turn_deg": 0.0})
    asked = []

    def clear(request):
        seen = opened.simulator.snapshot()
        asked.append((request, true_position_deg(opened)["camera_deg"], seen["moving"]))

    opened.on_hold = clear
    opened.simulator.fault(f"move {part} hold")
    opened.move({"camera_deg": 140.0, "turn_deg": 30.0})
    ((request, held_deg, moving),) = asked
    assert request.startswith("Clear the cause")
    assert float(re.search(r"camera_deg ([\d.]+)", request)[1]) == pytest.approx(held_deg, abs=0.06)
    assert not moving and 0.5 < held_deg < 139.5
    assert true_position_deg(opened) == pytest.approx({"camera_deg": 140.0, "turn_deg": 30.0}, abs=0.005)
    assert opened.status().state == "idle" and opened.status().homed


def test_a_move_may_be_held_twice(opened):
    opened.move({"camera_deg": 0.0})
    asked = []

    def clear(request):
        asked.append(request)
        if len(asked) == 1:
            opened.simulator.fault("move 0.7 hold")

    opened.on_hold = clear
    opened.simulator.fault("move 0.2 hold")
    opened.move({"camera_deg": 140.0})
    assert len(asked) == 2
    assert true_position_deg(opened)["camera_deg"] == pytest.approx(140.0, abs=0.005)


def test_a_rig_that_is_held_before_a_move_asks_first(opened):
    opened.move({"camera_deg": 20.0})
    opened.simulator.fault("hold")
    until_held(opened)
    asked = []
    opened.on_hold = asked.append
    opened.move({"camera_deg": 30.0})
    assert len(asked) == 1 and "camera_deg 20" in asked[0]
    assert true_position_deg(opened)["camera_deg"] == pytest.approx(30.0, abs=0.005)


def test_a_hold_that_the_person_ends_at_the_controller_needs_no_second_command(opened):
    opened.move({"camera_deg": 0.0})
    opened.on_hold = lambda request: opened._send_resume()
    opened.simulator.fault("move 0.5 hold")
    opened.move({"camera_deg": 140.0})
    assert true_position_deg(opened)["camera_deg"] == pytest.approx(140.0, abs=0.005)


@pytest.mark.parametrize("asked", [False, True])
def test_a_held_move_that_nobody_lets_go_on_is_given_up_where_it_stands(opened, asked):
    class Stopped(Exception):
        pass

    def refuse(request):
        raise Stopped("no")

    opened.move({"camera_deg": 0.0})
    opened.on_hold = refuse if asked else None
    opened.simulator.fault("move 0.5 hold")
    with pytest.raises(Stopped if asked else HeldError, match="no" if asked else "held at camera_deg .* start again"):
        opened.move({"camera_deg": 140.0})
    stands = true_position_deg(opened)["camera_deg"]
    status = opened.status()
    assert status.state == "idle" and status.homed and 10.0 < stands < 139.0
    assert status.position_deg["camera_deg"] == pytest.approx(stands, abs=0.005)
    opened.move({"camera_deg": 5.0})
    assert true_position_deg(opened)["camera_deg"] == pytest.approx(5.0, abs=0.005)


def test_opening_a_held_rig_gives_up_its_move(peer, opened):
    """Why there is no command to resume from another process: the board forgets the move when its port is opened."""
    rig, simulator = peer
    opened.move({"camera_deg": 0.0})

    def cut(request):
        opened.close()
        raise LinkError("cut off")

    opened.on_hold = cut
    simulator.fault("move 0.5 hold")
    with pytest.raises(LinkError):
        opened.move({"camera_deg": 140.0})
    assert simulator.snapshot()["state"].lower() == "hold"
    held = simulator.true_position()
    with open_rig(made(Rig, rig)) as again:
        assert again.status().state == "idle"
        with pytest.raises(CommandError, match="not held"):
            again.resume()
    assert simulator.true_position() == held


# ---- the line


def test_stop_and_close_may_be_repeated_and_never_raise(peer):
    rig, _ = peer
    with open_rig(made(Rig, rig)) as opened:
        opened.stop()
        opened.stop()
        opened.close()
        opened.close()
        opened.stop()
        with pytest.raises(LinkError):
            opened.status()
    with open_rig(made(Rig, rig)) as opened:
        opened.status()


@pytest.mark.stability(stage="capture", case="port in use")
def test_a_port_in_use_is_refused_by_name_in_this_process_and_in_another(peer):
    rig, simulator = peer
    with open_rig(made(Rig, rig)):
        with pytest.raises(LinkError, match=f"{simulator.port}: in use"), open_rig(made(Rig, rig)):
            pass
        code = (
            "import sys\nfrom irodori.capture.rig.serial_link import SerialLink\n"
            "from irodori.capture.rig.devices import LinkError\n"
            "try:\n    SerialLink(sys.argv[1])\nexcept LinkError as error:\n    print(error)\n"
        )
        run = patience.run([sys.executable, "-c", code, simulator.port])
        assert run.returncode == 0, run.stderr
        assert f"{simulator.port}: in use" in run.stdout
    with open_rig(made(Rig, rig)):
        pass


def test_the_time_of_a_move_is_that_of_its_slowest_axis(opened):
    start, target = {"camera_deg": 0.0, "turn_deg": 0.0}, {"camera_deg": 140.0, "turn_deg": 30.0}
    assert opened.travel_s(start, target) == pytest.approx(140.0 / 400.0 + 0.05, abs=0.001)
    assert opened.travel_s(start, start) == 0.0


def test_a_simulator_ends_with_the_process_that_started_it(tmp_path):
    code = (
        "import time, sys\nsys.path.insert(0, 'tests/rig')\nfrom motion_rigs import *\n"
        "from irodori.config.models import Rig\n"
        "with start_simulator(Rig.of(definition('grbl'))) as s:\n"
        "    print(s.process.pid, flush=True)\n    time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        pid = int(parent.stdout.readline())
        os.kill(pid, 0)
        parent.kill()
        parent.wait()
        patience.until(lambda: not _alive(pid), lambda: "the simulator outlives its parent")


def _alive(pid: int) -> bool:
    """Return whether a process runs; one that nobody has waited for yet does not."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_a_described_controller_without_a_resume_says_whose_the_hold_is():
    rig = definition("ascii")
    del rig["motion"]["ascii"]["resume"]
    with (
        start_simulator(made(Rig, rig)) as simulator,
        open_rig(made(Rig, at_port(rig, simulator.port))) as opened,
    ):
        opened.home()
        with pytest.raises(CommandError, match=r"no motion\.ascii\.resume"):
            opened.resume()
        opened.on_hold = lambda request: pytest.fail("nobody is asked for what cannot be done")
        simulator.fault("move 0.5 hold")
        with pytest.raises(CommandError, match=r"no motion\.ascii\.resume"):
            opened.move({"camera_deg": 140.0})
        assert opened.status().state == "idle"
