"""From an omnidirectional picture to compressed light and its irradiance map: equations (4) and (8)."""

import numpy as np

from irodori import store
from irodori.colour import xyz_from_radiance
from irodori.errors import InputError
from irodori.irradiance import fitted_irradiance_map
from irodori.light import Environment
from irodori.principal import compress
from irodori.progress import LOGGER
from irodori.recovery import Calibration


def fill_masked(response: np.ndarray, masked: np.ndarray) -> np.ndarray:
    """Return a panorama whose single masked pixels take the mean of their neighbours along the row.

    Parameters
    ----------
    response : (height, width, bands) float
        Longitude by latitude: the row closes on itself.
    masked : (height, width) bool

    Raises
    ------
    ValueError
        If a masked pixel has a masked neighbour in its row.
    """
    left, right = np.roll(masked, 1, axis=1), np.roll(masked, -1, axis=1)
    if (masked & (left | right)).any():
        raise ValueError(f"{int((masked & (left | right)).sum())} masked pixels beside each other in a row")
    filled = response.copy()
    rows, columns = np.nonzero(masked)
    width = response.shape[1]
    filled[rows, columns] = 0.5 * (response[rows, columns - 1] + response[rows, (columns + 1) % width])
    return filled


def prepare_environment(
    linear,
    calibration_file,
    output,
    target_mean: float,
    align: int,
    irradiance_options: dict,
    provenance: store.Provenance,
) -> None:
    """Write an environment's file from the linear responses of its omnidirectional picture.

    The camera was calibrated on reflectances under the rig's light E; a radiance is recovered as E(λ) times the
    reflectance that would have given the same responses.

    Raises
    ------
    InputError
        If a pixel is saturated in every bracket, or masked pixels stand beside each other.

    Notes
    -----
    A single masked pixel, hot in the camera, is filled from its neighbours along the row; the log says how many.
    """
    with store.open_file(linear) as file:
        response, valid = file.read("response"), file.read("valid").astype(bool)
        clipped = file.read("clipped").astype(bool)
        filters = file.attribute("filters")
    if clipped.any():
        found = f"{int(clipped.sum())} pixels saturated in every bracket"
        raise InputError(linear, "exposure_s", found, "a shorter bracket of the environment")
    if not valid.all():
        try:
            response = fill_masked(response, ~valid)
        except ValueError as error:
            accepted = "masked pixels that stand alone, or a stitched panorama"
            raise InputError(linear, "valid", str(error), accepted) from None
        LOGGER.info("%d masked pixels filled from their neighbours along the row", int((~valid).sum()))
    calibration = Calibration.load(calibration_file)
    calibration.require_filters(filters, linear)
    height, width = valid.shape
    weights = calibration.weights(response).reshape(height * width, -1)
    basis = calibration.basis * calibration.light[:, None]
    # The colour of the light is judged against the rig's light as white.
    matrix = xyz_from_radiance(calibration.light)
    observers = {"light": (matrix, matrix @ calibration.light)}
    compressed = compress(weights, basis, observers, target_mean, align)
    coefficients = compressed.coefficients.reshape(height, width, -1)
    irradiance, irradiance_errors = fitted_irradiance_map(coefficients, **irradiance_options)
    errors = {
        "delta_e": compressed.errors,
        "negative_fraction": compressed.negative_fraction,
        "irradiance": irradiance_errors,
    }
    Environment(coefficients, compressed.basis, irradiance).save(output, provenance, errors)
    LOGGER.info(
        "%d bases of %d; CIEDE2000 of the compression mean %.3f p99 %.3f; negative samples %.2f %%",
        compressed.basis.shape[1],
        basis.shape[1],
        compressed.errors["light"]["mean"],
        compressed.errors["light"]["p99"],
        100 * compressed.negative_fraction,
    )
