"""Colour differences between what a file holds and what Irodori computed, in CIEDE2000."""

import math
import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from irodori.colour.colorimetry import delta_e, lab_from_xyz, summary
from irodori.colour.display import Display

#: Name of the text attribute of a picture's file that states its loss.
LOSS = "irodori:loss"
_ROWS = 32


class Loss(NamedTuple):
    """Colour differences of an export against our own renderer, CIEDE2000."""

    compared: int
    mean: float
    p95: float
    largest: float

    @classmethod
    def of(cls, differences: np.ndarray) -> "Loss":
        """Return the figures of differences of any shape; NaN is left out."""
        found = summary(differences)
        return cls(int(found["count"]), found["mean"], found["p95"], found["max"])

    @classmethod
    def read(cls, figures: dict) -> "Loss":
        """Return the loss that `figures` wrote into a file as JSON."""
        values = (figures[name] for name in ("mean", "p95", "max"))
        return cls(figures["count"], *(np.nan if value is None else value for value in values))

    @classmethod
    def parse(cls, text: str) -> "Loss":
        """Return the loss whose `text` begins a file's statement.

        Raises
        ------
        ValueError
            If the statement holds no figures.
        """
        match = re.match(r"CIEDE2000 mean (\S+), p95 (\S+), max (\S+), of (\d+)", text)
        if match is None:
            raise ValueError(f"a loss without figures: {text!r}; accepted: CIEDE2000 mean, p95 and max")
        return cls(int(match[4]), *map(float, match.groups()[:3]))

    @property
    def text(self) -> str:
        """The figures in words, for a file's description."""
        return f"CIEDE2000 mean {self.mean:.3g}, p95 {self.p95:.3g}, max {self.largest:.3g}, of {self.compared}"

    def figures(self) -> dict:
        """Return the figures for a file in JSON."""
        return {"count": self.compared, "mean": _short(self.mean), "p95": _short(self.p95), "max": _short(self.largest)}


#: What is compared -> its loss, or why there is no figure.
Losses = dict[str, Loss | str]


def _short(value: float) -> float | None:
    return float(f"{value:.4g}") if math.isfinite(value) else None


def differences(display: Display, ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """Return CIEDE2000 between linear RGB of one display, (..., 3) to (...), for an eye adapted to its white."""
    xyz = (rgb @ display.xyz_from_rgb.T + display.black_xyz for rgb in (ours, theirs))
    return delta_e(*(lab_from_xyz(one, display.white_xyz) for one in xyz))


def display_loss(display: Display, linear: np.ndarray, codes: np.ndarray) -> Loss:
    """Return the loss of code values: their rounding, and colours that the display cannot show.

    Parameters
    ----------
    display : Display
    linear : (height, width, 3) float
        Linear RGB of the display before it was encoded.
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
    """Return the loss of spectra, or of XYZ, that a file holds with fewer digits, computed in double precision.

    Parameters
    ----------
    to_xyz : (3, n) float
        To XYZ: from spectra n = 61, from XYZ the identity.
    white_xyz : (3,) float
        XYZ of what counts as white.
    exact, stored : callable
        Return some rows, (rows, width, n): before they are stored, and as a reader of the file finds them. Pixels of
        NaN in either are not compared.
    height : int
        Number of rows.
    """

    def lab(values: np.ndarray) -> np.ndarray:
        return lab_from_xyz(values.astype(np.float64) @ to_xyz.T, white_xyz)

    with np.errstate(invalid="ignore"):  # a picture may have infinite pixels, of which there is no colour
        return _by_rows(height, lambda part: delta_e(lab(exact(part)), lab(stored(part))))


def _by_rows(height: int, differ: Callable[[slice], np.ndarray]) -> Loss:
    """Return the loss over bands of rows, which bound the memory of double precision."""
    parts = (slice(first, first + _ROWS) for first in range(0, height, _ROWS))
    return Loss.of(np.concatenate([differ(part).ravel() for part in parts]))
