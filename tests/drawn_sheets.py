"""Photographs of the printed sheet by a known lens, drawn as a camera would take them."""

from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation

from irodori.geometry.pinhole import Pinhole
from irodori.lens.printed_sheets import LENS_SHEET
from irodori.simulation.virtual_rig.dng_writer import write_dng

WIDTH, HEIGHT = 1200, 800  # mosaic pixels
PITCH_UM = 5.0
#: Of a lens of ordinary distortion: barrel, some tangential part, its axis off the middle.
TRUE = Pinhole(1500.0, (612.0, 391.0), WIDTH, HEIGHT, (-0.18, 0.06, 0.0006, -0.0009, 0.0, 0.0, 0.0, 0.0))
STRAIGHT = Pinhole(1500.0, (600.0, 400.0), WIDTH, HEIGHT)
COLUMNS, ROWS = LENS_SHEET.columns, LENS_SHEET.rows
BOARD = LENS_SHEET.picture(48).astype(np.float64) / 255.0
#: Angles of the sheet about its x and y, degrees, and where its middle is seen, as parts of the picture.
PLACES = [
    (0, 0, 0.5, 0.5), (35, 0, 0.5, 0.45), (-35, 0, 0.5, 0.55), (0, 35, 0.45, 0.5), (0, -35, 0.55, 0.5),
    (25, 25, 0.3, 0.35), (-25, 25, 0.7, 0.35), (25, -25, 0.3, 0.65), (-25, -25, 0.7, 0.65), (10, 30, 0.75, 0.5),
]  # fmt: skip


def seen_sheet(lens: Pinhole, about_x, about_y, at_x, at_y, distance=20.0):
    """The pose of the sheet: its first corner, its axes (columns), in the camera's frame, squares."""
    axes = Rotation.from_euler("xyz", [about_x, about_y, 3.0], degrees=True).as_matrix()
    ahead = lens.directions(np.array([at_x * WIDTH, at_y * HEIGHT]), np.eye(3))
    middle = distance * ahead / ahead[2]
    return middle - axes @ np.array([COLUMNS / 2, ROWS / 2, 0.0]), axes


@cache
def photographed(lens: Pinhole, place, seed=0, bend=0.0) -> np.ndarray:
    """The mosaic of a photograph: each pixel looks along its ray at a sheet that may be bent, through a soft lens."""
    origin, axes = seen_sheet(lens, *place)
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    toward = lens.directions(np.stack([x, y], axis=-1), np.eye(3))
    depth = (origin @ axes[:, 2]) / (toward @ axes[:, 2])
    on = (toward * depth[..., None] - origin) @ axes[:, :2]
    on[..., 0] += bend * (on[..., 1] - ROWS / 2) ** 2
    shown = map_coordinates(BOARD, [on[..., 1] * 48 - 0.5, on[..., 0] * 48 - 0.5], order=1, cval=0.6)
    light = 0.05 + 0.85 * gaussian_filter(shown, 0.8)
    radius = np.hypot(np.arange(WIDTH) - WIDTH / 2, np.arange(HEIGHT)[:, None] - HEIGHT / 2) / (WIDTH / 2)
    level = (
        light
        * (1.0 - 0.25 * radius**2)
        * np.array([[0.5, 0.9], [0.9, 0.4]])[np.arange(HEIGHT)[:, None] % 2, np.arange(WIDTH) % 2]
    )
    electrons = np.random.default_rng(seed).poisson(8000.0 * level)
    return (512 + electrons).clip(0, 16383).astype(np.uint16)


def store(folder, mosaics) -> None:
    folder.mkdir(exist_ok=True)
    for number, mosaic in enumerate(mosaics):
        path = folder / f"sheet{number:02}.dng"
        write_dng(path, mosaic, black_level=512, white_level=16383, exposure_s=0.02, model="test")
