"""Display pictures from tristimulus values: chromatic adaptation, primaries and tone curves.

A display is described by its primaries, white and tone curve, by colour measurements, or by its ICC profile. Without a
description it is taken to be an sRGB display.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irodori.colour.icc import MOST_BYTES, Profile, read_profile, write_profile
from irodori.colour.measured_display import measured_display
from irodori.colour.tone_curves import SRGB, Curve, ParametricCurve
from irodori.config.models import (
    DisplayDevice,
    GammaTone,
    MeasuredDisplay,
    PrimariesDisplay,
    ProfileDisplay,
    StandardDisplay,
)
from irodori.core.errors import InputError
from irodori.spectra.published_tables import published_matrix

ADAPTATION = "CAT16"
#: Linear light this far outside 0..1 is rounding.
_TOLERANCE = 1e-4
#: Tone curves of the standard displays, by the name that the library colour-science gives their primaries and white.
STANDARD = {"sRGB": SRGB, "Display P3": SRGB, "Adobe RGB (1998)": ParametricCurve(563 / 256)}
#: Sharpened cone responses of CAT16.
_CONES_FROM_XYZ = np.array(
    [[0.401288, 0.650173, -0.051461], [-0.250268, 1.204414, 0.045854], [-0.002079, 0.048952, 0.953127]]
)
#: IEC 61966-2-1, which states the rounded matrix of this direction; the white is D65 of x = 0.3127, y = 0.3290.
_SRGB_FROM_XYZ = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
_D65_XYZ = np.array([0.3127, 0.3290, 1.0 - 0.3127 - 0.3290]) / 0.3290


@dataclass(frozen=True)
class Display:
    """Display with three channels of additive light.

    Parameters
    ----------
    name : str
    xyz_from_rgb : (3, 3) float
        XYZ of linear RGB above black; white, with the black under it, has Y = 1.
    curves : three tone curves, red, green, blue
    white_xyz : (3,) float
        XYZ of white, Y = 1. For sRGB it is the standard's white, from which the sum of the standard's rounded matrix
        differs in the fourth digit.
    black_xyz : (3,) float
        XYZ at code 0, on the same scale; zeros if it was not measured.
    profile : bytes
        ICC profile to embed in pictures. A profile of a matrix and curves cannot describe the light of black.
    """

    name: str
    xyz_from_rgb: np.ndarray
    curves: tuple[Curve, Curve, Curve]
    white_xyz: np.ndarray
    black_xyz: np.ndarray
    profile: bytes

    def linear_rgb(self, xyz: np.ndarray, white_xyz: np.ndarray) -> np.ndarray:
        """Return the linear RGB of a scene's colours, adapted from the scene's white to the display's white (CAT16).

        Parameters
        ----------
        xyz : (..., 3) float
        white_xyz : (3,) float
            The scene's white, on the same scale; it becomes R = G = B = 1.

        Returns
        -------
        (..., 3), of the type of ``xyz``; outside 0..1 where the display cannot show the colour
        """
        matrix, offset = self._rgb_from_xyz(white_xyz)
        return xyz @ matrix.T.astype(xyz.dtype) - offset.astype(xyz.dtype)

    def _rgb_from_xyz(self, white_xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        white = np.asarray(white_xyz, dtype=np.float64)
        gain = (_CONES_FROM_XYZ @ self.white_xyz) / (_CONES_FROM_XYZ @ (white / white[1]))
        adapt = np.linalg.inv(_CONES_FROM_XYZ) @ (gain[:, None] * _CONES_FROM_XYZ)
        rgb_from_xyz = np.linalg.inv(self.xyz_from_rgb)
        return rgb_from_xyz @ adapt / white[1], rgb_from_xyz @ self.black_xyz

    def encode(self, linear: np.ndarray, bits: int = 8) -> tuple[np.ndarray, "Gamut"]:
        """Return the code values of linear RGB, (..., 3), and a count of the pixels that are out of gamut.

        Each channel is clipped to 0..1. The code values are uint8 up to 8 bits and uint16 above.

        Raises
        ------
        ValueError
            If a number is not finite, which has no code value.
        """
        if not np.isfinite(linear).all():
            raise ValueError("linear RGB that is not finite; accepted: finite numbers")
        codes = np.stack(
            [curve.code(np.clip(linear[..., i], 0.0, 1.0)) for i, curve in enumerate(self.curves)], axis=-1
        )
        top = 2**bits - 1
        return np.rint(codes * top).astype(np.uint16 if bits > 8 else np.uint8), gamut(linear)

    def decode(self, codes: np.ndarray) -> np.ndarray:
        """Return linear RGB, (..., 3) float64, of code values (..., 3) uint8 or uint16."""
        levels = np.arange(np.iinfo(codes.dtype).max + 1) / np.iinfo(codes.dtype).max
        return np.stack([curve.linear(levels)[codes[..., i]] for i, curve in enumerate(self.curves)], axis=-1)

    def attributes(self, white_xyz: np.ndarray) -> dict[str, str]:
        """Return metadata of a picture that state its chromatic adaptation to this display."""
        return {
            "irodori:chromaticAdaptation": ADAPTATION,
            "irodori:whiteXYZ": _listed(white_xyz),
            "irodori:display": self.name,
            "irodori:displayWhiteXYZ": _listed(self.white_xyz),
        }


class Gamut(NamedTuple):
    """Numbers of pixels out of a display's gamut; a pixel can be below it in one channel and above in another."""

    pixels: int
    outside: int
    below: int  # of a colour too saturated, or darker than black: a channel under 0
    above: int  # brighter than white in a channel

    def figures(self) -> dict[str, float]:
        """Return the number and the shares of pixels out of gamut, by the names that a picture's figures have."""
        shares = {name: getattr(self, name) / self.pixels for name in ("outside", "below", "above")}
        return {
            "out_of_gamut_pixels": self.outside,
            "out_of_gamut_fraction": shares["outside"],
            "out_of_gamut_below_fraction": shares["below"],
            "out_of_gamut_above_fraction": shares["above"],
        }


def gamut(linear: np.ndarray) -> Gamut:
    """Count the pixels of linear RGB (..., 3) with a channel outside 0..1 by more than rounding."""
    below, above = (linear < -_TOLERANCE).any(axis=-1), (linear > 1 + _TOLERANCE).any(axis=-1)
    return Gamut(below.size, int((below | above).sum()), int(below.sum()), int(above.sum()))


def _listed(values) -> str:
    return " ".join(f"{value:.6g}" for value in values)


def make_display(definition: DisplayDevice) -> Display:
    """Return the display that the key ``display.device`` of a scene describes.

    Parameters
    ----------
    definition : DisplayDevice
        For a measured display, see `irodori.colour.measured_display`.

    Raises
    ------
    InputError
        If the file of a profile or of measurements is missing or not accepted.
    ValueError
        If the white is not inside the triangle of the primaries.
    """
    if isinstance(definition, StandardDisplay):
        return standard_display(definition.name)
    if isinstance(definition, PrimariesDisplay):
        return _primaries(definition)
    return _measured(definition) if isinstance(definition, MeasuredDisplay) else _profile(definition)


def standard_display(name: str) -> Display:
    """Return a display of ``STANDARD``.

    Raises
    ------
    ValueError
        If the name is not in ``STANDARD``.
    """
    if name not in STANDARD:
        raise ValueError(f"unknown display {name!r}; accepted: {', '.join(STANDARD)}")
    curve = STANDARD[name]
    if name != "sRGB":
        return _made(name, published_matrix(f"xyz_from_rgb/{name}"), (curve,) * 3)
    from PIL import ImageCms  # slow to import

    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    return Display(name, np.linalg.inv(_SRGB_FROM_XYZ), (curve,) * 3, _D65_XYZ, np.zeros(3), profile)


def _made(name: str, matrix: np.ndarray, curves, profile: bytes | None = None, black=(0.0, 0.0, 0.0)) -> Display:
    if profile is None:
        profile = write_profile(Profile(name, matrix, curves))
    black = np.asarray(black, dtype=np.float64)
    return Display(name, matrix, curves, matrix.sum(axis=1) + black, black, profile)


def _primaries(definition: PrimariesDisplay) -> Display:
    corners = np.array([definition.red_xy, definition.green_xy, definition.blue_xy, definition.white_xy])
    xyz = np.column_stack([corners[:, 0], corners[:, 1], 1.0 - corners.sum(axis=1)]).T
    white = xyz[:, 3] / xyz[1, 3]
    amounts = np.linalg.solve(xyz[:, :3], white)
    if (amounts <= 0.0).any():
        raise ValueError(f"the white {list(definition.white_xy)}; accepted: one within the triangle of the primaries")
    tone = definition.tone
    curve = ParametricCurve(tone.gamma) if isinstance(tone, GammaTone) else SRGB
    return _made("display of given primaries", xyz[:, :3] * amounts, (curve,) * 3)


def _measured(definition: MeasuredDisplay) -> Display:
    matrix, curves, black = measured_display(definition.file)
    return _made(Path(definition.file).stem, matrix, curves, black=black)


def _profile(definition: ProfileDisplay) -> Display:
    path = Path(definition.file)
    if not path.is_file():
        raise InputError(path, "", "no such file", "the ICC profile of a display")
    with open(path, "rb") as file:
        data = file.read(MOST_BYTES + 1)
    found = read_profile(data, path)
    return _made(found.description, found.xyz_from_rgb, found.curves, data)


@lru_cache(maxsize=1)
def srgb() -> Display:
    """Return the sRGB display."""
    return standard_display("sRGB")


def rgb_from_xyz(white_xyz: np.ndarray) -> np.ndarray:
    """Return the matrix from XYZ in a scene to linear sRGB.

    Parameters
    ----------
    white_xyz : (3,) float
        The scene's white, Y = 100; it becomes R = G = B = 1 by chromatic adaptation (CAT16).

    Returns
    -------
    (3, 3) float64
    """
    return srgb()._rgb_from_xyz(white_xyz)[0]
