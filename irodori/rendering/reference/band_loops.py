"""Loops over the 61 bands, padded to 64 in single precision: four 512-bit vectors."""

from typing import Literal

import numpy as np

from irodori.jit.compilation import uncounted
from irodori.jit.vector_memory import load, spread, store
from irodori.reflection.fresnel import fresnel
from irodori.rendering.scene_lights import BANDS, PADDED

#: Sums over bands may be taken in any order, or each addition waits for the one before.
_SUMS = {"reassoc", "contract", "nsz"}
_ZERO = np.float32(0.0)
_WIDTH = 16  # bands in a vector


def padded(values: np.ndarray, fill: str = "zero") -> np.ndarray:
    """Pad spectra (..., 61) to (..., 64) float32; ``fill`` is ``zero``, or ``edge`` to repeat the last value."""
    width = [(0, 0)] * (values.ndim - 1) + [(0, PADDED - BANDS)]
    modes: dict[str, Literal["constant", "edge"]] = {"zero": "constant", "edge": "edge"}
    return np.ascontiguousarray(np.pad(values, width, mode=modes[fill]), dtype=np.float32)


@uncounted(forceinline=True, fastmath=_SUMS)
def decode(basis, index, count, coefficients, out):
    """Fill ``out`` with the spectrum of the first ``count`` coefficients on ``basis[index]``.

    Negative samples, which spectral recovery and compression leave, are set to zero, and the others are scaled down so
    that the sum stays the same: clipping alone would add light.
    """
    for band in range(PADDED):
        out[band] = _ZERO
    for b in range(count):
        value = np.float32(coefficients[b])
        for band in range(PADDED):
            out[band] += basis[index, b, band] * value
    total, positive = _ZERO, _ZERO
    for band in range(PADDED):
        total += out[band]
        positive += max(out[band], _ZERO)
    if total == positive:
        return
    share = total / positive if total > _ZERO else _ZERO
    for band in range(PADDED):
        out[band] = share * max(out[band], _ZERO)


@uncounted(forceinline=True, fastmath=_SUMS)
def summed_product(a, b):
    """Return the sum of the product of two spectra."""
    total = _ZERO
    for band in range(PADDED):
        total += a[band] * b[band]
    return float(total)


@uncounted(forceinline=True, fastmath=_SUMS)
def summed(a):
    """Return the sum of a spectrum over the 61 bands."""
    total = _ZERO
    for band in range(BANDS):
        total += a[band]
    return float(total)


@uncounted(forceinline=True)
def largest(a):
    """Return the largest of the 61 bands."""
    found = a[0]
    for band in range(1, BANDS):
        found = max(found, a[band])
    return float(found)


@uncounted(forceinline=True)
def scale(a, factor):
    """Multiply a spectrum by a number."""
    factor = np.float32(factor)
    for band in range(PADDED):
        a[band] *= factor


@uncounted(forceinline=True)
def scale_by(a, b, factor):
    """Multiply spectrum ``a`` by spectrum ``b`` and by a number, in place."""
    factor = np.float32(factor)
    for band in range(PADDED):
        a[band] *= b[band] * factor


@uncounted(forceinline=True, fastmath={"contract"})
def add_product(a, b, factor, out):
    """Add the product of two spectra and a number to ``out``."""
    factor = np.float32(factor)
    for band in range(PADDED):
        out[band] += a[band] * b[band] * factor


@uncounted(forceinline=True, fastmath={"contract"})
def fill_mixture(diffuse, a, gloss, b, out):
    """Fill ``out`` with one spectrum times a number plus another times a number."""
    a, b = np.float32(a), np.float32(b)
    for band in range(PADDED):
        out[band] = diffuse[band] * a + gloss[band] * b


@uncounted(forceinline=True, fastmath={"contract"})
def fill_mixture_grey(diffuse, a, b, out):
    """Fill ``out`` with a spectrum times a number plus a number."""
    a, b = np.float32(a), np.float32(b)
    for band in range(PADDED):
        out[band] = diffuse[band] * a + b


@uncounted(forceinline=True)
def fill_fresnel(cosine, n, k, index, out):
    """Fill ``out`` with the Fresnel reflectance of every band; ``n`` and ``k`` are (objects, 64) float32."""
    c = spread(np.float32(cosine), _WIDTH)
    for band in range(0, PADDED, _WIDTH):
        place = index * PADDED + band
        store(out, band, fresnel(c, load(n, place, _WIDTH), load(k, place, _WIDTH)))
