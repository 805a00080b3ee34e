"""Directions drawn towards rectangles and spheres: their density is what is told for them, on both sides of a path."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from made import made
from scipy.stats import qmc

from irodori.config.models import SceneLight
from irodori.jit.compilation import njit
from irodori.light.placed_lights import unit_luminance
from irodori.rendering.scene_lights import density_towards, make_lights, sample_towards, upward_radiance

POINTS = qmc.Sobol(2, seed=1).random_base2(14)


@njit(cache=True)
def _drawn(lights, point, places, towards, density, again):
    for i in range(len(places)):
        density[i] = sample_towards(lights, 0, point, places[i, 0], places[i, 1], towards[i])
        again[i] = density_towards(lights, 0, point, towards[i])


def drawn(lights, point):
    """Return directions drawn from a point, and their densities, which the other side of a path must find too."""
    towards, density, again = np.empty((len(POINTS), 3)), np.empty(len(POINTS)), np.empty(len(POINTS))
    _drawn(lights, point, POINTS, towards, density, again)
    assert np.allclose(np.linalg.norm(towards, axis=1), 1)
    # A direction to the very rim of a light may miss it by rounding.
    assert (density > 0).all() and np.allclose(again, density, rtol=1e-6)
    return towards, density


def edges_sum(corners) -> np.ndarray:
    """Vector irradiance of a polygon of radiance 1, seen from the origin: Lambert's sum over its edges."""
    total = np.zeros(3)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        across = np.cross(a, b)
        sine = np.linalg.norm(across)
        total += 0.5 * math.atan2(sine, a @ b) * across / sine
    return total


#: Directions of the upper half by the cosine to the zenith: their share that meets a light is its form factor.
_U, _TURN = qmc.Sobol(2, seed=3).random_base2(18).T
UPWARD = np.stack(
    [np.sqrt(_U) * np.cos(2 * np.pi * _TURN), np.sqrt(_U) * np.sin(2 * np.pi * _TURN), np.sqrt(1 - _U)], axis=-1
)


def white_of(light) -> float:
    """Return the radiance of a diffuser at the origin under a light of radiance 1, relative to that of the light."""
    found = upward_radiance(make_lights(made(Sequence[SceneLight], [light]), 0)[0])
    assert np.allclose(found / unit_luminance("D65"), found[30] / unit_luminance("D65")[30], rtol=1e-6)
    return float(found[30] / unit_luminance("D65")[30])


@pytest.mark.parametrize(
    ("centre", "radius"),
    [((0, -500, 100), 300), ((0, -300, 200), 350), ((0, -500, 0), 300), ((0, -100, 0), 90), ((0, -500, -100), 300),
     ((10, 20, 200), 50), ((0, 0, 100), 99), ((0, -500, -400), 300), ((0, 0, -100), 99)],
)  # fmt: skip
def test_the_white_of_a_ball_is_its_part_above_the_horizon(centre, radius):
    along = UPWARD @ np.array(centre, dtype=np.float64)
    is_met = (along > 0) & (along**2 > float(np.dot(centre, centre)) - radius**2)
    ball = {"kind": "sphere", "spectrum": "D65", "radiance": 1.0, "position_mm": list(centre), "radius_mm": radius}
    assert white_of(ball) == pytest.approx(is_met.mean(), abs=2e-4)


@pytest.mark.parametrize(
    ("place", "turn_deg"),
    [((0, 0, 5), (180, 0, 0)), ((0, 0, 20), (180, 0, 0)), ((100, 30, 500), (180, 0, 20)), ((0, -200, -10), (-90, 0, 0)),
     ((50, -300, 20), (-120, 20, 0)), ((0, 0, 20), (0, 0, 0)), ((0, 0, -20), (0, 0, 0))],
)  # fmt: skip
def test_the_white_of_a_panel_is_its_part_above_the_horizon(place, turn_deg):
    panel = {"kind": "rectangle", "spectrum": "D65", "radiance": 1.0, "rotation_deg": list(turn_deg),
             "position_mm": list(place), "width_mm": 1000, "height_mm": 400}  # fmt: skip
    lights, _ = make_lights(made(Sequence[SceneLight], [panel]), 0)
    centre, turn = lights.position_mm[0], lights.rotation[0]
    facing = UPWARD @ turn[:, 2]
    distance = (centre @ turn[:, 2]) / np.where(facing == 0.0, 1.0, facing)
    across = (UPWARD * distance[:, None] - centre) @ turn
    is_met = (facing < 0) & (distance > 0) & (np.abs(across[:, 0]) < 500) & (np.abs(across[:, 1]) < 200)
    assert white_of(panel) == pytest.approx(is_met.mean(), abs=2e-4)


@pytest.mark.parametrize("scale", [1e-2, 1.0, 1e4])
@pytest.mark.parametrize("turn_deg", [[0, 0, 0], [180, 0, 25], [35, -60, 10]])
@pytest.mark.parametrize(
    "place",
    [(0, 0, 50), (0, 0, 1e-2), (29.9, 19, 1e-2), (31, 0, 1e-2), (300, 10, 1.0), (300, 10, 0.05), (3000, 0, 1000),
     (20, -300, 5.0), (30, 20, 1e-6)],
)  # fmt: skip
def test_what_is_drawn_from_a_rectangle_over_its_density_is_its_light(place, turn_deg, scale):
    """Over it, beside it, far away and all but in its plane."""
    panel = {"kind": "rectangle", "spectrum": "D65", "radiance": 1.0, "rotation_deg": turn_deg,
             "position_mm": [scale, 2 * scale, 3 * scale], "width_mm": 60 * scale, "height_mm": 40 * scale}  # fmt: skip
    lights, _ = make_lights(made(Sequence[SceneLight], [panel]), 0)
    centre, turn = lights.position_mm[0], lights.rotation[0]
    point = centre + turn @ (scale * np.array(place, dtype=np.float64))
    towards, density = drawn(lights, point)
    corners = [centre - point + turn @ (scale * np.array([30.0 * a, 20.0 * b, 0.0]))
               for a, b in ((-1, -1), (-1, 1), (1, 1), (1, -1))]  # fmt: skip
    expected = edges_sum(np.array(corners))
    assert np.abs((towards / density[:, None]).mean(axis=0) - expected).max() <= 2e-4 * np.linalg.norm(expected)


def test_from_behind_and_from_within_its_plane_a_rectangle_gives_nothing():
    panel = {"kind": "rectangle", "spectrum": "D65", "radiance": 1.0, "rotation_deg": [0, 0, 0],
             "position_mm": [0, 0, 0], "width_mm": 60, "height_mm": 40}  # fmt: skip
    lights, _ = make_lights(made(Sequence[SceneLight], [panel]), 0)
    for point in ([0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [100.0, 0.0, 0.0]):
        density, towards = np.empty((2, 1)), np.zeros((1, 3))
        towards[0, 2] = 1.0
        _drawn(lights, np.array(point), POINTS[5:6], towards, density[0], density[1])
        assert density[0, 0] == 0 and density[1, 0] == 0


@pytest.mark.parametrize("distance", [10.0 + 1e-6, 11.0, 100.0, 1e6])
def test_what_is_drawn_from_a_sphere_over_its_density_is_its_light(distance):
    bulb = {"kind": "sphere", "spectrum": "D65", "radiance": 1.0, "position_mm": [3, -4, 12], "radius_mm": 10.0}
    lights, _ = make_lights(made(Sequence[SceneLight], [bulb]), 0)
    axis = np.array([3.0, -4.0, 12.0]) / 13.0
    towards, density = drawn(lights, lights.position_mm[0] - distance * axis)
    expected = math.pi * (10.0 / distance) ** 2 * axis
    assert np.allclose(
        (towards / density[:, None]).mean(axis=0), expected, rtol=0, atol=2e-4 * np.linalg.norm(expected)
    )
