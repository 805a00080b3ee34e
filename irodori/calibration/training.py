"""Training data of the estimators: chart, noise, and statistics of camera and reflectances.

A chart has two dozen reflectances; a picture has others. Two models carry over from one to the other. The *response
model*, responses per unit reflectance at each wavelength, is the light times a smooth sensitivity: its posterior
predicts the response to any reflectance, with its uncertainty. The *population* is the set of the patches and their
simulated mixtures as paints (Kubelka and Munk 1931), with the responses that the response model predicts.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from irodori.calibration.best_response import NOTHING, BestResponse, Given, best_response
from irodori.calibration.response_model import (
    ResponseModel,
    SmoothPrior,
    fit_response_model,
    smooth_covariance,
    smooth_priors,
)

_MIXTURES = 600  # at most; pairs are left out evenly
_LEAST_REFLECTANCE = 1e-3  # of a paint that is mixed: absorption grows without bound below
#: Standard deviation of reflectances about a member of the population, relative to its level, and their correlation
#: length, nm. Those for materials other than paint come from leaving out each patch of a ColorChecker, no other set.
PAINTS, ANYTHING = (0.03, 60.0), (0.2, 80.0)
_TWIN_RMS = 0.005


@dataclass(frozen=True)
class ResponseNoise:
    """Noise variances of patch means and of pixels, per band, in squared units of the response.

    Parameters
    ----------
    patch : (bands,) float, optional
        Variance of the means over the patches; None if unknown: the response model then estimates it.
    pixel : (bands,) float, optional
        Variance of a pixel that will be recovered; None if unknown: that of the patches is then used.
    """

    patch: np.ndarray | None = None
    pixel: np.ndarray | None = None


def mix_paints(spectra: np.ndarray, limit: int = _MIXTURES) -> np.ndarray:
    """Return reflectances of equal mixtures of two patches each, by the Kubelka-Munk ratio of opaque layers.

    Parameters
    ----------
    spectra : (m, 61) float
        Values outside 0.001..1 are clipped, for the mixtures only.
    limit : int
        Most mixtures; of more pairs every n-th is taken.

    Returns
    -------
    (n, 61) float64, 0..1
    """
    first, second = np.triu_indices(len(spectra), 1)
    step = max(1, -(-first.size // limit))
    first, second = first[::step], second[::step]
    paint = np.clip(spectra, _LEAST_REFLECTANCE, 1.0)
    ratio = (1.0 - paint) ** 2 / (2.0 * paint)
    mixed = 0.5 * (ratio[first] + ratio[second])
    return 1.0 + mixed - np.sqrt(mixed * (mixed + 2.0))


def twins(spectra: np.ndarray) -> np.ndarray:
    """Return, for each patch, the index of the first patch with nearly the same spectrum, (m,) int.

    Spectra with an rms difference under 0.005 count as one paint, such as those of two copies of a chart or the greys
    along the edge of a large one. A patch counts as left out only if its twins are left out too.
    """
    difference = np.sqrt(np.mean((spectra[:, None] - spectra) ** 2, axis=-1))
    return np.argmax(difference < _TWIN_RMS, axis=1)


@dataclass(frozen=True)
class Population:
    """Reflectances that may occur in a picture, and the responses of the camera to them.

    Each member represents a *cloud*: a Gaussian distribution of smooth spectra about it.

    Parameters
    ----------
    spectra : (n, 61) float64
    weight : (n,) float64
        Weights with the sum 1; equal shares for patches and mixtures, each weight divided by the mean reflectance.
    response : (n, bands) float64
        Expected responses, in units of `Training.scale`.
    excess : (n, bands, bands) float64
        Covariance of the response in the cloud and from the response model, without the noise of a pixel.
    size : (n,) float64
        Size of each member's cloud: its squared mean reflectance.
    cloud : (bands, 61) float64
        Covariance between response and spectrum in a cloud of size 1.
    """

    spectra: np.ndarray
    weight: np.ndarray
    response: np.ndarray
    excess: np.ndarray
    size: np.ndarray
    cloud: np.ndarray


@dataclass(frozen=True)
class Training:
    """Training data of an estimator: responses to a chart, its spectra, its light, and the noise.

    Parameters
    ----------
    response : (m, bands) float, P
    spectra : (m, 61) float, Λ
    light : (61,) float
    noise : ResponseNoise
    pixel_levels : bool
        Whether ``local`` also computes matrices for pixels with a stated noise variance.
    given : Given
        Further knowledge of the camera; only `best_response` uses it, no estimator does.
    """

    response: np.ndarray
    spectra: np.ndarray
    light: np.ndarray
    noise: ResponseNoise = ResponseNoise()
    pixel_levels: bool = True
    given: Given = NOTHING

    def without(self, left_out: np.ndarray, pixel_levels: bool = False) -> "Training":
        """Return the training data without the patches in a mask, (m,) bool, and without ``given``."""
        return Training(self.response[~left_out], self.spectra[~left_out], self.light, self.noise, pixel_levels)

    @cached_property
    def scale(self) -> np.ndarray:
        """Largest response in every band, (bands,)."""
        return np.abs(self.response).max(axis=0)

    @cached_property
    def scaled(self) -> np.ndarray:
        """Responses in units of the scale, (m, bands)."""
        return self.response / self.scale

    @cached_property
    def patch_variance(self) -> np.ndarray:
        """Known variance of the scaled responses of patches, zeros if unknown, (bands,)."""
        return np.zeros(len(self.scale)) if self.noise.patch is None else self.noise.patch / self.scale**2

    @cached_property
    def model(self) -> ResponseModel:
        """Response model of the scaled responses that the estimators train with."""
        return fit_response_model(self.scaled, self.priors, self.patch_variance)

    @cached_property
    def best_response(self) -> BestResponse:
        """Response model of the scaled responses that the calibration file stores; uses the chart and ``given``."""
        return best_response(self.scaled, self.spectra, self.light, self.patch_variance, self.given)

    @cached_property
    def priors(self) -> tuple[SmoothPrior, ...]:
        """Priors of the response model."""
        return smooth_priors(self.spectra, self.light)

    @cached_property
    def pixel_variance(self) -> np.ndarray:
        """Variance of a pixel's scaled response, (bands,)."""
        if self.noise.pixel is None:
            return self.model.noise
        return self.noise.pixel / self.scale**2

    @cached_property
    def paints(self) -> tuple[np.ndarray, np.ndarray]:
        """Patches and their mixtures, (n, 61), and their weights, (n,)."""
        return self._members(np.arange(len(self.spectra)))

    @cached_property
    def different_paints(self) -> tuple[np.ndarray, np.ndarray]:
        """As `paints`, but patches with the same spectrum, such as greys along a chart's edges, count as one paint."""
        return self._members(twins(self.spectra))

    def _members(self, paint: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return patches and mixtures with weights: equal shares, each divided by the mean reflectance.

        The division gives dark colours the weight that they have in ΔE. ``paint``, (m,) int, is the same number for
        patches that count as one.
        """
        _, first, which, count = np.unique(paint, return_index=True, return_inverse=True, return_counts=True)
        mixtures = mix_paints(self.spectra[first])
        spectra = np.concatenate([self.spectra, mixtures])
        share = 1.0 / (count[which] * len(first))
        weight = np.concatenate([share, np.full(len(mixtures), 1.0 / max(len(mixtures), 1))])
        weight = weight / np.maximum(spectra.mean(axis=1), _LEAST_REFLECTANCE)
        return spectra, weight / weight.sum()

    @cached_property
    def population(self) -> Population:
        """Population of the patches and their mixtures, with small clouds (`PAINTS`)."""
        return self.members(*self.paints, *PAINTS)

    @cached_property
    def wide_population(self) -> Population:
        """Population of the patches and their mixtures, each paint once, with large clouds (`ANYTHING`)."""
        return self.members(*self.different_paints, *ANYTHING)

    def members(self, spectra: np.ndarray, weight: np.ndarray, spread: float, length_nm: float) -> Population:
        """Return the population of given spectra (n, 61), weights (n,) and clouds (see `PAINTS`)."""
        model = self.model
        response, bands = spectra @ model.mean.T, len(model.mean)
        cloud = spread**2 * smooth_covariance(length_nm)
        level = spectra.mean(axis=1)[:, None, None] ** 2
        seen = model.mean @ cloud
        unsure = np.stack([np.einsum("ni,ni->n", spectra @ c, spectra) for c in model.covariance], axis=1)
        excess = level * (seen @ model.mean.T) + unsure[:, :, None] * np.eye(bands)
        return Population(
            spectra=spectra,
            weight=weight,
            response=response,
            excess=excess,
            size=level[:, 0, 0],
            cloud=seen,
        )
