"""Pictures of the default integrator against furnaces and closed forms."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from path_scenes import deviations, traced
from scenes import (
    BALL,
    GOLD_K,
    GOLD_N,
    THIRDS,
    constant_light,
    fresnel,
    material,
    plate,
    render,
    sky,
    sphere_hits,
)

# --- furnaces ----------------------------------------------------------------------------------------------------


@given(reflectance=st.floats(0.0, 1.0), level=st.floats(1e-3, 1e3))
@settings(deadline=None, max_examples=15)
def test_a_grey_sphere_shows_its_reflectance_times_the_light(reflectance, level):
    picture = render(
        [BALL], [material(reflectance)], constant_light(level * np.linspace(0.5, 2.0, 61)), size=(5, 5), samples=8
    )
    expected = reflectance * level * np.linspace(0.5, 2.0, 61)
    assert np.abs(picture[2, 2] - expected).max() <= 1e-5 * level


def test_what_is_below_zero_is_dark_and_adds_no_light():
    """As recovery leaves vivid colours: the rest of the spectrum carries what the negative samples take away."""
    spectrum = np.where(np.arange(61) < 20, -0.05, 0.4)
    light = np.linspace(0.5, 2.0, 61)
    seen = render([BALL], [material(spectrum)], constant_light(light), size=(5, 5))[2, 2]
    assert (seen[:20] == 0).all() and (seen / light).sum() == pytest.approx(spectrum.sum(), rel=1e-5)
    ratio = seen[20:] / (spectrum * light)[20:]
    assert np.ptp(ratio) < 1e-5 and 0.9 < ratio[0] < 1
    # The light itself, seen beside the sphere.
    sky = render([BALL], [material(0.5)], constant_light(spectrum), size=(9, 9))[0, 0]
    assert (sky >= 0).all() and sky.sum() == pytest.approx(spectrum.sum(), rel=1e-5)
    assert (render([BALL], [material(-0.1)], constant_light(light), size=(5, 5))[2, 2] == 0).all()


def test_scale_of_alpha_is_the_reflectances_own():
    # α S / S_G: a user who doubles α doubles the diffuse light.
    one = material(np.linspace(0.1, 0.4, 61))
    two = dataclasses.replace(one, alpha=2 * one.alpha)
    pictures = [render([BALL], [m], constant_light(), size=(5, 5))[2, 2] for m in (one, two)]
    assert np.allclose(pictures[0], np.linspace(0.1, 0.4, 61), rtol=1e-5)
    assert np.allclose(pictures[1], 2 * pictures[0], rtol=1e-5)


@pytest.mark.parametrize("mu", [0.02, 0.1, 0.3, 0.6, 1.0])
def test_gloss_creates_no_energy(mu):
    # Nearly F = 1: a metal of index 0.01 + 20i.
    glossy = material(0.0, beta=1 / (4 * mu**2), mu=mu, n=0.01, k=20.0)
    picture = traced([BALL], [glossy], constant_light(), 256)
    seen = np.isfinite(sphere_hits()[1]).all(axis=-1)
    assert picture.radiance.min() >= 0 and (deviations(picture, 1.0)[seen].max(axis=-1) < 7).all()
    assert picture.radiance[seen].mean() <= 1.0


# --- the mirror --------------------------------------------------------------------------------------------------


FINE = 8  # parts along the side of a pixel


def ball_hits():
    """Rays through the parts of every pixel, normals of the ball that they meet, and cosines; NaN where they miss."""
    ray, normal = sphere_hits(size=(41 * FINE, 41 * FINE))
    return ray, normal, -np.sum(ray * normal, axis=-1)


def pixel_means(values):
    """Means of the parts over the pixels."""
    return values.reshape(41, FINE, 41, FINE, -1).mean(axis=(1, 3))


@pytest.mark.parametrize(("n", "k"), [(1.5, 0.0), (0.2, 3.4), (2.4, 0.0)])
@pytest.mark.parametrize("mirror", [0.3, 1.0])
def test_a_mirror_shows_fresnel_reflectance(n, k, mirror):
    picture = render([BALL], [material(mirror=mirror, n=n, k=k)], constant_light(3.0))
    cosine = ball_hits()[2]
    assert picture[20, 20, 0] == pytest.approx(3.0 * mirror * ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2), rel=1e-4)
    inside = pixel_means(cosine)[..., 0] > 0.4
    assert inside.sum() > 600
    expected = 3.0 * mirror * pixel_means(fresnel(np.nan_to_num(cosine, nan=1.0), n, k))[..., 0]
    assert np.allclose(picture[inside, 30], expected[inside], rtol=0.01)


def test_a_mirrors_colour_is_that_of_its_index():
    n, k = np.array(GOLD_N)[THIRDS], np.array(GOLD_K)[THIRDS]
    light = np.linspace(1.0, 2.0, 61)
    picture = render([BALL], [material(mirror=1.0, n=n, k=k)], constant_light(light))
    assert np.allclose(picture[20, 20], light * ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2), rtol=1e-4)


def test_a_mirror_shows_the_light_of_the_reflected_direction():
    light = sky(lambda d: np.stack([2 + d[..., 0], 2 + d[..., 1], 2 + d[..., 2]], axis=-1), basis=np.eye(61)[:, :3])
    picture = render([BALL], [material(mirror=1.0, n=0.01, k=30.0)], light)
    ray, normal, cosine = ball_hits()
    inside = pixel_means(cosine)[..., 0] > 0.3
    expected = (2 + ray + 2 * cosine[..., None] * normal) * fresnel(np.nan_to_num(cosine, nan=1.0), 0.01, 30.0)[
        ..., None
    ]
    assert np.allclose(picture[inside][:, :3], pixel_means(expected)[inside], rtol=0.01)
    assert np.allclose(picture[0, 0, :3], 2 + ray[0, 0], rtol=5e-3)  # and the sky itself beside it


# --- objects among themselves ------------------------------------------------------------------------------------


def contact(ball_reflectance, plate_reflectance, distance_mm):
    """Radiance of a plate's point at a distance from where a sphere of radius 20 mm stands on it."""
    picture = render([plate(4000.0), BALL], [material(plate_reflectance), material(ball_reflectance)],
                     constant_light(), places=[(0, 0, 0), (0, 0, 20.0)], size=(1, 1), fov=0.05, samples=8192,
                     position=(distance_mm + 400.0, 0.0, 150.0), target=(distance_mm, 0, 0))  # fmt: skip
    return picture[0, 0]


@pytest.mark.parametrize("distance", [12.0, 20.0, 40.0, 100.0])
def test_the_contact_shadow_of_a_black_sphere_is_its_form_factor(distance):
    # A sphere of radius R that rests on the plane hides cosθ (R/D)² = (R/D)³ of the hemisphere, seen from D.
    hidden = (20.0 / np.hypot(20.0, distance)) ** 3
    assert np.allclose(contact(0.0, 0.8, distance), 0.8 * (1 - hidden), atol=0.005)


def test_a_grey_sphere_darkens_its_plate_less_than_a_black_one():
    black, grey, far = (contact(r, 0.8, d)[30] for r, d in ((0.0, 15.0), (0.5, 15.0), (0.5, 300.0)))
    assert black + 0.05 < grey < far - 0.05
    assert far == pytest.approx(0.8, rel=0.01)


def test_white_on_white_leaves_no_shadow_in_a_furnace():
    assert np.allclose(contact(1.0, 1.0, 20.0), 1.0, atol=2e-3)


def test_the_picture_shows_a_textures_places():
    # The left and right half of a plate differ, and so do its upper and lower half: u along +x, v along -y.
    values = np.array([[0.1, 0.4], [0.6, 0.9]]).repeat(16, axis=0).repeat(16, axis=1)
    uniform = material(1.0)
    textured = dataclasses.replace(
        uniform, alpha=values, green_response=np.ones_like(values), beta=np.zeros_like(values),
        mu=np.full_like(values, 0.1), coefficients=np.ones((32, 32, 1), np.float32),
    )  # fmt: skip
    picture = render([plate(100.0)], [textured], constant_light(), position=(0, -0.001, 500), fov=11, size=(40, 40))
    for rows, columns, value in (
        (slice(5, 18), slice(5, 18), 0.1), (slice(5, 18), slice(22, 35), 0.4),
        (slice(22, 35), slice(5, 18), 0.6), (slice(22, 35), slice(22, 35), 0.9),
    ):  # fmt: skip
        assert np.allclose(picture[rows, columns], value, atol=2e-3)
