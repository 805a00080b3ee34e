"""Estimators of reflectance from responses, behind one interface and one registry.

``ESTIMATORS[name](training)`` returns a mapping from responses to spectra (61); `fit` projects it on a basis. All have
closed forms, are deterministic and positively homogeneous of degree 1: twice the response yields twice the spectrum.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from irodori.calibration.conditioning import MAX_CONDITION
from irodori.calibration.paper_estimator import calibrate, spectral_basis
from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.recovery.mappings import (
    LinearMapping,
    LocalMapping,
    Mapping,
    PolynomialMapping,
    polynomial_count,
)
from irodori.calibration.response_model import smooth_covariance
from irodori.calibration.training import Population, Training

_RIDGES = 10.0 ** np.arange(-12.0, 0.5, 0.5)  # of the mean square of a scaled band
_FLOOR = 1e-12  # of a moment matrix's trace, added to its diagonal against rounding
_SMOOTH_SHARE = 0.02  # of the patches' level: standard deviation of the smooth prior added to their second moment
_WIDTH = 0.1  # of the neighbourhood in the directions of the scaled responses (chord)
_BACKGROUND = 0.002  # share of closeness that every member keeps, however far
_ANCHORS = 48  # at most
_LEVELS = 7  # of relative noise variance, one a factor 10
_SPREAD = 20.0  # how much of the relative noise variance adds to the squared width
_POLYNOMIAL_RIDGE = 1e-5  # of the mean moment, for non-linear monomials, in addition to noise and uncertainty


def pinv(training: Training) -> LinearMapping:
    """Return the mapping by the pseudo-inverse of the chart's responses, P⁺ Λ [eq. 4]; on the basis B' it is M."""
    return LinearMapping(np.linalg.pinv(training.scaled) @ training.spectra / training.scale[:, None])


def ridge(training: Training) -> LinearMapping:
    """Return Tikhonov's solution (Pᵀ P + t I)⁻¹ Pᵀ Λ on scaled bands.

    t minimises, over a fixed grid, the leave-one-out error in closed form (residual over one minus leverage) plus the
    error that a pixel's noise adds.
    """
    left, values, right = np.linalg.svd(training.scaled, full_matrices=False)
    turned = left.T @ training.spectra
    noise = np.zeros(len(training.scale)) if training.noise.pixel is None else training.pixel_variance
    mean_square = np.mean(values**2)
    best = (np.inf, None)
    for relative in _RIDGES:
        t = relative * mean_square
        shrink = values**2 / (values**2 + t)
        leverage = np.minimum((left**2 * shrink).sum(axis=1), 1.0 - 1e-9)
        residual = (training.spectra - (left * shrink) @ turned) / (1.0 - leverage)[:, None]
        matrix = (right.T * (values / (values**2 + t))) @ turned
        error = np.mean((residual**2).sum(axis=1)) + noise @ (matrix**2).sum(axis=1)
        if error < best[0]:
            best = (error, matrix)
    return LinearMapping(best[1] / training.scale[:, None])


def wiener(training: Training) -> LinearMapping:
    """Return Wiener's estimator K Hᵀ (H K Hᵀ + C)⁻¹.

    K is the patches' second moment plus a smooth prior, H the mean of the response model, and C the noise of a pixel
    with the uncertainty of the response model for spectra of covariance K.
    """
    model, spectra = training.model, training.spectra
    prior = spectra.T @ spectra / len(spectra)
    prior += _SMOOTH_SHARE**2 * np.mean(spectra.mean(axis=1) ** 2) * smooth_covariance(50.0)
    unsure = np.einsum("bij,ij->b", model.covariance, prior)
    cross = model.mean @ prior
    moment = cross @ model.mean.T + np.diag(unsure + training.pixel_variance)
    return LinearMapping(np.linalg.solve(_floored(moment), cross) / training.scale[:, None])


def local(training: Training) -> LocalMapping:
    """Return a blend of Wiener estimators around anchors; each weights the population by the direction of responses.

    Anchors are some of the patches; the population is the patches and their mixtures. Each anchor has matrices for
    several relative noise variances, and one for a pixel at the chart's mean level, used when no variance is given.
    """
    population, bands = training.population, len(training.scale)
    squares = (population.response**2).sum(axis=1)
    direction = population.response / np.sqrt(squares)[:, None]
    anchors = _anchors(training.scaled / np.linalg.norm(training.scaled, axis=1, keepdims=True))
    chord = np.maximum(2.0 - 2.0 * anchors @ direction.T, 0.0)
    mean = training.pixel_variance.mean()
    shape = training.pixel_variance / mean if mean > 0 else np.ones(bands)
    usual = mean / np.mean(squares[: len(training.spectra)])
    levels = np.log(10.0) * np.arange(-_LEVELS + 1.0, 1.0)
    maps: list[np.ndarray] = []
    stated = levels if training.pixel_levels else levels[:0]
    for relative in (usual, *np.exp(stated)):
        # The matrices for the usual noise have the plain width, with which `LocalMapping` blends them.
        squared_width = _WIDTH**2 + (_SPREAD * relative if maps else 0.0)
        share = population.weight * (_BACKGROUND + np.exp(-0.5 * chord / squared_width))
        share /= share.sum(axis=1, keepdims=True)
        shared = (share[:, None] * population.response.T).reshape(-1, len(squares))
        moment = (shared @ population.response).reshape(-1, bands, bands) + np.tensordot(share, population.excess, 1)
        moment += (share @ squares)[:, None, None] * np.diag(relative * shape)
        cross = (shared @ population.spectra).reshape(len(anchors), bands, -1)
        cross += (share @ population.size)[:, None, None] * population.cloud
        maps.append(np.linalg.solve(_floored(moment), cross))
    return LocalMapping(training.scale, anchors, _WIDTH, levels, _SPREAD, np.array(maps))


def kernel(training: Training) -> PolynomialMapping:
    """Return ridge regression in homogeneous polynomials of degree three, over the population.

    It is the primal form of kernel ridge with the kernel |ρ| |ρ'| (cosine + cosine² + cosine³), up to weights of its
    terms. The noise of a pixel and the spread of the population enter the moments through the derivatives of the
    monomials, so that a monomial is regularised the more, the more it amplifies them.
    """
    return _regression(training, training.population)


def broad(training: Training) -> PolynomialMapping:
    """Return the regression of `kernel` over a wider population, for reflectances that may differ much from paints."""
    return _regression(training, training.wide_population)


def _root(covariance: np.ndarray) -> np.ndarray:
    """Return square roots R of covariances R Rᵀ, (n, b, b); eigenvalues that rounding made negative count as zero."""
    try:
        return np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(covariance)
        return vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]


def _regression(training: Training, population: Population) -> PolynomialMapping:
    bands = len(training.scale)
    features, slopes = monomials(population.response)
    weight = population.weight
    spread = population.excess + np.diag(training.pixel_variance)
    # Each member's covariance is split once, and the sum over members becomes one matrix product.
    half = _root(spread + _FLOOR * np.trace(spread, axis1=1, axis2=2)[:, None, None] * np.eye(bands))
    turned = np.sqrt(weight)[:, None, None] * (slopes @ half)
    turned = turned.transpose(1, 0, 2).reshape(features.shape[1], -1)
    moment = (features * weight[:, None]).T @ features + turned @ turned.T
    cross = (features * weight[:, None]).T @ population.spectra
    cross += np.tensordot(weight * population.size, slopes, 1) @ population.cloud
    penalty = np.full(features.shape[1], _POLYNOMIAL_RIDGE)
    penalty[:bands] = _FLOOR
    moment[np.diag_indices_from(moment)] += penalty * np.trace(moment[:bands, :bands]) / bands
    return PolynomialMapping(training.scale, np.linalg.solve(moment, cross))


ESTIMATORS: dict[str, Callable[[Training], Mapping]] = {
    "pinv": pinv,
    "ridge": ridge,
    "wiener": wiener,
    "local": local,
    "kernel": kernel,
    "broad": broad,
}


def fit_mapping(name: str, training: Training) -> Mapping:
    """Return the mapping from responses to spectra that an estimator finds.

    Raises
    ------
    ValueError
        If there is no such estimator; the message lists those there are.
    """
    if name not in ESTIMATORS:
        raise ValueError(f"unknown estimator {name!r}; accepted: {', '.join(ESTIMATORS)}")
    return ESTIMATORS[name](training)


def fit(name: str, training: Training, bases: int, max_condition: float = MAX_CONDITION) -> Calibration:
    """Return a calibration by an estimator on a number of bases; ``pinv`` is the paper's formula.

    The responses have passed the checks of `irodori.calibration.conditioning`.

    Raises
    ------
    ValueError
        For an unknown estimator or an impossible number of bases.
    """
    with threadpool_limits(1):  # small matrices, and the same sums whatever the threads
        if name == "pinv":
            found = calibrate(training.response, training.spectra, bases, training.light, max_condition)
        else:
            basis = spectral_basis(training.spectra, bases)
            mapping = fit_mapping(name, training).on_basis(basis)
            light = np.asarray(training.light, dtype=np.float64)
            found = Calibration(basis, mapping, light, estimator=name, training=training.response)
        best, scale = training.best_response, training.scale
    covariance = best.covariance * scale[:, None, None, None] * scale[:, None]
    return replace(found, band_response=best.mean * scale[:, None], band_response_covariance=covariance)


def monomials(response: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the monomials of `PolynomialMapping` and their derivatives.

    Parameters
    ----------
    response : (n, bands) float64, scaled, none of length zero

    Returns
    -------
    values : (n, f) float64
    slopes : (n, f, bands) float64
    """
    bands = response.shape[1]
    length = np.linalg.norm(response, axis=1, keepdims=True)
    c, unit = response / length, np.eye(bands)
    values, slopes = [response], [np.broadcast_to(unit, (len(response), bands, bands))]
    for degree in (2, 3):
        index = np.array(_exponents(bands, degree)).T
        factors = [c[:, i] for i in index]
        product = np.prod(factors, axis=0)
        # The product of n direction cosines times the length: d = Σ (product without one factor) e - (n - 1) product c.
        slope = -(degree - 1) * product[:, :, None] * c[:, None, :]
        for which in range(degree):
            slope[:, np.arange(index.shape[1]), index[which]] += np.prod(factors[:which] + factors[which + 1 :], axis=0)
        values.append(product * length)
        slopes.append(slope)
    every = np.concatenate(values, axis=1)
    assert every.shape[1] == polynomial_count(bands)
    return every, np.concatenate(slopes, axis=1)


def _exponents(bands: int, degree: int) -> list[tuple[int, ...]]:
    if degree == 2:
        return [(i, j) for i in range(bands) for j in range(i, bands)]
    return [(i, j, k) for i in range(bands) for j in range(i, bands) for k in range(j, bands)]


def _anchors(direction: np.ndarray) -> np.ndarray:
    """Return at most 48 directions that lie far from each other, beginning with the first."""
    if len(direction) <= _ANCHORS:
        return direction
    chosen = [0]
    distance = np.linalg.norm(direction - direction[0], axis=1)
    while len(chosen) < _ANCHORS:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(direction - direction[chosen[-1]], axis=1))
    return direction[chosen]


def _floored(moment: np.ndarray) -> np.ndarray:
    """Return symmetric matrices (..., n, n) with a tiny share of their trace added to the diagonal."""
    trace = np.trace(moment, axis1=-2, axis2=-1)[..., None, None]
    return moment + _FLOOR * trace * np.eye(moment.shape[-1])
