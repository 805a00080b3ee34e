"""The ray tracer against furnaces, closed forms, an independent quadrature and Mitsuba 3; pictures in files."""

import dataclasses
import itertools

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
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
    render,
    sky,
    smooth_light,
    sphere_hits,
)

# --- furnaces ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ambient_samples", [0, 32])
def test_a_white_sphere_vanishes_in_a_white_furnace(ambient_samples):
    picture = render([BALL], [material(1.0)], constant_light(), ambient_samples=ambient_samples)
    assert np.abs(picture - 1).max() <= 1e-3


def test_a_white_sphere_vanishes_with_the_chains_own_irradiance_map():
    picture = render([BALL], [material(1.0)], sky(lambda d: np.ones((*d.shape[:2], 1)), 1000, 500))
    assert np.abs(picture - 1).max() <= 2e-3  # the map's own tolerance


@given(reflectance=st.floats(0.0, 1.0), level=st.floats(1e-3, 1e3))
@settings(deadline=None, max_examples=15)
def test_a_grey_sphere_shows_its_reflectance_times_the_light(reflectance, level):
    picture = render([BALL], [material(reflectance)], constant_light(level * np.linspace(0.5, 2.0, 61)), size=(5, 5))
    expected = reflectance * level * np.linspace(0.5, 2.0, 61)
    assert np.abs(picture[2, 2] - expected).max() <= 1e-5 * level


def test_what_is_below_zero_is_dark_and_adds_no_light():
    """As recovery leaves vivid colours: the rest of the spectrum carries what the negative samples take away."""
    spectrum = np.where(np.arange(61) < 20, -0.05, 0.4)
    light = np.linspace(0.5, 2.0, 61)
    seen = render([BALL], [material(spectrum)], constant_light(light), size=(5, 5))[2, 2]
    assert (seen[:20] == 0).all() and seen.sum() == pytest.approx((spectrum * light).sum(), rel=1e-5)
    ratio = seen[20:] / (spectrum * light)[20:]
    assert np.ptp(ratio) < 1e-5 and 0.9 < ratio[0] < 1
    # The light itself, seen beside the sphere.
    sky = render([BALL], [material(0.5)], constant_light(spectrum), size=(5, 5))[0, 0]
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
    picture = render([BALL], [glossy], constant_light(), gloss_samples=1024)
    assert picture.max() <= 1 + 2e-3 and picture.min() >= 0


def test_a_crowded_scene_creates_no_energy():
    shapes = [plate(200.0), BALL, BALL]
    materials = [material(0.6, beta=0.1 / (4 * 0.2**2), mu=0.2, mirror=0.3, n=0.1, k=5.0),
                 material(0.0, mirror=1.0, n=0.05, k=9.0),
                 material(0.8, beta=0.2 / (4 * 0.1**2), mu=0.1, n=0.1, k=5.0)]  # fmt: skip
    places = [(0, 0, 0), (-21, 0, 20.0), (21, 0, 20.0)]
    picture = render(shapes, materials, constant_light(), places=places, position=(0, -300, 150), target=(0, 0, 15),
                     fov=25, size=(60, 40), ambient_samples=64, gloss_samples=64, max_bounces=20)  # fmt: skip
    assert picture.max() <= 1.005 and picture.min() >= 0


# --- the mirror --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("n", "k"), [(1.5, 0.0), (0.2, 3.4), (2.4, 0.0)])
@pytest.mark.parametrize("mirror", [0.3, 1.0])
def test_a_mirror_shows_fresnel_reflectance(n, k, mirror):
    picture = render([BALL], [material(mirror=mirror, n=n, k=k)], constant_light(3.0))
    ray, normal = sphere_hits()
    cosine = -np.sum(ray * normal, axis=-1)
    assert picture[20, 20, 0] == pytest.approx(3.0 * mirror * ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2), rel=1e-4)
    inside = cosine > 0.2
    assert inside.sum() > 800
    assert np.allclose(picture[inside, 30], 3.0 * mirror * fresnel(cosine[inside], n, k), rtol=1e-3)


def test_a_mirrors_colour_is_that_of_its_index():
    n, k = np.array(GOLD_N)[THIRDS], np.array(GOLD_K)[THIRDS]
    light = np.linspace(1.0, 2.0, 61)
    picture = render([BALL], [material(mirror=1.0, n=n, k=k)], constant_light(light))
    assert np.allclose(picture[20, 20], light * ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2), rtol=1e-4)


def test_a_mirror_shows_the_light_of_the_reflected_direction():
    light = sky(lambda d: np.stack([2 + d[..., 0], 2 + d[..., 1], 2 + d[..., 2]], axis=-1), basis=np.eye(61)[:, :3])
    picture = render([BALL], [material(mirror=1.0, n=0.01, k=30.0)], light)
    ray, normal = sphere_hits()
    cosine = -np.sum(ray * normal, axis=-1)
    inside = cosine > 0.3
    reflected = ray + 2 * cosine[..., None] * normal
    expected = (2 + reflected[inside]) * fresnel(cosine[inside], 0.01, 30.0)[..., None]
    assert np.allclose(picture[inside][:, :3], expected, rtol=2e-3)
    assert np.allclose(picture[0, 0, :3], 2 + ray[0, 0], rtol=2e-3)  # and the sky itself beside it


def test_mirrors_facing_each_other_stop_at_the_limit():
    # Between two parallel mirrors each bounce adds one reflection; what is never seen again is lost, not invented.
    shapes = [plate(100.0), BALL]
    materials = [material(mirror=1.0, n=0.01, k=30.0)] * 2
    places = [(0, 0, 0), (0, 0, 20.001)]
    view = {"position": (0, -120, 30), "target": (0, -12, 4), "fov": 12, "size": (30, 30), "places": places}
    pictures = [render(shapes, materials, constant_light(), max_bounces=b, **view) for b in (1, 3, 10, 30)]
    for less, more in itertools.pairwise(pictures):
        assert (more >= less - 1e-6).all() and more.max() <= 1 + 1e-5
    assert pictures[0].mean() < pictures[-1].mean()
    assert pictures[-1].mean() > 0.98


# --- gloss -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("n", "k"), [(1.5, 0.0), (0.2, 3.4)], ids=["lacquer", "metal"])
@pytest.mark.parametrize("mu", [0.03, 0.12, 0.35])
def test_gloss_is_the_lobe_integrated_over_the_light(mu, n, k):
    beta = 1 / (4 * mu**2)
    light = sky(lambda d: smooth_light(d)[..., None])
    picture = render([BALL], [material(0.0, beta=beta, mu=mu, n=n, k=k)], light, gloss_samples=256)[..., 0]
    ray, normal = sphere_hits()
    cosine = -np.sum(ray * normal, axis=-1)
    for y, x in [(20, 20), (14, 20), (20, 27), (28, 12), (10, 14), (25, 33), (33, 24)]:
        assert cosine[y, x] > 0.25
        expected = lobe_integral(normal[y, x], -ray[y, x], beta, mu, n, k)
        assert picture[y, x] == pytest.approx(expected, rel=0.02)


def test_gloss_of_varying_index_agrees_with_each_band_alone():
    light = sky(lambda d: smooth_light(d)[..., None])
    n, k = np.array(GOLD_N)[THIRDS], np.array(GOLD_K)[THIRDS]
    mixed = render([BALL], [material(beta=10.0, mu=0.15, n=n, k=k)], light, size=(9, 9), gloss_samples=64)
    for third in range(3):
        alone = render([BALL], [material(beta=10.0, mu=0.15, n=GOLD_N[third], k=GOLD_K[third])], light, size=(9, 9),
                       gloss_samples=64)  # fmt: skip
        assert np.allclose(mixed[..., 20 * third + 5], alone[..., 20 * third + 5], rtol=1e-5)


# --- objects among themselves ------------------------------------------------------------------------------------


def contact(ball_reflectance, plate_reflectance, distance_mm, ambient_samples):
    """Radiance of a plate's point at a distance from where a sphere of radius 20 mm stands on it."""
    picture = render([plate(4000.0), BALL], [material(plate_reflectance), material(ball_reflectance)],
                     constant_light(), places=[(0, 0, 0), (0, 0, 20.0)], size=(1, 1), fov=0.05, pixel_side=4,
                     position=(distance_mm + 400.0, 0.0, 150.0), target=(distance_mm, 0, 0),
                     ambient_samples=ambient_samples)  # fmt: skip
    return picture[0, 0]


@pytest.mark.parametrize("distance", [12.0, 20.0, 40.0, 100.0])
def test_the_contact_shadow_of_a_black_sphere_is_its_form_factor(distance):
    # A sphere of radius R that rests on the plane hides cosθ (R/D)² = (R/D)³ of the hemisphere, seen from D.
    hidden = (20.0 / np.hypot(20.0, distance)) ** 3
    found = contact(0.0, 0.8, distance, ambient_samples=1024)
    assert np.allclose(found, 0.8 * (1 - hidden), atol=0.005)
    assert np.allclose(contact(0.0, 0.8, distance, ambient_samples=0), 0.8, atol=1e-3)


def test_a_grey_sphere_darkens_its_plate_less_than_a_black_one():
    black, grey, far = (contact(r, 0.8, d, 256)[30] for r, d in ((0.0, 15.0), (0.5, 15.0), (0.5, 300.0)))
    assert black + 0.05 < grey < far - 0.05
    assert far == pytest.approx(0.8, rel=0.01)


def test_white_on_white_leaves_no_shadow_in_a_furnace():
    assert np.allclose(contact(1.0, 1.0, 20.0, 256), 1.0, atol=2e-3)


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


@pytest.fixture
def threads():
    before = numba.get_num_threads()
    yield numba.set_num_threads
    numba.set_num_threads(before)


def test_threads_and_tiles_do_not_change_a_bit(threads):
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one thread only")
    light = sky(lambda d: np.stack([smooth_light(d), 1 - 0.5 * d[..., 0]], axis=-1), basis=np.eye(61)[:, :2] + 0.1)
    shapes, places = [plate(120.0), BALL, BALL], [(0, 0, 0), (-22, 0, 20), (22, 5, 20)]
    materials = [material(0.5, beta=1.0, mirror=0.2), material(0.3, beta=3.0, mu=0.2), material(mirror=1.0, n=0.2, k=3)]
    view = {"position": (20, -250, 130), "target": (0, 0, 10), "fov": 24, "size": (50, 40), "places": places}
    sampled = {"ambient_samples": 8, "gloss_samples": 8, "pixel_side": 2}
    pictures = []
    for count, tile_rows in ((1, 60), (2, 60), (2, 7), (2, 1)):
        threads(count)
        pictures.append(render(shapes, materials, light, tile_rows=tile_rows, **view, **sampled))
    assert np.isfinite(pictures[0]).all()
    for other in pictures[1:]:
        assert np.array_equal(pictures[0], other)
