"""Predicted colour errors of candidate filters for the second shot, from measured curves.

The estimator is the plain Wiener filter. With reflectances s of the training set, K = E[s sᵀ] (no mean is subtracted),
responses ρ = H s + e and noise of variance σ² on every band of full scale 1, it is A = K Hᵀ (H K Hᵀ + σ² I)⁻¹
(Pratt and Mancill 1976; Haneishi et al. 2000, doi:10.1364/AO.39.006621). Its spectral error is in closed form,
E|s - A ρ|² = |(I - A H) s|² + σ² tr(A Aᵀ); CIEDE2000 is not, and is averaged over noise of a fixed seed, the same for
all filters, so that their order does not depend on luck.
"""

from dataclasses import dataclass

import numpy as np

from irodori.calibration.simulated_responses import band_weights
from irodori.colour.colorimetry import delta_e, lab_from_xyz, xyz_from_reflectance
from irodori.spectra.grid import SAMPLES

#: Directions of H K Hᵀ below this fraction of the largest carry no signal, which matters without noise only.
_RANK_TOLERANCE = 1e-12
#: Colours that are compared for each filter: their mean then scatters by about 1 %, alike for all filters.
_COLOURS = 5000
NO_FILTER = "(one shot, no filter)"


@dataclass(frozen=True)
class FilterScore:
    """Predicted errors of one filter as the second shot.

    Parameters
    ----------
    name : str
    delta_e_mean, delta_e_p95 : float
        CIEDE2000 over the test set and the noise.
    rmse_mean, rmse_p95 : float
        Spectral RMSE, root mean square over the noise for each reflectance of the test set, then over the set.
    exposure_ratio : float
        How many times longer the second shot's brightest band must be exposed to be as bright as the first's; infinite
        for a filter that passes nothing.
    darkest_band : float
        Response of a perfect diffuser in the darkest band of the last shot, as a fraction of full scale.
    """

    name: str
    delta_e_mean: float
    delta_e_p95: float
    rmse_mean: float
    rmse_p95: float
    exposure_ratio: float
    darkest_band: float


def rank_filters(
    sensitivities: np.ndarray,
    filters: dict[str, np.ndarray],
    light: np.ndarray,
    training: np.ndarray,
    test: np.ndarray,
    noise: float,
    *,
    exposure: str = "per_shot",
    viewing_light: str = "D65",
) -> list[FilterScore]:
    """Predict the errors of six bands, three without and three with each filter, of a camera of known sensitivities.

    Parameters
    ----------
    sensitivities : (3, 61) float
    filters : dict of (61,) float
        Name to transmittance, 0..1.
    light : (61,) float
    training, test : (n, 61) float
        Reflectances for the second moments of the estimator, and reflectances on which it is tested.
    noise : float
        Standard deviation of a pixel as a fraction of full scale.
    exposure : str
        Exposure of the shots, see `irodori.calibration.simulated_responses.band_weights`. By default each shot is
        exposed for its own brightest band, so that the score includes the noise of bands that the filter darkens more
        than others; the longer exposure itself is returned as `exposure_ratio`.
    viewing_light : str
        Light under which colours are compared.

    Returns
    -------
    list of FilterScore, the smallest mean CIEDE2000 first, one shot without any filter among them

    Raises
    ------
    ValueError
        For a negative noise, an unknown exposure, and values that are negative or not finite.
    """
    if not (np.isfinite(noise) and noise >= 0.0):
        raise ValueError(f"noise of {noise}; accepted: a fraction of full scale from 0")
    draws = -(-_COLOURS // (2 * len(test)))  # pairs of opposite noise for each reflectance
    training, test = (np.asarray(values, dtype=np.float64) for values in (training, test))
    moments = training.T @ training / len(training)
    half = np.random.default_rng(0).standard_normal((draws, len(test), 6))
    judge = _Judge(test, moments, noise, noise * np.concatenate([half, -half]), viewing_light)
    time_ratio = _Exposure(sensitivities, light)
    scores = [judge.score(NO_FILTER, band_weights(sensitivities, light, None, exposure), 1.0)]
    for name, transmittance in filters.items():
        weights = band_weights(sensitivities, light, transmittance, exposure)
        scores.append(judge.score(name, weights, time_ratio(transmittance)))
    return sorted(scores, key=lambda score: (score.delta_e_mean, score.name))


def wiener_estimator(weights: np.ndarray, moments: np.ndarray, noise: float) -> np.ndarray:
    """Return the plain Wiener filter A, from responses to reflectance, (61, bands).

    Parameters
    ----------
    weights : (bands, 61) float, H
    moments : (61, 61) float, K
    noise : float, σ

    Notes
    -----
    Without noise the inverse is a pseudo-inverse, so that linearly dependent bands and bands without signal have no
    effect.
    """
    cross = moments @ weights.T
    signal = weights @ cross
    if noise > 0.0:
        return np.linalg.solve(signal + noise**2 * np.eye(len(weights)), cross.T).T
    return cross @ np.linalg.pinv(signal, rcond=_RANK_TOLERANCE, hermitian=True)


class _Exposure:
    """Function from a filter's transmittance (61,) to the exposure time with it, relative to that without it."""

    def __init__(self, sensitivities: np.ndarray, light: np.ndarray) -> None:
        self.sensitivities, self.light = sensitivities, light

    def __call__(self, transmittance: np.ndarray) -> float:
        brightest = band_weights(self.sensitivities, self.light, transmittance, "same_time")[3:].sum(axis=1).max()
        return float(1.0 / brightest) if brightest > 0.0 else float("inf")


class _Judge:
    """Scoring of systems of bands on one test set, light and draw of noise."""

    def __init__(self, test, moments, noise: float, drawn: np.ndarray, viewing_light: str) -> None:
        self.test, self.moments, self.noise, self.drawn = test, moments, noise, drawn
        self.xyz_from_reflectance = xyz_from_reflectance(viewing_light)
        self.white = self.xyz_from_reflectance.sum(axis=1)
        self.lab = lab_from_xyz(test @ self.xyz_from_reflectance.T, self.white)

    def score(self, name: str, weights: np.ndarray, exposure_ratio: float) -> FilterScore:
        """Return the predicted errors of a system of bands with `weights` (bands, 61)."""
        estimator = wiener_estimator(weights, self.moments, self.noise)
        response = self.test @ weights.T
        bias = self.test - response @ estimator.T
        rmse = np.sqrt(np.mean(bias**2, axis=1) + self.noise**2 * np.sum(estimator**2) / SAMPLES)
        # XYZ is linear in the response: no spectrum is needed for the noisy ones.
        xyz_from_response = self.xyz_from_reflectance @ estimator
        xyz = (response + self.drawn[..., : len(weights)]) @ xyz_from_response.T
        error = delta_e(np.broadcast_to(self.lab, xyz.shape), lab_from_xyz(xyz, self.white))
        return FilterScore(
            name=name,
            delta_e_mean=float(error.mean()),
            delta_e_p95=float(np.percentile(error, 95)),
            rmse_mean=float(rmse.mean()),
            rmse_p95=float(np.percentile(rmse, 95)),
            exposure_ratio=exposure_ratio,
            darkest_band=float(weights[-3:].sum(axis=1).min()),
        )
