"""Omnidirectional pictures on a spectral basis, and their orientation.

Here columns run with the azimuth, from +x towards +y, which is counter-clockwise seen from above: a picture painted on
the outside of a globe. A photographed panorama shows what stands around the eye, so that its columns run clockwise.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from irodori.light.environment_file import directions

#: Rows of a picture that are read together; EXR packs 16 or 32.
BAND_ROWS = 32


@dataclass(frozen=True)
class OmnidirectionalPicture:
    """Light from every direction, read a band of rows at a time, as often as wanted.

    Parameters
    ----------
    size : (height, width)
    basis : (61, r) float
        L(λ) = basis @ weights.
    read : callable
        Returns an iterator over bands (rows, width, r) float32 from the zenith down.
    file : path
        Named in error messages.
    origin : dict
        What it was made from and what was assumed; counts are complete when all bands have been read.
    basis_errors : (q, 61, r) float, optional
        Independent errors of the basis, see `irodori.light.light_recovery`; of given light there are none.
    """

    size: tuple[int, int]
    basis: np.ndarray
    read: Callable[[], Iterator[np.ndarray]]
    file: object = ""
    origin: dict = field(default_factory=dict)
    basis_errors: np.ndarray | None = None

    def __iter__(self) -> Iterator[np.ndarray]:
        return iter(self.read())

    def errors_on(self, basis: np.ndarray) -> np.ndarray | None:
        """Return the errors of another basis (61, k) of the same light, (q, 61, k); None where there are none."""
        if self.basis_errors is None:
            return None
        return self.basis_errors @ (np.linalg.pinv(self.basis) @ basis)

    @property
    def weights(self) -> np.ndarray:
        """The whole picture, (height, width, r) float32; for small ones."""
        return np.concatenate(list(self))


class MeanLight:
    """Mean of a picture's pixels over the sphere, gathered while tiles of it are read in any order.

    Parameters
    ----------
    size : (height, width)
    """

    def __init__(self, size: tuple[int, int]) -> None:
        height, width = size
        self._width, self._share = width, directions(1, height)[1][:, 0] / (4 * np.pi * width)
        self._sums: dict[int, np.ndarray] = {}

    def add(self, rows: np.ndarray, first: int) -> None:
        """Take in pixels (n, r) of which the first has a number."""
        share = self._share[(first + np.arange(len(rows))) // self._width]
        self._sums[first] = share @ rows

    def light(self, basis: np.ndarray) -> np.ndarray:
        """Return the mean radiance, (61,), what is negative left out; equal energy where it is dark."""
        mean = np.maximum(basis @ np.sum([self._sums[first] for first in sorted(self._sums)], axis=0), 0.0)
        return mean if mean.any() else np.ones_like(mean)


def bands(height: int) -> Iterator[slice]:
    """Yield the rows of each band."""
    for first in range(0, height, BAND_ROWS):
        yield slice(first, min(first + BAND_ROWS, height))


def _shift(width: int, centre_azimuth_deg: float) -> float:
    """Return the source column of column 0; column c has the one c columns to the left of it."""
    return 0.5 * width - 1.0 + width * centre_azimuth_deg / 360.0


def from_panorama(panorama: np.ndarray, centre_azimuth_deg: float = 0.0) -> np.ndarray:
    """Return a photographed panorama, (height, width, n), with its columns in the order of the azimuth.

    Parameters
    ----------
    panorama : (height, width, n) float
        Clockwise, the zenith on top.
    centre_azimuth_deg : float, degrees
        Azimuth of the middle of the picture. Where this falls between columns they are interpolated.
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
    """Return a picture in the order of the azimuth as a panorama whose middle is at azimuth 0, for other programs.

    The inverse of `from_panorama` for even widths; of an odd width the middle of the panorama is half a column off.
    """
    width = picture.shape[1]
    return picture[:, (width // 2 - 1 - np.arange(width)) % width]
