"""Checks of an environment's light source: required keys and named files."""

from pathlib import Path

from irodori.core.errors import InputError, is_file
from irodori.spectra.tables import index_table

_PHOTOGRAPHED = ("captures", "mirror_ball")
_OF_A_CAMERA = ("camera", "captures", "exposure_s", "virtual")


def is_photographed(environment: dict) -> bool:
    """Whether a camera photographs the place, as against a file of another program or placed lights."""
    return environment["source"]["kind"] in _PHOTOGRAPHED


def check_source(environment: dict, root: Path, file) -> None:
    """Refuse an environment whose keys are not those of its source, or whose files are not there.

    Raises
    ------
    InputError
        For the first fault.
    """
    source = environment["source"]
    kind = source["kind"]
    needed = {"captures": ("camera", "image"), "mirror_ball": ("camera", "image"), "lights": ("image",)}.get(kind, ())
    for key in needed:
        if key not in environment:
            raise InputError(file, key, "no such key", f"this key, because the source is of kind {kind}")
    unused = () if is_photographed(environment) else (*_OF_A_CAMERA, *(() if kind == "lights" else ("image",)))
    for key in unused:
        if key in environment:
            found = f"a key that a source of kind {kind} does not use"
            raise InputError(file, key, found, "to leave it out")
    if "file" in source and not is_file(root / source["file"]):
        raise InputError(file, "source.file", f"no such file: {source['file']}", "a picture of the light")
    if kind == "mirror_ball":
        _check_ball(source, root, file)
    for index, light in enumerate(source.get("lights", ())):
        given = [key for key in ("radiance", "irradiance") if key in light]
        if len(given) != 1:
            found = "both" if given else "neither"
            field = f"source.lights[{index}].irradiance"
            raise InputError(file, field, f"{found} of radiance and irradiance", "one of radiance and irradiance")
        if given == ["radiance"] and light["diameter_deg"] == 0.0:
            field = f"source.lights[{index}].diameter_deg"
            raise InputError(file, field, "0, whose radiance gives no light", "irradiance, or a diameter above 0")


def _check_ball(source: dict, root: Path, file) -> None:
    given = [key for key in ("refractive_index", "reflectance_factor") if key in source]
    if len(given) != 1:
        found = "both of refractive_index and reflectance_factor" if given else "no such key, nor reflectance_factor"
        accepted = "one of refractive_index and reflectance_factor, of the ball's surface"
        raise InputError(file, "source.refractive_index", found, accepted)
    table = source.get("refractive_index", {}).get("file")
    if table is None:
        return
    if not is_file(root / table):
        found = f"no such file: {table}"
        raise InputError(file, "source.refractive_index.file", found, "a CSV of wavelength_nm, n, k")
    index_table(root / table)
