"""Lights in the scenes of the path tracer, and the tracer against itself: error bars, seeds, threads, tiles."""

from collections.abc import Sequence

import numba
import numpy as np
import pytest
from made import made
from path_scenes import DARK, ball, traced
from scenes import (
    BALL,
    irradiance_map,
    material,
    pixel_rays,
    plate,
    sky,
    smooth_light,
)

from irodori.config.models import PlacedLight
from irodori.light.environment_file import Environment
from irodori.light.placed_lights import lights_picture
from irodori.reflection.equation5 import angles_from_directions, reflect
from irodori.rendering.reference.converging_picture import FinishedTiles, pooled
from irodori.spectra.published import light as spectrum_of

SPECTRUM = np.linspace(0.2, 0.9, 61)


# --- lights that stand in the scene ------------------------------------------------------------------------------


def lamp(kind, **keys):
    return {"kind": kind, "spectrum": "D65", **keys}


def test_collimated_light_falls_by_the_cosine_and_casts_a_hard_shadow():
    sun = lamp("collimated", azimuth_deg=0.0, elevation_deg=40.0, irradiance=2.0)
    picture = traced([plate(400.0), BALL], [material(SPECTRUM), material(0.0)], DARK, 64,
                     places=[(0, 0, 0), (0, 0, 60)], position=(0, -0.01, 900), fov=18, size=(60, 60),
                     lights=[sun])  # fmt: skip
    lit = 2.0 * SPECTRUM * spectrum_of("D65") * np.sin(np.radians(40.0))
    half = 900 * np.tan(np.radians(9.0))
    x = (np.arange(60) + 0.5 - 30) / 30 * half
    y = -x[:, None]
    # The shadow of a sphere of radius 20 mm at height 60 mm: an ellipse, 20 across the beam and 20 / sin 40° along it.
    centre = -60 / np.tan(np.radians(40.0))
    inside = np.hypot((x - centre) * np.sin(np.radians(40.0)), y + 0 * x)
    behind = np.hypot(x + 0 * y, y + 0 * x) < 26  # the sphere itself hides the plate
    for region, value in ((inside > 27, lit), (inside < 13, 0 * lit)):
        region &= ~behind
        assert region.sum() > 8
        assert np.allclose(picture.radiance[region], value, rtol=1e-4)


@pytest.mark.parametrize("elevation_deg", [90.0, 89.5, 80.0, 45.0])
@pytest.mark.parametrize("size", [(64, 32), (512, 256)])
def test_a_white_diffuser_is_white_under_a_small_light_also_at_the_zenith(elevation_deg, size):
    """A picture of light is interpolated, and a pixel at a pole has more of it than its own area."""
    sun = {"spectrum": "D65", "azimuth_deg": 30.0, "elevation_deg": elevation_deg, "irradiance": 1.0}
    made_of = lights_picture(made(Sequence[PlacedLight], [sun]), *size)
    light = Environment(made_of.weights, made_of.basis, irradiance_map(made_of.weights, 64, 32))
    picture = traced([plate(40.0)], [material(1.0)], light, 256, position=(0, -1, 200), fov=5.0, size=(9, 9))
    found = picture.radiance.mean(axis=(0, 1)) / spectrum_of("D65")
    assert found == pytest.approx(np.sin(np.radians(elevation_deg)), rel=4e-3)
    assert light.upward_white() / spectrum_of("D65") == pytest.approx(np.sin(np.radians(elevation_deg)), rel=4e-3)


def test_a_rectangle_lights_a_plate_by_its_form_factor():
    """From a corner of a parallel rectangle at distance 1: F = (X/√(1+X²) atan(Y/√(1+X²)) + the same of Y)/2π."""
    panel = lamp(
        "rectangle", position_mm=[40, 25, 100], rotation_deg=[180, 0, 0], width_mm=80, height_mm=50, radiance=5
    )
    picture = traced([plate(1000.0)], [material(SPECTRUM)], DARK, 4096, position=(-30, 0, 40), size=(1, 1),
                     fov=0.01, lights=[panel])  # fmt: skip
    x, y = 80 / 100, 50 / 100
    rx, ry = np.sqrt(1 + x * x), np.sqrt(1 + y * y)
    factor = (x / rx * np.arctan(y / rx) + y / ry * np.arctan(x / ry)) / (2 * np.pi)
    expected = SPECTRUM * factor * 5 * spectrum_of("D65")
    assert (np.abs(picture.radiance[0, 0] - expected) <= 5 * picture.standard_error[0, 0] + 1e-4 * expected).all()
    assert (picture.standard_error[0, 0] <= 3e-3 * expected).all()
    # It shines downwards only, and is seen so.
    seen = {
        "position": (40, 25, 50),
        "target": (40, 25, 100),
        "fov": 5,
        "size": (2, 2),
        "up": (0, 1, 0),
        "lights": [panel],
    }
    from_below = traced([plate(10.0)], [material(0.0)], DARK, 8, **seen)
    assert np.allclose(from_below.radiance, 5 * spectrum_of("D65"), rtol=1e-5)
    from_above = traced([plate(10.0)], [material(0.0)], DARK, 8, **(seen | {"position": (40, 25, 150)}))
    assert (from_above.radiance == 0).all()


@pytest.mark.parametrize("radius", [1.0, 30.0, 95.0])
def test_a_sphere_lights_a_plate_by_its_solid_angle(radius):
    bulb = lamp("sphere", position_mm=[60, 0, 100], radius_mm=radius, radiance=2)
    picture = traced([plate(1000.0)], [material(SPECTRUM)], DARK, 4096, position=(-60, 0, 30), size=(1, 1),
                     fov=0.01, lights=[bulb])  # fmt: skip
    squared = 60**2 + 100**2
    expected = SPECTRUM * 2 * spectrum_of("D65") * radius**2 / squared * 100 / np.sqrt(squared)
    assert (np.abs(picture.radiance[0, 0] - expected) <= 5 * picture.standard_error[0, 0] + 1e-4 * expected).all()
    assert (picture.standard_error[0, 0] <= 3e-3 * expected).all()


@pytest.mark.default_cases(3)
@pytest.mark.parametrize("mu", [0.02, 0.1, 0.4, 1.2])
@pytest.mark.parametrize("theta_deg", [30.0, 80.0])
def test_a_lamp_is_mirrored_as_broadly_as_the_surface_is_rough(mu, theta_deg):
    """Quadrature over the lamp with `irodori.reflection.equation5`, the eye in the mirror direction and beside it."""
    radius, distance = 12.0, 100.0
    theta = np.radians(theta_deg)
    centre = distance * np.array([0.0, np.sin(theta), np.cos(theta)])
    beta, normal = 1 / (4 * mu**2), np.array([0.0, 0.0, 1.0])
    nodes, weights = np.polynomial.legendre.leggauss(300)
    cap = 1 - np.sqrt(1 - (radius / distance) ** 2)
    rise, around = np.meshgrid((nodes + 1) / 2 * cap, (np.arange(360) + 0.5) * np.pi / 180, indexing="ij")
    axis = centre / distance
    across = np.cross(axis, [1.0, 0.0, 0.0])
    sine = np.sqrt(rise * (2 - rise))[..., None]
    towards = (1 - rise)[..., None] * axis + sine * (
        np.cos(around)[..., None] * np.array([1.0, 0.0, 0.0]) + np.sin(around)[..., None] * across
    )
    for off_deg in (0.0, 6.0):
        angle = np.radians(theta_deg - off_deg)
        view = np.array([0.0, -np.sin(angle), np.cos(angle)])
        reflected = reflect(0.3, 1.0, beta, mu, angles_from_directions(normal, towards, view), n=1.5, k=0.2)
        value = np.sum(reflected / np.pi * (weights * cap / 2)[:, None]) * np.pi / 180
        expected = 7.0 * value * spectrum_of("D65")[30]
        picture = traced([plate(50.0)], [material(0.3, beta=beta, mu=mu, n=1.5, k=0.2)], DARK, 16384,
                         position=300 * view, size=(1, 1), fov=0.001, up=(0.0, np.cos(angle), np.sin(angle)),
                         lights=[lamp("sphere", position_mm=list(centre), radius_mm=radius, radiance=7.0)])  # fmt: skip
        error = picture.standard_error[0, 0, 30]
        assert error <= 0.02 * expected
        assert abs(picture.radiance[0, 0, 30] - expected) <= 5 * error + 1e-3 * expected


def test_lights_add_up():
    """Which light is chosen is left to chance; what they give together is not."""
    lights = [
        lamp("collimated", azimuth_deg=0.0, elevation_deg=40.0, irradiance=0.2),
        lamp("sphere", position_mm=[60, 0, 100], radius_mm=20, radiance=2),
        lamp("rectangle", position_mm=[-40, 25, 90], rotation_deg=[180, 0, 0], width_mm=80, height_mm=50, radiance=5),
    ]
    room = sky(lambda d: np.exp(9 * (d[..., 2:] - 1)))
    material_ = material(SPECTRUM, beta=2.0, mu=0.2)
    view = {"position": (-60, -60, 100), "size": (8, 8), "fov": 5}
    together = traced([plate(1000.0)], [material_], room, 2048, lights=lights, **view)
    parts = [traced([plate(1000.0)], [material_], DARK, 2048, lights=[one], seed=1, **view) for one in lights]
    parts.append(traced([plate(1000.0)], [material_], room, 2048, seed=1, **view))
    total = sum(p.radiance.astype(float) for p in parts)
    error = np.sqrt(together.standard_error**2 + sum(p.standard_error**2 for p in parts))
    z = (together.radiance - total)[..., ::10] / error[..., ::10]
    assert np.abs(z).max() < 7 and np.abs(z.mean()) < 1.0
    assert (error <= 0.03 * total).all()


@pytest.mark.stability(stage="render", case="reciprocity")
def test_light_takes_the_same_paths_both_ways():
    """What a small lamp at P sends past Q from all sides is what it sends past P from Q: reciprocity of every path."""
    shapes = [plate(100.0), ball(30.0), ball(20.0)]
    places = [(0, 0, 0), (-25, 10, 30), (28, 15, 20)]
    materials = [material(0.6, beta=3.0, mu=0.15, n=1.6), material(0.3, beta=1.0, mu=0.4, n=0.2, k=3.4),
                 material(0.1, beta=20.0, mu=0.12, n=0.3, k=2.5)]  # fmt: skip
    ends = np.array([[-70.0, -110.0, 60.0], [80.0, -80.0, 110.0]])
    fluence, error = [], []
    for eye, other in (ends, ends[::-1]):
        small = lamp("sphere", position_mm=list(other), radius_mm=4.0, radiance=250.0)
        # 80° towards the objects hold every ray that meets one, and not the lamp.
        picture = traced(shapes, materials, DARK, 512, places=places, position=eye, target=(0, 20, 10), size=(48, 48),
                         fov=80, lights=[small])  # fmt: skip
        ray = pixel_rays(eye, (0, 20, 10), (48, 48), 80)
        forward = np.subtract((0, 20, 10), eye) / np.linalg.norm(np.subtract((0, 20, 10), eye))
        solid_angle = (ray @ forward) ** 3 * (2 * np.tan(np.radians(40)) / 48) ** 2
        lit = picture.radiance[..., 30] > 0
        assert lit.any() and not lit[[0, -1]].any() and not lit[:, [0, -1]].any()
        fluence.append((picture.radiance[..., 30] * solid_angle).sum(dtype=float))
        error.append(np.sqrt(((picture.standard_error[..., 30] * solid_angle) ** 2).sum(dtype=float)))
    assert max(error) <= 5e-3 * fluence[0]
    assert abs(fluence[0] - fluence[1]) <= 4 * np.hypot(*error)


# --- error bars, seeds, threads, tiles ---------------------------------------------------------------------------


def still_life(samples, **options):
    light = sky(
        lambda d: np.stack([smooth_light(d), np.exp(60 * (d[..., 2] - 1))], axis=-1), basis=np.eye(61)[:, :2] + 0.1
    )
    shapes, places = [plate(120.0), BALL, BALL], [(0, 0, 0), (-20, 0, 20), (20, 5, 20)]
    materials = [
        material(0.5, beta=1.0, mirror=0.2),
        material(SPECTRUM, beta=3.0, mu=0.2),
        material(mirror=1.0, n=0.2, k=3),
    ]
    view = {"position": (20, -250, 130), "target": (0, 0, 10), "fov": 14, "size": (24, 18), "places": places}
    return traced(shapes, materials, light, samples, **view, **options)


@pytest.mark.heavy
def test_error_bars_tell_how_far_a_picture_is_from_its_limit():
    # The error of the limit is a part of the error that is stated, so that it need not be small.
    limit = still_life(2048, seed=99)
    for samples in (128, 512):
        picture = still_life(samples)
        bands = [0, 1, 30]
        error = np.hypot(picture.standard_error, limit.standard_error)[..., bands]
        noisy = error > 1e-4 * limit.radiance[..., bands]
        z = ((picture.radiance - limit.radiance)[..., bands] / np.maximum(error, 1e-30))[noisy]
        # Student's t of 7 degrees of freedom: variance 1.4, 2.3 % beyond 2.9 on either side together.
        assert noisy.mean() > 0.3
        assert 1.0 < np.mean(np.minimum(z * z, 50)) < 2.0
        assert 0.01 < (np.abs(z) > 2.9).mean() < 0.05
        assert abs(z.mean()) < 0.15


def test_the_error_falls_with_the_samples():
    coarse, fine = (still_life(samples).standard_error[..., 30] for samples in (16, 256))
    assert np.sqrt((fine**2).mean()) <= np.sqrt((coarse**2).mean()) / 4 * 1.3


@pytest.mark.heavy
def test_two_sets_need_fewer_samples_than_eight_and_know_their_error():
    limit = still_life(2048, seed=9).radiance[..., 30].astype(float)

    def errors(replicates):
        pictures = [still_life(64, seed=seed, replicates=replicates) for seed in range(4)]
        return np.array([p.radiance[..., 30] - limit for p in pictures]), pictures

    (eight, _), (two, pictures) = errors(8), errors(2)
    # Of 64 samples those of two sets err as about a hundred of eight do.
    assert np.sqrt((two**2).mean()) <= 0.85 * np.sqrt((eight**2).mean())
    stated = np.array([pooled(p.standard_error[..., 30]) for p in pictures])
    noisy = (stated > 0) & (np.abs(two) > 0)
    assert 0.8 <= np.sqrt((stated**2).mean() / (two**2).mean()) <= 1.25
    # What neighbours say holds for single pixels too, where light and shadow change from one to the next.
    z = (two / np.maximum(stated, 1e-30))[noisy]
    assert 0.02 < (np.abs(z) > 2.0).mean() < 0.12


def test_one_error_for_all_bands_is_the_root_mean_square_of_theirs():
    """The plain mean of half differences would be a fifth too small where bands err apart from each other."""
    each, one = still_life(16), still_life(16, error_by_band=False)
    assert one.standard_error.shape == (*each.standard_error.shape[:2], 1)
    expected = np.sqrt(np.mean(np.square(each.standard_error, dtype=np.float64), axis=-1))
    np.testing.assert_allclose(one.standard_error[..., 0], expected, rtol=1e-4, atol=1e-9)
    np.testing.assert_array_equal(one.radiance, each.radiance)


def test_the_error_of_dark_pixels_is_theirs_however_bright_others_are():
    error = np.full((40, 50), 1e-3)
    error[5:9, 4:9] = np.random.default_rng(0).uniform(0, 1e7, (4, 5))
    stated = pooled(error)
    far = np.ones(stated.shape, dtype=bool)
    far[2:12, 1:12] = False
    assert np.allclose(stated[far], 1e-3, rtol=1e-9)
    assert (stated[~far] > 1e3).all()


@pytest.fixture
def threads():
    before = numba.get_num_threads()
    yield numba.set_num_threads
    numba.set_num_threads(before)


def test_threads_and_tiles_do_not_change_a_bit_and_seeds_do(threads):
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one thread only")
    pictures = []
    for count, tile_rows in ((1, 60), (2, 60), (2, 7), (2, 1)):
        threads(count)
        pictures.append(still_life(16, tile_rows=tile_rows))
    for other in pictures[1:]:
        assert np.array_equal(pictures[0].radiance, other.radiance)
        assert np.array_equal(pictures[0].standard_error, other.standard_error)
    assert not np.array_equal(pictures[0].radiance, still_life(16, seed=1).radiance)
    short = still_life(16, tile_rows=7, error_by_band=False)
    assert np.array_equal(short.radiance, pictures[0].radiance)
    whole = np.sqrt((pictures[0].standard_error ** 2).mean(axis=-1, keepdims=True))
    assert np.allclose(short.standard_error, whole, rtol=1e-6)


def test_an_interrupted_picture_goes_on_where_it_stopped(tmp_path, monkeypatch):
    from irodori.rendering.reference import converging_picture as module

    whole = still_life(16, tile_rows=6)
    real, made = module.Renderer.fill, []

    def counted(renderer, rows):
        if len(made) == 2:
            raise KeyboardInterrupt
        made.append((rows.places[0, 0, 1], rows.places[-1, 0, 1] + 1))
        return real(renderer, rows)

    monkeypatch.setattr(module.Renderer, "fill", counted)
    with pytest.raises(KeyboardInterrupt):
        still_life(16, tile_rows=6, tiles=FinishedTiles(tmp_path / "t", "a", after_s=0.0))
    assert made == [(0, 6), (6, 12)]
    made.clear()
    tiles = FinishedTiles(tmp_path / "t", "a")
    again = still_life(16, tile_rows=6, tiles=tiles)
    assert made == [(12, 18)]
    assert np.array_equal(again.radiance, whole.radiance)
    assert np.array_equal(again.standard_error, whole.standard_error)
    # Tiles of another picture are none of this one's.
    made.clear()
    with pytest.raises(KeyboardInterrupt):
        still_life(16, tile_rows=6, tiles=FinishedTiles(tmp_path / "t", "b", after_s=0.0))
    assert made == [(0, 6), (6, 12)]
    tiles.remove()
    assert {p.name for p in (tmp_path / "t").iterdir()} == {"b-0-6.npz", "b-6-12.npz"}
    # A quick picture stores none, a longer one also those that it had finished before.
    made.clear()
    clock = iter([0.0, 50.0, 61.0])
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock, 61.0))
    late = FinishedTiles(tmp_path / "l", "c")
    for rows in ((0, 6), (6, 12)):
        assert not any((tmp_path / "l").iterdir())
        late.get(rows, lambda: whole)
    assert {p.name for p in (tmp_path / "l").iterdir()} == {"c-0-6.npz", "c-6-12.npz"}


@pytest.mark.parametrize("samples", [0, 7, 20])
def test_samples_that_replicates_cannot_share_are_refused(samples):
    with pytest.raises(ValueError, match="multiple of 8"):
        still_life(samples)


def test_an_unknown_light_lists_the_kinds():
    with pytest.raises(ValueError, match="kinds collimated, rectangle, sphere"):
        traced([BALL], [material(0.5)], DARK, 8, size=(1, 1), lights=[lamp("disc", radius_mm=3.0)])
