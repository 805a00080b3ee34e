"""Meshes in the tracer, the rectification and the renderer: the same answers as the shapes that they approximate."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lathe import LID_MM, lathe, write_obj
from made import made
from scenes import BALL, constant_light, material, plate, render, sky
from shortcuts import ball
from test_rectification import PLATE_POSES, pixel_of, rectify, setup_of

from irodori.config.capture_table import Pose
from irodori.config.models import (
    BodyShape,
    Object,
    ObjectShape,
    Rig,
)
from irodori.config.parts import PlannedObject
from irodori.geometry.embree import NO_HIT, Tracer
from irodori.geometry.mesh import make_mesh
from irodori.geometry.rig_frame import rig_from_object, rotation_xyz
from irodori.geometry.shapes.placement import Placement, on_table
from irodori.geometry.shapes.plate import Plate
from irodori.geometry.shapes.shape import Shape
from irodori.geometry.shapes.sphere import Sphere
from irodori.geometry.shapes.triangle_mesh import TriangleMesh
from irodori.rectification.placement_correction import AS_TYPED
from irodori.rectification.stage import observe

SEEDS = st.integers(0, 2**32 - 1)
#: Radius and height of the vase, mm, closed: foot, belly, neck, a lip rolled over, and a floor inside the neck.
VASE_MM = (
    (0.0, 0.0), (11.0, 0.0), (12.5, 1.2), (12.0, 3.0), (14.5, 7.0), (18.5, 13.0), (21.5, 20.0), (22.6, 27.0),
    (21.8, 34.0), (19.0, 41.0), (15.2, 47.0), (11.6, 52.0), (9.6, 56.5), (9.2, 60.0), (10.2, 63.5), (12.4, 66.5),
    (12.9, 67.4), (12.2, 67.8), (11.2, 67.1), (8.6, 63.0), (7.8, 58.0), (0.0, 57.0),
)  # fmt: skip


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def vase(scale=1.0, segments=36):
    corners, uv = lathe(np.array(VASE_MM) - [0.0, 33.9], segments, margin=1 / 64)
    return TriangleMesh(make_mesh(scale * corners, uv))


def sphere_of_triangles(radius=25.0, rings=96):
    return TriangleMesh(make_mesh(*ball(radius, rings, 2 * rings)))


def placed(rng, shape, spread=50.0):
    return Placement(
        shape, rotation_xyz(rng.uniform(-180, 180, 3)), rng.uniform(-spread, spread, 3), rng.uniform(0.5, 2.0)
    )


# The tracer


def nearest_triangle(corners, origins, directions):
    """Distances to the first of all triangles, (n, 3, 3), that each ray meets, infinite for none.

    By the algorithm of T. Möller and B. Trumbore, "Fast, minimum storage ray/triangle intersection", 1997. Another
    device of Embree would leave a thread that waits in a loop, and takes a core until the process ends.
    """
    first, one, two = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    found = np.empty(len(origins))
    for number, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        across = np.cross(direction, two)
        from_first = origin - first
        around = np.cross(from_first, one)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 / np.sum(one * across, axis=1)
            u, v, far = (scale * part for part in (
                np.sum(from_first * across, axis=1), around @ direction, np.sum(two * around, axis=1)))  # fmt: skip
            met = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (far > 0.0)
        found[number] = far[met].min(initial=np.inf)
    return found


@given(seed=SEEDS)
@settings(deadline=None, max_examples=8)
def test_the_first_triangle_and_its_distance_are_those_of_all_triangles_tried_in_turn(seed):
    rng = np.random.default_rng(seed)
    where = placed(rng, vase())
    mesh = where.shape.mesh
    targets = where.translation_mm + rng.normal(scale=15.0 * where.scale, size=(500, 3))
    origins = where.translation_mm + 400.0 * unit(rng.normal(size=(500, 3)))
    directions = unit(targets - origins)
    expected = nearest_triangle(where.points(mesh.vertices_mm)[mesh.faces], origins, directions)
    tracer = Tracer([where])
    distance, shape = tracer.intersect(origins, directions)
    assert (shape == 0).sum() > 100
    # A ray along an outline may pass on either side of it.
    same = np.isfinite(expected) == (shape == 0)
    assert same.mean() > 0.995
    both = same & (shape == 0)
    close = np.isclose(distance[both], expected[both], rtol=1e-6)
    assert close.mean() > 0.995
    assert np.array_equal(tracer.occluded(origins, directions), shape == 0)


@given(seed=SEEDS)
@settings(deadline=None, max_examples=8)
def test_a_sphere_of_triangles_is_hit_within_its_sagitta(seed):
    rng = np.random.default_rng(seed)
    exact = placed(rng, Sphere(25.0))
    facets = dataclasses.replace(exact, shape=sphere_of_triangles())
    origins = exact.translation_mm + 300.0 * unit(rng.normal(size=(3000, 3)))
    directions = unit(exact.translation_mm + 15.0 * exact.scale * unit(rng.normal(size=(3000, 3))) - origins)
    near, _ = Tracer([exact]).intersect(origins, directions)
    found, shape = Tracer([facets]).intersect(origins, directions)
    assert (shape == 0).all()
    # Facets lie under the sphere by the sagitta of their diagonal, met at 37 degrees at most.
    sagitta = 25.0 * exact.scale * (np.pi / 96) ** 2 / 4
    assert (found >= near - 1e-6).all() and (found - near).max() < 1.3 * sagitta / 0.8


@pytest.mark.stability(stage="render", case="hits on shared edges")
@given(seed=SEEDS)
@settings(deadline=None, max_examples=10)
def test_no_ray_slips_through_an_edge(seed):
    rng = np.random.default_rng(seed)
    where = placed(rng, vase())
    mesh = where.shape.mesh
    world = where.points(mesh.vertices_mm)
    a, b = world[mesh.faces], world[np.roll(mesh.faces, -1, axis=1)]
    edges = (a + rng.uniform(0.02, 0.98, (*a.shape[:2], 1)) * (b - a)).reshape(-1, 3)
    # From inside the belly every way out is closed.
    tracer = Tracer([where])
    for targets, slipped in ((edges, 0), (world, 2)):
        inside = where.points(np.array([0.0, 0.0, -33.9 + 27.0])) + rng.normal(scale=0.5, size=targets.shape)
        # Embree decides each edge by the same numbers from either side; about a vertex, where six edges meet, single
        # precision leaves a gap for about one in 25 000 of the rays aimed at it.
        assert (tracer.intersect(inside, unit(targets - inside))[1] != 0).sum() <= slipped


def test_meshes_spheres_and_plates_hide_each_other():
    rng = np.random.default_rng(4)
    exact = [
        Placement(Sphere(20.0), translation_mm=np.array([0.0, 0.0, 20.0])),
        Placement(Plate(200.0, 200.0)),
        Placement(Sphere(20.0), rotation_xyz((20, 30, 40)), np.array([30.0, 10.0, 25.0])),
    ]
    mixed = [exact[0], exact[1], dataclasses.replace(exact[2], shape=sphere_of_triangles(20.0))]
    origins = np.array([0.0, 0.0, 30.0]) + 300.0 * unit(rng.normal(size=(5000, 3)) * [1, 1, 0.5] + [0, 0, 0.5])
    directions = unit(np.array([15.0, 0.0, 20.0]) + rng.normal(scale=20.0, size=(5000, 3)) - origins)
    shapes = [Tracer(placements).intersect(origins, directions)[1] for placements in (exact, mixed)]
    assert np.bincount(shapes[0] + 1, minlength=4)[1:].min() > 300
    assert np.mean(shapes[0] != shapes[1]) < 2e-3  # outlines move by a sagitta


@pytest.mark.stability(stage="render", case="self-intersection")
@given(exponent=st.floats(-4, 4), seed=SEEDS)
@settings(deadline=None, max_examples=15)
def test_a_convex_mesh_neither_hides_nor_shadows_itself_at_any_size(exponent, seed):
    rng = np.random.default_rng(seed)
    scale = 10.0**exponent
    shape = TriangleMesh(make_mesh(*(lambda c, t: (scale * c, t))(*ball(1.0, 24, 48))))
    texels = shape.atlas(96, 48)
    pose = Pose(rng.uniform(35, 125), rng.uniform(0, 140), rng.uniform(0, 45), rng.uniform(0, 360))
    rotation = rig_from_object(pose)
    position, normal, facet = (v[texels.covered] @ rotation.T for v in (texels.position, texels.normal, texels.facet))
    setup = dataclasses.replace(setup_of(), camera_distance_mm=40.0 * scale)
    sight = observe(position, normal, Tracer(on_table(shape, rotation, 0.0)), pose, setup, facet)
    light = np.array([np.sin(np.radians(pose.light_deg)), 0, np.cos(np.radians(pose.light_deg))])
    lit = (normal @ light > 0) & (facet @ light > 1e-6)
    assert (sight.lit == lit)[np.abs(facet @ light) > 1e-6].all()
    assert lit.mean() > 0.3
    frontal = np.radians(89.0)
    assert sight.visible[(sight.geometry[:, 1] < frontal - np.radians(8.0))].all()


@pytest.mark.parametrize("turned", [(0.2, -0.3), (-0.8, 0.5)])
def test_a_flat_mesh_that_registration_turns_is_not_cut_by_the_table_it_lies_on(turned):
    place = 45.0 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    chart = np.array([[0, 1], [1, 1], [1, 0], [0, 0.0]])
    faces = [[0, 1, 2], [0, 2, 3]]
    shape = TriangleMesh(make_mesh(place[faces], chart[faces]))
    texels, pose = shape.atlas(48, 48), Pose(45.0, 20.0, 15.0)
    correction = AS_TYPED.by([0.0, 0.0, 0.2, *turned, *[0.0] * 7])
    lies, table = correction.placements(shape, pose, 25.0)
    position, normal = lies.points(texels.position).reshape(-1, 3), texels.normal.reshape(-1, 3) @ lies.rotation.T
    sight = observe(position, normal, Tracer([lies, table]), pose, setup_of())
    assert sight.visible.all() and sight.lit.all()
    # What faces the table is still hidden by it.
    over = (np.abs(texels.position[..., :2]) < 20.0).all(axis=2).ravel()
    below = observe(position, -normal, Tracer([lies, table]), Pose(45.0 + 180.0, 200.0, 15.0), setup_of())
    assert not below.visible[over].any() and not below.lit[over].any()


def test_the_neck_of_the_vase_lies_in_the_shadow_of_its_lip():
    shape = vase()
    texels = shape.atlas(64, 256)
    position, normal, facet = (v[texels.covered] for v in (texels.position, texels.normal, texels.facet))
    pose = Pose(10.0, 35.0)
    sight = observe(position, normal, Tracer(on_table(shape, np.eye(3), 0.0)), pose, setup_of(), facet)
    towards = (normal @ [np.sin(np.radians(10)), 0, np.cos(np.radians(10))] > 0.05) & (np.abs(position[:, 1]) < 3)
    height, radius = position[:, 2] + 33.9, np.hypot(*position[:, :2].T)
    # The lip stands 3.7 mm further out than the neck: at 10 degrees its shadow reaches 21 mm down, to 46 mm and the
    # shoulder, and the belly, 8 mm further out than the lip, is beyond it.
    neck = towards & (height > 55) & (height < 62) & (radius > 9) & (position[:, 0] > 0)
    belly = towards & (height > 28) & (height < 38) & (position[:, 0] > 0)
    assert neck.sum() > 20 and belly.sum() > 20
    assert not sight.lit[neck].any() and sight.lit[belly].all()


# Rectification

EXACT = {"shape": {"kind": "sphere", "radius_mm": 25.0}, "texels": {"width": 64, "height": 32}}


@pytest.fixture(scope="module")
def facets(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "ball.obj"
    write_obj(path, *ball(25.0, 96, 192), digits=9)
    return {"shape": {"kind": "mesh", "file": str(path), "unit": "mm"}, "texels": EXACT["texels"]}


def test_a_sphere_of_triangles_is_observed_as_the_sphere(tmp_path, facets):
    exact, found = (
        rectify(tmp_path, definition, PLATE_POSES, setup=setup_of(40.0), max_angle_deg=80.0, name=f"{i}.h5")
        for i, definition in enumerate((EXACT, facets))
    )
    texel = found["texel"] == 1
    assert exact["texel"].all() and texel.mean() > 0.95
    apart = np.abs(found["geometry"] - exact["geometry"])[texel]
    # The bound on position and normal of `test_meshes`, 25 mm and 1 rad times 4.3e-4; φ and θ_r move by as much.
    assert apart.max() < 1.5e-3
    same = found["weight"] == exact["weight"]
    limit = np.radians(80.0)
    clear = (np.abs(exact["geometry"][..., :2] - limit) > 2e-3).all(axis=2) & texel[:, None]
    # The table's shadow ends somewhere: within the sagitta of it the two may differ.
    assert same[clear].mean() > 0.998
    both = (found["weight"] > 0) & (exact["weight"] > 0)
    # Responses of the test's picture are places in it: 0.011 mm are 0.03 superpixels. Both are stored as float16.
    one, other = (np.asarray(each["response"])[both][:, :2].astype(np.float64) for each in (found, exact))
    assert (np.abs(one - other) <= 0.05 / 512 + np.spacing(np.float16(np.maximum(one, other)))).all()


def test_what_is_no_texel_is_zero_throughout_and_said_to_be_none(tmp_path, facets):
    half = dict(facets)
    path = tmp_path / "half.obj"
    corners, uv = ball(25.0, 32, 64)
    write_obj(path, corners, 0.25 + 0.5 * uv, digits=9)
    half["shape"] = facets["shape"] | {"file": str(path)}
    found = rectify(tmp_path, half, PLATE_POSES, setup=setup_of(40.0))
    texel = found["texel"].astype(bool)
    assert texel.mean() == pytest.approx(0.25, abs=0.02)
    for name, values in found.items():
        assert not values[~texel].any(), name
    assert (found["weight"][texel] > 0).any(axis=1).mean() > 0.3


def test_a_texel_that_no_capture_sees_is_a_texel_without_weight(tmp_path, facets):
    found = rectify(tmp_path, facets, PLATE_POSES, setup=setup_of(40.0))
    south = slice(64 * 28, 64 * 31)  # under the sphere, towards the table
    assert found["texel"][south].all() and not found["weight"][south].any()
    # It keeps its geometry, which says why: every pose looks at its back.
    assert (found["geometry"][south, :, 1] > np.pi / 2).all()


@pytest.mark.heavy
def test_tiles_of_a_mesh_are_bit_identical_to_the_whole(tmp_path, facets):
    whole = rectify(tmp_path, facets, PLATE_POSES, setup=setup_of(20.0))
    parts = [
        rectify(tmp_path, facets, PLATE_POSES, rows=rows, setup=setup_of(20.0), name=f"t{rows[0]}.h5")
        for rows in itertools.pairwise([0, 1, 13, 32])
    ]
    for name, values in whole.items():
        assert np.array_equal(np.concatenate([part[name] for part in parts]), values), name


def test_texels_of_a_mesh_take_their_own_place_in_the_picture(tmp_path):
    path = tmp_path / "lid.obj"
    corners, uv = lathe(np.array(LID_MM) - [0.0, 14.4], 36, margin=1 / 64)
    write_obj(path, corners, uv, digits=9)
    definition = {"shape": {"kind": "mesh", "file": str(path), "unit": "mm", "pivot_mm": [0, 0, 0]},
                  "texels": {"width": 48, "height": 48}}  # fmt: skip
    shape = Shape.from_definition(made(ObjectShape | BodyShape, definition["shape"]))
    found = rectify(tmp_path, definition, PLATE_POSES)
    for j, pose in enumerate(PLATE_POSES):
        position = shape.texels(48, 48)[0].reshape(-1, 3) @ rig_from_object(pose).T
        seen = found["weight"][:, j] > 0
        x, y = pixel_of(position, pose).T
        assert seen.mean() > 0.2
        expected = np.stack([x / 512, y / 512, (3 * x - 2 * y) / 512], axis=1)
        rounding = 0.5 * np.spacing(np.float16(np.abs(expected[seen])))  # of float16, in which responses are stored
        assert (np.abs(found["response"][seen, j] - expected[seen]) <= 5e-3 / 512 + rounding).all()


# The renderer


def textured(width=64, height=32):
    """A material of smooth bands of colour and one sharp edge."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    values = 0.5 + 0.3 * np.cos(4 * np.pi * u) * np.sin(np.pi * v)
    uniform = material(1.0)
    return dataclasses.replace(
        uniform, alpha=values, green_response=np.ones_like(values), beta=np.full_like(values, 1.0),
        mu=np.full_like(values, 0.2), coefficients=np.ones((height, width, 1), np.float32),
    )  # fmt: skip


def smooth(direction):
    x, y, z = np.moveaxis(direction, -1, 0)
    return (1.0 + 0.5 * x - 0.3 * y + 0.6 * z * z)[..., None]


@pytest.mark.heavy
def test_a_sphere_of_triangles_is_rendered_as_the_sphere():
    light = sky(smooth)
    options = {"size": (41, 41), "samples": 256}
    facets = sphere_of_triangles(20.0)
    exact, found = (render([shape], [textured()], light, **options)[..., 30] for shape in (BALL, facets))
    apart = np.abs(found - exact)
    assert apart.mean() < 1e-3 * exact.mean()
    # At the outline a sub-pixel ray may miss the one and meet the other: a quarter of a pixel.
    assert np.percentile(apart, 99) < 1e-2 * exact.mean()
    assert apart.max() < 0.3 * exact.max()


def test_a_white_mesh_vanishes_in_a_white_furnace():
    picture = render([sphere_of_triangles(20.0)], [material(1.0)], constant_light(), samples=256)
    # Rays between the plane of a facet and that of its shading normal run into the mesh: some 1e-3 of them.
    assert np.abs(picture - 1).mean() <= 1e-3 and picture.max() <= 1 + 1e-3 and picture.min() > 0.9


def test_a_mesh_casts_its_shadow_on_a_plate_as_the_sphere_does():
    shapes = [[plate(400.0), shape] for shape in (BALL, sphere_of_triangles(20.0))]
    places = [(0, 0, 0), (0, 0, 20.0)]
    view = {"position": (0.0, -300.0, 150.0), "target": (0.0, 0.0, 10.0), "fov": 20.0, "size": (40, 30)}
    exact, found = (
        render(pair, [material(0.8), material(0.3)], constant_light(), places=places, samples=256, **view)
        for pair in shapes
    )
    assert np.abs(found - exact).mean() < 2e-3 and exact.min() < 0.35


@pytest.mark.parametrize("observed", ["all", "gaps"])
def test_nothing_bleeds_into_a_chart_from_beside_it(observed):
    # A square whose chart is a quarter of the texture; what lies beside it was never measured, or is nonsense.
    place = np.array([[-40, -40, 0], [40, -40, 0], [40, 40, 0], [-40, 40, 0]], dtype=float)
    chart = np.array([[0.25, 0.75], [0.75, 0.75], [0.75, 0.25], [0.25, 0.25]])
    faces = [[0, 1, 2], [0, 2, 3]]
    shape = TriangleMesh(make_mesh(place[faces], chart[faces]))
    values = np.full((32, 32), np.nan if observed == "all" else 77.0)
    values[8:24, 8:24] = 0.4
    if observed == "gaps":
        values[12:14, 9:13] = np.nan
    uniform = material(1.0)
    own = dataclasses.replace(
        uniform, alpha=values, green_response=np.ones_like(values), beta=np.zeros_like(values),
        mu=np.full_like(values, 0.1), coefficients=np.ones((32, 32, 1), np.float32),
    )  # fmt: skip
    whole, share = own.filled(shape.is_covered(32, 32))
    assert np.allclose(whole.alpha, 0.4) and share == pytest.approx(0.0 if observed == "all" else 8 / 256)
    picture = render([shape], [own], constant_light(), position=(0, -0.001, 400), fov=11.4, size=(40, 40))
    assert np.abs(picture[:, :, 30] - 0.4)[2:-2, 2:-2].max() < 1e-3


def test_a_mesh_reads_its_texture_as_its_file_says():
    place = np.array([[-50, -50, 0], [50, -50, 0], [50, 50, 0], [-50, 50, 0]], dtype=float)
    chart = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], dtype=float)  # v from the top, as on a plate
    faces = [[0, 1, 2], [0, 2, 3]]
    shape = TriangleMesh(make_mesh(place[faces], chart[faces]))
    view = {"position": (0, -0.001, 500), "fov": 11, "size": (40, 40)}
    flat, found = (render([s], [textured(32, 32)], constant_light(), **view) for s in (plate(100.0), shape))
    assert np.abs(found - flat).max() < 1e-5


def test_the_back_of_a_mesh_is_black_and_hides_what_is_behind_it():
    place = np.array([[-50, -50, 0], [50, -50, 0], [50, 50, 0], [-50, 50, 0]], dtype=float)
    faces = [[0, 2, 1], [0, 3, 2]]  # face down
    shape = TriangleMesh(make_mesh(place[faces], np.array([[0, 1], [1, 1], [1, 0], [0, 0.0]])[faces]))
    picture = render([shape], [material(1.0)], constant_light(), position=(0, -0.001, 500), fov=11, size=(20, 20))
    assert picture[5:-5, 5:-5].max() == 0.0


def test_an_untraced_ray_of_a_mesh_scene_meets_nothing():
    tracer = Tracer([Placement(vase())])
    assert tracer.intersect(np.array([[0, 0, 500.0]]), np.array([[0, 0, 1.0]]))[1][0] == NO_HIT


def test_poses_are_planned_for_the_points_of_a_mesh_as_for_those_of_the_sphere(facets):
    from irodori.capture.shot_planner.planner import subject_of

    rig = {"camera_distance_mm": 900.0, "table_radius_mm": 40.0}
    exact, found = (
        subject_of(made(Object | PlannedObject, {"shape": definition["shape"]}), made(Rig, rig))
        for definition in (EXACT, facets)
    )
    assert np.abs(np.linalg.norm(found.position, axis=1) - 25.0).max() < 0.05
    poses = [Pose(45.0, 20.0), Pose(80.0, 30.0, 10.0, 90.0)]
    seen = [
        np.mean((s.geometry(poses)[..., :2] < np.radians(80)).all(axis=-1) & s.unobstructed(poses))
        for s in (exact, found)
    ]
    assert seen[0] == pytest.approx(seen[1], abs=0.08)  # of 64 points each
