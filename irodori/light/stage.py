"""Stage ``light``: compress an omnidirectional picture and compute its irradiance and gloss maps [eq. 8, 9]."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.colour.colorimetry import xyz_from_radiance
from irodori.config.cross_checks.environment_sources import check_size
from irodori.config.models import (
    CapturesSource,
    Chart,
    IrradianceMap,
    LightsSource,
    MirrorBallSource,
    RgbSource,
    Size,
    SpectralSource,
)
from irodori.core import store
from irodori.core.errors import InputError, counted
from irodori.core.progress import LOGGER
from irodori.light.environment_file import QUANTITY, Environment, PixelNoise, directions
from irodori.light.gloss_maps import GlossMaps
from irodori.light.irradiance import fitted_irradiance_map
from irodori.light.known_lamps import known_prior, require_lamps_seen, told_by
from irodori.light.light_files import rgb_picture, spectral_picture
from irodori.light.light_prior import LightPrior, prior_of_any_lamp
from irodori.light.light_recovery import Directions, LightRecovery, ResponseModel, draw_directions
from irodori.light.mirror_ball import mean_reflectance, outline_doubt, unwrapped, used_part
from irodori.light.omnidirectional import (
    KeptPicture,
    MeanLight,
    OmnidirectionalPicture,
    bands,
    from_panorama,
    refuse_saturated,
)
from irodori.light.placed_lights import lights_picture
from irodori.light.room_charts import read_room_charts, recovery_with
from irodori.light.whole_sphere import whole_sphere
from irodori.material.principal_components.basis_count import Compression, CompressOptions, choose
from irodori.material.principal_components.pixel_tiles import Tiles
from irodori.material.principal_components.second_moments import second_moments
from irodori.spectra.published import spectrum

#: The most different test colours of CIE 224; if colours on these are preserved, those on other surfaces are too.
SURFACES = ("TCS2", "TCS56", "TCS77")
_WHOLE = CapturesSource()
_STRIPS = 32  # of a mirror ball, from each of which directions are drawn; as many as a panorama of 1000 rows has
_KEPT = 8  # largest number of weights per pixel that are kept in memory; pictures with more are read twice
_READERS = {"rgb": rgb_picture, "spectral": spectral_picture}


def lost_neighbours(masked: np.ndarray) -> int:
    """Count masked pixels, (height, width), with a masked neighbour in their row, which is regarded as a circle."""
    return int((masked & (np.roll(masked, 1, axis=1) | np.roll(masked, -1, axis=1))).sum())


def fill_masked(response: np.ndarray, masked: np.ndarray) -> np.ndarray:
    """Replace masked pixels in rows of a panorama, (rows, width, bands), by the mean of their two neighbours."""
    filled = response.copy()
    rows, columns = np.nonzero(masked)
    width = response.shape[1]
    filled[rows, columns] = 0.5 * (response[rows, columns - 1] + response[rows, (columns + 1) % width])
    return filled


def _read_masks(linear, part=None) -> tuple[np.ndarray, list[str]]:
    """Read the valid pixels of a photograph and its filter states; raise an error if used pixels are saturated.

    Parameters
    ----------
    linear : path
    part : callable, optional
        Function (height, width) -> (height, width) bool that returns which pixels are used; by default all.
    """
    with store.open_file(linear) as file:
        valid, clipped = file.read("valid").astype(bool), file.read("clipped").astype(bool)
        filters = file.attribute("filters")
    refuse_saturated(clipped if part is None else clipped & part(*valid.shape), linear)
    return valid, filters


def _pixel_noise(linear, recovery: LightRecovery, drawn: Directions) -> PixelNoise | None:
    """Return the noise of a photograph in its light; None, with a warning, if the camera's noise is not known."""
    with store.open_file(linear) as file:
        if "exposure_noise" in file and np.isfinite(noise := file.read("exposure_noise")).all():
            return recovery.noise(noise, file.read("exposure_limit"), drawn)
    LOGGER.warning("%s: the camera's noise is not known, and no error of the light contains it", linear)
    return None


def _photographed(
    linear, calibration: Calibration, centre_azimuth_deg: float, recovery_of: Callable[[Directions], LightRecovery]
) -> OmnidirectionalPicture:
    """Make the picture of the light from an equirectangular photograph with merged brackets.

    Its columns run clockwise, as in every panorama seen from inside.
    """
    valid, filters = _read_masks(linear)
    calibration.require_filters(filters, linear)
    beside = lost_neighbours(~valid)
    if beside:
        found, accepted = (
            f"{counted(beside, 'masked pixel')} beside each other in a row",
            "masked pixels that stand alone",
        )
        raise InputError(linear, "valid", found, f"{accepted}, or a stitched panorama")
    if not valid.all():
        LOGGER.info("%d masked pixels filled from their neighbours along the row", int((~valid).sum()))

    def responses() -> Iterator[tuple[slice, np.ndarray]]:
        with store.open_file(linear) as file:
            for rows in bands(len(valid)):
                yield rows, fill_masked(file.read("response", rows), ~valid[rows])

    def solid_angle(rows: slice) -> np.ndarray:
        return directions(1, len(valid), rows)[1].repeat(valid.shape[1])

    parts = whole_sphere((part for _, part in responses()), valid.shape, linear)
    drawn = draw_directions(
        (part.reshape(-1, part.shape[-1]), solid_angle(rows))
        for part, rows in zip(parts, bands(len(valid)), strict=True)
    )
    recovery = recovery_of(drawn)

    def read() -> Iterator[np.ndarray]:
        for _, part in responses():
            yield from_panorama(recovery.weights(part), centre_azimuth_deg)

    return OmnidirectionalPicture(
        valid.shape, recovery.basis, read, linear, {"kind": "captures"},
        basis_errors=recovery.errors, noise=_pixel_noise(linear, recovery, drawn),
    )  # fmt: skip


def _mirror_ball(
    linear,
    calibration: Calibration,
    source: MirrorBallSource,
    image: Size,
    recovery_of: Callable[[Directions], LightRecovery],
) -> OmnidirectionalPicture:
    """Make the picture of the light around a photographed mirror ball."""
    ball = partial(used_part, source)
    valid, filters = _read_masks(linear, ball)
    calibration.require_filters(filters, linear)
    with store.open_file(linear) as file:
        response = file.read("response")
    response = np.where(valid[..., None], response, 0.0)
    if doubt := outline_doubt(source, response, linear):
        LOGGER.warning("%s: %s", linear, doubt)
    # For a distant camera, equal areas of the image of the ball show equal solid angles. Of each strip as many
    # directions are drawn as of each part of a panorama, so that small lamps are among them.
    drawn = draw_directions((strip, 1.0) for strip in np.array_split(response[ball(*valid.shape)], _STRIPS))
    recovery = recovery_of(drawn)
    picture = unwrapped(source, image, response, valid, recovery, linear)
    return replace(picture, noise=_pixel_noise(linear, recovery, drawn))


def prepare_environment(
    linear,
    calibration_file,
    output,
    options: CompressOptions,
    irradiance_options: IrradianceMap,
    provenance: store.Provenance,
    *,
    source: CapturesSource | MirrorBallSource = _WHOLE,
    image: Size | None = None,
    gloss_maps: bool = False,
    prior: LightPrior | None = None,
    room_charts: Mapping[str, tuple[object, Chart]] | None = None,
    lamps: Sequence[str] = (),
    lamps_error_percent: float | None = None,
) -> None:
    """Write the file of an environment from linear responses of its omnidirectional picture or of a mirror ball.

    The camera was calibrated on reflectances under the light of the rig. Since different lights can give the same
    responses, the expected light is estimated; see `irodori.light.light_recovery`.

    Parameters
    ----------
    linear, calibration_file : path
    output, options, irradiance_options, provenance, gloss_maps : see `write_environment`
    source : CapturesSource or MirrorBallSource
        By default a panorama with its centre at azimuth 0.
    image : Size, optional
        Size of the picture to which a mirror ball is unwrapped.
    prior : LightPrior, optional
        By default that of the published lamps.
    room_charts : mapping of str to (path, Chart), optional
        Linear file and definition of each chart in the place, by name.
    lamps : sequence of str
        All lamps of the place, as published names or paths of measured spectra; if empty, any published lamps.
    lamps_error_percent : float, optional
        How far each may differ from its spectrum; by default as `irodori.spectra.published.lamp_error` says.

    Raises
    ------
    InputError
        If a pixel is saturated in every bracket, or masked pixels are adjacent; if a panorama does not show all
        directions, see `irodori.light.whole_sphere`; if a mirror ball's outline is not where it was typed; if a chart
        in the place cannot be read, or a chart or the lamps are inconsistent with the panorama.

    Notes
    -----
    Single masked pixels, such as hot pixels, are replaced by the mean of their neighbours in the row; their number is
    logged.
    """
    calibration = Calibration.load(calibration_file)
    charts = read_room_charts(room_charts or {}, calibration)
    model = ResponseModel.of(calibration, calibration_file)
    published = prior_of_any_lamp() if prior is None else prior
    known = known_prior(lamps, lamps_error_percent) if lamps else published

    mirror = mean_reflectance(source) if isinstance(source, MirrorBallSource) else None

    def recovery_of(drawn: Directions) -> LightRecovery:
        if lamps:
            seeing = model if mirror is None else model.through(mirror)
            require_lamps_seen(lamps, drawn, seeing, known, published, linear)
        return recovery_with(charts, model, drawn, known, mirror)

    if isinstance(source, CapturesSource):
        picture = _photographed(linear, calibration, source.centre_azimuth_deg, recovery_of)
    elif image is None:
        raise ValueError("a mirror ball without the size of its picture; accepted: image")
    else:
        picture = _mirror_ball(linear, calibration, source, image, recovery_of)
    sources = [f"charts in the room ({', '.join(room_charts)})"] if room_charts else []
    picture.origin["lamps"] = " and ".join([*sources, *([told_by(lamps)] if lamps else [])]) or "published lamps"
    LOGGER.info("source of the lamps' spectra: %s", picture.origin["lamps"])
    LOGGER.info("the rig's lamp is known to %g %%, and all recovered light with it", 100.0 * calibration.light_error)
    # Colour errors of the light are computed with the light of the rig as white.
    write_environment(
        picture, calibration.light, output, options, irradiance_options, provenance, gloss_maps=gloss_maps
    )


def make_environment(
    source: RgbSource | SpectralSource | LightsSource,
    image: Size | None,
    output,
    options: CompressOptions,
    irradiance_options: IrradianceMap,
    provenance: store.Provenance,
    *,
    gloss_maps: bool = False,
) -> None:
    """Write the file of an environment from a file of another program or from lights in given directions.

    Parameters
    ----------
    source : RgbSource, SpectralSource or LightsSource
    image : Size or None
        Size of the picture of placed lights.
    output, options, irradiance_options, provenance, gloss_maps : see `write_environment`

    Raises
    ------
    InputError
        If the file is not usable.
    ValueError
        If placed lights are given without the size of their picture.
    """
    if isinstance(source, RgbSource | SpectralSource):
        picture = _READERS[source.kind](source.file, source.scale, source.centre_azimuth_deg)
        height, width = picture.size
        check_size(width, height, source.file)
    elif image is None:
        raise ValueError("placed lights without the size of their picture; accepted: image")
    else:
        picture = lights_picture(source.lights, image.width, image.height)
    write_environment(picture, None, output, options, irradiance_options, provenance, gloss_maps=gloss_maps)


def observers(white: np.ndarray) -> dict:
    """Return the observers for colour errors of a light in `basis_count.choose`: of the light itself and on surfaces.

    The colour of directly seen light has only three values. Three bases would suffice for these, but could be wrong for
    the colours of pigments under the light.
    """
    matrix = xyz_from_radiance(white)
    seen = {"light": matrix} | {f"light on {name}": matrix * spectrum(name) for name in SURFACES}
    return {name: (one, matrix @ white) for name, one in seen.items()}


def write_environment(
    picture: OmnidirectionalPicture,
    white: np.ndarray | None,
    output,
    options: CompressOptions,
    irradiance_options: IrradianceMap,
    provenance: store.Provenance,
    *,
    gloss_maps: bool = False,
) -> None:
    """Compress an omnidirectional picture, compute its maps and write the file of the environment.

    The picture is read in bands of rows. Its weights on at most 8 bases are kept in memory and replaced by the
    coefficients, k per pixel, which the maps need. A picture with more bases is read twice.

    Parameters
    ----------
    picture : OmnidirectionalPicture
    white : (61,) float or None
        Radiance of white for colour errors; if None, the mean over the sphere.
    output : path
    options : CompressOptions
    irradiance_options : IrradianceMap
        See `irodori.light.irradiance.fitted_irradiance_map`.
    provenance : Provenance
    gloss_maps : bool
        Whether light blurred for rough reflection is stored, too.

    Raises
    ------
    InputError
        If a pixel of the picture is not finite.
    """
    mean, (height, width), bases = MeanLight(picture.size), picture.size, picture.basis.shape[1]
    kept = np.empty((height, width, bases), dtype=np.float32) if bases <= _KEPT else None
    first = Tiles(picture if kept is None else KeptPicture(picture, kept))
    moments = second_moments(first, also=mean.add if white is None else None)
    if moments.masked:
        found = f"{counted(moments.masked, 'pixel')} without a finite value"
        raise InputError(picture.file, "", found, "finite radiance everywhere")
    white = mean.light(picture.basis) if white is None else white
    compression = choose(moments, picture.basis, observers(white), options)
    if kept is None:
        second, buffer = first, np.empty(height * width * compression.bases, dtype=np.float32)
    else:
        # There are no more coefficients than weights, and tiles come in order: none is overwritten before it is read.
        second, buffer = Tiles(kept), kept.reshape(-1)[: height * width * compression.bases]
    coefficients = buffer.reshape(height, width, compression.bases)
    with store.create(output, provenance) as out:
        compression.write(
            out, "coefficients", second, picture.size, quantity=QUANTITY, codec=options.codec, decoded=coefficients
        )
        irradiance, of_irradiance = fitted_irradiance_map(coefficients, **vars(irradiance_options))
        if gloss_maps:
            GlossMaps.of(coefficients).write(out, options.storage)
        errors = {
            "delta_e": compression.errors,
            "negative_fraction": compression.negative,
            "compression": compression.summary(),
            "irradiance": of_irradiance,
        }
        errors_of_basis = picture.errors_on(compression.basis)
        light = Environment(
            coefficients, compression.basis, irradiance, basis_errors=errors_of_basis, noise=picture.noise
        )
        light.write_rest(out, errors, picture.origin)
    _log(compression)


def _log(compression: Compression) -> None:
    if not compression.budget_met:
        LOGGER.warning("the colour error stays above its target with all bases; see the errors in the file")
    of_light = compression.errors["light"]
    LOGGER.info(
        "%d bases of %d; CIEDE2000 of the compression mean %.3f p99 %.3f; negative samples %.2f %%",
        compression.bases,
        compression.rank,
        of_light["mean"],
        of_light["p99"],
        100 * compression.negative,
    )
