"""Level of the lamp in every photograph, estimated jointly with the materials of texels.

If most texels are brighter in one photograph than their fitted models predict, the lamp was brighter in it. The
estimate is a linear least-squares step from the fitted texels, repeated a few times. Its unknowns are α, β and μ of
every texel, which are eliminated, and the levels of the photographs. Other possible errors are unknowns too, each with
a prior of its expected size, so that they are not mistaken for changes of the lamp:

* the directions of light and camera in every photograph, within the error of the angles;
* the strength of the gloss in every photograph;
* a lobe of any form, a function of φ that all texels add to their own: on a flat object, a lobe with a longer tail than
  the fitted one brightens the photographs near the highlight as a lamp would;
* a departure of the diffuse light from Lambert's law, a function of θ plus the same one of θ_r.

On a flat object, all texels of a photograph have nearly the same angles. Its levels can then hardly be distinguished
from the last two errors, and their standard errors are large. A factor common to all photographs cannot be
distinguished from α; the mean of the levels is therefore 1.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from irodori.fitting.solvers import FitOptions, fit
from irodori.fitting.texel_sample import Readings
from irodori.material.material_file import Status
from irodori.reflection.fresnel import fresnel_array
from irodori.reflection.lobe_arrays import evaluate, evaluate_with_derivatives

#: Texels that an estimate takes at most; it costs some 0.1 ms of processor time for each.
MOST_TEXELS = 1000
_FEWEST_TEXELS = 50
_FEWEST_OBSERVATIONS = 5  # of a texel: its three unknowns and two to spare
_STEPS = 2
_LARGEST_ANGLE_RAD = np.radians(70.0)  # beyond it, rough surfaces depart furthest from Lambert's law
_MOST_CONTRADICTED = 0.25  # share of texels beyond which the model is not that of the surface
_OWN_ERROR = 0.005  # relative, of an observation of one texel: texture, places between samples
_STRAY = 0.003  # of α: stray light
_GLOSS_ERROR = 0.05  # relative, of one texel's gloss in an observation
_SHARED_GLOSS_ERROR = 0.1  # relative, of all texels' gloss in a photograph
_OTHER_LOBE = 0.3  # of the median α: β of the lobe of any form
_DEPARTURE = 0.03  # from Lambert's law, relative
_PHI_NODES_RAD = np.array([0.0, 0.04, 0.08, 0.13, 0.2, 0.28, 0.38, 0.5, 0.7, 1.0, 1.5])
_THETA_NODES_RAD = np.radians([0.0, 25.0, 40.0, 55.0, 70.0])
_EVEN = 1e3  # roughness of a lobe that is 1 everywhere
_TURN_RAD = 2e-4  # of a numerical derivative
_OUTLIER = 3.0  # standard deviations beyond which a reading counts for less
_KNOWN = 1.0 / 3.0  # of the prior standard deviation: a level that is known no better is none
_REGULAR = 1e-9
_LEAST_VARIANCE = 1e-12
_OF_ALPHA = 0.01  # relative error of an observation that tells α


@dataclass(frozen=True)
class EstimatedLevels:
    """Levels of photographs, their standard errors, (J,) each, and the texels from which they were estimated."""

    level: np.ndarray
    error: np.ndarray
    texels: int


class DescribedTexels(NamedTuple):
    """Texels used for the estimate: readings divided by the present levels, their weights, and the fitted gloss."""

    readings: Readings
    chosen: np.ndarray  # (all texels,) bool, which of the texels these are
    seen: np.ndarray  # (texels, J) bool
    lobes: tuple[str, ...]
    gloss: np.ndarray  # (texels, 2 components) β and μ of each

    def gloss_at(self, geometry: np.ndarray) -> np.ndarray:
        """Return the gloss term of the reflection model, (texels, J)."""
        total = np.zeros(geometry.shape[:-1])
        for component, name in enumerate(self.lobes):
            beta, mu = self.gloss[:, 2 * component, None], self.gloss[:, 2 * component + 1, None]
            total += beta * evaluate(name, mu, geometry)
        return total * self.fresnel(geometry)

    def fresnel(self, geometry: np.ndarray) -> np.ndarray:
        """Return the Fresnel reflectance, (texels, J)."""
        return fresnel_array(np.cos(geometry[..., 2]), self.readings.n, self.readings.k)


class _Model(NamedTuple):
    """The fitted model at the observations, (texels, J) each but the first and the last."""

    alpha: np.ndarray  # (texels, 1)
    cosine: np.ndarray
    gloss: np.ndarray
    slopes: np.ndarray  # (texels, J, unknowns of a texel) by α and, of each component, by β and ln μ


def turned(geometry: np.ndarray, angle_rad: float, *, light: bool) -> np.ndarray:
    """Return θ_i, θ_r, θ_H, φ after the light, or the camera, has moved towards the other in the plane of both.

    Parameters
    ----------
    geometry : (..., 4) float
        In rad. Where light and camera stand in one direction, there is no plane, and θ_i and θ_r stay.
    angle_rad : float
        Negative away from each other.
    light : bool
        Whether the light moves, else the camera.
    """
    own, other = (0, 1) if light else (1, 0)
    cosine, far = np.cos(geometry[..., own]), np.cos(geometry[..., other])
    apart = 2.0 * geometry[..., 2]
    has_plane = np.sin(apart) > 1e-6
    sine = np.where(has_plane, np.sin(apart), 1.0)
    across = np.where(has_plane, (far - cosine * np.cos(apart)) / sine, 0.0)
    # The half-way vector moves half as far, along the difference of the two directions.
    along = np.where(has_plane, (far - cosine) / np.maximum(2.0 * np.sin(geometry[..., 2]), 1e-9), 0.0)
    half, moved = 0.5 * angle_rad, np.array(geometry, dtype=np.float64)
    moved[..., own] = np.arccos(np.clip(cosine * np.cos(angle_rad) + across * np.sin(angle_rad), -1.0, 1.0))
    moved[..., 2] = np.abs(geometry[..., 2] - half)
    moved[..., 3] = np.arccos(np.clip(np.cos(geometry[..., 3]) * np.cos(half) + along * np.sin(half), -1.0, 1.0))
    return moved


def _tents(values: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Return piecewise linear basis functions, each 1 at its node and 0 at the others, (..., nodes)."""
    return np.stack([np.interp(values, nodes, one) for one in np.eye(len(nodes))], axis=-1)


def _variance(readings: Readings, response: np.ndarray, relative: float) -> np.ndarray:
    """Return the variance of responses due to noise, if known, and to a relative error."""
    noise = np.nan_to_num(np.asarray(readings.noise, dtype=np.float64))
    return noise[:, 0] + noise[:, 1] * np.maximum(response, 0.0) + (relative * response) ** 2 + _LEAST_VARIANCE


def _modelled(texels: DescribedTexels) -> _Model:
    """Return the fitted model with the least-squares α of the observations."""
    readings, seen = texels.readings, texels.seen
    cosine, fresnel = readings.diffuse(readings.geometry), texels.fresnel(readings.geometry)
    gloss, slopes = np.zeros_like(cosine), [cosine]
    for component, name in enumerate(texels.lobes):
        beta, mu = texels.gloss[:, 2 * component, None], texels.gloss[:, 2 * component + 1, None]
        value, by_mu, _ = fresnel * evaluate_with_derivatives(name, mu, readings.geometry)
        gloss += beta * value
        slopes += [np.where(beta > 0.0, value, 0.0), beta * by_mu]
    weight = np.where(seen, 1.0 / _variance(readings, readings.response, _OF_ALPHA), 0.0)
    power = (weight * cosine**2).sum(axis=1, keepdims=True)
    rest = np.where(seen, weight * cosine * (readings.response - gloss), 0.0).sum(axis=1, keepdims=True)
    alpha = np.maximum(rest / np.where(power > 0.0, power, 1.0), 0.0)
    return _Model(alpha, cosine, gloss, np.stack(slopes, axis=-1))


def _of_photographs(texels: DescribedTexels, model: _Model, options: FitOptions) -> np.ndarray:
    """Return each photograph's derivatives by its own unknowns, per prior standard deviation, (texels, J, unknowns)."""
    response, geometry = model.alpha * model.cosine + model.gloss, texels.readings.geometry
    changes = [options.model_error * response, _SHARED_GLOSS_ERROR * model.gloss]
    for light in (True, False):
        sides = []
        for angle in (_TURN_RAD, -_TURN_RAD):
            moved = turned(geometry, angle, light=light)
            sides.append(model.alpha * texels.readings.diffuse(moved) + texels.gloss_at(moved))
        changes.append((sides[0] - sides[1]) * (np.radians(options.angles.rig_deg) / (2.0 * _TURN_RAD)))
    return np.stack(changes, axis=-1)


def _of_all(texels: DescribedTexels, model: _Model) -> np.ndarray:
    """Return derivatives by unknowns common to all photographs, per prior standard deviation, (texels, J, unknowns)."""
    geometry = texels.readings.geometry
    even = evaluate("gaussian", _EVEN, geometry) * texels.fresnel(geometry)
    lobe = _OTHER_LOBE * np.median(model.alpha) * even[..., None] * _tents(geometry[..., 3], _PHI_NODES_RAD)
    law = _tents(geometry[..., 0], _THETA_NODES_RAD) + _tents(geometry[..., 1], _THETA_NODES_RAD)
    diffuse = _DEPARTURE * (model.alpha * model.cosine)[..., None] * law[..., 1:]
    return np.concatenate([lobe, diffuse], axis=-1)


def predict(texels: DescribedTexels, geometry: np.ndarray) -> np.ndarray:
    """Return the responses of the fitted texels under other angles, (texels, J) of (texels, J, 4)."""
    return _modelled(texels).alpha * texels.readings.diffuse(geometry) + texels.gloss_at(geometry)


class _Equations(NamedTuple):
    """Normal equations of the unknowns of single and of all photographs; the unknowns of texels are eliminated.

    ``matrix`` (Q, Q) and ``slope`` (Q,); ``onto`` (texels, Q, u), by which the texels' own unknowns follow; ``inverse``
    (texels, u, u) and ``own`` (texels, u), their normal equations.
    """

    matrix: np.ndarray
    slope: np.ndarray
    onto: np.ndarray
    inverse: np.ndarray
    own: np.ndarray


def _equations(weight, residual, slopes, single, shared) -> _Equations:
    """Assemble the normal equations from weights and residuals, (texels, J), and derivatives, (texels, J, unknowns)."""
    texels, captures, each = single.shape
    weighted = weight[..., None] * slopes
    normal = np.einsum("tju,tjv->tuv", weighted, slopes, optimize=True)
    size = _REGULAR * np.trace(normal, axis1=1, axis2=2) + np.finfo(float).tiny
    inverse = np.linalg.inv(normal + size[:, None, None] * np.eye(normal.shape[1]))
    of_single = np.einsum("tju,tjp->tjpu", weighted, single, optimize=True).reshape(texels, captures * each, -1)
    onto = np.concatenate([of_single, np.einsum("tju,tjq->tqu", weighted, shared, optimize=True)], axis=1)
    count, first = onto.shape[1], captures * each
    matrix = np.zeros((count, count))
    blocks = np.einsum("tj,tjp,tjq->jpq", weight, single, single, optimize=True)
    for j in range(captures):
        here = slice(j * each, (j + 1) * each)
        matrix[here, here] = blocks[j]
    crossed = weight[..., None] * single
    matrix[:first, first:] = np.einsum("tjp,tjq->jpq", crossed, shared, optimize=True).reshape(first, -1)
    matrix[first:, :first] = matrix[:first, first:].T
    matrix[first:, first:] = np.einsum("tj,tjp,tjq->pq", weight, shared, shared, optimize=True)
    root = np.einsum("tqu,tuv->tvq", onto, np.linalg.cholesky(inverse), optimize=True).reshape(-1, count)
    matrix -= root.T @ root
    left = weight * residual
    own = np.einsum("tj,tju->tu", left, slopes, optimize=True)
    slope = np.concatenate(
        [np.einsum("tj,tjp->jp", left, single).ravel(), np.einsum("tj,tjq->q", left, shared, optimize=True)]
    )
    slope -= np.einsum("tqu,tuv,tv->q", onto, inverse, own, optimize=True)
    return _Equations(matrix, slope, onto, inverse, own)


def estimate_levels(readings: Readings, options: FitOptions) -> EstimatedLevels | None:
    """Return the levels of photographs, mean 1; None where the data do not determine them.

    The result is None if fewer than fifty texels with five observations fit the model, if the observations of more than
    a quarter of the texels contradict it, or if the standard errors of the levels are not below a third of
    ``model_error``.

    Parameters
    ----------
    readings : Readings
    options : FitOptions
        ``model_error`` is the standard deviation of a level before the estimate, ``angles`` tells that of an angle.
    """
    if not options.model_error > 0.0:
        return None  # levels that cannot differ
    readings = replace(readings, geometry=np.asarray(readings.geometry, dtype=np.float64))
    level, error, told = np.ones(readings.response.shape[1]), np.empty(0), 0
    for _ in range(_STEPS):
        texels = describe(readings, options, level)
        if texels is None:
            return None
        level, error, *_ = adjust(texels, options, level)
        told = len(texels.seen)
    if np.sqrt(np.mean(error**2)) > _KNOWN * options.model_error:
        return None
    return EstimatedLevels(level, error, told)


def describe(readings: Readings, options: FitOptions, level: np.ndarray) -> DescribedTexels | None:
    """Return the texels that fit the model under these levels; None if they are too few."""
    dtype = readings.response.dtype
    under = (readings.response / level).astype(dtype)
    found = fit(
        under, readings.geometry.astype(dtype), readings.weight, readings.n, readings.k, options, noise=readings.noise
    )
    frontal = (readings.geometry[..., :2] < _LARGEST_ANGLE_RAD).all(axis=-1)
    seen = (readings.weight > 0.0) & np.isfinite(under) & frontal
    enough = seen.sum(axis=1) >= _FEWEST_OBSERVATIONS
    contradicted = (found.status == Status.CONTRADICTED)[enough]
    described = enough & np.isin(found.status, (Status.OK, Status.DIFFUSE_ONLY))
    if described.sum() < _FEWEST_TEXELS or contradicted.mean() > _MOST_CONTRADICTED:
        return None
    response = np.where(seen, under, 0.0)[described].astype(np.float64)
    weight, geometry = readings.weight[described], readings.geometry[described]
    chosen = replace(readings, response=response, weight=weight, geometry=geometry)
    return DescribedTexels(chosen, described, seen[described], found.lobes, found.gloss[described])


class Adjusted(NamedTuple):
    """Levels of the photographs and values of further unknowns after a step, each with standard errors."""

    level: np.ndarray
    level_error: np.ndarray
    further: np.ndarray
    further_error: np.ndarray


def adjust(texels: DescribedTexels, options: FitOptions, level: np.ndarray, slopes=None, further=()) -> Adjusted:
    """Take one step towards the levels of photographs and further unknowns that all photographs share.

    Parameters
    ----------
    texels : DescribedTexels
    options : FitOptions
    level : (J,) float
        Present levels, by which the readings have been divided.
    slopes : (texels, J, q) float, optional
        Derivatives of the readings by the further unknowns, each in units of its standard deviation before the step.
    further : (q,) float
        Present values of the further unknowns in these units, with which the readings have been modelled.
    """
    model, readings = _modelled(texels), texels.readings
    fitted = model.alpha * model.cosine + model.gloss
    variance = _variance(readings, fitted, _OWN_ERROR) + (_GLOSS_ERROR * model.gloss) ** 2 + (_STRAY * model.alpha) ** 2
    weight, residual = np.where(texels.seen, 1.0 / variance, 0.0), readings.response - fitted
    single, shared = _of_photographs(texels, model, options), _of_all(texels, model)
    if slopes is not None:
        shared = np.concatenate([shared, slopes], axis=-1)
    captures, each = single.shape[1:]
    first = captures * each
    offset = np.zeros(first + shared.shape[2])
    offset[:first:each] = (level - 1.0) / options.model_error
    own = slice(len(offset) - len(further), None)
    offset[own] = further
    weight = _without_outliers(weight, residual, model.slopes, single, shared, offset=offset)
    equations = _equations(weight, residual, model.slopes, single, shared)
    covariance = np.linalg.inv(equations.matrix + np.eye(len(offset)))
    solution = covariance @ (equations.slope - offset)
    level = level * (1.0 + options.model_error * solution[:first:each])
    # Of the levels less their mean, which is another unknown.
    among = options.model_error**2 * covariance[:first:each, :first:each]
    centred = np.eye(captures) - 1.0 / captures
    error = np.sqrt(np.diag(centred @ among @ centred.T))
    return Adjusted(level / level.mean(), error, offset[own] + solution[own], np.sqrt(np.diag(covariance)[own]))


def _without_outliers(weight, residual, slopes, single, shared, *, offset) -> np.ndarray:
    """Return weights reduced by Huber's rule for readings with large residuals."""
    equations = _equations(weight, residual, slopes, single, shared)
    solution = np.linalg.solve(equations.matrix + np.eye(len(offset)), equations.slope - offset)
    texels, captures, each = single.shape
    first = captures * each
    own = equations.own - np.einsum("tqu,q->tu", equations.onto, solution)
    own = np.einsum("tuv,tv->tu", equations.inverse, own)
    left = residual - np.einsum("tju,tu->tj", slopes, own) - shared @ solution[first:]
    left -= np.einsum("tjp,jp->tj", single, solution[:first].reshape(captures, each))
    size = np.abs(left) * np.sqrt(weight)
    free = max(int((weight > 0.0).sum()) - slopes.shape[2] * texels, 1)
    far = _OUTLIER * np.sqrt(max(float((size**2).sum()) / free, 1.0))
    return weight * np.where(size > far, far / np.maximum(size, far), 1.0)
