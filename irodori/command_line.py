"""The command ``irodori`` and its subcommands.

``irodori --help`` lists them. A subcommand's module is imported only when that subcommand runs, so that the help
appears at once, and a computer without a camera does not need the camera's library.
"""

import argparse
import importlib
import os
import select
import signal
import sys
from collections.abc import Callable, Sequence
from typing import NamedTuple

from irodori import __version__

_BENCH = "irodori.capture.command"


class Subcommand(NamedTuple):
    """Subcommand: the module that has its function ``main(arguments, prog)``, and its line of help.

    Parameters
    ----------
    module : str
        Dotted name of the module.
    help : str
        One line for the list of subcommands.
    """

    module: str
    help: str


SUBCOMMANDS = {
    "init": Subcommand("irodori.first_project.init_command", "write a project's files from a folder of photographs"),
    "lights": Subcommand("irodori.first_project.lights_command", "find where lamps stood by their images on a ball"),
    "dome": Subcommand("irodori.first_project.dome_command", "measure a ball from photographs under several lamps"),
    "check": Subcommand(
        "irodori.check.check_command", "look at definitions, scenes and photographs before any long job"
    ),
    "preview": Subcommand("irodori.check.preview_command", "show all photographs on one page, with what is wrong"),
    "status": Subcommand(_BENCH, "print the position of a rig's axes and the state of its controller"),
    "setup": Subcommand(_BENCH, "list, and change, settings of a controller that contradict its rig's file"),
    "home": Subcommand(_BENCH, "move every axis of a rig to its reference position"),
    "recount": Subcommand(_BENCH, "home a rig, and say what its axes have lost in steps"),
    "move": Subcommand(_BENCH, "move axes of a rig to angles"),
    "jog": Subcommand(_BENCH, "move axes of a rig by a small angle"),
    "shoot": Subcommand(_BENCH, "take one photograph"),
    "plan": Subcommand(_BENCH, "list the photographs of a session, or choose the most informative poses"),
    "capture": Subcommand(_BENCH, "start or continue a session: take the photographs that are missing"),
    "export": Subcommand("irodori.export.export_command", "write a scene, an object or a light for other programs"),
    "viewer": Subcommand("irodori.viewer.viewer_command", "write a scene's classroom page, or print what one holds"),
    "crate": Subcommand("irodori.export.crate_command", "describe a finished run as a Workflow Run RO-Crate"),
    "filters": Subcommand("irodori.calibration.filters", "rank filters for the second shot of a camera"),
    "lens": Subcommand("irodori.lens.lens_command", "measure a lens from photographs of a printed sheet"),
    "markers": Subcommand("irodori.lens.markers_command", "write a sheet to print, on which an object is photographed"),
    "verify": Subcommand("irodori.core.custody", "compare every result with its hash and with what it was made from"),
    "simulate-grbl": Subcommand("irodori.simulation.controllers.grbl_simulator", "simulate a Grbl motion controller"),
    "simulate-ascii": Subcommand(
        "irodori.simulation.controllers.ascii_simulator", "simulate a controller with a text protocol of its own"
    ),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a subcommand and return its exit status.

    Parameters
    ----------
    arguments : sequence of str
        Name of the subcommand and its arguments; those of the process if None.

    Returns
    -------
    int
        0 after success; 141, as of programs that the signal SIGPIPE ends, if whoever read the output, such as `head`,
        has gone.

    Raises
    ------
    SystemExit
        After ``--help`` and ``--version``, and with status 2 for arguments that are not accepted.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    return ended_quietly(lambda: _run(given))


def ended_quietly(command: Callable[[], int]) -> int:
    """Run a command and return its exit status, or 141 if whoever read its output has gone.

    The output is written out first. A process that was started without one, such as a daemon, has none.
    """
    try:
        try:
            return command()
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()
    except BrokenPipeError:
        # The signal itself stays ignored: it would also end a session whose controller has gone, without its clean-up.
        if sys.stdout is None or not _is_unread(sys.stdout.fileno()):
            raise
        with open(os.devnull, "w") as nowhere:  # what is left of the output, when Python ends
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
        return 128 + signal.SIGPIPE


def _is_unread(descriptor: int) -> bool:
    """Return whether the reader of a pipe has gone."""
    poll = select.poll()
    poll.register(descriptor, 0)
    return any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))


def _run(arguments: list[str]) -> int:
    """Run a subcommand with its arguments and return its exit status."""
    if not arguments or arguments[0] not in SUBCOMMANDS:
        _parser().parse_args(arguments[:1])  # help, version or an error: it never returns
    name, *rest = arguments
    subcommand = SUBCOMMANDS[name]
    module = importlib.import_module(subcommand.module)
    if subcommand.module == _BENCH:  # which has subcommands of its own
        return module.main(arguments, prog="irodori") or 0
    return module.main(rest, prog=f"irodori {name}") or 0


def _parser() -> argparse.ArgumentParser:
    width = max(map(len, SUBCOMMANDS))
    listed = "\n".join(f"  {name:{width}}  {subcommand.help}" for name, subcommand in SUBCOMMANDS.items())
    parser = argparse.ArgumentParser(
        prog="irodori",
        usage="irodori [--help] [--version] SUBCOMMAND ...",
        description="Tools around the Irodori workflow; the workflow itself is run by snakemake.",
        epilog=f"subcommands:\n{listed}\n\n'irodori SUBCOMMAND --help' explains one of them.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    parser.add_argument("subcommand", choices=SUBCOMMANDS, metavar="SUBCOMMAND", help="one of those below")
    return parser
