"""Environments made of lights of known spectrum in given directions, each a disc or a single texel."""

import numpy as np

from irodori.colour import colour_matching_weights
from irodori.light import directions
from irodori.omnidirectional import Picture
from irodori.spectra import light

_PARTS = 16  # points along each side of a pixel that a disc's edge crosses


def unit_luminance(name: str) -> np.ndarray:
    """Return the spectrum of a light with the luminance of D65 as tabulated (100 at 560 nm): radiance 1, (61,)."""
    luminance = colour_matching_weights()[1]
    spectrum = light(name)
    return spectrum * (luminance @ light("D65")) / (luminance @ spectrum)


def direction_of(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    """Return a unit vector, (3,): azimuth from +x towards +y, elevation from the horizon up, degrees."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    return np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])


def _texel(towards: np.ndarray, width: int, height: int) -> tuple[int, int]:
    theta = np.arctan2(np.hypot(towards[0], towards[1]), towards[2])
    turn = np.arctan2(towards[1], towards[0]) % (2 * np.pi) / (2 * np.pi)
    return min(int(theta / np.pi * height), height - 1), min(int(turn * width), width - 1)


def _coverage(towards: np.ndarray, radius: float, unit: np.ndarray) -> np.ndarray:
    """Return the share of every pixel that lies in a disc of an angular radius (rad), (height, width)."""
    height, width = unit.shape[:2]
    reach = 0.5 * np.hypot(np.pi / height, 2 * np.pi / width)
    cosine = unit @ towards
    covered = (cosine > np.cos(max(radius - reach, 0.0))).astype(np.float64)
    rows, columns = np.nonzero((cosine > np.cos(min(radius + reach, np.pi))) & (covered == 0.0))
    steps = (np.arange(_PARTS) + 0.5) / _PARTS
    theta = np.pi * (rows[:, None, None] + steps[:, None]) / height
    azimuth = 2 * np.pi * (columns[:, None, None] + steps) / width
    inside = np.sin(theta) * (np.cos(azimuth) * towards[0] + np.sin(azimuth) * towards[1]) + np.cos(theta) * towards[2]
    weight = np.broadcast_to(np.sin(theta), inside.shape)
    share = ((inside > np.cos(radius)) * weight).sum(axis=(1, 2)) / weight.sum(axis=(1, 2))
    covered[rows, columns] = share
    return covered


def raster(definition: dict, unit: np.ndarray, solid_angle: np.ndarray) -> np.ndarray:
    """Return the radiance of one light over a picture, (height, width) float64, its energy kept.

    Parameters
    ----------
    definition : dict
        ``azimuth_deg``, ``elevation_deg``, ``diameter_deg``, and either ``radiance`` or ``irradiance``: of a surface
        that faces the light, 1 where a perfect diffuser there has radiance 1.
    unit, solid_angle : as `irodori.light.directions` gives them
        A disc smaller than a pixel is one pixel with its energy.
    """
    height, width = solid_angle.shape
    towards = direction_of(definition["azimuth_deg"], definition["elevation_deg"])
    radius = 0.5 * np.radians(definition["diameter_deg"])
    shape = np.zeros((height, width))
    if radius >= 0.5 * max(np.pi / height, 2 * np.pi / width):
        shape = _coverage(towards, radius, unit)
    if not shape.any():
        row, column = _texel(towards, width, height)
        shape[row, column] = 1.0
        towards = unit[row, column]
    if "irradiance" in definition:
        # Σ L cosψ dΩ of a surface that faces the light is π times the radiance of a perfect diffuser.
        return shape * (
            np.pi * definition["irradiance"] / (shape * np.maximum(unit @ towards, 0.0) * solid_angle).sum()
        )
    disc = 4.0 * np.pi * np.sin(0.5 * radius) ** 2
    return shape * (definition["radiance"] * disc / (shape * solid_angle).sum())


def lights_picture(lights: list[dict], width: int, height: int) -> Picture:
    """Return the light of placed lights, one basis vector a light.

    Parameters
    ----------
    lights : list of dict
        See `raster`; and ``spectrum``.
    width, height : int
        Size of the picture, px.
    """
    unit, solid_angle = directions(width, height)
    weights = np.stack([raster(one, unit, solid_angle) for one in lights], axis=-1).astype(np.float32)
    basis = np.stack([unit_luminance(one["spectrum"]) for one in lights], axis=1)
    return Picture(weights, basis, {"kind": "lights", "count": len(lights)})
