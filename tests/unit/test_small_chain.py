"""All stages recover the truth on a virtual rig without faults."""

from dataclasses import replace

import numpy as np
import pytest
from definitions import ROOT
from small_chain import run_chain, small_camera, small_rig

from irodori.colour.colorimetry import delta_e_reflectance
from irodori.config.definitions import read_yaml
from irodori.config.models import Object, PoseGroup, Size
from irodori.simulation.virtual_rig.ground_truth import true_material

FAULTS = ("light_drift", "vignetting", "stray_light", "pose_error", "lamp_spectrum", "laid_off", "focal_length",
          "filter_plate", "hot_pixels")  # fmt: skip


@pytest.fixture(scope="module")
def setting():
    """Return camera and rig."""
    return small_camera(), small_rig(without=FAULTS)


def test_a_plate_is_found_on_a_rig_without_faults(setting, tmp_path):
    """Six poses and 12 x 12 texels: colours are there, within the few samples of each texel."""
    plate = Object.of(read_yaml(ROOT / "config/objects/tile-plate.yaml"))
    poses = (PoseGroup(light_deg=(45.0,), camera_deg=(0.0, 41.0, 55.0)),
             PoseGroup(light_deg=(65.0,), camera_deg=(55.0, 72.0)),
             PoseGroup(light_deg=(45.0,), camera_deg=(12.0,), tilt_deg=(20.0,)))  # fmt: skip
    plate = replace(plate, texels=Size(width=12, height=12), poses=poses)
    found, truth = run_chain(plate, *setting, tmp_path), true_material(plate, *setting)
    assert found.alpha.shape == (12, 12) and found.observed.mean() > 0.8
    exact, own = (m.coefficients[found.observed] @ m.basis.T for m in (truth, found))
    assert np.median(delta_e_reflectance(exact, own)) < 4.0


def test_a_ball_under_a_dome_of_lamps_is_found_by_a_camera_that_stays_where_it_is(setting, tmp_path):
    """Ten lamps above the table, of which eight stand beside the plane that all others are in."""
    ball = Object.of(read_yaml(ROOT / "config/objects/vermilion-sphere.yaml"))
    lamps = PoseGroup(light_deg=(30.0, 55.0), camera_deg=(0.0,), light_azimuth_deg=(0.0, 72.0, 144.0, -144.0, -72.0))
    ball = replace(ball, texels=Size(width=24, height=12), poses=(lamps,))
    found, truth = run_chain(ball, *setting, tmp_path), true_material(ball, *setting)
    seen = found.observed & (np.arange(12) < 5)[:, None]  # well above the equator
    exact, own = (m.coefficients[seen] @ m.basis.T for m in (truth, found))
    assert seen[:5].mean() > 0.8 and np.median(delta_e_reflectance(exact, own)) < 2.0
    assert np.median(np.abs(found.alpha / truth.alpha - 1.0)[seen]) < 0.02
