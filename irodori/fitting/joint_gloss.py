"""Gloss of all paints of an object, fitted jointly with the errors that the texels of a photograph share.

Between one photograph and the next, the lamp's brightness drifts, the angles are a little off, and the mirror image of
a lamp in a glossy surface spreads a veil of stray light over the picture. The texels of one paint cannot distinguish
such an error from a wider or stronger gloss, as all of them see it alike. Paints that differ in colour and gloss can.
The unknowns are therefore log β and log μ of every paint, and four errors of every photograph, each with a prior of its
expected size. The α of every texel is eliminated, and so is the texel's difference from its paint where gloss varies.
The expected size of the veil is itself estimated from all photographs (empirical Bayes).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from irodori.core.progress import LOGGER
from irodori.fitting import gloss_sums as sums
from irodori.fitting.gloss_sums import SHARED, VEIL, PhotographErrors, SearchedTexels
from irodori.fitting.judge import MAX_RELATIVE_ERROR
from irodori.fitting.paint_gloss import PaintGloss, SeparateGloss, matrices, separate_gloss, with_variation

#: What is left out of the fit where photographs contradict the gloss of paints; see `Contradiction`.
HIGHLIGHTS, PHOTOGRAPH, NOTHING = "highlights", "photograph", "nothing"
_STEPS = 40
_SETTLED = 1e-5  # change of log β and log μ that ends the search
_STEADY = 0.02  # change of the logarithm of the veil's size that does, too
_LONGEST = 0.3  # longest step of log β or log μ
_FIRST_VEIL = 0.01  # initial size of the veil, of the rms response
_LEAST_VEIL = 1e-3  # smallest size, of the first
_TOLD = 0.5  # number of photographs that tell their veil below which its size stays
_CONTRADICTED = 4.0  # standard deviations of χ² beyond which the errors of photographs are larger than expected
_BRIGHTEST = 0.25  # share of a paint's readings that is left out where highlights seem to clip
_PEAKS = 0.03  # share of them that are its brightest highlights
_AROUND, _NODES = 1.0, 33  # largest change of log μ without them, and number of values that are tried
_SEPARATE = 1e-10  # relative determinant below which β and μ cannot be separated
_NUDGE = 1e-3  # change of log β or log μ for numerical derivatives
_FLATTEST = 0.1  # smallest curvature of the sum of squares that is believed, relative to the normal matrix
_LEAST_PHOTOGRAPHS = 4  # fewest photographs for a jackknife


@dataclass(frozen=True)
class Contradiction:
    """Photographs whose errors of level and angles, as the gloss of paints tells them, are larger than expected.

    Parameters
    ----------
    times : float
        Errors found, in those expected (root mean square).
    left_out : str
        What is not part of the fit because of it, `HIGHLIGHTS`, `PHOTOGRAPH` or `NOTHING`.
    photograph : int
        Number of the photograph that contradicts most, from 0.
    """

    times: float
    left_out: str
    photograph: int

    def told(self, captures: Sequence[str]) -> dict:
        """Return the fields by name, with the name of the photograph among those of all."""
        return {"times": self.times, "left_out": self.left_out, "photograph": captures[self.photograph]}


class _Solution(NamedTuple):
    """Unknowns of all paints and photographs, and their covariance.

    ``log_gloss`` (paints, 2) has log β and log μ. In the covariance, paints come first. ``excess`` is the factor by
    which the squares of the photographs' errors exceed what is expected, at least 1; the covariance has it.
    """

    log_gloss: np.ndarray
    photographs: PhotographErrors
    covariance: np.ndarray
    excess: float


def _rms_response(surface: SearchedTexels) -> float:
    """Return the root mean square response of all observations."""
    part = sums.parts(surface, np.zeros((len(surface.blocks), 2)))
    return float(np.sqrt(part[:, sums.POWER].sum() / part[:, sums.TOTAL].sum()))


def _growth(veils: np.ndarray, variances: np.ndarray, least: float) -> float:
    """Return the factor on the expected size of the veil that makes it likelier, from ``least`` (or a tenth) to ten.

    The squares of the veils, in the expected size, should sum to the number of photographs that tell theirs (MacKay,
    *Neural Computation* 4, 1992).
    """
    told = float(np.sum(1.0 - variances))
    if told < _TOLD:
        return 1.0
    return min(max(float(np.sqrt(np.sum(veils**2) / told)), 0.1, least), 10.0)


def _contradiction(errors: np.ndarray, variances: np.ndarray) -> float:
    """Return the factor by which the squares of the photographs' errors exceed what is expected, at least 1.

    Of each kind of error, the squares should sum to the number of photographs that tell theirs. Far larger sums show
    that something else is wrong with the photographs. The size of the veil follows the photographs itself.
    """
    squares, told = np.sum(errors**2, axis=0), np.maximum(np.sum(1.0 - variances, axis=0), 0.0)
    beyond = squares > told + _CONTRADICTED * np.sqrt(2.0 * told)
    beyond[VEIL] = False
    return float(np.max(squares[beyond] / np.maximum(told[beyond], 1.0), initial=1.0))


def _joint(paints: list[SeparateGloss]) -> _Solution:
    """Search the most probable gloss of all paints and errors of all photographs by Newton's method.

    The differences of texels are eliminated as if they were small: the β of a paint is the mean of its texels' β, which
    exceeds that of log β by half the variance of log β.
    """
    count, photographs = len(paints), paints[0].surface.blocks.shape[2]
    first, size = 2 * count, 2 + photographs * SHARED
    place, errors = np.array([paint.log_gloss for paint in paints]), np.zeros((photographs, SHARED))
    veil = _FIRST_VEIL * float(np.mean([_rms_response(paint.surface) for paint in paints]))
    least = _LEAST_VEIL * veil
    for _ in range(_STEPS):
        matrix, down = np.zeros((first + size - 2,) * 2), np.zeros(first + size - 2)
        for number, paint in enumerate(paints):
            normal, slope = np.zeros((size, size)), np.zeros(size)
            apart, shared = paint.differences.over(paint.excess), PhotographErrors(errors, veil)
            sums.add_equations(paint.surface, place[number], apart, shared, normal, slope)
            here = np.r_[2 * number : 2 * number + 2, first : len(matrix)]
            matrix[np.ix_(here, here)] += (np.triu(normal) + np.triu(normal, 1).T) / paint.excess
            down[here] += slope / paint.excess
        matrix[first:, first:] += np.eye(size - 2)
        down[first:] -= errors.ravel()
        covariance = np.linalg.inv(matrix)
        step = covariance @ down
        step *= min(1.0, _LONGEST / max(np.abs(step[:first]).max(), 1e-300))
        place, errors = place + step[:first].reshape(-1, 2), errors + step[first:].reshape(-1, SHARED)
        growth = _growth(errors[:, VEIL], np.diag(covariance)[first:].reshape(-1, SHARED)[:, VEIL], least / veil)
        if np.abs(step[:first]).max() < _SETTLED and abs(np.log(growth)) < _STEADY:
            break
        veil, errors[:, VEIL] = veil * growth, errors[:, VEIL] / growth
    else:
        LOGGER.warning("the joint fit of gloss has not settled in %d steps; the last one counts", _STEPS)
    excess = _contradiction(errors, np.diag(covariance)[first:].reshape(-1, SHARED))
    return _Solution(place, PhotographErrors(errors, veil), excess * covariance, excess)


def _settled(paints: list[SeparateGloss]) -> tuple[list[SeparateGloss], _Solution]:
    """Fit all paints jointly, with gloss that varies within a paint as far as halves of the photographs confirm it.

    Errors of photographs look like gloss that varies, and the reverse. So the variation is estimated again after the
    errors that a fit has found are subtracted.
    """
    joint = _joint(paints)
    if not any(paint.varies for paint in paints):
        return paints, joint
    paints = [
        with_variation(paint, sums.without_errors(paint.surface, place, joint.photographs), place)
        for paint, place in zip(paints, joint.log_gloss, strict=True)
    ]
    return paints, _joint(paints) if any(paint.weighed for paint in paints) else joint


def _refitted(
    paints: list[SeparateGloss], surfaces: list[SearchedTexels], *, without_highlights: bool
) -> list[SeparateGloss]:
    """Return paints fitted to fewer readings; a paint whose gloss these do not determine stays as it is.

    So does one that shows a far wider lobe without its highlights, or a far narrower one: what is left of a mirror is
    the faint gleam around them.
    """
    near = np.linspace(-_AROUND, _AROUND, _NODES)
    out = []
    for paint, surface in zip(paints, surfaces, strict=True):
        found = separate_gloss(surface, paint.log_gloss[1] + near)
        if found is None or (without_highlights and abs(found.log_gloss[1] - paint.log_gloss[1]) > _AROUND):
            found = paint
        out.append(found)
    return out


def _are_too_dark(paints: list[SeparateGloss], dimmer: list[SeparateGloss], joint: _Solution) -> bool:
    """Return whether the readings that were left out are darker than the others say, as where they clip.

    If the lobe has another form than the fitted one, such as a longer tail, they are too bright, or at least the
    brightest of them: of two lobes, only the wider is seen without them. The errors of photographs, which the other
    readings tell, are subtracted; gloss that varies from place to place may explain the difference, too.

    Parameters
    ----------
    paints, dimmer : list of SeparateGloss
        Paints with all readings, and without their brightest ones.
    joint : _Solution
        Joint fit of ``dimmer``.
    """
    gains = [0.0]
    for paint, kept, place in zip(paints, dimmer, joint.log_gloss, strict=True):
        whole = paint.surface._replace(blocks=sums.without_errors(paint.surface, place, joint.photographs))
        for left_out in (_BRIGHTEST, _PEAKS) if kept.surface is not paint.surface else ():
            few = sums.without_brightest(whole, paint.log_gloss, left_out)
            gain, error = sums.left_out_gain(whole, few, place)
            if abs(gain) > _CONTRADICTED * np.hypot(error * np.sqrt(max(kept.excess, 1.0)), kept.differences.of_mean):
                gains.append(gain)
    return -min(gains) > max(gains)


def _consistent(paints: list[SeparateGloss]) -> tuple[list[SeparateGloss], _Solution, Contradiction | None]:
    """Return paints and their joint solution, without those readings that seem to contradict all others.

    A photograph with a wrong pose has errors far larger than expected. Highlights that clip without a flag look like
    lamps and angles that are far off in several photographs. Each is told by what the other readings say: without a
    wrong photograph, or without the brightest readings, the errors of photographs have their expected sizes.
    """
    paints, joint = _settled(paints)
    if joint.excess == 1.0:
        return paints, joint, None
    worst = int(np.argmax(np.sum(np.delete(joint.photographs.sizes, VEIL, axis=1) ** 2, axis=1)))
    times = float(np.sqrt(joint.excess))
    dim = [sums.without_brightest(paint.surface, paint.log_gloss, _BRIGHTEST) for paint in paints]
    dimmer = _refitted(paints, dim, without_highlights=True)
    dimmer, other = _settled(dimmer)
    if other.excess == 1.0 and _are_too_dark(paints, dimmer, other):
        return dimmer, other, Contradiction(times, HIGHLIGHTS, worst)
    fewer = [sums.without_photographs(paint.surface, worst) for paint in paints]
    others = _refitted(paints, fewer, without_highlights=False)
    others, other = _settled(others)
    if other.excess == 1.0:
        return others, other, Contradiction(times, PHOTOGRAPH, worst)
    return paints, joint, Contradiction(times, NOTHING, worst)


def _stretch(surface: SearchedTexels, place: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return how far log β and log μ really move when a Gauss-Newton step says how far, (2, 2).

    The two agree if the lobe has the right form. The residuals of another form change with the parameters, which the
    normal matrix ignores: the minimum is then flatter.

    Parameters
    ----------
    surface : SearchedTexels
    place : (2,) float64
        log β and log μ.
    normal : (2, 2) float64
        Normal matrix of all texels there.
    """
    inverse = np.linalg.inv(np.linalg.cholesky(normal))
    moved = np.empty((2, 2))
    for number, step in enumerate(_NUDGE * np.eye(2)):
        down = [
            matrices(sums.parts(surface, np.tile(place + side * step, (len(surface.blocks), 1))))[0].sum(axis=0)
            for side in (-1.0, 1.0)
        ]
        moved[:, number] = (down[0] - down[1]) / (2.0 * _NUDGE)
    size, along = np.linalg.eigh(inverse @ (0.5 * (moved + moved.T)) @ inverse.T)
    axes = inverse.T @ along
    return axes / np.clip(size, _FLATTEST, 1.0) @ axes.T @ normal


def _of_photographs(surface: SearchedTexels, place: np.ndarray, stretch: np.ndarray) -> np.ndarray:
    """Return the covariance of log β and log μ by the jackknife over photographs, (2, 2).

    It tells what neither the errors of photographs nor those of texels describe, such as a lobe of another form; gloss
    that varies from place to place is in it again. Zero if there are too few photographs. ``stretch`` is from
    `_stretch`.
    """
    moved, told = sums.without_each(surface, place)
    moved = moved @ stretch.T
    count = int(told.sum())
    if count < _LEAST_PHOTOGRAPHS:
        return np.zeros((2, 2))
    apart = moved[told] - moved[told].mean(axis=0)
    return (count - 1) / count * apart.T @ apart


def _larger(expected: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the smallest covariance that is in every direction at least as large as both of the given ones."""
    root = np.linalg.cholesky(expected)
    inverse = np.linalg.inv(root)
    size, along = np.linalg.eigh(inverse @ seen @ inverse.T)
    axes = root @ along
    return axes * np.maximum(size, 1.0) @ axes.T


def _with_error(paint: SeparateGloss, place, covariance, photographs: PhotographErrors) -> PaintGloss | None:
    """Return the gloss of a paint with its errors; None if they are too large, or if it is beyond its bounds."""
    surface, rules = paint.surface, paint.surface.rules
    if not (rules.low_log_mu < place[1] < rules.high_log_mu and place[0] < np.log(rules.high_beta)):
        return None
    surface = surface._replace(blocks=sums.without_errors(surface, place, photographs))
    slope, normal = matrices(sums.parts(surface, np.tile(place, (len(surface.blocks), 1))))
    total = normal.sum(axis=0)
    if not np.linalg.det(total) > _SEPARATE * total[0, 0] * total[1, 1]:
        return None
    inverse, stretch = np.linalg.inv(total), _stretch(surface, place, total)
    spread = inverse @ np.einsum("tij,jk,tkl->il", normal, paint.scatter + paint.unweighed, normal) @ inverse
    of_texels = stretch @ inverse @ slope.T @ slope @ inverse @ stretch.T
    error = _larger(_larger(covariance + spread, of_texels), _of_photographs(surface, place, stretch))
    error += np.diag([rules.level_error**2, 0.0])
    known = np.sqrt(error[0, 0]) < MAX_RELATIVE_ERROR["beta"] and np.sqrt(error[1, 1]) < MAX_RELATIVE_ERROR["mu"]
    return PaintGloss(place, error, paint.varying, paint.excess, len(surface.blocks), paint.scatter) if known else None


def gloss_of_paints(
    surfaces: Sequence[SearchedTexels | None], nodes: np.ndarray, *, checked: bool = True
) -> tuple[list[PaintGloss | None], Contradiction | None]:
    """Fit the gloss of all paints of an object.

    Parameters
    ----------
    surfaces : sequence of SearchedTexels or None
        Texels of each paint, all of the same photographs; None for a paint without texels.
    nodes : (nodes,) float
        Values of log μ for the initial scan.
    checked : bool
        Whether photographs that contradict the gloss are searched for, and gloss that varies is part of the fit.
        Neither can be told if angles or noise are unknown.

    Returns
    -------
    gloss : list of PaintGloss or None
        None for a paint whose texels show no gloss, or do not determine it.
    contradiction : Contradiction or None
        None if there is none, or if it was not searched for.
    """
    found = [None if surface is None else separate_gloss(surface, nodes, weighed=checked) for surface in surfaces]
    paints = [paint for paint in found if paint is not None]
    if not paints:
        return [None] * len(found), None
    paints, joint, contradiction = _consistent(paints) if checked else (*_settled(paints), None)
    covariances = (joint.covariance[first : first + 2, first : first + 2] for first in range(0, 2 * len(paints), 2))
    glosses = iter(
        [
            _with_error(paint, place, covariance, joint.photographs)
            for paint, place, covariance in zip(paints, joint.log_gloss, covariances, strict=True)
        ]
    )
    return [None if paint is None else next(glosses) for paint in found], contradiction
