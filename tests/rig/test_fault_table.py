"""The table of faults: fault, command, firmware; what the person is told, and how long after the fault.

On a clock that only waiting moves, with the timeout of a real rig. ``-s`` prints the table.
"""

import pytest
from test_rig_waits import later
from virtual_time import Bench, bench_of, opened, rig_of

from irodori.capture.rig.devices import DeviceError, LinkError, RigDevice
from irodori.capture.rig.grbl.protocol import FIRMWARES

TIMEOUT_S = 3.0
COMMANDS = {
    "home": lambda rig: rig.home(),
    "move": lambda rig: rig.move({"camera_deg": 140.0}),
    "jog": lambda rig: rig.jog("camera_deg", 140.0),
    "status": lambda rig: rig.status(),
    "recount": lambda rig: rig.recount(),
}


def lose(bench: Bench, way: str, what) -> None:
    """Lose once what is sent or heard next."""
    gone = []

    def fits(text) -> bool:
        found = not gone and what(text)
        if found:
            gone.append(text)
        return found

    if way == "sent":
        bench.on_the_way = lambda data: b"" if fits(data) else data
    else:
        bench.heard = lambda line: None if fits(line) else line


def unplug(bench: Bench) -> None:
    def lost(*_):
        raise LinkError("the line is lost (hung up)")

    bench.write = bench.read_line = lost


def silence(bench: Bench) -> None:
    bench.heard = lambda line: None


# Fault: what happens, what it ends in, and the longest time after it until it is said, s.
FAULTS = {
    "limit switch": (lambda b: b.machine.raise_alarm(1), "ALARM:1", 1.0),
    "reset button": (lambda b: b.machine.raise_alarm(3), "ALARM:3", 1.0),
    "another program's reset": (lambda b: b.write(b"\x18"), "ALARM:3", 1.0),
    "power lost": (lambda b: b.machine.power_up(), "started anew", 1.0),
    "question lost": (lambda b: lose(b, "sent", lambda data: data == b"?"), None, 0.0),
    "report lost": (lambda b: lose(b, "heard", lambda line: line.startswith("<")), None, 0.0),
    "ok lost": (lambda b: lose(b, "heard", lambda line: line == "ok"), None, 0.0),
    "feed hold": (lambda b: b.machine.press_hold(), "held", 1.5),
    "unplugged": (unplug, "the line is lost", 1.0),
    "silent for ever": (silence, "no status report|no end of homing", TIMEOUT_S * 4 + 0.1),
}
#: Where a fault ends otherwise than in most commands.
OTHERWISE = {
    # Homing that is reset ends in an alarm of its own.
    ("another program's reset", "home"): "ALARM:6",
    # Homing and a jog know no hold: Grbl cancels the jog, with which a switch is looked for too, and homing goes on.
    ("another program's reset", "status"): "started anew",
    ("feed hold", "home"): None,
    ("feed hold", "jog"): "came to rest elsewhere",
    ("feed hold", "recount"): "came to rest elsewhere",
}


def outcome(rig: RigDevice, bench: Bench, command: str, act) -> tuple[str, float]:
    """Return what a command says and the time that it takes after the fault, s."""
    at = [bench.now]
    if command == "status":
        act(bench)
    else:
        later(bench, 0.8, lambda: (at.append(bench.now), act(bench)))
    try:
        COMMANDS[command](rig)
    except DeviceError as error:
        return f"{type(error).__name__}: {error}", bench.now - at[-1]
    return "", bench.now - at[-1]


@pytest.mark.parametrize(
    ("command", "firmware"),
    [(name, dialect) for name in COMMANDS for dialect in FIRMWARES],
)
@pytest.mark.parametrize("fault", FAULTS)
def test_the_person_is_told_the_cause_in_time(monkeypatch, fault, command, firmware):
    rig = rig_of("grbl")
    bench = bench_of(rig, monkeypatch, firmware=firmware)
    driver = opened(rig, bench, timeout_s=TIMEOUT_S)
    driver.home()
    driver.move({"camera_deg": 140.0 if command == "recount" else 0.0})
    act, words, within_s = FAULTS[fault]
    words = OTHERWISE.get((fault, command), words)
    said, took = outcome(driver, bench, command, act)
    print(f"| {fault} | {command} | {firmware} | {said or 'done'} | {took:.1f} s |")
    if words is None:
        assert said == ""
    elif command == "status" and fault not in ("unplugged", "silent for ever"):
        # What is wrong with a rig is a state, which can be asked for again.
        status = driver.status()
        assert said == "" and took <= within_s
        assert words in (status.state if fault == "feed hold" else status.message).replace("hold", "held")
        assert status.homed == (fault == "feed hold")
    else:
        assert any(word in said for word in words.split("|")), said
        # Homing is waited for as long as it may take.
        assert took <= within_s or (command, fault) == ("home", "silent for ever")
