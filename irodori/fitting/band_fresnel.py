"""Fresnel reflectance per camera band for a measured complex index n(λ) + ik(λ).

A band answers to a reflectance S(λ) with Σ A_b(λ) S(λ) [eq. 1]. The gloss of a surface is such a reflectance, of the
colour F(λ, θ_H); so F of a band is the mean of F(λ, θ_H) under A_b, which the calibration knows as its response model.
The mean is not the F of any one wavelength: that of gold rises from 0.4 to 0.9 within the green band.

The fit itself takes one n + ik. It is given the one whose F comes nearest to that of its band at all angles; what the
other bands have more or less is a ratio of angle.
"""

from typing import NamedTuple

import numpy as np

from irodori.reflection.fresnel import fresnel_array

_ANGLES = 512
_COARSE = slice(None, None, 8)


class BandGloss(NamedTuple):
    """Fresnel reflectance by band.

    Parameters
    ----------
    n, k : float
        Complex refractive index of the band of the fit.
    ratio : (bands, angles) float64
        F of each band over F(n + ik), at θ_H equally spaced over 0..π/2.
    """

    n: float
    k: float
    ratio: np.ndarray


def varies(n, k) -> bool:
    """Return whether a refractive index varies with the wavelength."""
    return bool(np.ptp(n) > 0.0 or np.ptp(k) > 0.0)


def band_gloss(n, k, band_response: np.ndarray, band: int) -> BandGloss:
    """Return F by band of a refractive index that varies with the wavelength.

    Parameters
    ----------
    n, k : (61,) float
        Complex refractive index.
    band_response : (bands, 61) float
        Response per unit reflectance at each wavelength.
    band : int
        That of the fit.
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
    """Return F of a refractive index that is the same in all bands."""
    return BandGloss(float(n), float(k), np.ones((bands, 2)))
