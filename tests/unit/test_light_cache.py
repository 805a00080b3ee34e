"""The light cache of the path tracer: it changes no mean, and is never seen itself."""

from collections.abc import Sequence

import numpy as np
import pytest
from made import made
from path_scenes import DARK, ball, facetted_sphere
from scenes import constant_light, material, plate

from irodori.config.models import SceneLight, Size, View
from irodori.geometry.rig_frame import rotation_x, rotation_y
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Shape
from irodori.rendering.reference.converging_picture import TracedScene, make_scene, render
from irodori.rendering.reference.filling_cache import with_cache
from irodori.rendering.scene_arrays import make_objects, make_view
from irodori.spectra.published import light as spectrum_of

UP = np.eye(3)
#: Paths of a picture for which the cache is filled; more than the tests follow.
MANY = 1_000_000


def scene_of(things: list[tuple[Shape, object, tuple, np.ndarray]], light, lights: Sequence = ()) -> TracedScene:
    placements = [Placement(shape, turn, np.array(place, float)) for shape, _, place, turn in things]
    objects, _ = make_objects(placements, [one[1] for one in things])
    return make_scene(placements, objects, light, made(Sequence[SceneLight], lights))


def view_of(position, target, field_deg, width=24, height=24):
    seen = {"position_mm": position, "target_mm": target, "up": (0, 0, 1), "field_of_view_deg": field_deg}
    return make_view(made(View, seen), made(Size, {"width": width, "height": height}))


def room() -> TracedScene:
    """An open box of three colours with two balls, one golden, under a small panel."""
    walls = [((0, 0, 0), UP), ((0, 0, 100), rotation_x(np.pi)), ((0, 50, 50), rotation_x(np.pi / 2)),
             ((-50, 0, 50), rotation_y(np.pi / 2)), ((50, 0, 50), rotation_y(-np.pi / 2))]  # fmt: skip
    things = [(plate(100.0), material(0.5 + 0.1 * number), *wall) for number, wall in enumerate(walls[:4])]
    things.append((plate(100.0), material(np.linspace(0.2, 0.8, 61)), *walls[4]))
    things.append((ball(16.0), material(0.7, beta=0.1, mu=0.2), (20, 5, 16.0), UP))
    things.append((ball(12.0), material(0.0, mirror=1.0, n=0.2, k=3.4), (-20, -10, 12.0), UP))
    panel = {"kind": "rectangle", "spectrum": "A", "radiance": 9.0, "position_mm": [0, 0, 97],
             "rotation_deg": [180, 0, 10], "width_mm": 40.0, "height_mm": 30.0}  # fmt: skip
    return scene_of(things, DARK, [panel])


def test_white_things_vanish_in_a_furnace_with_the_cache():
    things = [(plate(300.0), material(1.0), (0, 0, 0), UP), (ball(20.0), material(1.0), (-25, 0, 20.0), UP),
              (facetted_sphere(20.0, 2), material(1.0), (25, 0, 20.0), UP)]  # fmt: skip
    scene = with_cache(scene_of(things, constant_light()), MANY)
    light = scene.world.cache.light[:, np.isfinite(scene.world.cache.least_mm2), :61]
    assert np.abs(light - 1.0).max() <= 1e-3
    picture = render(scene, view_of((0, -200, 90), (0, 0, 15), 30.0), 16)
    assert np.abs(picture.radiance - 1.0).max() <= 1e-3


def test_the_cache_leaves_the_light_in_a_closed_room_as_it_is():
    """As `test_light_in_a_closed_room_is_the_sum_of_all_its_reflections`, to 0.2 % of the mean."""
    size, lamp, reflectance = 100.0, 10.0, np.linspace(0.0, 0.9, 61)
    light = {"kind": "sphere", "spectrum": "D65", "radiance": 3.0, "position_mm": [0, 0, 0], "radius_mm": lamp}
    walls = (facetted_sphere(size, 4, inward=True), material(reflectance), (0, 0, 0), UP)
    scene = with_cache(scene_of([walls], DARK, [light]), MANY)
    picture = render(scene, view_of((0, -60, 0), (0, -100, 20), 40.0, 16, 16), 64)
    share = (lamp / size) ** 2
    expected = reflectance * 3.0 * spectrum_of("D65") * share / (1 - reflectance * (1 - share))
    # The facets of this wall lie up to 8e-4 of the radius inside the sphere.
    assert picture.radiance.mean() == pytest.approx(expected.mean(), rel=2e-3)


@pytest.fixture(scope="module")
def pictures():
    """The room and its picture without and with the cache, and the cached scene."""
    scene, view = room(), view_of((0, -240, 50), (0, 0, 50), 26.0)
    cached = with_cache(scene, MANY)
    return render(scene, view, 256, 1), render(cached, view, 256, 2), cached


def test_a_room_is_as_bright_and_as_coloured_with_the_cache(pictures):
    plain, cached, scene = pictures
    assert len(scene.world.cache.least_mm2) >= 7 * 64
    assert cached.radiance.mean() == pytest.approx(plain.radiance.mean(), rel=5e-3)
    blocks = [one.radiance[:, :, 30].reshape(6, 4, 6, 4).mean(axis=(1, 3)) for one in (plain, cached)]
    assert np.abs(blocks[1] / blocks[0] - 1.0).mean() <= 0.015


def test_the_cache_is_never_seen_itself(pictures):
    """A plate and a ball, each alone, and the same in a mirror: with light of 10⁶ in all texels nothing changes."""
    lamp = {"kind": "collimated", "spectrum": "D65", "azimuth_deg": -60.0, "elevation_deg": 60.0, "irradiance": 1.0}
    scene = scene_of([(ball(20.0), material(0.5), (0, 0, 20.0), UP)], constant_light(), [lamp])
    view = view_of((0, -200, 60), (0, 0, 20), 14.0)
    cached = with_cache(scene, MANY)
    world = cached.world._replace(cache=cached.world.cache._replace(light=np.full_like(cached.world.cache.light, 1e6)))
    assert np.array_equal(render(cached._replace(world=world), view, 16).radiance, render(scene, view, 16).radiance)
    # Where it may be used it is: the same light would shine from every wall of the room.
    plain, _, inside = pictures
    wall = inside.world.cache._replace(light=np.full_like(inside.world.cache.light, 1e6))
    bright = render(
        inside._replace(world=inside.world._replace(cache=wall)), view_of((0, -240, 50), (0, 0, 50), 26.0), 8
    )
    assert bright.radiance.mean() > 100.0 * plain.radiance.mean()


def test_each_set_of_paths_has_its_half_of_the_cache(pictures):
    """What is wrong in one half is seen as a difference between the sets."""
    _, _, scene = pictures
    first, second = scene.world.cache.light
    assert 0.0 < np.abs(first - second).mean() < 0.2 * first.mean()
    cache = scene.world.cache._replace(light=np.stack([0.0 * first, second]))
    halves = render(
        scene._replace(world=scene.world._replace(cache=cache)),
        view_of((0, -240, 50), (0, 0, 50), 26.0),
        8,
        halves=True,
    ).halves
    dark, whole = (np.mean(halves.mean + sign * halves.difference) for sign in (1.0, -1.0))
    assert whole > 1.1 * dark


def test_a_small_picture_goes_without():
    scene = room()
    assert with_cache(scene, 5_000) is scene
