"""Embree against closed forms: spheres and plates solved in double precision."""

import gc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from irodori.geometry.embree import NO_HIT, Tracer
from irodori.geometry.rig_frame import rotation_xyz
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.plate import Plate
from irodori.geometry.shapes.sphere import Sphere
from irodori.geometry.surfaces import make_surfaces

#: Embree traces in single precision: a silhouette is known to a few 6e-8 of the coordinates, 1e-5 with a wide margin.
SILHOUETTE = 1e-5
SEEDS = st.integers(0, 2**32 - 1)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def rotation(rng):
    return rotation_xyz(rng.uniform(-180, 180, 3))


def sphere(rng, spread=100.0):
    radius, scale = rng.uniform(5.0, 40.0), rng.uniform(0.5, 2.0)
    return Placement(Sphere(radius), rotation(rng), rng.uniform(-spread, spread, 3), scale)


def plate(rng, spread=100.0):
    size = tuple(rng.uniform(10.0, 80.0, 2))
    return Placement(Plate(*size), rotation(rng), rng.uniform(-spread, spread, 3), rng.uniform(0.5, 2.0))


def rays(rng, count, placements):
    """Return rays from afar, half of them aimed into the scene's shapes."""
    origins = 400.0 * unit(rng.normal(size=(count, 3)))
    centres = np.array([p.translation_mm for p in placements])
    targets = centres[rng.integers(0, len(centres), count)] + rng.normal(scale=30.0, size=(count, 3))
    return origins, unit(targets - origins)


def sphere_roots(placement, origins, directions):
    """Return both distances to a sphere (NaN for a miss) and how far inside (+) the silhouette the ray passes."""
    radius = placement.shape.size_mm[0] * placement.scale
    to_centre = placement.translation_mm - origins
    along = np.sum(to_centre * directions, axis=1)
    closest = np.linalg.norm(to_centre - along[:, None] * directions, axis=1)
    inside = radius - closest
    half_chord = np.sqrt(np.where(inside > 0, (radius - closest) * (radius + closest), np.nan))
    return along - half_chord, along + half_chord, inside


def plate_root(placement, origins, directions):
    """Return the distance to the plate's plane, and how far inside (+) the edge it is met."""
    normal = placement.rotation[:, 2]
    distance = ((placement.translation_mm - origins) @ normal) / (directions @ normal)
    point = origins + distance[:, None] * directions - placement.translation_mm
    half = 0.5 * placement.scale * np.array(placement.shape.size_mm)
    inside = np.min(half - np.abs(point @ placement.rotation[:, :2]), axis=1)
    # The edge is seen foreshortened: an error across the ray is longer on the plate.
    return distance, inside * np.abs(directions @ normal)


def closed_form(placements, origins, directions):
    """Return nearest distance and shape of each ray, and its least clearance from any silhouette."""
    best = np.full(len(origins), np.inf)
    shape = np.full(len(origins), NO_HIT)
    clearance = np.full(len(origins), np.inf)
    for identifier, placement in enumerate(placements):
        if isinstance(placement.shape, Sphere):
            near, far, inside = sphere_roots(placement, origins, directions)
            distance = np.where(near > 0, near, far)
            hit = (inside > 0) & (distance > 0)
        else:
            distance, inside = plate_root(placement, origins, directions)
            hit = (inside > 0) & (distance > 0)
        clearance = np.minimum(clearance, np.abs(inside))
        closer = hit & (distance < best)
        best[closer], shape[closer] = distance[closer], identifier
    return best, shape, clearance


def check_against_closed_form(placements, origins, directions, reach=500.0):
    distance, shape = Tracer(placements).intersect(origins, directions)
    expected, expected_shape, clearance = closed_form(placements, origins, directions)
    clear = clearance > SILHOUETTE * reach
    assert clear.mean() > 0.99
    differs = shape != expected_shape
    # Elsewhere, shapes may only change places where two surfaces cut each other within single precision.
    for ray in np.flatnonzero(differs & clear):
        assert shape[ray] != NO_HIT and expected_shape[ray] != NO_HIT
        assert distance[ray] == pytest.approx(expected[ray], rel=SILHOUETTE)
    same = clear & ~differs & (shape != NO_HIT)
    assert np.all(np.isinf(distance[shape == NO_HIT]))
    np.testing.assert_allclose(distance[same], expected[same], rtol=1e-9)
    return same.sum()


@given(seed=SEEDS)
@settings(deadline=None, max_examples=25)
def test_spheres_are_hit_where_the_quadratic_says(seed):
    rng = np.random.default_rng(seed)
    placements = [sphere(rng) for _ in range(6)]
    assert check_against_closed_form(placements, *rays(rng, 2000, placements)) > 10


@given(seed=SEEDS)
@settings(deadline=None, max_examples=25)
def test_plates_are_hit_where_their_plane_says(seed):
    rng = np.random.default_rng(seed)
    placements = [plate(rng) for _ in range(6)]
    assert check_against_closed_form(placements, *rays(rng, 2000, placements)) > 10


@given(seed=SEEDS)
@settings(deadline=None, max_examples=25)
def test_the_nearest_of_spheres_and_plates_is_found(seed):
    rng = np.random.default_rng(seed)
    placements = [sphere(rng), plate(rng), sphere(rng), plate(rng)]
    # Small shapes far apart are met by few rays; none at all would prove nothing.
    assert check_against_closed_form(placements, *rays(rng, 2000, placements)) > 10


@given(seed=SEEDS)
@settings(deadline=None, max_examples=20)
def test_a_ray_from_inside_a_sphere_leaves_at_its_far_side(seed):
    rng = np.random.default_rng(seed)
    ball = sphere(rng)
    radius = ball.shape.size_mm[0] * ball.scale
    origins = ball.translation_mm + 0.95 * radius * unit(rng.normal(size=(500, 3))) * rng.random((500, 1))
    directions = unit(rng.normal(size=(500, 3)))
    distance, shape = Tracer([ball]).intersect(origins, directions)
    _, far, _ = sphere_roots(ball, origins, directions)
    assert (shape == 0).all()
    np.testing.assert_allclose(distance, far, rtol=1e-9)
    on_surface = origins + distance[:, None] * directions - ball.translation_mm
    np.testing.assert_allclose(np.linalg.norm(on_surface, axis=1), radius, rtol=1e-9)


@given(seed=SEEDS)
@settings(deadline=None, max_examples=20)
def test_occluded_agrees_with_intersect(seed):
    rng = np.random.default_rng(seed)
    placements = [sphere(rng), plate(rng), sphere(rng), plate(rng)]
    origins, directions = rays(rng, 1000, placements)
    tracer = Tracer(placements)
    distance, shape = tracer.intersect(origins, directions)
    clear = closed_form(placements, origins, directions)[2] > SILHOUETTE * 500
    assert np.array_equal(tracer.occluded(origins, directions)[clear], (shape != NO_HIT)[clear])
    hit = clear & (shape != NO_HIT)
    assert tracer.occluded(origins[hit], directions[hit], far=distance[hit] * (1 + 1e-4)).all()
    assert not tracer.occluded(origins[hit], directions[hit], far=distance[hit] * (1 - 1e-4)).any()


def test_a_shadow_ray_ends_at_far_and_a_ray_starts_at_its_origin():
    ball = Placement(Sphere(10.0), translation_mm=np.array([0.0, 0.0, -50.0]))
    tracer = Tracer([ball])
    down = np.array([[0.0, 0.0, -1.0]])
    outside, inside, beyond = np.zeros((1, 3)), np.array([[0.0, 0.0, -50.0]]), np.array([[0.0, 0.0, -60.1]])
    assert tracer.intersect(outside, down)[0][0] == 40.0
    assert tracer.intersect(inside, down)[0][0] == 10.0
    assert tracer.intersect(beyond, down)[1][0] == NO_HIT
    assert not tracer.occluded(outside, down, far=39.9)[0]
    assert tracer.occluded(outside, down, far=40.1)[0]
    assert tracer.occluded(outside, down)[0]
    assert not tracer.occluded(inside, down, far=9.9)[0]
    assert tracer.occluded(inside, down, far=10.1)[0]  # the back is in the way too


def test_each_shadow_ray_has_its_own_end():
    tracer = Tracer([Placement(Plate(100.0, 100.0))])
    origins, directions = np.tile([1.0, 2.0, 30.0], (4, 1)), np.tile([0.0, 0.0, -1.0], (4, 1))
    assert tracer.occluded(origins, directions, far=np.array([29.9, 30.1, np.inf, 1.0])).tolist() == [
        False,
        True,
        True,
        False,
    ]


def test_nothing_behind_the_origin_is_hit():
    placements = [Placement(Sphere(10.0), translation_mm=np.array([0.0, 0.0, 50.0]))]
    tracer = Tracer(placements)
    ray = np.zeros((1, 3)), np.array([[0.0, 0.0, -1.0]])
    assert tracer.intersect(*ray)[1][0] == NO_HIT and not tracer.occluded(*ray)[0]


def test_a_plate_is_seen_from_both_faces():
    tracer = Tracer([Placement(Plate(20.0, 20.0))])
    origins, directions = np.array([[1.0, 2.0, 5.0], [1.0, 2.0, -5.0]]), np.array([[0, 0, -1.0], [0, 0, 1.0]])
    distance, shape = tracer.intersect(origins, directions)
    assert distance.tolist() == [5.0, 5.0] and shape.tolist() == [0, 0]


@pytest.mark.stability(stage="render", case="grazing hits")
def test_a_ray_along_a_plate_gives_no_nan():
    tracer = Tracer([Placement(Plate(20.0, 20.0))])
    distance, _ = tracer.intersect(np.array([[-50.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0]]))
    assert not np.isnan(distance).any()


def test_an_empty_scene_and_no_rays_are_no_special_cases():
    distance, shape = Tracer([]).intersect(np.zeros((3, 3)), np.tile([0.0, 0.0, 1.0], (3, 1)))
    assert np.isinf(distance).all() and (shape == NO_HIT).all()
    distance, shape = Tracer([Placement(Plate(1.0, 1.0))]).intersect(np.zeros((0, 3)), np.zeros((0, 3)))
    assert distance.shape == shape.shape == (0,)


@pytest.mark.stability(stage="render", case="hits on shared edges")
@given(seed=SEEDS)
@settings(deadline=None, max_examples=20)
def test_no_ray_leaks_through_the_edge_that_the_two_triangles_share(seed):
    rng = np.random.default_rng(seed)
    board = plate(rng)
    corners = board.corners()
    fraction = rng.uniform(0.01, 0.99, (4000, 1))
    starts, ends = corners[[0, 1]][:, None], corners[[2, 3]][:, None]  # both diagonals; one is the shared edge
    targets = (starts + fraction * (ends - starts)).reshape(-1, 3)
    side = board.rotation[:, 2] * rng.choice([-1.0, 1.0], (len(targets), 1))
    origins = targets + 300.0 * unit(rng.normal(size=targets.shape) * 0.5 + side)
    directions = unit(targets - origins)
    visible = np.abs(directions @ board.rotation[:, 2]) > 0.05
    tracer = Tracer([board])
    distance, shape = tracer.intersect(origins[visible], directions[visible])
    assert (shape == 0).all()
    assert tracer.occluded(origins[visible], directions[visible]).all()
    np.testing.assert_allclose(distance, np.linalg.norm(targets - origins, axis=1)[visible], rtol=1e-9)


def test_many_scenes_live_together_and_die_in_any_order():
    rng = np.random.default_rng(5)
    origin, direction = np.zeros((1, 3)), np.array([[0.0, 0.0, -1.0]])

    def scene(depth):
        return Tracer([Placement(Sphere(1.0), translation_mm=np.array([0.0, 0.0, -depth - 1.0]))])

    depths = np.arange(2.0, 202.0)
    alive = {depth: scene(depth) for depth in depths}
    for depth in rng.permutation(depths)[:150]:
        del alive[depth]
    gc.collect()
    alive.update({depth: scene(depth) for depth in depths[:20] + 500})
    for depth, tracer in alive.items():
        assert tracer.intersect(origin, direction)[0][0] == pytest.approx(depth, rel=1e-12)


def test_a_tracer_keeps_its_own_copy_of_the_shapes():
    translation = np.array([0.0, 0.0, -20.0])
    placements = [Placement(Sphere(1.0), translation_mm=translation)]
    tracer = Tracer(placements)
    del placements
    gc.collect()
    junk = [np.random.default_rng(i).random(4) for i in range(1000)]
    distance, _ = tracer.intersect(np.zeros((1, 3)), np.array([[0.0, 0.0, -1.0]]))
    assert distance[0] == 19.0 and len(junk) == 1000


def test_a_shape_that_nobody_registered_is_refused_by_its_name():
    class Torus(Sphere):
        name = "torus"

    with pytest.raises(ValueError, match=r"Torus.*plate, sphere"):
        make_surfaces([Placement(Torus(1.0))])


def test_threads_do_not_change_the_answer():
    import numba

    rng = np.random.default_rng(8)
    placements = [sphere(rng), plate(rng), sphere(rng)]
    origins, directions = rays(rng, 5000, placements)
    tracer = Tracer(placements)
    before = numba.get_num_threads()
    try:
        results = []
        for threads in (1, before):
            numba.set_num_threads(threads)
            results.append(tracer.intersect(origins, directions))
    finally:
        numba.set_num_threads(before)
    assert np.array_equal(results[0][0], results[1][0]) and np.array_equal(results[0][1], results[1][1])
