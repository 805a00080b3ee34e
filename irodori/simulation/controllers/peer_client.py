"""Handle of a running simulator: its port, its faults, and the true axis positions."""

import json
import math
import os
import select
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from irodori.capture.rig.deadline import Deadline
from irodori.capture.rig.devices import DeviceError

# Long: on a host that others share a start takes many seconds. A process that has ended is noticed at once.
_START_S, _ANSWER_S, _END_S = 300.0, 60.0, 2.0
_ROOT = Path(__file__).resolve().parents[3]


class Simulator:
    """A running simulator.

    Parameters
    ----------
    process : subprocess.Popen
        With pipes as its standard input and output.
    port : str
        Path of its serial port.
    """

    def __init__(self, process: subprocess.Popen, port: str) -> None:
        assert process.stdin is not None and process.stdout is not None
        self.process, self.port = process, port
        self._commands, self._answers = process.stdin, process.stdout
        self._lock, self._buffer = threading.Lock(), b""

    def fault(self, text: str) -> None:
        """Ask for a fault; see `irodori.simulation.controllers.line_faults`.

        Raises
        ------
        ValueError
            If there is no such fault.
        """
        self._ask(f"fault {text}")

    def clear(self) -> None:
        """Forget the faults that have not happened, end a stall, bring a line back that is hung up."""
        self._ask("clear")

    def power(self) -> None:
        """Switch the controller off and on; the axes stay where they stand."""
        self._ask("power")

    def pace(self, time_scale: float) -> None:
        """Change how many simulated seconds pass in a real one, above 0."""
        if not 0.0 < time_scale < math.inf:
            raise ValueError(f"time_scale {time_scale:g}: accepted: a number above 0")
        self._ask(f"pace {time_scale!r}")

    def forget(self) -> None:
        """Start the extremes of `snapshot` anew."""
        self._ask("forget")

    def snapshot(self) -> dict:
        """Return ``state``, ``moving``, and by channel in controller units ``position``, ``low`` and ``high``.

        The position is the true one: that of the mechanics, whatever the controller believes.
        """
        return self._ask("state")

    def true_position(self) -> dict[str, float]:
        """Return where each channel truly stands, controller units."""
        return self.snapshot()["position"]

    def close(self) -> None:
        """End the process."""
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(_END_S)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self._commands.close()
        self._answers.close()

    def read_line(self, seconds: float) -> str:
        """Return the next line of the process.

        Raises
        ------
        DeviceError
            If none comes in time.
        """
        deadline = Deadline(seconds)
        while b"\n" not in self._buffer:
            ready = select.select([self._answers], [], [], deadline.remaining_s)[0]
            got = os.read(self._answers.fileno(), 4096) if ready else b""
            if not got:
                raise DeviceError("the simulator has ended" if ready else "the simulator does not answer")
            self._buffer += got
        line, _, self._buffer = self._buffer.partition(b"\n")
        return line.decode()

    def _ask(self, command: str) -> dict:
        with self._lock:
            try:
                self._commands.write(command.encode() + b"\n")
                self._commands.flush()
            except (OSError, ValueError):
                raise DeviceError("the simulator has ended") from None
            answer = json.loads(self.read_line(_ANSWER_S))
        if "error" in answer:
            raise ValueError(answer["error"])
        return answer


@contextmanager
def run_simulator(module: str, arguments: Sequence[str]) -> Iterator[Simulator]:
    """Start a simulator's module as a process that ends with this one, and with the block.

    Parameters
    ----------
    module : str
        Such as ``irodori.simulation.controllers.grbl_simulator``.
    arguments : sequence of str
        Its command line.
    """
    with tempfile.TemporaryDirectory(prefix="irodori-") as folder:
        command = [sys.executable, "-m", module, "--parent", str(os.getpid()), "--link", f"{folder}/port", *arguments]
        # Its own session: Ctrl-C at the terminal is for the driver, as it would be with a controller on a cable.
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=_ROOT, start_new_session=True
        )
        simulator = Simulator(process, "")
        try:
            simulator.port = simulator.read_line(_START_S)
            yield simulator
        finally:
            simulator.close()
