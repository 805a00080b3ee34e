"""Negative values in reconstructed spectra: their number, depth, and the effect of clipping them.

A truncated basis, or recovery from a few bands, leaves some samples of dark or vivid spectra below zero. Setting them
to zero always adds light, and repeated reflections multiply the error. Negative values are therefore stored unchanged.
When rendering clips them, it also scales the rest of the spectrum down, so that the total stays the same.
"""

from dataclasses import asdict, dataclass

import numpy as np


@dataclass(frozen=True)
class Negative:
    """Statistics of the samples of decoded spectra that are below zero.

    Parameters
    ----------
    pixels : int
        Number of pixels examined.
    fraction : float
        Share of samples (pixel and wavelength) below zero.
    pixel_fraction : float
        Share of pixels with at least one such sample.
    depth_p99, depth_max : float
        99th percentile and maximum, over the pixels with such a sample, of the magnitude of their lowest sample
        relative to their largest magnitude; 0 if no pixel has one.
    clipping_bias : float
        Light that setting these samples to zero would add, as a share of all light.
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
    """Return statistics of the negative samples of spectra (n, 61), n >= 1."""
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
