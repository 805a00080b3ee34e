"""Gloss of very rough surfaces: exact sum of the lobe over about a thousand point sources.

From a roughness of 0.4 on, a lobe is so wide, and cut so strongly by the horizon, that blurred light would need more
look-ups than there are relevant directions. Therefore the sphere is divided into cells of a tenth of a radian. Each is
replaced by a point at its centre of power, so that a small sun keeps its direction.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from irodori.jit.compilation import njit
from irodori.light.irradiance import make_pixels
from irodori.reflection.fresnel import fresnel
from irodori.reflection.lobes import constants, features, reach, value

_ROWS = 32
_FEWEST_ROWS = 64  # smallest number of rows of the picture; coarser pixels are divided, as they are uniform


class PointLights(NamedTuple):
    """Light in the form of point sources at infinity."""

    direction: np.ndarray  # (n, 3) unit vectors
    power: np.ndarray  # (n, k) float64, radiance unit times sr


class Seen(NamedTuple):
    """Normals and view directions of places on a surface."""

    normal: np.ndarray  # (3,) unit vector, or (n, 3) for several places
    to_eye: np.ndarray  # unit vectors of the same shape


def point_lights(coefficients: np.ndarray) -> PointLights:
    """Convert an equirectangular picture, (height, width, k), to point sources."""
    for axis, least in enumerate((_FEWEST_ROWS, 2 * _FEWEST_ROWS)):
        if coefficients.shape[axis] < least:
            coefficients = coefficients.repeat(-(-least // coefficients.shape[axis]), axis=axis)
    pixels = make_pixels(coefficients)
    edges = np.round(np.linspace(0, len(pixels.values), _ROWS + 1)).astype(int)
    found = [_band(pixels, slice(*rows)) for rows in pairwise(edges)]
    return PointLights(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _band(pixels, rows: slice) -> tuple[np.ndarray, np.ndarray]:
    """Return directions and powers of the cells in some rows; those without light are left out."""
    width = pixels.values.shape[1]
    sine, parts = pixels.sin_theta[rows], (pixels.values, pixels.solid_angle, pixels.sin_theta, pixels.cos_theta)
    power = np.zeros((width, pixels.values.shape[2]))
    across, along = np.zeros(width), np.zeros(width)
    for row, solid_angle, s, z in zip(*(part[rows] for part in parts), strict=True):
        light = row * solid_angle
        length = np.sqrt(np.einsum("wk,wk->w", light, light))
        power += light
        across += length * s
        along += length * z
    columns = np.round(np.linspace(0, width, max(4, math.ceil(2 * _ROWS * sine.max())) + 1)).astype(int)[:-1]
    moment = np.stack([across * pixels.cos_azimuth, across * pixels.sin_azimuth, along], axis=-1)
    moment, power = np.add.reduceat(moment, columns), np.add.reduceat(power, columns)
    length = np.linalg.norm(moment, axis=1)
    lit = length > 0.0
    return moment[lit] / length[lit, None], power[lit]


@njit(cache=True, forceinline=True)
def place_of(seen, i):
    """Return place i of several."""
    return Seen(seen.normal[i], seen.to_eye[i])


@njit(cache=True, error_model="numpy")
def add_from_points(lights, seen, mu, index, scale, out):
    """Add ``scale`` times Σ F D G / cosθ_r L dω over the points; arguments as in `irodori.light.gloss.gloss_maps`."""
    normal, view = seen
    cos_r = normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2]
    least, constant = math.cos(reach(lights.lobes, 0, mu)), constants(lights.lobes, math.log(mu))
    for i in range(lights.power.shape[0]):
        x, y, z = lights.direction[i, 0], lights.direction[i, 1], lights.direction[i, 2]
        cos_i = normal[0] * x + normal[1] * y + normal[2] * z
        if cos_i <= 0.0:
            continue
        # |L + V|² = 2 (1 + L·V), and V·H is half of |L + V|.
        length = math.sqrt(max(2.0 + 2.0 * (view[0] * x + view[1] * y + view[2] * z), 1e-18))
        cos_h, cos_phi = 0.5 * length, min((cos_i + cos_r) / length, 1.0)
        if cos_phi < least:
            continue
        factor, f0, f1, f2 = features(lights.lobes, cos_i, cos_r, cos_phi, cos_h, math.acos(cos_phi))
        shown = scale * fresnel(cos_h, index[0], index[1]) * factor * value(lights.lobes, constant, f0, f1, f2)
        for b in range(out.size):
            out[b] += shown * lights.power[i, b]
