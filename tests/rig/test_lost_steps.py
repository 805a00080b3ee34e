"""Lost steps: what the limit switches say of the controller's count, and what a session makes of it."""

import json
import re
from contextlib import nullcontext

import pytest
from sessions import MADE, QuickCamera, assert_whole, target
from virtual_time import bench_of, opened, rig_of

from irodori.capture import stage
from irodori.capture.dialogue import Action, Dialogue
from irodori.capture.journal import Journal
from irodori.capture.operator import AutoOperator
from irodori.capture.rig.devices import AlarmError, CommandError, DeviceError, LinkError, SettingError
from irodori.capture.rig.grbl.protocol import FIRMWARES, FLUIDNC, GRBLHAL
from irodori.capture.rig.homings import Homings, Verdict
from irodori.capture.session import PositionError, Session, take_stock
from irodori.config.capture_table import Pose, Shot, read_captures

NAMES = ("camera_deg", "turn_deg")


@pytest.fixture
def record(tmp_path_factory):
    """Return the path of the record of a rig's homings."""
    return tmp_path_factory.mktemp("rig") / "homings.jsonl"


@pytest.fixture
def ready(monkeypatch, record):
    """Return a function that homes a rig on a simulated controller, away from its switches."""

    def start(firmware=FIRMWARES[0], **settings):
        rig = rig_of("grbl")
        bench = bench_of(rig, monkeypatch, firmware=firmware)
        bench.machine.settings |= {int(key.removeprefix("S")): value for key, value in settings.items()}
        driver = opened(rig, bench, homings=Homings(record))
        driver.home()
        driver.move({"camera_deg": 50.0, "turn_deg": 100.0})
        return driver, bench

    return start


@pytest.mark.parametrize("lost_deg", [(0.2, -1.2), (-1.0, 3.0)])
@pytest.mark.parametrize("settings", [{"S21": 1}, {"S21": 0}, {"S23": 1}], ids=["hard limits", "none", "other end"])
@pytest.mark.parametrize("firmware", FIRMWARES)
def test_what_the_motors_have_lost_is_measured_and_made_good(ready, firmware, settings, lost_deg):
    rig, bench = ready(firmware, **settings)
    for axis, (name, lost) in enumerate(zip(NAMES, lost_deg, strict=True)):
        bench.machine.slip(lost * rig.drives[name].units_per_deg, axis)
    found = rig.recount()
    # Without hard limits the switch is looked for in steps of a 16th of a quarter of the pull-off of one unit.
    within = {name: 0.02 / abs(rig.drives[name].units_per_deg) for name in NAMES}
    assert all(abs(found[name] - lost) < within[name] for name, lost in zip(NAMES, lost_deg, strict=True)), found
    rig.move({"camera_deg": 20.0})
    true = {name: rig.drives[name].to_deg(bench.machine.stage.position[axis]) for axis, name in enumerate(NAMES)}
    assert rig.position()["camera_deg"] == pytest.approx(20.0) == pytest.approx(true["camera_deg"], abs=2e-3)
    assert bench.machine.settings[20] == 1 and rig.status().homed


def test_a_switch_that_opens_elsewhere_than_it_closes_is_read_where_it_closes(ready):
    rig, bench = ready(S21=0)
    bench.machine.hysteresis = 0.4  # of a pull-off of one unit
    assert rig.recount() == pytest.approx({"camera_deg": 0.0, "turn_deg": 0.0}, abs=0.02)
    bench.machine.slip(0.3)
    assert rig.recount()["camera_deg"] == pytest.approx(0.3 / rig.drives["camera_deg"].units_per_deg, abs=0.02)


def test_more_than_is_looked_for_is_given_as_five_degrees(ready):
    rig, bench = ready()
    bench.machine.slip(12.0 * rig.drives["camera_deg"].units_per_deg)
    assert rig.recount() == {"camera_deg": 5.0, "turn_deg": 0.0}
    assert rig.status().homed


def test_a_line_that_is_lost_meanwhile_leaves_a_board_that_is_refused(ready):
    rig, bench = ready()
    write, gone = bench.write, []

    def lost(data):
        if gone or data.startswith(b"$J"):
            gone.append(data)
            raise LinkError("the line is lost (hung up)")
        write(data)

    bench.write = lost
    with pytest.raises(LinkError, match="hung up"):
        rig.recount()
    bench.write = write
    with pytest.raises(SettingError, match=r"soft limits are off in the controller: set \$20=1"):
        opened(rig_of("grbl"), bench)


@pytest.mark.parametrize("settings", [{"S40": 1}, {"S21": 3}, {"S22": 5}, {"S40": 1, "S21": 3, "S22": 7}], ids=str)
def test_what_grblhal_has_besides_does_not_keep_an_axis_from_its_switch(ready, settings):
    """Jogs that end at the travel, hard limits that forbid to unlock on a switch, homing required after them."""
    rig, bench = ready(GRBLHAL, **settings)
    bench.machine.slip(0.5 * rig.drives["camera_deg"].units_per_deg)
    before = dict(bench.machine.settings)
    found = rig.recount()
    assert found == {"camera_deg": pytest.approx(0.5, abs=0.01), "turn_deg": pytest.approx(0.0, abs=0.02)}
    assert bench.machine.settings == before and rig.status().homed


def test_fluidnc_has_its_limits_back_and_keeps_none_of_it(ready):
    rig, bench = ready(FLUIDNC)
    told = []

    def noted(data):
        told.append(data.decode("latin-1").strip())
        return data

    bench.on_the_way = noted
    rig.recount()
    changed = [line for line in told if line.startswith("$/axes") and "=" in line]
    assert changed[:2] == ["$/axes/x/motor0/hard_limits=false", "$/axes/y/motor0/hard_limits=false"]
    # Soft limits come back last: a board that has them has all.
    assert changed[-2:] == ["$/axes/x/soft_limits=true", "$/axes/y/soft_limits=true"]
    assert all(bench.machine._limit(number, axis) for number in (20, 21) for axis in (0, 1))
    bench.machine._told[20, 1] = False
    with pytest.raises(SettingError, match=r"soft limits are off: start the board anew, or set soft_limits: true"):
        opened(rig_of("grbl"), bench)
    bench.machine.power_up()
    opened(rig_of("grbl"), bench).home()


@pytest.mark.parametrize(
    ("firmware", "words"),
    [("Grbl", "before it moves again, $20=1"), (GRBLHAL, "before it moves again, $21=1, $20=1"),
     (FLUIDNC, "before it moves again, start the board anew")],
)  # fmt: skip
def test_a_board_that_is_left_without_its_limits_is_said_to_be_one(ready, caplog, firmware, words):
    rig, bench = ready(firmware)
    write, gone = bench.write, []

    def lost(data):
        if gone or data.startswith(b"$J"):
            gone.append(data)
            raise LinkError("the line is lost (hung up)")
        write(data)

    bench.write = lost
    with pytest.raises(LinkError, match="hung up"):
        rig.recount()
    assert f"the board was left without its limits: {words}" in caplog.text


def test_another_alarm_ends_it_with_the_soft_limits_on_again(ready):
    rig, bench = ready()
    bench.machine.settings[21] = rig._settings[21] = 0
    on_the_way = bench.on_the_way

    def pressed(data):
        if data.startswith(b"$J"):
            bench.machine.raise_alarm(3)
        return data

    bench.on_the_way = pressed
    with pytest.raises(AlarmError, match="ALARM:3"):
        rig.recount()
    bench.on_the_way = on_the_way
    assert bench.machine.settings[20] == 1 and not rig.status().homed


def test_a_byte_lost_from_the_soft_limits_leaves_no_other_setting_changed(ready):
    rig, bench = ready()
    before, lost = dict(bench.machine.settings), []

    def without_a_zero(data):
        if data == b"$20=1\n" and not lost:
            lost.append(data)
            return b"$2=1\n"
        return data

    bench.on_the_way = without_a_zero
    # No axis is said to be nothing below its count.
    assert str(rig.recount()) == "{'camera_deg': 0.0, 'turn_deg': 0.0}"
    assert lost and bench.machine.settings == before


def test_a_switch_that_chatters_while_the_axis_creeps_is_gone_over(ready):
    rig, bench = ready()
    jogs = []

    def chatter(data):
        jogs.append(data)
        if data == b"?" and len([line for line in jogs if line.startswith(b"$J")]) == 4 and b"chatter" not in jogs:
            jogs.append(b"chatter")
            bench.machine.raise_alarm(1)
        return data

    bench.on_the_way = chatter
    assert rig.recount() == {"camera_deg": 0.0, "turn_deg": 0.0}
    assert b"chatter" in jogs


def test_another_alarm_while_the_axis_creeps_is_no_chatter(ready):
    rig, bench = ready()
    jogs, raised = [], []

    def another(data):
        jogs.extend([data] * data.startswith(b"$J"))
        if data == b"?" and len(jogs) == 4 and not raised:
            raised.append(data)
            bench.machine.raise_alarm(3)
        return data

    bench.on_the_way = another
    with pytest.raises(AlarmError, match="ALARM:3"):
        rig.recount()
    assert len(jogs) == 4, "nothing moves after it"
    assert bench.machine.settings[20] == 1 and not rig.status().homed


@pytest.mark.parametrize(
    ("protocol", "firmware", "why"),
    [
        ("grbl", FLUIDNC, "FluidNC is homed each time it is opened: its sessions look for lost steps"),
        ("ascii", FIRMWARES[0], "does not tell where a limit switch closes"),
    ],
)
def test_a_controller_that_cannot_tell_is_said_to_be_one(monkeypatch, protocol, firmware, why):
    rig = rig_of(protocol)
    bench = bench_of(rig, monkeypatch, firmware=firmware)
    opened(rig, bench).home()
    before = list(bench.machine.stages[0].position)
    with pytest.raises(CommandError, match=why):
        opened(rig, bench).recount()
    assert bench.machine.stages[0].position == before


# ---- sessions

PLANNED = [Shot(f"{angle:g}.dng", "object", Pose(45.0, angle), "out", 0.02) for angle in (10.0, 40.0, 70.0)]


class Slipping(QuickCamera):
    """Its motor slips by half a degree after the photographs of these numbers."""

    def __init__(self, bench, after, by=1.0) -> None:
        super().__init__()
        self.bench, self.after, self.by, self.on_third = bench, after, by, lambda: None

    def capture(self, shot, path):
        super().capture(shot, path)
        if len(self.taken) in self.after:
            self.bench.machine.slip(self.by)
        if len(self.taken) == 3:
            self.on_third()


def sitting(folder, rig, camera, operator=None, dialogue=None):
    journal = Journal(folder / "captures.csv")
    tally = take_stock(journal, PLANNED)
    session = Session(camera, operator or AutoOperator(dict), journal, rig, tally, dialogue=dialogue)
    session.run(PLANNED, "test")
    return session


def test_a_sound_sitting_has_the_figure_and_keeps_its_photographs(tmp_path, ready):
    rig, bench = ready()
    session = sitting(tmp_path, rig, Slipping(bench, ()))
    assert [check.plain() for check in session.position] == [
        {"photographs": 3, "lost_deg": {"camera_deg": 0.0, "turn_deg": 0.0}}
    ]
    assert session.tally.taken == 3 and session.tally.doubted == 0


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_photographs_after_which_steps_are_missing_are_set_aside_and_taken_again(tmp_path, ready, caplog, firmware):
    rig, bench = ready(firmware)
    session = sitting(tmp_path, rig, Slipping(bench, (2,)))
    assert [check.lost_deg["camera_deg"] for check in session.position] == pytest.approx([-0.5, 0.0], abs=0.01)
    assert re.search(r"camera_deg stood -0\.(5|49\d) degrees off its count: steps were lost", caplog.text)
    assert all(shot.file in caplog.text for shot in PLANNED)
    assert_whole(tmp_path, PLANNED)
    assert len(list(tmp_path.glob("*-doubtful-*.dng"))) == 3 and session.tally.taken == 3


def test_a_long_sitting_puts_only_the_photographs_since_the_last_search_in_doubt(tmp_path, ready, monkeypatch):
    monkeypatch.setattr("irodori.capture.session._PHOTOGRAPHS_PER_SEARCH", 2)
    rig, bench = ready()
    session = sitting(tmp_path, rig, Slipping(bench, (3,)))
    assert [check.photographs for check in session.position] == [2, 1, 1]
    assert [round(check.lost_deg["camera_deg"], 1) for check in session.position] == [0.0, -0.5, 0.0]
    assert_whole(tmp_path, PLANNED)
    assert session.tally.taken == 3 and session.camera.taken == [shot.file for shot in (*PLANNED, PLANNED[2])]


def test_steps_lost_twice_stop_the_sitting_with_the_photographs_in_doubt(tmp_path, ready):
    rig, bench = ready()
    with pytest.raises(PositionError, match=r"camera_deg stood -0\.5 .*10\.dng, 40\.dng, 70\.dng; they are set aside"):
        sitting(tmp_path, rig, Slipping(bench, (2, 5)))
    assert not any((tmp_path / shot.file).exists() for shot in PLANNED)
    sitting(tmp_path, rig, QuickCamera())
    assert_whole(tmp_path, PLANNED)


def broken_off(folder, bench, rig, fault, slip=1.0) -> None:
    """A sitting that loses half a degree after its first photograph, and ends at its third."""
    camera = Slipping(bench, (1,), slip)
    camera.faults = [None, None, fault]
    with pytest.raises(type(fault)):
        sitting(folder, rig, camera)
    assert len(read_captures(folder / "captures.csv", folder)) == 2


def test_a_sitting_that_was_broken_off_is_held_against_the_switches_by_the_next(tmp_path, ready, caplog):
    rig, bench = ready()
    broken_off(tmp_path, bench, rig, DeviceError("its battery is empty"))
    session = sitting(tmp_path, rig, QuickCamera())
    assert session.position[0].lost_deg["camera_deg"] == pytest.approx(-0.5, abs=0.01)
    assert re.search(r"camera_deg stood -0\.\d+ degrees off its count.* are in doubt: 10\.dng, 40\.dng; ", caplog.text)
    assert session.tally.taken == 3 and session.tally.kept == 0
    assert_whole(tmp_path, PLANNED)
    assert len(list(tmp_path.glob("*-doubtful-*.dng"))) == 2


class Meeting(QuickCamera):
    """The axis meets its limit switch on its way from the second photograph to the third."""

    def __init__(self, bench, code=1) -> None:
        super().__init__()
        self.bench, self.code = bench, code

    def capture(self, shot, path):
        super().capture(shot, path)
        if len(self.taken) == 2:
            self.bench.on_the_way = self.meet

    def meet(self, data):
        if b"G1X" in data:
            self.bench.on_the_way = bytes
            self.bench.machine.raise_alarm(self.code)
        return data


class Person(AutoOperator):
    """A person who answers the question whether photographs are to be kept; an exception prevents the answer."""

    attended = True

    def __init__(self, answer) -> None:
        super().__init__(dict)
        self.answer, self.asked = answer, []

    def judge(self, doubt):
        self.asked.append(doubt)
        if isinstance(self.answer, BaseException):
            raise self.answer
        return self.answer


@pytest.mark.parametrize("reason", ["", "the arm was watched"])
def test_photographs_before_the_alarm_of_a_switch_are_in_doubt(tmp_path, ready, reason):
    """An axis that has lost steps meets its switch inside its soft limits."""
    rig, bench = ready()
    with pytest.raises(AlarmError, match="ALARM:1"):
        sitting(tmp_path, rig, Meeting(bench))
    person = Person(reason)
    session = sitting(tmp_path, rig, QuickCamera(), person)
    assert len(person.asked) == 1 and "ALARM:1" in person.asked[0] and "10.dng, 40.dng" in person.asked[0]
    kept = [shot.taken.accepted for shot in read_captures(tmp_path / "captures.csv", tmp_path)]
    assert kept == [reason, reason, ""] and session.tally.taken == (1 if reason else 3)
    assert len(list(tmp_path.glob("*-doubtful-*.dng"))) == (0 if reason else 2)
    assert_whole(tmp_path, PLANNED)
    assert session.journal.unchecked == {}


def test_an_alarm_for_another_reason_puts_no_photograph_in_doubt(tmp_path, ready):
    """An emergency stop (ALARM:3) says nothing about the angles before it; the count is lost all the same."""
    rig, bench = ready()
    with pytest.raises(AlarmError, match="ALARM:3"):
        sitting(tmp_path, rig, Meeting(bench, 3))
    session = sitting(tmp_path, rig, QuickCamera())
    assert session.tally.kept == 2 and list(session.journal.unchecked) == ["10.dng", "40.dng"]


@pytest.mark.parametrize("prevented", [KeyboardInterrupt(), DeviceError("nobody answered in time")])
def test_a_question_without_an_answer_is_asked_again(tmp_path, ready, prevented):
    """The search for lost steps homes the rig, so that a second one would find nothing."""
    rig, bench = ready()
    with pytest.raises(type(prevented)):
        sitting(tmp_path, rig, Slipping(bench, (2,)), Person(prevented))
    person = Person("")
    session = sitting(tmp_path, rig, QuickCamera(), person)
    assert len(person.asked) == 1 and re.search(r"-0\.(5|49\d) degrees.*10\.dng, 40\.dng, 70\.dng", person.asked[0])
    assert session.tally.taken == 3
    assert_whole(tmp_path, PLANNED)


@pytest.mark.parametrize("lost_deg", [0.0, 0.5])
@pytest.mark.parametrize("by", ["recount", "another object"])
def test_what_another_command_finds_out_about_the_rig_holds_for_the_photographs_before_it(
    tmp_path, ready, record, by, lost_deg
):
    rig, bench = ready()
    broken_off(tmp_path, bench, rig, DeviceError("its battery is empty"), 2.0 * lost_deg)
    again = opened(rig_of("grbl"), bench, homings=Homings(record))
    if by == "recount":
        again.recount()
    else:
        (tmp_path / "other").mkdir()
        for _ in range(2):
            sitting(tmp_path / "other", again, QuickCamera())
    again = opened(rig_of("grbl"), bench, homings=Homings(record))
    session = sitting(tmp_path, again, QuickCamera())
    assert session.tally.taken == (3 if lost_deg else 1) and session.journal.unchecked == {}
    assert len(list(tmp_path.glob("*-doubtful-*.dng"))) == (2 if lost_deg else 0)


@pytest.mark.parametrize("by", ["restart", "home"])
def test_photographs_before_the_count_was_lost_are_kept_and_named(tmp_path, ready, record, by):
    """An Arduino restarts when its port is opened: a session that is killed or stopped goes on nevertheless."""
    rig, bench = ready()
    broken_off(tmp_path, bench, rig, DeviceError("its battery is empty"))
    if by == "restart":
        bench.machine.power_up()
        rig = opened(rig_of("grbl"), bench, homings=Homings(record))
    else:
        rig.home()
    session = sitting(tmp_path, rig, QuickCamera())
    assert session.tally.taken == 1 and session.tally.kept == 2
    assert [check.photographs for check in session.position if check.photographs] == [1]
    assert list(session.journal.unchecked) == ["10.dng", "40.dng"]
    # A photograph that is taken again is checked.
    session.journal.drop(["10.dng"], "retaken")
    session = sitting(tmp_path, rig, QuickCamera())
    assert session.tally.taken == 1 and list(session.journal.unchecked) == ["40.dng"]


def test_half_a_line_of_a_power_cut_takes_no_other_with_it(tmp_path, record):
    journal, homings = Journal(tmp_path / "jar.csv"), Homings(record)
    homings.begin()
    first = homings.current
    with open(record, "a") as torn, open(tmp_path / "jar-unchecked.txt", "w") as cut:
        torn.write('{"homing": "20')
        cut.write("2026-11-30T10:00 a.d")
    homings.conclude(Verdict({"camera_deg": -0.5}))
    homings.begin()
    assert Homings(record).current == homings.current != first
    assert Homings(record).verdicts(first) == [Verdict({"camera_deg": -0.5})]
    assert Homings(record).verdicts(homings.current) == []
    journal.leave_unchecked("b c.dng", "0123", first)
    journal.shots["b c.dng"], journal.sha256["b c.dng"] = PLANNED[0], "0123"
    assert journal.unchecked == {"b c.dng": first}
    journal.sha256["b c.dng"] = "4567"
    assert journal.unchecked == {}, "the mark is that of another photograph of the name"


@pytest.mark.parametrize(
    "line",
    [
        '{"homing": "A", "note": 1}', '{"homing": "A", "lost_deg": {"camera_deg": NaN}}',
        '{"homing": "A", "lost_deg": []}', '{"homing": "A", "lost_deg": {}}', '["A"]',
    ],
)  # fmt: skip
def test_a_line_that_says_nothing_confirms_no_photograph(record, line):
    record.write_text(f'{{"homing": "A"}}\n{line}\n')
    assert Homings(record).current == "A" and Homings(record).verdicts("A") == []


@pytest.mark.parametrize("firmware", [FIRMWARES[0], GRBLHAL])
def test_photographs_taken_after_a_finding_do_not_share_it(tmp_path, ready, record, firmware):
    """The line of the next homing may be missing, after a full disk or a kill: the rig is homed again."""
    rig, bench = ready(firmware)
    rig.homings.conclude(Verdict({"camera_deg": 0.0, "turn_deg": 0.0}))
    session = sitting(tmp_path, rig, Slipping(bench, (2,)))
    assert len(list(tmp_path.glob("*-doubtful-*.dng"))) == 3 and session.tally.taken == 3


def test_another_record_of_the_same_board_confirms_nothing(tmp_path, ready, record):
    """Of two projects, or two files of one rig, each has a record; the board has but one count."""
    rig, bench = ready()
    broken_off(tmp_path, bench, rig, DeviceError("its battery is empty"))
    other = opened(rig_of("grbl"), bench, homings=Homings(record.with_name("other.jsonl")))
    (tmp_path / "other").mkdir()
    sitting(tmp_path / "other", other, QuickCamera())
    again = opened(rig_of("grbl"), bench, homings=Homings(record))
    session = sitting(tmp_path, again, QuickCamera())
    assert list(session.journal.unchecked) == ["10.dng", "40.dng"]


@pytest.mark.parametrize("settings", [{"S21": 1}, {"S21": 0}])
@pytest.mark.parametrize("jog", [1, 2, 3])
def test_a_search_that_is_interrupted_is_made_again(tmp_path, ready, settings, jog):
    rig, bench = ready(**settings)
    jogs = []

    def interrupted(data):
        jogs.extend([data] * data.startswith(b"$J"))
        if len(jogs) == jog and data.startswith(b"$J"):
            raise KeyboardInterrupt
        return data

    bench.on_the_way = interrupted
    with pytest.raises(KeyboardInterrupt):
        sitting(tmp_path, rig, Slipping(bench, (2,)))
    bench.on_the_way = bytes
    session = sitting(tmp_path, rig, QuickCamera())
    assert session.tally.taken == 3 and session.journal.unchecked == {}
    assert len(list(tmp_path.glob("*-doubtful-*.dng"))) == 3


@pytest.mark.parametrize("firmware", [FIRMWARES[0], GRBLHAL])
def test_a_finding_that_cannot_be_stored_is_made_again(tmp_path, ready, record, monkeypatch, firmware):
    rig, bench = ready(firmware)

    def full(self, verdict):
        raise DeviceError("homings.jsonl: cannot be stored: No space left on device")

    before = dict(bench.machine.settings)
    with monkeypatch.context() as disk:
        disk.setattr(Homings, "conclude", full)
        with pytest.raises(DeviceError, match="No space"):
            sitting(tmp_path, rig, Slipping(bench, (1,)))
    assert bench.machine.settings == before, "its limits are on again"
    with nullcontext() if firmware == GRBLHAL else pytest.raises(AlarmError):  # the axis stands on its switch
        sitting(tmp_path, rig, QuickCamera())
    session = sitting(tmp_path, rig, QuickCamera())
    assert len(list(tmp_path.glob("*-doubtful-*.dng"))) == 3 and session.journal.unchecked == {}


def test_a_sitting_that_ends_while_all_photographs_are_set_aside_goes_on(tmp_path, ready, monkeypatch):
    rig, bench = ready()

    def full(self):
        raise DeviceError("No space left on device")

    camera = Slipping(bench, (2,))
    with monkeypatch.context() as disk:
        # Full at the last photograph: the files are set aside, and their lines remain.
        camera.on_third = lambda: disk.setattr(Journal, "_rewrite", full)
        with pytest.raises(DeviceError, match="No space"):
            sitting(tmp_path, rig, camera)
    assert len(list(tmp_path.glob("*-doubtful-*.dng"))) == 3 and len(read_captures(tmp_path / "captures.csv")) == 3
    assert sitting(tmp_path, rig, QuickCamera()).tally.taken == 3
    assert_whole(tmp_path, PLANNED)


def test_a_rig_without_switches_completes_no_session_with_photographs_in_doubt(tmp_path, ready, monkeypatch):
    rig, bench = ready()
    with pytest.raises(KeyboardInterrupt):
        sitting(tmp_path, rig, Slipping(bench, (2,)), Person(KeyboardInterrupt()))
    _, aim = target(tmp_path)  # its rig has no block motion
    monkeypatch.setattr(stage, "homings_of", lambda *_: rig.homings)
    monkeypatch.setattr(stage, "_start_over_if_changed", lambda *_: None)
    with pytest.raises(PositionError, match=r"camera_deg stood -0\.\d+ degrees.*: 10\.dng, 40\.dng, 70\.dng"):
        stage.photograph(PLANNED, aim, None, tmp_path / "session.json", MADE, owner="object plate")


def test_the_search_that_a_lost_line_prevented_is_made_before_the_session_is_complete(tmp_path, ready, monkeypatch):
    rig, bench = ready()
    _, aim = target(tmp_path, True)

    def session(camera):
        monkeypatch.setattr(stage, "_equipment", lambda *_: nullcontext((rig, camera, AutoOperator(dict))))
        monkeypatch.setattr(stage, "_start_over_if_changed", lambda *_: None)
        monkeypatch.setattr(stage, "homings_of", lambda *_: rig.homings)
        stage.photograph(PLANNED, aim, None, tmp_path / "session.json", MADE, owner="object plate")
        return json.loads((tmp_path / "session.json").read_text())

    def lost():
        raise LinkError("the line is lost (hung up)")

    with monkeypatch.context() as unplugged:
        unplugged.setattr(rig, "recount", lost)
        with pytest.raises(LinkError):
            session(Slipping(bench, (1,)))
    assert not (tmp_path / "session.json").exists()
    assert len(read_captures(aim.table, aim.folder or tmp_path)) == 3
    camera = QuickCamera()
    record = session(camera)
    assert len(camera.taken) == 3, "all were in doubt"
    assert [round(check["lost_deg"]["camera_deg"], 1) for check in record["position"]] == [-0.5, 0.0]
    again = QuickCamera()
    session(again)
    assert not again.taken


def test_an_axis_that_was_moved_between_two_sittings_puts_no_photograph_in_doubt(tmp_path, ready, caplog):
    rig, bench = ready()
    sitting(tmp_path, rig, QuickCamera())
    rig.move({"camera_deg": 50.0})
    bench.machine.slip(1.0)
    assert sitting(tmp_path, rig, QuickCamera()).tally.kept == 3
    assert "moved by hand" in caplog.text


def test_a_retake_of_a_photograph_that_is_set_aside_meanwhile_is_its_next_one(tmp_path, ready):
    dialogue = Dialogue()

    class Person(AutoOperator):
        attended = True

        def judge(self, doubt):
            dialogue.act(Action.RETAKE_LAST, dialogue.view.turn)
            return ""

    rig, bench = ready()
    session = sitting(tmp_path, rig, Slipping(bench, (2,)), Person(dict), dialogue)
    assert_whole(tmp_path, PLANNED)
    assert session.tally.taken == 3 and len(session.camera.taken) == 6


def test_a_person_may_keep_them_with_a_reason(tmp_path, ready):
    class Person(AutoOperator):
        attended = True

        def judge(self, doubt):
            assert "camera_deg stood -0.5 degrees off its count" in doubt and "40.dng" in doubt
            return "the object is a sphere"

    rig, bench = ready()
    sitting(tmp_path, rig, Slipping(bench, (2,)), Person(dict))
    kept = read_captures(tmp_path / "captures.csv", tmp_path)
    assert {shot.taken.accepted for shot in kept} == {"the object is a sphere"}
