"""Gaussian-process priors, over wavelength, of one band's response per unit reflectance.

The response is the light times a sensitivity. Sensitivities are large in one part of the range and nearly zero
elsewhere: they are an envelope times a factor. The factor has an unknown level, the same at all wavelengths, and
departs from it by as much again, smoothly with bends, for which Matérn covariances allow. Without the level, an
amplitude that explains why all values are positive would be too large for the departures. The envelope is estimated
from the chart, and so are correlation length and amplitude, by the marginal likelihood (Rasmussen and Williams 2006,
section 5.4); the amplitude is then reduced. At the edges of a camera's UV and IR cut filters, sensitivities change
within a few nanometres: there, distances in wavelength are stretched.

Errors of given sensitivities, those of their measurement, are smoother than sensitivities, also at the edges of cut
filters. They are relative to the sensitivity; where a band sees nearly nothing, a small error that has nothing to do
with those nearby is added.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from irodori.calibration.response_model import smooth_covariance
from irodori.spectra.grid import SAMPLES, WAVELENGTH_NM

#: Values tried: correlation lengths, nm, of a sensitivity and of the error of a known one; a sensitivity's variances
#: and additional noise variances, both relative.
_LENGTHS_NM, _ERROR_NM = (20.0, 30.0, 40.0), (25.0, 30.0, 40.0)
_SIZES = 10.0 ** np.arange(-2.0, 5.0, 0.125)
_FURTHER_NOISE = 10.0 ** np.arange(-10.0, -1.0)
#: Factors on prior variances: of a sensitivity, since its likeliest size is decided by few large values, and of the
#: stated error of a known one. Like the lengths and the smallest value of the envelope, they were chosen for the shares
#: of errors within one and two standard deviations, with thirteen cameras (`docs/method/calibration.md`).
_LIKELIEST, _STATED = 0.6, 0.6
#: Variance of a sensitivity's level relative to that of its departures from the level.
_LEVEL = 1.0
#: Edges of cameras' cut filters, nm: position, width, and the distance that they add between two wavelengths. They are
#: those of the two cameras in colour-science; no other camera was examined.
_EDGES_NM, _EDGE_WIDTH_NM, _EDGE_DISTANCE_NM = (418.0, 655.0), 10.0, 40.0
#: Envelope: width of its local mean, nm, its smallest value relative to the largest, and its number of re-estimations.
_ENVELOPE_NM, _LEAST, _ROUNDS = 20.0, 0.005, 2
#: Width of the envelope of a known sensitivity, and the additional error where it is small, relative to the largest.
_KNOWN_NM, _KNOWN_LEAST = 5.0, 0.005
_LEAST_POWER = 1e-3  # smallest power of a lamp, relative to its mean


def with_least_power(light: np.ndarray) -> np.ndarray:
    """Return a light, (61,), with a thousandth of its mean power where it has less.

    At wavelengths without light, a chart does not determine a sensitivity, which is the response divided by the light.
    """
    return np.maximum(light, _LEAST_POWER * light.mean())


@dataclass(frozen=True)
class Posterior:
    """Posterior of one band's response per unit reflectance, given the responses to a chart.

    Parameters
    ----------
    mean : (61,) float64
    covariance : (61, 61) float64
    log_evidence : float
        Logarithm of the density of the chart's responses under the prior, up to a constant of the chart.
    """

    mean: np.ndarray
    covariance: np.ndarray
    log_evidence: float


@dataclass(frozen=True)
class BandPrior:
    """Gaussian prior of a band's response per unit reflectance, and the noise variance of a patch's response.

    Parameters
    ----------
    mean : (61,) float64
    covariance : (61, 61) float64
    noise : float
    """

    mean: np.ndarray
    covariance: np.ndarray
    noise: float

    def given(self, response: np.ndarray, spectra: np.ndarray) -> Posterior:
        """Return the posterior given responses (m,) to known reflectances (m, 61)."""
        cross = spectra @ self.covariance
        moment = cross @ spectra.T + self.noise * np.eye(len(spectra))
        missed = response - spectra @ self.mean
        solved = np.linalg.solve(moment, np.column_stack([missed, cross]))
        evidence = -0.5 * (missed @ solved[:, 0] + np.linalg.slogdet(moment)[1])
        return Posterior(self.mean + solved[:, 0] @ cross, self.covariance - cross.T @ solved[:, 1:], float(evidence))


@dataclass(frozen=True)
class Posteriors:
    """Posteriors of all bands' responses per unit reflectance, independent of each other, given a chart.

    Parameters
    ----------
    mean : (bands, 61) float64
    covariance : (bands, 61, bands, 61) float64
    log_evidence : float
        Logarithm of the density of all responses, up to a constant of the chart.
    """

    mean: np.ndarray
    covariance: np.ndarray
    log_evidence: float

    @classmethod
    def of(cls, priors: list[BandPrior], response: np.ndarray, spectra: np.ndarray) -> "Posteriors":
        """Return the posteriors given responses (m, bands) to known reflectances (m, 61)."""
        each = [prior.given(own, spectra) for prior, own in zip(priors, response.T, strict=True)]
        mean, covariance = np.array([one.mean for one in each]), of_independent_bands([one.covariance for one in each])
        return cls(mean, covariance, sum(one.log_evidence for one in each))


def of_independent_bands(covariances: Sequence[np.ndarray]) -> np.ndarray:
    """Return the covariance of all bands, (bands, 61, bands, 61), from that of each, (61, 61)."""
    found = np.zeros((len(covariances), SAMPLES, len(covariances), SAMPLES))
    for band, own in enumerate(covariances):
        found[band, :, band] = own
    return found


@lru_cache(maxsize=1)
def shapes() -> tuple[np.ndarray, np.ndarray]:
    """Return the covariances that are tried.

    Returns
    -------
    bent : (6, 61, 61) float64
        For sensitivities: that of the level, and Matérn's of orders 3/2 and 5/2 and unit variance.
    smooth : (3, 61, 61) float64
        Squared-exponential ones of unit variance, for errors of known sensitivities.
    """
    from scipy.special import ndtr  # slow to import

    place = WAVELENGTH_NM + _EDGE_DISTANCE_NM * sum(ndtr((WAVELENGTH_NM - e) / _EDGE_WIDTH_NM) for e in _EDGES_NM)
    distance = np.abs(place[:, None] - place) / np.array(_LENGTHS_NM)[:, None, None]
    rough, smooth = np.sqrt(3.0) * distance, np.sqrt(5.0) * distance
    bent = (1.0 + rough) * np.exp(-rough), (1.0 + smooth + smooth**2 / 3.0) * np.exp(-smooth)
    return _LEVEL + np.concatenate(bent), np.stack([smooth_covariance(length) for length in _ERROR_NM])


def _envelope(square: np.ndarray, width_nm: float = _ENVELOPE_NM, least: float = _LEAST) -> np.ndarray:
    """Return the square root of the local mean of squares (61,), kept above a small share of its maximum."""
    near = np.exp(-0.5 * ((WAVELENGTH_NM[:, None] - WAVELENGTH_NM) / width_nm) ** 2)
    mean = near @ np.maximum(square, 0.0) / near.sum(axis=1)
    return np.sqrt(mean + least**2 * mean.max())


def _averaged(
    missed: np.ndarray, spectra: np.ndarray, covariances: np.ndarray, size: float | None, variance: float
) -> tuple[np.ndarray, float]:
    """Return covariance and noise variance, averaged over some covariances with their marginal likelihoods as weights.

    Each covariance counts with the size and the noise of its highest likelihood.

    Parameters
    ----------
    missed : (m,) float64
        Residuals of the responses from the prior mean.
    spectra : (m, 61) float64
    covariances : (n, 61, 61) float64
    size : float or None
        Factor of the covariances; None to try a range relative to the mean square of the residuals.
    variance : float
        Known variance of the responses.
    """
    total = np.mean(missed**2)
    noise = variance + np.concatenate([[0.0] if variance > 0.0 else [], _FURTHER_NOISE]) * total
    logarithm, sized, noises = [], [], []
    for covariance in covariances:
        values, vectors = np.linalg.eigh(spectra @ covariance @ spectra.T)
        values, turned = np.maximum(values, 0.0), vectors.T @ missed
        sizes = _SIZES * total / values.mean() if size is None else np.array([size])
        spread = sizes[:, None, None] * values + noise[:, None]
        likelihood = -0.5 * (turned**2 / spread + np.log(spread)).sum(axis=2)
        i, j = np.unravel_index(np.argmax(likelihood), likelihood.shape)
        logarithm.append(likelihood[i, j])
        sized.append(sizes[i] * covariance)
        noises.append(noise[j])
    share = np.exp(np.array(logarithm) - max(logarithm))
    share /= share.sum()
    return np.tensordot(share, np.array(sized), axes=1), float(np.exp(share @ np.log(noises)))


def prior_of_chart(response: np.ndarray, spectra: np.ndarray, light: np.ndarray, variance: float = 0.0) -> BandPrior:
    """Return the prior of a band with an unknown sensitivity, estimated from the responses to a chart.

    Parameters
    ----------
    response : (m,) float64
    spectra : (m, 61) float64
    light : (61,) float64, > 0; see `with_least_power`
    variance : float
        Variance of the responses; 0 if unknown.
    """
    power = light / light.mean()
    envelope, nothing = np.ones(len(light)), np.zeros(len(light))
    for left in reversed(range(_ROUNDS + 1)):
        extent = power * envelope
        covariance, noise = _averaged(response, spectra, np.outer(extent, extent) * shapes()[0], None, variance)
        prior = BandPrior(nothing, _LIKELIEST * covariance, noise)
        if left:
            found = prior.given(response, spectra)
            envelope = _envelope((found.mean**2 + np.diag(found.covariance)) / power**2)
    return prior


def prior_about(
    sensitivity: np.ndarray,
    error: float,
    response: np.ndarray,
    spectra: np.ndarray,
    light: np.ndarray,
    variance: float = 0.0,
) -> BandPrior:
    """Return the prior of a band with a sensitivity that is known up to a factor and an error.

    Parameters
    ----------
    sensitivity : (61,) float64
        Relative.
    error : float
        Standard deviation of the sensitivity, relative to its local root mean square, 0.1 = 10 %.
    response, spectra, light, variance : see `prior_of_chart`
    """
    known = light * sensitivity
    answer = spectra @ known
    factor = (answer @ response) / (answer @ answer)
    mean = factor * known
    relative = factor * light * _envelope(sensitivity**2, _KNOWN_NM, 0.0)
    least = factor * light * _KNOWN_LEAST * np.abs(sensitivity).max()
    tried = (np.outer(relative, relative) + np.outer(least, least)) * shapes()[1]
    covariance, noise = _averaged(response - spectra @ mean, spectra, tried, error**2, variance)
    # The factor itself is as uncertain as the sensitivity.
    return BandPrior(mean, _STATED * covariance + error**2 * mean[:, None] * mean, noise)
