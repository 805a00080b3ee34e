"""The lines of Grbl 1.1: what they say, and that no line whatever does more than raise a device's error."""

import math
import re
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from irodori.capture.rig import deadline
from irodori.capture.rig.devices import (
    AlarmError,
    CommandError,
    DeadlineError,
    DeviceError,
    GarbledError,
    Link,
    LinkError,
)
from irodori.capture.rig.drives import along, straight_s
from irodori.capture.rig.grbl.codes import ALARMS, ERRORS, alarm_text, error_text
from irodori.capture.rig.grbl.conversation import Conversation
from irodori.capture.rig.grbl.protocol import (
    STATES,
    Alarm,
    Banner,
    Error,
    Feedback,
    Ok,
    Report,
    Setting,
    Startup,
    TextSetting,
    jog_line,
    motion_line,
    parse_line,
)
from irodori.simulation.controllers.grbl_gcode import GcodeError, Modes, parse_block

# ---- examples of the interface's documentation


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("ok", Ok()),
        ("error:9", Error(9)),
        ("ALARM:1", Alarm(1)),
        ("$100=250.000", Setting(100, 250.0)),
        ("$10=255", Setting(10, 255.0)),
        ("$0=10 (step pulse, usec)", Setting(0, 10.0)),
        ("[MSG:'$H'|'$X' to unlock]", Feedback("MSG", "'$H'|'$X' to unlock")),
        ("[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0.0 S0]", Feedback("GC", "G0 G54 G17 G21 G90 G94 M5 M9 T0 F0.0 S0")),
        ("[G54:4.000,0.000,0.000]", Feedback("G54", "4.000,0.000,0.000")),
        ("[VER:1.1h.20190825:]", Feedback("VER", "1.1h.20190825:")),
        ("[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]",
         Feedback("HLP", "$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x")),
        ("Grbl 1.1h ['$' for help]", Banner("1.1h")),
        ("Grbl 1.1f ['$' for help]", Banner("1.1f")),
        ("GrblHAL 1.1f ['$' or '$HELP' for help]", Banner("1.1f", "grblHAL")),
        ("Grbl 3.7 [FluidNC v3.7.8 (wifi) '$' for help]", Banner("3.7", "FluidNC")),
        ("[NVS STORAGE:*FLASH]", Feedback("NVS STORAGE", "*FLASH")),
        ("[NEWOPT:ENUMS,RT+,HOME]", Feedback("NEWOPT", "ENUMS,RT+,HOME")),
        ("[MSG:INFO: ALARM: Abort Cycle]", Feedback("MSG", "INFO: ALARM: Abort Cycle")),
        ("$302=192.168.5.1", TextSetting("302", "192.168.5.1")),
        ("$/axes/x/homing/mpos_mm=-1.000", TextSetting("/axes/x/homing/mpos_mm", "-1.000")),
        ("<Alarm:1|MPos:0.000,0.000,0.000|FS:0,0|H:0|FW:grblHAL>", Report("Alarm", 1, (0.0, 0.0, 0.0), homed=False)),
        ("<Idle|MPos:0.000,0.000,0.000|FS:0,0|H:1,7>", Report("Idle", machine=(0.0, 0.0, 0.0), homed=True)),
        ("<Run:2|MPos:0.000,0.000,0.000>", Report("Run", 2, (0.0, 0.0, 0.0))),
        ("<Tool|MPos:0.000,0.000,0.000>", Report("Tool", machine=(0.0, 0.0, 0.0))),
        ("$N0=G54", Startup("$N0=G54")),
        (">G54G20:ok", Startup(">G54G20:ok")),
        ("<Idle|MPos:0.000,0.000,0.000|FS:0.0,0>", Report("Idle", machine=(0.0, 0.0, 0.0))),
        ("<Run|MPos:23.036,1.620,0.000|FS:500,0>", Report("Run", machine=(23.036, 1.62, 0.0))),
        ("<Hold:1|MPos:-5.000,0.000,0.000|Bf:15,128|F:500>",
         Report("Hold", 1, (-5.0, 0.0, 0.0))),
        ("<Door:0|WPos:-2.500,0.000,11.000|FS:0,0|WCO:1.500,0.000,-11.000>",
         Report("Door", 0)),
        ("<Alarm|MPos:0.000,0.000,0.000|FS:0,0|Pn:XYZPDHRS|Ov:100,50,200|A:SFM>",
         Report("Alarm", machine=(0.0, 0.0, 0.0), pins="XYZPDHRS")),
        ("<Jog|MPos:-1.0000,-2.0000,-3.0000|Ln:99999|FS:0,0>",
         Report("Jog", machine=(-1.0, -2.0, -3.0))),
    ],
)  # fmt: skip
def test_published_lines_are_understood(line, message):
    assert parse_line(line) == message


@pytest.mark.parametrize(
    "line",
    [
        "",
        "k",
        "OK",
        "ok?",
        "error:",
        "error:x",
        "ALARM:",
        "ALARM:1234",
        "$=1",
        "$100=",
        "$100=2,5",
        "$27=x",
        "<>",
        "<Idle>",
        "<Idle|MPos:0.000,0.000>x",
        "Idle|MPos:0.000,0.000,0.000>",
        "<Idle|MPos:0.000,0.000,0.000",
        "<idle|MPos:0.000,0.000,0.000>",
        "<Hold:2|MPos:0.000,0.000,0.000>",
        "<Idle:0|MPos:0.000,0.000,0.000>",
        "<Run|MPos:1.00,0.000,0.000>",
        "<Run|MPos:nan,0.000,0.000>",
        "<Run|MPos:1.000,,0.000>",
        "<Run|MPos:1.000|MPos:2.000>",
        "<Run|FS:0,0>",
        "<Run|WPos:x>",
        "<Idle|MPos:0.0000,0.0000,0.0000",
        "<Idle|MPos:0.000,0.000,0.000|Pn:XY",
        "<|MPos:1.000>",
        "<Door:4|MPos:1.000>",
        "<Door:-1|MPos:1.000>",
        "<Hold:|MPos:1.000>",
        "<Run|MPos:1.000|junk>",
        "Grbl",
        "[MSG:no end",
    ],
)
def test_lines_that_grbl_does_not_send_are_garbled(line):
    with pytest.raises(GarbledError):
        parse_line(line)


@pytest.mark.parametrize(("state", "moving"), [("Run", True), ("Jog", True), ("Home", True), ("Hold:0", False),
                                               ("Hold:1", True), ("Door:0", False), ("Door:2", True), ("Door:1", False),
                                               ("Door:3", True), ("Hold", True), ("Idle", False),
                                               ("Alarm", False), ("Check", False), ("Sleep", False)])  # fmt: skip
def test_what_may_be_in_motion(state, moving):
    assert parse_line(f"<{state}|MPos:0.000,0.000,0.000>").moving is moving


def test_every_published_code_has_its_meaning_in_the_message():
    assert set(ERRORS) == {*range(1, 18), *range(20, 39)} and set(ALARMS) == set(range(1, 10))
    assert error_text(9) == "error:9 (G-code is locked out during an alarm or a jog)"
    assert alarm_text(1).startswith("ALARM:1 (a limit switch was hit")
    assert "does not publish" in error_text(99) and "does not publish" in alarm_text(42)


# ---- no line does harm

_PIECES = st.sampled_from(
    ["<", ">", "|", "Idle", "Run", "Hold:0", "MPos:", "WPos:", "WCO:", "0.000", "-1.500", ",", "FS:", "0,0", "Bf:",
     "Pn:", "Ov:", "ok", "error:", "ALARM:", "9", "99999999999", "$", "=", "[MSG:", "]", "\x00", "٣", "nan", "inf",
     "1e9", "-", ".", " ", "Grbl 1.1h ['$' for help]"]
)  # fmt: skip


@settings(deadline=None, max_examples=500)
@given(st.one_of(st.text(max_size=80), st.lists(_PIECES, max_size=14).map("".join)))
def test_any_line_is_a_message_or_garbled(line):
    try:
        message = parse_line(line)
    except GarbledError as error:
        assert len(str(error)) < 500
    else:
        if isinstance(message, Report):
            assert message.state in STATES and (message.machine or "WPos" in line)


class FuzzLink(Link):
    """Lines that were made up; then silence."""

    def __init__(self, lines):
        self.lines, self.sent = list(lines), []

    def write(self, data):
        self.sent.append(data)

    def read_line(self, timeout_s):
        if not self.lines:
            raise DeadlineError("silence")
        return self.lines.pop(0)

    def discard_input(self):
        self.lines.clear()

    def close(self):
        pass


_LINES = st.lists(
    st.one_of(
        st.lists(_PIECES, max_size=10).map("".join),
        st.sampled_from(["ok", "", "error:9", "ALARM:1", "<Idle|MPos:0.000,0.000,0.000|FS:0,0>", "[MSG:x]"]),
    ),
    max_size=12,
)


@settings(deadline=None, max_examples=300)
@given(_LINES)
def test_any_answers_end_a_question_with_an_answer_or_an_error(lines):
    for question in (
        lambda talk: talk.ask_report(),
        lambda talk: talk.command("$$"),
        lambda talk: talk.soft_reset(),
    ):
        talk = Conversation(FuzzLink(lines), 0.5)
        try:
            question(talk)
        except DeviceError as error:
            assert str(error)


def answers(*lines, timeout_s=0.5) -> Conversation:
    """Return a conversation with a controller that says some lines and then nothing."""
    return Conversation(FuzzLink(lines), timeout_s)


REPORT = "<Idle|MPos:0.000,0.000,0.000|FS:0,0>"


def test_a_report_is_what_answers_a_question_whatever_comes_before_it():
    talk = answers("", "ok", "[MSG:Caution: Unlocked]", "Grbl 1.1h ['$' for help]", REPORT)
    assert talk.ask_report() == Report("Idle", machine=(0.0, 0.0, 0.0))
    assert talk.message == "Caution: Unlocked" and talk.restarted
    talk = answers("[GC:G0]", REPORT)
    assert talk.ask_report() and talk.message == "" and not talk.restarted and talk.alarm is None


def test_an_alarm_ends_a_question_at_once_and_every_question_until_a_reset():
    talk = answers("[MSG:x]", "ALARM:2", "[MSG:Reset to continue]", "Grbl 1.1h ['$' for help]", REPORT)
    for _ in range(2):
        with pytest.raises(AlarmError, match=r"ALARM:2 \(the target is beyond .*home it"):
            talk.ask_report()
    assert talk.link.sent == [b"?"], "it is not asked again: it says nothing until it is reset"
    talk.soft_reset()
    assert talk.alarm == 2 and not talk.locked


@pytest.mark.parametrize("lost", [[None], ["<Idle|MP"], ["Grbl 1.1h ['$' for help]"], [None, "<Idle|MP"]])
def test_a_report_that_is_lost_is_asked_for_again_and_the_newest_counts(lost):
    class Losing(FuzzLink):
        def read_line(self, timeout_s):
            line = super().read_line(timeout_s)
            if line is None:
                raise DeadlineError("silence")
            return line

    late = "<Run|MPos:1.000,0.000,0.000|FS:0,0>"
    talk = Conversation(Losing([*lost, late, REPORT]), 0.5)
    assert talk.ask_report() == Report("Idle", machine=(0.0, 0.0, 0.0))
    assert talk.link.sent == [b"?"] * (1 + len(lost))


def test_a_refusal_that_nobody_waits_for_is_no_report():
    with pytest.raises(CommandError, match="refused a line out of turn: error:20 "):
        answers("error:20", REPORT).ask_report()


def test_what_is_said_before_the_ok_is_the_answer():
    talk = answers("$100=250.000", "[MSG:x]", "ok", "$101=1.0", "ok")
    assert talk.command("$$") == [Setting(100, 250.0), Feedback("MSG", "x")]
    assert talk.command("$$") == [Setting(101, 1.0)]


@pytest.mark.parametrize(
    ("line", "kind", "words"),
    [
        ("error:22", CommandError, "refused 'G1X1': error:22 "),
        ("ALARM:1", AlarmError, "stopped during 'G1X1': ALARM:1 .*home it"),
        ("Grbl 1.1h ['$' for help]", AlarmError, "restarted on its own"),
        ("nonsense", GarbledError, "'nonsense'"),
    ],
)
def test_an_answer_that_is_no_ok_names_the_line(line, kind, words):
    with pytest.raises(kind, match=words):
        answers(line).command("G1X1")


def test_a_controller_that_talks_and_never_answers_is_left_in_time(monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(deadline, "time", SimpleNamespace(monotonic=lambda: now_s[0]))

    class Talking(FuzzLink):
        def read_line(self, timeout_s):
            now_s[0] += 0.01
            return self.lines[0]

    for lines, question, words in (
        (["[MSG:x]"], lambda talk: talk.command("$H"), r"no answer to '\$H' within 0.1 s"),
        (["[MSG:x]"], lambda talk: talk.command("$H", 0.05), "within 0.05 s"),
        (["ok"], lambda talk: talk.ask_report(), "no status report within 0.1 s"),
        (["ok"], lambda talk: talk.ask_report(0.05), "within 0.05 s"),
        ([""], lambda talk: talk.command("$H"), "nothing but empty lines for 0.1 s"),
        (["ok"], lambda talk: talk.soft_reset(), "did not come back from a reset in 0.1 s"),
    ):
        begun = now_s[0]
        with pytest.raises(DeadlineError, match=words):
            question(Conversation(Talking(lines), 0.1))
        assert now_s[0] - begun < 0.15


def test_the_longest_line_that_the_controller_takes_is_sent_and_no_longer_one():
    talk = answers("ok")
    talk.command("X" * 79)
    assert talk.link.sent == [b"X" * 79 + b"\n"]
    with pytest.raises(CommandError, match="longer than the 79 bytes"):
        talk.command("X" * 80)


def test_a_reset_waits_for_the_banner_and_forgets_what_came_before():
    banner = "Grbl 1.1h ['$' for help]"
    talk = answers("[MSG:old]", "garbage", "ok", banner, "[MSG:'$H'|'$X' to unlock]", banner, "more garbage")
    talk.message = "older"
    talk.soft_reset()
    # What is said after the banner counts; a second banner answers a reset that was sent twice.
    assert talk.message == "'$H'|'$X' to unlock" and not talk.restarted
    assert talk.link.sent == [b"\x18"] and not talk.link.lines
    with pytest.raises(DeadlineError):
        talk.soft_reset()
    assert talk.link.sent == [b"\x18"] * 3 and talk.message == ""


def test_a_start_that_was_noticed_before_is_not_forgotten_by_waiting():
    talk = answers("Grbl 1.1h ['$' for help]", REPORT)
    talk.ask_report()
    talk.settle()
    assert talk.restarted
    talk = answers("Grbl 1.1h ['$' for help]")
    talk.settle()
    assert not talk.restarted


# ---- what is sent


@given(st.dictionaries(st.sampled_from("XYZ"), st.floats(-9999.0, 9999.0), min_size=1), st.floats(0.01, 1e5))
def test_a_motion_line_says_to_a_grbl_parser_what_it_means(targets, feed):
    line = motion_line(targets, feed)
    assert len(line) < 80 and re.fullmatch(r"[A-Z0-9.-]+", line)
    move = parse_block(line, Modes(units=20, distance=91, coordinates=55), "XYZ")
    assert move.targets == pytest.approx(targets, abs=5.1e-4) and not move.relative
    assert move.feed == pytest.approx(feed, abs=5.1e-4)
    jog = parse_block(jog_line(targets, feed)[3:], Modes(units=20, distance=91), "XYZ", jog=True)
    assert jog.targets == pytest.approx(targets, abs=5.1e-4) and not jog.relative


@settings(deadline=None, max_examples=300)
@given(st.text("GXYZFSNP0123456789.-M$=J()%", max_size=40), st.booleans())
def test_the_simulator_s_parser_refuses_with_a_published_code(line, jog):
    try:
        parse_block(line, Modes(), "XYZ", jog)
    except GcodeError as error:
        assert error.code in ERRORS


@given(st.lists(st.floats(-500, 500), min_size=2, max_size=2), st.floats(0.1, 100), st.floats(0.1, 100))
def test_axes_of_a_straight_move_keep_to_their_own_speeds(move, first, second):
    speed, acceleration = along(move, [first, second], [10.0, 20.0])
    length = math.hypot(*move)
    if length == 0.0:
        assert straight_s(move, [first, second], [10.0, 20.0]) == 0.0
        return
    shares = [abs(distance) / length for distance in move]
    for share, limit, most in zip(shares, (first, second), (10.0, 20.0), strict=True):
        assert share * speed <= limit * (1 + 1e-9) and share * acceleration <= most * (1 + 1e-9)


def test_a_straight_move_is_as_fast_as_its_axes_allow():
    # A triangle of 3, 4 and 5: of the speed along it the axes have 3/5 and 4/5.
    assert along([3.0, -4.0], [3.0, 8.0], [30.0, 12.0]) == pytest.approx((5.0, 15.0))
    assert along([0.0, 7.0], [1.0, 8.0], [1.0, 12.0]) == (8.0, 12.0)
    assert along([0.0, 0.0], [1.0, 8.0], [1.0, 12.0]) == (math.inf, math.inf)


def test_times_of_straight_moves():
    # Along a triangle of 3, 4 and 5, 30 units at 5 units/s and 15 units/s².
    assert straight_s([18.0, -24.0], [3.0, 8.0], [30.0, 12.0]) == pytest.approx(6.0 + 1.0 / 3.0)
    # 100 units at 10 units/s and 5 units/s²: a ramp of 2 s at either end, half of it lost each.
    assert straight_s([100.0], [10.0], [5.0]) == pytest.approx(12.0)
    # Too short to reach the speed: a triangle of twice sqrt(d / a).
    assert straight_s([5.0], [10.0], [5.0]) == pytest.approx(2.0)


def test_a_garbled_line_is_quoted_up_to_60_letters():
    for line, shown in (("x" * 60, "'" + "x" * 60 + "'"), ("x" * 61, "'" + "x" * 57 + "...'")):
        with pytest.raises(GarbledError, match=re.escape(f"sent {shown}, which")):
            parse_line(line)


def test_a_garbled_line_is_a_matter_of_the_line():
    assert issubclass(GarbledError, LinkError)
