"""Coordinates of the axes ``wavelength`` and ``band``, which files of several stages have in common."""

from collections.abc import Sequence

from irodori.core.errors import InputError
from irodori.core.store import Writer
from irodori.spectra.grid import WAVELENGTH_NM

_COLOURS = ("red", "green", "blue")


def write_wavelength(out: Writer) -> None:
    """Write ``/wavelength`` (61) in nm into an open file that has a spectral axis."""
    out.coordinate("wavelength", WAVELENGTH_NM, units="nm", quantity="wavelength")


def require_bands(filters: Sequence[str], bands: int, path) -> None:
    """Raise an error unless a file of responses has three bands for each of its filter states.

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
        Filter states in order, three bands each: for ``out`` and ``in`` the bands are ``out_red`` to ``in_blue``.
    """
    names = [f"{state}_{colour}" for state in filters for colour in _COLOURS]
    out.coordinate("band", names, units="1", quantity="state of the filter and colour of the sensor")
