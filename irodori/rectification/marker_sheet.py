"""The printed sheet with markers on the table: where its corners lie, and where photographs show them.

The sheet turns and tilts with the table. Its place on the table is not typed: with a sheet, the registration of an
object has nine more unknowns, in the order of `SHEET_QUANTITIES`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from irodori.config.capture_table import Pose
from irodori.core import store
from irodori.core.errors import InputError, counted
from irodori.geometry.pinhole import superpixels_from_samples
from irodori.geometry.rig_frame import rig_from_camera, rig_from_object, rotation_xyz, to_camera
from irodori.geometry.shapes.shape import Shape
from irodori.lens.opencv import need_opencv
from irodori.rectification.placement_correction import Quantity
from irodori.rectification.reduced_pictures import GREEN

if TYPE_CHECKING:
    from irodori.config.models import Markers, Placing
    from irodori.rectification.stage import RigSetup

#: The unknowns of a sheet, in their order: its middle, tilts about its sides, turn, sizes along its sides, and the
#: common displacement of all outlines of the object.
SHEET_QUANTITIES = (
    Quantity("x_mm", "mm", "middle of the sheet along the table's x"),
    Quantity("y_mm", "mm", "middle of the sheet along the table's y"),
    Quantity("z_mm", "mm", "sheet above where it was typed"),
    Quantity("about_x_deg", "deg", "sheet tilted about its long side"),
    Quantity("about_y_deg", "deg", "sheet tilted about its short side"),
    Quantity("turn_deg", "deg", "sheet turned about the table's normal"),
    Quantity("long_percent", "%", "size of the sheet along its long side"),
    Quantity("short_percent", "%", "size of the sheet along its short side"),
    Quantity("outline_mm", "mm", "common outward displacement of the object's outlines"),
)
#: Index of the last. It is no number of the sheet, but is needed with one: outlines in half-shadow are found with a
#: bias, so that the object's size would contradict the size of the sheet.
OUTLINE = len(SHEET_QUANTITIES) - 1
#: Steps of numerical derivatives by these unknowns.
SHEET_STEPS = np.full(len(SHEET_QUANTITIES), 0.01)
_ANYWHERE_MM, _ANY_TURN_DEG = 500.0, 180.0  # standard deviations of what is not typed
#: Standard deviations of the printed size: of a printer, and of a measurement of one side (a printer stretches paper
#: along one side more than along the other).
_PRINTER_PERCENT, _RULER_PERCENT = 0.5, 0.2
_LEAST_CORNERS = 4  # of a photograph that shows the sheet
_MOST_SIGMAS = 4.0  # standard deviations by which the sheet may contradict what was typed
_OUTLINE_MM = 0.1  # standard deviation of the common displacement of outlines: the accuracy of registration
_PROBES = 9  # points along a line across an outline that are tested for lying over the print


@dataclass(frozen=True)
class MarkerSheet:
    """A printed sheet on the table.

    Parameters
    ----------
    size : (2,) float
        Squares along the long and the short side.
    border : float
        Width of the chessboard around the black middle, squares.
    paper : (2,) float
        Sides of the paper, squares.
    square_mm : float
        Typed side of a square.
    z_mm : float
        Typed height in the frame of the object.
    sigma : (9,) float
        Standard deviations of the typed values.
    """

    size: np.ndarray
    border: float
    paper: np.ndarray
    square_mm: float
    z_mm: float
    sigma: np.ndarray

    @classmethod
    def of(cls, markers: "Markers", shape: Shape, placing: "Placing") -> "MarkerSheet":
        """Return the sheet of a definition; it lies under the object where the definition states no height."""
        need_opencv("markers")
        from irodori.lens.printed_sheets import OBJECT_SHEET

        *paper_mm, printed_mm = OBJECT_SHEET.papers_mm[markers.paper]
        percent = _PRINTER_PERCENT if markers.square_mm is None else _RULER_PERCENT
        up, tilt = placing.translation_mm, placing.rotation_deg
        return cls(
            np.array([OBJECT_SHEET.columns, OBJECT_SHEET.rows], dtype=float),
            OBJECT_SHEET.border,
            np.array(paper_mm) / printed_mm,
            printed_mm if markers.square_mm is None else markers.square_mm,
            shape.table_height_mm if markers.z_mm is None else markers.z_mm,
            np.array([_ANYWHERE_MM, _ANYWHERE_MM, up, tilt, tilt, _ANY_TURN_DEG, percent, percent, _OUTLINE_MM]),
        )

    def on_table(self, plane: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return points of the sheet, (n, 2) squares from its first corner, in the table's frame, (n, 3) mm."""
        side = self.square_mm * (1.0 + values[6:8] / 100.0) * [1.0, -1.0]  # rows are counted towards the reader
        flat = np.concatenate([(plane - self.size / 2.0) * side, np.zeros((len(plane), 1))], axis=1)
        return flat @ rotation_xyz(values[3:6]).T + [values[0], values[1], self.z_mm + values[2]]

    def on_sheet(self, xy: np.ndarray, pose: Pose, camera: "RigSetup", values: np.ndarray) -> np.ndarray:
        """Return the points of the sheet, (n, 2) squares, that appear at places of a picture, (n, 2) superpixels.

        NaN for lines of sight that do not meet the plane of the sheet. ``pose`` and ``camera`` are corrected already.
        """
        rotation, sheet = rig_from_object(pose), rotation_xyz(values[3:6])
        axes = rig_from_camera(pose, camera.pinhole.quarter_turns)
        way = camera.pinhole.directions(2.0 * (xy + 0.5), axes) @ rotation @ sheet
        middle = np.array([values[0], values[1], self.z_mm + values[2]])
        eye = (camera.camera_distance_mm * to_camera(pose) @ rotation - middle) @ sheet
        along = np.where(way[:, 2] * eye[2] < 0.0, -eye[2] / np.where(way[:, 2] == 0.0, np.nan, way[:, 2]), np.nan)
        side = self.square_mm * (1.0 + values[6:8] / 100.0) * [1.0, -1.0]
        return (eye + along[:, None] * way)[:, :2] / side + self.size / 2.0

    def is_over_print(self, xy, outward, reach_px, pose: Pose, camera: "RigSetup", values) -> np.ndarray:
        """Return which lines across an outline show paper or squares of the sheet, not its black middle, (n,) bool.

        Parameters
        ----------
        xy, outward : (n, 2) float
            Points of the outline in the picture and its unit normals, superpixels.
        reach_px : float
            Length of the lines to either side.
        pose : Pose
        camera : RigSetup
            Pose and camera are corrected already.
        values : (9,) float
            Place of the sheet.
        """
        over = np.zeros(len(xy), dtype=bool)
        for offset in np.linspace(-reach_px, reach_px, _PROBES):
            from_middle = np.abs(self.on_sheet(xy + offset * outward, pose, camera, values) - self.size / 2.0)
            in_middle = (from_middle < self.size / 2.0 - self.border).all(axis=1)
            over |= (from_middle < self.paper / 2.0).all(axis=1) & ~in_middle
        return over

    def first_place(self, plane, seen, poses, camera: "RigSetup") -> tuple[np.ndarray, float]:
        """Return a first estimate of the sheet's place, (9,), and the size of its squares relative to the typed one.

        The size is NaN if, in the typed pose of every photograph, corners lie where the camera sees no table.

        Parameters
        ----------
        plane, seen : sequence of (n, 2) float
            Corners found in each photograph, on the sheet in squares and in the picture in superpixels.
        poses : sequence of Pose
        camera : RigSetup
        """
        values, found = np.zeros(len(SHEET_QUANTITIES)), []
        for on, xy, pose in zip(plane, seen, poses, strict=True):
            if not len(on):
                continue
            # The map from typed to seen places on the table's plane, as complex numbers: a turn, a size and a shift.
            real = self._complex(self.on_sheet(xy, pose, camera, values))
            typed = self._complex(on)
            keep = np.isfinite(real)
            if keep.sum() < _LEAST_CORNERS:
                continue
            real, typed = real[keep], typed[keep]
            spread = typed - typed.mean()
            turn = np.vdot(spread, real - real.mean()) / np.vdot(spread, spread).real
            found.append((turn, real.mean() - turn * typed.mean()))
        if not found:
            return values, math.nan
        turns, middles = np.array(found, dtype=complex).T
        # The turn nearest to all others: one wrong pose does not move it.
        apart = np.abs(np.angle(turns[:, None] / turns[None])).sum(axis=1)
        values[5] = math.degrees(np.angle(turns[np.argmin(apart)]))
        values[:2] = np.median(middles.real), np.median(middles.imag)
        return values, float(np.median(np.abs(turns)))

    def _complex(self, plane: np.ndarray) -> np.ndarray:
        """Return points of the sheet as complex numbers, mm from its middle as typed."""
        x, y = ((plane - self.size / 2.0) * self.square_mm).T
        return x - 1j * y


def corners_in(green: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the corners of the sheet in a picture.

    Parameters
    ----------
    green : (height, width) float32
        Linear picture of the green band.

    Returns
    -------
    plane : (n, 2) float32
        Corners on the sheet, in squares; n is 0 if it was not found.
    seen : (n, 2) float32
        The same corners in the picture, samples; the centre of a sample has integer coordinates.

    Raises
    ------
    PlainError
        If OpenCV cannot be loaded.
    """
    need_opencv("markers")
    from irodori.lens.printed_sheets import OBJECT_SHEET

    plane, seen = OBJECT_SHEET.find(green)
    # A pattern of the object may be taken for a marker of the middle, which is not printed.
    size = np.array([OBJECT_SHEET.columns, OBJECT_SHEET.rows], dtype=float)
    printed = (np.abs(plane - size / 2.0) >= size / 2.0 - OBJECT_SHEET.border).any(axis=1)
    if np.count_nonzero(printed) < _LEAST_CORNERS:
        return plane[:0], seen[:0]
    return plane[printed], seen[printed]


def find_corners(path) -> tuple[np.ndarray, np.ndarray]:
    """Find the corners of the sheet in a file of linear responses; as `corners_in`, but in superpixels."""
    green, sample_px = _green(path)
    plane, seen = corners_in(green)
    return plane.astype(float), superpixels_from_samples(seen, sample_px)


def _green(path) -> tuple[np.ndarray, int]:
    """Return the green band of a file of linear responses, and the side of its samples in mosaic pixels."""
    with store.open_file(path) as file:
        file.require_axes({"response": "row,column,band"})
        green = file.read("response", (slice(None), slice(None), GREEN)).astype(np.float32)
        return np.nan_to_num(green), file.attribute("sample_px")


def not_found(linear: Sequence) -> InputError:
    """Return the error for photographs none of which shows the sheet."""
    from irodori.lens.printed_sheets import LENS_SHEET

    found = f"the sheet in none of {counted(len(linear), 'photograph')}"
    if any(len(LENS_SHEET.find(_green(path)[0])[0]) >= _LEAST_CORNERS for path in linear):
        found += ", but that of irodori lens"
    accepted = (
        "the sheet that irodori markers prints, squares of 20 superpixels or more; or no markers in the definition"
    )
    return InputError(Path(linear[0]).parent, "markers", found, accepted)


def check_first_size(linear: Sequence, sheet: MarkerSheet, size: float, camera: "RigSetup", placing: "Placing") -> None:
    """Raise an error if squares are of another size than distance and focal length of the camera can explain.

    ``size`` is that of `MarkerSheet.first_place`.
    """
    if math.isnan(size):
        found = "the sheet at places where the camera, in the typed poses, sees no table"
        raise InputError(Path(linear[0]).parent, "markers", found, "poses as they were, with the table in the picture")
    distance = placing.camera_distance_mm / camera.camera_distance_mm
    sigma = math.hypot(distance, placing.focal_length_percent / 100.0, sheet.sigma[6] / 100.0)
    if not abs(size - 1.0) <= _MOST_SIGMAS * sigma:
        found = f"squares of {size * sheet.square_mm:.3g} mm at the typed distance and focal length of the camera"
        accepted = f"{sheet.square_mm:g} mm (markers.paper, markers.square_mm), or another distance or focal length"
        raise InputError(Path(linear[0]).parent, "markers", found, accepted)


def check_printed_size(linear: Sequence, sheet: MarkerSheet, values: np.ndarray, reach_mm: float) -> None:
    """Raise an error if the sheet's size on the photographs contradicts the typed one, as measured by the object.

    Parameters
    ----------
    linear : sequence of path
    sheet : MarkerSheet
    values : (9,) float
        Its place and size, and the common displacement of outlines.
    reach_mm : float
        Distance of the object's outline from its middle.
    """
    sigmas = values / sheet.sigma
    if math.hypot(np.abs(sigmas[6:8]).max(), sigmas[OUTLINE]) <= _MOST_SIGMAS:
        return
    # The size if the outline of the object is right.
    long, short = sheet.square_mm * (1.0 + values[6:8] / 100.0 - values[OUTLINE] / reach_mm)
    found = f"squares of {long:.2f} x {short:.2f} mm beside an object of the typed size"
    accepted = f"{sheet.square_mm:g} mm; measure the print and state markers.square_mm, or correct the object's shape"
    raise InputError(Path(linear[0]).parent, "markers", found, accepted)
