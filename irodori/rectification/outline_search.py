"""Outline of an object in a photograph: its expected points, and their distances from the edge in the picture.

As in contour tracking (C. Harris, *Tracking with rigid models*, in Active Vision, 1992), the picture is searched for an
edge along the normals of the expected outline, and only the distance along the normals is measured.
"""

from typing import NamedTuple

import numpy as np

from irodori.geometry.embree import Tracer
from irodori.geometry.pinhole import Pinhole
from irodori.rectification.reduced_pictures import DARK, GREEN, Level, Picture

_GRID = 160  # rays along the longer side of the object, between which the outline is searched
_ROUNDS = 16  # bisections between a ray that hits the object and one that does not
_SMOOTH = 1.5  # blur of the object's mask that gives the outward direction, in grid steps
_NEIGHBOURS = 12  # points through which the outline's direction is fitted
_ROUGH = 0.02  # largest distance of these points from a smooth curve, as a share of their spread
_MOST = 200  # points of an outline, at most
_STEP = 0.5  # samples between readings along a normal
_READINGS = 4  # iterations of an edge's place, each centred on the result of the one before
_INNER, OUTER = 2.5, 6.0  # range of distances from an edge, samples, over which the level of each side is averaged
_LEAST_LOG_STEP = 0.25
_LEAST_SIGMAS = 6.0
_UNKNOWN_NOISE = 0.01


class Rim(NamedTuple):
    """Points of an object's outline as seen by a camera, with their normals in the picture."""

    point: np.ndarray  # (n, 3) on the object, in its frame, mm
    outward: np.ndarray  # (n, 2) unit vectors in the picture, x then y


def find_rim(tracer: Tracer, pinhole: Pinhole, eye, axes, window) -> Rim:
    """Find points of the outline of an object as a camera sees it, by tracing rays.

    Parameters
    ----------
    tracer : Tracer
        Scene; the object is its shape 0.
    pinhole : Pinhole
    eye : (3,) float
        Centre of projection in the scene, mm.
    axes : (3, 3) float, scene_from_camera
    window : (4,) float
        Bounding box of the object in the picture: x0, y0, x1, y1, superpixels.
    """
    from scipy import ndimage

    x0, y0, x1, y1 = window
    step = max(1.0, max(x1 - x0, y1 - y0) / _GRID)
    x, y = (np.arange(low - 3 * step, high + 3.5 * step, step) for low, high in ((x0, x1), (y0, y1)))
    grid = np.stack(np.meshgrid(x, y), axis=-1)

    def met(xy):
        directions = pinhole.directions(2.0 * (xy + 0.5), axes)
        seen = np.isfinite(directions[:, 0])
        directions[~seen] = axes[:, 2]
        distance, shape = tracer.intersect(np.broadcast_to(eye, directions.shape), directions)
        return seen & (shape == 0), eye + np.where(shape == 0, distance, 0.0)[:, None] * directions

    inside = met(grid.reshape(-1, 2))[0].reshape(grid.shape[:2])
    soft = ndimage.gaussian_filter(inside.astype(np.float64), _SMOOTH, mode="nearest")
    slope = -np.stack(np.gradient(soft)[::-1], axis=-1)
    pairs = []
    for axis in (0, 1):
        one = np.argwhere(np.diff(inside.astype(np.int8), axis=axis) != 0)
        pairs.append(np.stack([one, one + np.eye(2, dtype=int)[axis]], axis=1))
    pair = np.concatenate(pairs)
    if len(pair) < _NEIGHBOURS:
        return Rim(np.zeros((0, 3)), np.zeros((0, 2)))
    away = slope[pair[..., 0], pair[..., 1]].mean(axis=1)
    first = inside[pair[:, 0, 0], pair[:, 0, 1]]
    ends = grid[pair[..., 0], pair[..., 1]]
    on = np.where(first[:, None], ends[:, 0], ends[:, 1])
    off = np.where(first[:, None], ends[:, 1], ends[:, 0])
    for _ in range(_ROUNDS):
        middle = 0.5 * (on + off)
        hit = met(middle)[0][:, None]
        on, off = np.where(hit, middle, on), np.where(hit, off, middle)
    direction, is_smooth = _normals(on, away)
    on, direction = on[is_smooth], direction[is_smooth]
    chosen = np.unique(np.linspace(0, len(on) - 1, min(len(on), _MOST)).round().astype(int))
    on, direction = on[chosen], direction[chosen]
    placed = tracer.placements[0]
    return Rim((met(on)[1] - placed.translation_mm) @ placed.rotation, direction)


def _normals(on: np.ndarray, away: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit normals of a curve at its points, (n, 2), and a mask of the points where it is smooth, (n,) bool.

    A parabola is fitted through the neighbours of each point. A straight line would be less accurate, and errors of the
    normals would appear as a rotation of a round object.

    Parameters
    ----------
    on : (n, 2) float
        Points on the curve, in any order.
    away : (n, 2) float
        Approximate outward directions.
    """
    from scipy.spatial import cKDTree

    about = on[cKDTree(on).query(on, k=_NEIGHBOURS)[1]] - on[:, None]
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", about, about))
    along, across = axes[..., 1], axes[..., 0]
    u, w = np.einsum("nki,ni->nk", about, along), np.einsum("nki,ni->nk", about, across)
    design = np.stack([np.ones_like(u), u, u * u], axis=-1)
    found = np.einsum("nij,nj->ni", np.linalg.pinv(design), w)
    normal = across - found[:, 1:2] * along
    normal = np.where(np.sum(normal * away, axis=1)[:, None] < 0.0, -normal, normal)
    left = np.abs(np.einsum("nki,ni->nk", design, found) - w).max(axis=1)
    return normal / np.linalg.norm(normal, axis=1, keepdims=True), left < _ROUGH * np.sqrt(spread[:, 1])


def edge_distances(
    picture: Picture, level: Level, xy, outward, reach: float, *, is_dark_outside: bool = False
) -> np.ndarray:
    """Return the distances of the edges in a photograph from the expected points of an outline, outward positive.

    The edge is the place within reach with the largest ratio of brightness between its sides; places near the expected
    point are preferred. Its exact position follows from the area under the brightness profile between the levels of
    both sides, where the inner side may have a constant slope. It therefore depends neither on the height of the step
    nor on the sharpness of the picture.

    Parameters
    ----------
    picture : Picture
    level : Level
        Blurred version of the picture in which edges are searched.
    xy : (n, 2) float
        Expected points, superpixels.
    outward : (n, 2) float
        Unit normals.
    reach : float
        Distance searched to either side, samples.
    is_dark_outside : bool
        Whether the object is lit before something dark, so that the edge between its lit and its dark side, which is
        brighter outside, is not searched.

    Returns
    -------
    (n,) float64, superpixels; NaN where no edge stands out of the noise
    """
    offset = np.arange(-reach - OUTER - 1.0, reach + OUTER + 1.0 + _STEP / 2, _STEP)
    place = picture.place(xy)[:, None] + offset[None, :, None] * outward[:, None]
    count, width, _ = place.shape
    profile = level.sampled(level.bands[[GREEN]], place.reshape(-1, 2)).reshape(count, width)
    near, far = round(_INNER / _STEP), round(OUTER / _STEP)
    candidates = np.arange(far, width - far)
    levels = np.lib.stride_tricks.sliding_window_view(profile, far - near + 1, axis=1).mean(axis=-1)
    inner, outer = levels[:, : len(candidates)], levels[:, -len(candidates) :]
    c0, c1 = np.where(np.isfinite(picture.noise), picture.noise, [_UNKNOWN_NOISE**2, 0.0])
    noise = np.sqrt(c0 + c1 * np.maximum(np.maximum(inner, outer), 0.0))
    ratio = np.log((np.maximum(inner, 0.0) + DARK) / (np.maximum(outer, 0.0) + DARK))
    ratio = ratio if is_dark_outside else np.abs(ratio)
    clear = (ratio > _LEAST_LOG_STEP) & (np.abs(inner - outer) > _LEAST_SIGMAS * noise)
    score = np.where(clear, ratio * (1.0 - 0.5 * (offset[candidates] / (reach + 1.0)) ** 2), -1.0)
    best = np.argmax(score, axis=1)
    centre = candidates[best]
    # The largest ratio lies on the dark side of an edge, and the edge's blur there would tilt the fitted inner line:
    # the reading is centred again on the edge that it finds.
    for _ in range(_READINGS):
        area = _edge_beside(profile, centre)
        found = offset[centre] + area
        centre = np.clip(np.rint((np.nan_to_num(found) - offset[0]) / _STEP), far, width - far - 1).astype(int)
    strayed = np.abs(found - offset[candidates[best]]) > _INNER + _STEP  # to another edge
    lost = (score[np.arange(count), best] < 0.0) | ~np.isfinite(found) | strayed | (np.abs(found) > reach)
    return np.where(lost, np.nan, found / picture.scale)


def _edge_beside(profile: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return the distances of edges from given readings of their profiles, outward positive, (n,) picture samples.

    Parameters
    ----------
    profile : (n, width) float
        Readings along the normals, `_STEP` samples apart.
    centre : (n,) int
        Index of a reading near the edge, at least `OUTER` samples from both ends of the profile.
    """
    far = round(OUTER / _STEP)
    along = np.arange(-far, far + 1) * _STEP
    around = np.take_along_axis(profile, centre[:, None] + np.arange(-far, far + 1), axis=1)
    inside = along <= -_INNER
    # The inner side has a slope, because a round object darkens or brightens towards its outline.
    middle = along[inside].mean()
    lean = (around[:, inside] @ (along[inside] - middle)) / np.sum((along[inside] - middle) ** 2)
    inner_line = around[:, inside].mean(axis=1)[:, None] + lean[:, None] * (along - middle)
    outer_level = around[:, along >= _INNER].mean(axis=1)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (around - outer_level) / (inner_line - outer_level)
        # Trapezoidal area over the readings around the edge, less the area of a step exactly at the centre.
        within = (along >= -_INNER - _STEP) & (along <= _INNER + _STEP)
        weights = np.full(within.sum(), _STEP)
        weights[[0, -1]] *= 0.5
        return share[:, within] @ weights - (_INNER + _STEP)
