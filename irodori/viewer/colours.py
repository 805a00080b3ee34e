"""Tables of the illuminants, observers, displays and colour deficiencies that a classroom page offers."""

from collections.abc import Iterable

import numpy as np

from irodori.colour.colorimetry import colour_matching_weights
from irodori.colour.display import STANDARD
from irodori.colour.tone_curves import SRGB
from irodori.spectra.grid import WAVELENGTH_NM
from irodori.spectra.published import light
from irodori.spectra.published_tables import published_matrix, published_table

#: Name in a page -> description in the page.
ILLUMINANTS = {
    "D65": "CIE D65, daylight",
    "D50": "CIE D50, daylight of the morning",
    "A": "CIE A, light bulb",
    "FL2": "CIE FL2, cool white fluorescent",
    "FL11": "CIE FL11, fluorescent of three bands",
    "FL12": "CIE FL12, warm fluorescent of three bands",
    "LED-B1": "CIE LED-B1, warm white LED",
    "LED-B3": "CIE LED-B3, neutral white LED",
    "LED-B5": "CIE LED-B5, cool white LED",
    "LED-RGB1": "CIE LED-RGB1, red, green and blue LEDs",
    "LED-V1": "CIE LED-V1, LED with a violet pump",
    "E": "CIE E, the same power everywhere",
}
#: Name in a page -> name in colour-science, and description in the page.
OBSERVERS = {
    "CIE 1931 2°": ("CIE 1931 2 Degree Standard Observer", "small fields; what the other figures are computed with"),
    "CIE 1964 10°": ("CIE 1964 10 Degree Standard Observer", "large fields"),
    "CIE 2015 2°": ("CIE 2015 2 Degree Standard Observer", "from cone fundamentals, small fields"),
    "CIE 2015 10°": ("CIE 2015 10 Degree Standard Observer", "from cone fundamentals, large fields"),
}
#: Dichromats: name in a page -> name in colour-science.
DEFICIENCIES = {"protan": "Protanomaly", "deutan": "Deuteranomaly", "tritan": "Tritanomaly"}


def illuminants(further: Iterable[str] = ()) -> list[dict]:
    """Return the illuminants and further ones by name, each with its relative power at the 61 wavelengths."""
    return [
        {"name": name, "label": label, "power": [float(x) for x in light(name) / light(name).max()]}
        for name, label in (ILLUMINANTS | {name: name for name in further if name not in ILLUMINANTS}).items()
    ]


def observers() -> list[dict]:
    """Return the observers, each with the weights that integrate a spectrum of 61 samples into X, Y and Z."""
    return [
        {"name": name, "label": label, "xyz": [[float(x) for x in row] for row in colour_matching_weights(table).T]}
        for name, (table, label) in OBSERVERS.items()
    ]


def daylight() -> list[list[float]]:
    """Return the mean and the two principal components of CIE daylight, (3, 61), which give any colour temperature."""
    return published_table("daylight").at(WAVELENGTH_NM).tolist()


def displays() -> list[dict]:
    """Return the displays with sRGB's tone curve, each with its matrix from XYZ to linear RGB and its white (Y = 1)."""
    return [
        {
            "name": name,
            "rgb_from_xyz": np.linalg.inv(published_matrix(f"xyz_from_rgb/{name}")).tolist(),
            "white_xyz": published_matrix(f"white_xyz/{name}").tolist(),
        }
        for name, curve in STANDARD.items()
        if curve is SRGB
    ]


def deficiencies() -> list[dict]:
    """Return the matrices on linear sRGB that simulate dichromats, after Machado et al. (2009)."""
    return [
        {"name": name, "rgb_from_rgb": published_matrix(f"rgb_from_rgb/{table}").tolist()}
        for name, table in DEFICIENCIES.items()
    ]
