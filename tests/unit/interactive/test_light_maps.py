"""Light maps: what path tracing finds on the objects' textures, and pictures of the interactive renderer with it."""

from dataclasses import replace

import numpy as np
import pytest
from made import made
from scenes import BALL, constant_light, material, plate, sky, smooth_light

from irodori.colour.colorimetry import delta_e, lab_from_xyz, xyz_from_radiance
from irodori.config.cross_checks.plan_overrides import check_plan
from irodori.config.models import Render, Scene
from irodori.core import store
from irodori.core.errors import InputError
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.plane import Plane
from irodori.geometry.shapes.shape import Shape
from irodori.rendering.frame_state import STILL
from irodori.rendering.integrators import make_renderer, render_image
from irodori.rendering.light_maps import LightMaps, look_up
from irodori.rendering.reference.baking import bake_maps, maps_key
from irodori.rendering.scene_arrays import make_objects

HEIGHT_MM = 30.0
TABLE, SHAPES = plate(120.0), [plate(120.0), BALL]


def placements(height_mm=HEIGHT_MM) -> list[Placement]:
    return [Placement(TABLE, np.eye(3), np.zeros(3)), Placement(BALL, np.eye(3), np.array([0.0, 0.0, height_mm]))]


def baked(reflectances, light, height_mm=HEIGHT_MM) -> LightMaps:
    there = placements(height_mm)
    return bake_maps(there, make_objects(there, [material(r) for r in reflectances])[0], light)


def test_between_white_surfaces_in_even_light_every_place_is_as_bright():
    """A white furnace: what neighbours hide they send back, after however many reflections."""
    maps = baked((1.0, 1.0), constant_light(2.0))
    for index in range(2):
        assert np.abs(maps.of(index) / 2.0 - 1.0).max() < 0.03
        assert np.abs(maps.of(index).mean() / 2.0 - 1.0) < 2e-3
    assert all(bake.error < 0.02 for bake in maps.bakes)


def test_under_a_black_ball_a_table_is_dark_by_the_ball_s_form_factor():
    """The share of the hemisphere that a ball hides from a point that it stands over is cosθ (r / d)²."""
    maps = baked((0.5, 0.0), constant_light())
    found = maps.of(0)[..., 30]
    side = (np.arange(found.shape[0]) + 0.5) / found.shape[0] * 120.0 - 60.0
    x, y = np.meshgrid(side, side)
    distance = np.sqrt(x**2 + y**2 + HEIGHT_MM**2)
    whole = HEIGHT_MM > 20.0  # all of the ball is above the horizon of the table
    assert whole and np.abs(found - (1.0 - HEIGHT_MM / distance * (20.0 / distance) ** 2)).mean() < 0.01
    # Most of what the ball sends back came from the table: what falls on its underside is at most what that reflects.
    below = maps.of(1)[-1, :, 30]
    assert (below < 0.5).all() and below.mean() > 0.2


def test_a_map_is_looked_up_as_the_renderer_does_across_its_joined_sides():
    picture = np.arange(8.0).reshape(1, 8, 1).repeat(2, axis=0)
    u, v = np.array([0.0, 1.0 / 16, 0.5, 1.0]), np.full(4, 0.5)
    assert look_up(picture, u, v, True)[:, 0] == pytest.approx([3.5, 0.0, 3.5, 3.5])
    assert look_up(picture, u, v, False)[:, 0] == pytest.approx([0.0, 0.0, 3.5, 7.0])


COLOURED = [np.linspace(0.2, 0.9, 61), np.linspace(0.9, 0.1, 61)]
LIGHT = sky(lambda unit: smooth_light(unit)[..., None], 64, 32)
OPTIONS = made(Render, Render(pixel_side=2, min_throughput=1e-3))


def scene_of(integrator, lights=(), **more) -> Scene:
    stands = [{"object": name, "position_mm": [0.0, 0.0, z]} for name, z in (("table", 0.0), ("ball", 20.1))]
    view = {"position_mm": [0.0, -200.0, 90.0], "target_mm": [0.0, 0.0, 12.0], "field_of_view_deg": 22.0}
    return made(Scene, {"image": {"width": 32, "height": 24}, "objects": stands, "views": {"v": view},
                        "integrator": integrator, "lights": list(lights), **more})  # fmt: skip


def shown(integrator, lights=(), maps_file=None):
    materials = [material(one) for one in COLOURED]
    scene = scene_of(integrator, lights)
    return render_image(scene, "v", SHAPES, materials, LIGHT, OPTIONS, distance=True, maps_file=maps_file)[1]


MAPS = {"kind": "interactive", "light_maps": True}
LAMP = {"kind": "collimated", "spectrum": "D65", "azimuth_deg": -60.0, "elevation_deg": 40.0, "irradiance": 2.0}


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("lights", [(), (LAMP,)], ids=["sky", "sky and a lamp"])
def test_with_light_maps_a_picture_of_dull_objects_is_near_the_path_traced_one(lights):
    """Shadows, light between coloured objects, and that of a lamp that others reflect; nothing is counted twice."""
    far = {name: shown(integrator, lights)["delta_e_to_reference"]["mean"] for name, integrator in {
        "maps": MAPS, "ambient": {"kind": "interactive"}}.items()}  # fmt: skip
    assert far["maps"] < 0.5 and far["maps"] < 0.4 * far["ambient"]


def test_products_of_light_and_surface_show_what_the_bands_show_with_light_maps():
    materials, scene = [material(one) for one in COLOURED], scene_of(MAPS)
    white = LIGHT.upward_white()
    bands, products = (make_renderer(scene, SHAPES, materials, LIGHT, OPTIONS, w) for w in (None, white))
    matrix = xyz_from_radiance(white)
    (spectral, _), (xyz, figures) = bands.picture("v"), products.picture("v")
    assert figures["representation"] == "coefficients" and figures["light_maps"]
    white_xyz = matrix @ white
    off = delta_e(lab_from_xyz(spectral @ matrix.T, white_xyz), lab_from_xyz(xyz.astype(np.float64), white_xyz))
    assert off.mean() < 0.1 and off.max() < 1.0


def test_turned_light_is_not_shown_by_maps_of_the_light_as_it_stood():
    renderer = make_renderer(scene_of(MAPS), SHAPES, [material(one) for one in COLOURED], LIGHT, OPTIONS)
    turned = STILL._replace(environment_deg=70.0)
    for other in (turned, STILL._replace(objects_deg=10.0)):
        with pytest.raises(ValueError, match="light maps in turned light"):
            renderer.picture("v", other)
    # A turn of eye, objects and light together is no turn.
    all_turned = turned._replace(eye_deg=70.0, objects_deg=70.0, lights_deg=70.0)
    assert np.allclose(renderer.picture("v", all_turned)[0], renderer.picture("v")[0], atol=2e-3)


REDDISH = STILL._replace(filter=tuple(np.linspace(0.2, 1.8, 61)))


@pytest.mark.parametrize("moment", [REDDISH, STILL._replace(eye_deg=50)], ids=["another colour", "another side"])
def test_maps_show_other_colours_of_the_light_and_other_sides_as_path_tracing_does(moment):
    """With maps of the scene as it stands: against paths, nearer than shadows by formulas, under the same filter."""
    materials = [material(one) for one in COLOURED]
    seen = {
        name: make_renderer(scene_of(integrator), SHAPES, materials, LIGHT, OPTIONS).picture("v", moment)[0]
        for name, integrator in (("maps", MAPS), ("ambient", {"kind": "interactive"}),
                                 ("paths", {"kind": "reference", "samples": 256, "denoise": False}))
    }  # fmt: skip
    white = LIGHT.upward_white() * (1.0 if moment.filter is None else np.array(moment.filter))
    matrix = xyz_from_radiance(white)
    lab = {name: lab_from_xyz(picture @ matrix.T, matrix @ white) for name, picture in seen.items()}
    far = {name: delta_e(lab[name], lab["paths"]).mean() for name in ("maps", "ambient")}
    assert far["maps"] < 0.7 and far["maps"] < 0.6 * far["ambient"]


def test_maps_of_a_scene_whose_object_was_moved_are_refused_by_name(tmp_path):
    materials = [material(one) for one in COLOURED]
    renderer = make_renderer(scene_of(MAPS), SHAPES, materials, LIGHT, OPTIONS)
    path = tmp_path / "light-maps.h5"
    renderer.baked.save(path, store.Provenance("test"))
    stored = make_renderer(scene_of(MAPS), SHAPES, materials, LIGHT, OPTIONS, maps_file=path)
    assert np.array_equal(stored.picture("v")[0], renderer.picture("v")[0])
    moved = scene_of(MAPS)
    item = replace(moved.objects[1], position_mm=(1.0, 0.0, 20.1))
    moved = replace(moved, objects=(moved.objects[0], item))
    with pytest.raises(InputError, match=r"light-maps.h5: key: found light maps of something else"):
        make_renderer(moved, SHAPES, materials, LIGHT, OPTIONS, maps_file=path).picture("v")


def test_the_key_of_maps_follows_what_they_depend_on_and_nothing_else():
    def key(scene=None, shapes=SHAPES, paint=0.5, light=LIGHT):
        there = placements()
        objects = make_objects(there, [material(0.8), material(paint)])[0]
        return maps_key(scene or scene_of(MAPS), shapes, objects, light)

    own = key()
    assert own == key(scene_of(MAPS, max_bounces=2))
    other_light = replace(LIGHT, coefficients=LIGHT.coefficients * np.float32(1.0001))
    mesh = Shape.from_mesh(BALL.facetted(1.0))
    raised = Shape.from_mesh(replace(mesh.mesh, vertices_mm=mesh.mesh.vertices_mm + 0.1))
    others = [key(scene_of(MAPS, [LAMP])), key(paint=0.51), key(light=other_light), key(shapes=[plate(121.0), BALL])]
    others += [key(shapes=[TABLE, mesh]), key(shapes=[TABLE, raised])]
    assert len({own, *others}) == 7


def test_an_endless_plane_has_no_map_and_a_tolerance_no_light_maps():
    there = [Placement(Plane(), np.eye(3), np.zeros(3)), *placements()[1:]]
    maps = bake_maps(there, make_objects(there, [material(0.5), material(0.5)])[0], constant_light())
    assert maps.maps[0].size == 0 and maps.maps[1].size > 0
    with pytest.raises(InputError, match=r"light_maps: found light maps in a scene with tolerance_ciede2000"):
        check_plan(scene_of(MAPS, tolerance_ciede2000=40.0), "scene.yaml")
