"""Camera sensitivity per wavelength, estimated from a chart under a smoothness prior."""

from dataclasses import dataclass

import numpy as np

from irodori.spectra.grid import WAVELENGTH_NM

#: Values tried: correlation lengths of a sensitivity with its filter, nm, and prior variances relative to the data's.
_LENGTHS_NM = (10.0, 15.0, 20.0, 30.0, 40.0)
_AMPLITUDES = 10.0 ** np.arange(-2.0, 5.0)
#: Values tried: variances of patch means in addition to the known variance, relative to the responses' mean square.
_EXTRA_NOISE = 10.0 ** np.arange(-10.0, -1.0)


def smooth_covariance(length_nm: float) -> np.ndarray:
    """Return the squared-exponential covariance of unit variance over the grid, (61, 61)."""
    distance = (WAVELENGTH_NM[:, None] - WAVELENGTH_NM) / length_nm
    return np.exp(-0.5 * distance**2)


@dataclass(frozen=True)
class ResponseModel:
    """Responses per unit reflectance and wavelength, with their uncertainty.

    Parameters
    ----------
    mean : (bands, 61) float64
    covariance : (bands, 61, 61) float64
    noise : (bands,) float64
        Variance of patch means: the given variance and the additional variance that fits the data best.
    """

    mean: np.ndarray
    covariance: np.ndarray
    noise: np.ndarray


@dataclass(frozen=True)
class SmoothPrior:
    """Gaussian prior of a smooth sensitivity times the light, and the resulting prior of a chart's responses.

    Parameters
    ----------
    covariance : (61, 61) float64
        Covariance of the response per unit reflectance, up to a factor.
    values : (m,) float64, vectors : (m, m) float64
        Eigenvalues and eigenvectors of the resulting covariance of the m patches' responses.
    turned : (m, 61) float64
        Covariance between the patches' responses, projected on the eigenvectors, and the response per unit reflectance.
    """

    covariance: np.ndarray
    values: np.ndarray
    vectors: np.ndarray
    turned: np.ndarray


def smooth_priors(spectra: np.ndarray, light: np.ndarray) -> tuple[SmoothPrior, ...]:
    """Return one prior for each correlation length that is tried; spectra are (m, 61), the light (61,)."""
    shape = np.asarray(light) / np.mean(light)
    found = []
    for length in _LENGTHS_NM:
        covariance = shape[:, None] * smooth_covariance(length) * shape
        cross = spectra @ covariance
        values, vectors = np.linalg.eigh(cross @ spectra.T)
        found.append(SmoothPrior(covariance, np.maximum(values, 0.0), vectors, vectors.T @ cross))
    return tuple(found)


def fit_response_model(
    response: np.ndarray, priors: tuple[SmoothPrior, ...], patch_variance: np.ndarray
) -> ResponseModel:
    """Return the posterior of the response model under a prior of smooth sensitivities times the light.

    For each band, correlation length, amplitude and additional noise maximise the marginal likelihood over a fixed
    grid, with one eigendecomposition for each length (Rasmussen and Williams 2006, section 5.4).

    Parameters
    ----------
    response : (m, bands) float64
    priors : tuple of SmoothPrior
        See `smooth_priors`.
    patch_variance : (bands,) float64
        Known variance of patch means; zeros if unknown.
    """
    total = np.mean(response**2, axis=0)
    best = np.full(response.shape[1], -np.inf)
    chosen: list = [None] * response.shape[1]
    noise = np.maximum(patch_variance, 0.0)[:, None] + _EXTRA_NOISE * total[:, None]
    for prior in priors:
        turned = (prior.vectors.T @ response).T
        amplitude = _AMPLITUDES * total[:, None] / np.mean(prior.values)
        # Bands, amplitudes, noises, eigenvalues.
        variance = amplitude[:, :, None, None] * prior.values + noise[:, None, :, None]
        likelihood = -0.5 * (turned[:, None, None] ** 2 / variance + np.log(variance)).sum(axis=3)
        for band, own in enumerate(likelihood):
            i, j = np.unravel_index(np.argmax(own), own.shape)
            if own[i, j] > best[band]:
                best[band] = own[i, j]
                chosen[band] = (prior, amplitude[band, i], noise[band, j], turned[band])
    mean, covariance = [], []
    for prior, size, own_noise, turned in chosen:
        gain = size * prior.turned / (size * prior.values + own_noise)[:, None]
        mean.append(turned @ gain)
        covariance.append(size * (prior.covariance - prior.turned.T @ gain))
    return ResponseModel(np.array(mean), np.array(covariance), np.array([own_noise for _, _, own_noise, _ in chosen]))
