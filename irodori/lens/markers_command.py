"""The subcommand ``markers``: write the sheet with markers on which an object is photographed."""

import argparse
import sys

from irodori.core.errors import PlainError
from irodori.lens.opencv import need_opencv

_PAPERS = ("A3", "A4", "A5", "A6", "letter")


def main(arguments: list[str] | None = None, prog: str = "irodori markers") -> int:
    """Write a sheet with printed markers that tells where camera and table stood in the photographs of an object.

    Take a paper whose chessboard is in the frame of the photographs, and whose black middle is larger than the object.
    Print it at its full size, glue it to something flat, lay it on the table and put the object on it. It must not move
    on the table between the photographs. Then state it as markers in the object's definition. The exit status is 2 if
    nothing was written.
    """
    parser = argparse.ArgumentParser(prog=prog, description=main.__doc__)
    parser.add_argument("sheet", metavar="FILE.pdf", help="file to write")
    parser.add_argument("--paper", choices=_PAPERS, default="A4", help="size of the paper (%(default)s)")
    asked = parser.parse_args(arguments)
    try:
        need_opencv("irodori markers")
        from irodori.lens.printed_sheets import OBJECT_SHEET

        OBJECT_SHEET.write(asked.sheet, asked.paper)
    except PlainError as error:
        print(error, file=sys.stderr)
        return 2
    count, square_mm = OBJECT_SHEET.columns, OBJECT_SHEET.papers_mm[asked.paper][2]
    print(
        f"{asked.sheet}: print it at its full size and measure it: {count} squares of {square_mm:g} mm are "
        f"{count * square_mm:g} mm long. If yours are not, state markers.square_mm"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
