"""The tables of faults in docs/rig.md: fault, command, controller; what the person is told, and how long after it.

On a clock that only waiting moves, with the timeout of a real rig. ``-s`` prints what came of each case.
"""

import re
from pathlib import Path

import pytest
from test_rig_waits import later
from virtual_time import Bench, bench_of, opened, rig_of

from irodori.capture.rig.devices import DeviceError, LinkError, RigDevice
from irodori.capture.rig.grbl.protocol import FIRMWARES

TIMEOUT_S = 3.0
ASCII = "ascii"
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


def press(bench: Bench, keys: bytes) -> None:
    for byte in keys:
        bench.machine.receive(byte)


#: What happens, in the words of the table.
FAULTS = {
    "limit switch": lambda b: b.machine.raise_alarm(1),
    "soft limit": lambda b: press(b, b"G90G53G0X-999\n"),
    "reset button": lambda b: b.machine.raise_alarm(3),
    "another program's reset": lambda b: b.write(b"\x18"),
    "alarm": lambda b: b.machine.raise_alarm(1),
    "power lost": lambda b: b.machine.power_up(),
    "question lost": lambda b: lose(b, "sent", lambda data: data == b"?" or data.startswith((b"PO", b"SS"))),
    "report lost": lambda b: lose(b, "heard", lambda line: line.startswith(("<", "PO", "SS"))),
    "ok lost": lambda b: lose(b, "heard", lambda line: line in ("ok", "OK")),
    "feed hold": lambda b: b.machine.press_hold(),
    "steps lost": lambda b: b.machine.slip(0.5),
    "unplugged": unplug,
    "silent for ever": silence,
}
#: What a controller says on its own, and is passed on within a second.
SAID_BY_ITSELF = ("limit switch", "soft limit", "reset button", "another program's reset", "alarm", "power lost")


def documented() -> dict[tuple[str, str, str], str]:
    """Return the cells of the tables by controller, fault and command; those of a dash are no cases."""
    text = (Path(__file__).parents[2] / "docs/rig.md").read_text(encoding="utf-8")
    tables = re.findall(r"^\| fault, (.+?) \|(.+)\|\n\|[-|]+\|\n((?:\|.*\n)+)", text, re.MULTILINE)
    found = {}
    for whose, head, body in tables:
        dialects = FIRMWARES if whose == "Grbl, grblHAL, FluidNC" else (ASCII,)
        for line in body.splitlines():
            fault, *cells = (part.strip() for part in line.strip("|").split("|"))
            for command, cell in zip(head.split("|"), cells, strict=True):
                found |= {(dialect, fault, command.strip()): cell for dialect in dialects if cell != "-"}
    return found


CASES = documented()


def test_the_tables_have_every_fault_that_is_tried():
    assert {fault for _, fault, _ in CASES} == set(FAULTS) and {command for _, _, command in CASES} == set(COMMANDS)
    assert {dialect for dialect, _, _ in CASES} == {*FIRMWARES, ASCII} and len(CASES) > 170


def outcome(rig: RigDevice, bench: Bench, command: str, act) -> tuple[str, float]:
    """Return what a command says and the time that it takes after the fault, s."""
    at = [bench.now]
    # The answer to the command itself is lost at once.
    if command == "status" or act is FAULTS["ok lost"]:
        act(bench)
    else:
        later(bench, 0.8, lambda: (at.append(bench.now), act(bench)))
    try:
        COMMANDS[command](rig)
    except DeviceError as error:
        return f"{type(error).__name__}: {error}", bench.now - at[-1]
    return "", bench.now - at[-1]


@pytest.mark.default_cases(70)
@pytest.mark.parametrize(("dialect", "fault", "command"), CASES)
def test_the_person_is_told_what_the_table_says_and_no_later(monkeypatch, dialect, fault, command):
    rig = rig_of(ASCII if dialect == ASCII else "grbl")
    bench = bench_of(rig, monkeypatch, **({} if dialect == ASCII else {"firmware": dialect}))
    driver = opened(rig, bench, timeout_s=TIMEOUT_S)
    driver.home()
    # Where the way to the switch is long enough for a fault on it.
    far = command == "recount" or (dialect, command) == (ASCII, "home")
    driver.move({"camera_deg": 140.0 if far else 0.0})
    said, took = outcome(driver, bench, command, FAULTS[fault])
    if command == "status" and not said:
        # What is wrong with a rig is a state, which can be asked for again.
        status = driver.status()
        said = ", ".join([f"state {status.state}", "homed" if status.homed else "not homed", status.message])
        said = "" if said == "state idle, homed, " else said
    print(f"| {fault} | {command} | {dialect} | {said or 'done'} | {took:.1f} s |")
    cell = CASES[dialect, fault, command]
    words, seconds = re.findall(r"`(.+?)`", cell), re.search(r"([\d.]+) s\b", cell)
    assert bool(said) == bool(words) and (words or cell.startswith("done")), (cell, said)
    assert all(word in said for word in words), (cell, said)
    if words:
        assert took <= float(seconds[1]) + 0.05, (cell, took)
        assert fault not in SAID_BY_ITSELF or float(seconds[1]) <= 1.0
