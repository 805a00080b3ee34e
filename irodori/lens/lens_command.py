"""The subcommand ``lens``: measure the block ``optics`` of a camera file from photographs of a printed sheet."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from irodori.core.errors import InputError, PlainError
from irodori.core.progress import track
from irodori.first_project.raw_folder import pixel_pitch_um, raw_files
from irodori.geometry.distortion import COEFFICIENTS
from irodori.ingest.mosaic import decode

if TYPE_CHECKING:
    from irodori.lens.lens_models import Lens, Sheet

_PAPERS = ("A4", "A3", "letter")
#: Smallest share of the picture with corners that gives no warning; elsewhere the distortion is extrapolated.
_LEAST_COVERED = 0.8


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
        _need_opencv()
        if asked.sheet:
            from irodori.lens.calibration_sheet import write_sheet

            write_sheet(asked.sheet, asked.paper)
            print(f"{asked.sheet}: print it at its full size; the squares may come out somewhat larger or smaller")
            return 0
        _measure(Path(asked.photographs), asked.pixel_pitch_um)
    except PlainError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _need_opencv() -> None:
    try:
        import cv2  # noqa: F401
    except ImportError as error:
        raise PlainError(
            f"irodori lens needs OpenCV, which does not start ({error}): install the system's libgl1 and libglib2.0-0"
        ) from error


def _measure(folder: Path, pitch_um: float | None) -> None:
    """Print the optics of a lens, and their accuracy to the standard error stream."""
    from irodori.lens.lens_models import LEAST_PHOTOGRAPHS, covered, fit_lens

    sheets, size, pitch_um = _sheets(folder, pitch_um)
    if len(sheets) < LEAST_PHOTOGRAPHS:
        found = f"the sheet in {len(sheets)} photographs"
        accepted = f"{LEAST_PHOTOGRAPHS} or more in which most of the sheet that --print writes is seen"
        raise InputError(folder, "", found, accepted)
    try:
        lens, far = fit_lens(sheets, size)
    except PlainError as error:
        raise PlainError(f"{folder}: {error}") from None
    for sheet in far:
        print(f"{sheet.name}: left out, it fits no lens that fits the others (was the sheet bent?)", file=sys.stderr)
    kept = [sheet for sheet in sheets if sheet not in far]
    for line in _words(lens, kept, pitch_um, covered(kept, size)):
        print(line, file=sys.stderr)
    print(yaml.safe_dump({"optics": optics_of(lens, size, pitch_um)}, sort_keys=False), end="")


def _sheets(folder: Path, pitch_um: float | None) -> "tuple[list[Sheet], tuple[int, int], float]":
    """Return the sheets found in all photographs, the size of a picture in superpixels, and the pixel pitch in µm."""
    from irodori.lens.calibration_sheet import find_corners
    from irodori.lens.lens_models import LEAST_CORNERS, Sheet

    sheets: list[Sheet] = []
    first: tuple[Path, tuple[int, int], float] | None = None
    for path in track(raw_files(folder), "photographs"):
        mosaic = decode(path)
        if first is None:
            first = path, mosaic.size, mosaic.focal_mm
            pitch_um = pitch_um or pixel_pitch_um(path, mosaic)
            if not pitch_um:
                accepted = "files that state it, or --pixel-pitch-um (camera reviews list it as pixel size)"
                raise InputError(path, "pixel pitch", "none", accepted)
        if mosaic.size != first[1]:
            raise InputError(path, "size", "{} x {} pixels".format(*mosaic.size), "{} x {}".format(*first[1]))
        if mosaic.focal_mm != first[2]:
            found = f"{mosaic.focal_mm:g} mm, and {first[2]:g} mm in {first[0].name}"
            raise InputError(path, "focal length", found, "photographs of one lens at one zoom")
        plane, seen = find_corners(mosaic.superpixels[..., 1])
        if len(plane) < LEAST_CORNERS:
            print(f"{path.name}: left out, {len(plane)} of the sheet's corners found", file=sys.stderr)
            continue
        sheets.append(Sheet(path.name, plane, seen))
    assert first is not None and pitch_um  # a folder without files was refused
    return sheets, (first[1][0] // 2, first[1][1] // 2), pitch_um


def optics_of(lens: "Lens", size: tuple[int, int], pitch_um: float) -> dict:
    """Return the block ``optics`` of the file of a camera.

    Parameters
    ----------
    lens : Lens
        In superpixels.
    size : (int, int)
        Width and height of the picture, superpixels.
    pitch_um : float
        Pixel pitch of the sensor, µm.
    """
    from irodori.lens.lens_models import MODELS

    # Mosaic coordinates start at the edge of the first pixel, sample coordinates at the centre of the first superpixel.
    centre = 2.0 * (lens.centre + 0.5)
    optics: dict = {
        "focal_length_mm": float(f"{2.0 * lens.focal * pitch_um / 1000.0:.6g}"),
        "pixel_pitch_um": float(f"{pitch_um:.6g}"),
        "width_px": 2 * size[0],
        "height_px": 2 * size[1],
        "principal_point_px": [round(float(value), 2) for value in centre],
    }
    free = MODELS[lens.model]
    if free:
        values = dict(zip(COEFFICIENTS, lens.coefficients, strict=True))
        optics["distortion"] = {name: float(f"{values[name]:.6g}") for name in COEFFICIENTS if name in free}
    return optics


def _words(lens: "Lens", sheets: "Sequence[Sheet]", pitch_um: float, share: float) -> list[str]:
    """Return lines of text about the accuracy of the result."""
    focal_mm, error_mm = (2.0 * value * pitch_um / 1000.0 for value in (lens.focal, lens.focal_error))
    corners = sum(len(sheet.plane) for sheet in sheets)
    lines = [
        f"{len(sheets)} photographs, {corners} corners, off by {2.0 * lens.rms:.2f} pixels (root mean square); "
        f"{2.0 * lens.left_out:.2f} where a photograph was left out",
        f"focal length {focal_mm:.3f} ± {error_mm:.3f} mm, "
        f"principal point ± {2.0 * lens.centre_error.max():.1f} pixels, distortion: {lens.model}",
    ]
    if share < _LEAST_COVERED:
        lines.append(f"warning: the sheet reached {100 * share:.0f} % of the picture; photograph it in the corners too")
    return lines


if __name__ == "__main__":
    sys.exit(main())
