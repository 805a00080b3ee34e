"""Simulator of a Grbl 1.1 controller on a pseudo-terminal.

``python -m irodori.simulation.controllers.grbl_simulator`` prints its port.

The commands on its standard input are listed in `irodori.simulation.controllers.peer_server`.
"""

import argparse
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager

from irodori.capture.rig.grbl.codes import SETTINGS
from irodori.capture.rig.grbl.protocol import FIRMWARES
from irodori.simulation.controllers.grbl_machine import GrblMachine
from irodori.simulation.controllers.peer_client import Simulator, run_simulator
from irodori.simulation.controllers.peer_server import add_arguments, serve

__all__ = ["Simulator", "simulate"]

_MODULE = "irodori.simulation.controllers.grbl_simulator"


def simulate(
    settings: Mapping[int, float] | None = None,
    *,
    time_scale: float = 1.0,
    seed: int = 0,
    homing_rms: float = 0.0,
    faults: Sequence[str] = (),
    firmware: str = FIRMWARES[0],
) -> AbstractContextManager[Simulator]:
    """Start the simulator as a process that ends with this process and with the ``with`` block.

    Parameters
    ----------
    settings : dict, optional
        ``$`` settings of Grbl that differ from those of `irodori.simulation.controllers.grbl_machine.DEFAULTS`.
    time_scale : float
        Simulated seconds per real second.
    seed : int
        Seed of the initial positions and of all other random numbers.
    homing_rms : float
        Repeatability of the limit switches, standard deviation, controller units.
    faults : sequence of str
        Faults at the start, see `irodori.simulation.controllers.line_faults`.
    firmware : str
        One of `irodori.capture.rig.grbl.protocol.FIRMWARES`.

    Returns
    -------
    context manager of Simulator
        Its ``port`` is the path of the serial port for a driver.
    """
    arguments = ["--time-scale", repr(time_scale), "--seed", str(seed), "--homing-rms", repr(homing_rms)]
    arguments += ["--firmware", firmware]
    for number, value in (settings or {}).items():
        arguments += ["--setting", f"{number}={value!r}"]
    for fault in faults:
        arguments += ["--fault", fault]
    return run_simulator(_MODULE, arguments)


def _setting(text: str) -> tuple[int, float]:
    number, _, value = text.partition("=")
    if not number.isdigit() or int(number) not in SETTINGS:
        raise argparse.ArgumentTypeError(f"{text!r} is no NUMBER=VALUE of a Grbl setting")
    return int(number), float(value)


def main(arguments: Sequence[str] | None = None, prog: str = f"python -m {_MODULE}") -> None:
    """Run the simulator from the command line."""
    parser = argparse.ArgumentParser(prog=prog, description=__doc__)
    add_arguments(parser)
    parser.add_argument("--setting", action="append", type=_setting, default=[], help="Grbl setting, such as 130=140")
    parser.add_argument("--firmware", choices=FIRMWARES, default=FIRMWARES[0], help="whose language it speaks")
    parser.add_argument("--homing-rms", type=float, default=0.0, help="repeatability of the switches, units")
    given = parser.parse_args(arguments)
    serve(
        GrblMachine(dict(given.setting), seed=given.seed, homing_rms=given.homing_rms, firmware=given.firmware), given
    )


if __name__ == "__main__":
    main()
