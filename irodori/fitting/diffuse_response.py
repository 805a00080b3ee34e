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
    LOBE,
    LOBE_SLOPE,
    RESPONSE,
    SPOILED,
    TRUST,
    VARIANCE,
    WEIGHT,
    WEIGHTED_COSINE,
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
_FAR, _AN_OUTLIER_IN = 6.0, 8  # distance of an outlier in standard deviations; at most one observation in 8 is one
_CHUNK = 2048  # texels that a thread takes at a time
#: Rows with other contents here than in a fit: gloss in green, gloss in the present band, place in the table of ratios,
#: weight of an observation for its outlier test, and its squared distance.
_OF_GREEN, _OF_BAND, _PLACE, _PULL, _OFF = ASSUMED, LOBE_SLOPE, BEFORE, VARIANCE, WEIGHTED_COSINE


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
def _leave_out(t, given, rows):
    """Fill the weights of the valid observations of a texel; those of invalid ones and of outliers are 0.

    An outlier is more than `_FAR` standard deviations away from the prediction by the other observations, in green. At
    most one observation in eight is left out.
    """
    response, weight, used, b = given.response, given.weight, spread(0.0), min(GREEN, given.response.shape[2] - 1)
    for j in range(response.shape[1]):
        rows[RESPONSE, j], rows[TRUST, j] = response[t, j, b], weight[t, j]
    for j in range(vectors_of(rows)):
        r, w = get(rows, RESPONSE, j), get(rows, TRUST, j)
        fine = (magnitude(r + get(rows, SPOILED, j)) < np.inf) & (w > 0.0)
        put(rows, RESPONSE, j, select(fine, r, 0.0))
        put(rows, TRUST, j, select(fine, w, 0.0))
        used = used + select(fine, 1.0, 0.0)
    for _ in range(int(folded(used, 0.0)) // _AN_OUTLIER_IN):
        top, bottom = spread(0.0), spread(0.0)
        for j in range(vectors_of(rows)):
            r, c, gloss = get(rows, RESPONSE, j), get(rows, COSINE, j), get(rows, _OF_GREEN, j)
            w = get(rows, TRUST, j) * c / _expected(given, b, j, gloss, upper_of(r, gloss))
            put(rows, _PULL, j, w)
            top, bottom = top + w * (r - gloss), bottom + w * c
        pull, cosines, furthest = folded(top, 0.0), folded(bottom, 0.0), spread(_FAR * _FAR)
        for j in range(vectors_of(rows)):
            r, c, gloss, w = get(rows, RESPONSE, j), get(rows, COSINE, j), get(rows, _OF_GREEN, j), get(rows, _PULL, j)
            rest = cosines - w * c
            told = (w > 0.0) & (rest > 0.0)
            by_others = (pull - w * (r - gloss)) / select(told, rest, 1.0) * c + gloss
            apart = r - by_others
            off = select(told, apart * apart / _expected(given, b, j, gloss, by_others), 0.0)
            put(rows, _OFF, j, off)
            furthest = upper_of(furthest, off)
        most = highest(furthest, 0.0)
        if not most > _FAR * _FAR:
            return
        for j in range(response.shape[1]):
            if rows[_OFF, j] == most:
                rows[TRUST, j] = 0.0
                break


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
def _combine_texel(t, given, rows, out, variance):
    """Fill diffuse responses and variances of a texel, (bands,) each."""
    response, noise, last = given.response, given.noise, given.ratio.shape[1] - 1.0
    _leave_out(t, given, rows)
    for j in range(response.shape[1] if given.coloured else 0):
        rows[_PLACE, j] = min(max(given.geometry[t, j, 2] / (0.5 * math.pi) * last, 0.0), last)
    for b in range(response.shape[2]):
        for j in range(response.shape[1]):
            rows[RESPONSE, j] = response[t, j, b]
        _gloss_of_band(given, b, rows)
        # First with the variance that unknown noise counts as, because the response is not known.
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
        if not total > 0.0:
            out[b], variance[b] = np.nan, np.nan
            continue
        diffuse, scatter = folded(top, 0.0) / total, spread(0.0)
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
