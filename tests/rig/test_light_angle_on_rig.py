"""Angle of the light from photographs of the virtual rig."""

import math

import numpy as np
import pytest
from made import made
from test_near_light import definitions, photographed, setup_of, small, uniform  # noqa: F401

from irodori.config.capture_table import Pose
from irodori.config.models import Object
from irodori.fitting.light_angle import LightSearch
from irodori.fitting.solvers import FitOptions
from irodori.rectification.placement_correction import CAMERA, COUNT, LIGHT, Correction
from irodori.rectification.told_values import settle_light

POSES = [
    Pose(light, camera, 0.0, turn) for light, camera in ((35, 0), (45, 25), (60, 10)) for turn in (0.0, 90.0, 180.0)
]


@pytest.mark.parametrize("distance_mm", [None, 600.0], ids=["far", "near"])
def test_a_glossy_ball_shows_where_the_light_stands(tmp_path, definitions, distance_mm):  # noqa: F811
    camera, rig = small(definitions, distance_mm)
    definition = uniform(definitions, {"kind": "sphere", "radius_mm": 20.0}, beta=2.0, mu_rad=0.2)
    files = photographed(tmp_path, definition, camera, rig, POSES)
    off = np.zeros(COUNT)
    off[LIGHT] = -1.2
    setup = setup_of(camera, rig, white=distance_mm is not None).corrected(Correction.of(off))
    definition["texels"] = {"width": 64, "height": 32}
    found = LightSearch(files, made(Object, definition), FitOptions(), (1.5, 0.0), 80.0)(setup)
    assert found is not None and abs(found.offset_deg - 1.2) < 0.2


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("scale", [LIGHT, CAMERA], ids=["light", "camera"])
def test_a_scale_5_degrees_off_is_corrected_on_a_ball_and_both_are_named(tmp_path, definitions, scale, caplog):  # noqa: F811
    """A ball that is alike all around shows the angle between light and camera, which both scales change alike."""
    camera, rig = small(definitions, None)
    definition = uniform(definitions, {"kind": "sphere", "radius_mm": 20.0}, beta=2.0, mu_rad=0.2)
    files = photographed(tmp_path, definition, camera, rig, POSES)
    off = np.zeros(COUNT)
    off[scale] = -5.0
    setup = setup_of(camera, rig, white=False).corrected(Correction.of(off))
    definition["texels"] = {"width": 64, "height": 32}
    found = LightSearch(files, made(Object, definition), FitOptions(), (1.5, 0.0), 80.0)(setup)
    assert found is not None and math.isclose(found.offset_deg, 5.0, abs_tol=0.3)
    assert settle_light(*found, 0.05).used_deg == found.offset_deg
    assert "contradict the typed light angles, which are corrected by +" in caplog.text
    assert "or else the zero of the camera's scale is off by as much" in caplog.text
