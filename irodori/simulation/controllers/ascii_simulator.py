"""Simulator of a text-protocol motion controller on a pseudo-terminal.

``python -m irodori.simulation.controllers.ascii_simulator RIG.yaml``.

It accepts commands that match the templates of the rig's description and answers with its ``simulated_replies``. The
commands on its standard input are listed in `irodori.simulation.controllers.peer_server`.
"""

import argparse
import json
import math
import random
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager

from irodori.capture.rig.ascii_description import COMMANDS, OPTIONAL, Description, template_pattern
from irodori.capture.rig.drives import Drive, drives_of
from irodori.config.models import Rig
from irodori.simulation.controllers.peer_client import Simulator, run_simulator
from irodori.simulation.controllers.peer_server import Machine, add_arguments, serve
from irodori.simulation.controllers.trapezoidal_motion import Block, Stage

__all__ = ["Simulator", "simulate"]

_LINE_BYTES = 256
_MODULE = "irodori.simulation.controllers.ascii_simulator"


class AsciiMachine(Machine):
    """Simulated controller and mechanics; axes move independently of each other, and homing moves them to position 0.

    Parameters
    ----------
    drives : dict
        Angle -> drive.
    description : Description
    replies : dict
        Name of a reply -> template with ``axis``, ``position``, ``state`` and ``message``.
    seed : int
        Seed of the initial positions and of all other random numbers.
    homing_rms : float
        Repeatability of the switches, standard deviation, units.
    """

    def __init__(
        self,
        drives: Mapping[str, Drive],
        description: Description,
        replies: Mapping[str, str],
        seed: int = 0,
        homing_rms: float = 0.0,
    ) -> None:
        super().__init__()
        self._drives = {drive.channel: drive for drive in drives.values()}
        self.channels, self._words, self._replies = tuple(self._drives), description, replies
        self._patterns = {name: template_pattern(text) for name, text in description.commands.items()}
        self._rng, self._homing_rms = random.Random(seed), homing_rms
        self.stages = tuple(Stage([self._rng.uniform(*drive.reach)]) for drive in self._drives.values())
        self.power_up()

    def power_up(self) -> None:
        """Start with a position count of zero, wherever the axes stand."""
        for stage in self.stages:
            stage.clear()
        self._origin = {name: stage.position[0] for name, stage in self._named()}
        self._line, self._alarm, self._held = b"", False, False
        self._homing: set[str] = set()

    def press_hold(self) -> None:
        """Decelerate the axes to rest; they continue after ``resume``."""
        if not self._alarm:
            self._held = True
            for stage in self.stages:
                stage.holding = bool(stage.blocks)

    def slip(self, by: float, axis: int = 0) -> None:
        """Lose steps of an axis; see `Machine.slip`."""
        self.stages[axis].slip(0, by)
        self._origin[self.channels[axis]] += by

    def raise_alarm(self, code: int) -> None:
        """Stop at once, and stay in alarm until homed if the rig's description has a word for an alarm."""
        for name, stage in self._named():
            if stage.speed:
                self._origin[name] += self._rng.uniform(-0.3, 0.3)
            stage.clear()
        self._alarm, self._held, self._homing = bool(self._words.alarm), False, set()

    @property
    def state(self) -> str:
        """State of the controller: ``alarm``, ``run``, ``hold`` or ``idle``."""
        return "alarm" if self._alarm else "run" if self.moving else "hold" if self._held else "idle"

    def receive(self, byte: int) -> None:
        """Receive a byte; execute the line when its end has arrived."""
        self._line = (self._line + bytes([byte]))[-_LINE_BYTES:]
        if self._line.endswith(self._words.line_end):
            line = self._line.removesuffix(self._words.line_end).strip(b"\r\n")
            self._line = b""
            self.lines += 1
            self._obey(line.decode("ascii", "replace"))

    def advance(self, seconds: float) -> None:
        """Advance simulated time by a number of seconds."""
        for name, stage in self._named():
            stage.advance(seconds)
            if stage.holding and not stage.moving and not self._held:
                stage.clear()
            if name in self._homing and not stage.blocks:
                self._homing.discard(name)
                self._origin[name] = stage.position[0]

    def _named(self):
        return zip(self.channels, self.stages, strict=True)

    def _obey(self, line: str) -> None:
        for command in (*COMMANDS, *OPTIONAL):
            if command not in self._patterns:
                continue
            found = self._patterns[command].fullmatch(line)
            if found and found.groupdict().get("axis", self.channels[0]) in self.channels:
                self._do(command, found.groupdict())
                return
        self._say("refused", message="unknown command")

    def _do(self, command: str, given: dict) -> None:
        names = [given["axis"]] if "axis" in given else list(self.channels)
        if command == "stop":
            for stage in self.stages:
                stage.holding = bool(stage.blocks)
            self._homing, self._held = set(), False
        elif command == "resume":
            if not self._held or self.moving:
                self._say("refused", message="not held")
                return
            self._held = False
            for stage in self.stages:
                stage.holding = False
        elif command == "home":
            self._alarm = self._held = False
            for name in names:
                self._push(name, self._rng.gauss(0.0, self._homing_rms) if self._homing_rms else 0.0)
                self._homing.add(name)
        elif command == "move":
            low, high = self._drives[names[0]].reach
            target = float(given["target"])
            if self._alarm or self._held or not low - 1e-6 <= target <= high + 1e-6:
                why = "in alarm" if self._alarm else "held" if self._held else "out of range"
                self._say("refused", message=why)
                return
            self._push(names[0], target + self._origin[names[0]])
        elif command == "position":
            place = dict(self._named())[names[0]].position[0] - self._origin[names[0]]
            self._say("position", axis=names[0], position=round(place, 6))
            return
        else:
            self._say("status", axis=names[0], state=self._word(names))
            return
        self._say("accepted")

    def _word(self, names: list[str]) -> str:
        stages = dict(self._named())
        if self._alarm:
            return self._words.alarm[0]
        if any(stages[name].moving for name in names):
            return self._words.busy[0]
        if self._held:  # a controller without a word for hold reports that it is busy
            return (self._words.hold or self._words.busy)[0]
        return self._words.idle[0]

    def _push(self, name: str, end: float) -> None:
        stage, drive = dict(self._named())[name], self._drives[name]
        stage.clear()
        if math.fabs(end - stage.position[0]) > 1e-9:
            stage.push(Block([end], drive.speed, drive.acceleration))

    def _say(self, reply: str, **values) -> None:
        template = self._replies.get(reply) or self._replies["accepted"]
        self.output += template.format(**values).encode("ascii") + self._words.line_end


def simulate(
    rig: Rig, *, time_scale: float = 1.0, seed: int = 0, homing_rms: float = 0.0, faults: Sequence[str] = ()
) -> AbstractContextManager[Simulator]:
    """Start the simulator as a process that ends with this process and with the ``with`` block.

    Parameters
    ----------
    rig : Rig
        Definition of a rig whose ``motion`` has the block ``ascii``.
    time_scale, seed, homing_rms, faults
        See `irodori.simulation.controllers.grbl_simulator.simulate`.
    """
    described = json.dumps(rig.plain())
    arguments = [described, "--time-scale", repr(time_scale), "--seed", str(seed), "--homing-rms", repr(homing_rms)]
    for fault in faults:
        arguments += ["--fault", fault]
    return run_simulator(_MODULE, arguments)


def main(arguments: Sequence[str] | None = None, prog: str = f"python -m {_MODULE}") -> None:
    """Run the simulator from the command line."""
    parser = argparse.ArgumentParser(prog=prog, description=__doc__)
    parser.add_argument("rig", help="the rig's file, or the same as JSON")
    parser.add_argument("--homing-rms", type=float, default=0.0, help="repeatability of the switches, units")
    add_arguments(parser)
    given = parser.parse_args(arguments)
    if given.rig.lstrip().startswith("{"):
        rig = json.loads(given.rig)
    else:
        from irodori.config.definitions import read_yaml
        from irodori.config.validation import validate

        rig = validate(read_yaml(given.rig), "rig", given.rig)
    rig = Rig.of(rig)
    block = rig.motion.ascii if rig.motion else None
    if block is None:
        parser.error("the rig's file has no block motion.ascii, which describes its controller")
    description = Description.of(block)
    machine = AsciiMachine(drives_of(rig), description, block.simulated_replies.plain(), given.seed, given.homing_rms)
    serve(machine, given)


if __name__ == "__main__":
    main()
