"""Lens stage: photographs of the printed sheet in; ``lens.yaml``, the measured optics of a camera, out."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from irodori.config.capture_table import LENS, read_captures, shot_path
from irodori.config.models import Optics
from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError, PlainError, counted
from irodori.core.progress import LOGGER, track
from irodori.first_project.raw_folder import pixel_pitch_um
from irodori.geometry.distortion import COEFFICIENTS
from irodori.ingest.mosaic import Mosaic, decode
from irodori.lens.lens_models import LEAST_CORNERS, LEAST_PHOTOGRAPHS, MODELS, Lens, Sheet, covered, fit_lens
from irodori.lens.printed_sheets import LENS_SHEET

#: Smallest share of the picture with corners that gives no warning; elsewhere the distortion is extrapolated.
_LEAST_COVERED = 0.8


@dataclass(frozen=True)
class MeasuredLens:
    """Result of the measurement of a lens.

    Parameters
    ----------
    optics : dict
        The block ``optics`` of a camera's file.
    focal_error_mm : float
        Standard error of the focal length, mm.
    remarks : list of str
        Lines of text about photographs that were left out and the accuracy of the result.
    """

    optics: dict
    focal_error_mm: float
    remarks: list[str]


class SheetReader:
    """Photographs of the printed sheet, added one after the other, and the measurement of the lens from all of them.

    Parameters
    ----------
    where : path
        Folder or table of the photographs, for messages.
    pitch_um : float, optional
        Pixel pitch of the sensor, µm; that stated in the files if it is None.

    Attributes
    ----------
    left_out : list of (path, str)
        Photographs in which too little of the sheet was found, and a phrase that says so.
    """

    def __init__(self, where: Path, pitch_um: float | None) -> None:
        self._where, self._pitch_um = where, pitch_um
        self._sheets: list[Sheet] = []
        self._first: tuple[Path, tuple[int, int], float] | None = None
        self.left_out: list[tuple[Path, str]] = []

    def add(self, path: Path, mosaic: Mosaic) -> None:
        """Find the sheet in a decoded photograph.

        Raises
        ------
        InputError
            If size or focal length differ from those of the photographs before, or the pixel pitch is not known.
        """
        if self._first is None:
            self._first = path, mosaic.size, mosaic.focal_mm
            self._pitch_um = self._pitch_um or pixel_pitch_um(path, mosaic)
            if not self._pitch_um:
                accepted = "files that state it, or --pixel-pitch-um (camera reviews list it as pixel size)"
                raise InputError(path, "pixel pitch", "none", accepted)
        first, size, focal_mm = self._first
        if mosaic.size != size:
            raise InputError(path, "size", "{} x {} pixels".format(*mosaic.size), "{} x {}".format(*size))
        if mosaic.focal_mm != focal_mm:
            found = f"{mosaic.focal_mm:g} mm, and {focal_mm:g} mm in {first.name}"
            raise InputError(path, "focal length", found, "photographs of one lens at one zoom")
        plane, seen = LENS_SHEET.find(mosaic.superpixels[..., 1])
        if len(plane) < LEAST_CORNERS:
            self.left_out.append((path, f"left out, {len(plane)} of the sheet's corners found"))
        else:
            self._sheets.append(Sheet(path.name, plane, seen))

    def measure(self) -> MeasuredLens:
        """Measure focal length, principal point and distortion from the photographs added so far.

        Raises
        ------
        InputError
            If too few photographs show the sheet.
        PlainError
            If the photographs do not agree with each other, or do not determine the focal length.
        """
        if len(self._sheets) < LEAST_PHOTOGRAPHS or self._first is None or not self._pitch_um:
            found = f"the sheet in {counted(len(self._sheets), 'photograph')}"
            accepted = (
                f"{LEAST_PHOTOGRAPHS} or more in which most of the sheet that irodori lens --print writes is seen"
            )
            raise InputError(self._where, "", found, accepted)
        size = self._first[1][0] // 2, self._first[1][1] // 2
        try:
            lens, far = fit_lens(self._sheets, size)
        except PlainError as error:
            raise PlainError(f"{self._where}: {error}") from None
        kept = [sheet for sheet in self._sheets if sheet not in far]
        remarks = [f"{path.name}: {words}" for path, words in self.left_out]
        remarks += [
            f"{sheet.name}: left out, it fits no lens that fits the others (was the sheet bent?)" for sheet in far
        ]
        remarks += _words(lens, kept, self._pitch_um, covered(kept, size))
        return MeasuredLens(optics_of(lens, size, self._pitch_um), _mm(lens.focal_error, self._pitch_um), remarks)


def measure_lens(photographs: Sequence[tuple[Path, bool]], where: Path, pitch_um: float | None) -> MeasuredLens:
    """Measure focal length, principal point and distortion of a lens.

    Parameters
    ----------
    photographs : sequence of (path, bool)
        Photographs of the sheet, and whether each is a linear TIFF or PNG picture in place of a RAW file.
    where, pitch_um
        See `SheetReader`.

    Raises
    ------
    InputError, PlainError
        If a photograph cannot be read; or see `SheetReader`.
    """
    sheets = SheetReader(where, pitch_um)
    for path, linear in track(photographs, "photographs"):
        sheets.add(path, decode(path, linear))
    return sheets.measure()


def calibrate_lens(table, folder, typed: Optics, output) -> None:
    """Write ``lens.yaml`` from the photographs of the role ``lens`` in a camera's table.

    The file holds the block ``optics`` that is used in place of the typed one, the standard error of its focal length,
    and remarks, the first of which compares this focal length with the typed one.

    Parameters
    ----------
    table, folder : path
        Table of the photographs, and the folder of their files.
    typed : Optics
        Of the camera's file. The distance of the pixels is taken from it.
    output : path

    Raises
    ------
    InputError, PlainError
        See `measure_lens`; or if the photographs have another size than the typed one.
    """
    shots = [shot for shot in read_captures(table, folder) if shot.role == LENS]
    photographs = [(shot_path(shot, table, folder), shot.linear) for shot in shots]
    found = measure_lens(photographs, Path(table), typed.pixel_pitch_um)
    check_size(found, typed, table)
    remarks = [compared(found, typed), *found.remarks]
    for line in remarks:
        LOGGER.info("%s", line)
    content = {
        "optics": found.optics,
        "focal_length_error_mm": float(f"{found.focal_error_mm:.3g}"),
        "remarks": remarks,
    }
    with written_whole(output) as temporary:
        temporary.write_text(yaml.safe_dump(content, sort_keys=False, width=120, allow_unicode=True), encoding="utf-8")


def check_size(found: MeasuredLens, typed: Optics, table) -> None:
    """Raise `InputError` if the photographs of the sheet have another size than those of the camera's file."""
    for key in ("width_px", "height_px"):
        if found.optics[key] != getattr(typed, key):
            told = f"photographs of the role {LENS} of {found.optics[key]} pixels"
            raise InputError(table, key, told, f"{getattr(typed, key)}, as in the camera's file")


def compared(found: MeasuredLens, typed: Optics) -> str:
    """Return a sentence that compares the measured focal length with the typed one."""
    own_mm = found.optics["focal_length_mm"]
    measured = f"focal length {own_mm:.3f} ± {found.focal_error_mm:.3f} mm"
    if abs(own_mm - typed.focal_length_mm) <= 2.0 * found.focal_error_mm:
        return f"{measured}, as typed ({typed.focal_length_mm:g} mm)"
    percent = 100.0 * (own_mm / typed.focal_length_mm - 1.0)
    more = "more" if percent > 0 else "less"
    return (
        f"{measured}, {abs(percent):.2g} % {more} than the typed {typed.focal_length_mm:g} mm: a few percent are "
        "usual, for a lens focused near is longer than its name says; beyond that it was another zoom, or "
        "pixel_pitch_um is wrong"
    )


def _mm(samples: float, pitch_um: float) -> float:
    """Return a length in samples of the picture, two mosaic pixels each, in mm."""
    return 2.0 * samples * pitch_um / 1000.0


def optics_of(lens: Lens, size: tuple[int, int], pitch_um: float) -> dict:
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
    # Mosaic coordinates start at the edge of the first pixel, sample coordinates at the centre of the first superpixel.
    centre = 2.0 * (lens.centre + 0.5)
    optics: dict = {
        "focal_length_mm": float(f"{_mm(lens.focal, pitch_um):.6g}"),
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


def _words(lens: Lens, sheets: Sequence[Sheet], pitch_um: float, share: float) -> list[str]:
    """Return lines of text about the accuracy of the result."""
    corners = sum(len(sheet.plane) for sheet in sheets)
    lines = [
        f"{len(sheets)} photographs, {corners} corners, off by {2.0 * lens.rms:.2f} pixels (root mean square); "
        f"{2.0 * lens.left_out:.2f} where a photograph was left out",
        f"focal length {_mm(lens.focal, pitch_um):.3f} ± {_mm(lens.focal_error, pitch_um):.3f} mm, "
        f"principal point ± {2.0 * lens.centre_error.max():.1f} pixels, distortion: {lens.model}",
    ]
    if share < _LEAST_COVERED:
        lines.append(f"warning: the sheet reached {100 * share:.0f} % of the picture; photograph it in the corners too")
    return lines
