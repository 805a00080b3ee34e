"""Clustering of the colours of an object's texels into paints: number of paints, and the paint of each texel.

A colour is the diffuse response of a texel in all bands, on a scale on which the colours of one paint scatter by about
1 in each band because of noise and light. Texels with the same colour as all their neighbours are the *cores* of
painted areas; at a seam, where a texel shows a mixture, there are none. The colours of the cores are covered with
balls, and balls that touch belong to one paint: two colours belong to different paints if no chain of colours connects
them.
"""

from dataclasses import dataclass

import numpy as np

from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit

#: Relative scatter of the colours of one paint in a band (1 %), from errors of light and pose.
STEP = 0.01
MOST_CORES = 20000  # texels from which the paints of an object are found
_LEAST_SHARE = 0.002  # share of the cores below which a ball counts as a mixture or an outlier
_LEAST_CORES = 8
_MOST_BALLS = 400
_CHUNK = 8192  # texels that a thread takes at a time


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest_chunk(colour, precision, centre, found, first, last):
    """Fill the mean squared distance to the nearest centre, in units of the scatter, and the centre's index."""
    best, place = found
    for t in range(first, last):
        least = np.inf
        for ball in range(centre.shape[0]):
            square = 0.0
            for band in range(centre.shape[1]):
                square += (colour[t, band] - centre[ball, band]) ** 2 * precision[t, band]
            if square < least:
                least, place[t] = square, ball
        best[t] = least / centre.shape[1]


@dataclass(frozen=True)
class Colours:
    """The colours of an object's paints.

    Parameters
    ----------
    floor : (bands,) float64
        Response at which noise is as large as `STEP` of it.
    centre : (balls, bands) float64
        Centres of the balls that cover the cores, on the scale of `scaled`.
    paint : (balls,) int
        Number of the paint to which a ball belongs.
    """

    floor: np.ndarray
    centre: np.ndarray
    paint: np.ndarray

    @property
    def count(self) -> int:
        """The number of paints."""
        return int(self.paint.max()) + 1 if self.paint.size else 0

    def scaled(self, response: np.ndarray) -> np.ndarray:
        """Convert responses, (..., bands), to a scale on which one paint scatters by about 1 in each band."""
        return np.log1p(np.maximum(response, -0.5 * self.floor) / self.floor) / STEP

    def nearest(self, response: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the paint with the nearest colour for each texel.

        Parameters
        ----------
        response, variance : (texels, bands) float
            Diffuse responses and their variances; an unknown variance (NaN) counts as 0.

        Returns
        -------
        paint : (texels,) int
            Number of the paint; -1 for a texel without a colour.
        distance : (texels,) float64
            RMS distance over the bands, in units of the scatter of the texel's colour; infinite without a colour.
        """
        out, distance = np.full(len(response), -1), np.full(len(response), np.inf)
        known = np.isfinite(response).all(axis=1)
        if not self.count or not known.any():
            return out, distance
        colour = self.scaled(response[known])
        spread = 1.0 + np.nan_to_num(variance[known]) / (STEP * (response[known] + self.floor)) ** 2
        best, place = np.empty(len(colour)), np.zeros(len(colour), dtype=np.int64)
        run_chunks(_nearest_chunk, len(colour), _CHUNK, colour, 1.0 / spread, self.centre, (best, place))
        out[known], distance[known] = self.paint[place], np.sqrt(best)
        return out, distance

    def between(self, response, variance, one, other) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Estimate which share of a second paint texels show, if they show a mixture of two.

        Parameters
        ----------
        response, variance : (texels, bands) float
            As for `nearest`.
        one, other : (texels,) int
            Numbers of the paints.

        Returns
        -------
        share, error : (texels,) float64
            0 to 1, and its standard error, for errors of the colour that all bands share; NaN without a colour.
        distance : (texels,) float64
            RMS distance over the bands to the mixture, in units of the scatter of the texel's colour.
        """
        first, second = self.nearest_of(response, one), self.nearest_of(response, other)
        scatter = (STEP * (np.maximum(response, 0.0) + self.floor)) ** 2 + np.nan_to_num(variance)
        apart = ((second - first) ** 2 / scatter).mean(axis=1)
        share = np.clip(((response - first) * (second - first) / scatter).mean(axis=1) / apart, 0.0, 1.0)
        mixture = first + share[:, None] * (second - first)
        return share, 1.0 / np.sqrt(apart), np.sqrt(((response - mixture) ** 2 / scatter).mean(axis=1))

    def nearest_of(self, response: np.ndarray, paint: np.ndarray) -> np.ndarray:
        """Return the response nearest to each texel's, (texels, bands), among those of a given paint."""
        colour, out = self.scaled(response), np.empty(response.shape)
        for number in np.unique(paint):
            here, balls = paint == number, self.centre[self.paint == number]
            place = np.zeros(int(here.sum()), dtype=np.int64)
            _nearest_chunk(
                colour[here], np.ones_like(colour[here]), balls, (np.empty(len(place)), place), 0, len(place)
            )
            out[here] = np.expm1(balls[place] * STEP) * self.floor
        return out


#: Typical RMS distance over the bands between two texels of one paint, each with a scatter of 1.
NEAR = float(np.sqrt(2.0))


def noise_floor(variance: np.ndarray, response: np.ndarray) -> np.ndarray:
    """Return the response in each band at which the noise is the share `STEP` of the response, (bands,).

    ``variance`` and ``response`` are those of texels of an object, (texels, bands). The result is at least a hundredth
    of the median response, which is used alone if the camera's noise is unknown; without texels it is 1.
    """
    if not len(response):
        return np.ones(response.shape[1])
    floor = 0.01 * np.maximum(np.median(response, axis=0), 1e-6)
    for band, known in enumerate(np.isfinite(variance).T):
        if known.any():
            floor[band] = max(floor[band], np.sqrt(np.median(variance[known, band])) / STEP)
    return floor


def cores(response: np.ndarray, floor: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return the texels that have the same colour as all their neighbours, (height, width) bool.

    There are eight neighbours, fewer at the border.

    Parameters
    ----------
    response : (height, width, bands) float
    floor : (bands,) float
    chosen : (height, width) bool
        Texels with a reliable colour; the others are never cores, and are ignored as neighbours.
    """
    colour = Colours(floor, np.empty((0, len(floor))), np.empty(0, dtype=int)).scaled(response)
    out = chosen & np.isfinite(response).all(axis=-1)
    believed = out.copy()
    height, width = out.shape
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = np.s_[: height - down, max(-right, 0) : width - max(right, 0)]
        there = np.s_[down:, max(right, 0) : width + min(right, 0)]
        with np.errstate(invalid="ignore"):
            apart = np.sqrt(((colour[here] - colour[there]) ** 2).mean(axis=-1)) > 2.0 * NEAR
        apart &= believed[here] & believed[there]
        out[here] &= ~apart
        out[there] &= ~apart
    return out


def find_colours(response: np.ndarray, floor: np.ndarray) -> Colours:
    """Cluster the responses of cores, (cores, bands), into paints; paint 0 has the most cores.

    ``floor`` is that of `Colours`.
    """
    from scipy.sparse.csgraph import connected_components  # slow to import

    none = Colours(floor, np.empty((0, response.shape[1])), np.empty(0, dtype=int))
    colour = none.scaled(response)
    free = np.ones(len(colour), dtype=bool)
    centres: list[np.ndarray] = []
    members: list[int] = []
    least = max(_LEAST_CORES, _LEAST_SHARE * len(colour))
    while free.any() and len(centres) < _MOST_BALLS:
        left = np.flatnonzero(free)
        seed = colour[left[0]]
        for _ in range(3):  # move the seed to the median of the colours near it
            near = _apart(colour[left], seed) <= NEAR
            seed = np.median(colour[left[near]], axis=0) if near.any() else seed
        near = _apart(colour[left], seed) <= NEAR
        near[0] = True
        free[left[near]] = False
        if near.sum() >= least:
            centres.append(seed)
            members.append(int(near.sum()))
    if not centres:
        return none
    centre = np.stack(centres)
    touching = _apart(centre[:, None], centre[None]) <= 2.0 * NEAR
    _, paint = connected_components(touching, directed=False)
    order = np.argsort(-np.bincount(paint, weights=members), kind="stable")
    return Colours(floor, centre, np.argsort(order)[paint])


def _apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.sqrt(((one - other) ** 2).mean(axis=-1))
