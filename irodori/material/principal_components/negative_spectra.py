"""Negative values in reconstructed spectra: their number, depth, and the effect of clipping them.

A truncated basis, or recovery from a few bands, leaves some samples of dark or vivid spectra below zero. Setting them
to zero adds light, always of the same sign, and repeated reflections multiply it. They are stored as they are;
rendering, which decodes them, also scales the rest of a spectrum down until the total is what it was.
"""

from dataclasses import asdict, dataclass

import numpy as np


@dataclass(frozen=True)
class Negative:
    """Samples of decoded spectra that are below zero.

    Parameters
    ----------
    pixels : int
        Pixels looked at.
    fraction : float
        Share of samples (pixel and wavelength) below zero.
    pixel_fraction : float
        Share of pixels with such a sample.
    depth_p99, depth_max : float
        How deep the lowest sample of a pixel lies, as a share of the pixel's largest magnitude, over the pixels that
        have one; 0 where none has.
    clipping_bias : float
        Light that setting them to zero would add, as a share of all light.
    """

    pixels: int
    fraction: float
    pixel_fraction: float
    depth_p99: float
    depth_max: float
    clipping_bias: float

    def as_dict(self) -> dict:
        """Return the numbers by name."""
        return asdict(self)


def count_negative(spectra: np.ndarray) -> Negative:
    """Return what lies below zero in spectra (n, 61), n >= 1."""
    low = spectra.min(axis=1)
    below = low < 0
    depth = -low[below] / np.abs(spectra[below]).max(axis=1)
    total = float(spectra.sum(dtype=np.float64))
    added = -float(np.minimum(spectra, 0).sum(dtype=np.float64))
    return Negative(
        pixels=len(spectra),
        fraction=float((spectra < 0).mean()),
        pixel_fraction=float(below.mean()),
        depth_p99=float(np.percentile(depth, 99)) if depth.size else 0.0,
        depth_max=float(depth.max()) if depth.size else 0.0,
        clipping_bias=added / total if total > 0 else 0.0,
    )
