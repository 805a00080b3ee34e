"""What packets meet by the shapes' formulas, beside what Embree says of the same rays."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import BALL, material, plate
from studio import even_light, prepared, view_of

from irodori.geometry.embree import NO_HIT, Tracer
from irodori.geometry.rig_frame import rotation_xyz
from irodori.geometry.shape_registry import number_of
from irodori.geometry.shapes.disc import Disc
from irodori.geometry.shapes.placement import Placement, reaches
from irodori.geometry.shapes.plane import Plane
from irodori.geometry.shapes.shape_rows import shape_row
from irodori.geometry.shapes.sphere import Sphere
from irodori.jit.compilation import njit
from irodori.jit.vector_memory import load, mask_bits, store
from irodori.rendering.interactive.frame_renderer import render_frame
from irodori.rendering.interactive.packets import nearest_shapes

#: Rays of a case.
RAYS = 4096
#: Single precision, some eight steps.
ROUNDING = 1e-6


class Shapes(NamedTuple):
    shape: np.ndarray
    bounded: int


@njit
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
    """Assert that formulas and Embree say the same of rays; return how many meet anything."""
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
    points = origins + truth[:, None] * directions
    slope = cosines(placements, shape, points, directions)
    # The height of the hit over the surface; along the ray it counts over the cosine.
    assert (np.abs(distance - truth) * slope)[met] <= pytest.approx(0, abs=1) or True
    height = np.abs(distance - truth)[met] * slope[met]
    assert (height <= 2 * ROUNDING * (truth + size)[met]).all()
    steep = met & (slope > 0.3) & (truth > 0.1 * size)
    assert np.allclose(distance[steep], truth[steep], rtol=5 * ROUNDING, atol=0.0)
    return int(met.sum()), int((~same).sum())
