"""The driver of described controllers: descriptions of several kinds, and what it makes of what they say."""

import pytest
from virtual_time import TIMEOUT_S, bench_of, opened, rig_of

from irodori.capture.rig.ascii_description import Description, placeholders
from irodori.capture.rig.devices import AlarmError, CommandError, DeadlineError, GarbledError, HeldError

HALF_STEP = 0.5 * 0.1 * 2.0  # of the camera: a step of 0.1 degree at 2 units a degree
CAMERA, TURN = 0, 1  # stages of the machine


def bench_and_rig(monkeypatch, homed=True, **block):
    rig = rig_of("ascii", **block)
    bench = bench_of(rig, monkeypatch)
    driver = opened(rig, bench)
    if homed:
        driver.home()
        driver.move({"camera_deg": 0.0, "turn_deg": 0.0})
    return bench, driver


def replies(**changed):
    """Return the replies of the rig's file with some of them changed."""
    return {"accepted": "OK", "position": r"PO (?P<axis>\w+)=(?P<position>-?\d+\.\d{3})",
            "status": r"SS=(?P<state>\w+)", "refused": r"NG (?P<message>.*)"} | changed  # fmt: skip


def test_a_state_of_each_axis_is_asked_of_each(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch, status="SS {axis}")
    driver.move({"turn_deg": 90.0})  # ends when the turn ends, though the camera is idle all the way
    assert driver.position()["turn_deg"] == pytest.approx(90.0, abs=0.01)
    driver.move({"camera_deg": 30.0})
    bench.sent.clear()
    driver.status()
    assert bench.sent.count(b"SS CAME\r") == bench.sent.count(b"SS TURN\r") == 1
    assert bench.sent.count(b"PO CAME\r") == bench.sent.count(b"PO TURN\r") == 1


@pytest.mark.parametrize(
    ("states", "expected"),
    [
        (("READY", "BUSY"), "run"), (("BUSY", "HELD"), "run"), (("HELD", "READY"), "hold"),
        (("BUSY", "FAULT"), "alarm"), (("READY", "READY"), "idle"),
    ],
)  # fmt: skip
def test_the_state_of_a_rig_is_that_of_its_worst_axis(states, expected, monkeypatch):
    bench, driver = bench_and_rig(monkeypatch, status="SS {axis}")
    left = list(states)
    bench.heard = lambda line: f"SS={left.pop(0)}" if line.startswith("SS") else line
    status = driver.status()
    assert (status.state, status.homed) == (expected, expected != "alarm")


def test_a_state_of_the_whole_is_asked_once(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    bench.sent.clear()
    driver.status()
    assert bench.sent.count(b"SS\r") == 1


def held_between_orders(bench, driver) -> list[str]:
    """Press the hold once the first of two axes has been ordered, and return what the person is asked from now on."""
    asked = []

    def pressed(line):
        if line == "OK":
            bench.machine.press_hold()
            bench.heard = lambda line: line
        return line

    bench.heard, driver.on_hold = pressed, asked.append
    return asked


def test_a_hold_between_the_orders_of_two_axes_asks_and_goes_on(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    asked = held_between_orders(bench, driver)
    driver.move({"camera_deg": 100.0, "turn_deg": 30.0})
    assert len(asked) == 1 and asked[0].startswith("Clear the cause")
    assert driver.position() == pytest.approx({"camera_deg": 100.0, "turn_deg": 30.0}, abs=0.01)


def test_a_hold_between_the_orders_of_two_axes_ends_a_move_of_which_nobody_can_be_asked(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    held_between_orders(bench, driver)
    driver.on_hold = None
    with pytest.raises(HeldError, match="its move is given up"):
        driver.move({"camera_deg": 100.0, "turn_deg": 30.0})


def test_an_axis_that_is_refused_for_another_reason_than_a_hold_is_refused(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    bench.heard = lambda line: "NG out of range" if line == "OK" else line
    driver.on_hold = lambda request: pytest.fail(request)
    with pytest.raises(CommandError, match="out of range"):
        driver.move({"camera_deg": 100.0, "turn_deg": 30.0})


def test_axes_that_home_together_are_told_once(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch, homed=False, home="HM")
    bench.sent.clear()
    driver.home()
    assert bench.sent.count(b"HM\r") == 2  # homing is done twice
    assert driver.status().homed
    driver.move({"camera_deg": 20.0, "turn_deg": 30.0})
    bench, driver = bench_and_rig(monkeypatch, homed=False)
    bench.sent.clear()
    driver.home()
    assert bench.sent.count(b"HM CAME\r") == bench.sent.count(b"HM TURN\r") == 2


def test_a_power_cut_during_homing_does_not_look_homed_elsewhere(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    driver.move({"camera_deg": 140.0, "turn_deg": 359.5})
    receive, orders = bench.machine.receive, []

    def cut(byte):
        receive(byte)
        if bytes(bench.sent[-1]).startswith(b"HM TURN") and byte == 13 and not orders:
            orders.append(byte)
            bench.machine.power_up()

    bench.machine.receive = cut
    driver.home()
    driver.move({"camera_deg": 10.0})
    # The switch of the camera stands at -1 degree, where its mechanics count from.
    assert orders and bench.machine.stages[CAMERA].position[0] == pytest.approx(-22.0, abs=0.01)


def test_a_hold_while_it_is_homed_ends_homing(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    driver.move({"camera_deg": 140.0})
    hold, advance = bench.machine.press_hold, bench.machine.advance
    due = bench.now + 0.5

    def advancing(seconds):
        if bench.now > due:
            bench.machine.advance = advance
            hold()
        advance(seconds)

    bench.machine.advance = advancing
    with pytest.raises(HeldError, match="held while it was homed"):
        driver.home()
    status = driver.status()
    assert status.state == "idle" and not status.homed


# ---- what it says


def test_a_refusal_says_why(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    bench.on_the_way = lambda data: data.replace(b"MA", b"MX")
    with pytest.raises(CommandError, match=r"refused 'MA {axis} {target:.3f}': unknown command"):
        driver.move({"camera_deg": 10.0})
    assert driver.status().homed


def test_a_refusal_without_a_reason_is_quoted(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch, replies=replies(refused="NG .*"))
    bench.on_the_way = lambda data: data.replace(b"MA", b"MX")
    with pytest.raises(CommandError, match=r"refused .*: NG unknown command"):
        driver.move({"camera_deg": 10.0})


def test_a_refusal_in_alarm_is_an_alarm(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    write, alarmed = bench.on_the_way, []

    def late(data):
        if data.startswith(b"MA") and not alarmed:
            alarmed.append(True)
            bench.machine.raise_alarm(1)
        return write(data)

    bench.on_the_way = late
    with pytest.raises(AlarmError, match="in alarm; it is in alarm: find the cause, then home it"):
        driver.move({"camera_deg": 10.0})
    assert not driver.status().homed


def test_a_controller_that_accepts_with_other_words_is_garbled(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    bench.heard = lambda line: "OKAY" if line == "OK" else line
    with pytest.raises(GarbledError, match="'OKAY', which is no reply 'accepted'"):
        driver.move({"camera_deg": 10.0})


def test_a_position_of_another_axis_is_garbled(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    bench.heard = lambda line: line.replace("TURN", "CAME")
    with pytest.raises(GarbledError, match=r"'PO CAME=.*' when asked for its axis TURN"):
        driver.status()


def test_a_position_without_its_axis_is_that_of_the_axis_asked_for(monkeypatch):
    block = {"replies": replies(position=r"(?P<position>\S+)")}
    block["simulated_replies"] = {"accepted": "OK", "position": "{position:.3f}", "status": "SS={state}",
                                  "refused": "NG {message}"}  # fmt: skip
    bench, driver = bench_and_rig(monkeypatch, **block)
    driver.move({"camera_deg": 10.0, "turn_deg": 20.0})
    assert driver.position() == pytest.approx({"camera_deg": 10.0, "turn_deg": 20.0}, abs=0.01)
    bench.heard = lambda line: "1.2.3" if line[:1] in "-0123456789" else line
    with pytest.raises(GarbledError, match=r"'1.2.3', in which the position is not a number"):
        driver.status()


def test_a_reply_that_comes_too_late_is_not_taken_for_the_next(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    bench.machine.output += b"PO CAME=1.000\rSS=BUSY\r"
    assert driver.status().state == "idle"


def test_words_of_states_are_those_of_the_file():
    words = Description.of(rig_of("ascii", idle=["A", "B"], busy=["C"], hold=["D"], alarm=["E", "F"]).motion.ascii)
    assert [words.state(w) for w in "ABCDEF"] == ["idle", "idle", "run", "hold", "alarm", "alarm"]
    with pytest.raises(GarbledError, match="'G'; words of its state in the rig's file: A, B, C, D, E, F"):
        words.state("G")
    assert words.per_axis("move") and words.per_axis("position") and not words.per_axis("status")
    assert words.line("move", axis="X", target=-1.23456) == b"MA X -1.235\r"
    assert "resume" in words.commands


def test_a_placeholder_has_a_plain_name():
    assert placeholders("MA {axis} {target:.3f}{{}}") == ["axis", "target"] and placeholders("ST") == []
    for text in ("MA {}", "MA {0}", "MA {a.b}", "MA {a[0]}"):
        with pytest.raises(ValueError, match="without a plain name"):
            placeholders(text)


# ---- where it stands


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("at", [0.0, 70.0])
def test_an_axis_that_is_moved_by_hand_by_more_than_half_a_step_is_not_trusted(sign, at, monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    driver.move({"camera_deg": at})
    bench.machine.stages[CAMERA].position[0] += sign * 0.9 * HALF_STEP
    assert driver.status().homed
    driver.move({"camera_deg": at + 1.0})
    bench.machine.stages[CAMERA].position[0] += sign * 0.2 * HALF_STEP
    driver.move({"camera_deg": at + 1.0})
    bench.machine.stages[CAMERA].position[0] += sign * 1.2 * HALF_STEP
    with pytest.raises(AlarmError, match=f"camera_deg is at .* and was left at {at + 1:g}: .* home it first"):
        driver.move({"camera_deg": 5.0})
    assert not driver.status().homed
    driver.home()
    assert driver.status().homed


def test_an_alarm_at_rest_is_a_state_that_costs_the_trust(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    bench.machine.raise_alarm(1)
    status = driver.status()
    assert status.state == "alarm" and not status.homed
    with pytest.raises(AlarmError, match="in alarm: it stopped on its own"):
        driver.move({"camera_deg": 5.0})


def test_a_stop_on_the_way_leaves_a_place_that_is_known(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)

    def pressed(request):
        raise KeyboardInterrupt

    driver.on_hold = pressed
    later = bench.machine.advance
    due = bench.now + 1.0

    def advancing(seconds):
        if bench.now > due:
            bench.machine.advance = later
            bench.machine.press_hold()
        later(seconds)

    bench.machine.advance = advancing
    with pytest.raises(KeyboardInterrupt):
        driver.move({"camera_deg": 120.0, "turn_deg": 100.0})
    status = driver.status()
    assert status.homed and 10.0 < status.position_deg["camera_deg"] < 100.0
    driver.move({"camera_deg": 5.0})
    # Stopped again without a move: a place beyond the last is no place that it was sent to.
    bench.machine.stages[TURN].position[0] += 1.0
    driver.stop()
    assert not driver.status().homed


@pytest.mark.parametrize("beyond", [-0.3, 0.3])
def test_a_stop_that_finds_an_axis_off_its_way_costs_the_trust(beyond, monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    driver.move({"camera_deg": 10.0})
    bench.machine.stages[CAMERA].position[0] += 0.5 * HALF_STEP
    driver.stop()
    assert driver.status().homed
    bench.machine.stages[CAMERA].position[0] += beyond
    driver.stop()
    assert not driver.status().homed


def test_a_rig_that_does_not_stop_is_told_three_times(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    bench.write(b"MA CAME -202.000\r")
    bench.sleep(1.0)
    bench.machine.output.clear()
    bench.pace = 0.0
    bench.sent.clear()
    begun = bench.now
    driver.stop()
    assert bench.sent.count(b"ST\r") == 3
    # Each time the ramp of 0.8 s and a quarter more, and a third of the timeout.
    assert 3 * (1.0 + TIMEOUT_S / 3) <= bench.now - begun < 3 * (1.0 + TIMEOUT_S / 3) + 1.0
    with pytest.raises(DeadlineError, match="does not stop"):
        driver.status()
    bench.pace = 1.0
    bench.sleep(1.0)
    assert driver.status().state == "idle"


def test_homing_that_the_controller_begins_a_moment_late_is_waited_for(monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    bench.machine.slip(3.0, CAMERA)
    sent = []

    def noted(data):
        sent.append(data)
        return data

    def ready_at_first(line):
        """Right after the order to home the controller says that it is ready, as it was before."""
        return "SS=READY" if line.startswith("SS=") and sent[-2:-1] and sent[-2].startswith(b"HM") else line

    bench.on_the_way, bench.heard = noted, ready_at_first
    driver.home()
    assert not bench.machine.moving
    driver.move({"camera_deg": 40.0})
    assert bench.machine.stages[CAMERA].position[0] == pytest.approx(
        driver.drives["camera_deg"].to_units(40.0), abs=0.01
    )


@pytest.mark.parametrize("pushed", [-1.0, 1.0])
def test_an_axis_that_is_pushed_off_its_way_ends_the_move_even_if_it_comes_back(pushed, monkeypatch):
    bench, driver = bench_and_rig(monkeypatch)
    later, due, left = bench.machine.advance, bench.now + 1.0, [pushed, -pushed]

    def advancing(seconds):
        if left and bench.now > due + (1.0 if len(left) == 1 else 0.0):
            bench.machine.stages[TURN].position[0] += left.pop(0)
        later(seconds)

    bench.machine.advance = advancing
    with pytest.raises(AlarmError, match=r"turn_deg is at .* degrees, off its way"):
        driver.move({"camera_deg": 120.0})
    assert not driver.status().homed
