"""Simulated controllers in this process, on a clock that only waiting moves."""

from collections.abc import Callable
from contextlib import nullcontext
from types import ModuleType

import motion_rigs
import patience
from made import made
from motion_rigs import definition

from irodori.capture.rig import ascii_rig, connect, controlled_rig, deadline
from irodori.capture.rig.ascii_description import Description
from irodori.capture.rig.connect import grbl_settings
from irodori.capture.rig.devices import DeadlineError, Link, LinkError, RigDevice
from irodori.capture.rig.drives import drives_of
from irodori.capture.rig.grbl import driver as grbl_driver
from irodori.capture.rig.grbl.protocol import FIRMWARES
from irodori.capture.rig.homings import Homings
from irodori.config.models import Rig
from irodori.simulation.controllers.ascii_simulator import AsciiMachine
from irodori.simulation.controllers.grbl_machine import GrblMachine
from irodori.simulation.controllers.peer_client import Simulator
from irodori.simulation.controllers.peer_server import FaultyMachine, Machine

#: Modules that look at the clock.
CLOCKED: tuple[ModuleType, ...] = (ascii_rig, controlled_rig, deadline, grbl_driver)
TIMEOUT_S = 1.0
#: How far the clock goes at a time while nothing is heard, at first and at last, s.
_STEP_S, _LONGEST_STEP_S = 1e-3, 0.05
#: How often what is sent and lost is looked at while the clock goes on, s.
_LOOK_S = 0.01


class Bench(Link):
    """A controller, its line and the clock of both.

    Attributes
    ----------
    now : float
        Time since the start, s.
    pace : float
        Part of their speed at which the axes go; at 0 they are stuck.
    on_the_way : callable
        Returns the bytes that arrive in place of those that the driver sends.
    heard : callable
        Returns the line that arrives in place of one that the controller sends; None where it is lost.
    sent : list of bytes
    """

    def __init__(self, machine: Machine, line_end: bytes) -> None:
        self.machine, self._line_end = machine, line_end
        self.now, self.pace, self.sent = 0.0, 1.0, list[bytes]()
        self.on_the_way: Callable[[bytes], bytes] = lambda data: data
        self.heard: Callable[[str], str | None] = lambda line: line

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        self.machine.advance(seconds * self.pace)

    def write(self, data: bytes) -> None:
        self.sent.append(data)
        for byte in self.on_the_way(data):
            self.machine.receive(byte)
        self.sleep(_STEP_S)

    def read_line(self, timeout_s: float) -> str:
        end, step = self.now + timeout_s, _STEP_S
        while True:
            line, found, rest = bytes(self.machine.output).partition(self._line_end)
            if found:
                self.machine.output[:] = rest
                self.sleep(_STEP_S)
                if (text := self.heard(line.decode("ascii").removesuffix("\r"))) is not None:
                    return text
            elif self.now >= end:
                raise DeadlineError("no answer")
            else:
                self.sleep(min(step, max(end - self.now, 1e-6)))
                step = min(1.5 * step, _LONGEST_STEP_S)

    def discard_input(self) -> None:
        self.machine.output.clear()

    def close(self) -> None:
        pass


def rig_of(protocol: str, **block) -> Rig:
    """Return the definition of a rig whose axes take seconds; ``block`` replaces keys of ``motion.ascii``."""
    rig = definition(protocol)
    axes = rig["motion"]["axes"]
    axes["camera_deg"] |= {"units_per_deg": -2.0, "speed_deg_per_s": 40.0, "acceleration_deg_per_s2": 50.0}
    axes["turn_deg"] |= {"speed_deg_per_s": 60.0, "acceleration_deg_per_s2": 100.0}
    if protocol == "ascii":
        rig["motion"]["ascii"] |= block
    return made(Rig, rig)


def machine_of(rig: Rig, homing: bool = True, seed: int = 0, firmware: str = FIRMWARES[0]) -> tuple[Machine, bytes]:
    """Return the controller of a definition, and what ends a line of its."""
    drives = drives_of(rig)
    assert rig.motion is not None
    words = rig.motion.ascii
    if words is None:
        return GrblMachine(grbl_settings(drives, homing), seed=seed, firmware=firmware), b"\n"
    description = Description.of(words)
    return AsciiMachine(drives, description, words.simulated_replies.plain(), seed), description.line_end


def bench_of(rig: Rig, monkeypatch, homing: bool = True, seed: int = 0, firmware: str = FIRMWARES[0]) -> Bench:
    """Return the controller of a definition, and let every driver look at its clock."""
    bench = Bench(*machine_of(rig, homing, seed, firmware))
    for module in CLOCKED:
        monkeypatch.setattr(module, "time", bench)
    return bench


class FaultyBench(Simulator):
    """A simulator whose faults, line and clock are of this process: what `connect.open_rig` opens as ``simulator``.

    Attributes
    ----------
    now : float
        Time since the start, s.
    """

    def __init__(self, rig: Rig, monkeypatch, seed: int = 0) -> None:
        machine, _ = machine_of(rig, seed=seed)
        self.now, self.port = 0.0, "in this process"
        self.faulty = FaultyMachine(machine, 1.0, seed, self.monotonic)
        self._line: _Line | None = None
        monkeypatch.setattr(connect, "start_simulator", lambda rig: nullcontext(self))
        monkeypatch.setattr(connect, "SerialLink", self._connect)
        for module in (*CLOCKED, motion_rigs, patience):
            monkeypatch.setattr(module, "time", self)

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            step = min(end - self.now, _LOOK_S)
            self.now = end if step < _LOOK_S else self.now + step
            self.faulty.advance(step)
            self.faulty.fire()
            arrived = self.faulty.send()
            if not self.faulty.plugged:
                self._line = None
            elif self._line:
                self._line.arrived += arrived

    def is_lost(self, line: "_Line") -> bool:
        """Return whether a line has hung up since it was opened, or was opened by another."""
        return self._line is not line

    def _connect(self, port: str, baud: int, *, write_timeout_s: float, line_end: bytes) -> "_Line":
        assert port == self.port
        if not self.faulty.plugged:
            raise LinkError(f"{port}: no such port")
        self._line = _Line(self, line_end)
        return self._line

    def _ask(self, command: str) -> dict:
        word, _, rest = command.partition(" ")
        answer = self.faulty.answer(word, rest)
        assert "error" not in answer, answer
        self.sleep(_STEP_S)
        return answer


class _Line(Link):
    """The driver's end of a line to a `FaultyBench`, from its opening until it is closed or hangs up."""

    def __init__(self, bench: FaultyBench, line_end: bytes) -> None:
        self._bench, self._line_end, self.arrived = bench, line_end, b""

    def write(self, data: bytes) -> None:
        self._check()
        self._bench.faulty.receive(data)
        self._bench.sleep(_STEP_S)

    def read_line(self, timeout_s: float) -> str:
        end, step = self._bench.now + timeout_s, _STEP_S
        while self._line_end not in self.arrived:
            self._check()
            if self._bench.now >= end:
                raise DeadlineError("no answer")
            self._bench.sleep(min(step, max(end - self._bench.now, 1e-6)))
            step = min(1.5 * step, _LONGEST_STEP_S)
        line, _, self.arrived = self.arrived.partition(self._line_end)
        return line.removesuffix(b"\r").decode("ascii", "backslashreplace")

    def discard_input(self) -> None:
        self._check()
        self.arrived = b""

    def close(self) -> None:
        pass

    def _check(self) -> None:
        if self._bench.is_lost(self):
            raise LinkError("the line is lost (hung up)")


def opened(
    rig: Rig, bench: Bench, homing: bool = True, timeout_s: float = TIMEOUT_S, homings: Homings | None = None
) -> RigDevice:
    """Return the driver of a controller."""
    drives = drives_of(rig)
    assert rig.motion is not None
    if rig.motion.ascii is None:
        return grbl_driver.GrblRig(bench, drives, timeout_s=timeout_s, homing=homing, homings=homings)
    return ascii_rig.AsciiRig(bench, drives, Description.of(rig.motion.ascii), timeout_s=timeout_s, homing=homing)


__all__ = ["TIMEOUT_S", "Bench", "FaultyBench", "bench_of", "opened", "rig_of"]
