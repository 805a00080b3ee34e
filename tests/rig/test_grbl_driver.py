"""The Grbl driver against a controller that is set up in some way of its own."""

import errno
import os
from dataclasses import replace

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st
from made import made
from motion_rigs import PATIENT_S, TIMEOUT_S, at_port, definition, start_simulator

from irodori.capture.rig.connect import grbl_settings, open_rig, true_position_deg
from irodori.capture.rig.devices import (
    AlarmError,
    Axis,
    CommandError,
    DeadlineError,
    LinkError,
    SettingError,
)
from irodori.capture.rig.drives import Drive, drives_of
from irodori.capture.rig.grbl.driver import GrblRig
from irodori.capture.rig.grbl.settings_check import (
    check_settings,
    disagreements,
    home_position,
    homing_s,
    switch_position,
    travel_of,
)
from irodori.capture.rig.serial_link import SerialLink
from irodori.config.definitions import load_one
from irodori.config.models import Rig, SimulatorOptions
from irodori.simulation.controllers.grbl_machine import DEFAULTS
from irodori.simulation.controllers.grbl_simulator import simulate
from irodori.simulation.controllers.peer_client import run_simulator

RIG = definition("grbl")
DRIVES = drives_of(made(Rig, RIG))
FITTING = {**DEFAULTS, **grbl_settings(DRIVES, homing=True)}


def test_settings_that_fit_are_accepted():
    check_settings(FITTING, "V", DRIVES, homing=True)


@pytest.mark.parametrize(
    ("number", "value", "words"),
    [
        (130, 140.0, r"camera_deg: limits 0 to 140 are X -141 to -1, but .* from -140 to 0 \(\$130\)"),
        (131, 100.0, "turn_deg: limits"),
        (110, 12000.0, r"camera_deg: speed_deg_per_s 400 is above .* 200 \(\$110=12000\)"),
        (121, 4000.0, r"turn_deg: acceleration_deg_per_s2 16000 is above .* 8000 \(\$121=4000\)"),
        (100, 5.0, "camera_deg: one step of the motor is 0.2 degrees"),
        (101, 0.0, "turn_deg: steps, rate or acceleration of Y are 0"),
        (10, 2, r"set \$10=3"),
        (13, 1, r"set \$13=0"),
        (20, 0, r"set \$20=1"),
        (22, 0, r"motion.homing is true, but .* set \$22=1"),
        (27, ..., r"lack \$27 \(homing switch pull-off"),
        (130, ..., r"lack \$130 \(X maximum travel"),
    ],
)
def test_settings_that_contradict_the_rig_s_file_are_refused(number, value, words):
    settings = {key: given for key, given in {**FITTING, number: value}.items() if given is not ...}
    with pytest.raises(SettingError, match=words):
        check_settings(settings, "V", DRIVES, homing=True)


@pytest.mark.parametrize("number", [10, 13, 20, 22, 23, 24, 25, 26, 27, 100, 101, 110, 111, 120, 121, 130, 131])
def test_a_controller_without_a_setting_that_is_needed_is_refused(number):
    with pytest.raises(SettingError, match=rf"lack \${number} "):
        check_settings({k: v for k, v in FITTING.items() if k != number}, "V", DRIVES, homing=True)


@pytest.mark.parametrize(("first", "word"), [(100, "step of the motor"), (110, "speed"), (120, "acceleration")])
def test_a_setting_is_refused_from_a_thousandth_beyond_what_the_axis_needs(first, word):
    drive = DRIVES["turn_deg"]
    needed = {
        100: 1.0 / (drive.axis.step_deg * drive.units_per_deg), 110: 60.0 * drive.speed, 120: drive.acceleration,
    }[first]  # fmt: skip
    check_settings({**FITTING, first + 1: needed * 0.9995}, "V", DRIVES, homing=True)
    with pytest.raises(SettingError, match=f"turn_deg: .*{word}"):
        check_settings({**FITTING, first + 1: needed * 0.998}, "V", DRIVES, homing=True)


@pytest.mark.parametrize("first", [100, 110, 120])
def test_a_setting_of_nothing_is_refused_by_name(first):
    with pytest.raises(SettingError, match="camera_deg: steps, rate or acceleration of X are 0"):
        check_settings({**FITTING, first: 0.0}, "V", DRIVES, homing=True)


def test_settings_that_hold_without_switches_are_told_from_those_with_them():
    free = {**FITTING, 20: 0, 22: 0}
    check_settings({**free, 130: 1.0}, "V", DRIVES, homing=False)  # nobody knows where the ends are
    with pytest.raises(SettingError, match=r"motion.homing is false, but \$22=1 locks it"):
        check_settings(FITTING, "V", DRIVES, homing=False)
    with pytest.raises(SettingError, match=r"motion.homing is true"):
        check_settings(free, "V", DRIVES, homing=True)


@pytest.mark.parametrize("channel", ["Q", "XY", "", "x"])
def test_an_axis_that_the_controller_does_not_have_is_refused(channel):
    drives = {**DRIVES, "camera_deg": replace(DRIVES["camera_deg"], channel=channel)}
    with pytest.raises(SettingError, match=r"camera_deg: no axis .* accepted: X, Y, Z, A, B, C"):
        check_settings(FITTING, "V", drives, homing=True)


def test_where_homing_ends_and_what_it_leaves_to_travel():
    camera, turn = DRIVES.values()
    settings = {23: 0, 27: 1.5, 130: 200.0, 131: 300.0}
    # Grbl counts downward from switches at the positive end, and upward into the travel from those of $23.
    assert home_position(settings, "V", camera) == home_position(settings, "V", turn) == -1.5
    assert home_position({**settings, 23: 2}, "V", camera) == -1.5
    assert home_position({**settings, 23: 2}, "V", turn) == -298.5
    assert travel_of({**settings, 23: 2}, "V", turn) == (-300.0, 0.0)
    # Z: a build that calls the place after homing 0, and counts away from the switch.
    assert home_position({**settings, 23: 2}, "VZ", turn) == 0.0
    assert travel_of(settings, "VZ", turn) == (-300.0, 0.0)
    assert travel_of({**settings, 23: 2}, "VZ", turn) == (0.0, 300.0)
    assert travel_of({**settings, 23: 2}, "VZ", camera) == (-200.0, 0.0)
    # Where an axis is known to stand after homing, its travel begins there.
    homes = {turn.channel: 7.0}
    assert home_position(settings, "V", turn, homes) == 7.0 and home_position(settings, "V", camera, homes) == -1.5
    assert travel_of(settings, "V", turn, homes) == (-293.0, 7.0)
    assert travel_of({**settings, 23: 2}, "V", turn, homes) == (7.0, 307.0)
    # The switch lies the pull-off beyond where homing ends.
    assert switch_position(settings, turn, -1.5) == 0.0
    assert switch_position({**settings, 23: 2}, turn, -298.5) == -300.0


@pytest.mark.parametrize(("low", "high"), [(-142.0, -1.0), (-141.0, 0.01)])
def test_a_reach_beyond_either_end_of_the_travel_is_refused(low, high):
    drive = DRIVES["camera_deg"]
    axis = replace(drive.axis, min_deg=-1.0 - high, max_deg=-1.0 - low)
    settings = {**FITTING, 130: 141.0}
    check_settings(settings, "V", DRIVES, homing=True)
    with pytest.raises(SettingError, match="camera_deg: limits"):
        check_settings(settings, "V", {**DRIVES, "camera_deg": replace(drive, axis=axis)}, homing=True)


def test_a_travel_that_is_too_short_is_made_as_long_as_the_reach_and_the_switch_stays_where_it_is():
    """Where the reach ends beyond the switch, no number in the controller helps: somebody has to move the switch."""
    short = {**FITTING, 130: 100.0}
    (found,) = disagreements(short, "V", DRIVES, True)
    assert (found.number, found.wanted) == (130, 141.0)
    check_settings({**short, found.number: found.wanted}, "V", DRIVES, homing=True)
    drive = DRIVES["camera_deg"]
    beyond = {**DRIVES, "camera_deg": replace(drive, axis=replace(drive.axis, min_deg=-2.0))}
    (found,) = disagreements(FITTING, "V", beyond, True)
    assert (found.number, found.wanted) == (130, None)


@pytest.mark.parametrize(("beyond", "fits"), [(0.0008, True), (0.0012, False)])
@pytest.mark.parametrize("end", [0, 1])
def test_a_reach_may_go_a_thousandth_of_a_unit_beyond_the_travel(end, beyond, fits):
    drive = DRIVES["camera_deg"]  # counts downward from -1 degree
    low, high = (-141.0 - beyond, -1.0) if end == 0 else (-141.0, beyond)
    drive = replace(drive, axis=replace(drive.axis, min_deg=-1.0 - high, max_deg=-1.0 - low))
    drives, settings = {**DRIVES, "camera_deg": drive}, {**FITTING, 27: 0.0, 130: 141.0}
    if fits:
        check_settings(settings, "V", drives, homing=True)
    else:
        with pytest.raises(SettingError, match="camera_deg: limits"):
            check_settings(settings, "V", drives, homing=True)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(("inside", "fits"), [(0.0, True), (0.0008, True), (0.01, False), (1.0, False)])
def test_a_reach_up_to_the_switch_is_refused_where_the_axis_pulls_off(turned, inside, fits):
    # 140 units of reach, a pull-off of one; turned, homing seeks the negative end.
    drive = DRIVES["camera_deg"]
    low = -141.0 - inside if turned else -141.0 + inside
    axis = replace(drive.axis, min_deg=-1.0 - (low + 140.0), max_deg=-1.0 - low)
    drives = {**DRIVES, "camera_deg": replace(drive, axis=axis)}
    settings = {**FITTING, 23: int(turned), 27: 1.0, 130: 142.0}
    if fits:
        check_settings(settings, "V", drives, homing=True)
    else:
        with pytest.raises(SettingError, match=rf"camera_deg: .*\$27=1.* shift zero_deg by {inside:g} degrees"):
            check_settings(settings, "V", drives, homing=True)


def test_all_disagreements_are_said_at_once_and_written_on_request():
    wrong = {10: 2, 13: 1, 20: 0, 110: 12000.0, 121: 4000.0}
    with simulate({**grbl_settings(DRIVES, True), **wrong}, time_scale=10.0) as simulator:
        there = made(Rig, at_port(RIG, simulator.port))
        before = simulator.true_position()
        with pytest.raises(SettingError) as refused, open_rig(there):
            pass
        for number in wrong:
            assert f"${number}" in str(refused.value)
        with open_rig(there, checked=False) as rig:
            found = rig.disagreements()
            assert {d.number for d in found} == set(wrong)
            rig.write_settings({d.number: d.wanted for d in found})
            assert rig.disagreements() == []
            with pytest.raises(AlarmError):
                rig.move({"camera_deg": 10.0})
        assert simulator.true_position() == before
        with open_rig(there) as rig:
            rig.home()
            rig.move({"camera_deg": 140.0, "turn_deg": 0.0})


def test_what_only_a_person_can_mend_has_no_value_to_be_written():
    settings = {**FITTING, 10: 2, 13: 1, 20: 0, 100: 5.0, 110: 12000.0}
    found = {d.number: d.wanted for d in disagreements(settings, "V", DRIVES, True)}
    assert found == {10: 3, 13: 0, 20: 1, 100: None, 110: 24000.0}


def test_homing_that_was_switched_off_is_switched_on_before_the_soft_limits():
    with simulate({**grbl_settings(DRIVES, True), 20: 0, 22: 0}) as simulator:
        with open_rig(made(Rig, at_port(RIG, simulator.port)), checked=False) as rig:
            rig.write_settings({d.number: d.wanted for d in rig.disagreements() if d.wanted is not None})
        with open_rig(made(Rig, at_port(RIG, simulator.port))) as rig:
            assert not rig.status().homed, "homing that is switched on now has not been done"


@pytest.mark.parametrize("name", ["gonio-grbl", "virtual"])
def test_a_shipped_rig_reaches_its_own_ends_with_hard_limits_on(name):
    rig = load_one("rigs", name).rigs[name]
    rig = replace(
        rig, motion=replace(rig.motion, port="simulator", settle_s=0.0, simulator=SimulatorOptions(time_scale=200.0))
    )
    with open_rig(rig) as opened:
        assert opened.settings()[21] == 1
        opened.home()
        for ends in ({"camera_deg": 140.0, "turn_deg": 359.5}, {"camera_deg": 0.0, "turn_deg": 0.0}):
            opened.move(ends)
            assert true_position_deg(opened) == pytest.approx(ends, abs=0.01)


def test_the_pull_off_ends_at_the_reach_and_is_a_unit_at_most():
    camera = DRIVES["camera_deg"]
    for zero, pull_off in ((-0.25, 0.25), (-1.0, 1.0), (-1.4, 1.0), (0.0, 1.0), (3.0, 1.0)):
        assert grbl_settings({"camera_deg": replace(camera, zero_deg=zero)}, True)[27] == pull_off


def test_the_time_for_homing_is_that_of_its_steps():
    camera = replace(DRIVES["camera_deg"], axis=replace(DRIVES["camera_deg"].axis, step_deg=1.0))
    settings = {24: 60.0, 25: 600.0, 26: 250.0, 27: 2.0, 120: 5.0, 121: 20.0, 130: 80.0, 131: 10.0, 132: 100.0}
    # Seeking at 10 units/s, 1.5 times the longest travel and the pull-off twice; five pull-offs at 1 unit/s; at each of
    # four ends 0.25 s of debounce and ramps of 10 / 5 s. Twice: Z is homed before X and Y.
    one = (150.0 + 4.0) / 10.0 + 10.0 / 1.0 + 4 * (0.25 + 2 * 2.0)
    assert homing_s(settings, {"camera_deg": camera, "turn_deg": DRIVES["turn_deg"]}) == pytest.approx(2 * one)


@pytest.mark.parametrize("homing", [True, False])
@given(
    units=st.floats(0.1, 50.0), turns=st.booleans(), step=st.floats(0.01, 2.0), beyond=st.floats(0.05, 30.0),
    speed=st.floats(1.0, 500.0), acceleration=st.floats(1.0, 5000.0),
)  # fmt: skip
def test_settings_made_for_drives_fit_them(homing, units, turns, step, beyond, speed, acceleration):
    axis = Axis("camera_deg", 0.0, 140.0, step, speed, acceleration)
    # Whichever way it counts, the reach lies below the switch.
    zero = 140.0 + beyond if turns else -beyond
    drives = {"camera_deg": Drive(axis, "X", units if turns else -units, zero), "turn_deg": DRIVES["turn_deg"]}
    settings = {**DEFAULTS, **grbl_settings(drives, homing)}
    check_settings(settings, "V", drives, homing)
    assert settings[20] == settings[22] == homing
    own = (24, 25, 27, *(first + axis for first in (100, 110, 120, 130) for axis in (0, 1)))
    assert all(round(settings[key], 3) == settings[key] for key in own)  # Grbl keeps three decimals
    # Rounded so that the drive keeps its own speed, acceleration and reach.
    pull_off = min(1.0, *(-drive.reach[1] for drive in drives.values()))
    for index, drive in enumerate(drives.values()):
        least = (60.0 * drive.speed, drive.acceleration, pull_off - drive.reach[0])
        assert all(settings[first + index] >= n - 1e-9 for first, n in zip((110, 120, 130), least, strict=True))
    if homing:
        for drive in drives.values():
            low, high = travel_of(settings, "V", drive)
            # After homing the axis stands within its travel, at the near end of its reach or beyond it.
            assert (
                low <= drive.reach[0] + 1e-3
                and drive.reach[1] <= home_position(settings, "V", drive) + 1e-3 <= high + 1e-3
            )
            assert settings[24] == pytest.approx(settings[25] / 4, abs=1e-3)
        # The fastest drive's speed is what the switches are sought with, and no axis that is not driven slows it.
        assert settings[25] == pytest.approx(60.0 * max(d.speed for d in drives.values()), abs=1e-3)
        # Grbl counts in steps: a tenth of the finest step of an axis, and of 0.1 degree where that is coarser.
        for number, drive in ((100, drives["camera_deg"]), (101, drives["turn_deg"])):
            finest = min(drive.axis.step_deg, 0.1) * abs(drive.units_per_deg)
            assert settings[number] == pytest.approx(max(100.0, 10.0 / finest), abs=1e-3)
        assert settings[27] == pytest.approx(min(1.0, *(-drive.reach[1] for drive in drives.values())), abs=1e-3)
        assert settings[122] == max(d.acceleration for d in drives.values()) and settings[132] == 10.0


def test_a_controller_that_contradicts_the_rig_s_file_is_refused_before_anything_moves():
    with simulate({**grbl_settings(DRIVES, True), 130: 100.0}) as simulator:
        before = simulator.true_position()
        with pytest.raises(SettingError, match=r"\$130"), open_rig(made(Rig, at_port(RIG, simulator.port))):
            pass
        assert simulator.true_position() == before
        SerialLink(simulator.port).close()  # the port is free again


def test_axes_slower_than_their_controller_move_at_their_own_speed():
    settings = grbl_settings(DRIVES, True)
    fast = {key: value * 4 if key in (110, 111) else value for key, value in settings.items()}
    with (
        simulate(fast, time_scale=10.0) as simulator,
        open_rig(made(Rig, at_port(RIG, simulator.port))) as rig,
    ):
        rig.home()
        rig.move({"camera_deg": 0.0, "turn_deg": 0.0})
        sent = []
        write = rig._talk.link.write
        rig._talk.link.write = lambda data: (sent.append(data), write(data))
        rig.move({"camera_deg": 100.0})
        assert b"G21G90G94G53G1X-101.000F24000.000\n" in sent
        rig.move({"camera_deg": 0.0, "turn_deg": 359.5})
        # Y goes 179.75 units at 400 units/s, X keeps step with it: along the line 205.7 units in the same time.
        feed = float(next(s for s in sent if b"Y" in s).split(b"F")[1])
        assert feed == pytest.approx((179.75**2 + 100.0**2) ** 0.5 / (179.75 / 400.0) * 60.0, rel=1e-4)


def test_a_rig_without_switches_counts_from_where_it_was_switched_on():
    rig = definition("grbl")
    rig["motion"]["homing"] = False
    for axis in rig["motion"]["axes"].values():
        axis["zero_deg"] = 0.0
    with start_simulator(made(Rig, rig)) as simulator, open_rig(made(Rig, at_port(rig, simulator.port))) as opened:
        opened.simulator = simulator
        assert opened.status().homed
        with pytest.raises(CommandError, match="no limit switches"):
            opened.home()
        opened.move({"camera_deg": 30.0, "turn_deg": 90.0})
        assert true_position_deg(opened) == pytest.approx({"camera_deg": 30.0, "turn_deg": 90.0}, abs=0.005)
        simulator.power()
        with pytest.raises(AlarmError, match="restarted"):
            opened.move({"camera_deg": 31.0})
        with pytest.raises(AlarmError, match="does not know where it stands"):
            opened.move({"camera_deg": 31.0})


def test_switches_that_do_not_repeat_shift_the_true_position_and_not_the_reported_one():
    rig = definition("grbl")
    rig["motion"]["simulator"]["homing_rms_units"] = 0.05
    errors = []
    with open_rig(made(Rig, rig)) as opened:
        for _ in range(5):
            opened.home()
            opened.move({"camera_deg": 10.0})
            assert opened.position()["camera_deg"] == pytest.approx(10.0, abs=0.005)
            errors.append(true_position_deg(opened)["camera_deg"] - 10.0)
    assert 0.005 < max(map(abs, errors)) < 0.3 and len(set(errors)) == 5


def test_only_a_simulated_rig_knows_where_it_truly_stands():
    with start_simulator(made(Rig, RIG)) as simulator, open_rig(made(Rig, at_port(RIG, simulator.port))) as rig:
        assert rig.simulator is None
        with pytest.raises(ValueError, match="only a simulated rig"):
            true_position_deg(rig)


def test_something_else_on_the_port_is_not_taken_for_grbl():
    with start_simulator(made(Rig, definition("ascii"))) as simulator:
        there = at_port(definition("grbl", timeout_s=TIMEOUT_S), simulator.port)
        with pytest.raises((DeadlineError, LinkError)), open_rig(made(Rig, there)):
            pass


def test_ports_that_cannot_be_opened_are_named(tmp_path):
    (tmp_path / "notes").write_text("")
    for name, words in (("ttyUSB7", "no such port"), ("notes", "not a serial port"), ("", "")):
        with pytest.raises(LinkError, match=f"{tmp_path / name}: .*{words}"):
            SerialLink(str(tmp_path / name))


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.EBUSY, "in use by another program"), (errno.EWOULDBLOCK, "in use by another program"),
        (errno.EACCES, "no permission"), (errno.EIO, "hung up"), (errno.ENODEV, "no device"),
        (errno.ENOTTY, "not a serial"), (errno.EPERM, "Operation not permitted"),
    ],
)  # fmt: skip
def test_why_a_port_cannot_be_opened_is_said_in_words(number, words, monkeypatch):
    def refused(*_, **__):
        raise serial.SerialException(number, os.strerror(number))

    monkeypatch.setattr(serial, "Serial", refused)
    with pytest.raises(LinkError, match=f"^/dev/ttyUSB0: .*{words}"):
        SerialLink("/dev/ttyUSB0")


def test_a_line_without_an_end_and_bytes_that_are_no_text():
    with run_simulator("irodori.simulation.controllers.grbl_simulator", []) as simulator:
        link = SerialLink(simulator.port)
        link.discard_input()
        link.write(b"$G\n")
        simulator.fault("garble")
        link.write(b"$$\n")
        lines = [link.read_line(PATIENT_S) for _ in range(20)]
        assert all(line.isascii() for line in lines)
        link.discard_input()
        with pytest.raises(DeadlineError, match=simulator.port):
            link.read_line(0.05)
        simulator.fault("hangup")
        with pytest.raises(LinkError, match=f"{simulator.port}: the line is lost"):
            link.read_line(PATIENT_S)
        with pytest.raises(LinkError):
            link.write(b"?")
        with pytest.raises(LinkError):
            link.discard_input()
        link.close()
        link.close()
        with pytest.raises(LinkError):
            link.read_line(0.1)


@pytest.mark.parametrize("call", ["discard_input", "write", "read_line"])
def test_an_exception_of_a_signal_handler_is_not_taken_for_a_lost_line(monkeypatch, call):
    """It may come while pyserial computes, and the program that asked for it must meet it as it was raised."""

    class Interrupted(Exception):
        pass

    def interrupt(*_):
        raise Interrupted

    with run_simulator("irodori.simulation.controllers.grbl_simulator", []) as simulator:
        link = SerialLink(simulator.port)
        try:
            inner = {"discard_input": "reset_input_buffer", "write": "write", "read_line": "read"}[call]
            monkeypatch.setattr(link._serial, inner, interrupt)
            with pytest.raises(Interrupted):
                getattr(link, call)(*{"write": (b"?",), "read_line": (0.1,)}.get(call, ()))
        finally:
            link.close()


def test_the_driver_s_constructor_leaves_the_line_to_its_owner():
    with simulate({**grbl_settings(DRIVES, True), 22: 0, 20: 0}) as simulator:
        link = SerialLink(simulator.port)
        with pytest.raises(SettingError):
            GrblRig(link, DRIVES, timeout_s=PATIENT_S)
        link.write(b"?")
        link.close()


def test_a_rig_without_motion_has_nothing_to_open():
    assert drives_of(made(Rig, {k: v for k, v in RIG.items() if k != "motion"})) == {}
    with (
        pytest.raises(SettingError, match="no block motion"),
        open_rig(made(Rig, {k: v for k, v in RIG.items() if k != "motion"})),
    ):
        pass
