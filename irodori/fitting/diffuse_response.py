"""Diffuse response of texels in every band: what is left of their observations without the gloss.

The gloss is fitted in one band. In the others it is the same but for the Fresnel reflectance of the band.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from irodori.fitting.band_fresnel import BandGloss
from irodori.fitting.solvers import FitResult
from irodori.fitting.texel_rows import (
    ASSUMED,
    BEFORE,
    COSINE,
    F0,
    F1,
    F2,
    LOBE,
    LOBE_SLOPE,
    RESPONSE,
    SPOILED,
    TRUST,
    VARIANCE,
    WEIGHT,
    WEIGHTED_COSINE,
    WEIGHTED_RESPONSE,
    fill_lobe,
    folded,
    get,
    highest,
    new_rows,
    pack_geometry,
    padded,
    put,
    vectors_of,
)
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit, uncounted
from irodori.jit.functions import magnitude, select, upper_of
from irodori.jit.vector_memory import load, spread
from irodori.jit.vectors import LANES
from irodori.reflection.lobes import Lobes

GREEN = 1  # green without the filter, the band of equation (7)
_RESPONSE_NOISE = 0.01  # standard deviation of a response if the camera's noise is unknown
_LEAST_VARIANCE = 1e-12
_GLOSS_MODEL_ERROR = 0.1
_FAR, _AN_OUTLIER_IN = 6.0, 8  # distance of an outlier in standard deviations; at most one in 8 is one in green
_PLATEAU = 0.9  # share of the brightest response from which on others may clip too: levels of photographs differ
_CHUNK = 2048  # texels that a thread takes at a time
#: Rows with other contents here than in a fit: gloss in green, gloss in the present band, place in the table of ratios;
#: in the test for outliers, what diffuse light should explain, its variance, both in green, and the squared distance.
_OF_GREEN, _OF_BAND, _PLACE = ASSUMED, LOBE_SLOPE, BEFORE
_REST, _SQUARE, _GREEN_REST, _GREEN_SQUARE, _OFF = F0, VARIANCE, F1, F2, WEIGHTED_COSINE
_MAY_BE_LOW, _MAY_BE_HIGH = WEIGHTED_RESPONSE, LOBE  # whether an observation may be left out as too dark or too bright


@dataclass(frozen=True)
class Observed:
    """Observations of texels in all bands.

    Parameters
    ----------
    response : (texels, J, bands) float
    geometry : (texels, J, 4) float
        θ_i, θ_r, θ_H, φ in rad.
    weight : (texels, J) float
    clipped : (texels, J) uint8
    noise : (J, bands, 2) float64
        c0 and c1 of the variance c0 + c1 ρ of a response ρ by the camera's noise.
    """

    response: np.ndarray
    geometry: np.ndarray
    weight: np.ndarray
    clipped: np.ndarray
    noise: np.ndarray

    def __getitem__(self, chosen) -> "Observed":
        """Return the observations of selected texels; ``chosen`` is any NumPy index."""
        response, geometry, weight = self.response[chosen], self.geometry[chosen], self.weight[chosen]
        return Observed(response, geometry, weight, self.clipped[chosen], self.noise)


class Fitted(NamedTuple):
    """Observations of texels in all bands, and the gloss fitted to them.

    Parameters
    ----------
    response : (texels, J, bands) float
    geometry : (texels, J, 4) float
        θ_i, θ_r, θ_H, φ in rad.
    weight : (texels, J) float
    noise : (bands, 2, P) float64
        c0 and c1 of the variance c0 + c1 ρ of a response ρ by the camera's noise, for J padded to P observations.
    model_error : float
        Relative error of an observation apart from noise.
    lobes : tuple of Lobes
        Lobe of each component.
    gloss : (texels, 2 or 4) float64
        β and μ of each component.
    n, k : float
        Complex refractive index of the fit.
    coupled : bool
        Whether the coat reduces the diffuse term.
    coloured : bool
        Whether the Fresnel reflectance of some band is another than that of the fit.
    ratio : (bands, angles) float64
        Fresnel reflectance of each band divided by that of the fit, at equally spaced θ_H from 0 to π/2.
    """

    response: np.ndarray
    geometry: np.ndarray
    weight: np.ndarray
    noise: np.ndarray
    model_error: float
    lobes: tuple[Lobes, ...]
    gloss: np.ndarray
    n: float
    k: float
    coupled: bool
    coloured: bool
    ratio: np.ndarray


@uncounted(error_model="numpy")
def _expected(given, b, j, gloss, fitted):
    """Return the variances of eight observations in band b from noise, light and the error of the gloss.

    The noise is that at the ``fitted`` responses. If it is unknown, a constant is used.
    """
    noise, light = given.noise, given.model_error * fitted
    first = 2 * b * noise.shape[2] + j * LANES
    own = load(noise, first) + load(noise, first + noise.shape[2]) * upper_of(fitted, 0.0) + light * light
    own = select(magnitude(own) < np.inf, upper_of(own, _LEAST_VARIANCE), _RESPONSE_NOISE * _RESPONSE_NOISE)
    return own + (_GLOSS_MODEL_ERROR * gloss) * (_GLOSS_MODEL_ERROR * gloss)


@uncounted(error_model="numpy")
def _screen(t, given, rows):
    """Fill the weights of the valid observations of a texel, 0 for those that are not; return their number."""
    response, weight, used, b = given.response, given.weight, spread(0.0), min(GREEN, given.response.shape[2] - 1)
    for j in range(response.shape[1]):
        rows[RESPONSE, j], rows[TRUST, j] = response[t, j, b], weight[t, j]
    for j in range(vectors_of(rows)):
        w = get(rows, TRUST, j)
        fine = (magnitude(get(rows, RESPONSE, j) + get(rows, SPOILED, j)) < np.inf) & (w > 0.0)
        put(rows, TRUST, j, select(fine, w, 0.0))
        used = used + select(fine, 1.0, 0.0)
    return int(folded(used, 0.0))


@uncounted(error_model="numpy")
def _gloss_of_band(given, b, rows):
    """Fill the gloss of a texel's observations in a band."""
    ratio = given.ratio
    if not given.coloured:
        for j in range(vectors_of(rows)):
            put(rows, _OF_BAND, j, get(rows, _OF_GREEN, j))
        return
    for j in range(rows.shape[1]):
        place = rows[_PLACE, j]
        i = min(int(place), ratio.shape[1] - 2)
        rows[_OF_BAND, j] = rows[_OF_GREEN, j] * (ratio[b, i] + (place - i) * (ratio[b, i + 1] - ratio[b, i]))


@uncounted(error_model="numpy")
def _load_band(t, given, b, rows):
    """Fill responses, gloss, and weights times cosθ_i of a texel in a band; return a rough diffuse response.

    It takes noise as unknown, because the response is not known; NaN without observations.
    """
    for j in range(given.response.shape[1]):
        rows[RESPONSE, j] = given.response[t, j, b]
    _gloss_of_band(given, b, rows)
    top, bottom = spread(0.0), spread(0.0)
    for j in range(vectors_of(rows)):
        r, c, gloss = get(rows, RESPONSE, j), get(rows, COSINE, j), get(rows, _OF_BAND, j)
        w = select(magnitude(r) < np.inf, get(rows, TRUST, j) * c, 0.0)
        r = select(w > 0.0, r, 0.0)
        put(rows, RESPONSE, j, r)
        put(rows, WEIGHT, j, w)
        uncertain = _GLOSS_MODEL_ERROR * gloss
        w = w / (_RESPONSE_NOISE * _RESPONSE_NOISE + uncertain * uncertain)
        top, bottom = top + w * (r - gloss), bottom + w * c
    total = folded(bottom, 0.0)
    return folded(top, 0.0) / total if total > 0.0 else np.nan


@uncounted(error_model="numpy")
def _leave_out_furthest(rows, observations):
    """Set the weight of the worst outlier that may be left out to 0, and return whether there is one.

    An outlier is more than `_FAR` standard deviations away from the prediction by the other observations.
    """
    top, bottom = spread(0.0), spread(0.0)
    for j in range(vectors_of(rows)):
        w = get(rows, WEIGHT, j) / get(rows, _SQUARE, j)
        top, bottom = top + w * get(rows, _REST, j), bottom + w * get(rows, COSINE, j)
    pull, cosines, furthest = folded(top, 0.0), folded(bottom, 0.0), spread(_FAR * _FAR)
    for j in range(vectors_of(rows)):
        c, rest, square = get(rows, COSINE, j), get(rows, _REST, j), get(rows, _SQUARE, j)
        w = get(rows, WEIGHT, j) / square
        others = cosines - w * c
        apart = rest - (pull - w * rest) / select(others > 0.0, others, 1.0) * c
        may_be = select(apart < 0.0, get(rows, _MAY_BE_LOW, j), get(rows, _MAY_BE_HIGH, j)) > 0.0
        off = select((w > 0.0) & (others > 0.0) & may_be, apart * apart / square, 0.0)
        put(rows, _OFF, j, off)
        furthest = upper_of(furthest, off)
    most = highest(furthest, 0.0)
    for j in range(observations):
        if rows[_OFF, j] == most and most > _FAR * _FAR:
            rows[TRUST, j], rows[WEIGHT, j] = 0.0, 0.0
            return True
    return False


@uncounted(error_model="numpy")
def _mark_brightest(rows, row):
    """Fill a row with 1 for observations whose response is at least `_PLATEAU` of the largest, 0 for others."""
    most = spread(0.0)
    for j in range(vectors_of(rows)):
        most = upper_of(most, select(get(rows, WEIGHT, j) > 0.0, get(rows, RESPONSE, j), 0.0))
    least = _PLATEAU * highest(most, 0.0)
    for j in range(vectors_of(rows)):
        put(rows, row, j, select(get(rows, RESPONSE, j) >= least, 1.0, 0.0))


@uncounted(error_model="numpy")
def _leave_out(t, given, rows, used):
    """Set the weights of outliers among the ``used`` observations of a texel to 0, for all bands.

    In green, at most one observation in eight is left out, because the gloss may be wrong. Then each other band is
    compared with green. The two differ by diffuse light alone, however wrong the gloss is, and by what little the
    colour of gloss adds. So clipped readings are told, as long as they are a minority: they are the brightest of a
    band, and too dark. Other differences are no reason: at a seam, what a texel shows differs between photographs.
    """
    observations, bands = given.response.shape[1], given.response.shape[2]
    green, left = min(GREEN, bands - 1), (used - 1) // 2
    level = _load_band(t, given, green, rows)
    for j in range(vectors_of(rows)):
        r, c, gloss = get(rows, RESPONSE, j), get(rows, COSINE, j), get(rows, _OF_BAND, j)
        # A response that lost its light would get too small a variance, and decide what the others contradict.
        bright = upper_of(r, level * c + gloss)
        put(rows, _REST, j, r - gloss)
        put(rows, _SQUARE, j, _expected(given, green, j, gloss, bright))
        put(rows, _GREEN_REST, j, r - gloss)
        put(rows, _GREEN_SQUARE, j, _expected(given, green, j, 0.0, bright))
        put(rows, _MAY_BE_LOW, j, spread(1.0))
        put(rows, _MAY_BE_HIGH, j, spread(1.0))
    for _ in range(used // _AN_OUTLIER_IN):
        if not _leave_out_furthest(rows, observations):
            break
        left -= 1
    _mark_brightest(rows, _MAY_BE_HIGH)  # too dark in green
    for b in range(bands):
        if b == green:
            continue
        level = _load_band(t, given, b, rows)
        _mark_brightest(rows, _MAY_BE_LOW)
        for j in range(vectors_of(rows)):
            r, c, gloss = get(rows, RESPONSE, j), get(rows, COSINE, j), get(rows, _OF_BAND, j)
            bright, coloured = upper_of(r, level * c + gloss), gloss - get(rows, _OF_GREEN, j)
            put(rows, _REST, j, r - gloss - get(rows, _GREEN_REST, j))
            put(rows, _SQUARE, j, _expected(given, b, j, coloured, bright) + get(rows, _GREEN_SQUARE, j))
        while left > 0 and _leave_out_furthest(rows, observations):
            left -= 1


@uncounted(error_model="numpy")
def _combine_texel(t, given, rows, out, variance):
    """Fill diffuse responses and variances of a texel, (bands,) each."""
    noise, last = given.noise, given.ratio.shape[1] - 1.0
    for j in range(given.response.shape[1] if given.coloured else 0):
        rows[_PLACE, j] = min(max(given.geometry[t, j, 2] / (0.5 * math.pi) * last, 0.0), last)
    _leave_out(t, given, rows, _screen(t, given, rows))
    for b in range(given.response.shape[2]):
        diffuse, scatter = _load_band(t, given, b, rows), spread(0.0)
        if math.isnan(diffuse):
            out[b], variance[b] = np.nan, np.nan
            continue
        top, bottom = spread(0.0), spread(0.0)
        for j in range(vectors_of(rows)):
            r, c, gloss, w = get(rows, RESPONSE, j), get(rows, COSINE, j), get(rows, _OF_BAND, j), get(rows, WEIGHT, j)
            told = w > 0.0
            w = w / _expected(given, b, j, gloss, diffuse * c + gloss)
            top, bottom = top + w * (r - gloss), bottom + w * c
            first = 2 * b * noise.shape[2] + j * LANES
            own = load(noise, first) + load(noise, first + noise.shape[2]) * upper_of(r, 0.0)
            scatter = scatter + select(told, w * w * own, 0.0)
        total = folded(bottom, 0.0)
        out[b], variance[b] = folded(top, 0.0) / total, folded(scatter, 0.0) / (total * total)


@uncounted(error_model="numpy")
def _add_gloss(t, given, component, lobes, rows):
    """Fill the rows of a texel's geometry, and add the gloss of a component in green."""
    beta, mu = given.gloss[t, 2 * component], given.gloss[t, 2 * component + 1]
    pack_geometry(given.geometry[t], lobes, given.n, given.k, given.coupled, rows)
    if beta > 0.0:
        fill_lobe(rows, lobes, math.log(mu))
        for j in range(vectors_of(rows)):
            put(rows, _OF_GREEN, j, get(rows, _OF_GREEN, j) + beta * get(rows, LOBE, j))


@njit(cache=True, nogil=True, error_model="numpy")
def _combine_chunk(given, out, variance, first, last):
    rows, gloss = new_rows(given.response.shape[1]), given.gloss
    rows[:] = 0.0
    for t in range(first, last):
        rows[_OF_GREEN] = 0.0
        _add_gloss(t, given, 0, given.lobes[0], rows)
        if gloss.shape[1] > 2 and gloss[t, 2] > 0.0:
            _add_gloss(t, given, 1, given.lobes[1], rows)
        _combine_texel(t, given, rows, out[t], variance[t])


def diffuse_response(
    response,
    geometry,
    weight,
    result: FitResult,
    fresnel: BandGloss,
    noise,
    *,
    model_error: float = 0.01,
    coupled: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Combine the observations of each texel to its diffuse response, without gloss, in every band.

    The fitted gloss is subtracted from every observation. The remainder, divided by cosθ_i, is averaged with inverse
    variances as weights and without outliers. Observations with strong gloss have less weight because of the error of
    the gloss model.

    Parameters
    ----------
    response : (texels, J, bands) float
    geometry : (texels, J, 4) float, rad
    weight : (texels, J) float
    result : FitResult
    fresnel : BandGloss
        n and k of the fit, and the Fresnel reflectance of each band.
    noise : (J, bands, 2) float
        c0 and c1 of the variance c0 + c1 ρ of a response ρ by the camera's noise.
    model_error : float
        Relative error of an observation apart from noise.
    coupled : bool
        Whether the coat reduces the diffuse term, see `irodori.reflection.coat`.

    Returns
    -------
    response : (texels, bands) float64
        NaN where there is no observation.
    variance : (texels, bands) float64
        Variance by the camera's noise alone; NaN where the noise is unknown or there is no observation.
    """
    observed = Observed(response, geometry, weight, np.empty((0, 0), np.uint8), noise)
    return without_gloss(observed, result.gloss, result.lobes, fresnel, model_error=model_error, coupled=coupled)


def without_gloss(
    observed: Observed,
    gloss,
    lobes: tuple[str, ...],
    fresnel: BandGloss,
    *,
    model_error: float,
    coupled: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute diffuse responses and variances as `diffuse_response` does, for a given gloss.

    Parameters
    ----------
    observed : Observed
    gloss : (texels, 2 or 4) float64
        β and μ of each component.
    lobes : tuple of str
        Lobe of each component.
    fresnel, model_error, coupled
        As in `diffuse_response`.
    """
    out, variance = np.empty((2, len(observed.response), observed.response.shape[2]))
    captures, bands, _ = observed.noise.shape
    noise = np.zeros((bands, 2, padded(captures)))
    noise[..., :captures] = np.moveaxis(observed.noise, 0, -1)
    alone = tuple(Lobes((name,)) for name in (lobes if len(lobes) > 1 else lobes * 2))
    given = Fitted(
        observed.response, observed.geometry, observed.weight, noise, float(model_error), alone, gloss, fresnel.n,
        fresnel.k, coupled, bool((fresnel.ratio != 1.0).any()), fresnel.ratio,
    )  # fmt: skip
    run_chunks(_combine_chunk, len(out), _CHUNK, given, out, variance)
    return out, variance
