"""Coordinates of the axes that files of several stages share: wavelength and band."""

from collections.abc import Sequence

from irodori.core.errors import InputError
from irodori.core.store import Writer
from irodori.spectra.grid import WAVELENGTH_NM

_COLOURS = ("red", "green", "blue")


def write_wavelength(out: Writer) -> None:
    """Write ``/wavelength`` (61) in nm into an open file that has a spectral axis."""
    out.coordinate("wavelength", WAVELENGTH_NM, units="nm", quantity="wavelength")


def require_bands(filters: Sequence[str], bands: int, path) -> None:
    """Refuse a file of responses whose bands are not three for each of its filter states.

    Raises
    ------
    InputError
    """
    if bands != len(_COLOURS) * len(filters):
        found = f"{len(filters)} filter states and {bands} bands"
        raise InputError(path, "filters", found, "three bands a filter state")


def write_bands(out: Writer, filters: Sequence[str]) -> None:
    """Write ``/band``, the names of the bands, into an open file.

    Parameters
    ----------
    out : Writer
    filters : sequence of str
        Filter states of the bands in order, three bands each: ``out`` and ``in`` give ``out_red`` to ``in_blue``.
    """
    names = [f"{state}_{colour}" for state in filters for colour in _COLOURS]
    out.coordinate("band", names, units="1", quantity="state of the filter and colour of the sensor")
