"""Linear pictures of a ball or a plate on the printed sheet, drawn by hand for the registration of objects."""

import math
from dataclasses import replace

import numpy as np
from drawn_plates import linear_file
from scipy.ndimage import gaussian_filter, map_coordinates

from irodori.config.capture_table import Pose
from irodori.config.parts import TexturedObject
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.rig_frame import rig_from_camera, to_camera, to_light
from irodori.geometry.shapes.shape import Shape
from irodori.lens.printed_sheets import OBJECT_SHEET, PrintedSheet
from irodori.rectification.placement_correction import Correction
from irodori.rectification.stage import RigSetup

#: A superpixel is 0.39 mm at the origin.
LENS = Pinhole(4_600.0, (640.0, 480.0), 1280, 960)
SETUP = RigSetup(LENS, 900.0, 0.0)
VIEWS = [
    Pose(45.0, 0.0), Pose(60.0, 20.0), Pose(45.0, 10.0, 0.0, 90.0), Pose(50.0, 30.0, 0.0, 180.0),
    Pose(45.0, 5.0, 15.0, 0.0), Pose(55.0, 35.0, 0.0, 250.0),
]  # fmt: skip
BALL = TexturedObject.of({"shape": {"kind": "sphere", "radius_mm": 30.0}, "texels": {"width": 24, "height": 12}})
PLATE = TexturedObject.of(
    {"shape": {"kind": "plate", "width_mm": 100.0, "height_mm": 60.0}, "texels": {"width": 40, "height": 24}}
)
#: Where the sheet lies: along x and y, above where it is typed, mm; tilted about its sides, turned, degrees.
SHEET_LIES = (7.0, -4.0, 0.0, 0.0, 0.0, 25.0)
PAPER = "A5"
_SQUARE = 40  # samples of the drawn sheet
_NOISE = 0.003


def turned(angles_deg) -> np.ndarray:
    """Rotation about x, then y, then z, written out."""
    (cx, sx), (cy, sy), (cz, sz) = ((math.cos(a), math.sin(a)) for a in np.radians(angles_deg))
    about_x, about_y = (
        np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]]),
        np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]),
    )
    return np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]]) @ about_y @ about_x


def on_plane(start, rays, origin, axes) -> np.ndarray:
    """Where rays meet a plane, in its axes (its normal is the third), (..., 2) mm from its origin."""
    start, rays = (start - origin) @ axes, rays @ axes
    return (start - (start[2] / rays[..., 2])[..., None] * rays)[..., :2]


def soft(inside, width):
    """Share of a superpixel on the inner side of an edge that is so far away."""
    return np.clip(inside / width + 0.5, 0.0, 1.0)


def drawn(
    folder, lies: Correction, definition=BALL, *, shown=VIEWS, stated=None, sheet: PrintedSheet | None = OBJECT_SHEET,
    without=(), stretched=(1.0, 1.0), sheet_lies=SHEET_LIES,
):  # fmt: skip
    """Linear files of an object on the sheet, by a camera that stands and an object that lies by a correction.

    ``without`` are numbers of photographs in which the sheet is missing.
    """
    shape, files = Shape.from_definition(definition.shape), []
    height_mm = shape.table_height_mm
    if sheet is not None:
        square_mm = sheet.papers_mm[PAPER if PAPER in sheet.papers_mm else "A4"][2]
        board = gaussian_filter(sheet.picture(_SQUARE).astype(float) / 255.0, 0.2 * _SQUARE / 10.0)
        paper = np.array(sheet.papers_mm[PAPER if PAPER in sheet.papers_mm else "A4"][:2]) / square_mm
        size = np.array([sheet.columns, sheet.rows])
    camera = SETUP.corrected(lies)
    centres = np.stack(np.meshgrid(np.arange(1.0, LENS.width_px, 2.0), np.arange(1.0, LENS.height_px, 2.0)), axis=-1)
    for number, (pose, said) in enumerate(zip(shown, stated or shown, strict=True)):
        real = lies.pose(pose)
        rays = camera.pinhole.directions(centres, rig_from_camera(real))
        eye, table = camera.camera_distance_mm * to_camera(real), turned((0.0, real.tilt_deg, 0.0))
        table = table @ turned((0.0, 0.0, real.turn_deg))
        picture = np.full(rays.shape[:2], 0.02)
        if sheet is not None and number not in without:
            middle = table @ np.array([*sheet_lies[:2], height_mm + sheet_lies[2]])
            at = on_plane(eye, rays, middle, table @ turned(sheet_lies[3:]))
            square = at / (square_mm * np.array(stretched)) * [1.0, -1.0] + size / 2.0
            print_ = map_coordinates(board, (square[..., ::-1] * _SQUARE - 0.5).transpose(2, 0, 1), order=1, cval=1.0)
            is_paper = (np.abs(square - size / 2.0) < paper / 2.0).all(axis=-1)
            cosine = (table[:, 2] @ to_light(real)).item()
            picture = np.where(is_paper, (0.05 + 0.75 * print_) * cosine, picture)
        origin = table @ np.array(lies.values[:3])
        if definition is BALL:
            toward = origin - eye
            apart = np.linalg.norm(toward)
            off = np.arccos(np.clip(rays @ toward / apart, -1.0, 1.0))
            inside = math.asin(30.0 / apart) - off
            covered = soft(inside, 2.0 / camera.pinhole.focal_px)
            along = rays @ toward
            near = along - np.sqrt(np.maximum(along**2 - toward @ toward + 30.0**2, 0.0))
            normal = (near[..., None] * rays - toward) / 30.0
            light = 0.6 * np.maximum(normal @ to_light(real), 0.0)
        else:
            axes, half = table @ turned(lies.values[3:6]), np.array([50.0, 30.0])
            at = on_plane(eye, rays, origin, axes)
            width = np.abs(np.gradient(at, axis=1)) + np.abs(np.gradient(at, axis=0))
            covered = soft(half - np.abs(at), width).prod(axis=-1)
            light = (0.4 + 0.1 * np.sin(0.2 * at[..., 0]) * np.cos(0.15 * at[..., 1])) * (axes[:, 2] @ to_light(real))
        picture = gaussian_filter(covered * light + (1.0 - covered) * picture, 0.5)
        noise = np.random.default_rng(number).normal(0.0, _NOISE, (*picture.shape, 3))
        files.append(linear_file(folder / f"{number}.h5", picture[..., None] + noise, pose=said.angles_deg))
    return files


def wrong(number: int, **angles) -> list[Pose]:
    """The poses, one of which is another."""
    return [replace(pose, **angles) if one == number else pose for one, pose in enumerate(VIEWS)]
