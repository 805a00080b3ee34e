"""Angle of the light from shading and highlights: found where photographs tell it, with an error as stated."""

import numpy as np
import pytest
from test_level_estimate import FLAT, SITTING, dusty, ggx, measured, paper, photographed, seen, sphere

from irodori.fitting.light_angle import Sight, estimate_light_angle
from irodori.fitting.solvers import FitOptions
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


@pytest.mark.stability(stage="fit", case="light angles of a surface that the lobe does not describe")
@pytest.mark.parametrize("surface", ["ggx", "matt", "two lobes", "dusty", "acryl_blue", "garnet_red", "krylon_blue"])
@pytest.mark.parametrize("poses", [SITTING, AROUND], ids=["sitting", "around"])
def test_no_surface_contradicts_angles_that_are_right(surface, poses):
    """An error as large as registration takes for a contradiction would make things worse."""
    modelled = {"ggx": ggx, "matt": matt, "two lobes": two_lobes, "dusty": dusty}
    found = shown(modelled.get(surface) or measured(surface), poses, 3, 0.0)
    assert found is None or abs(found.offset_deg) < 4.0 * np.hypot(0.05, found.error_deg)


def test_photographs_from_one_set_of_angles_tell_nothing():
    level = np.tile([0.0, 0.0, 1.0], (300, 1))
    found = shown(paper, FLAT, 5, 0.0, normal=level)
    assert found is None or abs(found.offset_deg) < 4.0 * np.hypot(0.05, found.error_deg)
