"""Albedo of the lobes without Fresnel reflectance: that of a metal that reflects everything."""

from irodori.reflection.albedo import gloss_albedo


def lobe_albedo(name, mu, cosine):
    """Return ∫ D G / cosθ_r dω_i / π, (m, c)."""
    return gloss_albedo(name, mu, cosine, 1e-12, 1.0)[..., 0]
