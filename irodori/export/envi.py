"""ENVI files through Spectral Python, written a few rows at a time."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from irodori.spectra.grid import WAVELENGTH_NM

INTERLEAVES = ("bsq", "bil", "bip")
_ROWS = 32


def write_envi(
    path, size: tuple[int, int], names: list[str], rows: Callable[[slice], np.ndarray], *, interleave: str, units: str
) -> None:
    """Write a picture of 32-bit floats; header and data appear under their names when they are complete.

    Parameters
    ----------
    path : path
        Path of the data, ``.img``; the header has the same name with the suffix ``.hdr``.
    size : (height, width)
    names : list of str
        Names of the bands. If there are 61, the bands are spectral samples, and the header lists their wavelengths in
        nm.
    rows : callable
        Function of a slice of rows that returns their pixels, (rows, width, bands).
    interleave : str
        Order of the numbers: ``bsq``, band after band; ``bil``, row after row, with the bands of each row in turn;
        ``bip``, pixel after pixel.
    units : str
        Description in the header.

    Raises
    ------
    ValueError
        For an unknown interleave.
    """
    if interleave not in INTERLEAVES:
        raise ValueError(f"unknown interleave {interleave!r}; accepted: {', '.join(INTERLEAVES)}")
    from spectral.io import envi

    path = Path(path)
    header = {"description": units, "band names": names, "data ignore value": "nan"}
    if len(names) == WAVELENGTH_NM.size:
        header |= {"wavelength": [f"{w:g}" for w in WAVELENGTH_NM], "wavelength units": "Nanometers"}
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part.hdr")
    try:
        image = envi.create_image(
            str(temporary), header, dtype=np.float32, shape=(*size, len(names)), interleave=interleave, force=True
        )
        pixels = image.open_memmap(interleave="bip", writable=True)
        for first in range(0, size[0], _ROWS):
            part = slice(first, min(first + _ROWS, size[0]))
            pixels[part] = rows(part)
        pixels.flush()
        os.replace(temporary.with_suffix(".img"), path)
        os.replace(temporary, path.with_suffix(".hdr"))
    finally:
        temporary.unlink(missing_ok=True)
        temporary.with_suffix(".img").unlink(missing_ok=True)
