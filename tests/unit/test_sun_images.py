"""Suns of one pixel in mirrors: directions of their images against traced rays, pictures against closed forms."""

import numpy as np
import pytest
from made import made
from path_scenes import ball
from scenes import GOLD_K, GOLD_N, THIRDS, constant_light, fresnel, material, plate
from scipy.optimize import brentq

from irodori.config.models import Size, View
from irodori.geometry.embree import Tracer
from irodori.geometry.shapes.placement import Placement
from irodori.light.environment_file import Environment, directions
from irodori.rendering.reference import sky_sampling
from irodori.rendering.reference.converging_picture import make_scene, render
from irodori.rendering.reference.glints import find_glints
from irodori.rendering.reference.incident_light import incident_light
from irodori.rendering.reference.sky_sampling import make_sky
from irodori.rendering.reference.sun_images import aim_at_directions, make_images
from irodori.rendering.scene_arrays import make_objects, make_view

RADIUS, SUN = 20.0, 1e6
ROW, COLUMN, WIDTH = 76, 317, 512
GOLD = material(0.0, mirror=1.0, n=np.array(GOLD_N)[THIRDS], k=np.array(GOLD_K)[THIRDS])
EYE = {"position_mm": (0.0, -300.0, 150.0), "target_mm": (0.0, 0.0, 15.0), "field_of_view_deg": 22.0}


def sunlit(sky: float = 0.0) -> Environment:
    """Return a light of one bright pixel in an even sky."""
    coefficients = np.full((WIDTH // 2, WIDTH, 1), sky, np.float32)
    coefficients[ROW, COLUMN] = SUN
    return Environment(coefficients, np.ones((61, 1)), np.ones((2, 4, 1), np.float32))


def sun() -> tuple[np.ndarray, float]:
    """Return the direction of the sun and its radiance times solid angle: a tent has the weight of its pixel."""
    unit, solid_angle = directions(WIDTH, WIDTH // 2)
    return unit[ROW, COLUMN], SUN * float(solid_angle[ROW, 0])


def placed(*shapes) -> list[Placement]:
    return [Placement(shape, np.eye(3), np.array(place, float)) for shape, place in shapes]


def seen(placements, materials, light, samples, *, size=(24, 18), seed=0, **view):
    """Return a picture in two sets of paths, and how many glints and chains there are."""
    scene = make_scene(placements, make_objects(placements, materials)[0], light)
    camera = make_view(made(View, EYE | view), made(Size, {"width": size[0], "height": size[1]}))
    glints, chains = len(find_glints(scene.world.images, camera).chain), len(scene.world.images.weight)
    return render(scene, camera, samples, seed, halves=True), glints, chains


STILL = placed((plate(400.0), (0, 0, 0)), (ball(RADIUS), (-20.0, 0, 20.1)), (ball(RADIUS), (20.001, 0, 20.1)))


def test_every_direction_that_mirrors_turn_into_another_is_found_again_also_between_balls_that_touch():
    """Rays are traced by Embree and reflected here: each that meets up to three mirrors shows where it ends."""
    images = make_images(STILL, make_objects(STILL, [GOLD] * 3)[0], make_sky(sunlit(1.0)))
    tracer, rng, count = Tracer(STILL), np.random.default_rng(4), 20_000
    eye = np.array([0.0, -60.0, 30.0])
    aimed = np.array([0.0, 0.0, 15.0]) + rng.normal(0.0, 12.0, (count, 3)) - eye
    first = direction = aimed / np.linalg.norm(aimed, axis=1, keepdims=True)
    origin, met = np.tile(eye, (count, 1)), np.full((count, 4), -1)
    for bounce in range(4):
        distance, shape = tracer.intersect(origin, direction)
        hit = np.flatnonzero(shape >= 0)
        met[hit, bounce] = shape[hit]
        origin = origin.copy()
        origin[hit] += distance[hit, None] * direction[hit]
        centre = np.stack([p.translation_mm for p in STILL])[shape[hit]]
        normal = np.where(shape[hit, None] == 0, [0.0, 0.0, 1.0], (origin[hit] - centre) / RADIUS)
        direction = direction.copy()
        direction[hit] -= 2.0 * (direction[hit] * normal).sum(axis=1, keepdims=True) * normal
        origin[hit] += 1e-7 * normal
    chains = {tuple(chain): number for number, chain in enumerate(images.chain)}
    number = np.array([chains.get((*row[:3],), -1) if row[3] < 0 else -1 for row in met])
    tried = number >= 0
    assert tried.sum() > 3000 and len(np.unique(number[tried])) >= 15
    found, there = np.zeros((tried.sum(), 3)), np.zeros(tried.sum(), dtype=np.bool_)
    aim_at_directions(images, number[tried], np.tile(eye, (tried.sum(), 1)), direction[tried], found, there)
    assert there.all() and np.abs(found - first[tried]).max() < 1e-6


def test_suns_are_small_and_bright_and_mirrors_are_mirrors():
    objects = make_objects(STILL, [material(0.5), GOLD, material(0.5, beta=10.0, mu=0.2, n=1.5)])[0]
    assert len(make_images(STILL, objects, make_sky(constant_light())).weight) == 0
    wide = sunlit(1.0)
    wide.coefficients[60:120, 100:300] = 50.0
    wide.coefficients[ROW, COLUMN] = 50.0
    assert len(make_images(STILL, objects, make_sky(wide)).weight) == 0
    images = make_images(STILL, objects, make_sky(sunlit(1.0)))
    # Neither the plate nor the rough ball is a mirror, and one ball does not see itself.
    assert images.chain.tolist() == [[1, -1, -1]] and images.pixel.tolist() == [[ROW, COLUMN]]
    assert images.share == pytest.approx(1.0, rel=1e-5)


@pytest.mark.stability(stage="render", case="a sun of one pixel in mirrors")
@pytest.mark.parametrize("lens", [None, {"diameter_mm": 0.5, "focus_mm": 300.0}], ids=["pinhole", "lens"])
def test_a_glint_in_a_golden_ball_has_its_light_with_every_seed(lens):
    """The image of a sun in a sphere has its radiance times the metal's reflectance, and is smaller by the curvature.

    Without aimed paths, 64 of a pixel find 0 to 3 times as much.
    """
    towards, power = sun()
    centre, eye = np.array([0.0, 0.0, 15.0]), np.array(EYE["position_mm"])
    away = eye - centre
    far, whole = np.linalg.norm(away) / RADIUS, np.arccos(away @ towards / np.linalg.norm(away))
    angle = brentq(lambda a: np.arctan2(np.sin(a), np.cos(a) - 1.0 / far) - (whole - a), 0.0, whole)
    cosine, distance = np.cos(whole - angle), RADIUS * np.hypot(far * np.cos(angle) - 1.0, far * np.sin(angle))
    smaller = (1.0 + 2.0 * distance / (RADIUS * cosine)) * (1.0 + 2.0 * distance * cosine / RADIUS)
    pixel_side = 2.0 * np.tan(np.radians(11.0)) / 18  # at right angles to the line of sight, nearly
    expected = power / smaller * fresnel(cosine, np.array(GOLD_N)[THIRDS], np.array(GOLD_K)[THIRDS]) / pixel_side**2
    sums = []
    for seed in range(16 if lens is None else 6):
        view = {} if lens is None else {"lens": lens}
        picture, glints, _ = seen(placed((ball(RADIUS), centre)), [GOLD], sunlit(), 64, seed=seed, **view)
        assert glints == 1
        sums.append(picture.radiance.sum(axis=(0, 1), dtype=np.float64))
    off = np.array(sums) / expected - 1.0
    assert np.abs(off).max() < 0.06 and np.abs(off.mean(axis=0)).max() < 0.005


@pytest.mark.stability(stage="render", case="a sun of one pixel in mirrors")
@pytest.mark.parametrize("mirror", ["ball", "plate"])
def test_light_that_a_mirror_throws_onto_a_table_is_that_of_quadrature(mirror):
    """The sun's irradiance by way of a mirror, at one place of a dark table, with every seed."""
    towards, power = sun()
    place = np.array([0.0, 0.0, 0.0])
    if mirror == "ball":
        centre = np.array([30.0, 15.0, 25.0])
        shape = Placement(ball(RADIUS), np.eye(3), centre)
        away = place - centre
        far, whole = np.linalg.norm(away) / RADIUS, np.arccos(away @ towards / np.linalg.norm(away))
        angle = brentq(lambda a: np.arctan2(np.sin(a), np.cos(a) - 1.0 / far) - (whole - a), 0.0, whole)
        unit = away / np.linalg.norm(away)
        side = towards - (towards @ unit) * unit
        normal = np.cos(angle) * unit + np.sin(angle) * side / np.linalg.norm(side)
        way, cosine = centre + RADIUS * normal - place, np.cos(whole - angle)
        distance = np.linalg.norm(way)
        smaller = (1.0 + 2.0 * distance / (RADIUS * cosine)) * (1.0 + 2.0 * distance * cosine / RADIUS)
    else:
        # Upright, and so that the sun's image is in its middle.
        normal = np.array([-0.8, 0.3, 0.0]) / np.hypot(0.8, 0.3)
        back = towards - 2.0 * (towards @ normal) * normal
        turn = np.column_stack([np.cross([0.0, 0.0, 1.0], normal), [0.0, 0.0, 1.0], normal])
        way, cosine, smaller = 30.0 * back, towards @ normal, 1.0
        shape = Placement(plate(30.0), turn, way)
        assert np.linalg.det(turn) == pytest.approx(1.0) and cosine > 0.2
        distance = 30.0
    reflected = fresnel(cosine, np.array(GOLD_N)[THIRDS], np.array(GOLD_K)[THIRDS]) / smaller * way[2] / distance
    expected = 0.01 / np.pi * power * (towards[2] + reflected)
    table = Placement(plate(2000.0), np.eye(3), place)
    scene = make_scene([table, shape], make_objects([table, shape], [material(0.01), GOLD])[0], sunlit())
    up = np.array([[0.0, 0.0, 1.0]])
    found = incident_light(scene, 0, place[None], up, up, samples=128).mean(axis=0)[0]
    assert np.abs((found - 100.0 * expected) / (power / np.pi * reflected)).max() < 0.02
    view = {"position_mm": (-100.0, -250.0, 150.0), "target_mm": place, "field_of_view_deg": 0.01}
    off = []
    for seed in range(4):
        picture = seen([table, shape], [material(0.01), GOLD], sunlit(), 128, size=(1, 1), seed=seed, **view)[0]
        # The table that is lit by the sun is seen in the mirror: a hundredth of what it is.
        off.append(np.abs((picture.radiance[0, 0] - expected) / (0.01 / np.pi * power * reflected)).max())
    # By the ball, one seed in six is off by more than 0.02, and none of sixty by more than 0.11.
    assert np.median(off) < 0.02 and max(off) < 0.15


@pytest.mark.heavy
def test_pictures_with_aimed_paths_have_the_mean_of_those_without(monkeypatch):
    """A smooth and a coated ball on a plate that is a mirror in part: also by way of gloss, and in chains."""
    placements = placed((plate(200.0), (0, 0, 0)), (ball(RADIUS), (-20.5, 0, 20.0)), (ball(RADIUS), (20.5, 0, 20.0)))
    smooth = material(0.0, beta=0.9 / (4 * 0.02**2), mu=0.02, n=GOLD.n, k=GOLD.k)
    coated = material(0.3, beta=0.3 / (4 * 0.05**2), mu=0.05, mirror=0.5, n=1.5)
    materials = [material(0.4, mirror=0.4, n=0.2, k=3.0), smooth, coated]
    few, glints, chains = seen(placements, materials, sunlit(1.0), 1024)
    assert glints > 0 and chains > 10
    monkeypatch.setattr(sky_sampling, "_WORTH", np.inf)
    many, _, none = seen(placements, materials, sunlit(1.0), 8192, seed=1)
    assert none == 0
    for part in (slice(0, 9), slice(9, 18)):
        means = [picture.radiance[part].mean(dtype=np.float64) for picture in (few, many)]
        errors = [np.sqrt((p.standard_error[part].mean(axis=-1) ** 2).sum()) / (9 * 24) for p in (few, many)]
        assert abs(means[0] - means[1]) < 4.0 * np.hypot(*errors) < 0.2 * means[1]
