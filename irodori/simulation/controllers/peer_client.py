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
    """Handle of a running simulator process.

    Parameters
    ----------
    process : subprocess.Popen
        Process with pipes as its standard input and output.
    port : str
        Path of its serial port.
    """

    def __init__(self, process: subprocess.Popen, port: str) -> None:
        assert process.stdin is not None and process.stdout is not None
        self.process, self.port = process, port
        self._commands, self._answers = process.stdin, process.stdout
        self._lock, self._buffer = threading.Lock(), b""

    def fault(self, text: str) -> None:
        """Inject a fault, given as text; see `irodori.simulation.controllers.line_faults`.

        Raises
        ------
        ValueError
            If there is no such fault.
        """
        self._ask(f"fault {text}")

    def clear(self) -> None:
        """Discard faults that have not happened yet, end a stall and reconnect the line."""
        self._ask("clear")

    def power(self) -> None:
        """Switch the controller off and on; the axes stay in place."""
        self._ask("power")

    def pace(self, time_scale: float) -> None:
        """Set the number of simulated seconds per real second, above 0."""
        if not 0.0 < time_scale < math.inf:
            raise ValueError(f"time_scale {time_scale:g}: accepted: a number above 0")
        self._ask(f"pace {time_scale!r}")

    def forget(self) -> None:
        """Reset the extreme positions of `snapshot` to the present position."""
        self._ask("forget")

    def snapshot(self) -> dict:
        """Return ``state``, ``moving``, and for each channel ``position``, ``low`` and ``high``, controller units.

        Positions are the true ones of the mechanics, not those that the controller has counted; ``low`` and ``high``
        are the extremes since the last `forget`.
        """
        return self._ask("state")

    def true_position(self) -> dict[str, float]:
        """Return the true position of each channel, controller units."""
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
        """Return the next line of the process's standard output.

        Raises
        ------
        DeviceError
            If no line arrives within ``seconds``, or the process has ended.
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
    """Start a simulator's module as a process that ends with this process and with the ``with`` block.

    Parameters
    ----------
    module : str
        Name of the module, such as ``irodori.simulation.controllers.grbl_simulator``.
    arguments : sequence of str
        Command-line arguments of the module.
    """
    with tempfile.TemporaryDirectory(prefix="irodori-") as folder:
        command = [sys.executable, "-m", module, "--parent", str(os.getpid()), "--link", f"{folder}/port", *arguments]
        # A session of its own: Ctrl-C at the terminal must reach only the driver, as with a real controller.
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=_ROOT, start_new_session=True
        )
        simulator = Simulator(process, "")
        try:
            simulator.port = simulator.read_line(_START_S)
            yield simulator
        finally:
            simulator.close()
