"""Environments made of lights with known spectra in given directions, each a disc or a point."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from irodori.colour.colorimetry import colour_matching_weights
from irodori.light.environment_file import directions, row_solid_angles
from irodori.light.omnidirectional import OmnidirectionalPicture, bands
from irodori.spectra.published import light

if TYPE_CHECKING:
    from irodori.config.models import PlacedLight

_PARTS = 16  # sample points along each side of a pixel that is crossed by the edge of a disc


def unit_luminance(name: str) -> np.ndarray:
    """Return the spectrum of a light, (61,), scaled to the luminance of D65 as tabulated (100 at 560 nm)."""
    luminance = colour_matching_weights()[1]
    spectrum = light(name)
    return spectrum * (luminance @ light("D65")) / (luminance @ spectrum)


def direction_of(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    """Return a unit vector, (3,), for an azimuth from +x towards +y and an elevation above the horizon, degrees."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    return np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])


def _pixels_around(towards: np.ndarray, width: int, height: int) -> list[tuple[int, int, float]]:
    """Return row, column and share of the four pixels between whose centres a direction lies; shares sum to 1.

    Their mean direction, weighted by the shares, is that of the light. Beyond a pole is the opposite meridian.
    """
    theta = np.arctan2(np.hypot(towards[0], towards[1]), towards[2])
    turn = np.arctan2(towards[1], towards[0]) / (2 * np.pi)
    row, column = theta / np.pi * height - 0.5, turn * width - 0.5
    found = []
    for r in (math.floor(row), math.floor(row) + 1):
        for c in (math.floor(column), math.floor(column) + 1):
            inside = min(max(r, 0), height - 1)
            over = 0 if inside == r else width // 2
            found.append((inside, (c + over) % width, (1.0 - abs(row - r)) * (1.0 - abs(column - c))))
    return found


def _coverage(towards: np.ndarray, radius: float, size: tuple[int, int], rows: slice) -> np.ndarray:
    """Return the share of each pixel of some rows, (rows, width), that lies in a disc with an angular radius (rad)."""
    height, width = size
    reach = 0.5 * np.hypot(np.pi / height, 2 * np.pi / width)
    theta = np.pi * (np.arange(height)[rows] + 0.5) / height
    if np.abs(theta - np.arccos(np.clip(towards[2], -1.0, 1.0))).min() > radius + 2 * reach:
        return np.zeros((len(theta), width))
    cosine = directions(width, height, rows)[0] @ towards
    covered = (cosine > np.cos(max(radius - reach, 0.0))).astype(np.float64)
    row, columns = np.nonzero((cosine > np.cos(min(radius + reach, np.pi))) & (covered == 0.0))
    steps = (np.arange(_PARTS) + 0.5) / _PARTS
    theta = np.pi * (np.arange(height)[rows][row][:, None, None] + steps[:, None]) / height
    azimuth = 2 * np.pi * (columns[:, None, None] + steps) / width
    inside = np.sin(theta) * (np.cos(azimuth) * towards[0] + np.sin(azimuth) * towards[1]) + np.cos(theta) * towards[2]
    weight = np.broadcast_to(np.sin(theta), inside.shape)
    share = ((inside > np.cos(radius)) * weight).sum(axis=(1, 2)) / weight.sum(axis=(1, 2))
    covered[row, columns] = share
    return covered


def raster(definition: "PlacedLight", size: tuple[int, int]) -> Callable[[slice], np.ndarray]:
    """Return a function of a row slice that returns the radiance of a light in these rows, (rows, width) float64.

    Parameters
    ----------
    definition : PlacedLight
        Light with either ``radiance`` or ``irradiance``. The latter is that on a surface that faces the light, and is 1
        if a perfect diffuser there has radiance 1.
    size : (height, width)
        Size of the picture, px. A disc smaller than a pixel is replaced by the four pixels around its middle, with its
        energy and its mean direction.
    """
    height, width = size
    towards = direction_of(definition.azimuth_deg, definition.elevation_deg)
    radius = 0.5 * np.radians(definition.diameter_deg)

    def disc(rows: slice) -> np.ndarray:
        return _coverage(towards, radius, size, rows)

    def point(rows: slice) -> np.ndarray:
        shape = np.zeros((len(range(height)[rows]), width))
        for row, column, share in around:
            if rows.start <= row < rows.stop:
                shape[row - rows.start, column] += share / of_row[row]
        return shape

    around, of_row = _pixels_around(towards, width, height), row_solid_angles(width, height)
    is_disc = radius >= 0.5 * max(np.pi / height, 2 * np.pi / width) and any(disc(r).any() for r in bands(height))
    shape = disc if is_disc else point
    power = facing = 0.0
    for rows in bands(height):
        part = shape(rows)
        if not part.any():
            continue
        unit, _ = directions(width, height, rows)
        part = part * of_row[rows, None]
        power, facing = power + part.sum(), facing + (part * np.maximum(unit @ towards, 0.0)).sum()
    if definition.irradiance is not None:
        # Σ L cosψ dΩ on a surface that faces the light is π times the radiance of a perfect diffuser.
        factor = np.pi * definition.irradiance / facing
    else:
        assert definition.radiance is not None  # one of the two is given
        factor = definition.radiance * 4.0 * np.pi * np.sin(0.5 * radius) ** 2 / power
    return lambda rows: factor * shape(rows)


def lights_picture(lights: "Sequence[PlacedLight]", width: int, height: int) -> OmnidirectionalPicture:
    """Make the picture of placed lights, with one basis vector per light.

    Parameters
    ----------
    lights : sequence of PlacedLight
    width, height : int
        Size of the picture, px.
    """
    size = height, width
    shapes = [raster(one, size) for one in lights]
    basis = np.stack([unit_luminance(one.spectrum) for one in lights], axis=1)

    def read() -> Iterator[np.ndarray]:
        for rows in bands(height):
            yield np.stack([shape(rows) for shape in shapes], axis=-1).astype(np.float32)

    return OmnidirectionalPicture(size, basis, read, "the placed lights", {"kind": "lights", "count": len(lights)})
