"""Readers of pictures that Irodori wrote, as other programs read them: spectra, and the loss that a file states."""

import re
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from irodori.export.loss import LOSS, Loss


def spectra_in(path: Path | str, kind: str = "S0") -> tuple[np.ndarray, np.ndarray]:
    """Return the wavelengths of a spectral EXR, nm, and its layers of a kind, ``S0`` or ``T``, (h, w, n) float32."""
    picture = oiio.ImageBuf(str(path))
    names = [re.fullmatch(rf"{kind}\.([\d,]+)nm", name) for name in picture.spec().channelnames]
    layers = sorted((float(name[1].replace(",", ".")), channel) for channel, name in enumerate(names) if name)
    pixels = picture.get_pixels("float")[..., [channel for _, channel in layers]]
    scale = np.float32(picture.spec().getattribute("irodori:scale") or 1.0)
    return np.array([wavelength for wavelength, _ in layers]), pixels / scale


def loss_stated_in(path: Path | str) -> Loss:
    """Return the loss that the attributes of a picture state, or its description where it has no others."""
    spec = oiio.ImageBuf(str(path)).spec()
    text = spec.getattribute(LOSS) or spec.get_string_attribute("ImageDescription")
    *figures, count = re.search(r"CIEDE2000 mean (\S+), p95 (\S+), max (\S+), of (\d+)", text).groups()
    return Loss(int(count), *map(float, figures))
