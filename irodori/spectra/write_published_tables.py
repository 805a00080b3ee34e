"""Script that writes the tables that `irodori.spectra.published_tables` reads, from the library colour-science.

Run ``python -m irodori.spectra.write_published_tables``.
"""

import warnings
from collections.abc import Iterator
from pathlib import Path

import colour
import h5py
import numpy as np
from colour.characterisation import SDS_COLOURCHECKERS
from colour.quality.cfi2017 import load_TCS_CIE2017
from colour.recovery import MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019

from irodori.spectra.published_names import (
    CAMERAS,
    CHART_PATCHES,
    DEFICIENCIES,
    DISPLAYS,
    ILLUMINANTS,
    OBSERVERS,
    TEST_COLOURS,
)
from irodori.spectra.published_tables import TABLES, PublishedTable

#: What the spectra of a table are, by the first part of its name.
_QUANTITIES = {
    "illuminants": "relative spectral power",
    "light_sources": "relative spectral power",
    "daylight": "component of relative spectral power",
    "charts": "reflectance factor",
    "test_colours": "reflectance factor",
    "cameras": "relative spectral sensitivity",
    "observers": "colour-matching function",
    "srgb_primaries": "component of a reflectance factor",
}
#: Kind of matrix -> its quantity and its axes.
_MATRICES: dict[str, tuple[str, ...]] = {
    "xyz_from_rgb": ("tristimulus values of linear RGB", "tristimulus", "primary"),
    "white_xyz": ("tristimulus values of the white", "tristimulus"),
    "rgb_from_rgb": ("linear sRGB as a dichromat sees linear sRGB", "seen", "primary"),
}
_LETTERS = {"tristimulus": ("X", "Y", "Z"), "primary": ("R", "G", "B"), "seen": ("R", "G", "B")}


def library_tables() -> Iterator[tuple[str, PublishedTable]]:
    """Yield name and content of every table of the file, from colour-science."""
    for name in ILLUMINANTS:
        yield f"illuminants/{name}", _table([name], [colour.SDS_ILLUMINANTS[name]])
    # Their names have slashes, which part the groups of the file: one table, of those published every 5 nm.
    lamps = {name: one for name, one in colour.SDS_LIGHT_SOURCES.items() if one.shape.interval == 5}
    yield "light_sources", _table(lamps, lamps.values())
    for name in CHART_PATCHES:
        yield f"charts/{name}", _table(SDS_COLOURCHECKERS[name], SDS_COLOURCHECKERS[name].values())
    for name in CAMERAS:
        yield f"cameras/{name}", _columns("rgb", colour.MSDS_CAMERA_SENSITIVITIES[name])
    for name in OBSERVERS:
        yield f"observers/{name}", _columns("xyz", colour.MSDS_CMFS[name])
    components = colour.colorimetry.SDS_BASIS_FUNCTIONS_CIE_ILLUMINANT_D_SERIES
    yield "daylight", _table(components, components.values())
    yield "test_colours", _columns(TEST_COLOURS, load_TCS_CIE2017(colour.SpectralShape(380, 780, 5)))
    yield "srgb_primaries", _columns("rgb", MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019)


def library_matrices() -> Iterator[tuple[str, np.ndarray]]:
    """Yield name and content of every matrix of the file, from colour-science."""
    for name in DISPLAYS:
        space = colour.RGB_COLOURSPACES[name]
        yield f"xyz_from_rgb/{name}", space.matrix_RGB_to_XYZ
        yield f"white_xyz/{name}", colour.xy_to_XYZ(space.whitepoint)
    for name in DEFICIENCIES:
        with warnings.catch_warnings():
            # The library warns that tritanomaly is an approximation; the page states that too.
            warnings.simplefilter("ignore", colour.utilities.ColourUsageWarning)
            yield f"rgb_from_rgb/{name}", colour.matrix_cvd_Machado2009(name, 1.0)


def _table(names, distributions) -> PublishedTable:
    """Return a table of single spectral distributions of colour-science, which must have the same wavelengths."""
    distributions = list(distributions)
    return PublishedTable(
        distributions[0].wavelengths, np.stack([one.values for one in distributions]), tuple(map(str, names))
    )


def _columns(names, distributions) -> PublishedTable:
    return PublishedTable(distributions.wavelengths, distributions.values.T, tuple(names))


def write_published_tables(path: Path = TABLES) -> None:
    """Write the HDF5 file: one group for each table and each kind of matrix, every axis with its dimension scale."""
    with h5py.File(path, "w") as file:
        for name, table in library_tables():
            given = {"spectrum": table.names, "wavelength": table.wavelength_nm}
            _write(file.create_group(name), "value", table.spectra, given, _QUANTITIES[name.partition("/")[0]])
        for name, matrix in library_matrices():
            kind, _, of = name.partition("/")
            quantity, *axes = _MATRICES[kind]
            _write(file.require_group(kind), of, matrix, {axis: _LETTERS[axis] for axis in axes}, quantity)


def _write(group: h5py.Group, name: str, values: np.ndarray, axes: dict, quantity: str) -> None:
    """Write a dataset and the dimension scales of its axes that the group does not have yet."""
    packed = {"compression": "gzip", "shuffle": True} if values.size > 1000 else {}
    dataset = group.create_dataset(name, data=values, track_times=False, **packed)
    dataset.attrs.update({"units": "1", "dims": ",".join(axes), "quantity": quantity})
    for number, (axis, along) in enumerate(axes.items()):
        if axis not in group:
            text = not isinstance(along, np.ndarray)
            scale = np.array(along, dtype=h5py.string_dtype()) if text else along
            group.create_dataset(axis, data=scale, track_times=False).make_scale(axis)
            group[axis].attrs.update({"units": "nm" if axis == "wavelength" else "1", "dims": axis})
        dataset.dims[number].attach_scale(group[axis])


if __name__ == "__main__":
    write_published_tables()
