"""Predicted error of a recovered light, over the published illuminants that match its six responses.

A camera that was calibrated on a chart under one lamp answers to a light L(λ) with Σ R_b L dλ, where the calibration's
response model tells R_b. The lights of a family that could have given a picture's responses scatter: by the family's
second moment, what the responses say of the light is a Gaussian whose mean and covariance are those of Wiener's
estimate. Its difference to the recovered light is the error that is expected of that.
"""

from dataclasses import replace

import numpy as np

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.recovery.mappings import LinearMapping
from irodori.colour.colorimetry import colour_matching_weights
from irodori.light.environment_file import Environment
from irodori.spectra.published import spectrum
from irodori.spectra.published_names import ILLUMINANTS

_LEAST_EIGENVALUE = 1e-9  # of the responses' covariance, relative: below it a response tells nothing new


def family() -> np.ndarray:
    """Return the published illuminants of colour-science, each of luminance 1, (lights, 61).

    CIE A to E, the D series, fluorescent, high-pressure and LED illuminants, indoor daylight, and those of ISO 7589.
    """
    lights = np.stack([spectrum(name) for name in ILLUMINANTS])
    return lights / (lights @ colour_matching_weights()[1])[:, None]


def responses_from_light(calibration: Calibration) -> np.ndarray:
    """Return what turns a recovered light into the responses it was recovered from, (bands, 61).

    Exact where the estimator is linear and has as many bases as bands; else by the response model.

    Raises
    ------
    ValueError
        If the calibration states no response model.
    """
    model = sensitivity(calibration)
    matrix = calibration.weights_from_response
    is_linear = isinstance(calibration.mapping, LinearMapping)
    if is_linear and matrix is not None and matrix.shape[1] >= matrix.shape[0]:
        return np.linalg.pinv(matrix.T) @ np.linalg.pinv(calibration.basis * calibration.light[:, None])
    return model


def sensitivity(calibration: Calibration) -> np.ndarray:
    """Return the responses per unit radiance at each wavelength, (bands, 61).

    Raises
    ------
    ValueError
        If the calibration states no response model.
    """
    if calibration.band_response is None:
        raise ValueError("a calibration without a response model; accepted: one that the stage wrote")
    return calibration.band_response / calibration.light


def posterior(model: np.ndarray, lights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what is known of a light from its responses.

    Parameters
    ----------
    model : (bands, 61) float
        Responses per unit radiance.
    lights : (n, 61) float
        The family, each of luminance 1.

    Returns
    -------
    mean_from_response : (61, bands) float64
    root : (61, 61) float64
        Times a standard normal (61,) and a luminance: a draw about that mean.
    """
    moment = lights.T @ lights / len(lights)
    cross = moment @ model.T
    values, vectors = np.linalg.eigh(model @ cross)
    kept = values > _LEAST_EIGENVALUE * values[-1]
    mean_from_response = cross @ (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    spread, axes = np.linalg.eigh(moment - mean_from_response @ cross.T)
    return mean_from_response, axes * np.sqrt(np.maximum(spread, 0.0))


def drawn_lights(
    light: Environment, calibration: Calibration, lights: np.ndarray, count: int, rng: np.random.Generator
) -> list[Environment]:
    """Return lights that the photograph of an environment could have been of.

    What its responses leave open is drawn once for all directions, in proportion to their luminance: the lamps of a
    room are of few kinds.

    Parameters
    ----------
    light : Environment
        As it was recovered through the calibration.
    calibration : Calibration
    lights : (n, 61) float
        See `family`.
    count : int
    rng : Generator
    """
    mean_from_response, root = posterior(sensitivity(calibration), lights)
    mean = mean_from_response @ (responses_from_light(calibration) @ light.basis)
    luminance = colour_matching_weights()[1] @ light.basis
    # The irradiance map is on the same basis, so that a change of the basis is all there is.
    return [
        replace(light, basis=mean + np.outer(root @ rng.standard_normal(len(root)), luminance)) for _ in range(count)
    ]
