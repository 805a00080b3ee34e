"""Pictures for registration that are made by hand: linear files of a drawn plate, and what takes fewer words."""

from dataclasses import replace

import numpy as np

from irodori.config.capture_table import Pose
from irodori.config.parts import TexturedObject
from irodori.core import store
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.rig_frame import rig_from_camera, to_camera, to_light
from irodori.geometry.shapes.plate import Plate
from irodori.rectification.placement_correction import QUANTITIES, Correction
from irodori.rectification.reduced_pictures import Picture
from irodori.rectification.stage import RigSetup

PINHOLE = Pinhole(10_000.0, (400.0, 300.0), 800, 600)
NAMES = [quantity.name for quantity in QUANTITIES]


def correction(**values) -> Correction:
    return Correction.of([values.get(name, 0.0) for name in NAMES])


def picture(response, *, valid=None, scale=1.0, corner=(0.0, 0.0), noise=(1e-6, 0.0)) -> Picture:
    response = np.asarray(response, np.float32)
    valid = np.ones(response.shape[:2], np.float32) if valid is None else np.asarray(valid, np.float32)
    return Picture(response, valid, scale, np.array(corner), np.array(noise))


def linear_file(path, response, valid=None, sample_px=2, pose=(45.0, 10.0, 5.0, 90.0)):
    height, width, bands = response.shape
    valid = np.ones((height, width), np.uint8) if valid is None else valid
    with store.create(path, store.Provenance("test")) as out:
        kept = {"units": "1", "dims": "row,column,band", "quantity": "response", "compression": "none"}
        out.write("response", response.astype("f4"), **kept)
        out.write("valid", valid, units="1", dims="row,column", quantity="valid")
        noise = np.stack([np.array([1e-4, 1e-3]) * (band + 1) for band in range(bands)])
        out.write("noise_model", noise, units="1", dims="band,term", quantity="noise")
        out.attribute("sample_px", sample_px)
        out.attribute("mosaic", "")
        out.attribute("pose_deg", list(pose))
    return path


SMALL = Pinhole(2_400.0, (160.0, 120.0), 320, 240)
SETUP = RigSetup(SMALL, 900.0, 0.0)
VIEWS = [Pose(45.0, 0.0), Pose(60.0, 20.0), Pose(45.0, 10.0, 0.0, 90.0), Pose(50.0, 30.0, 0.0, 180.0)]
PLATE = TexturedObject.of(
    {"shape": {"kind": "plate", "width_mm": 60.0, "height_mm": 50.0}, "texels": {"width": 24, "height": 20}}
)


def drawn(folder, lies, shown=VIEWS, stated=VIEWS, size=(60.0, 50.0), contrast=1.0, *, turns=0):
    """Linear files of a matt plate with a smooth texture, its sides as sharp as superpixels show them.

    What a camera shows that is mounted turned by quarter turns counter-clockwise is the picture of an upright one, with
    the sensor's sides exchanged, turned clockwise.
    """
    files, (wide, high) = [], ((320, 240), (240, 320))[turns % 2]
    upright = replace(SETUP, pinhole=replace(SMALL, centre_px=(wide / 2.0, high / 2.0), width_px=wide, height_px=high))
    for number, (pose, said) in enumerate(zip(shown, stated, strict=True)):
        real = lies.pose(pose)
        placed = lies.placements(Plate(*size), real, 0.0)[0]
        way = upright.corrected(lies)
        centres = np.stack(np.meshgrid(np.arange(1.0, wide, 2.0), np.arange(1.0, high, 2.0)), axis=-1)
        rays = way.pinhole.directions(centres, rig_from_camera(real)) @ placed.rotation
        start = (way.camera_distance_mm * to_camera(real) - placed.translation_mm) @ placed.rotation
        at = (start + (-start[2] / rays[..., 2])[..., None] * rays)[..., :2]
        across, down = np.gradient(at, axis=(1, 0))
        width = np.abs(across) + np.abs(down)  # of a superpixel, on the plate
        on = np.clip((np.array(size) / 2.0 - np.abs(at)) / width + 0.5, 0.0, 1.0).prod(axis=-1)
        x, y = np.moveaxis(at, -1, 0)
        waves = np.sin(0.15 * x + 0.08 * y), np.cos(0.22 * y - 0.05 * x), np.sin(0.05 * x)
        texture = np.stack(waves, axis=-1) * [0.2, 0.25, 0.25]
        colour = [0.35, 0.4, 0.45] + contrast * texture
        cosine = (placed.rotation[:, 2] @ to_light(real)).item()
        seen = np.rot90(on[..., None] * colour * cosine, -turns)
        files.append(linear_file(folder / f"{number}.h5", seen, pose=said.angles_deg))
    return files
