"""Texture of an object as photographs tell it, and how far they must move to agree about it.

The diffuse part of a texel's response is its colour times the cosine of incidence, so that logarithms over that cosine
are one number in all photographs, but for the level of the lamp, gloss and all else that changes slowly over a surface.
These drop out with the level of a block of texels; what is left is the texture, whose colours are eliminated.
"""

from typing import NamedTuple

import numpy as np

from irodori.rectification.reduced_pictures import DARK, Level, Picture

_MATT_RAD = 0.35  # of an angle between normal and half vector under which gloss has its say
_BLOCK_SIGMAS = 8.0  # side of a block, in standard deviations of the blur
_ROUNDS = 6  # in which levels of blocks and colours of texels are found in turn
_LEAST_BLOCK = 3  # texels with a weight, below which a block says nothing


class TextureRows(NamedTuple):
    """Linearised texture of one photograph: what each texel shows, and how that changes with each unknown."""

    weight: np.ndarray  # (n,) 0 where the texel says nothing
    value: np.ndarray  # (n, bands)
    change: np.ndarray  # (n, bands, unknowns)


def matt_weight(phi: np.ndarray) -> np.ndarray:
    """Return the weight of observations by their angle between normal and half vector, rad: little where gloss is."""
    return np.clip(phi / _MATT_RAD, 0.0, 1.0) ** 2


def blocks(columns: int, rows: int, texel_samples: float, blur: float) -> np.ndarray:
    """Return the block of each texel, (rows * columns,) int.

    Parameters
    ----------
    columns, rows : int
    texel_samples : float
        Samples of the pictures along a texel.
    blur : float
        Standard deviation of the blur, samples.
    """
    side = int(np.clip(round(_BLOCK_SIGMAS * blur / max(texel_samples, 1e-9)), 5, 20))
    row, column = np.divmod(np.arange(rows * columns), columns)
    return (row // side) * (columns // side + 1) + column // side


def picture_slope(values: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return how values on the grid of texels change over a picture, (rows, columns, bands, 2) a superpixel.

    NaN where a neighbour has no value.

    Parameters
    ----------
    values : (rows, columns, bands) float
        NaN where there is none.
    place : (rows, columns, 2) float
        Where the texels appear, superpixels.
    """
    down, across = np.gradient(values, axis=(0, 1))
    place_down, place_across = np.gradient(place, axis=(0, 1))
    determinant = place_across[..., 0] * place_down[..., 1] - place_across[..., 1] * place_down[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (across * place_down[..., 1:] - down * place_across[..., 1:]) / determinant[..., None]
        y = (down * place_across[..., :1] - across * place_down[..., :1]) / determinant[..., None]
    return np.stack([x, y], axis=-1)


def texel_values(picture: Picture, level: Level, place, shading) -> np.ndarray:
    """Return logarithms of what texels reflect, (n, bands); NaN where a photograph does not show them.

    Parameters
    ----------
    picture : Picture
    level : Level
        Of the picture.
    place : (n, 2) float
        Where texels appear, superpixels.
    shading : (n,) float
        Cosine of incidence times the lamp's power; NaN where the light is behind.
    """
    found = level.sampled(level.bands, picture.place(place))
    return np.log(np.maximum(found, 0.0) / shading[:, None] + DARK)


def mean_texture(values: list[np.ndarray], weights: list[np.ndarray]) -> np.ndarray:
    """Return the mean of what photographs show of each texel, finite (n, bands); NaN where it has no weight."""
    total = np.sum(weights, axis=0)
    summed = sum(w[:, None] * v for v, w in zip(values, weights, strict=True))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(total[:, None] > 0.0, summed / total[:, None], np.nan)


def _block_means(values: np.ndarray, weight: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Return the weighted mean of each block, (blocks, ...), 0 of one without weight."""
    total = np.bincount(block, weight, block.max() + 1)
    sums = np.zeros((len(total), *values.shape[1:]))
    used = weight > 0.0
    np.add.at(sums, block[used], (weight[used] * values[used].T).T)
    return (sums.T / np.maximum(total, 1e-12)).T


def without_levels(values: list[np.ndarray], weights: list[np.ndarray], block: np.ndarray) -> list[np.ndarray]:
    """Return values of each photograph, (n, bands), without what it has more than the others over a block.

    Photographs show different parts of a block, so that its level and the colours of its texels are found together.

    Parameters
    ----------
    values : list of (n, bands) float
        NaN only where there is no weight.
    weights : list of (n,) float
    block : (n,) int
    """
    own = [np.where(w[:, None] > 0.0, v, 0.0) for v, w in zip(values, weights, strict=True)]
    totals = np.array([np.bincount(block, w, block.max() + 1) for w in weights])
    share = totals / np.maximum(totals.sum(axis=0), 1e-12)
    level = np.zeros((len(own), totals.shape[1], own[0].shape[1]))
    for _ in range(_ROUNDS):
        mean = np.nan_to_num(mean_texture([v - g[block] for v, g in zip(own, level, strict=True)], weights))
        level = np.stack([_block_means(v - mean, w, block) for v, w in zip(own, weights, strict=True)])
        level -= np.einsum("jb,jbc->bc", share, level)
    return [v - g[block] for v, g in zip(own, level, strict=True)]


def texture_rows(values: np.ndarray, slope: np.ndarray, moved: np.ndarray, weight, block) -> TextureRows:
    """Return the texture of texels as a photograph shows it, with its change less the mean of each block.

    Parameters
    ----------
    values : (n, bands) float
        Those of `without_levels`.
    slope : (n, bands, 2) float
        Of the texture that all photographs tell, a superpixel of this one: their own slopes are those of shading and
        gloss as well. Where it is not finite, the texel says nothing.
    moved : (n, 2, unknowns) float
        How the places of the texels change, superpixels.
    weight : (n,) float
    block : (n,) int
    """
    weight = np.where(np.isfinite(slope).all(axis=(1, 2)), weight, 0.0)
    change = np.where(weight[:, None, None] > 0.0, slope, 0.0) @ moved
    change = np.where(weight[:, None, None] > 0.0, change - _block_means(change, weight, block)[block], 0.0)
    count = np.bincount(block, weight > 0.0, block.max() + 1)
    return TextureRows(np.where(count[block] >= _LEAST_BLOCK, weight, 0.0), values, change)
