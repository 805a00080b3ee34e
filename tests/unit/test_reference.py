"""The path tracer against furnaces, closed forms and quadrature: energy, bias, light from afar."""

import dataclasses

import numpy as np
import pytest
from path_scenes import DARK, ball, deviations, facetted_sphere, traced
from scenes import (
    BALL,
    GOLD_K,
    GOLD_N,
    THIRDS,
    constant_light,
    fresnel,
    lobe_integral,
    material,
    plate,
    sky,
    smooth_light,
    smooth_sky,
)
from sky_draws import densities, drawn

from irodori.geometry.rig_frame import rotation_x
from irodori.rendering.reference.sky_sampling import make_sky
from irodori.spectra.published import light as spectrum_of

SPECTRUM = np.linspace(0.2, 0.9, 61)


# --- furnaces ----------------------------------------------------------------------------------------------------


@pytest.mark.stability(stage="render", case="white furnace")
def test_a_white_sphere_vanishes_in_a_white_furnace_in_every_band():
    light = np.linspace(0.5, 2.0, 61)
    picture = traced([BALL], [material(1.0)], constant_light(light), 16)
    assert np.abs(picture.radiance / light - 1).max() <= 1e-5


@pytest.mark.stability(stage="render", case="scene of 1 mm", size=0.001)
@pytest.mark.stability(stage="render", case="scene of 1 km", size=1000.0)
@pytest.mark.stability(stage="render", case="touching spheres")
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3], ids=["1 mm", "1 m", "1 km"])
def test_a_crowd_of_white_spheres_that_touch_vanishes_at_any_size(size):
    """Every path between them ends in the light with all it set out with, or light has leaked."""
    radius = 500.0 * size
    places = [(x * 2 * radius, y * 2 * radius, radius) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    shapes = [plate(1e5 * size), *[ball(radius)] * 4]
    picture = traced(shapes, [material(1.0)] * 5, constant_light(), 64, places=[(0, 0, 0), *places], fov=25,
                     size=(24, 24), position=(0, -8 * radius, 5 * radius), target=(0, 0, radius))  # fmt: skip
    assert np.abs(picture.radiance - 1).max() <= 1e-3
    assert picture.cut == 0


def test_a_ball_on_a_floor_of_a_kilometre_loses_no_light():
    """A ray that left the floor too high above it would start inside of the ball, whose inner side is black."""
    picture = traced([plate(1e6), BALL], [material(1.0)] * 2, constant_light(), 64, size=(24, 24), fov=25,
                     places=[(0, 0, 0), (0, 0, 20.0)], position=(0, -160, 60), target=(0, 0, 10))  # fmt: skip
    # 0.031 with rays that left 7 mm above the floor.
    assert np.abs(picture.radiance - 1).mean() <= 3e-4
    # At outlines, where there are more paths, more pixels have one that is lost, with a smaller part of the light.
    assert (np.abs(picture.radiance[..., 0] - 1) > 1e-3).mean() <= 1e-2


def test_a_great_many_samples_add_up():
    """0.7 is no sum of few powers of two: a total in single precision drifts by 1e-3 over 2¹⁷ of it."""
    picture = traced([BALL], [material(0.7)], constant_light(), 2**19, size=(1, 1), fov=0.1)
    assert np.abs(picture.radiance / 0.7 - 1).max() <= 1e-5


@pytest.mark.stability(stage="render", case="hits on shared edges")
def test_no_path_slips_through_edges_that_triangles_share():
    """What slipped through would meet the black back of the other side."""
    picture = traced([facetted_sphere(20.0, 3)], [material(1.0)], constant_light(), 64, size=(61, 61))
    assert np.abs(picture.radiance - 1).max() <= 1e-4


@pytest.mark.stability(stage="render", case="energy")
@pytest.mark.stability(stage="render", case="roughness at both bounds", mu=(0.005, 1.2))
@pytest.mark.parametrize("mu", [0.005, 0.1, 0.4, 1.2])
def test_no_energy_is_made(mu):
    shapes, places = [plate(200.0), BALL, BALL], [(0, 0, 0), (-20, 0, 20.0), (20, 0, 20.0)]
    materials = [material(0.6, beta=0.1 / (4 * mu**2), mu=mu, mirror=0.3, n=0.1, k=5.0),
                 material(0.0, mirror=1.0, n=0.05, k=9.0),
                 material(0.8, beta=0.2 / (4 * mu**2), mu=mu, n=0.1, k=5.0)]  # fmt: skip
    picture = traced(shapes, materials, constant_light(), 64, places=places, position=(0, -300, 150),
                     target=(0, 0, 15), fov=25, size=(30, 20))  # fmt: skip
    assert picture.radiance.min() >= 0 and (deviations(picture, 1.0).max(axis=-1) < 6).all()
    assert picture.radiance.mean() <= 1.0


@pytest.mark.heavy
def test_light_in_a_closed_room_is_the_sum_of_all_its_reflections():
    """In a sphere every part of the wall lights every other alike: E = E0 / (1 - ρ (1 - r²/R²)) [integrating sphere].

    E0 = π L r²/R² comes from a lamp of radius r in the middle; the lamp itself takes up what falls on it.
    """
    room, lamp, radiance = 100.0, 10.0, 3.0
    reflectance = np.linspace(0.0, 0.95, 61)
    light = {"kind": "sphere", "spectrum": "D65", "radiance": radiance, "position_mm": [0, 0, 0], "radius_mm": lamp}
    picture = traced([facetted_sphere(room, 5, inward=True)], [material(reflectance)], DARK, 4096, position=(0, -60, 0),
                     target=(0, -100, 20), size=(6, 6), fov=40, lights=[light])  # fmt: skip
    share = (lamp / room) ** 2
    spectrum = radiance * spectrum_of("D65")
    expected = reflectance * spectrum * share / (1 - reflectance * (1 - share))
    mean = picture.radiance.mean(axis=(0, 1))
    error = np.sqrt((picture.standard_error**2).sum(axis=(0, 1))) / 36
    assert (error[1:] <= 3e-3 * expected[1:]).all()
    # The facets stand 2e-4 of the radius inside the sphere.
    assert (np.abs(mean - expected) <= 5 * error + 1e-3 * expected).all()


# --- the terms of equation (5) -----------------------------------------------------------------------------------


@pytest.mark.default_cases(8)
@pytest.mark.stability(stage="render", case="roughness at both bounds", mu=(0.005, 1.2))
@pytest.mark.parametrize(("n", "k"), [(1.5, 0.0), (0.2, 3.4)], ids=["lacquer", "metal"])
@pytest.mark.parametrize("mu", [0.005, 0.05, 0.4, 1.2])
@pytest.mark.parametrize("theta_deg", [0.0, 45.0, 80.0, 89.0])
def test_gloss_is_the_lobe_integrated_over_the_light(mu, theta_deg, n, k):
    """A small part of a plate under light that varies slowly, at every roughness, to grazing view."""
    theta = np.radians(theta_deg)
    view = np.array([0.0, -np.sin(theta), np.cos(theta)])
    beta = 1 / (4 * mu**2)
    picture = traced([plate(2000.0)], [material(0.0, beta=beta, mu=mu, n=n, k=k)],
                     smooth_sky(2048, 1024) if mu < 0.05 else smooth_sky(), 8192, position=500 * view,
                     size=(1, 1), fov=0.1, up=(0.0, np.cos(theta), np.sin(theta)))  # fmt: skip
    expected = lobe_integral(np.array([0.0, 0.0, 1.0]), view, beta, mu, n, k)
    assert picture.standard_error[0, 0, 0] <= 5e-3 * expected
    assert abs(picture.radiance[0, 0, 0] - expected) <= 5 * picture.standard_error[0, 0, 0] + 5e-4 * expected


def test_gloss_of_varying_index_agrees_with_each_band_alone():
    light = smooth_sky()
    n, k = np.array(GOLD_N)[THIRDS], np.array(GOLD_K)[THIRDS]
    mixed = traced([BALL], [material(beta=10.0, mu=0.15, mirror=0.3, n=n, k=k)], light, 512, size=(9, 9), fov=10)
    for third in range(3):
        alone = traced([BALL], [material(beta=10.0, mu=0.15, mirror=0.3, n=GOLD_N[third], k=GOLD_K[third])], light, 512,
                       size=(9, 9), fov=10, seed=1)  # fmt: skip
        band = 20 * third + 5
        error = np.hypot(mixed.standard_error[..., band], alone.standard_error[..., band])
        off = np.abs(mixed.radiance[..., band] - alone.radiance[..., band])
        assert (off <= 7 * error + 1e-6).all()
        assert error.mean() <= 0.01 * alone.radiance[..., band].mean()


@pytest.mark.stability(stage="render", case="grazing hits")
@pytest.mark.parametrize(("n", "k"), [(1.5, 0.0), (0.2, 3.4), (3.0, 10.0)])
@pytest.mark.parametrize("theta_deg", [0.0, 56.3, 80.0, 89.9])
def test_a_mirror_shows_fresnel_reflectance_to_grazing_angles(theta_deg, n, k):
    theta = np.radians(theta_deg)
    view = np.array([0.0, -np.sin(theta), np.cos(theta)])
    picture = traced([plate(2000.0)], [material(mirror=1.0, n=n, k=k)], constant_light(3.0), 16, position=100 * view,
                     size=(1, 1), fov=0.001, up=(0.0, np.cos(theta), np.sin(theta)))  # fmt: skip
    assert np.allclose(picture.radiance, 3.0 * fresnel(np.cos(theta), n, k), rtol=1e-5)


@pytest.mark.parametrize(("n", "k"), [(1.5, 0.0), (0.2, 3.4)], ids=["lacquer", "metal"])
@pytest.mark.parametrize("samples", [8, 16, 40, 64])
def test_a_mirror_over_a_diffuse_body_adds_its_light_and_no_noise(samples, n, k):
    """Under even light each branch of a path brings the same every time, however many samples follow the mirror."""
    picture = traced([plate(2000.0)], [material(SPECTRUM, mirror=0.6, n=n, k=k)], constant_light(3.0), samples,
                     position=(0, -60, 80), size=(3, 3), fov=0.001)  # fmt: skip
    assert np.allclose(picture.radiance, 3.0 * (SPECTRUM + 0.6 * fresnel(0.8, n, k)), rtol=2e-5)
    assert picture.standard_error.max() <= 1e-4


@pytest.mark.stability(stage="render", case="Fresnel at 90°")
def test_the_fresnel_reflectance_of_all_bands_is_that_of_one():
    from irodori.reflection.fresnel import fresnel
    from irodori.rendering.reference.band_loops import fill_fresnel, padded

    n, k = np.linspace(0.05, 10, 61), np.linspace(0, 20, 61)[::-1].copy()
    k[40:] = 0.0
    found = np.empty(64, np.float32)
    for cosine in (0.0, 1e-6, 1e-3, 0.1, 0.5, 0.999999, 1.0):
        fill_fresnel(cosine, padded(n[None], "edge"), padded(k[None], "edge"), 0, found)
        expected = [fresnel(cosine, a, b) for a, b in zip(n, k, strict=True)]
        assert np.allclose(found[:61], expected, atol=2e-6)
        if cosine == 0.0:
            assert np.allclose(found, 1.0, atol=1e-6)


@pytest.mark.stability(stage="render", case="parallel mirrors")
def test_between_parallel_mirrors_light_loses_one_reflectance_a_bounce():
    """The eye looks between two plates 20 mm apart at an angle; a ray meets them N times before it leaves."""
    n, k = 0.2, 3.4
    slope = np.tan(np.radians(30.0))  # rise over run of the ray
    picture = traced([plate(400.0)] * 2, [material(mirror=1.0, n=n, k=k)] * 2, constant_light(), 4096, size=(1, 1),
                     fov=0.02, places=[(0, 0, 0), (0, 0, 20.0)], rotations=[np.eye(3), rotation_x(np.pi)],
                     position=(0, -199.0, 10.0), target=(0, -199.0 + 10 / slope, 0.0))  # fmt: skip
    run = 20 / slope
    first = -199.0 + 10 / slope
    bounces = int(np.floor((200 - first) / run)) + 1
    assert bounces == 12
    expected = fresnel(np.sin(np.radians(30.0)), n, k) ** bounces
    assert abs(picture.radiance[0, 0, 30] - expected) <= 5 * picture.standard_error[0, 0, 30] + 1e-3 * expected
    assert picture.standard_error[0, 0, 30] <= 0.02 * expected


# --- light from afar ---------------------------------------------------------------------------------------------


def test_a_plate_shows_the_irradiance_map_of_the_renderer():
    """Independent of the path tracer: the map is summed in harmonics of the sphere, to 2e-3 of its largest value."""
    light = sky(lambda d: np.stack([smooth_light(d), np.exp(20 * (d[..., 2] - 1)), 1 + 0 * d[..., 0]], axis=-1),
                basis=np.eye(61)[:, :3])  # fmt: skip
    picture = traced([plate(100.0)], [material(0.7)], light, 4096, position=(0, -0.001, 500), fov=5, size=(4, 4))
    expected = 0.7 * light.irradiance[0].mean(axis=0) / np.pi
    mean = picture.radiance[..., :3].mean(axis=(0, 1))
    error = np.sqrt((picture.standard_error[..., :3] ** 2).sum(axis=(0, 1))) / 16
    assert (np.abs(mean - expected) <= 5 * error + 2e-3 * expected).all()
    assert (error <= 2e-3 * expected).all()


def one_texel_sun(row=60, column=40, radiance=1e5):
    """A sun of one texel of 512 x 256, from (0.6, 0.3, 0.75) or so for row 60."""
    coefficients = np.zeros((256, 512, 1), np.float32)
    coefficients[row, column] = radiance
    return dataclasses.replace(constant_light(np.full(61, 0.1)), coefficients=coefficients)


def zenith_irradiance(row, radiance=1e5, parts=256) -> float:
    """Irradiance of a surface that faces up by that sun, as it is interpolated: linearly, and flat at the pole."""
    step = (np.arange(2 * parts) + 0.5) / parts - 1
    tent = 1 - np.abs(step)
    if row == 0:
        tent = np.where(step < 0, np.where(step < -0.5, 0.0, 1.0), tent)
    theta = np.pi * (row + 0.5 + step) / 256
    return 0.1 * radiance * np.sum(tent * np.sin(theta) * np.cos(theta)) * np.pi / 256 / parts * 2 * np.pi / 512


@pytest.mark.stability(stage="render", case="one-texel sun")
@pytest.mark.parametrize("row", [0, 3, 60])
def test_a_sun_of_one_texel_is_found_and_weighs_what_it_should(row):
    picture = traced([plate(100.0)], [material(SPECTRUM)], one_texel_sun(row), 256, size=(4, 4), fov=1.0,
                     position=(100, 0, 100))  # fmt: skip
    expected = SPECTRUM * zenith_irradiance(row) / np.pi
    assert (picture.standard_error <= 0.03 * expected).all()
    mean, error = picture.radiance.mean(axis=(0, 1)), np.sqrt((picture.standard_error**2).sum(axis=(0, 1))) / 16
    assert (np.abs(mean - expected) <= 5 * error + 1e-4 * expected).all()
    assert (error <= 5e-3 * expected).all()


@pytest.mark.parametrize("place", [(0, 0), (0, 300), (60, 40), (255, 511)])
def test_directions_are_drawn_with_the_density_that_is_told_for_them(place):
    """What is drawn, divided by its density, integrates any function over the sphere; poles and seam included."""
    rng = np.random.default_rng(3)
    light = one_texel_sun(*place)
    light.coefficients[100:140, 200:300, 0] = rng.uniform(0, 4, (40, 100))
    made = make_sky(light)
    uv = np.random.default_rng(5).random((400_000, 2))
    towards, density = drawn(made, uv)
    assert np.allclose(np.linalg.norm(towards, axis=1), 1)
    again = densities(made, towards)
    usable = np.hypot(towards[:, 0], towards[:, 1]) > 1e-4
    assert np.allclose(density[usable], again[usable], rtol=2e-3)
    # The density integrates to 1: by even directions about the texel and over the rest.
    theta = np.pi * (np.arange(1024) + 0.5) / 1024
    azimuth = 2 * np.pi * (np.arange(1024) + 0.5) / 1024
    total = 0.0
    for t in theta:
        row = np.stack([np.sin(t) * np.cos(azimuth), np.sin(t) * np.sin(azimuth), np.full(1024, np.cos(t))], axis=-1)
        total += densities(made, row).sum() * np.sin(t) * (np.pi / 1024) * (2 * np.pi / 1024)
    assert total == pytest.approx(1.0, abs=2e-3)


@pytest.mark.stability(stage="render", case="black light")
@pytest.mark.stability(stage="render", case="monochromatic light")
def test_black_light_gives_a_black_picture_and_one_wavelength_stays_one():
    picture = traced([BALL], [material(0.5, beta=1.0, mirror=0.2)], DARK, 16, size=(5, 5))
    assert (picture.radiance == 0).all() and (picture.standard_error == 0).all()
    light = np.zeros(61)
    light[17] = 2.0
    picture = traced([BALL], [material(SPECTRUM, beta=1.0, mirror=0.2)], constant_light(light), 16, size=(5, 5))
    assert (np.delete(picture.radiance, 17, axis=-1) == 0).all() and (picture.radiance[..., 17] > 0).all()
