"""Environments from the files of other programs: RGB pictures of high dynamic range and spectral EXR."""

import numpy as np
import OpenImageIO as oiio

from irodori.errors import InputError
from irodori.omnidirectional import Picture, from_panorama
from irodori.pictures import read_layers
from irodori.progress import LOGGER
from irodori.spectra import WAVELENGTH_NM, light
from irodori.spectra.resampling import resample_picture

_RGB_ASSUMPTION = (
    "linear sRGB primaries; the spectrum of a pixel is R r(λ) + G g(λ) + B b(λ) of Mallett and Yuksel (2019) times "
    "D65, the smooth spectrum that has its colour: what the lights of the place really emit is not in the file"
)


def mallett_basis() -> np.ndarray:
    """Return the spectra of the linear sRGB primaries (Mallett and Yuksel 2019), (61, 3), times D65, 100 at 560 nm.

    Their sum is D65, and an RGB of linear sRGB relative to D65 = (1, 1, 1) has its own colour.
    """
    from colour.recovery import MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019 as functions

    columns = [np.interp(WAVELENGTH_NM, functions.wavelengths, column) for column in functions.values.T]
    return np.stack(columns, axis=1) * light("D65")[:, None]


def _read_rgb(path) -> np.ndarray:
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise InputError(path, "", f"a file OpenImageIO cannot open ({oiio.geterror()})", "an HDR or EXR picture")
    try:
        spec = source.spec()
        names, depth = list(spec.channelnames), str(spec.format)
        pixels = source.read_image("float")
    finally:
        source.close()
    if depth not in ("half", "float", "double"):
        accepted = "linear light: half or float samples, as EXR and Radiance HDR have"
        raise InputError(path, "", f"{depth} samples, which are made for a display", accepted)
    if pixels is None:
        raise InputError(path, "", "a truncated picture", "a whole HDR or EXR picture")
    missing = [name for name in "RGB" if name not in names]
    if missing:
        found = f"no channel {missing[0]} among {', '.join(names[:6])}"
        raise InputError(path, "channels", found, "the channels R, G and B")
    return pixels[..., [names.index(name) for name in "RGB"]]


def _finite(pixels: np.ndarray, path) -> None:
    bad = int((~np.isfinite(pixels)).any(axis=-1).sum())
    if bad:
        raise InputError(path, "", f"{bad} pixels that are not finite", "finite radiance everywhere")


def rgb_picture(path, scale: float = 1.0, centre_azimuth_deg: float = 0.0) -> Picture:
    """Return the light of an RGB panorama, spectra by Mallett and Yuksel (2019), an assumption.

    Parameters
    ----------
    path : path
        EXR, Radiance HDR or TIFF of half or float samples; linear sRGB primaries; clockwise, the zenith on top.
    scale : float
        Radiance of RGB (1, 1, 1), relative: 1 has the luminance of D65 as tabulated, 100 at 560 nm.
    centre_azimuth_deg : float, degrees
        Azimuth of the middle of the picture.

    Raises
    ------
    InputError
        If the file cannot be read, has no R, G and B, is made for a display, or a pixel is not finite.

    Notes
    -----
    Negative values, which lossy compression and wide gamuts leave, are set to 0 and counted in ``origin``.
    """
    pixels = _read_rgb(path)
    _finite(pixels, path)
    negative = pixels < 0.0
    count = int(negative.any(axis=-1).sum())
    if count:
        LOGGER.info("%d of %d pixels had negative values, set to 0", count, negative[..., 0].size)
    weights = from_panorama(np.maximum(pixels, 0.0) * np.float32(scale), centre_azimuth_deg)
    origin = {
        "kind": "rgb",
        "assumption": _RGB_ASSUMPTION,
        "negative_pixels": count,
        "negative_sum_over_positive": float(
            -pixels[negative].sum(dtype=np.float64) / max(weights.sum() / scale, 1e-30)
        ),
    }
    return Picture(np.ascontiguousarray(weights), mallett_basis(), origin)


def spectral_picture(path, scale: float = 1.0, centre_azimuth_deg: float = 0.0) -> Picture:
    """Return the light of a spectral EXR in the published layout, brought to the 61 wavelengths.

    Parameters
    ----------
    path : path
        Emissive layers ``S0.<wavelength>`` of any wavelengths that cover 400 to 700 nm; clockwise, the zenith on top.
    scale : float
        Factor on the file's radiance.
    centre_azimuth_deg : float, degrees

    Raises
    ------
    InputError
        If the file cannot be read, holds no emissive layers (a picture of reflectances is no light), does not cover the
        wavelengths, or a value is not finite.
    """
    wavelength_nm, pixels = read_layers(path, "S0")
    _finite(pixels, path)
    values = resample_picture(wavelength_nm, pixels, path)
    negative = values < 0.0
    count = int(negative.any(axis=-1).sum())
    if count:
        LOGGER.info("%d pixels had negative values, set to 0", count)
        values[negative] = 0.0
    origin = {
        "kind": "spectral",
        "negative_pixels": count,
        "wavelengths_nm": [float(wavelength_nm[0]), float(wavelength_nm[-1]), len(wavelength_nm)],
    }
    weights = from_panorama(values * np.float32(scale), centre_azimuth_deg)
    return Picture(np.ascontiguousarray(weights), np.eye(WAVELENGTH_NM.size), origin)
