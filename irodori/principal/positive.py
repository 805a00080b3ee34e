"""Spectra below zero: how many, how deep, and a guard that adds no light.

A truncated basis, or recovery from a few bands, leaves some samples of dark or vivid spectra below zero. Setting them
to zero adds light, always of the same sign, and repeated reflections multiply it. `without_negative` also scales the
rest of the spectrum down until the total is what it was.
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


def without_negative(spectra: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """Return spectra without negative samples and with the same total.

    Parameters
    ----------
    spectra : (..., 61) float
    weights : (61,) float, optional
        From 0; the total that is kept is ``spectra @ weights``, of all samples alike where absent.

    Returns
    -------
    (..., 61) float; zero where the total is not above zero. A spectrum without a negative sample is as it was.
    """
    spectra = np.asarray(spectra)
    weights = np.ones(spectra.shape[-1]) if weights is None else np.asarray(weights)
    positive = np.maximum(spectra, 0)
    before, after = spectra @ weights, positive @ weights
    factor = np.divide(before, after, out=np.zeros_like(after), where=after > 0)
    factor = np.where((spectra < 0).any(axis=-1), np.maximum(factor, 0), 1.0)
    return positive * factor[..., None]
