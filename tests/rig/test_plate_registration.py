"""The plate of the virtual rig, seen through a filter that shifts, turns and magnifies, is registered."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.plate_pictures import errors_px, photograph
from irodori.captures import Pose
from irodori.config import load_definitions, read_yaml
from irodori.geometry.embree import Tracer
from irodori.geometry.frames import rig_from_camera, rig_from_object, rotation_z, to_camera, to_light
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.shapes import on_table
from irodori.registration import Registration, bayer_offsets_px, register
from irodori.rig.virtual.imaging import expose_object
from irodori.rig.virtual.samples import Sample
from irodori.rig.virtual.sensor import band_weights
from irodori.spectra import spectrum

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def definitions():
    return load_definitions(read_yaml(ROOT / "config/config.yaml"), ROOT)


def see(definitions, pose: Pose, plate: Registration, state: int) -> np.ndarray:
    """Return the mosaic of white-referenced responses of the tile plate through a filter plate."""
    camera, rig = definitions["cameras"]["d5100-comb"], definitions["rigs"]["virtual"]
    sample = Sample.from_definition(definitions["objects"]["tile-plate"])
    weights = band_weights(camera, spectrum("A"))
    rotation = rig_from_object(pose)
    pinhole = Pinhole.from_optics(camera["optics"])
    x, y = pinhole.centre_px
    image = expose_object(
        sample,
        Tracer(on_table(sample.shape, rotation, rig["table_radius_mm"])),
        rotation,
        Pinhole(
            pinhole.focal_px * plate.scale,
            (x + 2.0 * plate.dx_px, y + 2.0 * plate.dy_px),
            pinhole.width_px,
            pinhole.height_px,
        ),
        rig["camera_distance_mm"] * to_camera(pose),
        rig_from_camera(pose) @ rotation_z(plate.rotation_rad).T,
        to_light(pose),
        weights,
        math.radians(rig["virtual"]["light_angular_radius_deg"]),
    )[state]
    row, column = np.indices(image.shape, sparse=True)
    return image / weights.sum(axis=1)[3 * state + row % 2 + column % 2]


def found_error_px(definitions, pose: Pose, plate, spots: int) -> float:
    """Return the rms error over the picture, seen by pixels that average ``spots`` squared sub-pixel shifts."""
    dx, dy, rotation_deg, scale = plate
    truth = Registration(dx, dy, math.radians(rotation_deg), scale, 0.0, 0.0)
    rng, pictures = np.random.default_rng(3), []
    steps = ((np.arange(spots) + 0.5) / spots - 0.5) / 2.0  # of half a superpixel, a mosaic pixel
    for state, transform in enumerate((Registration.identity(), truth)):
        shifted = [
            see(definitions, pose, replace(transform, dx_px=transform.dx_px + x, dy_px=transform.dy_px + y), state)
            for x in steps
            for y in steps
        ]
        pictures.append(photograph(np.mean(shifted, axis=0), state, rng))
    (fixed, fixed_valid), (moving, moving_valid) = pictures
    found = register(fixed, moving, fixed_valid, moving_valid, band_offsets_px=bayer_offsets_px("RGGB"))
    height, width = fixed_valid.shape
    return math.sqrt((errors_px(found, truth, width, height) ** 2).mean())


@pytest.mark.parametrize(
    ("pose", "plate"),
    [(Pose(45.0, 35.0, 0.0), (-7.6, 2.2, -0.3, 0.992)), (Pose(45.0, 12.0, 20.0), (3.9, 3.3, 0.1, 0.995))],
)
def test_the_tile_plate_is_registered_where_pixels_see_an_area(definitions, pose, plate):
    assert found_error_px(definitions, pose, plate, 3) <= 0.05


@pytest.mark.xfail(
    strict=True,
    reason="a mosaic pixel of the virtual camera sees four points: an edge along the rows moves half a superpixel "
    "before any sample changes, and the plate's only content is ten such edges",
)
@pytest.mark.parametrize(
    ("pose", "plate"),
    [(Pose(45.0, 0.0, 0.0), (6.3, -4.7, 0.4, 1.008)), (Pose(45.0, 35.0, 0.0), (-7.6, 2.2, -0.3, 0.992))],
)
def test_the_tile_plate_is_registered_where_pixels_see_four_points(definitions, pose, plate):
    assert found_error_px(definitions, pose, plate, 1) <= 0.05
