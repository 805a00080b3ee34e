"""Rotation of an object from its first placement, by the texture that photographs of both placements show.

An outline tells how a mesh is turned, but not how a ball or a vase is turned about its axis. The paints tell: a point
of the surface that photographs of two placements show has the same diffuse colour in both. The rotation about the
table's three axes under which the two textures agree best is found by Gauss-Newton steps from coarse to fine pictures.
On a ball, which looks alike however it is turned, the steps begin at the best of many rotations. A typed rotation is
refused if the textures agree far better under one that is far from it, and under no other: small parts of two textures
agree by chance under some of thousands of rotations.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.geometry.embree import Tracer
from irodori.geometry.rig_frame import rig_from_camera, rotation_xyz, to_camera
from irodori.rectification.reduced_pictures import Level
from irodori.rectification.registration_file import Estimate
from irodori.rectification.stage import observe
from irodori.rectification.texture_agreement import matt_weight, mean_texture, texel_values

if TYPE_CHECKING:
    from irodori.rectification.registration_problem import Problem, View

TURN = slice(3, 6)  # the rotation about the table's axes in `irodori.rectification.placement_correction.QUANTITIES`
_LEAST_COSINE = 0.25  # of incidence and view: at grazing angles pictures show little, and mix in what lies behind
_COARSER = (2.0, 1.4, 1.0)  # blur of the pictures, in that of the last level
_PART_OF_TEXEL = 0.6  # blur of the last level, a sample at least
_STEPS = 6
_ASIDE_DEG = 0.5  # of numerical derivatives
_STILL = 0.05  # standard errors within which a step ends the search
#: Neighbouring texels and the bands have common errors: number of values that counts as one.
_SHARED = 75.0
_FLOOR = 0.01  # least standard deviation of a value
_FEWEST = 40  # texels that two textures have in common, at least
_LEAST_CONTRAST = 0.1  # least standard deviation of a texture, as a logarithm: gloss leaves less on a single paint
_SURE_CONTRAST = 0.2  # the same for a texture that contradicts what was typed
#: Rotations of a ball: number that are tried, spread over all; standard deviations of the typed one that are near it,
#: and steps to either side of it.
_ROTATIONS, _NEAR, _NEAR_STEPS = 8000, 3.0, 4
_POINTS = 500  # of a ball, that are looked up for each of them
_AT_ONCE = 200
_LEAST_COMMON = 0.2  # share of these points, at least, that both placements show
#: Misfit, as a share of the scatter of the paints, below which two textures agree; and the ratio of two that tells.
_AGREES, _CLEARER = 0.3, 3.0
_APART_DEG = 30.0  # between rotations of which one must be far clearer than the other


class Texture(NamedTuple):
    """Logarithms of diffuse reflectance at the texels, (n, bands), and weights, (n,), 0 where nothing shows them."""

    value: np.ndarray
    weight: np.ndarray


class Turned(NamedTuple):
    """Rotation that textures tell: corrections about the table's axes and their covariance, degrees."""

    rotation_deg: np.ndarray
    covariance: np.ndarray


class Side(NamedTuple):
    """One placement: its photographs and their files, the corrections with which it stands, (12,), and its number."""

    problem: "Problem"
    linear: Sequence
    values: np.ndarray
    number: int


# ---- textures


def _read(problem: "Problem", view: "View", level: Level, values: np.ndarray) -> np.ndarray:
    """Return logarithms of the texels' reflectance in a photograph, (n, bands), for given corrections."""
    correction = problem.setup.correction.by(values)
    pose, camera = correction.pose(view.pose), problem.setup.corrected(correction)
    lain = correction.placements(problem.shape, pose, 0.0)[0]
    position = lain.points(problem.texels.position)
    light, power, _ = camera.lamp.seen_from(position, pose)
    cosine = np.sum((problem.texels.normal @ lain.rotation.T) * light, axis=1)
    axes = rig_from_camera(pose, camera.pinhole.quarter_turns)
    xy = camera.pinhole.project(position, camera.camera_distance_mm * to_camera(pose), axes)
    return texel_values(view.picture, level, xy, np.where(cosine > 0.0, cosine * power, np.nan))


def _weight(problem: "Problem", view: "View", values: np.ndarray) -> np.ndarray:
    """Return weights of the texels in a photograph, (n,): 0 where they are hidden, unlit or grazing, low by gloss."""
    correction = problem.setup.correction.by(values)
    pose, camera = correction.pose(view.pose), problem.setup.corrected(correction)
    placements = correction.placements(problem.shape, pose, problem.setup.table_radius_mm)
    lain, texels = placements[0], problem.texels
    normal, facet = texels.normal @ lain.rotation.T, texels.facet @ lain.rotation.T
    sight = observe(lain.points(texels.position), normal, Tracer(placements), pose, camera, facet)
    steep = (np.cos(sight.geometry[:, :2]) > _LEAST_COSINE).all(axis=1)
    return matt_weight(sight.geometry[:, 3]) * (sight.visible & sight.lit & steep)


class _Shown(NamedTuple):
    """Views of a placement with one blur, and the weights of their texels."""

    problem: "Problem"
    views: "Sequence[View]"
    levels: list[Level]
    weights: list[np.ndarray]

    @classmethod
    def of(cls, side: Side, blur: float) -> "_Shown":
        levels = [view.picture.level(blur) for view in side.problem.views]
        return cls(side.problem, side.problem.views, levels, []).standing(side.values)

    def standing(self, values: np.ndarray) -> "_Shown":
        """Return the same with the weights for given corrections."""
        weights = []
        for view, level in zip(self.views, self.levels, strict=True):
            known = np.isfinite(_read(self.problem, view, level, values)).all(axis=1)
            weights.append(np.where(known, _weight(self.problem, view, values), 0.0))
        return self._replace(weights=weights)

    def each(self, values: np.ndarray) -> list[np.ndarray]:
        """Return what every photograph shows for given corrections; 0 where it has no weight."""
        seen = [_read(self.problem, view, level, values) for view, level in zip(self.views, self.levels, strict=True)]
        return [np.where(w[:, None] > 0.0, v, 0.0) for v, w in zip(seen, self.weights, strict=True)]

    def texture(self, values: np.ndarray) -> Texture:
        """Return the mean over the photographs for given corrections."""
        return Texture(mean_texture(self.each(values), self.weights), np.sum(self.weights, axis=0))


def _blur(problem: "Problem") -> float:
    """Return the blur of the pictures in the last level, samples."""
    from scipy.spatial import cKDTree  # slow to import

    points = problem.texels.position
    apart = float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))
    scale = float(np.median([view.picture.scale for view in problem.views]))
    return max(1.0, _PART_OF_TEXEL * apart / problem.mm_per_px * scale)


def _misfit(one: Texture, other: Texture) -> tuple[float, float]:
    """Return the mean square difference of two textures over the scatter of both, apart from their levels, and that.

    The first is infinite if they have too little in common or too little contrast.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = np.nan_to_num(one.weight * other.weight / (one.weight + other.weight))
    seen = weight > 0.0
    if np.count_nonzero(seen) < _FEWEST:
        return np.inf, 0.0
    a, b, weight = one.value[seen], other.value[seen], weight[seen]
    a, b = (v - np.average(v, axis=0, weights=weight) for v in (a, b))
    scatter = float(np.average((a**2 + b**2).mean(axis=1), weights=weight))
    if scatter < 2.0 * _LEAST_CONTRAST**2:
        return np.inf, scatter
    return float(np.average(((a - b) ** 2).mean(axis=1), weights=weight)) / scatter, scatter


# ---- the rotation


def turned(first: Side, own: Side, sigma_deg: float) -> Turned | None:
    """Return by what an object is turned beyond the typed rotation from its first placement; None if nothing tells.

    Parameters
    ----------
    first, own : Side
        The first placement and this one, registered each by itself.
    sigma_deg : float
        Standard deviation of the typed rotation about each axis.

    Raises
    ------
    InputError
        If the photographs of a ball agree far better with a rotation far from the typed one, or a photograph with the
        other placement.
    """
    own = _nearest_turn(first, own, sigma_deg) if own.problem.shape.ball_mm is not None else own
    found, blur = None, _blur(own.problem)
    for factor in _COARSER:
        found = _fitted(first, own, factor * blur, sigma_deg)
        if found is None:
            return None
        own = own._replace(values=np.concatenate([own.values[:3], found.rotation_deg, own.values[6:]]))
    misfit = _misfit(*(_Shown.of(side, blur).texture(side.values) for side in (first, own)))[0]
    if misfit > _AGREES:
        return None
    _refuse_wrong_side(first, own)
    return found


def _fitted(first: Side, own: Side, blur: float, sigma_deg: float) -> Turned | None:
    """Take Gauss-Newton steps with one blur."""
    reference, values = _Shown.of(first, blur).texture(first.values), own.values.copy()
    shown = _Shown.of(own, blur)
    for _ in range(_STEPS):
        shown = shown.standing(values)
        texture = shown.texture(values)
        if not np.isfinite(_misfit(reference, texture)[0]):
            return None
        with np.errstate(divide="ignore", invalid="ignore"):
            weight = np.nan_to_num(reference.weight * texture.weight / (reference.weight + texture.weight))
        slopes = []
        for axis in range(TURN.start, TURN.stop):
            ends = []
            for sign in (1.0, -1.0):
                moved = values.copy()
                moved[axis] += sign * _ASIDE_DEG
                ends.append(shown.texture(moved).value)
            slopes.append((ends[0] - ends[1]) / (2.0 * _ASIDE_DEG))
        slope = np.stack(slopes, axis=-1)
        seen = (weight > 0.0) & np.isfinite(slope).all(axis=(1, 2))
        if np.count_nonzero(seen) < _FEWEST:
            return None
        weight, slope, off = weight[seen], slope[seen], (reference.value - texture.value)[seen]
        # The level of the lamp in each band is unknown.
        off, slope = (v - np.average(v, axis=0, weights=weight) for v in (off, slope))
        square = np.mean(off**2, axis=1)
        scale = max(float(np.average(square, weights=weight)), _FLOOR**2)
        weight = weight / np.mean(weight) / (1.0 + square / (4.0 * scale)) / (scale * _SHARED)
        matrix = np.einsum("t,tbi,tbk->ik", weight, slope, slope) + np.eye(3) / sigma_deg**2
        right = np.einsum("t,tbi,tb->i", weight, slope, off) - values[TURN] / sigma_deg**2
        step, covariance = np.linalg.solve(matrix, right), np.linalg.inv(matrix)
        values[TURN] += step
        if np.all(np.abs(step) <= _STILL * np.sqrt(np.diag(covariance))):
            break
    return Turned(values[TURN], covariance)


def with_turn(estimate: Estimate, found: Turned | None) -> Estimate:
    """Return the estimate of a placement with what textures tell of its rotation."""
    if found is None:
        return estimate
    whole = estimate.covariance
    gain = whole[:, TURN] @ np.linalg.inv(whole[TURN, TURN] + found.covariance)
    change = gain @ (found.rotation_deg - estimate.probable[TURN])
    probable, values = estimate.probable + change, estimate.values.copy()
    values[TURN] = probable[TURN]
    # What else was corrected moves along; what stays as typed does.
    moves = np.flatnonzero(estimate.values)
    moves = moves[(moves < TURN.start) | (moves >= TURN.stop)]
    values[moves] += change[moves]
    return estimate._replace(probable=probable, covariance=whole - gain @ whole[TURN], values=values)


# ---- what is far from what was typed


def _nearest_turn(first: Side, own: Side, sigma_deg: float) -> Side:
    """Return a ball's placement with the best of many rotations near the typed one; refuse one that contradicts it."""
    from scipy.spatial.transform import Rotation  # slow to import

    blur = _COARSER[0] * _blur(own.problem)
    here, there = _Shown.of(first, blur).texture(first.values), _Shown.of(own, blur).texture(own.values)
    reach = np.linspace(-_NEAR * sigma_deg, _NEAR * sigma_deg, 2 * _NEAR_STEPS + 1) if sigma_deg > 0.0 else np.zeros(1)
    near = np.stack(np.meshgrid(reach, reach, reach), axis=-1).reshape(-1, 3)
    near = near[np.argsort(np.linalg.norm(near, axis=1), kind="stable")]
    at = own.problem.setup.correction.by(own.values).table_from_object
    typed = _misfits(first.problem, here, there, at, np.stack([rotation_xyz(one) for one in near]))
    anywhere = Rotation.random(_ROTATIONS, random_state=1)
    misfits = _misfits(first.problem, here, there, at, anywhere.as_matrix())
    best = int(np.argmin(misfits))
    clearest = anywhere[best]
    others = misfits[(anywhere * clearest.inv()).magnitude() > np.radians(_APART_DEG)]
    contrast = np.std(here.value[here.weight > 0.0], axis=0).mean() if (here.weight > 0.0).any() else 0.0
    limit = _CLEARER * misfits[best]
    is_far = clearest.magnitude() > np.radians(_NEAR * max(sigma_deg, 1.0))
    contradicts = contrast > _SURE_CONTRAST and misfits[best] < _AGREES and limit < typed.min() and is_far
    if contradicts and limit >= others.min():
        said = "placement %d: the photographs agree better with several other rotations than with the typed one, %s"
        LOGGER.warning(said, own.number, list(own.problem.setup.correction.rotation_deg))
    elif contradicts:
        said = Rotation.from_matrix(clearest.as_matrix() @ at).as_euler("xyz", degrees=True)
        angles = ", ".join(f"{angle:.0f}" for angle in said)
        stated = ", ".join(f"{angle:g}" for angle in own.problem.setup.correction.rotation_deg)
        found = f"[{stated}], though the photographs of placement {own.number} show the object turned by [{angles}]"
        field = f"placements[{own.number - 2}].rotation_deg"
        raise InputError(own.linear[0], field, found, "the rotation by which it was turned, roughly")
    if not np.isfinite(typed.min()):
        return own
    turn = near[np.argmin(typed)]
    return own._replace(values=np.concatenate([own.values[:3], own.values[TURN] + turn, own.values[6:]]))


def _misfits(problem: "Problem", here: Texture, there: Texture, at: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Return how badly two textures of a ball agree under each of many further turns about the table's axes, (m,).

    The measure is that of `_misfit`; infinite for turns under which too few points are seen in both placements.

    Parameters
    ----------
    problem : Problem
    here, there : Texture
        Of the first placement, and of the other under the typed rotation.
    at : (3, 3) float
        table_from_object of the other placement as typed.
    turns : (m, 3, 3) float
        Rotations of the table's frame.
    """
    texels = problem.texels
    shown = np.flatnonzero(here.weight > 0.0)
    shown = shown[:: max(1, len(shown) // _POINTS)]
    grid = np.zeros((texels.rows * texels.columns, here.value.shape[1] + 1))
    grid[texels.number, 0], grid[texels.number, 1:] = there.weight > 0.0, np.nan_to_num(there.value)
    value, found = here.value[shown], np.full(len(turns), np.inf)
    points = texels.position[shown] / np.linalg.norm(texels.position[shown], axis=1)[:, None]
    for first in range(0, len(turns), _AT_ONCE):
        moved = np.einsum("mij,nj->mni", at.T @ turns[first : first + _AT_ONCE] @ at, points)
        column = (np.arctan2(moved[..., 1], moved[..., 0]) / (2.0 * np.pi) % 1.0 * texels.columns).astype(int)
        row = (np.arccos(np.clip(moved[..., 2], -1.0, 1.0)) / np.pi * texels.rows).astype(int)
        met = grid[np.minimum(row, texels.rows - 1) * texels.columns + np.minimum(column, texels.columns - 1)]
        both = met[..., :1]
        count = np.maximum(both.sum(axis=1), 1.0)
        a, b = both * value, both * met[..., 1:]
        a, b = (both * (v - (v.sum(axis=1) / count)[:, None]) for v in (a, b))
        scatter = (a**2 + b**2).sum(axis=(1, 2)) / count[:, 0] / value.shape[1]
        misfit = ((a - b) ** 2).sum(axis=(1, 2)) / count[:, 0] / value.shape[1]
        enough = (count[:, 0] >= _LEAST_COMMON * len(shown)) & (scatter > 2.0 * _LEAST_CONTRAST**2)
        found[first : first + _AT_ONCE] = np.where(enough, misfit / np.maximum(scatter, 1e-12), np.inf)
    return found


def _refuse_wrong_side(first: Side, own: Side) -> None:
    """Raise an error if a photograph of one placement shows the other, by the texture that all others show."""
    blur = _blur(own.problem)
    sides = (first, own)
    shown = [_Shown.of(side, blur) for side in sides]
    values = [one.each(side.values) for one, side in zip(shown, sides, strict=True)]
    every, weights = [*values[0], *values[1]], [*shown[0].weights, *shown[1].weights]
    total, weighted = np.sum(weights, axis=0), sum(w[:, None] * v for v, w in zip(every, weights, strict=True))
    for which, (side, other) in enumerate((sides, sides[::-1])):
        for number, view in enumerate(shown[which].views):
            at = number + which * len(values[0])
            left = total - weights[at]
            with np.errstate(divide="ignore", invalid="ignore"):
                rest = Texture((weighted - weights[at][:, None] * every[at]) / left[:, None], left)
            misfit = _misfit(rest, Texture(every[at], weights[at]))[0]
            seen = _read(other.problem, view, shown[which].levels[number], other.values)
            weight = np.where(np.isfinite(seen).all(axis=1), _weight(other.problem, view, other.values), 0.0)
            there = _misfit(rest, Texture(np.nan_to_num(seen), weight))[0]
            LOGGER.debug("%s: misfit %.3f in placement %d, %.3f in %d", view.pose.name, misfit, side.number, there,
                         other.number)  # fmt: skip
            if np.isfinite(misfit) and there < _AGREES and _CLEARER * there < misfit:
                found = f"{side.number}, though the photograph shows the object in placement {other.number}"
                raise InputError(side.linear[number], "placement", found, "the placement that each photograph shows")
