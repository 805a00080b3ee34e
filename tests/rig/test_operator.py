"""Hand steps: the sentence, the answer on a terminal, the answer through a file, and what stands afterwards."""

import os
import pty
import subprocess
import sys
import threading
from dataclasses import replace

import patience
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sessions import QuickCamera, shots

from irodori.capture.dialogue import Dialogue
from irodori.capture.journal import Journal
from irodori.capture.operator import (
    SETTINGS,
    AutoOperator,
    FileOperator,
    HandSettings,
    Operator,
    OperatorAbort,
    PromptOperator,
    Step,
    make_operator,
)
from irodori.capture.rig.devices import Axis, DeadlineError, DeviceError, RigDevice, RigStatus
from irodori.capture.session import Session, take_stock
from irodori.capture.setup_steps import hand_settings, motor_targets
from irodori.config.capture_table import FILTERS, SUBJECTS, Pose, Shot

STEP = Step.between({"light_deg": 65.0, "filter": "out"}, {"light_deg": 45.0, "filter": "in"})

angles = st.floats(-360.0, 360.0)
settings_of_a_bench = st.fixed_dictionaries(
    {},
    optional={
        "subject": st.sampled_from([*(s for s in SUBJECTS if s != "room-chart"), "room-chart-desk"]),
        "light_deg": angles,
        "camera_deg": angles,
        "tilt_deg": angles,
        "turn_deg": angles,
        "filter": st.sampled_from(FILTERS),
    },
)


class Asked(Operator):
    """Notes the steps; fails where told to."""

    def __init__(self, faults=()):
        self.steps, self.faults = [], list(faults)

    def ask(self, step):
        self.steps.append(step)
        if self.faults and (fault := self.faults.pop(0)):
            raise fault

    def confirm(self, request):
        raise AssertionError(f"asked for what is no step: {request}")


# ---- the sentence


@pytest.mark.parametrize(
    ("stands", "wanted", "sentence"),
    [
        ({"light_deg": 65.0, "filter": "out"}, {"light_deg": 45.0, "filter": "in"},
         "Set the light to 45.0° (it stands at 65.0°), put the comb filter in"),
        ({}, {"light_deg": 45.0, "tilt_deg": 0.0, "filter": "out", "subject": "object"},
         "Take the lens cap off and put the object in place, set the light to 45.0°, tilt the table to 0.0°, "
         "take the comb filter out"),
        ({"subject": "object"}, {"subject": "dark"}, "Put the lens cap on"),
        ({"subject": "dark"}, {"subject": "white"}, "Take the lens cap off and put the white reference in place"),
        ({"subject": "white"}, {"subject": "chart"}, "Put the colour chart in place"),
        ({"camera_deg": 0.05, "turn_deg": 0.0}, {"camera_deg": -0.0, "turn_deg": 0.25},
         "Set the camera to 0.0° (it stands at 0.05°), turn the table to 0.25° (it stands at 0.0°)"),
    ],
)  # fmt: skip
def test_a_step_is_one_plain_sentence(stands, wanted, sentence):
    assert str(Step.between(stands, wanted)) == sentence


@given(settings_of_a_bench, settings_of_a_bench)
def test_a_step_changes_what_differs_and_nothing_else(stands, wanted):
    step = Step.between(stands, wanted)
    assert {**stands, **step.new} == {**stands, **wanted}
    assert all(change.old != change.new for change in step.changes)
    assert [change.name for change in step.changes] == [name for name in SETTINGS if name in step.new]
    assert bool(step) == ({**stands, **wanted} != stands)
    assert not Step.between({**stands, **wanted}, wanted)


@given(settings_of_a_bench, settings_of_a_bench)
def test_the_sentence_gives_every_angle_exactly(stands, wanted):
    step = Step.between(stands, wanted)
    text = str(step)
    assert "\n" not in text and text[:1] == text[:1].upper()
    written = [float(word.split("°")[0]) for word in text.replace("(", "").split() if "°" in word]
    given_angles = [a for c in step.changes for a in (c.new, c.old) if isinstance(a, float)]
    assert written == pytest.approx(given_angles, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("wanted", "said"),
    [({"ligth_deg": 45.0}, "light_deg"), ({"filter": "inn"}, "'in'"), ({"subject": "objekt"}, "'object'")],
)
def test_an_unknown_setting_lists_the_valid_ones(wanted, said):
    with pytest.raises(ValueError, match=said):
        Step.between({}, wanted)


# ---- what a shot wants


def shot(role: str, **changes) -> Shot:
    return Shot("", role, Pose(45.0, 20.0, 10.0, 5.0), changes.get("filter", "in"), 0.02)


def test_what_no_motor_drives_is_set_by_hand():
    axes = ("camera_deg", "turn_deg")
    assert motor_targets(shot("object"), axes) == {"camera_deg": 20.0, "turn_deg": 5.0}
    assert hand_settings(shot("object"), axes) == {
        "subject": "object", "placement": 1, "filter": "in",
        "light_deg": 45.0, "light_azimuth_deg": 0.0, "tilt_deg": 10.0,
    }  # fmt: skip


def test_a_covered_lens_wants_neither_pose_nor_filter():
    assert motor_targets(shot("dark"), ("camera_deg",)) == {}
    assert hand_settings(shot("dark"), ("camera_deg",)) == {"subject": "dark"}
    assert hand_settings(shot("environment"), ()) == {"subject": "environment", "filter": "in"}


# ---- what stands


def test_the_first_step_of_a_run_states_everything_once():
    operator = Asked()
    hand = HandSettings(operator)
    wanted = hand_settings(shot("object"), ("camera_deg",))
    hand.set(wanted)
    # A lamp that nobody moved beside the rig's plane stands in it, and an object put in place lies as it does first.
    assert {**operator.steps[0].new, "light_azimuth_deg": 0.0, "placement": 1} == wanted
    assert "light_azimuth_deg" not in operator.steps[0].new
    assert all(change.old is None for change in operator.steps[0].changes)
    assert not hand.set(wanted) and len(operator.steps) == 1
    hand.set(hand_settings(shot("object", filter="out"), ("camera_deg",)))
    assert str(operator.steps[1]) == "Take the comb filter out"


@pytest.mark.parametrize("fault", [OperatorAbort("stop"), DeadlineError("late"), KeyboardInterrupt()])
def test_after_a_step_that_failed_its_settings_are_unknown(fault):
    operator = Asked([None, fault])
    hand = HandSettings(operator)
    hand.set({"light_deg": 45.0, "filter": "in", "subject": "object"})
    with pytest.raises(type(fault)):
        hand.set({"light_deg": 65.0, "filter": "in", "subject": "object"})
    hand.set({"light_deg": 45.0, "filter": "in", "subject": "object"})
    assert operator.steps[-1].new == {"light_deg": 45.0}


# ---- on a terminal


class Terminal:
    """The input is a pseudo-terminal; each question on stderr is answered by the next of the lines typed."""

    def __init__(self, monkeypatch, lines):
        self.master, slave = pty.openpty()
        self.lines, self.shown = list(lines), []
        monkeypatch.setattr(sys, "stdin", os.fdopen(slave))
        monkeypatch.setattr(sys, "stderr", self)

    def write(self, text):
        self.shown.append(text)
        if text.endswith(": ") and self.lines:
            os.write(self.master, self.lines.pop(0))

    def flush(self):
        pass

    def isatty(self):
        return True


@pytest.fixture
def terminal(monkeypatch):
    terminals = []

    def make(*lines):
        terminals.append(Terminal(monkeypatch, lines))
        return terminals[0]

    yield make
    for made in terminals:
        sys.stdin.close()
        os.close(made.master)


@pytest.mark.parametrize("answer", [b"\n", b"y\n", b"Done\n"])
def test_enter_confirms_on_a_terminal(terminal, answer):
    screen = terminal(answer)
    PromptOperator(Dialogue()).ask(STEP)
    assert str(STEP) in "".join(screen.shown)


def test_an_answer_that_is_none_is_asked_for_again(terminal):
    screen = terminal(b"what?\n", b"\xff\xfe\n", b"\n")
    PromptOperator(Dialogue()).ask(STEP)
    assert sum("Enter when done" in text for text in screen.shown) == 3


@pytest.mark.parametrize("answer", [b"q\n", b"Abort\n", b"no\n", b"\x04"])
def test_the_person_may_stop_the_session(terminal, answer):
    terminal(answer)
    with pytest.raises(OperatorAbort, match=r"stopped by the person at the bench, before: Set the light to 45\.0°"):
        PromptOperator(Dialogue()).ask(STEP)


def test_what_was_typed_before_the_question_is_no_answer(terminal):
    screen = terminal(b"q\n")
    os.write(screen.master, b"\n\n")
    with pytest.raises(OperatorAbort):
        PromptOperator(Dialogue()).ask(STEP)


def test_nobody_at_the_terminal_ends_at_the_deadline(terminal):
    terminal()
    with pytest.raises(DeadlineError, match=r"nobody answered in 0\.05 s: Set the light"):
        PromptOperator(Dialogue(deadline_s=0.05)).ask(STEP)


def test_a_session_is_driven_by_keys(terminal, tmp_path):
    """What the page has buttons for: a test exposure at a step, a pause typed in mid-exposure, the last one again."""
    screen = terminal(b"t\n", b"\n", b"l\n", b"\n")

    class Motor(RigDevice):
        def __init__(self):
            self.axes = {"camera_deg": Axis("camera_deg", 0.0, 90.0, 1.0, 10.0, 10.0)}

        def move(self, targets_deg):
            screen.shown.append("moves: ")

        def status(self):
            return RigStatus("idle", {"camera_deg": 0.0}, homed=True)

        def home(self):
            raise AssertionError

        stop = close = resume = home

    class Eye(QuickCamera):
        def capture(self, shot, path):
            super().capture(replace(shot, file=f"{len(self.taken)}"), path)  # no two are alike
            if len(self.taken) == 2:
                os.write(screen.master, b"p\n")

    planned, dialogue, eye = shots(2), Dialogue(), Eye()
    journal = Journal(tmp_path / "captures.csv")
    tally = take_stock(journal, planned)
    Session(eye, PromptOperator(dialogue), journal, Motor(), tally, dialogue=dialogue).run(planned, "vase")
    happened = [text for text in screen.shown if text.endswith(": ")]
    assert [text.split(". ")[-1] for text in happened] == [
        "moves: ",
        "Enter when done, t for a test exposure, q to stop: ",
        "Enter when done, t for a test exposure, q to stop: ",
        "Enter to go on, l to retake the last, t for a test exposure, q to stop: ",
        "moves: ",
        "moves: ",
        "Enter when done, l to retake the last, t for a test exposure, q to stop: ",
    ]
    assert "Test exposure: brightest hundredth at" in "".join(screen.shown) and "\nG |" in "".join(screen.shown)
    assert (len(eye.taken), tally.taken, tally.retaken) == (4, 3, 1)
    assert len(list(tmp_path.glob("*-retaken-*.dng"))) == 1 and not list(tmp_path.glob(".part*"))


def test_an_input_that_is_no_terminal_is_refused_with_a_way_out(monkeypatch):
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        with pytest.raises(DeviceError, match=r"asked to set the light.*no terminal.*operator: file"):
            PromptOperator(Dialogue()).ask(STEP)


def test_without_any_input_it_is_refused_as_well(monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(DeviceError, match="no terminal"):
        PromptOperator(Dialogue()).ask(STEP)


# ---- through a file


class Bystander:
    """Reads stderr and hands each command that a message names to a person."""

    def __init__(self, monkeypatch, person):
        self.shown, self.person = [], person
        monkeypatch.setattr(sys, "stderr", self)

    def write(self, text):
        self.shown.append(text)
        if "When done: " in text:
            self.person(text.partition("When done: ")[2])

    def flush(self):
        pass


def test_the_command_that_the_message_names_confirms_and_the_file_goes(monkeypatch, tmp_path):
    folder, people = tmp_path / "results of today" / "rig", []
    at_the_bench = Bystander(monkeypatch, lambda command: people.append(subprocess.Popen(["sh", "-c", command])))
    operator = FileOperator(folder, deadline_s=patience.LONG_S, poll_s=0.01)
    operator.ask(STEP)
    operator.ask(STEP)
    assert [person.wait() for person in people] == [0, 0]
    assert list(folder.iterdir()) == []
    assert all(str(STEP) in line for line in at_the_bench.shown if "When done" in line)


def test_files_from_before_the_question_do_not_count(monkeypatch, tmp_path):
    (tmp_path / "confirm-1").touch()
    (tmp_path / "confirm-1-0000").touch()
    monkeypatch.setattr("irodori.capture.operator.os.urandom", lambda _: b"\0\0")
    Bystander(monkeypatch, lambda command: None)
    with pytest.raises(DeadlineError, match=r"confirm-1-0000 did not appear in 0\.05 s"):
        FileOperator(tmp_path, deadline_s=0.05, poll_s=0.01).ask(STEP)


def test_an_answer_to_a_run_that_was_killed_confirms_nothing(monkeypatch, tmp_path):
    commands = []
    Bystander(monkeypatch, commands.append)
    for _ in range(2):
        with pytest.raises(DeadlineError):
            FileOperator(tmp_path, deadline_s=0.0, poll_s=0.01).ask(STEP)
    assert commands[0] != commands[1]


def test_a_long_wait_is_told_from_time_to_time(monkeypatch, tmp_path):
    def person(command):
        if sum("waiting for" in line for line in at_the_bench.shown) == 3:
            threading.Timer(0.02, subprocess.run, [["sh", "-c", command]]).start()

    at_the_bench = Bystander(monkeypatch, person)
    FileOperator(tmp_path, deadline_s=patience.LONG_S, poll_s=0.005, progress_s=0.02).ask(STEP)
    assert sum("waiting for" in line for line in at_the_bench.shown) >= 3


# ---- by configuration


def test_the_virtual_bench_is_set_by_itself():
    stands = {}
    HandSettings(AutoOperator(stands.update)).set({"light_deg": 45.0, "filter": "in"})
    assert stands == {"light_deg": 45.0, "filter": "in"}


def test_the_configuration_chooses_the_operator(tmp_path):
    assert isinstance(make_operator("prompt", tmp_path, Dialogue(5.0)), PromptOperator)
    assert make_operator("file", tmp_path, Dialogue(5.0)).deadline_s == 5.0
    assert isinstance(make_operator("auto", tmp_path, Dialogue(), set_bench=dict), AutoOperator)
    with pytest.raises(DeviceError, match="auto is for the virtual rig"):
        make_operator("auto", tmp_path, Dialogue())
    with pytest.raises(ValueError, match=r"no operator 'promt'; did you mean 'prompt'\?"):
        make_operator("promt", tmp_path, Dialogue())
