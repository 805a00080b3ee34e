"""Tables of the library colour-science that ship with this package, because importing that library takes two seconds.

Run ``python -m irodori.spectra.write_published_tables`` after an update of colour-science; a test fails until then.
"""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

TABLES = Path(__file__).with_name("published_tables.h5")


class PublishedTable(NamedTuple):
    """Published spectra at their original wavelengths.

    wavelength_nm : (n,) float64, ascending
    spectra : (spectra, n) float64
    names : tuple of str, one for each spectrum
    """

    wavelength_nm: np.ndarray
    spectra: np.ndarray
    names: tuple[str, ...]

    def at(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the spectra at other wavelengths by linear interpolation, constant beyond the ends, (spectra, m)."""
        return np.stack([np.interp(wavelength_nm, self.wavelength_nm, row) for row in self.spectra])


@cache
def published_table(name: str) -> PublishedTable:
    """Return a table of published spectra by its name in the package's file.

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
    """Return a published colour matrix by its name in the package's file, as a read-only array.

    Parameters
    ----------
    name : str
        ``xyz_from_rgb/`` (from linear RGB, white has Y = 1) or ``white_xyz/`` (Y = 1) followed by a display, or
        ``rgb_from_rgb/`` (linear sRGB as seen by a dichromat, Machado et al. 2009) followed by a deficiency in
        `irodori.spectra.published_names`.

    Returns
    -------
    (3, 3) float64; (3,) for a white

    Raises
    ------
    KeyError
        If there is no such matrix.
    """
    with h5py.File(TABLES) as file:
        values = file[name][()]
    values.flags.writeable = False
    return values
