"""The subcommand ``lights``: directions to lamps from their mirror images on a polished ball."""

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from irodori.config.capture_table import light_angles_deg
from irodori.core.errors import InputError, counted
from irodori.first_project.mirror_highlights import brightness, lamp_direction, outline, write_light_places
from irodori.first_project.photograph_order import ORDERS, in_counting_order, in_order
from irodori.geometry.circle_search import Circle, circle_of_mask
from irodori.ingest.plausibility import camera_time


def main(arguments: list[str] | None = None, prog: str = "irodori lights") -> int:
    """Find the direction to the lamp of each photograph by its mirror image on a polished ball.

    The directions are printed and written to a light-position file (.lp), which the commands init and dome read. The
    camera must not have moved. It counts as far away: from 60 radii of the ball a direction is off by 1 degree at most.
    The exit status is 2 if nothing was written.
    """
    parser = argparse.ArgumentParser(prog=prog, description=main.__doc__)
    parser.add_argument("photographs", nargs="+", help="photographs of the ball, one lamp in each; RAW, TIFF or PNG")
    parser.add_argument("--into", default="lights.lp", help="light-position file to write (lights.lp)")
    add_outline(parser)
    add_names(parser, "in the file")
    asked = parser.parse_args(arguments)
    try:
        return _write(asked)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2


def add_outline(parser: argparse.ArgumentParser) -> None:
    """Add the command-line options ``--mask`` and ``--circle``, which state the outline of the ball."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--mask", help="picture of the same size that is bright on the ball and black elsewhere")
    where.add_argument(
        "--circle", nargs=3, type=float, metavar=("X", "Y", "RADIUS"), help="outline of the ball, pixels"
    )


def add_names(parser: argparse.ArgumentParser, where: str) -> None:
    """Add ``--names``, photographs whose names are listed in place of those of the ball, and ``--order`` for both."""
    names = f"photographs of the object under the same lamps in the same order, whose names are to be listed {where}"
    parser.add_argument("--names", nargs="+", metavar="PHOTOGRAPH", help=names)
    order = "with --names: right order of photographs where the camera's clock and file names contradict each other"
    parser.add_argument("--order", choices=ORDERS, default="", help=order)


def paired(asked: argparse.Namespace) -> tuple[list[Path], list[str]]:
    """Return the photographs of the ball, and for each the name to list: its own, or that of ``--names``.

    With ``--names``, both are in the order in which they were taken, else in counting order.

    Raises
    ------
    InputError
        If there are not as many names as photographs of the ball, or it cannot be told in which order they were taken.
    """
    files = [Path(name) for name in in_counting_order(asked.photographs) if not is_mask(name, asked)]
    if not asked.names:
        return files, [file.name for file in files]
    if len(asked.names) != len(files):
        found = f"{counted(len(files), 'photograph')} of the ball and {counted(len(asked.names), 'name')}"
        raise InputError("--names", "", found, "one name for each photograph")
    both = _times(files), _times(map(Path, asked.names))
    some_state_it = any(any(times.values()) for times in both)

    def in_turn(times: dict[Path, str]) -> list[Path]:
        # The clock may be asked for where the photographs of one of the two state no time.
        is_silent = some_state_it and not any(times.values())
        return in_order(times, "" if asked.order == "clock" and is_silent else asked.order)[0]

    return in_turn(both[0]), [path.name for path in in_turn(both[1])]


def _times(paths: Iterable[Path]) -> dict[Path, str]:
    """Return the times of photographs; those that are not at hand have none.

    Raises
    ------
    InputError
        If a photograph is listed twice or cannot be read.
    """
    times: dict[Path, str] = {}
    for path in paths:
        if path in times:
            raise InputError(path, "", "a photograph that is listed twice", "each photograph once")
        try:
            times[path] = camera_time(path) if path.is_file() else ""
        except OSError as error:
            raise InputError(path, "", f"a file that cannot be read ({error.strerror})", "a photograph") from None
    return times


def _write(asked: argparse.Namespace) -> int:
    files, listed = paired(asked)
    pictures = [brightness(file) for file in files]
    same_size(files, pictures)
    circle = asked_circle(asked, pictures, files[0])
    print(f"ball about {circle.x:.1f}, {circle.y:.1f}, radius {circle.radius:.1f} pixels")
    places = {}
    for file, name, picture in zip(files, listed, pictures, strict=True):
        direction = lamp_direction(picture, circle, file)
        places[name] = direction
        angle_deg, azimuth_deg = light_angles_deg(direction)
        print(f"{file.name}: light_deg {angle_deg:.1f}, light_azimuth_deg {azimuth_deg:.1f}")
    write_light_places(asked.into, places)
    print(f"next: irodori init FOLDER --lights {asked.into}")
    return 0


def asked_circle(asked: argparse.Namespace, pictures: list[np.ndarray], path) -> Circle:
    """Return the outline of the ball from the options ``--circle`` or ``--mask``, or else found in the pictures."""
    if asked.circle:
        return Circle(*asked.circle)
    if asked.mask:
        return circle_of_mask(asked_mask(asked, pictures[0].shape), asked.mask)
    return outline(pictures, path)


def asked_mask(asked: argparse.Namespace, shape: tuple[int, ...]) -> np.ndarray:
    """Return the pixels that are bright in the picture of ``--mask``, (rows, columns) bool.

    Raises
    ------
    InputError
        If the picture has another size than ``shape``, or no bright pixel.
    """
    mask = brightness(asked.mask)
    if mask.shape != shape:
        raise InputError(asked.mask, "size", _size(mask.shape), _size(shape))
    if not mask.any():
        raise InputError(asked.mask, "", "a black picture", "a picture that is bright on the object")
    return mask > 0.5 * float(mask.max())


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]} pixels"


def is_mask(name: str, asked: argparse.Namespace) -> bool:
    """Return whether a photograph is the file of ``--mask``, which a shell pattern may list with the others."""
    return asked.mask is not None and Path(name).resolve() == Path(asked.mask).resolve()


def same_size(files: list[Path], pictures: list[np.ndarray]) -> None:
    """Raise `InputError` if a picture has another size than the first."""
    for file, picture in zip(files, pictures, strict=True):
        if picture.shape != pictures[0].shape:
            raise InputError(file, "size", _size(picture.shape), f"{_size(pictures[0].shape)}, as {files[0].name}")


if __name__ == "__main__":
    sys.exit(main())
