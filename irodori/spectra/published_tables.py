"""Tables of colour-science that ship with this package: importing that library costs every process two seconds.

Run ``python -m irodori.spectra.write_published_tables`` after an update of colour-science; a test fails until then.
"""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

TABLES = Path(__file__).with_name("published_tables.h5")


class PublishedTable(NamedTuple):
    """Spectra as they were published, at wavelengths of their own.

    wavelength_nm : (n,) float64, ascending
    spectra : (spectra, n) float64
    names : tuple of str, one a spectrum
    """

    wavelength_nm: np.ndarray
    spectra: np.ndarray
    names: tuple[str, ...]

    def at(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the spectra at other wavelengths, (spectra, wavelengths): linear between samples, held at the ends."""
        return np.stack([np.interp(wavelength_nm, self.wavelength_nm, row) for row in self.spectra])


@cache
def published_table(name: str) -> PublishedTable:
    """Return a table by its name in the file.

    Parameters
    ----------
    name : str
        ``test_colours`` (CIE 224:2017), ``light_sources`` (measured lamps), ``daylight`` (the three components of CIE
        daylight), ``srgb_primaries`` (Mallett and Yuksel 2019), or ``illuminants/``, ``observers/``, ``charts/`` or
        ``cameras/`` and a name of `irodori.spectra.published_names`.

    Raises
    ------
    KeyError
        If there is no such table.
    """
    with h5py.File(TABLES) as file:
        table = file[name]
        names = tuple(table["spectrum"].asstr()[()].tolist())
        return PublishedTable(table["wavelength"][()], table["value"][()], names)


@cache
def published_matrix(name: str) -> np.ndarray:
    """Return a matrix by its name in the file, not to be written to.

    Parameters
    ----------
    name : str
        ``xyz_from_rgb/`` (of linear RGB, white has Y = 1), ``white_xyz/`` (Y = 1) and a display, or ``rgb_from_rgb/``
        (linear sRGB as a dichromat sees it, Machado et al. 2009) and a deficiency of `irodori.spectra.published_names`.

    Returns
    -------
    (3, 3) float64; (3,) of a white

    Raises
    ------
    KeyError
        If there is no such matrix.
    """
    with h5py.File(TABLES) as file:
        values = file[name][()]
    values.flags.writeable = False
    return values
