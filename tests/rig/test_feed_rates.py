"""The speed of Grbl's moves: that of the rig's file, whatever the board allows and another program has left behind."""

from dataclasses import replace

import pytest
from test_grbl_simulator import Desk
from virtual_time import Bench, bench_of, opened, rig_of

from irodori.capture.rig.connect import grbl_settings
from irodori.capture.rig.drives import drives_of
from irodori.capture.rig.grbl.driver import GrblRig
from irodori.capture.rig.grbl.protocol import FIRMWARES, GRBLHAL
from irodori.simulation.controllers.grbl_machine import GrblMachine

START, END = {"camera_deg": 10.0, "turn_deg": 20.0}, {"camera_deg": 130.0, "turn_deg": 200.0}
#: Polls and answers at both ends of a move, s.
SLACK_S = 0.15


def ten_times_as_fast(machine: GrblMachine) -> None:
    """Let the board allow ten times the rates of the rig's file."""
    rates = (110, 111, 112, 113)
    machine.settings |= {key: 10.0 * machine.settings[key] for key in rates if key in machine.settings}


def quickest_deg_per_s(bench: Bench, driver: GrblRig, move) -> dict[str, float]:
    """Return the largest speed of each axis during a move, between two looks at the clock."""
    seen, advance = dict.fromkeys(driver.drives, 0.0), bench.machine.advance
    order = [bench.machine.letters.index(drive.channel) for drive in driver.drives.values()]

    def watching(step: float) -> None:
        before = list(bench.machine.stage.position)
        advance(step)
        after = bench.machine.stage.position
        for (name, drive), axis in zip(driver.drives.items(), order, strict=True):
            if step > 0.0:
                seen[name] = max(seen[name], abs(after[axis] - before[axis]) / step / abs(drive.units_per_deg))

    bench.machine.advance = watching
    move()
    bench.machine.advance = advance
    return seen


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("left", ["G20 G91 G93 G0", "G21 G90 G94 G1 F1", "G20 G91 G94 G80"])
def test_what_a_start_up_line_has_left_changes_no_move(monkeypatch, firmware, left):
    """Inches, distances for places, inverse time, a feed of 1 a minute: all that a line depends on stands in it."""
    rig = rig_of("grbl")
    bench = bench_of(rig, monkeypatch, firmware=firmware)
    ten_times_as_fast(bench.machine)
    driver = opened(rig, bench)
    driver.home()
    driver.move(START)
    for byte in f"{left}\n".encode():
        bench.machine.receive(byte)
    bench.machine.advance(0.0)
    assert b"ok" in bytes(bench.machine.output)
    bench.discard_input()
    began = bench.now
    speeds = quickest_deg_per_s(bench, driver, lambda: driver.move(END))
    assert bench.now - began == pytest.approx(driver.travel_s(START, END), abs=SLACK_S)
    assert all(speeds[name] <= driver.axes[name].speed_deg_per_s * 1.001 for name in speeds)
    assert max(speeds[name] / driver.axes[name].speed_deg_per_s for name in speeds) > 0.99
    driver.jog("camera_deg", -60.0)
    assert driver.position() == pytest.approx({"camera_deg": 70.0, "turn_deg": 200.0}, abs=0.01)


@pytest.mark.parametrize("rotary", [0, 8])
@pytest.mark.parametrize("ends", [END, START | {"camera_deg": 130.0}, START | {"turn_deg": 200.0}], ids=str)
def test_a_rotary_axis_beside_a_straight_one_keeps_its_speed_on_grblhal(monkeypatch, rotary, ends):
    """By RS274 a feed belongs to the straight part of a move, where an axis is a rotary one by $376."""
    rig = rig_of("grbl")
    turn = replace(rig.motion.axes.turn_deg, channel="A")
    rig = replace(rig, motion=replace(rig.motion, axes=replace(rig.motion.axes, turn_deg=turn)))
    drives = drives_of(rig)
    bench = bench_of(rig, monkeypatch, firmware=GRBLHAL)
    bench.machine = GrblMachine(grbl_settings(drives, True) | {376: rotary}, letters="XYZA", firmware=GRBLHAL)
    ten_times_as_fast(bench.machine)
    driver = opened(rig, bench)
    driver.home()
    driver.move(START)
    began = bench.now
    speeds = quickest_deg_per_s(bench, driver, lambda: driver.move(ends))
    assert bench.now - began == pytest.approx(driver.travel_s(START, ends), abs=SLACK_S)
    assert all(speeds[name] <= driver.axes[name].speed_deg_per_s * 1.001 for name in speeds)
    assert driver.position() == pytest.approx(ends, abs=0.01)


def test_the_simulator_knows_inverse_time():
    desk = Desk()
    assert desk.type("G93G1X-51") == ["error:22"], "each line needs its own"
    # Half a minute to the power of -1: 50 mm in 30 s.
    assert desk.type("G93G1X-51F2", 15.0) == ["ok"]
    assert desk.x == pytest.approx(-26.0, abs=0.2)
    desk.press(b"", 16.0)
    assert desk.x == -51.0
    assert desk.type("G94G1X-50") == ["error:22"], "a feed by inverse time is none by the minute"
