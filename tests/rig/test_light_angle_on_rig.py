"""Angle of the light from photographs of the virtual rig, and what registration makes of it."""

import numpy as np
import pytest
from made import made
from test_near_light import definitions, photographed, setup_of, small, uniform  # noqa: F401

from irodori.config.capture_table import Pose
from irodori.config.models import Object
from irodori.fitting.light_angle import LightSearch
from irodori.fitting.solvers import FitOptions
from irodori.rectification.object_registration import Registered, in_words
from irodori.rectification.placement_correction import COUNT, LIGHT, Correction
from irodori.rectification.registration_covariance import RegisteredAngleErrors

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


def registered(prior_deg: float) -> Registered:
    prior = np.ones(COUNT)
    prior[LIGHT] = prior_deg
    one, suspects = np.zeros(1), (("turn_deg", 0.0),)
    errors = RegisteredAngleErrors(np.zeros(4), np.zeros((1, 4)), np.zeros((4, 2)))
    return Registered(Correction(), np.diag(prior**2), prior, one, one, 0.1, one, suspects, errors)


def test_angles_that_the_photographs_contradict_are_corrected_and_others_stay_as_typed():
    found = registered(0.05).with_light(0.6, 0.06)
    assert found.correction.values[LIGHT] == 0.6 and found.sigma[LIGHT] == pytest.approx(0.06)
    assert found.is_told[LIGHT] and "every light angle +0.60 ± 0.06 deg" in in_words(found)
    agrees = registered(0.05).with_light(0.2, 0.06)
    assert agrees.correction.values == Correction().values
    assert "show the light +0.20 ± 0.06 deg from its typed angles" in in_words(agrees)
    assert agrees.sigma[LIGHT] == pytest.approx(0.05 * 0.06 / np.hypot(0.05, 0.06))
    # A rig whose light is stated to be exact is believed as long as the photographs agree.
    assert registered(0.0).with_light(0.2, 0.06).sigma[LIGHT] == 0.0
    assert registered(0.0).with_light(0.3, 0.06).correction.values[LIGHT] == 0.3
    # Where the angles are stated to be less certain, they are corrected as all numbers are that photographs determine.
    assert registered(1.0).with_light(0.2, 0.06).correction.values[LIGHT] == 0.2
    assert registered(1.0).with_light(0.1, 0.06).correction.values[LIGHT] == 0.0
