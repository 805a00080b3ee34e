"""Brightness of an object just inside its outline: its light, and its paints as other photographs show them.

A photograph shows the surface beside an outline at grazing angles, so that the border of two paints which lies some
degrees behind the outline is a fraction of a sample inside it, within the blur of the edge. Other photographs show the
same place from the front.
"""

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.config.capture_table import Pose
from irodori.geometry.embree import Tracer
from irodori.geometry.rig_frame import rig_from_camera, rig_from_object, to_camera
from irodori.rectification.outline_search import InnerSide, first_hit, held
from irodori.rectification.reduced_pictures import GREEN

if TYPE_CHECKING:
    from irodori.rectification.registration_problem import Problem

_NODES, _STEP = 13, 0.5  # depths at which the brightness is returned, and their distance in units of the blur
_FEW = 600  # points of the surface, about, by which the contrast of its paints is found
_JUST_INSIDE = 0.02  # units between the outline and the first ray
_RAYS = 31  # for each point; they lie the closer the nearer to the outline, where a round surface turns fastest
_LEAST_COSINE = 0.2  # of incidence and of view, below which another photograph does not tell the paint
_BLURRED = 2.0  # samples inside another photograph's own outline into which blur mixes the background


def _depths() -> tuple[np.ndarray, np.ndarray]:
    """Return depths of the rays, (rays,) units, and the weights of their averages around the nodes, (nodes, rays)."""
    deepest = _STEP * (_NODES - 1)
    depth = _JUST_INSIDE + (deepest - _JUST_INSIDE) * np.linspace(0.0, 1.0, _RAYS) ** 2
    fine = (np.arange(4000) + 0.5) / 4000 * deepest
    hats = np.maximum(1.0 - np.abs(fine / _STEP - np.arange(_NODES)[:, None]), 0.0)
    hats /= hats.sum(axis=1, keepdims=True)
    between = np.stack([np.interp(fine, depth, one) for one in np.eye(_RAYS)], axis=1)
    return depth, hats @ between


_DEPTH, _AROUND_NODES = _depths()


class InnerSurface(NamedTuple):
    """Points of the surface inside the n points of an outline.

    Parameters
    ----------
    step : float
        Samples from one depth to the next.
    point, normal : (n, rays, 3) float
        In the object's frame.
    light, facing : (n, rays) float
        Cosine of incidence times the irradiance normal to the beam, and cosine of the angle between normal and view.
    """

    step: float
    point: np.ndarray
    normal: np.ndarray
    light: np.ndarray
    facing: np.ndarray

    @property
    def evenly_painted(self) -> InnerSide:
        """The brightness of the surface if its paint is even."""
        light, facing = self.light @ _AROUND_NODES.T, self.facing @ _AROUND_NODES.T
        return InnerSide(self.step, light, facing, np.ones(light.shape), np.zeros(light.shape))


def inner_surface(problem: "Problem", number: int, tracer: Tracer, xy: np.ndarray) -> InnerSurface:
    """Return the surface just inside points of an outline in a photograph.

    Parameters
    ----------
    problem : Problem
    number : int
        Index of the photograph.
    tracer : Tracer
        Scene with the object as its shape 0.
    xy : (n, 2) float
        The points, superpixels.
    """
    view, placed = problem.views[number], tracer.placements[0]
    unit = max(1.0, view.search.sigma)
    correction, pose = problem.standing(number, problem.unknowns)
    camera = problem.setup.corrected(correction)
    eye = camera.camera_distance_mm * to_camera(pose)
    axes = rig_from_camera(pose, camera.pinhole.quarter_turns)
    inside = xy[:, None] - (unit * _DEPTH / view.picture.scale)[:, None] * view.outward[:, None]
    world, is_on = first_hit(tracer, camera.pinhole, eye, axes, inside.reshape(-1, 2))
    skin, normals, _ = problem.skin
    point = (world - placed.translation_mm) @ placed.rotation
    nearest = skin.query(point)[1]
    normal = normals[nearest] + np.einsum("nij,nj->ni", problem.bends[nearest], point - skin.data[nearest])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    turned, to_eye = normal @ placed.rotation.T, eye - world
    light, power, _ = problem.setup.lamp.seen_from(world, pose)
    incidence = np.maximum(np.sum(turned * light, axis=1), 0.0) * power
    facing = np.sum(turned * to_eye, axis=1) / np.linalg.norm(to_eye, axis=1)
    values = (held(np.where(is_on, one, np.nan).reshape(-1, _RAYS)) for one in (incidence, facing))
    return InnerSurface(_STEP * unit, point.reshape(-1, _RAYS, 3), normal.reshape(-1, _RAYS, 3), *values)


def paint_contrast(problem: "Problem") -> float:
    """Return the standard deviation of an object's paint relative to its mean, by what all photographs show of it."""
    points = slice(None, None, 1 + len(problem.skin[1]) // _FEW)
    paint = _paint(problem, problem.skin[0].data[points], problem.skin[1][points], range(len(problem.views)))
    known = paint[np.isfinite(paint)]
    return float(known.std() / known.mean()) if known.size else 0.0


def painted(problem: "Problem", number: int, contrast: float) -> InnerSide:
    """Return the brightness of a surface inside its outline, with its paint as all other photographs show it.

    Where no other photograph shows the place lit and from the front, the paint is taken for that beside it, and is as
    unsure as the paints of the object differ.

    Parameters
    ----------
    problem : Problem
    number : int
        Index of the photograph.
    contrast : float
        Result of `paint_contrast`.
    """
    surface = problem.views[number].surface
    assert surface is not None  # the object is not flat
    others = [other for other in range(len(problem.views)) if other != number]
    paint = _paint(problem, surface.point.reshape(-1, 3), surface.normal.reshape(-1, 3), others)
    paint = paint.reshape(surface.light.shape)
    unsure = (contrast * np.isnan(paint)) @ _AROUND_NODES.T
    # Gaps at the outline get the value inside them, and those at the inner end the value before them.
    paint = held(held(paint[:, ::-1], np.nan)[:, ::-1], 1.0) @ _AROUND_NODES.T
    return surface.evenly_painted._replace(paint=paint / paint.mean(axis=1, keepdims=True), unsure=unsure)


def _paint(problem: "Problem", point: np.ndarray, normal: np.ndarray, numbers: Iterable[int]) -> np.ndarray:
    """Return responses relative to those of a matt white surface, (n,), at points of an object with their normals.

    Means over photographs of the given numbers; NaN where none of them shows the point lit and from the front.
    """
    correction, _ = problem.standing(0, problem.unknowns)
    # In the table's frame, the object and the table are the same in all photographs.
    placements = correction.placements(problem.shape, Pose(0.0, 0.0), problem.setup.table_radius_mm)
    tracer, placed = Tracer(placements), placements[0]
    place, normal = placed.points(point), normal @ placed.rotation.T
    sights = [_seen_in(problem, number, place, normal) for number in numbers]
    if not sights:
        return np.full(len(point), np.nan)
    seen = _Sights(*(np.concatenate(parts) for parts in zip(*sights, strict=True)))
    start = place[seen.point] + problem.shape.ray_offset_mm * normal[seen.point]
    is_hidden = tracer.occluded(start, seen.to_eye) | tracer.occluded(start, seen.to_light, far=seen.lamp_mm)
    weight = np.where(is_hidden, 0.0, seen.weight)
    total, summed = (np.bincount(seen.point, one, len(place)) for one in (weight, weight * seen.paint))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(summed > 0.0, summed / total, np.nan)


class _Sights(NamedTuple):
    """Points that a photograph shows lit and from the front, unless something is before them, in the table's frame."""

    point: np.ndarray  # (n,) index
    to_eye: np.ndarray  # (n, 3) unit vectors
    to_light: np.ndarray
    lamp_mm: np.ndarray  # (n,)
    paint: np.ndarray  # (n,) response relative to that of a matt white surface
    weight: np.ndarray  # (n,)


def _seen_in(problem: "Problem", number: int, place: np.ndarray, normal: np.ndarray) -> _Sights:
    """Return which of the points, (n, 3) in the table's frame with their normals, a photograph shows, and their paint.

    A point counts by how steeply it is seen and lit; near the mirror direction, gloss hides the paint.
    """
    view = problem.views[number]
    correction, pose = problem.standing(number, problem.unknowns)
    camera, turn = problem.setup.corrected(correction), rig_from_object(pose)
    eye = camera.camera_distance_mm * to_camera(pose)
    to_eye = eye @ turn - place
    to_eye /= np.linalg.norm(to_eye, axis=1)[:, None]
    facing = np.sum(normal * to_eye, axis=1)
    # A round surface that is so deep inside the outline is seen under this cosine.
    least = max(_LEAST_COSINE, math.sqrt(2.0 * _BLURRED * problem.bend_per_mm * problem.mm_per_px / view.picture.scale))
    point = np.flatnonzero(facing > least)
    world = place[point] @ turn.T
    light, power, lamp_mm = camera.lamp.seen_from(world, pose)
    to_light = light @ turn
    incidence = np.sum(normal[point] * to_light, axis=1)
    xy = camera.pinhole.project(world, eye, rig_from_camera(pose, camera.pinhole.quarter_turns))
    seen = view.search.sampled(view.search.bands[[GREEN]], view.picture.place(xy))[:, 0]
    used = (incidence > _LEAST_COSINE) & np.isfinite(seen)
    point, to_light, incidence = point[used], to_light[used], incidence[used]
    half = to_eye[point] + to_light
    half /= np.linalg.norm(half, axis=1)[:, None]
    weight = (1.0 - np.sum(half * normal[point], axis=1) ** 2) ** 2
    weight *= ((incidence - _LEAST_COSINE) * (facing[point] - least)) ** 2
    return _Sights(point, to_eye[point], to_light, lamp_mm[used], seen[used] / (incidence * power[used]), weight)
