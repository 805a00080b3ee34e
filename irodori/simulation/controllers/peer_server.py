"""Server process of a simulated controller: byte transport over a pseudo-terminal, and faults.

Commands on standard input, each answered by one line of JSON on standard output:

* ``fault TEXT``: inject a fault, see `irodori.simulation.controllers.line_faults`; ``clear``: discard faults that have
  not happened yet, end a stall and reconnect the line.
* ``state``: return the state, whether anything moves, and for each channel the true position and its extremes in
  controller units; ``forget``: reset the extremes.
* ``power``: switch the controller off and on; ``pace X``: run X simulated seconds per real second; ``quit``: end.
"""

import argparse
import contextlib
import json
import math
import os
import random
import select
import signal
import sys
import tempfile
import time
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path

from irodori.simulation.controllers.line_faults import Fault, parse_fault
from irodori.simulation.controllers.trapezoidal_motion import Stage

#: Simulated time between two checks for faults, s.
_SLICE_S = 5e-3
_BUSY_WAIT_S, _IDLE_WAIT_S = 1e-3, 2e-2
#: Least time for which the line stays disconnected, s.
_SHORTEST_HANGUP_S = 1e-3


class Machine(ABC):
    """A simulated controller without its serial line.

    Attributes
    ----------
    channels : tuple of str
        Names of the axes.
    stages : tuple of Stage
        Mechanics, in true coordinates, independent of the positions that the controller has counted. Channels of one
        stage move together; the channels are those of the stages in order.
    output : bytearray
        Bytes sent by the controller that the line has not transmitted yet.
    lines : int
        Number of received lines.
    dropped_reports : int
        Number of the next status reports that are lost completely, if the protocol has such reports.
    """

    channels: tuple[str, ...]
    stages: tuple[Stage, ...]

    def __init__(self) -> None:
        self.output = bytearray()
        self.lines = 0
        self.dropped_reports = 0

    @property
    @abstractmethod
    def state(self) -> str:
        """State of the controller, in the words of its protocol."""

    @property
    def moving(self) -> bool:
        """Whether any axis moves."""
        return any(stage.moving for stage in self.stages)

    @property
    def progress(self) -> float | None:
        """Share of the path that is done in the present motion, the least of all stages; None without motion."""
        return min((stage.progress for stage in self.stages if stage.blocks), default=None)

    @abstractmethod
    def receive(self, byte: int) -> None:
        """Receive a byte from the line."""

    @abstractmethod
    def advance(self, seconds: float) -> None:
        """Advance simulated time by a number of seconds."""

    @abstractmethod
    def power_up(self) -> None:
        """Start as after switching on: discard all that a controller forgets without power."""

    @abstractmethod
    def raise_alarm(self, code: int) -> None:
        """Stop at once and report an alarm with a code."""

    @abstractmethod
    def press_hold(self) -> None:
        """Decelerate the axes to rest and keep the remaining moves, like the feed-hold button of a controller."""

    @abstractmethod
    def slip(self, by: float, axis: int = 0) -> None:
        """Displace an axis by a number of units without changing the controller's count, as if its motor lost steps."""


class FaultyMachine:
    """A simulated controller with faults on command; the caller provides the clock and the serial line.

    Parameters
    ----------
    machine : Machine
    time_scale : float
        Simulated seconds per second of the clock.
    seed : int
        Seed of the random bytes in a garbled line.
    now : callable
        Returns the time of the clock, s.
    """

    def __init__(self, machine: Machine, time_scale: float, seed: int, now: Callable[[], float]) -> None:
        self.machine, self.scale, self._now = machine, time_scale, now
        self._rng = random.Random(seed)
        self._waiting: list[tuple[Fault, int]] = []
        self._lost_out = self._lost_in = self._garble = 0
        self._stalled_until = self._back_at = -math.inf

    @property
    def busy(self) -> bool:
        """Whether the controller moves, has output to send or waits for a fault."""
        return bool(self.machine.moving or self.machine.output or self._waiting)

    @property
    def plugged(self) -> bool:
        """Whether the line is connected."""
        return self._now() >= self._back_at

    def advance(self, seconds: float) -> None:
        """Advance by a number of seconds of the clock and execute the faults that become due."""
        seconds *= self.scale
        while seconds > 0.0:
            if not self.machine.moving:
                self.machine.advance(seconds)
                break
            self.machine.advance(min(seconds, _SLICE_S))
            seconds -= _SLICE_S
            self.fire()

    def receive(self, data: bytes) -> None:
        """Pass bytes from the line to the controller, except those that a fault drops."""
        for byte in data:
            if self._lost_in:
                self._lost_in -= 1
            else:
                self.machine.receive(byte)
        self.machine.advance(0.0)

    def send(self) -> bytes:
        """Return the controller's output with faults applied; it is held back in a stall and lost if disconnected."""
        output = self.machine.output
        if not self.plugged:
            output.clear()
        if not output or self._now() < self._stalled_until:
            return b""
        lost = min(self._lost_out, len(output))
        self._lost_out -= lost
        del output[:lost]
        data = bytes(output)
        output.clear()
        if self._garble and data.strip():
            data, self._garble = self._garbled(data), self._garble - 1
        return data

    def fire(self) -> None:
        """Execute the faults that are due."""
        progress = self.machine.progress if self._waiting else None
        due = [item for item in self._waiting if item[0].due(self.machine.lines - item[1], progress)]
        for item in due:
            self._waiting.remove(item)
            self._do(item[0])

    def ask_for(self, fault: str) -> None:
        """Add a fault, given as text, to those that wait to happen.

        Raises
        ------
        ValueError
            If there is no such fault.
        """
        self._waiting.append((parse_fault(fault), self.machine.lines))

    def answer(self, word: str, rest: str) -> dict:
        """Execute a command of the server and return its answer, with the key ``error`` if it is not understood."""
        if word == "fault":
            try:
                self.ask_for(rest)
            except ValueError as error:
                return {"error": str(error)}
            return {}
        if word == "clear":
            self._waiting.clear()
            self.machine.dropped_reports = 0
            self._lost_out = self._lost_in = self._garble = 0
            self._stalled_until, self._back_at = -math.inf, min(self._back_at, self._now())
            return {}
        if word == "pace":
            self.scale = float(rest)
            return {}
        if word == "power":
            self.machine.power_up()
            return {}
        if word == "forget":
            for stage in self.machine.stages:
                stage.low, stage.high = list(stage.position), list(stage.position)
            return {}
        if word == "state":
            return self._state()
        return {"error": f"no command {word!r}; commands: fault, clear, state, forget, pace, power, quit"}

    def _garbled(self, data: bytes) -> bytes:
        first, end, rest = data.lstrip().partition(b"\n")
        length = len(first.rstrip(b"\r"))
        for place in {0, *range(self._rng.randrange(3), length, 3)}:
            first = first[:place] + bytes([self._rng.randrange(128, 256)]) + first[place + 1 :]
        return first + end + rest

    def _do(self, fault: Fault) -> None:
        if fault.kind == "drop-output":
            self._lost_out += int(fault.value)
        elif fault.kind == "drop-input":
            self._lost_in += int(fault.value)
        elif fault.kind == "drop-report":
            self.machine.dropped_reports += int(fault.value)
        elif fault.kind == "garble":
            self._garble += 1
        elif fault.kind == "stall":
            self._stalled_until = self._now() + fault.value
        elif fault.kind == "hangup":
            self._back_at = self._now() + max(fault.value, _SHORTEST_HANGUP_S)
        elif fault.kind == "reset":
            self.machine.power_up()
        elif fault.kind == "hold":
            self.machine.press_hold()
        elif fault.kind == "slip":
            self.machine.slip(-fault.value)
        else:
            self.machine.raise_alarm(int(fault.value))

    def _state(self) -> dict:
        stages, names = self.machine.stages, self.machine.channels
        found = {"state": self.machine.state, "moving": self.machine.moving, "waiting_faults": len(self._waiting)}
        for key in ("position", "low", "high"):
            values = [value for stage in stages for value in getattr(stage, key)]
            found[key] = dict(zip(names, values, strict=True))
        return found


class Server:
    """Server that connects a simulated controller with faults to a pseudo-terminal.

    Parameters
    ----------
    faulty : FaultyMachine
        Controller, on the clock `time.monotonic`.
    link : path
        Symbolic link to the pseudo-terminal; its path stays the same if the line disconnects and returns.
    parent : int, optional
        Number of the parent process; the server ends with it.
    """

    def __init__(self, faulty: FaultyMachine, link, parent: int | None = None) -> None:
        self.faulty, self.link, self.parent = faulty, Path(link), parent
        self._master = self._slave = -1
        self._commands = b""
        self._plug()

    def run(self) -> None:
        """Serve until the command ``quit`` or the end of the parent process."""
        print(self.link, flush=True)
        last, inputs, going = time.monotonic(), [0], True
        while going and (self.parent is None or os.getppid() == self.parent):
            ready = self._wait(inputs)
            now = time.monotonic()
            self.faulty.advance(now - last)
            last = now
            if self._master in ready:
                self._take()
            if 0 in ready:
                going = self._obey(inputs)
            self.faulty.fire()
            self._give()

    def close(self) -> None:
        """Disconnect the line and remove the symbolic link."""
        self._unplug()

    def _wait(self, inputs: list[int]) -> list[int]:
        reading = inputs + ([self._master] if self._master >= 0 else [])
        return select.select(reading, [], [], _BUSY_WAIT_S if self.faulty.busy else _IDLE_WAIT_S)[0]

    def _take(self) -> None:
        """Read bytes from the pseudo-terminal and pass them to the controller."""
        with contextlib.suppress(OSError):  # nothing there after all
            self.faulty.receive(os.read(self._master, 4096))

    def _give(self) -> None:
        """Write the controller's output to the pseudo-terminal, and disconnect or reconnect the line if due."""
        data = self.faulty.send()
        if not self.faulty.plugged:
            self._unplug()
        elif self._master < 0:
            self._plug()
        if data and self._master >= 0:
            with contextlib.suppress(BlockingIOError):  # a UART does not wait for a reader either
                os.write(self._master, data)

    def _obey(self, inputs: list[int]) -> bool:
        """Answer the commands on standard input and return whether the server continues."""
        got = os.read(0, 4096)
        if not got:
            inputs.clear()
            return self.parent is None
        *lines, self._commands = (self._commands + got).split(b"\n")
        for line in lines:
            word, _, rest = line.decode("utf-8", "replace").strip().partition(" ")
            if word == "quit":
                return False
            print(json.dumps(self.faulty.answer(word, rest)), flush=True)
        return True

    def _plug(self) -> None:
        # The server keeps the driver's end open too: reading its own end fails if no process has opened the other.
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        new = self.link.with_name(self.link.name + ".new")
        new.unlink(missing_ok=True)
        new.symlink_to(os.ttyname(self._slave))
        new.replace(self.link)

    def _unplug(self) -> None:
        if self._master >= 0:
            self.link.unlink(missing_ok=True)
            os.close(self._master)
            os.close(self._slave)
            self._master = self._slave = -1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments that all simulators have in common."""
    parser.add_argument("--time-scale", type=float, default=1.0, help="simulated seconds in a real one")
    parser.add_argument("--seed", type=int, default=0, help="start of the random numbers")
    parser.add_argument("--link", help="symbolic link to make to the pseudo-terminal; a temporary one where absent")
    parser.add_argument("--parent", type=int, help="process with which the simulator ends")
    parser.add_argument("--fault", action="append", default=[], help="fault to begin with, such as 'move 0.5 reset'")


def serve(machine: Machine, arguments: argparse.Namespace) -> None:
    """Serve a simulated controller until the command ``quit``, an interrupt or the end of the parent process."""
    if not (0.0 < arguments.time_scale < math.inf):
        raise SystemExit(f"--time-scale {arguments.time_scale:g}: accepted: a number above 0")
    with tempfile.TemporaryDirectory(prefix="irodori-") as folder:
        faulty = FaultyMachine(machine, arguments.time_scale, arguments.seed, time.monotonic)
        server = Server(faulty, arguments.link or Path(folder) / "port", arguments.parent)
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
        try:
            for text in arguments.fault:
                faulty.ask_for(text)
            server.run()
        except ValueError as error:
            raise SystemExit(str(error)) from None
        except KeyboardInterrupt:
            pass
        finally:
            server.close()
