"""Colour differences, in CIEDE2000, between the content of a file and the values that Irodori computed."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from irodori.colour.colorimetry import delta_e, lab_from_xyz, summary
from irodori.colour.display import Display

#: Name of the text attribute of a picture's file that states its loss.
LOSS = "irodori:loss"
_ROWS = 32


class Loss(NamedTuple):
    """Statistics of the colour differences between an export and Irodori's own values, CIEDE2000."""

    compared: int  # number of colours
    mean: float
    p95: float
    largest: float

    @classmethod
    def of(cls, differences: np.ndarray) -> "Loss":
        """Compute the statistics of an array of differences of any shape; NaN is left out."""
        found = summary(differences)
        return cls(int(found["count"]), found["mean"], found["p95"], found["max"])

    @classmethod
    def read(cls, figures: dict) -> "Loss":
        """Return the loss from the JSON object that `figures` made."""
        values = (figures[name] for name in ("mean", "p95", "max"))
        return cls(figures["count"], *(np.nan if value is None else value for value in values))

    @property
    def text(self) -> str:
        """The statistics as one line of text, for the description in a file."""
        return f"CIEDE2000 mean {self.mean:.3g}, p95 {self.p95:.3g}, max {self.largest:.3g}, of {self.compared}"

    def figures(self) -> dict:
        """Return the statistics as a JSON object, rounded to four digits; null if there are none."""
        return {"count": self.compared, "mean": _short(self.mean), "p95": _short(self.p95), "max": _short(self.largest)}


#: Description of the compared colours -> their loss, or the reason why it was not measured.
Losses = dict[str, Loss | str]


def _short(value: float) -> float | None:
    return float(f"{value:.4g}") if math.isfinite(value) else None


def differences(display: Display, ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """Return CIEDE2000, (...), between linear RGB colours of a display, (..., 3), for an eye adapted to its white."""
    xyz = (rgb @ display.xyz_from_rgb.T + display.black_xyz for rgb in (ours, theirs))
    return delta_e(*(lab_from_xyz(one, display.white_xyz) for one in xyz))


def display_loss(display: Display, linear: np.ndarray, codes: np.ndarray) -> Loss:
    """Return the loss of code values, from their rounding and from colours outside the display's gamut.

    Parameters
    ----------
    display : Display
    linear : (height, width, 3) float
        Linear RGB of the display before encoding.
    codes : (height, width, 3) uint8 or uint16
    """
    return _by_rows(len(linear), lambda part: differences(display, linear[part], display.decode(codes[part])))


def stored_loss(
    to_xyz: np.ndarray,
    white_xyz: np.ndarray,
    exact: Callable[[slice], np.ndarray],
    stored: Callable[[slice], np.ndarray],
    height: int,
) -> Loss:
    """Return the loss of spectra or XYZ values stored with reduced precision, computed in double precision.

    Parameters
    ----------
    to_xyz : (3, n) float
        Matrix to XYZ: from spectra (n = 61), or the identity for XYZ values.
    white_xyz : (3,) float
        XYZ of white.
    exact, stored : callable
        Functions of a slice of rows that return the values, (rows, width, n), before storing and as read from the file.
        Pixels with NaN in either are not compared.
    height : int
        Number of rows.
    """

    def lab(values: np.ndarray) -> np.ndarray:
        return lab_from_xyz(values.astype(np.float64) @ to_xyz.T, white_xyz)

    with np.errstate(invalid="ignore"):  # a picture may have infinite pixels, whose colour is NaN
        return _by_rows(height, lambda part: delta_e(lab(exact(part)), lab(stored(part))))


def _by_rows(height: int, differ: Callable[[slice], np.ndarray]) -> Loss:
    """Compute the loss a few rows at a time, which limits the memory for double precision."""
    parts = (slice(first, first + _ROWS) for first in range(0, height, _ROWS))
    return Loss.of(np.concatenate([differ(part).ravel() for part in parts]))
