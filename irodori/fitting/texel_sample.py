"""Samples of an object's texels, for estimates that are made once for the whole object."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from irodori.core import store
from irodori.fitting.diffuse_response import Observed
from irodori.fitting.stage import read_observations
from irodori.reflection.coat import diffuse_cosine

_LEAST_VARIANCE = 1e-8  # smallest variance, relative to the mean square response of a texel
_OF_TEXELS = ("response", "weight", "geometry")  # fields of `Readings` with an entry for each texel
_MOST_TILES = 16  # evenly over the object: of ten million texels one tile in sixteen


@dataclass(frozen=True)
class Readings:
    """Observations of texels in one band, in the form of the arguments of `irodori.fitting.solvers.fit`.

    Parameters
    ----------
    response, weight : (texels, J) float
    geometry : (texels, J, 4) float
        θ_i, θ_r, θ_H, φ in rad.
    noise : (J, 2) float
        c0 and c1 of the variance c0 + c1 ρ of a response; NaN if unknown.
    n, k : float
        Complex refractive index.
    coupled : bool
        Whether the coat reduces the diffuse term, see `irodori.reflection.coat`.
    """

    response: np.ndarray
    weight: np.ndarray
    geometry: np.ndarray
    noise: np.ndarray
    n: float
    k: float
    coupled: bool = False

    @classmethod
    def of_band(cls, observed: Observed, band: int, n: float, k: float, coupled: bool = False) -> "Readings":
        """Return the observations of one band."""
        response, noise = observed.response[..., band], observed.noise[:, band]
        return cls(response, observed.weight, observed.geometry, noise, n, k, coupled)

    @classmethod
    def joined(cls, several: Sequence["Readings"]) -> "Readings":
        """Return the observations of the texels of several instances, which have the same photographs."""
        parts: dict = {name: np.concatenate([getattr(one, name) for one in several]) for name in _OF_TEXELS}
        return replace(several[0], **parts)

    def __getitem__(self, texels) -> "Readings":
        """Return the observations of some texels; ``texels`` is any NumPy index."""
        parts: dict = {name: getattr(self, name)[texels] for name in _OF_TEXELS}
        return replace(self, **parts)

    def variance(self, response: np.ndarray, model_error: float) -> np.ndarray:
        """Return the variance of responses from camera noise and light, (texels, J), in the band of these readings.

        From light alone if the noise is unknown. ``model_error`` is the relative error apart from noise.
        """
        noise = np.nan_to_num(self.noise.astype(np.float64))
        told = (self.weight > 0.0) & np.isfinite(self.response)
        power = np.mean(np.where(told, self.response, 0.0).astype(np.float64) ** 2, axis=1)[:, None]
        own = noise[:, 0] + noise[:, 1] * np.maximum(response, 0.0) + (model_error * response) ** 2
        return own + _LEAST_VARIANCE * power + np.finfo(float).tiny

    def diffuse(self, geometry: np.ndarray) -> np.ndarray:
        """Return the diffuse term for α = 1 under any angles, (...) of (..., 4)."""
        return diffuse_cosine(geometry, self.n, self.k, self.coupled)


def drawn(observations: np.ndarray, most: int, enough: int) -> np.ndarray:
    """Return indices of some texels, drawn at random: of those with enough observations, or else with the most.

    Parameters
    ----------
    observations : (texels,) int
        Number of observations of each.
    most, enough : int
        As in `sample_texels`.
    """
    found = np.flatnonzero(observations >= max(min(enough, observations.max(initial=0)), 1))
    # Every nth would be a few columns of a texture whose width n divides.
    return np.sort(np.random.default_rng(1).permutation(found)[:most])


def sample_texels(tiles: list, most: int, enough: int) -> Observed:
    """Draw texels evenly from tiles: those with enough observations, or if there are none, with the most.

    Parameters
    ----------
    tiles : list of path
        All observations of the object.
    most : int
        Texels to return, about.
    enough : int
        Observations of a texel.
    """
    tiles = tiles[:: -(-len(tiles) // _MOST_TILES)]
    counts = [_observations(path) for path in tiles]
    least = max(min(enough, max(count.max(initial=0) for count in counts)), 1)
    total = sum(int((count >= least).sum()) for count in counts)
    step = max(1, -(-total // most))
    parts = [
        read_observations(path, texels=np.flatnonzero(count >= least)[::step])
        for path, count in zip(tiles, counts, strict=True)
    ]
    return Observed(
        response=np.concatenate([part.response for part in parts]),
        geometry=np.concatenate([part.geometry for part in parts]),
        weight=np.concatenate([part.weight for part in parts]),
        clipped=np.concatenate([part.clipped for part in parts]),
        noise=parts[0].noise,
    )


def _observations(path) -> np.ndarray:
    """Count the observations with a positive weight of each texel of a tile."""
    with store.open_file(path) as file:
        return (file.read("weight") > 0).sum(axis=1)
