"""The ray tracer against furnaces, closed forms, an independent quadrature and Mitsuba 3; pictures in files."""

import dataclasses
import itertools
import json
from pathlib import Path

import numba
import numpy as np
import OpenImageIO as oiio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from irodori import store
from irodori.environment import irradiance_map
from irodori.errors import InputError
from irodori.geometry.shapes import Shape
from irodori.light import Environment, directions
from irodori.material import Material
from irodori.pictures import channel_names, read_spectral_exr, write_png, write_spectral_exr
from irodori.rendering.stage import render_image, render_view
from irodori.spectra import WAVELENGTH_NM

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
OPTIONS = {"pixel_side": 1, "ambient_samples": 0, "gloss_samples": 0, "max_bounces": 5, "min_throughput": 1e-9}
ONES = np.ones(61)
# Gold at about 650, 550 and 450 nm (Johnson and Christy 1972), in thirds of the grid.
GOLD_N, GOLD_K = (0.16, 0.42, 1.50), (3.80, 2.35, 1.88)
THIRDS = np.minimum(np.arange(61) // 20, 2)


def fresnel(cosine, n, k):
    """Unpolarised reflectance from the amplitudes, complex arithmetic."""
    index = n + 1j * np.asarray(k)
    inside = np.sqrt(1 - (1 - cosine**2) / index**2 + 0j)
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (index * cosine - inside) / (index * cosine + inside)
    return 0.5 * (abs(s) ** 2 + abs(p) ** 2)


def material(reflectance=0.0, beta=0.0, mu=0.1, mirror=0.0, n=1.5, k=0.0) -> Material:
    """A uniform material; ``reflectance`` is a number or a spectrum (61,)."""
    size = (4, 8)
    spectrum = np.broadcast_to(np.asarray(reflectance, dtype=np.float64), 61)
    return Material(
        alpha=np.full(size, 0.5), beta=np.full(size, float(beta)), mu=np.full(size, float(mu)),
        green_response=np.full(size, 0.5), coefficients=np.ones((*size, 1), np.float32), basis=spectrum[:, None].copy(),
        n=np.broadcast_to(np.asarray(n, float), 61).copy(), k=np.broadcast_to(np.asarray(k, float), 61).copy(),
        mirror=mirror, typical_gloss=(1.0, 0.1),
    )  # fmt: skip


def constant_light(radiance=1.0) -> Environment:
    """Light of one radiance from everywhere; its irradiance is π times that."""
    basis = np.broadcast_to(np.asarray(radiance, dtype=np.float64), 61)[:, None].copy()
    return Environment(np.ones((32, 64, 1), np.float32), basis, np.full((16, 32, 1), np.pi, np.float32))


def sky(function, width=512, height=256, basis=None) -> Environment:
    """Light whose coefficients are a function of the direction, (height, width, 3) -> (height, width, k)."""
    coefficients = function(directions(width, height)[0]).astype(np.float32)
    basis = np.ones((61, 1)) if basis is None else basis
    return Environment(coefficients, basis, irradiance_map(coefficients, 128, 64))


BALL = Shape.from_definition({"kind": "sphere", "radius_mm": 20.0})


def plate(side_mm: float) -> Shape:
    return Shape.from_definition({"kind": "plate", "width_mm": side_mm, "height_mm": side_mm})


def render(shapes, materials, light, position=(0.0, -200.0, 0.0), target=(0.0, 0.0, 0.0), size=(41, 41), fov=13.0,
           places=None, tile_rows=60, **options):  # fmt: skip
    places = places or [(0.0, 0.0, 0.0)] * len(shapes)
    scene = {
        "image": {"width": size[0], "height": size[1]},
        "objects": [
            {"object": f"o{i}", "position_mm": list(p), "rotation_deg": [0.0, 0.0, 0.0], "scale": 1.0}
            for i, p in enumerate(places)
        ],
        "views": {"v": {"position_mm": list(position), "target_mm": list(target), "up": [0.0, 0.0, 1.0],
                        "field_of_view_deg": fov}},
    }  # fmt: skip
    return render_image(scene, "v", shapes, materials, light, OPTIONS | options, tile_rows)[0]


def pixel_rays(position=(0.0, -200.0, 0.0), target=(0.0, 0.0, 0.0), size=(41, 41), fov=13.0):
    """Unit view directions of the pixel centres, (height, width, 3)."""
    forward = np.subtract(target, position) / np.linalg.norm(np.subtract(target, position))
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    half = np.tan(np.radians(fov) / 2)
    x = (np.arange(size[0]) + 0.5 - size[0] / 2) / (size[1] / 2) * half
    y = (size[1] / 2 - np.arange(size[1]) - 0.5) / (size[1] / 2) * half
    ray = forward + x[None, :, None] * right + y[:, None, None] * up
    return ray / np.linalg.norm(ray, axis=-1, keepdims=True)


def sphere_hits(radius=20.0, position=(0.0, -200.0, 0.0), **view):
    """Rays, normals at their first meeting with a sphere at the origin (NaN where they miss)."""
    ray = pixel_rays(position, **view)
    along = ray @ np.asarray(position)
    with np.errstate(invalid="ignore"):
        distance = -along - np.sqrt(along**2 - (np.dot(position, position) - radius**2))
    return ray, (np.asarray(position) + distance[..., None] * ray) / radius


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


def smooth_light(direction):
    x, y, z = np.moveaxis(direction, -1, 0)
    return 1.0 + 0.5 * x - 0.3 * y + 0.6 * z * z + 0.2 * x * z


def lobe_integral(normal, view, beta, mu, n, k) -> float:
    """Radiance β/π ∫ L F D G / cosθ_r dω of equation (5), Gauss-Legendre over half vectors."""
    nodes, weights = np.polynomial.legendre.leggauss(160)
    top = min(6 * mu, np.pi / 2)
    phi, dphi = (nodes + 1) / 2 * top, weights * top / 2
    around = (np.arange(256) + 0.5) * 2 * np.pi / 256
    tangent = np.cross(normal, [0.3, 0.9, -0.2])
    tangent /= np.linalg.norm(tangent)
    bitangent = np.cross(normal, tangent)
    phi, around = np.meshgrid(phi, around, indexing="ij")
    ring = np.cos(around)[..., None] * tangent + np.sin(around)[..., None] * bitangent
    half = np.cos(phi)[..., None] * normal + np.sin(phi)[..., None] * ring
    cos_h = half @ view
    light = 2 * cos_h[..., None] * half - view
    cos_i, cos_r = light @ normal, normal @ view
    valid = (cos_h > 1e-6) & (cos_i > 0)
    safe = np.where(valid, cos_h, 1.0)
    geometric = np.minimum(1.0, 2 * np.cos(phi) / safe * np.minimum(cos_r, cos_i))
    value = smooth_light(light) * fresnel(safe, n, k) * np.exp(-((phi / mu) ** 2)) * geometric / cos_r * 4 * safe
    return beta / np.pi * np.sum(np.where(valid, value, 0.0) * np.sin(phi) * dphi[:, None] * 2 * np.pi / 256)


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


# --- the material ------------------------------------------------------------------------------------------------


def test_gaps_take_the_nearest_observed_texel_around_the_seam():
    rng = np.random.default_rng(1)
    height, width = 12, 24
    observed = rng.uniform(size=(height, width)) < 0.1
    observed[:, :8] = False
    observed[5, 23] = True
    code = np.arange(height * width, dtype=np.float64).reshape(height, width) + 1
    known = observed & (rng.uniform(size=observed.shape) < 0.5)
    gaps = Material(
        alpha=np.where(observed, code, np.nan), green_response=np.where(observed, code * 2, np.nan),
        beta=np.where(known, 5.0, np.nan), mu=np.where(known, 0.3, np.nan),
        coefficients=np.where(observed, code * 3, np.nan)[..., None].astype(np.float32), basis=np.ones((61, 1)),
        n=ONES, k=ONES, mirror=0.0, typical_gloss=(7.0, 0.25),
    )  # fmt: skip
    whole, share = gaps.filled()
    assert share == pytest.approx(1 - observed.mean())
    rows, columns = np.nonzero(observed)
    for y in range(height):
        for x in range(width):
            across = np.abs(columns - x)
            distance2 = (rows - y) ** 2 + np.minimum(across, width - across) ** 2
            nearest = code[rows, columns][distance2 == distance2.min()]
            assert whole.alpha[y, x] in nearest
            assert whole.green_response[y, x] == 2 * whole.alpha[y, x]
            assert whole.coefficients[y, x, 0] == 3 * whole.alpha[y, x]
    assert np.array_equal(whole.beta, np.where(known, 5.0, 7.0))
    assert np.array_equal(whole.mu, np.where(known, 0.3, 0.25))
    assert np.array_equal(whole.alpha[observed], code[observed])


def test_a_material_of_gaps_alone_is_refused():
    empty = dataclasses.replace(material(0.5), alpha=np.full((4, 8), np.nan))
    with pytest.raises(ValueError, match="accepted"):
        empty.filled()


def test_a_material_survives_its_file(tmp_path):
    saved = material(np.linspace(0.1, 0.9, 61), beta=np.nan, mu=np.nan, mirror=0.4, n=np.linspace(1.4, 1.6, 61))
    saved.save(tmp_path / "m.h5", store.Provenance("test"))
    loaded = Material.load(tmp_path / "m.h5")
    for field in dataclasses.fields(Material):
        assert np.array_equal(getattr(loaded, field.name), getattr(saved, field.name), equal_nan=field.name != "extra")
    assert np.allclose(loaded.spectra(), np.linspace(0.1, 0.9, 61))


# --- pictures in files -------------------------------------------------------------------------------------------


def spectral_picture(path, seed=2, size=(24, 32)):
    rng = np.random.default_rng(seed)
    radiance = rng.gamma(1.0, 1.0, (*size, 61)).astype(np.float32)
    write_spectral_exr(path, radiance, radiance[..., :3], {"irodori:test": "yes"})
    return radiance


def test_a_spectral_exr_keeps_every_bit(tmp_path):
    radiance = spectral_picture(tmp_path / "a.exr")
    assert np.array_equal(read_spectral_exr(tmp_path / "a.exr"), radiance)
    assert [file.name for file in tmp_path.iterdir()] == ["a.exr"]


def test_layers_are_named_as_the_published_layout_says(tmp_path):
    spectral_picture(tmp_path / "a.exr")
    source = oiio.ImageInput.open(str(tmp_path / "a.exr"))
    names, spec = list(source.spec().channelnames), source.spec()
    source.close()
    expected = [f"S0.{wavelength},000000nm" for wavelength in range(400, 701, 5)]
    assert channel_names() == expected
    assert sorted(names) == sorted(["R", "G", "B", *expected])
    assert spec.getattribute("spectralLayoutVersion") == "1.0" and spec.getattribute("emissiveUnits")
    assert spec.getattribute("irodori:test") == "yes"


@pytest.mark.parametrize("keep", [0, 4, 300, 0.25, 0.5, 0.9, 0.999])
def test_a_truncated_exr_is_refused(tmp_path, keep):
    path = tmp_path / "a.exr"
    spectral_picture(path)
    content = path.read_bytes()
    path.write_bytes(content[: keep if isinstance(keep, int) else int(keep * len(content))])
    with pytest.raises(InputError, match=r"a\.exr"):
        read_spectral_exr(path)


def test_an_exr_that_is_missing_or_lacks_a_wavelength_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"missing\.exr"):
        read_spectral_exr(tmp_path / "missing.exr")
    spec = oiio.ImageSpec(4, 4, 3, "float")
    output = oiio.ImageOutput.create(str(tmp_path / "rgb.exr"))
    assert output.open(str(tmp_path / "rgb.exr"), spec) and output.write_image(np.ones((4, 4, 3), np.float32))
    output.close()
    with pytest.raises(InputError, match="400 nm"):
        read_spectral_exr(tmp_path / "rgb.exr")


def test_another_programs_exr_of_other_wavelengths_is_refused_by_name():
    path = DATA / "spectral" / "macbeth_chart_36_bands.exr"
    if not path.is_file():
        pytest.skip(f"no picture at {path}")
    with pytest.raises(InputError, match="no layer for 4"):
        read_spectral_exr(path)


def test_a_png_keeps_its_pixels_and_carries_srgb(tmp_path):
    from PIL import ImageCms

    pixels = np.random.default_rng(3).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    write_png(tmp_path / "a.png", pixels)
    with Image.open(tmp_path / "a.png") as image:
        assert image.mode == "RGB" and np.array_equal(np.asarray(image), pixels)
        profile = image.info["icc_profile"]
    (tmp_path / "profile.icc").write_bytes(profile)
    assert "sRGB" in ImageCms.getProfileDescription(ImageCms.getOpenProfile(str(tmp_path / "profile.icc")))


def test_a_view_in_files_shows_a_white_diffuser_as_white(tmp_path):
    light = constant_light(np.linspace(0.3, 3.0, 61))
    provenance = store.Provenance("test")
    light.save(tmp_path / "e.h5", provenance)
    for name, reflectance in (("white", 1.0), ("grey", 0.2)):
        material(reflectance).save(tmp_path / f"{name}.h5", provenance)
    shapes = [{"kind": "plate", "width_mm": 100.0, "height_mm": 100.0}, {"kind": "sphere", "radius_mm": 20.0}]
    scene = {
        "image": {"width": 31, "height": 31}, "display": {"exposure": "auto"},
        "objects": [{"object": n, "position_mm": [0, 0, z], "rotation_deg": [0, 0, 0], "scale": 1.0}
                    for n, z in (("white", 0.0), ("grey", 40.0))],
        "views": {"v": {"position_mm": [0, -0.01, 500.0], "target_mm": [0, 0, 0], "up": [0, 0, 1],
                        "field_of_view_deg": 11.0}},
    }  # fmt: skip
    render_view(scene, "v", shapes, [tmp_path / "white.h5", tmp_path / "grey.h5"], tmp_path / "e.h5",
                tmp_path / "v.exr", tmp_path / "v.png", tmp_path / "v.json", OPTIONS, 10)  # fmt: skip
    radiance = read_spectral_exr(tmp_path / "v.exr")
    assert np.allclose(radiance[2, 2], np.linspace(0.3, 3.0, 61), rtol=2e-3)
    with Image.open(tmp_path / "v.png") as image:
        pixels = np.asarray(image).astype(int)
    assert (pixels[2, 2] >= 254).all()
    # sRGB of a fifth of white, neutral: 255 (1.055 * 0.2^(1/2.4) - 0.055).
    assert np.abs(pixels[15, 15] - 255 * (1.055 * 0.2 ** (1 / 2.4) - 0.055)).max() <= 1
    figures = json.loads((tmp_path / "v.json").read_text())
    assert figures["exposure"] == 1.0 and figures["filled_fraction"] == {"white": 0.0, "grey": 0.0}
    assert WAVELENGTH_NM.size == radiance.shape[2]


# --- Mitsuba 3 ---------------------------------------------------------------------------------------------------


def mitsuba_picture(bsdf: dict, coefficients: np.ndarray, samples: int, size=(64, 64), fov=16.0) -> np.ndarray:
    """A sphere of radius 20 at the origin seen from (0, -200, 0) under an equirectangular picture, (h, w, 3)."""
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    # Mitsuba's picture has y up and its azimuth runs the other way round.
    turn = mitsuba.ScalarTransform4f([[0, 0, -1, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    bitmap = mitsuba.Bitmap(np.ascontiguousarray(coefficients[:, ::-1]))
    scene = mitsuba.load_dict({
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "light": {"type": "envmap", "bitmap": bitmap, "to_world": turn},
        "ball": {"type": "sphere", "radius": 20.0, "bsdf": bsdf},
        "camera": {
            "type": "perspective", "fov": fov, "fov_axis": "y",
            "to_world": mitsuba.ScalarTransform4f().look_at(origin=[0, -200, 0], target=[0, 0, 0], up=[0, 0, 1]),
            "film": {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": {"type": "box"},
                     "component_format": "float32"},
            "sampler": {"type": "multijitter", "sample_count": samples},
        },
    })  # fmt: skip
    return np.array(mitsuba.render(scene, seed=1))


def room(direction):
    """Three bands of smooth light with a broad bright side."""
    x, y, z = np.moveaxis(direction, -1, 0)
    bands = (1 + 0.5 * x + np.exp(4 * (z - 1)), 1 - 0.4 * y + 0.3 * x * z, 0.6 + 0.4 * z + 0.5 * y * y)
    return np.stack(bands, axis=-1)


def one_hot() -> np.ndarray:
    """A basis whose three vectors are the thirds of the grid."""
    return np.eye(3)[THIRDS]


def mean_difference(ours, theirs) -> float:
    return float(np.abs(ours[..., [10, 30, 50]] - theirs).mean() / theirs.mean())


@pytest.mark.parametrize("lighting", ["constant", "room"])
def test_mitsuba_agrees_on_a_diffuse_sphere(lighting):
    pytest.importorskip("mitsuba")
    light = sky(room if lighting == "room" else lambda d: np.ones_like(d) * [1.0, 2.0, 0.5], basis=one_hot())
    reflectance = (0.7, 0.4, 0.15)
    bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(reflectance)}}
    theirs = mitsuba_picture(bsdf, light.coefficients, samples=256)
    ours = render([BALL], [material(np.array(reflectance)[THIRDS])], light, size=(64, 64), fov=16.0, pixel_side=4)
    assert mean_difference(ours, theirs) <= 0.01


def test_mitsuba_agrees_on_a_golden_sphere():
    pytest.importorskip("mitsuba")
    light = sky(room, basis=one_hot())
    bsdf = {"type": "conductor", "eta": {"type": "rgb", "value": list(GOLD_N)},
            "k": {"type": "rgb", "value": list(GOLD_K)}}  # fmt: skip
    theirs = mitsuba_picture(bsdf, light.coefficients, samples=64)
    gold = material(mirror=1.0, n=np.array(GOLD_N)[THIRDS], k=np.array(GOLD_K)[THIRDS])
    ours = render([BALL], [gold], light, size=(64, 64), fov=16.0, pixel_side=4)
    assert mean_difference(ours, theirs) <= 0.01
