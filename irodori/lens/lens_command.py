"""The subcommand ``lens``: measure the block ``optics`` of a camera file from photographs of a printed sheet."""

import argparse
import sys
from pathlib import Path

import yaml

from irodori.core.errors import PlainError
from irodori.first_project.raw_folder import raw_files
from irodori.lens.opencv import need_opencv

_PAPERS = ("A4", "A3", "letter")


def main(arguments: list[str] | None = None, prog: str = "irodori lens") -> int:
    """Measure focal length, principal point and distortion of a lens from RAW photographs of a printed sheet.

    Print the sheet with --print, glue it to something flat, and take ten to twenty photographs of it with the focus and
    zoom of the object's photographs: close enough to fill the picture, tilted to all sides, and reaching into all
    corners. The block that is printed replaces optics in the camera's file. The size of the printed squares does not
    matter. The exit status is 2 if nothing was measured.
    """
    parser = argparse.ArgumentParser(prog=prog, description=main.__doc__)
    parser.add_argument("photographs", nargs="?", help="folder of the RAW photographs of the sheet")
    parser.add_argument(
        "--print", dest="sheet", metavar="FILE.pdf", help="write the sheet to print, and do nothing else"
    )
    parser.add_argument("--paper", choices=_PAPERS, default="A4", help="size of the sheet's paper (%(default)s)")
    parser.add_argument(
        "--pixel-pitch-um",
        type=float,
        help="distance of the sensor's pixels, micrometres, where the files do not state it",
    )
    asked = parser.parse_args(arguments)
    if (asked.photographs is None) == (asked.sheet is None):
        parser.error("give a folder of photographs, or --print FILE.pdf")
    try:
        need_opencv("irodori lens")
        if asked.sheet:
            from irodori.lens.printed_sheets import LENS_SHEET

            LENS_SHEET.write(asked.sheet, asked.paper)
            print(f"{asked.sheet}: print it at its full size; the squares may come out somewhat larger or smaller")
            return 0
        _measure(Path(asked.photographs), asked.pixel_pitch_um)
    except PlainError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _measure(folder: Path, pitch_um: float | None) -> None:
    """Print the optics of a lens, and their accuracy to the standard error stream."""
    from irodori.lens.stage import measure_lens

    found = measure_lens([(path, False) for path in raw_files(folder)], folder, pitch_um)
    for line in found.remarks:
        print(line, file=sys.stderr)
    print(yaml.safe_dump({"optics": found.optics}, sort_keys=False), end="")


if __name__ == "__main__":
    sys.exit(main())
