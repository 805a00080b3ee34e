"""Angle of the light from shading and highlights: found where photographs tell it, with an error as stated."""

import numpy as np
import pytest
from drawn_plates import PLATE, SETUP, drawn
from test_level_estimate import FLAT, SITTING, dusty, ggx, measured, paper, photographed, seen, sphere

from irodori.config.models import Placing
from irodori.core import store
from irodori.fitting.light_angle import Sight, estimate_light_angle
from irodori.fitting.solvers import FitOptions
from irodori.material.lobe_choices import model_before_choice
from irodori.rectification.object_registration import register_object
from irodori.rectification.placement_correction import LIGHT, Correction
from irodori.rectification.told_values import settle_light
from irodori.reflection.equation5 import reflect

#: Poses with a camera between the light and its mirror direction as well.
AROUND = [
    (light, camera, turn)
    for light, camera in ((45, 0), (45, 45), (65, 30), (30, 30), (75, 20))
    for turn in (0.0, 120.0, 240.0)
]


def shown(surface, poses, seed, typed_off_deg, normal=None):
    """Return the estimate for photographs whose light angles are larger than typed by a number of degrees."""
    normal = sphere(seed=seed) if normal is None else normal
    readings, _ = photographed(surface, normal, poses, seed, drift=0.004)

    def geometry(offset_deg):
        off = np.tile([offset_deg - typed_off_deg, 0.0], (len(poses), 1))
        return seen(normal, poses, off)

    def under(offset_deg):
        angles = geometry(offset_deg)
        weight = (angles[..., :2] < np.radians(80.0)).all(axis=2) * (readings.response > 0.0)
        return type(readings)(readings.response, weight.astype(float), angles, readings.noise, readings.n, readings.k)

    return estimate_light_angle(Sight(under, geometry), FitOptions())


def two_lobes(geometry, albedo):
    return reflect(0.3 * albedo, 1.0, 1.0, 0.3, geometry) + reflect(0.0, 1.0, 3.0, 0.1, geometry)


def matt(geometry, albedo):
    return reflect(0.35 * albedo, 1.0, 0.0, 0.15, geometry)


@pytest.mark.stability(stage="fit", case="light angles off by up to 5 degrees")
@pytest.mark.parametrize("poses", [SITTING, AROUND], ids=["sitting", "around"])
def test_the_error_of_the_light_angles_is_found_within_its_stated_error(poses):
    deviations = []
    for seed, off in enumerate((0.0, 0.7, -1.5, 3.0, -5.0)):
        found = shown(paper, poses, seed, off)
        assert found is not None and found.error_deg < 0.1
        deviations.append((found.offset_deg - off) / found.error_deg)
    assert np.abs(deviations).max() < 3.0 and np.sqrt(np.mean(np.square(deviations))) < 1.7


@pytest.mark.default_cases(5)
@pytest.mark.stability(stage="fit", case="light angles of a surface that the lobe does not describe")
@pytest.mark.parametrize("surface", ["ggx", "matt", "two lobes", "dusty", "acryl_blue", "garnet_red", "krylon_blue"])
@pytest.mark.parametrize("poses", [SITTING, AROUND], ids=["sitting", "around"])
def test_no_surface_contradicts_angles_that_are_right(surface, poses):
    """Surfaces of which the model describes too little tell nothing; others no contradiction, which would do harm."""
    modelled = {"ggx": ggx, "matt": matt, "two lobes": two_lobes}
    if surface in modelled:
        found = shown(modelled[surface], poses, 3, 0.0)
        assert found is not None and abs(found.offset_deg) < 4.0 * np.hypot(0.05, found.error_deg)
    else:
        assert shown(dusty if surface == "dusty" else measured(surface), poses, 3, 0.0) is None


def test_photographs_from_one_set_of_angles_tell_nothing():
    assert shown(paper, FLAT, 5, 0.0, normal=np.tile([0.0, 0.0, 1.0], (300, 1))) is None


def test_angles_that_the_photographs_contradict_are_corrected_and_others_stay_as_typed(caplog):
    assert settle_light(0.6, 0.06, 0.05) == (0.6, 0.6, pytest.approx(0.06**2))
    assert "contradict the typed light angles, which are corrected by +0.60" in caplog.text
    # What agrees is taken together.
    used, probable, variance = settle_light(0.2, 0.06, 0.05)
    assert used == 0.0 and probable == pytest.approx(0.2 / 0.06**2 / (1.0 / 0.05**2 + 1.0 / 0.06**2))
    assert variance == pytest.approx(1.0 / (1.0 / 0.05**2 + 1.0 / 0.06**2))
    # A rig whose light is stated to be exact is believed as long as the photographs agree.
    assert settle_light(0.2, 0.06, 0.0) == (0.0, 0.0, 0.0) and settle_light(0.3, 0.06, 0.0).used_deg == 0.3
    # Where the angles are stated to be less certain, they are corrected as all numbers are that photographs determine.
    assert settle_light(0.2, 0.06, 1.0).used_deg == 0.2 and settle_light(0.1, 0.06, 1.0).used_deg == 0.0


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("offset_deg", [0.03, 1.2])
def test_the_file_and_the_errors_of_angles_have_what_was_found_of_the_light(tmp_path, offset_deg):
    files, output = drawn(tmp_path, Correction()), tmp_path / "out.h5"
    placing = Placing(light_deg=0.5)
    asked = []

    def light(setup):
        asked.append(setup.correction)
        return offset_deg, 0.04

    register_object(files, PLATE, SETUP, placing, light=light, output=output, provenance=store.Provenance("test"))
    found = Correction.load(output)
    assert found.values[LIGHT] == (offset_deg if offset_deg > 0.1 else 0.0)
    assert len(asked) == 1 and asked[0].values[:LIGHT] == found.values[:LIGHT]
    with store.open_file(output) as file:
        assert file.read("sigma")[LIGHT] == pytest.approx(0.04, rel=0.01) and file.attribute("told")[LIGHT]
        assert f"show the light {offset_deg:+.2f} ± 0.04 deg from its typed angles" in file.attribute("sentence")
        # What photographs share is known now; each one's own angle is as uncertain as it was stated.
        theta_i = file.read("angle_error")[0]
    assert 0.49 < theta_i < 0.53
    register_object(files, PLATE, SETUP, placing, output=output, provenance=store.Provenance("test"))
    with store.open_file(output) as file:
        assert file.read("angle_error")[0] > 1.35 * theta_i


def test_lobes_that_are_still_to_be_chosen_are_equation_5():
    assert model_before_choice(["auto"], "auto") == {"lobes": ("gaussian",), "coat": "sum"}
    assert model_before_choice(["ggx", "gaussian"], "coupled") == {"lobes": ("ggx", "gaussian"), "coat": "coupled"}
