"""From tristimulus values to a display picture: adaptation to the scene's white, sRGB primaries and tone curve."""

from functools import lru_cache

import colour
import numpy as np

_ADAPTATION = "CAT16"


@lru_cache(maxsize=1)
def _srgb():
    return colour.RGB_COLOURSPACES["sRGB"]


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
    d65 = colour.xy_to_XYZ(_srgb().whitepoint)
    adapt = colour.adaptation.matrix_chromatic_adaptation_VonKries(
        np.asarray(white_xyz) / white_xyz[1], d65, transform=_ADAPTATION
    )
    return _srgb().matrix_XYZ_to_RGB @ adapt / 100.0


def encode_srgb(linear: np.ndarray) -> tuple[np.ndarray, float]:
    """Return 8-bit sRGB of linear values, and the share of pixels outside 0..1 in some channel.

    Out-of-range values are clipped; the share is for the report.
    """
    outside = ((linear < -1e-4) | (linear > 1 + 1e-4)).any(axis=-1).mean()
    encoded = _srgb().cctf_encoding(np.clip(linear, 0.0, 1.0))
    return np.rint(encoded * 255).astype(np.uint8), float(outside)
