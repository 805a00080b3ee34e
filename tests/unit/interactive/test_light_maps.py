"""Light maps: what path tracing finds on the objects' textures, and pictures of the interactive renderer with it."""

import functools
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made import made
from scenes import BALL, DATA, constant_light, material, plate, sky, smooth_light

from benchmarks.render import true_light, true_materials
from irodori.colour.colorimetry import delta_e, lab_from_xyz, xyz_from_radiance
from irodori.config.definitions import load_definitions, read_yaml
from irodori.config.models import Render, Scene, Size
from irodori.config.models import View as SeenFrom
from irodori.core import store
from irodori.core.errors import InputError
from irodori.geometry.embree import Tracer
from irodori.geometry.mesh import make_mesh
from irodori.geometry.rig_frame import rotation_z
from irodori.geometry.shapes import mesh_nodes
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.plane import Plane
from irodori.geometry.shapes.shape import Shape
from irodori.geometry.shapes.triangle_mesh import TriangleMesh
from irodori.light.environment_file import Environment
from irodori.light.gloss_maps import GlossMaps
from irodori.light.irradiance import fitted_irradiance_map
from irodori.light.light_files import rgb_picture
from irodori.rendering import light_transfer
from irodori.rendering.frame_state import STILL, turned_scene
from irodori.rendering.integrators import _to_reference, make_renderer, render_image, render_prepared
from irodori.rendering.interactive.frame_renderer import light_of, prepare_scene, render_frame
from irodori.rendering.light_maps import LightMaps, look_up
from irodori.rendering.light_transfer import LightTransfer
from irodori.rendering.reference import baking
from irodori.rendering.reference.baking import bake_maps, maps_key
from irodori.rendering.reference.converging_picture import make_scene
from irodori.rendering.reference.incident_light import incident_light
from irodori.rendering.scene_arrays import make_objects, make_view
from irodori.rendering.scene_lights import make_lights
from irodori.rendering.scene_white import scene_white

ROOT = Path(__file__).resolve().parents[3]
HEIGHT_MM = 30.0
TABLE, SHAPES = plate(120.0), [plate(120.0), BALL]


@pytest.fixture(autouse=True)
def few_paths(monkeypatch):
    """Measure the stated error with a sixteenth of the paths; it is tried in even light, where they have no noise."""
    monkeypatch.setattr(baking, "_PATHS", 32)


def placements(height_mm=HEIGHT_MM) -> list[Placement]:
    return [Placement(TABLE, np.eye(3), np.zeros(3)), Placement(BALL, np.eye(3), np.array([0.0, 0.0, height_mm]))]


def baked(reflectances, light, height_mm=HEIGHT_MM) -> LightMaps:
    there = placements(height_mm)
    return bake_maps(Tracer(there), make_objects(there, [material(r) for r in reflectances])[0], light)


def charts(count: int) -> np.ndarray:
    """Texture coordinates of triangles, each on its own, (count, 3, 2)."""
    side = int(np.ceil(np.sqrt(count)))
    cell = np.stack([np.arange(count) % side, np.arange(count) // side], axis=1)
    return (cell[:, None] + np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]])) / side


def octahedron(radius_mm: float, halvings: int):
    """A ball of triangles, each edge of an octahedron halved some times, with the normals of the ball."""
    corners = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    faces = corners[[[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [1, 0, 5], [2, 1, 5], [3, 2, 5], [0, 3, 5]]]
    for _ in range(halvings):
        a, b, c = faces[:, 0], faces[:, 1], faces[:, 2]
        d, e, f = a + b, b + c, c + a
        faces = np.concatenate([np.stack(three, axis=1) for three in ((a, d, f), (d, b, e), (f, e, c), (d, e, f))])
        faces = faces / np.linalg.norm(faces, axis=2, keepdims=True)
    return make_mesh(radius_mm * faces, charts(len(faces)), faces)


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


@pytest.mark.heavy
def test_turned_by_any_angle_the_light_is_that_of_a_room_that_was_turned_by_hand():
    """Neither the cells of the sphere nor the pixels of the picture fit the angle."""
    there = placements()
    objects = make_objects(there, [material(one, mirror=0.8, n=0.2, k=3.0) for one in COLOURED])[0]
    no_lamps = np.zeros((0, 61)), np.zeros((0, 3))

    def room(angle: float) -> Environment:
        return sky(lambda unit: smooth_light(unit @ rotation_z(np.radians(angle)))[..., None], 256, 128)

    standing, by_hand = room(0.0), room(37.3)
    transfer = LightTransfer(Tracer(there), objects, standing)
    turned, still = (transfer.light(standing, angle, *no_lamps)[0] for angle in (37.3, 0.0))
    made = LightTransfer(Tracer(there), objects, by_hand).light(by_hand, 0.0, *no_lamps)[0]
    assert np.abs(turned - made).max() < 0.01 * made.mean() and np.abs(still - made).max() > 0.1 * made.mean()


def test_the_same_transfer_shows_lamps_wherever_they_stand_as_path_tracing_finds_their_reflected_light():
    there, light = placements(), constant_light(0.0)
    objects = make_objects(there, [material(one) for one in COLOURED])[0]
    transfer = LightTransfer(Tracer(there), objects, light)
    for azimuth in (20.0, 250.0):
        lights = scene_of(MAPS, [LAMP | {"azimuth_deg": azimuth}]).lights
        lamps = make_lights(lights, 0)[0]
        spectra, towards = lamps.spectrum[:, :61].astype(np.float64), lamps.rotation[:, :, 2]
        found = transfer.maps(light, 0.0, spectra, towards).of(1).reshape(-1, 61)
        chosen = np.arange(0, len(found), 9)
        points = (values[chosen] for values in transfer.layouts[1].points(transfer.most[1]))
        halves = incident_light(make_scene(there, objects, light, lights), 1, *points, samples=512)
        off = np.mean((found[chosen] - halves[0]) * (found[chosen] - halves[1]))
        assert halves.mean() > 0.01 and np.sqrt(max(off, 0.0)) < 0.05 * halves.mean()


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


MAPS, BARE = ({"kind": "interactive", "light_maps": maps} for maps in (True, False))
LAMP = {"kind": "collimated", "spectrum": "D65", "azimuth_deg": -60.0, "elevation_deg": 40.0, "irradiance": 2.0}
PATHS = {"kind": "reference", "samples": 256, "denoise": False}


def dull(kind: str, lit: bool = False, **options):
    """Return a new renderer ``maps``, ``bare`` or ``paths`` of two coloured objects, perhaps lit by a lamp as well."""
    scene = scene_of({"maps": MAPS, "bare": BARE, "paths": PATHS}[kind], [LAMP] if lit else [])
    found = make_renderer(scene, SHAPES, [material(one) for one in COLOURED], LIGHT, OPTIONS, **options)
    if kind == "maps" and not options:
        found.baked, found.transfer = light_on_dull(lit)
    return found


@functools.cache
def light_on_dull(lit: bool) -> tuple:
    """Return the light maps and the transfer of light of all renderers ``maps``: to make them takes longest."""
    first = dull("maps", lit, maps_file=None)
    return first.baked, first.transfer


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("lit", [False, True], ids=["sky", "sky and a lamp"])
def test_with_light_maps_a_picture_of_dull_objects_is_near_the_path_traced_one(lit):
    """Shadows, light between coloured objects, and that of a lamp that others reflect; nothing is counted twice."""
    far = {
        name: render_prepared(dull(name, lit), "v", distance=True)[1]["delta_e_to_reference"]["mean"]
        for name in ("maps", "bare")
    }
    assert far["maps"] < 0.5 and far["maps"] < 0.4 * far["bare"]


@pytest.mark.heavy
def test_with_light_maps_a_mesh_on_an_endless_plane_is_near_the_path_traced_picture_also_from_a_file(tmp_path):
    floor = {"shape": {"kind": "plane"}, "position_mm": [0.0, 0.0, 0.0], "material": {"spectrum": "TCS11"}}
    mesh, materials, file = [TriangleMesh(octahedron(20.0, 3))], [material(COLOURED[1])], tmp_path / "m.h5"

    def scene(integrator) -> Scene:
        made = scene_of(integrator, bodies=[floor])
        return replace(made, objects=made.objects[1:])

    def far(integrator, maps_file=None) -> float:
        arguments = (scene(integrator), "v", mesh, materials, LIGHT, OPTIONS)
        return render_image(*arguments, distance=True, maps_file=maps_file)[1]["delta_e_to_reference"]["mean"]

    make_renderer(scene(MAPS), mesh, materials, LIGHT, OPTIONS).baked.save(file, store.Provenance("test"))
    from_maps = far(MAPS, file)
    assert from_maps < 0.5 and from_maps < 0.5 * far(BARE)


@pytest.mark.heavy
def test_products_of_light_and_surface_show_what_the_bands_show_with_light_maps():
    white, bands = LIGHT.upward_white(), dull("maps")
    products = dull("maps", white=white)
    products.baked = bands.baked
    matrix = xyz_from_radiance(white)
    (spectral, _), (xyz, figures) = bands.picture("v"), products.picture("v")
    assert figures["representation"] == "coefficients" and figures["light_maps"]
    white_xyz = matrix @ white
    off = delta_e(lab_from_xyz(spectral @ matrix.T, white_xyz), lab_from_xyz(xyz.astype(np.float64), white_xyz))
    assert off.mean() < 0.02 and off.max() < 0.3


REDDISH = STILL._replace(filter=tuple(np.linspace(0.2, 1.8, 61)))


TURNED = STILL._replace(environment_deg=70.0)


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(
    ("moment", "lit"),
    [
        (REDDISH, False),
        (TURNED, False),
        (STILL._replace(objects_deg=130.0), True),
        (STILL._replace(lights_deg=200.0, environment_deg=-90.0, filter=REDDISH.filter), True),
    ],
    ids=["another colour", "turned light", "turned objects", "lamp and coloured light turned"],
)
def test_maps_show_other_colours_turned_light_and_other_sides_as_path_tracing_does(moment, lit):
    """Against paths, nearer than without shadows."""
    seen = {name: dull(name, lit).picture("v", moment)[0] for name in ("maps", "bare", "paths")}
    white = scene_white(dull("maps", lit).scene, LIGHT)[0] * (1.0 if moment.filter is None else np.array(moment.filter))
    matrix = xyz_from_radiance(white)
    lab = {name: lab_from_xyz(picture @ matrix.T, matrix @ white) for name, picture in seen.items()}
    far = {name: delta_e(lab[name], lab["paths"]).mean() for name in ("maps", "bare")}
    # A lamp's hard shadow has an edge that four rays a pixel resolve coarsely.
    assert far["maps"] < (0.9 if lit else 0.7) and far["maps"] < 0.6 * far["bare"]


@pytest.mark.stability(stage="render", case="light maps whose object moved")
def test_maps_of_a_scene_whose_object_was_moved_are_refused_by_name(tmp_path):
    materials, renderer = [material(one) for one in COLOURED], dull("maps")
    path = tmp_path / "light-maps.h5"
    renderer.baked.save(path, store.Provenance("test"))
    stored = dull("maps", maps_file=path)
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
    mesh = TriangleMesh(BALL.facetted(1.0))
    raised = TriangleMesh(replace(mesh.mesh, vertices_mm=mesh.mesh.vertices_mm + 0.1))
    others = [key(scene_of(MAPS, [LAMP])), key(paint=0.51), key(light=other_light), key(shapes=[plate(121.0), BALL])]
    others += [key(shapes=[TABLE, mesh]), key(shapes=[TABLE, raised])]
    assert len({own, *others}) == 7


def seen_from_above(placements, reflectances, light, maps=None, span_mm=400.0, size=64) -> tuple[np.ndarray, ...]:
    """Green radiance that the interactive renderer shows to parallel rays from above, and x and y of its pixels, mm."""
    objects = make_objects(placements, [material(r) for r in reflectances])[0]
    maps = bake_maps(Tracer(placements), objects, light) if maps is None else maps
    tracer, gloss = Tracer(placements), GlossMaps.of(light.coefficients)
    ready = prepare_scene(objects, light_of(light), gloss, tracer, "spectral", np.ones(61), maps=maps)
    view = {"kind": "orthographic", "position_mm": [0.0, 0.0, 300.0], "target_mm": [0.0, 0.0, 0.0],
            "up": [0.0, 1.0, 0.0], "height_mm": span_mm}  # fmt: skip
    seen = make_view(made(SeenFrom, view), made(Size, {"width": size, "height": size}))
    side = ((np.arange(size) + 0.5) / size - 0.5) * span_mm
    return render_frame(ready, seen, bands=True)[..., 30], *np.meshgrid(side, -side)


@pytest.mark.heavy
def test_under_a_black_ball_an_endless_plane_is_dark_by_the_ball_s_form_factor_near_and_far():
    there = [Placement(Plane(), np.eye(3), np.zeros(3)), *placements()[1:]]
    far = [20000.0, 400.0]
    for span in far:
        found, x, y = seen_from_above(there, (0.5, 0.0), constant_light(), span_mm=span)
        distance = np.sqrt(x**2 + y**2 + HEIGHT_MM**2)
        beside = np.hypot(x, y) > 21.0  # the rest shows the ball
        wanted = 0.5 * (1.0 - HEIGHT_MM / distance * (20.0 / distance) ** 2)
        assert np.abs(found - wanted)[beside].mean() < 0.01 and np.abs(found - wanted)[beside].max() < 0.05


def lit_ball(shape) -> np.ndarray:
    """Return what is seen from above of a ball over a table, but for its rim."""
    there = [placements()[0], replace(placements()[1], shape=shape)]
    found, x, y = seen_from_above(there, (0.3, 0.8), LIGHT, span_mm=50.0, size=48)
    return found[np.hypot(x, y) < 17.0]


@functools.cache
def exact_ball() -> np.ndarray:
    return lit_ball(BALL)


@pytest.mark.heavy
@pytest.mark.parametrize("mesh", [octahedron(20.0, 3), BALL.facetted(1.0)], ids=["512 triangles", "16256"])
def test_a_ball_of_triangles_has_the_light_of_an_exact_ball(mesh):
    """Large triangles are divided for texels; where they are small, their corners are texels."""
    assert np.abs(lit_ball(TriangleMesh(mesh)) / exact_ball() - 1.0).mean() < 0.02


@pytest.mark.parametrize("parts", [1, 2, 7, 40])
def test_a_hit_at_or_just_beyond_a_triangles_edge_has_its_nodes_within_the_triangle(parts):
    at, rng = mesh_nodes.lattice(parts), np.random.default_rng(4)
    # Two of those whose shares added up to more than 1 when divided by their sum.
    pairs = [(1.0929607219267723e-09, 1.0), (2.3243158786545592e-10, 1.0), (1.0, 0.0), (0.0, 1.0), (0.0, 0.0)]
    pairs += [(x, 1.0) for x in 10.0 ** rng.uniform(-12, -7, 200)] + [
        (1.0, x) for x in 10.0 ** rng.uniform(-12, -7, 50)
    ]
    pairs += [(x, 1.0 - x + 2.0**-24) for x in rng.random(200)]
    for b, c in np.float32(pairs).astype(float):
        places, weights = mesh_nodes.lattice_place(parts, b, c)
        assert max(places) < len(at)
        found = sum(w * at[place] for place, w in zip(places, weights, strict=True))
        assert np.abs(found - (max(1.0 - b - c, 0.0), b, c)).max() <= 3e-7


@pytest.mark.heavy
def test_of_a_mesh_of_many_corners_some_are_traced_and_all_have_light(monkeypatch):
    """Light is spread from a quarter of the corners of a fine ball: the picture is that of an exact ball."""
    exact = exact_ball()
    monkeypatch.setattr(light_transfer, "_MOST_TEXELS", 2048)
    assert np.abs(lit_ball(TriangleMesh(BALL.facetted(1.0))) / exact - 1.0).mean() < 0.02


def block(half_mm: float, low_mm: float, high_mm: float):
    """A box of twelve triangles, two to each side."""
    x = np.array([[sx * half_mm, sy * half_mm, z] for z in (low_mm, high_mm) for sy in (-1, 1) for sx in (-1, 1)])
    sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    faces = np.array([[a, b, c] for a, b, c, _ in sides] + [[a, c, d] for a, _, c, d in sides])
    return TriangleMesh(make_mesh(x[faces], charts(12)))


def test_no_darkness_leaks_out_under_a_box_that_stands_in_a_table():
    """A white furnace: texels inside the box have no light, and light is interpolated at the box's foot."""
    there = [Placement(TABLE, np.eye(3), np.zeros(3)), Placement(block(19.0, -15.0, 15.0), np.eye(3), np.zeros(3))]
    found = seen_from_above(there, (1.0, 1.0), constant_light(2.0), span_mm=110.0)[0]
    assert np.abs(found / 2.0 - 1.0).max() < 0.05


@pytest.mark.heavy
def test_objects_inside_a_closed_box_are_dark_and_trace_to_an_end(monkeypatch):
    """No texel of plate and ball is in the open, so that none may send light; from outside the box is as it was.

    Of the box's 4096 texels each has a thousand hidden cells. With all their data in full they take 0.7 GB.
    """
    monkeypatch.setattr(light_transfer, "_MOST_TEXELS", 1 << 12)
    there = [*placements(), Placement(block(90.0, -90.0, 90.0), np.eye(3), np.zeros(3))]
    objects = make_objects(there, [material(0.8, mirror=1.0, n=0.2, k=3.0)] * 3)[0]
    tracemalloc.start()
    try:
        transfer = LightTransfer(Tracer(there), objects, constant_light())
        assert tracemalloc.get_traced_memory()[1] < 0.5e9
    finally:
        tracemalloc.stop()
    maps = transfer.maps(constant_light(), 30.0, np.zeros((0, 61)), np.zeros((0, 3)))
    assert maps.of(0).max() < 0.02 and maps.of(1).max() < 0.02 and np.abs(maps.of(2) - 1.0).max() < 0.02


@pytest.mark.usefixtures("coarse_light_maps")
def test_reflections_and_spectra_that_light_maps_leave_out_are_told(caplog, monkeypatch):
    objects = make_objects(placements(), [material(0.8), material(0.8)])[0]
    transfer, no_lamps = (
        LightTransfer(Tracer(placements()), objects, constant_light()),
        (np.zeros((0, 61)), np.zeros((0, 3))),
    )
    transfer.maps(constant_light(), 0.0, *no_lamps)
    assert "leave out" not in caplog.text and "without" not in caplog.text
    monkeypatch.setattr(light_transfer, "_MOST_REFLECTIONS", 1)
    transfer.maps(constant_light(), 0.0, *no_lamps)
    assert "leave out reflections after 1;" in caplog.text and "without" not in caplog.text
    # As many spectra as texels, none like another.
    transfer._gloss_maps(np.random.default_rng(5).uniform(size=(len(transfer.points.point), 61)).astype(np.float32))
    assert "gloss shows the light of other objects without" in caplog.text


GLOSSY = {"beta": 4.0, "mu": 0.15}


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("is_mesh", [False, True], ids=["exact", "of triangles"])
def test_gloss_of_white_neighbours_in_even_light_is_that_of_the_sky(is_mesh):
    """A white furnace: what neighbours hide from a lobe they send back, for every surface is as bright as the sky."""
    light = constant_light(2.0)
    shapes = [TriangleMesh(octahedron(20.0, 4)) if is_mesh and shape.wraps else shape for shape in SHAPES]
    matt, glossy, blind = (
        make_renderer(scene_of(MAPS), shapes, [material(1.0, **gloss)] * 2, light, OPTIONS)
        for gloss in ({}, GLOSSY, GLOSSY)
    )
    glossy.baked, blind.baked = matt.baked, replace(matt.baked, seen=())
    plain, seen, free = (renderer.picture("v")[0][..., 30] for renderer in (matt, glossy, blind))
    shown = free - plain > 1e-3
    assert shown.sum() > 200 and all((one[..., 0] < 0.5).any() for one in glossy.baked.seen)
    assert np.abs((seen - plain)[shown] / (free - plain)[shown] - 1.0).max() < 0.05


@pytest.mark.usefixtures("coarse_light_maps")
def test_in_even_light_a_turn_of_the_light_changes_nothing_that_gloss_shows():
    """Dark neighbours hide the same directions from a lobe, however the light is turned."""
    renderer = make_renderer(scene_of(MAPS), SHAPES, [material(0.1, **GLOSSY)] * 2, constant_light(2.0), OPTIONS)
    still, turned = (renderer.picture("v", moment)[0][..., 30] for moment in (STILL, TURNED))
    assert np.abs(turned - still).max() < 2e-3 * still.max()


@functools.cache
def glossy_renderers() -> list:
    """Return renderers by light maps, by those without what gloss sees of neighbours, and by paths."""
    materials = [material(0.5 * one, n=1.0, k=3.0, **GLOSSY) for one in COLOURED]
    kinds = MAPS, MAPS, PATHS | {"samples": 512}
    found = [make_renderer(scene_of(kind), SHAPES, materials, LIGHT, OPTIONS) for kind in kinds]
    found[1].baked = replace(found[0].baked, seen=())
    return found


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("moment", [STILL, REDDISH], ids=["as it stands", "another colour"])
def test_gloss_shows_neighbours_as_path_tracing_does(moment):
    """A coloured ball and plate in each other's gloss: nearer to paths than gloss that sees the sky through them."""
    white = LIGHT.upward_white()
    white = white * (1.0 if moment.filter is None else np.array(moment.filter))
    matrix = xyz_from_radiance(white)
    seen, blind, traced = (
        lab_from_xyz(renderer.picture("v", moment)[0] @ matrix.T, matrix @ white) for renderer in glossy_renderers()
    )
    far, without = delta_e(seen, traced), delta_e(blind, traced)
    assert far.mean() < 0.6 * without.mean() and np.percentile(far, 99) < 0.8 * np.percentile(without, 99)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("place", "turn_deg", "mean", "p99"),
    [("classroom", 0.0, 0.8, 4.0), ("hall", 225.0, 1.2, 6.0), ("museum", 225.0, 1.2, 6.0)],
)
def test_with_light_maps_the_still_life_is_near_the_path_traced_one_also_in_turned_places(place, turn_deg, mean, p99):
    """The true materials of the shipped scene in the virtual classroom, and in photographed places.

    Two thousand pixels are compared: a small picture has as many, with the same distances.
    """
    loaded = load_definitions(read_yaml(ROOT / "config/config.yaml"), ROOT)
    light = true_light(loaded, 500) if place == "classroom" else None
    if light is None:
        file = DATA / "environments" / f"{place}.exr"
        if not file.is_file():
            pytest.skip(f"no picture at {file}")
        picture = rgb_picture(file)
        weights = picture.weights.astype(np.float32)
        light = Environment(weights, picture.basis, fitted_irradiance_map(weights, max_error=2e-3, max_height=128)[0])
    moment = STILL._replace(environment_deg=turn_deg)
    small = made(Size, {"width": 320, "height": 240})
    scene = replace(loaded.scenes["still-life"], integrator=scene_of(MAPS).integrator, image=small)
    # The paths are traced where objects and eye are turned the other way.
    scenes = scene, turned_scene(scene, moment.seen_from("environment"))
    shapes = [Shape.from_definition(loaded.objects[item.object].shape) for item in scene.objects]
    shows, traced = (make_renderer(one, shapes, true_materials(loaded), light) for one in scenes)
    far = _to_reference(traced, "front", shows.picture("front", moment)[0], None)
    assert far["mean"] < mean and far["p99"] < p99


def test_black_light_gives_a_black_picture_and_a_mirror_over_a_black_table_none_brighter_than_the_sky():
    dark = make_renderer(scene_of(MAPS), SHAPES, [material(0.5, **GLOSSY)] * 2, constant_light(0.0), OPTIONS)
    assert (dark.picture("v")[0] == 0.0).all()
    mirror = [material(0.0), material(0.0, mirror=1.0, n=0.2, k=3.0)]
    found = make_renderer(scene_of(MAPS), SHAPES, mirror, constant_light(1.0), OPTIONS).picture("v")[0]
    assert np.isfinite(found).all() and (found >= 0.0).all() and found.max() < 1.001
