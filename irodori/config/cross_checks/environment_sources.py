"""Checks of an environment's light source: required keys and named files."""

from pathlib import Path

from irodori.config.cross_checks.named_spectra import check_index
from irodori.config.models import (
    CapturesSource,
    EnvironmentDefinition,
    LightsSource,
    MirrorBallSource,
    RgbSource,
    SpectralSource,
)
from irodori.core.errors import InputError, is_file

_OF_A_CAMERA = ("camera", "captures", "exposure_s", "virtual")


def is_photographed(environment: EnvironmentDefinition) -> bool:
    """Whether a camera photographs the place, as against a file of another program or placed lights."""
    return isinstance(environment.source, CapturesSource | MirrorBallSource)


def check_source(environment: EnvironmentDefinition, root: Path, file) -> None:
    """Refuse an environment whose keys are not those of its source, or whose files are not there.

    Raises
    ------
    InputError
        For the first fault.
    """
    source, kind, given = environment.source, environment.source.kind, environment.given()
    lights = isinstance(source, LightsSource)
    for key in ("camera", "image") if is_photographed(environment) else ("image",) if lights else ():
        if key not in given:
            raise InputError(file, key, "no such key", f"this key, because the source is of kind {kind}")
    unused = () if is_photographed(environment) else (*_OF_A_CAMERA, *(() if lights else ("image",)))
    for key in unused:
        if key in given:
            found = f"a key that a source of kind {kind} does not use"
            raise InputError(file, key, found, "to leave it out")
    if isinstance(source, RgbSource | SpectralSource) and not is_file(root / source.file):
        raise InputError(file, "source.file", f"no such file: {source.file}", "a picture of the light")
    if isinstance(source, MirrorBallSource):
        _check_ball(source, root, file)
    for index, light in enumerate(source.lights if isinstance(source, LightsSource) else ()):
        if (light.radiance is None) == (light.irradiance is None):
            found = "neither" if light.radiance is None else "both"
            field = f"source.lights[{index}].irradiance"
            raise InputError(file, field, f"{found} of radiance and irradiance", "one of radiance and irradiance")
        if light.radiance is not None and light.diameter_deg == 0.0:
            field = f"source.lights[{index}].diameter_deg"
            raise InputError(file, field, "0, whose radiance gives no light", "irradiance, or a diameter above 0")


def _check_ball(source: MirrorBallSource, root: Path, file) -> None:
    index = source.refractive_index
    if (index is None) == (source.reflectance_factor is None):
        found = "both of refractive_index and reflectance_factor" if index else "no such key, nor reflectance_factor"
        accepted = "one of refractive_index and reflectance_factor, of the ball's surface"
        raise InputError(file, "source.refractive_index", found, accepted)
    if index is not None:
        check_index(index, root, file, "source.refractive_index")
