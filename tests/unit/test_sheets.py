"""Thin sheets: both sides are seen, and light passes through."""

import numpy as np
import pytest
from made import made
from path_scenes import DARK, ball, deviations, traced
from scenes import constant_light, material, sky, smooth_light

from irodori.config.models import BodyShape, ObjectShape
from irodori.geometry.rig_frame import rotation_xyz
from irodori.geometry.shapes.shape import Shape
from irodori.material.material_file import Material
from irodori.spectra.grid import SAMPLES

WAVE = np.linspace(-1.0, 1.0, SAMPLES)
FRONT, BACK = 0.35 + 0.2 * WAVE, 0.25 - 0.15 * WAVE
THROUGH = 0.3 + 0.25 * np.exp(-((2.0 * WAVE) ** 2))
LEAF = Material.uniform(FRONT, transmittance=THROUGH)


def plate(side: float) -> Shape:
    block = {"kind": "plate", "width_mm": side, "height_mm": side}
    return Shape.from_definition(made(ObjectShape | BodyShape, block))


def lamp(elevation_deg: float, azimuth_deg: float = 0.0) -> dict:
    angles = {"elevation_deg": elevation_deg, "azimuth_deg": azimuth_deg}
    return {"kind": "collimated", "spectrum": "D65", "irradiance": np.pi, **angles}


def test_a_sheet_that_loses_nothing_disappears_in_even_light():
    """A furnace: reflectance and transmittance sum to 1 in every band, on both sides, beside another object."""
    sheet = Material.uniform(1.0 - THROUGH, transmittance=THROUGH)
    for height in (80.0, -80.0):
        shapes, places = [plate(30.0), ball(8.0)], [(0.0, 0.0, 0.0), (3.0, 0.0, -9.0)]
        picture = traced(shapes, [sheet, material(1.0)], constant_light(0.7), 256, places=places,
                         position=(0.0, -200.0, height), size=(9, 9))  # fmt: skip
        assert np.abs(picture.radiance.mean(axis=(0, 1)) - 0.7).max() < 0.004
        assert np.mean(deviations(picture, 0.7) ** 2) < 2.0
