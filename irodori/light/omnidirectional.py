"""Omnidirectional pictures on a spectral basis, and their orientation.

Here columns are in the order of the azimuth, from +x towards +y, which is counter-clockwise when seen from above: the
picture is as on the outside of a globe. A photographed panorama is as seen from inside: its columns run clockwise.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from irodori.core.errors import InputError, counted
from irodori.light.environment_file import PixelNoise, directions

#: Rows of a picture that are read at a time; EXR compresses 16 or 32 rows together.
BAND_ROWS = 32


@dataclass(frozen=True)
class OmnidirectionalPicture:
    """Light from all directions, which is read in bands of rows, repeatedly if needed.

    Parameters
    ----------
    size : (height, width)
    basis : (61, r) float
        L(λ) = basis @ weights.
    read : callable
        Function that returns an iterator over bands, (rows, width, r) float32, from the zenith down.
    file : path
        File named in error messages.
    origin : dict
        Source of the picture, and assumptions; counts in it are complete after all bands have been read.
    basis_errors : (q, 61, r) float, optional
        Independent errors of the basis, see `irodori.light.light_recovery`; None for light that was not recovered.
    noise : PixelNoise, optional
        None for light that was not recovered, and if the camera's noise is not known.
    """

    size: tuple[int, int]
    basis: np.ndarray
    read: Callable[[], Iterator[np.ndarray]]
    file: object = ""
    origin: dict = field(default_factory=dict)
    basis_errors: np.ndarray | None = None
    noise: PixelNoise | None = None

    def __iter__(self) -> Iterator[np.ndarray]:
        return iter(self.read())

    def errors_on(self, basis: np.ndarray) -> np.ndarray | None:
        """Convert the errors to another basis, (61, k), of the same light, (q, 61, k); None if there are no errors."""
        if self.basis_errors is None:
            return None
        return self.basis_errors @ (np.linalg.pinv(self.basis) @ basis)

    @property
    def weights(self) -> np.ndarray:
        """The whole picture, (height, width, r) float32; only for small pictures."""
        return np.concatenate(list(self))


@dataclass(frozen=True)
class KeptPicture:
    """Picture whose weights are stored in an array while it is read, so that it need not be computed again.

    Parameters
    ----------
    picture : OmnidirectionalPicture
    weights : (height, width, r) float32
        Filled from the first row on.
    """

    picture: OmnidirectionalPicture
    weights: np.ndarray

    def __iter__(self) -> Iterator[np.ndarray]:
        row = 0
        for part in self.picture:
            kept = self.weights[row : row + len(part)]
            kept[:] = part
            row += len(part)
            yield kept


class MeanLight:
    """Mean of a picture over the sphere, computed while parts of it are read in any order.

    Parameters
    ----------
    size : (height, width)
    """

    def __init__(self, size: tuple[int, int]) -> None:
        height, width = size
        self._width, self._share = width, directions(1, height)[1][:, 0] / (4 * np.pi * width)
        self._sums: dict[int, np.ndarray] = {}

    def add(self, rows: np.ndarray, first: int) -> None:
        """Add consecutive pixels, (n, r); ``first`` is the index of the first one."""
        share = self._share[(first + np.arange(len(rows))) // self._width]
        self._sums[first] = share @ rows

    def light(self, basis: np.ndarray) -> np.ndarray:
        """Return the mean radiance, (61,), with negative values set to 0; equal energy if all light is zero."""
        mean = np.maximum(basis @ np.sum([self._sums[first] for first in sorted(self._sums)], axis=0), 0.0)
        return mean if mean.any() else np.ones_like(mean)


def refuse_saturated(saturated: np.ndarray, file) -> None:
    """Raise an error if pixels of a photographed environment are saturated in every exposure of a bracket.

    Parameters
    ----------
    saturated : (height, width) bool
        False also where a pixel is not used.
    file : path
        File that the message names.

    Raises
    ------
    InputError
    """
    if saturated.any():
        found = f"{counted(int(saturated.sum()), 'pixel')} saturated in every bracket"
        raise InputError(file, "exposure_s", found, "a shorter bracket of the environment")


def bands(height: int) -> Iterator[slice]:
    """Yield the row slice of each band."""
    for first in range(0, height, BAND_ROWS):
        yield slice(first, min(first + BAND_ROWS, height))


def _shift(width: int, centre_azimuth_deg: float) -> float:
    """Return the panorama column for column 0 of the picture; column c corresponds to c columns to its left."""
    return 0.5 * width - 1.0 + width * centre_azimuth_deg / 360.0


def from_panorama(panorama: np.ndarray, centre_azimuth_deg: float = 0.0) -> np.ndarray:
    """Convert a photographed panorama, (height, width, n), to columns in the order of the azimuth.

    Parameters
    ----------
    panorama : (height, width, n) float
        Panorama as seen from inside, zenith at the top.
    centre_azimuth_deg : float, degrees
        Azimuth of the centre of the picture. If it needs a shift by a fraction of a column, columns are interpolated.
    """
    width = panorama.shape[1]
    place = (_shift(width, centre_azimuth_deg) - np.arange(width)) % width
    left = np.floor(place + 1e-6).astype(int)
    part = place - left
    if np.abs(part).max() < 1e-5:
        return panorama[:, left % width]
    part = part.astype(panorama.dtype)[:, None]
    return panorama[:, left % width] * (1 - part) + panorama[:, (left + 1) % width] * part


def to_panorama(picture: np.ndarray) -> np.ndarray:
    """Convert a picture in the order of the azimuth to a panorama with azimuth 0 at its centre, for other programs.

    This is the inverse of `from_panorama` for even widths; for odd widths the centre is off by half a column.
    """
    width = picture.shape[1]
    return picture[:, (width // 2 - 1 - np.arange(width)) % width]
