"""Occlusion by triangle meshes against closed forms, form factors and converged paths."""

from dataclasses import replace

import numba
import numpy as np
import pytest
from lathe import LID_MM, lathe
from made import made
from scenes import BALL, OPTIONS, constant_light, material, pixel_rays, plate
from shortcuts import ball
from studio import even_light, picture, placed, prepared, spectrum_of, view_of
from test_interactive_representations import uneven_light

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.config.models import (
    BodyShape,
    ObjectShape,
    Render,
    Scene,
)
from irodori.geometry.embree import Tracer
from irodori.geometry.mesh import Mesh, make_mesh
from irodori.geometry.rig_frame import rotation_xyz
from irodori.geometry.shapes import flat, mesh_shadow_nodes, sphere
from irodori.geometry.shapes.shape import Shape
from irodori.rendering.integrators import render_image
from irodori.rendering.interactive import mesh_shadows
from irodori.rendering.interactive.frame_renderer import render_frame

LIGHT = even_light()
WHITE = xyz_from_radiance(LIGHT.upward_white())[1] @ spectrum_of()
DISC = Shape.from_definition(made(ObjectShape | BodyShape, {"kind": "disc", "radius_mm": 15.0}))
FAR_BALL, SMALL_BALL = (
    Shape.from_definition(made(ObjectShape | BodyShape, {"kind": "sphere", "radius_mm": r})) for r in (60.0, 5.0)
)
PLANE = Shape.from_definition(made(ObjectShape | BodyShape, {"kind": "plane"}))
FLOOR_VIEW = {"position": (0, -400.0, 150.0), "target": (0, 0, 0), "size": (80, 50), "fov": 20}


@pytest.fixture(autouse=True)
def _few_nodes(request, monkeypatch):
    """Fewer nodes and rays than a user has, for speed; errors grow to about twice theirs."""
    mesh_shadows._found.clear()
    if "every_node" not in request.fixturenames:
        monkeypatch.setattr(flat, "FLAT_SIDE", 80)
        monkeypatch.setattr(sphere, "EQUATOR", 64)
        monkeypatch.setattr(mesh_shadow_nodes, "MESH_NODES", 4096)
        monkeypatch.setattr(mesh_shadows, "RAYS_PER_NODE", 256)


@pytest.fixture
def every_node():
    """As many nodes and rays as a user has."""


def mesh_ball(rings=48, radius=20.0) -> Shape:
    return Shape.from_mesh(make_mesh(*ball(radius, rings, 2 * rings)))


def squares(*corners) -> Shape:
    """A mesh of quadrangles of four corners each, every one with a square of the texture to itself."""
    corners, count = np.array(corners, dtype=np.float64), len(corners)
    side = int(np.ceil(np.sqrt(count)))
    where = np.array([(i % side, i // side) for i in range(count)])
    unit = np.array([[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9]])
    uv = (where[:, None] + unit) / side
    turn = np.array([[0, 1, 2], [0, 2, 3]])
    return Shape.from_mesh(make_mesh(corners[:, turn].reshape(-1, 3, 3), uv[:, turn].reshape(-1, 3, 2)))


def sheet(side, height=0.0) -> Shape:
    h = 0.5 * side
    return squares([(-h, -h, height), (h, -h, height), (h, h, height), (-h, h, height)])


def box(half: float, outward: bool) -> Shape:
    """A cube about the origin of twelve triangles, seen from outside or, as a room, from inside."""
    faces = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            a, b = np.roll([0.0, 1.0, 0.0], axis), np.roll([0.0, 0.0, 1.0], axis)
            centre = sign * np.roll([1.0, 0.0, 0.0], axis)
            a, b = (a, b) if sign > 0 else (b, a)
            faces.append([half * (centre + p * a + q * b) for p, q in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    found = squares(*faces)
    if outward:
        return found
    # `make_mesh` refuses closed surfaces that look inward.
    mesh = found.mesh
    turned = Mesh(mesh.vertices_mm, mesh.faces[:, ::-1].copy(), mesh.uv[:, ::-1].copy(), -mesh.normals[:, ::-1])
    return Shape.from_mesh(turned)


def lid() -> Shape:
    """The example's lid on its rim at z = 0, open below."""
    return Shape.from_mesh(make_mesh(*lathe(np.array(LID_MM), 36, 1 / 64)))


def shares(shapes, materials, places, view=None, light=LIGHT, **scene):
    """Y over that of a white surface."""
    found = picture(shapes, materials, light, view=view or FLOOR_VIEW, places=places, ambient=True, **scene)
    return found[..., 1] / WHITE


def assert_alike(found, truth, rms, largest):
    """Assert that shares agree; outlines of triangles, where the sky (1) or a black shape (0) is seen, are left out."""
    same = ((found > 0.0) == (truth > 0.0)) & ((found > 0.95) == (truth > 0.95))
    assert same.mean() > 0.98
    apart = (found - truth)[same]
    assert np.sqrt(np.mean(apart**2)) <= rms and np.abs(apart).max() <= largest


# --- against closed forms -------------------------------------------------------------------------------------------

RECEIVERS = {
    "plate": (plate(400.0), plate(400.0)),
    "disc": (Shape.from_definition(made(ObjectShape | BodyShape, {"kind": "disc", "radius_mm": 200.0})),) * 2,
    "plane": (PLANE, PLANE),
    "mesh": (sheet(400.0), plate(400.0)),
    "large plate": (plate(1e5), plate(1e5)),
}


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(
    "receiver", ["plate", "mesh", "plane", *(pytest.param(r, marks=pytest.mark.heavy) for r in ("disc", "large plate"))]
)
def test_a_ball_of_triangles_throws_the_contact_shadow_of_the_exact_ball(receiver):
    """A black ball that touches its floor; where the floor is of triangles too, the plate is the truth."""
    floor, exact = RECEIVERS[receiver]
    colours, places = [material(0.8), material(0.0)], [(0, 0, 0), (0, 0, 20.0)]
    found = shares([floor, mesh_ball()], colours, places)
    truth = shares([exact, BALL], colours, places)
    bare = shares([exact, BALL], colours, [(0, 0, 0), (0, 0, 1e5)])
    assert np.abs(truth - bare)[truth > 0].max() > 0.5
    # Large triangles are divided evenly, not more finely at the contact: to 6 mm here.
    assert_alike(found, truth, 0.004, 0.06 if receiver == "mesh" else 0.03)


@pytest.mark.heavy
def test_the_contact_shadow_is_exact_within_two_parts_in_a_thousand(every_node):
    colours, places = [material(0.8), material(0.0)], [(0, 0, 0), (0, 0, 20.0)]
    found, truth = (shares([plate(400.0), b], colours, places) for b in (mesh_ball(96), BALL))
    assert_alike(found, truth, 0.002, 0.012)


@pytest.mark.parametrize("triangles", [pytest.param(False, marks=pytest.mark.heavy), True])
def test_balls_that_touch_hide_each_other_as_exact_ones_do(triangles):
    """The ball that is looked at is exact, or of triangles as well."""
    colours, places = [material(0.8), material(0.0)], [(-20, 0, 0), (20, 0, 0)]
    view = {"position": (60.0, -250, 40), "target": (-12, 0, 0), "size": (60, 50), "fov": 9}
    found = shares([mesh_ball() if triangles else BALL, mesh_ball()], colours, places, view)
    truth = shares([BALL, BALL], colours, places, view)
    assert_alike(found, truth, 0.006, 0.04)


def test_an_open_sheet_hides_what_a_plate_hides_and_its_back_is_black():
    colours, places = [material(0.8), material(0.6)], [(0, 0, 0), (0, 0, 20.0)]
    found, truth = (shares([plate(400.0), s], colours, places) for s in (sheet(60.0), plate(60.0)))
    assert_alike(found, truth, 0.004, 0.03)


@pytest.mark.heavy
@pytest.mark.parametrize("grey", [0.0, 0.7])
def test_what_two_shapes_hide_together_counts_once(grey):
    """A ball of triangles right behind a disc that covers it adds nothing, in front of it takes what the disc had."""
    view = {"position": (0, -400.0, 250.0), "target": (0, 0, 0), "size": (16, 12), "fov": 1.0}
    small = mesh_ball(24, 4.0)
    colours = [material(0.8), material(grey), material(grey)]
    both = shares([plate(400.0), DISC, small], colours, [(0, 0, 0), (0, 0, 20.0), (0, 0, 26.0)], view)
    alone = shares([plate(400.0), DISC, small], colours, [(0, 0, 0), (0, 0, 20.0), (0, 0, 1e5)], view)
    assert np.abs(both - alone).max() <= 0.01
    # Of a disc that faces down: its front is what the floor sees.
    turned = {"rotations": [np.eye(3), rotation_xyz((180.0, 0.0, 0.0)), np.eye(3)]}
    front = shares([plate(400.0), DISC, small], colours, [(0, 0, 0), (0, 0, 20.0), (0, 0, 14.0)], view, **turned)
    disc = shares([plate(400.0), DISC, small], colours, [(0, 0, 0), (0, 0, 20.0), (0, 0, 1e5)], view, **turned)
    assert np.abs(front - disc).max() <= 0.01


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("grey", [0.0, 0.9])
def test_what_hangs_in_front_of_a_ceiling_hides_it_although_it_hides_no_sky(grey):
    """A ball of triangles between a floor and a ceiling so wide that no ray to the sky meets the ball."""
    ceiling = Shape.from_definition(made(ObjectShape | BodyShape, {"kind": "disc", "radius_mm": 4000.0}))
    turns = [np.eye(3), rotation_xyz((180.0, 0.0, 0.0)), np.eye(3)]
    colours, places = [material(0.8), material(0.9), material(grey)], [(0, 0, 0), (0, 0, 62.0), (0, 0, 40.0)]
    view = {"position": (0, -300.0, 50.0), "target": (0, 0, 0), "size": (1, 1), "fov": 0.05}
    found = shares([plate(300.0), ceiling, mesh_ball(24)], colours, places, view, rotations=turns)[0, 0]
    assert found == pytest.approx(0.8 * (0.75 * 0.9 + 0.25 * grey), abs=0.006)


# --- enclosures and hollows -----------------------------------------------------------------------------------------


def test_a_closed_box_about_a_plate_hides_all_and_a_grey_room_sends_its_light_back():
    view = {"position": (0.0, -30.0, 30.0), "target": (0, 0, 0), "size": (9, 9), "fov": 20}
    colours = [material(0.8), material(0.5)]
    places = [(0, 0, 0), (0, 0, 0)]
    assert (np.abs(shares([plate(40.0), box(50.0, True)], colours, places, view)) <= 1e-6).all()
    assert np.allclose(shares([plate(40.0), box(50.0, False)], colours, places, view), 0.8 * 0.5, rtol=2e-3)


@pytest.mark.parametrize("distance", [0.5, 2.0, 10.0, 20.0])
def test_a_wall_hides_its_form_factor_from_the_floor_of_the_same_mesh(distance):
    """Of a wall of height h without end the floor at distance d sees (1 - d / √(d² + h²)) / 2."""
    w, h = 400.0, 20.0
    floor = [(-w, -w, 0), (w, -w, 0), (w, 0, 0), (-w, 0, 0)]
    wall = [(-w, 0, 0), (w, 0, 0), (w, 0, h), (-w, 0, h)]
    view = {"position": (0.0, -distance - 400.0, 300.0), "target": (0, -distance, 0), "size": (1, 1), "fov": 0.01}
    found = shares([squares(floor, wall)], [material(0.01)], [(0, 0, 0)], view)[0, 0] / 0.01
    truth = 1 - 0.5 * (1 - distance / np.hypot(distance, h))
    assert found == pytest.approx(truth, abs=0.012)


def test_a_convex_mesh_hides_nothing_from_itself():
    for shape in (mesh_ball(8), box(20.0, True)):
        view = {"position": (30.0, -250, 130), "size": (50, 50)}
        found = [
            picture([shape], [material(0.6)], LIGHT, "spectral", view=view, ambient=ambient)
            for ambient in (True, False)
        ]
        assert np.array_equal(*found)
        assert mesh_shadows.make_mesh_shadows(Tracer(placed([shape]))) is None


# --- against paths that converge ------------------------------------------------------------------------------------


@pytest.mark.heavy
@pytest.mark.default_cases(1)
@pytest.mark.parametrize(("cover", "table", "rms"), [(0.0, 0.8, 0.008), (0.5, 0.5, 0.012)])
def test_a_lid_on_a_plate_is_shaded_as_the_reference_integrator_shades_it(cover, table, rms):
    """By its light maps."""
    shapes, eye, target, size, fov = [plate(100.0), lid()], (0.0, -330.0, 190.0), (0.0, 0.0, 10.0), (40, 30), 14.0
    scene = {
        "image": {"width": size[0], "height": size[1]}, "lights": [],
        "objects": [{"object": name, "position_mm": [0.0] * 3, "rotation_deg": [0.0] * 3, "scale": 1.0}
                    for name in "ab"],
        "views": {"v": {"position_mm": eye, "target_mm": target, "up": [0, 0, 1], "field_of_view_deg": fov}},
    }  # fmt: skip
    kinds = [{"kind": "interactive", "light_maps": a} for a in (True, False)]
    kinds.append({"kind": "reference", "samples": 256, "seed": 0})
    options = replace(OPTIONS, pixel_side=4)
    found, bare, truth = (
        render_image(made(Scene, scene | {"integrator": kind}), "v", shapes, [material(table), material(cover)],
                     constant_light(), made(Render, options))[0][..., 30] for kind in kinds
    )  # fmt: skip
    # Pixels that show one shape only.
    rays = pixel_rays(eye, target, (4 * size[0], 4 * size[1]), fov).reshape(-1, 3)
    seen = Tracer(placed(shapes)).intersect(np.broadcast_to(eye, rays.shape), rays)[1]
    seen = seen.reshape(size[1], 4, size[0], 4)
    whole = (seen.min(axis=(1, 3)) == seen.max(axis=(1, 3))) & (seen.min(axis=(1, 3)) >= 0)
    assert whole.sum() > 400
    error, without = (np.sqrt(np.mean((image - truth)[whole] ** 2)) for image in (found, bare))
    assert error <= rms and without >= 3 * error


# --- what repeats, turns, and grows ---------------------------------------------------------------------------------


def still(**options):
    return prepared([plate(120.0), lid(), BALL], [material(0.8), material(0.5), material(0.3)], uneven_light(),
                    places=[(0, 0, 0), (-15, 0, 0), (38, 0, 20)], ambient=True, **options)  # fmt: skip


@pytest.mark.heavy
def test_neither_threads_nor_what_was_kept_change_a_bit():
    view = view_of((20, -300, 150), (0, 0, 5), (64, 48), 24.0)
    threads, found = numba.get_num_threads(), []
    try:
        for count in (1, threads):
            numba.set_num_threads(count)
            mesh_shadows._found.clear()
            ready = still()
            found += [render_frame(ready, view, keep_visibility=True) for _ in range(2)]
        found.append(render_frame(still(), view))
    finally:
        numba.set_num_threads(threads)
    assert all(np.array_equal(found[0], other) for other in found[1:])


def test_turning_the_light_is_turning_the_eye_the_other_way_about_a_lid_that_looks_the_same():
    shapes, colours = [plate(120.0), lid()], [material(0.8), material(0.5)]
    ready = prepared(shapes, colours, uneven_light(), ambient=True)
    turn = rotation_xyz((0.0, 0.0, 90.0))
    eye = np.array([40.0, -300.0, 150.0])
    turned = render_frame(ready, view_of(turn @ eye, (0, 0, 5), (64, 48), 24.0), world_from_light=turn)
    still_ = render_frame(ready, view_of(eye, (0, 0, 5), (64, 48), 24.0))
    other = render_frame(ready, view_of(eye, (0, 0, 5), (64, 48), 24.0), world_from_light=turn)
    scale = still_.max()
    assert np.sqrt(np.mean(((turned - still_) / scale) ** 2)) <= 0.004
    assert np.abs(other - still_).max() > 0.1 * scale


@pytest.mark.stability(stage="render", case="scene of 1 mm")
@pytest.mark.stability(stage="render", case="scene of 1 km")
@pytest.mark.heavy
@pytest.mark.parametrize("scale", [1 / 120.0, 1e6 / 120.0])
def test_shadows_of_a_millimetre_and_of_a_kilometre_are_those_of_a_lid(scale):
    view = {"position": (20, -300, 150), "target": (0, 0, 5), "size": (64, 48), "fov": 24.0}
    pair = [
        shares([plate(120.0), lid(), mesh_ball(12)], [material(0.8), material(0.5), material(0.3)],
               [(0, 0, 0), (-15, 0, 0), (38, 0, 20)], view | {"scale": s}, scale=s) for s in (1.0, scale)
    ]  # fmt: skip
    assert_alike(pair[1], pair[0], 0.002, 0.03)


@pytest.mark.heavy
def test_triangles_without_area_and_needles_among_others_change_nothing():
    corners, uv = ball(20.0, 24, 48)
    point, needle = corners[:1, [0, 0, 1]], np.array([[[0.0, 0, 20.0], [0.0, 1e-9, 20.0], [1e-9, 0, 20.0]]])
    spoilt = Shape.from_mesh(make_mesh(np.concatenate([corners, point, needle]), np.concatenate([uv, uv[:2]])))
    colours, places = [material(0.8), material(0.0)], [(0, 0, 0), (0, 0, 20.0)]
    found = shares([plate(400.0), spoilt], colours, places)
    truth = shares([plate(400.0), mesh_ball(24)], colours, places)
    assert np.isfinite(found).all()
    assert_alike(found, truth, 0.002, 0.02)


@pytest.mark.parametrize("sunk", [0.0, 1e-3, *(pytest.param(s, marks=pytest.mark.heavy) for s in (-1e-3, 1e-6, 2.0))])
def test_a_post_that_stands_on_its_floor_or_in_it_leaks_neither_light_nor_shadow(sunk):
    """At a distance D from its axis the floor loses arcsin(R / D) / π of the sky to a black post of endless height."""
    radius, segments, height = 10.0, 48, 4000.0
    profile = np.array([(0.0, 0), (radius, 0), (radius, height), (0, height)])
    post = Shape.from_mesh(make_mesh(*lathe(profile, segments, 1 / 64)))
    view = {"position": (0.0, -300.0, 500.0), "target": (0, -22, 0), "size": (1, 80), "fov": 4.0}
    found = shares([plate(400.0), post], [material(0.8), material(0.0)], [(0, 0, 0), (0, 0, -sunk)], view)[:, 0] / 0.8
    ray = pixel_rays(view["position"], view["target"], view["size"], view["fov"])[:, 0]
    away = 300.0 + 500.0 * ray[:, 1] / ray[:, 2]
    truth = 1.0 - np.arcsin(radius / np.maximum(away, radius)) / np.pi
    ground = away > 1.01 * radius
    assert ground.sum() > 40
    assert np.abs(found - truth)[ground].max() <= 0.02


def test_a_scene_without_meshes_has_no_shadows_to_look_up():
    ready = prepared([plate(100.0), BALL], [material(0.5)] * 2, LIGHT, ambient=True)
    assert ready.world.shadowed == 0
    dark = prepared([plate(100.0), lid()], [material(0.5)] * 2, LIGHT, ambient=False)
    assert dark.world.shadowed == 0


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(
    ("away", "height", "other", "grey"), [(200, -55, 0, 0), (200, -55, 0.5, 0.5), (10, -80, 0.9, 0)]
)
def test_a_fifth_mesh_has_its_shadow_where_four_larger_ones_hide_nothing(away, height, other, grey):
    """A small ball on a plate; the others hardly rise over the plate's horizon beside it, or are under it."""
    centres = [(away, 0, height), (-away, 0, height), (0, away, height), (0, -away, height), (0, 0, 5.0)]
    colours, places = [material(0.8)] + [material(other)] * 4 + [material(grey)], [(0, 0, 0), *centres]
    view = {"position": (0, -40.0, 200.0), "target": (0, -8.0, 0), "size": (31, 1), "fov": 0.72}
    found, truth = (
        shares([plate(100.0), *balls], colours, places, view)[0]
        for balls in ([mesh_ball(16, 60.0)] * 4 + [mesh_ball(16, 5.0)], [FAR_BALL] * 4 + [SMALL_BALL])
    )
    assert truth.min() < 0.7 + 0.1 * grey and truth.max() > 0.78
    assert np.abs(found - truth).max() <= 0.02


@pytest.mark.parametrize("parts", [1, 2, 7, 40])
def test_a_hit_at_or_just_beyond_a_triangles_edge_has_its_nodes_within_the_triangle(parts):
    at, rng = mesh_shadow_nodes.lattice(parts), np.random.default_rng(4)
    # Two of those whose shares added up to more than 1 when divided by their sum.
    pairs = [(1.0929607219267723e-09, 1.0), (2.3243158786545592e-10, 1.0), (1.0, 0.0), (0.0, 1.0), (0.0, 0.0)]
    pairs += [(x, 1.0) for x in 10.0 ** rng.uniform(-12, -7, 200)] + [
        (1.0, x) for x in 10.0 ** rng.uniform(-12, -7, 50)
    ]
    pairs += [(x, 1.0 - x + 2.0**-24) for x in rng.random(200)]
    for b, c in np.float32(pairs).astype(float):
        places, weights = mesh_shadow_nodes.lattice_place(parts, b, c)
        assert max(places) < len(at)
        found = sum(w * at[place] for place, w in zip(places, weights, strict=True))
        assert np.abs(found - (max(1.0 - b - c, 0.0), b, c)).max() <= 3e-7


@pytest.mark.heavy
def test_of_many_meshes_the_strongest_reflect_and_all_hide():
    """Six black posts about a point: two more than are kept apart."""
    posts = [mesh_ball(24, 8.0)] * 6
    angles = np.arange(6) * np.pi / 3
    places = [(0, 0, 0)] + [(20 * np.cos(a), 20 * np.sin(a), 8.0) for a in angles]
    view = {"position": (0.0, -10.0, 300.0), "target": (0, 0, 0), "size": (15, 15), "fov": 2.0}
    colours = [material(0.8)] + [material(0.0)] * 6
    exact = Shape.from_definition(made(ObjectShape | BodyShape, {"kind": "sphere", "radius_mm": 8.0}))
    found = shares([plate(400.0), *posts], colours, places, view)
    truth = shares([plate(400.0), exact, *[exact] * 5], colours, places, view)
    # Closed forms multiply what each leaves, rays add what each hides.
    hidden = 6 * (8.0 / np.hypot(20.0, 8.0)) ** 2 * 8.0 / np.hypot(20.0, 8.0)
    assert found[7, 7] == pytest.approx(0.8 * (1 - hidden), abs=0.012)
    assert truth[7, 7] > found[7, 7]
