"""Training data of the estimators: chart, noise, and statistics of camera and reflectances.

A chart shows two dozen reflectances; a picture shows others. Two things carry over. The *response model*, responses per
unit reflectance at each wavelength, is the light times a smooth sensitivity: its posterior under that prior gives the
response of any reflectance, with its uncertainty. The *population* is the patches and what they would give mixed as
paints (Kubelka and Munk 1931), seen through that model.
"""

from dataclasses import dataclass, replace
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
#: Standard deviation of a reflectance about a member of the population, of its level, and its correlation length, nm.
#: Those of what is not paint were taken by leaving out each patch of a ColorChecker, not from any other set.
PAINTS, ANYTHING = (0.03, 60.0), (0.2, 80.0)
_TWIN_RMS = 0.005


@dataclass(frozen=True)
class ResponseNoise:
    """Variances of what is measured, per band, in squared units of the response.

    Parameters
    ----------
    patch : (bands,) float, optional
        Of the means over the patches; None where not known: the marginal likelihood of the response model finds it.
    pixel : (bands,) float, optional
        Of a pixel that will be recovered; None where not known: that of the patches stands for it.
    """

    patch: np.ndarray | None = None
    pixel: np.ndarray | None = None


def mix_paints(spectra: np.ndarray, limit: int = _MIXTURES) -> np.ndarray:
    """Return reflectances of equal mixtures of two patches each, by the Kubelka-Munk ratio of opaque layers.

    Parameters
    ----------
    spectra : (m, 61) float
        Values outside 0.001..1 are brought there, in the mixtures only.
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
    """Return the number of the first patch of nearly the same spectrum (rms difference under 0.005), (m,) int.

    Two copies of one chart, or the greys along the edge of a large one, are one paint: with its twin among the rest,
    a patch is not left out.
    """
    difference = np.sqrt(np.mean((spectra[:, None] - spectra) ** 2, axis=-1))
    return np.argmax(difference < _TWIN_RMS, axis=1)


@dataclass(frozen=True)
class Population:
    """Reflectances that a picture may show, and what the camera answers.

    Each member stands for a small cloud of smooth spectra about it, and the response model for those it may be.

    Parameters
    ----------
    spectra : (n, 61) float64
    weight : (n,) float64
        Sum one; half on the patches, half on their mixtures, each over its level.
    response : (n, bands) float64
        Expected, scaled.
    excess : (n, bands, bands) float64
        Covariance of ρ, without the noise of a pixel.
    size : (n,) float64
        Of a member's cloud, its squared level.
    cloud : (bands, 61) float64
        Covariance of ρ and s in a cloud of size one.
    """

    spectra: np.ndarray
    weight: np.ndarray
    response: np.ndarray
    excess: np.ndarray
    size: np.ndarray
    cloud: np.ndarray


@dataclass(frozen=True)
class Training:
    """A chart as the estimators see it.

    Parameters
    ----------
    response : (m, bands) float, P
    spectra : (m, 61) float, Λ
    light : (61,) float
    noise : ResponseNoise
    pixel_levels : bool
        Whether ``local`` prepares for pixels of stated variance; what only serves cross-validation need not.
    given : Given
        What is known of the camera beside its chart; no estimator makes use of it, `best_response` does.
    """

    response: np.ndarray
    spectra: np.ndarray
    light: np.ndarray
    noise: ResponseNoise = ResponseNoise()
    pixel_levels: bool = True
    given: Given = NOTHING

    def without(self, left_out: np.ndarray, pixel_levels: bool = False) -> "Training":
        """Return the same without some patches, (m,) bool, and as a rule without levels of a pixel's noise."""
        return Training(self.response[~left_out], self.spectra[~left_out], self.light, self.noise, pixel_levels)

    def answering(self, response: np.ndarray) -> "Training":
        """Return the same patches with other responses, (m, bands); what follows from the spectra alone is shared."""
        other = replace(self, response=response)
        other.__dict__.update(priors=self.priors, paints=self.paints, different_paints=self.different_paints)
        return other

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
        """Variance of the scaled responses as far as it is known, (bands,)."""
        return np.zeros(len(self.scale)) if self.noise.patch is None else self.noise.patch / self.scale**2

    @cached_property
    def model(self) -> ResponseModel:
        """Response model of the scaled responses that the estimators train with."""
        return fit_response_model(self.scaled, self.priors, self.patch_variance)

    @cached_property
    def best_response(self) -> BestResponse:
        """Response model of the scaled responses from all that is given, as the calibration states it."""
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
        """The same, where what stands several times on a chart, as greys along the edges do, counts as one paint."""
        return self._members(twins(self.spectra))

    def _members(self, paint: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return patches and mixtures with weights: half each, over the level, since ΔE grows as light falls.

        ``paint``, (m,) int, is the same for patches that count as one.
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
        """Patches and their mixtures, and what is nearly so, seen by the camera."""
        return self.members(*self.paints, *PAINTS)

    @cached_property
    def wide_population(self) -> Population:
        """Patches and their mixtures, each paint once, and smooth reflectances far about them, seen by the camera."""
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
