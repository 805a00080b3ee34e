"""Rays met by the shapes' formulas, beside Embree's answer for the same rays."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from quadrangles import box
from scenes import material
from studio import even_light, prepared, view_of

from irodori.geometry.embree import NO_HIT, Tracer
from irodori.geometry.rig_frame import rotation_xyz
from irodori.geometry.shape_registry import number_of
from irodori.geometry.shapes.disc import Disc
from irodori.geometry.shapes.placement import Placement, reaches
from irodori.geometry.shapes.plane import Plane
from irodori.geometry.shapes.plate import Plate
from irodori.geometry.shapes.shape_rows import shape_row
from irodori.geometry.shapes.sphere import Sphere
from irodori.jit.compilation import njit
from irodori.jit.vector_memory import load, mask_bits, store
from irodori.rendering.interactive import prepared_scene
from irodori.rendering.interactive.frame_renderer import CollimatedLamp, render_frame
from irodori.rendering.interactive.packets import nearest_shapes

#: Rays of a case.
RAYS = 4096
#: Single precision, some eight steps.
ROUNDING = 1e-6


class Shapes(NamedTuple):
    shape: np.ndarray
    bounded: int


@njit(cache=True)
def _met(world, rays, distance, shape):
    left = 0
    for base in range(0, distance.size, 16):
        origin = load(rays, base, 16), load(rays, distance.size + base, 16), load(rays, 2 * distance.size + base, 16)
        at = 3 * distance.size + base
        direction = load(rays, at, 16), load(rays, at + distance.size, 16), load(rays, at + 2 * distance.size, 16)
        far, met, doubtful = nearest_shapes(world, origin, direction)
        store(distance, base, far)
        store(shape, base, met)
        left += mask_bits(doubtful)
    return left


def by_formula(placements, origins, directions):
    """Distances and shapes; no ray is left to Embree."""
    rows = [shape_row(p, r, number_of(p.shape)) for p, r in zip(placements, reaches(placements), strict=True)]
    rays = np.concatenate([origins.T, directions.T]).astype(np.float32).ravel()
    distance, shape = np.empty(len(origins), np.float32), np.empty(len(origins), np.int32)
    assert _met(Shapes(np.concatenate(rows), len(rows)), rays, distance, shape) == 0
    return distance.astype(np.float64), shape


def unit(vectors):
    return (vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)).astype(np.float32).astype(np.float64)


def cosines(placements, shape, points, directions):
    """|cosine| between rays and the surfaces that they meet."""
    found = np.ones(len(points))
    for number, placement in enumerate(placements):
        chosen = shape == number
        normal = placement.rotation[:, 2]
        if isinstance(placement.shape, Sphere):
            normal = (points[chosen] - placement.translation_mm) / (placement.shape.radius_mm * placement.scale)
        found[chosen] = np.abs(np.sum(directions[chosen] * normal, axis=-1))
    return found


def compare(placements, origins, directions):
    """Assert that formulas and Embree say the same of rays; return how many meet anything, and how many differ."""
    origins, directions = np.float64(np.float32(origins)), unit(directions)
    distance, shape = by_formula(placements, origins, directions)
    tracer = Tracer(placements)
    truth, traced = tracer.intersect(origins, directions)  # in double precision on the shapes' equations
    size = np.abs(origins).max(axis=1) + reaches(placements)[shape.clip(0)]
    same = shape == traced
    # Where they differ, Embree says the formulas' answer of a ray beside, within rounding: outlines, edges, touching.
    explained = same.copy()
    for axis in range(3):
        for step in (-4.0, 4.0):
            beside = origins + step * ROUNDING * size[:, None] * np.eye(3)[axis]
            explained |= tracer.intersect(beside, directions)[1] == shape
    assert explained.all(), (origins[~explained][:3], directions[~explained][:3], shape[~explained], traced[~explained])
    met = same & (shape != NO_HIT)
    distance, truth, size = distance[met], truth[met], size[met]
    slope = cosines(placements, shape[met], origins[met] + truth[:, None] * directions[met], directions[met])
    # The height of the hit over the surface; along the ray it counts over the cosine.
    assert (np.abs(distance - truth) * slope <= 2 * ROUNDING * (truth + size)).all()
    steep = (slope > 0.3) & (truth > 0.1 * size)
    assert np.allclose(distance[steep], truth[steep], rtol=5 * ROUNDING, atol=0.0)
    return int(met.sum()), int((~same).sum())


def scattered(seed, count=8, spread=100.0):
    """Balls, discs and plates about the origin, sizes over two decades, some of them in one another."""
    rng, placements = np.random.default_rng(seed), []
    for number in range(count):
        size = 10.0 ** rng.uniform(-0.5, 1.5)
        shape = (Sphere(size), Disc(size), Plate(2.0 * size, 0.7 * size))[number % 3]
        turn = rotation_xyz(rng.uniform(-180.0, 180.0, 3))
        placements.append(Placement(shape, turn, rng.normal(size=3) * spread / 3, 10.0 ** rng.uniform(-0.3, 0.3)))
    return placements, rng


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), away=st.sampled_from([0.0, 100.0, 1e3]))
def test_formulas_say_what_embree_says(seed, away):
    placements, rng = scattered(seed)
    origins = unit(rng.normal(size=(RAYS, 3))) * away + rng.normal(size=(RAYS, 3)) * 20.0
    aim = rng.integers(len(placements), size=RAYS)
    centres = np.array([placement.translation_mm for placement in placements])[aim]
    towards = centres + rng.normal(size=(RAYS, 3)) * 0.8 * reaches(placements)[aim, None] - origins
    met, different = compare(placements, origins, towards)
    assert met > RAYS // 20 and different < RAYS // 200


@pytest.mark.parametrize("height", [1e-3, 1.0, 1e4])
def test_an_endless_plane_is_met_from_both_sides(height):
    rng = np.random.default_rng(5)
    placements = [Placement(Plane(), rotation_xyz((3.0, -2.0, 0.0)), np.array([0.0, 0.0, 7.0])), *scattered(6, 4)[0]]
    origins = rng.normal(size=(RAYS, 3)) * [50.0, 50.0, 0.0] + [0.0, 0.0, 7.0]
    origins[:, 2] += np.where(np.arange(RAYS) % 2, height, -height)
    directions = rng.normal(size=(RAYS, 3))
    met, different = compare(placements, origins, directions)
    assert met > RAYS // 3 and different < RAYS // 100


@pytest.mark.parametrize("distance", [1e2, 1e4, 1e5])
def test_a_small_ball_far_away_keeps_its_outline(distance):
    """The usual discriminant is lost in single precision where a ball of 1 mm is 100 m away."""
    rng = np.random.default_rng(7)
    origins = np.tile([0.0, -distance, 0.0], (RAYS, 1))
    off = rng.uniform(-1.5, 1.5, (RAYS, 2))
    towards = np.stack([off[:, 0], np.full(RAYS, distance), off[:, 1]], axis=1)
    found, shape = by_formula([Placement(Sphere(1.0))], np.float32(origins), unit(towards))
    beside = np.hypot(*off.T)
    # A direction in single precision ends 1e-7 of the distance beside its aim.
    slack = 3e-7 * distance
    assert (shape[beside < 1.0 - slack] == 0).all() and (shape[beside > 1.0 + slack] == NO_HIT).all()
    inner = beside < 0.9 - slack
    assert np.allclose(found[inner], distance, rtol=0.0, atol=1.0 + 1e-6 * distance)


@pytest.mark.parametrize("shape", [Disc(5.0), Plate(10.0, 10.0), Plane()], ids=lambda shape: shape.name)
def test_a_ray_in_the_plane_of_a_flat_shape_meets_nothing_that_is_no_number(shape):
    directions = np.tile([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], (8, 1))
    distance, met = by_formula([Placement(shape)], np.zeros((16, 3)), directions)
    assert not np.isnan(distance).any() and (np.isfinite(distance) == (met == 0)).all()


def test_a_ray_leaves_the_surface_that_it_starts_on():
    """Starts are raised over the surface as those of reflections are."""
    placements, rng = scattered(9, 6, spread=300.0)
    for number, placement in enumerate(placements):
        if isinstance(placement.shape, Sphere):
            normals = unit(rng.normal(size=(RAYS, 3)))
            points = placement.translation_mm + normals * placement.shape.radius_mm * placement.scale
        else:
            normals = np.tile(placement.rotation[:, 2], (RAYS, 1))
            points = placement.points(rng.uniform(-0.3, 0.3, (RAYS, 3)) * [1.0, 1.0, 0.0])
        out = rng.normal(size=(RAYS, 3))
        out *= np.sign(np.sum(out * normals, axis=1, keepdims=True))
        starts = np.float32(points + normals * 2.0**-17 * np.abs(points).max(axis=1, keepdims=True))
        assert not (by_formula([placement], starts, unit(out))[1] == 0).any(), number


@pytest.mark.parametrize("lamps", [(), (CollimatedLamp(unit(np.array([0.4, -0.5, 0.8]))),)], ids=["light", "sun"])
def test_a_picture_is_that_of_embree_but_for_outlines(monkeypatch, lamps):
    shapes = [Sphere(20.0), Sphere(9.0), Plate(120.0, 120.0), Disc(15.0), box(10.0, True)]
    places = [(0.0, 0.0, 20.0), (30.0, -12.0, 9.0), (0.0, 0.0, 0.0), (-35.0, -5.0, 12.0), (5.0, -40.0, 14.0)]
    turns = [np.eye(3), np.eye(3), np.eye(3), rotation_xyz((60.0, 20.0, 0.0)), np.eye(3)]
    paints = [material(0.5, beta=0.3, mu=0.1), material(0.2, mirror=1.0), *[material(0.4)] * 3]
    view = view_of((0.0, -260.0, 120.0), (0.0, 0.0, 10.0), (192, 144), 30.0)
    seen = {}
    for most in (12, 0):
        monkeypatch.setattr(prepared_scene, "_MOST_BOUNDED", most)
        light = even_light()
        ready = prepared(
            shapes, paints, light, places=places, rotations=turns, **({"lamps": np.ones((1, 61))} if lamps else {})
        )
        assert ready.world.bounded == (len(shapes) if most else 0)
        seen[most] = render_frame(ready, view, lamps=lamps)
    off = np.abs(seen[12] - seen[0]).max(axis=-1) / seen[0].max()
    assert (off > 1e-4).mean() < 0.005
