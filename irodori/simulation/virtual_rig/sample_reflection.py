"""Reflection of the virtual rig's samples: gloss components with any lobe, or a table of measured BRDF samples.

A sample may have a lobe that the fit of its object does not assume, or follow a table of BRDF samples. Both test the
fit on materials that do not follow its model.
"""

import math
from typing import NamedTuple

import numpy as np

from irodori.core.errors import InputError
from irodori.jit.compilation import njit
from irodori.reflection.lobes import Lobes, features_of, value_of
from irodori.reflection.registry import lobe
from irodori.spectra.resampling import resample
from irodori.spectra.tables import brdf_table

_HALF_NODES = 46
_DIFFERENCE_NODES = 10
_MAX_ANGLE_RAD = math.radians(80.0)


class GlossComponents(NamedTuple):
    """Gloss components of a sample's materials for compiled loops; see `gloss_components`."""

    lobes: Lobes
    which: np.ndarray  # (m, c) index of the component's lobe in `lobes`, -1 if the material has no such component
    beta: np.ndarray  # (m, c)
    constant: np.ndarray  # (m, c, 2) of the lobe at the component's roughness


def gloss_components(lobes: list[tuple[str, ...]], beta: np.ndarray, mu: np.ndarray) -> GlossComponents:
    """Return the gloss components of m materials, up to c each, in the form that compiled loops need.

    Parameters
    ----------
    lobes : list of tuple of str
        For each material, the lobe of each of its components.
    beta, mu : (m, c) float
        Weight and roughness of the components, in the unit of the lobe.
    """
    occurring = Lobes.of([name for names in lobes for name in names] or ["gaussian"])
    which, constant = np.full(beta.shape, -1), np.zeros((*beta.shape, 2))
    for m, names in enumerate(lobes):
        for c, name in enumerate(names):
            which[m, c] = occurring.names.index(name)
            constant[m, c] = lobe(name).constants(math.log(mu[m, c]))
    return GlossComponents(occurring, which, np.ascontiguousarray(beta), constant)


@njit(cache=True, error_model="numpy")
def gloss_term(gloss, material, cos_i, cos_r, cos_phi, cos_h):
    """Return the gloss term of a material without its factor F: the sum of β D G / cosθ_r over its components.

    Parameters
    ----------
    gloss : GlossComponents
    material : int
    cos_i, cos_r, cos_phi, cos_h : float
        N·L, N·V, N·H and V·H.
    """
    total, phi = 0.0, math.acos(min(cos_phi, 1.0))
    for c in range(gloss.which.shape[1]):
        which = gloss.which[material, c]
        if which < 0:
            continue
        constant = gloss.constant[material, c, 0], gloss.constant[material, c, 1]
        factor, f0, f1, f2 = features_of(gloss.lobes, which, cos_i, cos_r, cos_phi, cos_h, phi)
        total += gloss.beta[material, c] * factor * value_of(gloss.lobes, which, constant, f0, f1, f2)
    return total


@njit(cache=True, error_model="numpy")
def measured_lobe(table, cos_phi, cos_h, band):
    """Return π times a tabulated BRDF, interpolated linearly between nodes of the half and the difference angle.

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
    """Read BRDF samples and arrange them on the grid of `measured_lobe`.

    Parameters
    ----------
    path : path
        CSV as `irodori.spectra.tables.brdf_table` reads it; the mirror direction is at φ_r - φ_i = π.

    Returns
    -------
    (half nodes, difference nodes, 61) float64, π times the BRDF. A node is the median of the samples nearest to it
    (outliers near grazing are common in such tables; samples beyond 80 degrees are left out); a node without samples
    takes the value of the nearest node with samples. The surface is assumed to be isotropic, and the azimuth of the
    difference vector is ignored, so that the table is reciprocal.

    Raises
    ------
    InputError
        If the table is invalid or no sample has both angles below 80 degrees.
    """
    wavelength_nm, angles, brdf = map(np.array, brdf_table(path))
    usable = (angles[:, 0] < _MAX_ANGLE_RAD) & (angles[:, 2] < _MAX_ANGLE_RAD)
    if not usable.any():
        raise InputError(path, "", "no sample with both angles below 80 degrees", "measured BRDF samples")
    half, difference = _half_difference(*angles[usable].T)
    grid = _gridded(half, difference, np.maximum(brdf[usable], 0.0))
    flat = resample(wavelength_nm, grid.reshape(-1, grid.shape[-1]), path)
    return math.pi * flat.reshape(_HALF_NODES, _DIFFERENCE_NODES, -1)


def _half_difference(theta_i, phi_i, theta_r, phi_r) -> tuple[np.ndarray, np.ndarray]:
    """Return the half angle φ, between normal and half vector, and the difference angle θ_H, rad."""

    def direction(theta, phi):
        return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)

    light, view = direction(theta_i, phi_i), direction(theta_r, phi_r)
    total = light + view
    length = np.linalg.norm(total, axis=-1)
    return np.arccos(np.clip(total[:, 2] / length, -1, 1)), np.arccos(np.clip(length / 2, -1, 1))


def _gridded(half, difference, brdf) -> np.ndarray:
    """Return the median of the samples nearest to each node, (half nodes, difference nodes, bands)."""
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
