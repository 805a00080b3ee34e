"""Equation (5) written out in NumPy, as an independent witness of the compiled lobe of Gaussian facets."""

import numpy as np

from irodori.reflection.fresnel import fresnel_array


def attenuation_over_cosine(cos_i, cos_r, cos_phi, cos_h):
    """Return G / cosθ_r: the smaller of 1 / cosθ_r and the two V-cavity terms over cosθ_r; 0 below the horizon."""
    with np.errstate(divide="ignore", invalid="ignore"):
        facet = 2.0 * cos_phi / cos_h
        value = np.minimum(np.minimum(1.0, facet * cos_i) / cos_r, facet)
    return np.where((cos_i > 0) & (cos_r > 0) & (cos_h > 0) & (cos_phi > 0), value, 0.0)


def gloss_factors(geometry, n: float, k: float):
    """Return F G / cosθ_r of θ_i, θ_r, θ_H, φ, (..., 4) rad."""
    cos_i, cos_r, cos_h, cos_phi = np.moveaxis(np.cos(geometry), -1, 0)
    return fresnel_array(cos_h, n, k) * attenuation_over_cosine(cos_i, cos_r, cos_phi, cos_h)
