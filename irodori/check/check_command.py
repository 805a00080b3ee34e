"""The subcommand ``check``: all checks of a project that are possible before any long job."""

import argparse
import sys
from itertools import chain

from irodori.check.angles import of_object
from irodori.check.findings import Finding
from irodori.check.photographs import PhotographCheck
from irodori.check.scenes import of_scene
from irodori.config.project import DEFAULT_FILE, inside, load_project, project_faults
from irodori.core.errors import InputError, counted


def main(arguments: list[str] | None = None, prog: str = "irodori check") -> int:
    """Check definitions, scenes and photographs, print all errors and warnings, and write no file.

    Photographs that are still to be taken, such as those of the virtual rig, are skipped. The exit status is 1 if there
    is an error, and 0 if there are only warnings or none.
    """
    parser = argparse.ArgumentParser(prog=prog, description=main.__doc__)
    parser.add_argument("--directory", default=".", help="where all paths start, those of configurations too")
    parser.add_argument(
        "config", nargs="*", help=f"configurations on top of {DEFAULT_FILE}, as snakemake --configfile has them"
    )
    asked = parser.parse_args(arguments)
    try:
        with inside(asked.directory):
            return _check(asked.config)
    except InputError as error:
        print(Finding(True, str(error)))
        return 1


def _check(files: list[str]) -> int:
    """Print what is found of the project in the working directory; return the exit status."""
    try:
        loaded = load_project(files)
    except InputError as error:
        faults = project_faults(files) or [error]
        for fault in faults:
            print(Finding(True, str(fault)))
        # Photographs are checked only if the definitions state correctly what they should show.
        print(f"{counted(len(faults), 'error')}; no photograph was looked at")
        return 1
    photographs, errors, warnings = PhotographCheck(loaded), 0, 0
    scenes = (finding for name in loaded.scenes for finding in of_scene(loaded, name))
    angles = (finding for name in loaded.objects for finding in of_object(loaded, name))
    for finding in chain(scenes, angles, photographs.findings()):
        print(finding, flush=True)
        errors, warnings = errors + finding.is_error, warnings + (not finding.is_error)
    looked = counted(photographs.count, "photograph")
    print(f"{looked} looked at: {counted(errors, 'error')}, {counted(warnings, 'warning')}")
    return 1 if errors else 0


if __name__ == "__main__":
    sys.exit(main())
