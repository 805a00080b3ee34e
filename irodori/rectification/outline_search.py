"""Outline of an object in a photograph: its expected points, and their distances from the edge in the picture.

As in contour tracking (C. Harris, *Tracking with rigid models*, in Active Vision, 1992), the picture is searched for an
edge along the normals of the expected outline, and only the distance along the normals is measured.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.geometry.embree import Tracer
from irodori.geometry.pinhole import Pinhole
from irodori.rectification.reduced_pictures import DARK, GREEN, Level, Picture

_GRID = 160  # rays along the longer side of the object, between which the outline is searched
_LEAST_GRID = 40  # rays of an object that is smaller in the picture than so many superpixels
_ROUNDS = 16  # bisections between a ray that hits the object and one that does not
_SMOOTH = 1.5  # blur of the object's mask that gives the outward direction, in grid steps
_NEIGHBOURS = 12  # points through which the outline's direction is fitted
_ROUGH = 0.02  # largest distance of these points from a smooth curve, as a share of their spread
_MOST = 200  # points of an outline, at most
_STEP = 0.5  # between readings along a normal, in samples of a sharp picture
#: Standard deviation, samples, of the blur of a reading: by the area of a sample, the two green pixels of a superpixel,
#: and bilinear interpolation.
_READ = math.sqrt(1 / 12 + 1 / 16 + 1 / 6)
_READINGS = 12  # iterations of an edge's place, each centred on the result of the one before
#: Change of a place that is settled, share of the places that have to be, and largest change of one that is used.
_SETTLED, _MOST_SETTLED, _STILL = 0.005, 0.9, 0.05
_PARTS = 0.3, 2.0  # range of the parts of a change that are taken
#: Range of distances from an edge over which the level of each side is averaged, in samples of a sharp picture.
_INNER, OUTER = 1.5, 3.5
_DEEP, _DEEPEST = 2.5, 6.0  # range of depths over which the shading of a photograph is compared with a matt surface's
_EVEN_DEEP = 4.0  # least depth at which the slope of a flat object's texture is read, where no blur of the edge reaches
#: Readings around an edge: the first and the last, their places, outward positive, and masks of those in the ranges.
_FIRST, _LAST = round(-_DEEPEST / _STEP), round(OUTER / _STEP)
_ALONG = np.arange(_FIRST, _LAST + 1) * _STEP
_SURFACE = 0.5 - 0.5 * np.sign(_ALONG)  # share of the inner side in a sharp reading
_INSIDE, _OUTSIDE = (_ALONG >= -OUTER) & (_ALONG <= -_INNER), _ALONG >= _INNER
_AREA = _STEP * np.array([0.5, *np.ones(round(2.0 * _INNER / _STEP) + 1), 0.5])  # under readings to either side
_WITHIN, _DEEPER, _PLAIN = np.abs(_ALONG) <= _INNER + _STEP, _ALONG <= -_DEEP, _ALONG <= -_EVEN_DEEP
_LEAST_TURN = 1e-6  # sum of squared changes of a cosine below which a surface is flat
_BESIDE = 15  # neighbouring points of an outline over which its shading is averaged
_BLURRED = 2  # readings to either side over which the border of two paints is spread
#: Errors of the places of edges by gloss and by paints, as shares of what these change in the places.
_GLOSS_DOUBT, _PAINT_DOUBT = 0.7, 0.2
_UNSURE_DOUBT = 0.3  # root of the chance that a paint that is not known differs from that beside it
_LEAST_BORDER = 0.02  # relative change of the paint's brightness over them that is a border
#: Largest rms deviation of a side from its form, as a share of the step, or of the median of the photograph's edges.
_ROUGH_SIDE, _ROUGHER = 0.05, 1.5
_LEAST_HEIGHT = 0.3  # of the step just inside the outline, as a share of that between both sides
_LEAST_LOG_STEP = 0.25
_LEAST_SIGMAS = 6.0
_UNKNOWN_NOISE = 0.01


class Rim(NamedTuple):
    """Points of an object's outline as seen by a camera, with their normals in the picture."""

    point: np.ndarray  # (n, 3) on the object, in its frame, mm
    outward: np.ndarray  # (n, 2) unit vectors in the picture, x then y


class InnerSide(NamedTuple):
    """Known parts of the brightness of a surface inside n points of its outline, at m depths.

    Parameters
    ----------
    step : float
        Samples from one depth to the next; the first is 0.
    light : (n, m) float
        Irradiance.
    facing : (n, m) float
        Cosine of the angle between normal and view.
    paint : (n, m) float
        Brightness of the paint, 1 in the mean.
    unsure : (n, m) float
        Standard deviation of the paint relative to it, where it is not known.
    """

    step: float
    light: np.ndarray
    facing: np.ndarray
    paint: np.ndarray
    unsure: np.ndarray


def first_hit(tracer: Tracer, pinhole: Pinhole, eye, axes, xy) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of the scene seen in places of the picture, (n, 3) mm, and whether they are on shape 0.

    Parameters
    ----------
    tracer, pinhole, eye, axes
        As in `find_rim`.
    xy : (n, 2) float
        Superpixels.
    """
    directions = pinhole.directions(2.0 * (xy + 0.5), axes)
    seen = np.isfinite(directions[:, 0])
    directions[~seen] = axes[:, 2]
    distance, shape = tracer.intersect(np.broadcast_to(eye, directions.shape), directions)
    return eye + np.where(shape == 0, distance, 0.0)[:, None] * directions, seen & (shape == 0)


def held(values: np.ndarray, first: float = 1.0) -> np.ndarray:
    """Return rows of values, (n, m), whose NaN are replaced by the value before; ``first`` if there is none."""
    out = values.copy()
    out[:, 0] = np.where(np.isnan(out[:, 0]), first, out[:, 0])
    for number in range(1, out.shape[1]):
        out[:, number] = np.where(np.isnan(out[:, number]), out[:, number - 1], out[:, number])
    return out


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
    extent = max(x1 - x0, y1 - y0, 1e-3)
    step = max(min(1.0, extent / _LEAST_GRID), extent / _GRID)
    x, y = (np.arange(low - 3 * step, high + 3.5 * step, step) for low, high in ((x0, x1), (y0, y1)))
    grid = np.stack(np.meshgrid(x, y), axis=-1)

    def met(xy):
        return first_hit(tracer, pinhole, eye, axes, xy)

    inside = met(grid.reshape(-1, 2))[1].reshape(grid.shape[:2])
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
        hit = met(middle)[1][:, None]
        on, off = np.where(hit, middle, on), np.where(hit, off, middle)
    direction, is_smooth = _normals(on, away)
    on, direction = on[is_smooth], direction[is_smooth]
    chosen = np.unique(np.linspace(0, len(on) - 1, min(len(on), _MOST)).round().astype(int))
    on, direction = on[chosen], direction[chosen]
    placed = tracer.placements[0]
    return Rim((met(on)[0] - placed.translation_mm) @ placed.rotation, direction)


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


class Edges(NamedTuple):
    """Edges in a photograph near the expected points of an outline.

    Parameters
    ----------
    distance : (n,) float64
        Distances from the expected points, outward positive, superpixels; NaN where no edge stands out of the noise.
    doubt : (n,) float64
        Standard deviations of the errors that neighbouring points have in common, because the brightness inside the
        outline is not quite as expected, superpixels.
    """

    distance: np.ndarray
    doubt: np.ndarray


def find_edges(
    picture: Picture, level: Level, xy, outward, reach: float, *, inner=None, is_dark_outside: bool = False
) -> Edges:
    """Find the edges in a photograph near the expected points of an outline.

    The edge is the place within reach with the largest ratio of brightness between its sides; places near the expected
    point are preferred. Its exact position follows from the area under the brightness profile above the level of the
    outer side, compared with the expected one, whose height is free: it depends neither on the height of the step nor
    on the sharpness of the picture, nor on how steeply a round object darkens towards its outline. An edge is not read
    if one of its sides has another form than expected and most edges of the photograph do not.

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
    inner : InnerSide, optional
        What is known of the brightness inside the outline. If absent, the surface is flat and evenly lit, and what
        changes evenly towards its outline is its texture.
    is_dark_outside : bool
        Whether the object is lit before something dark, so that the edge between its lit and its dark side, which is
        brighter outside, is not searched.
    """
    unit = max(1.0, level.sigma)
    step = _STEP * unit
    most = math.ceil((reach / unit + _DEEPEST + 1.0) / _STEP)
    offset = np.arange(-most, most + 1) * step
    place = picture.place(xy)[:, None] + offset[None, :, None] * outward[:, None]
    count, width, _ = place.shape
    profile = level.sampled(level.bands[[GREEN]], place.reshape(-1, 2)).reshape(count, width)
    near, far = round(_INNER / _STEP), round(OUTER / _STEP)
    candidates = np.arange(far, width - far)
    levels = np.lib.stride_tricks.sliding_window_view(profile, far - near + 1, axis=1).mean(axis=-1)
    inside, outside = levels[:, : len(candidates)], levels[:, -len(candidates) :]
    c0, c1 = np.where(np.isfinite(picture.noise), picture.noise, [_UNKNOWN_NOISE**2, 0.0])
    noise = np.sqrt(c0 + c1 * np.maximum(np.maximum(inside, outside), 0.0))
    ratio = np.log((np.maximum(inside, 0.0) + DARK) / (np.maximum(outside, 0.0) + DARK))
    ratio = ratio if is_dark_outside else np.abs(ratio)
    clear = (ratio > _LEAST_LOG_STEP) & (np.abs(inside - outside) > _LEAST_SIGMAS * noise)
    score = np.where(clear, ratio * (1.0 - 0.5 * (offset[candidates] / (reach + 1.0)) ** 2), -1.0)
    best = np.argmax(score, axis=1)
    is_clear, first = score[np.arange(count), best] > 0.0, offset[candidates[best]]
    noise, at = noise[np.arange(count), best], first
    expected = None if inner is None else _Expected(inner, xy, unit, math.hypot(_READ, level.sigma) / unit)
    # The largest ratio lies on the dark side of an edge, and the edge's blur there would change the level of the inner
    # side: the reading is centred again on the edge that it finds.
    move, part, farthest = np.zeros(count), np.ones(count), (_INNER + 2.0 * _STEP) * unit
    for number in range(_READINGS):
        reading = _edge_beside(profile, (np.nan_to_num(at) - offset[0]) / step, expected, noise, is_clear)
        before, move = move, offset[0] + step * reading.place - at
        if number:
            # The secant method: how much of the last move was too much.
            with np.errstate(divide="ignore", invalid="ignore"):
                part = np.nan_to_num(np.clip(part * before / (before - move), *_PARTS), nan=1.0)
        at = at + part * move
        is_settled, strayed = np.abs(move) < _SETTLED * unit, np.abs(at - first) > farthest
        if (is_settled | strayed | ~is_clear).mean() > _MOST_SETTLED:
            break
    doubt = np.zeros(count)
    if expected is not None:
        doubt = unit / picture.scale * expected.doubt(reading.around, reading.height, is_clear)
    # What strays is another edge.
    is_read = is_clear & (np.abs(move) < _STILL * unit) & ~strayed & (np.abs(at) <= reach) & np.isfinite(doubt)
    # On an object with a fine texture no side is plain.
    most_rough = max(_ROUGH_SIDE, _ROUGHER * float(np.median(reading.rough[is_read]))) if is_read.any() else 0.0
    return Edges(np.where(is_read & (reading.rough <= most_rough), at / picture.scale, np.nan), doubt)


class _Reading(NamedTuple):
    """Edges in profiles.

    Roughness is the rms deviation of a side from its expected form, without noise, as a share of the step; infinite
    where little of the step is left just inside the outline.
    """

    place: np.ndarray  # (n,) in readings
    rough: np.ndarray  # (n,)
    around: np.ndarray  # (n, readings) around the supposed places
    height: np.ndarray  # (n,) of the step between outer and inner side


def _edge_beside(profile, place, expected: "_Expected | None", noise, is_clear) -> _Reading:
    """Read the edges near given places of profiles.

    Parameters
    ----------
    profile : (n, width) float
        Readings along the normals, `_STEP` units apart.
    place : (n,) float
        Supposed places of the edges, in readings.
    expected : _Expected, optional
        Brightness of the inner sides; absent for a flat object.
    noise : (n,) float
        Standard deviation of a reading.
    is_clear : (n,) bool
        Mask of the edges that stand out of the noise.
    """
    place = np.clip(place, -_FIRST, profile.shape[1] - _LAST - 1)
    around = _between(profile, place[:, None] + np.arange(_FIRST, _LAST + 1))
    outer = around[:, _OUTSIDE]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        level, outer_level = around[:, _INSIDE].mean(axis=1), outer.mean(axis=1)
        if expected is None:
            # The texture's level at the edge follows from its slope.
            away = _ALONG[_PLAIN] - _ALONG[_PLAIN].mean()
            lean = (around[:, _PLAIN] @ away) / np.sum(away**2)
            form = level[:, None] + lean[:, None] * (_ALONG - _ALONG[_INSIDE].mean())
            form, share, judged = form * _SURFACE, _SURFACE, _ALONG <= -_INNER
        else:
            form, share, judged = expected.form(around, is_clear), expected.share, _INSIDE
        # Areas above the level of the outer side: that of the readings, and that of the inner side up to the place.
        area = (around[:, _WITHIN] - outer_level[:, None]) @ _AREA
        whole = (form - outer_level[:, None] * share)[:, _WITHIN] @ _AREA
        height = form[:, np.argmax(_WITHIN)] - outer_level
        step, deviation = np.abs(level - outer_level), np.sqrt(np.mean((around - form)[:, judged] ** 2, axis=1))
        rough = np.maximum(np.maximum(deviation, outer.std(axis=1)) - 2.0 * noise, 0.0) / step
        rough = np.where(np.abs(height) > _LEAST_HEIGHT * step, rough, np.inf)
        # Without a step there is no edge: it is as far away as nobody looks.
        far = float(profile.shape[1])
        return _Reading(place + np.clip((area - whole) / height / _STEP, -far, far), rough, around, height)


class _Expected:
    """Brightness that is expected along the normals inside an outline, at the readings around its edges.

    Parameters
    ----------
    inner : InnerSide
    xy : (n, 2) float
        Points of the outline, superpixels.
    unit : float
        Samples.
    blur : float
        Standard deviation of the blur of a reading, units.
    """

    def __init__(self, inner: InnerSide, xy: np.ndarray, unit: float, blur: float) -> None:
        from scipy.spatial import cKDTree

        depth = np.minimum(np.maximum(-_ALONG, 0.0) * unit / inner.step, inner.light.shape[1] - 1.0)
        depth = np.broadcast_to(depth, (len(xy), len(depth)))
        light, facing, self._paint = (_between(one, depth) for one in inner[1:4])
        # The blur of a photograph spreads the borders of paints: brightness is compared away from them.
        apart = np.pad(self._paint, ((0, 0), (_BLURRED, _BLURRED)), mode="edge")
        border = (apart[:, 2 * _BLURRED :] - apart[:, : -2 * _BLURRED]) / self._paint
        even = 1.0 / (1.0 + (border / _LEAST_BORDER) ** 2)
        self._inside, deep = (even * part / np.sum(even * part, axis=1)[:, None] for part in (_INSIDE, _DEEPER))
        with np.errstate(divide="ignore", invalid="ignore"):
            # Where the surface is dark, nothing is expected, and no edge is read.
            self._mean_light = np.sum(self._inside * light, axis=1)
            light /= self._mean_light[:, None]
            light[~np.isfinite(light)] = np.nan
        facing -= np.sum(self._inside * facing, axis=1)[:, None]
        self._light, self._deep, self._deep_light = light, deep, np.sum(deep * light, axis=1)
        self._turn = deep * (facing - np.sum(deep * facing, axis=1)[:, None])
        self._turned = np.sum(self._turn * facing, axis=1)
        self._told = np.sum(even * _DEEPER, axis=1) * self._turned
        # What a reading contains of its neighbourhood, and how much of that is the surface.
        blurred = np.exp(-0.5 * ((_ALONG[:, None] - _ALONG) / blur) ** 2)
        blurred *= _SURFACE / blurred.sum(axis=1, keepdims=True)
        self.share = blurred.sum(axis=1)
        self._matt, self._gloss = ((self._paint * one) @ blurred.T for one in (light, facing))
        self._unsure = (self._paint * light * _between(inner.unsure, depth)) @ blurred.T
        self._even_matt, self._even_gloss = (one @ blurred.T for one in (light, facing))
        self._beside = cKDTree(xy).query(xy, k=np.arange(1, min(_BESIDE, len(xy)) + 1))[1]

    def form(self, around: np.ndarray, is_clear: np.ndarray) -> np.ndarray:
        """Return the expected readings, as high as the ones around the edges, (n, readings).

        Parameters
        ----------
        around : (n, readings) float
            Readings around the supposed places of the edges.
        is_clear : (n,) bool
            Mask of the edges that stand out of the noise.
        """
        slope = self._slope(around / self._paint, is_clear)
        form = self._matt + slope[:, None] * self._gloss
        return self._level(around, form)[:, None] * form

    def doubt(self, around: np.ndarray, height: np.ndarray, is_clear: np.ndarray) -> np.ndarray:
        """Return standard deviations of the places of edges by errors of paints and gloss, (n,) units.

        They are proportional to what paints and gloss change in the places. Paints that are not known count with what
        they could change.

        Parameters
        ----------
        around, is_clear
            As in `form`.
        height : (n,) float
            Height of the step between outer and inner side.
        """
        gloss = self._slope(around / self._paint, is_clear)[:, None]
        form, even = self._matt + gloss * self._gloss, self._even_matt + gloss * self._even_gloss
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            found, matt, even, unsure = (
                self._level(around, level) * (one[:, _WITHIN] @ _AREA) / height
                for one, level in ((form, form), (self._matt, self._matt), (even, even), (self._unsure, form))
            )
        parts = (_GLOSS_DOUBT, found - matt), (_PAINT_DOUBT, found - even), (_UNSURE_DOUBT, unsure)
        return np.sqrt(sum((share * moved) ** 2 for share, moved in parts))

    def _level(self, around: np.ndarray, form: np.ndarray) -> np.ndarray:
        """Return how much higher than a form the readings inside the outline are, away from borders of paints."""
        return np.sum(self._inside * around, axis=1) / np.sum(self._inside * form, axis=1)

    def _slope(self, seen: np.ndarray, is_clear: np.ndarray) -> np.ndarray:
        """Return how brightness changes with the cosine of the view's angle, less a matt surface's change, (n,).

        Gloss, dust or a rough surface change it. Compared with a fully lit surface it varies slowly along an outline:
        the median over neighbouring points is taken, weighted by how much the angle changes.

        Parameters
        ----------
        seen : (n, readings) float
            Readings over the brightness of the paint.
        is_clear : (n,) bool
        """
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            scale = self._deep_light / np.sum(self._deep * seen, axis=1)
            slope = np.sum(self._turn * (scale[:, None] * seen - self._light), axis=1) / self._turned
            slope *= self._mean_light
        used = is_clear & np.isfinite(slope) & (self._told > _LEAST_TURN)
        slope, told = (np.where(used, one, 0.0)[self._beside] for one in (slope, self._told))
        order = np.argsort(slope, axis=1)
        total = np.cumsum(np.take_along_axis(told, order, axis=1), axis=1)
        middle = np.argmax(total >= 0.5 * total[:, -1:], axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            return slope[np.arange(len(slope)), order[np.arange(len(slope)), middle]] / self._mean_light


def _between(rows: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Interpolate rows of values, (n, m), linearly at places of each, (n, k) from 0 to m - 1."""
    first = np.minimum(places.astype(int), rows.shape[1] - 2)
    near, after = (np.take_along_axis(rows, first + one, axis=1) for one in (0, 1))
    return near + (places - first) * (after - near)
