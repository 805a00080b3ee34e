"""From an omnidirectional picture to compressed light, its irradiance map and gloss maps: equations (4), (8), (9)."""

import numpy as np

from irodori import store
from irodori.colour import xyz_from_radiance
from irodori.errors import InputError
from irodori.gloss import GlossMaps
from irodori.gloss_errors import gloss_errors
from irodori.irradiance import Integrator, fitted_irradiance_map
from irodori.light import Environment
from irodori.light_files import rgb_picture, spectral_picture
from irodori.mirror_ball import RIM, unwrapped
from irodori.omnidirectional import Picture
from irodori.placed_lights import lights_picture
from irodori.principal import CompressOptions, compress
from irodori.progress import LOGGER
from irodori.recovery import Calibration

_READERS = {"rgb": rgb_picture, "spectral": spectral_picture}


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


def _read_linear(linear, part=None) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return response, mask and filter states of a photograph; refuse one that is saturated where it is used.

    Parameters
    ----------
    linear : path
    part : callable, optional
        (height, width) -> (height, width) bool, the pixels that are used; all where absent.
    """
    with store.open_file(linear) as file:
        response, valid = file.read("response"), file.read("valid").astype(bool)
        clipped = file.read("clipped").astype(bool)
        filters = file.attribute("filters")
    used = clipped if part is None else clipped & part(*valid.shape)
    if used.any():
        found = f"{int(used.sum())} pixels saturated in every bracket"
        raise InputError(linear, "exposure_s", found, "a shorter bracket of the environment")
    return response, valid, filters


def _photographed(linear, calibration: Calibration) -> Picture:
    """Return the light of an equirectangular photograph."""
    response, valid, filters = _read_linear(linear)
    if not valid.all():
        try:
            response = fill_masked(response, ~valid)
        except ValueError as error:
            accepted = "masked pixels that stand alone, or a stitched panorama"
            raise InputError(linear, "valid", str(error), accepted) from None
        LOGGER.info("%d masked pixels filled from their neighbours along the row", int((~valid).sum()))
    calibration.require_filters(filters, linear)
    basis = calibration.basis * calibration.light[:, None]
    return Picture(calibration.weights(response), basis, {"kind": "captures"})


def _mirror_ball(linear, calibration: Calibration, source: dict, image: dict) -> Picture:
    """Return the light around a photographed mirror ball."""
    (x, y), radius = source["centre_px"], source["radius_px"]

    def ball(height: int, width: int) -> np.ndarray:
        return np.hypot(np.arange(width) - x, np.arange(height)[:, None] - y) <= RIM * radius + 1.0

    response, valid, filters = _read_linear(linear, ball)
    calibration.require_filters(filters, linear)
    weights = calibration.weights(np.where(valid[..., None], response, 0.0))
    return unwrapped(source, image, weights, valid, calibration.basis * calibration.light[:, None], linear)


def prepare_environment(
    linear,
    calibration_file,
    output,
    options: CompressOptions,
    irradiance_options: dict,
    provenance: store.Provenance,
    source: dict | None = None,
    image: dict | None = None,
    with_gloss: bool = False,
) -> None:
    """Write an environment's file from the linear responses of its omnidirectional picture or of a mirror ball.

    The camera was calibrated on reflectances under the rig's light E; a radiance is recovered as E(λ) times the
    reflectance that would have given the same responses.

    Parameters
    ----------
    linear, calibration_file, output : path
    target_mean, align : see `irodori.principal.compress`
    irradiance_options : dict
        See `irodori.irradiance.fitted_irradiance_map`.
    provenance : Provenance
    with_gloss : bool
        Whether gloss maps are made, and their errors.
    source : dict, optional
        Of the environment's definition; of the kind ``captures`` where absent.
    image : dict, optional
        ``width`` and ``height`` of what a mirror ball is unwrapped to.

    Raises
    ------
    InputError
        If a pixel is saturated in every bracket, or masked pixels stand beside each other.

    Notes
    -----
    A single masked pixel, hot in the camera, is filled from its neighbours along the row; the log says how many.
    """
    calibration = Calibration.load(calibration_file)
    if source is None or source["kind"] == "captures":
        picture = _photographed(linear, calibration)
    else:
        picture = _mirror_ball(linear, calibration, source, image)
    # The colour of the light is judged against the rig's light as white.
    write_environment(picture, calibration.light, output, options, irradiance_options, provenance, with_gloss)


def make_environment(
    source: dict,
    image: dict | None,
    output,
    options: CompressOptions,
    irradiance_options: dict,
    provenance: store.Provenance,
    with_gloss: bool = False,
) -> None:
    """Write an environment's file from a file of another program or from lights placed in directions.

    Parameters
    ----------
    source : dict
        Of the kind ``rgb``, ``spectral`` or ``lights``.
    image : dict or None
        ``width`` and ``height`` of the picture of placed lights.
    output, options, irradiance_options, provenance : see `prepare_environment`

    Raises
    ------
    InputError
        If the file is at fault.
    ValueError
        For another kind.
    """
    if source["kind"] == "lights":
        picture = lights_picture(source["lights"], image["width"], image["height"])
    elif source["kind"] in _READERS:
        picture = _READERS[source["kind"]](source["file"], source["scale"], source["centre_azimuth_deg"])
    else:
        raise ValueError(f"no light is made from {source['kind']!r}; accepted: lights, {', '.join(_READERS)}")
    white = picture.mean_light()
    write_environment(picture, white, output, options, irradiance_options, provenance, with_gloss)


def write_environment(
    picture: Picture,
    white: np.ndarray,
    output,
    options: CompressOptions,
    irradiance_options: dict,
    provenance: store.Provenance,
    with_gloss: bool = False,
) -> None:
    """Compress an omnidirectional picture, integrate its maps and write the environment's file.

    Parameters
    ----------
    picture : Picture
    white : (61,) float
        Radiance as which white is judged.
    output, options, irradiance_options, provenance : see `prepare_environment`
    """
    height, width, rank = picture.weights.shape
    matrix = xyz_from_radiance(white)
    observers = {"light": (matrix, matrix @ white)}
    compressed = compress(picture.weights.reshape(height * width, rank), picture.basis, observers, options)
    coefficients = compressed.coefficients.reshape(height, width, -1)
    integrator = Integrator(coefficients)
    irradiance, irradiance_errors = fitted_irradiance_map(coefficients, **irradiance_options, integrate=integrator)
    gloss = GlossMaps.of(coefficients) if with_gloss else None
    errors = {
        "delta_e": compressed.errors,
        "negative_fraction": compressed.negative_fraction,
        "compression": compressed.compression.summary(),
        "irradiance": irradiance_errors,
    }
    if gloss is not None:
        errors["gloss"] = gloss_errors(integrator, gloss)
    Environment(coefficients, compressed.basis, irradiance).save(
        output, provenance, errors, gloss, picture.origin, storage=options.storage, codec=options.codec
    )
    if not compressed.compression.budget_met:
        LOGGER.warning("the colour error stays above its target with all bases; see the errors in the file")
    LOGGER.info(
        "%d bases of %d; CIEDE2000 of the compression mean %.3f p99 %.3f; negative samples %.2f %%",
        compressed.basis.shape[1],
        rank,
        compressed.errors["light"]["mean"],
        compressed.errors["light"]["p99"],
        100 * compressed.negative_fraction,
    )
    for row in errors.get("gloss", []):
        LOGGER.info("gloss by look-up, mu %.2f rad, view %.0f degrees: rms error %.3f", *list(row.values())[:3])
