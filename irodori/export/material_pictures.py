"""Export of materials and environments for other programs, as spectral EXR, TIFF or ENVI.

Spectral EXR has the published layout (Fichet et al. 2021). TIFF has 32-bit floats with one channel for each wavelength.
OpenImageIO writes both. ENVI, plain numbers with a text header, is written by Spectral Python, because OpenImageIO
cannot. Spectra are decoded a few rows at a time. A material has the layers ``T.<λ>nm`` (reflectance) and α, β, μ. An
environment has ``S0.<λ>nm``, as a panorama in the usual orientation: azimuth increases clockwise, 0 is in the middle.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from irodori.colour.colorimetry import xyz_from_radiance, xyz_from_reflectance
from irodori.colour.display import rgb_from_xyz
from irodori.core import store
from irodori.core.errors import InputError
from irodori.export.diffuse_picture import colours_from_bands, diffuse_colours
from irodori.export.envi import INTERLEAVES, write_envi
from irodori.export.loss import LOSS, Loss, Losses, stored_loss
from irodori.export.pictures import layer_names, specification, write_picture_file
from irodori.light.environment_file import Environment
from irodori.light.omnidirectional import to_panorama
from irodori.material.material_file import Material, gloss_maps
from irodori.spectra.grid import WAVELENGTH_NM

SUFFIXES = (".exr", ".tif", ".tiff", ".img")
_ROWS = 32
_ENVI_BANDS = [f"{wavelength:g} nm" for wavelength in WAVELENGTH_NM]  # without commas, which separate the list


def _write(path, size: tuple[int, int], names: list[str], attributes: dict, rows: Callable) -> None:
    """Write a picture; ``rows`` returns the channels of a slice of rows, (rows, width, channels)."""
    height, _ = size
    spec = specification(size, names, {"compression": "zip", "oiio:RowsPerStrip": _ROWS, **attributes})
    parts = (slice(first, min(first + _ROWS, height)) for first in range(0, height, _ROWS))
    write_picture_file(path, spec, (rows(part).astype(np.float32, copy=False) for part in parts))


def _attributes(units: str, names: list[str], loss: str) -> dict:
    return {
        "spectralLayoutVersion": "1.0",
        "irodori:units": units,
        "irodori:channels": " ".join(names),
        LOSS: loss,
        # TIFF has no names of channels: the description lists them in order.
        "ImageDescription": f"channels: {' '.join(names)}; {units}; {LOSS} {loss}",
    }


def export_material(source, path, interleave: str = "bsq") -> Loss:
    """Write the diffuse reflectance of a material, and its maps of α and of β and μ of every gloss component.

    The reflectance is α S(λ) / S_G, as it is rendered: that of the diffuse term with its level in the green band fitted
    to all photographs. It is not to be multiplied by α again. The description in the file states the loss by 32-bit
    numbers.

    Parameters
    ----------
    source : path
        ``material.h5``. Texels without data stay NaN.
    path : path
        ``.exr`` or ``.tif``, where the channels R, G, B are linear sRGB under D65; or ``.img`` for ENVI. An ENVI file
        lists wavelengths for all bands or for none, so the maps are in a second file, ``<name>-maps.img``.
    interleave : str
        Order of the numbers in ENVI files, see `irodori.export.envi.write_envi`.

    Returns
    -------
    Loss
        Colour differences under D65 between the spectra as written and the diffuse colours of the material in double
        precision.
    """
    material = Material.load(source)
    own = ["alpha", *gloss_maps(material.lobes)]
    names = ["R", "G", "B", *layer_names("T"), *own]
    to_xyz = xyz_from_reflectance("D65")
    to_rgb = rgb_from_xyz(to_xyz.sum(axis=1)) @ to_xyz

    scale = material.spectrum_scale[..., None]

    def decoded(part: slice) -> np.ndarray:
        return scale[part].astype(np.float32) * (material.coefficients[part] @ material.basis.T)

    def maps(part: slice) -> np.ndarray:
        gloss = [values[part] for _, *pair in material.gloss for values in pair]
        return np.stack([material.alpha[part], *gloss], axis=-1)

    def rows(part: slice) -> np.ndarray:
        spectra = decoded(part)
        return np.concatenate([spectra @ to_rgb.T, spectra, maps(part)], axis=-1)

    exact_basis = material.basis.astype(np.float64)

    def exact(part: slice) -> np.ndarray:
        spectra = scale[part] * (material.coefficients[part].astype(np.float64) @ exact_basis.T)
        return np.where(material.observed[part, :, None], spectra, np.nan)

    def stored(part: slice) -> np.ndarray:
        return decoded(part).astype(np.float32)

    loss = stored_loss(to_xyz, to_xyz.sum(axis=1), exact, stored, len(material.coefficients))
    stated = f"{loss.text}, spectra under D65"
    reflectance = "diffuse reflectance factor as rendered (alpha is in it), 1 = perfect diffuser"
    units_of = {
        name: "a ratio" if units == "1" else f"in {units}" for name, (units, _) in gloss_maps(material.lobes).items()
    }
    ratios = ", ".join(["alpha is a ratio", *(f"{name} is {unit}" for name, unit in units_of.items())])
    if _is_envi(path):
        size, beside = material.alpha.shape, Path(path).with_name(f"{Path(path).stem}-maps.img")
        write_envi(path, size, _ENVI_BANDS, decoded, interleave=interleave, units=f"{reflectance}; {LOSS} {stated}")
        write_envi(beside, size, own, maps, interleave=interleave, units=ratios)
        return loss
    _write(path, material.alpha.shape, names, _attributes(f"{reflectance}; {ratios}", names, stated), rows)
    return loss


def export_environment(source, path, interleave: str = "bsq") -> Loss | str:
    """Write the radiance of an environment as a panorama.

    The description in the file states the loss by 32-bit numbers.

    Parameters
    ----------
    source : path
        File of an environment.
    path : path
        ``.exr`` or ``.tif``, where the channels R, G, B are linear sRGB with a perfect diffuser that faces up as white;
        or ``.img`` for ENVI.
    interleave : str
        Order of the numbers in ENVI files, see `irodori.export.envi.write_envi`.

    Returns
    -------
    Loss or str
        Colour differences between the pixels as written and those of the light in double precision, with a perfect
        diffuser that faces up as white. If no light falls on such a diffuser: a text with this reason.
    """
    environment = Environment.load(source)
    names = ["R", "G", "B", *layer_names("S0")]
    to_rgb = _rgb_from_radiance(environment)

    def decoded(part: slice) -> np.ndarray:
        return to_panorama(environment.coefficients[part].astype(np.float32)) @ environment.basis.T

    def rows(part: slice) -> np.ndarray:
        spectra = decoded(part)
        return np.concatenate([spectra @ to_rgb.T, spectra], axis=-1)

    loss = _loss_of_light(environment, decoded)
    stated = f"{loss.text}, white is a diffuser that faces up" if isinstance(loss, Loss) else loss
    units = "relative spectral radiance"
    if _is_envi(path):
        size = environment.coefficients.shape[:2]
        write_envi(path, size, _ENVI_BANDS, decoded, interleave=interleave, units=f"{units}; {LOSS} {stated}")
        return loss
    attributes = _attributes(units, names, stated) | {"emissiveUnits": units}
    _write(path, environment.coefficients.shape[:2], names, attributes, rows)
    return loss


def _loss_of_light(environment: Environment, decoded: Callable[[slice], np.ndarray]) -> Loss | str:
    """Return the loss of a panorama by 32-bit numbers, or the reason why it cannot be computed."""
    white = environment.upward_white()
    if not (white > 0).any():
        return "not measured: nothing lights a diffuser that faces up, which counts as white"
    matrix, basis = xyz_from_radiance(white), environment.basis.astype(np.float64)

    def exact(part: slice) -> np.ndarray:
        return to_panorama(environment.coefficients[part].astype(np.float64)) @ basis.T

    def stored(part: slice) -> np.ndarray:
        return decoded(part).astype(np.float32)

    return stored_loss(matrix, matrix @ white, exact, stored, len(environment.coefficients))


def stored_preview(source) -> np.ndarray:
    """Return a preview of a material or an environment in linear sRGB, (height, width, 3).

    A material appears in its diffuse colour under D65, NaN at texels without data; an environment as a panorama with a
    perfect diffuser that faces up as white.
    """
    if _is_material(source):
        return diffuse_colours(Material.load(source), colours_from_bands("D65"))
    environment = Environment.load(source)
    return to_panorama(environment.coefficients @ (_rgb_from_radiance(environment) @ environment.basis).T)


def _rgb_from_radiance(environment: Environment) -> np.ndarray:
    """Return the matrix from radiance to linear sRGB, (3, 61); zeros if no light falls on a diffuser that faces up."""
    white = environment.upward_white()
    if not (white > 0).any():
        return np.zeros((3, WAVELENGTH_NM.size))
    matrix = xyz_from_radiance(white)
    return rgb_from_xyz(matrix @ white) @ matrix


def _is_envi(path) -> bool:
    return Path(path).suffix.lower() == ".img"


def export_picture(source, path, interleave: str | None = None) -> Losses:
    """Write a material or an environment in the format given by the suffix of ``path``.

    Parameters
    ----------
    source, path : path
    interleave : str, optional
        Order of the numbers in ENVI files, ``bsq`` by default; see `irodori.export.envi.write_envi`.

    Returns
    -------
    Losses
        One entry, see `export_material` and `export_environment`.

    Raises
    ------
    InputError
        For another suffix, a file that is neither a material nor an environment, an unknown interleave, or an
        interleave for another format than ENVI.
    """
    if interleave is not None and not (_is_envi(path) and interleave in INTERLEAVES):
        raise InputError(path, "interleave", interleave, f"one of {', '.join(INTERLEAVES)}, with the suffix .img")
    interleave = interleave or INTERLEAVES[0]
    if Path(path).suffix.lower() not in SUFFIXES:
        raise InputError(path, "", f"the suffix {Path(path).suffix!r}", f"one of {', '.join(SUFFIXES)}")
    if _is_material(source):
        return {"spectra, under D65": export_material(source, path, interleave)}
    return {"light of every direction": export_environment(source, path, interleave)}


def _is_material(source) -> bool:
    """Return True for the file of a material and False for that of an environment; raise `InputError` for others."""
    with store.open_file(source) as file:
        is_material, is_environment = "reflectance/coefficients" in file, "irradiance" in file
    if not (is_material or is_environment):
        raise InputError(source, "", "neither a material nor an environment", "material.h5 or an environment's file")
    return is_material
