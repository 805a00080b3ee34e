"""Normal equations of a registration: distances of outlines, textures and sheets from their places."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from irodori.rectification.marker_sheet import OUTLINE
from irodori.rectification.outline_search import OUTER, find_edges
from irodori.rectification.placement_correction import CAMERA, COUNT
from irodori.rectification.registration_covariance import Rows
from irodori.rectification.registration_problem import Problem
from irodori.rectification.texture_agreement import (
    TextureRows,
    mean_texture,
    picture_slope,
    texel_values,
    texture_rows,
    without_levels,
)

FINEST_REACH = 4.0  # samples to either side of an outline, at the end of the search
_ROUNDS = 6  # iterations of the robust fit of an outline's displacement
LEAST_POINTS = 12
#: Distance from a displacement of the whole outline within which a point agrees with it: superpixels, or share of that
#: displacement; and share of the points that have to agree.
_AGREE_PX, _AGREE, _MOST_AGREE = 0.3, 0.25, 0.6
#: Least standard deviation of a single measurement: the systematic errors of edges and of textures in pictures.
OUTLINE_FLOOR_PX, TEXTURE_FLOOR, _CORNER_FLOOR_PX = 0.1, 0.01, 0.05
_OUTLINE_MOST_PX = 0.4  # largest standard deviation of outline points in the last level; points beyond are outliers
#: Neighbouring measurements have common errors: number that counts as one (for textures, a block of texels and bands).
_OUTLINE_SHARED, _TEXTURE_SHARED = 5.0, 75.0
_SIDES = 4.0  # parts of an outline in which the errors by paints and gloss are alike
_OUTLINED = 0.5  # share of photographs with an outline from which on coarse levels use outlines alone
_CAMERA = range(6, CAMERA + 1)  # quantities on which the place of the sheet in a photograph depends


class Outline(NamedTuple):
    """A photograph's outline, measured against its expected place at n points.

    Parameters
    ----------
    distance, doubt : (n,) float
        Distances of the found edges from the expected outline along its outward normals, and the standard deviations of
        the errors that neighbouring points have in common, superpixels.
    change : (n, 12) float
        Derivatives of the expected place along the normals by the common unknowns.
    found : (m,) bool
        Mask of the points of the outline at which an edge was found.
    """

    distance: np.ndarray
    doubt: np.ndarray
    change: np.ndarray
    found: np.ndarray


def measure_outline(problem: Problem, number: int, reach: float) -> Outline:
    """Measure a photograph's outline against its expected place."""
    view = problem.views[number]
    nothing = Outline(np.zeros(0), np.zeros(0), np.zeros((0, COUNT)), np.zeros(len(view.rim), dtype=bool))
    if not len(view.rim):
        return nothing
    xy = problem.seen(number, view.rim, problem.unknowns)
    # The middle of a sheet is dark, but not black: before it, the end of the lit part may be a stronger edge.
    is_dark = problem.sheet is not None
    distance, doubt = find_edges(
        view.picture, view.search, xy, view.outward, reach, inner=view.inner, is_dark_outside=is_dark
    )
    distance -= problem.outline_px
    if problem.sheet is not None:
        # Edges of squares are stronger than that of the object.
        correction, pose = problem.standing(number, problem.unknowns)
        place, camera = problem.unknowns[problem.of_sheet], problem.setup.corrected(correction)
        far = (reach + OUTER * max(1.0, view.search.sigma)) / view.picture.scale
        distance[problem.sheet.is_over_print(xy, view.outward, far, pose, camera, place)] = np.nan
    found = np.isfinite(distance)
    if found.sum() < LEAST_POINTS:
        return nothing
    return Outline(distance[found], doubt[found], view.change[found], found)


def robust_sigma(values: np.ndarray, floor: float, most: float = math.inf) -> float:
    """Return a robust standard deviation of measurements about zero, from their median magnitude, within limits."""
    return min(max(1.4826 * float(np.median(np.abs(values))), floor), most) if values.size else floor


def cauchy_weight(values: np.ndarray, sigma) -> np.ndarray:
    """Return Cauchy weights of residuals, which give outliers little influence."""
    return 1.0 / (1.0 + (values / (2.0 * sigma)) ** 2)


def equations(problem: Problem, reach: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal matrix and right-hand side of a Gauss-Newton step, with the prior.

    ``reach`` is that of the search for outlines; if it is None, only the sheet is used.
    """
    size = len(problem.unknowns)
    matrix, right = np.zeros((size, size)), np.zeros(size)
    if problem.sheet is not None:
        for rows in sheet_rows(problem):
            rows.add_to(matrix, right)
    if reach is not None:
        _add_object(problem, reach, matrix, right)
    free = problem.sigma > 0
    matrix[free, free] += 1.0 / problem.sigma[free] ** 2
    right[free] -= problem.unknowns[free] / problem.sigma[free] ** 2
    return matrix, right


def sheet_rows(problem: Problem) -> list[Rows]:
    """Return the distances of the sheet's corners from their expected places in every photograph that shows it."""
    off = [
        view.corners_px - problem.corners_seen(number, problem.unknowns) for number, view in enumerate(problem.views)
    ]
    scale = robust_sigma(np.concatenate(off).ravel(), _CORNER_FLOOR_PX)
    common, found = [*_CAMERA, *problem.of_sheet], []
    for number, one in enumerate(off):
        if not len(one):
            continue
        moved = problem.derivative(problem.corners_seen, number, common)
        where = [*common, COUNT + number]
        rows = np.concatenate([moved, moved[..., [common.index(CAMERA)]]], axis=-1)
        factor = cauchy_weight(np.linalg.norm(one, axis=1) / math.sqrt(2.0), scale) / scale**2
        factor /= problem.views[number].corner_scatter
        found.append(Rows(where, rows.reshape(-1, len(where)), np.repeat(factor, 2), one.ravel()))
    return found


def outline_scale(measured: list[Outline], *, is_last: bool) -> float:
    """Return the standard deviation of outline points, superpixels; ``measured`` as found by `measure_outline`."""
    every = np.concatenate([one.distance for one in measured])
    return robust_sigma(every, OUTLINE_FLOOR_PX, _OUTLINE_MOST_PX if is_last else math.inf)


def outline_rows(problem: Problem, measured: list, scale: float, *, is_last: bool) -> list[Rows]:
    """Return the outline of every photograph as rows of equations, from results and scale of its points."""
    found = []
    for view, one in enumerate(measured):
        rows, where = one.change[:, [*range(COUNT), CAMERA]], [*range(COUNT), COUNT + view]
        if problem.sheet is not None:
            rows = np.concatenate([rows, np.full((len(rows), 1), 1.0 / problem.mm_per_px)], axis=1)
            where.append(problem.of_sheet[OUTLINE])
        # Borders of paints beside an outline are many and on one side: at the end they lose all influence.
        factor = cauchy_weight(one.distance, np.hypot(scale, one.doubt)) ** (2 if is_last else 1)
        variance = problem.views[view].outline_scatter * outline_variance(problem, view, one, scale)
        found.append(Rows(where, rows, factor / variance, one.distance))
    return found


def outline_variance(problem: Problem, number: int, outline: Outline, scale: float) -> np.ndarray:
    """Return variances of the points of an outline as if their errors were independent, (n,) superpixels².

    Parameters
    ----------
    problem : Problem
    number : int
        Index of the photograph.
    outline : Outline
    scale : float
        Standard deviation of a point.
    """
    pose = replace(problem.views[number].pose, turn_deg=0.0)
    # Gloss and paints err alike on one side of an object, and in all photographs under the same angles.
    alike = sum(replace(view.pose, turn_deg=0.0) == pose for view in problem.views)
    return scale**2 * _OUTLINE_SHARED + outline.doubt**2 * max(1.0, len(outline.distance) / _SIDES) * alike


def _add_object(problem: Problem, reach: float, matrix: np.ndarray, right: np.ndarray) -> None:
    """Add outlines and textures to normal equations."""
    is_last = reach <= FINEST_REACH
    measured = [measure_outline(problem, view, reach) for view in range(len(problem.views))]
    for rows in outline_rows(problem, measured, outline_scale(measured, is_last=is_last), is_last=is_last):
        rows.add_to(matrix, right)
    outlined = np.mean([len(one.distance) > 0 for one in measured]) >= _OUTLINED
    if problem.tells_texture and (is_last or not outlined):
        add_texture(linearised_textures(problem), matrix, right, problem.texture_scatter)


def linearised_textures(problem: Problem) -> list[TextureRows]:
    """Return the linearised texture of every photograph."""
    texels, views = problem.texels, problem.views
    places = [problem.seen(view, texels.position, problem.unknowns) for view in range(len(views))]
    values, weights = [], []
    for number, view in enumerate(views):
        values.append(texel_values(view.picture, view.level, places[number], problem.shading(number)))
        weights.append(np.where(np.isfinite(values[-1]).all(axis=1), view.weight, 0.0))
    values = without_levels(values, weights, problem.block)
    mean = problem.on_grid(mean_texture(values, weights))
    found = []
    for number, place in enumerate(places):
        # After the common unknowns: shifts of this photograph alone along x and y.
        moved = np.concatenate([views[number].moved, np.broadcast_to(np.eye(2), (len(place), 2, 2))], axis=2)
        slope = picture_slope(mean, problem.on_grid(place)).reshape(-1, mean.shape[2], 2)[texels.number]
        found.append(texture_rows(values[number], slope, moved, weights[number], problem.block))
    return found


def add_texture(rows: list[TextureRows], matrix: np.ndarray, right: np.ndarray, scatter: float = 1.0) -> list[Rows]:
    """Add the differences between the photographs' textures to normal equations, the texels' colours eliminated.

    Returns the differences of every photograph from the mean texture.
    """
    # A texel that only one photograph shows cannot be compared.
    both = np.sum([row.weight > 0 for row in rows], axis=0) > 1
    if not both.any():
        return []
    rows = [TextureRows(*(part[both] for part in row)) for row in rows]
    values, weights = [row.value for row in rows], [row.weight for row in rows]
    mean = mean_texture(values, weights)
    off = [value - mean for value in values]
    scale = robust_sigma(np.concatenate([o[w > 0].ravel() for o, w in zip(off, weights, strict=True)]), TEXTURE_FLOOR)
    weights = [
        w * cauchy_weight(np.sqrt(np.mean(o**2, axis=1)), scale) / (scatter * scale**2 * _TEXTURE_SHARED)
        for o, w in zip(off, weights, strict=True)
    ]
    mean, total = mean_texture(values, weights), np.sum(weights, axis=0)
    sums, found = np.zeros((*mean.shape, len(right))), []
    for view, (row, weight) in enumerate(zip(rows, weights, strict=True)):
        where = [*range(COUNT), COUNT + view]
        change = row.change[..., [*range(COUNT), CAMERA]]
        sums[..., where] += weight[:, None, None] * change
        one = change.reshape(-1, len(where)), np.repeat(weight, mean.shape[1]), (mean - row.value).ravel()
        found.append(Rows(where, *one))
        found[-1].add_to(matrix, right)
    matrix -= np.einsum("tbp,tbq->pq", sums, sums / total[:, None, None], optimize=True)
    return found


def fitted_displacement(xy: np.ndarray, outward: np.ndarray, distance: np.ndarray) -> np.ndarray | None:
    """Return the displacement of an outline's points along its normals by a robust affine fit, (n,) superpixels.

    Outliers, at edges of something else, have little influence. None if most points do not agree with any displacement
    of the whole: such an outline, beside shadows or paints, tells nothing about the photograph.

    Parameters
    ----------
    xy : (n, 2) float
        Expected points of the outline, superpixels.
    outward : (n, 2) float
        Unit normals.
    distance : (n,) float
        Distance of the measured outline from them, superpixels.
    """
    affine = np.concatenate([outward, outward * xy[:, :1], outward * xy[:, 1:]], axis=1)
    weight, explained = np.ones(len(distance)), distance
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)
        explained = affine @ np.linalg.lstsq(root[:, None] * affine, root * distance, rcond=1e-9)[0]
        left = distance - explained
        weight = cauchy_weight(left, robust_sigma(left, OUTLINE_FLOOR_PX))
    displacement = math.sqrt(np.mean(explained**2))
    agree = np.abs(distance - explained) <= max(_AGREE_PX, _AGREE * displacement)
    return explained if agree.mean() >= _MOST_AGREE else None
