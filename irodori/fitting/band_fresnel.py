"""Fresnel reflectance in each camera band for a refractive index n(λ) + ik(λ) that varies with wavelength.

The response of band b to a reflectance S(λ) is Σ A_b(λ) S(λ) [eq. 1], with weights A_b from the response model of the
calibration. Gloss has the spectral reflectance F(λ, θ_H), so its Fresnel reflectance in a band is the mean of F(λ, θ_H)
weighted by A_b. This mean is not F at any single wavelength: F of gold rises from 0.4 to 0.9 within the green band.

The fit takes a single n + ik. It is given the one with F closest to that of its band over all angles. For the other
bands, the ratio to this F is tabulated over the angle.
"""

from typing import NamedTuple

import numpy as np

from irodori.reflection.fresnel import fresnel_array

_ANGLES = 512
_COARSE = slice(None, None, 8)


class BandGloss(NamedTuple):
    """Fresnel reflectance of each camera band.

    Parameters
    ----------
    n, k : float
        Complex refractive index for the band that is fitted.
    ratio : (bands, angles) float64
        F of each band divided by F(n + ik), at equally spaced θ_H from 0 to π/2.
    """

    n: float
    k: float
    ratio: np.ndarray


def varies(n, k) -> bool:
    """Return whether a refractive index varies with the wavelength."""
    return bool(np.ptp(n) > 0.0 or np.ptp(k) > 0.0)


def band_gloss(n, k, band_response: np.ndarray, band: int) -> BandGloss:
    """Compute the Fresnel reflectance of each band for a refractive index that varies with wavelength.

    Parameters
    ----------
    n, k : (61,) float
        Complex refractive index.
    band_response : (bands, 61) float
        Response per unit reflectance at each wavelength.
    band : int
        Index of the band that is fitted.
    """
    from scipy.optimize import least_squares  # slow to import

    theta = np.linspace(0.0, 0.5 * np.pi, _ANGLES)
    spectral = np.stack([fresnel_array(np.cos(theta), a, b) for a, b in zip(n, k, strict=True)])
    weight = band_response / band_response.sum(axis=1, keepdims=True)
    by_band = weight @ spectral
    start = np.maximum([weight[band] @ n, weight[band] @ k], [1e-3, 0.0])
    found = least_squares(
        lambda x: fresnel_array(np.cos(theta[_COARSE]), *x) - by_band[band, _COARSE],
        start,
        bounds=([1e-4, 0.0], np.inf),
    )
    own_n, own_k = map(float, found.x)
    return BandGloss(own_n, own_k, by_band / fresnel_array(np.cos(theta), own_n, own_k))


def uniform(n: float, k: float, bands: int) -> BandGloss:
    """Return the `BandGloss` of a refractive index that is the same in all bands."""
    return BandGloss(float(n), float(k), np.ones((bands, 2)))
