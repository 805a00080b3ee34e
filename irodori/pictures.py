"""Pictures in files through OpenImageIO: spectral EXR (published layout) and display PNG with its ICC profile."""

import os
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from irodori.errors import InputError
from irodori.spectra import WAVELENGTH_NM


def channel_names() -> list[str]:
    """Return the channels of an emissive spectral EXR: S0.<wavelength>nm with a comma, as the layout prescribes."""
    return [f"S0.{wavelength:.6f}nm".replace(".", ",").replace("S0,", "S0.", 1) for wavelength in WAVELENGTH_NM]


def _write(path, pixels: np.ndarray, spec: oiio.ImageSpec) -> None:
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.part{path.suffix}")
    output = oiio.ImageOutput.create(str(temporary))
    if output is None:
        raise OSError(f"{path}: {oiio.geterror()}")
    try:
        if not (output.open(str(temporary), spec) and output.write_image(pixels) and output.close()):
            raise OSError(f"{path}: {output.geterror()}")
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_spectral_exr(path, radiance: np.ndarray, rgb: np.ndarray, attributes: dict[str, str]) -> None:
    """Write a spectral radiance image (Fichet et al. 2021, *An OpenEXR Layout for Spectral Images*).

    Parameters
    ----------
    radiance : (height, width, 61) float32, relative radiance
    rgb : (height, width, 3) float
        Linear sRGB for viewers that know no spectra.
    attributes : dict of str
        Further text attributes.
    """
    height, width = radiance.shape[:2]
    names = ["R", "G", "B", *channel_names()]
    spec = oiio.ImageSpec(width, height, len(names), "float")
    spec.channelnames = names
    spec.attribute("compression", "zip")
    spec.attribute("spectralLayoutVersion", "1.0")
    spec.attribute("emissiveUnits", "relative spectral radiance")
    for name, value in attributes.items():
        spec.attribute(name, value)
    _write(path, np.ascontiguousarray(np.concatenate([rgb, radiance], axis=-1), dtype=np.float32), spec)


def read_spectral_exr(path) -> np.ndarray:
    """Read the S0 layers of a spectral EXR on the 61 wavelengths, (height, width, 61) float32.

    Raises
    ------
    InputError
        If the file is missing, truncated, or lacks a wavelength.
    """
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise InputError(path, "", f"a file OpenImageIO cannot open ({oiio.geterror()})", "a spectral EXR")
    try:
        names = list(source.spec().channelnames)
        pixels = source.read_image("float")
    finally:
        source.close()
    if pixels is None:
        raise InputError(path, "", "a truncated EXR", "a whole spectral EXR")
    available = {}
    for index, name in enumerate(names):
        if name.startswith("S0.") and name.endswith("nm"):
            available[round(float(name[3:-2].replace(",", ".")), 3)] = index
    missing = [w for w in WAVELENGTH_NM if round(float(w), 3) not in available]
    if missing:
        raise InputError(path, "channels", f"no layer for {missing[0]:g} nm", "layers S0.400nm to S0.700nm, step 5")
    return pixels[..., [available[round(float(w), 3)] for w in WAVELENGTH_NM]]


def write_png(path, pixels: np.ndarray) -> None:
    """Write an 8-bit sRGB picture, (height, width, 3) uint8, with its ICC profile."""
    from PIL import ImageCms

    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "uint8")
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(profile)}]"), np.frombuffer(profile, dtype=np.uint8))
    spec.attribute("oiio:ColorSpace", "sRGB")
    _write(path, np.ascontiguousarray(pixels), spec)
