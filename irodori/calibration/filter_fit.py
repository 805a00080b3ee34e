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
from functools import cached_property, lru_cache

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


@lru_cache(maxsize=8)
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


@dataclass(frozen=True)
class _State:
    """Sensitivities (3, 61), departures (4,), gains (3,) and remainder (61,), or differences of them.

    The gains are logarithms.
    """

    sensitivities: np.ndarray
    departures: np.ndarray
    gains: np.ndarray
    rest: np.ndarray

    def plus(self, other: "_State", share: float = 1.0) -> "_State":
        """Return this state with a share of another added."""
        return _State(
            *(one + share * more for one, more in zip(vars(self).values(), vars(other).values(), strict=True))
        )


@dataclass(frozen=True)
class _Linearised:
    """Responses at a state, and their derivatives, most of which are diagonal.

    Parameters
    ----------
    state : _State
    passed : (61,) float64
        Transmittance.
    slopes : (61, 4) float64
        Its derivatives by the departures.
    """

    state: _State
    passed: np.ndarray
    slopes: np.ndarray

    @cached_property
    def value(self) -> np.ndarray:
        """Responses per unit reflectance, (6, 61)."""
        return np.concatenate([self.state.sensitivities, self.by_sensitivity * self.state.sensitivities])

    @cached_property
    def by_sensitivity(self) -> np.ndarray:
        """Derivatives of the responses with the filter by the sensitivities, (3, 61)."""
        return np.exp(self.state.gains)[:, None] * self.passed

    @cached_property
    def by_passed(self) -> np.ndarray:
        """Derivatives of the responses with the filter by its transmittance, (3, 61)."""
        return np.exp(self.state.gains)[:, None] * self.state.sensitivities

    def times(self, change: _State) -> np.ndarray:
        """Return the changes of the responses, (6, 61), with a change of the state."""
        passed = self.slopes @ change.departures + change.rest
        filtered = self.by_sensitivity * change.sensitivities + self.by_passed * passed
        return np.concatenate([change.sensitivities, filtered + self.value[FILTERED:] * change.gains[:, None]])

    def transposed(self, responses: np.ndarray) -> _State:
        """Return the product of the transposed derivatives with values of the responses, (6, 61)."""
        plain, filtered = responses[:FILTERED], responses[FILTERED:]
        passed = np.sum(self.by_passed * filtered, axis=0)
        gains = np.sum(self.value[FILTERED:] * filtered, axis=1)
        return _State(plain + self.by_sensitivity * filtered, self.slopes.T @ passed, gains, passed)


@dataclass(frozen=True)
class _Covariance:
    """Covariance of the state: blocks of the sensitivities (3, 61, 61), variances (4,) and (3,), remainder (61, 61)."""

    sensitivities: np.ndarray
    departures: np.ndarray
    gains: np.ndarray
    rest: np.ndarray

    def times(self, state: _State) -> _State:
        """Return the product with a state."""
        sensitivities = (self.sensitivities @ state.sensitivities[..., None])[..., 0]
        return _State(
            sensitivities, self.departures * state.departures, self.gains * state.gains, self.rest @ state.rest
        )

    def of_responses(self, one: _Linearised, other: _Linearised) -> np.ndarray:
        """Return the covariance of the responses, linearised in two states, (6, 61, 6, 61)."""
        out = np.zeros((2 * FILTERED, SAMPLES, 2 * FILTERED, SAMPLES))
        passed = self.rest + (one.slopes * self.departures) @ other.slopes.T
        for band in range(FILTERED):
            own, through = self.sensitivities[band], FILTERED + band
            left, right = one.by_sensitivity[band][:, None], other.by_sensitivity[band]
            out[band, :, band], out[band, :, through], out[through, :, band] = own, own * right, left * own
            for further in range(FILTERED):
                out[through, :, FILTERED + further] = one.by_passed[band][:, None] * passed * other.by_passed[further]
            gain = self.gains[band] * one.value[through][:, None] * other.value[through]
            out[through, :, through] += left * own * right + gain
        return out


class _Problem:
    """Responses to a chart as a function of sensitivities, departures, gains and remainder."""

    def __init__(self, response, spectra, table: FilterTable, priors: list[BandPrior], noise: np.ndarray) -> None:
        self.table, self.noise, self.further_evidence = table, noise, 0.0
        self.alone = np.stack(
            [prior.given(own, spectra).mean for prior, own in zip(priors, response.T[:FILTERED], strict=True)]
        )
        self.response, self.spectra = response.T, spectra
        if len(spectra) > SAMPLES:
            # What no light answers with is noise: as many combinations of the patches as wavelengths tell the same.
            turned, self.spectra = np.linalg.qr(spectra)
            self.response = self.response @ turned
            left = np.sum(response.T**2, axis=1) - np.sum(self.response**2, axis=1)
            number = len(spectra) - SAMPLES
            self.further_evidence = -0.5 * float(np.sum(np.maximum(left, 0.0) / noise + number * np.log(noise)))
        self.prior = np.stack([prior.covariance for prior in priors])
        self.mean = np.stack([prior.mean for prior in priors])

    def begin(self, shift: float) -> _State:
        """Return the starting values for a shift in nm; their gains are the mean of the gains' prior, too."""
        departures = np.array([shift, *np.zeros(len(DEPARTURES) - 1)])
        passed = self.spectra * self.table.at(departures)
        seen = [passed @ h for h in self.alone]
        gains = [one @ own / max(one @ one, 1e-300) for one, own in zip(seen, self.response[FILTERED:], strict=True)]
        return _State(self.alone, departures, np.log(np.maximum(gains, _LEAST_GAIN)), np.zeros(SAMPLES))

    def rest(self, size: float, length_nm: float, here: _Linearised) -> np.ndarray:
        """Return the prior covariance of the transmittance's remainder beyond its departures, (61, 61)."""
        level, edge = here.passed - here.state.rest, here.slopes[:, 0]
        levels = level[:, None] * _matern(length_nm) * level
        return size**2 * (levels + _EDGE_PER_LEVEL_NM**2 * edge[:, None] * _matern(_EDGE_NM) * edge)

    def linearised(self, state: _State) -> _Linearised:
        """Return the responses at a state with their derivatives."""
        return _Linearised(state, self.table.at(state.departures) + state.rest, self.table.slopes(state.departures))

    def solve(self, size: float, shift: float = 0.0, length_nm: float = _LEVEL_NM) -> FilterFit:
        """Return the fit with a remainder of the given size and correlation length, started at a shift in nm."""
        x, patches = self.begin(shift), len(self.spectra)
        mean = _State(self.mean, np.zeros(len(DEPARTURES)), x.gains, np.zeros(SAMPLES))
        gains = np.full(FILTERED, _GAIN**2)
        variances = np.einsum("bll->bl", self.prior), self.table.spread**2, gains
        units = [np.sqrt(np.maximum(one, np.finfo(float).tiny)) for one in variances]
        for _ in range(_STEPS):
            here = self.linearised(x)
            before = _Covariance(self.prior, self.table.spread**2, gains, self.rest(size, length_nm, here))
            known = here.value + here.times(mean.plus(x, -1.0))
            missed = (self.response - known @ self.spectra.T).ravel()
            moment = self.seen(self.seen(before.of_responses(here, here)).T.reshape(2 * FILTERED, SAMPLES, -1)).T
            moment[np.diag_indices_from(moment)] += np.repeat(self.noise, patches)
            solved = np.linalg.solve(moment, missed)
            weighed = here.transposed(solved.reshape(2 * FILTERED, patches) @ self.spectra)
            step = mean.plus(before.times(weighed)).plus(x, -1.0)
            # Far from the solution the linearised model is wrong: the step is limited in shifts and gains.
            shift, gain = np.abs(step.departures[:2]).max(), np.abs(step.gains).max()
            x = x.plus(step, 1.0 / max(1.0, shift / _MOST_SHIFT_NM, gain / _MOST_GAIN))
            moved = zip((step.sensitivities, step.departures, step.gains), units, strict=True)
            if max(float(np.abs(one / unit).max()) for one, unit in moved) < _ENOUGH:
                break
        there = self.linearised(x)
        cross = self.seen(before.of_responses(here, there))
        covariance = before.of_responses(there, there).reshape(cross.shape[1], -1)
        covariance -= cross.T @ np.linalg.solve(moment, cross)
        of_departures = np.zeros((2 * FILTERED, SAMPLES, len(DEPARTURES)))
        of_departures[FILTERED:] = here.by_passed[..., None] * (here.slopes * before.departures)
        told = self.seen(of_departures)
        left = before.departures - np.sum(told * np.linalg.solve(moment, told), axis=0)
        evidence = self.further_evidence - 0.5 * (missed @ solved + np.linalg.slogdet(moment)[1])
        return FilterFit(
            there.value,
            covariance.reshape(*there.value.shape, *there.value.shape),
            float(evidence),
            x.departures,
            np.sqrt(np.maximum(left, 0.0)),
            np.exp(x.gains),
            size,
        )

    def seen(self, of_responses: np.ndarray) -> np.ndarray:
        """Return values per response, (6, 61, ...), as the chart's patches show them, (6 patches, all others)."""
        shown = self.spectra @ of_responses.reshape(2 * FILTERED, SAMPLES, -1)
        return shown.reshape(2 * FILTERED * len(self.spectra), -1)


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
