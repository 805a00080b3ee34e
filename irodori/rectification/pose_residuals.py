"""Residuals of single photographs after a registration, and the angle of a pose that would explain each best."""

import math
from dataclasses import replace

import numpy as np

from irodori.rectification.coarse_look import contrast
from irodori.rectification.placement_correction import COUNT
from irodori.rectification.registration_equations import (
    LEAST_POINTS,
    TEXTURE_FLOOR,
    cauchy_weight,
    fitted_displacement,
    linearised_textures,
    measure_outline,
    robust_sigma,
)
from irodori.rectification.registration_problem import Problem, View
from irodori.rectification.texture_agreement import TextureRows, mean_texture
from irodori.rectification.told_values import CONTRADICTED

# Mean square of the gradient of log reflectance per superpixel, in the direction in which it is least.
_LEAST_TEXTURE = 1e-5
#: Least mean square of the normals of an outline, along any direction, with which it tells where its object is shown.
_BOTH_WAYS = 0.1
#: Displacement, superpixels, from which an outline has to be clearer where it is found than where it is expected; the
#: ratio that is clearer; and distance from the outline of the readings that tell, samples.
_DOUBTFUL_PX, _CLEARER, _BESIDE = 0.5, 1.05, 1.5
_MOST_DOUBT_PX = 0.4  # of a point of an outline by which a photograph is judged
_LEAST_MATT = 0.3  # mean weight of the texels of a photograph that is judged by its texture
#: What may be wrong with the pose of one photograph -> the angle that is varied. The place of the object in the picture
#: depends only on the sum of the camera's angle and the tilt.
_POSE_ANGLES = {"camera_deg or tilt_deg": "camera_deg", "turn_deg": "turn_deg"}


def pose_residuals(problem: Problem, reach: float) -> tuple[np.ndarray, np.ndarray, tuple[tuple[str, float], ...]]:
    """Return residuals (J,) in superpixels, counts of outline points (J,), and the suspect angle of every photograph.

    Residuals are relative to the common correction. Outlines are searched over ``reach`` samples, further than at the
    end of the registration, so that a photograph with a wrong pose gets a large residual instead of none.
    """
    residual, count = np.full(len(problem.views), np.nan), np.zeros(len(problem.views), dtype=int)
    rows = linearised_textures(problem) if problem.tells_texture else []
    weights = [row.weight for row in rows]
    mean = mean_texture([row.value for row in rows], weights) if rows else np.zeros(0)
    total = np.sum(weights, axis=0)
    suspects = []
    for number, view in enumerate(problem.views):
        distance, doubt, _, found = measure_outline(problem, number, reach)
        count[number] = len(distance)
        sure = doubt < _MOST_DOUBT_PX
        if sure.sum() < LEAST_POINTS:
            sure[:] = False
        distance, found = distance[sure], _within(found, sure)
        outward = view.outward[found] if len(distance) else np.zeros((0, 2))
        if len(distance):
            xy = problem.seen(number, view.rim[found], problem.unknowns)
            residual[number] = _displacement(xy, outward, distance)
            if residual[number] > _DOUBTFUL_PX and not _is_clearer(view, xy, outward, distance):
                residual[number] = np.nan
        shift = np.full(2, np.nan)
        # An outline that tells both directions is more certain than a texture beside gloss.
        if rows and np.linalg.eigvalsh(outward.T @ outward)[0] < _BOTH_WAYS * len(outward) + 1e-9:
            shift = _shift(rows[number], mean, total)
        residual[number] = np.fmax(residual[number], np.linalg.norm(shift))
        off = np.zeros((0, 2))
        if len(view.corners):
            xy = problem.corners_seen(number, problem.unknowns)
            off, both = view.corners_px - xy, np.tile(np.eye(2), (len(xy), 1))
            view.sheet_residual_px = math.sqrt(2.0) * _displacement(np.repeat(xy, 2, axis=0), both, off.ravel())
            residual[number] = np.fmax(residual[number], view.sheet_residual_px)
        suspects.append(_suspect(problem, number, distance, found, shift, off))
    return residual, count, tuple(suspects)


def least_residuals(
    problem: Problem, residual: np.ndarray, probable: np.ndarray, sigma: np.ndarray, reach: float
) -> np.ndarray:
    """Return the residuals, (J,) in superpixels, or those with all common unknowns at their most probable values.

    A few points of an outline may show that an object is displaced without determining how: its place then stays as
    typed, and is no contradiction. The smaller of both counts, and NaN if the photograph does not tell that it is far
    from the most probable place. If that place is itself unlikely, it explains nothing.
    """
    if (np.abs(probable[:COUNT]) > CONTRADICTED * sigma[:COUNT]).any():
        return residual
    used, problem.unknowns = problem.unknowns, probable.copy()
    problem.unknowns[problem.own] = 0.0
    of_sheet = [view.sheet_residual_px for view in problem.views]
    least = np.minimum(residual, pose_residuals(problem, reach)[0])
    problem.unknowns = used
    for view, one in zip(problem.views, of_sheet, strict=True):
        view.sheet_residual_px = one
    return least


def _within(mask: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return a mask, (n,) bool, of those of the true values of another that are chosen, (true values,) bool."""
    out = mask.copy()
    out[mask] = chosen
    return out


def _is_clearer(view: View, xy: np.ndarray, outward: np.ndarray, distance: np.ndarray) -> bool:
    """Whether a displaced outline is clearer in a photograph than the expected one.

    A few points at borders of paints or highlights can displace an outline by far, if most points are on one side.
    Arguments as in `fitted_displacement`.
    """
    explained = fitted_displacement(xy, outward, distance)
    if explained is None:
        return False
    on = np.stack([xy, xy + explained[:, None] * outward])
    across = np.broadcast_to(_BESIDE / view.picture.scale * outward, on.shape)
    expected, displaced = contrast(view.picture, on, across)
    return bool(displaced > _CLEARER * expected)


def _displacement(xy: np.ndarray, outward: np.ndarray, distance: np.ndarray) -> float:
    """Return the root-mean-square displacement of an outline, superpixels; NaN if `fitted_displacement` returns None.

    The mean is over all points: if a rectangular plate is moved along one of its sides, half of its outline stays in
    place and still counts. Arguments as in `fitted_displacement`.
    """
    explained = fitted_displacement(xy, outward, distance)
    return math.nan if explained is None else math.sqrt(np.mean(explained**2))


def _suspect(
    problem: Problem, number: int, distance: np.ndarray, found: np.ndarray, shift: np.ndarray, off_sheet=()
) -> tuple[str, float]:
    """Return the angle of a photograph's pose whose error would explain its displacement best, and that error, degrees.

    Parameters
    ----------
    problem : Problem
    number : int
        Index of the photograph.
    distance : (n,) float
        Displacement of its outline at the found points, superpixels.
    found : (m,) bool
        Mask of the outline points at which an edge was found.
    shift : (2,) float
        Displacement of its texture, superpixels; used if neither an outline nor the sheet was found.
    off_sheet : (k, 2) float
        Displacement of the sheet's corners, superpixels; used if there are any.
    """
    view = problem.views[number]
    points, outward = problem.texels.position, None
    if len(off_sheet):
        off = np.ravel(off_sheet)
    elif len(distance):
        points, outward, off = view.rim[found], view.outward[found], distance
    else:
        off = np.tile(np.nan_to_num(shift), len(points))

    def place() -> np.ndarray:
        """Place of the points along the measured directions in the present pose."""
        if len(off_sheet):
            return problem.corners_seen(number, problem.unknowns).ravel()
        xy = problem.seen(number, points, problem.unknowns)
        return xy.ravel() if outward is None else np.sum(xy * outward, axis=1)

    typed, explained = view.pose, []
    for name, angle in _POSE_ANGLES.items():
        ends = []
        for sign in (1.0, -1.0):
            view.pose = replace(typed, **{angle: getattr(typed, angle) + 0.1 * sign})
            ends.append(place())
        along = (ends[0] - ends[1]) / 0.2
        by = float(along @ off) / max(float(along @ along), 1e-12)
        explained.append((float(np.sum((off - by * along) ** 2)), name, by))
    view.pose = typed
    return min(explained)[1:]


def _shift(row: TextureRows, mean: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Return the displacement of a photograph's texture from that of the others, (2,) superpixels; NaN if too weak."""
    others = total - row.weight
    used = (row.weight > 0) & (others > 1e-6 * row.weight)
    # Gloss changes the texture near mirror directions: with mostly such texels, the place cannot be determined.
    if not used.any() or row.weight[used].mean() < _LEAST_MATT:
        return np.full(2, np.nan)
    share = row.weight[used] / others[used]
    off = (row.value[used] - mean[used]) * (1.0 + share)[:, None]  # from the mean of the others
    slope = row.change[used][..., COUNT:]
    weight = row.weight[used, None] * cauchy_weight(off, robust_sigma(off, TEXTURE_FLOOR))
    matrix = np.einsum("tb,tbi,tbk->ik", weight, slope, slope)
    if np.linalg.eigvalsh(matrix)[0] < _LEAST_TEXTURE * weight.sum():
        return np.full(2, np.nan)
    return np.linalg.solve(matrix, -np.einsum("tb,tbi,tb->i", weight, slope, off))
