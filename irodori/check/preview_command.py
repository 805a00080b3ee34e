"""The subcommand ``preview``: one page that shows every photograph of a project before any long job."""

import argparse
import sys
from itertools import chain
from pathlib import Path

from irodori.check.angles import of_object
from irodori.check.contact_sheet import ContactSheet
from irodori.check.findings import Finding
from irodori.check.photographs import PhotographCheck
from irodori.check.scenes import of_scene
from irodori.config.models import Optics
from irodori.config.project import inside, load_project
from irodori.core.errors import InputError, counted


def main(arguments: list[str] | None = None, prog: str = "irodori preview") -> int:
    """Write an HTML page with all photographs of a project at small size, each beside its errors and warnings.

    Drawn over each photograph are the outline of the object in the pose that the table states, the patches of a chart,
    the corners that were found of a printed sheet, and marks on overexposed (red) and dark (blue) parts. Photographs
    that are still to be taken are skipped. The exit status is 1 if there is an error.
    """
    parser = argparse.ArgumentParser(prog=prog, description=main.__doc__)
    parser.add_argument("--directory", default=".", help="where all paths start, those of configurations too")
    parser.add_argument(
        "--configfile", nargs="+", default=[], help="configurations on top of config/config.yaml, as snakemake has them"
    )
    parser.add_argument("-o", "--output", default="contact_sheet.html", help="page to write (contact_sheet.html)")
    asked = parser.parse_args(arguments)
    output = Path(asked.output).absolute()
    try:
        with inside(asked.directory):
            return _preview(asked.configfile, output)
    except InputError as error:
        print(Finding(True, str(error)))
        return 1


def _preview(files: list[str], output: Path) -> int:
    """Write the page of the project in the working directory; return the exit status."""
    if not output.parent.is_dir():
        raise InputError(output, "", "a folder that is not there", "a page in a folder that exists")
    loaded = load_project(files)
    optics: dict[str, Optics] = {}
    sheet = ContactSheet(loaded, optics)
    check = PhotographCheck(loaded, sheet.add, optics)
    scenes = (finding for name in loaded.scenes for finding in of_scene(loaded, name))
    angles = (finding for name in loaded.objects for finding in of_object(loaded, name))
    findings = list(chain(scenes, angles, check.findings()))
    sheet.write(output, findings, check.located)
    errors = sum(finding.is_error for finding in findings)
    warnings = len(findings) - errors
    looked = counted(check.count, "photograph")
    print(f"{output}: {looked} looked at: {counted(errors, 'error')}, {counted(warnings, 'warning')}")
    print("Whether each outline fits its object is for you to see on the page.")
    return 1 if errors else 0


if __name__ == "__main__":
    sys.exit(main())
