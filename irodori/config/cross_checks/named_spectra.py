"""Checks of the spectra that definitions name: published names, or complete tables of the right quantity."""

import difflib
import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from irodori.config.definition import Definition
from irodori.config.models import Chart, GivenFilter, IndexTable, RefractiveIndex
from irodori.config.validation import dotted
from irodori.core.errors import InputError, is_file
from irodori.spectra.published_names import (
    BLACKBODY_K,
    CAMERAS,
    CHART_PATCHES,
    DAYLIGHT_K,
    ILLUMINANTS,
    TEST_COLOURS,
    synthetic_light,
)
from irodori.spectra.spectral_files import SUFFIXES, check_power, check_reflectance, filter_row, spectral_table
from irodori.spectra.tables import index_table

#: Rows and columns of the charts that can be detected without corners, and the same as text.
FOUND_LAYOUTS = ((4, 6), (10, 14), (14, 10))
FOUND_WORDS = "4 x 6 patches, a ColorChecker Classic, or 14 x 10 (letter by letter) or 10 x 14, a Digital SG"
#: Height of a triangle over its longest side below which its corners are on a line.
_FLAT = 1e-3
_BANDS = (("r", "red"), ("g", "green"), ("b", "blue"))

#: Published names of each kind of spectrum, and the same as text.
_PUBLISHED = {
    "light": (
        ILLUMINANTS,
        f"the illuminants {', '.join(ILLUMINANTS)}, D{DAYLIGHT_K[0]} to D{DAYLIGHT_K[1]} for daylight and "
        f"P{BLACKBODY_K[0]} to P{BLACKBODY_K[1]} for a blackbody of that many kelvin",
    ),
    "reflectance": (TEST_COLOURS, f"the test colours {TEST_COLOURS[0]} to {TEST_COLOURS[-1]}"),
    "chart": (tuple(CHART_PATCHES), f"the charts {', '.join(CHART_PATCHES)}"),
    "sensitivities": (CAMERAS, f"the cameras {', '.join(CAMERAS)}"),
}


def check_spectra(value, path: tuple, root: Path, file) -> None:
    """Refuse spectra that are neither published names nor tables with the quantity that their key requires.

    Parameters
    ----------
    value : Definition, mapping, sequence or scalar
        A definition, or a part of one.
    path : tuple of str and int
        Keys and indices of `value` in its definition.
    root : path
        Folder at which relative paths start.
    file : path
        File of the definition, for the error message.

    Raises
    ------
    InputError
        For the first fault.
    """
    if isinstance(value, Definition | Mapping):
        for key, item in (value.given() if isinstance(value, Definition) else value).items():
            check_spectra(item, (*path, key), root, file)
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            check_spectra(item, (*path, index), root, file)
    elif isinstance(value, str) and (kind := _kind(path)):
        _check_one(kind, value, root, file, dotted(path))


def check_light(name: str, root: Path, file) -> None:
    """Refuse a light that is neither a published illuminant nor a file of one spectrum of power.

    Parameters
    ----------
    name : str
        Name of the light, or the path of a file.
    root : path
        Folder at which relative paths start.
    file : origin of the name, for the error message

    Raises
    ------
    InputError
    """
    _check_one("light", name, root, file, "")


def check_index(index: RefractiveIndex, root: Path, file, field: str) -> None:
    """Refuse a table of refractive indices that does not exist or is not valid."""
    if isinstance(index, IndexTable):
        if not is_file(root / index.file):
            raise InputError(file, f"{field}.file", f"no such file: {index.file}", "a CSV of wavelength_nm, n, k")
        index_table(root / index.file)
    elif index.n == 1.0 and index.k == 0.0:
        found = "1, that of air, from which nothing is reflected"
        raise InputError(file, f"{field}.n", found, "the refractive index of the surface, such as 1.5")


def check_filter(given: GivenFilter, root: Path, file) -> None:
    """Refuse a filter if its table is missing, lacks it, or has no transmittances over 400 to 700 nm."""
    if not is_file(root / given.transmittance):
        accepted = f"the path of a file whose name ends in {', '.join(SUFFIXES)}"
        raise InputError(file, "comb_filter.transmittance", f"no such file: {given.transmittance}", accepted)
    filter_row(spectral_table(root / given.transmittance), given.name, root / given.transmittance)


def check_chart(chart: Chart, root: Path, file, key: str = "chart") -> None:
    """Refuse a chart with other numbers of patches in its rows and columns and in its spectra."""
    name, patches = chart.spectra, chart.rows * chart.columns
    count = CHART_PATCHES[name] if name in CHART_PATCHES else len(spectral_table(root / name).names)
    if patches != count:
        found = f"{chart.rows} rows of {chart.columns} patches, {patches} in all"
        raise InputError(file, f"{key}.rows", found, f"rows and columns that make {count} patches, as in {name}")
    _check_places(chart, file, key)


def _check_places(chart: Chart, file, key: str) -> None:
    """Refuse a chart with both or neither of given and detected positions, or without a side of its patches."""
    find, given = chart.find, chart.centres_px is not None
    if find == "chart":
        if given:
            accepted = "either centres_px, or find: chart, which needs none"
            raise InputError(file, f"{key}.centres_px", "corners of a chart that is to be found", accepted)
        if (chart.rows, chart.columns) not in FOUND_LAYOUTS:
            found = f"chart, for {chart.rows} x {chart.columns} patches"
            accepted = f"{FOUND_WORDS}; for other layouts centres_px with nothing or edges"
            raise InputError(file, f"{key}.find", found, accepted)
        return
    if not given:
        found = f"no corners where {key}.find is {find}"
        raise InputError(file, f"{key}.centres_px", found, "the centres of the four corner patches, or find: chart")
    if chart.rows > 1 and chart.columns > 1:
        corners = vars(chart.centres_px)
        for three in itertools.combinations(corners, 3):
            if _are_on_a_line([corners[name] for name in three]):
                accepted = "the centres of the four corner patches, around the chart"
                raise InputError(file, f"{key}.centres_px", f"{', '.join(three)} on a line", accepted)
    if find == "nothing" and chart.patch_px is None:
        raise InputError(
            file, f"{key}.patch_px", "no side of the patches", "a side in superpixels, or find: edges or chart"
        )


def _are_on_a_line(three: Sequence[tuple[float, float]]) -> bool:
    """Return whether three points are on a line, or two of them in one place."""
    (x0, y0), (x1, y1), (x2, y2) = three
    area = abs((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0))
    return area <= _FLAT * max(math.dist(one, other) for one, other in itertools.combinations(three, 2)) ** 2


def _kind(path: tuple) -> str | None:
    """Return the kind of the spectrum that a definition has at a path of keys; None if it is not a spectrum."""
    keys = [part for part in path if isinstance(part, str)]
    if keys[-1] in ("ambient_light", "lights", "lamps", "illuminants", "from_illuminant"):
        return "light"
    if keys[-2:] == ["sensitivities", "file"]:
        return "sensitivities"
    if keys[-1] == "spectrum":
        return "reflectance" if {"materials", "surfaces", "bodies"} & set(keys) else "light"
    if keys[-1] == "transmittance" and {"sheet", "bodies", "materials"} & set(keys):
        return "reflectance"
    kinds = {"spectra": "chart", "sensitivities": "sensitivities", "reflectance_factor": "reflectance"}
    return kinds.get(keys[-1])


def _check_one(kind: str, value: str, root: Path, file, field: str) -> None:
    names, words = _PUBLISHED[kind]
    if value in names or (kind == "light" and synthetic_light(value)):
        return
    table = root / value
    if not is_file(table):
        if _looks_like_a_path(value):
            accepted = f"the path of a file, or a published name ({words})"
            raise InputError(file, field, f"no such file: {value}", accepted)
        raise InputError(file, field, repr(value), f"{_nearest(value, names)}{words}, or the path of a file")
    if not table.suffix:
        accepted = f"a file whose name ends in {', '.join(SUFFIXES)}"
        raise InputError(file, field, f"a file without a suffix: {value}", accepted)
    _check_table(kind, table)


def _check_table(kind: str, path: Path) -> None:
    table = spectral_table(path)
    if kind == "sensitivities":
        names = [name.lower() for name in table.names]
        if len(names) != len(_BANDS) or any(n not in band for n, band in zip(names, _BANDS, strict=True)):
            found = ", ".join(["wavelength_nm", *names])
            raise InputError(path, "line 1", found, "the columns wavelength_nm, r, g, b in this order")
        return
    if kind != "chart" and len(table.names) != 1:
        raise InputError(path, "", f"{len(table.names)} spectra", "one spectrum")
    (check_power if kind == "light" else check_reflectance)(table, path)


def _looks_like_a_path(text: str) -> bool:
    return text.lower().endswith(SUFFIXES) or "/" in text or "\\" in text


def _nearest(word: str, names: tuple[str, ...]) -> str:
    """Return the beginning of a hint, ``did you mean 'D65' or 'D60'? Accepted are ``; empty if no name is similar."""
    by_small = {name.lower(): name for name in names}
    near = [repr(by_small[small]) for small in difflib.get_close_matches(word.lower(), by_small, n=5)]
    return f"did you mean {' or '.join(near)}? Accepted are " if near else ""
