"""Estimation of responses without and with a filter from one chart, with or without a table of its transmittance.

Per unit reflectance, the response of band b is h_b(λ) without the filter and g_b T(λ) h_b(λ) with it. T is the table's
transmittance with its departures (`irodori.calibration.filter_table`) plus a remainder δ(λ): a Gaussian process that
allows every passband its own level and every edge its own position. Sensitivities, departures, δ and the gains g_b are
estimated together by Gauss-Newton steps from Gaussian priors. Their covariance is that of the linearised model
(Laplace's approximation), so that the covariance of the responses includes the uncertainty of the table. Fits with
several sizes of δ are averaged with their marginal likelihoods as weights.

Without a table, T is 1 plus a δ as large as 1, with several lengths: a filter that passes everything or nothing. Little
is known of it, but all bands have the same filter, and with it none of them sees what it does not see without it.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from irodori.calibration.filter_table import DEPARTURES, FilterTable
from irodori.calibration.sensitivity_prior import BandPrior
from irodori.spectra.grid import SAMPLES, WAVELENGTH_NM

#: Relative standard deviations of a passband's level that are tried, and their correlation length, nm. The standard
#: deviation of an edge's position, in nm, is 30 times that of the level, with its own correlation length.
_LEVELS, _LEVEL_NM = (0.003, 0.01, 0.03, 0.1), 25.0
_EDGE_PER_LEVEL_NM, _EDGE_NM = 30.0, 10.0
#: Levels and correlation lengths, nm, of a filter without a table. One that passes half of the range fully and nothing
#: else departs from its mean by as much as the mean; one that blocks a tenth of the range, by a third.
_UNKNOWN_LEVELS, _UNKNOWN_NM = (1 / 3, 1.0), (10.0, 20.0, 40.0)
#: Starting values of the shift, in its standard deviations, and the index of the level that these searches use.
_STARTS, _FIRST = (-1.5, 0.0, 1.5), 1
_GAIN, _LEAST_GAIN = 0.3, 1e-3  # standard deviation of the logarithm of a gain about where the search begins
_STEPS, _ENOUGH = 30, 1e-4
_MOST_SHIFT_NM, _MOST_GAIN = 1.5, 0.5  # in one step
#: Number of bands that are photographed without and with the filter.
FILTERED = 3
_UNKNOWN = FilterTable(WAVELENGTH_NM, np.ones(SAMPLES))


def _matern(length_nm: float) -> np.ndarray:
    """Return Matérn's covariance of order 5/2 and unit variance, (61, 61)."""
    distance = np.sqrt(5.0) * np.abs(WAVELENGTH_NM[:, None] - WAVELENGTH_NM) / length_nm
    return (1.0 + distance + distance**2 / 3.0) * np.exp(-distance)


@dataclass(frozen=True)
class FilterFit:
    """Estimated responses of the six bands, and the departures of the filter from its table.

    Parameters
    ----------
    mean : (6, 61) float64
    covariance : (6, 61, 6, 61) float64
    log_evidence : float
    departures, errors : (4,) float64
        Departures, see `irodori.calibration.filter_table.DEPARTURES`, and their standard deviations.
    gains : (3,) float64
        Gains of the bands with the filter, for a largest transmittance of 1.
    level : float
        Relative standard deviation of a passband's level with the highest marginal likelihood.
    """

    mean: np.ndarray
    covariance: np.ndarray
    log_evidence: float
    departures: np.ndarray
    errors: np.ndarray
    gains: np.ndarray
    level: float


class _Problem:
    """Responses to a chart as a function of sensitivities (3 x 61), departures (4), gains (3) and remainder (61)."""

    _DEPARTURES = slice(FILTERED * SAMPLES, FILTERED * SAMPLES + len(DEPARTURES))
    _SHIFTS = slice(_DEPARTURES.start, _DEPARTURES.start + 2)
    _GAINS = slice(_DEPARTURES.stop, _DEPARTURES.stop + FILTERED)
    _REST = slice(_GAINS.stop, _GAINS.stop + SAMPLES)

    def __init__(self, response, spectra, table: FilterTable, priors: list[BandPrior], noise: np.ndarray) -> None:
        self.response, self.spectra, self.table = response.T.ravel(), spectra, table
        self.noise = np.repeat(noise, len(spectra))
        self.mean, self.covariance = np.zeros(self._REST.stop), np.zeros((self._REST.stop,) * 2)
        for band, prior in enumerate(priors):
            own = slice(band * SAMPLES, (band + 1) * SAMPLES)
            self.mean[own], self.covariance[own, own] = prior.mean, prior.covariance
        self.covariance[self._DEPARTURES, self._DEPARTURES] = np.diag(table.spread**2)
        self.covariance[self._GAINS, self._GAINS] = _GAIN**2 * np.eye(FILTERED)
        self.alone = [prior.given(own, spectra).mean for prior, own in zip(priors, response.T, strict=False)]

    def begin(self, shift: float) -> np.ndarray:
        """Return the starting values for a shift in nm; the gains among them also become the mean of their prior."""
        start = self.mean.copy()
        start[: self._DEPARTURES.start] = np.concatenate(self.alone)
        start[self._DEPARTURES.start] = shift
        passed = self.spectra * self.table.at(start[self._DEPARTURES])
        measured = self.response.reshape(2, FILTERED, -1)[1]
        seen = [passed @ h for h in self.alone]
        gains = [one @ own / max(one @ one, 1e-300) for one, own in zip(seen, measured, strict=True)]
        self.mean[self._GAINS] = start[self._GAINS] = np.log(np.maximum(gains, _LEAST_GAIN))
        return start

    def rest(self, size: float, length_nm: float, departures: np.ndarray) -> np.ndarray:
        """Return the prior covariance of the transmittance's remainder beyond its departures, (61, 61)."""
        level, edge = self.table.at(departures), self.table.slopes(departures)[:, 0]
        levels = level[:, None] * _matern(length_nm) * level
        return size**2 * (levels + _EDGE_PER_LEVEL_NM**2 * edge[:, None] * _matern(_EDGE_NM) * edge)

    def responses(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the responses per unit reflectance (6, 61) and their derivatives (6, 61, unknowns)."""
        h, departures = x[: self._DEPARTURES.start].reshape(FILTERED, SAMPLES), x[self._DEPARTURES]
        gains, passed = np.exp(x[self._GAINS]), self.table.at(departures) + x[self._REST]
        slopes, of_all = self.table.slopes(departures), np.arange(SAMPLES)
        value = np.concatenate([h, gains[:, None] * passed * h])
        by = np.zeros((2 * FILTERED, SAMPLES, len(x)))
        for band in range(FILTERED):
            own = band * SAMPLES + of_all
            by[band, of_all, own] = 1.0
            by[FILTERED + band, of_all, own] = gains[band] * passed
            by[FILTERED + band][:, self._DEPARTURES] = (gains[band] * h[band])[:, None] * slopes
            by[FILTERED + band, :, self._GAINS.start + band] = value[FILTERED + band]
            by[FILTERED + band, of_all, self._REST.start + of_all] = gains[band] * h[band]
        return value, by

    def solve(self, size: float, shift: float = 0.0, length_nm: float = _LEVEL_NM) -> FilterFit:
        """Return the fit with a remainder of the given size and correlation length, started at a shift in nm."""
        x, variance = self.begin(shift), np.diag(self.covariance)[: self._REST.start]
        unit = np.sqrt(np.maximum(variance, np.finfo(float).tiny))
        for _ in range(_STEPS):
            self.covariance[self._REST, self._REST] = self.rest(size, length_nm, x[self._DEPARTURES])
            value, by = self.responses(x)
            slopes = np.einsum("ml,blu->bmu", self.spectra, by, optimize=True).reshape(len(self.response), -1)
            missed = self.response - (value @ self.spectra.T).ravel() + slopes @ (x - self.mean)
            cross = self.covariance @ slopes.T
            moment = slopes @ cross + np.diag(self.noise)
            solved = np.linalg.solve(moment, missed)
            step = self.mean + cross @ solved - x
            # Far from the solution the linearised model is wrong: the step is limited in shifts and gains.
            shift, gain = (np.abs(step[own]).max() for own in (self._SHIFTS, self._GAINS))
            x = x + step / max(1.0, shift / _MOST_SHIFT_NM, gain / _MOST_GAIN)
            if np.abs(step[: self._REST.start] / unit).max() < _ENOUGH:
                break
        value, by = self.responses(x)
        by = by.reshape(-1, by.shape[-1])
        covariance = self.covariance - cross @ np.linalg.solve(moment, cross.T)
        evidence = -0.5 * (missed @ solved + np.linalg.slogdet(moment)[1])
        return FilterFit(
            value,
            (by @ covariance @ by.T).reshape(*value.shape, *value.shape),
            float(evidence),
            x[self._DEPARTURES],
            np.sqrt(np.maximum(np.diag(covariance)[self._DEPARTURES], 0.0)),
            np.exp(x[self._GAINS]),
            size,
        )


def fit_filter(
    response: np.ndarray, spectra: np.ndarray, table: FilterTable | None, priors: list[BandPrior], variance: np.ndarray
) -> FilterFit:
    """Return the responses of six bands, three without and three with a filter, with the filter's table as a prior.

    Parameters
    ----------
    response : (m, 6) float64
    spectra : (m, 61) float64
    table : FilterTable or None
        None for a filter of which nothing is known; the departures and gains found then mean nothing.
    priors : list of 3 BandPrior
        Priors of the bands without the filter. Their noise beyond the known variance, relative to the mean square of a
        band, is assumed for the bands with the filter too.
    variance : (6,) float64
        Known variance of the responses.
    """
    square = np.mean(response**2, axis=0)
    plain = np.array([prior.noise for prior in priors])
    further = np.mean((plain - variance[:FILTERED]) / square[:FILTERED])
    noise = np.concatenate([plain, variance[FILTERED:] + further * square[FILTERED:]])
    if table is None:
        problem = _Problem(response, spectra, _UNKNOWN, priors, noise)
        tried = itertools.product(_UNKNOWN_LEVELS, _UNKNOWN_NM)
        return _averaged([problem.solve(level, length_nm=length) for level, length in tried])
    problem = _Problem(response, spectra, table, priors, noise)
    starts = [problem.solve(_LEVELS[_FIRST], start * table.shift_nm) for start in _STARTS]
    first = max(starts, key=lambda fit: fit.log_evidence)
    return _averaged(
        [first if which == _FIRST else problem.solve(level, first.departures[0]) for which, level in enumerate(_LEVELS)]
    )


def _averaged(fits: list[FilterFit]) -> FilterFit:
    """Return the mean of fits, weighted by their marginal likelihoods, with the departures of the likeliest."""
    logarithm = np.array([fit.log_evidence for fit in fits])
    share = np.exp(logarithm - logarithm.max())
    share /= share.sum()
    mean = np.tensordot(share, np.array([fit.mean for fit in fits]), axes=1)
    covariance = sum(
        part * (fit.covariance + np.multiply.outer(fit.mean - mean, fit.mean - mean))
        for part, fit in zip(share, fits, strict=True)
    )
    best = fits[int(np.argmax(logarithm))]
    evidence = float(np.log(np.mean(np.exp(logarithm - logarithm.max()))) + logarithm.max())
    return FilterFit(mean, covariance, evidence, best.departures, best.errors, best.gains, best.level)
