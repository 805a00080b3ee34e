"""Reflection of a glTF 2.0 material: a diffuse base, a specular lobe of GGX facets, and a smooth clear coat.

Implements appendix B of the specification of glTF 2.0 and its extensions ``KHR_materials_ior``,
``KHR_materials_specular`` and ``KHR_materials_clearcoat``, for non-metallic surfaces. With α = roughness², Schlick's
approximation F of the Fresnel reflectance, and a weight w of the gloss, which also attenuates the base,

    f = (1 - c F_c(θ_r)) [(1 - w max F(θ_H)) base / π + w F(θ_H) D V] + c F_c(θ_r) mirror

where D and V are those of GGX with Smith's height-correlated masking and shadowing, c is the weight of the coat and F_c
is F for a refractive index of 1.5.
"""

from typing import NamedTuple

import numpy as np

#: Reflectance of the clear coat at normal incidence, from its refractive index of 1.5.
COAT_F0 = 0.04


class GltfSurface(NamedTuple):
    """Parameters of a glTF material at places of its texture; shapes broadcast."""

    base: np.ndarray  # (..., 3) linear sRGB, 0..1
    weight: np.ndarray  # (...) 0..1, specularFactor
    f0: np.ndarray  # (..., 3) reflectance at normal incidence, 0..1, linear sRGB
    alpha: np.ndarray  # (...) roughness², 0 of a mirror
    coat: np.ndarray  # (...) 0..1, clearcoatFactor

    @classmethod
    def of(cls, base, weight, f0, alpha, coat) -> "GltfSurface":
        """Convert the parameters to float64 arrays."""
        return cls(*(np.asarray(value, dtype=np.float64) for value in (base, weight, f0, alpha, coat)))


def schlick(f0, cosine) -> np.ndarray:
    """Return Schlick's approximation of the Fresnel reflectance; ``f0`` is the reflectance at normal incidence."""
    return f0 + (1.0 - f0) * (1.0 - np.abs(cosine)) ** 5


def facets(alpha, cosines) -> np.ndarray:
    """Return D V of GGX, 1/sr; 0 for a mirror (α = 0), whose reflection is not a finite density.

    Parameters
    ----------
    alpha : (...) float
        roughness².
    cosines : three (...) float
        cosθ_i and cosθ_r, above 0, and cosφ.
    """
    cos_i, cos_r, cos_phi = cosines
    square = np.square(alpha)
    around = 1.0 - cos_phi**2 * (1.0 - square)
    distribution = square / (np.pi * np.square(np.where(around > 0.0, around, 1.0)))
    shadowed = cos_i * np.sqrt(square + (1.0 - square) * cos_r**2) + cos_r * np.sqrt(square + (1.0 - square) * cos_i**2)
    return np.where(square > 0.0, distribution * 0.5 / shadowed, 0.0)


def reflected(surface: GltfSurface, geometry: np.ndarray) -> np.ndarray:
    """Return π L_o / E_n under a collimated light, (..., 3) linear sRGB, in the unit of equation (5).

    Parameters
    ----------
    surface : GltfSurface
    geometry : (..., 4) float
        θ_i, θ_r, θ_H, φ in rad, the first two below π/2.
    """
    cos_i, cos_r, cos_h, cos_phi = np.moveaxis(np.cos(geometry), -1, 0)
    fresnel = schlick(surface.f0, cos_h[..., None])
    gloss = surface.weight * np.pi * facets(surface.alpha, (cos_i, cos_r, cos_phi))
    left = 1.0 - surface.weight * fresnel.max(axis=-1)
    under = left[..., None] * surface.base + gloss[..., None] * fresnel
    passed = (1.0 - surface.coat * schlick(COAT_F0, cos_r)) * cos_i
    return passed[..., None] * under


def mirrored(surface: GltfSurface, theta_r: np.ndarray) -> np.ndarray:
    """Return the reflectance of the mirror reflection, (..., 3): coat, and specular lobe where its roughness is 0.

    Parameters
    ----------
    surface : GltfSurface
    theta_r : (...) float
        Angle of the observer from the normal, rad.
    """
    cos_r = np.cos(theta_r)
    coat = (surface.coat * schlick(COAT_F0, cos_r))[..., None]
    smooth = np.where(surface.alpha > 0.0, 0.0, surface.weight)[..., None] * schlick(surface.f0, cos_r[..., None])
    return coat + (1.0 - coat) * smooth
