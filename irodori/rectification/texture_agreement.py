"""Texture of an object in its photographs, and its derivatives by the shifts that would make photographs agree.

The diffuse part of a texel's response is its colour times the cosine of incidence. The logarithm of response over
cosine is therefore the same in all photographs, apart from the level of the lamp, gloss and other differences that vary
slowly over the surface. Subtracting the mean of each block of texels removes these differences; what remains is the
texture. The unknown colours of the texels are eliminated from the equations.
"""

from typing import NamedTuple

import numpy as np

from irodori.rectification.reduced_pictures import DARK, Level, Picture

_MATT_RAD = 0.35  # angle between normal and half vector below which gloss may matter
_BLOCK_SIGMAS = 8.0  # side of a block, in standard deviations of the blur
_ROUNDS = 6  # iterations that estimate levels of blocks and colours of texels in turn
_LEAST_BLOCK = 3  # texels with weight that a block needs to be used


class TextureRows(NamedTuple):
    """Linearised texture of one photograph: value of each texel, its weight, and derivatives by each unknown."""

    weight: np.ndarray  # (n,) 0 where the texel is not used
    value: np.ndarray  # (n, bands)
    change: np.ndarray  # (n, bands, unknowns)


def matt_weight(phi: np.ndarray) -> np.ndarray:
    """Return weights of observations from the angle φ between normal and half vector, rad: low near the highlight."""
    return np.clip(phi / _MATT_RAD, 0.0, 1.0) ** 2


def blocks(columns: int, rows: int, texel_samples: float, blur: float) -> np.ndarray:
    """Divide a grid of texels into square blocks and return the block number of each texel, (rows * columns,) int.

    Parameters
    ----------
    columns, rows : int
        Size of the grid.
    texel_samples : float
        Size of a texel in the pictures, samples.
    blur : float
        Standard deviation of the blur, samples.
    """
    side = int(np.clip(round(_BLOCK_SIGMAS * blur / max(texel_samples, 1e-9)), 5, 20))
    row, column = np.divmod(np.arange(rows * columns), columns)
    return (row // side) * -(-columns // side) + column // side


def picture_slope(values: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return gradients in a picture of values on the grid of texels, (rows, columns, bands, 2) per superpixel.

    NaN where a neighbour has no value.

    Parameters
    ----------
    values : (rows, columns, bands) float
        NaN where there is no value.
    place : (rows, columns, 2) float
        Positions of the texels in the picture, superpixels.
    """
    down, across = np.gradient(values, axis=(0, 1))
    place_down, place_across = np.gradient(place, axis=(0, 1))
    determinant = place_across[..., 0] * place_down[..., 1] - place_across[..., 1] * place_down[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (across * place_down[..., 1:] - down * place_across[..., 1:]) / determinant[..., None]
        y = (down * place_across[..., :1] - across * place_down[..., :1]) / determinant[..., None]
    return np.stack([x, y], axis=-1)


def texel_values(picture: Picture, level: Level, place, shading) -> np.ndarray:
    """Return logarithms of the texels' responses over their irradiance, (n, bands); NaN where not in the photograph.

    Parameters
    ----------
    picture : Picture
    level : Level
        Blurred version of the picture.
    place : (n, 2) float
        Positions of the texels in the picture, superpixels.
    shading : (n,) float
        Cosine of incidence times the irradiance normal to the beam; NaN if lit from behind.
    """
    found = level.sampled(level.bands, picture.place(place))
    return np.log(np.maximum(found, 0.0) / shading[:, None] + DARK)


def mean_texture(values: list[np.ndarray], weights: list[np.ndarray]) -> np.ndarray:
    """Return the weighted mean of each texel's values over photographs, (n, bands); NaN for a texel without weight."""
    total = np.sum(weights, axis=0)
    summed = sum(w[:, None] * v for v, w in zip(values, weights, strict=True))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(total[:, None] > 0.0, summed / total[:, None], np.nan)


def _block_means(values: np.ndarray, weight: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Return the weighted mean of the values in each block, (blocks, ...); 0 for a block without weight."""
    total = np.bincount(block, weight)
    sums = np.zeros((len(total), *values.shape[1:]))
    used = weight > 0.0
    np.add.at(sums, block[used], (weight[used] * values[used].T).T)
    return (sums.T / np.maximum(total, 1e-12)).T


def without_levels(values: list[np.ndarray], weights: list[np.ndarray], block: np.ndarray) -> list[np.ndarray]:
    """Return the values of each photograph, (n, bands), less the photograph's offset in each block from the others.

    Photographs show different parts of a block, so that offsets and mean texture are estimated in turn.

    Parameters
    ----------
    values : list of (n, bands) float
        One array for each photograph; NaN only where the weight is 0.
    weights : list of (n,) float
    block : (n,) int
        Block of each texel.
    """
    own = [np.where(w[:, None] > 0.0, v, 0.0) for v, w in zip(values, weights, strict=True)]
    totals = np.array([np.bincount(block, w) for w in weights])
    share = totals / np.maximum(totals.sum(axis=0), 1e-12)
    level = np.zeros((len(own), totals.shape[1], own[0].shape[1]))
    for _ in range(_ROUNDS):
        mean = np.nan_to_num(mean_texture([v - g[block] for v, g in zip(own, level, strict=True)], weights))
        level = np.stack([_block_means(v - mean, w, block) for v, w in zip(own, weights, strict=True)])
        level -= np.einsum("jb,jbc->bc", share, level)
    return [v - g[block] for v, g in zip(own, level, strict=True)]


def texture_rows(values: np.ndarray, slope: np.ndarray, moved: np.ndarray, weight, block) -> TextureRows:
    """Return the linearised texture of a photograph, with the mean of each block subtracted from the derivatives.

    Parameters
    ----------
    values : (n, bands) float
        Values that `without_levels` returned for the photograph.
    slope : (n, bands, 2) float
        Gradient of the mean texture per superpixel of this photograph; the photograph's own gradient would contain
        shading and gloss too. A texel where it is not finite is not used.
    moved : (n, 2, unknowns) float
        Derivatives of the texels' positions by the unknowns, superpixels.
    weight : (n,) float
    block : (n,) int
        Block of each texel.
    """
    weight = np.where(np.isfinite(slope).all(axis=(1, 2)), weight, 0.0)
    change = np.where(weight[:, None, None] > 0.0, slope, 0.0) @ moved
    change = np.where(weight[:, None, None] > 0.0, change - _block_means(change, weight, block)[block], 0.0)
    count = np.bincount(block, weight > 0.0)
    return TextureRows(np.where(count[block] >= _LEAST_BLOCK, weight, 0.0), values, change)
