"""From an omnidirectional picture to compressed light and its irradiance map: equations (4) and (8)."""

from irodori import store
from irodori.colour import xyz_from_radiance
from irodori.errors import InputError
from irodori.light import Environment, irradiance_map
from irodori.principal import compress
from irodori.progress import LOGGER
from irodori.recovery import Calibration


def prepare_environment(
    linear,
    calibration_file,
    output,
    target_mean: float,
    align: int,
    irradiance_size: dict,
    provenance: store.Provenance,
) -> None:
    """Write an environment's file from the linear responses of its omnidirectional picture.

    The camera was calibrated on reflectances under the rig's light E; a radiance is recovered as E(λ) times the
    reflectance that would have given the same responses.

    Raises
    ------
    InputError
        If a pixel is saturated in every bracket.
    """
    with store.open_file(linear) as file:
        response, valid = file.read("response"), file.read("valid").astype(bool)
        filters = file.attribute("filters")
    if not valid.all():
        raise InputError(
            linear,
            "exposure_s",
            f"{int((~valid).sum())} pixels saturated in every bracket",
            "a shorter bracket of the environment",
        )
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
    irradiance = irradiance_map(coefficients, irradiance_size["width"], irradiance_size["height"])
    errors = {"delta_e": compressed.errors, "negative_fraction": compressed.negative_fraction}
    Environment(coefficients, compressed.basis, irradiance).save(output, provenance, errors)
    LOGGER.info(
        "%d bases of %d; CIEDE2000 of the compression mean %.3f p99 %.3f; negative samples %.2f %%",
        compressed.basis.shape[1],
        basis.shape[1],
        compressed.errors["light"]["mean"],
        compressed.errors["light"]["p99"],
        100 * compressed.negative_fraction,
    )
