"""Omnidirectional pictures on a spectral basis, before they are compressed, and which way round they are.

Here columns run with the azimuth, from +x towards +y, which is counter-clockwise seen from above: a picture painted on
the outside of a globe. A photographed panorama shows what stands around the eye, so that its columns run clockwise.
"""

from dataclasses import dataclass, field

import numpy as np

from irodori.light import directions


@dataclass(frozen=True)
class Picture:
    """Light from every direction.

    Parameters
    ----------
    weights : (height, width, r) float
        L(λ) = basis @ weights.
    basis : (61, r) float
    origin : dict
        What it was made from and what was assumed.
    """

    weights: np.ndarray
    basis: np.ndarray
    origin: dict = field(default_factory=dict)

    def mean_light(self) -> np.ndarray:
        """Return the mean radiance over the sphere, (61,), what is negative left out; equal energy where it is dark."""
        height, width = self.weights.shape[:2]
        solid_angle = directions(1, height)[1][:, 0] / (4 * np.pi * width)
        mean = self.basis @ np.einsum("h,hwr->r", solid_angle, self.weights, dtype=np.float64)
        mean = np.maximum(mean, 0.0)
        return mean if mean.any() else np.ones_like(mean)


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
