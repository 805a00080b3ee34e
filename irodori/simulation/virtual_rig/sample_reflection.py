"""Reflection models of the virtual samples: equation (5), and two that the fit does not assume.

A GGX surface (Walter et al., *Microfacet models for refraction through rough surfaces*, EGSR 2007, with the
height-correlated shadowing of Heitz, JCGT 3(2), 2014) has longer tails than the paper's Gaussian facets. A measured
one follows a table of BRDF samples. Both show what the fit makes of a material that is not its own.
"""

import math

import numpy as np

from irodori.core.errors import InputError
from irodori.jit.native import njit
from irodori.reflection.equation5 import attenuation_over_cosine, facet_distribution
from irodori.spectra.resampling import resample
from irodori.spectra.tables import brdf_table

PAPER, GGX, MEASURED = 0, 1, 2
MODELS = {"paper": PAPER, "ggx": GGX, "measured": MEASURED}

_HALF_NODES = 46
_DIFFERENCE_NODES = 10
_MAX_ANGLE_RAD = math.radians(80.0)


@njit(cache=True, error_model="numpy")
def gloss_lobe(model, mu, cos_i, cos_r, cos_phi, cos_h):
    """Return the gloss term of a surface over β F: 1 at normal incidence and reflection for either model.

    Parameters
    ----------
    model : int, PAPER or GGX
    mu : float
        Roughness, rad; of a GGX surface its width parameter, tan of the angle at which D has fallen to a quarter.
    cos_i, cos_r, cos_phi, cos_h : float
        N·L, N·V, N·H and V·H, the first two above 0.
    """
    if model == PAPER:
        return facet_distribution(math.acos(cos_phi), mu) * attenuation_over_cosine(cos_i, cos_r, cos_phi, cos_h)
    m2 = mu * mu
    c2 = cos_phi * cos_phi
    # D / D(0): sin² written apart, since c² (m² - 1) + 1 loses the digits of a smooth surface.
    base = m2 * c2 + (1.0 - c2)
    distribution = (m2 / base) ** 2
    smith_i = cos_r * math.sqrt(m2 + (1.0 - m2) * cos_i * cos_i)
    smith_r = cos_i * math.sqrt(m2 + (1.0 - m2) * cos_r * cos_r)
    return distribution * 2.0 * cos_i / (smith_i + smith_r)


@njit(cache=True, error_model="numpy")
def measured_lobe(table, cos_phi, cos_h, band):
    """Return π times a tabulated BRDF, linear between nodes of the half and the difference angle.

    Parameters
    ----------
    table : (half nodes, difference nodes, bands) float
        Nodes are equally spaced in sqrt(φ) and in θ_H, both from 0 to π/2.
    cos_phi, cos_h : float
        N·H and V·H.
    """
    half = math.sqrt(math.acos(cos_phi) / (0.5 * math.pi)) * (table.shape[0] - 1)
    difference = math.acos(min(cos_h, 1.0)) / (0.5 * math.pi) * (table.shape[1] - 1)
    i, j = min(int(half), table.shape[0] - 2), min(int(difference), table.shape[1] - 2)
    a, b = half - i, difference - j
    low = (1.0 - b) * table[i, j, band] + b * table[i, j + 1, band]
    high = (1.0 - b) * table[i + 1, j, band] + b * table[i + 1, j + 1, band]
    return (1.0 - a) * low + a * high


def read_measured(path) -> np.ndarray:
    """Read BRDF samples and put them on the grid of `measured_lobe`.

    Parameters
    ----------
    path : path
        CSV as `irodori.spectra.tables.brdf_table` reads it; the mirror direction stands at φ_r - φ_i = π.

    Returns
    -------
    (half nodes, difference nodes, 61) float64, π times the BRDF. A node is the median of the samples nearest to it
    (outliers near grazing are common in such tables; samples beyond 80 degrees are left out), nodes without samples
    take those of the nearest with. An isotropic surface is assumed and the azimuth of the difference vector is
    averaged over, so that the table is reciprocal.

    Raises
    ------
    InputError
        If the table is at fault or no sample has both angles below 80 degrees.
    """
    wavelength_nm, angles, brdf = brdf_table(path)
    angles, brdf = np.array(angles), np.array(brdf)
    usable = (angles[:, 0] < _MAX_ANGLE_RAD) & (angles[:, 2] < _MAX_ANGLE_RAD)
    if not usable.any():
        raise InputError(path, "", "no sample with both angles below 80 degrees", "measured BRDF samples")
    half, difference = _half_difference(*angles[usable].T)
    grid = _gridded(half, difference, np.maximum(brdf[usable], 0.0))
    flat = resample(wavelength_nm, grid.reshape(-1, grid.shape[-1]), path)
    return math.pi * flat.reshape(_HALF_NODES, _DIFFERENCE_NODES, -1)


def _half_difference(theta_i, phi_i, theta_r, phi_r) -> tuple[np.ndarray, np.ndarray]:
    """Return φ (between normal and half vector) and θ_H, rad."""

    def direction(theta, phi):
        return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)

    light, view = direction(theta_i, phi_i), direction(theta_r, phi_r)
    total = light + view
    length = np.linalg.norm(total, axis=-1)
    return np.arccos(np.clip(total[:, 2] / length, -1, 1)), np.arccos(np.clip(length / 2, -1, 1))


def _gridded(half, difference, brdf) -> np.ndarray:
    """Return the median of the samples about each node, (half nodes, difference nodes, bands)."""
    i = np.rint(np.sqrt(half / (math.pi / 2)) * (_HALF_NODES - 1)).astype(int)
    j = np.rint(difference / (math.pi / 2) * (_DIFFERENCE_NODES - 1)).astype(int)
    cell = i * _DIFFERENCE_NODES + j
    known = np.unique(cell)
    medians = np.stack([np.median(brdf[cell == c], axis=0) for c in known])
    # A step of the half angle changes a lobe far more than one of the difference angle.
    at = np.stack(np.divmod(known, _DIFFERENCE_NODES), axis=-1) * (3.0, 1.0)
    every = np.stack(np.divmod(np.arange(_HALF_NODES * _DIFFERENCE_NODES), _DIFFERENCE_NODES), axis=-1) * (3.0, 1.0)
    nearest = np.argmin(((every[:, None] - at[None]) ** 2).sum(axis=-1), axis=1)
    return medians[nearest].reshape(_HALF_NODES, _DIFFERENCE_NODES, -1)
