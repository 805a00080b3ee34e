"""Photometric stereo: normals and diffuse weights of a surface of unknown shape, from photographs under several lamps.

The camera stays where it is, and each photograph shows the surface under another distant lamp. In every photograph that
lights it, a matt place has the response b · E, where E is the direction to the lamp times the lamp's level, and b the
normal times the diffuse weight. Three photographs determine b; the others check it. Shadows and highlights are
outliers: the search begins with the three photographs with which most others agree, and continues with weighted least
squares.

References
----------
R. J. Woodham, "Photometric method for determining surface orientation from multiple images", Optical Engineering
19(1), 1980.
S. Geman and D. E. McClure, "Statistical methods for tomographic image reconstruction", Bulletin of the International
Statistical Institute 52(4), 1987 (the bounded loss r² / (r² + s²)).
H. Hayakawa, "Photometric stereo under a light source with arbitrary motion", Journal of the Optical Society of America
A 11(11), 1994 (the matrix that unknown lamps leave open).
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np

from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit

#: cosθ_i below which a response is not used: near the terminator, errors of the lamp's size and of the shape dominate.
LEAST_COSINE = 0.2
#: Standard deviation of the logarithm of a lamp's level that nobody measured.
LEVEL_ERROR = 0.1
#: Number of photographs that have to agree at a place. Nothing would check three.
FEWEST = 4
#: Most sets of three photographs that are tried at each place.
_TRIPLES = 150
#: Misfit of a response, relative to the diffuse weight, that is assumed at first, and at least.
_FIRST_MISFIT, _LEAST_MISFIT = 0.05, 0.003
#: Rounds of weighted least squares at a place.
_STEPS = 6
#: Misfit, in units of the expected one, at which the weight of a response is a quarter.
QUARTER = 2.5
#: Weight above which a response agrees with the model.
AGREES = 0.25
_CHUNK = 512


class Facets(NamedTuple):
    """Normals and diffuse weights of T places.

    Parameters
    ----------
    normal : (T, 3) float64
        Unit vectors: x to the right, y up, z to the camera. NaN where fewer than four photographs agree.
    alpha : (T,) float64
        Diffuse weight: matt response under a lamp of level 1 straight above the place.
    weight : (T, J) float64
        Share from 0 to 1 with which each response counts; 0 where the light falls at more than 78 degrees, and almost 0
        in shadows and highlights.
    misfit : float
        Typical difference of a response from the model, relative to ``alpha``.
    """

    normal: np.ndarray
    alpha: np.ndarray
    weight: np.ndarray
    misfit: float

    @property
    def told(self) -> np.ndarray:
        """Places with a normal, (T,) bool."""
        return np.isfinite(self.alpha)

    @property
    def agreeing(self) -> np.ndarray:
        """Number of photographs that agree at each place, (T,) int."""
        return np.count_nonzero(self.weight > AGREES, axis=1)

    def normal_error_deg(self, light) -> np.ndarray:
        """Return the standard error of each normal in degrees, (T,), from misfit and lamps (J, 3): root mean square."""
        matrix = np.einsum("tj,ja,jb->tab", self.weight, light, light)
        matrix[~self.told] = np.eye(3)
        spread = np.linalg.inv(matrix)
        across = np.trace(spread, axis1=1, axis2=2) - np.einsum("ta,tab,tb->t", self.normal, spread, self.normal)
        return np.degrees(self.misfit * np.sqrt(across))


class _Task(NamedTuple):
    """Arrays of the fit of T places in J photographs with M sets of three lamps."""

    response: np.ndarray  # (T, J)
    usable: np.ndarray  # (T, J)
    light: np.ndarray  # (J, 3)
    triples: np.ndarray  # (M, 3)
    inverses: np.ndarray  # (M, 3, 3)
    found: np.ndarray  # output: normals times diffuse weights, (T, 3)
    weight: np.ndarray  # output, (T, J)


def fit_facets(response, usable, light, *, misfit: float | None = None) -> Facets:
    """Fit the normal and the diffuse weight of every place.

    Parameters
    ----------
    response : (T, J) float
        Responses of T places in J photographs, proportional to the light.
    usable : (T, J) bool
        False for responses that are clipped or left out.
    light : (J, 3) float
        Directions to the lamps times their levels.
    misfit : float, optional
        Typical difference of a response from the model, relative to the diffuse weight; found from the data if absent.
    """
    matt = np.ascontiguousarray(response, dtype=np.float64)
    light = np.ascontiguousarray(light, dtype=np.float64)
    usable = np.ascontiguousarray(usable, dtype=np.bool_)
    triples, inverses = _triples(light)
    places, count = matt.shape
    found, weight = np.empty((places, 3)), np.empty((places, count))

    task = _Task(matt, usable, light, triples, inverses, found, weight)

    def fit(expected: float) -> np.ndarray:
        run_chunks(_fit_places, places, _CHUNK, task, expected)
        return np.linalg.norm(found, axis=1)

    if misfit is None:
        misfit = _FIRST_MISFIT
        for _ in range(2):
            alpha = fit(misfit)
            misfit = misfit_of((matt - found @ light.T) / alpha[:, None], weight > AGREES)
    alpha = fit(misfit)
    return Facets(found / alpha[:, None], alpha, weight, misfit)


def misfit_of(left: np.ndarray, used: np.ndarray) -> float:
    """Return the typical relative difference of responses from a model, from those used, (T, J) bool."""
    if not used.any():
        return _FIRST_MISFIT
    # Of the responses of a place, three are used up by its normal and its weight.
    free = max(1.0 - 3.0 * float(used.any(axis=1).sum()) / float(used.sum()), 0.1)
    return max(1.4826 * float(np.median(np.abs(left[used]))) / np.sqrt(free), _LEAST_MISFIT)


def _triples(light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return sets of three lamps (M, 3) that determine normals well, and the inverses of their matrices (M, 3, 3).

    Raises
    ------
    ValueError
        If the lamps stand in one plane with the object.
    """
    generator = np.random.default_rng(11)
    several = np.array(list(combinations(range(len(light)), 3)))
    if len(several) > 20 * _TRIPLES:
        several = several[generator.choice(len(several), 20 * _TRIPLES, replace=False)]
    volume = np.abs(np.linalg.det(light[several]))
    several = several[(volume >= np.median(volume)) & (volume > 1e-4)]
    if not len(several):
        raise ValueError("lamps in one plane with the object; accepted: lamps on several sides")
    if len(several) > _TRIPLES:
        several = several[np.sort(generator.choice(len(several), _TRIPLES, replace=False))]
    return several, np.linalg.inv(light[several])


@njit(cache=True, nogil=True, error_model="numpy")
def _best_triple(task, at, misfit):
    """Return b of the three photographs with which most others agree, and whether there are such."""
    y, able, light, triples, inverses = task.response[at], task.usable[at], task.light, task.triples, task.inverses
    best, b0, b1, b2 = np.inf, 0.0, 0.0, 0.0
    for m in range(len(triples)):
        i, j, k = triples[m]
        if not (able[i] and able[j] and able[k]):
            continue
        inverse = inverses[m]
        x0 = inverse[0, 0] * y[i] + inverse[0, 1] * y[j] + inverse[0, 2] * y[k]
        x1 = inverse[1, 0] * y[i] + inverse[1, 1] * y[j] + inverse[1, 2] * y[k]
        x2 = inverse[2, 0] * y[i] + inverse[2, 1] * y[j] + inverse[2, 2] * y[k]
        if x2 <= 0.0:  # turned away from the camera
            continue
        square = misfit * misfit * (x0 * x0 + x1 * x1 + x2 * x2)
        cost = 0.0
        for n in range(len(light)):
            if able[n]:
                left = y[n] - max(x0 * light[n, 0] + x1 * light[n, 1] + x2 * light[n, 2], 0.0)
                cost += left * left / (left * left + square)
        if cost < best:
            best, b0, b1, b2 = cost, x0, x1, x2
    return best < np.inf, b0, b1, b2


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_places(task, misfit, first, last):
    light, found, weight = task.light, task.found, task.weight
    count = len(light)
    length = np.sqrt((light * light).sum(axis=1))
    for at in range(first, last):
        y, able = task.response[at], task.usable[at]
        good, b0, b1, b2 = _best_triple(task, at, misfit)
        agree = 0
        for _ in range(_STEPS if good else 0):
            alpha = np.sqrt(b0 * b0 + b1 * b1 + b2 * b2)
            square = (QUARTER * misfit * alpha) ** 2
            a00, a01, a02, a11, a12, a22, r0, r1, r2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            agree = 0
            for n in range(count):
                weight[at, n] = 0.0
                e0, e1, e2 = light[n, 0], light[n, 1], light[n, 2]
                shown = b0 * e0 + b1 * e1 + b2 * e2
                if not able[n] or shown < LEAST_COSINE * alpha * length[n]:
                    continue
                left = y[n] - shown
                w = (square / (square + left * left)) ** 2
                agree += w > AGREES
                weight[at, n] = w
                a00 += w * e0 * e0
                a01 += w * e0 * e1
                a02 += w * e0 * e2
                a11 += w * e1 * e1
                a12 += w * e1 * e2
                a22 += w * e2 * e2
                r0 += w * e0 * y[n]
                r1 += w * e1 * y[n]
                r2 += w * e2 * y[n]
            c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
            c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
            det = a00 * c00 + a01 * c01 + a02 * c02
            good = agree >= FEWEST and det > 1e-12
            if not good:
                break
            b0 = (c00 * r0 + c01 * r1 + c02 * r2) / det
            b1 = (c01 * r0 + c11 * r1 + c12 * r2) / det
            b2 = (c02 * r0 + c12 * r1 + c22 * r2) / det
        if good and b2 > 0.0:
            found[at, 0], found[at, 1], found[at, 2] = b0, b1, b2
        else:
            found[at] = np.nan
            weight[at] = 0.0


def refine_lamps(response, facets: Facets, known, level, *, error_deg: float, level_error: float) -> np.ndarray:
    """Estimate levels and directions of the lamps of J photographs from the normals of a surface.

    If all lamps are multiplied by a matrix of 3 x 3 numbers and all b by its inverse, the responses stay the same. Of
    all such sets of lamps, the one nearest to the known levels and directions is returned.

    Parameters
    ----------
    response : (T, J) float
        Matt part of the responses.
    facets : Facets
        Fitted under the lamps as estimated so far.
    known : (J, 3) float
        Unit vectors to the lamps as known beforehand.
    level : (J,) float
        Levels of the lamps as known beforehand.
    error_deg : float
        Standard deviation of these directions, degrees; 0 if they are exact.
    level_error : float
        Standard deviation of the logarithms of these levels.

    Returns
    -------
    (J, 3) float64
        Directions times levels, whose geometric mean is 1.
    """
    alpha = facets.alpha[facets.told, None]
    # Misfits are relative to the diffuse weight, so that dark and bright places count alike.
    b, weight, real = alpha * facets.normal[facets.told], facets.weight[facets.told] / alpha**2, response[facets.told]
    light = np.empty(np.shape(known))
    for at, share in enumerate(weight.T):
        if error_deg:
            light[at] = np.linalg.solve((share * b.T) @ b, (share * b.T) @ real[:, at])
        else:
            shown = b @ known[at]
            light[at] = known[at] * ((share * shown) @ real[:, at]) / ((share * shown) @ shown)
    if error_deg:
        light = _nearest(light, known, level, error_deg, level_error)
    return light / np.exp(np.log(np.linalg.norm(light, axis=1)).mean())


def _nearest(light, known, level, error_deg: float, level_error: float) -> np.ndarray:
    """Return lamps (J, 3) multiplied by the matrix that brings them nearest to the known ones."""
    from scipy.optimize import least_squares  # slow to import

    def residuals(x: np.ndarray) -> np.ndarray:
        moved = light @ x.reshape(3, 3)
        length = np.linalg.norm(moved, axis=1)
        beside = (moved / length[:, None] - known) / np.radians(error_deg)
        return np.append(beside.ravel(), np.log(length / level) / level_error)

    return light @ least_squares(residuals, np.eye(3).ravel(), x_scale="jac").x.reshape(3, 3)
