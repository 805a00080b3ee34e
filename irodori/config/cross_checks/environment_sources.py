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
    VirtualRoom,
)
from irodori.core.errors import InputError, is_file

#: Rows from which irradiance is right to 0.7 % under even light: all of a pixel's light comes from its centre.
FEWEST_ROWS = 16
_OF_A_CAMERA = ("camera", "captures", "exposure_s", "room_charts", "lamps", "lamps_error_percent", "virtual")


def is_photographed(environment: EnvironmentDefinition) -> bool:
    """Whether a camera photographs the environment, which otherwise is a picture file or placed lights."""
    return isinstance(environment.source, CapturesSource | MirrorBallSource)


def check_source(environment: EnvironmentDefinition, root: Path, file) -> None:
    """Refuse an environment with missing or unused keys for its kind of source, or with a missing file.

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
        if given.get(key):
            found = f"a key that a source of kind {kind} does not use"
            raise InputError(file, key, found, "to leave it out")
    if (size := environment.image) is not None:
        check_size(size.width, size.height, file, "image")
    if environment.lamps_error_percent is not None and not environment.lamps:
        raise InputError(file, "lamps_error_percent", "a key without lamps", "lamps, or to leave it out")
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


def check_size(width: int, height: int, file, field: str = "") -> None:
    """Refuse an omnidirectional picture with so few pixels that its light comes from elsewhere.

    Raises
    ------
    InputError
    """
    if height < FEWEST_ROWS or width < 2 * FEWEST_ROWS:
        accepted = f"{2 * FEWEST_ROWS} x {FEWEST_ROWS} pixels or more, so that light comes from where it is"
        raise InputError(file, field, f"{width} x {height} pixels", accepted)


def check_placed_charts(environment: EnvironmentDefinition, room: VirtualRoom, file) -> None:
    """Refuse charts of a virtual room without a position, outside the room or without a direction, and vice versa.

    Raises
    ------
    InputError
        For the first fault.
    """
    for name in environment.room_charts:
        if name not in room.charts:
            raise InputError(file, f"virtual.charts.{name}", "no such key", f"where room_charts.{name} stands")
    half_m = room.room_m.width / 2.0, room.room_m.depth / 2.0
    for name, place in room.charts.items():
        field = f"virtual.charts.{name}"
        if name not in environment.room_charts:
            raise InputError(file, field, "a place without a chart", f"room_charts.{name}, or to leave it out")
        x, y, z = place.position_m
        if abs(x) >= half_m[0] or abs(y) >= half_m[1] or not 0.0 < z < room.room_m.height:
            found = f"{x:g}, {y:g}, {z:g}, outside the room"
            raise InputError(file, f"{field}.position_m", found, "a place within room_m")
        if not any(place.facing):
            raise InputError(file, f"{field}.facing", "0, 0, 0", "a direction")


def _check_ball(source: MirrorBallSource, root: Path, file) -> None:
    index = source.refractive_index
    if (index is None) == (source.reflectance_factor is None):
        found = "both of refractive_index and reflectance_factor" if index else "no such key, nor reflectance_factor"
        accepted = "one of refractive_index and reflectance_factor, of the ball's surface"
        raise InputError(file, "source.refractive_index", found, accepted)
    if index is not None:
        check_index(index, root, file, "source.refractive_index")
