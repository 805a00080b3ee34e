"""Names of published spectra and colour data, checked without loading colour-science.

The spectra are those of colour-science, see `irodori.spectra.published_tables`; a test compares the names with it.
"""

import re

#: CIE and ISO illuminants: ``colour.SDS_ILLUMINANTS``.
ILLUMINANTS = (
    *["A", "B", "C", "D50", "D55", "D60", "D65", "D75", "E"],
    *(f"FL{number}" for number in range(1, 13)),
    *(f"FL3.{number}" for number in range(1, 16)),
    *(f"HP{number}" for number in range(1, 6)),
    *["LED-B1", "LED-B2", "LED-B3", "LED-B4", "LED-B5", "LED-BH1", "LED-RGB1", "LED-V1", "LED-V2", "ID65", "ID50"],
    "ISO 7589 Photographic Daylight",
    "ISO 7589 Sensitometric Daylight",
    "ISO 7589 Studio Tungsten",
    "ISO 7589 Sensitometric Studio Tungsten",
    "ISO 7589 Photoflood",
    "ISO 7589 Sensitometric Photoflood",
    "ISO 7589 Sensitometric Printer",
)

#: Correlated colour temperatures of CIE daylight ``D<n>`` (CIE 15) and temperatures of blackbodies ``P<n>``, K.
DAYLIGHT_K = (4000, 25000)
BLACKBODY_K = (1000, 20000)
_SYNTHETIC = re.compile(r"([DP])(\d{4,5})")


def synthetic_light(name: str) -> tuple[str, int] | None:
    """Split the name of a light such as ``D5500`` or ``P2856`` into letter and temperature in K; None for others."""
    match = _SYNTHETIC.fullmatch(name)
    if match is None:
        return None
    low, high = DAYLIGHT_K if match[1] == "D" else BLACKBODY_K
    return (match[1], int(match[2])) if low <= int(match[2]) <= high else None


#: Test colours of CIE 224:2017.
TEST_COLOURS = tuple(f"TCS{number}" for number in range(99))

#: Colour charts and their patches (count): ``colour.characterisation.SDS_COLOURCHECKERS``.
CHART_PATCHES = {
    "BabelColor Average": 24,
    "ColorChecker N Ohta": 24,
    "ISO 17321-1": 24,
    "PMC": 30,
    "babel_average": 24,
    "cc_ohta": 24,
}

#: Colour-matching functions: ``colour.MSDS_CMFS``.
OBSERVERS = (
    "CIE 1931 2 Degree Standard Observer",
    "CIE 1964 10 Degree Standard Observer",
    "CIE 2015 2 Degree Standard Observer",
    "CIE 2015 10 Degree Standard Observer",
)

#: Primaries and whites of displays: ``colour.RGB_COLOURSPACES``.
DISPLAYS = ("sRGB", "Display P3", "Adobe RGB (1998)")

#: Deficiencies of colour vision: ``colour.blindness.CVD_MATRICES_MACHADO2010``.
DEFICIENCIES = ("Protanomaly", "Deuteranomaly", "Tritanomaly")

#: Cameras: ``colour.MSDS_CAMERA_SENSITIVITIES``.
CAMERAS = ("Nikon 5100 (NPL)", "Sigma SDMerill (NPL)")
