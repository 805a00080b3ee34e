"""Gaussian-process priors, over wavelength, of one band's response per unit reflectance.

The response is the light times a sensitivity. Sensitivities are smooth with bends, for which Matérn covariances allow.
They are large in one part of the range and nearly zero elsewhere, so that the prior's standard deviation follows an
envelope. The envelope is estimated from the chart, and so are correlation length and amplitude, by the marginal
likelihood (Rasmussen and Williams 2006, section 5.4); the amplitude is then reduced. At the edges of a camera's UV and
IR cut filters, sensitivities change within a few nanometres: there, distances in wavelength are stretched.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from irodori.spectra.grid import SAMPLES, WAVELENGTH_NM

#: Values tried: correlation lengths of a sensitivity, nm; its variances and additional noise variances, both relative.
_LENGTHS_NM = (20.0, 30.0, 40.0)
_SIZES = 10.0 ** np.arange(-2.0, 5.0, 0.125)
_FURTHER_NOISE = 10.0 ** np.arange(-10.0, -1.0)
#: Factors on prior variances: of a sensitivity, since its likeliest size is decided by few large values, and of the
#: stated error of a known one. Like the lengths, they were chosen for the share of errors within one and two standard
#: deviations, with the two cameras in colour-science and five of the program rawtoaces, and 15 filters.
_LIKELIEST, _STATED = 0.4, 0.7
#: Edges of cameras' cut filters, nm: position, width, and the distance that they add between two wavelengths. They are
#: those of the two cameras in colour-science; no other camera was examined.
_EDGES_NM, _EDGE_WIDTH_NM, _EDGE_DISTANCE_NM = (418.0, 655.0), 10.0, 40.0
#: Envelope: width of its local mean, nm, its smallest value relative to the largest, and its number of re-estimations.
_ENVELOPE_NM, _LEAST, _ROUNDS = 20.0, 0.02, 2
#: Width and smallest value of the envelope of the error of a known sensitivity.
_KNOWN_NM, _KNOWN_LEAST = 5.0, 0.005
_LEAST_POWER = 1e-3  # smallest power of a lamp, relative to its mean


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
def shapes() -> np.ndarray:
    """Return the covariances of unit variance that are tried, Matérn's of orders 3/2 and 5/2, (6, 61, 61)."""
    from scipy.special import ndtr  # slow to import

    place = WAVELENGTH_NM + _EDGE_DISTANCE_NM * sum(ndtr((WAVELENGTH_NM - e) / _EDGE_WIDTH_NM) for e in _EDGES_NM)
    found = []
    for length in _LENGTHS_NM:
        distance = np.abs(place[:, None] - place) / length
        rough, smooth = np.sqrt(3.0) * distance, np.sqrt(5.0) * distance
        found += [(1.0 + rough) * np.exp(-rough), (1.0 + smooth + smooth**2 / 3.0) * np.exp(-smooth)]
    return np.array(found)


def _envelope(square: np.ndarray, width_nm: float = _ENVELOPE_NM, least: float = _LEAST) -> np.ndarray:
    """Return the square root of the local mean of squares (61,), kept above a small share of its maximum."""
    near = np.exp(-0.5 * ((WAVELENGTH_NM[:, None] - WAVELENGTH_NM) / width_nm) ** 2)
    mean = near @ np.maximum(square, 0.0) / near.sum(axis=1)
    return np.sqrt(mean + least**2 * mean.max())


def _averaged(
    missed: np.ndarray, spectra: np.ndarray, envelope: np.ndarray, variance: float, sizes: np.ndarray | None
) -> tuple[np.ndarray, float]:
    """Return covariance and noise variance, averaged over `shapes` with their marginal likelihoods as weights.

    Each shape counts with the size and the noise of its highest likelihood.

    Parameters
    ----------
    missed : (m,) float64
        Residuals of the responses from the prior mean.
    spectra : (m, 61) float64
    envelope : (61,) float64
    variance : float
        Known variance of the responses.
    sizes : (n,) float64 or None
        Prior variances to try; None for a range relative to the mean square of the residuals.
    """
    total = np.mean(missed**2)
    factor = _LIKELIEST if sizes is None else _STATED
    noise = variance + np.concatenate([[0.0] if variance > 0.0 else [], _FURTHER_NOISE]) * total
    logarithm, covariances, noises = [], [], []
    for shape in shapes():
        covariance = envelope[:, None] * shape * envelope
        values, vectors = np.linalg.eigh(spectra @ covariance @ spectra.T)
        values, turned = np.maximum(values, 0.0), vectors.T @ missed
        size = _SIZES * total / values.mean() if sizes is None else sizes
        spread = size[:, None, None] * values + noise[:, None]
        likelihood = -0.5 * (turned**2 / spread + np.log(spread)).sum(axis=2)
        i, j = np.unravel_index(np.argmax(likelihood), likelihood.shape)
        logarithm.append(likelihood[i, j])
        covariances.append(factor * size[i] * covariance)
        noises.append(noise[j])
    share = np.exp(np.array(logarithm) - max(logarithm))
    share /= share.sum()
    return np.tensordot(share, np.array(covariances), axes=1), float(np.exp(share @ np.log(noises)))


def prior_of_chart(response: np.ndarray, spectra: np.ndarray, light: np.ndarray, variance: float = 0.0) -> BandPrior:
    """Return the prior of a band with an unknown sensitivity, estimated from the responses to a chart.

    Parameters
    ----------
    response : (m,) float64
    spectra : (m, 61) float64
    light : (61,) float64
    variance : float
        Variance of the responses; 0 if unknown.
    """
    # At wavelengths without light, the chart does not determine a sensitivity.
    power = np.maximum(light / light.mean(), _LEAST_POWER)
    envelope, nothing = np.ones(len(light)), np.zeros(len(light))
    for left in reversed(range(_ROUNDS + 1)):
        prior = BandPrior(nothing, *_averaged(response, spectra, power * envelope, variance, None))
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
    envelope = factor * light * _envelope(sensitivity**2, _KNOWN_NM, _KNOWN_LEAST)
    covariance, noise = _averaged(response - spectra @ mean, spectra, envelope, variance, np.array([error**2]))
    # The factor itself is as uncertain as the sensitivity.
    return BandPrior(mean, covariance + error**2 * mean[:, None] * mean, noise)
