"""Interruption of a moving rig from outside: Ctrl-C, an exception, the death of the program."""

import os
import signal
import subprocess
import sys
import threading
import time

import patience
import pytest
from made import made
from motion_rigs import at_port, definition, start_simulator, wait_until_still

from irodori.capture.rig.connect import open_rig
from irodori.capture.rig.devices import AlarmError, DeviceError
from irodori.capture.rig.drives import drives_of
from irodori.config.models import Rig

#: The rig of the program: it is slow, so that a signal meets it in mid-move. Its whole reach takes 10 s.
TIME_SCALE = 0.04
#: A rig that has gone so far is under way, controller units.
UNDER_WAY = 2.0
PROGRAM = """
import sys
sys.path.insert(0, "tests/rig")
from motion_rigs import at_port, definition
from irodori.capture.rig.connect import open_rig
from irodori.config.models import Rig
rig = definition(sys.argv[1])
rig["motion"]["timeout_s"] = 60.0  # deadlines are of the axes' own speed, and the simulated ones are slowed down
with open_rig(Rig.of(at_port(rig, sys.argv[2]))) as rig:
    rig._homed = True  # the ascii rig forgets that it was homed; homing again would take too long here
    print("ready", flush=True)
    rig.move({"camera_deg": float(sys.argv[3])})
"""


@pytest.fixture(params=["grbl", "ascii"])
def peer(request):
    """Return (protocol, simulator)."""
    with start_simulator(made(Rig, definition(request.param))) as simulator:
        yield request.param, simulator


class Interrupted(Exception):
    pass


def wait_until_under_way(simulator, before: dict[str, float]) -> None:
    """Wait until an axis has left the place where it stood."""
    patience.until(lambda: any(abs(at - before[name]) > UNDER_WAY for name, at in simulator.true_position().items()))


def test_an_exception_from_a_signal_handler_stops_the_rig(peer):
    protocol, simulator = peer
    rig = at_port(definition(protocol), simulator.port)

    def interrupt(*_):
        raise Interrupted

    def interrupt_under_way():
        wait_until_under_way(simulator, stood)
        signal.pthread_kill(threading.main_thread().ident, signal.SIGALRM)

    before, interrupter = signal.signal(signal.SIGALRM, interrupt), threading.Thread(target=interrupt_under_way)
    try:
        with open_rig(made(Rig, rig)) as opened:
            opened.home()
            opened.move({"camera_deg": 0.0})
            simulator.pace(TIME_SCALE)
            stood = simulator.true_position()
            interrupter.start()
            with pytest.raises(Interrupted):
                opened.move({"camera_deg": 140.0})
            seen = simulator.snapshot()
            assert not seen["moving"]
            here = opened.status()
            assert here.state == "idle" and 1.0 < here.position_deg["camera_deg"] < 139.0
            time.sleep(0.1)
            assert simulator.true_position() == seen["position"]
            simulator.pace(10.0)
            opened.move({"camera_deg": 5.0})
            interrupter.join()
    finally:
        signal.signal(signal.SIGALRM, before)


@pytest.mark.stability(stage="capture", case="interrupt in mid-move")
@pytest.mark.parametrize("kill", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_signal_in_mid_move(peer, kill):
    """SIGINT stops the rig. A program that is killed cannot: the rig ends its move, whose target was checked.

    SIGTERM ends a Python program without its cleaning up, unless it asks for that.
    """
    protocol, simulator = peer
    rig = at_port(definition(protocol), simulator.port)
    with open_rig(made(Rig, rig)) as opened:
        opened.home()
        opened.move({"camera_deg": 0.0})
    simulator.pace(TIME_SCALE)
    stood = simulator.true_position()
    command = [sys.executable, "-c", PROGRAM, protocol, simulator.port, "140"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        assert program.stdout.readline() == "ready\n", program.stderr.read()
        wait_until_under_way(simulator, stood)
        os.kill(program.pid, kill)
        patience.wait(program)
        seen = simulator.snapshot()
        if kill == signal.SIGINT:
            assert "KeyboardInterrupt" in program.stderr.read()
            assert not seen["moving"] and seen["state"].lower() == "idle"
    simulator.pace(10.0)
    still = wait_until_still(simulator)
    camera = drives_of(made(Rig, rig))["camera_deg"]
    angle = camera.to_deg(still["position"][camera.channel])
    if kill == signal.SIGINT:
        assert still["position"] == seen["position"] and 1.0 < angle < 139.0
    else:
        assert angle == pytest.approx(140.0, abs=0.005)
    with open_rig(made(Rig, rig)) as opened:
        opened.home()
        opened.move({"camera_deg": 45.0})


def test_a_rig_that_still_moves_is_brought_to_rest_when_it_is_opened():
    rig = definition("grbl")
    with start_simulator(made(Rig, rig)) as simulator:
        there = at_port(rig, simulator.port)
        with open_rig(made(Rig, there)) as opened:
            opened.home()
            opened.move({"camera_deg": 0.0})
        simulator.pace(TIME_SCALE)
        with open_rig(made(Rig, there)) as opened:
            opened._talk.link.write(b"G21G90G53G0X-140.000\n")
            patience.until(lambda: simulator.snapshot()["moving"])
            opened.close()
        with open_rig(made(Rig, there)) as opened:
            status = opened.status()
            assert status.state == "idle" and status.homed, "a hold with a ramp costs no position"
            assert not simulator.snapshot()["moving"]
            assert -1.0 < status.position_deg["camera_deg"] < 139.0


def test_what_happens_behind_the_driver_s_back_is_noticed():
    rig = definition("grbl")
    with start_simulator(made(Rig, rig)) as simulator, open_rig(made(Rig, at_port(rig, simulator.port))) as opened:
        opened.home()
        simulator.power()
        status = opened.status()
        assert not status.homed and "restarted" in status.message
        with pytest.raises(AlarmError, match="home"):
            opened.move({"camera_deg": 3.0})
        simulator.fault("alarm 1")
        time.sleep(0.05)
        with pytest.raises(DeviceError):
            opened.move({"camera_deg": 3.0})
        opened.home()
        assert opened.status().homed
