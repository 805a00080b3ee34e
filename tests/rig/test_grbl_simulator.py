"""The simulated Grbl answers as the firmware's documentation says; its mechanics move as its settings say."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from irodori.simulation.controllers.grbl_machine import GrblMachine
from irodori.simulation.controllers.line_faults import KINDS, parse_fault
from irodori.simulation.controllers.trapezoidal_motion import Block, Stage

SETTINGS = {130: 100.0, 131: 100.0, 132: 100.0, 110: 600.0, 111: 600.0, 112: 600.0, 120: 50.0, 121: 50.0, 122: 50.0}


class Desk:
    """A machine without a line, and a person who types."""

    def __init__(self, unlock: bool = True, **settings):
        self.machine = GrblMachine({**SETTINGS, **{int(k[1:]): v for k, v in settings.items()}}, seed=3)
        self.say()
        if unlock:
            self.type("$H", 20.0)

    def say(self) -> list[str]:
        text = self.machine.output.decode()
        self.machine.output.clear()
        return [line for line in text.split("\r\n") if line]

    def type(self, line: str, seconds: float = 0.0) -> list[str]:
        return self.press(line.encode() + b"\n", seconds)

    def press(self, keys: bytes, seconds: float = 0.0) -> list[str]:
        for byte in keys:
            self.machine.receive(byte)
        self.machine.advance(0.0)
        while seconds > 0:
            self.machine.advance(min(seconds, 0.02))
            seconds -= 0.02
        return self.say()

    def report(self) -> dict[str, str]:
        (line,) = self.press(b"?")
        state, *fields = line[1:-1].split("|")
        return {"state": state, **dict(field.split(":") for field in fields)}

    @property
    def x(self) -> float:
        return float(self.report()["MPos"].split(",")[0])


def test_it_starts_locked_and_homing_unlocks_it():
    desk = Desk(unlock=False)
    assert desk.report()["state"] == "Alarm"
    assert desk.type("G0X-10") == ["error:9"]
    assert desk.type("$H") == []
    assert desk.press(b"?") == [], "homing answers nothing"
    said = desk.press(b"", 20.0)
    assert said[-1] == "ok" and said[0].startswith("<Idle")
    assert desk.report()["MPos"] == "-1.000,-1.000,-1.000"
    assert desk.machine.stage.position == pytest.approx([-1.0, -1.0, -1.0])


def test_unlocking_keeps_a_count_that_does_not_fit():
    desk = Desk(unlock=False)
    assert desk.type("$X") == ["[MSG:Caution: Unlocked]", "ok"]
    assert desk.report()["MPos"] == "0.000,0.000,0.000"
    assert desk.machine.stage.position[0] != 0.0


def test_a_move_takes_the_time_of_its_trapezoid():
    desk = Desk()
    assert desk.type("G90G0X-51") == ["ok"]
    # 50 mm at 10 mm/s and 50 mm/s²: 5 s and a ramp of 0.2 s.
    desk.press(b"", 5.1)
    assert desk.report()["state"] == "Run"
    desk.press(b"", 0.2)
    assert desk.report()["state"] == "Idle" and desk.x == -51.0


def test_a_feed_rate_is_kept_and_must_be_known():
    desk = Desk()
    assert desk.type("G1X-10") == ["error:22"]
    assert desk.type("G1X-11F60") == ["ok"]
    desk.press(b"", 5.0)
    assert desk.x == pytest.approx(-6.0, abs=0.05)


def test_soft_limits_raise_alarm_2_and_wait_for_a_reset():
    desk = Desk()
    assert desk.type("G0X-100.1") == ["ALARM:2", "[MSG:Reset to continue]"]
    assert desk.type("$X") == [] and desk.press(b"?", 5.0) == [], "it says nothing until it is reset"
    assert desk.press(b"\x18") == ["Grbl 1.1h ['$' for help]", "[MSG:'$H'|'$X' to unlock]"]
    assert desk.type("$X") == ["[MSG:Caution: Unlocked]", "ok"]
    assert desk.x == -1.0, "the position is kept"
    assert desk.type("$J=G90X1F100") == ["error:15"], "a jog out of the travel is only refused"


def test_a_hold_slows_down_and_a_resume_goes_on():
    desk = Desk()
    desk.type("G0X-51", 2.0)
    desk.press(b"!")
    assert desk.report()["state"] == "Hold:1"
    desk.press(b"", 0.5)
    assert desk.report()["state"] == "Hold:0"
    held = desk.x
    assert desk.type("G0X-2", 1.0) == [], "nothing is read in a hold"
    assert desk.x == held
    desk.press(b"~", 20.0)
    assert desk.report()["state"] == "Idle" and desk.x == -2.0


def test_a_reset_in_a_hold_keeps_the_position_and_one_in_motion_does_not():
    desk = Desk()
    desk.type("G0X-51", 2.0)
    desk.press(b"!", 0.5)
    assert desk.press(b"\x18", 5.0) == ["Grbl 1.1h ['$' for help]"]
    assert desk.report()["state"] == "Idle"
    assert desk.x == pytest.approx(desk.machine.stage.position[0], abs=0.006)
    desk.type("G0X-80", 1.0)
    assert desk.press(b"\x18", 5.0)[0] == "ALARM:3"
    assert desk.report()["state"] == "Alarm"
    assert desk.x != pytest.approx(desk.machine.stage.position[0], abs=0.006)


def test_a_reset_while_homing_raises_alarm_6():
    desk = Desk(unlock=False)
    desk.type("$H", 0.5)
    assert desk.press(b"\x18")[0] == "ALARM:6"


def test_power_lost_in_mid_move_loses_the_count():
    desk = Desk()
    desk.type("G0X-51", 2.0)
    there = desk.machine.stage.position[0]
    desk.machine.power_up()
    assert desk.say()[0] == "Grbl 1.1h ['$' for help]"
    assert desk.x == 0.0 and desk.machine.stage.position[0] == there
    desk.press(b"", 10.0)
    assert desk.machine.stage.position[0] == there


def test_a_jog_is_cancelled_without_a_trace():
    desk = Desk()
    assert desk.type("$J=G90X-51F600") == ["ok"]
    assert desk.type("G0X-2") == ["error:9"]
    desk.press(b"", 2.0)
    assert desk.report()["state"] == "Jog"
    desk.press(b"\x85", 1.0)
    assert desk.report()["state"] == "Idle" and -40.0 < desk.x < -10.0
    assert desk.type("G1X-2") == ["error:22"], "a jog leaves no feed rate behind"


def test_a_limit_switch_raises_alarm_1():
    desk = Desk(unlock=False, _21=1)
    desk.type("$X")
    desk.machine.settings[20] = 0
    said = desk.type("G0X150", 60.0)
    assert "ALARM:1" in said
    # Seen at the end of a slice of 20 ms, in which the axis goes 0.2 mm.
    assert desk.machine.stage.position[0] == pytest.approx(0.0, abs=0.21)


def test_lines_wait_for_the_planner_and_bytes_beyond_the_buffer_are_lost():
    desk = Desk(_10=3)
    lines = "".join(f"G0X-{n}\n" for n in range(2, 60)).encode()
    said = desk.press(lines)
    assert said == ["ok"] * 15, "the planner holds 15 moves"
    assert desk.report()["Bf"] == "0,0"
    said = desk.press(b"", 60.0)
    assert len(said) < 58 - 15, "what came while the buffer was full never arrived"


def test_character_counting_loses_nothing():
    desk = Desk(_10=3)
    for n in range(2, 40):
        line = f"G0X-{n}\n".encode()
        while int(desk.report()["Bf"].split(",")[1]) < len(line):
            desk.press(b"", 0.1)
        desk.press(line)
    desk.press(b"", 60.0)
    assert desk.x == -39.0


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("", "ok"), ("   ", "ok"), ("g0 x-5 ; there", "ok"), ("X", "error:2"), ("5", "error:1"), ("G5", "error:20"),
        ("G0G1X-3F50", "error:21"), ("G0X-1X-2", "error:25"), ("T", "error:2"), ("Q1", "error:20"), ("F-1", "error:4"),
        ("$Q", "error:3"), ("$J", "error:3"), ("$J=X-3", "error:22"), ("$J=F50", "error:26"),
        ("$J=G0X-3F50", "error:16"),
        ("$130=x", "error:2"), ("$999=1", "error:3"), ("$130=-5", "error:4"), ("$0=1", "error:6"), ("$130=90.5", "ok"),
        ("G0" + "X" * 90, "error:11"), ("G4P0.5", None), ("M3S100", "ok"), ("M99", "error:20"), ("G4", "error:28"),
    ],
)  # fmt: skip
def test_lines_are_answered_with_the_published_codes(line, answer):
    desk = Desk()
    assert desk.type(line) == ([answer] if answer else [])


def test_homing_and_soft_limits_depend_on_each_other():
    desk = Desk()
    assert desk.type("$22=0") == ["ok"] and desk.machine.settings[20] == 0
    assert desk.type("$20=1") == ["error:10"]
    assert desk.type("$H") == ["error:5"]


def test_what_needs_rest_is_refused_in_motion():
    desk = Desk()
    desk.type("G0X-51", 1.0)
    assert desk.type("$$") == ["error:8"] and desk.type("$H") == ["error:8"] and desk.type("$130=5") == ["error:8"]
    assert desk.type("$J=X-3F50") == ["error:8"]


def test_a_dwell_is_answered_when_the_moves_before_it_are_done():
    desk = Desk()
    assert desk.press(b"G0X-11\nG4P0.5\n", 1.0) == ["ok"]
    assert desk.press(b"", 3.0) == ["ok"]


def test_settings_and_parameters_are_printed():
    desk = Desk()
    printed = desk.type("$$")
    assert printed[-1] == "ok" and "$130=100.000" in printed and "$22=1" in printed
    assert desk.type("$G")[0].startswith("[GC:G0 G54")
    assert desk.type("$I") == ["[VER:1.1h.20190830:]", "[OPT:V,15,128]", "ok"]
    assert desk.type("$#")[0] == "[G54:0.000,0.000,0.000]"


@settings(deadline=None, max_examples=60)
@given(st.binary(max_size=200), st.floats(0.0, 2.0))
def test_no_bytes_whatever_upset_it_or_take_it_out_of_its_travel(keys, seconds):
    desk = Desk()
    desk.press(keys, seconds)
    desk.press(b"\x18", 1.0)
    assert desk.report()["state"] in ("Idle", "Alarm")
    for low, high in zip(desk.machine.stage.low, desk.machine.stage.high, strict=True):
        assert low >= -100.0 - 1e-6 and high <= 1e-6


# ---- mechanics and faults


@settings(deadline=None)
@given(
    st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=4),
    st.floats(4.0, 50.0),
    st.floats(20.0, 200.0),
    st.floats(0.0, 3.0),
)
def test_a_stage_never_overshoots_and_stops_with_its_deceleration(ends, speed, acceleration, hold_at):
    stage = Stage([0.0])
    for end in ends:
        stage.push(Block([end], speed, acceleration))
    stage.advance(hold_at)
    assert min(0.0, *ends) - 1e-9 <= stage.low[0] and stage.high[0] <= max(0.0, *ends) + 1e-9
    before, was = stage.position[0], stage.speed
    assert was <= speed + 1e-9
    stage.holding = True
    stage.advance(1e3)
    assert not stage.moving
    # v² / 2a, and what a step of 1 ms adds.
    assert abs(stage.position[0] - before) <= was**2 / (2 * acceleration) + was * 2e-3 + 1e-9
    stage.holding = False
    stage.advance(1e4)
    assert stage.position[0] == pytest.approx(ends[-1], abs=1e-9)


def test_faults_are_read_and_nonsense_lists_what_is_accepted():
    fault = parse_fault("move 0.5 drop-output 3")
    assert (fault.kind, fault.value, fault.when, fault.at) == ("drop-output", 3.0, "move", 0.5)
    assert parse_fault("stall").value == float("inf") and parse_fault("line 2 garble").at == 2.0
    for text in ("", "explode", "move", "move x reset", "drop-output", "garble 3", "line -1 reset", "stall nan"):
        with pytest.raises(ValueError, match=r"faults: |takes|not a number"):
            parse_fault(text)
    assert set(KINDS) == {
        "drop-output",
        "drop-input",
        "drop-report",
        "garble",
        "stall",
        "hangup",
        "reset",
        "alarm",
        "hold",
        "slip",
    }
